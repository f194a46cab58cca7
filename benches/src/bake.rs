//! Speed, memory and size of baking, beside what the disk allows.
#![forbid(unsafe_code)]

use anyhow::{Context, Result, bail};
use clap::Parser;
use pbgi::cli;
use pbgi_cloud::{RawKind, write_raw_file};
use pbgi_scene::{DiceOptions, DicedScene, Spacing, TwoSided, procedural_scene};
use rustix::fs::{Advice, fadvise};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Bakes raw streams of 32 bytes per surfel made from a procedural scene, cold from disk, with `pbgi-bake` of the same build, and
/// reports time, CPU, bytes and memory beside the disk's own speed.
#[derive(Parser)]
struct Args {
    /// Surfels of each bake
    #[arg(long, value_parser = cli::parse_count, value_delimiter = ',', default_value = "10M,100M")]
    surfels: Vec<u64>,
    /// Memory limits of each bake
    #[arg(long, value_delimiter = ',', default_value = "1GiB")]
    memory_limit: Vec<String>,
    /// Scene the surfels are of
    #[arg(long, default_value = "demo:street")]
    scene: String,
    /// Bake the scene itself, not a stream of its surfels
    #[arg(long)]
    direct: bool,
    /// Keep the last stream as this file
    #[arg(long)]
    keep: Option<PathBuf>,
    /// Folder for the stream, the octree and temporary files
    #[arg(long, default_value = ".")]
    folder: PathBuf,
    /// Further options of pbgi-bake
    #[arg(last = true)]
    options: Vec<String>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let folder = tempfile::tempdir_in(&args.folder)?;
    let program = std::env::current_exe()?.with_file_name("pbgi-bake");
    if !program.exists() {
        bail!("{}: not here; run `cargo build --release` first", program.display());
    }
    let (write, read) = disk_speed(&folder.path().join("disk"))?;
    println!("disk, 1 GiB: {write:.0} MB/s written and synced, {read:.0} MB/s read\n");
    println!(
        "| surfels | limit | s | M surfels/s | phases | user s | system s | read B/surfel | written B/surfel \
         | file B/surfel | peak MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for &count in &args.surfels {
        let stream = folder.path().join("surfels.surf");
        let scene = format!("{}?surfels={count}", args.scene);
        if !args.direct {
            write_stream(&scene, count, &stream)?;
        }
        let input = if args.direct { Path::new(&scene) } else { &stream };
        for limit in &args.memory_limit {
            bake(&program, input, limit, folder.path(), &args.options)?;
        }
        match &args.keep {
            Some(kept) if !args.direct => std::fs::rename(&stream, kept)?,
            _ if !args.direct => std::fs::remove_file(&stream)?,
            _ => {}
        }
    }
    Ok(())
}

fn write_stream(scene: &str, count: u64, path: &Path) -> Result<()> {
    let scene = procedural_scene(scene)?.scene;
    let options = DiceOptions { spacing: Spacing::Count(count), two_sided: TwoSided::default() };
    write_raw_file(path, RawKind::Compact, &mut DicedScene::new(&scene, options)?)?;
    Ok(())
}

/// Writes what is dirty and forgets what is cached.
fn make_cold(path: &Path) -> Result<()> {
    let Ok(file) = File::open(path) else { return Ok(()) };
    file.sync_all()?;
    fadvise(&file, 0, None, Advice::DontNeed)?;
    Ok(())
}

/// MB/s of writing with a sync, and of reading.
fn disk_speed(path: &Path) -> Result<(f64, f64)> {
    const MIB: usize = 1024;
    let mut block = vec![0u8; 1 << 20];
    for (i, byte) in block.iter_mut().enumerate() {
        *byte = (i.wrapping_mul(2_654_435_761) >> 13) as u8;
    }
    let start = Instant::now();
    let mut file = File::create(path)?;
    for _ in 0..MIB {
        file.write_all(&block)?;
    }
    file.sync_all()?;
    let write = start.elapsed().as_secs_f64();
    make_cold(path)?;
    let start = Instant::now();
    let mut file = File::open(path)?;
    for _ in 0..MIB {
        file.read_exact(&mut block)?;
    }
    let read = start.elapsed().as_secs_f64();
    std::fs::remove_file(path)?;
    let megabytes = (MIB * block.len()) as f64 / 1e6;
    Ok((megabytes / write, megabytes / read))
}

fn bake(program: &Path, input: &Path, limit: &str, folder: &Path, more: &[String]) -> Result<()> {
    make_cold(input)?;
    let (target, stats) = (folder.join("bench.pbgi"), folder.join("stats.json"));
    let status = Command::new(program)
        .arg(input)
        .args(["--force", "--quiet", "--memory-limit", limit])
        .arg("--output")
        .arg(&target)
        .arg("--stats-json")
        .arg(&stats)
        .args(more)
        .status()?;
    if !status.success() {
        bail!("{} failed", program.display());
    }
    let stats: serde_json::Value = serde_json::from_reader(File::open(&stats)?)?;
    let number = |name: &str| stats[name].as_f64().with_context(|| format!("{name} of the report"));
    let surfels = number("surfels")?;
    let phases: Vec<String> = stats["phases"]
        .as_array()
        .context("phases")?
        .iter()
        .map(|p| {
            format!(
                "{} {:.1}",
                p["name"].as_str().unwrap_or("?"),
                p["seconds"].as_f64().unwrap_or(0.0)
            )
        })
        .collect();
    println!(
        "| {:.1} M | {limit} | {:.1} | {:.2} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.2} | {:.0} |",
        surfels / 1e6,
        number("seconds")?,
        number("surfels_per_second")? / 1e6,
        phases.join(", "),
        number("user_seconds")?,
        number("system_seconds")?,
        number("read_bytes")? / surfels,
        number("written_bytes")? / surfels,
        number("file_bytes")? / surfels,
        number("memory_peak_bytes")? / f64::from(1 << 20),
    );
    std::fs::remove_file(&target)?;
    Ok(())
}
