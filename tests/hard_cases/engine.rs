//! The engine under judgment: the facade, and the gatherer alone where receivers reflect glossily.

use pbgi::{
    BakeRequest, EnvironmentSpec, LightSource, PbgiError, Positions, Progress, ReceiversRequest,
    ShadeSettings, Shading, bake, shade_receivers,
};
use pbgi_cloud::{RawKind, RawWriter};
use pbgi_gather::{GatherSettings, Gatherer, Gloss, Material, PreparedLight, Receiver};
use pbgi_image::{RgbImage, write_environment_exr};
use pbgi_store::{Octree, OpenOptions};
use pbgi_testkit::hard::{CaseCloud, CaseScene, CaseSky, Engine, Found, Refusal};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// The engine, as programs use it.
pub struct Pbgi;

impl Engine for Pbgi {
    fn shade(&mut self, scene: &CaseScene) -> Result<Vec<Found>, Refusal> {
        let folder = tempfile::tempdir().expect("a folder for temporary files");
        let octree = bake_cloud(&scene.cloud, folder.path())?;
        let shadings = if scene.receivers.iter().any(|r| r.gloss.is_some()) {
            shade_glossy(scene, &octree, folder.path())?
        } else {
            shade_diffuse(scene, &octree, folder.path())?
        };
        Ok(shadings.iter().map(found_of).collect())
    }
}

fn found_of(shading: &Shading) -> Found {
    Found {
        surfaces: shading.surface_irradiance[1].into(),
        sky: shading.environment_irradiance[1].into(),
        open: shading.ambient_occlusion.into(),
        reflected: shading.reflected[1].into(),
    }
}

fn refusal(error: &PbgiError) -> Refusal {
    Refusal { exit_code: error.exit_code().into(), message: error.to_string() }
}

/// Bakes a cloud as the program does.
fn bake_cloud(cloud: &CaseCloud, folder: &Path) -> Result<PathBuf, Refusal> {
    let input = match cloud {
        CaseCloud::Ply(text) => {
            let path = folder.join("cloud.ply");
            std::fs::write(&path, text).expect("the folder can be written");
            path
        }
        CaseCloud::Surfels { origin, surfels } => {
            let path = folder.join("cloud.surfels");
            let file = std::fs::File::create(&path).expect("the folder can be written");
            let file = std::io::BufWriter::new(file);
            let count = Some(surfels.len() as u64);
            let mut writer = RawWriter::new(file, &path, RawKind::Full, *origin, count)
                .expect("the folder can be written");
            writer.write(surfels).expect("the disk has room");
            writer.finish().expect("as many surfels as there are");
            path
        }
    };
    let request = BakeRequest {
        inputs: vec![input.to_string_lossy().into_owned()],
        output: folder.join("scene.pbgi"),
        threads: 1,
        ..BakeRequest::default()
    };
    bake(&request, &Progress::silent(), &AtomicBool::new(false)).map_err(|e| refusal(&e))?;
    Ok(request.output)
}

/// The sky as the facade takes it.
fn environment(sky: &CaseSky, folder: &Path) -> Option<EnvironmentSpec> {
    let source = match sky {
        CaseSky::Black => return None,
        CaseSky::Uniform(radiance) => LightSource::Uniform([*radiance; 3]),
        CaseSky::Image { width, texels } => {
            let pixels = texels.iter().map(|texel| [*texel; 3]).collect();
            let image = RgbImage { width: *width, height: texels.len() / width, pixels };
            let path = folder.join("sky.exr");
            write_environment_exr(&path, &image, &[]).expect("the folder can be written");
            LightSource::File(path)
        }
    };
    Some(EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 })
}

fn shade_diffuse(scene: &CaseScene, octree: &Path, folder: &Path) -> Result<Vec<Shading>, Refusal> {
    let positions: Vec<[f64; 3]> = scene.receivers.iter().map(|r| r.position.to_array()).collect();
    let normals: Vec<[f32; 3]> = scene.receivers.iter().map(|r| r.normal.to_array()).collect();
    let settings =
        ShadeSettings { environment: environment(&scene.sky, folder), ..ShadeSettings::default() };
    let solid_angle_sr = scene.solid_angle_sr.unwrap_or(settings.solid_angle_sr);
    let request = ReceiversRequest {
        octree,
        positions: Positions::F64(&positions),
        normals: &normals,
        skip_empty: false,
        eye: None,
        settings: ShadeSettings { solid_angle_sr, ..settings },
    };
    let mut shadings = vec![Shading::default(); positions.len()];
    let take = |index: usize, shading: &Shading| shadings[index] = *shading;
    shade_receivers(&request, take, &Progress::silent(), &AtomicBool::new(false))
        .map_err(|e| refusal(&e))?;
    Ok(shadings)
}

/// Each receiver with a material and an eye of its own, which the facade takes from pictures only.
fn shade_glossy(scene: &CaseScene, octree: &Path, folder: &Path) -> Result<Vec<Shading>, Refusal> {
    let octree = Octree::open(octree, &OpenOptions::default()).expect("what was just baked opens");
    let settings = GatherSettings::default();
    let loaded = environment(&scene.sky, folder)
        .map(|spec| spec.load(false, 1 << 30).map_err(|e| refusal(&e)))
        .transpose()?;
    let light = loaded
        .as_ref()
        .map(|l| PreparedLight::for_reflections(&l.environment, settings.raster_edge));
    let mut gatherer = Gatherer::new(octree.reader(), &settings, light.as_ref());
    let origin = octree.header().origin;
    let gathered = scene.receivers.iter().map(|receiver| {
        let gloss = receiver.gloss.map(|gloss| Gloss {
            material: Material {
                base_color: [gloss.color; 3],
                metalness: 1.0,
                roughness: gloss.roughness,
                ..Material::default()
            },
            toward_eye: gloss.toward_eye,
        });
        let position = (receiver.position - origin).as_vec3();
        let receiver = Receiver { gloss, ..Receiver::diffuse(position, receiver.normal) };
        gatherer.gather(&receiver).expect("what was just baked is sound")
    });
    Ok(gathered.collect())
}
