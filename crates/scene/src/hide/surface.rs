//! The triangles of a scene under one numbering, and what their surface is like at a point.

use super::project::Projector;
use crate::{Material, Mesh, Scene, Texture};
use pbgi_math::{Affine3A, DVec3, Vec2, Vec3};

/// Triangles of all instances, numbered in instance order.
pub(super) struct Triangles<'a> {
    scene: &'a Scene,
    /// Number of the first triangle of each instance, and the total.
    starts: Vec<u64>,
    default_material: Material,
}

/// One triangle with all that is needed to draw and to shade it.
#[derive(Clone, Copy)]
pub(super) struct SceneTriangle<'a> {
    pub mesh: &'a Mesh,
    pub material: &'a Material,
    textures: &'a [Texture],
    pub transform: &'a Affine3A,
    pub vertices: [usize; 3],
}

/// Colors of a surface at a point.
pub(super) struct SurfaceColor {
    pub base_color: [f32; 3],
    pub emission: [f32; 3],
}

impl<'a> Triangles<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let mut starts = vec![0];
        let mut total = 0;
        for instance in &scene.instances {
            let mesh = scene.meshes.get(instance.mesh as usize);
            total += mesh.map_or(0, |mesh| mesh.triangles.len() as u64);
            starts.push(total);
        }
        Self { scene, starts, default_material: Material::default() }
    }

    /// Number of triangles.
    pub fn count(&self) -> u64 {
        self.starts.last().copied().unwrap_or(0)
    }

    /// Triangle `number`; `None` where the scene's indices lead nowhere.
    pub fn get(&self, number: u32) -> Option<SceneTriangle<'_>> {
        let number = u64::from(number);
        let instance_index =
            self.starts.partition_point(|start| *start <= number).checked_sub(1)?;
        let instance = self.scene.instances.get(instance_index)?;
        let mesh = self.scene.meshes.get(instance.mesh as usize)?;
        let local = (number - self.starts[instance_index]) as usize;
        let vertices = mesh.triangles.get(local)?.map(|vertex| vertex as usize);
        if vertices.iter().any(|vertex| *vertex >= mesh.positions.len()) {
            return None;
        }
        Some(SceneTriangle {
            mesh,
            material: self
                .scene
                .materials
                .get(mesh.material as usize)
                .unwrap_or(&self.default_material),
            textures: &self.scene.textures,
            transform: &instance.transform,
            vertices,
        })
    }
}

