//! What newcomers write, and the line that tells them what to write instead.

use crate::support::{octree, run_in, square};
use std::path::Path;

/// Arguments, the exit code, and words of the line that tells the cure.
type Mistake = (&'static [&'static str], i32, &'static [&'static str]);

const SHADE_TAIL: &[&str] = &["-o", "x.exr"];

const MISTAKES: &[Mistake] = &[
    // No command, or the wrong one.
    (&["box.obj"], 2, &["command first", "pbgi bake box.obj", "pbgi shade box.pbgi"]),
    (&["box.pbgi"], 2, &["command first", "pbgi info box.pbgi"]),
    (&["demo:street"], 2, &["pbgi bake demo:street"]),
    (&["render"], 2, &["unrecognized subcommand"]),
    // Arguments in each other's places.
    (&["shade", "box.obj", "--scene", "box.pbgi"], 2, &["swap them: box.pbgi --scene box.obj"]),
    (&["shade", "box.pbgi", "--scene", "box.pbgi"], 3, &["is an octree", "the mesh it was baked"]),
    (&["bake", "box.pbgi", "-o", "box.obj"], 2, &["inputs come first", "box.pbgi (-o)"]),
    (&["bake", "box.obj", "-o", "x.png"], 2, &["writes an octree", "x.pbgi", "pbgi shade makes"]),
    (&["shade", "box.obj"], 2, &["is a mesh", "pbgi bake box.obj -o box.pbgi"]),
    (&["shade", "points.ply"], 2, &["is a point cloud", "pbgi bake points.ply -o points.pbgi"]),
    (&["shade", "demo:street"], 2, &["is a mesh", "pbgi bake demo:street -o street.pbgi"]),
    (&["info", "box.obj"], 2, &["is a mesh", "pbgi bake box.obj"]),
    // Folders.
    (&["bake", "scans", "-o", "x.pbgi"], 2, &["scans is a folder", "scans/*.laz"]),
    (&["shade", "scans"], 2, &["scans is a folder", "scans/scene.pbgi"]),
    (&["bake", "box.obj", "-o", "out/x.pbgi"], 1, &["no folder out", "mkdir -p out"]),
    (&["shade", "box.pbgi", "-o", "out/x.exr"], 1, &["no folder out", "mkdir -p out"]),
    (&["shade", "box.pbgi", "--preview", "out/x.png"], 1, &["no folder out", "mkdir -p out"]),
    // Files of other programs.
    (&["bake", "a.fbx"], 3, &[".fbx files are not read", "glTF 2.0 (.glb)"]),
    (&["bake", "a.usd"], 3, &[".usd files are not read", "glTF 2.0 (.glb)"]),
    (&["bake", "a.usda"], 3, &[".usda files are not read", "glTF 2.0 (.glb)"]),
    (&["bake", "a.usdc"], 3, &[".usdc files are not read", "glTF 2.0 (.glb)"]),
    (&["bake", "a.usdz"], 3, &[".usdz files are not read", "glTF 2.0 (.glb)"]),
    (&["bake", "a.abc"], 3, &[".abc files are not read", "glTF 2.0 (.glb)"]),
    (&["bake", "a.blend"], 3, &[".blend files are not read", "File > Export"]),
    (&["bake", "a.stl"], 3, &[".stl files are not read", ".ply or .obj"]),
    (&["bake", "a.xyz"], 3, &[".xyz files are not read", ".ply or .las", "CloudCompare"]),
    (&["shade", "a.fbx"], 3, &[".fbx files are not read", "glTF 2.0 (.glb)"]),
    (&["shade", "box.pbgi", "--scene", "a.fbx"], 3, &[".fbx files are not read", "glTF"]),
    (&["bake", "text.glb"], 3, &["is text", "rename it to .gltf"]),
    (&["bake", "pointer.glb"], 3, &["git lfs pull"]),
    (&["bake", "missing.fbx"], 3, &["missing.fbx", "No such file"]),
    // Pictures.
    (&["shade", "box.pbgi", "-o", "x.png"], 2, &["written as .exr", "--preview writes a .png"]),
    (&["shade", "box.pbgi", "--env", "sky.png"], 3, &["display colors", "take an .exr or .hdr"]),
    (&["bake", "box.obj", "--env", "sky.png"], 3, &["display colors", "take an .exr or .hdr"]),
    // Options that do not go together.
    (&["shade", "box.pbgi", "--env-rotate", "90"], 2, &["--env-rotate", "add --env sky.hdr"]),
    (&["bake", "box.obj", "--env-rotate", "90"], 2, &["--env-rotate", "add --env sky.hdr"]),
    (&["bake", "box.obj", "--env-scale", "2"], 2, &["--env-scale", "add --env sky.hdr"]),
    (
        &["shade", "box.pbgi", "--quality", "final", "--target-error", "1%"],
        2,
        &["--quality <PRESET>", "cannot be used with", "--target-error"],
    ),
    (
        &["shade", "box.pbgi", "--quality", "draft", "--solid-angle", "0.1"],
        2,
        &["--quality <PRESET>", "cannot be used with", "--solid-angle"],
    ),
    (&["bake", "box.obj", "--surfels", "many"], 2, &["`many` is no count", "2M, 5e5"]),
    // A number of other units.
    (&["bake", "box.obj", "--spacing", "5"], 0, &["coarse for a scene of", "centimeters"]),
    (
        &["shade", "box.pbgi", "--scene", "large.obj", "--env-color", "1,1,1"],
        0,
        &["100 times", "centimeters against meters"],
    ),
];

