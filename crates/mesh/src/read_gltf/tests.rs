//! Small documents, sound and damaged.

use super::*;
use pbgi_math::{Vec2, Vec3};
use std::fmt::Write;

/// Bytes of one buffer, and views and accessors into it.
#[derive(Default)]
struct Builder {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Builder {
    /// Adds a view of `data`; returns its index.
    fn view(&mut self, data: &[u8], extra: &str) -> usize {
        let (offset, length) = (self.bytes.len(), data.len());
        self.bytes.extend(data);
        self.views
            .push(format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length}{extra}}}"#));
        self.views.len() - 1
    }

    fn accessor(&mut self, data: &[u8], kind: u32, type_: &str, count: usize, extra: &str) {
        let view = self.view(data, "");
        self.accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":{kind},"type":"{type_}","count":{count}{extra}}}"#
        ));
    }

    fn glb(&self, rest: &str) -> Vec<u8> {
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":{}}}],"bufferViews":[{}],"accessors":[{}],{rest}}}"#,
            self.bytes.len(),
            self.views.join(","),
            self.accessors.join(",")
        );
        pack_glb(json.as_bytes(), &self.bytes)
    }
}

fn pack_glb(json: &[u8], binary: &[u8]) -> Vec<u8> {
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((28 + json.len() as u32 + binary.len() as u32).to_le_bytes());
    for (kind, data) in [(b"JSON", json), (b"BIN\0", binary)] {
        glb.extend((data.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(data);
    }
    glb
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

const QUAD: [f32; 12] = [0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 0.];

/// A strip of two triangles with u8 indices, texture coordinates and colors.
fn quad() -> Builder {
    let mut builder = Builder::default();
    builder.accessor(&floats(&QUAD), 5126, "VEC3", 4, "");
    builder.accessor(&[0, 1, 2, 3], 5121, "SCALAR", 4, "");
    builder.accessor(&[0, 0, 255, 0, 0, 255, 255, 255], 5121, "VEC2", 4, r#","normalized":true"#);
    builder.accessor(&[255, 0, 51, 255].repeat(4), 5121, "VEC4", 4, r#","normalized":true"#);
    builder
}

const SCENE: &str = r#""scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"meshes":[{"primitives":[
    {"mode":5,"attributes":{"POSITION":0,"TEXCOORD_0":2,"COLOR_0":3},"indices":1,"material":0}]}],
    "materials":[{"name":"m"}]"#;

fn parse(glb: &[u8]) -> Result<Scene, SceneError> {
    parse_gltf(Path::new("test.glb"), glb, &Resources::new(&pbgi_file::Allowance::unlimited()))
}

#[test]
fn strips_with_small_types_are_read() {
    let scene = parse(&quad().glb(SCENE)).unwrap();
    let mesh = &scene.meshes[0];
    assert_eq!(mesh.triangles, [[0, 1, 2], [2, 1, 3]]);
    assert_eq!(mesh.positions[3], Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(mesh.colors, [[1.0, 0.0, 0.2]; 4]);
    // Without a texture no coordinates are needed.
    assert!(mesh.uvs.is_empty() && mesh.normals.is_empty());
    assert_eq!((scene.materials.len(), scene.warnings.len()), (1, 0));
}

#[test]
fn missing_indices_materials_and_scenes_are_made_up() {
    let mut builder = Builder::default();
    builder.accessor(&floats(&QUAD[..9]), 5126, "VEC3", 3, "");
    let rest = r#""nodes":[{"children":[1]},{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#;
    let scene = parse(&builder.glb(rest)).unwrap();
    assert_eq!(scene.meshes[0].triangles, [[0, 1, 2]]);
    assert_eq!(scene.materials[scene.meshes[0].material as usize].metallic, 0.0);
    assert_eq!(scene.instances.len(), 1);
}

#[test]
fn sparse_and_strided_accessors_are_read() {
    let mut builder = Builder::default();
    let padded: Vec<f32> = QUAD[..9].chunks(3).flat_map(|p| [p[0], p[1], p[2], 9.0]).collect();
    let view = builder.view(&floats(&padded), r#","byteStride":16"#);
    let indices = builder.view(&[2, 0], "");
    let values = builder.view(&floats(&[7., 8., 9.]), "");
    builder.accessors.push(format!(
        r#"{{"bufferView":{view},"componentType":5126,"type":"VEC3","count":3,"sparse":{{"count":1,
        "indices":{{"bufferView":{indices},"componentType":5123}},"values":{{"bufferView":{values}}}}}}}"#
    ));
    let rest = r#""nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#;
    let scene = parse(&builder.glb(rest)).unwrap();
    assert_eq!(scene.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::new(7.0, 8.0, 9.0)]);
    let outside = builder.glb(rest);
    let place = outside.windows(2).rposition(|w| w == [2, 0]).unwrap();
    let mut outside = outside;
    outside[place] = 3;
    assert!(parse(&outside).unwrap_err().to_string().contains("sparse index 3"));
}

