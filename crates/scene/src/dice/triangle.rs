//! One triangle of an instance, or two as one rectangle, from world positions to surfels.

use super::lattice::{Cell, Lattice, Lattices, SKEW_COSINE_MAX};
use super::surface::{ALPHA_GRID_LAST, ALPHA_GRID_MAX, Shade, Surface, TriangleSurface};
use super::{RUN_TRIANGLES, TwoSided};
use crate::{Instance, Mesh, Scene};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{Affine3A, DVec3, encode_octahedral24};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// How far the fourth corner of a rectangle may be off, as a share of its longer edge.
const FLAT_TOLERANCE: f64 = 1e-4;

/// Cells at the edge of a hole are quartered while the root of their area is above this share of the spacing: twice at most.
const HOLE_SHARE_MIN: f64 = 0.3;

/// Cells of a row that are skipped as one where all are holes.
pub(super) const RUN_CELLS: u64 = 64;

/// What looking at a cell takes, in what it takes to see that rows or a part of one are a hole.
const CELL_LOOKS: u64 = 4;

/// Counting that may have to end before it is done.
pub(super) struct Work<'a> {
    stop: &'a AtomicBool,
    /// Looks so far, and how many may be: a cell takes some, and what is one hole one.
    done: AtomicU64,
    most: u64,
}

impl<'a> Work<'a> {
    pub fn new(stop: &'a AtomicBool, cells_max: u64) -> Self {
        Self { stop, done: AtomicU64::new(0), most: cells_max.saturating_mul(CELL_LOOKS) }
    }

    /// Counts looks.
    fn look(&self, looks: u64) {
        self.done.fetch_add(looks, Ordering::Relaxed);
    }

    /// Whether more cells were looked at than may be. It does not depend on who looks at which.
    pub fn is_too_much(&self) -> bool {
        self.done.load(Ordering::Relaxed) > self.most
    }

    /// Whether the rest is of no use.
    pub fn is_over(&self) -> bool {
        self.is_too_much() || self.stop.load(Ordering::Relaxed)
    }
}

/// Most surfels of one cell: all its parts, both sides.
#[cfg(test)]
pub(super) const CELL_SURFELS_MAX: usize = 2 * 16;

/// An instance with its mesh and material.
#[derive(Clone, Copy)]
pub(super) struct InstanceView<'a> {
    pub mesh: &'a Mesh,
    pub mesh_index: u32,
    transform: Affine3A,
    flips: bool,
    surface: Surface<'a>,
    two_sided: bool,
    spacing_factor: f64,
}

/// A triangle's world positions and what the sides share.
#[derive(Clone, Copy)]
pub(super) struct Triangle {
    pub positions: [DVec3; 3],
    /// Unit normal of the front.
    normal: DVec3,
    pub area: f64,
}

/// What is diced as one: a triangle, or two that follow each other in the mesh and make up a rectangle.
#[derive(Clone, Copy)]
pub(super) struct Patch {
    index: usize,
    /// The first triangle.
    triangle: Triangle,
    /// Of the second: which corner of the first lies opposite the edge they share.
    rectangle: Option<usize>,
}

impl Patch {
    /// Triangles of the mesh in it.
    pub fn triangle_count(&self) -> usize {
        if self.rectangle.is_some() { 2 } else { 1 }
    }

    fn lattices(&self, spacing: f64) -> Lattices {
        match self.rectangle {
            None => Lattices::new(self.triangle.positions, spacing),
            Some(apex) => Lattices::of_rectangle(self.triangle.positions, apex, spacing),
        }
    }
}

/// A patch cut into micropolygons, and what their surfels share.
pub(super) struct DicedPatch<'a> {
    pub lattices: Lattices,
    surface: TriangleSurface<'a>,
    masked: bool,
    /// Area below which cells with holes are not quartered.
    part_area_min: f64,
    uniform: bool,
    /// Front first; position, size and, unless uniform, color are set per micropolygon.
    sides: [Surfel; 2],
    outlines: [Outlines; 2],
    side_count: usize,
    back_emits: bool,
}

/// What the cells of a piece have in common, for each side.
#[derive(Clone, Copy, Default)]
struct Outlines {
    /// Of rectangles whose long edge is the first, and the second.
    rectangles: [[Outline; 2]; 2],
    /// Of triangles, and of those turned by half a circle; and their radius over the root of their area.
    triangles: [[Outline; 2]; 2],
    triangle_radius: f32,
    /// Along the first edge of a triangle that is not turned.
    edge: DVec3,
}