fn prepare(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
    write("box.obj", square(3.0).as_bytes());
    write("large.obj", square(300.0).as_bytes());
    write("points.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n");
    write("text.glb", b"{\"asset\": {\"version\": \"2.0\"}}");
    write("pointer.glb", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n");
    write("sky.png", b"\x89PNG\r\n\x1a\n");
    for extension in ["fbx", "usd", "usda", "usdc", "usdz", "abc", "blend", "stl", "xyz"] {
        write(&format!("a.{extension}"), b"0 0 0\n1 1 1\n");
    }
    std::fs::create_dir(folder.join("scans")).unwrap();
    write("scans/a.laz", b"");
    std::fs::copy(octree(), folder.join("box.pbgi")).unwrap();
}

#[test]
fn every_mistake_has_its_cure_in_a_line() {
    let mut faults = Vec::new();
    for (arguments, code, words) in MISTAKES {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path());
        let mut arguments = arguments.to_vec();
        match arguments[..] {
            ["shade", ..] if !arguments.contains(&"-o") => arguments.extend(SHADE_TAIL),
            ["bake", input, ..] if !arguments.contains(&"-o") && input != "-" => {
                arguments.extend(["-o", "made.pbgi"]);
            }
            _ => {}
        }
        if let ["shade", ..] = arguments[..] {
            arguments.extend(["--resolution", "16x9", "--progress", "none"]);
        }
        let run = run_in(folder.path(), &arguments);
        let is_told = run.stderr.lines().any(|line| words.iter().all(|word| line.contains(word)));
        if run.code != *code || !is_told {
            let command = arguments.join(" ");
            faults.push(format!("pbgi {command}\n  ends with {}: {}", run.code, run.stderr.trim()));
        }
        // What was refused left nothing behind.
        let made = ["x.exr", "made.pbgi", "x.png", "x.pbgi"].map(|name| folder.path().join(name));
        assert!(*code == 0 || !made.iter().any(|path| path.exists()), "{arguments:?}");
    }
    assert!(faults.is_empty(), "{} mistakes:\n{}", faults.len(), faults.join("\n"));
}

#[test]
fn counts_are_written_as_people_do() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let mut sizes = Vec::new();
    for count in ["1k", "1e3", "1_000", "1000", "0.001M"] {
        let arguments = [
            "bake",
            "box.obj",
            "-o",
            "new.pbgi",
            "--force",
            "--surfels",
            count,
            "--stats-json",
            "-",
        ];
        let run = crate::support::succeed_in(folder.path(), &arguments);
        let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        sizes.push(report["surfels"].as_u64().unwrap());
    }
    assert!(sizes.iter().all(|&size| size == sizes[0] && size > 500), "{sizes:?}");
}