#[test]
fn transforms_nest_and_mirror() {
    let nodes = r#""scene":0,"scenes":[{"nodes":[2]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0,"translation":[1,0,0]},{"mesh":0,"scale":[-1,1,1]},
        {"rotation":[0,0,1.4142,1.4142],"translation":[0,0,5],"children":[0,1]}]"#;
    let mut builder = Builder::default();
    builder.accessor(&floats(&QUAD[..9]), 5126, "VEC3", 3, "");
    let scene = parse(&builder.glb(nodes)).unwrap();
    assert_eq!(scene.meshes.len(), 1);
    let [first, second] = &scene.instances[..] else { panic!("{:?}", scene.instances) };
    // A quarter turn about +Z takes +X to +Y.
    let moved = first.transform.transform_point3(Vec3::X);
    assert!((moved - Vec3::new(0.0, 2.0, 5.0)).length() < 1e-5, "{moved}");
    assert!(!first.flips() && second.flips());
}

#[test]
fn materials_are_read_with_their_extensions() {
    let png = tiny_png([255, 188, 0, 100]);
    let mut builder = quad();
    let view = builder.view(&png, "");
    let rest = format!(
        r#""extensionsRequired":["KHR_texture_transform"],
        "extensionsUsed":["KHR_texture_transform","KHR_materials_emissive_strength"],
        "nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[
        {{"mode":5,"attributes":{{"POSITION":0,"TEXCOORD_0":2}},"indices":1,"material":0}}]}}],
        "images":[{{"bufferView":{view},"mimeType":"image/png"}}],"textures":[{{"source":0}}],
        "materials":[{{"alphaMode":"MASK","alphaCutoff":0.3,"doubleSided":true,
        "emissiveFactor":[1,0.5,0.25],
        "extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":8}}}},
        "pbrMetallicRoughness":{{"baseColorFactor":[0.5,0.5,0.5,0.6],"metallicFactor":0.25,
        "baseColorTexture":{{"index":0,"extensions":{{"KHR_texture_transform":
        {{"offset":[0.5,0],"scale":[2,4],"rotation":1.5707963}}}}}}}}}}]"#
    );
    let scene = parse(&builder.glb(&rest)).unwrap();
    let material = &scene.materials[0];
    assert_eq!(material.emission, [8.0, 4.0, 2.0]);
    assert!((material.alpha_cutoff.unwrap() - 0.5).abs() < 1e-6 && material.double_sided);
    assert_eq!((material.base_color, material.metallic), ([0.5; 3], 0.25));
    let texture = &scene.textures[material.base_color_texture.unwrap() as usize];
    assert_eq!(texture.texels(), [[255, 188, 0, 100]]);
    // (u, v) → (v', -u') + offset, after scaling.
    assert!((scene.meshes[0].uvs[3] - Vec2::new(4.5, -2.0)).length() < 1e-5);
    // Of an opaque material the alpha is dropped.
    let opaque = parse(&builder.glb(&rest.replace(r#""MASK","#, r#""OPAQUE","#))).unwrap();
    assert_eq!(opaque.textures[0].texels(), [[255, 188, 0, 255]]);
    // So is a cutoff that nothing falls below.
    let solid = parse(&builder.glb(&rest.replace(":0.3,", ":0.1,"))).unwrap();
    assert_eq!(solid.materials[0].alpha_cutoff, None);
}

fn tiny_png(pixel: [u8; 4]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(vec![]);
    let image = image::RgbaImage::from_pixel(1, 1, image::Rgba(pixel));
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn blended_glass_is_a_hole_with_a_warning() {
    let rest = SCENE.replace(
        r#"{"name":"m"}"#,
        r#"{"alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorFactor":[1,1,1,0.2]}}"#,
    );
    let scene = parse(&quad().glb(&rest)).unwrap();
    assert!(scene.materials[0].alpha_cutoff.unwrap() > 1.0);
    assert_eq!(scene.warnings.len(), 1);
    let cloudy = parse(&quad().glb(&rest.replace("0.2]", "0.7]"))).unwrap();
    assert_eq!(cloudy.materials[0].alpha_cutoff, None);
}

#[test]
fn cameras_are_rigid() {
    let rest = r#""nodes":[{"scale":[3,1,2],"rotation":[0,0.6,0,0.8],"children":[1]},
        {"camera":0,"translation":[0,0,1],"name":"eye"},{"camera":1}],
        "cameras":[{"type":"perspective","perspective":{"yfov":0.7,"znear":0.1}},
        {"type":"orthographic","orthographic":{"xmag":1,"ymag":1,"znear":0,"zfar":1}}]"#;
    let scene = parse(&quad().glb(rest)).unwrap();
    assert_eq!((scene.cameras.len(), scene.warnings.len()), (1, 1), "{:?}", scene.warnings);
    let camera = &scene.cameras[0];
    assert_eq!((camera.name.as_str(), camera.yfov), ("eye", 0.7));
    let axes = camera.transform.matrix3;
    assert!((axes.determinant() - 1.0).abs() < 1e-5);
    assert!((Vec3::from(axes.z_axis) - Vec3::new(0.96, 0.0, 0.28)).length() < 1e-5);
    assert!((camera.transform.translation.x - 1.92).abs() < 1e-5);
}

#[test]
fn files_beside_and_data_uris_are_found() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("q u.bin"), floats(&QUAD[..9])).unwrap();
    let path = folder.path().join("test.gltf");
    for uri in [
        "q%20u.bin",
        "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA",
    ] {
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":36,"uri":"{uri}"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],"nodes":[{{"mesh":0}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}]}}"#
        );
        std::fs::write(&path, json).unwrap();
        let scene = crate::read_scene(&path).unwrap();
        assert_eq!(scene.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
    }
    let missing = std::fs::read_to_string(&path).unwrap().replace("data:", "http://data:");
    std::fs::write(&path, missing).unwrap();
    assert!(matches!(crate::read_scene(&path), Err(SceneError::Unsupported { .. })));
}

