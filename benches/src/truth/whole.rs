//! A whole picture, as its user pays for it: every receiver, those that gather and those that do not, beside truth for a sample of them.

use crate::cases::{Case, Light, Quantity};
use crate::curve::Point;
use crate::engine::{Setting, light_of};
use crate::paths::{RayCurve, Truth, without_noise};
use crate::report::Times;
use anyhow::Result;
use pbgi_benches::Caster;
use pbgi_file::platform::processor_seconds;
use pbgi_gather::{GatherSettings, Receiver};
use pbgi_image::compare;
use pbgi_schedule::{Feed, KeptRecords, ScheduleError, ShadeOptions, shade_stream};
use pbgi_store::Octree;
use serde::Serialize;
use std::borrow::Cow;
use std::fmt::{self, Write as _};

/// Rows of a band: what pictures are shaded by.
const ROWS: usize = 64;

/// Receivers whose truth is cast.
const SAMPLE: usize = 600;

/// Settings from coarse to fine: solid angle, raster, share that interpolation may be wrong by.
const LADDER: [(f32, usize, f32); 6] =
    [(1.0, 4, 0.4), (0.6, 8, 0.2), (0.3, 8, 0.2), (0.15, 8, 0.2), (0.1, 16, 0.1), (0.03, 16, 0.1)];

/// Error at which times are told.
const ERROR: f64 = 0.05;

/// Processor time per receiver of a picture, and what is wrong with it.
#[derive(Clone, Debug, Serialize)]
pub struct WholeRow {
    pub scene: String,
    pub quantity: &'static str,
    pub receivers: usize,
    /// Share of them that gather, by setting.
    pub gathers: Vec<f64>,
    pub engine: Vec<Point>,
    pub rays: Vec<Point>,
}

impl WholeRow {
    /// At [`ERROR`].
    fn times(&self) -> Times {
        Times::at(ERROR, &self.engine, &self.rays)
    }
}

impl fmt::Display for WholeRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [engine, rays, factor] = self.times().short();
        write!(f, "{:16} {:10} {engine:>7} {rays:>7} {factor:>7} |", self.scene, self.quantity)?;
        self.engine.iter().zip(&self.gathers).try_for_each(|(point, gathers)| {
            let (us, error, share) = (point.microseconds, 100.0 * point.error, 100.0 * gathers);
            write!(f, " {us:5.0} {error:5.2} % {share:3.0} |")
        })
    }
}

/// Above the lines that rows print.
pub fn header() -> String {
    let settings = LADDER.map(|(sr, raster, tolerance)| {
        format!("{:>18} |", format!("{sr} {raster} {:.0} %", 100.0 * tolerance))
    });
    format!(
        "whole pictures: core-us per receiver of engine and rays at {:.0} %; then by sr, raster and --interpolation: core-us, rRMSE, % that gather\n\
         scene            quantity    engine    rays  factor |{}",
        100.0 * ERROR,
        settings.concat()
    )
}

