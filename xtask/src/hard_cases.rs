//! Hard cases: measured, compared with what is promised, and written down.

use crate::workspace::Workspace;

/// Tells the program of the cases to write its document instead of to compare it.
const BLESS: &str = "PBGI_BLESS";

/// Measures the cases whose names contain one of `filters`, all without any. All of them are compared with `docs/hard-cases.md`, or with
/// `bless` written there.
pub fn run(workspace: &Workspace, filters: &[&str], bless: bool) -> Result<(), String> {
    let mut command = workspace.cargo();
    command.args(["test", "--quiet", "--release", "--package", "pbgi-tests"]);
    command.args(["--test", "hard_cases", "--"]).args(filters);
    if bless {
        command.env(BLESS, "1");
    }
    let status = command.status().map_err(|e| format!("{command:?}: {e}"))?;
    if status.success() {
        return Ok(());
    }
    Err("hard cases: a promise is broken, a known limit got worse, or docs/hard-cases.md is stale; see above".into())
}
