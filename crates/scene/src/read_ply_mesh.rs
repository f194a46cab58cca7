//! PLY meshes: ASCII and binary, any property order and types, polygons as fans of triangles.

use crate::error::from_cloud_error;
use crate::resources::Resources;
use crate::texture::srgb_to_linear;
use crate::{Instance, Material, Mesh, Scene, SceneError};
use pbgi_cloud::{PlyElement, PlyKind, PlyReader, PlyRow, PlyType};
use pbgi_file::open_input;
use pbgi_math::{Affine3A, Vec3};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Reads a PLY mesh as one instance with the default material. Vertex normals (`nx ny nz`) and
/// colors (`red green blue`: 8 bits as sRGB, 16 bits and floats as linear) are used where present.
///
/// Memory is bounded by what the file really holds, not by what its header promises.
pub(crate) fn read_ply_mesh(path: &Path, resources: &Resources) -> Result<Scene, SceneError> {
    let file = open_input(path).map_err(|e| SceneError::io(path, "open", e))?;
    // A face of three indices in its list makes a triangle as large; vertices take no more than in the file.
    let length = file.metadata().map_err(|e| SceneError::io(path, "read", e))?.len();
    resources.take(path, length.saturating_mul(2))?;
    let cloud_error = |e| from_cloud_error(path, e);
    let mut reader = PlyReader::new(BufReader::new(file), path).map_err(cloud_error)?;
    let header = reader.header();
    if header.element("face").is_none() {
        let what = match header.element("tristrips") {
            Some(_) => "a ply mesh of triangle strips",
            None => "a ply file without faces as a mesh",
        };
        let cure = "write it with a `face` element, or read it as a point cloud";
        return Err(SceneError::unsupported(path, what, cure));
    }
    let mut mesh = Mesh::default();
    let mut warnings = Vec::new();
    // Elements come in any order: indices are checked when all is read.
    while let Some(element) = reader.element().cloned() {
        match element.name.as_str() {
            "vertex" => read_vertices(path, &mut reader, &element, &mut mesh)?,
            "face" => read_faces(path, &mut reader, &element, &mut mesh, &mut warnings)?,
            _ => {}
        }
        reader.next_element().map_err(cloud_error)?;
    }
    check_mesh(path, &mut mesh, &mut warnings)?;
    Ok(Scene {
        meshes: vec![mesh],
        instances: vec![Instance { mesh: 0, transform: Affine3A::IDENTITY }],
        materials: vec![Material { name: "ply".into(), ..Material::default() }],
        warnings,
        ..Scene::default()
    })
}

/// Where the vertex properties are in a row.
struct VertexColumns {
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    color: Option<[usize; 3]>,
    /// Type of the color values.
    color_type: PlyType,
}

impl VertexColumns {
    fn find(path: &Path, element: &PlyElement) -> Result<Self, SceneError> {
        let find = |names: [&str; 3]| {
            let [x, y, z] = names.map(|name| element.property(name));
            Some([x?, y?, z?])
        };
        let position = find(["x", "y", "z"])
            .ok_or_else(|| SceneError::malformed(path, "vertices have no x, y and z"))?;
        let color = find(["red", "green", "blue"]).or_else(|| find(["r", "g", "b"]));
        let color_type = match color.and_then(|c| element.properties.get(c[0])).map(|p| p.kind) {
            Some(PlyKind::Scalar(scalar)) => scalar,
            _ => PlyType::F32,
        };
        Ok(Self { position, normal: find(["nx", "ny", "nz"]), color, color_type })
    }
}

