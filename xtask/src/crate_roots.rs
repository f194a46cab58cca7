//! What every crate says and forbids at its root.

use crate::workspace::Workspace;

/// Crates that hold audited unsafe code; all others forbid it.
const WITH_UNSAFE: [&str; 2] = ["raster", "store"];

/// What is wrong with the first lines of the crates.
pub fn check(workspace: &Workspace) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    for name in workspace.crates()? {
        let path = format!("crates/{name}/src/lib.rs");
        let denies = WITH_UNSAFE.contains(&name.as_str());
        faults.extend(check_root(&path, &workspace.read(&path)?, denies));
    }
    Ok(faults)
}

fn check_root(path: &str, text: &str, denies: bool) -> Vec<String> {
    let mut faults = Vec::new();
    if !text.starts_with("//! ") {
        faults.push(format!("{path}: starts without `//!`; say what the crate is"));
    }
    if !text.contains("//!") || !text.contains("must never") && !text.contains("never published") {
        faults.push(format!("{path}: does not say what the crate must never do or know"));
    }
    let attribute = if denies { "#![deny(unsafe_code)]" } else { "#![forbid(unsafe_code)]" };
    if !text.lines().any(|line| line == attribute) {
        faults.push(format!("{path}: lacks `{attribute}`"));
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roots_without_text_or_attribute_are_reported() {
        let good = "//! Points.\n//!\n//! It must never open a file.\n#![forbid(unsafe_code)]\n";
        assert!(check_root("lib.rs", good, false).is_empty());
        assert_eq!(check_root("lib.rs", good, true).len(), 1);
        assert_eq!(check_root("lib.rs", "mod a;\n", false).len(), 3);
    }
}
