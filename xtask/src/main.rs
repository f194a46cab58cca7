//! Chores of the workspace: `cargo xtask tidy`, `cargo xtask bless`, `cargo xtask billion`, `cargo xtask truth`,
//! `cargo xtask cases`, `cargo xtask hard-cases`, `cargo xtask faults`, `cargo xtask fuzz`, `cargo xtask miri`,
//! `cargo xtask sanitize`, `cargo xtask licenses`, `cargo xtask publish`, `cargo xtask dist`, `cargo xtask ci`.
#![forbid(unsafe_code)]

mod bench_compare;
mod billion;
mod bless;
mod cases;
mod ci;
mod crate_roots;
mod dist;
mod edges;
mod faults;
mod fuzz;
mod hard_cases;
mod layout_lock;
mod licenses;
mod packages;
mod publish;
mod soundness;
mod spdx;
mod text;
mod truth;
mod workspace;

use std::process::ExitCode;
use workspace::Workspace;

const USAGE: &str = "\
Usage: cargo xtask COMMAND

  tidy            check crate edges, crate roots, texts and the layout lock (seconds)
  bless layout    record the layout of today's crates/format in docs/format.md
  bless golden    rewrite the golden octree file and its dump in docs/format.md
  bless hard-cases
                  measure all hard cases and write docs/hard-cases.md (minutes)
  billion [SURFELS [FOLDER]]
                  bake, verify and shade a street of so many surfels (1G) in a folder (.); 60 GB of disk (minutes)
  truth [--reference] [ARGUMENTS]
                  errors against a ray caster's truth, or against the converged references (minutes); --help tells more
  bench-compare OLD NEW
                  times and errors of one record of truth (--record FILE) over those of another
  cases [NAMES]   run the cases beside the workspace, all or those whose names contain one of these (minutes)
  hard-cases [NAMES]
                  measure the hard cases, all or those whose names contain one of these, and compare them with what is promised (minutes)
  faults [--short]
                  fail, fill and kill every program at calls on files (minutes, with --short a few moments of each kind)
  fuzz [--minutes N] [TARGETS]
                  search N minutes (5) for inputs that a reader fails on, of every target of fuzz/ or of these; needs nightly and C++
  miri [NAMES]    run unit tests of numbers, formats and pages in memory under Miri, all or those whose names contain one of these
                  (half an hour); needs nightly with miri and rust-src
  sanitize address|thread
                  run tests under a sanitizer (minutes); needs nightly with rust-src
  licenses        check the licenses of all dependencies against deny.toml
  publish         check that all published crates pack
  dist [--dry-run] [TARGET]
                  pack the program with all licenses into target/dist, for Linux static (minutes); or only tell what would be packed
  ci              run every check, as .ci/run does (minutes)
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = Workspace::find().and_then(|workspace| match words[..] {
        ["tidy"] => tidy(&workspace),
        ["bless", "layout"] => bless::bless_layout(&workspace),
        ["bless", "golden"] => bless::bless_golden(&workspace),
        ["bless", "hard-cases"] => hard_cases::run(&workspace, &[], true),
        ["hard-cases", ref filters @ ..] => hard_cases::run(&workspace, filters, false),
        ["billion"] => billion::run(&workspace, "1G", "."),
        ["billion", surfels] => billion::run(&workspace, surfels, "."),
        ["billion", surfels, folder] => billion::run(&workspace, surfels, folder),
        ["truth", ref rest @ ..] => truth::run(&workspace, rest),
        ["bench-compare", old, new] => bench_compare::run(old, new),
        ["cases", ref filters @ ..] => cases::run(&workspace, filters),
        ["faults"] => faults::run(&workspace, false),
        ["faults", "--short"] => faults::run(&workspace, true),
        ["fuzz", ref rest @ ..] => fuzz::run(&workspace, rest),
        ["miri", ref filters @ ..] => soundness::miri(&workspace, filters),
        ["sanitize", sanitizer] => soundness::sanitize(&workspace, sanitizer),
        ["licenses"] => licenses::check(&workspace),
        ["publish"] => publish::check(&workspace),
        ["dist", ref rest @ ..] => dist::run(&workspace, rest),
        ["ci"] => ci::run(&workspace),
        ["-h" | "--help"] => {
            print!("{USAGE}");
            Ok(())
        }
        _ => Err(USAGE.to_owned()),
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{}", message.trim_end());
            ExitCode::FAILURE
        }
    }
}

/// Runs every quick check and reports all that is wrong at once.
fn tidy(workspace: &Workspace) -> Result<(), String> {
    let mut faults = edges::check(workspace)?;
    faults.extend(crate_roots::check(workspace)?);
    faults.extend(text::check(workspace)?);
    faults.extend(layout_lock::check(workspace)?);
    if faults.is_empty() {
        println!("tidy: edges, crate roots, texts and layout lock are in order");
        return Ok(());
    }
    Err(format!("{}\ntidy: {} to mend", faults.join("\n"), faults.len()))
}