/// What of a surfel does not depend on its size.
#[derive(Clone, Copy, Default)]
struct Outline {
    orientation: u32,
    flags: SurfelFlags,
}

impl Outlines {
    fn new(piece: &Lattice, sides: [Surfel; 2], normal: DVec3) -> Self {
        let outline =
            |surfel: Surfel| Outline { orientation: surfel.orientation, flags: surfel.flags };
        let sides = sides.map(|side| Surfel { area: 1.0, ..side });
        let mut outlines = Self::default();
        // A row ends in a triangle, where there are any.
        let cell = piece.cell(piece.column_count(0) - 1, 0);
        if piece.has_rectangles() {
            let along = |edge: DVec3| sides.map(|side| side.with_tile(edge.as_vec3(), 1.0));
            let edges = cell.edges().map(DVec3::normalize_or_zero);
            outlines.rectangles = edges.map(|edge| along(edge).map(outline));
        }
        if cell.is_triangle {
            let (base, foot) = cell.base(normal);
            let (base, foot) = ((base / cell.area().sqrt()).as_vec3(), foot as f32);
            // Turned, the longest edge runs the other way; seen from behind, from its end.
            let triangles = [base, -base].map(|base| {
                [sides[0].with_triangle(base, foot), sides[1].with_triangle(-base, 1.0 - foot)]
            });
            outlines.triangles = triangles.map(|sides| sides.map(outline));
            outlines.triangle_radius = triangles[0][0].radius;
            outlines.edge = cell.edges()[0];
        }
        outlines
    }

    /// What `side` of a cell of this area is, and its radius.
    #[inline]
    fn of(&self, cell: &Cell, area: f32, side: usize) -> (Outline, f32) {
        if cell.is_triangle {
            let turned = usize::from(cell.is_turned(self.edge));
            return (self.triangles[turned][side], self.triangle_radius * area.sqrt());
        }
        let [u, v] = cell.edges().map(DVec3::length_squared);
        let long = usize::from(v > u);
        // Half the diagonal of the rectangle with these edges' ratio and the area.
        let aspect = (u / v).sqrt() as f32;
        (self.rectangles[long][side], 0.5 * (area * (aspect + 1.0 / aspect)).sqrt())
    }
}

impl<'a> InstanceView<'a> {
    /// `instance` of a valid `scene`.
    pub fn new(scene: &'a Scene, instance: &Instance, two_sided: TwoSided) -> Self {
        let mesh = &scene.meshes[instance.mesh as usize];
        let material = &scene.materials[mesh.material as usize];
        Self {
            mesh,
            mesh_index: instance.mesh,
            transform: instance.transform,
            flips: instance.flips(),
            surface: Surface::new(scene, mesh, material),
            two_sided: match two_sided {
                TwoSided::Material => material.double_sided,
                TwoSided::All => true,
                TwoSided::None => false,
            },
            spacing_factor: f64::from(material.spacing_factor),
        }
    }

    /// Surfels on an area of the square of the spacing, about.
    pub fn surfel_density(&self) -> f64 {
        self.side_count() as f64 / (self.spacing_factor * self.spacing_factor)
    }

    /// Surfels per micropolygon.
    pub fn side_count(&self) -> u64 {
        if self.two_sided { 2 } else { 1 }
    }

    /// Whether parts of the surface may be holes.
    pub fn is_masked(&self) -> bool {
        self.surface.is_masked()
    }

    /// Triangle `index` in the world; `None` if its area is 0 or too large for a surfel.
    pub fn triangle(&self, index: usize) -> Option<Triangle> {
        let positions = self.mesh.triangles[index]
            .map(|v| self.transform.transform_point3(self.mesh.positions[v as usize]).as_dvec3());
        let [a, b, c] = positions;
        let cross = (b - a).cross(c - a);
        let double_area = cross.length();
        let area = 0.5 * double_area;
        // Neither 0 nor infinite, in the precision of a surfel.
        if !(area as f32).is_normal() {
            return None;
        }
        let normal = cross / if self.flips { -double_area } else { double_area };
        Some(Triangle { positions, normal, area })
    }

    /// The patch that starts with triangle `index`; `None` if that has no area.
    pub fn patch(&self, index: usize) -> Option<Patch> {
        let triangle = self.triangle(index)?;
        Some(Patch { index, triangle, rectangle: self.find_rectangle(index, &triangle) })
    }

