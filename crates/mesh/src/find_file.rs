//! Files that scene files name, as people and other systems write their names.

use std::path::{Path, PathBuf};

/// Longest folder that is searched for a name in other case.
const ENTRIES_MAX: usize = 100_000;

/// The file called `name` beside the file `from`. Where there is none of exactly that name: with slashes for backslashes, in upper or
/// lower case, or by its last part alone, for paths of the machine that wrote it, and all that without a comment behind it. A device or
/// pipe of the exact name is returned for readers to refuse as such. `None` if all fail.
pub(crate) fn find_file(from: &Path, name: &str) -> Option<PathBuf> {
    let plain = plain_name(name);
    let has_comment = plain != without_quotes(name);
    find_named(from, name).or_else(|| if has_comment { find_named(from, plain) } else { None })
}

/// A name without quotes and without a comment behind it.
pub(crate) fn plain_name(name: &str) -> &str {
    let end = name.find(" #").or_else(|| name.find("\t#")).unwrap_or(name.len());
    without_quotes(&name[..end])
}

fn without_quotes(name: &str) -> &str {
    name.trim().trim_matches('"').trim()
}

fn find_named(from: &Path, name: &str) -> Option<PathBuf> {
    let folder = from.parent().unwrap_or(Path::new(""));
    let name = without_quotes(name);
    let turned = name.replace('\\', "/");
    let last = turned.rsplit('/').next().unwrap_or_default();
    if last.is_empty() {
        return None;
    }
    let exact = [name, turned.as_str()].into_iter().map(|name| folder.join(name));
    exact
        .chain([folder.join(last)])
        .find(|path| path.is_file())
        .or_else(|| find_in_any_case(folder, &turned))
        .or_else(|| find_in_any_case(folder, last))
        .or_else(|| Some(folder.join(name)).filter(|path| path.exists() && !path.is_dir()))
}

/// Walks the parts of a relative name, each by its own case or any other.
fn find_in_any_case(folder: &Path, name: &str) -> Option<PathBuf> {
    if Path::new(name).is_absolute() {
        return None;
    }
    let mut path = folder.to_owned();
    for part in name.split('/').filter(|part| !part.is_empty() && *part != ".") {
        let next = path.join(part);
        path = if part == ".." || next.exists() { next } else { in_any_case(&path, part)? };
    }
    path.is_file().then_some(path)
}

fn in_any_case(folder: &Path, part: &str) -> Option<PathBuf> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let lower = part.to_lowercase();
    let names = std::fs::read_dir(folder).ok()?.take(ENTRIES_MAX).flatten();
    // The first in order, whatever order the system lists them in.
    let same = names.filter(|entry| {
        entry.file_name().to_str().is_some_and(|name| name.to_lowercase() == lower)
    });
    same.map(|entry| entry.path()).min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_other_systems_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let from = folder.path().join("mesh.obj");
        std::fs::create_dir(folder.path().join("Maps")).unwrap();
        let file = folder.path().join("Maps/Wood.png");
        std::fs::write(&file, "").unwrap();
        let beside = folder.path().join("sky blue.PNG");
        std::fs::write(&beside, "").unwrap();
        for name in ["Maps/Wood.png", "Maps\\Wood.png", "maps/WOOD.PNG", ".\\MAPS\\wood.png"] {
            assert_eq!(find_file(&from, name).as_ref(), Some(&file), "{name}");
        }
        for name in [
            "\"sky blue.png\"",
            "sky blue.png # of 1998",
            "C:\\Users\\me\\sky blue.png",
            "/srv/me/SKY BLUE.png",
        ] {
            assert_eq!(find_file(&from, name).as_ref(), Some(&beside), "{name}");
        }
        for name in ["", "Maps", "none.png", "maps/none.png", "..", "/", "\\"] {
            assert_eq!(find_file(&from, name), None, "{name}");
        }
    }
}
