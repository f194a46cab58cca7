//! Wavefront OBJ with its MTL materials.

mod mtl;

use crate::SceneError;
use crate::find_file::plain_name;
use crate::origin::Places;
use crate::polygon::Triangulator;
use crate::resources::Resources;
use mtl::Placement;
use pbgi_cloud::parse_number;
use pbgi_file::open_input;
use pbgi_math::{Affine3A, DVec3, Vec2, Vec3};
use pbgi_scene::display_to_linear;
use pbgi_scene::{Instance, Material, Mesh, Scene};
use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Longest line in bytes.
const LINE_BYTES_MAX: u64 = 1 << 20;

/// Lines after which it is seen how much memory is held.
const LINES_BETWEEN_CHECKS: u64 = 4096;

/// Bytes of a place, a color or a normal, and of a corner: while it is read, its number is looked up in a table half full, and then it
/// becomes a vertex.
const VERTEX_BYTES: usize = size_of::<Vec3>();
const CORNER_BYTES: usize = 3 * size_of::<Corner>() + 4 * VERTEX_BYTES;

/// Keywords that say nothing about shape or light, or belong to lines that are left out.
const SILENT_KEYWORDS: [&str; 33] = [
    "g",
    "o",
    "s",
    "vp",
    "mg",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "shadow_obj",
    "trace_obj",
    "ctech",
    "stech",
    "maplib",
    "cstype",
    "deg",
    "bmat",
    "step",
    "end",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "con",
    "bsp",
    "bzp",
    "cdc",
    "cdp",
    "res",
    "csh",
    "bmat",
    "version",
];

/// Reads an OBJ file: one mesh and one instance per material, or more where some of its faces lack texture coordinates or normals.
/// Polygons are cut into triangles; lines, points, curves and smoothing groups are left out. Vertex colors after the position are
/// those of a display. A missing MTL file or material is a warning.
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

/// Beginning of comments of ZBrush with mask and color of vertices, in lower case.
const COLORS_KEYWORD: &str = "#mrgb";

/// Calls `visit` with line number (from 1), first word in lower case, and rest of each line that is neither empty
/// nor a comment, unless it has colors. A backslash at its end continues a line; a byte order mark before the first is skipped. Lines may
/// end as on any system.
fn read_lines(
    path: &Path,
    mut visit: impl FnMut(u64, &str, &str) -> Result<(), SceneError>,
) -> Result<(), SceneError> {
    let file = open_input(path).map_err(|e| SceneError::io(path, "open", e))?;
    let mut reader = BufReader::new(file);
    let (mut line, mut number) = (Vec::new(), 0);
    loop {
        let (before, room) = (line.len(), LINE_BYTES_MAX.saturating_sub(line.len() as u64));
        let read = read_line_of_any_end(&mut reader, room as usize, &mut line);
        let read = read.map_err(|e| SceneError::io(path, "read", e))?;
        number += 1;
        if number == 1 {
            skip_byte_order_mark(path, &mut line)?;
        }
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
        let keyword = keyword.to_ascii_lowercase();
        if !keyword.is_empty() && (!keyword.starts_with('#') || keyword == COLORS_KEYWORD) {
            visit(number, &keyword, rest.trim())?;
        }
        if read == 0 {
            return Ok(());
        }
        line.clear();
    }
}

/// Appends a line and the byte that ends it, `\n` or `\r`, at most `room` bytes; returns how many were read, 0 at the end. Of `\r\n` both
/// are read as one end.
fn read_line_of_any_end(
    reader: &mut impl BufRead,
    room: usize,
    line: &mut Vec<u8>,
) -> std::io::Result<usize> {
    let mut read = 0;
    while read < room {
        let bytes = reader.fill_buf()?;
        let bytes = &bytes[..bytes.len().min(room - read)];
        let end = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
        let taken = end.map_or(bytes.len(), |end| end + 1);
        line.extend_from_slice(&bytes[..taken]);
        let is_return = end.is_some_and(|end| bytes[end] == b'\r');
        let is_over = taken == 0 || end.is_some();
        reader.consume(taken);
        read += taken;
        if is_return && reader.fill_buf()?.first() == Some(&b'\n') {
            reader.consume(1);
        }
        if is_over {
            break;
        }
    }
    Ok(read)
}

fn skip_byte_order_mark(path: &Path, line: &mut Vec<u8>) -> Result<(), SceneError> {
    if line.starts_with(&[0xff, 0xfe]) || line.starts_with(&[0xfe, 0xff]) {
        return Err(SceneError::unsupported(path, "text in UTF-16", "save it as UTF-8"));
    }
    if line.starts_with("\u{feff}".as_bytes()) {
        line.drain(..3);
    }
    Ok(())
}

