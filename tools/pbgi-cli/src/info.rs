//! `pbgi info`: tells what an octree file holds, verifies it, exports its surfels.

use crate::advice::check_octree;
use crate::cli::{self, CommonArgs, EXIT_CODES_HELP, IoMode};
use clap::Parser;
use pbgi::figures::{format_bytes, format_seconds, format_table};
use pbgi::{
    OctreeCheck, OctreeInfo, Output, OutputKind, PbgiError, Progress, RunFiles, check_writable,
};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// Tell what an octree file holds, verify it, export its surfels
#[derive(Debug, Parser)]
#[command(name = "pbgi-info", version, after_long_help = EXIT_CODES_HELP, max_term_width = 100)]
pub struct InfoArgs {
    /// Octree file
    #[arg(value_name = "SCENE.pbgi")]
    file: PathBuf,
    /// Read every page and check every invariant
    #[arg(long)]
    verify: bool,
    /// Count levels, leaf sizes, lobes and page sizes (verifies, too)
    #[arg(long)]
    histogram: bool,
    /// How the file is read to be verified
    #[arg(long, value_enum, value_name = "HOW", default_value = "read", hide_short_help = true)]
    io: IoMode,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    /// Write all surfels to this file, in the file's order: .ply, or .ptc for RenderMan
    #[arg(long, value_name = "OUT.ply|OUT.ptc")]
    points: Option<PathBuf>,
    /// Replace the file of --points if it exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    common: CommonArgs,
}

/// Tells what was asked for.
///
/// # Errors
///
/// If the file cannot be read or is damaged.
pub fn run(args: &InfoArgs, cancel: &AtomicBool) -> Result<(), PbgiError> {
    args.common.check()?;
    check_octree(&args.file, None)?;
    if let Some(path) = &args.points {
        let mut files = RunFiles::default();
        files.add_input(&args.file)?;
        let (kind, replace) = (OutputKind::Points, args.force);
        files.add_output(&Output { option: "--points", path, kind, replace })?;
        check_writable(path)?;
    }
    let info = OctreeInfo::read(&args.file, args.common.memory_limit)?;
    let is_read = args.verify || args.histogram;
    let progress =
        args.common.start_progress(u32::from(is_read) + u32::from(args.points.is_some()));
    if !args.json {
        cli::print(&format_table(&info.rows()))?;
    }
    let check =
        is_read.then(|| check_file(args, info.file_bytes, &progress, cancel)).transpose()?;
    if let Some(check) = &check
        && !args.json
    {
        print_check(args, check)?;
    }
    if args.json {
        let object = serde_json::json!({ "header": info, "contents": check });
        cli::write_json(Path::new("-"), &object)?;
    }
    if let Some(points) = &args.points {
        let (limit, force) = (args.common.memory_limit, args.force);
        pbgi::export_points(&args.file, points, force, limit, &progress, cancel)?;
    }
    Ok(())
}

fn check_file(
    args: &InfoArgs,
    file_bytes: u64,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<OctreeCheck, PbgiError> {
    let phase = progress.start_phase("verify", "bytes", Some(file_bytes));
    let CommonArgs { memory_limit, .. } = args.common;
    let threads = args.common.thread_count();
    OctreeCheck::read(&args.file, args.io.into(), threads, memory_limit, |bytes| {
        phase.set_done(bytes);
        if cancel.load(Ordering::Relaxed) {
            // Only reading so far: there is nothing to clean up.
            std::process::exit(i32::from(pbgi::EXIT_INTERRUPTED));
        }
    })
}

fn print_check(args: &InfoArgs, check: &OctreeCheck) -> Result<(), PbgiError> {
    if args.histogram {
        cli::print(&format!("\n{}", check.histograms()))?;
    }
    let mib_per_second = check.bytes_per_second() / f64::from(1 << 20);
    cli::print(&format!(
        "\nverified: every page, link, box and total is sound; {} in {}, {mib_per_second:.0} MiB/s\n",
        format_bytes(check.bytes_read),
        format_seconds(check.seconds),
    ))
}

/// The program `pbgi-info`.
pub fn main() -> ExitCode {
    let args = InfoArgs::parse();
    cli::run("pbgi-info", |cancel| run(&args, cancel)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn options_are_consistent() {
        InfoArgs::command().debug_assert();
    }
}
