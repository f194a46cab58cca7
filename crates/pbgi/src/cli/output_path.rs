//! Where results and temporary files go.

use crate::PbgiError;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};

/// The folder a file lies in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Bytes free to users in the file system of a folder; none where the system does not tell.
pub(crate) fn free_bytes(folder: &Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(folder).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// Whether two folders lie in one file system; `false` where the system does not tell.
pub(crate) fn are_on_one_disk(a: &Path, b: &Path) -> bool {
    let device = |folder: &Path| rustix::fs::stat(folder).ok().map(|stat| stat.st_dev);
    device(a).is_some_and(|found| Some(found) == device(b))
}

/// Refuses an output that cannot or should not be written, before any long work.
///
/// # Errors
///
/// [`PbgiError::Usage`] if it exists and `force` is not set, is no file, or is one of the inputs;
/// [`PbgiError::Output`] if its folder cannot be written.
pub(crate) fn check_output(output: &Path, force: bool, inputs: &[String]) -> Result<(), PbgiError> {
    let shown = output.display();
    if output.file_name().is_none() {
        return Err(PbgiError::usage(format!("the output `{shown}` is no file name (-o)")));
    }
    if let Ok(found) = std::fs::metadata(output) {
        if !found.is_file() {
            return Err(PbgiError::usage(format!(
                "{shown} exists and is no regular file; choose another output (-o)"
            )));
        }
        let target = std::fs::canonicalize(output).ok();
        let is_output = |input: &&String| std::fs::canonicalize(input).ok() == target;
        if let Some(input) = inputs.iter().find(is_output) {
            return Err(PbgiError::usage(format!(
                "{shown} is the input {input}, too; choose another output (-o)"
            )));
        }
        if !force {
            return Err(PbgiError::usage(format!(
                "{shown} exists; --force replaces it, -o names another output"
            )));
        }
    }
    let folder = folder_of(output);
    if !folder.is_dir() {
        let missing = std::io::Error::new(
            std::io::ErrorKind::NotFound,
            format!("there is no folder {}; make it first", folder.display()),
        );
        return Err(PbgiError::output(output, "create", missing));
    }
    tempfile::Builder::new()
        .prefix(".pbgi-")
        .tempfile_in(folder)
        .map(drop)
        .map_err(|e| PbgiError::output(output, "create", e))
}

/// Refuses a name whose suffix tells of another format than what will be in the file. `what` is for the message, in the plural.
///
/// # Errors
///
/// [`PbgiError::Usage`], naming the suffixes that are right.
pub fn check_suffix(path: &Path, suffixes: &[&str], what: &str) -> Result<(), PbgiError> {
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

/// Path in `temp_dir` for what a bake of `output` leaves between its phases, without its last extension. Always the same for the same
/// output, so that the next run takes over what a killed one left; different for different outputs.
pub(crate) fn temporary_path(temp_dir: &Path, output: &Path) -> PathBuf {
    let folder = std::fs::canonicalize(folder_of(output)).unwrap_or_default();
    let mut hasher = DefaultHasher::new();
    (folder, output.file_name()).hash(&mut hasher);
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    temp_dir.join(format!(".{stem}-{:016x}", hasher.finish()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_are_judged_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("old.pbgi"), "old").unwrap();
        let code = |output: &Path, force| {
            check_output(output, force, &[]).map_err(|e| e.exit_code()).err()
        };
        assert_eq!(code(&path("new.pbgi"), false), None);
        assert_eq!(code(&path("old.pbgi"), false), Some(2));
        assert_eq!(code(&path("old.pbgi"), true), None);
        assert_eq!(code(folder.path(), true), Some(2));
        assert_eq!(code(Path::new("/dev/null"), true), Some(2));
        assert_eq!(code(&path("none/new.pbgi"), true), Some(1));
        assert_eq!(code(Path::new(""), true), Some(2));
        let inputs = [path("old.pbgi").to_str().unwrap().to_owned()];
        assert!(check_output(&path("old.pbgi"), true, &inputs).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

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
        let name = |output: &str| temporary_path(Path::new("tmp"), Path::new(output));
        assert_eq!(name("a.pbgi"), name("./a.pbgi"));
        assert_ne!(name("a.pbgi"), name("b.pbgi"));
        assert_ne!(name("a.pbgi"), name("/a.pbgi"));
    }
}
