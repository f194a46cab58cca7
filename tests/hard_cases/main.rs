//! Hard cases, each through the whole engine: from a file to an octree to what receivers receive.
//!
//! `cargo xtask hard-cases` runs it; `cargo xtask bless hard-cases` writes `docs/hard-cases.md`. Arguments are parts of names; without any, all
//! cases are measured and the document is compared with them.
#![allow(missing_docs, reason = "a program of tests")]

mod document;
mod engine;
mod verdict;

use engine::Pbgi;
use pbgi_testkit::hard::hard_cases;
use std::process::ExitCode;
use verdict::{Measured, Verdict};

/// Tells to write the document instead of to compare.
const BLESS: &str = "PBGI_BLESS";

fn main() -> ExitCode {
    let filters: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let is_meant =
        |name: &str| filters.is_empty() || filters.iter().any(|filter| name.contains(filter));
    let cases = hard_cases().into_iter().filter(|case| is_meant(case.name));
    println!("{:<24} {:>10} {:>10} {:>8}  verdict", "case", "promised", "measured", "margin");
    let mut rows = Vec::new();
    for case in cases {
        let row = Measured::new(case, (case.measure)(&mut Pbgi));
        println!("{row}");
        rows.push(row);
    }
    let count = |verdict: Verdict| rows.iter().filter(|row| row.verdict() == verdict).count();
    let (kept, known) = (count(Verdict::Kept), count(Verdict::KnownLimit));
    let (broken, met) = (count(Verdict::Broken), count(Verdict::LimitMet));
    println!(
        "{} cases: {kept} promises kept, {known} known limits, {met} of them kept today, {broken} broken",
        rows.len()
    );
    let mut is_sound = broken == 0;
    if filters.is_empty() {
        let blessed = std::env::var_os(BLESS).is_some();
        let done = if blessed { document::write(&rows) } else { document::check(&rows) };
        if let Err(message) = done {
            eprintln!("{message}");
            is_sound = false;
        }
    }
    if is_sound { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
