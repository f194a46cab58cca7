//! Replays recorded requests for pages with several policies and budgets.
//!
//! `pbgi-shade scene.pbgi … --trace-pages run.trace`, then `cargo run --release -p pbgi-benches --bin replay -- run.trace`

#![forbid(unsafe_code)]

mod policies;
mod simulate;

use anyhow::{Context, Result};
use clap::Parser;
use pbgi_store::PageTrace;
use pbgi_store::policy::{Lru, Policy};
use policies::{Clock, S3Fifo, TwoQueues};
use serde::Serialize;
use simulate::{Replay, Seen};
use std::path::PathBuf;

/// Budgets, as shares of the bytes of all different pages of the trace.
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
        rows.extend(replay_all(&name, &trace, arguments.pins)?);
    }
    if let Some(path) = &arguments.json {
        std::fs::write(path, serde_json::to_string_pretty(&rows)?)?;
    }
    Ok(())
}

/// Replays a trace with all budgets and policies, and prints a table.
fn replay_all(name: &str, trace: &PageTrace, pins_max: usize) -> Result<Vec<Row>> {
    let distinct = simulate::distinct(trace);
    let bytes: u64 = distinct.iter().map(|page| u64::from(trace.page_bytes[*page as usize])).sum();
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
        let budget_bytes = (bytes as f64 * budget) as u64;
        // As `Octree::open` divides the budget of one reader.
        let spare = (budget_bytes / 2 / largest).clamp(1, pins_max as u64) as usize;
        let pins = if spare.is_power_of_two() { spare } else { spare.next_power_of_two() / 2 };
        let replay = Replay { trace, budget_bytes, pins };
        let results: [(&'static str, Seen); 9] = [
            ("lru", replay.run::<Lru>(false)),
            ("lru, pins count", replay.run::<Lru>(true)),
            ("clock", replay.run::<Clock>(false)),
            ("clock, pins count", replay.run::<Clock>(true)),
            ("s3-fifo", replay.run::<S3Fifo>(false)),
            ("s3-fifo, p. count", replay.run::<S3Fifo>(true)),
            ("2q, pins count", replay.run::<TwoQueues>(true)),
            ("lru, top kept", replay.run_with_top::<Lru>(0.25)),
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
