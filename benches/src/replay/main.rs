//! Replays recorded requests for pages with several policies and budgets.
//!
//! `pbgi-shade scene.pbgi … --trace-pages run.trace`, then `cargo run --release -p pbgi-benches --bin replay -- run.trace`

#![forbid(unsafe_code)]

mod policies;
mod simulate;

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_store::PageTrace;
use pbgi_store::policy::Lirs;
use policies::{Clock, Lru, S3Fifo, TwoQueues};
use serde::Serialize;
use simulate::{Replay, Seen};
use std::path::PathBuf;

/// Budgets, as shares of the bytes of all different pages of the trace, or of all pages of the file.
const BUDGETS: [f64; 4] = [0.01, 0.023, 0.1, 0.29];

/// Replays traces of pbgi-shade --trace-pages with several policies and budgets.
#[derive(Parser)]
struct Arguments {
    /// Traces.
    #[arg(required = true)]
    traces: Vec<PathBuf>,
    /// Most pages that a reader pins for itself besides its way down the tree.
    #[arg(long, default_value_t = 64)]
    pins: usize,
    /// One part in so many of the budget is for those pins at most.
    #[arg(long, default_value_t = 16)]
    pins_part: u64,
    /// Budgets are shares of the whole file, not of what the trace asks for.
    #[arg(long)]
    of_file: bool,
    /// All rows as JSON, to this file.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// One policy with one budget on one trace.
#[derive(Serialize)]
struct Row {
    trace: String,
    budget: f64,
    budget_bytes: u64,
    /// Pages a reader may pin for itself.
    pins: usize,
    policy: &'static str,
    requests: u64,
    reads: u64,
    hit_rate: f64,
    read_amplification: f64,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let mut rows = Vec::new();
    for path in &arguments.traces {
        let trace = PageTrace::read(path)?;
        let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        rows.extend(replay_all(&name, &trace, &arguments)?);
    }
    if let Some(path) = &arguments.json {
        std::fs::write(path, serde_json::to_string_pretty(&rows)?)?;
    }
    Ok(())
}

/// Replays a trace with all budgets and policies, and prints a table.
fn replay_all(name: &str, trace: &PageTrace, arguments: &Arguments) -> Result<Vec<Row>> {
    let distinct = simulate::distinct(trace);
    let bytes: u64 = distinct.iter().map(|page| u64::from(trace.page_bytes[*page as usize])).sum();
    let file_bytes: u64 = trace.page_bytes.iter().map(|bytes| u64::from(*bytes)).sum();
    let largest = u64::from(trace.page_bytes.iter().copied().max().context("no pages")?);
    println!(
        "\n{name}: {} requests of {} pages, {:.1} MiB, of a file of {}",
        simulate::requests(trace),
        distinct.len(),
        bytes as f64 / f64::from(1 << 20),
        trace.page_bytes.len()
    );
    println!("budget     pages  pins  policy            reads   re-read   hit rate");
    let mut rows = Vec::new();
    for budget in BUDGETS {
        let whole = if arguments.of_file { file_bytes } else { bytes };
        let budget_bytes = (whole as f64 * budget) as u64;
        // As `Octree::open` divides the budget of one reader.
        let spare = (budget_bytes / arguments.pins_part.max(1) / largest)
            .clamp(1, arguments.pins as u64) as usize;
        let pins = if spare.is_power_of_two() { spare } else { spare.next_power_of_two() / 2 };
        let replay = Replay { trace, budget_bytes, pins };
        let results: [(&'static str, Seen); 10] = [
            ("lru", replay.run::<Lru>(false)),
            ("clock", replay.run::<Clock>(false)),
            ("2q", replay.run::<TwoQueues>(false)),
            ("s3-fifo", replay.run::<S3Fifo>(false)),
            ("lirs 10 %", replay.run::<Lirs<10>>(false)),
            ("lirs 30 % (ours)", replay.run::<Lirs>(false)),
            ("lirs 50 %", replay.run::<Lirs<50>>(false)),
            ("ours, pins count", replay.run::<Lirs>(true)),
            ("ours, top kept", replay.run_with_top::<Lirs>(0.25)),
            ("belady", replay.run_belady()),
        ];
        for (policy, seen) in results {
            let hit_rate = 1.0 - seen.reads as f64 / seen.requests.max(1) as f64;
            println!(
                "{:>5.1} %  {:>7}  {pins:>4}  {policy:<17} {:>7}  {:>8.3}  {:>8.4} %",
                budget * 100.0,
                budget_bytes / largest,
                seen.reads,
                seen.bytes_read as f64 / bytes as f64,
                hit_rate * 100.0
            );
            rows.push(Row {
                trace: name.to_owned(),
                budget,
                budget_bytes,
                pins,
                policy,
                requests: seen.requests,
                reads: seen.reads,
                hit_rate,
                read_amplification: seen.bytes_read as f64 / bytes as f64,
            });
        }
    }
    Ok(rows)
}
