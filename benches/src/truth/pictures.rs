//! Truth, engine and their difference, side by side.

use crate::cases::{Case, Light, Quantity};
use crate::engine::{Setting, gather_all};
use crate::paths::Truth;
use crate::report::{Row, short};
use anyhow::{Context, Result};
use pbgi_benches::{Caster, SkyImage};
use pbgi_image::{ToneMap, auto_exposure, write_png};
use pbgi_store::Octree;
use std::f32::consts::PI;
use std::path::Path;

/// Columns of each of the three pictures.
const WIDTH: u32 = 320;

/// Paths per pixel of the truth: less noise than is seen.
const PATHS: u32 = 512;

/// Brightness of a difference.
const DIFFERENCE_GAIN: f32 = 4.0;

/// Columns of white between pictures.
const GAP: usize = 4;

/// Draws what the case's camera sees into `folder`; with the core-seconds of the engine.
///
/// # Errors
///
/// If the octree cannot be read or the picture not be written.
pub fn draw(
    case: &Case,
    caster: &Caster,
    octree: &Octree,
    setting: &Setting,
    folder: &Path,
) -> Result<f64> {
    let view = case.view(WIDTH);
    let places = case.receivers(caster, &view);
    let (found, us) = gather_all(case, octree, setting, &places)?;
    let truth = Truth::cast(case, caster, &places, 0.0, PATHS)?;
    let sky = case.sky.clone().map(SkyImage::new);
    let count = (view.width * view.height) as usize;
    let mut panels = vec![vec![[0f32; 3]; count]; 3];
    let mut colors = vec![[0f32; 3]; count];
    for index in 0..count {
        let (column, row) = (index as u32 % view.width, index as u32 / view.width);
        let (eye, direction) = view.ray(column as f32 + 0.5, row as f32 + 0.5);
        let hit = caster.cast(eye, direction);
        let seen = match (&hit, &sky) {
            (Some(hit), _) => caster.emission(hit),
            (None, Some(sky)) => sky.radiance(direction),
            (None, None) => [0.0; 3],
        };
        colors[index] = hit.map_or([0.0; 3], |hit| caster.albedo(&hit));
        panels[0][index] = seen;
        panels[1][index] = seen;
    }
    for (i, (pixel, _)) in places.iter().enumerate() {
        let both = [&truth.light[i], &found[i]].map(|light| outgoing(case, light, colors[*pixel]));
        for (panel, light) in both.into_iter().enumerate() {
            let shown = &mut panels[panel][*pixel];
            *shown = std::array::from_fn(|c| shown[c] + light[c]);
        }
        let off = |c: usize| DIFFERENCE_GAIN * (both[1][c] - both[0][c]).abs();
        panels[2][*pixel] = std::array::from_fn(off);
    }
    let lit: Vec<[f32; 3]> = places.iter().map(|(pixel, _)| panels[0][*pixel]).collect();
    let tone = ToneMap { exposure: auto_exposure(&lit, None), filmic: true };
    write_panels(&folder.join(file(&case.name)), &panels, view.width as usize, tone)?;
    Ok(us * places.len() as f64 * 1e-6)
}

/// Name of the picture of a case.
pub fn file(name: &str) -> String {
    format!("truth-{name}.png")
}

/// Radiance that what is compared brings to the eye.
fn outgoing(case: &Case, light: &Light, color: [f32; 3]) -> [f32; 3] {
    match case.quantities().last() {
        Some(Quantity::Reflection) => light.reflected,
        _ => std::array::from_fn(|c| color[c] / PI * light.irradiance[c]),
    }
}

/// Pictures of one width side by side.
///
/// # Errors
///
/// If the file cannot be written.
pub fn write_panels(
    path: &Path,
    panels: &[Vec<[f32; 3]>],
    width: usize,
    tone: ToneMap,
) -> Result<()> {
    let rows = panels.iter().map(|p| p.len() / width).min().unwrap_or(0);
    let white = [1e3 * (-tone.exposure).exp2(); 3];
    let mut pixels = Vec::new();
    for row in 0..rows {
        for (index, panel) in panels.iter().enumerate() {
            if index > 0 {
                pixels.extend([white; GAP]);
            }
            pixels.extend_from_slice(&panel[row * width..(row + 1) * width]);
        }
    }
    let columns = panels.len() * (width + GAP) - GAP;
    write_png(path, columns, rows, &pixels, tone).with_context(|| path.display().to_string())
}

/// What the documentation says under a picture.
pub fn caption(case: &Case, row: &Row, surfels: u64, core_seconds: f64) -> String {
    let Case { name, title, .. } = case;
    let bounces = match case.bounces {
        0 => String::new(),
        n => format!(" {n} bounces are baked, as many path-traced."),
    };
    format!(
        "![{title}: path-traced truth, the engine, and their difference](images/{file})\n\n\
         *{title}, {surfels} surfels: truth, engine, and their difference times {DIFFERENCE_GAIN}. The engine takes {core_seconds:.1} core-seconds for the picture, {us:.0} core-µs per \
         receiver; error of its {quantity} {error:.1} %, bias {bias:+.1} % (truth: {noise:.1} % noise). Rays take {rays} times as long for that error.{bounces}* `cargo xtask truth --pictures out {name}`",
        file = file(name),
        us = row.microseconds,
        quantity = row.quantity,
        error = row.rrmse * 100.0,
        bias = row.bias * 100.0,
        noise = row.noise * 100.0,
        rays = short(row.factor()),
    )
}
