//! Points.

use crate::support::{SCENE, bake_to, fail, octree, shade, text};
use pbgi_cloud::{CloudOptions, LasPoints, PlyWriter, ReceiverReader, ReceiverTable, SurfelSource};
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

#[test]
fn positions_and_normals_come_back_as_given() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["in.ply", "out.ply"].map(|name| folder.path().join(name));
    let text_of = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
                   property float nx\nproperty float ny\nproperty double nz\nend_header\n\
                   0.1 5.123456789012345 -0.2 0.25 2 0.7\n1e-9 7 0 0 -5 0.1\n";
    std::fs::write(&input, text_of).unwrap();
    let octree = octree();
    let paths = [text(&octree), "--receivers", text(&input), "-o", text(&output)];
    shade(&[&paths[..], &["--env-color", "1,1,1", "-q"]].concat());
    let [given, found] = [&input, &output].map(|path| {
        let kinds = ReceiverReader::open(path).unwrap().given_kinds();
        (kinds, ReceiverTable::read(path).unwrap().given)
    });
    assert_eq!(given.1[0][1], 5.123_456_789_012_345);
    assert_eq!(found, given);
}

/// Vertices of the scene itself, in other units and with another axis up.
#[test]
fn receivers_far_from_all_surfels_are_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let [surfels, input, output] =
        ["s.ply", "in.ply", "out.ply"].map(|name| folder.path().join(name));
    let octree = octree();
    shade_surfels(&octree, &surfels, "1", &[]);
    let table = ReceiverTable::read(&surfels).unwrap();
    let warnings_of = |change: &dyn Fn(f32, f32, f32) -> [f32; 3]| {
        let mut writer = PlyWriter::create(&input, &["x", "y", "z", "nx", "ny", "nz"]).unwrap();
        for place in table.positions.iter().step_by(20) {
            let [x, y, z] = change(place.x, place.y, place.z);
            writer.write_rows(&[x, y, z, 0.0, 1.0, 0.0]).unwrap();
        }
        writer.finish().unwrap();
        let paths = [text(&octree), "--receivers", text(&input), "-o", text(&output), "--force"];
        let rest = ["--env-color", "1,1,1", "--solid-angle", "1", "-q", "--stats-json", "-"];
        let stats = shade(&[&paths[..], &rest].concat());
        let stats: serde_json::Value = serde_json::from_str(&stats).unwrap();
        stats["warnings"].as_array().unwrap().clone()
    };
    assert_eq!(warnings_of(&|x, y, z| [x, y, z]), [] as [serde_json::Value; 0]);
    let found = warnings_of(&|x, y, z| [100.0 * x, -100.0 * z, 100.0 * y]);
    assert_eq!(found.len(), 1, "{found:?}");
    let warning = found[0].as_str().unwrap();
    let expected = "+Z is up in it and its unit is 0.01 of the octree's: give 0.01 times (x, z, -y) as position";
    assert!(warning.contains("in.ply: ") && warning.contains(expected), "{warning}");
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
        let stats = shade_surfels(
            &octree,
            &output,
            solid_angle,
            &["--check", "50", "--interpolation", "0"],
        );
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

