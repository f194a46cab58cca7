//! Fuzzing of all that reads files: the functions of `fuzz/`, under libFuzzer.

use crate::workspace::{Workspace, host_triple, succeed, succeed_shown};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Minutes per target where none are given.
const MINUTES: f64 = 5.0;

/// What makes code tell the fuzzer where it has been.
const COVERAGE: &str = "--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares";

/// Limits of one input: seconds, and megabytes of the process.
const LIMITS: [&str; 2] = ["-timeout=30", "-rss_limit_mb=2048"];

/// Searches so many minutes for inputs on which a target fails, for one target after the other.
pub fn run(workspace: &Workspace, arguments: &[&str]) -> Result<(), String> {
    let (minutes, names) = match arguments {
        ["--minutes", minutes, names @ ..] => {
            let minutes = minutes.parse().ok().filter(|minutes| (0.1..=1e4).contains(minutes));
            (minutes.ok_or("--minutes wants a number from 0.1 to 10000")?, names)
        }
        names => (MINUTES, names),
    };
    let seeds = workspace.root().join("fuzz").join("seeds");
    let all = folders(&seeds)?;
    if let Some(unknown) = names.iter().find(|name| !all.iter().any(|known| known == *name)) {
        return Err(format!("`{unknown}` is no target; there are {}", all.join(", ")));
    }
    let program = build(workspace)?;
    let mut failed = Vec::new();
    for name in all.iter().filter(|name| names.is_empty() || names.contains(&name.as_str())) {
        println!("\n== {name}, {minutes} minutes");
        if let Err(error) = search(workspace, &program, &seeds, name, minutes) {
            eprintln!("{error}");
            failed.push(name.as_str());
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("failed: {}", failed.join(", "))) }
}

/// Builds the fuzzer's program, by the nightly toolchain.
fn build(workspace: &Workspace) -> Result<PathBuf, String> {
    let host = host_triple()?;
    let target = workspace.target().join("fuzz");
    let mut cargo = workspace.nightly_cargo();
    cargo.args(["build", "--release", "--features", "libfuzzer"]);
    cargo.args(["--manifest-path", "fuzz/Cargo.toml", "--target", &host]);
    cargo.env("RUSTFLAGS", COVERAGE).env("CARGO_TARGET_DIR", &target);
    succeed(&mut cargo)?;
    Ok(target.join(host).join("release").join("fuzz"))
}

/// Runs the program on one target. What it finds worth keeping stays in `target/fuzz/corpus`, what fails in `target/fuzz/findings`.
fn search(
    workspace: &Workspace,
    program: &Path,
    seeds: &Path,
    name: &str,
    minutes: f64,
) -> Result<(), String> {
    let fuzz = workspace.target().join("fuzz");
    let (corpus, findings) = (fuzz.join("corpus").join(name), fuzz.join("findings"));
    for folder in [&corpus, &findings] {
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    }
    let dictionary = workspace.root().join("fuzz").join("dictionaries").join(dictionary_of(name));
    let mut command = Command::new(program);
    command.env("PBGI_FUZZ_TARGET", name).args(LIMITS);
    command.arg(format!("-max_total_time={:.0}", 60.0 * minutes));
    command.arg(format!("-dict={}", dictionary.display()));
    command.arg(format!("-artifact_prefix={}/{name}-", findings.display()));
    command.args(["-print_final_stats=1", "-close_fd_mask=1"]).arg(corpus).arg(seeds.join(name));
    succeed_shown(&mut command)
}

/// The file of words that are tried for a target.
fn dictionary_of(name: &str) -> &'static str {
    match name {
        "ply_points" | "ply_mesh" => "ply.txt",
        "obj" => "obj.txt",
        "gltf" => "gltf.txt",
        "exr" | "gbuffer" => "exr.txt",
        "hdr" => "hdr.txt",
        "camera" => "camera.txt",
        _ => "binary.txt",
    }
}

/// Names of the folders in `folder`, sorted.
fn folders(folder: &Path) -> Result<Vec<String>, String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut names: Vec<String> = entries
        .filter_map(Result::ok)
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    Ok(names)
}