/// A triangle whose buffer is beside the file under `name`, if that is given, and called `uri` in it.
fn read_triangle(uri: &str, name: Option<&str>) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    if let Some(name) = name {
        std::fs::write(folder.path().join(name), floats(&QUAD[..9])).unwrap();
    }
    let path = folder.path().join("test.gltf");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":36,"uri":"{uri}"}}],
        "bufferViews":[{{"buffer":0,"byteLength":36,"byteStride":0}}],"nodes":[{{"mesh":0}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}]}}"#
    );
    std::fs::write(&path, json).unwrap();
    crate::read_scene(&path)
}

#[test]
fn uris_are_read_as_writers_write_them() {
    for (uri, name) in [
        ("data:;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA", None),
        (
            "DATA:application/gltf-buffer;charset=x;BASE64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA",
            None,
        ),
        ("data:text/plain;base64,AAAAAAAAAAAAAAAAAACAPwAA\\nAAAAAAAAAAAAAAAAgD8AAAAA\\n", None),
        ("b%C3%BCf%20a.bin", Some("b\u{fc}f a.bin")),
        ("b\u{fc}f a.bin", Some("b\u{fc}f a.bin")),
        ("a%20b.bin", Some("a%20b.bin")),
        ("100%.bin", Some("100%.bin")),
        ("maps\\\\a.bin", Some("a.bin")),
    ] {
        let scene = read_triangle(uri, name).unwrap_or_else(|e| panic!("{uri}: {e}"));
        assert_eq!(scene.meshes[0].positions, [Vec3::ZERO, Vec3::X, Vec3::Y], "{uri}");
    }
}

#[test]
fn meshes_that_are_compressed_only_are_refused_with_the_cure() {
    let mut builder = quad();
    builder.accessors[0] = r#"{"componentType":5126,"type":"VEC3","count":4}"#.into();
    let draco = r#""indices":1,"extensions":{"KHR_draco_mesh_compression":{"bufferView":0,"attributes":{"POSITION":0}}}"#;
    let rest = quad_with("", "", "", "").replace("\"indices\":1", draco);
    let refused = parse(&builder.glb(&rest)).unwrap_err().to_string();
    assert!(refused.contains("KHR_draco") && refused.contains("gltf-transform copy"), "{refused}");
    let scene = parse(&quad().glb(&rest)).unwrap();
    assert!(scene.warnings[0].contains("uncompressed copy"), "{:?}", scene.warnings);
    let copy = r#""buffers":[{"byteLength":9},{"byteLength":48,"extensions":{"EXT_meshopt_compression":{"fallback":true}}}],"#;
    let json = format!(r#"{{"asset":{{"version":"2.0"}},{copy}"nodes":[{{}}]}}"#);
    let refused = parse(json.as_bytes()).unwrap_err().to_string();
    assert!(
        refused.contains("EXT_meshopt") && refused.contains("gltf-transform copy"),
        "{refused}"
    );
}

#[test]
fn what_changes_light_and_is_not_read_is_named_even_where_it_is_not_listed() {
    let root = r#""materials":[{"normalTexture":{"index":0},"extensions":{"KHR_materials_unlit":{},"KHR_materials_ior":{"ior":1.3}},
        "extras":{"extensions":{"VENDOR_a":{}}}}],"textures":[{"source":0}],"images":[{"uri":"none.png"}],"#;
    let warnings = warnings_of(&quad_with("", "", "", root));
    let [unlit, bumps] = &warnings[..] else { panic!("{warnings:?}") };
    assert!(
        unlit.contains("KHR_materials_unlit") && bumps.contains("1 materials have normal maps")
    );
    let colors = r#","extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"_COLOR_0":3,"TRANSLATION":0}}}"#;
    let warnings = warnings_of(&quad_with(colors, "", "", ""));
    assert!(warnings[0].contains("1 nodes have instances with colors"), "{warnings:?}");
}

