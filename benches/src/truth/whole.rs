//! A whole picture, or all surfels of a file, as its user pays for it: every receiver, those that gather and those that do not, beside truth for a sample of
//! them.

use crate::cases::{Case, Light, Quantity};
use crate::curve::Point;
use crate::engine::{Setting, gather_all, light_of};
use crate::paths::{RayCurve, Truth, without_noise};
use crate::report::Times;
use anyhow::Result;
use pbgi_benches::Caster;
use pbgi_cloud::Surfel;
use pbgi_file::platform::processor_seconds;
use pbgi_format::LeafSurfel;
use pbgi_gather::{GatherSettings, Receiver};
use pbgi_image::compare;
use pbgi_math::Vec3;
use pbgi_scene::{Camera, Scene};
use pbgi_schedule::{Feed, KeptRecords, ScheduleError, ShadeOptions, shade_stream};
use pbgi_store::{Octree, StoreError, try_for_each_leaf};
use serde::Serialize;
use std::borrow::Cow;
use std::fmt::{self, Write as _};

/// Rows of a band: what pictures are shaded by.
const ROWS: usize = 64;

/// How many times fewer of reflections, none of which is interpolated.
const GLOSSY_PART: usize = 32;

/// How many times fewer chunks of surfels than bands of pictures: there are seven times as many.
const SURFELS_PART: usize = 4;

/// Surfels that are shaded at once.
const CHUNK: usize = 1 << 14;

/// Receivers whose truth is found.
const SAMPLE: usize = 600;

/// Most paths of the truth: fires want many.
const PATHS: u32 = 1 << 16;

/// Much finer than the default: solid angle, texels along a face.
const FINE: (f32, usize) = (0.01, 32);

/// Settings from coarse to fine: solid angle, raster, share that interpolation may be wrong by.
const LADDER: [(f32, usize, f32); 10] = [
    (1.0, 4, 0.4),
    (0.3, 4, 0.4),
    (1.5, 8, 0.2),
    (0.6, 8, 0.2),
    (0.4, 8, 0.4),
    (0.3, 8, 0.2),
    (0.15, 8, 0.2),
    (0.1, 8, 0.4),
    (0.1, 16, 0.4),
    (0.03, 16, 0.1),
];

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

/// What is shaded as one, with the truth of a sample of it.
struct Job<'a> {
    scene: String,
    case: &'a Case,
    octree: &'a Octree,
    /// Receivers, by what is shaded at once.
    groups: Vec<Vec<Receiver>>,
}

/// What results are compared with.
struct Reference {
    light: Vec<Light>,
    /// rRMSE of each quantity, and the rays' curve.
    noise: Vec<f64>,
    rays: Vec<Vec<Point>>,
}

/// From one receiver that is compared to the next: odd, so that columns of a picture are met alike.
fn sample_step(receivers: usize) -> usize {
    (receivers / SAMPLE).max(1) | 1
}

impl Job<'_> {
    fn sample(&self) -> Vec<(usize, Receiver)> {
        let all = self.groups.iter().flatten().copied().enumerate();
        all.step_by(sample_step(self.count())).collect()
    }

    fn count(&self) -> usize {
        self.groups.iter().map(Vec::len).sum()
    }

    /// Truth by rays, and how long rays take for an error.
    fn cast(&self, caster: &Caster, noise: f64) -> Result<Reference> {
        let (case, sample) = (self.case, self.sample());
        let truth = Truth::cast(case, caster, &sample, noise, PATHS)?;
        let curve = RayCurve::cast(case, caster, &sample, &truth);
        let of_all = case.quantities().iter();
        Ok(Reference {
            noise: of_all.clone().map(|q| truth.noise(*q)).collect::<Result<_>>()?,
            rays: of_all.map(|q| curve.points(*q, &truth)).collect::<Result<_>>()?,
            light: truth.light,
        })
    }

    /// What much finer settings find, receiver by receiver.
    fn gather_finely(&self) -> Result<Reference> {
        let (solid_angle_sr, raster_edge) = FINE;
        let fine = Setting { solid_angle_sr, raster_edge, ..Setting::default() };
        let (light, _) = gather_all(self.case, self.octree, &fine, &self.sample())?;
        Ok(Reference { light, noise: vec![0.0], rays: vec![Vec::new()] })
    }

    /// Shades all by every setting.
    fn run(&self, quantities: &[Quantity], reference: &Reference) -> Result<Vec<WholeRow>> {
        let mut runs = Vec::new();
        for (solid_angle_sr, raster_edge, tolerance) in LADDER {
            // Two directions of a reflection for three texels of the raster.
            let lobe_level = raster_edge.ilog2() - 1;
            let setting = Setting { solid_angle_sr, raster_edge, lobe_level, ..Setting::default() };
            // Reflections are never interpolated.
            let tolerance = if self.case.gloss.is_some() { 0.0 } else { tolerance };
            let (found, seconds, gathers) = self.shade(&setting, tolerance)?;
            let found: Vec<Light> = found.into_iter().step_by(sample_step(self.count())).collect();
            let label = format!("{}, {tolerance}", setting.quality(self.case));
            let of_receivers = 1.0 / self.count().max(1) as f64;
            let microseconds = 1e6 * seconds * of_receivers;
            runs.push((label, found, microseconds, gathers as f64 * of_receivers));
        }
        let row = |(index, quantity): (usize, &Quantity)| -> Result<WholeRow> {
            let expected = quantity.values(&reference.light);
            let mut engine = Vec::new();
            for (setting, found, microseconds, _) in &runs {
                let rrmse = compare(&quantity.values(found), &expected)?.rrmse;
                let error = without_noise(rrmse, reference.noise[index]);
                engine.push(Point { setting: setting.clone(), microseconds: *microseconds, error });
            }
            Ok(WholeRow {
                scene: self.scene.clone(),
                quantity: quantity.name(),
                receivers: self.count(),
                gathers: runs.iter().map(|run| run.3).collect(),
                engine,
                rays: reference.rays[index].clone(),
            })
        };
        quantities.iter().enumerate().map(row).collect()
    }

    /// Results of all receivers, processor seconds, and how many gathered.
    fn shade(&self, setting: &Setting, tolerance: f32) -> Result<(Vec<Light>, f64, u64)> {
        let case = self.case;
        let gather = GatherSettings { tolerance, ..setting.gather(case) };
        let options = ShadeOptions { gather, threads: 1, ..ShadeOptions::default() };
        let light = setting.light(case)?;
        let mut found = Vec::new();
        let before = processor_seconds().unwrap_or_default();
        let report = shade_stream(
            self.octree,
            light.as_ref(),
            &options,
            &mut KeptRecords::default(),
            |feed: &mut Feed<'_, '_, (), ScheduleError>| {
                self.groups.iter().try_for_each(|group| feed.push(Cow::Borrowed(group), ()))
            },
            |chunk| {
                found.extend(chunk.shadings.iter().map(light_of));
                Ok(())
            },
        )?;
        let seconds = processor_seconds().unwrap_or_default() - before;
        Ok((found, seconds, report.cut_sizes.count))
    }
}

