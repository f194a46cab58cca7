//! Threads, memory and folders never change a byte; nothing is left behind.

use crate::support::{Bench, Ply, ply, ply_sphere, sphere};

#[test]
fn threads_budgets_and_folders_never_change_a_byte() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("tmp")).unwrap();
    let mut files = Vec::new();
    for (threads, memory) in [("1", "64MiB"), ("2", "64MiB"), ("2", "150MiB"), ("1", "1GiB")] {
        // More surfels than the smallest budget sorts in memory.
        let args = ["demo:room?surfels=800k", "-o", "room.pbgi", "--force", "--temp-dir", "tmp"];
        let args = [&args[..], &["--threads", threads, "--memory-limit", memory]].concat();
        bench.bake(&args, "room.pbgi");
        files.push(bench.read("room.pbgi"));
    }
    assert!(files.iter().all(|file| *file == files[0]));
    assert_eq!(bench.files(), ["room.pbgi", "tmp"]);
    assert_eq!(std::fs::read_dir(bench.path("tmp")).unwrap().count(), 0);
}

#[test]
fn runs_on_disk_keep_to_the_smallest_budget() {
    let bench = Bench::new();
    bench.write("s.ply", ply_sphere(1_500_000, Ply::Little));
    let args = ["s.ply", "--memory-limit", "64MiB", "--stats-json", "s.json"];
    bench.bake(&args, "s.pbgi");
    let stats: serde_json::Value = serde_json::from_slice(&bench.read("s.json")).unwrap();
    assert!(stats["sorted_runs"].as_u64().unwrap() > 1, "{stats}");
    if let Some(peak) = stats["memory_peak_bytes"].as_u64() {
        assert!(peak <= 64 << 20, "{peak}");
    }
}

#[test]
fn baked_light_is_the_same_for_all_threads_and_budgets() {
    let bench = Bench::new();
    write_gray_environment(&bench);
    let mut files = Vec::new();
    for (threads, memory) in [("1", "64MiB"), ("2", "100MiB"), ("2", "1GiB")] {
        let args = ["demo:cornell?surfels=4k", "--env", "sky.hdr", "--bounces", "2", "--force"];
        let args = [&args[..], &["--threads", threads, "--memory-limit", memory]].concat();
        bench.bake(&args, "cornell.pbgi");
        files.push(bench.read("cornell.pbgi"));
    }
    assert!(files.iter().all(|file| *file == files[0]));
    assert_eq!(bench.files(), ["cornell.pbgi", "sky.hdr"]);
}

