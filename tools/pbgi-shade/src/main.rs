//! Gathers light from an octree file: pictures with many channels, or results for points.
#![forbid(unsafe_code)]

mod args;

use args::{ShadeArgs, SpaceArg};
use clap::Parser;
use pbgi::cli::{self, format_table};
use pbgi::{
    FRAME_AOVS, Frame, FrameRequest, GBUFFER_AOVS, GBufferRequest, GBufferSpace, PbgiError,
    PointSource, PointsRequest, Progress, ShadeReport, ShadeSettings, check_writable, load_scene,
    refuse_to_overwrite, shade_frame, shade_gbuffer, shade_points,
};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

fn main() -> ExitCode {
    let args = ShadeArgs::parse();
    cli::run("pbgi-shade", |cancel| shade(&args, cancel))
}

fn shade(args: &ShadeArgs, cancel: &AtomicBool) -> Result<(), PbgiError> {
    args.common.check()?;
    let progress = args.common.start_progress(2);
    let settings = settings(args);
    settings.validate()?;
    let output = &args.output_options;
    for path in output.stats_json.iter().chain(&output.preview) {
        if path.as_os_str() != "-" {
            check_writable(path)?;
        }
    }
    check_writable(&args.output)?;
    let report = match &args.points.receivers {
        Some(path) => points(args, PointSource::File(path.clone()), settings, &progress, cancel),
        None if args.points.surfels => {
            points(args, PointSource::Surfels, settings, &progress, cancel)
        }
        None => match &args.gbuffer.gbuffer {
            Some(path) => gbuffer(args, path, settings, &progress, cancel),
            None => picture(args, settings, &progress, cancel),
        },
    }?;
    for warning in &report.warnings {
        progress.warn(warning);
    }
    if let Some(path) = &output.stats_json {
        cli::write_json(path, &report)?;
    }
    // Standard output is the statistics' own where they were asked for there.
    let is_table_wanted =
        !args.common.quiet && output.stats_json.as_ref().is_none_or(|path| path.as_os_str() != "-");
    if is_table_wanted { cli::print(&format_table(&report.rows())) } else { Ok(()) }
}

fn settings(args: &ShadeArgs) -> ShadeSettings {
    ShadeSettings {
        solid_angle_sr: args.quality.solid_angle,
        raster_edge: args.quality.raster,
        bias: args.quality.bias,
        environment: args.light.environment(),
        check_receivers: args.quality.check,
        threads: args.common.thread_count(),
        memory_bytes: args.common.memory_limit,
    }
}

fn picture(
    args: &ShadeArgs,
    settings: ShadeSettings,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ShadeReport, PbgiError> {
    let aovs = args.output_options.parse_aovs(&FRAME_AOVS)?;
    let scene = args.view.scene.as_deref().map(load_scene).transpose()?;
    for warning in scene.iter().flat_map(|scene| &scene.warnings) {
        progress.warn(warning);
    }
    let request = FrameRequest {
        octree: &args.octree,
        scene: scene.as_ref(),
        camera: args.view.camera(),
        width: args.view.resolution[0],
        height: args.view.resolution[1],
        samples: args.view.samples,
        shading_rate: args.view.shading_rate,
        share_pixels: args.view.share,
        aovs,
        names: args.output_options.names(),
        settings,
    };
    write_frame(args, shade_frame(&request, progress, cancel)?)
}

fn gbuffer(
    args: &ShadeArgs,
    path: &Path,
    settings: ShadeSettings,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ShadeReport, PbgiError> {
    let request = GBufferRequest {
        octree: &args.octree,
        gbuffer: path,
        camera: args.view.camera(),
        space: match args.gbuffer.gbuffer_space {
            SpaceArg::World => GBufferSpace::World,
            SpaceArg::Camera => GBufferSpace::Camera,
        },
        pass_through: args.gbuffer.pass_through,
        aovs: args.output_options.parse_aovs(&GBUFFER_AOVS)?,
        names: args.output_options.names(),
        settings,
    };
    write_frame(args, shade_gbuffer(&request, progress, cancel)?)
}

fn write_frame(args: &ShadeArgs, frame: Frame) -> Result<ShadeReport, PbgiError> {
    frame.write_exr(&args.output)?;
    if let Some(path) = &args.output_options.preview {
        frame.write_preview(path, args.output_options.exposure.stops())?;
    }
    Ok(frame.report)
}

fn points(
    args: &ShadeArgs,
    source: PointSource,
    settings: ShadeSettings,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ShadeReport, PbgiError> {
    if args.output_options.preview.is_some() {
        return Err(PbgiError::usage("--preview belongs to a picture; points have none"));
    }
    refuse_to_overwrite(&args.output, args.force)?;
    let request = PointsRequest { octree: &args.octree, source, target: &args.output, settings };
    shade_points(&request, progress, cancel)
}
