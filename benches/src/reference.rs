//! Model error: the engine's results beside converged references by an independent program, with the time they took, beside our own
//! ray caster's, and split into its causes.
//!
//! `cargo xtask truth --reference`, `cargo xtask truth --reference --causes room thicket`

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_benches::{Caster, Gathered, SkyImage, ThreadTimer, bake, dice, first_bounce, light_up};
use pbgi_cloud::{ReceiverTable, Surfel};
use pbgi_gather::{
    GatherParts, GatherSettings, Gloss, ImportanceTerms, Material, PreparedLight, Receiver, Shading,
};
use pbgi_image::compare;
use pbgi_light::{Environment, EnvironmentOptions};
use pbgi_math::Vec3;
use pbgi_mesh::read_scene;
use pbgi_scene::Scene;
use pbgi_schedule::{ShadeOptions, ShadeReport, shade_receivers};
use pbgi_store::Octree;
use std::fmt::Write as _;
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
    /// Directions of a reflection: 16 · 4^LEVEL.
    #[arg(long, default_value_t = GatherSettings::default().lobe_level)]
    lobe_level: u32,
    /// Terms of importance: env,lobe,cosine,radiance,quality, or all or off.
    #[arg(long, default_value_t = ImportanceTerms::ALL)]
    importance: ImportanceTerms,
    /// Shade every n-th receiver.
    #[arg(long, default_value_t = 10)]
    every: usize,
    /// Paths per receiver of our own ray caster, whose error is printed below the engine's; 0 for none.
    #[arg(long, default_value_t = 256)]
    rays: u32,
    /// Turn each cause of error up to its limit alone: four times the surfels, finer rasters, every surfel, no importance. In room, direct
    /// light only.
    #[arg(long)]
    causes: bool,
    /// Folder for one CSV file per scene and quantity: position, normal, truth and result of every receiver, of the first channel.
    #[arg(long)]
    results: Option<PathBuf>,
    /// room, plaza, embers, thicket.
    #[arg(default_values_t = ["room", "plaza", "embers", "thicket"].map(str::to_owned))]
    scenes: Vec<String>,
}

/// Where the references of embers are seen from.
const EMBERS_EYE: Vec3 = Vec3::new(0.25, 1.35, 6.2);

/// A setting, and how many times as many surfels.
#[derive(Clone, Copy)]
struct Variant {
    label: &'static str,
    settings: GatherSettings,
    density: u64,
}

/// The settings, and each with one cause of error turned up to its limit.
fn causes(settings: GatherSettings) -> Vec<Variant> {
    let plain = Variant { label: "as set", settings, density: 1 };
    let with = |label, settings| Variant { label, settings, density: 1 };
    let raster_edge = |n| GatherSettings { raster_edge: n, ..settings };
    vec![
        plain,
        Variant { label: "surfels x 4", density: 4, ..plain },
        with("raster 16", raster_edge(16)),
        with("raster 32", raster_edge(32)),
        with("every surfel", GatherSettings { solid_angle_sr: 0.0, ..settings }),
        with("no bias", GatherSettings { bias: 0.0, ..settings }),
        with("no importance", GatherSettings { importance: ImportanceTerms::OFF, ..settings }),
    ]
}