fn read_vertices(
    path: &Path,
    reader: &mut PlyReader<BufReader<File>>,
    element: &PlyElement,
    mesh: &mut Mesh,
) -> Result<(), SceneError> {
    let columns = VertexColumns::find(path, element)?;
    let mut row = PlyRow::default();
    while reader.read_row(&mut row).map_err(|e| from_cloud_error(path, e))? {
        let vector = |c: [usize; 3]| Vec3::from_array(c.map(|i| row.scalar(i) as f32));
        let position = vector(columns.position);
        if !position.is_finite() {
            let vertex = reader.row_index() - 1;
            let message = format!("position of vertex {vertex} is not finite");
            return Err(SceneError::malformed(path, message));
        }
        mesh.positions.push(position);
        mesh.normals.extend(columns.normal.map(vector));
        let linear = |i: usize| linear_color(row.scalar(i), columns.color_type);
        mesh.colors.extend(columns.color.map(|c| c.map(linear)));
    }
    Ok(())
}

/// Linear value of a color component: by convention bytes are display colors.
fn linear_color(value: f64, kind: PlyType) -> f32 {
    let value = if value.is_finite() { value } else { 0.0 };
    match kind {
        PlyType::U8 | PlyType::I8 => srgb_to_linear(value as u8),
        PlyType::U16 | PlyType::I16 => (value / 65_535.0).clamp(0.0, 1.0) as f32,
        _ => value.clamp(0.0, 1.0) as f32,
    }
}

fn read_faces(
    path: &Path,
    reader: &mut PlyReader<BufReader<File>>,
    element: &PlyElement,
    mesh: &mut Mesh,
    warnings: &mut Vec<String>,
) -> Result<(), SceneError> {
    let column = ["vertex_indices", "vertex_index"]
        .into_iter()
        .find_map(|name| element.property(name))
        .ok_or_else(|| SceneError::malformed(path, "faces have no list `vertex_indices`"))?;
    let mut row = PlyRow::default();
    let mut thin_count = 0u64;
    while reader.read_row(&mut row).map_err(|e| from_cloud_error(path, e))? {
        // A bad index is found when all vertices are known.
        let index = |&value: &f64| {
            let whole = value >= 0.0 && value < f64::from(u32::MAX) && value.fract() == 0.0;
            if whole { value as u32 } else { u32::MAX }
        };
        match row.list(column) {
            [hub, rim @ ..] if rim.len() >= 2 => {
                let fan = rim.windows(2).map(|w| [index(hub), index(&w[0]), index(&w[1])]);
                mesh.triangles.extend(fan);
            }
            _ => thin_count += 1,
        }
    }
    if thin_count > 0 {
        warnings.push(format!("{thin_count} faces of fewer than three vertices are left out"));
    }
    Ok(())
}

