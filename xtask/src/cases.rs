//! Cases from outside: folders with files, and an `expected.md` whose commands are run in a copy of the folder.

mod expected;

use crate::workspace::Workspace;
use expected::{Check, checks_of};
use std::fs;
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Where cases are, beside the workspace.
const CASES: &str = "../shared/cases";
/// A command that takes longer hangs.
const SECONDS_MAX: u64 = 120;
/// Kept of what a command says.
const TEXT_MAX: u64 = 1 << 20;

/// Runs the cases that are there and whose names contain one of `filters`, all without any, by the release build, and prints which fall
/// short. Some need Python with xxhash.
pub fn run(workspace: &Workspace, filters: &[&str]) -> Result<(), String> {
    let root = workspace.root().join(CASES);
    let entries = fs::read_dir(&root)
        .map_err(|e| format!("{CASES}: {e}; cases are kept beside the workspace"))?;
    let mut folders: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    folders.retain(|folder| folder.join("expected.md").is_file());
    folders.retain(|folder| {
        let name = name_of(folder);
        filters.is_empty() || filters.iter().any(|filter| name.contains(filter))
    });
    folders.sort();
    let tools = build_tools(workspace)?;
    let (mut short, mut unjudged) = (Vec::new(), 0);
    for folder in &folders {
        let name = name_of(folder);
        let found = run_case(workspace, folder, &tools)?;
        match (found, checks_of(&name).is_empty()) {
            (Some(why), _) => {
                println!("{name}: {why}");
                short.push(name);
            }
            (None, true) => {
                println!("{name}: ran; what it expects is not known here");
                unjudged += 1;
            }
            (None, false) => println!("{name}: holds"),
        }
    }
    println!(
        "{} cases: {} hold, {} fall short, {unjudged} only ran",
        folders.len(),
        folders.len() - short.len() - unjudged,
        short.len()
    );
    if short.is_empty() { Ok(()) } else { Err(format!("fall short: {}", short.join(", "))) }
}

fn name_of(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Builds the program; returns a folder where its commands are, each under a name of its own.
fn build_tools(workspace: &Workspace) -> Result<PathBuf, String> {
    let mut command = workspace.cargo();
    command.args(["build", "--release", "-p", "pbgi-cli"]);
    let status = command.status().map_err(|e| e.to_string())?;
    if !status.success() {
        return Err("the program does not build".into());
    }
    let program = workspace.target().join("release").join("pbgi");
    let tools = workspace.target().join("cases-tools");
    let write = |tool: &str| {
        let path = tools.join(format!("pbgi-{tool}"));
        let script = format!("#!/bin/sh\nexec '{}' {tool} \"$@\"\n", program.display());
        fs::create_dir_all(&tools)?;
        fs::write(&path, script)?;
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755))
    };
    let written = ["bake", "shade", "info", "demo"].into_iter().try_for_each(write);
    written.map_err(|e| format!("{}: {e}", tools.display()))?;
    Ok(tools)
}

/// What is wrong with a case, if something is.
fn run_case(workspace: &Workspace, folder: &Path, tools: &Path) -> Result<Option<String>, String> {
    let text = fs::read_to_string(folder.join("expected.md")).map_err(|e| e.to_string())?;
    let Some(script) = script_of(&text) else { return Ok(Some("has no commands".into())) };
    let copy = workspace.root().join("target").join("cases").join(name_of(folder));
    let _ = fs::remove_dir_all(&copy);
    copy_folder(folder, &copy).map_err(|e| format!("{}: {e}", copy.display()))?;
    let path = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{path}", tools.display());
    let child = Command::new("bash")
        .args(["-c", &script])
        .current_dir(&copy)
        .env("PATH", &path)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| format!("bash: {e}"))?;
    let Some(said) = wait(child) else {
        return Ok(Some(format!("does not end within {SECONDS_MAX} s")));
    };
    if said.all.contains("panicked at") || said.code.is_none_or(|code| code == 101) {
        return Ok(Some(format!("panics or is killed: {}", end_of(&said.all))));
    }
    if said.errors.contains("ModuleNotFoundError") {
        return Ok(Some(format!("lacks a Python module: {}", end_of(&said.errors))));
    }
    let failed = checks_of(&name_of(folder)).iter().find_map(|check| match check {
        Check::Prints { script, expected } => judge_script(script, expected, &copy, &path),
        check => judge(check, &said, &copy),
    });
    Ok(failed.map(|why| format!("{why}; it said: {}", end_of(&said.all))))
}

