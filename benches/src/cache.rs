//! What the page cache does while shading, by budget, order of the receivers and state of the system's cache.
//!
//! `cargo run --release -p pbgi-benches --bin cache -- --folder bench --json cache.json --svg cache.svg`

use anyhow::{Context, Result, bail};
use clap::{Parser, ValueEnum};
use pbgi::{BakeRequest, Progress, bake};
use pbgi_benches::{Line, plot};
use pbgi_file::platform::processor_seconds;
use pbgi_gather::{GatherSettings, Receiver, Shading};
use pbgi_image::compare;
use pbgi_math::{Aabb, RootCube, Vec3};
use pbgi_procedural::procedural_scene;
use pbgi_scene::{CameraView, HideOptions, hide};
use pbgi_schedule::{ReceiverOrder, ShadeOptions, ShadeReport, shade_receivers};
use pbgi_store::{CacheStats, Octree, OpenOptions, StoreError, try_for_each_leaf};
use rustix::fs::{Advice, fadvise};
use serde::Serialize;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Hit rate, read amplification, speed and stalls of the page cache.
#[derive(Parser)]
struct Arguments {
    /// Folder that keeps the baked file, about 9 bytes per surfel.
    #[arg(long, default_value = "bench-data")]
    folder: PathBuf,
    /// Surfels of the street.
    #[arg(long, default_value = "50M", value_parser = pbgi_cli::cli::parse_count)]
    surfels: u64,
    /// Receivers of each kind.
    #[arg(long, default_value_t = 40_000)]
    receivers: usize,
    /// Worker threads.
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Budgets in percent of the file.
    #[arg(long, value_delimiter = ',', default_value = "1,2.3,10,29,100")]
    budgets: Vec<f64>,
    /// Orders of the receivers.
    #[arg(long, value_delimiter = ',', default_value = "morton,hilbert,scanline,shuffled")]
    orders: Vec<Order>,
    /// Receivers whose cut error is measured.
    #[arg(long, default_value_t = 200)]
    check: usize,
    /// 5 M surfels in pages of 16 KiB, 3 000 receivers, budgets of 2.3 and 100 %, 40 receivers checked.
    #[arg(long)]
    brief: bool,
    /// Where to write the rows as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Where to draw them.
    #[arg(long)]
    svg: Option<PathBuf>,
}

/// Pages of the brief file: nearly as many as those of a file of 50 M surfels have by default.
const BRIEF_PAGE_BYTES: usize = 16 << 10;

/// Stretches of neighboring surfels that are receivers, spread evenly over the file.
const STRETCHES: usize = 16;

/// An order of receivers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
enum Order {
    /// Along the Morton curve.
    Morton,
    /// Along the Hilbert curve.
    Hilbert,
    /// By rows: of the picture, or of the place's grid of one meter.
    Scanline,
    /// At random.
    Shuffled,
}

/// One run.
#[derive(Clone, Debug, Serialize)]
struct Row {
    receivers: &'static str,
    order: Order,
    budget_percent: f64,
    /// Bytes of decoded pages that may be held.
    cache_bytes: u64,
    /// Whether the file was dropped from the system's cache before.
    cold: bool,
    seconds: f64,
    /// Seconds on a processor, all threads.
    processor_seconds: f64,
    receivers_per_second: f64,
    /// Speed relative to the whole file in memory, by wall time and by processor time.
    speed: f64,
    processor_speed: f64,
    hit_rate: f64,
    /// Share of the groups and leaves that walks opened without a page being read for it: requests for pages are those that decoded nodes do not answer.
    opened_rate: f64,
    read_amplification: f64,
    evictions: u64,
    rereads: u64,
    /// Share of the workers' time spent reading pages or waiting for them.
    stall_share: f64,
    /// Share of the file's pages that were never read.
    untouched_share: f64,
    cut_mean: f64,
    cut_deviation: f64,
}

/// The file and what shades it.
struct Bench {
    path: PathBuf,
    file_bytes: u64,
    threads: usize,
}

/// How a run differs from others.
#[derive(Clone, Copy)]
struct Setting {
    order: Order,
    budget_percent: f64,
    cold: bool,
}

impl Bench {
    /// Bakes the file unless the folder has it.
    fn prepare(arguments: &Arguments) -> Result<Self> {
        std::fs::create_dir_all(&arguments.folder)?;
        let pages = if arguments.brief { "16k" } else { "64k" };
        let name = format!("street-{}-{pages}.pbgi", arguments.surfels);
        let path = arguments.folder.join(name);
        if !path.exists() {
            let defaults = BakeRequest::default();
            let request = BakeRequest {
                inputs: vec![format!("demo:street?surfels={}", arguments.surfels)],
                output: path.clone(),
                page_bytes: if arguments.brief { BRIEF_PAGE_BYTES } else { defaults.page_bytes },
                threads: arguments.threads,
                ..defaults
            };
            bake(&request, &Progress::silent(), &AtomicBool::new(false))?;
        }
        let file_bytes = std::fs::metadata(&path)?.len();
        Ok(Self { path, file_bytes, threads: arguments.threads })
    }

