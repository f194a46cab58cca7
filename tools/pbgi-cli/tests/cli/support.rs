//! Running the program in a folder with a few small files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// Runs the program in `folder`.
pub fn run_in(folder: &Path, arguments: &[&str]) -> Run {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pbgi"));
    let Output { status, stdout, stderr } =
        command.current_dir(folder).args(arguments).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Run { code: status.code().unwrap_or(-1), stdout: text(stdout), stderr: text(stderr) }
}

/// Runs the program, which must succeed.
pub fn succeed_in(folder: &Path, arguments: &[&str]) -> Run {
    let run = run_in(folder, arguments);
    assert_eq!(run.code, 0, "{arguments:?}: {}", run.stderr);
    run
}

/// An octree of a box of three meters, baked once for all tests.
pub fn octree() -> PathBuf {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("box.obj"), square(3.0)).unwrap();
        let bake = ["bake", "box.obj", "-o", "box.pbgi", "--surfels", "500", "-q"];
        succeed_in(folder.path(), &bake);
        folder
    });
    folder.path().join("box.pbgi")
}

/// A ground and a wall of this edge, as OBJ.
pub fn square(edge: f32) -> String {
    format!(
        "v 0 0 0\nv {edge} 0 0\nv {edge} 0 {edge}\nv 0 0 {edge}\nv 0 {edge} 0\nv {edge} {edge} 0\n\
         f 1 3 2\nf 1 4 3\nf 1 2 6\nf 1 6 5\n"
    )
}