    /// Whether triangle `index` and the next one make up a rectangle; see [`Patch::rectangle`]. Pairs stay within runs of [`RUN_TRIANGLES`], so that those can be counted apart.
    fn find_rectangle(&self, index: usize, first: &Triangle) -> Option<usize> {
        let next = index + 1;
        if next.is_multiple_of(RUN_TRIANGLES) || next >= self.mesh.triangles.len() {
            return None;
        }
        let second = self.triangle(next)?;
        let (p, q) = (first.positions, second.positions);
        let shared = |i: usize, j: usize| {
            q[(j + 1) % 3] == p[(i + 2) % 3] && q[(j + 2) % 3] == p[(i + 1) % 3]
        };
        let (i, j) = (0..9).map(|k| (k / 3, k % 3)).find(|&(i, j)| shared(i, j))?;
        let (u, v) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
        let size = u.length().max(v.length());
        let is_parallelogram = (p[i] + u + v).distance(q[j]) <= FLAT_TOLERANCE * size;
        let is_skew = u.dot(v).abs() > SKEW_COSINE_MAX * u.length() * v.length();
        (is_parallelogram && !is_skew && self.surface.is_linear([index, next], [i, j])).then_some(i)
    }

    /// Micropolygons of a patch, holes included.
    pub fn count_cells(&self, patch: &Patch, spacing: f64) -> u64 {
        patch.lattices(spacing * self.spacing_factor).cell_count()
    }

    /// Surfels of a patch; too few once `work` is over.
    pub fn count_surfels(&self, patch: &Patch, spacing: f64, work: &Work<'_>) -> u64 {
        let cells = if self.is_masked() {
            self.dice(patch, spacing).count_opaque_cells(work)
        } else {
            self.count_cells(patch, spacing)
        };
        cells.saturating_mul(self.side_count())
    }

    /// Cuts a patch.
    pub fn dice(&self, patch: &Patch, spacing: f64) -> DicedPatch<'a> {
        let triangle = &patch.triangle;
        let spacing = spacing * self.spacing_factor;
        let lattices = patch.lattices(spacing);
        let surface = self.surface.triangle(patch.index, triangle.area);
        let flags = if self.two_sided { SurfelFlags::FRONT_ONLY } else { SurfelFlags::default() };
        let normal = triangle.normal.as_vec3();
        let side = |normal| Surfel {
            orientation: encode_octahedral24(normal),
            flags,
            ..Surfel::default()
        };
        let sides = [side(normal), side(-normal)];
        let mut outlines = [Outlines::default(); 2];
        for (outlines, piece) in outlines.iter_mut().zip(lattices.pieces()) {
            *outlines = Outlines::new(piece, sides, triangle.normal);
        }
        let mut diced = DicedPatch {
            lattices,
            surface,
            masked: self.is_masked(),
            part_area_min: (HOLE_SHARE_MIN * spacing).powi(2),
            uniform: self.surface.is_uniform(),
            sides,
            outlines,
            side_count: if self.two_sided { 2 } else { 1 },
            back_emits: self.surface.material.double_sided,
        };
        if diced.uniform {
            // Without textures and vertex colors any cell will do.
            let shade = diced.surface.shade(&lattices.pieces[0].cell(0, 0));
            diced.set_shade(shade);
        }
        diced
    }
}