/// A LAS 1.2 file of point format 0: a square of ground with a wall on it, far from the origin. Every tenth point is
/// noise, and intensities count.
fn scan() -> Vec<u8> {
    let mut points: Vec<[i32; 3]> = Vec::new();
    for i in 0..60 {
        points.extend((0..60).map(|k| [i * 50, k * 50, 0]));
        points.extend((1..20).map(|k| [i * 50, 1500, k * 50]));
    }
    let mut bytes = b"LASF".to_vec();
    bytes.resize(227, 0);
    bytes[24..26].copy_from_slice(&[1, 2]);
    bytes[94..96].copy_from_slice(&227u16.to_le_bytes());
    bytes[96..100].copy_from_slice(&227u32.to_le_bytes());
    bytes[105..107].copy_from_slice(&20u16.to_le_bytes());
    bytes[107..111].copy_from_slice(&(points.len() as u32).to_le_bytes());
    // Scales, offsets, and the box: largest and smallest of x, y, z.
    let box_of = [637_030.0, 637_000.0, 5_512_030.0, 5_512_000.0, 10.0, 0.0];
    let offsets = [637_000.0, 5_512_000.0, 0.0];
    let numbers = [0.01; 3].into_iter().chain(offsets).chain(box_of);
    for (k, number) in numbers.enumerate() {
        bytes[131 + 8 * k..139 + 8 * k].copy_from_slice(&f64::to_le_bytes(number));
    }
    for (i, point) in points.iter().enumerate() {
        bytes.extend(point.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend((i as u16).to_le_bytes());
        bytes.extend([0x11, if i % 10 == 0 { 7 } else { 2 }, 0, 3, 0, 0]);
    }
    bytes
}

/// All surfels of a scan, noise included.
fn read_scan(path: &Path) -> Vec<pbgi_cloud::Surfel> {
    let classes = pbgi_cloud::ClassFilter::Skip(Vec::new());
    let options = CloudOptions { classes, ..CloudOptions::default() };
    let mut source = LasPoints::open(path, &options).unwrap();
    let mut surfels = Vec::new();
    while source.read_chunk(&mut surfels).unwrap() {}
    surfels
}

#[test]
fn a_scan_comes_back_with_its_shading() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let bytes = scan();
    let count = (bytes.len() - 227) / 20;
    std::fs::write(path("in.las"), &bytes).unwrap();
    bake_to(text(&path("in.las")), 1, &path("scan.pbgi"));
    for name in ["out.las", "out.laz", "out.csv"] {
        let [octree, input, output] = ["scan.pbgi", "in.las", name].map(path);
        let files = [text(&octree), "--receivers", text(&input), "-o", text(&output)];
        shade(&[&files[..], &["--env-color", "2,1,0.5", "-q"]].concat());
    }
    assert!(read_scan(&path("out.las")) == read_scan(&path("in.las")));
    assert!(read_scan(&path("out.laz")) == read_scan(&path("in.las")));
    let las = std::fs::read(path("out.las")).unwrap();
    let offset = u32::from_le_bytes(las[96..100].try_into().unwrap()) as usize;
    assert_eq!(offset, 227 + 54 + 6 * 192);
    assert_eq!(las.len(), offset + count * (20 + 24));
    let table = std::fs::read_to_string(path("out.csv")).unwrap();
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    assert_eq!(names[..3], ["x", "y", "z"]);
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let (mut ground, mut foot) = (Vec::new(), Vec::new());
    for (i, line) in lines.enumerate() {
        let row: Vec<f64> = line.split(',').map(|word| word.parse().unwrap()).collect();
        let point = &las[offset + i * 44..][..44];
        assert_eq!(point[..20], bytes[227 + i * 20..][..20], "fields stay as they were");
        let value = |k: usize| f32::from_le_bytes(point[20 + 4 * k..][..4].try_into().unwrap());
        for (k, name) in [(1, "irradiance_r"), (4, "ao"), (5, "sky_visibility")] {
            assert_eq!(f64::from(value(k)), f64::from(row[column(name)] as f32), "{name}");
        }
        let luminance = 0.2126 * value(1) + 0.7152 * value(2) + 0.0722 * value(3);
        assert!((value(0) - luminance).abs() < 1e-5);
        assert!((row[0] - 637_015.0).abs() < 16.0 && (row[1] - 5_512_015.0).abs() < 16.0);
        let from_wall = (row[1] - 5_512_015.0).abs();
        if row[2] == 0.0 && (2.0..28.0).contains(&(row[0] - 637_000.0)) {
            if from_wall > 12.0 {
                ground.push(value(4));
            } else if (0.6..2.0).contains(&from_wall) {
                foot.push(value(4));
            }
        }
    }
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    // The wall hides up to half of the sky at its foot.
    let (ground, foot) = (mean(&ground), mean(&foot));
    assert!(ground > 0.85 && (0.4..0.75).contains(&foot), "{ground} {foot}");
}

#[test]
fn results_become_tables_for_analysis() {
    let folder = tempfile::tempdir().unwrap();
    let [input, npy, las] = ["in.ply", "out.npy", "out.las"].map(|name| folder.path().join(name));
    write_receivers(&input);
    let octree = octree();
    let files = [text(&octree), "--receivers", text(&input), "-q", "-o"];
    shade(&[&files[..], &[text(&npy)]].concat());
    let bytes = std::fs::read(&npy).unwrap();
    let header = String::from_utf8_lossy(&bytes[10..]).into_owned();
    assert!(header.contains("('id', '<f4')") && header.contains("'shape': (3,)"), "{header}");
    let message = fail(2, &[&files[..], &[text(&las)]].concat());
    assert!(message.contains("only the points of LAS"), "{message}");
}

#[test]
fn pictures_and_points_do_not_mix() {
    let octree = octree();
    let message = fail(2, &[text(&octree), "--surfels", "--scene", SCENE, "-o", "x.ply"]);
    assert!(message.contains("--scene"), "{message}");
}

