//! What the material of a mesh gives to a micropolygon.

use super::lattice::Cell;
use crate::{Material, Mesh, Scene, Texture};
use pbgi_math::{DVec3, Vec2};

/// Most alpha samples along an edge of a micropolygon.
pub(super) const ALPHA_GRID_MAX: u32 = 4;

/// The same of one that has holes and is not quartered.
pub(super) const ALPHA_GRID_LAST: u32 = 8;

/// How far an attribute of a parallelogram may be off from linear, as a share of its span.
const LINEAR_TOLERANCE: f32 = 1e-4;

/// A mesh with its material, ready to be evaluated.
#[derive(Clone, Copy)]
pub(super) struct Surface<'a> {
    mesh: &'a Mesh,
    pub material: &'a Material,
    base_color: Option<&'a Texture>,
    emission: Option<&'a Texture>,
}

/// One triangle of a [`Surface`].
#[derive(Clone, Copy)]
pub(super) struct TriangleSurface<'a> {
    surface: Surface<'a>,
    uvs: [Vec2; 3],
    colors: [[f32; 3]; 3],
    alphas: [f32; 3],
    /// Area in texture coordinates over area in space.
    uv_density: f64,
}

/// Diffuse albedo and emitted radiance of a micropolygon.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shade {
    pub albedo: [f32; 3],
    pub emission: [f32; 3],
}

impl<'a> Surface<'a> {
    /// The mesh and its material; both are known to be consistent with the scene.
    pub fn new(scene: &'a Scene, mesh: &'a Mesh, material: &'a Material) -> Self {
        let has_uvs = mesh.uvs.len() == mesh.positions.len();
        let texture = |index: Option<u32>| {
            index.filter(|_| has_uvs).and_then(|i| scene.textures.get(i as usize))
        };
        Self {
            mesh,
            material,
            base_color: texture(material.base_color_texture),
            emission: texture(material.emission_texture),
        }
    }

    /// Whether every micropolygon of a triangle looks the same.
    pub fn is_uniform(&self) -> bool {
        self.base_color.is_none() && self.emission.is_none() && self.mesh.colors.is_empty()
    }

    /// Whether parts of the surface may be holes.
    pub fn is_masked(&self) -> bool {
        self.material.alpha_cutoff.is_some()
    }

    /// Whether texture coordinates, colors and alphas, where they matter, are linear over the parallelogram of two triangles: one
    /// with corner `i` and one with corner `j` opposite the edge they share.
    pub fn is_linear(&self, triangles: [usize; 2], [i, j]: [usize; 2]) -> bool {
        let [p, q] = triangles.map(|index| self.mesh.triangles[index].map(|v| v as usize));
        // Each pair must agree; the last is the parallelogram's fourth corner.
        let is_linear = |value: &dyn Fn(usize) -> f32, span: f32| {
            let [apex, left, right] = [0, 1, 2].map(|k| value(p[(i + k) % 3]));
            let [fourth, right2, left2] = [0, 1, 2].map(|k| value(q[(j + k) % 3]));
            let near = |a: f32, b: f32| (a - b).abs() <= LINEAR_TOLERANCE * span;
            near(left, left2) && near(right, right2) && near(fourth, left + right - apex)
        };
        let uv = |v: usize| self.mesh.uvs.get(v).copied().unwrap_or(Vec2::ZERO);
        let textured = self.base_color.is_some() || self.emission.is_some();
        let span = uv(p[0]).distance(uv(p[1])).max(uv(p[0]).distance(uv(p[2])));
        let uvs_linear =
            !textured || is_linear(&|v| uv(v).x, span) && is_linear(&|v| uv(v).y, span);
        let color = |v: usize, c: usize| self.mesh.colors.get(v).map_or(1.0, |color| color[c]);
        let alpha = |v: usize| self.mesh.alphas.get(v).copied().unwrap_or(1.0);
        uvs_linear
            && (self.mesh.colors.is_empty() || (0..3).all(|c| is_linear(&|v| color(v, c), 1.0)))
            && (!self.is_masked() || self.mesh.alphas.is_empty() || is_linear(&alpha, 1.0))
    }

