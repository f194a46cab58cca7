//! `pbgi demo`: one command from nothing to a picture: a procedural street, a sky with a sun, bake, shade, check.

mod table;

use crate::cli::{self, CommonArgs, EXIT_CODES_HELP};
use clap::Parser;
use pbgi::figures::{format_count, format_seconds, format_table};
use pbgi::{
    BakeReport, BakeRequest, CameraChoice, EnvironmentSpec, FRAME_AOVS, FrameRequest, LightRequest,
    Output, OutputKind, PbgiError, Progress, RunFiles, Sampling, ShadeReport, ShadeSettings,
    SkyParameters, bake, check_writable, procedural_scene, shade_frame, synthetic_sky,
    write_environment_exr,
};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Make a street and a sky, bake, shade and check them, and print one table
///
/// Writes sky.exr, street.pbgi, street.exr, street.png and stats.json into the output folder; files of
/// these names are replaced.
#[derive(Debug, Parser)]
#[command(name = "pbgi-demo", version, after_long_help = EXIT_CODES_HELP, max_term_width = 100)]
pub struct DemoArgs {
    /// Folder for the results
    #[arg(short, long, value_name = "FOLDER", default_value = "out")]
    out: PathBuf,
    /// A large picture of many surfels: 960x540 and 2M instead of 320x180 and 500k
    #[arg(long)]
    full: bool,
    /// The default, which once was asked for
    #[arg(long, hide = true, conflicts_with = "full")]
    quick: bool,
    /// Surfels the street is diced into, such as 2M
    #[arg(long, value_name = "COUNT", value_parser = cli::parse_count)]
    surfels: Option<u64>,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", value_parser = cli::parse_resolution)]
    resolution: Option<[u32; 2]>,
    /// Seed of the street
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Options of every tool
    #[command(flatten)]
    common: CommonArgs,
}

/// Surfels and pixels of the picture that comes soon, and of the large one.
const FIRST_LOOK: (u64, [u32; 2]) = (500_000, [320, 180]);
const FULL: (u64, [u32; 2]) = (2_000_000, [960, 540]);

/// Columns of the sky's image; it is half as high.
const SKY_COLUMNS: usize = 2048;

/// What the picture is gathered with: half the time of the defaults.
const SOLID_ANGLE_SR: f32 = 0.08;
const RASTER_EDGE: usize = 8;

/// Neighbors on one surface that share a gather when the surfels are lit: their light is only seen
/// reflected by others.
const SHARE: usize = 256;

/// Largest solid angle of a node where surfels are lit.
const BAKE_SOLID_ANGLE_SR: f32 = 1.0;

/// Receivers of which the error is measured.
const CHECK_RECEIVERS: usize = 64;

/// Makes the picture.
///
/// # Errors
///
/// If a step fails.
pub fn run(args: &DemoArgs, cancel: &AtomicBool) -> Result<(), PbgiError> {
    Demo::new(args)?.run(cancel)
}

/// The program `pbgi-demo`.
pub fn main() -> ExitCode {
    let args = DemoArgs::parse();
    cli::run("pbgi-demo", |cancel| run(&args, cancel)).into()
}

struct Demo {
    out: PathBuf,
    scene_name: String,
    is_full: bool,
    surfels: u64,
    resolution: [u32; 2],
    shading_rate: f32,
    solid_angle_sr: f32,
    raster_edge: usize,
    common: CommonArgs,
    progress: Progress,
}

