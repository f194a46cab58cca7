//! PLY meshes: ASCII and binary, any property order and types, polygons and strips cut into triangles.

use crate::SceneError;
use crate::error::from_cloud_error;
use crate::origin::Places;
use crate::polygon::Triangulator;
use crate::resources::Resources;
use pbgi_cloud::{PlyElement, PlyKind, PlyReader, PlyRow, PlyType};
use pbgi_file::open_input;
use pbgi_math::{Affine3A, DVec3, Vec3};
use pbgi_scene::{Instance, Material, Mesh, Scene};
use pbgi_scene::{display_to_linear, srgb_to_linear};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Names of the elements that have faces.
const FACE_ELEMENTS: [&str; 2] = ["face", "tristrips"];

/// Colors as floats are linear, from 0 to 1; where one is above this, all are codes of a display up to 255.
const FLOAT_COLOR_MAX: f32 = 1.5;

/// Names of elements that are read, or have nothing to do with light and shape.
const ELEMENTS: [&str; 4] = ["vertex", "face", "tristrips", "camera"];

/// Names of columns that place textures, which are not read.
const UV_NAMES: [&str; 8] = ["s", "t", "u", "v", "texture_u", "texture_v", "texcoord", "texnumber"];

/// Reads a PLY mesh as one instance with the default material. Vertex normals (`nx ny nz`) and
/// colors (`red green blue` and other names: integers as sRGB, floats as linear) are used where present; colors replace the
/// gray of that material.
///
/// Memory is bounded by what the file really holds, not by what its header promises.
pub(crate) fn read_ply_mesh(path: &Path, resources: &Resources) -> Result<Scene, SceneError> {
    let reader = open(path)?;
    let header = reader.header().clone();
    take_memory(path, &reader, resources)?;
    drop(reader);
    let place = |name: &str| header.elements.iter().position(|e| e.name == name);
    let faces = FACE_ELEMENTS.into_iter().filter_map(place).min();
    let Some(faces) = faces else {
        let what = "a ply file without faces as a mesh";
        let cure = "write it with an element `face`, or read it as a point cloud";
        return Err(SceneError::unsupported(path, what, cure));
    };
    let mut mesh = PlyMesh::default();
    let is_other = |e: &&PlyElement| e.count > 0 && !ELEMENTS.contains(&e.name.as_str());
    for element in header.elements.iter().filter(is_other) {
        let PlyElement { name, count, .. } = element;
        mesh.warnings.push(format!("{count} rows of element {name} are not read"));
    }
    // Polygons are cut by the places of their corners, which may come behind them.
    if place("vertex").is_some_and(|vertices| vertices < faces) {
        mesh.read(path, &|_| true)?;
    } else {
        mesh.read(path, &|name| name == "vertex")?;
        mesh.read(path, &|name| name != "vertex")?;
    }
    mesh.into_scene(path)
}

fn open(path: &Path) -> Result<PlyReader<BufReader<File>>, SceneError> {
    let file = open_input(path).map_err(|e| SceneError::io(path, "open", e))?;
    let mut reader =
        PlyReader::new(BufReader::new(file), path).map_err(|e| from_cloud_error(path, e))?;
    reader.allow_long_rows();
    Ok(reader)
}

/// Takes memory for the mesh. A face of three indices in its list makes a triangle as large; vertices take no more than in the file. Of a
/// strip, each index makes a triangle.
fn take_memory(
    path: &Path,
    reader: &PlyReader<BufReader<File>>,
    resources: &Resources,
) -> Result<(), SceneError> {
    let length = std::fs::metadata(path).map_err(|e| SceneError::io(path, "read", e))?.len();
    let factor = if reader.header().element("tristrips").is_some() { 6 } else { 2 };
    resources.take(path, length.saturating_mul(factor))
}

/// A mesh under way.
#[derive(Default)]
struct PlyMesh {
    mesh: Mesh,
    /// World position of the origin of the mesh's positions.
    origin: DVec3,
    /// Largest color of type float.
    float_color_max: f32,
    /// Whether a vertex is at no place, and may not be used.
    has_bad_positions: bool,
    triangulator: Triangulator,
    warnings: Vec<String>,
}