#[test]
fn points_reflect_toward_the_eye() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["in.ply", "out.ply"].map(|name| folder.path().join(name));
    let columns = ["x", "y", "z", "nx", "ny", "nz", "roughness", "metalness"];
    let mut writer = PlyWriter::create(&input, &columns).unwrap();
    for roughness in [0.05, 0.5] {
        writer.write_rows(&[0.0, 50.0, 0.0, 0.0, 1.0, 0.0, roughness, 1.0]).unwrap();
    }
    writer.finish().unwrap();
    let octree = octree();
    let paths = [text(&octree), "--receivers", text(&input), "-o", text(&output), "--force"];
    let light = ["--env-color", "1,0.5,0", "-q", "--gloss"];
    let message = fail(2, &[&paths[..], &light].concat());
    assert!(message.contains("--eye"), "{message}");
    let eye = [&paths[..], &light, &["--eye", "30,90,0"]].concat();
    shade(&eye);
    let table = ReceiverTable::read(&output).unwrap();
    let red = table.column("specular_indirect_r").unwrap();
    // A metal of albedo 0.8 under an open sky of radiance 1.
    assert!((red[0] - 0.8).abs() < 0.01 && (0.7..0.81).contains(&red[1]), "{red:?}");
    let green = table.column("specular_indirect_g").unwrap();
    assert!((green[0] - 0.4).abs() < 0.005);
    // A flag counts more than a column: without a metal, little is reflected.
    shade(&[&eye[..], &["--metalness", "0"]].concat());
    let table = ReceiverTable::read(&output).unwrap();
    assert!(table.column("specular_indirect_r").unwrap()[0] < 0.1);
    let message = fail(2, &[&eye[..], &["--roughness", "2"]].concat());
    assert!(message.contains("--roughness is 2"), "{message}");
}

#[test]
fn the_target_error_is_met_by_other_receivers_than_those_measured() {
    let folder = tempfile::tempdir().unwrap();
    let octree = folder.path().join("room.pbgi");
    bake_to("demo:room", 20_000, &octree);
    let output = folder.path().join("out.ply");
    for (text, target) in [("10%", 0.1), ("3%", 0.03)] {
        let files = [self::text(&octree), "--surfels", "-o", self::text(&output), "--force"];
        let rest = ["--target-error", text, "--check", "150", "--stats-json", "-", "-q"];
        let json = shade(&[&files[..], &rest].concat());
        let stats: serde_json::Value = serde_json::from_str(&json).unwrap();
        let chosen = &stats["target"];
        assert!(chosen["error"].as_f64().unwrap() <= target, "{chosen}");
        assert!(chosen["receivers"].as_u64().unwrap() >= 100);
        assert_eq!(chosen["solid_angle_sr"], stats["solid_angle_sr"]);
        let found = stats["check"]["rrmse"].as_f64().unwrap();
        assert!(found <= 1.3 * target, "{target}: {found}");
    }
}

/// Shades with a memory limit; returns the statistics.
fn shade_within(files: &[&str], limit: &str, threads: &str) -> serde_json::Value {
    let quality = ["--solid-angle", "2", "--raster", "1", "--importance", "off"];
    let rest = ["--force", "--progress", "none", "--stats-json", "-"];
    let limits = ["--memory-limit", limit, "--threads", threads];
    serde_json::from_str(&shade(&[files, &quality, &rest, &limits].concat())).unwrap()
}

