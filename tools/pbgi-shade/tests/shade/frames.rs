//! Pictures.

use crate::support::{SCENE, fail, octree, shade, text};
use pbgi_image::{Aov, AovNames, AttributeValue, Image, Metadata, read_exr};
use pbgi_math::Vec3;
use std::path::Path;

/// Shades a small picture and reads it back.
fn picture(folder: &Path, extra: &[&str]) -> (Image, Metadata) {
    let (octree, target) = (octree(), folder.join("out.exr"));
    let fixed =
        [text(&octree), "-o", text(&target), "--resolution", "64x36", "--samples", "4", "-q"];
    shade(&[&fixed, extra].concat());
    read_exr(&target).unwrap()
}

/// The pixels of a quantity.
fn values<const K: usize>(image: &Image, aov: Aov) -> Vec<[f32; K]> {
    let names = AovNames::default().channels(aov);
    let planes: Vec<&[f32]> = names.iter().map(|name| image.channel(name).unwrap()).collect();
    (0..planes[0].len()).map(|i| std::array::from_fn(|k| planes[k][i])).collect()
}

#[test]
fn threads_and_memory_never_change_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let octree = octree();
    let mut files = Vec::new();
    for (threads, limit) in [("1", "1GiB"), ("2", "1GiB"), ("2", "64MiB"), ("1", "100MiB")] {
        let target = folder.path().join("out.exr");
        shade(&[
            text(&octree),
            "--scene",
            SCENE,
            "-o",
            text(&target),
            "--resolution",
            "64x36",
            "--env-color",
            "1,0.5,0.25",
            "--check",
            "20",
            "--threads",
            threads,
            "--memory-limit",
            limit,
            "--progress",
            "none",
        ]);
        files.push(std::fs::read(&target).unwrap());
    }
    assert!(files.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn positions_match_the_camera_and_channels_agree() {
    let folder = tempfile::tempdir().unwrap();
    let (image, metadata) = picture(folder.path(), &["--scene", SCENE, "--env-color", "2,1,0.5"]);
    let Some(AttributeValue::Matrix(to_ndc)) = metadata.attribute("worldToNDC") else {
        panic!("no worldToNDC")
    };
    let Some(AttributeValue::Matrix(to_camera)) = metadata.attribute("worldToCamera") else {
        panic!("no worldToCamera")
    };
    let beauty = values::<4>(&image, Aov::Beauty);
    let indirect = values::<3>(&image, Aov::DiffuseIndirect);
    let direct = values::<3>(&image, Aov::DiffuseDirect);
    let irradiance = values::<3>(&image, Aov::Irradiance);
    let [position, normal, bent] =
        [Aov::Position, Aov::Normal, Aov::BentNormal].map(|aov| values::<3>(&image, aov));
    let [open, depth] = [Aov::Occlusion, Aov::Depth].map(|aov| values::<1>(&image, aov));
    let mut covered = 0;
    for pixel in 0..64 * 36 {
        let alpha = beauty[pixel][3];
        assert!((0.0..=1.0).contains(&alpha) && (0.0..=1.001).contains(&open[pixel][0]));
        if alpha == 0.0 {
            assert_eq!(beauty[pixel], [2.0, 1.0, 0.5, 0.0]);
            assert_eq!((position[pixel], normal[pixel]), ([0.0; 3], [0.0; 3]));
            assert!(depth[pixel][0] > 1e9);
            continue;
        }
        covered += 1;
        let place = Vec3::from_array(position[pixel]);
        let ndc = *to_ndc * place.extend(1.0);
        let (x, y) = (ndc.x / ndc.w * 64.0, ndc.y / ndc.w * 36.0);
        let (column, row) = ((pixel % 64) as f32 + 0.5, (pixel / 64) as f32 + 0.5);
        // A piece seen at the edge of a pixel lies up to a micropolygon's diagonal from its middle.
        assert!((x - column).abs() < 2.0 && (y - row).abs() < 2.0, "{pixel}: {x} {y}");
        assert!((-to_camera.transform_point3(place).z / depth[pixel][0] - 1.0).abs() < 1e-3);
        assert!((Vec3::from_array(normal[pixel]).length() - 1.0).abs() < 1e-3);
        assert!((Vec3::from_array(bent[pixel]).length() - 1.0).abs() < 1e-2);
        if alpha == 1.0 {
            for c in 0..3 {
                let sum = direct[pixel][c] + indirect[pixel][c];
                assert!((beauty[pixel][c] - sum).abs() < 1e-6);
                // Nothing receives more than the whole sky gives.
                assert!(irradiance[pixel][c] <= 1.01 * std::f32::consts::PI * [2.0, 1.0, 0.5][c]);
            }
        }
    }
    assert!((500..64 * 36).contains(&covered), "{covered}");
}

#[test]
fn files_without_a_mesh_show_their_surfels() {
    let folder = tempfile::tempdir().unwrap();
    let (image, _) = picture(folder.path(), &["--env-color", "1,1,1"]);
    let beauty = values::<4>(&image, Aov::Beauty);
    let lit = beauty.iter().filter(|p| p[3] == 1.0 && p[1] > 0.01).count();
    assert!(lit > 200, "{lit}");
    let normals = values::<3>(&image, Aov::Normal);
    let upward = normals.iter().filter(|n| n[1] > 0.99).count();
    assert!(upward > 100, "{upward}");
}

#[test]
fn channels_and_names_are_those_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let scene = ["--scene", SCENE, "--aovs", "AO,N", "--aov-names", "blender"];
    let (image, metadata) = picture(folder.path(), &scene);
    let mut names: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["Ambient Occlusion", "Normal.X", "Normal.Y", "Normal.Z"]);
    assert!(
        matches!(metadata.attribute("pbgi:cutSizeMean"), Some(AttributeValue::Float(x)) if *x > 1.0)
    );
}

