//! The engine beside an independent ray caster over the same triangles: error, time, and pictures of the difference.
//!
//! `cargo xtask truth`

use anyhow::{Context, Result, bail};
use clap::Parser;
use pbgi_benches::{Caster, Gathered, SkyImage, ThreadTimer, bake, dice, reflected_radiance};
use pbgi_image::{RgbImage, ToneMap, auto_exposure, compare, read_environment, write_png};
use pbgi_light::{Environment, EnvironmentOptions, SkyParameters, synthetic_sky};
use pbgi_math::{Affine3A, Vec3};
use pbgi_scene::{
    Camera, CameraView, Instance, Material, Mesh, Scene, procedural_scene, read_scene,
};
use pbgi_schedule::{GatherSettings, Gatherer, PreparedLight, Receiver, Shading};
use pbgi_store::Octree;
use std::path::{Path, PathBuf};

/// Errors of the engine against ray-cast truth, and how long rays take to be as right.
#[derive(Parser)]
struct Arguments {
    /// Folder with meshes and environments; cases without their data are left out.
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Surfels per scene.
    #[arg(long, default_value_t = 500_000)]
    surfels: u64,
    /// Columns of the picture whose first hits are the receivers; 9 rows to 16 columns.
    #[arg(long, default_value_t = 32)]
    width: u32,
    /// Paths per receiver of the truth.
    #[arg(long, default_value_t = 4096)]
    samples: u32,
    /// Where to write pictures: truth, engine, and their difference four times as bright, side by side.
    #[arg(long)]
    pictures: Option<PathBuf>,
    /// cornell, cornell3, sponza-overcast, sponza-sunny, apartment, bunny, street, foliage.
    #[arg(default_values_t = CASES.map(str::to_owned))]
    cases: Vec<String>,
}

const CASES: [&str; 8] = [
    "cornell",
    "cornell3",
    "sponza-overcast",
    "sponza-sunny",
    "apartment",
    "bunny",
    "street",
    "foliage",
];

/// Paths per receiver of the caster's curve of error against time.
const CURVE: [u32; 6] = [4, 16, 64, 256, 1024, 4096];

/// Seeds of the curve, apart from the truth's.
const CURVE_SEED: u32 = 0x5eed_0000;

/// Least time that is measured.
const SECONDS_MIN: f64 = 0.05;

/// A scene under its light.
struct Case {
    scene: Scene,
    camera: Camera,
    sky: Option<RgbImage>,
    bounces: u32,
}

impl Case {
    fn under(scene: Scene, camera: Camera, sky: RgbImage) -> Self {
        Self { scene, camera, sky: Some(sky), bounces: 0 }
    }
}

