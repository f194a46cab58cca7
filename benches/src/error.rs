//! Cut error against time: importance off, each term alone, all terms.
//!
//! `cargo run --release -p pbgi-benches --bin error -- --data ../shared/data --json error.json --svg error.svg`

use anyhow::{Context, Result, bail};
use clap::Parser;
use pbgi_benches::{ThreadTimer, bake, dice};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{
    GatherParts, GatherSettings, Gatherer, Gloss, ImportanceTerms, Material, PreparedLight,
    Receiver, Shading,
};
use pbgi_image::{RgbImage, compare, read_environment};
use pbgi_light::{Environment, EnvironmentOptions, SkyParameters, synthetic_sky};
use pbgi_math::Vec3;
use pbgi_mesh::read_scene;
use pbgi_procedural::procedural_scene;
use pbgi_scene::{Camera, CameraView, HideOptions, Scene, hide};
use pbgi_store::Octree;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Curves of cut error against time per receiver and cut size, and the times at equal error.
#[derive(Parser)]
struct Arguments {
    /// Folder with sponza_crytek.glb and environments; without it, sponza is left out.
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Surfels per scene.
    #[arg(long, default_value_t = 1_000_000)]
    surfels: u64,
    /// Receivers per scene.
    #[arg(long, default_value_t = 100)]
    receivers: usize,
    /// Print the key ratios only.
    #[arg(long)]
    brief: bool,
    /// Curves besides `off` and `all`: terms of importance, alone.
    #[arg(long, value_delimiter = ' ', default_value = "env lobe cosine radiance quality")]
    terms: Vec<ImportanceTerms>,
    /// Also measure how smoothly results change while environment and receivers move.
    #[arg(long)]
    motion: bool,
    /// Where to write the curves as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Where to draw them.
    #[arg(long)]
    svg: Option<PathBuf>,
    /// Cases: street, fire30, fire10, fire05, sponza-overcast, sponza-sunny, foliage.
    #[arg(default_values_t = ["street", "fire30", "fire10", "fire05", "sponza-overcast", "sponza-sunny", "foliage"].map(str::to_owned))]
    cases: Vec<String>,
}

/// What of a shading is compared.
#[derive(Clone, Copy)]
enum Quantity {
    Irradiance,
    Reflected,
    Occlusion,
}

impl Quantity {
    fn values(self, shadings: &[Shading]) -> Vec<f32> {
        match self {
            Self::Irradiance => shadings.iter().flat_map(Shading::irradiance).collect(),
            Self::Reflected => shadings.iter().flat_map(|s| s.reflected).collect(),
            Self::Occlusion => shadings.iter().map(|s| s.ambient_occlusion).collect(),
        }
    }
}

/// A scene with light and receivers.
struct Case {
    octree: Octree,
    sky: Option<RgbImage>,
    receivers: Vec<Receiver>,
    quantity: Quantity,
    parts: GatherParts,
}

/// One setting.
#[derive(Clone, Copy, Debug, Serialize)]
struct Point {
    solid_angle_sr: f32,
    microseconds: f64,
    cut: f64,
    error: f64,
    bias: f64,
}

/// Settings from coarse to fine.
#[derive(Clone, Debug, Serialize)]
struct Curve {
    case: String,
    importance: String,
    points: Vec<Point>,
}

/// How a curve is gathered.
struct Way {
    label: String,
    importance: ImportanceTerms,
    raster_edge: usize,
    /// Whether peaks of the environment have windows of their own.
    windows: bool,
}

impl Way {
    fn of(importance: ImportanceTerms) -> Self {
        let raster_edge = GatherSettings::default().raster_edge;
        Self { label: importance.to_string(), importance, raster_edge, windows: true }
    }

    /// A uniform threshold and a uniform raster, as fine as there is one: no windows for the sun.
    fn uniform() -> Self {
        let label = format!("off, one raster of {RASTER_EDGE_MAX}");
        let importance = ImportanceTerms::OFF;
        Self { label, importance, raster_edge: RASTER_EDGE_MAX, windows: false }
    }
}

/// Texels along a face of the finest raster.
const RASTER_EDGE_MAX: usize = 64;

