//! Files that are not read, and how to make one of them that is.

use crate::PbgiError;
use pbgi_file::open_input;
use std::io::Read;
use std::path::Path;

/// How to convert a file of this extension, if it is one of a known kind that is not read.
fn conversion(extension: &str) -> Option<&'static str> {
    Some(match extension.to_ascii_lowercase().as_str() {
        "fbx" | "dae" | "3ds" | "abc" | "usd" | "usda" | "usdc" | "usdz" => {
            "import it into Blender and export glTF 2.0 (.glb) there"
        }
        "blend" => "export glTF 2.0 (.glb) from Blender (File > Export)",
        "max" | "ma" | "mb" | "c4d" | "hip" => {
            "export glTF 2.0 (.glb) or .obj from the program it is of"
        }
        "stl" | "off" | "3mf" => "save it as .ply or .obj, in MeshLab or Blender for instance",
        "xyz" | "pts" | "asc" | "txt" | "csv" | "pcd" | "e57" => {
            "save it as .ply or .las, in CloudCompare for instance"
        }
        _ => return None,
    })
}

/// Refuses a file of a known kind that is not read, and a folder, with what to do.
///
/// # Errors
///
/// [`PbgiError::Input`], or [`PbgiError::Usage`] for a folder.
pub(crate) fn refuse_foreign(name: &str) -> Result<(), PbgiError> {
    let path = Path::new(name);
    if path.is_dir() {
        return Err(PbgiError::usage(format!(
            "{name} is a folder; name the files in it, such as {}",
            path.join(example_in(path)).display()
        )));
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    match conversion(extension) {
        // A file that is missing is told to be missing.
        Some(cure) if path.exists() => {
            Err(PbgiError::input(format!("{name}: .{extension} files are not read; {cure}")))
        }
        _ => Ok(()),
    }
}

/// A pattern of the files in a folder that can be read.
fn example_in(folder: &Path) -> String {
    let known = ["laz", "las", "ply", "glb", "gltf", "obj", "ptc"];
    let extension = known.into_iter().find(|known| {
        let is_of_kind = |entry: std::io::Result<std::fs::DirEntry>| {
            entry.is_ok_and(|e| e.path().extension().is_some_and(|e| e.eq_ignore_ascii_case(known)))
        };
        std::fs::read_dir(folder).is_ok_and(|mut entries| entries.any(is_of_kind))
    });
    extension.map_or_else(|| "*".to_owned(), |extension| format!("*.{extension}"))
}

/// Refuses a `.glb` file that is something else, and says what.
///
/// # Errors
///
/// [`PbgiError::Input`].
pub(crate) fn refuse_misnamed(path: &Path) -> Result<(), PbgiError> {
    if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("glb")) {
        return Ok(());
    }
    let mut start = Vec::new();
    let read = open_input(path).and_then(|file| file.take(64).read_to_end(&mut start));
    if read.is_err() || start.starts_with(b"glTF") {
        return Ok(());
    }
    let text = start.trim_ascii_start();
    let what = if text.starts_with(b"version https://git-lfs") {
        "is a pointer of Git LFS, not the file; fetch it with `git lfs pull`"
    } else if text.starts_with(b"{") {
        "is text, as .gltf files are; rename it to .gltf, beside the files it refers to"
    } else if text.starts_with(b"<") {
        "is a web page; download the file itself"
    } else if start.is_empty() {
        "is empty; export or download it again"
    } else {
        "is no binary glTF, which starts with `glTF`; export or download it again"
    };
    Err(PbgiError::input(format!("{}: {what}", path.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_binary_gltf_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        for (bytes, cure) in [
            ("{ \"asset\": {} }", "rename it to .gltf"),
            ("version https://git-lfs.github.com/spec/v1", "git lfs pull"),
            ("<!DOCTYPE html>", "web page"),
            ("", "empty"),
            ("solid", "export or download"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let error = refuse_misnamed(&path).unwrap_err();
            assert_eq!(error.exit_code(), 3);
            assert!(error.to_string().contains(cure), "{error}");
        }
        std::fs::write(&path, "glTF").unwrap();
        refuse_misnamed(&path).unwrap();
    }

    #[test]
    fn folders_are_answered_with_what_is_in_them() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = || refuse_foreign(folder.path().to_str().unwrap()).unwrap_err();
        assert!(refusal().to_string().ends_with("/*"));
        std::fs::write(folder.path().join("a.LAZ"), "").unwrap();
        assert!(refusal().to_string().ends_with("*.laz"));
        assert_eq!(refusal().exit_code(), 2);
    }
}
