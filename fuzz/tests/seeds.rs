//! Writes the seeds: small sound files from the engine's own writers, and texts.

use image::{DynamicImage, ImageFormat, RgbImage as PlainImage};
use las::point::Format;
use las::{Builder, Point, Writer};
use pbgi_cloud::{
    PlyWriter, PtcPoint, PtcWriter, RawKind, RawWriter, SliceSource, Surfel, write_raw_file,
};
use pbgi_fuzz::bake_octree;
use pbgi_image::{AttributeValue, Image, write_exr};
use pbgi_math::{DVec3, Mat4, Vec3};
use std::io::Cursor;
use std::path::{Path, PathBuf};

type Seeds = Vec<(&'static str, Vec<u8>)>;

/// What a function writes to a file.
fn written(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path: PathBuf = folder.path().join(name);
    write(&path);
    std::fs::read(path).unwrap()
}

fn surfels() -> Vec<Surfel> {
    (0..5).map(|i| Surfel::new(Vec3::new(i as f32, 0.5, -1.0), Vec3::Y, 0.5, 0.7)).collect()
}

fn clouds() -> Seeds {
    let names =
        "x y z nx ny nz radius area radiance_r radiance_g radiance_b albedo_r albedo_g albedo_b";
    let columns: Vec<&str> = names.split(' ').collect();
    let row = [0.5, 1.0, -2.0, 0.0, 1.0, 0.0, 0.25, 0.2, 1.0, 2.0, 3.0, 0.5, 0.5, 0.5];
    let floats = written("a.ply", |path| {
        let mut writer = PlyWriter::create(path, &columns).unwrap();
        writer.write_rows(&row.repeat(3)).unwrap();
        writer.finish().unwrap();
    });
    let doubles = written("a.ply", |path| {
        let mut writer = PlyWriter::create_with_doubles(path, &columns[..7], 3).unwrap();
        writer.write_double_rows(&[6e5, 5e6, 100.0, 0.0, 0.0, 1.0, 0.5].repeat(3)).unwrap();
        writer.finish().unwrap();
    });
    let ascii = b"ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float nx\nproperty float ny\nproperty float nz\n\
        element tag 1\nproperty list uchar float of\nend_header\n1 2 3 255 0 9 0 0 1\n4 5 6 0 1 2 1 0 0\n2 0.5 1\n";
    let big = b"ply\nformat binary_big_endian 1.0\nelement tag 1\nproperty list uchar short of\nelement vertex 1\nproperty float x\n\
        property float y\nproperty float z\nend_header\n\x02\0\x01\0\x02\x3f\x80\0\0\0\0\0\0\x40\0\0\0";
    vec![
        ("ply_points/floats", floats),
        ("ply_points/doubles", doubles),
        ("ply_points/ascii", ascii.to_vec()),
        ("ply_points/big-endian", big.to_vec()),
    ]
}

fn streams() -> Seeds {
    let point = PtcPoint {
        position: Vec3::ONE,
        normal: Vec3::Z,
        radius: 0.5,
        area: 0.7,
        radiance: [1.0; 3],
        albedo: [0.5; 3],
    };
    let ptc = |radiosity, albedo| {
        written("a.ptc", |path| {
            let mut writer = PtcWriter::create(path, radiosity, albedo).unwrap();
            writer.write(&[point; 3]).unwrap();
            writer.finish().unwrap();
        })
    };
    let raw = |kind| {
        written("a.raw", |path| {
            write_raw_file(path, kind, &mut SliceSource::new(&surfels())).unwrap();
        })
    };
    let mut piped = Vec::new();
    let mut writer =
        RawWriter::new(&mut piped, Path::new("-"), RawKind::Full, DVec3::ONE, None).unwrap();
    writer.write(&surfels()).unwrap();
    writer.finish().unwrap();
    vec![
        ("ptc/all", ptc(true, true)),
        ("ptc/bare", ptc(false, false)),
        ("raw/compact", raw(RawKind::Compact)),
        ("raw/full", raw(RawKind::Full)),
        ("raw/piped", piped),
    ]
}

fn survey(format: u8, version: (u8, u8), compress: bool) -> Vec<u8> {
    let mut builder = Builder::from(version);
    builder.point_format = Format::new(format).unwrap();
    builder.point_format.is_compressed = compress;
    for axis in [&mut builder.transforms.x, &mut builder.transforms.y, &mut builder.transforms.z] {
        *axis = las::Transform { scale: 0.01, offset: 637_000.0 };
    }
    let format = builder.point_format;
    let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    for i in 0..20u16 {
        let point = Point {
            x: 637_380.0 + f64::from(i) * 0.25,
            y: 637_950.0,
            z: 637_400.0 - f64::from(i % 7),
            intensity: i,
            gps_time: format.has_gps_time.then_some(f64::from(i)),
            color: format.has_color.then(|| las::Color::new(i, 2 * i, 300 * i)),
            nir: format.has_nir.then_some(i),
            is_withheld: i % 9 == 0,
            ..Default::default()
        };
        writer.write_point(point).unwrap();
    }
    writer.close().unwrap();
    writer.into_inner().unwrap().into_inner()
}

fn surveys() -> Seeds {
    vec![
        ("las/1.2-format-0", survey(0, (1, 2), false)),
        ("las/1.2-format-3", survey(3, (1, 2), false)),
        ("las/1.4-format-8", survey(8, (1, 4), false)),
        ("las/1.2-format-2-laz", survey(2, (1, 2), true)),
        ("las/1.4-format-7-laz", survey(7, (1, 4), true)),
    ]
}

const GLTF: &str = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1]}],"nodes":[{"mesh":0,"translation":[1,0,0],"children":[2]},
{"camera":0,"rotation":[0,0,0,1],"extensions":{"KHR_lights_punctual":{"light":0}}},{"mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,2,1]}],
"meshes":[{"primitives":[{"mode":5,"attributes":{"POSITION":0,"TEXCOORD_0":2,"COLOR_0":3},"indices":1,"material":0}]}],
"materials":[{"name":"m","alphaMode":"MASK","doubleSided":true,"emissiveFactor":[1,1,0],"pbrMetallicRoughness":{"baseColorFactor":[1,0.5,0.5,1],
"baseColorTexture":{"index":0,"extensions":{"KHR_texture_transform":{"offset":[0.5,0],"scale":[2,2]}}}}}],
"textures":[{"source":0,"sampler":0}],"samplers":[{"wrapS":33071}],"cameras":[{"type":"perspective","perspective":{"yfov":0.7,"znear":0.1}}],
"extensionsUsed":["KHR_lights_punctual","KHR_texture_transform"],"extensions":{"KHR_lights_punctual":{"lights":[{"type":"point","intensity":5}]}},
"#;

fn picture(format: ImageFormat) -> Vec<u8> {
    let image =
        PlainImage::from_fn(5, 3, |x, y| image::Rgb([50 * x as u8, 80 * y as u8, (x * y) as u8]));
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::ImageRgb8(image).write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let digits =
        |part: &[u8]| -> String {
            let word = part.iter().fold(0u32, |word, b| word << 8 | u32::from(*b))
                << (8 * (3 - part.len()));
            let used = part.len() + 1;
            (0..4)
                .map(|k| {
                    if k < used {
                        DIGITS[(word >> (18 - 6 * k) & 63) as usize] as char
                    } else {
                        '='
                    }
                })
                .collect()
        };
    bytes.chunks(3).map(digits).collect()
}

/// A strip with small types, a texture, lights and a camera, as text with data in it and as a binary file.
fn gltfs() -> Seeds {
    let quad = [0f32, 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 0.];
    let mut bytes: Vec<u8> = quad.iter().flat_map(|v| v.to_le_bytes()).collect();
    bytes.extend([0, 1, 2, 3]);
    bytes.extend([0, 0, 255, 0, 0, 255, 255, 255]);
    bytes.extend([255, 0, 51, 255].repeat(4));
    let png = picture(ImageFormat::Png);
    let image_at = bytes.len();
    bytes.extend(&png);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let json = |uri: &str| {
        let mut json = GLTF.to_owned();
        json += &format!(
            r#""images":[{{"bufferView":4,"mimeType":"image/png"}}],"buffers":[{{"byteLength":{}{uri}}}],"bufferViews":["#,
            bytes.len()
        );
        for (offset, length) in [(0, 48), (48, 4), (52, 8), (60, 16), (image_at, png.len())] {
            let comma = if offset == image_at { "" } else { "," };
            json +=
                &format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length}}}{comma}"#);
        }
        json += r#"],"accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":4,"min":[0,0,0],"max":[1,1,0]},
{"bufferView":1,"componentType":5121,"type":"SCALAR","count":4},{"bufferView":2,"componentType":5121,"type":"VEC2","count":4,"normalized":true},
{"bufferView":3,"componentType":5121,"type":"VEC4","count":4,"normalized":true}]}"#;
        json.into_bytes()
    };
    let text =
        json(&format!(r#","uri":"data:application/octet-stream;base64,{}""#, base64(&bytes)));
    let mut head = json("");
    head.resize(head.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((28 + head.len() as u32 + bytes.len() as u32).to_le_bytes());
    for (kind, data) in [(b"JSON", &head), (b"BIN\0", &bytes)] {
        glb.extend((data.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(data);
    }
    vec![("gltf/text", text), ("gltf/binary", glb)]
}

fn meshes() -> Seeds {
    let ply = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
        property uchar green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0 1 2 3\n4 0 1 2 3\n3 0 1 2\n";
    let mut binary = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        .to_vec();
    binary.extend([0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|v| v.to_le_bytes()));
    binary.push(3);
    binary.extend([0, 1, 2].iter().flat_map(|v: &i32| v.to_le_bytes()));
    let obj = b"mtllib a.mtl\no first\nv 0 0 0 1 0.5 0.5\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl m\ns 1\nf 1/1/1 2//1 -2 4\n\
        g second\nf 1 2 \\\n 3\n\0newmtl m\nKd 1 0.5 0.5\nKe 1 1 1\nNs 10\nd 0.5\nPr 0.5\nPm 1\nmap_Kd -clamp on missing.png\nnewmtl n\nillum 2\n";
    vec![("ply_mesh/ascii", ply.to_vec()), ("ply_mesh/binary", binary), ("obj/all", obj.to_vec())]
}

fn pictures() -> Seeds {
    let mut image = Image::new(4, 3);
    image.push_rgb(["R", "G", "B"], &[[1.0, 0.5, 0.25]; 12]);
    let picture_exr = written("a.exr", |path| write_exr(path, &image, &[]).unwrap());
    // An eye 5 above the origin of z, a field of view of 53 degrees; y of the image goes down.
    let to_camera = Mat4::from_translation(Vec3::new(-3.0, -2.0, -5.0));
    let to_ndc = Mat4::from_cols_array_2d(&[
        [1.0, 0.0, 0.0, 0.0],
        [0.0, -1.0, 0.0, 0.0],
        [-0.5, -0.5, 0.0, -1.0],
        [0.0, 0.0, 1.0, 0.0],
    ]) * to_camera;
    for (layer, value) in [("P", [1.0, 2.0, 3.0]), ("N", [0.0, 1.0, 0.0])] {
        let names = ["X", "Y", "Z"].map(|axis| format!("{layer}.{axis}"));
        image.push_rgb(names.each_ref().map(String::as_str), &[value; 12]);
    }
    image.push_rgb(["albedo.R", "albedo.G", "albedo.B"], &[[0.5; 3]; 12]);
    image.push("A", vec![1.0; 12]);
    let attributes = [
        ("worldToCamera".to_owned(), AttributeValue::Matrix(to_camera)),
        ("worldToNDC".to_owned(), AttributeValue::Matrix(to_ndc)),
    ];
    let gbuffer = written("a.exr", |path| write_exr(path, &image, &attributes).unwrap());
    let mut flat = b"#?RADIANCE\nEXPOSURE=2\nPRIMARIES= 0.64 0.33 0.3 0.6 0.15 0.06 0.3127 0.329\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n".to_vec();
    flat.extend([10, 20, 30, 128].repeat(6));
    let mut runs = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 8\n\x02\x02\0\x08".to_vec();
    runs.extend([136, 9].repeat(3));
    runs.extend([4, 1, 2, 3, 4, 132, 128]);
    vec![
        ("exr/picture", picture_exr),
        ("exr/gbuffer", gbuffer.clone()),
        ("gbuffer/all", gbuffer),
        ("hdr/flat", flat),
        ("hdr/runs", runs),
        ("texture/png", picture(ImageFormat::Png)),
        ("texture/jpeg", picture(ImageFormat::Jpeg)),
        ("texture/bmp", picture(ImageFormat::Bmp)),
        ("texture/tga", picture(ImageFormat::Tga)),
        ("texture/webp", picture(ImageFormat::WebP)),
    ]
}

fn others() -> Seeds {
    let look_at = br#"{"position":[3,2,5],"target":[0,0.5,0],"up":[0,1,0],"fov":40}"#;
    let matrix = br#"{"camera_to_world":[[1,0,0,3],[0,1,0,2],[0,0,1,5],[0,0,0,1]]}"#;
    let octree = |surfels, compress| bake_octree(surfels, compress).unwrap();
    vec![
        ("camera/look-at", look_at.to_vec()),
        ("camera/matrix", matrix.to_vec()),
        ("octree/plain", octree(100, false)),
        ("octree/compressed", octree(300, true)),
        ("shade/plain", octree(100, false)),
        ("shade/compressed", octree(300, true)),
    ]
}

#[test]
#[ignore = "writes seeds/: cargo test --manifest-path fuzz/Cargo.toml --test seeds -- --ignored"]
fn write_seeds() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds");
    let all = [clouds(), streams(), surveys(), gltfs(), meshes(), pictures(), others()];
    for (name, bytes) in all.into_iter().flatten() {
        let path = root.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}
