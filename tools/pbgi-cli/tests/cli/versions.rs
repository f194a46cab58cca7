//! Octree files of other versions are refused with the version named.

use crate::support::{octree, run_in};

#[test]
fn files_of_other_versions_are_refused_with_the_version_and_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    let sound = std::fs::read(octree()).unwrap();
    let current = u32::from_le_bytes(sound[8..12].try_into().unwrap());
    for (version, cure) in [
        (1, "of an older program"),
        (current - 1, "of an older program"),
        (current + 1, "of a newer program"),
        (u32::MAX, "of a newer program"),
    ] {
        let mut bytes = sound.clone();
        bytes[8..12].copy_from_slice(&version.to_le_bytes());
        std::fs::write(folder.path().join("x.pbgi"), bytes).unwrap();
        for arguments in [&["info", "x.pbgi"][..], &["shade", "x.pbgi", "-o", "x.exr", "-q"]] {
            let run = run_in(folder.path(), arguments);
            let expected = format!("version: found {version}, expected {current}");
            assert_eq!(run.code, 3, "{}", run.stderr);
            assert!(run.stderr.contains(&expected) && run.stderr.contains(cure), "{}", run.stderr);
        }
    }
}