#[test]
fn meshes_beside_the_scene_are_counted() {
    let rest = quad_with("", "", "", r#""scene":0,"#).replace(
        r#""nodes":[{"mesh":0}]"#,
        r#""nodes":[{"mesh":0},{"mesh":0},{"children":[3]},{"mesh":0}]"#,
    );
    let warnings = warnings_of(&rest);
    assert!(warnings[0].starts_with("2 nodes with meshes are not in the scene"), "{warnings:?}");
    // What is hidden is told once.
    let hidden = rest.replace(r#"{"mesh":0},{"mesh":0},"#, r#"{"mesh":0,"extensions":{"KHR_node_visibility":{"visible":false}},"children":[1,2]},{"mesh":0},"#);
    let warnings = warnings_of(&hidden);
    assert!(warnings.len() == 1 && warnings[0].starts_with("1 nodes are hidden"), "{warnings:?}");
}

#[test]
fn colors_of_integers_are_shares_of_their_range() {
    let mut builder = quad();
    builder.accessor(&[51, 0, 255, 255].repeat(4), 5121, "VEC4", 4, "");
    let scene = parse(&builder.glb(&quad_with("", "", r#","COLOR_0":4"#, ""))).unwrap();
    assert_eq!(scene.meshes[0].colors[0], [0.2, 0.0, 1.0]);
}

#[test]
fn text_that_is_not_utf_8_costs_names_only() {
    let mut json = br#"{"asset":{"version":"2.0","generator":"caf"#.to_vec();
    json.push(0xe9);
    json.extend(br#""},"nodes":[{}]}"#);
    assert!(parse(&json).is_ok());
}

#[test]
fn required_extensions_that_change_shapes_are_refused_by_name_and_cure() {
    for (extension, cure) in [
        ("KHR_draco_mesh_compression", "gltf-transform copy"),
        ("EXT_meshopt_compression", "gltf-transform copy"),
        ("CESIUM_RTC", "export it again"),
        ("VENDOR_unheard_of", "export it again"),
    ] {
        let rest = format!(r#""extensionsRequired":["{extension}"],{SCENE}"#);
        let error = parse(&quad().glb(&rest)).unwrap_err();
        assert!(matches!(error, SceneError::Unsupported { .. }));
        let message = error.to_string();
        assert!(message.contains(extension) && message.contains(cure), "{message}");
    }
}

#[test]
fn damage_is_named() {
    let quad = quad();
    let sound = String::from_utf8_lossy(&quad.glb(SCENE)).into_owned();
    assert!(sound.contains("glTF"));
    let json = {
        let glb = quad.glb(SCENE);
        let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
        String::from_utf8(glb[20..20 + length].to_vec()).unwrap()
    };
    for (from, to, expected) in [
        (
            r#""type":"VEC3","count":4"#,
            r#""type":"VEC3","count":5"#,
            "mesh 0, primitive 0: POSITION: 5 elements",
        ),
        (r#""count":4"#, r#""count":1e300"#, "json"),
        (r#""count":4"#, r#""count":18446744073709551615"#, "elements"),
        (r#""type":"VEC3","#, r#""type":"VEC2","#, "vec2"),
        (r#""byteOffset":48"#, r#""byteOffset":18446744073709551600"#, "buffer view 1"),
        (r#""buffers":[{"byteLength":76"#, r#""buffers":[{"byteLength":99"#, "99 bytes"),
        (
            r#""bufferView":1,"componentType":5121"#,
            r#""bufferView":1,"componentType":5126"#,
            "elements",
        ),
        (r#"[{"mesh":0}]"#, r#"[{"mesh":0,"children":[0]}]"#, "tree"),
        (r#"[{"mesh":0}]"#, r#"[{"mesh":7}]"#, "invalid gltf"),
        (
            r#"[{"mesh":0}]"#,
            r#"[{"mesh":0,"scale":[1e38,1,1],"children":[1]},{"scale":[1e38,1,1]}]"#,
            "finite",
        ),
        (r#""COLOR_0":3"#, r#""COLOR_0":1"#, "COLOR_0"),
    ] {
        assert!(json.contains(from), "{from} in {json}");
        let damaged = json.replacen(from, to, 1);
        let message = parse(&pack_glb(damaged.as_bytes(), &quad.bytes)).unwrap_err().to_string();
        assert!(message.contains(expected), "{from}: {message}");
    }
    let mut bytes = quad.bytes.clone();
    bytes[51] = 4;
    let message = parse(&pack_glb(json.as_bytes(), &bytes)).unwrap_err().to_string();
    assert!(message.contains("vertex index 4"), "{message}");
    bytes = quad.bytes;
    bytes[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
    let message = parse(&pack_glb(json.as_bytes(), &bytes)).unwrap_err().to_string();
    assert!(message.contains("position of vertex 1"), "{message}");
}

#[test]
fn truncated_and_mutated_files_never_panic() {
    let png = tiny_png([1, 2, 3, 4]);
    let mut builder = quad();
    let view = builder.view(&png, "");
    let mut rest = SCENE.replace(
        r#"{"name":"m"}"#,
        r#"{"alphaMode":"MASK","pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}"#,
    );
    write!(
        rest,
        r#","images":[{{"bufferView":{view},"mimeType":"image/png"}}],"textures":[{{"source":0}}],
        "cameras":[{{"type":"perspective","perspective":{{"yfov":0.7,"znear":0.1}}}}]"#
    )
    .unwrap();
    let sound = builder.glb(&rest);
    parse(&sound).unwrap();
    for length in 0..sound.len() {
        assert!(parse(&sound[..length]).is_err(), "{length}");
    }
    let mut errors = 0;
    for place in 0..sound.len() {
        for byte in
            [0, b' ', b'9', b'-', b'"', b'}', b'z', 0xff, sound[place] ^ 1, sound[place] ^ 2]
        {
            let mut damaged = sound.clone();
            damaged[place] = byte;
            errors += u32::from(parse(&damaged).is_err());
        }
    }
    assert!(errors > 1000, "{errors}");
}

#[test]
fn damage_to_a_real_file_never_panics() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/reference/room.glb");
    let Ok(sound) = std::fs::read(path) else { return println!("skipped: {path} is not there") };
    for k in 0..200 {
        assert!(parse(&sound[..sound.len() * k / 200]).is_err());
    }
    let json_end = 20 + u32::from_le_bytes(sound[12..16].try_into().unwrap()) as usize;
    let mut errors = 0;
    for place in 0..json_end {
        let mut damaged = sound.clone();
        damaged[place] ^= 1 << (place % 7);
        errors += usize::from(parse(&damaged).is_err());
    }
    assert!(errors > json_end / 3, "{errors} of {json_end}");
}

/// A bulb that hangs twice in the scene and a spot under a turned, mirrored and stretched node.
const LIGHTS: &str = r#""extensionsUsed":["KHR_lights_punctual"],
    "extensions":{"KHR_lights_punctual":{"lights":[
        {"type":"point","name":"bulb","color":[1,0.5,0],"intensity":6,"range":4},
        {"type":"spot","intensity":20,"spot":{"outerConeAngle":0.5}},
        {"type":"directional","name":"sun","color":[1,1,0.5],"intensity":3},
        {"type":"point","intensity":-1}]}},
    "nodes":[{"translation":[1,2,3],"extensions":{"KHR_lights_punctual":{"light":0}}},
        {"rotation":[0,0.70710678,0,0.70710678],"scale":[2,-2,2],"children":[2,3]},
        {"translation":[0,1,5],"extensions":{"KHR_lights_punctual":{"light":0}}},
        {"name":"beam","extensions":{"KHR_lights_punctual":{"light":1}}},
        {"extensions":{"KHR_lights_punctual":{"light":2}}},
        {"extensions":{"KHR_lights_punctual":{"light":3}}}]"#;

#[test]
fn lights_are_placed_by_their_nodes() {
    let scene = parse(&Builder::default().glb(LIGHTS)).unwrap();
    let [first, second, spot] = &scene.lights[..] else { panic!("{:?}", scene.lights) };
    assert_eq!((first.position, first.axis), (Vec3::new(1.0, 2.0, 3.0), None));
    assert_eq!((first.intensity, second.intensity), ([6.0, 3.0, 0.0], [6.0, 3.0, 0.0]));
    // A quarter turn about +Y takes +Z to +X; the scale moves the light and leaves its intensity.
    assert!((second.position - Vec3::new(10.0, -2.0, 0.0)).length() < 1e-5, "{second:?}");
    assert!((spot.axis.unwrap() - Vec3::NEG_X).length() < 1e-6, "{spot:?}");
    assert_eq!(spot.intensity, [20.0; 3]);
    let told = |words: &[&str]| {
        let told = |warning: &&String| words.iter().all(|word| warning.contains(word));
        assert_eq!(
            scene.warnings.iter().filter(told).count(),
            1,
            "{words:?}: {:?}",
            scene.warnings
        );
    };
    told(&["sun", "--env", "3, 3, 1.5", "0.000, 0.000, 1.000"]);
    told(&["beam", "cones"]);
    told(&["bulb, bulb", "range"]);
    told(&["of node 5", "-1, -1, -1"]);
    assert_eq!(scene.warnings.len(), 4);
}

#[test]
fn lights_that_are_damaged_are_refused() {
    for (sound, damaged, expected) in [
        (r#""light":1"#, r#""light":9"#, "light"),
        (r#""spot":{"outerConeAngle":0.5}"#, r#""extras":{}"#, "spot"),
        (r#""type":"point""#, r#""type":"area""#, "type"),
    ] {
        let error = parse(&Builder::default().glb(&LIGHTS.replacen(sound, damaged, 1)));
        let message = error.unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let sound = Builder::default().glb(LIGHTS);
    for place in 0..sound.len() {
        for byte in [0, b' ', b'9', b'-', b'"', b'}', b'z', sound[place] ^ 1] {
            let mut damaged = sound.clone();
            damaged[place] = byte;
            let _ = parse(&damaged);
        }
    }
}

/// The quad in one node, with more members of the node, the mesh, the primitive's attributes, and the root.
fn quad_with(node: &str, mesh: &str, attributes: &str, root: &str) -> String {
    format!(
        r#"{root}"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{node}}}],"meshes":[{{"primitives":[
        {{"mode":5,"attributes":{{"POSITION":0{attributes}}},"indices":1}}]{mesh}}}]"#
    )
}

fn warnings_of(rest: &str) -> Vec<String> {
    parse(&quad().glb(rest)).unwrap().warnings
}

#[test]
fn what_is_not_needed_stops_nothing() {
    let animation =
        r#""animations":[{"channels":[{"sampler":0,"target":{"path":"pointer"}}],"samplers":7}],"#;
    let warnings = warnings_of(&quad_with("", "", "", animation));
    assert_eq!(warnings, ["1 animations are not played; the scene is read as it stands"]);
    let empty = quad_with("", "", "", r#""scene":0,"#)
        .replace("[{\"nodes\":[0]}]", "[{\"nodes\":[0]},{\"name\":\"b\"}]");
    assert_eq!(warnings_of(&empty).len(), 0);
    let bare = r#""nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{}}]}]"#;
    assert!(warnings_of(bare)[0].contains("no positions"));
    let unused = quad().glb(&quad_with("", "", "", ""));
    let json_end = 20 + u32::from_le_bytes(unused[12..16].try_into().unwrap()) as usize;
    let json = String::from_utf8(unused[20..json_end].to_vec()).unwrap();
    let more = r#"}],"bufferViews""#;
    let json = json.replacen(more, r#"},{"byteLength":9,"uri":"none.bin"}],"bufferViews""#, 1);
    assert!(json.contains("none.bin"));
    assert!(parse(&pack_glb(json.as_bytes(), &quad().bytes)).is_ok());
    let mut marked = "\u{feff}".as_bytes().to_vec();
    marked.extend(r#"{"asset":{"version":"2.0"},"nodes":[{}]}"#.bytes());
    assert!(parse(&marked).is_ok());
    marked.extend([b' ', 0, 0]);
    assert!(parse(&marked).is_ok());
}

#[test]
fn extensions_that_leave_shapes_alone_may_be_required() {
    for (extension, effect) in [
        ("KHR_materials_unlit", "without light"),
        ("KHR_materials_variants", "variant"),
        ("KHR_xmp_json_ld", "left out"),
        ("KHR_texture_basisu", "textures"),
        ("VRMC_vrm", "left out"),
    ] {
        let root =
            format!(r#""extensionsUsed":["{extension}"],"extensionsRequired":["{extension}"],"#);
        let warnings = warnings_of(&quad_with("", "", "", &root));
        let [warning] = &warnings[..] else { panic!("{warnings:?}") };
        assert!(warning.contains(extension) && warning.contains(effect), "{warning}");
    }
}

#[test]
fn versions_other_than_2_are_named() {
    for (asset, expected) in [
        (r#"{"version":"1.0"}"#, "glTF version 1.0 is not supported; convert it to glTF 2.0"),
        (r#"{"version":"2.1","minVersion":"2.1"}"#, "version 2.1"),
        (r#"{"version":2.0}"#, "no asset.version"),
        ("{}", "no asset.version"),
    ] {
        // What version 1 says differs: it is an object.
        let json = format!(r#"{{"nodes":{{"a":{{}}}},"asset":{asset}}}"#);
        let message = parse(json.as_bytes()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let newer = r#"{"asset":{"version":"2.1","minVersion":"2.0"},"nodes":[{}]}"#;
    assert!(parse(newer.as_bytes()).is_ok());
}

#[test]
fn textures_that_cannot_be_read_cost_their_color_only() {
    let textured = |images: &str, texture: &str| {
        format!(
            r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[
            {{"mode":5,"attributes":{{"POSITION":0,"TEXCOORD_0":2}},"indices":1,"material":0}}]}}],
            {images}"textures":[{texture}],"materials":[{{"name":"m","emissiveFactor":[1,1,1],"emissiveTexture":{{"index":0}},
            "pbrMetallicRoughness":{{"baseColorFactor":[0.5,0.5,0.5,1],"baseColorTexture":{{"index":0}},
            "metallicRoughnessTexture":{{"index":0}}}}}}]"#
        )
    };
    for (images, texture, expected) in [
        (r#""images":[{"uri":"none.png"}],"#, r#"{"source":0}"#, "none.png"),
        (r#""images":[{"uri":"http://a/b.png"}],"#, r#"{"source":0}"#, "http://a/b.png"),
        (r#""images":[{"uri":"data:;base64,AAAA"}],"#, r#"{"source":0}"#, "neither png"),
        (
            r#""images":[{"bufferView":0,"mimeType":"image/png"}],"#,
            r#"{"source":0}"#,
            "neither png",
        ),
        ("", r#"{"extensions":{"KHR_texture_basisu":{"source":0}}}"#, "KHR_texture_basisu only"),
        ("", "{}", "no extension only"),
    ] {
        let scene = parse(&quad().glb(&textured(images, texture))).unwrap();
        let material = &scene.materials[0];
        assert_eq!((material.base_color, material.base_color_texture), ([0.5; 3], None));
        // Metals are rare, and what a texture would make shine is not known.
        assert_eq!((material.metallic, material.emission), (0.0, [0.0; 3]));
        let found = scene.warnings.iter().filter(|w| w.contains(expected)).count();
        assert!(found >= 1 && scene.warnings.len() == 2, "{expected}: {:?}", scene.warnings);
    }
    // Where an extension that is read names it, it is found.
    let mut builder = quad();
    let view = builder.view(&tiny_png([9, 9, 9, 255]), "");
    let images = format!(r#""images":[{{"bufferView":{view},"mimeType":"image/webp"}}],"#);
    let texture = r#"{"extensions":{"EXT_texture_webp":{"source":0}}}"#;
    let scene = parse(&builder.glb(&textured(&images, texture))).unwrap();
    assert_eq!(scene.textures[0].texels(), [[9, 9, 9, 255]]);
}

#[test]
fn samplers_say_what_is_beyond_the_edges() {
    let mut builder = quad();
    let image = image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([255 * x as u8, 0, 0, 255]));
    let mut png = std::io::Cursor::new(vec![]);
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let view = builder.view(&png.into_inner(), "");
    let red_at = |sampler: &str, u: f32| {
        let rest = format!(
            r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[
            {{"mode":5,"attributes":{{"POSITION":0,"TEXCOORD_0":2}},"indices":1,"material":0}}]}}],
            "images":[{{"bufferView":{view},"mimeType":"image/png"}}],"samplers":[{{{sampler}}}],
            "textures":[{{"source":0,"sampler":0}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}]"#
        );
        parse(&builder.glb(&rest)).unwrap().textures[0].sample(Vec2::new(u, 0.5))[0]
    };
    for (sampler, u, red) in [
        ("", 1.25, 0.0),
        (r#""wrapS":33071"#, 1.25, 1.0),
        (r#""wrapS":33071"#, 0.0, 0.0),
        (r#""wrapS":33648"#, 1.25, 1.0),
        (r#""wrapS":33648"#, 1.75, 0.0),
        (r#""wrapT":33071"#, 1.25, 0.0),
    ] {
        assert!((red_at(sampler, u) - red).abs() < 1e-5, "{sampler} {u}");
    }
}

#[test]
fn morph_targets_have_the_weights_of_node_or_mesh() {
    let mut builder = quad();
    builder.accessor(&floats(&[0., 0., 2.].repeat(4)), 5126, "VEC3", 4, "");
    builder.accessor(&floats(&[1., 0., 0.].repeat(4)), 5126, "VEC3", 4, "");
    let first = |node: &str, mesh: &str| {
        let rest = quad_with(node, mesh, "", "").replace(
            "\"indices\":1",
            "\"indices\":1,\"targets\":[{\"POSITION\":4},{\"POSITION\":5}]",
        );
        let scene = parse(&builder.glb(&rest)).unwrap();
        let instance = &scene.instances[0];
        scene.meshes[instance.mesh as usize].positions[3]
    };
    assert_eq!(first("", ""), Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(first("", r#","weights":[0.5,0]"#), Vec3::new(1.0, 1.0, 1.0));
    assert_eq!(first(r#","weights":[0,3]"#, r#","weights":[0.5,0]"#), Vec3::new(4.0, 1.0, 0.0));
}

#[test]
fn joints_alone_move_what_has_a_skin() {
    let mut builder = quad();
    builder.accessor(&[0, 1, 9, 0].repeat(4), 5121, "VEC4", 4, "");
    builder.accessor(&floats(&[3., 1., 0., 0.].repeat(4)), 5126, "VEC4", 4, "");
    // Both joints were at the origin when they were bound, the second one turned.
    let mut inverse = vec![1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
    inverse.extend([0., 1., 0., 0., -1., 0., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]);
    builder.accessor(&floats(&inverse), 5126, "MAT4", 2, "");
    builder.accessor(&floats(&[0., 0., 1.].repeat(4)), 5126, "VEC3", 4, "");
    let rest = |joint: u32| {
        format!(
            r#""scenes":[{{"nodes":[0,1]}}],"skins":[{{"joints":[2,{joint}],"inverseBindMatrices":6}}],
            "nodes":[{{"mesh":0,"skin":0,"translation":[100,0,0],"scale":[9,9,9]}},
            {{"translation":[0,4,0],"children":[2]}},{{"translation":[0,4,0],"children":[3]}},
            {{"translation":[0,-8,0]}}],
            "meshes":[{{"primitives":[{{"mode":5,"attributes":{{"POSITION":0,"NORMAL":7,"JOINTS_0":4,"WEIGHTS_0":5}},"indices":1}}]}}]"#
        )
    };
    let scene = parse(&builder.glb(&rest(3))).unwrap();
    let instance = &scene.instances[0];
    let mesh = &scene.meshes[instance.mesh as usize];
    let place = |v: usize| instance.transform.transform_point3(mesh.positions[v]);
    // (1, 0, 0): three parts at 8 + itself, one part at 0 + (0, 1, 0).
    assert!((place(1) - Vec3::new(0.75, 6.25, 0.0)).length() < 1e-5, "{}", place(1));
    assert!((mesh.normals[1] - Vec3::Z).length() < 1e-6);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let mut bytes = builder.glb(&rest(3));
    let place = bytes.windows(4).position(|w| w == [0, 1, 9, 0]).unwrap();
    bytes[place + 1] = 5;
    assert!(parse(&bytes).unwrap_err().to_string().contains("joint 5"));
    let ring = rest(3).replace("\"translation\":[0,-8,0]", "\"children\":[1]");
    assert!(parse(&builder.glb(&ring)).is_err());
}

#[test]
fn instances_of_one_node_are_placed() {
    let mut builder = quad();
    builder.accessor(&floats(&[0., 0., 0., 5., 0., 0., 9., 0., 0.]), 5126, "VEC3", 3, "");
    builder.accessor(&floats(&[1., 1., 1., 2., 2., 2., 1., -1., 1.]), 5126, "VEC3", 3, "");
    builder.accessor(&[0, 0, 0, 127].repeat(3), 5120, "VEC4", 3, r#","normalized":true"#);
    builder.accessor(&floats(&[1., 1., 1.]), 5126, "VEC3", 1, "");
    let rest = |attributes: &str| {
        let node = format!(
            r#","translation":[0,7,0],"extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":{{{attributes}}}}}}}"#
        );
        let extension = r#"["EXT_mesh_gpu_instancing"]"#;
        quad_with(
            &node,
            "",
            "",
            &format!(r#""extensionsRequired":{extension},"extensionsUsed":{extension},"#),
        )
    };
    let all = rest(r#""TRANSLATION":4,"SCALE":5,"ROTATION":6,"_ID":0"#);
    let scene = parse(&builder.glb(&all)).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let places = scene.instances.iter().map(|i| i.transform.transform_point3(Vec3::ONE));
    let expected = [Vec3::new(1.0, 8.0, 1.0), Vec3::new(7.0, 9.0, 2.0), Vec3::new(10.0, 6.0, 1.0)];
    assert!(places.zip(expected).all(|(p, e)| (p - e).length() < 1e-5));
    assert!(scene.instances[2].flips() && scene.meshes.len() == 1);
    let error = parse(&builder.glb(&rest(r#""TRANSLATION":4,"SCALE":7"#))).unwrap_err();
    assert!(error.to_string().contains("[3, 1] elements"), "{error}");
    let many = builder.glb(&all.replace("\"TRANSLATION\":4", "\"TRANSLATION\":99"));
    assert!(parse(&many).unwrap_err().to_string().contains("no such accessor"));
}

#[test]
fn alpha_of_vertices_makes_holes_where_the_material_is_masked() {
    let mut builder = Builder::default();
    builder.accessor(&floats(&QUAD), 5126, "VEC3", 4, "");
    builder.accessor(&[0, 1, 2, 3], 5121, "SCALAR", 4, "");
    builder.accessor(&[255, 255, 255, 0].repeat(4), 5121, "VEC4", 4, r#","normalized":true"#);
    let rest = |mode: &str| {
        quad_with("", "", r#","COLOR_0":2"#, &format!(r#""materials":[{{"alphaMode":"{mode}"}}],"#))
            .replace("\"indices\":1", "\"indices\":1,\"material\":0")
    };
    let scene = parse(&builder.glb(&rest("MASK"))).unwrap();
    assert_eq!((scene.materials[0].alpha_cutoff, scene.meshes[0].alphas[0]), (Some(0.5), 0.0));
    let scene = parse(&builder.glb(&rest("OPAQUE"))).unwrap();
    assert_eq!(scene.materials[0].alpha_cutoff, None);
}

#[test]
fn glass_lets_light_through_and_says_so() {
    let rest = |extension: &str| {
        quad_with("", "", "", &format!(r#""extensionsUsed":["KHR_materials_transmission"],"materials":[{{"name":"pane","extensions":{{"KHR_materials_transmission":{{{extension}}}}}}}],"#))
            .replace("\"indices\":1", "\"indices\":1,\"material\":0")
    };
    for (extension, is_hole, text) in [
        (r#""transmissionFactor":1"#, true, "transmission 1); it is left out"),
        (r#""transmissionFactor":0.25"#, false, "blocks all of it"),
        (r#""transmissionFactor":1,"transmissionTexture":{"index":0}"#, false, "by a texture"),
    ] {
        let scene = parse(&quad().glb(&rest(extension))).unwrap();
        assert_eq!(scene.materials[0].alpha_cutoff.is_some(), is_hole);
        let told = |w: &&String| w.contains("material pane") && w.contains(text);
        assert_eq!(scene.warnings.iter().filter(told).count(), 1, "{:?}", scene.warnings);
    }
}

#[test]
fn colors_of_meshes_without_material_replace_the_gray() {
    for (attributes, base_color) in [("", 0.8), (r#","COLOR_0":3"#, 1.0)] {
        let scene = parse(&quad().glb(&quad_with("", "", attributes, ""))).unwrap();
        assert_eq!(scene.materials.len(), 1);
        assert_eq!(scene.materials[scene.meshes[0].material as usize].base_color, [base_color; 3]);
    }
    let both = quad_with("", "", "", "").replace(
        r#""indices":1}"#,
        r#""indices":1},{"mode":5,"attributes":{"POSITION":0,"COLOR_0":3},"indices":1}"#,
    );
    let scene = parse(&quad().glb(&both)).unwrap();
    let colors = scene.meshes.iter().map(|m| scene.materials[m.material as usize].base_color[0]);
    assert_eq!(colors.collect::<Vec<_>>(), [0.8, 1.0]);
}

#[test]
fn the_older_model_of_materials_keeps_its_color() {
    let root = r#""extensionsRequired":["KHR_materials_pbrSpecularGlossiness"],"materials":[{"extensions":
        {"KHR_materials_pbrSpecularGlossiness":{"diffuseFactor":[0.25,0.5,0.75,1],"glossinessFactor":0.75}}}],"#;
    let rest = quad_with("", "", "", root).replace("\"indices\":1", "\"indices\":1,\"material\":0");
    let material = &parse(&quad().glb(&rest)).unwrap().materials[0];
    assert_eq!(material.base_color, [0.25, 0.5, 0.75]);
    assert_eq!((material.metallic, material.roughness), (0.0, 0.25));
}

#[test]
fn hidden_nodes_are_left_out_with_a_warning() {
    let node = r#","extensions":{"KHR_node_visibility":{"visible":false}}"#;
    let scene = parse(&quad().glb(&quad_with(node, "", "", ""))).unwrap();
    assert!(scene.instances.is_empty() && scene.warnings[0].starts_with("1 nodes are hidden"));
}

#[test]
fn normals_without_direction_are_those_of_their_faces() {
    let mut builder = quad();
    builder.accessor(
        &floats(&[0., 0., 0., 0., 0., 2., 0., 0., 1., f32::NAN, 0., 0.]),
        5126,
        "VEC3",
        4,
        "",
    );
    let scene = parse(&builder.glb(&quad_with("", "", r#","NORMAL":4"#, ""))).unwrap();
    assert_eq!(scene.meshes[0].normals, [Vec3::ZERO, Vec3::Z, Vec3::Z, Vec3::ZERO]);
    assert!(scene.warnings[0].contains("2 normals without direction"), "{:?}", scene.warnings);
}
