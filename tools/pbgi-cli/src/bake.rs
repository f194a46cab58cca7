//! `pbgi bake`: meshes and point clouds become an octree file of lit surfels.

use crate::advice::check_octree_name;
use crate::cli::{self, CommonArgs, EXIT_CODES_HELP};
use crate::environment::EnvironmentArgs;
use clap::{Parser, ValueEnum};
use pbgi::figures::format_table;
use pbgi::{
    BakeRequest, ClassFilter, CloudOptions, InputKind, InvalidPolicy, LightRequest, NormalsChoice,
    Output, OutputKind, PbgiError, Sampling, TwoSided, UpAxis, check_writable,
};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

/// Bake meshes and point clouds into one octree file of lit surfels
///
/// Inputs are meshes (.glb .gltf .obj .ply), point clouds (.ply .las .laz .ptc, raw surfels), `-` for
/// raw surfels on standard input, octree files (.pbgi), or a procedural scene such as demo:street?seed=1&surfels=2M.
/// Several inputs become one cloud.
#[derive(Debug, Parser)]
#[command(name = "pbgi-bake", version, after_long_help = EXIT_CODES_HELP, max_term_width = 100)]
pub struct BakeArgs {
    /// Meshes, point clouds, octrees, `-`, or demo:NAME
    #[arg(required_unless_present = "relight", value_name = "INPUT")]
    inputs: Vec<String>,
    /// Octree file to write; the first input's name with .pbgi here if not given
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replace the output if it exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    surfels: SurfelArgs,
    #[command(flatten)]
    light: LightArgs,
    #[command(flatten)]
    layout: LayoutArgs,
    /// Keep what the sort and passes of light made until the bake is complete; go on with what a killed run kept
    #[arg(long)]
    resume: bool,
    /// Folder for temporary files; that of the output if not given
    #[arg(long, value_name = "FOLDER")]
    temp_dir: Option<PathBuf>,
    /// Write statistics as JSON; - is standard output
    #[arg(long, value_name = "FILE")]
    stats_json: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArgs,
}

/// How inputs become surfels.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Surfels")]
struct SurfelArgs {
    /// Longest micropolygon edge of meshes, in scene units
    #[arg(long, value_name = "LENGTH", conflicts_with = "surfels", allow_negative_numbers = true)]
    spacing: Option<f32>,
    /// Surfels of all meshes together, such as 2M; a million if not given
    #[arg(long, value_name = "COUNT", value_parser = cli::parse_count)]
    surfels: Option<u64>,
    /// Surfaces with a surfel for each side
    #[arg(long, value_enum, value_name = "WHICH", default_value = "material")]
    two_sided: TwoSidedArg,
    /// Where a cloud has no normals
    #[arg(long, value_enum, value_name = "HOW", default_value = "estimate")]
    normals: NormalsArg,
    /// Upward axis; z for LAS and LAZ, else y
    #[arg(long, value_enum, value_name = "AXIS")]
    up: Option<UpArg>,
    /// LAS classes to read, such as 2,6; withheld points never are
    #[arg(long, value_name = "LIST", value_parser = parse_classes, conflicts_with = "skip_classes")]
    classes: Option<Classes>,
    /// LAS classes to leave out, or none; 7,18 (noise) if not given
    #[arg(long, value_name = "LIST", value_parser = parse_classes)]
    skip_classes: Option<Classes>,
    /// Drop invalid records instead of refusing the file
    #[arg(long)]
    skip_invalid: bool,
}

impl SurfelArgs {
    fn class_filter(&self) -> ClassFilter {
        match (&self.classes, &self.skip_classes) {
            (Some(Classes(only)), _) => ClassFilter::Only(only.clone()),
            (None, Some(Classes(skip))) => ClassFilter::Skip(skip.clone()),
            (None, None) => ClassFilter::default(),
        }
    }
}

/// Classes of LAS points.
#[derive(Clone, Debug)]
struct Classes(Vec<u8>);

/// Numbers separated by commas, or `none`.
fn parse_classes(text: &str) -> Result<Classes, String> {
    if text == "none" {
        return Ok(Classes(Vec::new()));
    }
    let classes: Result<_, _> = text.split(',').map(|class| class.trim().parse()).collect();
    classes.map(Classes).map_err(|_| {
        format!("`{text}` are no classes; expected numbers of 0 to 255 such as 2,6, or none")
    })
}

