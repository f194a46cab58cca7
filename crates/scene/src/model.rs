//! The scene in memory: meshes placed by instances, materials, textures, cameras, lights.

use crate::{PunctualLight, Texture};
use pbgi_math::{Aabb, Affine3A, DVec3, Vec2, Vec3};
use std::path::PathBuf;

/// A triangle mesh with one material.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Shading normals, empty or one per vertex.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, empty or one per vertex; (0, 0) is the top left texel corner, as in glTF.
    pub uvs: Vec<Vec2>,
    /// Linear vertex colors that multiply the base color, empty or one per vertex.
    pub colors: Vec<[f32; 3]>,
    /// Alpha of the vertices, which multiplies that of the base color, empty or one per vertex.
    pub alphas: Vec<f32>,
    /// Vertex indices, counterclockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`Scene::materials`].
    pub material: u32,
}

/// A mesh placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Index into [`Scene::meshes`].
    pub mesh: u32,
    /// From mesh to world. A mirroring transform flips the front side back, as glTF demands.
    pub transform: Affine3A,
}

impl Instance {
    /// Whether the transform mirrors: triangles that were counterclockwise become clockwise, and
    /// their front is where they now look clockwise from.
    #[must_use]
    pub fn flips(&self) -> bool {
        self.transform.matrix3.determinant() < 0.0
    }
}

/// A surface, as far as the gather needs it.
#[derive(Clone, Debug)]
pub struct Material {
    /// Name from the file, for messages.
    pub name: String,
    /// Linear color, multiplied by the texture: the diffuse albedo, or what a metal reflects.
    pub base_color: [f32; 3],
    /// Index into [`Scene::textures`].
    pub base_color_texture: Option<u32>,
    /// Emitted radiance, W·m⁻²·sr⁻¹, from the front (both sides of a double-sided material).
    pub emission: [f32; 3],
    /// Emission texture, multiplied by `emission`.
    pub emission_texture: Option<u32>,
    /// 0 metal-free, 1 metal: metals have no diffuse albedo.
    pub metallic: f32,
    /// Perceptual roughness, 0..=1.
    pub roughness: f32,
    /// Strength of the gloss where it is no metal, 0..=1: 0.08 of it is reflected at normal incidence.
    pub specular: f32,
    /// Base color alpha below this is a hole; `None` for an opaque material. The alpha is that of the
    /// base color texture, 1 without one, times that of the vertices.
    pub alpha_cutoff: Option<f32>,
    /// Lit and visible from both sides.
    pub double_sided: bool,
    /// Factor on the spacing when diced, above 0: larger than 1 for backdrops, which nothing comes near.
    pub spacing_factor: f32,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: [0.8; 3],
            base_color_texture: None,
            emission: [0.0; 3],
            emission_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            specular: 0.5,
            alpha_cutoff: None,
            double_sided: false,
            spacing_factor: 1.0,
        }
    }
}

/// A perspective pinhole camera, looking down its local −Z with +Y up.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Name from the file.
    pub name: String,
    /// From camera to world: a rigid transform.
    pub transform: Affine3A,
    /// Full vertical field of view in radians.
    pub yfov: f32,
}

impl Camera {
    /// Camera at `position` that looks at `target`, +`up` upward.
    #[must_use]
    pub fn look_at(position: Vec3, target: Vec3, up: Vec3, yfov: f32) -> Self {
        let back = (position - target).normalize();
        let side = up.cross(back);
        // Looking along `up` leaves the roll free; any choice is right.
        let side = if side.length_squared() > 1e-12 {
            side.normalize()
        } else {
            back.any_orthonormal_vector()
        };
        Self {
            name: String::new(),
            transform: Affine3A::from_mat3_translation(
                pbgi_math::Mat3::from_cols(side, back.cross(side), back),
                position,
            ),
            yfov,
        }
    }
}

/// Everything a scene file holds that the engine uses.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// World position of the origin of all coordinates.
    pub origin: DVec3,
    /// Meshes, shared by instances.
    pub meshes: Vec<Mesh>,
    /// Placements, in file order: the order of their surfels.
    pub instances: Vec<Instance>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Cameras, in world space.
    pub cameras: Vec<Camera>,
    /// Lights without extent, in file order.
    pub lights: Vec<PunctualLight>,
    /// What was left out or read differently than the file says, one sentence each.
    pub warnings: Vec<String>,
    /// Files it refers to that were read.
    pub files: Vec<PathBuf>,
}

impl Scene {
    /// Box of all triangles, relative to the origin: of the meshes' positions under their instances' transforms.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        let of_instance = |instance: &Instance| {
            let mesh = self.meshes.get(instance.mesh as usize)?;
            let used = mesh.triangles.iter().flatten();
            let points = used.filter_map(|&v| mesh.positions.get(v as usize));
            Some(Aabb::from_points(points.map(|&p| instance.transform.transform_point3(p))))
        };
        self.instances.iter().filter_map(of_instance).fold(Aabb::EMPTY, Aabb::union)
    }
}