/// Solid angles, from coarse to fine: from so coarse that what is a hundred times as bright as usual may be taken whole.
fn widths() -> impl Iterator<Item = f32> {
    (0..38).map(|step| 290.0 * 0.5f32.powf(0.7 * step as f32))
}

/// Least time that is measured.
const SECONDS_MIN: f64 = 0.15;

/// A curve ends below this error.
const ERROR_MIN: f64 = 0.004;

/// A curve ends where it takes this share of the exhaustive gather's time.
const SLOW_SHARE: f64 = 0.8;

/// Receivers for which a finer raster is tried: every so many.
const FINER_EVERY: usize = 4;

impl Case {
    fn settings(&self) -> GatherSettings {
        GatherSettings { parts: self.parts, ..GatherSettings::default() }
    }

    /// The environment turned about the vertical.
    fn light(
        &self,
        rotate_degrees: f32,
        windows: bool,
        raster_edge: usize,
    ) -> Result<Option<PreparedLight>> {
        let Some(image) = &self.sky else { return Ok(None) };
        let options =
            EnvironmentOptions { rotate_degrees, peaks: windows, ..EnvironmentOptions::default() };
        let environment = Environment::from_image(image.clone(), options)?;
        Ok(Some(PreparedLight::for_reflections(&environment, raster_edge)))
    }

    /// Shadings with the microseconds and entries of the cut per receiver; the light fits the settings' raster.
    fn gather(
        &self,
        receivers: &[Receiver],
        settings: &GatherSettings,
        light: Option<&PreparedLight>,
    ) -> Result<(Vec<Shading>, f64, f64)> {
        let mut gatherer = Gatherer::new(self.octree.reader(), settings, light);
        // The first receiver pays for pages and tables.
        gatherer.gather(&receivers[0])?;
        let (before, timer) = (gatherer.stats().cut_size(), ThreadTimer::start());
        let mut count = 0.0;
        loop {
            let shadings: Result<Vec<Shading>, _> =
                receivers.iter().map(|r| gatherer.gather(r)).collect();
            let shadings = shadings?;
            count += receivers.len() as f64;
            // The system counts in steps of milliseconds.
            let seconds = timer.seconds();
            if seconds >= SECONDS_MIN {
                let cut = (gatherer.stats().cut_size() - before) as f64 / count;
                return Ok((shadings, seconds * 1e6 / count, cut));
            }
        }
    }

    fn curve(&self, name: &str, way: &Way, truth: &[f32], slow: f64) -> Result<Curve> {
        let &Way { importance, raster_edge, windows, .. } = way;
        let light = self.light(0.0, windows, raster_edge)?;
        let mut points = Vec::new();
        for solid_angle_sr in widths() {
            let settings =
                GatherSettings { solid_angle_sr, importance, raster_edge, ..self.settings() };
            let (shadings, microseconds, cut) =
                self.gather(&self.receivers, &settings, light.as_ref())?;
            let error = compare(&self.quantity.values(&shadings), truth)?;
            points.push(Point {
                solid_angle_sr,
                microseconds,
                cut,
                error: error.rrmse,
                bias: error.bias,
            });
            if error.rrmse < ERROR_MIN || microseconds > SLOW_SHARE * slow {
                break;
            }
        }
        Ok(Curve { case: name.to_owned(), importance: way.label.clone(), points })
    }

    /// What is compared, for every few receivers on their way, frame by frame.
    fn frames(&self, settings: &GatherSettings) -> Result<Vec<Vec<f32>>> {
        let frame = |step: usize| -> Result<Vec<f32>> {
            let degrees = step as f32 * DEGREES_PER_FRAME;
            let light = self.light(degrees, true, settings.raster_edge)?;
            let mut gatherer = Gatherer::new(self.octree.reader(), settings, light.as_ref());
            let moved = self.receivers.iter().step_by(MOVING_EVERY).map(|receiver| {
                let slide = receiver.normal.any_orthonormal_vector();
                let position = receiver.position + slide * (step as f32 * METERS_PER_FRAME);
                Ok(gatherer.gather(&Receiver { position, ..*receiver })?)
            });
            Ok(self.quantity.values(&moved.collect::<Result<Vec<Shading>>>()?))
        };
        (0..FRAMES).map(frame).collect()
    }

