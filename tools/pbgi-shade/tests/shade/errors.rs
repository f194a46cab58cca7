//! What goes wrong, and the exit codes that say so.

use crate::support::{SCENE, fail, octree, run, text};
use pbgi::write_environment_exr;
use pbgi_image::{AttributeValue, RgbImage, read_exr};

const SMALL: [&str; 4] = ["--resolution", "32x18", "--progress", "none"];

#[test]
fn unreadable_and_damaged_octrees_are_input_errors() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("out.exr");
    let damaged = folder.path().join("damaged.pbgi");
    let shade = |octree: &str| {
        fail(3, &[&[octree, "--scene", SCENE, "-o", text(&target)], &SMALL[..]].concat())
    };
    let missing = folder.path().join("none.pbgi");
    assert!(shade(text(&missing)).contains("none.pbgi"));
    std::fs::write(&damaged, "not an octree").unwrap();
    assert!(shade(text(&damaged)).contains("damaged.pbgi"));
    let mut bytes = std::fs::read(octree()).unwrap();
    // Past the header lie the pages.
    for at in (4096..bytes.len() / 2).step_by(64) {
        bytes[at] ^= 0x55;
    }
    std::fs::write(&damaged, &bytes).unwrap();
    let message = shade(text(&damaged));
    assert!(message.contains("page") && message.contains("bake it again"), "{message}");
    assert!(!target.exists());
}

#[test]
fn environments_that_cannot_be_are_named_with_their_pixel() {
    let folder = tempfile::tempdir().unwrap();
    let [sky, target] = ["sky.exr", "out.exr"].map(|name| folder.path().join(name));
    let mut image = RgbImage { width: 8, height: 4, pixels: vec![[1.0; 3]; 32] };
    image.pixels[13][2] = -1.0;
    write_environment_exr(&sky, &image, &[]).unwrap();
    let octree = octree();
    let arguments = [text(&octree), "--scene", SCENE, "-o", text(&target), "--env", text(&sky)];
    let message = fail(3, &[&arguments, &SMALL[..]].concat());
    assert!(message.contains("column 5, row 1"), "{message}");
    let color = [text(&octree), "-o", text(&target), "--env-color", "1,-1,0"];
    fail(2, &[&color, &SMALL[..]].concat());
}

#[test]
fn outputs_that_cannot_be_written_are_found_before_the_work() {
    let octree = octree();
    let folder = tempfile::tempdir().unwrap();
    for target in [folder.path().join("none/out.exr"), folder.path().to_owned()] {
        // The octree's absence would be found, if anything were done.
        let output = run(&["none.pbgi", "-o", text(&target)]);
        assert!([Some(1), Some(2)].contains(&output.status.code()), "{output:?}");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(message.contains(text(&target)), "{message}");
    }
    let points = folder.path().join("none/out.ply");
    fail(1, &[text(&octree), "--surfels", "-o", text(&points), "-q"]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn cameras_that_see_nothing_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let (octree, target) = (octree(), folder.path().join("out.exr"));
    let away = [
        text(&octree),
        "--scene",
        SCENE,
        "-o",
        text(&target),
        "--camera-position",
        "0,90,0",
        "--camera-target",
        "0,100,0",
        "--up",
        "0,0,1",
    ];
    let message = fail(1, &[&away, &SMALL[..]].concat());
    assert!(message.contains("sees no surface"), "{message}");
    assert!(!target.exists());
    let output = run(&[&away, &SMALL[..], &["--env-color", "1,1,1"]].concat());
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("warning: the camera"));
    let unknown = [text(&octree), "--scene", SCENE, "-o", text(&target), "--camera", "tele"];
    let message = fail(2, &[&unknown, &SMALL[..]].concat());
    assert!(message.contains("\"tele\""), "{message}");
}

#[test]
fn settings_out_of_range_are_misuse() {
    let folder = tempfile::tempdir().unwrap();
    let (octree, target) = (octree(), folder.path().join("out.exr"));
    for (option, value) in [
        ("--solid-angle", "nan"),
        ("--solid-angle", "-1"),
        ("--raster", "65"),
        ("--directions", "1000"),
        ("--samples", "5"),
        ("--shading-rate", "0"),
        ("--memory-limit", "1MiB"),
        ("--aovs", "gloss"),
        ("--env-scale", "nan"),
    ] {
        let option = format!("{option}={value}");
        let fixed = [text(&octree), "--scene", SCENE, "-o", text(&target), &option];
        fail(2, &[&fixed, &SMALL[..], &["--env-color=1,1,1"]].concat());
    }
    let bare = folder.path().join("bare.ply");
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
        property float z\nend_header\n0 0 0\n";
    std::fs::write(&bare, ply).unwrap();
    let table = folder.path().join("out.ply");
    let message = fail(3, &[text(&octree), "--receivers", text(&bare), "-o", text(&table), "-q"]);
    assert!(message.contains("normals"), "{message}");
}

#[test]
fn damaged_pages_are_skipped_on_request_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let [damaged, target, stats] =
        ["damaged.pbgi", "out.exr", "out.json"].map(|name| folder.path().join(name));
    let mut bytes = std::fs::read(octree()).unwrap();
    // The third page is behind the header and two pages of 4 KiB at most.
    bytes[256 + 8192 + 100] ^= 0x55;
    std::fs::write(&damaged, &bytes).unwrap();
    let fixed = [text(&damaged), "--scene", SCENE, "-o", text(&target)];
    let detail = ["--solid-angle", "0"];
    let message = fail(3, &[&fixed, &SMALL[..], &detail].concat());
    assert!(message.contains("damaged.pbgi") && message.contains("--skip-damaged"), "{message}");
    let mut images = Vec::new();
    for (io, threads) in [("read", "1"), ("map", "2")] {
        let options = ["--io", io, "-t", threads, "--skip-damaged", "--stats-json", text(&stats)];
        let output = run(&[&fixed, &SMALL[..], &detail, &options].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{message}");
        assert!(message.contains("warning: 1 of") && message.contains("left out"), "{message}");
        let json = std::fs::read(&stats).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
        let page = report["damaged_pages"][0].as_u64().unwrap();
        let (_, metadata) = read_exr(&target).unwrap();
        let said = AttributeValue::Text(format!("1 left out: {page}"));
        assert!(metadata.attributes.contains(&("pbgi:damagedPages".to_owned(), said)));
        images.push(std::fs::read(&target).unwrap());
    }
    assert_eq!(images[0], images[1]);
}

#[test]
fn requests_for_pages_are_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (octree, target) = (octree(), folder.path().join("out.exr"));
    let trace = folder.path().join("out.trace");
    let fixed = [text(&octree), "--scene", SCENE, "-o", text(&target), "-q"];
    let output = run(&[&fixed, &SMALL[..], &["--trace-pages", text(&trace)]].concat());
    assert!(output.status.success(), "{output:?}");
    assert!(std::fs::read(&trace).unwrap().starts_with(b"PBGITRC1"));
}
