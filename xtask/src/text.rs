//! What no tracked text may hold: places on somebody's machine and notes to self.

use crate::workspace::Workspace;

const EXTENSIONS: [&str; 8] = ["rs", "md", "toml", "sh", "py", "yml", "yaml", "json"];

/// Folders of absolute paths, and marks of unfinished work. In halves, so that this file passes.
const FOLDERS: [&str; 5] = ["wo rk", "ho me", "t mp", "ro ot", "Us ers"];
const MARKS: [&str; 4] = ["TO DO", "FIX ME", "XX X", "HA CK"];

/// What is wrong with the texts.
pub fn check(workspace: &Workspace) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    for path in workspace.files()? {
        let extension = path.rsplit('.').next().unwrap_or_default();
        if EXTENSIONS.contains(&extension) || path.starts_with(".ci/") {
            faults.extend(check_text(&path, &workspace.read(&path)?));
        }
    }
    Ok(faults)
}

fn check_text(path: &str, text: &str) -> Vec<String> {
    let join = |halves: &str| halves.replace(' ', "");
    let mut faults = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let place = format!("{path}:{}", number + 1);
        for folder in FOLDERS.map(join) {
            if names_folder(line, &folder) {
                faults.push(format!("{place}: absolute path /{folder}; write it relative"));
            }
        }
        for mark in MARKS.map(join) {
            if has_word(line, &mark) {
                faults.push(format!("{place}: {mark}; do it or drop it"));
            }
        }
    }
    faults
}

/// Whether `line` holds `/folder` as the start of a path.
fn names_folder(line: &str, folder: &str) -> bool {
    let path = format!("/{folder}");
    line.match_indices(&path).any(|(at, _)| {
        let before = line[..at].chars().next_back();
        let after = line[at + path.len()..].chars().next();
        let starts = !before.is_some_and(|c| c.is_alphanumeric() || "._-/>})".contains(c));
        starts && (after == Some('/') || !after.is_some_and(|c| c.is_alphanumeric() || c == '_'))
    })
}

fn has_word(line: &str, word: &str) -> bool {
    line.match_indices(word).any(|(at, _)| {
        let is_part = |c: char| c.is_alphanumeric() || c == '_';
        let before = line[..at].chars().next_back().is_some_and(is_part);
        let after = line[at + word.len()..].chars().next().is_some_and(is_part);
        !before && !after
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absolute_paths_are_found_and_relative_ones_are_not() {
        let line = |folder: &str| format!("open(\"/{folder}/x\")");
        for folder in FOLDERS.map(|halves| halves.replace(' ', "")) {
            assert_eq!(check_text("a.rs", &line(&folder)).len(), 1, "{folder}");
            assert!(check_text("a.rs", &format!("see ../{folder}/x and a/{folder}ers")).is_empty());
        }
    }

    #[test]
    fn notes_to_self_are_found() {
        for mark in MARKS.map(|halves| halves.replace(' ', "")) {
            assert_eq!(check_text("a.rs", &format!("// {mark}: later")).len(), 1, "{mark}");
            assert!(check_text("a.rs", &format!("{mark}S")).is_empty());
        }
    }
}