#[test]
fn room_for_octrees_between_passes_is_stated() {
    let bench = Bench::new();
    for (bounces, expected) in [
        ("0", "at most 0 bytes for temporary files, given back"),
        // 20 bytes for each of 4040 surfels, and twice that.
        ("1", "at most 78.9 KiB for temporary files, octrees between passes of light among them"),
        ("2", "at most 158 KiB for temporary files, octrees between passes of light among them"),
    ] {
        let run = bench.run(&[
            "demo:cornell?surfels=4k",
            "-o",
            "c.pbgi",
            "--force",
            "--bounces",
            bounces,
        ]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert!(run.stderr.contains(expected), "{bounces}: {}", run.stderr);
    }
}

#[test]
fn an_open_plane_under_a_gray_sky_reflects_its_albedo() {
    let bench = Bench::new();
    write_gray_environment(&bench);
    // A square facing up, albedo 0.5 by default: radiance 0.5 under a sky of radiance 1.
    let edge = 40;
    let (mut values, step) = (Vec::new(), 1.0 / edge as f32);
    for i in 0..edge * edge {
        let (x, z) = ((i % edge) as f32 * step, (i / edge) as f32 * step);
        values.extend([x, 0.0, z, 0.0, 1.0, 0.0, step, step * step]);
    }
    let columns = ["x", "y", "z", "nx", "ny", "nz", "radius", "area"];
    bench.write("plane.ply", ply(&columns, values, Ply::Little));
    let info = bench.bake(&["plane.ply", "--env", "sky.hdr"], "plane.pbgi");
    let radiance = info.flux_total[0] / info.area_total;
    // Cube raster of 6 x 6 texels: its horizon is coarse.
    assert!((radiance / 0.5 - 1.0).abs() < 0.03, "{radiance}");
    // A convex cloud has no bounces.
    let more = ["plane.ply", "--env", "sky.hdr", "--bounces", "1", "-o", "more.pbgi"];
    let info = bench.bake(&more, "more.pbgi");
    assert!((info.flux_total[0] / info.area_total / radiance - 1.0).abs() < 0.01);
}

/// A closed room whose walls all shine with radiance 1 and reflect the share ρ has the radiance 1 + ρ + … + ρᴺ after N bounces, and every
/// bounce is reported with its time.
#[test]
fn bounces_of_a_white_room_are_a_geometric_series() {
    let bench = Bench::new();
    bench.write("room.mtl", "newmtl wall\nKd 0.8 0.8 0.8\nKe 1 1 1\n");
    // Faces look inward.
    let corners =
        "v 0 0 0\nv 3 0 0\nv 3 2 0\nv 0 2 0\nv 0 0 2.5\nv 3 0 2.5\nv 3 2 2.5\nv 0 2 2.5\n";
    let faces = "f 1 2 3 4\nf 5 8 7 6\nf 1 4 8 5\nf 2 6 7 3\nf 1 5 6 2\nf 4 3 7 8\n";
    bench.write("room.obj", format!("mtllib room.mtl\nusemtl wall\n{corners}{faces}"));
    for (bounces, text) in [(1, "1"), (3, "3"), (8, "8")] {
        let args = ["room.obj", "--surfels", "3k", "--bounces", text, "--force"];
        let info = bench.bake(&[&args[..], &["--stats-json", "stats.json"]].concat(), "room.pbgi");
        let expected = (1.0 - 0.8f64.powi(bounces + 1)) / (1.0 - 0.8);
        let radiance = info.flux_total[1] / info.area_total;
        assert!((radiance / expected - 1.0).abs() < 0.003, "{bounces}: {radiance} {expected}");
        let stats: serde_json::Value = serde_json::from_slice(&bench.read("stats.json")).unwrap();
        let phases = stats["phases"].as_array().unwrap().iter();
        let seen: Vec<&serde_json::Value> = phases.filter(|p| p["name"] == "bounce").collect();
        let numbers: Vec<i64> = seen.iter().map(|p| p["bounce"].as_i64().unwrap()).collect();
        assert_eq!(numbers, (1..=i64::from(bounces)).collect::<Vec<_>>());
        assert!(seen.iter().all(|p| p["seconds"].as_f64().unwrap() > 0.0));
    }
}

#[test]
fn bounces_add_light_to_a_room_with_a_lamp() {
    let bench = Bench::new();
    let mut fluxes = Vec::new();
    for bounces in ["0", "1", "2"] {
        let args = ["demo:room?surfels=6k", "--bounces", bounces, "--force"];
        fluxes.push(bench.bake(&args, "room.pbgi").flux_total[1]);
    }
    let gains = [fluxes[1] - fluxes[0], fluxes[2] - fluxes[1]];
    assert!(gains[0] > 0.0 && gains[1] > 0.0, "{fluxes:?}");
    // Each bounce reflects less than it received.
    assert!(gains[1] < gains[0], "{fluxes:?}");
}

#[test]
fn shared_gathers_depend_on_no_chunk_and_keep_the_light() {
    let bench = Bench::new();
    let bake = |share, memory| {
        let args = ["demo:room?surfels=40k", "--bounces", "1", "--force", "--memory-limit", memory];
        let flux = bench.bake(&[&args[..], &["--bounce-share", share]].concat(), "room.pbgi");
        (bench.read("room.pbgi"), flux.flux_total[1])
    };
    // Limits below 256 MiB shade smaller chunks.
    let (small, flux) = bake("16", "100MiB");
    let (large, _) = bake("16", "1GiB");
    assert!(small == large);
    let (_, exact) = bake("1", "1GiB");
    assert!((flux / exact - 1.0).abs() < 0.01, "{flux} {exact}");
}

#[test]
fn light_that_cannot_be_is_a_warning() {
    let bench = Bench::new();
    let points: Vec<f32> = sphere(500).into_iter().flat_map(|[x, y, z]| [x, y, z, 0.1]).collect();
    bench.write("dark.ply", ply(&["x", "y", "z", "radius"], points, Ply::Little));
    let run = bench.run(&["dark.ply", "--bounces", "1"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("nothing shines"), "{}", run.stderr);
}

/// An equirectangular image of radiance 1, in the flat form of Radiance HDR.
pub fn write_gray_environment(bench: &Bench) {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
    bytes.extend([128, 128, 128, 129].repeat(32));
    bench.write("sky.hdr", bytes);
}