/// The case `name`, or none if its data are not there.
fn make_case(name: &str, data: &Path) -> Result<Option<Case>> {
    let demo = |spec: &str| -> Result<(Scene, Camera, Vec3)> {
        let made = procedural_scene(spec)?;
        let camera = made.scene.cameras[0].clone();
        Ok((made.scene, camera, made.sun_direction))
    };
    let mesh = |file: &str| -> Result<Option<Scene>> {
        let path = data.join(file);
        if path.is_file() { Ok(Some(read_scene(&path)?)) } else { Ok(None) }
    };
    let sky = |file: &str| read_environment(&data.join(file));
    Ok(match name {
        "cornell" | "cornell3" => {
            let (scene, camera, _) = demo("demo:cornell")?;
            Some(Case { scene, camera, sky: None, bounces: if name == "cornell" { 1 } else { 3 } })
        }
        "street" | "foliage" => {
            let (scene, camera, sun_direction) = demo(&format!("demo:{name}"))?;
            let parameters = SkyParameters { sun_direction, ..SkyParameters::default() };
            Some(Case::under(scene, camera, synthetic_sky(2048, 1024, &parameters)))
        }
        "sponza-overcast" | "sponza-sunny" => {
            let Some(scene) = mesh("sponza_crytek.glb")? else { return Ok(None) };
            let (from, to) = (Vec3::new(-12.0, 2.5, -0.5), Vec3::new(5.0, 3.0, -0.5));
            let camera = Camera::look_at(from, to, Vec3::Y, 65f32.to_radians());
            let overcast = name == "sponza-overcast";
            let file = if overcast { "potsdamer_platz_1k.hdr" } else { "kloppenheim_05_1k.hdr" };
            Some(Case::under(scene, camera, sky(file)?))
        }
        "apartment" => {
            let Some(scene) = mesh("dream_apartment.glb")? else { return Ok(None) };
            let camera = Camera::framing(&scene.bounds(), Vec3::Y, 16.0 / 9.0, 0.7);
            Some(Case::under(scene, camera, sky("kloppenheim_05_1k.hdr")?))
        }
        "bunny" => {
            let Some(scene) = mesh("stanford_bunny.ply")? else { return Ok(None) };
            let (scene, camera) = put_on_plane(scene);
            Some(Case::under(scene, camera, sky("potsdamer_platz_1k.hdr")?))
        }
        _ => bail!("there is no case {name}; see --help"),
    })
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

/// Receivers on what pixels' middles show first, and their pixels.
fn receivers(caster: &Caster, view: &CameraView) -> Vec<(usize, Receiver)> {
    let pixel = |index: u32| {
        let (column, row) = (index % view.width, index / view.width);
        let (eye, direction) = view.ray(column as f32 + 0.5, row as f32 + 0.5);
        let hit = caster.cast(eye, direction).filter(|hit| hit.is_front)?;
        Some((index as usize, Receiver::diffuse(eye + direction * hit.distance, hit.normal)))
    };
    (0..view.width * view.height).filter_map(pixel).collect()
}

/// The caster's results with the microseconds per receiver.
fn cast_all(
    caster: &Caster,
    places: &[(usize, Receiver)],
    bounces: u32,
    samples: u32,
    seed: u32,
) -> (Vec<Gathered>, f64) {
    let one = |(pixel, r): &(usize, Receiver)| {
        caster.gather(r.position, r.normal, bounces, samples, seed ^ *pixel as u32)
    };
    let (timer, mut rounds) = (ThreadTimer::start(), 0.0);
    loop {
        let found: Vec<Gathered> = places.iter().map(one).collect();
        rounds += 1.0;
        // The system counts in steps of milliseconds.
        let seconds = timer.seconds();
        if seconds >= SECONDS_MIN || places.is_empty() {
            return (found, seconds * 1e6 / (rounds * places.len().max(1) as f64));
        }
    }
}

/// What is compared.
struct Quantity {
    name: &'static str,
    of_truth: fn(&Gathered) -> [f32; 3],
    of_engine: fn(&Shading) -> [f32; 3],
}

const OPENNESS: Quantity = Quantity {
    name: "occlusion",
    of_truth: |g| [g.openness as f32; 3],
    of_engine: |s| [s.ambient_occlusion; 3],
};
const IRRADIANCE: Quantity = Quantity {
    name: "irradiance",
    of_truth: |g| g.irradiance_from(0),
    of_engine: Shading::irradiance,
};

struct Comparison<'a> {
    case: &'a str,
    quantity: Quantity,
    truth: Vec<[f32; 3]>,
    found: Vec<[f32; 3]>,
    engine_us: f64,
    /// Errors and microseconds of the caster, from few to many paths.
    curve: Vec<(f64, f64)>,
}

impl Comparison<'_> {
    fn print(&self) -> Result<()> {
        let error = compare(self.found.as_flattened(), self.truth.as_flattened())?;
        let times = [error.rrmse, 0.1, 0.05, 0.02].map(|e| self.caster_us(e));
        let factor = |at: Option<f64>| {
            at.map_or("      -".to_owned(), |us| format!("{:7.2}", us / self.engine_us))
        };
        println!(
            "{:16} {:10} {:7.2} % {:+7.2} % {:7.1} % {:7.1} % {:9.0} {} {:>9} {:>9} {:>9}",
            self.case,
            self.quantity.name,
            error.rrmse * 100.0,
            error.bias * 100.0,
            error.p95 * 100.0,
            error.p99 * 100.0,
            self.engine_us,
            factor(times[0]),
            microseconds(times[1]),
            microseconds(times[2]),
            microseconds(times[3]),
        );
        Ok(())
    }

    /// Microseconds of the caster at an error, between the counts of paths around it; beyond the ends by the square root law.
    fn caster_us(&self, error: f64) -> Option<f64> {
        let by_root = |(e, us): (f64, f64)| us * (e / error).powi(2);
        let at = self.curve.iter().position(|&(e, _)| e <= error);
        match at {
            None => self.curve.last().copied().map(by_root),
            Some(0) => self.curve.first().copied().map(by_root),
            Some(i) => {
                let ((e0, us0), (e1, us1)) = (self.curve[i - 1], self.curve[i]);
                let share = (e0 / error).ln() / (e0 / e1).ln();
                Some(us0 * (us1 / us0).powf(share))
            }
        }
    }
}

fn microseconds(us: Option<f64>) -> String {
    us.map_or("-".to_owned(), |us| format!("{us:.0}"))
}

/// Bakes a scene with light that bounces among its surfels.
fn bake_case(case: &Case, surfels: u64, path: &Path) -> Result<Octree> {
    let surfels = dice(&case.scene, surfels)?;
    let mut octree = bake(&surfels, path)?;
    let (mut lit, settings) = (surfels.clone(), GatherSettings::default());
    for _ in 0..case.bounces {
        let reflected = reflected_radiance(&octree, None, &lit, &settings)?;
        let sum = surfels.iter().zip(&reflected).map(|(own, reflected)| {
            own.with_radiance(std::array::from_fn(|c| own.radiance[c] + reflected[c]))
        });
        lit = sum.collect();
        octree = bake(&lit, path)?;
    }
    Ok(octree)
}

