//! The tool that looks into octree files, from its command line to its exit codes.
#![allow(missing_docs, reason = "tests are named by what they claim")]

use pbgi::{BakeRequest, Progress, Sampling};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::atomic::AtomicBool;

const SURFELS: u64 = 20_000;

/// A folder with `scene.pbgi`, baked from `input`.
fn bake(input: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let request = BakeRequest {
        inputs: vec![input.to_owned()],
        output: folder.path().join("scene.pbgi"),
        sampling: Sampling::Surfels(SURFELS),
        ..BakeRequest::default()
    };
    pbgi::bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
    folder
}

fn run(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pbgi-info"));
    let Output { status, stdout, stderr } =
        command.current_dir(folder).args(args).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

#[test]
fn sound_files_are_described_and_verified() {
    let folder = bake("demo:cornell");
    let (code, stdout, stderr) = run(folder.path(), &["scene.pbgi", "--histogram"]);
    assert_eq!(code, 0, "{stderr}");
    for part in ["surfels  ", "bytes/surfel", "leaves by surfels", "MiB/s", "+y"] {
        assert!(stdout.contains(part), "`{part}` is not in {stdout}");
    }
    let (code, stdout, stderr) = run(folder.path(), &["scene.pbgi", "--json", "--verify"]);
    assert_eq!(code, 0, "{stderr}");
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let header = &json["header"];
    assert_eq!(header["file_bytes"], file_bytes(folder.path()));
    let levels = json["contents"]["levels"].as_array().unwrap();
    let total: u64 = levels.iter().map(|l| l["surfels"].as_u64().unwrap()).sum();
    assert_eq!(header["surfels"], total);
    let (_, stdout, _) = run(folder.path(), &["scene.pbgi", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert!(json["contents"].is_null());
}

fn file_bytes(folder: &Path) -> u64 {
    std::fs::metadata(folder.join("scene.pbgi")).unwrap().len()
}

/// What a killed run has left beside the points, the next one removes, also one that finds nothing to write.
#[test]
fn what_killed_runs_have_left_is_removed() {
    let folder = bake("demo:cornell");
    for args in [
        &["scene.pbgi", "--points", "out.ply"][..],
        &["none.pbgi", "--points", "out.ply", "--force"],
    ] {
        let left = folder.path().join(".out.ply.k1l2m3n4o5p6.pbgi-tmp");
        std::fs::write(&left, "half").unwrap();
        let (code, _, stderr) = run(folder.path(), args);
        assert!([0, 3].contains(&code) && !left.exists(), "{code}: {stderr}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

/// What goes out as a RenderMan point cloud comes in again: the same places, sizes and light.
#[test]
fn ptc_files_go_out_and_come_in_again() {
    let folder = bake("demo:cornell");
    let (code, _, stderr) = run(folder.path(), &["scene.pbgi", "--points", "out.ptc"]);
    assert_eq!(code, 0, "{stderr}");
    let request = BakeRequest {
        inputs: vec![folder.path().join("out.ptc").display().to_string()],
        output: folder.path().join("again.pbgi"),
        ..BakeRequest::default()
    };
    pbgi::bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
    let info = |name: &str| pbgi::OctreeInfo::read(&folder.path().join(name), 1 << 30).unwrap();
    let (before, after) = (info("scene.pbgi"), info("again.pbgi"));
    assert_eq!((after.surfels, after.channels, after.albedo), (before.surfels, "rgb", true));
    let is_close = |a: f64, b: f64| (a - b).abs() <= 1e-3 * b.abs();
    assert!(is_close(after.area_total, before.area_total));
    assert!((0..3).all(|k| is_close(after.flux_total[k], before.flux_total[k])));
    // These files know disks only: their boxes end a little elsewhere than those of triangles.
    let moved = |k: usize| (after.bounds_max[k] - before.bounds_max[k]).abs();
    assert!(
        (0..3).all(|k| moved(k) <= 1e-3 * f64::from(before.cube_edge)),
        "{:?}",
        [0, 1, 2].map(moved)
    );
}

#[test]
fn damage_anywhere_ends_with_code_3_and_names_the_file() {
    let folder = bake("demo:cornell");
    let path = folder.path().join("scene.pbgi");
    let good = std::fs::read(&path).unwrap();
    for at in (3..good.len()).step_by(good.len() / 25) {
        let mut bad = good.clone();
        bad[at] ^= 0x10;
        std::fs::write(&path, &bad).unwrap();
        let (code, stdout, stderr) = run(folder.path(), &["scene.pbgi", "--verify"]);
        // Bytes between pages belong to nothing.
        let is_padding = code == 0 && good[at] == 0;
        assert!(is_padding || code == 3, "byte {at}: {code} {stdout} {stderr}");
        assert!(is_padding || stderr.contains("scene.pbgi"), "{stderr}");
    }
    for len in [0, 100, 256, good.len() / 2, good.len() - 1] {
        std::fs::write(&path, &good[..len]).unwrap();
        let (code, _, stderr) = run(folder.path(), &["scene.pbgi"]);
        assert_eq!(code, 3, "{len}: {stderr}");
    }
    assert_eq!(run(folder.path(), &["missing.pbgi"]).0, 3);
}

#[test]
fn exported_surfels_bake_into_the_same_cloud_again() {
    let folder = bake("demo:cornell");
    let export = ["scene.pbgi", "--points", "out.ply", "-q"];
    assert_eq!(run(folder.path(), &export).0, 0);
    // Not twice without --force, and never over the octree itself.
    assert_eq!(run(folder.path(), &export).0, 2);
    let over = ["scene.pbgi", "--points", "scene.pbgi", "--force"];
    assert_eq!(run(folder.path(), &over).0, 2);
    let request = BakeRequest {
        inputs: vec![folder.path().join("out.ply").display().to_string()],
        output: folder.path().join("again.pbgi"),
        ..BakeRequest::default()
    };
    pbgi::bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
    let read = |name| pbgi::OctreeInfo::read(&folder.path().join(name), 1 << 30).unwrap();
    let (first, again) = (read("scene.pbgi"), read("again.pbgi"));
    assert_eq!(first.surfels, again.surfels);
    assert!((first.area_total / again.area_total - 1.0).abs() < 1e-3);
    for c in 0..3 {
        assert!((first.flux_total[c] / again.flux_total[c] - 1.0).abs() < 1e-2);
    }
}

#[test]
fn coordinates_far_from_the_origin_keep_their_digits() {
    let folder = tempfile::tempdir().unwrap();
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n\
                  property double z\nproperty float radius\nend_header\n";
    let rows = "4512345.25 0 1 0.5\n4512346.125 0 1 0.5\n4512347.375 0 1 0.5\n";
    let cloud = folder.path().join("far.ply");
    std::fs::write(&cloud, format!("{header}{rows}")).unwrap();
    let request = BakeRequest {
        inputs: vec![cloud.display().to_string()],
        output: folder.path().join("far.pbgi"),
        ..BakeRequest::default()
    };
    pbgi::bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
    assert_eq!(run(folder.path(), &["far.pbgi", "--points", "out.ply"]).0, 0);
    let bytes = std::fs::read(folder.path().join("out.ply")).unwrap();
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    assert!(String::from_utf8_lossy(&bytes[..start]).contains("property double x"));
    let stride = (bytes.len() - start) / 3;
    let x = |i: usize| {
        let at = start + i * stride;
        f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
    };
    let expected = [4_512_345.25, 4_512_346.125, 4_512_347.375];
    // Half a step of disks: a 128th of √area / 2, with an area of π/4. An f32 alone would be off by up to 0.25.
    let half_step = 0.25 * std::f64::consts::PI.sqrt() / 128.0;
    assert!((0..3).all(|i| (x(i) - expected[i]).abs() <= half_step), "{} {} {}", x(0), x(1), x(2));
}