/// A corner of a face: position, and texture coordinates and normal if it has them.
type Corner = (u32, Option<u32>, Option<u32>);

/// What the faces of a part have in common: their material, `None` before the first `usemtl`, and whether all their corners have
/// texture coordinates, and normals.
type PartKey = (Option<String>, bool, bool);

/// Faces of one material, vertices shared where all three indices agree.
#[derive(Default)]
struct Part {
    corners: Vec<Corner>,
    numbers: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
}

/// What has been read so far.
#[derive(Default)]
struct Obj {
    /// Positions; those that are not finite may not be used.
    places: Places,
    /// Empty, or one per position, as written.
    colors: Vec<[f32; 3]>,
    /// Colors of vertices in comments of ZBrush, in their order: codes of a display from 0 to 255.
    comment_colors: Vec<[u8; 3]>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    library: mtl::Library,
    /// Index into `parts`.
    part_numbers: HashMap<PartKey, usize>,
    /// In order of appearance.
    parts: Vec<(PartKey, Part)>,
    material: Option<String>,
    triangulator: Triangulator,
    /// The face under way.
    corners: Vec<Corner>,
    outline: Vec<Vec3>,
    /// Texture coordinates and normals that corners name and the file does not have.
    missing_uvs: u64,
    bad_uvs: u64,
    missing_normals: u64,
    ignored: BTreeMap<&'static str, u64>,
    /// Bytes taken of the scene's memory.
    taken_bytes: u64,
    unknown: BTreeMap<String, u64>,
}

/// Most unknown keywords that are told apart.
const UNKNOWN_MAX: usize = 20;

