//! How fast clouds are read: processor time of nothing but reading, per file format.
//!
//! `cargo run --release -p pbgi-benches --bin read_clouds`

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_benches::{SURFEL_COLUMNS, surfel_row};
use pbgi_cloud::{
    CloudOptions, PlyWriter, PtcPoint, PtcWriter, RawKind, SliceSource, Surfel, open_cloud,
    write_raw_file,
};
use pbgi_math::Vec3;
use std::path::{Path, PathBuf};

/// Writes the same surfels in every format, then reads each file in turn, round after round.
#[derive(Parser)]
struct Arguments {
    /// Surfels of each file, in millions.
    #[arg(long, default_value_t = 8)]
    millions: usize,
    /// Rounds; the median of their times counts.
    #[arg(long, default_value_t = 9)]
    rounds: usize,
}

/// One file, and the seconds its readings took: in user code, and with what the system did for it.
struct Subject {
    name: &'static str,
    path: PathBuf,
    bytes_per_surfel: f64,
    user: Vec<f64>,
    total: Vec<f64>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let folder = tempfile::tempdir_in(".")?;
    let surfels = surfels(arguments.millions * 1_000_000);
    let mut subjects = write_all(folder.path(), &surfels)?;
    for _ in 0..arguments.rounds {
        for subject in &mut subjects {
            let before = seconds_used()?;
            let count = read(&subject.path)?;
            let after = seconds_used()?;
            subject.user.push(after[0] - before[0]);
            subject.total.push(after[1] - before[1]);
            anyhow::ensure!(count == surfels.len(), "{}: {count} surfels", subject.name);
        }
    }
    println!("millions of surfels per second of processor time: median (smallest to largest)");
    println!("{:<24} {:>6}  {:<26} {:<26}", "format", "bytes", "in user code", "with the system's");
    for subject in &mut subjects {
        let [user, total] = [&mut subject.user, &mut subject.total].map(|seconds| {
            seconds.sort_by(f64::total_cmp);
            let rate = |at: usize| surfels.len() as f64 / seconds[at].max(1e-9) / 1e6;
            let last = seconds.len() - 1;
            format!("{:.1} ({:.1} to {:.1})", rate(last / 2), rate(last), rate(0))
        });
        let Subject { name, bytes_per_surfel, .. } = subject;
        println!("{name:<24} {bytes_per_surfel:>6.1}  {user:<26} {total:<26}");
    }
    Ok(())
}

/// Reads a cloud to its end and returns its number of surfels.
fn read(path: &Path) -> Result<usize> {
    let mut source = open_cloud(path, &CloudOptions::default())?;
    let (mut chunk, mut count) = (Vec::new(), 0);
    loop {
        chunk.clear();
        let more = source.read_chunk(&mut chunk)?;
        count += chunk.len();
        if !more {
            return Ok(count);
        }
    }
}

fn surfels(count: usize) -> Vec<Surfel> {
    (0..count)
        .map(|i| {
            let x = i as f32;
            let normal = Vec3::new(x.sin(), x.cos(), (0.37 * x).sin()).normalize();
            Surfel::new(Vec3::new(x, 0.5 * x, -x), normal, 0.25, 0.125)
                .with_radiance([1.0, 2.0, 0.5])
                .with_albedo([0.5, 0.25, 1.0])
        })
        .collect()
}

/// The files to be read.
fn write_all(folder: &Path, surfels: &[Surfel]) -> Result<Vec<Subject>> {
    let plys = [
        ("ply, place and normal", 6, 0),
        ("ply, with radius", 7, 0),
        ("ply, all", 14, 0),
        ("ply, all, double places", 14, 3),
    ];
    let mut paths = Vec::new();
    for (name, kind) in [("raw, 44 bytes", RawKind::Full), ("raw, 32 bytes", RawKind::Compact)] {
        let path = folder.join(name);
        write_raw_file(&path, kind, &mut SliceSource::new(surfels))?;
        paths.push((name, path));
    }
    for (name, columns, doubles) in plys {
        let path = folder.join(name);
        let mut writer =
            PlyWriter::create_with_doubles(&path, &SURFEL_COLUMNS[..columns], doubles)?;
        for surfel in surfels {
            let row = surfel_row(surfel).map(f64::from);
            writer.write_double_rows(&row[..columns])?;
        }
        writer.finish()?;
        paths.push((name, path));
    }
    paths.push(("ptc, all", folder.join("ptc, all")));
    let mut writer = PtcWriter::create(&paths[paths.len() - 1].1, true, true)?;
    let mut points = surfels.iter().map(|s| PtcPoint {
        position: s.center(),
        normal: s.normal(),
        radius: s.radius,
        area: s.area,
        radiance: s.radiance,
        albedo: s.albedo_rgb(),
    });
    points.try_for_each(|point| writer.write(&[point]))?;
    writer.finish()?;
    paths
        .into_iter()
        .map(|(name, path)| {
            let bytes = std::fs::metadata(&path)?.len();
            let bytes_per_surfel = bytes as f64 / surfels.len() as f64;
            Ok(Subject { name, path, bytes_per_surfel, user: Vec::new(), total: Vec::new() })
        })
        .collect()
}

/// Seconds of this process so far, in user code and in all; the system counts them in ticks of 10 ms.
fn seconds_used() -> Result<[f64; 2]> {
    let text = std::fs::read_to_string("/proc/self/stat")?;
    let fields = text.rsplit(')').next().context("no name in /proc/self/stat")?;
    let ticks: Vec<f64> =
        fields.split_whitespace().skip(11).take(2).map(str::parse).collect::<Result<_, _>>()?;
    let [user, system] = ticks[..] else { anyhow::bail!("no times in /proc/self/stat") };
    Ok([user * 0.01, (user + system) * 0.01])
}