impl DicedPatch<'_> {
    /// Micropolygons that are not all hole; too few once `work` is over.
    fn count_opaque_cells(&self, work: &Work<'_>) -> u64 {
        let pieces = 0..self.lattices.piece_count;
        pieces.map(|p| self.count_rows(p, 0..self.lattices.pieces[p].row_count(), work)).sum()
    }

    fn count_rows(&self, piece: usize, rows: Range<u64>, work: &Work<'_>) -> u64 {
        if rows.is_empty() || work.is_over() {
            return 0;
        }
        work.look(1);
        if self.are_holes(piece, rows.clone()) {
            return 0;
        }
        let lattice = &self.lattices.pieces[piece];
        if rows.end - rows.start > 1 {
            let middle = rows.start.midpoint(rows.end);
            let halves = [rows.start..middle, middle..rows.end];
            return halves.into_iter().map(|half| self.count_rows(piece, half, work)).sum();
        }
        let columns = lattice.column_count(rows.start);
        (0..columns)
            .step_by(RUN_CELLS as usize)
            .map(|first| {
                let run = first..columns.min(first + RUN_CELLS);
                self.count_run(piece, rows.start, run, work)
            })
            .sum()
    }

    fn count_run(&self, piece: usize, row: u64, columns: Range<u64>, work: &Work<'_>) -> u64 {
        if work.is_over() {
            return 0;
        }
        if self.is_hole_run(piece, row, columns.clone()) {
            work.look(1);
            return 0;
        }
        work.look(CELL_LOOKS * (columns.end - columns.start));
        let mut count = 0;
        for column in columns {
            let cell = self.lattices.pieces[piece].cell(column, row);
            visit_opaque(&self.surface, &cell, self.part_area_min, &mut |_, _| count += 1);
        }
        count
    }

    /// Whether all cells of these rows, of which there is at least one, are holes for sure.
    pub fn are_holes(&self, piece: usize, rows: Range<u64>) -> bool {
        let lattice = &self.lattices.pieces[piece];
        let ends =
            |row: u64| [lattice.cell(0, row), lattice.cell(lattice.column_count(row) - 1, row)];
        // The piece is convex, and so is what lies between the ends of its first and its last row.
        self.masked
            && self.surface.is_hole_between(&[ends(rows.start), ends(rows.end - 1)].concat())
    }

    /// Whether all cells of a part of a row, of which there is at least one, are holes for sure.
    pub fn is_hole_run(&self, piece: usize, row: u64, columns: Range<u64>) -> bool {
        let lattice = &self.lattices.pieces[piece];
        let ends = [columns.start, columns.end - 1].map(|column| lattice.cell(column, row));
        self.masked && self.surface.is_hole_between(&ends)
    }

    /// Appends the surfels of `cell` of a piece: one, or two back to back, or none if it is a hole; more if it has holes.
    #[inline]
    pub fn push_surfels(&mut self, piece: usize, cell: &Cell, out: &mut Vec<Surfel>) {
        if self.masked {
            let surface = self.surface;
            visit_opaque(&surface, cell, self.part_area_min, &mut |part, coarse| {
                let mut opaque = coarse;
                if coarse < 1.0 {
                    let fine = surface.opaque_fraction(part, ALPHA_GRID_LAST);
                    // What was counted is there, however little of it more samples find.
                    opaque = if fine > 0.0 { fine } else { coarse };
                }
                self.push_opaque(piece, part, opaque, out);
            });
        } else {
            self.push_opaque(piece, cell, 1.0, out);
        }
    }

    /// Appends the surfels of a cell of which the share `opaque` is no hole.
    #[inline]
    fn push_opaque(&mut self, piece: usize, cell: &Cell, opaque: f64, out: &mut Vec<Surfel>) {
        if !self.uniform {
            let shade = self.surface.shade(cell);
            self.set_shade(shade);
        }
        let position = cell.center().as_vec3().to_array();
        // Slivers may vanish in f32.
        let area = ((cell.area() * opaque) as f32).max(f32::MIN_POSITIVE);
        for (k, side) in self.sides[..self.side_count].iter().enumerate() {
            let (Outline { orientation, flags }, radius) = self.outlines[piece].of(cell, area, k);
            // What is so thin that its shape overflows is of no shape.
            let radius = if radius.is_finite() { radius } else { area.sqrt() };
            let radius = radius.max(f32::MIN_POSITIVE);
            out.push(Surfel { position, radius, area, orientation, flags, ..*side });
        }
    }

    fn set_shade(&mut self, shade: Shade) {
        let black = [0.0; 3];
        let emissions = [shade.emission, if self.back_emits { shade.emission } else { black }];
        for (side, emission) in self.sides.iter_mut().zip(emissions) {
            *side = side.with_albedo(shade.albedo).with_radiance(emission);
        }
    }
}

/// Visits what of a cell is no hole: all of it, or where a part is hole, its parts, quartered while they have more than `area_min`.
fn visit_opaque(
    surface: &TriangleSurface<'_>,
    cell: &Cell,
    area_min: f64,
    visit: &mut dyn FnMut(&Cell, f64),
) {
    let opaque = surface.opaque_fraction(cell, ALPHA_GRID_MAX);
    if opaque == 0.0 {
        return;
    }
    if opaque == 1.0 || cell.area() <= area_min {
        return visit(cell, opaque);
    }
    for part in cell.parts() {
        visit_opaque(surface, &part, area_min, visit);
    }
}