    /// Prints by how much frames differ from the mean of those before and after them, beside the error of the cut.
    fn print_motion(&self, name: &str) -> Result<()> {
        let exhaustive = GatherSettings { solid_angle_sr: 0.0, ..self.settings() };
        let (truth, found) = (self.frames(&exhaustive)?, self.frames(&self.settings())?);
        let error = compare(&found.concat(), &truth.concat())?.rrmse;
        let truth_sum: f64 = truth.iter().flatten().map(|x| f64::from(*x)).sum();
        let mean = truth_sum / truth.iter().map(Vec::len).sum::<usize>() as f64;
        for (label, frames) in [("every surfel", &truth), ("the cut", &found)] {
            let bends = frames.windows(3).flat_map(|f| {
                let bend = |i: usize| f64::from(0.5 * (f[0][i] + f[2][i]) - f[1][i]).abs() / mean;
                (0..f[1].len()).map(bend).collect::<Vec<f64>>()
            });
            let (mut count, mut squares, mut largest) = (0.0, 0.0, 0f64);
            for bend in bends {
                (count, squares, largest) = (count + 1.0, squares + bend * bend, largest.max(bend));
            }
            println!(
                "{name}: {FRAMES} frames of {label}: off the mean of their neighbors by {:.2} % rms, {:.2} % at most",
                100.0 * f64::sqrt(squares / count),
                100.0 * largest
            );
        }
        println!("{name}: error of the cut in motion {:.2} %", 100.0 * error);
        Ok(())
    }
}

/// Frames of a motion.
const FRAMES: usize = 20;

/// Turn of the environment between frames.
const DEGREES_PER_FRAME: f32 = 0.2;

/// Slide of the receivers between frames.
const METERS_PER_FRAME: f32 = 0.005;

/// Receivers that move: every so many.
const MOVING_EVERY: usize = 4;

impl Curve {
    /// Microseconds per receiver at an error, between the settings around it; none where no setting is as good.
    fn time_at(&self, error: f64) -> Option<f64> {
        let at = self.points.iter().position(|p| p.error <= error)?;
        let fine = self.points[at];
        let Some(coarse) = at.checked_sub(1).map(|i| self.points[i]) else {
            return Some(fine.microseconds);
        };
        let share = (coarse.error / error).ln() / (coarse.error / fine.error).ln();
        Some(coarse.microseconds * (fine.microseconds / coarse.microseconds).powf(share))
    }
}

/// What a camera sees, thinned evenly.
fn seen(scene: &Scene, camera: &Camera, wanted: usize) -> Result<Vec<(Vec3, Vec3)>> {
    let view = CameraView { camera: camera.clone(), width: 192, height: 108 };
    let options = HideOptions { samples: 4, shading_rate: 4.0, window: None };
    let pieces = hide(scene, &view, &options)?.micropolygons;
    let step = (pieces.len() / wanted).max(1);
    Ok(pieces.iter().step_by(step).take(wanted).map(|p| (p.position, p.normal)).collect())
}

fn diffuse(places: Vec<(Vec3, Vec3)>) -> Vec<Receiver> {
    places.into_iter().map(|(position, normal)| Receiver::diffuse(position, normal)).collect()
}

/// Small clouds of glowing particles over a street: number in 0..1 after number from a seed.
fn fire(surfels: &mut Vec<Surfel>, around: Vec3, count: usize) {
    let mut state = 0x2545_f491u32;
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 8) as f32 / (1 << 24) as f32
    };
    for index in 0..count {
        let flame = (index % 40) as f32;
        let middle = around + Vec3::new((flame * 2.4).sin() * 7.0, 0.3, (flame * 1.7).cos() * 7.0);
        let spread = |x: f32| 0.5 * (x + x * x * x);
        let offset = Vec3::new(
            spread(2.0 * next() - 1.0) * 0.5,
            next() * next() * 2.5,
            spread(2.0 * next() - 1.0) * 0.5,
        );
        let radius = 0.004 + 0.02 * next() * next();
        let heat = 20.0 + 200.0 * next().powi(3);
        let area = std::f32::consts::PI * radius * radius;
        let particle = Surfel::new(middle + offset, Vec3::Y, radius, 2.0 * area);
        surfels.push(
            particle
                .with_radiance([heat, 0.45 * heat, 0.1 * heat])
                .with_flags(SurfelFlags::ISOTROPIC),
        );
    }
}

