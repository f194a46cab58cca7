//! Where temporary files go.

use crate::PbgiError;
use pbgi_file::{FileId, KeptFiles, folder_of, platform};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;

/// Bytes free to users in the file system of a folder; none where the system does not tell.
pub(crate) fn free_bytes(folder: &Path) -> Option<u64> {
    platform::free_bytes(folder)
}

/// Whether two folders lie in one file system; `false` where the system does not tell.
pub(crate) fn are_on_one_disk(a: &Path, b: &Path) -> bool {
    let ids = FileId::of(a).ok().zip(FileId::of(b).ok());
    ids.is_some_and(|(a, b)| a.is_on_disk_of(&b))
}

/// Refuses a name whose suffix tells of another format than what will be in the file. `what` is for the message, in the plural.
///
/// # Errors
///
/// [`PbgiError::Usage`], naming the suffixes that are right.
pub fn check_suffix(path: &Path, suffixes: &[&str], what: &str) -> Result<(), PbgiError> {
    // Devices have the names they have.
    if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        return Ok(());
    }
    let suffix = path.extension().unwrap_or_default();
    if suffixes.iter().any(|s| suffix.eq_ignore_ascii_case(s)) {
        return Ok(());
    }
    let expected: Vec<String> = suffixes.iter().map(|s| format!(".{s}")).collect();
    let preview = if what == "pictures" { " (--preview writes a .png)" } else { "" };
    Err(PbgiError::usage(format!(
        "{}: {what} are written as {}{preview}; name such a file (-o)",
        path.display(),
        expected.join(", ")
    )))
}

/// The files that a bake of `output` leaves in `temp_dir` between its phases. The next run of the same output finds them again; those of
/// others are called otherwise.
pub(crate) fn kept_files(temp_dir: &Path, output: &Path) -> KeptFiles {
    let folder = std::fs::canonicalize(folder_of(output)).unwrap_or_default();
    let mut hasher = DefaultHasher::new();
    (folder, output.file_name()).hash(&mut hasher);
    // Names have 255 bytes at most.
    let stem: String =
        output.file_stem().unwrap_or_default().to_string_lossy().chars().take(40).collect();
    KeptFiles::new(temp_dir, format!(".{stem}-{:016x}", hasher.finish()).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suffixes_tell_what_is_written() {
        let check = |name: &str| check_suffix(Path::new(name), &["exr"], "pictures");
        assert!(check("a.exr").is_ok() && check("b/a.0001.EXR").is_ok());
        for name in ["a.png", "a", "exr", "a.exr.gz"] {
            let error = check(name).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains("written as .exr (--preview"), "{error}");
        }
    }

    #[test]
    fn temporary_names_differ_by_output() {
        let name = |output: &str| {
            let path = kept_files(Path::new("tmp"), Path::new(output)).new_path();
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            name.rsplit_once('-').unwrap().0.to_owned()
        };
        assert_eq!(name("a.pbgi"), name("./a.pbgi"));
        assert_ne!(name("a.pbgi"), name("b.pbgi"));
        assert_ne!(name("a.pbgi"), name("/a.pbgi"));
        assert!(name(&"long".repeat(50)).len() < 200);
    }
}
