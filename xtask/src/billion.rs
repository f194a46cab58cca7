//! A billion surfels, from nothing to a picture, within a gibibyte.

use crate::workspace::{Workspace, succeed_shown};
use std::path::Path;
use std::process::Command;

/// Bakes a procedural street of `surfels` (such as `1G`) in `folder`, verifies and shades it, and removes it again. The tools say how long
/// that takes, what memory they held and how wrong the picture is.
pub fn run(workspace: &Workspace, surfels: &str, folder: &str) -> Result<(), String> {
    succeed_shown(&mut workspace.build_program())?;
    let tool = |name: &str| {
        let mut command = Command::new(workspace.program());
        command.arg(name);
        command
    };
    let scene = format!("demo:street?surfels={surfels}");
    let octree = Path::new(folder).join("billion.pbgi");
    let picture = Path::new(folder).join("billion.exr");
    let limit = ["--memory-limit", "1GiB"];
    let steps = || {
        succeed_shown(tool("bake").arg(&scene).arg("-o").arg(&octree).args(limit).arg("--force"))?;
        succeed_shown(tool("info").arg(&octree).arg("--verify").args(limit))?;
        let mut shade = tool("shade");
        shade.arg(&octree).args(["--scene", "demo:street", "-o"]).arg(&picture).args(limit);
        shade.args(["--resolution", "320x180", "--env-color", "1,1,1", "--check", "2", "--force"]);
        succeed_shown(&mut shade)
    };
    let result = steps();
    for file in [octree, picture] {
        // What was not made is not there.
        let _ = std::fs::remove_file(file);
    }
    result
}
