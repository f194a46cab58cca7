//! One triangle of an instance, or two as one parallelogram, from world positions to surfels.

use super::lattice::{Cell, Lattices, Rectangle, SKEW_COSINE_MAX};
use super::surface::{Shade, Surface, TriangleSurface};
use super::{RUN_TRIANGLES, TwoSided};
use crate::{Instance, Mesh, Scene};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{Affine3A, DVec3, encode_octahedral24};

/// How far the fourth corner of a parallelogram may be off, as a share of its longer edge.
const FLAT_TOLERANCE: f64 = 1e-4;

/// An instance with its mesh and material.
#[derive(Clone, Copy)]
pub(super) struct InstanceView<'a> {
    pub mesh: &'a Mesh,
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

/// What is diced as one: a triangle, or two that follow each other in the mesh and make up a parallelogram.
#[derive(Clone, Copy)]
pub(super) struct Patch {
    index: usize,
    /// The first triangle.
    triangle: Triangle,
    /// The second: which corner of the first lies opposite the edge they share, and the area of both.
    parallelogram: Option<(usize, f64)>,
}

impl Patch {
    /// Triangles of the mesh in it.
    pub fn triangle_count(&self) -> usize {
        if self.parallelogram.is_some() { 2 } else { 1 }
    }

    fn lattices(&self, spacing: f64) -> Lattices {
        match self.parallelogram {
            None => Lattices::new(self.triangle.positions, spacing),
            Some((apex, area)) => {
                Lattices::of_parallelogram(self.triangle.positions, apex, area, spacing)
            }
        }
    }
}

/// A patch cut into micropolygons, and what their surfels share.
pub(super) struct DicedPatch<'a> {
    pub lattices: Lattices,
    surface: TriangleSurface<'a>,
    masked: bool,
    uniform: bool,
    /// Front first; position, size and, unless uniform, color are set per micropolygon.
    sides: [Surfel; 2],
    /// Of the whole cells of each piece, for each side: orientation, and radius over the root of the area.
    rectangles: [Option<[(u32, f32); 2]>; 2],
    side_count: usize,
    back_emits: bool,
}

impl<'a> InstanceView<'a> {
    /// `instance` of a valid `scene`.
    pub fn new(scene: &'a Scene, instance: &Instance, two_sided: TwoSided) -> Self {
        let mesh = &scene.meshes[instance.mesh as usize];
        let material = &scene.materials[mesh.material as usize];
        Self {
            mesh,
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
        Some(Patch { index, triangle, parallelogram: self.find_parallelogram(index, &triangle) })
    }

    /// Whether triangle `index` and the next one make up a parallelogram not too far from a rectangle; see
    /// [`Patch::parallelogram`]. Pairs stay within runs of [`RUN_TRIANGLES`], so that those can be counted apart.
    fn find_parallelogram(&self, index: usize, first: &Triangle) -> Option<(usize, f64)> {
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
        (is_parallelogram && !is_skew && self.surface.is_linear([index, next], [i, j]))
            .then_some((i, first.area + second.area))
    }

    /// Surfels of a patch.
    pub fn count_surfels(&self, patch: &Patch, spacing: f64) -> u64 {
        let cells = if self.is_masked() {
            self.dice(patch, spacing).count_opaque_cells()
        } else {
            patch.lattices(spacing * self.spacing_factor).cell_count()
        };
        cells.saturating_mul(self.side_count())
    }

    /// Cuts a patch.
    pub fn dice(&self, patch: &Patch, spacing: f64) -> DicedPatch<'a> {
        let triangle = &patch.triangle;
        let lattices = patch.lattices(spacing * self.spacing_factor);
        let surface = self.surface.triangle(patch.index, triangle.area);
        let flags = if self.two_sided { SurfelFlags::FRONT_ONLY } else { SurfelFlags::default() };
        let normal = triangle.normal.as_vec3();
        let side = |normal| Surfel {
            orientation: encode_octahedral24(normal),
            flags,
            ..Surfel::default()
        };
        let sides = [side(normal), side(-normal)];
        let rectangles = lattices.pieces.map(|piece| {
            let rectangle = piece.rectangle()?;
            let (edge, aspect) = (rectangle.direction.as_vec3(), rectangle.aspect as f32);
            Some(sides.map(|side| {
                let unit = Surfel { area: 1.0, ..side }.with_tile(edge, aspect);
                (unit.orientation, unit.radius)
            }))
        });
        let mut diced = DicedPatch {
            lattices,
            surface,
            masked: self.is_masked(),
            uniform: self.surface.is_uniform(),
            sides,
            rectangles,
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
    /// Micropolygons that are not all hole.
    fn count_opaque_cells(&self) -> u64 {
        let mut count = 0;
        for lattice in &self.lattices.pieces[..self.lattices.piece_count] {
            for row in 0..lattice.row_count() {
                let fraction =
                    |column| self.surface.opaque_fraction(lattice, &lattice.cell(column, row));
                let columns = 0..lattice.column_count(row);
                count += columns.filter(|&column| fraction(column) > 0.0).count() as u64;
            }
        }
        count
    }

    /// Appends the surfels of `cell` of a piece: one, two back to back, or none if it is a hole.
    #[inline]
    pub fn push_surfels(&mut self, piece: usize, cell: &Cell, out: &mut Vec<Surfel>) {
        let opaque = if self.masked {
            self.surface.opaque_fraction(&self.lattices.pieces[piece], cell)
        } else {
            1.0
        };
        if opaque == 0.0 {
            return;
        }
        if !self.uniform {
            let shade = self.surface.shade(cell);
            self.set_shade(shade);
        }
        let position = cell.center.as_vec3().to_array();
        // Slivers may vanish in f32.
        let area = ((cell.area * opaque) as f32).max(f32::MIN_POSITIVE);
        let radius = ((cell.radius * opaque.sqrt()) as f32).max(f32::MIN_POSITIVE);
        let rectangles = self.rectangles[piece].filter(|_| cell.whole);
        for (k, side) in self.sides[..self.side_count].iter().enumerate() {
            let (orientation, radius) = match rectangles.map(|sides| sides[k]) {
                Some((orientation, ratio)) => (orientation, ratio * area.sqrt()),
                None => (side.orientation, radius),
            };
            let surfel = Surfel { position, radius, area, orientation, ..*side };
            out.push(match &cell.sliver {
                Some(Rectangle { direction, aspect }) => {
                    surfel.with_tile(direction.as_vec3(), *aspect as f32)
                }
                None => surfel,
            });
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
