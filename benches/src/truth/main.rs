//! The engine beside an independent ray caster over the same triangles: error, time, and pictures of the difference.
//!
//! `cargo xtask truth`

mod cases;
mod curve;
mod engine;
mod page;
mod paths;
mod pictures;
mod record;
mod report;
mod scan;
mod whole;
mod workers;

use anyhow::{Context, Result};
use cases::{CASES, Case, Folders, Light, WITH_SURFELS, WITHOUT_PICTURE, make_case};
use clap::Parser;
use engine::{LADDER, Setting, bake_case, gather_all};
use paths::{RayCurve, Truth};
use pbgi_benches::{Caster, SkyImage, dice};
use pbgi_cloud::Surfel;
use pbgi_gather::{Receiver, lobe_level};
use pbgi_store::Octree;
use record::Records;
use report::Row;
use serde::Serialize;
use std::path::{Path, PathBuf};
use whole::WholeRow;

/// Errors of the engine against ray-cast truth, and how long rays take to be as right.
#[derive(Parser)]
struct Arguments {
    /// Folder with meshes, scans and environments; cases without their data are left out.
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Folder with embers.glb.
    #[arg(long, default_value = "../shared/reference")]
    reference: PathBuf,
    /// Surfels per scene; a tenth of it in the box.
    #[arg(long, default_value_t = pbgi::DEFAULT_SURFELS)]
    surfels: u64,
    /// Columns of the picture whose first hits are the receivers; 9 rows to 16 columns.
    #[arg(long, default_value_t = 32)]
    width: u32,
    /// Paths are doubled until the noise of the truth is at most this rRMSE.
    #[arg(long, default_value_t = 0.01)]
    noise: f64,
    /// Most paths per receiver of the truth.
    #[arg(long, default_value_t = 16384)]
    paths: u32,
    /// Largest solid angle of a node taken as one, sr; 0 takes every surfel.
    #[arg(long, default_value_t = Setting::default().solid_angle_sr)]
    solid_angle: f32,
    /// Texels along a face of the raster.
    #[arg(long, default_value_t = Setting::default().raster_edge)]
    raster: usize,
    /// Directions of a reflection: 16, 64, 256, 1024, 4096 or 16384.
    #[arg(long = "directions", value_name = "DIRECTIONS", default_value = "1024", value_parser = parse_directions)]
    lobe_level: u32,
    /// Only those settings: no curves, and no times of rays.
    #[arg(long)]
    brief: bool,
    /// Shade whole pictures so many pixels wide instead, 9 rows to 16 columns, and compare a sample of their receivers.
    #[arg(long, conflicts_with_all = ["brief", "worst", "pictures", "svg"])]
    whole: Option<u32>,
    /// Of whole pictures, shade one band of 64 rows in so many.
    #[arg(long, default_value_t = 1, requires = "whole")]
    nth_band: usize,
    /// Print so many receivers with the largest errors.
    #[arg(long, default_value_t = 0)]
    worst: usize,
    /// Folder to draw pictures into: truth, engine, and their difference four times as bright, side by side.
    #[arg(long)]
    pictures: Option<PathBuf>,
    /// Folder of the documentation, whose tables and captions are written anew; its folder images gets the pictures and the plot.
    #[arg(long, conflicts_with_all = ["pictures", "brief"])]
    docs: Option<PathBuf>,
    /// Where to write the curves and errors as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Where to write every setting's time and error as CSV, for `cargo xtask bench-compare`.
    #[arg(long)]
    record: Option<PathBuf>,
    /// Where to draw the curves.
    #[arg(long)]
    svg: Option<PathBuf>,
    /// cornell, cornell3, sponza-overcast, sponza-sunny, sponza1, apartment, bunny, street, street1, foliage, fire, fire30, fire10, scan.
    #[arg(default_values_t = CASES.map(str::to_owned))]
    cases: Vec<String>,
}

/// Core-seconds the engine took for a picture, if it was drawn.
type Drawn = Option<f64>;

/// A case ready to be measured.
struct Bench<'a> {
    case: &'a Case,
    caster: &'a Caster<'a>,
    surfels: u64,
    folder: &'a Path,
}

