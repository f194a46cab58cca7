//! Every check, here as on the server.

use crate::workspace::Workspace;
use std::process::Command;

/// Runs `.ci/run`.
pub fn run(workspace: &Workspace) -> Result<(), String> {
    let script = workspace.root().join(".ci").join("run");
    let status = Command::new(&script)
        .current_dir(workspace.root())
        .status()
        .map_err(|e| format!("{}: {e}", script.display()))?;
    if status.success() { Ok(()) } else { Err(format!(".ci/run failed: {status}")) }
}
