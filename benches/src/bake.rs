//! Speed, memory and size of baking, beside what the disk allows.
#![forbid(unsafe_code)]

use anyhow::{Context, Result, bail};
use clap::{Parser, ValueEnum};
use pbgi_benches::{SURFEL_COLUMNS, surfel_row};
use pbgi_cli::cli;
use pbgi_cloud::{
    CloudError, CloudOptions, PlyWriter, RawKind, Surfel, SurfelSource, open_cloud, write_raw_file,
};
use pbgi_math::Vec3;
use pbgi_procedural::procedural_scene;
use pbgi_scene::{DiceOptions, DicedScene, Spacing, TwoSided};
use rustix::fs::{Advice, fadvise};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

/// Bakes raw streams of 32 bytes per surfel made from a procedural scene, cold from disk, with `pbgi-bake` of the same build, and
/// reports time, CPU, bytes and memory beside the disk's own speed. With --ply the same surfels are baked from PLY, too.
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
    /// Clouds that are hard on memory, in place of a scene
    #[arg(long, value_enum, value_delimiter = ',', conflicts_with_all = ["direct", "scene"])]
    case: Vec<Case>,
    /// Files each stream is divided into
    #[arg(long, default_value_t = 1)]
    files: u64,
    /// Bake each stream as a binary PLY file of all its columns, too
    #[arg(long, conflicts_with = "direct")]
    ply: bool,
    /// How often everything is baked, in turn
    #[arg(long, default_value_t = 1)]
    rounds: usize,
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
        "| cloud | surfels | limit | s | M surfels/s | phases | user s | system s | read B/surfel | written B/surfel \
         | file B/surfel | peak MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for &count in &args.surfels {
        let scene = format!("{}?surfels={count}", args.scene);
        if args.direct {
            for _ in 0..args.rounds {
                for limit in &args.memory_limit {
                    bake(&program, &scene, &[scene.clone().into()], limit, folder.path(), &args)?;
                }
            }
            continue;
        }
        let cases = args.case.iter().map(|&case| Some(case));
        let cases: Vec<Option<Case>> =
            if args.case.is_empty() { vec![None] } else { cases.collect() };
        for case in cases {
            let name = case.map_or(args.scene.clone(), |case| format!("{case:?}").to_lowercase());
            let streams = write_streams(case, &scene, count, folder.path(), args.files)?;
            let plys = if args.ply { write_plys(&streams)? } else { Vec::new() };
            for _ in 0..args.rounds {
                for limit in &args.memory_limit {
                    bake(&program, &name, &streams, limit, folder.path(), &args)?;
                    if args.ply {
                        let name = format!("{name}, PLY");
                        bake(&program, &name, &plys, limit, folder.path(), &args)?;
                    }
                }
            }
            for ply in plys {
                std::fs::remove_file(ply)?;
            }
            for stream in streams {
                match &args.keep {
                    Some(kept) => std::fs::rename(&stream, kept)?,
                    None => std::fs::remove_file(&stream)?,
                }
            }
        }
    }
    Ok(())
}

/// Clouds that are hard on memory.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Case {
    /// All surfels at one place, but for one.
    Place,
    /// All surfels on one line, shuffled.
    Line,
    /// A plane in Morton order.
    Sorted,
    /// A plane against the Morton order.
    Reversed,
}

/// The surfels of a case, numbers `next..end` of `count`.
struct Generated {
    case: Case,
    count: u64,
    next: u64,
    end: u64,
}

impl Generated {
    fn position(&self, number: u64) -> Vec3 {
        let fraction = |n: u64| n as f32 / self.count as f32;
        match self.case {
            Case::Place => Vec3::splat(if number == 0 { 1.0 } else { 0.25 }),
            // An odd number far from a divisor visits all places.
            Case::Line => Vec3::X * fraction(number.wrapping_mul(982_451_653) % self.count),
            Case::Sorted | Case::Reversed => {
                let number =
                    if self.case == Case::Sorted { number } else { self.count - 1 - number };
                let bits = |shift: u32| {
                    (0..32).fold(0u64, |all, bit| all | (number >> (2 * bit + shift) & 1) << bit)
                };
                Vec3::new(bits(0) as f32, bits(1) as f32, 0.0)
            }
        }
    }
}

impl SurfelSource for Generated {
    fn count(&self) -> Option<u64> {
        Some(self.end - self.next)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let end = self.end.min(self.next + 4096);
        out.extend((self.next..end).map(|n| Surfel::new(self.position(n), Vec3::Z, 0.7, 1.0)));
        self.next = end;
        Ok(end < self.end)
    }
}

fn write_streams(
    case: Option<Case>,
    scene: &str,
    count: u64,
    folder: &Path,
    files: u64,
) -> Result<Vec<PathBuf>> {
    let Some(case) = case else {
        let path = folder.join("scene.surf");
        write_stream(scene, count, &path)?;
        return Ok(vec![path]);
    };
    (0..files)
        .map(|file| {
            let path = folder.join(format!("{file}.surf"));
            let (next, end) = (count * file / files, count * (file + 1) / files);
            write_raw_file(&path, RawKind::Compact, &mut Generated { case, count, next, end })?;
            Ok(path)
        })
        .collect()
}

fn write_stream(scene: &str, count: u64, path: &Path) -> Result<()> {
    let scene = procedural_scene(scene)?.scene;
    let options = DiceOptions { spacing: Spacing::Count(count), two_sided: TwoSided::default() };
    write_raw_file(path, RawKind::Compact, &mut DicedScene::new(&scene, options)?)?;
    Ok(())
}

/// Writes the surfels of each stream as a PLY file beside it.
fn write_plys(streams: &[PathBuf]) -> Result<Vec<PathBuf>> {
    // All but the albedo, which streams of 32 bytes do not have.
    const COLUMNS: usize = 11;
    let write = |stream: &PathBuf| {
        let path = stream.with_extension("ply");
        let mut source = open_cloud(stream, &CloudOptions::default())?;
        let mut writer = PlyWriter::create(&path, &SURFEL_COLUMNS[..COLUMNS])?;
        let (mut chunk, mut more) = (Vec::new(), true);
        while more {
            chunk.clear();
            more = source.read_chunk(&mut chunk)?;
            for surfel in &chunk {
                writer.write_rows(&surfel_row(surfel)[..COLUMNS])?;
            }
        }
        writer.finish()?;
        Ok(path)
    };
    streams.iter().map(write).collect()
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

fn bake(
    program: &Path,
    name: &str,
    inputs: &[PathBuf],
    limit: &str,
    folder: &Path,
    args: &Args,
) -> Result<()> {
    for input in inputs {
        make_cold(input)?;
    }
    let (target, stats) = (folder.join("bench.pbgi"), folder.join("stats.json"));
    let status = Command::new(program)
        .args(inputs)
        .stdout(Stdio::null())
        .args(["--force", "--quiet", "--memory-limit", limit])
        .arg("--output")
        .arg(&target)
        .arg("--stats-json")
        .arg(&stats)
        .args(&args.options)
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
        "| {name} | {:.1} M | {limit} | {:.1} | {:.2} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.2} | {:.0} |",
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