/// The first block of shell commands.
fn script_of(text: &str) -> Option<String> {
    let (_, rest) = text.split_once("```sh\n")?;
    let (script, _) = rest.split_once("```")?;
    Some(script.to_owned())
}

fn copy_folder(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)?.flatten() {
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy_folder(&path, &target)?;
        } else {
            fs::copy(&path, &target)?;
        }
    }
    Ok(())
}

/// What a command says, with one blank between words.
struct Said {
    /// On standard output, then on standard error.
    all: String,
    errors: String,
    code: Option<i32>,
}

/// All that a command says; `None` if it takes too long.
fn wait(mut child: Child) -> Option<Said> {
    let (out, err) = (child.stdout.take(), child.stderr.take());
    let collect = |pipe: Option<Box<dyn Read + Send>>| {
        thread::spawn(move || {
            let mut bytes = Vec::new();
            if let Some(mut pipe) = pipe {
                let _ = Read::by_ref(&mut pipe).take(TEXT_MAX).read_to_end(&mut bytes);
                let _ = std::io::copy(&mut pipe, &mut std::io::sink());
            }
            String::from_utf8_lossy(&bytes).into_owned()
        })
    };
    let out = collect(out.map(|pipe| Box::new(pipe) as Box<dyn Read + Send>));
    let err = collect(err.map(|pipe| Box::new(pipe) as Box<dyn Read + Send>));
    let start = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => {
                let [out, errors] = [out.join(), err.join()].map(|said| {
                    let said = said.unwrap_or_default();
                    said.split_whitespace().collect::<Vec<_>>().join(" ")
                });
                return Some(Said { all: format!("{out} {errors}"), errors, code: status.code() });
            }
            Ok(None) if start.elapsed() < Duration::from_secs(SECONDS_MAX) => {
                thread::sleep(Duration::from_millis(20));
            }
            _ => {
                let _ = child.kill();
                let _ = child.wait();
                return None;
            }
        }
    }
}

/// Runs a script behind a case; says what is wrong if it does not print what is expected last.
fn judge_script(script: &str, expected: &str, folder: &Path, path: &str) -> Option<String> {
    let run =
        Command::new("bash").args(["-c", script]).current_dir(folder).env("PATH", path).output();
    let run = match run {
        Ok(run) => run,
        Err(error) => return Some(format!("bash: {error}")),
    };
    let found = String::from_utf8_lossy(&run.stdout);
    let last = found.lines().last().unwrap_or_default().trim();
    let errors = String::from_utf8_lossy(&run.stderr);
    (last != expected)
        .then(|| format!("prints `{last}`, expected `{expected}`: {}", end_of(&errors)))
}