fn check_mesh(path: &Path, mesh: &mut Mesh, warnings: &mut Vec<String>) -> Result<(), SceneError> {
    let count = mesh.positions.len();
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        if let Some(&bad) = triangle.iter().find(|&&v| v as usize >= count) {
            let found = if bad == u32::MAX { "no whole number".into() } else { bad.to_string() };
            return Err(SceneError::malformed(
                path,
                format!("triangle {i} refers to vertex {found}, but there are {count} vertices"),
            ));
        }
    }
    let unit: Option<Vec<Vec3>> = mesh.normals.iter().map(|n| n.try_normalize()).collect();
    if unit.is_none() {
        warnings.push("some normals have no direction; all normals are ignored".into());
    }
    mesh.normals = unit.unwrap_or_default();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Scene, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        std::fs::write(&path, bytes).unwrap();
        read_ply_mesh(&path, &Resources::new(&pbgi_file::Allowance::unlimited()))
    }

    const HEADER: &str = "element vertex 4\nproperty double y\nproperty float x\nproperty uchar red\n\
        property uchar green\nproperty uchar blue\nproperty int z\nelement face 2\n\
        property uchar flag\nproperty list uchar ushort vertex_index\nend_header\n";

    fn ascii() -> String {
        format!(
            "ply\nformat ascii 1.0\n{HEADER}0 0 255 0 188 7\n0 1 0 0 0 7\n1 1 0 0 0 7\n1 0 0 0 0 7\n\
             5 4 0 1 2 3\n9 3 2 1 0\n"
        )
    }

    fn binary(big: bool) -> Vec<u8> {
        let name = if big { "binary_big_endian" } else { "binary_little_endian" };
        let mut bytes = format!("ply\nformat {name} 1.0\n{HEADER}").into_bytes();
        let mut put = |word: &[u8]| {
            // Words are little-endian here.
            if big { bytes.extend(word.iter().rev()) } else { bytes.extend(word) }
        };
        for (x, y, red, blue) in
            [(0f32, 0f64, 255, 188), (1., 0., 0, 0), (1., 1., 0, 0), (0., 1., 0, 0)]
        {
            put(&y.to_le_bytes());
            put(&x.to_le_bytes());
            [red, 0, blue].iter().for_each(|&c| put(&[c]));
            put(&7i32.to_le_bytes());
        }
        for (flag, face) in [(5, vec![0u16, 1, 2, 3]), (9, vec![2, 1, 0])] {
            put(&[flag]);
            put(&[face.len() as u8]);
            face.iter().for_each(|i| put(&i.to_le_bytes()));
        }
        bytes
    }

    #[test]
    fn all_three_formats_give_the_same_mesh() {
        for bytes in [ascii().into_bytes(), binary(false), binary(true)] {
            let scene = read(&bytes).unwrap();
            let mesh = &scene.meshes[0];
            assert_eq!(mesh.positions[2], Vec3::new(1.0, 1.0, 7.0));
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [2, 1, 0]]);
            let [r, g, b] = mesh.colors[0];
            assert!(r == 1.0 && g == 0.0 && (b - 0.5029).abs() < 1e-4);
            assert!(mesh.normals.is_empty() && scene.warnings.is_empty());
        }
    }

    #[test]
    fn truncated_files_are_errors() {
        for bytes in [ascii().into_bytes(), binary(false), binary(true)] {
            // The last byte of the ascii file is a newline one can do without.
            for length in 0..bytes.len() - 2 {
                assert!(read(&bytes[..length]).is_err(), "{length}");
            }
        }
    }

    #[test]
    fn bad_indices_and_positions_are_named() {
        for (from, to, expected) in [
            ("5 4 0 1 2 3", "5 4 0 1 2 4", "vertex 4"),
            ("5 4 0 1 2 3", "5 4 0 1 2 -1", "vertex no whole number"),
            ("0 1 0 0 0 7", "nan 1 0 0 0 7", "vertex 1 is not finite"),
            ("property float x", "property float w", "no x, y and z"),
            ("vertex_index", "corners", "vertex_indices"),
            ("element face", "element tristrips", "triangle strips"),
        ] {
            let message = read(ascii().replace(from, to).as_bytes()).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let thin = read(ascii().replace("9 3 2 1 0", "9 2 2 1").as_bytes()).unwrap();
        assert_eq!((thin.meshes[0].triangles.len(), thin.warnings.len()), (2, 1));
    }

    #[test]
    fn normals_are_normalized() {
        let text = ascii()
            .replace(
                "property int z\n",
                "property int z\nproperty float nx\nproperty float ny\nproperty float nz\n",
            )
            .replace(" 7\n", " 7 0 0 3\n");
        assert_eq!(read(text.as_bytes()).unwrap().meshes[0].normals, [Vec3::Z; 4]);
        let broken = read(text.replace("0 0 3", "0 0 0").as_bytes()).unwrap();
        assert!(broken.meshes[0].normals.is_empty() && broken.warnings.len() == 1);
    }

    #[test]
    fn mutated_files_never_panic() {
        let mut errors = 0;
        for sound in [ascii().into_bytes(), binary(false), binary(true)] {
            for place in 0..sound.len() {
                for byte in [b'0', b'9', b'-', b'\n', 0x7f, 0xff] {
                    let mut damaged = sound.clone();
                    damaged[place] = byte;
                    errors += u32::from(read(&damaged).is_err());
                }
            }
        }
        assert!(errors > 1000, "{errors}");
    }
}