    /// Triangle `index` of the mesh, whose area in space is `area`.
    pub fn triangle(&self, index: usize, area: f64) -> TriangleSurface<'a> {
        let corners = self.mesh.triangles[index];
        let uvs = corners.map(|v| self.mesh.uvs.get(v as usize).copied().unwrap_or(Vec2::ZERO));
        let colors = corners.map(|v| self.mesh.colors.get(v as usize).copied().unwrap_or([1.0; 3]));
        let alphas = corners.map(|v| self.mesh.alphas.get(v as usize).copied().unwrap_or(1.0));
        let (a, b) = (uvs[1] - uvs[0], uvs[2] - uvs[0]);
        let uv_area = 0.5 * f64::from(a.perp_dot(b)).abs();
        TriangleSurface { surface: *self, uvs, colors, alphas, uv_density: uv_area / area }
    }
}

impl TriangleSurface<'_> {
    /// Albedo and emission of `cell`, textures filtered over its size.
    pub fn shade(&self, cell: &Cell) -> Shade {
        let material = self.surface.material;
        let uv = self.uv(cell.barycentric());
        let lookup = |texture: Option<&Texture>| {
            texture.map_or([1.0; 4], |t| t.sample_level(uv, self.texel_footprint(t, cell)))
        };
        let (texel, glow) = (lookup(self.surface.base_color), lookup(self.surface.emission));
        let color = self.color(cell.barycentric());
        let diffuse = 1.0 - material.metallic.clamp(0.0, 1.0);
        Shade {
            albedo: std::array::from_fn(|c| {
                (material.base_color[c] * texel[c] * color[c] * diffuse).clamp(0.0, 1.0)
            }),
            emission: std::array::from_fn(|c| (material.emission[c] * glow[c]).max(0.0)),
        }
    }

    /// Whether all between cells is a hole, of which these are at the corners.
    pub fn is_hole_between(&self, cells: &[Cell]) -> bool {
        let Some(cutoff) = self.surface.material.alpha_cutoff else { return false };
        let vertex = self.alphas.into_iter().fold(0f32, f32::max);
        let Some(texture) = self.surface.base_color else { return vertex < cutoff };
        let uvs = || cells.iter().flat_map(Cell::corners).map(|corner| self.uv(corner));
        let min = uvs().fold(Vec2::INFINITY, Vec2::min);
        let max = uvs().fold(Vec2::NEG_INFINITY, Vec2::max);
        texture.alpha_max_within(min, max) * vertex < cutoff
    }

    /// Share of `cell` that is not a hole, from up to `grid_max` × `grid_max` samples of the alpha.
    pub fn opaque_fraction(&self, cell: &Cell, grid_max: u32) -> f64 {
        let Some(cutoff) = self.surface.material.alpha_cutoff else { return 1.0 };
        let texture = self.surface.base_color;
        // Two samples per texel see every edge that bilinear lookup can show.
        let grid = texture.map_or(1.0, |t| 2.0 * self.texel_footprint(t, cell));
        let grid = (grid.ceil() as u32).clamp(1, grid_max);
        let fades = self.alphas != [self.alphas[0]; 3];
        let grid = if fades { grid_max } else { grid };
        let (mut opaque, mut total) = (0u32, 0u32);
        cell.visit_grid(grid, |barycentric| {
            let texel = texture.map_or(1.0, |t| t.sample_alpha(self.uv(barycentric)));
            let alpha = texel * self.alpha(barycentric);
            total += 1;
            opaque += u32::from(alpha >= cutoff);
        });
        f64::from(opaque) / f64::from(total)
    }

    fn uv(&self, barycentric: DVec3) -> Vec2 {
        let b = barycentric.as_vec3();
        self.uvs[0] * b.x + self.uvs[1] * b.y + self.uvs[2] * b.z
    }

    fn color(&self, barycentric: DVec3) -> [f32; 3] {
        let b = barycentric.as_vec3();
        let [p, q, r] = self.colors;
        std::array::from_fn(|c| p[c] * b.x + q[c] * b.y + r[c] * b.z)
    }

    fn alpha(&self, barycentric: DVec3) -> f32 {
        let [p, q, r] = self.alphas;
        // Not rounded where it is the same everywhere: it is compared.
        if p == q && q == r {
            return p;
        }
        let b = barycentric.as_vec3();
        p * b.x + q * b.y + r * b.z
    }

    /// Edge, in texels, of a square as large as `cell` in the texture.
    fn texel_footprint(&self, texture: &Texture, cell: &Cell) -> f32 {
        let texels = f64::from(texture.width()) * f64::from(texture.height());
        (self.uv_density * cell.area() * texels).sqrt() as f32
    }
}
