//! Scenes under their light, and what of them is compared.

use anyhow::{Result, bail};
use pbgi_benches::Caster;
use pbgi_gather::{Gloss, Receiver};
use pbgi_image::{RgbImage, read_environment};
use pbgi_light::{SkyParameters, synthetic_sky};
use pbgi_math::{Affine3A, Vec3};
use pbgi_mesh::read_scene;
use pbgi_procedural::procedural_scene;
use pbgi_scene::{Camera, CameraView, Instance, Material, Mesh, Scene};
use std::path::PathBuf;

/// All cases, in the order of the tables.
pub const CASES: [&str; 14] = [
    "cornell",
    "cornell3",
    "sponza-overcast",
    "sponza-sunny",
    "sponza1",
    "apartment",
    "bunny",
    "street",
    "street1",
    "foliage",
    "fire",
    "fire30",
    "fire10",
    "scan",
];

/// Cases that have no picture: others show nearly the same.
pub const WITHOUT_PICTURE: [&str; 5] = ["cornell", "sponza1", "street1", "fire", "fire30"];

/// Cases of which, beside a whole picture, all surfels are shaded.
pub const WITH_SURFELS: [&str; 2] = ["street", "fire"];

/// How many times fewer surfels the box has than other scenes: it is small and smooth.
const BOX_SHARE: u64 = 10;

/// The material of the fire's scene that reflects.
const WET_GROUND: &str = "wet_ground";

/// Where the data are.
pub struct Folders {
    /// Meshes and environments.
    pub data: PathBuf,
    /// Scenes with converged references.
    pub reference: PathBuf,
}

/// A scene under its light.
pub struct Case {
    /// What it is called.
    pub name: String,
    /// What a caption says of it.
    pub title: &'static str,
    pub scene: Scene,
    pub camera: Camera,
    pub sky: Option<RgbImage>,
    /// Times that light bounces.
    pub bounces: u32,
    /// Width α of the slopes of the ground, where its reflections are what is compared.
    pub gloss: Option<f32>,
}

/// What a receiver gets, by rays or by the engine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Light {
    /// Cosine-weighted share of the hemisphere that is open.
    pub openness: f32,
    /// W·m⁻².
    pub irradiance: [f32; 3],
    /// Radiance reflected toward the eye, W·m⁻²·sr⁻¹.
    pub reflected: [f32; 3],
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    Occlusion,
    Irradiance,
    Reflection,
}

impl Quantity {
    pub fn name(self) -> &'static str {
        match self {
            Self::Occlusion => "occlusion",
            Self::Irradiance => "irradiance",
            Self::Reflection => "reflection",
        }
    }

    /// The values of receivers, channel by channel.
    pub fn values(self, light: &[Light]) -> Vec<f32> {
        light.iter().flat_map(|l| self.of(l)).collect()
    }

    pub fn of(self, light: &Light) -> [f32; 3] {
        match self {
            Self::Occlusion => [light.openness; 3],
            Self::Irradiance => light.irradiance,
            Self::Reflection => light.reflected,
        }
    }
}

impl Case {
    pub fn new(name: &str, title: &'static str, scene: Scene, camera: Camera) -> Self {
        let name = name.to_owned();
        Self { name, title, scene, camera, sky: None, bounces: 0, gloss: None }
    }

    fn under(self, sky: RgbImage) -> Self {
        Self { sky: Some(sky), ..self }
    }

    /// What is compared; the last one is what pictures show.
    pub fn quantities(&self) -> &'static [Quantity] {
        match (self.gloss, &self.sky) {
            (Some(_), _) => &[Quantity::Reflection],
            (None, Some(_)) => &[Quantity::Occlusion, Quantity::Irradiance],
            (None, None) => &[Quantity::Irradiance],
        }
    }

    /// Surfels where most cases have `surfels`.
    pub fn surfels(&self, surfels: u64) -> u64 {
        if self.bounces > 0 && self.sky.is_none() { surfels / BOX_SHARE } else { surfels }
    }

    pub fn view(&self, width: u32) -> CameraView {
        CameraView { camera: self.camera.clone(), width, height: (width * 9).div_ceil(16) }
    }

    /// The receiver on what a pixel's middle shows first, if it is to be compared.
    fn receiver(&self, caster: &Caster, eye: Vec3, direction: Vec3) -> Option<Receiver> {
        let hit = caster.cast(eye, direction).filter(|hit| hit.is_front)?;
        let position = eye + direction * hit.distance;
        let plain = Receiver::diffuse(position, hit.normal);
        let Some(alpha) = self.gloss else { return Some(plain) };
        // Without a Fresnel term, as the caster reflects.
        let material = pbgi_gather::Material {
            base_color: [1.0; 3],
            metalness: 1.0,
            roughness: alpha.sqrt(),
            ..pbgi_gather::Material::default()
        };
        let gloss = Some(Gloss { material, toward_eye: -direction });
        (caster.material_of(&hit).name == WET_GROUND).then_some(Receiver { gloss, ..plain })
    }

    /// Receivers with the indices of their pixels.
    pub fn receivers(&self, caster: &Caster, view: &CameraView) -> Vec<(usize, Receiver)> {
        let pixel = |index: u32| {
            let (column, row) = (index % view.width, index / view.width);
            let (eye, direction) = view.ray(column as f32 + 0.5, row as f32 + 0.5);
            Some((index as usize, self.receiver(caster, eye, direction)?))
        };
        (0..view.width * view.height).filter_map(pixel).collect()
    }
}

