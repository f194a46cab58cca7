//! Model error: the engine's results beside converged ray-cast references, with the time they took.
//!
//! `cargo run --release -p pbgi-benches --bin reference -- --data ../shared/reference room plaza`

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_build::{BuildOptions, SortedStream, StreamError, StreamSummary, build_octree};
use pbgi_cloud::{ReceiverTable, SliceSource, Surfel, SurfelSource};
use pbgi_image::compare;
use pbgi_light::{Environment, EnvironmentOptions};
use pbgi_math::MortonCode;
use pbgi_scene::{DiceOptions, DicedScene, Spacing, TwoSided, read_scene};
use pbgi_schedule::{
    GatherSettings, PreparedLight, Receiver, ShadeOptions, ShadeReport, Shading, shade_receivers,
};
use pbgi_sort::{SortOptions, SortedSurfels, sort_surfels};
use pbgi_store::{Octree, OpenOptions};
use std::f32::consts::PI;
use std::path::{Path, PathBuf};

/// Compares with the references of a folder: rRMSE, bias and percentiles beside core-µs per receiver.
#[derive(Parser)]
struct Arguments {
    /// Folder with the scenes and their receivers.
    #[arg(long, default_value = "../shared/reference")]
    data: PathBuf,
    /// Surfels per scene.
    #[arg(long, default_value_t = 1_000_000)]
    surfels: u64,
    /// Largest solid angle of a node taken as one, sr.
    #[arg(long, default_value_t = GatherSettings::default().solid_angle_sr)]
    solid_angle: f32,
    /// Texels along a face of the raster.
    #[arg(long, default_value_t = GatherSettings::default().raster_edge)]
    raster: usize,
    /// Shade every n-th receiver.
    #[arg(long, default_value_t = 10)]
    every: usize,
    /// room, plaza, embers, thicket.
    #[arg(default_values_t = ["room", "plaza", "embers", "thicket"].map(str::to_owned))]
    scenes: Vec<String>,
}

struct Stream(SortedSurfels);

impl SortedStream for Stream {
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError> {
        Ok(self.0.read_chunk(out)?)
    }
}

fn bake(surfels: &[Surfel], path: &Path) -> Result<Octree> {
    let sorted = sort_surfels(&mut SliceSource::new(surfels), &SortOptions::default())?;
    let facts = *sorted.summary();
    let summary = StreamSummary {
        root: facts.root,
        origin: facts.origin,
        surfel_count: facts.count,
        radius_max: facts.radius_max,
        area_max: facts.area_max,
        radiance_max: facts.radiance_max,
        any_albedo: facts.any_albedo,
        any_isotropic: facts.any_isotropic,
        z_up: false,
    };
    build_octree(&mut Stream(sorted), &summary, &BuildOptions::default(), path)?;
    Ok(Octree::open(path, &OpenOptions { cache_bytes: 1 << 30, ..OpenOptions::default() })?)
}

struct Bench<'a> {
    folder: &'a Path,
    name: &'a str,
    table: ReceiverTable,
    receivers: Vec<Receiver>,
    settings: GatherSettings,
    every: usize,
}