/// Shades a picture `width` pixels wide, or every `nth` band of it.
///
/// # Errors
///
/// If the octree cannot be read, or values are not finite.
pub fn picture(
    case: &Case,
    caster: &Caster,
    octree: &Octree,
    (width, nth): (u32, usize),
    noise: f64,
) -> Result<Vec<WholeRow>> {
    let view = case.view(width);
    // Reflections are not interpolated: fewer rows tell what they cost at this density.
    let rows = if case.gloss.is_some() { ROWS / GLOSSY_PART } else { ROWS };
    let nth = if case.gloss.is_some() { nth * GLOSSY_PART } else { nth };
    let band = |pixel: usize| pixel / view.width as usize / rows;
    let mut places = case.receivers(caster, &view);
    places.retain(|(pixel, _)| band(*pixel).is_multiple_of(nth));
    let bands = places.chunk_by(|a, b| band(a.0) == band(b.0));
    let groups = bands.map(|band| band.iter().map(|place| place.1).collect()).collect();
    let job = Job { scene: case.name.clone(), case, octree, groups };
    job.run(case.quantities(), &job.cast(caster, noise)?)
}

/// Shades a scene's `surfels`, or every `nth` chunk of them, in the order in which its octree has them, but where they are: where a file's rounding has moved
/// them, some lie below what rays meet.
///
/// # Errors
///
/// As of [`picture`].
pub fn surfels(
    case: &Case,
    caster: &Caster,
    octree: &Octree,
    (mut surfels, nth): (Vec<Surfel>, usize),
    noise: f64,
) -> Result<Vec<WholeRow>> {
    let root = octree.header().root;
    surfels.sort_by_cached_key(|surfel| root.code(surfel.center()));
    let receiver = |surfel: &Surfel| Receiver::diffuse(surfel.center(), surfel.normal());
    let receivers: Vec<Receiver> = surfels.iter().map(receiver).collect();
    let scene = format!("{} surfels", case.name);
    let job = Job { scene, case, octree, groups: chunks(&receivers, nth) };
    job.run(case.quantities(), &job.cast(caster, noise)?)
}

/// Shades all points of a scan, or every `nth` chunk of them; truth is what much finer settings find, as a scan has no triangles for rays.
///
/// # Errors
///
/// As of [`picture`].
pub fn points(octree: &Octree, nth: usize) -> Result<Vec<WholeRow>> {
    let camera = Camera::look_at(Vec3::Z, Vec3::ZERO, Vec3::Y, 1.0);
    let case = Case::new("scan points", "", Scene::default(), camera);
    let up = if octree.header().flags.z_up { Vec3::Z } else { Vec3::Y };
    let mut receivers = Vec::new();
    try_for_each_leaf(&mut octree.reader(), |_, surfels| {
        let normal = |surfel: &LeafSurfel| if surfel.isotropic { up } else { surfel.normal };
        receivers.extend(surfels.iter().map(|s| Receiver::diffuse(s.center, normal(s))));
        Ok::<(), StoreError>(())
    })?;
    let groups = chunks(&receivers, nth);
    let job = Job { scene: case.name.clone(), case: &case, octree, groups };
    job.run(&[Quantity::Occlusion], &job.gather_finely()?)
}

/// The chunks that receivers are shaded by, those of every `nth` band.
fn chunks(receivers: &[Receiver], nth: usize) -> Vec<Vec<Receiver>> {
    receivers.chunks(CHUNK).step_by(nth * SURFELS_PART).map(<[Receiver]>::to_vec).collect()
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