#[test]
fn previews_and_statistics_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let octree = octree();
    let [exr, png, json] = ["a.exr", "a.png", "a.json"].map(|name| folder.path().join(name));
    let table = shade(&[
        text(&octree),
        "--scene",
        SCENE,
        "-o",
        text(&exr),
        "--preview",
        text(&png),
        "--exposure",
        "0",
        "--stats-json",
        text(&json),
        "--check",
        "10",
        "--resolution",
        "32x18",
        "--env-color",
        "1,1,1",
        "--progress",
        "none",
    ]);
    for label in [
        "receivers per second",
        "error",
        "of interpolation alone",
        "peak memory",
        "read amplification",
    ] {
        assert!(table.contains(label), "{table}");
    }
    assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
    let stats: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!(stats["check"]["receivers"], 10);
    assert!(stats["check"]["rrmse"].as_f64().unwrap() < 0.2);
    let memory = &stats["memory"];
    let parts = ["held_bytes", "frame_bytes", "cache_bytes"].map(|k| memory[k].as_u64().unwrap());
    assert_eq!(parts.iter().sum::<u64>(), memory["limit_bytes"].as_u64().unwrap());
}

/// Each frame is the picture its own options would make, under its own name.
#[test]
fn frames_are_numbered_and_turn() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let octree = octree();
    // A sky with one bright side, so that turning it shows.
    let mut sky = Image::new(16, 8);
    for name in ["R", "G", "B"] {
        sky.push(name, (0..128).map(|i| if i % 16 < 4 { 5.0 } else { 0.1 }).collect());
    }
    pbgi_image::write_exr(&path("sky.exr"), &sky, &[]).unwrap();
    let sky = path("sky.exr");
    let fixed = [text(&octree), "--scene", SCENE, "--resolution", "32x24", "--samples", "1", "-q"];
    let light = ["--env", text(&sky), "--camera-position=4,3,6", "--camera-target=0,0.5,0"];
    let (all, sheet) = (path("f.###.exr"), path("sheet.#.png"));
    let animation = ["--frames", "8-12x2", "--env-turn", "15", "--camera-turn=-5"];
    let outputs = ["-o", text(&all), "--contact-sheet", text(&sheet)];
    shade(&[&fixed[..], &light, &animation, &outputs].concat());
    let read = |name: &str| read_exr(&path(name)).unwrap().0;
    for (k, name) in ["f.008.exr", "f.010.exr", "f.012.exr"].into_iter().enumerate() {
        let (sin, cos) = (f64::from(8 + 2 * k as u32) * -5.0).to_radians().sin_cos();
        let eye = format!("{},3,{}", 4.0 * cos + 6.0 * sin, -4.0 * sin + 6.0 * cos);
        let light = ["--env", text(&sky), "--camera-position", &eye];
        let camera = ["--camera-target=0,0.5,0", "--env-rotate", &(15 * (8 + 2 * k)).to_string()];
        let one = path("one.exr");
        shade(&[&fixed[..], &light, &camera, &["-o", text(&one)]].concat());
        let (frame, one) = (read(name), read("one.exr"));
        let [frame, one] = [&frame, &one].map(|image| image.channel("irradiance.G").unwrap());
        let difference: f32 = frame.iter().zip(one).map(|(a, b)| (a - b).abs()).sum();
        assert!(difference < 1e-3 * one.iter().sum::<f32>(), "{name}: {difference}");
    }
    let changed =
        |channel: &str| read("f.008.exr").channel(channel) != read("f.010.exr").channel(channel);
    assert!(changed("irradiance.G") && changed("Z"));
    for name in ["sheet.8.png", "sheet.10.png", "sheet.12.png"] {
        assert!(std::fs::read(path(name)).unwrap().starts_with(b"\x89PNG"), "{name}");
    }
    let same = path("same.exr");
    let message = fail(2, &[&fixed[..], &animation[..2], &["-o", text(&same)]].concat());
    assert!(message.contains("####"), "{message}");
}
