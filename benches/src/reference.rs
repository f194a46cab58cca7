//! Model error: the engine's results beside converged ray-cast references, with the time they took.
//!
//! `cargo run --release -p pbgi-benches --bin reference -- --data ../shared/reference room plaza`

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_benches::{bake, dice, reflected_radiance};
use pbgi_cloud::{ReceiverTable, Surfel};
use pbgi_image::compare;
use pbgi_light::{Environment, EnvironmentOptions};
use pbgi_math::Vec3;
use pbgi_scene::read_scene;
use pbgi_schedule::{
    GatherParts, GatherSettings, Gloss, ImportanceTerms, Material, PreparedLight, Receiver,
    ShadeOptions, ShadeReport, Shading, shade_receivers,
};
use pbgi_store::Octree;
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
    /// room, plaza, embers, thicket.
    #[arg(default_values_t = ["room", "plaza", "embers", "thicket"].map(str::to_owned))]
    scenes: Vec<String>,
}

/// Where the references of embers are seen from.
const EMBERS_EYE: Vec3 = Vec3::new(0.25, 1.35, 6.2);

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

    /// Reflections in the ground toward the camera, without a Fresnel term; the references name the width α of the slopes.
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
                Receiver { position: *position, normal: *normal, gloss }
            };
            let settings = GatherSettings { parts: GatherParts::Sharp, ..self.settings };
            let receivers = places.map(receiver).collect();
            let bench = Bench { table: table.clone(), receivers, settings, ..*self };
            let (shadings, run) = bench.shade(octree, None)?;
            let found: Vec<f32> = shadings.iter().flat_map(|s| s.reflected).collect();
            self.report(&column[4..], &found, &bench.rgb(column)?, &run)?;
        }
        Ok(())
    }

    /// One bounce: surfels lit by the emitter, which itself counts as black.
    fn relight(&self, octree: &Octree, surfels: &[Surfel]) -> Result<Vec<Surfel>> {
        let reflected = reflected_radiance(octree, None, surfels, &self.settings)?;
        let relit = surfels.iter().zip(reflected).map(|(surfel, reflected)| {
            let emits = surfel.radiance.iter().any(|&c| c > 0.0);
            surfel.with_radiance(if emits { [0.0; 3] } else { reflected })
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
            "embers" => {
                self.irradiance("irradiance", octree, None)?;
                self.gloss(octree)
            }
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
        lobe_level: arguments.lobe_level,
        importance: arguments.importance,
        ..GatherSettings::default()
    };
    let temporary = tempfile::tempdir()?;
    println!(
        "scene    quantity       rRMSE      bias   median      p99  µs/receiver  cut (1 thread)"
    );
    for name in &arguments.scenes {
        let scene = read_scene(&arguments.data.join(format!("{name}.glb")))?;
        let surfels = dice(&scene, arguments.surfels)?;
        let table = ReceiverTable::read(&arguments.data.join(format!("{name}_receivers.ply")))?;
        let places = table.positions.iter().zip(&table.normals).step_by(arguments.every);
        let receivers = places.map(|(p, n)| Receiver::diffuse(*p, *n)).collect();
        let every = arguments.every;
        let bench = Bench { folder: &arguments.data, name, table, receivers, settings, every };
        let path = temporary.path().join("scene.pbgi");
        bench.run(&surfels, &bake(&surfels, &path)?, &path)?;
    }
    Ok(())
}
