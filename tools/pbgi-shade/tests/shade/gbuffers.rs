//! G-buffers, and cameras in files.

use crate::support::{SCENE, bake_lit, fail, octree, shade, text};
use pbgi_image::{
    AttributeValue, Image, ImageWindow, Metadata, Samples, StoredChannel, read_exr,
    read_stored_exr, write_windowed_exr,
};
use std::path::Path;

const CAMERA: [&str; 2] = ["--camera-position=4,3,6", "--camera-target=0,0.5,0"];

/// A picture of the scene with everything a G-buffer needs.
fn picture(target: &Path) {
    let octree = octree();
    let files = [text(&octree), "--scene", SCENE, "-o", text(target), "-q"];
    let quality = ["--resolution", "48x32", "--samples", "1", "--env-color", "1,0.5,0.25"];
    shade(&[&files[..], &CAMERA, &quality].concat());
}

/// The picture's own channels as those of another renderer, somewhere in a larger frame.
fn write_gbuffer(picture: &Path, target: &Path, names: &[(&str, &str)]) -> Metadata {
    let (image, metadata) = read_exr(picture).unwrap();
    let mut gbuffer = Image::new(image.width, image.height);
    for (own, theirs) in names {
        for k in ["X", "Y", "Z", "R", "G", "B", "A"] {
            if let Some(data) = image.channel(&format!("{own}.{k}")) {
                gbuffer.push(format!("{theirs}.{k}"), data.to_vec());
            }
        }
    }
    gbuffer.push("A", image.channel("A").unwrap().to_vec());
    let ids = Samples::Uint((0..48 * 32).map(|i| u32::MAX - i).collect());
    let stored = [StoredChannel { name: "objectId".to_owned(), samples: ids }];
    let window =
        ImageWindow { data_origin: [5, -9], display_origin: [0, 0], display_size: [64, 48] };
    let mut attributes = metadata.attributes.clone();
    attributes.retain(|(name, _)| name.starts_with("worldTo"));
    attributes.push(("shot".to_owned(), AttributeValue::Text("x_010".to_owned())));
    write_windowed_exr(target, &gbuffer, &stored, &window, &attributes).unwrap();
    metadata
}

#[test]
fn g_buffers_of_all_renderers_give_the_light_of_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let [own, gbuffer, output] = ["p.exr", "g.exr", "o.exr"].map(|name| folder.path().join(name));
    picture(&own);
    let (expected, _) = read_exr(&own).unwrap();
    for names in [
        [("P", "P"), ("N", "N"), ("albedo", "albedo")],
        [("P", "V.Position"), ("N", "V.Normal"), ("albedo", "V.Diffuse Color")],
        [("P", "__Pworld"), ("N", "__Nworld"), ("albedo", "albedo")],
    ] {
        let metadata = write_gbuffer(&own, &gbuffer, &names);
        let octree = octree();
        let files = [text(&octree), "--gbuffer", text(&gbuffer), "-o", text(&output), "-q"];
        let light = ["--env-color", "1,0.5,0.25", "--stats-json", "-"];
        let stats = shade(&[&files[..], &light].concat());
        let (found, found_metadata) = read_exr(&output).unwrap();
        assert_eq!((found.width, found.height), (48, 32));
        assert_eq!(found_metadata.window.data_origin, [5, -9]);
        assert_eq!(found_metadata.window.display_size, [64, 48]);
        for name in ["worldToCamera", "worldToNDC"] {
            assert_eq!(found_metadata.attribute(name), metadata.attribute(name));
        }
        assert!(found.channel("objectId").is_none());
        let alpha = expected.channel("A").unwrap();
        let empty = alpha.iter().filter(|a| **a == 0.0).count();
        assert!(empty > 20, "{empty} pixels show no surface");
        let stats: serde_json::Value = serde_json::from_str(&stats).unwrap();
        assert_eq!(stats["empty_pixels"], empty);
        assert_eq!(stats["receivers"], alpha.len() - empty);
        for name in ["irradiance.G", "AO", "diffuse_direct.R"] {
            let [found, expected] = [&found, &expected].map(|image| image.channel(name).unwrap());
            // A picture's pieces are shaded in their middles, a G-buffer's pixels in theirs.
            let error = |(found, expected): (&f32, &f32)| f64::from((found - expected).abs());
            let sum: f64 = found.iter().zip(expected).map(error).sum();
            let mean: f64 = expected.iter().map(|x| f64::from(*x)).sum();
            assert!(sum / mean < 0.03, "{name}: {}", sum / mean);
            let dark = |(pixel, alpha): (&f32, &f32)| *alpha > 0.0 || *pixel == 0.0;
            assert!(found.iter().zip(alpha).all(dark), "{name} is 0 where no surface is");
        }
    }
}

