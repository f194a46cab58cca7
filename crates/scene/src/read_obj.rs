//! Wavefront OBJ with its MTL materials.

mod mtl;

use crate::resources::Resources;
use crate::{Instance, Material, Mesh, Scene, SceneError};
use pbgi_file::open_input;
use pbgi_math::{Affine3A, Vec2, Vec3};
use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Longest line in bytes.
const LINE_BYTES_MAX: u64 = 1 << 20;

/// Lines after which it is seen how much memory is held.
const LINES_BETWEEN_CHECKS: u64 = 4096;

/// Bytes of a place, a color or a normal, and of a corner: while it is read, its number is looked up in a table half full, and then it
/// becomes a vertex.
const VERTEX_BYTES: usize = size_of::<Vec3>();
const CORNER_BYTES: usize = 3 * size_of::<Corner>() + 4 * VERTEX_BYTES;

/// Reads an OBJ file: one mesh and one instance per material. Polygons become fans of triangles;
/// lines, points, curves and smoothing groups are left out. Vertex colors after the position are
/// taken as linear. A missing MTL file or material is a warning.
pub(crate) fn read_obj(path: &Path, resources: &Resources) -> Result<Scene, SceneError> {
    let mut obj = Obj::default();
    read_lines(path, |number, keyword, rest| {
        let read = obj.read_line(path, keyword, rest, resources);
        read.map_err(|message| SceneError::malformed(path, format!("line {number}: {message}")))?;
        if let Some(error) = obj.library.failed.take() {
            return Err(error);
        }
        if number.is_multiple_of(LINES_BETWEEN_CHECKS) {
            obj.take_memory(path, resources)
        } else {
            Ok(())
        }
    })?;
    obj.take_memory(path, resources)?;
    Ok(obj.into_scene())
}

/// Calls `visit` with line number (from 1), first word and rest of each line that is neither empty
/// nor a comment. A backslash at its end continues a line.
fn read_lines(
    path: &Path,
    mut visit: impl FnMut(u64, &str, &str) -> Result<(), SceneError>,
) -> Result<(), SceneError> {
    let file = open_input(path).map_err(|e| SceneError::io(path, "open", e))?;
    let mut reader = BufReader::new(file);
    let (mut line, mut number) = (Vec::new(), 0);
    loop {
        let (before, room) = (line.len(), LINE_BYTES_MAX.saturating_sub(line.len() as u64));
        let read = reader.by_ref().take(room).read_until(b'\n', &mut line);
        let read = read.map_err(|e| SceneError::io(path, "read", e))?;
        number += 1;
        if line.len() as u64 == LINE_BYTES_MAX {
            let message = format!("line {number} is longer than {LINE_BYTES_MAX} bytes");
            return Err(SceneError::malformed(path, message));
        }
        let text = line.trim_ascii_end();
        if read > 0 && text.ends_with(b"\\") {
            let kept = text.len() - 1;
            line.truncate(kept.max(before));
            line.push(b' ');
            continue;
        }
        // Names may be in any encoding; what is not UTF-8 only has to stay distinct enough.
        let text = String::from_utf8_lossy(&line);
        let (keyword, rest) =
            text.trim().split_once(char::is_whitespace).unwrap_or((text.trim(), ""));
        if !keyword.is_empty() && !keyword.starts_with('#') {
            visit(number, keyword, rest.trim())?;
        }
        if read == 0 {
            return Ok(());
        }
        line.clear();
    }
}

/// A corner of a face: position, and texture coordinates and normal if it has them.
type Corner = (u32, Option<u32>, Option<u32>);

/// The faces of one material, vertices shared where all three indices agree.
#[derive(Default)]
struct Part {
    corners: Vec<Corner>,
    numbers: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
}

/// What has been read so far.
#[derive(Default)]
struct Obj {
    positions: Vec<Vec3>,
    /// Empty, or one per position.
    colors: Vec<[f32; 3]>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    library: mtl::Library,
    /// Index into `parts` by name of the material; `None` before the first `usemtl`.
    part_numbers: HashMap<Option<String>, usize>,
    /// In order of appearance.
    parts: Vec<(Option<String>, Part)>,
    material: Option<String>,
    ignored: BTreeMap<&'static str, u64>,
    /// Bytes taken of the scene's memory.
    taken_bytes: u64,
}

