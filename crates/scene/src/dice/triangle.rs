//! One triangle of an instance, from world positions to surfels.

use super::TwoSided;
use super::lattice::{Cell, Lattices};
use super::surface::{Shade, Surface, TriangleSurface};
use crate::{Instance, Mesh, Scene};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{Affine3A, DVec3, encode_octahedral24};

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

/// A triangle cut into micropolygons, and what their surfels share.
pub(super) struct DicedTriangle<'a> {
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

    /// Surfels of triangle `index`; `None` if it has no area.
    pub fn count_surfels(&self, index: usize, spacing: f64) -> Option<u64> {
        let triangle = self.triangle(index)?;
        let cells = if self.is_masked() {
            self.dice(&triangle, index, spacing).count_opaque_cells()
        } else {
            Lattices::new(triangle.positions, spacing * self.spacing_factor).cell_count()
        };
        Some(cells.saturating_mul(self.side_count()))
    }

    /// Cuts `triangle`, the one with `index`.
    pub fn dice(&self, triangle: &Triangle, index: usize, spacing: f64) -> DicedTriangle<'a> {
        let lattices = Lattices::new(triangle.positions, spacing * self.spacing_factor);
        let surface = self.surface.triangle(index, triangle.area);
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
        let mut diced = DicedTriangle {
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
            let shade = diced.surface.shade(&lattices.pieces[0].clipped_cell(0, 0));
            diced.set_shade(shade);
        }
        diced
    }
}

impl DicedTriangle<'_> {
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
            out.push(Surfel { position, radius, area, orientation, ..*side });
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