impl PlyMesh {
    /// Reads the elements that `wants` names.
    fn read(&mut self, path: &Path, wants: &dyn Fn(&str) -> bool) -> Result<(), SceneError> {
        let mut reader = open(path)?;
        while let Some(element) = reader.element().cloned() {
            match element.name.as_str() {
                name if !wants(name) => {}
                "vertex" => self.read_vertices(path, &mut reader, &element)?,
                "face" => self.read_faces(path, &mut reader, &element)?,
                "tristrips" => self.read_strips(path, &mut reader, &element)?,
                _ => {}
            }
            reader.next_element().map_err(|e| from_cloud_error(path, e))?;
        }
        Ok(())
    }

    fn into_scene(mut self, path: &Path) -> Result<Scene, SceneError> {
        self.check(path)?;
        let Self { mesh, triangulator, mut warnings, origin, .. } = self;
        warnings.extend(triangulator.warnings());
        let base_color = match mesh.colors.is_empty() {
            true => Material::default().base_color,
            false => [1.0; 3],
        };
        Ok(Scene {
            origin,
            meshes: vec![mesh],
            instances: vec![Instance { mesh: 0, transform: Affine3A::IDENTITY }],
            materials: vec![Material { name: "ply".into(), base_color, ..Material::default() }],
            warnings,
            ..Scene::default()
        })
    }
}

/// Where the vertex properties are in a row.
struct VertexColumns {
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    color: Option<[usize; 3]>,
    /// Type of the color values.
    color_type: PlyType,
    /// Where alpha is, and what it is where a surface is opaque.
    alpha: Option<(usize, f64)>,
}

impl VertexColumns {
    fn find(path: &Path, element: &PlyElement) -> Result<Self, SceneError> {
        let find = |names: [&str; 3]| {
            let [x, y, z] = names.map(|name| element.property(name));
            Some([x?, y?, z?])
        };
        let position = find(["x", "y", "z"])
            .ok_or_else(|| SceneError::malformed(path, "vertices have no x, y and z"))?;
        let color = element.colors();
        let color_type = match color.and_then(|c| element.properties.get(c[0])).map(|p| p.kind) {
            Some(PlyKind::Scalar(scalar)) => scalar,
            _ => PlyType::F32,
        };
        let alpha = element.alpha();
        Ok(Self { position, normal: element.normals(), color, color_type, alpha })
    }
}

/// Linear value of a color component: integers are display colors, over the range of their type, wide and signed ones over that of a
/// byte; floats are as they are.
fn linear_color(value: f64, kind: PlyType) -> f32 {
    let value = if value.is_finite() { value } else { 0.0 };
    match kind {
        PlyType::F32 | PlyType::F64 => value.max(0.0) as f32,
        PlyType::U16 => display_to_linear((value / 65_535.0).clamp(0.0, 1.0) as f32),
        _ => srgb_to_linear(value as u8),
    }
}

impl PlyMesh {
    fn read_vertices(
        &mut self,
        path: &Path,
        reader: &mut PlyReader<BufReader<File>>,
        element: &PlyElement,
    ) -> Result<(), SceneError> {
        let columns = VertexColumns::find(path, element)?;
        self.warn_of_textures(element);
        self.warnings.extend(element.describe_unread(true));
        if element.property("radiance_r").is_some() {
            self.warnings.push(
                "radiance of vertices is not read; nothing shines (bake its vertices as a cloud, without faces)".into(),
            );
        }
        let mesh = &mut self.mesh;
        let mut row = PlyRow::default();
        let (mut places, mut clear_count) = (Places::default(), 0u64);
        while reader.read_row(&mut row).map_err(|e| from_cloud_error(path, e))? {
            let vector = |c: [usize; 3]| Vec3::from_array(c.map(|i| row.scalar(i) as f32));
            let position = DVec3::from_array(columns.position.map(|i| row.scalar(i)));
            self.has_bad_positions |= !position.as_vec3().is_finite();
            places.push(position);
            let is_clear = columns.alpha.is_some_and(|(i, opaque)| row.scalar(i) < 0.5 * opaque);
            clear_count += u64::from(is_clear);
            mesh.normals.extend(columns.normal.map(vector));
            let linear = |i: usize| linear_color(row.scalar(i), columns.color_type);
            let color = columns.color.map(|c| c.map(linear));
            let largest = color.iter().flatten().fold(0f32, |max, c| max.max(*c));
            self.float_color_max = self.float_color_max.max(largest);
            mesh.colors.extend(color);
        }
        (self.origin, mesh.positions) = places.finish();
        if clear_count > 0 {
            self.warnings.push(format!(
                "{clear_count} vertices have an alpha below one half; all surfaces are opaque"
            ));
        }
        Ok(())
    }

