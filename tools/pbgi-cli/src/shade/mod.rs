//! `pbgi shade`: gathers light from an octree file, for pictures with many channels or for points.

pub mod args;
mod frames;

use crate::advice::check_octree;
use crate::cli;
use args::{ShadeArgs, SpaceArg};
use clap::Parser;
use frames::Frames;
use pbgi::figures::format_table;
use pbgi::{
    FRAME_AOVS, Frame, FrameRequest, GBUFFER_AOVS, GBufferRequest, GBufferSpace, Output,
    OutputKind, PbgiError, PointSource, PointsRequest, Progress, RunFiles, Scene, ShadeReport,
    ShadeSettings, check_suffix, check_writable, load_scene_within, shade_frame, shade_gbuffer,
    shade_points,
};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

/// The program `pbgi-shade`.
pub fn main() -> ExitCode {
    let args = ShadeArgs::parse();
    cli::run("pbgi-shade", |cancel| run(&args, cancel)).into()
}

/// Shades as asked for.
///
/// # Errors
///
/// As the facade, or if the arguments contradict each other.
pub fn run(args: &ShadeArgs, cancel: &AtomicBool) -> Result<(), PbgiError> {
    args.common.check()?;
    let mut scenes = SceneCache::default();
    let Some(frames) = &args.animation.frames else {
        let mut files = RunFiles::default();
        add_inputs(args, &mut files)?;
        add_outputs(args, &mut files)?;
        return shade_one(args, &mut scenes, &mut files, cancel);
    };
    frames::check(args)?;
    let mut files = files_of_all(args, frames)?;
    for number in frames.numbers() {
        if !args.common.quiet {
            cli::tell(&format!("frame {number}"));
        }
        shade_one(&frames::args_of(args, number), &mut scenes, &mut files, cancel)?;
    }
    Ok(())
}

/// The files of an animation: no frame may replace what another one reads.
fn files_of_all(args: &ShadeArgs, frames: &Frames) -> Result<RunFiles, PbgiError> {
    let mut files = RunFiles::default();
    for number in frames.numbers() {
        add_inputs(&frames::args_of(args, number), &mut files)?;
    }
    for number in frames.numbers() {
        add_outputs(&frames::args_of(args, number), &mut files)?;
    }
    Ok(files)
}

fn add_inputs(args: &ShadeArgs, files: &mut RunFiles) -> Result<(), PbgiError> {
    let others =
        [&args.view.camera_file, &args.gbuffer.gbuffer, &args.points.receivers, &args.light.env];
    files.add_input(&args.octree)?;
    others.into_iter().flatten().try_for_each(|path| files.add_input(path))?;
    files.add_named_inputs(&args.view.scene)
}

fn add_outputs(args: &ShadeArgs, files: &mut RunFiles) -> Result<(), PbgiError> {
    outputs(args).iter().try_for_each(|output| files.add_output(output))
}

/// What is written, but to standard output.
fn outputs(args: &ShadeArgs) -> Vec<Output<'_>> {
    let is_points = args.points.surfels || args.points.receivers.is_some();
    let (kind, replace) =
        if is_points { (OutputKind::Points, args.force) } else { (OutputKind::Picture, true) };
    let mut outputs = vec![Output { option: "-o", path: &args.output, kind, replace }];
    let options = &args.output_options;
    for (option, path, kind) in [
        ("--preview", &options.preview, OutputKind::Preview),
        ("--contact-sheet", &options.contact_sheet, OutputKind::Preview),
        ("--stats-json", &options.stats_json, OutputKind::Statistics),
        ("--trace-pages", &args.store.trace_pages, OutputKind::Trace),
    ] {
        let path = path.as_deref().filter(|path| *path != Path::new("-"));
        outputs.extend(path.map(|path| Output { option, path, kind, replace: true }));
    }
    outputs
}

/// The scene of the frame before, which most animations share.
#[derive(Default)]
struct SceneCache(Option<(String, Scene)>);

impl SceneCache {
    /// The scene called `name`; its warnings are given when it is read.
    fn load(
        &mut self,
        name: &str,
        memory_limit: u64,
        warnings: &mut Vec<String>,
    ) -> Result<&Scene, PbgiError> {
        let known = self.0.take().filter(|(known, _)| known == name);
        let entry = match known {
            Some(entry) => entry,
            None => {
                let scene = load_scene_within(name, memory_limit)?;
                warnings.extend(scene.warnings.iter().map(|warning| format!("{name}: {warning}")));
                (name.to_owned(), scene)
            }
        };
        Ok(&self.0.insert(entry).1)
    }
}