fn run(name: &str, case: &Case, arguments: &Arguments, folder: &Path) -> Result<()> {
    let octree = bake_case(case, arguments.surfels, &folder.join("scene.pbgi"))?;
    let environment = case
        .sky
        .clone()
        .map(|image| Environment::from_image(image, EnvironmentOptions::default()))
        .transpose()?;
    let settings = GatherSettings::default();
    let light = environment.as_ref().map(|e| PreparedLight::new(e, settings.raster_edge));
    let sky = case.sky.clone().map(SkyImage::new);
    let caster = Caster::new(&case.scene, sky.as_ref());
    let (width, height) = (arguments.width, (arguments.width * 9).div_ceil(16));
    let view = CameraView { camera: case.camera.clone(), width, height };
    let places = receivers(&caster, &view);
    let mut gatherer = Gatherer::new(octree.reader(), &settings, light.as_ref());
    // The first receiver pays for pages and tables.
    places.first().map(|(_, receiver)| gatherer.gather(receiver)).transpose()?;
    let timer = ThreadTimer::start();
    let shadings: Result<Vec<Shading>, _> =
        places.iter().map(|(_, r)| gatherer.gather(r)).collect();
    let (shadings, engine_us) = (shadings?, timer.seconds() * 1e6 / places.len().max(1) as f64);
    let (truth, _) = cast_all(&caster, &places, case.bounces, arguments.samples, 0);
    let counts = CURVE.into_iter().filter(|&count| count <= arguments.samples / 4);
    let estimates: Vec<_> =
        counts.map(|n| cast_all(&caster, &places, case.bounces, n, CURVE_SEED ^ n)).collect();
    let quantities = if case.sky.is_some() { vec![OPENNESS, IRRADIANCE] } else { vec![IRRADIANCE] };
    for quantity in quantities {
        let expected: Vec<[f32; 3]> = truth.iter().map(quantity.of_truth).collect();
        let curve: Result<Vec<(f64, f64)>> = estimates
            .iter()
            .map(|(found, us)| {
                let found: Vec<[f32; 3]> = found.iter().map(quantity.of_truth).collect();
                Ok((compare(found.as_flattened(), expected.as_flattened())?.rrmse, *us))
            })
            .collect();
        let found = shadings.iter().map(quantity.of_engine).collect();
        let comparison =
            Comparison { case: name, quantity, truth: expected, found, engine_us, curve: curve? };
        comparison.print()?;
        if let Some(folder) = &arguments.pictures {
            write_picture(folder, &comparison, &places, [width as usize, height as usize])?;
        }
    }
    Ok(())
}

/// Brightness of a difference in a picture.
const DIFFERENCE_GAIN: f32 = 4.0;

/// Truth, engine and absolute difference side by side.
fn write_picture(
    folder: &Path,
    comparison: &Comparison,
    places: &[(usize, Receiver)],
    [width, height]: [usize; 2],
) -> Result<()> {
    let exposure = auto_exposure(&comparison.truth, None);
    let mut pixels = vec![[0f32; 3]; 3 * width * height];
    for (i, (pixel, _)) in places.iter().enumerate() {
        let (row, column) = (pixel / width, pixel % width);
        let (truth, found) = (comparison.truth[i], comparison.found[i]);
        let difference = std::array::from_fn(|c| DIFFERENCE_GAIN * (found[c] - truth[c]).abs());
        for (panel, color) in [truth, found, difference].into_iter().enumerate() {
            pixels[(3 * row + panel) * width + column] = color;
        }
    }
    let path = folder.join(format!("{}-{}.png", comparison.case, comparison.quantity.name));
    let tone = ToneMap { exposure, filmic: true };
    Ok(write_png(&path, 3 * width, height, &pixels, tone)?)
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let folder = tempfile::tempdir()?;
    if let Some(pictures) = &arguments.pictures {
        std::fs::create_dir_all(pictures).with_context(|| pictures.display().to_string())?;
    }
    println!(
        "core-us per receiver; rays: times as long for the same error; then core-us of rays at 10, 5, 2 %\n\
         {:16} {:10} {:>9} {:>9} {:>9} {:>9} {:>9} {:>7} {:>9} {:>9} {:>9}",
        "scene", "quantity", "rRMSE", "bias", "p95", "p99", "us", "rays", "10 %", "5 %", "2 %"
    );
    for name in &arguments.cases {
        match make_case(name, &arguments.data).with_context(|| format!("case {name}"))? {
            Some(case) => run(name, &case, &arguments, folder.path())?,
            None => println!("{name}: skipped, no data in {}", arguments.data.display()),
        }
    }
    Ok(())
}