impl Bench<'_> {
    fn column(&self, name: &str) -> Result<Vec<f32>> {
        let column = self.table.column(name).with_context(|| format!("no column {name}"))?;
        Ok(column.iter().copied().step_by(self.every).collect())
    }

    fn rgb(&self, prefix: &str) -> Result<Vec<f32>> {
        let [r, g, b] = ["r", "g", "b"].map(|c| self.column(&format!("{prefix}_{c}")));
        let (r, g, b) = (r?, g?, b?);
        Ok((0..r.len()).flat_map(|i| [r[i], g[i], b[i]]).collect())
    }

    fn shade(
        &self,
        octree: &Octree,
        light: Option<&PreparedLight>,
    ) -> Result<(Vec<Shading>, ShadeReport)> {
        let options = ShadeOptions { gather: self.settings, ..ShadeOptions::default() };
        Ok(shade_receivers(octree, light, &self.receivers, &options)?)
    }

    fn report(&self, what: &str, found: &[f32], truth: &[f32], run: &ShadeReport) -> Result<()> {
        let error = compare(found, truth)?;
        let receivers = run.receivers as f64;
        println!(
            "{:8} {what:12} {:7.2} % {:+7.2} % {:6.2} % {:7.1} % {:9.1} {:7.0}",
            self.name,
            error.rrmse * 100.0,
            error.bias * 100.0,
            error.p50 * 100.0,
            error.p99 * 100.0,
            run.seconds * 1e6 / receivers,
            run.cut.cut_size() as f64 / receivers,
        );
        Ok(())
    }

    fn irradiance(&self, what: &str, octree: &Octree, light: Option<&PreparedLight>) -> Result<()> {
        let (shadings, run) = self.shade(octree, light)?;
        let found: Vec<f32> = shadings.iter().flat_map(Shading::irradiance).collect();
        self.report(what, &found, &self.rgb(&format!("ref_{what}"))?, &run)
    }

    /// One bounce: surfels lit by the emitter, which itself counts as black.
    fn relight(&self, octree: &Octree, surfels: &[Surfel]) -> Result<Vec<Surfel>> {
        let places = surfels.iter().map(|s| Receiver { position: s.center(), normal: s.normal() });
        let places: Vec<Receiver> = places.collect();
        let options = ShadeOptions { gather: self.settings, threads: 2, ..ShadeOptions::default() };
        let (lit, _) = shade_receivers(octree, None, &places, &options)?;
        let relit = surfels.iter().zip(&lit).map(|(surfel, light)| {
            let (albedo, irradiance) = (surfel.albedo_rgb(), light.irradiance());
            let emits = surfel.radiance.iter().any(|&c| c > 0.0);
            let reflected = |c: usize| if emits { 0.0 } else { albedo[c] / PI * irradiance[c] };
            surfel.with_radiance(std::array::from_fn(reflected))
        });
        Ok(relit.collect())
    }

    fn run(&self, surfels: &[Surfel], octree: &Octree, path: &Path) -> Result<()> {
        match self.name {
            "room" => {
                self.irradiance("direct", octree, None)?;
                let octree = bake(&self.relight(octree, surfels)?, path)?;
                self.irradiance("indirect", &octree, None)
            }
            "plaza" => ["sky", "sky_sun"].into_iter().try_for_each(|sky| {
                let file = self.folder.join(format!("plaza_{sky}.exr"));
                let image = pbgi_image::read_environment(&file)?;
                let environment = Environment::from_image(image, EnvironmentOptions::default())?;
                let light = PreparedLight::new(&environment, self.settings.raster_edge);
                self.irradiance(sky, octree, Some(&light))
            }),
            "embers" => self.irradiance("irradiance", octree, None),
            _ => {
                let (shadings, run) = self.shade(octree, None)?;
                let found: Vec<f32> = shadings.iter().map(|s| s.ambient_occlusion).collect();
                self.report("ao", &found, &self.column("ref_ao")?, &run)
            }
        }
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    if !arguments.data.is_dir() {
        println!("skipped: no references in {}", arguments.data.display());
        return Ok(());
    }
    let settings = GatherSettings {
        solid_angle_sr: arguments.solid_angle,
        raster_edge: arguments.raster,
        ..GatherSettings::default()
    };
    let temporary = tempfile::tempdir()?;
    println!(
        "scene    quantity       rRMSE      bias   median      p99  µs/receiver  cut (1 thread)"
    );
    for name in &arguments.scenes {
        let scene = read_scene(&arguments.data.join(format!("{name}.glb")))?;
        let spacing = Spacing::Count(arguments.surfels);
        let options = DiceOptions { spacing, two_sided: TwoSided::Material };
        let mut surfels = Vec::new();
        let mut source = DicedScene::new(&scene, options)?;
        while source.read_chunk(&mut surfels)? {}
        let table = ReceiverTable::read(&arguments.data.join(format!("{name}_receivers.ply")))?;
        let places = table.positions.iter().zip(&table.normals).step_by(arguments.every);
        let receivers = places.map(|(p, n)| Receiver { position: *p, normal: *n }).collect();
        let every = arguments.every;
        let bench = Bench { folder: &arguments.data, name, table, receivers, settings, every };
        let path = temporary.path().join("scene.pbgi");
        bench.run(&surfels, &bake(&surfels, &path)?, &path)?;
    }
    Ok(())
}
