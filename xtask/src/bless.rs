//! Rewriting what is compared with the code: only here, and the commit says why.

use crate::layout_lock;
use crate::workspace::Workspace;

/// Tells the tests of the document to write instead of to compare.
const BLESS: &str = "PBGI_BLESS";

/// Records today's layout in the document, which must already describe it.
pub fn bless_layout(workspace: &Workspace) -> Result<(), String> {
    layout_lock::record(workspace)?;
    println!("{}: layout lock recorded", layout_lock::DOCUMENT);
    Ok(())
}

/// Rewrites the golden octree file and the dump of it in the document.
pub fn bless_golden(workspace: &Workspace) -> Result<(), String> {
    let status = workspace
        .cargo()
        .args(["test", "--quiet", "-p", "pbgi-tests", "--test", "pipeline", "format_document"])
        .env(BLESS, "1")
        .status()
        .map_err(|e| format!("cargo test: {e}"))?;
    if !status.success() {
        return Err("the golden file was not rewritten: see the failing test above".to_owned());
    }
    println!("{}: golden file and dump rewritten", layout_lock::DOCUMENT);
    Ok(())
}