/// Sky and surfaces are apart, and add up to the beauty: as they are by Arnold's and RenderMan's names, and by Blender's after
/// multiplication with the color, as compositors do it. A pixel of a G-buffer is one surface, so that this is exact.
#[test]
fn sky_and_surface_light_add_up_in_the_units_of_each_program() {
    let folder = tempfile::tempdir().unwrap();
    let [own, gbuffer, output] = ["p.exr", "g.exr", "o.exr"].map(|name| folder.path().join(name));
    let octree = folder.path().join("lit.pbgi");
    bake_lit(&octree);
    picture(&own);
    write_gbuffer(&own, &gbuffer, &[("P", "P"), ("N", "N"), ("albedo", "albedo")]);
    let (given, _) = read_exr(&gbuffer).unwrap();
    for (preset, beauty, direct, indirect, has_color) in [
        ("arnold", "", "diffuse_direct.", "diffuse_indirect.", true),
        ("blender", "Combined.", "Diffuse Direct.", "Diffuse Indirect.", false),
        ("renderman", "Ci.", "directDiffuse.", "indirectDiffuse.", true),
    ] {
        let files = [text(&octree), "--gbuffer", text(&gbuffer), "-o", text(&output), "-q"];
        let more = ["--env-color", "1,0.5,0.25", "--aov-names", preset];
        shade(&[&files[..], &more].concat());
        let (found, _) = read_exr(&output).unwrap();
        let mut sums = [0.0; 2];
        for c in ["R", "G", "B"] {
            let channel = |layer: &str| found.channel(&format!("{layer}{c}")).unwrap();
            let albedo = given.channel(&format!("albedo.{c}")).unwrap();
            for pixel in 0..48 * 32 {
                let color = if has_color { 1.0 } else { albedo[pixel] };
                let parts = [direct, indirect].map(|layer| channel(layer)[pixel] * color);
                let whole = channel(beauty)[pixel];
                assert!((parts[0] + parts[1] - whole).abs() <= 1e-5 * whole, "{preset} {pixel}");
                sums = [0, 1].map(|i| sums[i] + parts[i]);
            }
        }
        assert!(sums[0] > 10.0 * 0.25 && sums[1] > 1.0, "both shine: {sums:?}");
    }
}

/// With Z up, in centimeters: a warning names the options, and with them the light and the bent normals are those of the picture.
#[test]
fn another_axis_and_unit_are_named_and_mended() {
    let folder = tempfile::tempdir().unwrap();
    let [own, gbuffer, output] = ["p.exr", "g.exr", "o.exr"].map(|name| folder.path().join(name));
    picture(&own);
    let (image, _) = read_exr(&own).unwrap();
    let mut other = Image::new(image.width, image.height);
    for (layer, scale) in [("P", 100.0), ("N", 1.0)] {
        for (theirs, own, sign) in [("X", "X", 1.0), ("Y", "Z", -1.0), ("Z", "Y", 1.0)] {
            let data = image.channel(&format!("{layer}.{own}")).unwrap();
            other.push(
                format!("{layer}.{theirs}"),
                data.iter().map(|v| sign * scale * v).collect::<Vec<f32>>(),
            );
        }
    }
    write_windowed_exr(&gbuffer, &other, &[], &ImageWindow::whole(48, 32), &[]).unwrap();
    let octree = octree();
    let files = [text(&octree), "--gbuffer", text(&gbuffer), "-o", text(&output)];
    let light = ["--env-color", "1,0.5,0.25", "--progress", "none"];
    let message = fail(3, &[&files[..], &light, &["--strict"]].concat());
    assert!(message.contains("add --gbuffer-up z --gbuffer-scale 0.01"), "{message}");
    let cure = ["--gbuffer-up", "z", "--gbuffer-scale", "0.01", "--aovs", "AO,bent_normal"];
    shade(&[&files[..], &light, &cure, &["--strict"]].concat());
    let (found, _) = read_exr(&output).unwrap();
    let mut errors = [0.0; 4];
    for (error, (theirs, own, sign)) in errors.iter_mut().zip([
        ("AO", "AO", 1.0),
        ("bent_normal.X", "bent_normal.X", 1.0),
        ("bent_normal.Y", "bent_normal.Z", -1.0),
        ("bent_normal.Z", "bent_normal.Y", 1.0),
    ]) {
        let [found, expected] =
            [(&found, theirs), (&image, own)].map(|(image, name)| image.channel(name).unwrap());
        let apart = found.iter().zip(expected).map(|(found, own)| (found - sign * own).abs());
        *error = apart.sum::<f32>() / found.len() as f32;
    }
    assert!(errors.iter().all(|error| *error < 0.03), "{errors:?}");
    let message = fail(2, &[&files[..], &light, &["--gbuffer-scale", "0"]].concat());
    assert!(message.contains("--gbuffer-scale is 0"), "{message}");
}