/// What of a check does not hold.
fn judge(check: &Check, said: &Said, folder: &Path) -> Option<String> {
    let (errors, code, said) = (&said.errors, said.code, &said.all);
    match *check {
        Check::Prints { .. } => None,
        Check::Code(expected) => {
            (code != Some(expected)).then(|| format!("ends with {code:?}, expected {expected}"))
        }
        Check::AtMost { unit, bounds } => {
            let mut found = numbers_before(errors, unit);
            if found.is_empty() {
                found = numbers_before(said, unit);
            }
            let holds =
                found.len() == bounds.len() && found.iter().zip(bounds).all(|(f, b)| f <= b);
            (!holds).then(|| format!("{found:?} {unit}, expected at most {bounds:?}"))
        }
        Check::Pairs { expected, relative, absolute } => {
            let pairs = said.split(' ').filter_map(|word| word.split_once(','));
            let found: Vec<[f64; 2]> =
                pairs.filter_map(|(a, b)| Some([a.parse().ok()?, b.parse().ok()?])).collect();
            let near = |f: &[f64; 2], e: &[f64; 2]| {
                (f[0] - e[0]).abs() <= relative * e[0] && (f[1] - e[1]).abs() <= absolute
            };
            let holds = found.len() == expected.len()
                && found.iter().zip(expected).all(|(f, e)| near(f, e));
            (!holds).then(|| format!("found {found:?}, expected {expected:?}"))
        }
        Check::EachSays { begins, any } => {
            let mut lines = said.split(begins).skip(1);
            let bad = lines.find(|line| !any.iter().any(|text| line.contains(text)));
            match (said.matches(begins).count(), bad) {
                (0, _) => Some(format!("never says `{begins}`")),
                (_, Some(line)) => Some(format!("`{begins}{}` says none of {any:?}", end_of(line))),
                (_, None) => None,
            }
        }
        Check::Says(text) => {
            (!said.contains(text)).then(|| format!("expected that it says `{text}`"))
        }
        Check::Never(text) => said.contains(text).then(|| format!("it says `{text}`")),
        Check::Areas(expected) => {
            let found = numbers_behind(said, "area ");
            let holds = found.len() >= expected.len()
                && expected.iter().zip(&found).all(|(e, f)| (f - e).abs() <= 0.02 * e);
            (!holds).then(|| format!("areas {found:?}, expected {expected:?}"))
        }
        Check::Column { file, column, expected, tolerance } => {
            let found = column_mean(&folder.join(file), column);
            let holds = found.is_some_and(|found| (found - expected).abs() <= tolerance);
            (!holds)
                .then(|| format!("mean of {column} in {file} is {found:?}, expected {expected}"))
        }
        Check::Values { file, column, expected } => {
            let found = column_values(&folder.join(file), column).unwrap_or_default();
            let near = |(f, e): (&f64, &f64)| (f - e).abs() <= 0.02 * e.abs().max(0.1);
            let holds = found.len() == expected.len() && found.iter().zip(expected).all(near);
            (!holds).then(|| format!("{column} of {file} is {found:?}, expected {expected:?}"))
        }
        Check::Largest { file, column, row } => {
            let values = column_values(&folder.join(file), column).unwrap_or_default();
            let found = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b]));
            (found != Some(row))
                .then(|| format!("{column} of {file} is largest in row {found:?}, expected {row}"))
        }
        Check::Holds { file, text } => {
            let bytes = fs::read(folder.join(file)).unwrap_or_default();
            let holds = bytes.windows(text.len()).any(|part| part == text.as_bytes());
            (!holds).then(|| format!("{file} does not hold `{text}`"))
        }
    }
}

/// Numbers behind a word.
fn numbers_behind(said: &str, word: &str) -> Vec<f64> {
    let behind = said.split(word).skip(1);
    behind.filter_map(|rest| rest.split(' ').next()?.replace(',', "").parse().ok()).collect()
}

/// Numbers before a word, with or without a comma behind it.
fn numbers_before(said: &str, word: &str) -> Vec<f64> {
    let words: Vec<&str> = said.split(' ').collect();
    let pairs = words.windows(2).filter(|pair| pair[1].trim_end_matches(',') == word);
    pairs.filter_map(|pair| pair[0].parse().ok()).collect()
}

/// Values of a column of a `.csv` file, or of a binary `.ply` file of floats, doubles and bytes.
fn column_values(path: &Path, column: &str) -> Option<Vec<f64>> {
    let bytes = fs::read(path).ok()?;
    if path.extension()? == "csv" {
        let text = String::from_utf8(bytes).ok()?;
        let mut lines = text.lines();
        let index = lines.next()?.split(',').position(|name| name == column)?;
        return lines.map(|line| line.split(',').nth(index)?.parse().ok()).collect();
    }
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|window| window == end)? + end.len();
    let header = String::from_utf8_lossy(&bytes[..start]).into_owned();
    let (mut stride, mut place, mut rows) = (0, None, 0);
    for line in header.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["element", "vertex", count] => rows = count.parse().ok()?,
            ["element", _, _] => break,
            ["property", kind, name] => {
                let size = match kind {
                    "double" => 8,
                    "float" | "int" | "uint" => 4,
                    "short" | "ushort" => 2,
                    _ => 1,
                };
                if name == column {
                    place = Some((stride, kind.to_owned()));
                }
                stride += size;
            }
            _ => {}
        }
    }
    let (offset, kind) = place?;
    let value = |row: usize| {
        let rest = bytes.get(start + row * stride + offset..)?;
        Some(match kind.as_str() {
            "double" => f64::from_le_bytes(*rest.first_chunk()?),
            "float" => f64::from(f32::from_le_bytes(*rest.first_chunk()?)),
            "int" => f64::from(i32::from_le_bytes(*rest.first_chunk()?)),
            _ => f64::from(*rest.first()?),
        })
    };
    (0..rows).map(value).collect()
}

fn column_mean(path: &Path, column: &str) -> Option<f64> {
    let values = column_values(path, column)?;
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The last words.
fn end_of(said: &str) -> String {
    let start = said.char_indices().rev().nth(300).map_or(0, |(index, _)| index);
    said[start..].to_owned()
}