impl Obj {
    /// Takes what has come to be held since it was last called.
    fn take_memory(&mut self, path: &Path, resources: &Resources) -> Result<(), SceneError> {
        let corners: usize = self.parts.iter().map(|(_, part)| part.corners.len()).sum();
        let triangles: usize = self.parts.iter().map(|(_, part)| part.triangles.len()).sum();
        let places = self.positions.len() + self.colors.len() + self.normals.len();
        let held = (places * VERTEX_BYTES
            + self.uvs.len() * size_of::<Vec2>()
            + corners * CORNER_BYTES
            + triangles * 2 * size_of::<[u32; 3]>()) as u64;
        let more = held - self.taken_bytes;
        self.taken_bytes = held;
        resources.take(path, more)
    }

    fn read_line(
        &mut self,
        path: &Path,
        keyword: &str,
        rest: &str,
        resources: &Resources,
    ) -> Result<(), String> {
        match keyword {
            "v" => self.read_position(rest)?,
            "vt" => {
                let [u, v] = read_floats(rest, [f32::NAN, 0.0])?;
                // Row 0 of our textures is at the top, v = 0 of theirs at the bottom.
                self.uvs.push(Vec2::new(u, 1.0 - v));
            }
            "vn" => self.normals.push(Vec3::from_array(read_floats(rest, [f32::NAN; 3])?)),
            "f" | "fo" => self.read_face(rest)?,
            "usemtl" => self.material = Some(rest.to_owned()),
            "mtllib" => self.library.read(path, rest, resources),
            "l" => *self.ignored.entry("lines").or_default() += 1,
            "p" => *self.ignored.entry("points").or_default() += 1,
            "curv" | "curv2" | "surf" => {
                *self.ignored.entry("curves and curved surfaces").or_default() += 1;
            }
            _ => {}
        }
        Ok(())
    }

    fn read_position(&mut self, rest: &str) -> Result<(), String> {
        let words = rest.split_ascii_whitespace().count();
        let position = Vec3::from_array(read_floats(rest, [f32::NAN; 3])?);
        if words >= 6 {
            // Colors may begin anywhere in the file; what came before is white.
            self.colors.resize(self.positions.len(), [1.0; 3]);
            let [.., r, g, b] = read_floats(rest, [f32::NAN; 6])?;
            self.colors.push([r, g, b].map(|c| c.clamp(0.0, 1.0)));
        } else if !self.colors.is_empty() {
            self.colors.push([1.0; 3]);
        }
        self.positions.push(position);
        Ok(())
    }

    fn read_face(&mut self, rest: &str) -> Result<(), String> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let corners: Result<Vec<Corner>, String> =
            rest.split_ascii_whitespace().map(|word| read_corner(word, counts)).collect();
        let corners = corners?;
        if corners.len() < 3 {
            return Err(format!("a face has {} corners, expected at least 3", corners.len()));
        }
        let number = match self.part_numbers.get(&self.material) {
            Some(&number) => number,
            None => {
                self.part_numbers.insert(self.material.clone(), self.parts.len());
                self.parts.push((self.material.clone(), Part::default()));
                self.parts.len() - 1
            }
        };
        let part = &mut self.parts[number].1;
        let vertices: Vec<u32> =
            corners.into_iter().map(|corner| part.add_corner(corner)).collect();
        part.triangles.extend(vertices[1..].windows(2).map(|w| [vertices[0], w[0], w[1]]));
        Ok(())
    }

    fn into_scene(self) -> Scene {
        let mut scene = Scene { warnings: self.library.warnings, ..Scene::default() };
        let left_out = |(name, count)| format!("{count} {name} are left out");
        scene.warnings.extend(self.ignored.into_iter().map(left_out));
        scene.textures = self.library.textures;
        for (name, part) in &self.parts {
            let material = name.as_ref().and_then(|name| {
                let found = self.library.materials.iter().rev().find(|m| m.name == *name);
                if found.is_none() {
                    let text = "is not in any material library; a gray one is used";
                    scene.warnings.push(format!("material {name} {text}"));
                }
                found
            });
            let gray = || Material {
                name: name.clone().unwrap_or_else(|| "default".into()),
                ..Material::default()
            };
            let mesh = part.to_mesh(
                [&self.positions, &self.normals],
                &self.uvs,
                &self.colors,
                scene.materials.len() as u32,
            );
            scene
                .instances
                .push(Instance { mesh: scene.meshes.len() as u32, transform: Affine3A::IDENTITY });
            scene.meshes.push(mesh);
            scene.materials.push(material.cloned().unwrap_or_else(gray));
        }
        scene
    }
}