    fn read_faces(
        &mut self,
        path: &Path,
        reader: &mut PlyReader<BufReader<File>>,
        element: &PlyElement,
    ) -> Result<(), SceneError> {
        let column = find_indices(path, element)?;
        self.warn_of_textures(element);
        if element.colors().is_some() || element.property("red").is_some() {
            self.warnings
                .push("colors of faces are not read; those of vertices are used, or gray".into());
        }
        let Self { mesh, triangulator, warnings, .. } = self;
        let mut row = PlyRow::default();
        let mut thin_count = 0u64;
        let (mut corners, mut outline) = (Vec::new(), Vec::new());
        while reader.read_row(&mut row).map_err(|e| from_cloud_error(path, e))? {
            corners.clear();
            corners.extend(row.list(column).iter().map(index_of));
            if corners.len() < 3 {
                thin_count += 1;
                continue;
            }
            // A bad index is found when all is read.
            let place = |&v: &u32| mesh.positions.get(v as usize).copied().unwrap_or(Vec3::ZERO);
            outline.clear();
            outline.extend(corners.iter().map(place));
            let triangles = &mut mesh.triangles;
            triangulator.triangulate(&outline, |t| triangles.push(t.map(|k| corners[k])));
        }
        if thin_count > 0 {
            warnings.push(format!("{thin_count} faces of fewer than three vertices are left out"));
        }
        Ok(())
    }

    /// Strips of triangles, every other one of which runs backward; −1, as a type without signs has it, too, starts the next.
    fn read_strips(
        &mut self,
        path: &Path,
        reader: &mut PlyReader<BufReader<File>>,
        element: &PlyElement,
    ) -> Result<(), SceneError> {
        let column = find_indices(path, element)?;
        let mut row = PlyRow::default();
        while reader.read_row(&mut row).map_err(|e| from_cloud_error(path, e))? {
            for strip in
                row.list(column).split(|&index| index == -1.0 || index == f64::from(u32::MAX))
            {
                for (k, corners) in strip.windows(3).enumerate() {
                    let [a, b, c] = [0, 1, 2].map(|i| index_of(&corners[i]));
                    // Strips turn by repeating a vertex.
                    if a != b && b != c && c != a {
                        self.mesh.triangles.push(if k % 2 == 0 { [a, b, c] } else { [b, a, c] });
                    }
                }
            }
        }
        Ok(())
    }

    fn warn_of_textures(&mut self, element: &PlyElement) {
        let names = UV_NAMES.into_iter().filter(|name| element.property(name).is_some());
        let names: Vec<&str> = names.collect();
        if !names.is_empty() {
            let names = names.join(", ");
            self.warnings.push(format!(
                "textures of ply files are not read ({names} of element {}); export the mesh as glTF or OBJ to keep them",
                element.name
            ));
        }
    }

    fn check(&mut self, path: &Path) -> Result<(), SceneError> {
        let mesh = &mut self.mesh;
        let count = mesh.positions.len();
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            if let Some(&bad) = triangle.iter().find(|&&v| v as usize >= count) {
                let found =
                    if bad == u32::MAX { "no whole number".into() } else { bad.to_string() };
                return Err(SceneError::malformed(
                    path,
                    format!(
                        "triangle {i} refers to vertex {found}, but there are {count} vertices"
                    ),
                ));
            }
        }
        if self.has_bad_positions {
            let used = mesh.triangles.iter().flatten();
            let is_bad = |&&v: &&u32| !mesh.positions[v as usize].is_finite();
            if let Some(vertex) = used.clone().find(is_bad) {
                let message = format!("position of vertex {vertex} is not finite");
                return Err(SceneError::malformed(path, message));
            }
        }
        // Floats are linear, but where they are codes of a display all the same.
        let are_codes = self.float_color_max > FLOAT_COLOR_MAX;
        for color in &mut mesh.colors {
            let code = |c: f32| display_to_linear((c / 255.0).min(1.0));
            *color = color.map(|c| if are_codes { code(c) } else { c.min(1.0) });
        }
        if are_codes {
            let max = self.float_color_max;
            self.warnings.push(format!(
                "colors are floats of up to {max}; they are taken as those of a display, from 0 to 255"
            ));
        }
        let mut zero_count = 0;
        for normal in &mut mesh.normals {
            *normal = normal.try_normalize().unwrap_or(Vec3::ZERO);
            zero_count += usize::from(*normal == Vec3::ZERO);
        }
        if zero_count > 0 {
            self.warnings.push(format!(
                "{zero_count} normals have no direction; those of their faces are used there"
            ));
        }
        Ok(())
    }
}