    /// Opens the file with a share of it as cache, or the least cache that its readers need.
    fn open(&self, budget_percent: f64, readers: usize) -> Result<(Octree, u64)> {
        let cache_bytes = (self.file_bytes as f64 * budget_percent * 0.01) as u64;
        let mut options = OpenOptions { cache_bytes, readers, ..OpenOptions::default() };
        match Octree::open(&self.path, &options) {
            Err(StoreError::Budget { needed, .. }) => {
                options.cache_bytes = needed;
                Ok((Octree::open(&self.path, &options)?, needed))
            }
            opened => Ok((opened?, cache_bytes)),
        }
    }

    /// Drops the file from the system's cache, or reads all of it.
    fn set_cold(&self, cold: bool) -> Result<()> {
        let mut file = File::open(&self.path)?;
        if cold {
            file.sync_all()?;
            fadvise(&file, 0, None, Advice::DontNeed)?;
        } else {
            std::io::copy(&mut file, &mut std::io::sink())?;
        }
        Ok(())
    }

    fn run(&self, receivers: &[Receiver], setting: &Setting) -> Result<(Vec<Shading>, Measured)> {
        self.set_cold(setting.cold)?;
        let (octree, cache_bytes) = self.open(setting.budget_percent, self.threads)?;
        let options = ShadeOptions {
            threads: self.threads,
            order: match setting.order {
                Order::Morton => ReceiverOrder::Morton,
                _ => ReceiverOrder::AsGiven,
            },
            ..ShadeOptions::default()
        };
        let before = processor_seconds().unwrap_or_default();
        let (shadings, report) = shade_receivers(&octree, None, receivers, &options)?;
        let processor_seconds = processor_seconds().unwrap_or_default() - before;
        let pages = octree.pages().len();
        let cache = octree.stats();
        Ok((shadings, Measured { report, cache, cache_bytes, processor_seconds, pages }))
    }
}

/// What a run did.
struct Measured {
    report: ShadeReport,
    cache: CacheStats,
    cache_bytes: u64,
    processor_seconds: f64,
    pages: usize,
}

impl Measured {
    fn row(&self, bench: &Bench, name: &'static str, setting: &Setting, whole: (f64, f64)) -> Row {
        let Self { report, cache, .. } = self;
        let worker_seconds = report.seconds * bench.threads as f64;
        Row {
            receivers: name,
            order: setting.order,
            budget_percent: 100.0 * self.cache_bytes as f64 / bench.file_bytes as f64,
            cache_bytes: self.cache_bytes,
            cold: setting.cold,
            seconds: report.seconds,
            processor_seconds: self.processor_seconds,
            receivers_per_second: report.receivers as f64 / report.seconds,
            speed: whole.0 / report.seconds,
            processor_speed: whole.1 / self.processor_seconds.max(1e-9),
            hit_rate: cache.hit_rate(),
            opened_rate: 1.0 - cache.pages_read as f64 / report.cut.opened.max(1) as f64,
            read_amplification: cache.read_amplification(),
            evictions: cache.evictions,
            rereads: cache.rereads,
            stall_share: report.wait_seconds() / worker_seconds,
            untouched_share: 1.0 - cache.distinct_pages as f64 / self.pages as f64,
            cut_mean: report.cut_sizes.mean(),
            cut_deviation: report.cut_sizes.standard_deviation(),
        }
    }
}

/// What the street's camera sees, in the order of its rows of tiles.
fn camera_receivers(surfels: u64, wanted: usize) -> Result<Vec<Receiver>> {
    let made = procedural_scene(&format!("demo:street?surfels={surfels}"))?;
    // As many pixels of a 16:9 picture as receivers are wanted; some see the sky.
    let height = ((wanted as f64 / 0.7 * 9.0 / 16.0).sqrt() as u32).max(9);
    let camera = made.scene.cameras.first().context("the street has no camera")?.clone();
    let view = CameraView { camera, width: height * 16 / 9, height };
    let options = HideOptions { samples: 1, shading_rate: 1.0, window: None };
    let pieces = hide(&made.scene, &view, &options)?.micropolygons;
    Ok(pieces.iter().take(wanted).map(|p| Receiver::diffuse(p.position, p.normal)).collect())
}