impl Part {
    fn add_corner(&mut self, corner: Corner) -> u32 {
        let next = self.corners.len() as u32;
        *self.numbers.entry(corner).or_insert_with(|| {
            self.corners.push(corner);
            next
        })
    }

    /// The mesh; attributes that some corner lacks are left out.
    fn to_mesh(
        &self,
        [positions, normals]: [&[Vec3]; 2],
        uvs: &[Vec2],
        colors: &[[f32; 3]],
        material: u32,
    ) -> Mesh {
        let normal = |c: &Corner| normals.get(c.2? as usize)?.try_normalize();
        let uv = |c: &Corner| uvs.get(c.1? as usize).copied();
        let color = |c: &Corner| colors.get(c.0 as usize).copied();
        let corners = || self.corners.iter();
        Mesh {
            positions: corners().map(|c| positions[c.0 as usize]).collect(),
            normals: corners().map(normal).collect::<Option<_>>().unwrap_or_default(),
            uvs: corners().map(uv).collect::<Option<_>>().unwrap_or_default(),
            colors: corners().map(color).collect::<Option<_>>().unwrap_or_default(),
            triangles: self.triangles.clone(),
            material,
        }
    }
}

/// The first `N` numbers of a line, all finite; `defaults` that are numbers may be missing.
fn read_floats<const N: usize>(text: &str, defaults: [f32; N]) -> Result<[f32; N], String> {
    let mut values = defaults;
    for (value, word) in values.iter_mut().zip(text.split_ascii_whitespace()) {
        let parsed: f32 = word.parse().map_err(|_| format!("`{word}` is not a number"))?;
        if !parsed.is_finite() {
            return Err(format!("`{word}` is not finite"));
        }
        *value = parsed;
    }
    if values.iter().any(|v| v.is_nan()) {
        return Err(format!("expected {N} numbers, found `{text}`"));
    }
    Ok(values)
}

