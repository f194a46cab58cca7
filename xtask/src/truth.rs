//! The engine beside path-traced truth.

use crate::workspace::Workspace;
use std::process::Command;

/// Runs the bench `truth`, or with `--reference` first the bench `reference`; the rest of the arguments is the bench's.
pub fn run(workspace: &Workspace, arguments: &[&str]) -> Result<(), String> {
    let (bench, rest) = match arguments {
        ["--reference", rest @ ..] => ("reference", rest),
        _ => ("truth", arguments),
    };
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["run", "--release", "--package", "pbgi-benches", "--bin", bench, "--"]);
    command.args(rest).current_dir(workspace.root());
    let status = command.status().map_err(|e| format!("{command:?}: {e}"))?;
    if status.success() { Ok(()) } else { Err(format!("{command:?} failed: {status}")) }
}
