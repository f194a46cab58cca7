//! Where temporary files go.

use pbgi_file::{KeptFiles, folder_of};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;

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
