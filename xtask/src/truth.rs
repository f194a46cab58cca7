//! The engine beside path-traced truth.

use crate::workspace::{Workspace, succeed};

/// Runs the bench `truth`, or with `--reference` first the bench `reference`; the rest of the arguments is the bench's.
pub fn run(workspace: &Workspace, arguments: &[&str]) -> Result<(), String> {
    let (bench, rest) = match arguments {
        ["--reference", rest @ ..] => ("reference", rest),
        _ => ("truth", arguments),
    };
    let mut command = workspace.cargo();
    command.args(["run", "--release", "--package", "pbgi-benches", "--bin", bench, "--"]);
    succeed(command.args(rest))
}
