//! Every kind of input bakes, and means the same in each format.

use crate::support::{Bench, Ply, ply, ply_sphere, shared, sphere};
use std::f64::consts::PI;

#[test]
fn ply_clouds_mean_the_same_in_all_three_formats() {
    let bench = Bench::new();
    for (name, format) in [("a", Ply::Ascii), ("l", Ply::Little), ("b", Ply::Big)] {
        bench.write(&format!("{name}.ply"), ply_sphere(5000, format));
        // Without -o the output is named after the input.
        let info = bench.bake(&[&format!("{name}.ply")], &format!("{name}.pbgi"));
        assert_eq!((info.surfels, info.channels, info.up), (5000, "rgb", "+y"));
        assert!((info.area_total / (8.0 * PI) - 1.0).abs() < 1e-3, "{}", info.area_total);
    }
    assert!(bench.read("a.pbgi") == bench.read("l.pbgi"));
    assert!(bench.read("l.pbgi") == bench.read("b.pbgi"));
}

#[test]
fn bare_points_get_sizes_and_normals() {
    let bench = Bench::new();
    let points: Vec<f32> = sphere(20_000).into_iter().flatten().collect();
    bench.write("p.ply", ply(&["x", "y", "z"], points, Ply::Little));
    let info = bench.bake(&["p.ply", "--stats-json", "s.json"], "p.pbgi");
    // 4π, within what the density of 12 neighbors tells.
    assert!((info.area_total / (4.0 * PI) - 1.0).abs() < 0.1, "{}", info.area_total);
    assert!(!info.isotropic);
    let stats: serde_json::Value = serde_json::from_slice(&bench.read("s.json")).unwrap();
    assert_eq!(stats["estimated_sizes"], 20_000);
    assert_eq!(stats["estimated_normals"], 20_000);
    let info = bench.bake(&["p.ply", "--normals", "isotropic", "--force"], "p.pbgi");
    assert!(info.isotropic);
}

#[test]
fn meshes_are_diced_as_finely_as_asked() {
    let bench = Bench::new();
    bench.write("q.obj", "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nf 1 2 3\nf 1 3 4\n");
    let info = bench.bake(&["q.obj", "--spacing", "0.1", "-o", "s.pbgi"], "s.pbgi");
    assert!((400..1000).contains(&info.surfels), "{}", info.surfels);
    assert!((info.area_total - 4.0).abs() < 1e-3);
    let info = bench.bake(&["q.obj", "--surfels", "20k", "-o", "c.pbgi"], "c.pbgi");
    assert!((info.surfels as f64 / 2e4 - 1.0).abs() < 0.05, "{}", info.surfels);
    let all = ["q.obj", "--surfels", "20k", "--two-sided", "all", "-o", "t.pbgi"];
    let info = bench.bake(&all, "t.pbgi");
    assert!((info.area_total - 8.0).abs() < 1e-3);
}

#[test]
fn procedural_scenes_and_several_inputs_bake_as_one() {
    let bench = Bench::new();
    bench.write("a.ply", ply_sphere(1000, Ply::Ascii));
    let run = ["demo:room?surfels=3k", "a.ply", "-o", "two.pbgi", "--up", "z"];
    let info = bench.bake(&run, "two.pbgi");
    assert!((3800..4300).contains(&info.surfels), "{}", info.surfels);
    assert_eq!(info.up, "+z");
}