impl Obj {
    /// Takes what has come to be held since it was last called.
    fn take_memory(&mut self, path: &Path, resources: &Resources) -> Result<(), SceneError> {
        let corners: usize = self.parts.iter().map(|(_, part)| part.corners.len()).sum();
        let triangles: usize = self.parts.iter().map(|(_, part)| part.triangles.len()).sum();
        let colors = self.colors.len() + self.comment_colors.len();
        let places = self.places.len() + colors + self.normals.len();
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
            COLORS_KEYWORD => self.read_color_comment(rest),
            "vt" => {
                let [u] = read_any_floats(rest)?;
                let v = read_any_floats::<2>(rest).map_or(0.0, |[_, v]| v);
                // Row 0 of our textures is at the top, v = 0 of theirs at the bottom.
                let uv = Vec2::new(u, 1.0 - v);
                self.bad_uvs += u64::from(!uv.is_finite());
                self.uvs.push(if uv.is_finite() { uv } else { Vec2::ZERO });
            }
            "vn" => {
                let normal = Vec3::from_array(read_any_floats(rest)?);
                self.normals.push(normal.try_normalize().unwrap_or(Vec3::ZERO));
            }
            "f" | "fo" => self.read_face(rest)?,
            "usemtl" => self.material = Some(rest.to_owned()),
            "mtllib" => self.library.read(path, rest, resources),
            "l" => *self.ignored.entry("lines").or_default() += 1,
            "p" => *self.ignored.entry("points").or_default() += 1,
            "curv" | "curv2" | "surf" => {
                *self.ignored.entry("curves and curved surfaces").or_default() += 1;
            }
            "call" => *self.ignored.entry("calls of other files").or_default() += 1,
            "usemap" => *self.ignored.entry("texture maps of `usemap`").or_default() += 1,
            _ if SILENT_KEYWORDS.contains(&keyword) => {}
            _ if self.unknown.len() < UNKNOWN_MAX || self.unknown.contains_key(keyword) => {
                *self.unknown.entry(keyword.chars().take(40).collect()).or_default() += 1;
            }
            _ => {}
        }
        Ok(())
    }

    fn read_position(&mut self, rest: &str) -> Result<(), String> {
        let position = DVec3::from_array(read_any_numbers(rest)?);
        let words = rest.split_ascii_whitespace().take_while(|word| !word.starts_with('#'));
        if words.count() >= 6 {
            // Colors may begin anywhere in the file; what came before is white.
            self.colors.resize(self.places.len(), [1.0; 3]);
            let [.., r, g, b] = read_any_floats::<6>(rest)?;
            self.colors.push([r, g, b].map(|c| if c.is_finite() { c.max(0.0) } else { 0.0 }));
        } else if !self.colors.is_empty() {
            self.colors.push([1.0; 3]);
        }
        self.places.push(position);
        Ok(())
    }

    /// Eight digits per vertex: mask, red, green, blue. What is no such number is a comment after all.
    fn read_color_comment(&mut self, rest: &str) {
        let color = |digits: &[u8]| {
            let code = u32::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?;
            let [_, r, g, b] = code.to_be_bytes();
            Some([r, g, b])
        };
        let colors = rest.as_bytes().chunks_exact(8).map_while(color);
        self.comment_colors.extend(colors);
    }

    fn read_face(&mut self, rest: &str) -> Result<(), String> {
        let positions = self.places.settle();
        let counts = [positions.len(), self.uvs.len(), self.normals.len()];
        self.corners.clear();
        self.outline.clear();
        for word in rest.split_ascii_whitespace().take_while(|word| !word.starts_with('#')) {
            let (corner, missing) = read_corner(word, counts)?;
            let position = positions[corner.0 as usize];
            if !position.is_finite() {
                let number = corner.0 + 1;
                return Err(format!("position {number} of corner `{word}` is not finite"));
            }
            self.missing_uvs += u64::from(missing[0]);
            self.missing_normals += u64::from(missing[1]);
            self.corners.push(corner);
            self.outline.push(position);
        }
        if self.corners.len() < 3 {
            *self.ignored.entry("faces of fewer than three corners").or_default() += 1;
            return Ok(());
        }
        let has_uvs = self.corners.iter().all(|corner| corner.1.is_some());
        let has_normals = self.corners.iter().all(|corner| corner.2.is_some());
        let key = (self.material.clone(), has_uvs, has_normals);
        let number = match self.part_numbers.get(&key) {
            Some(&number) => number,
            None => {
                self.part_numbers.insert(key.clone(), self.parts.len());
                self.parts.push((key, Part::default()));
                self.parts.len() - 1
            }
        };
        let part = &mut self.parts[number].1;
        let vertices: Vec<u32> = self
            .corners
            .iter()
            .map(|&(position, uv, normal)| {
                part.add_corner((position, uv.filter(|_| has_uvs), normal.filter(|_| has_normals)))
            })
            .collect();
        self.triangulator
            .triangulate(&self.outline, |t| part.triangles.push(t.map(|corner| vertices[corner])));
        Ok(())
    }

    fn into_scene(mut self) -> Scene {
        let (origin, positions) = std::mem::take(&mut self.places).finish();
        let mut scene = Scene { origin, warnings: self.warnings(), ..Scene::default() };
        self.decode_colors(positions.len());
        scene.textures = std::mem::take(&mut self.library.textures);
        // Materials by name, in order of use; that of colored parts without one is white.
        let mut materials: HashMap<&Option<String>, (u32, Placement)> = HashMap::new();
        let mut untextured = 0;
        for ((name, has_uvs, _), part) in &self.parts {
            let (material, placement) = *materials.entry(name).or_insert_with(|| {
                let (material, placement) = self.find_material(name, &mut scene.warnings);
                scene.materials.push(material);
                (scene.materials.len() as u32 - 1, placement)
            });
            let Material { base_color_texture, emission_texture, .. } =
                &scene.materials[material as usize];
            if !has_uvs && base_color_texture.or(*emission_texture).is_some() {
                untextured += part.triangles.len();
            }
            let mut mesh =
                part.to_mesh([&positions, &self.normals], &self.uvs, &self.colors, material);
            mesh.uvs.iter_mut().for_each(|uv| *uv = placement.place(*uv));
            scene
                .instances
                .push(Instance { mesh: scene.meshes.len() as u32, transform: Affine3A::IDENTITY });
            scene.meshes.push(mesh);
        }
        if untextured > 0 {
            scene.warnings.push(format!(
                "{untextured} triangles have a textured material but no texture coordinates; the texture is left out there"
            ));
        }
        scene
    }

    /// The material called `name`, else one in other case, or with other quotes or comments, else a gray one, which vertex colors make
    /// white; and where its textures lie.
    fn find_material(
        &self,
        name: &Option<String>,
        warnings: &mut Vec<String>,
    ) -> (Material, Placement) {
        let base_color = match self.colors.is_empty() {
            true => Material::default().base_color,
            false => [1.0; 3],
        };
        let Some(name) = name else {
            let plain = Material { name: "default".into(), base_color, ..Material::default() };
            return (plain, Placement::default());
        };
        let library = &self.library;
        let last = |is_it: &dyn Fn(&str) -> bool| {
            library.materials.iter().rposition(|material| is_it(&material.name))
        };
        let plain = plain_name(name);
        let found = last(&|own| own == name)
            .or_else(|| last(&|own| own.eq_ignore_ascii_case(name)))
            .or_else(|| last(&|own| plain_name(own).eq_ignore_ascii_case(plain)));
        let known = found.map(|i| (library.materials[i].clone(), library.placements[i]));
        known.unwrap_or_else(|| {
            let color = if self.colors.is_empty() { "a gray one is" } else { "vertex colors are" };
            warnings.push(format!("material {name} is not in any material library; {color} used"));
            let plain = Material { name: name.clone(), base_color, ..Material::default() };
            (plain, Placement::default())
        })
    }

    fn warnings(&mut self) -> Vec<String> {
        let mut warnings = std::mem::take(&mut self.library.warnings);
        let left_out = |(name, count): (&&str, &u64)| format!("{count} {name} are left out");
        warnings.extend(self.ignored.iter().map(left_out));
        warnings.extend(self.unknown.iter().map(|(keyword, count)| {
            format!("{count} lines that begin with `{keyword}` are not understood and left out")
        }));
        warnings.extend(self.triangulator.warnings());
        if self.missing_uvs > 0 {
            let count = self.missing_uvs;
            warnings.push(format!(
                "{count} corners of faces name texture coordinates that are not in the file; their faces have no texture"
            ));
        }
        if self.bad_uvs > 0 {
            let count = self.bad_uvs;
            warnings.push(format!("{count} texture coordinates are not finite; 0 is used"));
        }
        if self.missing_normals > 0 {
            let count = self.missing_normals;
            warnings.push(format!(
                "{count} corners of faces name normals that are not in the file; their faces are flat"
            ));
        }
        let zero_count = self.normals.iter().filter(|normal| **normal == Vec3::ZERO).count();
        if zero_count > 0 {
            warnings.push(format!(
                "{zero_count} normals have no direction; those of their faces are used there"
            ));
        }
        warnings
    }

    /// Makes colors linear: they are those of a display, from 0 to 1, or to 255 where one is above 1.
    fn decode_colors(&mut self, position_count: usize) {
        let in_comments = std::mem::take(&mut self.comment_colors);
        if self.colors.is_empty() && !in_comments.is_empty() {
            let color = |codes: &[u8; 3]| codes.map(|c| f32::from(c) / 255.0);
            self.colors = in_comments.iter().map(color).collect();
            self.colors.resize(position_count, [1.0; 3]);
        }
        let largest = self.colors.iter().flatten().fold(0f32, |max, &c| max.max(c));
        let scale = if largest > 1.0 { 1.0 / 255.0 } else { 1.0 };
        for color in &mut self.colors {
            *color = color.map(|c| display_to_linear((c * scale).min(1.0)));
        }
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
        let normal = |c: &Corner| normals.get(c.2? as usize).copied();
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
            ..Mesh::default()
        }
    }
}

