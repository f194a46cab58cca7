//! Points.

use crate::support::{SCENE, bake_to, fail, octree, shade, text};
use pbgi_cloud::{PlyWriter, ReceiverTable};
use std::f32::consts::PI;
use std::path::Path;

/// Receivers with a column of their own, high above all: looking up, looking down, looking up.
fn write_receivers(path: &Path) {
    let mut writer = PlyWriter::create(path, &["id", "x", "y", "z", "nx", "ny", "nz"]).unwrap();
    writer.write_rows(&[7.0, 0.0, 50.0, 0.0, 0.0, 1.0, 0.0]).unwrap();
    writer.write_rows(&[8.0, 0.0, 50.0, 0.0, 0.0, -1.0, 0.0]).unwrap();
    writer.write_rows(&[9.0, 9.0, 60.0, 0.0, 0.0, 2.0, 0.0]).unwrap();
    writer.finish().unwrap();
}

#[test]
fn receivers_come_back_with_their_light_and_their_columns() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["in.ply", "out.ply"].map(|name| folder.path().join(name));
    write_receivers(&input);
    let octree = octree();
    let arguments = [
        text(&octree),
        "--receivers",
        text(&input),
        "-o",
        text(&output),
        "--env-color",
        "1,0.5,0",
        "-q",
    ];
    shade(&arguments);
    let table = ReceiverTable::read(&output).unwrap();
    assert_eq!(table.len(), 3);
    assert_eq!(table.column("id"), Some([7.0, 8.0, 9.0].as_slice()));
    assert_eq!(table.positions[0].to_array(), [0.0, 50.0, 0.0]);
    let column = |name: &str| table.column(name).unwrap();
    // The open sky; the raster's integrals are within 0.2 %.
    assert!((column("irradiance_r")[0] / PI - 1.0).abs() < 3e-3);
    assert!((column("irradiance_g")[0] / PI - 0.5).abs() < 3e-3);
    assert!((column("ao")[0] - 1.0).abs() < 3e-3 && column("bent_ny")[0] > 0.99);
    let ao = column("ao");
    assert!((0.5..0.9).contains(&ao[1]), "{ao:?}");
    // Results are not overwritten by chance.
    let message = fail(2, &arguments);
    assert!(message.contains("--force"), "{message}");
    shade(&[&arguments[..], &["--force"]].concat());
}

/// Shades every surfel of a file, at a solid angle; returns the statistics.
fn shade_surfels(
    octree: &Path,
    output: &Path,
    solid_angle: &str,
    more: &[&str],
) -> serde_json::Value {
    let paths = [text(octree), "--surfels", "-o", text(output), "--force"];
    let rest = ["--solid-angle", solid_angle, "--progress", "none", "--stats-json", "-"];
    let json = shade(&[&paths[..], &rest, more].concat());
    serde_json::from_str(&json).unwrap()
}

#[test]
fn every_surfel_is_shaded_once() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out.ply");
    let octree = octree();
    let (mut bytes, mut counts) = (Vec::new(), Vec::new());
    for threads in ["1", "2"] {
        let stats = shade_surfels(&octree, &output, "0.3", &["--threads", threads]);
        counts.push(stats["surfels"].as_u64().unwrap());
        bytes.push(std::fs::read(&output).unwrap());
    }
    assert!(bytes[0] == bytes[1]);
    let table = ReceiverTable::read(&output).unwrap();
    assert_eq!(counts, [table.len() as u64; 2]);
    assert!(table.column("radius").is_some_and(|r| r.iter().all(|r| *r > 0.0)));
}

#[test]
fn the_measured_error_vanishes_with_the_solid_angle() {
    let folder = tempfile::tempdir().unwrap();
    let octree = folder.path().join("room.pbgi");
    bake_to("demo:room", 4000, &octree);
    let output = folder.path().join("out.ply");
    let error = |solid_angle: &str| {
        let stats = shade_surfels(&octree, &output, solid_angle, &["--check", "50"]);
        assert_eq!(stats["check"]["quantity"], "irradiance");
        stats["check"]["rrmse"].as_f64().unwrap()
    };
    let (coarse, none) = (error("0.5"), error("0"));
    assert!(coarse > 1e-3 && none == 0.0, "{coarse} {none}");
    // The room is closed.
    let table = ReceiverTable::read(&output).unwrap();
    let open: f32 = table.column("ao").unwrap().iter().sum::<f32>() / table.len() as f32;
    assert!(open < 0.02, "{open}");
}

#[test]
fn pictures_and_points_do_not_mix() {
    let octree = octree();
    let message = fail(2, &[text(&octree), "--surfels", "--scene", SCENE, "-o", "x.ply"]);
    assert!(message.contains("--scene"), "{message}");
}