/// Light stored in surfels.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Light")]
struct LightArgs {
    /// Factor on point and spot lights of glTF files; 0.001464 (1/683) for those of Blender
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, allow_negative_numbers = true)]
    light_scale: f32,
    /// Octree file to light anew instead of inputs; it must store albedo, and no light
    #[arg(long, value_name = "OCTREE", conflicts_with = "inputs")]
    relight: Option<String>,
    /// What an octree stores is emitted light: it was baked without environment and --bounces
    #[arg(long)]
    unlit: bool,
    #[command(flatten)]
    environment: EnvironmentArgs,
    /// How often light passes from surfel to surfel
    #[arg(long, value_name = "N", default_value_t = 0)]
    bounces: u32,
    /// Largest solid angle of a cluster, in steradians
    #[arg(long, value_name = "SR", default_value_t = 0.2)]
    bounce_solid_angle: f32,
    /// Texels along a face of the cube raster
    #[arg(long, value_name = "N", default_value_t = 6)]
    bounce_raster: usize,
    /// Most neighbors on one surface that share a gather; 1 gathers for each
    #[arg(long, value_name = "N", default_value_t = 1)]
    bounce_share: usize,
}

/// Layout of the file.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "File layout")]
struct LayoutArgs {
    /// Bytes a page aims at
    #[arg(long, value_name = "SIZE", default_value = "64KiB", value_parser = cli::parse_bytes)]
    page_bytes: u64,
    /// Most surfels of a leaf
    #[arg(long, value_name = "N", default_value_t = 32)]
    leaf_surfels: usize,
    /// Compress pages
    #[arg(long)]
    lz4: bool,
    /// Store neither light nor albedo
    #[arg(long)]
    occlusion_only: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TwoSidedArg {
    /// Those of double-sided materials
    Material,
    /// All
    All,
    /// None
    None,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum NormalsArg {
    /// Estimate them from neighbors
    Estimate,
    /// Leave surfels isotropic: particles, smoke
    Isotropic,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum UpArg {
    /// +Y
    Y,
    /// +Z
    Z,
}

impl BakeArgs {
    fn request(&self) -> Result<BakeRequest, PbgiError> {
        let Self { surfels, light, layout, .. } = self;
        if light.relight.is_some() && light.environment.spec()?.is_none() && light.bounces == 0 {
            return Err(PbgiError::usage(
                "--relight without light; add --env, --env-color or --bounces",
            ));
        }
        let inputs: Vec<String> = light.relight.iter().chain(&self.inputs).cloned().collect();
        let environment = light.environment.spec()?;
        let invalid =
            if surfels.skip_invalid { InvalidPolicy::Skip } else { InvalidPolicy::Refuse };
        Ok(BakeRequest {
            output: self.output.clone().map_or_else(|| default_output(&inputs[0]), Ok)?,
            inputs,
            unlit: light.unlit,
            force: self.force,
            sampling: match (surfels.spacing, surfels.surfels) {
                (Some(spacing), _) => Sampling::Spacing(spacing),
                (None, Some(count)) => Sampling::Surfels(count),
                (None, None) => Sampling::default(),
            },
            two_sided: match surfels.two_sided {
                TwoSidedArg::Material => TwoSided::Material,
                TwoSidedArg::All => TwoSided::All,
                TwoSidedArg::None => TwoSided::None,
            },
            light_scale: light.light_scale,
            cloud: CloudOptions {
                invalid,
                classes: surfels.class_filter(),
                ..CloudOptions::default()
            },
            up: surfels.up.map(|up| match up {
                UpArg::Y => UpAxis::Y,
                UpArg::Z => UpAxis::Z,
            }),
            normals: match surfels.normals {
                NormalsArg::Estimate => NormalsChoice::Estimate,
                NormalsArg::Isotropic => NormalsChoice::Isotropic,
            },
            light: LightRequest {
                environment,
                bounces: light.bounces,
                solid_angle_sr: light.bounce_solid_angle,
                raster_edge: light.bounce_raster,
                share: light.bounce_share,
            },
            resume: self.resume,
            temp_dir: self.temp_dir.clone(),
            memory_limit: self.common.memory_limit,
            threads: self.common.thread_count(),
            page_bytes: usize::try_from(layout.page_bytes).unwrap_or(usize::MAX),
            leaf_surfels_max: layout.leaf_surfels,
            compress: layout.lz4,
            occlusion_only: layout.occlusion_only,
        })
    }
}

/// The input's name with the octree's extension, in the current folder.
fn default_output(input: &str) -> Result<PathBuf, PbgiError> {
    if input == "-" {
        return Err(PbgiError::usage("standard input has no name; name the output (-o)"));
    }
    if InputKind::is_procedural_name(input) {
        let name = input.trim_start_matches("demo:").split('?').next().unwrap_or_default();
        return Ok(PathBuf::from(format!("{name}.pbgi")));
    }
    match Path::new(input).file_stem() {
        Some(stem) => {
            let mut name = stem.to_owned();
            name.push(".pbgi");
            Ok(PathBuf::from(name))
        }
        None => Err(PbgiError::usage(format!("{input} is no file name; name the output (-o)"))),
    }
}

/// Bakes as asked for.
///
/// # Errors
///
/// As [`pbgi::bake`], or if the arguments contradict each other.
pub fn run(args: &BakeArgs, cancel: &AtomicBool) -> Result<(), PbgiError> {
    args.common.check()?;
    args.output.as_deref().map_or(Ok(()), check_octree_name)?;
    let request = args.request()?;
    let statistics = args.stats_json.as_deref().filter(|path| *path != Path::new("-"));
    if let Some(path) = statistics {
        let kind = OutputKind::Statistics;
        let output = Output { option: "--stats-json", path, kind, replace: true };
        request.files()?.add_output(&output)?;
        check_writable(path)?;
    }
    let progress = args.common.start_progress(2);
    let report = pbgi::bake(&request, &progress, cancel)?;
    let json_on_stdout = args.stats_json.as_deref() == Some(Path::new("-"));
    if !json_on_stdout {
        cli::print(&format_table(&report.rows()))?;
    }
    args.stats_json.as_deref().map_or(Ok(()), |path| cli::write_json(path, &report))?;
    args.common.judge(&report.warnings)
}

/// The program `pbgi-bake`.
pub fn main() -> ExitCode {
    let args = BakeArgs::parse();
    cli::run("pbgi-bake", |cancel| run(&args, cancel)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn options_are_consistent() {
        BakeArgs::command().debug_assert();
    }

    #[test]
    fn classes_are_read() {
        let filter = |words: &[&str]| {
            let all = ["pbgi-bake", "a.las"].iter().chain(words);
            BakeArgs::try_parse_from(all).map(|args| args.surfels.class_filter())
        };
        assert_eq!(filter(&[]).unwrap(), ClassFilter::Skip(vec![7, 18]));
        assert_eq!(filter(&["--classes", "2, 6"]).unwrap(), ClassFilter::Only(vec![2, 6]));
        assert_eq!(filter(&["--skip-classes", "none"]).unwrap(), ClassFilter::Skip(Vec::new()));
        for bad in ["", "2,", "256", "-1", "ground"] {
            assert!(filter(&["--skip-classes", bad]).is_err(), "{bad}");
        }
        assert!(filter(&["--classes", "2", "--skip-classes", "7"]).is_err());
    }

    #[test]
    fn outputs_are_named_after_inputs() {
        for (input, output) in [
            ("models/a.b.ply", "a.b.pbgi"),
            ("demo:street?seed=2", "street.pbgi"),
            ("scan.laz", "scan.pbgi"),
        ] {
            assert_eq!(default_output(input).unwrap(), Path::new(output));
        }
        assert_eq!(default_output("-").unwrap_err().exit_code(), pbgi::EXIT_MISUSED);
        assert!(default_output("..").is_err());
    }

    #[test]
    fn short_help_fits_a_screen() {
        let help = BakeArgs::command().render_help().to_string();
        assert!(help.lines().count() <= 60, "{help}");
    }
}