/// A hundred files are one cloud, and wait for their turn closed.
#[cfg(unix)]
#[test]
fn a_hundred_inputs_bake_with_few_files_open() {
    let bench = Bench::new();
    let points = sphere(5000);
    let names: Vec<String> = (0..100).map(|i| format!("{i:03}.pbgisurf")).collect();
    for (name, part) in names.iter().zip(points.chunks(50)) {
        bench.write(name, raw_stream(part, 0));
    }
    bench.write("all.pbgisurf", raw_stream(&points, 0));
    bench.bake(&["all.pbgisurf", "-o", "all.pbgi"], "all.pbgi");
    let mut shell = std::process::Command::new("sh");
    let limited = "ulimit -n 24; exec \"$0\" \"$@\" -o parts.pbgi";
    shell.args(["-c", limited, env!("CARGO_BIN_EXE_pbgi-bake")]).args(&names);
    let output = shell.current_dir(bench.path("")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(bench.read("parts.pbgi") == bench.read("all.pbgi"));
}

#[test]
fn raw_streams_are_read_from_standard_input() {
    let bench = Bench::new();
    let raw = raw_stream(&sphere(3000), 0);
    let run = bench.run_with_input(&["-", "-o", "raw.pbgi", "--stats-json", "-"], &raw);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let stats: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(stats["surfels"], 3000);
    assert_eq!(bench.check("raw.pbgi").surfels, 3000);
    // The layout of the file knows nothing of where it came from.
    bench.write("raw.pbgisurf", &raw);
    bench.bake(&["raw.pbgisurf", "-o", "file.pbgi"], "file.pbgi");
    assert!(bench.read("raw.pbgi") == bench.read("file.pbgi"));
}

#[test]
fn particles_of_raw_streams_stay_isotropic() {
    let bench = Bench::new();
    bench.write("p.pbgisurf", raw_stream(&sphere(500), 1));
    assert!(bench.bake(&["p.pbgisurf"], "p.pbgi").isotropic);
}

/// Version 1, records of 32 bytes, count unknown.
fn raw_stream(points: &[[f32; 3]], flags: u16) -> Vec<u8> {
    let mut bytes = b"PBGISURF".to_vec();
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(u64::MAX.to_le_bytes());
    bytes.resize(64, 0);
    for point in points {
        bytes.extend(point.iter().flat_map(|c| c.to_le_bytes()));
        bytes.extend([0.05f32, 0.004].iter().flat_map(|c| c.to_le_bytes()));
        // Normal code and radiance.
        bytes.extend([0; 10]);
        bytes.extend(flags.to_le_bytes());
    }
    bytes
}

#[test]
fn files_of_the_shared_data_bake() {
    let bench = Bench::new();
    if let Some(room) = shared("reference/room.glb") {
        let info = bench.bake(&[&room, "--surfels", "100k", "-o", "room.pbgi"], "room.pbgi");
        assert!((info.surfels as f64 / 1e5 - 1.0).abs() < 0.05, "{}", info.surfels);
        // Its lamp shines.
        assert!(info.flux_total.iter().all(|f| *f > 0.0));
    }
    if let Some(scan) = shared("data/autzen_stadium.laz") {
        let info = bench.bake(&[&scan, "-o", "scan.pbgi"], "scan.pbgi");
        assert_eq!((info.up, info.channels, info.albedo), ("+z", "none", true));
        assert!(info.origin[0] > 1e5 && info.surfels > 2_000_000);
    }
}

#[test]
fn strips_and_zero_normals_are_what_they_mean() {
    let bench = Bench::new();
    let strips = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
        0 0 0\n2 0 0\n0 2 0\n2 2 0\n4 0 1 2 3\n";
    bench.write("s.ply", strips);
    let info = bench.bake(&["s.ply", "--surfels", "1k"], "s.pbgi");
    assert!((info.area_total - 4.0).abs() < 1e-3, "{}", info.area_total);
    // Normals of 0 are not known: estimated, but where surfels have sizes.
    let rows = |zeros: usize, more: &[f32]| -> Vec<f32> {
        let place = |i: usize| [(i % 60) as f32, (i / 60) as f32, 0.0];
        let row =
            |i| [&place(i)[..], &[0.0, 0.0, if i < zeros { 0.0 } else { 1.0 }], more].concat();
        (0..3600).flat_map(row).collect()
    };
    let names = ["x", "y", "z", "nx", "ny", "nz", "radius"];
    for zeros in [3600, 100] {
        bench.write("z.ply", ply(&names[..6], rows(zeros, &[]), Ply::Little));
        assert!(!bench.bake(&["z.ply", "--force"], "z.pbgi").isotropic);
    }
    bench.write("r.ply", ply(&names, rows(3600, &[0.7]), Ply::Little));
    assert!(bench.bake(&["r.ply"], "r.pbgi").isotropic);
}

#[test]
fn points_that_coincide_are_told() {
    let bench = Bench::new();
    let points: Vec<f32> =
        (0..400).flat_map(|i| [(i % 20) as f32, (i / 20) as f32, 0.0].repeat(14)).collect();
    bench.write("c.ply", ply(&["x", "y", "z"], points, Ply::Little));
    bench.bake(&["c.ply", "--stats-json", "s.json"], "c.pbgi");
    let stats: serde_json::Value = serde_json::from_slice(&bench.read("s.json")).unwrap();
    assert!(stats["warnings"][0].as_str().unwrap().contains("coincide"), "{stats}");
}
