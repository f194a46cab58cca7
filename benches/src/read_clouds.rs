//! How fast clouds are read: user time of nothing but reading, per file format, beside the raw stream's.
//!
//! `cargo run --release -p pbgi-benches --bin read_clouds`

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_cloud::{
    CloudOptions, PlyWriter, RawKind, SliceSource, Surfel, open_cloud, write_raw_file,
};
use pbgi_math::Vec3;
use std::path::{Path, PathBuf};

/// Writes the same surfels in every format, then reads each file in turn, round after round.
#[derive(Parser)]
struct Arguments {
    /// Surfels of each file, in millions.
    #[arg(long, default_value_t = 8)]
    millions: usize,
    /// Rounds; the median of their user times counts.
    #[arg(long, default_value_t = 9)]
    rounds: usize,
}

/// One file and the user seconds its readings took.
struct Subject {
    name: &'static str,
    path: PathBuf,
    bytes_per_surfel: f64,
    seconds: Vec<f64>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let folder = tempfile::tempdir_in(".")?;
    let surfels = surfels(arguments.millions * 1_000_000);
    let mut subjects = write_all(folder.path(), &surfels)?;
    for _ in 0..arguments.rounds {
        for subject in &mut subjects {
            let before = user_seconds()?;
            let count = read(&subject.path)?;
            subject.seconds.push(user_seconds()? - before);
            anyhow::ensure!(count == surfels.len(), "{}: {count} surfels", subject.name);
        }
    }
    println!("{:<26} {:>8} {:>16} {:>7}   spread", "format", "bytes", "surfels/user-s", "to raw");
    let rate = |seconds: f64| surfels.len() as f64 / seconds.max(1e-9) / 1e6;
    let raw = rate(median(&mut subjects[0].seconds));
    for subject in &mut subjects {
        let middle = rate(median(&mut subject.seconds));
        let (fast, slow) = (subject.seconds[0], subject.seconds[subject.seconds.len() - 1]);
        println!(
            "{:<26} {:>8.1} {:>14.1} M {:>6.0} %   {:.1} to {:.1} M",
            subject.name,
            subject.bytes_per_surfel,
            middle,
            100.0 * middle / raw,
            rate(slow),
            rate(fast)
        );
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

/// The files to be read; the first is what the others are compared with.
fn write_all(folder: &Path, surfels: &[Surfel]) -> Result<Vec<Subject>> {
    type Row = fn(&Surfel) -> Vec<f64>;
    let placed: Row =
        |s| s.position.iter().chain(&s.normal().to_array()).map(|&x| x.into()).collect();
    let sized: Row = |s| {
        let position = s.position.into_iter().chain(s.normal().to_array());
        position.chain([s.radius]).map(f64::from).collect()
    };
    let full: Row = |s| {
        let position = s.position.into_iter().chain(s.normal().to_array());
        let sizes = position.chain([s.radius, s.area]).chain(s.radiance);
        sizes.chain(s.albedo_rgb()).map(f64::from).collect()
    };
    let names = [
        "x",
        "y",
        "z",
        "nx",
        "ny",
        "nz",
        "radius",
        "area",
        "radiance_r",
        "radiance_g",
        "radiance_b",
        "albedo_r",
        "albedo_g",
        "albedo_b",
    ];
    let plys: [(&str, usize, usize, Row); 4] = [
        ("ply, place and normal", 6, 0, placed),
        ("ply, with radius", 7, 0, sized),
        ("ply, all", 14, 0, full),
        ("ply, all, double places", 14, 3, full),
    ];
    let mut paths = Vec::new();
    for (name, kind) in [("raw, 44 bytes", RawKind::Full), ("raw, 32 bytes", RawKind::Compact)] {
        let path = folder.join(name);
        write_raw_file(&path, kind, &mut SliceSource::new(surfels))?;
        paths.push((name, path));
    }
    for (name, columns, doubles, row) in plys {
        let path = folder.join(name);
        let mut writer = PlyWriter::create_with_doubles(&path, &names[..columns], doubles)?;
        for surfel in surfels {
            writer.write_double_rows(&row(surfel))?;
        }
        writer.finish()?;
        paths.push((name, path));
    }
    paths
        .into_iter()
        .map(|(name, path)| {
            let bytes = std::fs::metadata(&path)?.len();
            let bytes_per_surfel = bytes as f64 / surfels.len() as f64;
            Ok(Subject { name, path, bytes_per_surfel, seconds: Vec::new() })
        })
        .collect()
}

fn median(seconds: &mut [f64]) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}

/// User time of this process so far; the system counts it in ticks of 10 ms.
fn user_seconds() -> Result<f64> {
    let text = std::fs::read_to_string("/proc/self/stat")?;
    let ticks = text.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(11));
    Ok(ticks.context("no user time in /proc/self/stat")?.parse::<f64>()? * 0.01)
}