/// The first `N` numbers of a line up to a comment, all finite; `defaults` that are numbers may be missing.
fn read_floats<const N: usize>(text: &str, defaults: [f32; N]) -> Result<[f32; N], String> {
    let mut values = defaults;
    let words = text.split_ascii_whitespace().take_while(|word| !word.starts_with('#'));
    for (value, word) in values.iter_mut().zip(words) {
        let parsed = parse_number(word).ok_or_else(|| format!("`{word}` is not a number"))? as f32;
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

/// The first `N` numbers of a line, which need not be finite.
fn read_any_floats<const N: usize>(text: &str) -> Result<[f32; N], String> {
    Ok(read_any_numbers(text)?.map(|value| value as f32))
}

/// As [`read_any_floats`], with all digits.
fn read_any_numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let mut words = text.split_ascii_whitespace().take_while(|word| !word.starts_with('#'));
    let mut values = [0.0; N];
    for value in &mut values {
        let word = words.next().ok_or_else(|| format!("expected {N} numbers, found `{text}`"))?;
        *value = parse_number(word).ok_or_else(|| format!("`{word}` is not a number"))?;
    }
    Ok(values)
}

/// A corner as position/uv/normal, each from 1 on, or backward from the last with a minus; 0 is none. Also whether its texture
/// coordinates, and its normal, are not in the file.
fn read_corner(word: &str, counts: [usize; 3]) -> Result<(Corner, [bool; 2]), String> {
    let mut indices = [None; 3];
    let mut missing = [false; 3];
    for (k, text) in word.split('/').enumerate() {
        let slot =
            indices.get_mut(k).ok_or_else(|| format!("`{word}` has more than three parts"))?;
        if text.is_empty() {
            continue;
        }
        let number: i64 = text.parse().map_err(|_| format!("`{word}` is no face corner"))?;
        let count = counts[k] as i64;
        let index = if number < 0 { count.saturating_add(number) } else { number - 1 };
        if k > 0 && !(0..count).contains(&index) {
            // The shape is whole without them.
            missing[k] = number != 0;
            continue;
        }
        if index < 0 || index >= count {
            return Err(format!(
                "position {number} of corner `{word}` is not one of the {count} so far"
            ));
        }
        *slot = Some(u32::try_from(index).map_err(|_| "more than 2^32 vertices".to_owned())?);
    }
    let position = indices[0].ok_or_else(|| format!("corner `{word}` has no position"))?;
    Ok(((position, indices[1], indices[2]), [missing[1], missing[2]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_freely(path: &Path) -> Result<Scene, SceneError> {
        read_obj(path, &Resources::new(&pbgi_file::Allowance::unlimited()))
    }

    fn read(obj: &str, mtl: &str) -> Result<Scene, SceneError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.mtl"), mtl).unwrap();
        let path = folder.path().join("mesh.obj");
        std::fs::write(&path, obj).unwrap();
        read_freely(&path)
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
            ("v 1 0 0", "v 1 0 # 0", "line 3: expected 3 numbers"),
            ("v 1 0 0", "v 1 x 0", "line 3: `x` is not a number"),
            ("v 1 0 0", "v 1 1e99 0", "line 10: position 2 of corner `2/2/1` is not finite"),
            ("v 1 0 0", "v 1 -nan(ind) 0", "line 10: position 2"),
            ("f 1//1 2//1 3//1", "f 1 2 5", "position 5"),
            ("f 1//1 2//1 3//1", "f 1 2 0", "position 0"),
            ("f 1//1 2//1 3//1", "f 1 2 -5", "position -5"),
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
        let colors = &scene.meshes[0].colors;
        assert_eq!([colors[0], colors[2]], [[1.0; 3]; 2]);
        assert!((colors[1][1] - 0.214_04).abs() < 1e-4 && colors[1][2] == 0.0, "{colors:?}");
    }

    #[test]
    fn colors_are_those_of_a_display_and_replace_the_gray() {
        for (v, expected) in [("0.5 0.5 1", 0.214_04), ("127.5 127.5 255", 0.214_04)] {
            let scene =
                read(&format!("v 0 0 0 {v}\nv 1 0 0 {v}\nv 0 1 0 {v}\nf 1 2 3"), "").unwrap();
            assert_eq!(scene.materials[0].base_color, [1.0; 3]);
            let [r, _, b] = scene.meshes[0].colors[2];
            assert!((r - expected).abs() < 1e-4 && b == 1.0, "{r} {b}");
        }
    }

    #[test]
    fn what_faces_lack_costs_them_their_texture_only() {
        let text = format!(
            "{SQUARE}usemtl lamp\nf 1/1/1 2/7/1 3/1/9\nf 1/0/0 2/0/0 3/0/0 # one\nf 1 2 3#4\n"
        );
        let message = read(&text, LIBRARY).unwrap_err().to_string();
        assert!(message.contains("`3#4` is no face corner"), "{message}");
        let scene = read(&text.replace("3#4", "3 #4"), LIBRARY).unwrap();
        let triangles = scene.meshes.iter().map(|m| m.triangles.len()).collect::<Vec<_>>();
        // The lamp's textured square stays whole; each material is there once.
        assert_eq!(triangles, [2, 1, 3]);
        assert_eq!(scene.meshes.iter().map(|m| m.material).collect::<Vec<_>>(), [0, 1, 0]);
        assert_eq!((scene.meshes[0].uvs.len(), scene.meshes[2].uvs.len()), (4, 0));
        let [uvs, normals] = &scene.warnings[..] else { panic!("{:?}", scene.warnings) };
        assert!(uvs.contains("1 corners of faces name texture coordinates"), "{uvs}");
        assert!(normals.contains("1 corners of faces name normals"), "{normals}");
    }

    #[test]
    fn byte_order_marks_and_keywords_in_any_case_are_read() {
        let marked = format!("\u{feff}{}", SQUARE.replace("v 0 1 0", "V 0 1 0 # top"));
        let library =
            format!("\u{feff}{}", LIBRARY.replace("Kd", "KD").replace("newmtl", "NewMtl"));
        let scene = read(&marked, &library).unwrap();
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        assert_eq!(scene.meshes[0].positions[0], Vec3::ZERO);
        assert_eq!(scene.materials[1].base_color, [0.2, 0.3, 0.4]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wide.obj");
        std::fs::write(&path, b"\xff\xfev\0 \0").unwrap();
        assert!(read_freely(&path).unwrap_err().to_string().contains("UTF-8"));
    }

    #[test]
    fn unused_vertices_and_normals_may_be_anything() {
        let text = SQUARE
            .replace("vn 0 0 2", "vn 0 0 2\nvn 0 0 0\nvt nan 1\nv nan 1 1\nv 1.#IND 0 -1.#INF");
        let text = text.replace("-1/2/-1", "4/2/1") + "f 1 2\n";
        let scene = read(&text, LIBRARY).unwrap();
        assert_eq!(scene.meshes[0].normals, [Vec3::Z; 4]);
        let [faces, uvs, normals] = &scene.warnings[..] else { panic!("{:?}", scene.warnings) };
        assert!(
            faces.contains("1 faces of fewer than three corners") && uvs.contains("not finite")
        );
        assert!(normals.contains("1 normals have no direction"), "{normals}");
    }

    #[test]
    fn concave_faces_are_cut_within_their_outline() {
        let text = "v 1 0 1\nv 2 0 1\nv 2 0 0\nv 0 0 0\nv 0 0 2\nv 1 0 2\nf 1 2 3 4 5 6\n";
        let mesh = &read(text, "").unwrap().meshes[0];
        let doubled = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            (b - a).cross(c - a)
        };
        assert!(
            (mesh.triangles.iter().map(|t| doubled(t).length()).sum::<f32>() - 6.0).abs() < 1e-5
        );
        assert!(mesh.triangles.iter().all(|t| doubled(t).y > 0.0));
    }

    #[test]
    fn unknown_lines_are_counted() {
        let scene = read(&format!("{SQUARE}vx 1\nvx 2\ncall a.obj\ns 1\n"), LIBRARY).unwrap();
        let [calls, unknown] = &scene.warnings[..] else { panic!("{:?}", scene.warnings) };
        assert!(calls.contains("calls") && unknown.contains("2 lines that begin with `vx`"));
    }

    /// Reads the square with files beside it; the last material is `m`.
    fn read_with(mtl: &str, files: &[(&str, &[u8])]) -> Scene {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        std::fs::write(folder.path().join("m.mtl"), format!("newmtl m\n{mtl}")).unwrap();
        let path = folder.path().join("mesh.obj");
        let obj = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
            usemtl m\nf 1/1 2/2 3/3 4/4\n";
        std::fs::write(&path, obj).unwrap();
        read_freely(&path).unwrap()
    }

    fn png(width: u32, pixels: &[[u8; 4]]) -> Vec<u8> {
        let height = pixels.len() as u32 / width;
        let mut bytes = std::io::Cursor::new(vec![]);
        image::RgbaImage::from_raw(width, height, pixels.concat())
            .unwrap()
            .write_to(&mut bytes, image::ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    }

    fn texels(scene: &Scene) -> &[[u8; 4]] {
        let texture = scene.materials[0].base_color_texture.unwrap();
        scene.textures[texture as usize].texels()
    }

    const GRAY: [u8; 4] = [128, 128, 128, 255];

    #[test]
    fn d_decides_where_tr_contradicts_it() {
        for (lines, is_hole, warnings) in [
            ("d 1\nTr 1", false, 1),
            ("Tr 1\nd 1", false, 1),
            ("d 0\nTr 0", true, 2),
            ("d 0.2\nTr 0.8", true, 1),
            ("d 0.7\nTr 0.3", false, 1),
            ("Tr 0.8", true, 1),
            // All of the library would be invisible: it means the opposite.
            ("Tr 1", false, 1),
            ("Tr 1\nnewmtl n\nTr 1.0", false, 1),
            ("Tr 1\nnewmtl n\nTr 0", true, 1),
        ] {
            let scene = read_with(lines, &[]);
            assert_eq!(scene.materials[0].alpha_cutoff.is_some(), is_hole, "{lines}");
            assert_eq!(scene.warnings.len(), warnings, "{lines}: {:?}", scene.warnings);
        }
    }

    #[test]
    fn black_beside_a_texture_is_not_multiplied() {
        let files: &[(&str, &[u8])] = &[("g.png", &png(1, &[GRAY]))];
        for (lines, base, glow, warnings) in [
            ("Kd 0 0 0\nmap_Kd g.png", 1.0, 0.0, 1),
            ("map_Kd g.png", 1.0, 0.0, 0),
            ("Kd 0.5 0.5 0.5\nmap_Kd g.png", 0.5, 0.0, 0),
            ("Kd 0 0 0", 0.0, 0.0, 0),
            ("Kd 0 0 0\nmap_Kd none.png", 1.0, 0.0, 2),
            ("Ke 0 0 0\nmap_Ke g.png", 0.8, 1.0, 1),
            ("Ke 3\nmap_Ke g.png", 0.8, 3.0, 0),
            ("Ke 3\nmap_Ke none.png", 0.8, 0.0, 1),
        ] {
            let scene = read_with(lines, files);
            let material = &scene.materials[0];
            assert_eq!((material.base_color[0], material.emission[0]), (base, glow), "{lines}");
            assert_eq!(scene.warnings.len(), warnings, "{lines}: {:?}", scene.warnings);
        }
    }

    #[test]
    fn masks_cut_holes() {
        let (white, black) = ([255; 4], [0, 0, 0, 255]);
        let clear = [128, 128, 128, 0];
        let files: &[(&str, &[u8])] = &[
            ("leaf.png", &png(1, &[GRAY])),
            ("mask.png", &png(2, &[white, black])),
            ("matte.png", &png(2, &[GRAY, clear])),
        ];
        for (lines, alphas) in [
            ("map_Kd leaf.png\nmap_d mask.png", &[255, 0][..]),
            ("map_Kd leaf.png\nMAP_D -clamp on mask.png", &[255, 0]),
            ("map_d mask.png", &[255, 0]),
            ("map_Kd matte.png\nmap_d matte.png", &[255, 0]),
            ("map_Kd leaf.png\nmap_d matte.png", &[255, 0]),
            ("map_Kd leaf.png\nmap_d -imfchan m matte.png", &[255, 0]),
            ("map_Kd mask.png\nmap_d mask.png", &[255, 0]),
        ] {
            let scene = read_with(lines, files);
            let found = texels(&scene).iter().map(|t| t[3]).collect::<Vec<_>>();
            assert_eq!(found, alphas, "{lines}");
            assert_eq!(scene.materials[0].alpha_cutoff, Some(0.5), "{lines}");
            assert!(scene.warnings.is_empty(), "{lines}: {:?}", scene.warnings);
        }
        let faded = read_with("d 0.8\nmap_d mask.png", files);
        assert_eq!(faded.materials[0].alpha_cutoff, Some(0.625));
        let unmasked = read_with("map_Kd matte.png", files);
        assert_eq!((texels(&unmasked)[1][3], unmasked.materials[0].alpha_cutoff), (255, None));
        assert!(unmasked.warnings[0].contains("no map_d"), "{:?}", unmasked.warnings);
    }

    #[test]
    fn options_of_maps_are_honored_or_named() {
        let files: &[(&str, &[u8])] = &[("my map.png", &png(2, &[GRAY, [255; 4]]))];
        for (options, warnings) in [
            ("", 0),
            ("-blendu off -mm 0 1 -s 1 1 1 -o 0 0", 0),
            ("-s 2 2 1", 0),
            ("-o 0.5 -t 0.1 0 0", 1),
            ("-bm 0.5 -mm 0.2 0.5", 1),
        ] {
            let scene = read_with(&format!("map_Kd {options} my map.png"), files);
            assert_eq!(texels(&scene).len(), 2, "{options}");
            assert_eq!(scene.warnings.len(), warnings, "{options}: {:?}", scene.warnings);
        }
        let at_edge = |options: &str| {
            let scene = read_with(&format!("map_Kd {options} My Map.PNG"), files);
            scene.textures[0].sample(Vec2::new(1.4, 0.5))[0]
        };
        assert!(at_edge("-clamp on") > 0.99 && at_edge("-clamp off") < 0.8);
        assert!(read_with("map_Kd", &[]).warnings[0].contains("names no file"));
        // The corner of 1, 1 as OBJ counts, whose second coordinate grows upward.
        let scene = read_with("map_Kd -s 2 3 1 -o 0.25 0.5 0 my map.png", files);
        assert_eq!(scene.meshes[0].uvs[2], Vec2::new(2.25, -2.5));
        assert_eq!(scene.meshes[0].uvs[0], Vec2::new(0.25, 0.5));
        let unlike = read_with("map_Kd my map.png\nmap_d -s 2 2 my map.png", files);
        assert!(unlike.warnings[0].contains("places its textures differently"));
    }

    #[test]
    fn maps_and_gloss_that_are_not_read_are_counted() {
        let scene =
            read_with("disp a.png\nmap_Ks b.png\nTf 1 1 1\nnewmtl n\ndisp a.png\nTf 1 0 0", &[]);
        assert_eq!(scene.warnings.len(), 3, "{:?}", scene.warnings);
        assert!(
            scene.warnings[0].contains("disp (2 times) is not read; surfaces are not displaced")
        );
        let metal = read_with("Pm 1\nPr 0.3", &[]);
        assert_eq!((metal.materials[0].metallic, metal.materials[0].roughness), (1.0, 0.3));
    }

    #[test]
    fn what_is_not_read_of_materials_is_named() {
        let lines = "Ka 1 1 1\nKs 0.5\nNs 250\nNi 1.5\nillum 2\nPc 0\nPcr 0.03\nbump -bm 0.2 a.png\nNorm a.png\nmap_Tr a.png\nPc 1\n\
            glitter 2\nmap_Ka a.png\nKd 200 100 50";
        let scene = read_with(lines, &[]);
        let expected = [
            "`glitter`",
            "bump (1 times)",
            "map_tr (1 times) is not read; it makes no holes",
            "norm (1 times)",
            "pc (1 times)",
            "a Kd above 1",
            "map_Ka and no map_Kd",
        ];
        assert_eq!(scene.warnings.len(), expected.len(), "{:?}", scene.warnings);
        for text in expected {
            assert!(scene.warnings.iter().any(|warning| warning.contains(text)), "{text}");
        }
    }

    #[test]
    fn lines_may_end_as_on_any_system() {
        let expected = read(SQUARE, LIBRARY).unwrap().meshes[0].positions.clone();
        for end in ["\r", "\r\n"] {
            let text = SQUARE.replace("\n", end).replace("vn 0 0 2", &format!("vn \\{end}0 0 2"));
            let scene = read(&text, &LIBRARY.replace("\n", end)).unwrap();
            assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
            assert_eq!(scene.meshes[0].positions, expected);
            let message = read(&text.replace("v 1 0 0", "v 1 0"), LIBRARY).unwrap_err().to_string();
            assert!(message.contains("line 3: expected 3 numbers"), "{message}");
        }
    }

    /// Four vertices, of which a second line colors the last.
    #[test]
    fn colors_in_comments_of_zbrush_are_read() {
        let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n#MRGB ffff0000ff00ff00ff0000ff\n#MRGB ff808080\n#MRGB is color\n\
            f 1 2 3 4\n";
        let scene = read(text, "").unwrap();
        let colors = &scene.meshes[0].colors;
        assert_eq!(colors[..3], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert!((colors[3][0] - 0.215_86).abs() < 1e-4, "{colors:?}");
        assert_eq!(scene.materials[0].base_color, [1.0; 3]);
    }

    #[test]
    fn names_may_have_quotes_and_comments() {
        let scene = read(
            &SQUARE
                .replace("a b.mtl", "\"a b.mtl\" # library")
                .replace("usemtl wall", "usemtl \"Wall\" # 1"),
            LIBRARY,
        )
        .unwrap();
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        assert_eq!(scene.materials[1].base_color, [0.2, 0.3, 0.4]);
        let files: &[(&str, &[u8])] = &[("g.png", &png(1, &[GRAY]))];
        let textured = read_with("map_Kd g.png # gray", files);
        assert_eq!(texels(&textured).len(), 1, "{:?}", textured.warnings);
    }

    #[test]
    fn libraries_are_found_as_people_write_them() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("Sub")).unwrap();
        std::fs::write(folder.path().join("Sub/Lib.mtl"), "newmtl Red\nKd 1 0 0\n").unwrap();
        std::fs::write(folder.path().join("b.mtl"), "newmtl blue\nKd 0 0 1\n").unwrap();
        let path = folder.path().join("mesh.obj");
        for (library, material, color) in [
            ("sub\\lib.mtl", "red", [1.0, 0.0, 0.0]),
            ("none.mtl b.mtl", "blue", [0.0, 0.0, 1.0]),
            ("C:\\Users\\me\\B.MTL", "blue", [0.0, 0.0, 1.0]),
        ] {
            let text =
                format!("mtllib {library}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl {material}\nf 1 2 3");
            std::fs::write(&path, text).unwrap();
            assert_eq!(read_freely(&path).unwrap().materials[0].base_color, color, "{library}");
        }
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