#[test]
fn foreign_channels_pass_through_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let [own, gbuffer, output] = ["p.exr", "g.exr", "o.exr"].map(|name| folder.path().join(name));
    picture(&own);
    write_gbuffer(&own, &gbuffer, &[("P", "P"), ("N", "N")]);
    let octree = octree();
    let files = [text(&octree), "--gbuffer", text(&gbuffer), "-o", text(&output)];
    let more = ["--pass-through", "--aovs", "AO,irradiance", "--env-color", "1,1,1"];
    shade(&[&files[..], &more, &["--progress", "none"]].concat());
    let (given, _) = read_stored_exr(&gbuffer).unwrap();
    let (found, metadata) = read_stored_exr(&output).unwrap();
    for channel in &given.channels {
        assert!(found.channels.contains(channel), "{}", channel.name);
    }
    assert_eq!(found.channels.len(), given.channels.len() + 4);
    assert_eq!(metadata.attribute("shot"), Some(&AttributeValue::Text("x_010".to_owned())));
}

/// A camera goes into a picture's matrices and comes out again: the same picture, pixel by pixel.
#[test]
fn a_picture_is_a_camera_file() {
    let folder = tempfile::tempdir().unwrap();
    let [own, again, json] = ["p.exr", "a.exr", "c.json"].map(|name| folder.path().join(name));
    picture(&own);
    let (expected, _) = read_exr(&own).unwrap();
    std::fs::write(&json, r#"{"position": [4, 3, 6], "target": [0, 0.5, 0], "fov": 45}"#).unwrap();
    for file in [&own, &json] {
        let octree = octree();
        let files = [text(&octree), "--scene", SCENE, "-o", text(&again), "-q"];
        let camera = ["--camera-file", text(file), "--resolution", "48x32", "--samples", "1"];
        shade(&[&files[..], &camera, &["--env-color", "1,0.5,0.25"]].concat());
        let (found, _) = read_exr(&again).unwrap();
        let [found, expected] = [&found, &expected].map(|image| image.channel("Z").unwrap());
        let far = found.iter().zip(expected).filter(|(a, b)| (*a - *b).abs() > 1e-3 * *b).count();
        assert!(far < 10, "{far} pixels differ");
    }
}

#[test]
fn g_buffers_without_surfaces_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let gbuffer = folder.path().join("g.exr");
    let mut image = Image::new(2, 2);
    for name in ["P.X", "P.Y", "P.Z", "N.X", "N.Y", "N.Z"] {
        image.push(name, vec![0.0; 4]);
    }
    write_windowed_exr(&gbuffer, &image, &[], &ImageWindow::whole(2, 2), &[]).unwrap();
    let octree = octree();
    let files = [text(&octree), "--gbuffer", text(&gbuffer), "-o", "x.exr"];
    let message = fail(3, &files);
    assert!(message.contains("no pixel shows a surface"), "{message}");
    let message = fail(2, &[&files[..], &["--aovs", "P"]].concat());
    assert!(message.contains("there is no `P`"), "{message}");
}