/// Stretches of surfels that are neighbors in the file.
fn surfel_receivers(bench: &Bench, wanted: usize) -> Result<Vec<Receiver>> {
    let (octree, _) = bench.open(10.0, 1)?;
    let total = octree.header().surfel_count;
    let (apart, len) = (total / STRETCHES as u64, (wanted / STRETCHES) as u64);
    let mut receivers = Vec::new();
    try_for_each_leaf(&mut octree.reader(), |first, surfels| {
        for (index, surfel) in (first..).zip(surfels) {
            if index % apart.max(1) < len && receivers.len() < wanted {
                let normal = if surfel.isotropic { Vec3::Y } else { surfel.normal };
                receivers.push(Receiver::diffuse(surfel.center, normal));
            }
        }
        Ok::<(), StoreError>(())
    })?;
    Ok(receivers)
}

/// The receivers in another order. `is_picture` says that they come in that of a picture's rows.
fn arrange(receivers: &[Receiver], order: Order, is_picture: bool) -> Vec<Receiver> {
    let mut all = receivers.to_vec();
    match order {
        Order::Morton => {}
        Order::Scanline if is_picture => {}
        Order::Scanline => all.sort_by_key(|r| {
            let [x, _, z] = r.position.to_array();
            (z.floor() as i64, x.floor() as i64)
        }),
        Order::Shuffled => {
            let mut state = 0x2545_f491_4f6c_dd1d_u64;
            for index in (1..all.len()).rev() {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                all.swap(index, (state % (index as u64 + 1)) as usize);
            }
        }
        Order::Hilbert => {
            let bounds = Aabb::from_points(all.iter().map(|r| r.position));
            let root = RootCube::from_bounds(&bounds);
            all.sort_by_cached_key(|r| hilbert_from_morton(root.code(r.position).0));
        }
    }
    all
}