impl Bench<'_> {
    fn dice(&self, density: f64) -> Result<Vec<Surfel>> {
        dice(&self.case.scene, (self.case.surfels(self.surfels) as f64 * density) as u64)
    }

    fn bake(&self, surfels: &[Surfel]) -> Result<Octree> {
        bake_case(self.case, surfels, &self.folder.join("scene.pbgi"))
    }

    /// Results and times of every setting beside the default. Light that bounces is baked at one density.
    fn ladder(
        &self,
        octree: &Octree,
        places: &[(usize, Receiver)],
    ) -> Result<Vec<(String, Vec<Light>, f64)>> {
        let (mut runs, mut other): (Vec<_>, Option<(f64, Octree)>) = (Vec::new(), None);
        for setting in &LADDER {
            let plain = setting.density == 1.0;
            if !plain && self.case.bounces > 0 {
                continue;
            }
            if !plain && other.as_ref().is_none_or(|(density, _)| *density != setting.density) {
                other = Some((setting.density, self.bake(&self.dice(setting.density)?)?));
            }
            let of_density = other.as_ref().filter(|_| !plain).map_or(octree, |(_, o)| o);
            let (found, us) = gather_all(self.case, of_density, setting, places)?;
            runs.push((setting.label(self.case), found, us));
        }
        Ok(runs)
    }

    fn run(&self, arguments: &Arguments, pictures: Option<&Path>) -> Result<(Vec<Row>, Drawn)> {
        let Self { case, caster, .. } = *self;
        let places = case.receivers(caster, &case.view(arguments.width));
        let octree = self.bake(&self.dice(1.0)?)?;
        let setting = Setting {
            solid_angle_sr: arguments.solid_angle,
            raster_edge: arguments.raster,
            lobe_level: arguments.lobe_level,
            ..Setting::default()
        };
        let (found, us) = gather_all(case, &octree, &setting, &places)?;
        let truth = Truth::cast(case, caster, &places, arguments.noise, arguments.paths)?;
        let drawn = pictures
            .filter(|_| !WITHOUT_PICTURE.contains(&case.name.as_str()))
            .map(|folder| pictures::draw(case, caster, &octree, &setting, folder))
            .transpose()?;
        let mut runs = vec![(setting.label(case), found, us)];
        let mut rays = None;
        if !arguments.brief {
            runs.extend(self.ladder(&octree, &places)?);
            rays = Some(RayCurve::cast(case, caster, &places, &truth));
        }
        let mut rows = Vec::new();
        for &quantity in case.quantities() {
            let row = Row::new(case, quantity, &truth, &runs, rays.as_ref())?;
            println!("{row}");
            print_worst(&row, &places, &truth, &runs[0].1, arguments.worst);
            rows.push(row);
        }
        Ok((rows, drawn))
    }
}

/// The receivers that add most to the rRMSE.
fn print_worst(
    row: &Row,
    places: &[(usize, Receiver)],
    truth: &Truth,
    found: &[Light],
    count: usize,
) {
    let (expected, found) = (row.of.values(&truth.light), row.of.values(found));
    let mean = expected.iter().sum::<f32>() / expected.len().max(1) as f32;
    let green = |i: usize| (expected[3 * i + 1] / mean, found[3 * i + 1] / mean);
    let badness = |i: usize| {
        let (r, x) = green(i);
        (x - r).powi(2) / (r * r + 0.01)
    };
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|a, b| badness(*b).total_cmp(&badness(*a)));
    let all: f32 = order.iter().map(|i| badness(*i)).sum();
    for &i in order.iter().take(count) {
        let ((pixel, receiver), (r, x)) = (places[i], green(i));
        let share = 100.0 * badness(i) / all;
        let (p, n) = (receiver.position, receiver.normal);
        println!(
            "  pixel {pixel:6} at {p:.4} facing {n:.3}: {x:.3} of {r:.3}, {share:.1} % of the error"
        );
    }
}

/// A case by its name, or none, which is told, where its data are not there.
fn find_case(arguments: &Arguments, name: &str) -> Result<Option<Case>> {
    let folders = Folders { data: arguments.data.clone(), reference: arguments.reference.clone() };
    let case = make_case(name, &folders).with_context(|| format!("case {name}"))?;
    if case.is_none() {
        println!("{name}: skipped, no data");
    }
    Ok(case)
}

/// Writes rows as JSON and their settings on record, where that is asked for.
fn write_results<R: Serialize>(
    arguments: &Arguments,
    rows: &[R],
    record: impl Fn(&mut Records, &R),
) -> Result<()> {
    if let Some(path) = &arguments.json {
        std::fs::write(path, serde_json::to_string_pretty(rows)?)?;
    }
    if let Some(path) = &arguments.record {
        let mut records = Records::default();
        rows.iter().for_each(|row| record(&mut records, row));
        records.write(path)?;
    }
    Ok(())
}