/// Shades every band of a picture `width` pixels wide, or every `nth`, by all settings.
///
/// # Errors
///
/// If the octree cannot be read, or values are not finite.
pub fn run(
    case: &Case,
    caster: &Caster,
    octree: &Octree,
    width: u32,
    nth: usize,
    noise: f64,
) -> Result<Vec<WholeRow>> {
    let view = case.view(width);
    let rows = |pixel: usize| pixel / view.width as usize;
    let is_of_picture = |pixel: usize| (rows(pixel) / ROWS).is_multiple_of(nth);
    let mut places = case.receivers(caster, &view);
    places.retain(|(pixel, _)| is_of_picture(*pixel));
    let bands: Vec<&[(usize, Receiver)]> =
        places.chunk_by(|a, b| rows(a.0) / ROWS == rows(b.0) / ROWS).collect();
    // Odd, so that columns of the picture are met alike.
    let step = (places.len() / SAMPLE).max(1) | 1;
    let sample: Vec<(usize, Receiver)> = places.iter().step_by(step).copied().collect();
    let truth = Truth::cast(case, caster, &sample, noise, 4096)?;
    let rays = RayCurve::cast(case, caster, &sample, &truth);
    let mut runs = Vec::new();
    for (solid_angle_sr, raster_edge, tolerance) in LADDER {
        let setting = Setting { solid_angle_sr, raster_edge, ..Setting::default() };
        let (found, seconds, gathers) = shade(case, octree, &setting, tolerance, &bands)?;
        let found: Vec<Light> = found.into_iter().step_by(step).collect();
        let label = format!("{solid_angle_sr} sr, raster {raster_edge}, {tolerance}");
        let of_receivers = 1.0 / places.len().max(1) as f64;
        runs.push((label, found, 1e6 * seconds * of_receivers, gathers as f64 * of_receivers));
    }
    let row = |quantity: Quantity| -> Result<WholeRow> {
        let (expected, noise) = (quantity.values(&truth.light), truth.noise(quantity)?);
        let mut engine = Vec::new();
        for (setting, found, microseconds, _) in &runs {
            let error = without_noise(compare(&quantity.values(found), &expected)?.rrmse, noise);
            engine.push(Point { setting: setting.clone(), microseconds: *microseconds, error });
        }
        Ok(WholeRow {
            scene: case.name.clone(),
            quantity: quantity.name(),
            receivers: places.len(),
            gathers: runs.iter().map(|run| run.3).collect(),
            engine,
            rays: rays.points(quantity, &truth)?,
        })
    };
    case.quantities().iter().map(|quantity| row(*quantity)).collect()
}

/// Results of all receivers, processor seconds, and how many gathered.
fn shade(
    case: &Case,
    octree: &Octree,
    setting: &Setting,
    tolerance: f32,
    bands: &[&[(usize, Receiver)]],
) -> Result<(Vec<Light>, f64, u64)> {
    // Reflections are never interpolated.
    let tolerance = if case.gloss.is_some() { 0.0 } else { tolerance };
    let gather = GatherSettings { tolerance, ..setting.gather(case) };
    let options = ShadeOptions { gather, threads: 1, ..ShadeOptions::default() };
    let light = setting.light(case)?;
    let mut found = Vec::new();
    let before = processor_seconds().unwrap_or_default();
    let report = shade_stream(
        octree,
        light.as_ref(),
        &options,
        &mut KeptRecords::default(),
        |feed: &mut Feed<'_, '_, (), ScheduleError>| {
            bands.iter().try_for_each(|band| {
                let receivers = band.iter().map(|place| place.1).collect();
                feed.push(Cow::Owned(receivers), ())
            })
        },
        |chunk| {
            found.extend(chunk.shadings.iter().map(light_of));
            Ok(())
        },
    )?;
    let seconds = processor_seconds().unwrap_or_default() - before;
    Ok((found, seconds, report.cut_sizes.count))
}

/// Time at [`ERROR`] of every picture, in Markdown.
pub fn table(rows: &[WholeRow]) -> String {
    let columns = LADDER
        .map(|(sr, raster, tolerance)| format!(" {sr} sr, {raster}, {:.0} % |", 100.0 * tolerance));
    let mut out = format!(
        "| scene | quantity | engine, {0:.0} % | rays, {0:.0} % | factor |{1}\n|---|---|---|---|---|{2}",
        100.0 * ERROR,
        columns.concat(),
        "---|".repeat(LADDER.len())
    );
    for row in rows {
        let [engine, rays, factor] = row.times().short();
        let _ =
            write!(out, "\n| {} | {} | {engine} | {rays} | {factor} |", row.scene, row.quantity);
        for (point, gathers) in row.engine.iter().zip(&row.gathers) {
            let (us, error, share) = (point.microseconds, 100.0 * point.error, 100.0 * gathers);
            let _ = write!(out, " {us:.0} µs, {error:.1} %, {share:.0} % |");
        }
    }
    out
}