impl SceneTriangle<'_> {
    /// Vertices in world space.
    pub fn world(&self) -> [Vec3; 3] {
        self.vertices.map(|vertex| self.transform.transform_point3(self.mesh.positions[vertex]))
    }

    /// Vertices in camera space.
    pub fn local(&self, projector: &Projector) -> [DVec3; 3] {
        self.world().map(|point| projector.point(point))
    }

    /// Whether the instance mirrors, which turns the winding around.
    pub fn is_mirrored(&self) -> bool {
        self.transform.matrix3.determinant() < 0.0
    }

    /// Unit normal of the front, or `None` for a triangle without area.
    pub fn geometric_normal(&self) -> Option<Vec3> {
        let [a, b, c] = self.world().map(Vec3::as_dvec3);
        let normal = (b - a).cross(c - a).try_normalize()?.as_vec3();
        Some(if self.is_mirrored() { -normal } else { normal })
    }

    /// Unit shading normal at barycentric coordinates: interpolated vertex normals, if the mesh has
    /// any and they lie on the side of `geometric`.
    pub fn shading_normal(&self, weights: [f32; 3], geometric: Vec3) -> Vec3 {
        let Some(normals) = interpolated(&self.mesh.normals, self.vertices, weights) else {
            return geometric;
        };
        // Normals go through the inverse transpose; the adjugate avoids dividing by a determinant
        // and its sign is that of the winding.
        let m = self.transform.matrix3;
        let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis].map(Vec3::from);
        let turned = y.cross(z) * normals.x + z.cross(x) * normals.y + x.cross(y) * normals.z;
        let turned = if self.is_mirrored() { -turned } else { turned };
        turned.try_normalize().filter(|normal| normal.dot(geometric) > 1e-3).unwrap_or(geometric)
    }

    /// Whether the surface has a hole at barycentric coordinates.
    pub fn is_hole(&self, weights: [f32; 3]) -> bool {
        let Some(cutoff) = self.material.alpha_cutoff else { return false };
        let texture = self.texture(self.material.base_color_texture);
        let uv = interpolated(&self.mesh.uvs, self.vertices, weights);
        let texel = texture.zip(uv).map_or(1.0, |(texture, uv)| texture.sample_alpha(uv));
        let vertex = interpolated(&self.mesh.alphas, self.vertices, weights).unwrap_or(1.0);
        texel * vertex < cutoff
    }

    /// Color and emission at barycentric coordinates, filtered over a micropolygon that is
    /// `fraction` as large as the triangle.
    pub fn color(&self, weights: [f32; 3], fraction: f32) -> SurfaceColor {
        let material = self.material;
        let uv = interpolated(&self.mesh.uvs, self.vertices, weights);
        let texel = |index: Option<u32>| match (self.texture(index), uv) {
            (Some(texture), Some(uv)) => {
                let texels = texture.width() as f32 * texture.height() as f32;
                let footprint = (self.uv_area() * fraction * texels).sqrt();
                let rgba = texture.sample_level(uv, footprint);
                [rgba[0], rgba[1], rgba[2]]
            }
            _ => [1.0; 3],
        };
        let vertex = interpolated(&self.mesh.colors, self.vertices, weights).unwrap_or([1.0; 3]);
        let base = texel(material.base_color_texture);
        let glow = texel(material.emission_texture);
        SurfaceColor {
            base_color: std::array::from_fn(|i| {
                (material.base_color[i] * base[i] * vertex[i]).clamp(0.0, 1.0)
            }),
            emission: std::array::from_fn(|i| (material.emission[i] * glow[i]).max(0.0)),
        }
    }

    fn texture(&self, index: Option<u32>) -> Option<&Texture> {
        self.textures.get(index? as usize)
    }

    /// Area of the triangle in texture coordinates.
    fn uv_area(&self) -> f32 {
        let [a, b, c] =
            self.vertices.map(|vertex| self.mesh.uvs.get(vertex).copied().unwrap_or(Vec2::ZERO));
        (b - a).perp_dot(c - a).abs() * 0.5
    }
}

/// What a mesh keeps per vertex and interpolates.
trait Attribute: Copy {
    fn blend(values: [Self; 3], weights: [f32; 3]) -> Self;
}

impl Attribute for Vec2 {
    fn blend([a, b, c]: [Self; 3], [u, v, w]: [f32; 3]) -> Self {
        a * u + b * v + c * w
    }
}

impl Attribute for Vec3 {
    fn blend([a, b, c]: [Self; 3], [u, v, w]: [f32; 3]) -> Self {
        a * u + b * v + c * w
    }
}

impl Attribute for f32 {
    fn blend([a, b, c]: [Self; 3], [u, v, w]: [f32; 3]) -> Self {
        a * u + b * v + c * w
    }
}

impl Attribute for [f32; 3] {
    fn blend([a, b, c]: [Self; 3], [u, v, w]: [f32; 3]) -> Self {
        std::array::from_fn(|i| a[i] * u + b[i] * v + c[i] * w)
    }
}

/// Interpolated attribute; `None` if the mesh lacks it.
fn interpolated<T: Attribute>(values: &[T], vertices: [usize; 3], weights: [f32; 3]) -> Option<T> {
    let [a, b, c] = vertices.map(|vertex| values.get(vertex).copied());
    Some(T::blend([a?, b?, c?], weights))
}