/// Measures the cases and draws them, if told to; with the captions of the pictures.
fn run_all(
    arguments: &Arguments,
    pictures: Option<&Path>,
    temporary: &Path,
) -> Result<(Vec<Row>, Vec<String>)> {
    let (mut rows, mut captions) = (Vec::new(), Vec::new());
    for name in &arguments.cases {
        if name == "scan" {
            captions.extend(scan::run(&arguments.data, temporary, pictures)?);
            continue;
        }
        let Some(case) = find_case(arguments, name)? else { continue };
        let sky = case.sky.clone().map(SkyImage::new);
        let caster = Caster::new(&case.scene, sky.as_ref());
        let surfels = arguments.surfels;
        let bench = Bench { case: &case, caster: &caster, surfels, folder: temporary };
        let (found, drawn) =
            bench.run(arguments, pictures).with_context(|| format!("case {name}"))?;
        if let (Some(seconds), Some(row)) = (drawn, found.last()) {
            captions.push(pictures::caption(&case, row, case.surfels(surfels), seconds));
        }
        rows.extend(found);
    }
    Ok((rows, captions))
}

/// Shades whole pictures of the cases, all surfels of some, and all points of the scan.
fn run_whole(arguments: &Arguments, width: u32, temporary: &Path) -> Result<Vec<WholeRow>> {
    let mut rows = Vec::new();
    println!("{}", whole::header());
    let nth = arguments.nth_band.max(1);
    for name in &arguments.cases {
        if name == "scan" {
            let octree = scan::bake(&arguments.data, temporary)?;
            let of_scan = octree.map(|octree| whole::points(&octree, nth)).transpose()?;
            rows.extend(printed(of_scan.unwrap_or_default()));
            continue;
        }
        let Some(case) = find_case(arguments, name)? else { continue };
        let sky = case.sky.clone().map(SkyImage::new);
        let caster = Caster::new(&case.scene, sky.as_ref());
        let (surfels, folder) = (arguments.surfels, temporary);
        let bench = Bench { case: &case, caster: &caster, surfels, folder };
        let surfels = bench.dice(1.0)?;
        let octree = bench.bake(&surfels)?;
        let in_case = || format!("case {name}");
        let picture = whole::picture(&case, &caster, &octree, (width, nth), arguments.noise);
        rows.extend(printed(picture.with_context(in_case)?));
        if WITH_SURFELS.contains(&name.as_str()) {
            let all = whole::surfels(&case, &caster, &octree, (surfels, nth), arguments.noise);
            rows.extend(printed(all.with_context(in_case)?));
        }
    }
    Ok(rows)
}

fn printed(rows: Vec<WholeRow>) -> Vec<WholeRow> {
    rows.iter().for_each(|row| println!("{row}"));
    rows
}

/// The level of so many directions.
fn parse_directions(text: &str) -> Result<u32, String> {
    let directions = text.parse().map_err(|error| format!("{error}"))?;
    lobe_level(directions).map_err(|expected| format!("expected {expected}"))
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let temporary = tempfile::tempdir()?;
    if let Some(width) = arguments.whole {
        let rows = run_whole(&arguments, width, temporary.path())?;
        if let Some(docs) = &arguments.docs {
            page::replace(&docs.join("measuring.md"), "whole", &whole::table(&rows))?;
        }
        return write_results(&arguments, &rows, |records, r| {
            records.add(&r.scene, r.quantity, &r.engine, &r.rays);
        });
    }
    println!("{}", report::HEADER);
    let images = arguments.docs.as_ref().map(|docs| docs.join("images"));
    let pictures = arguments.pictures.as_ref().or(images.as_ref());
    if let Some(pictures) = pictures {
        std::fs::create_dir_all(pictures).with_context(|| pictures.display().to_string())?;
    }
    let (rows, captions) = run_all(&arguments, pictures.map(PathBuf::as_path), temporary.path())?;
    if let Some(docs) = &arguments.docs {
        std::fs::write(docs.join("images/truth.svg"), report::plot(&rows))?;
        page::replace(&docs.join("pictures.md"), "pictures", &captions.join("\n\n"))?;
        page::replace(&docs.join("measuring.md"), "errors", &report::error_table(&rows))?;
        page::replace(&docs.join("measuring.md"), "times", &report::time_table(&rows))?;
    }
    if let Some(path) = &arguments.svg {
        std::fs::write(path, report::plot(&rows))?;
    }
    write_results(&arguments, &rows, |records, r| {
        records.add(&r.scene, r.quantity, &r.engine, &r.rays);
    })
}