fn shade_one(
    args: &ShadeArgs,
    scenes: &mut SceneCache,
    files: &mut RunFiles,
    cancel: &AtomicBool,
) -> Result<(), PbgiError> {
    let progress = args.common.start_progress(2);
    let settings = settings(args)?;
    settings.validate()?;
    check_octree(&args.octree, args.view.scene.as_deref())?;
    outputs(args).iter().try_for_each(|output| check_writable(output.path))?;
    let output = &args.output_options;
    if args.points.receivers.is_none() && !args.points.surfels {
        check_suffix(&args.output, &["exr"], "pictures")?;
    }
    for path in [&output.preview, &output.contact_sheet].into_iter().flatten() {
        check_suffix(path, &["png"], "previews")?;
    }
    let mut warnings = Vec::new();
    let mut report = match &args.points.receivers {
        Some(path) => points(args, PointSource::File(path.clone()), settings, &progress, cancel),
        None if args.points.surfels => {
            points(args, PointSource::Surfels, settings, &progress, cancel)
        }
        None => match &args.gbuffer.gbuffer {
            Some(path) => gbuffer(args, path, settings, &progress, cancel),
            None => {
                if let Some(name) = &args.view.scene {
                    let limit = args.common.memory_limit;
                    let scene = scenes.load(name, limit, &mut warnings)?;
                    scene.files.iter().try_for_each(|file| files.add_input(file))?;
                }
                picture(args, scenes, settings, &progress, cancel)
            }
        },
    }?;
    report.warnings.splice(0..0, warnings);
    for warning in &report.warnings {
        progress.warn(warning);
    }
    if let Some(path) = &output.stats_json {
        cli::write_json(path, &report)?;
    }
    // Standard output is the statistics' own where they were asked for there.
    let is_table_wanted =
        !args.common.quiet && output.stats_json.as_ref().is_none_or(|path| path.as_os_str() != "-");
    if is_table_wanted {
        cli::print(&format_table(&report.rows()))?;
        if output.stats {
            cli::print(&format_table(&report.statistics()))?;
        }
    }
    args.common.judge(&report.warnings)
}

fn settings(args: &ShadeArgs) -> Result<ShadeSettings, PbgiError> {
    Ok(ShadeSettings {
        solid_angle_sr: args.quality.solid_angle,
        target_error: args.quality.target_error(),
        interpolation: args.quality.interpolation(),
        importance: args.quality.importance,
        gloss: args.gloss.settings(),
        raster_edge: args.quality.raster,
        directions: args.quality.directions,
        bias: args.quality.bias,
        environment: args.light.spec()?,
        check_receivers: args.quality.check,
        threads: args.common.thread_count(),
        memory_bytes: args.common.memory_limit,
        io: args.store.settings(),
    })
}

fn picture(
    args: &ShadeArgs,
    scenes: &mut SceneCache,
    settings: ShadeSettings,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ShadeReport, PbgiError> {
    let aovs = args.output_options.parse_aovs(&FRAME_AOVS, &settings)?;
    let limit = args.common.memory_limit;
    let mut warnings = Vec::new();
    let scene = args.view.scene.as_deref();
    let scene = scene.map(|name| scenes.load(name, limit, &mut warnings)).transpose()?;
    let request = FrameRequest {
        octree: &args.octree,
        scene,
        camera: args.view.camera(args.animation.camera_turned),
        width: args.view.resolution[0],
        height: args.view.resolution[1],
        samples: args.view.samples,
        shading_rate: args.view.shading_rate,
        aovs,
        names: args.output_options.names(),
        scratch: scratch_folder(&args.output),
        settings,
    };
    let mut report = write_frame(args, shade_frame(&request, progress, cancel)?)?;
    report.warnings.splice(0..0, warnings);
    Ok(report)
}

/// Where rows of a picture may wait on disk: beside it, if it is a file.
fn scratch_folder(output: &Path) -> Option<&Path> {
    if std::fs::metadata(output).is_ok_and(|found| !found.is_file()) {
        return None;
    }
    let folder = output.parent()?;
    Some(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
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
        camera: args.view.camera(args.animation.camera_turned),
        space: match args.gbuffer.gbuffer_space {
            SpaceArg::World => GBufferSpace::World,
            SpaceArg::Camera => GBufferSpace::Camera,
        },
        up: args.gbuffer.gbuffer_up.map(Into::into),
        scale: args.gbuffer.gbuffer_scale,
        pass_through: args.gbuffer.pass_through,
        aovs: args.output_options.parse_aovs(&GBUFFER_AOVS, &settings)?,
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
    if let Some(path) = &args.output_options.contact_sheet {
        frame.write_contact_sheet(path, args.output_options.exposure.stops())?;
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
    if args.output_options.preview.is_some() || args.output_options.contact_sheet.is_some() {
        let message = "--preview and --contact-sheet belong to a picture; points have none";
        return Err(PbgiError::usage(message));
    }
    let eye = args.points.eye.map(Into::into);
    let request =
        PointsRequest { octree: &args.octree, source, target: &args.output, eye, settings };
    shade_points(&request, progress, cancel)
}
