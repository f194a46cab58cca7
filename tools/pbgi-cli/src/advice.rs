//! What is mistaken for something else on the command line, and what to write instead.

use pbgi::{InputKind, PbgiError, is_octree, starts_as_octree};
use std::ffi::OsStr;
use std::path::Path;

/// Refuses what is named in place of an octree; `scene` is what --scene names. A file that is missing, damaged or cannot be read is left to its
/// reader.
pub fn check_octree(octree: &Path, scene: Option<&str>) -> Result<(), PbgiError> {
    let name = octree.to_string_lossy();
    match starts_as_octree(octree) {
        Ok(true) => return Ok(()),
        Err(_) if octree.is_file() => return Ok(()),
        _ if !octree.exists() && !InputKind::is_procedural_name(&name) => return Ok(()),
        _ => {}
    }
    if octree.is_dir() {
        return Err(PbgiError::usage(format!(
            "{name} is a folder; name an octree file in it, such as {}",
            octree.join("scene.pbgi").display()
        )));
    }
    if let Some(scene) = scene.filter(|scene| is_octree(Path::new(scene))) {
        return Err(PbgiError::usage(format!(
            "{scene} is the octree and {name} is not; swap them: {scene} --scene {name}"
        )));
    }
    let what = match InputKind::detect(&name) {
        Ok(InputKind::Mesh | InputKind::Procedural) => "a mesh",
        Ok(_) => "a point cloud",
        // Damage of an octree is for its reader to name.
        Err(_) if octree.extension() == Some(OsStr::new("pbgi")) => return Ok(()),
        Err(error) => return Err(error),
    };
    Err(PbgiError::usage(format!(
        "{name} is {what}, expected an octree; bake it first: pbgi bake {name} -o {}",
        octree_name(&name)
    )))
}

/// The name of an octree made of an input.
fn octree_name(input: &str) -> String {
    let name = input.trim_start_matches("demo:").split('?').next().unwrap_or_default();
    Path::new(name).with_extension("pbgi").display().to_string()
}

/// Names of files that an octree must not have.
const OTHERS: [&str; 16] = [
    "png", "jpg", "jpeg", "exr", "hdr", "ply", "obj", "glb", "gltf", "las", "laz", "ptc", "csv",
    "npy", "json", "fbx",
];

/// Refuses an octree file that is called like a file of another kind.
pub fn check_octree_name(output: &Path) -> Result<(), PbgiError> {
    let extension = output.extension().unwrap_or_default();
    if !OTHERS.iter().any(|other| extension.eq_ignore_ascii_case(other)) {
        return Ok(());
    }
    Err(PbgiError::usage(format!(
        "{}: a bake writes an octree, not a .{} file; inputs come first, and the output is called such as {} (-o); \
         pbgi shade makes pictures and points of it",
        output.display(),
        extension.to_string_lossy(),
        output.with_extension("pbgi").display()
    )))
}

/// What to write where a file stands in place of a command.
pub fn command_for(first: &OsStr) -> Option<String> {
    let (path, name) = (Path::new(first), first.to_string_lossy());
    if is_octree(path) {
        return Some(format!(
            "{name} is an octree; name a command first: pbgi info {name}, or pbgi shade {name} ..."
        ));
    }
    let is_input = path.exists() || InputKind::is_procedural_name(&name);
    is_input.then(|| {
        format!(
            "{name} is a file, expected a command first: pbgi bake {name}, then pbgi shade {}",
            octree_name(&name)
        )
    })
}
