//! A scan has no triangles to cast rays at: its sky visibility is compared with that of much finer settings of the engine.

use crate::pictures::{file, write_panels};
use anyhow::{Context, Result};
use pbgi::{
    Aov, AovNames, BakeRequest, CameraChoice, EnvironmentSpec, Frame, FrameRequest, LightSource,
    Progress, ShadeSettings,
};
use pbgi_image::{ToneMap, compare};
use pbgi_store::{Octree, OpenOptions};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// The points.
const FILE: &str = "autzen_stadium.laz";

/// Columns and rows of each picture.
const SIZE: [u32; 2] = [320, 180];

/// Much finer than the default: solid angle, texels along a face.
const FINE: (f32, usize) = (0.01, 32);

/// Receivers whose gather of every surfel tells the error of the cut.
const CHECKED: usize = 100;

/// Brightness of the difference.
const GAIN: f32 = 4.0;

/// Prints the error, and with `pictures` draws; with the caption. None where there is no such file.
///
/// # Errors
///
/// If a step fails.
pub fn run(data: &Path, temporary: &Path, pictures: Option<&Path>) -> Result<Option<String>> {
    let Some(opened) = bake(data, temporary)? else { return Ok(None) };
    let (octree, surfels) = (opened.path().to_owned(), opened.header().surfel_count);
    let plain = ShadeSettings {
        environment: Some(EnvironmentSpec {
            source: LightSource::Uniform([1.0; 3]),
            rotate_degrees: 0.0,
            scale: 1.0,
        }),
        check_receivers: CHECKED,
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        memory_bytes: 1 << 30,
        ..ShadeSettings::default()
    };
    let (solid_angle_sr, raster_edge) = FINE;
    let fine = ShadeSettings { solid_angle_sr, raster_edge, check_receivers: 0, ..plain.clone() };
    let found = shade(&octree, plain)?;
    let truth = shade(&octree, fine)?;
    let (result, reference) = (visibility(&found)?, visibility(&truth)?);
    let error = compare(&result, &reference)?;
    let report = &found.report;
    let us = report.shade_seconds * 1e6 * report.threads as f64 / report.receivers.max(1) as f64;
    let cut = report.check.as_ref().map_or(0.0, |check| check.rrmse);
    let line = format!(
        "{us:.0} core-µs per receiver (elapsed time of all threads); error of its sky visibility {:.1} %, bias {:+.1} %, against the engine with nodes of {solid_angle_sr} sr and \
         {raster_edge} × {raster_edge} texels; against every point's surfel {:.1} %, on its own raster",
        error.rrmse * 100.0,
        error.bias * 100.0,
        cut * 100.0
    );
    println!("scan             visibility {line}");
    let Some(folder) = pictures else { return Ok(None) };
    let off: Vec<f32> = result.iter().zip(&reference).map(|(x, r)| GAIN * (x - r).abs()).collect();
    let gray = |values: &[f32]| values.iter().map(|v| [*v; 3]).collect::<Vec<[f32; 3]>>();
    let panels = [gray(&reference), gray(&result), gray(&off)];
    let tone = ToneMap { exposure: 0.0, filmic: false };
    write_panels(&folder.join(file("scan")), &panels, SIZE[0] as usize, tone)?;
    Ok(Some(format!(
        "![A stadium scanned from the air, its sky visibility by fine and default settings, and the difference](images/{})\n\n\
         *Scan with sky visibility, {} points: much finer settings of the engine itself, since a scan has no triangles for rays; default settings; their difference times {GAIN}. {line}.* \
         `cargo xtask truth --pictures out scan`",
        file("scan"),
        surfels,
    )))
}

/// The octree of the points; none, which is told, where there is no such file.
///
/// # Errors
///
/// If a step fails.
pub fn bake(data: &Path, temporary: &Path) -> Result<Option<Octree>> {
    let input = data.join(FILE);
    if !input.is_file() {
        println!("scan: skipped, no data");
        return Ok(None);
    }
    let output = temporary.join("scan.pbgi");
    let bake = BakeRequest {
        inputs: vec![input.display().to_string()],
        output: output.clone(),
        force: true,
        memory_limit: 1 << 30,
        ..BakeRequest::default()
    };
    pbgi::bake(&bake, &Progress::silent(), &AtomicBool::new(false))?;
    Ok(Some(Octree::open(&output, &OpenOptions::default())?))
}

fn shade(octree: &Path, settings: ShadeSettings) -> Result<Frame> {
    let request = FrameRequest {
        octree,
        scene: None,
        camera: CameraChoice::Default,
        width: SIZE[0],
        height: SIZE[1],
        samples: 4,
        shading_rate: 1.0,
        aovs: vec![Aov::SkyVisibility],
        names: AovNames::default(),
        scratch: None,
        settings,
    };
    Ok(pbgi::shade_frame(&request, &Progress::silent(), &AtomicBool::new(false))?)
}

fn visibility(frame: &Frame) -> Result<Vec<f32>> {
    let image = frame.image()?;
    let found = image.channel("sky_visibility").context("no channel sky_visibility")?;
    Ok(found.to_vec())
}