struct Bench<'a> {
    folder: &'a Path,
    scene: &'a Scene,
    label: &'a str,
    rays: u32,
    name: &'a str,
    table: ReceiverTable,
    receivers: Vec<Receiver>,
    settings: GatherSettings,
    every: usize,
    results: Option<&'a Path>,
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
        if let Some(folder) = self.results {
            self.write_results(folder, what, found, truth)?;
        }
        let receivers = run.receivers as f64;
        let cut = format!("{:.0}", run.cut.cut_size() as f64 / receivers);
        self.print([what, self.label, &cut], found, truth, run.seconds / receivers)
    }

    fn write_results(&self, folder: &Path, what: &str, found: &[f32], truth: &[f32]) -> Result<()> {
        let channels = found.len() / self.receivers.len().max(1);
        let mut text = "x,y,z,nx,ny,nz,truth,found\n".to_owned();
        for (i, r) in self.receivers.iter().enumerate() {
            let (p, n, at) = (r.position, r.normal, i * channels);
            let place = [p.x, p.y, p.z, n.x, n.y, n.z].map(|x| x.to_string()).join(",");
            writeln!(text, "{place},{},{}", truth[at], found[at])?;
        }
        let name = format!("{}-{what}{}.csv", self.name, self.label.replace(' ', "-"));
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())
    }

    fn print(
        &self,
        [what, label, cut]: [&str; 3],
        found: &[f32],
        truth: &[f32],
        seconds: f64,
    ) -> Result<()> {
        let error = compare(found, truth)?;
        println!(
            "{:8} {what:11} {label:13} {:7.2} % {:+7.2} % {:6.2} % {:6.1} % {:7.1} % {:9.1} {cut:>6}",
            self.name,
            error.rrmse * 100.0,
            error.bias * 100.0,
            error.p50 * 100.0,
            error.p95 * 100.0,
            error.p99 * 100.0,
            seconds * 1e6,
        );
        Ok(())
    }

    /// The error of our own ray caster, which shares nothing with the engine but the scene.
    fn cast(
        &self,
        what: &str,
        caster: &Caster,
        bounces: u32,
        value: impl Fn(&Gathered) -> [f32; 3],
    ) -> Result<()> {
        let timer = ThreadTimer::start();
        let gather = |(i, r): (usize, &Receiver)| {
            value(&caster.gather(r.position, r.normal, bounces, 0..self.rays, i as u32))
        };
        let found: Vec<[f32; 3]> = self.receivers.iter().enumerate().map(gather).collect();
        let seconds = timer.seconds() / found.len().max(1) as f64;
        let truth = self.rgb(&format!("ref_{what}"))?;
        self.print([what, "rays", ""], found.as_flattened(), &truth, seconds)
    }

    fn irradiance(&self, what: &str, octree: &Octree, light: Option<&PreparedLight>) -> Result<()> {
        let (shadings, run) = self.shade(octree, light)?;
        let found: Vec<f32> = shadings.iter().flat_map(Shading::irradiance).collect();
        self.report(what, &found, &self.rgb(&format!("ref_{what}"))?, &run)
    }

    /// Reflections in the ground toward the camera, without a Fresnel term; the references name the width α of the slopes, and are of the first bounce at
    /// microfacets alone.
    fn gloss(&self, octree: &Octree) -> Result<()> {
        let path = self.folder.join(format!("{}_ground_receivers.ply", self.name));
        let table = ReceiverTable::read(&path)?;
        for (column, alpha) in [("ref_glossy03", 0.3f32), ("ref_glossy01", 0.1)] {
            let material = Material {
                base_color: [1.0; 3],
                metalness: 1.0,
                roughness: alpha.sqrt(),
                ..Material::default()
            };
            let places = table.positions.iter().zip(&table.normals).step_by(self.every);
            let receiver = |(position, normal): (&Vec3, &Vec3)| {
                let toward_eye = (EMBERS_EYE - *position).normalize();
                let gloss = Some(Gloss { material, toward_eye });
                Receiver { gloss, ..Receiver::diffuse(*position, *normal) }
            };
            let settings = GatherSettings { parts: GatherParts::Sharp, ..self.settings };
            let receivers = places.map(receiver).collect();
            let bench = Bench { table: table.clone(), receivers, settings, ..*self };
            let (shadings, run) = bench.shade(octree, None)?;
            let found: Vec<f32> = shadings.iter().flat_map(|s| s.reflected).collect();
            let mut truth = bench.rgb(column)?;
            for (values, r) in truth.chunks_exact_mut(3).zip(&bench.receivers) {
                let eye = (EMBERS_EYE - r.position).normalize();
                let share = first_bounce(r.normal, eye, alpha);
                values.iter_mut().for_each(|value| *value /= share);
            }
            self.report(&column[4..], &found, &truth, &run)?;
            if self.rays > 0 {
                let caster = Caster::new(self.scene, None);
                let timer = ThreadTimer::start();
                let cast = |(i, r): (usize, &Receiver)| {
                    let eye = (EMBERS_EYE - r.position).normalize();
                    caster.reflect(r.position, r.normal, eye, alpha, 0..self.rays, i as u32)
                };
                let found: Vec<[f32; 3]> = bench.receivers.iter().enumerate().map(cast).collect();
                let seconds = timer.seconds() / found.len().max(1) as f64;
                self.print([&column[4..], "rays", ""], found.as_flattened(), &truth, seconds)?;
            }
        }
        Ok(())
    }

    fn run(&self, surfels: &[Surfel], octree: &Octree, path: &Path) -> Result<()> {
        match self.name {
            "room" => {
                self.irradiance("direct", octree, None)?;
                let caster = Caster::new(self.scene, None);
                if self.rays > 0 {
                    self.cast("direct", &caster, 0, |g| g.irradiance_from(0))?;
                    self.cast("indirect", &caster, 1, |g| g.irradiance_from(1))?;
                }
                if self.label.is_empty() {
                    // One bounce: the emitter itself counts as black.
                    let black: Vec<_> = surfels.iter().map(|s| s.with_radiance([0.0; 3])).collect();
                    let octree = bake(&light_up(octree, None, &black, &self.settings)?, path)?;
                    self.irradiance("indirect", &octree, None)?;
                }
                Ok(())
            }
            "plaza" => ["sky", "sky_sun"].into_iter().try_for_each(|sky| {
                let file = self.folder.join(format!("plaza_{sky}.exr"));
                let image = pbgi_image::read_environment(&file)?;
                let environment =
                    Environment::from_image(image.clone(), EnvironmentOptions::default())?;
                let light = PreparedLight::new(&environment, self.settings.raster_edge);
                self.irradiance(sky, octree, Some(&light))?;
                if self.rays > 0 {
                    let image = SkyImage::new(image);
                    let caster = Caster::new(self.scene, Some(&image));
                    self.cast(sky, &caster, 0, |g| g.irradiance_from(0))?;
                }
                Ok(())
            }),
            "embers" => {
                self.irradiance("irradiance", octree, None)?;
                if self.rays > 0 {
                    let caster = Caster::new(self.scene, None);
                    self.cast("irradiance", &caster, 0, |g| g.irradiance_from(0))?;
                }
                self.gloss(octree)
            }
            _ => {
                let (shadings, run) = self.shade(octree, None)?;
                let found: Vec<f32> = shadings.iter().map(|s| s.ambient_occlusion).collect();
                let truth = self.column("ref_ao")?;
                self.report("ao", &found, &truth, &run)?;
                if self.rays > 0 {
                    let caster = Caster::new(self.scene, None);
                    let timer = ThreadTimer::start();
                    let open = |(i, r): (usize, &Receiver)| {
                        caster.gather(r.position, r.normal, 0, 0..self.rays, i as u32).openness
                            as f32
                    };
                    let found: Vec<f32> = self.receivers.iter().enumerate().map(open).collect();
                    let seconds = timer.seconds() / found.len().max(1) as f64;
                    self.print(["ao", "rays", ""], &found, &truth, seconds)?;
                }
                Ok(())
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
        lobe_level: arguments.lobe_level,
        importance: arguments.importance,
        ..GatherSettings::default()
    };
    let temporary = tempfile::tempdir()?;
    println!(
        "scene    quantity    setting          rRMSE      bias   median      p95       p99 µs/receiver   cut (1 thread)"
    );
    let plain = Variant { label: "", settings, density: 1 };
    let variants = if arguments.causes { causes(settings) } else { vec![plain] };
    for name in &arguments.scenes {
        let scene = read_scene(&arguments.data.join(format!("{name}.glb")))?;
        let table = ReceiverTable::read(&arguments.data.join(format!("{name}_receivers.ply")))?;
        let places = table.positions.iter().zip(&table.normals).step_by(arguments.every);
        let receivers: Vec<Receiver> = places.map(|(p, n)| Receiver::diffuse(*p, *n)).collect();
        for Variant { label, settings, density } in &variants {
            let surfels = dice(&scene, arguments.surfels * density)?;
            let bench = Bench {
                folder: &arguments.data,
                scene: &scene,
                label,
                // Rays do not depend on what is varied.
                rays: if arguments.causes { 0 } else { arguments.rays },
                name,
                table: table.clone(),
                receivers: receivers.clone(),
                settings: *settings,
                every: arguments.every,
                results: arguments.results.as_deref(),
            };
            let path = temporary.path().join("scene.pbgi");
            bench.run(&surfels, &bake(&surfels, &path)?, &path)?;
        }
    }
    Ok(())
}