/// Place on the Hilbert curve of the cell with a Morton code of 21 bits per axis, by the transposed form of Skilling (2004).
fn hilbert_from_morton(code: u64) -> u64 {
    const BITS: u32 = 21;
    let mut x: [u32; 3] = std::array::from_fn(|axis| {
        (0..BITS).map(|bit| ((code >> (3 * bit + axis as u32) & 1) as u32) << bit).sum()
    });
    for bit in (1..BITS).rev() {
        let (q, p) = (1u32 << bit, (1u32 << bit) - 1);
        for axis in 0..3 {
            if x[axis] & q != 0 {
                x[0] ^= p;
            } else {
                let t = (x[0] ^ x[axis]) & p;
                x[0] ^= t;
                x[axis] ^= t;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let t = (1..BITS).filter(|bit| x[2] >> bit & 1 != 0).fold(0, |t, bit| t ^ ((1u32 << bit) - 1));
    x = x.map(|value| value ^ t);
    (0..BITS).rev().fold(0, |index, bit| {
        x.iter().fold(index, |index, value| index << 1 | u64::from(value >> bit & 1))
    })
}

/// Relative RMSE of ambient occlusion against taking every surfel, over receivers spread evenly.
fn cut_error(bench: &Bench, receivers: &[Receiver], check: usize) -> Result<f64> {
    let step = (receivers.len() / check.max(1)).max(1);
    let sample: Vec<Receiver> = receivers.iter().copied().step_by(step).collect();
    let (octree, _) = bench.open(100.0, bench.threads)?;
    let open = |solid_angle_sr: f32| -> Result<Vec<f32>> {
        let gather = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
        let options = ShadeOptions { gather, threads: bench.threads, ..ShadeOptions::default() };
        let (shadings, _) = shade_receivers(&octree, None, &sample, &options)?;
        Ok(shadings.iter().map(|s| s.ambient_occlusion).collect())
    };
    Ok(compare(&open(GatherSettings::default().solid_angle_sr)?, &open(0.0)?)?.rrmse)
}

/// The settings to run, the whole file in memory first. Along the Morton curve the file is cold, too.
fn settings(budgets: &[f64], orders: &[Order]) -> Vec<Setting> {
    let mut all = Vec::new();
    for &budget_percent in budgets.iter().rev() {
        for &order in orders {
            let warm = Setting { order, budget_percent, cold: false };
            all.push(warm);
            if order == Order::Morton {
                all.push(Setting { cold: true, ..warm });
            }
        }
    }
    all
}

/// Whether two results are the same, bit for bit, whatever order they come in.
fn same_bits(receivers: &[Receiver], found: &[Shading], reference: &[(Key, u32)]) -> bool {
    keyed(receivers, found) == reference
}

/// A receiver's bits, and its ambient occlusion's.
type Key = [u32; 6];

fn keyed(receivers: &[Receiver], shadings: &[Shading]) -> Vec<(Key, u32)> {
    let bits = |(r, s): (&Receiver, &Shading)| {
        let [p, n] = [r.position, r.normal].map(|v| v.to_array().map(f32::to_bits));
        ([p[0], p[1], p[2], n[0], n[1], n[2]], s.ambient_occlusion.to_bits() ^ s.cut_size)
    };
    let mut all: Vec<(Key, u32)> = receivers.iter().zip(shadings).map(bits).collect();
    all.sort_unstable();
    all
}

fn measure(
    bench: &Bench,
    name: &'static str,
    receivers: &[Receiver],
    arguments: &Arguments,
) -> Result<Vec<Row>> {
    let (mut rows, mut whole, mut reference) = (Vec::new(), None, Vec::new());
    print_head();
    for setting in settings(&arguments.budgets, &arguments.orders) {
        let arranged = arrange(receivers, setting.order, name == "camera");
        let (shadings, measured) = bench.run(&arranged, &setting)?;
        if whole.is_none() {
            reference = keyed(&arranged, &shadings);
        } else if !same_bits(&arranged, &shadings, &reference) {
            bail!(
                "{name}: other bits at {} % in order {:?}",
                setting.budget_percent,
                setting.order
            );
        }
        let times = (measured.report.seconds, measured.processor_seconds);
        let row = measured.row(bench, name, &setting, *whole.get_or_insert(times));
        print_row(&row);
        rows.push(row);
    }
    Ok(rows)
}

fn print_head() {
    println!(
        "{:>8} {:9} {:4} {:>10} {:>8} {:>8} {:>9} {:>9} {:>6} {:>9} {:>9} {:>6} {:>9}",
        "budget",
        "order",
        "file",
        "receiv./s",
        "speed",
        "cpu spd",
        "hit rate",
        "opened",
        "ampl.",
        "evictions",
        "re-reads",
        "stall",
        "untouched"
    );
}

fn print_row(row: &Row) {
    println!(
        "{:6.2} % {:9} {:4} {:10.0} {:6.1} % {:6.1} % {:7.3} % {:7.3} % {:6.2} {:9} {:9} {:4.1} % {:7.1} %",
        row.budget_percent,
        format!("{:?}", row.order).to_lowercase(),
        if row.cold { "cold" } else { "warm" },
        row.receivers_per_second,
        row.speed * 100.0,
        row.processor_speed * 100.0,
        row.hit_rate * 100.0,
        row.opened_rate * 100.0,
        row.read_amplification,
        row.evictions,
        row.rereads,
        row.stall_share * 100.0,
        row.untouched_share * 100.0
    );
}

fn main() -> Result<()> {
    let mut arguments = Arguments::parse();
    if arguments.brief {
        (arguments.surfels, arguments.receivers, arguments.check) = (5_000_000, 3_000, 40);
        arguments.budgets = vec![2.3, 100.0];
    }
    let bench = Bench::prepare(&arguments)?;
    let kinds = [
        ("camera", camera_receivers(arguments.surfels, arguments.receivers)?),
        ("surfels", surfel_receivers(&bench, arguments.receivers)?),
    ];
    let mut rows = Vec::new();
    for (name, receivers) in &kinds {
        let error = cut_error(&bench, receivers, arguments.check)?;
        println!(
            "\n{name}: {} receivers, file of {} MiB, {} threads, cut error {:.2} % (ambient occlusion, relative RMSE)",
            receivers.len(),
            bench.file_bytes >> 20,
            bench.threads,
            error * 100.0
        );
        rows.extend(measure(&bench, name, receivers, &arguments)?);
    }
    write_outputs(&rows, arguments.json.as_deref(), arguments.svg.as_deref())
}

fn write_outputs(rows: &[Row], json: Option<&Path>, svg: Option<&Path>) -> Result<()> {
    if let Some(path) = json {
        std::fs::write(path, serde_json::to_string_pretty(rows)?)?;
    }
    if let Some(path) = svg {
        std::fs::write(path, plot(&lines(rows), "share against cache in % of the file"))?;
    }
    Ok(())
}

/// Misses and speed against the budget: a line for each order, and for cold files.
fn lines(rows: &[Row]) -> Vec<Line> {
    type Value = fn(&Row) -> f64;
    let values: [(&str, Value); 2] = [
        // A miss in ten million requests is none.
        ("misses", |row| (1.0 - row.hit_rate).max(1e-7)),
        ("speed", |row| row.speed),
    ];
    let mut lines: Vec<Line> = Vec::new();
    for receivers in ["camera", "surfels"] {
        for (what, value) in values {
            for row in rows.iter().filter(|row| row.receivers == receivers) {
                let mut label = format!("{:?}", row.order).to_lowercase();
                label.push_str(if row.cold { " cold" } else { "" });
                let (plot, point) =
                    (format!("{receivers}, {what}"), (row.budget_percent, value(row)));
                match lines.iter_mut().find(|line| line.plot == plot && line.label == label) {
                    Some(line) => line.points.push(point),
                    None => lines.push(Line { plot, label, points: vec![point] }),
                }
            }
        }
    }
    lines
}