/// The case `name`, or none if its data are not there.
///
/// # Errors
///
/// If there is no such case, or a file cannot be read.
pub fn make_case(name: &str, folders: &Folders) -> Result<Option<Case>> {
    let mesh = |file: &str| -> Result<Option<Scene>> {
        let path = folders.data.join(file);
        if path.is_file() { Ok(Some(read_scene(&path)?)) } else { Ok(None) }
    };
    let sky = |file: &str| read_environment(&folders.data.join(file));
    Ok(match name {
        "cornell" | "cornell3" => {
            let made = procedural_scene("demo:cornell")?;
            let camera = made.scene.cameras[0].clone();
            let (bounces, title) = match name {
                "cornell" => (1, "Cornell box, one bounce"),
                _ => (3, "Cornell box, three bounces"),
            };
            Some(Case { bounces, ..Case::new(name, title, made.scene, camera) })
        }
        "street" | "street1" | "foliage" => {
            let made = procedural_scene(&format!("demo:{}", name.trim_end_matches('1')))?;
            let camera = made.scene.cameras[0].clone();
            let sun_direction = made.sun_direction;
            let parameters = SkyParameters { sun_direction, ..SkyParameters::default() };
            let (bounces, title) = match name {
                "street" => (0, "Street with a sun"),
                "street1" => (1, "Street with a sun, one bounce"),
                _ => (0, "Foliage with a sun"),
            };
            let case = Case { bounces, ..Case::new(name, title, made.scene, camera) };
            Some(case.under(synthetic_sky(2048, 1024, &parameters)))
        }
        "sponza-overcast" | "sponza-sunny" | "sponza1" => {
            let Some(scene) = mesh("sponza_crytek.glb")? else { return Ok(None) };
            let (from, to) = (Vec3::new(-12.0, 2.5, -0.5), Vec3::new(5.0, 3.0, -0.5));
            let camera = Camera::look_at(from, to, Vec3::Y, 65f32.to_radians());
            let (bounces, title, file) = match name {
                "sponza-overcast" => (0, "Sponza, overcast", "potsdamer_platz_1k.hdr"),
                "sponza-sunny" => (0, "Sponza with a sun", "kloppenheim_05_1k.hdr"),
                _ => (1, "Sponza with a sun, one bounce", "kloppenheim_05_1k.hdr"),
            };
            let case = Case { bounces, ..Case::new(name, title, scene, camera) };
            Some(case.under(sky(file)?))
        }
        "apartment" => {
            let Some(scene) = mesh("dream_apartment.glb")? else { return Ok(None) };
            let camera = Camera::framing(&scene.bounds(), Vec3::Y, 16.0 / 9.0, 0.7);
            let case = Case::new(name, "Apartment", scene, camera);
            Some(case.under(sky("kloppenheim_05_1k.hdr")?))
        }
        "bunny" => {
            let Some(scene) = mesh("stanford_bunny.ply")? else { return Ok(None) };
            let (scene, camera) = put_on_plane(scene);
            let case = Case::new(name, "Bunny on a plane", scene, camera);
            Some(case.under(sky("potsdamer_platz_1k.hdr")?))
        }
        "fire" | "fire30" | "fire10" => fire(name, folders)?,
        _ => bail!("there is no case {name}; see --help"),
    })
}

/// Thousands of glowing particles over ground that reflects them.
fn fire(name: &str, folders: &Folders) -> Result<Option<Case>> {
    let path = folders.reference.join("embers.glb");
    if !path.is_file() {
        return Ok(None);
    }
    let scene = read_scene(&path)?;
    let Some(camera) = scene.cameras.first().cloned() else {
        bail!("{} has no camera, expected one", path.display())
    };
    let (gloss, title) = match name {
        "fire" => (None, "Fire"),
        "fire30" => (Some(0.3), "Fire over glossy ground, α = 0.3"),
        _ => (Some(0.1), "Fire over glossy ground, α = 0.1"),
    };
    Ok(Some(Case { gloss, ..Case::new(name, title, scene, camera) }))
}

/// Adds a plane six times as wide below a scene.
fn put_on_plane(mut scene: Scene) -> (Scene, Camera) {
    let bounds = scene.bounds();
    let camera = Camera::framing(&bounds, Vec3::Y, 16.0 / 9.0, 0.6);
    let (center, half) = (bounds.center(), 3.0 * bounds.extent().max_element());
    let corner = |x: f32, z: f32| Vec3::new(center.x + x * half, bounds.min.y, center.z + z * half);
    let plane = Mesh {
        positions: vec![corner(-1., -1.), corner(-1., 1.), corner(1., 1.), corner(1., -1.)],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material: scene.materials.len() as u32,
        ..Mesh::default()
    };
    let mesh = scene.meshes.len() as u32;
    scene.materials.push(Material { name: "plane".into(), ..Material::default() });
    scene.meshes.push(plane);
    scene.instances.push(Instance { mesh, transform: Affine3A::IDENTITY });
    (scene, camera)
}