/// A corner as position/uv/normal, each from 1 on, or backward from the last with a minus.
fn read_corner(word: &str, counts: [usize; 3]) -> Result<Corner, String> {
    const NAMES: [&str; 3] = ["position", "texture coordinate", "normal"];
    let mut indices = [None; 3];
    for (k, text) in word.split('/').enumerate() {
        let slot =
            indices.get_mut(k).ok_or_else(|| format!("`{word}` has more than three parts"))?;
        if text.is_empty() {
            continue;
        }
        let number: i64 = text.parse().map_err(|_| format!("`{word}` is no face corner"))?;
        let count = counts[k] as i64;
        let index = if number < 0 { count.saturating_add(number) } else { number - 1 };
        if index < 0 || index >= count {
            let name = NAMES[k];
            return Err(format!(
                "{name} {number} of corner `{word}` is not one of the {count} so far"
            ));
        }
        *slot = Some(u32::try_from(index).map_err(|_| "more than 2^32 vertices".to_owned())?);
    }
    let position = indices[0].ok_or_else(|| format!("corner `{word}` has no position"))?;
    Ok((position, indices[1], indices[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(obj: &str, mtl: &str) -> Result<Scene, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.mtl"), mtl).unwrap();
        let path = folder.path().join("mesh.obj");
        std::fs::write(&path, obj).unwrap();
        read_obj(&path, &Resources::new(&pbgi_file::Allowance::unlimited()))
    }

    const SQUARE: &str = "mtllib a b.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\n\
        vn 0 0 2\nusemtl lamp\nf 1/1/1 2/2/1 3/1/1 -1/2/-1\nusemtl wall\nf 1//1 2//1 3//1\n";
    const LIBRARY: &str =
        "newmtl lamp\nKa 20 20 20\nKe 3 2 1\nKd 0.5 0.5 0.5\nnewmtl wall\nKd .2 .3\\\n .4\n";

    #[test]
    fn polygons_materials_and_negative_indices_are_read() {
        let scene = read(SQUARE, LIBRARY).unwrap();
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        assert_eq!(scene.meshes[0].triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(scene.meshes[0].normals, [Vec3::Z; 4]);
        assert_eq!(scene.meshes[0].uvs[1], Vec2::new(1.0, 0.0));
        assert!(scene.meshes[1].uvs.is_empty());
        assert_eq!(scene.materials[0].emission, [3.0, 2.0, 1.0]);
        assert_eq!(scene.materials[1].emission, [0.0; 3]);
        assert_eq!(scene.materials[1].base_color, [0.2, 0.3, 0.4]);
        assert_eq!(scene.instances.len(), 2);
    }

    #[test]
    fn missing_libraries_and_materials_are_warnings() {
        let scene = read(&SQUARE.replace("a b.mtl", "none.mtl"), "").unwrap();
        assert_eq!(scene.warnings.len(), 3, "{:?}", scene.warnings);
        assert_eq!(scene.materials[0].base_color, Material::default().base_color);
        let broken =
            read(SQUARE, "newmtl lamp\nKd 1 1\nmap_Kd none.png\nd 0.2\nnewmtl wall").unwrap();
        assert_eq!(broken.warnings.len(), 3, "{:?}", broken.warnings);
        assert!(broken.materials[0].alpha_cutoff.is_some());
    }

    #[test]
    fn malformed_lines_are_named() {
        for (from, to, expected) in [
            ("v 1 0 0", "v 1 0", "line 3: expected 3 numbers"),
            ("v 1 0 0", "v 1 x 0", "line 3: `x` is not a number"),
            ("v 1 0 0", "v 1 1e99 0", "line 3: `1e99` is not finite"),
            ("f 1//1 2//1 3//1", "f 1 2", "line 12: a face has 2 corners"),
            ("f 1//1 2//1 3//1", "f 1 2 5", "position 5"),
            ("f 1//1 2//1 3//1", "f 1 2 0", "position 0"),
            ("f 1//1 2//1 3//1", "f 1 2 -5", "position -5"),
            ("f 1//1 2//1 3//1", "f 1 2 3/9", "texture coordinate 9"),
            ("f 1//1 2//1 3//1", "f 1 2 /1", "no position"),
            ("f 1//1 2//1 3//1", "f 1 2 99999999999999999999", "no face corner"),
        ] {
            let message = read(&SQUARE.replace(from, to), LIBRARY).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn lines_and_points_are_left_out_with_a_warning() {
        let scene = read(&format!("{SQUARE}l 1 2\np 1\n"), LIBRARY).unwrap();
        assert_eq!(scene.warnings, ["1 lines are left out", "1 points are left out"]);
    }

    #[test]
    fn colors_may_begin_late() {
        let scene = read("v 0 0 0\nv 1 0 0 1 0.5 0\nv 0 1 0\nf 1 2 3", "").unwrap();
        assert_eq!(scene.meshes[0].colors, [[1.0; 3], [1.0, 0.5, 0.0], [1.0; 3]]);
    }

    #[test]
    fn mutated_files_never_panic() {
        let mut errors = 0;
        for place in 0..SQUARE.len() {
            for byte in [b'0', b'-', b'/', b' ', b'\n', b'\\', 0xff] {
                let mut damaged = SQUARE.as_bytes().to_vec();
                damaged[place] = byte;
                let damaged = String::from_utf8_lossy(&damaged).into_owned();
                errors += u32::from(read(&damaged, &damaged).is_err());
            }
        }
        assert!(errors > 100, "{errors}");
    }
}