#[test]
fn receivers_stream_within_the_memory_limit() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["in.ply", "out.ply"].map(|name| folder.path().join(name));
    // 300 000 rows of 100 bytes: held at once, with their results, they take more than the limit.
    let names: Vec<String> = (0..19).map(|k| format!("c{k}")).collect();
    let names: Vec<&str> = ["x", "y", "z", "nx", "ny", "nz"]
        .into_iter()
        .chain(names.iter().map(String::as_str))
        .collect();
    let mut writer = PlyWriter::create(&input, &names).unwrap();
    for i in 0..300_000u32 {
        let mut row = [i as f32; 25];
        row[..3].copy_from_slice(&[(i % 500) as f32 * 0.02, 0.3, (i / 500) as f32 * 0.02]);
        row[3..6].copy_from_slice(&[0.0, 1.0, 0.0]);
        writer.write_rows(&row).unwrap();
    }
    writer.finish().unwrap();
    let octree = octree();
    let files = [text(&octree), "--receivers", text(&input), "-o", text(&output)];
    let mut results = Vec::new();
    // Chunks of 2^12 and 2^16 receivers.
    for (limit, threads) in [("64MiB", "2"), ("4GiB", "1")] {
        let stats = shade_within(&files, limit, threads);
        assert_eq!(stats["receivers"], 300_000);
        if let ("64MiB", Some(peak)) = (limit, stats["memory_peak_bytes"].as_u64()) {
            assert!(peak <= 64 << 20, "{peak}");
        }
        results.push(std::fs::read(&output).unwrap());
    }
    assert!(results[0] == results[1]);
    let table = ReceiverTable::read(&output).unwrap();
    let passed = table.column("c7").unwrap();
    assert!(passed.iter().enumerate().all(|(i, value)| *value == i as f32));
    // Damage in a late row names it, and the file is as it was.
    let mut bytes = std::fs::read(&input).unwrap();
    let at = bytes.len() - 100;
    bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&input, &bytes).unwrap();
    let message = fail(3, &[&files[..], &["--force", "-q", "--solid-angle", "2"]].concat());
    assert!(message.contains("vertex row 299999"), "{message}");
    assert!(std::fs::read(&output).unwrap() == results[0]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn limits_and_threads_never_change_a_scan() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("in.las"), scan()).unwrap();
    bake_to(text(&path("in.las")), 1, &path("scan.pbgi"));
    let [octree, input, output] = ["scan.pbgi", "in.las", "out.las"].map(path);
    let files = [text(&octree), "--receivers", text(&input), "-o", text(&output)];
    let results = [("64MiB", "1"), ("64MiB", "2"), ("2GiB", "2")].map(|(limit, threads)| {
        shade_within(&files, limit, threads);
        std::fs::read(&output).unwrap()
    });
    assert!(results[0] == results[1] && results[0] == results[2]);
}

#[test]
fn columns_keep_their_types_and_meshes_their_faces() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output, array] =
        ["in.ply", "out.ply", "out.npy"].map(|name| folder.path().join(name));
    let text_of = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nproperty int id\nproperty uchar red\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n\
        0 50 0 0 1 0 16777217 10\n1 50 0 0 1 0 123456789 200\n0 50 1 0 1 0 -7 255\n3 0 1 2\n";
    std::fs::write(&input, text_of).unwrap();
    let octree = octree();
    let arguments = |output: &Path| {
        let all = [
            text(&octree),
            "--receivers",
            text(&input),
            "--env-color",
            "1,1,1",
            "-q",
            "-o",
            text(output),
        ];
        all.map(str::to_owned)
    };
    let run = |output: &Path, more: &[&str]| {
        let arguments = arguments(output);
        let all: Vec<&str> =
            arguments.iter().map(String::as_str).chain(more.iter().copied()).collect();
        crate::support::run(&all)
    };
    assert!(run(&output, &["--strict"]).status.success());
    let table = ReceiverTable::read(&output).unwrap();
    let of = |name: &str| table.columns.iter().find(|column| column.name == name).unwrap();
    let ids: Vec<f64> = (0..3).map(|row| of("id").value(row)).collect();
    assert_eq!(ids, [16_777_217.0, 123_456_789.0, -7.0]);
    assert_eq!(
        (of("id").kind, of("red").kind),
        (pbgi_cloud::PlyType::I32, pbgi_cloud::PlyType::U8)
    );
    let bytes = std::fs::read(&output).unwrap();
    assert!(bytes.ends_with(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]));
    // An array has no place for faces: a warning, which --strict makes the end of the run.
    let output = run(&array, &["--strict"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(
        said.contains("1 rows of `face`") && said.contains("--strict") && array.exists(),
        "{said}"
    );
}

#[test]
fn columns_of_lists_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = ["in.ply", "out.ply"].map(|name| folder.path().join(name));
    let text_of = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nproperty list uchar int near\nend_header\n\
        0 50 0 0 1 0 1 7\n";
    std::fs::write(&input, text_of).unwrap();
    let octree = octree();
    let files = [text(&octree), "--receivers", text(&input), "-o", text(&output)];
    let all = [&files[..], &["--env-color", "1,1,1", "--strict"]].concat();
    let run = crate::support::run(&all);
    let said = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(3), "{said}");
    assert!(said.contains("columns of lists do not come back: near"), "{said}");
}

#[test]
fn names_that_tell_of_another_format_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let octree = octree();
    for (name, kind, expected) in [
        ("a.xyz", "--surfels", ".ply, .npy, .csv, .las, .laz"),
        ("a", "--surfels", ".ply, .npy"),
        ("a.png", "--scene=demo:spheres", "written as .exr (--preview"),
    ] {
        let output = folder.path().join(name);
        let message = fail(2, &[text(&octree), kind, "--env-color", "1,1,1", "-o", text(&output)]);
        assert!(message.contains(expected) && !output.exists(), "{message}");
    }
}
