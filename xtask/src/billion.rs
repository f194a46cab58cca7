//! A billion surfels, from nothing to a picture, within a gibibyte.

use crate::workspace::Workspace;
use std::path::Path;
use std::process::Command;

/// Bakes a procedural street of `surfels` (such as `1G`) in `folder`, verifies and shades it, and removes it again. The tools say how long
/// that takes, what memory they held and how wrong the picture is.
pub fn run(workspace: &Workspace, surfels: &str, folder: &str) -> Result<(), String> {
    let root = workspace.root();
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut build = Command::new(cargo);
    build.args(["build", "--release", "--package", "pbgi-cli", "--bin", "pbgi"]);
    succeed(build.current_dir(root))?;
    let target =
        std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), Into::into);
    let tool = |name: &str| {
        let mut command = Command::new(target.join("release").join("pbgi"));
        command.arg(name);
        command
    };
    let scene = format!("demo:street?surfels={surfels}");
    let octree = Path::new(folder).join("billion.pbgi");
    let picture = Path::new(folder).join("billion.exr");
    let limit = ["--memory-limit", "1GiB"];
    let steps = || {
        succeed(tool("bake").arg(&scene).arg("-o").arg(&octree).args(limit).arg("--force"))?;
        succeed(tool("info").arg(&octree).arg("--verify").args(limit))?;
        let mut shade = tool("shade");
        shade.arg(&octree).args(["--scene", "demo:street", "-o"]).arg(&picture).args(limit);
        shade.args(["--resolution", "320x180", "--env-color", "1,1,1", "--check", "2", "--force"]);
        succeed(&mut shade)
    };
    let result = steps();
    for file in [octree, picture] {
        // What was not made is not there.
        let _ = std::fs::remove_file(file);
    }
    result
}

fn succeed(command: &mut Command) -> Result<(), String> {
    println!("+ {command:?}");
    let status = command.status().map_err(|e| format!("{command:?}: {e}"))?;
    if status.success() { Ok(()) } else { Err(format!("{command:?} failed: {status}")) }
}