impl Demo {
    fn new(args: &DemoArgs) -> Result<Self, PbgiError> {
        args.common.check()?;
        std::fs::create_dir_all(&args.out)
            .map_err(|source| PbgiError::output(&args.out, "create", source))?;
        let (surfels, resolution) = if args.full { FULL } else { FIRST_LOOK };
        Ok(Self {
            out: args.out.clone(),
            scene_name: format!("demo:street?seed={}", args.seed),
            surfels: args.surfels.unwrap_or(surfels),
            resolution: args.resolution.unwrap_or(resolution),
            is_full: args.full,
            shading_rate: 2.5,
            solid_angle_sr: SOLID_ANGLE_SR,
            raster_edge: RASTER_EDGE,
            common: args.common,
            progress: args.common.start_progress(6),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.out.join(name)
    }

    fn run(&self, cancel: &AtomicBool) -> Result<(), PbgiError> {
        let start = Instant::now();
        self.check_files()?;
        self.announce();
        let street = procedural_scene(&self.scene_name)?;
        let sky_path = self.path("sky.exr");
        let sky = SkyParameters { sun_direction: street.sun_direction, ..SkyParameters::default() };
        write_environment_exr(&sky_path, &synthetic_sky(SKY_COLUMNS, SKY_COLUMNS / 2, &sky), &[])?;
        let octree = self.path("street.pbgi");
        let baked = self.bake(&sky_path, &octree, cancel)?;
        let request = FrameRequest {
            octree: &octree,
            scene: Some(&street.scene),
            camera: CameraChoice::Default,
            width: self.resolution[0],
            height: self.resolution[1],
            samples: 8,
            shading_rate: self.shading_rate,
            aovs: FRAME_AOVS.to_vec(),
            names: Default::default(),
            scratch: Some(&self.out),
            settings: ShadeSettings {
                environment: Some(EnvironmentSpec::from_file(&sky_path)),
                check_receivers: CHECK_RECEIVERS,
                threads: self.common.thread_count(),
                memory_bytes: self.common.memory_limit,
                solid_angle_sr: self.solid_angle_sr,
                raster_edge: self.raster_edge,
                interpolation: ShadeSettings::usual_interpolation(None),
                ..ShadeSettings::default()
            },
        };
        let frame = shade_frame(&request, &self.progress, cancel)?;
        frame.write_exr(&self.path("street.exr"))?;
        frame.write_preview(&self.path("street.png"), None)?;
        self.report(&baked, &frame.report, start.elapsed().as_secs_f64())
    }

    /// Refuses to replace what is called like a result and is none.
    fn check_files(&self) -> Result<(), PbgiError> {
        let mut files = RunFiles::default();
        for (name, kind) in [
            ("sky.exr", OutputKind::Picture),
            ("street.pbgi", OutputKind::Octree),
            ("street.exr", OutputKind::Picture),
            ("street.png", OutputKind::Preview),
            ("stats.json", OutputKind::Statistics),
        ] {
            let path = &self.path(name);
            files.add_output(&Output { option: "--out", path, kind, replace: true })?;
            check_writable(path)?;
        }
        Ok(())
    }

    fn bake(
        &self,
        sky: &Path,
        octree: &Path,
        cancel: &AtomicBool,
    ) -> Result<BakeReport, PbgiError> {
        let request = BakeRequest {
            inputs: vec![self.scene_name.clone()],
            output: octree.to_owned(),
            force: true,
            sampling: Sampling::Surfels(self.surfels),
            light: LightRequest {
                environment: Some(EnvironmentSpec::from_file(sky)),
                share: SHARE,
                solid_angle_sr: BAKE_SOLID_ANGLE_SR,
                ..LightRequest::default()
            },
            memory_limit: self.common.memory_limit,
            threads: self.common.thread_count(),
            ..BakeRequest::default()
        };
        bake(&request, &self.progress, cancel)
    }

    fn report(
        &self,
        baked: &BakeReport,
        shaded: &ShadeReport,
        seconds: f64,
    ) -> Result<(), PbgiError> {
        let stats = serde_json::json!({ "bake": baked, "shade": shaded, "seconds": seconds });
        cli::write_json(&self.path("stats.json"), &stats)?;
        let mut rows = table::rows(baked, shaded);
        rows.push(("total", format_seconds(seconds)));
        rows.push(("picture", self.path("street.png").display().to_string()));
        cli::print(&format_table(&rows))?;
        self.tell_what_is_next();
        Ok(())
    }

    /// Tells what will happen.
    fn announce(&self) {
        let [width, height] = self.resolution;
        self.progress.note(&format!(
            "a street under a sky with a sun: bakes {} surfels into {}, lights them, shades a picture of {width}x{height}, \
             and measures its error",
            format_count(self.surfels as f64),
            self.path("street.pbgi").display()
        ));
    }

    /// Tells what to do with what is there now.
    fn tell_what_is_next(&self) {
        let file = |name: &str| self.path(name).display().to_string();
        let (octree, sky) = (file("street.pbgi"), file("sky.exr"));
        let mut lines = vec![
            format!(
                "next: look at {}; all channels are in {}",
                file("street.png"),
                file("street.exr")
            ),
            format!("  pbgi info {octree}"),
            "  pbgi bake YOUR.glb -o your.pbgi".to_owned(),
            format!(
                "  pbgi shade your.pbgi --scene YOUR.glb --env {sky} -o your.exr --preview your.png"
            ),
        ];
        if !self.is_full {
            lines.push(
                "  pbgi demo --full      nine times the pixels, four times the surfels".to_owned(),
            );
        }
        self.progress.note(&lines.join("\n"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn options_are_consistent() {
        DemoArgs::command().debug_assert();
    }
}