/// The case `name`, or none if its data are not there.
fn make_case(name: &str, arguments: &Arguments, folder: &Path) -> Result<Option<Case>> {
    let path = folder.join(format!("{name}.pbgi"));
    let wanted = arguments.receivers;
    let sky = |sun_direction: Vec3| {
        let parameters = SkyParameters { sun_direction, ..SkyParameters::default() };
        synthetic_sky(2048, 1024, &parameters)
    };
    let (quantity, parts) = (Quantity::Irradiance, GatherParts::All);
    Ok(Some(match name {
        "street" => {
            let made = procedural_scene("demo:street")?;
            let receivers = diffuse(seen(&made.scene, &made.scene.cameras[0], wanted)?);
            let octree = bake(&dice(&made.scene, arguments.surfels)?, &path)?;
            Case { octree, sky: Some(sky(made.sun_direction)), receivers, quantity, parts }
        }
        "fire30" | "fire10" | "fire05" => {
            let alpha: f32 = name[4..].parse::<f32>()? / 100.0;
            let made = procedural_scene("demo:street")?;
            let camera = &made.scene.cameras[0];
            let eye = Vec3::from(camera.transform.translation);
            let ground: Vec<_> = seen(&made.scene, camera, 60 * wanted)?;
            let low = |n: &(Vec3, Vec3)| n.1.y > 0.95 && n.0.y < 0.3;
            let mut ground: Vec<_> = ground.into_iter().filter(low).collect();
            ground.retain(|place| (place.0 - eye).length() < 25.0);
            if ground.is_empty() {
                bail!("the street's camera sees no ground");
            }
            let step = (ground.len() / wanted).max(1);
            let material = Material {
                base_color: [1.0; 3],
                metalness: 1.0,
                roughness: alpha.sqrt(),
                ..Material::default()
            };
            let glossy = |(position, normal): &(Vec3, Vec3)| {
                let gloss = Gloss { material, toward_eye: (eye - *position).normalize() };
                Receiver { gloss: Some(gloss), ..Receiver::diffuse(*position, *normal) }
            };
            let receivers = ground.iter().step_by(step).take(wanted).map(glossy).collect();
            let middle = ground.iter().map(|g| g.0).sum::<Vec3>() / ground.len() as f32;
            let mut surfels = dice(&made.scene, arguments.surfels)?;
            // By night: walls are dim, not black.
            for surfel in &mut surfels {
                let albedo = surfel.albedo_rgb();
                *surfel = surfel.with_radiance(albedo.map(|a| 0.02 * a));
            }
            fire(&mut surfels, middle, 30_000);
            let (quantity, parts) = (Quantity::Reflected, GatherParts::Sharp);
            let octree = bake(&surfels, &path)?;
            Case { octree, sky: None, receivers, quantity, parts }
        }
        "sponza-overcast" | "sponza-sunny" => {
            let mesh = arguments.data.join("sponza_crytek.glb");
            if !mesh.is_file() {
                return Ok(None);
            }
            let scene = read_scene(&mesh)?;
            let (from, to) = (Vec3::new(-12.0, 2.5, -0.5), Vec3::new(5.0, 3.0, -0.5));
            let camera = Camera::look_at(from, to, Vec3::Y, 65f32.to_radians());
            let receivers = diffuse(seen(&scene, &camera, wanted)?);
            let overcast = name == "sponza-overcast";
            let file = if overcast { "potsdamer_platz_1k.hdr" } else { "kloppenheim_05_1k.hdr" };
            let image = read_environment(&arguments.data.join(file))?;
            let octree = bake(&dice(&scene, arguments.surfels)?, &path)?;
            Case { octree, sky: Some(image), receivers, quantity, parts }
        }
        "foliage" => {
            let made = procedural_scene("demo:foliage")?;
            let receivers = diffuse(seen(&made.scene, &made.scene.cameras[0], wanted)?);
            let octree = bake(&dice(&made.scene, arguments.surfels)?, &path)?;
            let quantity = Quantity::Occlusion;
            Case { octree, sky: None, receivers, quantity, parts }
        }
        _ => bail!("there is no case {name}; see --help"),
    }))
}

