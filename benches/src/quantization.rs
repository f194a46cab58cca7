//! What rounding in the file costs, beside what a cut costs: the same receivers, gathered over surfels as stored and hardly rounded.
//!
//! `cargo run --release -p pbgi-benches --bin quantization -- --data ../shared/data --json quantization.json`

use anyhow::{Result, bail};
use clap::Parser;
use pbgi_benches::{bake_with, lit_surfels, scene_surfels};
use pbgi_build::{BuildOptions, LeafRounding};
use pbgi_cloud::Surfel;
use pbgi_gather::{GatherSettings, ImportanceTerms, Receiver, Shading};
use pbgi_image::compare;
use pbgi_schedule::{ShadeOptions, shade_receivers};
use pbgi_store::Octree;
use serde::Serialize;
use std::path::PathBuf;

/// Errors of rounding and of the cut, with receivers strewn over the scene's surfaces.
#[derive(Parser)]
struct Arguments {
    /// Folder with sponza_crytek.glb and an environment; without it, sponza is left out.
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Surfels per scene.
    #[arg(long, default_value_t = 500_000)]
    surfels: u64,
    /// Receivers per scene.
    #[arg(long, default_value_t = 200)]
    receivers: usize,
    /// Another seed gives other receivers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Solid angle of the cut that rounding is compared with, sr.
    #[arg(long, default_value_t = 0.01)]
    solid_angle: f32,
    /// Texels along a face of the raster: coarse ones scatter more than rounding does.
    #[arg(long, default_value_t = 24)]
    raster: usize,
    /// As many receivers on each surfel, however small: most lie on fine details then.
    #[arg(long)]
    by_surfel: bool,
    /// Leave the surfels dark, which saves most of the time: only occlusion is compared.
    #[arg(long)]
    dark: bool,
    /// Where to write the rows as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Scenes: street, sponza, foliage.
    #[arg(default_values_t = ["street", "sponza"].map(str::to_owned))]
    scenes: Vec<String>,
}

/// One error of one quantity.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scene: String,
    quantity: &'static str,
    of: &'static str,
    rrmse: f64,
    bias: f64,
    p50: f64,
    p99: f64,
    /// Over that of the cut with uniform thresholds.
    of_cut: f64,
}

/// Receivers strewn over surfels that know their rectangle, anywhere on it: by area, or on each as many.
fn strew(surfels: &[Surfel], arguments: &Arguments) -> Result<Vec<Receiver>> {
    let mut state = arguments.seed;
    let mut next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f32 / (1u64 << 31) as f32
    };
    let places: Vec<(&Surfel, [_; 2])> =
        surfels.iter().filter_map(|s| Some((s, s.half_edges()?))).collect();
    if places.is_empty() {
        bail!("no surfel knows the rectangle it stands for");
    }
    let mut total = 0.0;
    let ends: Vec<f64> = places
        .iter()
        .map(|(surfel, _)| {
            total += if arguments.by_surfel { 1.0 } else { f64::from(surfel.area) };
            total
        })
        .collect();
    let receiver = |_| {
        let wanted = f64::from(next()) * total;
        let at = ends.partition_point(|end| *end <= wanted);
        let (surfel, [long, short]) = places[at.min(places.len() - 1)];
        let offset = long * (2.0 * next() - 1.0) + short * (2.0 * next() - 1.0);
        Receiver::diffuse(surfel.center() + offset, surfel.normal())
    };
    Ok((0..arguments.receivers).map(receiver).collect())
}

fn gather(
    octree: &Octree,
    receivers: &[Receiver],
    settings: GatherSettings,
) -> Result<Vec<Shading>> {
    let options = ShadeOptions { gather: settings, threads: 2, ..ShadeOptions::default() };
    Ok(shade_receivers(octree, None, receivers, &options)?.0)
}

/// What of a shading is compared.
type Values = fn(&[Shading]) -> Vec<f32>;

const QUANTITIES: [(&str, Values); 2] = [
    ("irradiance", |shadings| shadings.iter().flat_map(Shading::irradiance).collect()),
    ("occlusion", |shadings| shadings.iter().map(|s| s.ambient_occlusion).collect()),
];

/// All errors of a scene.
fn measure(scene: &str, surfels: &[Surfel], arguments: &Arguments) -> Result<Vec<Row>> {
    let folder = tempfile::tempdir()?;
    let receivers = strew(surfels, arguments)?;
    let every = GatherSettings {
        solid_angle_sr: 0.0,
        importance: ImportanceTerms::OFF,
        raster_edge: arguments.raster,
        ..GatherSettings::default()
    };
    let uniform = GatherSettings { solid_angle_sr: arguments.solid_angle, ..every };
    let guided = GatherSettings { importance: ImportanceTerms::ALL, ..uniform };
    let bake = |rounding, name| {
        let options = BuildOptions { rounding, ..BuildOptions::default() };
        let (octree, report) = bake_with(surfels, &options, &folder.path().join(name))?;
        let bytes = report.file_bytes as f64 / report.surfels as f64;
        println!("{scene}: {} surfels, {name} {bytes:.2} bytes each", report.surfels);
        anyhow::Ok(octree)
    };
    let finest = bake(LeafRounding::Finest, "finest")?;
    let exact = gather(&finest, &receivers, every)?;
    drop(finest);
    let stored = bake(LeafRounding::Compact, "stored")?;
    let rounded = gather(&stored, &receivers, every)?;
    let runs = [
        ("rounding", rounded.clone(), &exact),
        ("cut, uniform", gather(&stored, &receivers, uniform)?, &rounded),
        ("cut, importance", gather(&stored, &receivers, guided)?, &rounded),
    ];
    let mut rows = Vec::new();
    for (quantity, values) in QUANTITIES.into_iter().skip(usize::from(arguments.dark)) {
        let error = |(_, found, truth): &(_, Vec<Shading>, &Vec<Shading>)| {
            compare(&values(found), &values(truth))
        };
        let cut = error(&runs[1])?.rrmse;
        for run in &runs {
            let error = error(run)?;
            rows.push(Row {
                scene: scene.to_owned(),
                quantity,
                of: run.0,
                rrmse: error.rrmse,
                bias: error.bias,
                p50: error.p50,
                p99: error.p99,
                of_cut: error.rrmse / cut,
            });
        }
    }
    Ok(rows)
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let mut all = Vec::new();
    for scene in &arguments.scenes {
        let make = if arguments.dark { scene_surfels } else { lit_surfels };
        let surfels = make(scene, arguments.surfels, &arguments.data)?;
        let Some(surfels) = surfels else {
            println!("{scene}: skipped, no data in {}", arguments.data.display());
            continue;
        };
        let rows = measure(scene, &surfels, &arguments)?;
        for r in &rows {
            println!(
                "{:10} {:15} rRMSE {:6.2} %  bias {:+6.2} %  median {:5.2} %  p99 {:6.1} %  of the cut's {:.3}",
                r.quantity,
                r.of,
                r.rrmse * 100.0,
                r.bias * 100.0,
                r.p50 * 100.0,
                r.p99 * 100.0,
                r.of_cut
            );
        }
        all.extend(rows);
    }
    if let Some(path) = &arguments.json {
        std::fs::write(path, serde_json::to_string_pretty(&all)?)?;
    }
    Ok(())
}