/// A vertex index; `u32::MAX` if it is none.
fn index_of(&value: &f64) -> u32 {
    let whole = value >= 0.0 && value < f64::from(u32::MAX) && value.fract() == 0.0;
    if whole { value as u32 } else { u32::MAX }
}

/// The list of vertex indices of faces or strips.
fn find_indices(path: &Path, element: &PlyElement) -> Result<usize, SceneError> {
    ["vertex_indices", "vertex_index"]
        .into_iter()
        .find_map(|name| element.property(name))
        .ok_or_else(|| {
            let message = format!("element {} has no list `vertex_indices`", element.name);
            SceneError::malformed(path, message)
        })
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
            ("0 1 0 0 0 7", "-nan(ind) 1 0 0 0 7", "vertex 1 is not finite"),
            ("property float x", "property float w", "no x, y and z"),
            ("vertex_index", "corners", "vertex_indices"),
            ("element face", "element faces", "without faces"),
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
        assert_eq!(broken.meshes[0].normals, [Vec3::ZERO; 4]);
        assert!(broken.warnings[0].starts_with("4 normals"), "{:?}", broken.warnings);
    }

    #[test]
    fn strips_are_meshes() {
        let text = ascii()
            .replace(
                "element face 2\nproperty uchar flag\nproperty list uchar ushort vertex_index",
                "element tristrips 1\nproperty list int int vertex_indices",
            )
            .replace("5 4 0 1 2 3\n9 3 2 1 0\n", "10 0 1 3 2 -1 0 1 1 2 3\n");
        let scene = read(text.as_bytes()).unwrap();
        assert_eq!(scene.meshes[0].triangles, [[0, 1, 3], [3, 1, 2], [1, 2, 3]]);
        let wide = text.replace("2 -1 0", "2 4294967295 0").replace("int int", "int uint");
        assert_eq!(read(wide.as_bytes()).unwrap().meshes[0].triangles.len(), 3);
        for (from, to) in [("0 1 3 2 -1", "0 1 3 2 -2"), ("0 1 3 2 -1", "0 1 3 4 -1")] {
            assert!(read(text.replace(from, to).as_bytes()).is_err());
        }
    }

    #[test]
    fn vertices_may_come_behind_their_faces() {
        let (head, rows) = ("ply\nformat ascii 1.0\n", "6 0 1 2 3 4 5\n");
        let faces = "element face 1\nproperty list uchar int vertex_indices\n";
        let vertices =
            "element vertex 6\nproperty int x\nproperty int z\nproperty int y\nend_header\n";
        let places = "1 1 0\n2 1 0\n2 0 0\n0 0 0\n0 2 0\n1 2 0\n";
        let scene = read(format!("{head}{faces}{vertices}{rows}{places}").as_bytes()).unwrap();
        let mesh = &scene.meshes[0];
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            (b - a).cross(c - a).length() * 0.5
        };
        assert!((mesh.triangles.iter().map(area).sum::<f32>() - 3.0).abs() < 1e-5);
    }

    #[test]
    fn vertices_that_no_face_uses_may_be_anywhere() {
        let text = ascii().replace("5 4 0 1 2 3\n9 3 2 1 0", "5 3 0 1 2\n9 3 2 1 0");
        assert_eq!(
            read(text.replace("\n1 0 0 0 0 7", "\nnan 0 0 0 0 7").as_bytes()).unwrap().meshes[0]
                .triangles
                .len(),
            2
        );
    }

    #[test]
    fn colors_replace_the_gray_and_wide_ones_are_those_of_a_display() {
        let colored = read(ascii().as_bytes()).unwrap();
        assert_eq!(colored.materials[0].base_color, [1.0; 3]);
        let bare = ascii().replace("uchar red", "uchar r0");
        assert_eq!(read(bare.as_bytes()).unwrap().materials[0].base_color, [0.8; 3]);
        let wide = ascii()
            .replace("property uchar blue", "property ushort blue")
            .replace("0 188 7", "0 48316 7");
        let wide = wide.replace("uchar red", "ushort red").replace("uchar green", "ushort green");
        let [_, _, b] = read(wide.as_bytes()).unwrap().meshes[0].colors[0];
        let floats = ascii()
            .replace("uchar red", "float red")
            .replace("uchar green", "float green")
            .replace("uchar blue", "float blue");
        let codes = read(floats.as_bytes()).unwrap();
        assert!((codes.meshes[0].colors[0][2] - 0.5029).abs() < 1e-4 && codes.warnings.len() == 1);
        let linear = read(floats.replace("255 0 188", "0.25 0 1").as_bytes()).unwrap();
        assert_eq!(linear.meshes[0].colors[0], [0.25, 0.0, 1.0]);
        assert!((b - 0.5029).abs() < 1e-4, "{b}");
    }

    #[test]
    fn textures_and_colors_of_faces_are_named() {
        let text = ascii()
            .replace("uchar flag", "uchar red")
            .replace("int z\n", "int z\nproperty float s\nproperty float t\n")
            .replace(" 7\n", " 7 0 1\n");
        let scene = read(text.as_bytes()).unwrap();
        let [uvs, colors] = &scene.warnings[..] else { panic!("{:?}", scene.warnings) };
        assert!(uvs.contains("(s, t of element vertex)") && colors.contains("colors of faces"));
    }

    #[test]
    fn names_of_columns_are_those_of_clouds() {
        for [from, to] in [["red", "diffuse_red"], ["red", "Red"], ["red", "r"]] {
            let text = ["red", "green", "blue"].into_iter().fold(ascii(), |text, name| {
                let other = match to {
                    "r" => name[..1].to_owned(),
                    "Red" => name.to_uppercase(),
                    _ => to.replace(from, name),
                };
                text.replace(&format!("uchar {name}"), &format!("uchar {other}"))
            });
            let mesh = &read(text.as_bytes()).unwrap().meshes[0];
            assert_eq!(mesh.colors[0][..2], [1.0, 0.0], "{to}");
        }
        let text = ascii()
            .replace("int z\n", "int z\nproperty float normal_x\nproperty float normal_y\nproperty float normal_z\n")
            .replace(" 7\n", " 7 0 0 3\n");
        assert_eq!(read(text.as_bytes()).unwrap().meshes[0].normals, [Vec3::Z; 4]);
    }

    #[test]
    fn what_changes_light_and_is_not_read_is_named() {
        let bare = ascii().replace("uchar red", "uchar r0");
        let with = |text: &str, column: &str, value: &str| {
            let text = text
                .replace("int z\n", &format!("int z\nproperty {column}\n"))
                .replace(" 7\n", &format!(" 7 {value}\n"));
            read(text.as_bytes()).unwrap().warnings
        };
        for (column, value, expected) in [
            ("float scalar_Intensity", "5", "scalar_Intensity; albedo is gray"),
            ("float rgb", "5", "packed into one number"),
            ("float radiance_r", "5", "radiance of vertices is not read"),
            ("uchar alpha", "127", "4 vertices have an alpha below one half"),
            ("float alpha", "0.2", "4 vertices have an alpha below one half"),
        ] {
            let warnings = with(&bare, column, value);
            assert!(warnings.len() == 1 && warnings[0].contains(expected), "{warnings:?}");
        }
        for (column, value) in
            [("float Intensity", "5"), ("uchar alpha", "255"), ("float quality", "1")]
        {
            assert!(with(&ascii(), column, value).is_empty(), "{column}");
        }
        let text =
            ascii().replace("end_header", "element edge 1\nproperty int v1\nend_header") + "0\n";
        assert_eq!(
            read(text.as_bytes()).unwrap().warnings,
            ["1 rows of element edge are not read"]
        );
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