fn print_curves(curves: &[Curve]) {
    println!(
        "{:18} {:10} {:>9} {:>11} {:>8} {:>8} {:>8}",
        "importance", "", "sr", "us/receiver", "cut", "rRMSE", "bias"
    );
    for curve in curves {
        for p in &curve.points {
            println!(
                "{:29} {:9.5} {:11.1} {:8.0} {:6.2} % {:+6.2} %",
                curve.importance,
                p.solid_angle_sr,
                p.microseconds,
                p.cut,
                p.error * 100.0,
                p.bias * 100.0
            );
        }
    }
}

/// Times at equal error, and how often they are those without importance.
fn print_ratios(case: &str, curves: &[Curve]) {
    let off = &curves[0];
    println!("{case}: us/receiver at equal error (times faster than off)");
    for curve in curves {
        let mut line = format!("  {:29}", curve.importance);
        for error in [0.05, 0.02, 0.01] {
            let text = match (curve.time_at(error), off.time_at(error)) {
                (Some(time), Some(base)) => format!("{time:9.0} ({:5.2}x)", base / time),
                (Some(time), None) => format!("{time:9.0} (     )"),
                (None, _) => "        - (     )".to_owned(),
            };
            let _ = write!(line, " {:2.0} %: {text}", error * 100.0);
        }
        println!("{line}");
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let folder = tempfile::tempdir()?;
    let mut all = Vec::new();
    for name in &arguments.cases {
        let Some(case) = make_case(name, &arguments, folder.path())? else {
            println!("{name}: skipped, no data in {}", arguments.data.display());
            continue;
        };
        let exhaustive = GatherSettings { solid_angle_sr: 0.0, ..case.settings() };
        let light = case.light(0.0, true, exhaustive.raster_edge)?;
        let (truth, slow, cut) = case.gather(&case.receivers, &exhaustive, light.as_ref())?;
        let finer = GatherSettings { raster_edge: 16, lobe_level: 4, ..exhaustive };
        let some: Vec<Receiver> = case.receivers.iter().copied().step_by(FINER_EVERY).collect();
        let coarser: Vec<Shading> = truth.iter().copied().step_by(FINER_EVERY).collect();
        let light = case.light(0.0, true, finer.raster_edge)?;
        let finer = case.gather(&some, &finer, light.as_ref())?.0;
        let raster = compare(&case.quantity.values(&coarser), &case.quantity.values(&finer))?;
        let truth = case.quantity.values(&truth);
        println!(
            "\n{name}: {} receivers; every surfel: {slow:.0} us, {cut:.0} entries; against a raster of twice the edge {:.2} %",
            case.receivers.len(),
            raster.rrmse * 100.0
        );
        let uniform = case.sky.is_some().then(Way::uniform);
        let ways = std::iter::once(ImportanceTerms::OFF)
            .chain(arguments.terms.iter().copied())
            .chain([ImportanceTerms::ALL])
            .map(Way::of)
            .chain(uniform);
        let curves: Result<Vec<Curve>> =
            ways.map(|way| case.curve(name, &way, &truth, slow)).collect();
        let curves = curves.with_context(|| format!("case {name}"))?;
        if !arguments.brief {
            print_curves(&curves);
        }
        print_ratios(name, &curves);
        if arguments.motion {
            case.print_motion(name)?;
        }
        all.extend(curves);
    }
    if let Some(path) = &arguments.json {
        std::fs::write(path, serde_json::to_string_pretty(&all)?)?;
    }
    if let Some(path) = &arguments.svg {
        std::fs::write(
            path,
            pbgi_benches::plot(&all_lines(&all), "relative RMSE against us per receiver"),
        )?;
    }
    Ok(())
}

/// One plot per case, one line per curve.
fn all_lines(curves: &[Curve]) -> Vec<pbgi_benches::Line> {
    let line = |curve: &Curve| pbgi_benches::Line {
        plot: curve.case.clone(),
        label: curve.importance.clone(),
        points: curve.points.iter().map(|p| (p.microseconds, p.error)).collect(),
    };
    curves.iter().map(line).collect()
}
