//! MTL material libraries.

use super::{read_floats, read_lines};
use crate::SceneError;
use crate::decode_texture::{DecodedImage, TextureSize, decode_image};
use crate::find_file::find_file;
use crate::resources::{Resources, is_lack_of_memory};
use pbgi_cloud::parse_number;
use pbgi_math::Vec2;
use pbgi_scene::{Material, Texture, Wrap};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Most keywords that are not read and are told apart.
const KEYWORDS_MAX: usize = 40;

/// Bytes that a line of a library may come to hold: a material, or a warning.
const LINE_BYTES: usize = size_of::<Draft>() + 64;

/// Materials read so far. Nothing in a library is an error: the shape matters more than its color,
/// so what cannot be read is a warning.
#[derive(Default)]
pub(super) struct Library {
    pub materials: Vec<Material>,
    /// Where each material's textures lie.
    pub placements: Vec<Placement>,
    pub textures: Vec<Texture>,
    pub warnings: Vec<String>,
    /// Why the scene cannot be read: what memory there is must not decide what is ignored.
    pub failed: Option<SceneError>,
    /// Textures that were made, by what they are made of.
    known: Vec<(TextureKey, u32)>,
    /// Libraries that were read, or looked for.
    seen: BTreeSet<String>,
}

/// A texture's files: of color and of mask.
#[derive(Clone, PartialEq)]
struct TextureKey {
    color: Option<Map>,
    mask: Option<Map>,
}

/// A `map_…` line: the file, and how it is laid.
#[derive(Clone, PartialEq)]
struct Map {
    name: String,
    clamp: bool,
    /// Of a mask: its alpha is meant, not its brightness.
    matte: bool,
    placement: Placement,
}

impl Map {
    /// The same wherever it lies.
    fn unplaced(self) -> Self {
        Self { placement: Placement::default(), ..self }
    }
}

/// Factor on texture coordinates, and what is added then: `-s` and `-o`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    scale: [f32; 2],
    offset: [f32; 2],
}

impl Default for Placement {
    fn default() -> Self {
        Self { scale: [1.0; 2], offset: [0.0; 2] }
    }
}

impl Placement {
    /// Coordinates in the texture, whose second grows downward.
    pub fn place(&self, uv: Vec2) -> Vec2 {
        if *self == Self::default() {
            return uv;
        }
        let [u, v] = [uv.x, 1.0 - uv.y];
        let [u, v] = [u * self.scale[0] + self.offset[0], v * self.scale[1] + self.offset[1]];
        Vec2::new(u, 1.0 - v)
    }
}

/// A material as its lines say it.
#[derive(Default)]
struct Draft {
    material: Material,
    has_kd: bool,
    has_ke: bool,
    d: Option<f32>,
    tr: Option<f32>,
    color: Option<Map>,
    mask: Option<Map>,
    glow: Option<Map>,
    /// Whether a texture is given for ambient light.
    has_ambient_map: bool,
    /// What is not read as its lines say.
    notes: Vec<String>,
}

/// What a keyword that is not read would have done.
fn effect_of(keyword: &str) -> Option<&'static str> {
    Some(match keyword {
        "disp" => "surfaces are not displaced",
        "map_pm" | "map_pr" => {
            "metalness and roughness are those of Pm and Pr, or of a matte surface"
        }
        "map_ks" | "map_ns" | "refl" => "gloss is that of the default material",
        "decal" => "no decals are laid over surfaces",
        "tf" => "light that comes through is not colored",
        "bump" | "map_bump" | "norm" | "map_kn" => "surfaces have the normals of their vertices",
        "map_tr" => "it makes no holes; name its inverse in map_d",
        "pc" | "ps" | "aniso" => "surfaces shine as they do without it",
        _ => return None,
    })
}

/// Keywords that change no light here: gloss of older models, how to render, and what serves those that are not read.
const SILENT_KEYWORDS: [&str; 12] =
    ["ka", "ks", "ns", "ni", "illum", "km", "sharpness", "map_aat", "pcr", "anisor", "cr", "ior"];

impl Library {
    /// Adds the libraries that an `mtllib` line of the OBJ file at `obj` names: one name, which may hold spaces, or several.
    pub fn read(&mut self, obj: &Path, names: &str, resources: &Resources) {
        if find_file(obj, names).is_some() {
            return self.read_one(obj, names, resources);
        }
        let words: Vec<&str> = names.split_ascii_whitespace().collect();
        let is_list =
            words.len() > 1 && words.iter().all(|word| word.to_ascii_lowercase().ends_with(".mtl"));
        if is_list {
            words.into_iter().for_each(|name| self.read_one(obj, name, resources));
        } else {
            self.read_one(obj, names, resources);
        }
    }

    /// Adds the library `name`.
    ///
    /// `Kd` and `map_Kd` give the base color, `Ke` and `map_Ke` the emitted radiance, `Pm` and `Pr` metalness and roughness; `map_d` cuts
    /// holes; `d` below 0.5 (or `Tr` above, where there is no `d`) makes the surface a hole. `Ka` is the reflection of an
    /// ambient light, no emission. A color given for a textured material multiplies the texture, unless it is black.
    fn read_one(&mut self, obj: &Path, name: &str, resources: &Resources) {
        if !self.seen.insert(name.to_owned()) {
            return;
        }
        let Some(path) = find_file(obj, name) else {
            self.warnings.push(format!(
                "material library {name} is left out: there is no such file beside the mesh"
            ));
            return;
        };
        resources.add_file(&path);
        let mut drafts: Vec<Draft> = Vec::new();
        let mut ignored: BTreeMap<String, u64> = BTreeMap::new();
        let read = read_lines(&path, |number, keyword, rest| {
            resources.take(&path, (LINE_BYTES + rest.len()) as u64)?;
            if let Err(message) = read_line(&mut drafts, &mut ignored, keyword, rest) {
                self.warnings.push(format!("{name}, line {number}: {message}"));
            }
            Ok(())
        });
        if let Err(error) = read {
            let Some(error) = self.fail_of_memory(error) else { return };
            self.warnings.push(format!("material library {name} is left out: {error}"));
            return;
        }
        for (keyword, count) in ignored {
            self.warnings.push(match effect_of(&keyword) {
                Some(effect) => format!("{name}: {keyword} ({count} times) is not read; {effect}"),
                None => format!(
                    "{name}: {count} lines that begin with `{keyword}` are not understood and left out"
                ),
            });
        }
        self.settle_inverted(name, &mut drafts);
        for draft in drafts {
            self.finish(&path, draft, resources);
        }
    }

    /// Gives an error back, unless it is a lack of memory, which fails the scene.
    fn fail_of_memory(&mut self, error: SceneError) -> Option<SceneError> {
        if !is_lack_of_memory(&error) {
            return Some(error);
        }
        self.failed = Some(error);
        None
    }

    /// Some programs write `Tr 1` and mean opaque: where a whole library would be invisible, that is what it says.
    fn settle_inverted(&mut self, name: &str, drafts: &mut [Draft]) {
        let vanishes = |draft: &Draft| draft.d.is_none() && draft.tr.is_some_and(|tr| tr >= 0.999);
        if !drafts.is_empty() && drafts.iter().all(vanishes) {
            drafts.iter_mut().for_each(|draft| draft.tr = None);
            self.warnings.push(format!(
                "{name}: all materials have Tr 1, which makes them invisible; they are read as opaque"
            ));
        }
    }

    fn finish(&mut self, path: &Path, draft: Draft, resources: &Resources) {
        let Draft { mut material, d, tr, color, mask, glow, .. } = draft;
        let placements = [&color, &mask, &glow].map(|map| map.as_ref().map(|m| m.placement));
        let placement = placements.into_iter().flatten().next().unwrap_or_default();
        let opacity = d.unwrap_or_else(|| 1.0 - tr.unwrap_or(0.0));
        let name = material.name.clone();
        let mut warn = |text: String| self.warnings.push(format!("material {name} {text}"));
        draft.notes.into_iter().for_each(&mut warn);
        if placements.into_iter().flatten().any(|other| other != placement) {
            warn("places its textures differently by -s and -o; all lie as the first of map_Kd, map_d, map_Ke".into());
        }
        if draft.has_ambient_map && color.is_none() {
            warn("has map_Ka and no map_Kd; a texture of ambient light is not read".into());
        }
        if d.is_some() && tr.is_some_and(|tr| (opacity < 0.5) != (tr > 0.5)) {
            warn("has both d and Tr, which contradict each other; d decides".into());
        }
        if opacity < 1.0 && mask.is_none() {
            let effect = if opacity < 0.5 { "a hole" } else { "opaque" };
            let keyword = if d.is_some() { "d" } else { "Tr" };
            let value = d.or(tr).unwrap_or_default();
            warn(format!("has {keyword} {value}, which is read as {effect}"));
        }
        let black = [0.0; 3];
        if draft.has_kd && material.base_color == black && color.is_some() {
            warn("has a texture and Kd 0 0 0; the black is not multiplied".into());
            material.base_color = [1.0; 3];
        } else if !draft.has_kd && color.is_some() {
            material.base_color = [1.0; 3];
        }
        if glow.is_some() && material.emission == black {
            if draft.has_ke {
                warn("has map_Ke and Ke 0 0 0; the black is not multiplied".into());
            }
            material.emission = [1.0; 3];
        }
        if color.is_some() || mask.is_some() {
            let key = TextureKey { color: color.map(Map::unplaced), mask: mask.map(Map::unplaced) };
            material.base_color_texture = self.add_texture(path, key, resources);
        }
        if let Some(glow) = glow {
            let key = TextureKey { color: Some(glow.unplaced()), mask: None };
            material.emission_texture = self.add_texture(path, key, resources);
            if material.emission_texture.is_none() {
                material.emission = black;
            }
        }
        let texture = material.base_color_texture.and_then(|t| self.textures.get(t as usize));
        let has_holes = texture.is_some_and(|texture| texture.alpha_min() < 1.0);
        material.alpha_cutoff = match has_holes {
            true => Some(if opacity > 0.0 { 0.5 / opacity } else { f32::INFINITY }),
            false => (opacity < 0.5).then_some(f32::INFINITY),
        };
        self.materials.push(material);
        self.placements.push(placement);
    }

    /// Index of the texture of `key`; `None`, with a warning, if none of its files can be read.
    fn add_texture(&mut self, path: &Path, key: TextureKey, resources: &Resources) -> Option<u32> {
        if let Some((_, known)) = self.known.iter().find(|(k, _)| *k == key) {
            return Some(*known);
        }
        let color = key.color.as_ref().and_then(|map| self.decode(path, map, resources));
        let mask = match (&key.color, &key.mask) {
            (Some(color_map), Some(mask)) if color_map.name == mask.name => color.clone(),
            (_, Some(mask)) => self.decode(path, mask, resources),
            (_, None) => None,
        };
        let is_one_file = key.color.as_ref().map(|m| &m.name) == key.mask.as_ref().map(|m| &m.name);
        let matte = key.mask.as_ref().is_some_and(|m| m.matte);
        if let (None, Some(color), Some(map)) = (&mask, &color, &key.color)
            && color.texels.iter().any(|texel| texel[3] < 128)
        {
            self.warnings.push(format!(
                "texture {} has transparent texels, but no map_d says that they are holes; they are opaque",
                map.name
            ));
        }
        let mask = mask.map(|mask| alpha_of(&mask, is_one_file || matte));
        let image = join(color, mask)?;
        let clamp = key.color.as_ref().or(key.mask.as_ref()).is_some_and(|map| map.clamp);
        let wrap = if clamp { Wrap::Clamp } else { Wrap::Repeat };
        let texture = Texture::new(image.width, image.height, image.texels, true)?;
        self.textures.push(texture.with_wrap([wrap; 2]));
        let index = self.textures.len() as u32 - 1;
        self.known.push((key, index));
        Some(index)
    }

    fn decode(&mut self, path: &Path, map: &Map, resources: &Resources) -> Option<DecodedImage> {
        let name = &map.name;
        let read = match find_file(path, name) {
            Some(file) => read_image(&file, name, resources),
            None => Ok(Err("there is no such file".to_owned())),
        };
        let why = match read {
            Ok(Ok(image)) => return Some(image),
            Ok(Err(why)) => why,
            Err(error) => self.fail_of_memory(error)?.to_string(),
        };
        self.warnings.push(format!("texture {name} is ignored: {why}"));
        None
    }
}

/// Reads and decodes an image. The inner error says what is wrong with it.
fn read_image(
    file: &Path,
    name: &str,
    resources: &Resources,
) -> Result<Result<DecodedImage, String>, SceneError> {
    let bytes = resources.read_referred(file)?;
    let size = match TextureSize::of(name, &bytes) {
        Ok(size) => size,
        Err(why) => return Ok(Err(why)),
    };
    resources.take(file, size.held_bytes())?;
    resources.check(file, size.decoding_bytes())?;
    Ok(decode_image(name, &bytes))
}

fn read_line(
    drafts: &mut Vec<Draft>,
    ignored: &mut BTreeMap<String, u64>,
    keyword: &str,
    rest: &str,
) -> Result<(), String> {
    if keyword == "newmtl" {
        let material = Material { name: rest.to_owned(), ..Material::default() };
        drafts.push(Draft { material, ..Draft::default() });
        return Ok(());
    }
    let Some(draft) = drafts.last_mut() else { return Ok(()) };
    let material = &mut draft.material;
    match keyword {
        "kd" => {
            let color = read_color(rest)?;
            if color.iter().any(|c| *c > 1.0) {
                let text = "has a Kd above 1, which is read as 1; shares of light go from 0 to 1";
                draft.notes.push(text.into());
            }
            material.base_color = color.map(|c| c.min(1.0));
            draft.has_kd = true;
        }
        "ke" => {
            material.emission = read_color(rest)?;
            draft.has_ke = true;
        }
        "pm" => {
            [material.metallic] = read_floats(rest, [f32::NAN])?.map(|v: f32| v.clamp(0.0, 1.0))
        }
        "pr" => {
            [material.roughness] = read_floats(rest, [f32::NAN])?.map(|v: f32| v.clamp(0.0, 1.0));
        }
        "d" => {
            let [value] = read_floats(rest.trim_start_matches("-halo"), [f32::NAN])?;
            draft.d = Some(value);
        }
        "tr" => {
            let [value] = read_floats(rest, [f32::NAN])?;
            draft.tr = Some(value);
        }
        "map_kd" => draft.color = Some(read_map(keyword, rest, &mut draft.notes)?),
        "map_d" | "map_opacity" => draft.mask = Some(read_map(keyword, rest, &mut draft.notes)?),
        "map_ke" | "map_emissive" => draft.glow = Some(read_map(keyword, rest, &mut draft.notes)?),
        "tf" if read_color(rest).is_ok_and(|c| c == [1.0; 3]) => {}
        "map_ka" => draft.has_ambient_map = true,
        "pc" | "ps" | "aniso"
            if read_floats(rest, [f32::NAN]).is_ok_and(|[v]: [f32; 1]| v == 0.0) => {}
        _ if SILENT_KEYWORDS.contains(&keyword) => {}
        _ if ignored.len() < KEYWORDS_MAX || ignored.contains_key(keyword) => {
            *ignored.entry(keyword.chars().take(40).collect()).or_default() += 1;
        }
        _ => {}
    }
    Ok(())
}

/// Options and file name of a map. Of the options, `-clamp`, `-imfchan`, `-s` and `-o` are honored; turbulence and those that color the
/// texture are not, which goes to `notes`.
fn read_map(keyword: &str, text: &str, notes: &mut Vec<String>) -> Result<Map, String> {
    let mut map =
        Map { name: String::new(), clamp: false, matte: false, placement: Placement::default() };
    let mut rest = text;
    let mut changed = Vec::new();
    while rest.starts_with('-') {
        let (option, mut tail) = split_word(rest);
        let (least, most) = match option {
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-imfchan" | "-texres" | "-bm"
            | "-boost" | "-type" => (1, 1),
            "-mm" => (2, 2),
            "-o" | "-s" | "-t" => (1, 3),
            _ => break,
        };
        let mut values = Vec::new();
        while values.len() < most {
            let (value, after) = split_word(tail);
            if after.is_empty() || values.len() >= least && value.parse::<f32>().is_err() {
                break;
            }
            values.push(value);
            tail = after;
        }
        rest = tail;
        match (option, values.as_slice()) {
            ("-clamp", ["on"]) => map.clamp = true,
            ("-imfchan", [channel]) => map.matte = *channel == "m",
            ("-s", values) => map.placement.scale = read_placement(values, 1.0)?,
            ("-o", values) => map.placement.offset = read_placement(values, 0.0)?,
            ("-t", values) if values.iter().any(|v| v.parse() != Ok(0.0f32)) => {
                changed.push(option);
            }
            ("-mm", values) if values.iter().map(|v| v.parse()).ne([Ok(0.0f32), Ok(1.0)]) => {
                changed.push(option);
            }
            _ => {}
        }
    }
    map.name = rest.trim().trim_matches('"').to_owned();
    if map.name.is_empty() {
        return Err(format!("{keyword} names no file"));
    }
    if !changed.is_empty() {
        let options = changed.join(", ");
        notes.push(format!(
            "has {keyword} with {options}, which is not read; the texture is used as it is"
        ));
    }
    Ok(map)
}

/// The first two values of `-s` or `-o`.
fn read_placement(values: &[&str], default: f32) -> Result<[f32; 2], String> {
    let mut placement = [default; 2];
    for (place, text) in placement.iter_mut().zip(values) {
        let value = parse_number(text).map(|value| value as f32).filter(|value| value.is_finite());
        *place = value.ok_or_else(|| format!("`{text}` is no place of a texture"))?;
    }
    Ok(placement)
}

/// The first word and what follows it.
fn split_word(text: &str) -> (&str, &str) {
    let text = text.trim_start();
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// What a mask lets be seen, as the alpha of a white image: its own alpha where that is meant or where nothing else differs, else
/// its brightness.
fn alpha_of(mask: &DecodedImage, own_alpha: bool) -> DecodedImage {
    let has_alpha = mask.texels.iter().any(|texel| texel[3] < 255);
    let first = mask.texels[0];
    let is_plain = mask.texels.iter().all(|texel| texel[..3] == first[..3]);
    let alpha = |&[r, g, b, a]: &[u8; 4]| {
        let brightness = (u16::from(r) + u16::from(g) + u16::from(b)) / 3;
        let value = if has_alpha && (own_alpha || is_plain) { a } else { brightness as u8 };
        [255, 255, 255, value]
    };
    DecodedImage { texels: mask.texels.iter().map(alpha).collect(), ..*mask }
}

/// Color with a mask's alpha, in the larger size of both on each axis; opaque without a mask, white without color.
fn join(color: Option<DecodedImage>, mask: Option<DecodedImage>) -> Option<DecodedImage> {
    let (mut color, mask) = match (color, mask) {
        (Some(color), Some(mask)) => (color, mask),
        (None, mask) => return mask,
        (Some(mut color), None) => {
            color.texels.iter_mut().for_each(|texel| texel[3] = 255);
            return Some(color);
        }
    };
    let (width, height) = (color.width.max(mask.width), color.height.max(mask.height));
    let texel_count = |width: u32, height: u32| u64::from(width) * u64::from(height);
    let larger = texel_count(color.width, color.height).max(texel_count(mask.width, mask.height));
    // A tall and a wide image would make one of any size: that of the color must do.
    let fits = texel_count(width, height) <= 4 * larger;
    let (width, height) = if fits { (width, height) } else { (color.width, color.height) };
    let nearest = |image: &DecodedImage, x: u32, y: u32| {
        let at = |k: u32, size: u32, own: u32| {
            (u64::from(k) * u64::from(own) / u64::from(size)) as usize
        };
        let (x, y) = (at(x, width, image.width), at(y, height, image.height));
        image.texels[y * image.width as usize + x]
    };
    let places = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    if (color.width, color.height) != (width, height) {
        let texels = places().map(|(x, y)| nearest(&color, x, y)).collect();
        color = DecodedImage { width, height, texels };
    }
    for (texel, (x, y)) in color.texels.iter_mut().zip(places()) {
        texel[3] = nearest(&mask, x, y)[3];
    }
    Some(color)
}

/// Three numbers, or one for gray; none below 0.
fn read_color(text: &str) -> Result<[f32; 3], String> {
    let words = text.split_ascii_whitespace().take_while(|word| !word.starts_with('#'));
    if words.count() == 1 {
        let [gray] = read_floats(text, [f32::NAN])?;
        return Ok([gray.max(0.0); 3]);
    }
    Ok(read_floats(text, [f32::NAN; 3])?.map(|c: f32| c.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The page of formats and this reader tell the same.
    #[test]
    fn keywords_are_documented() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/formats.md");
        let page = std::fs::read_to_string(page).unwrap();
        let row = page.lines().find(|line| line.contains("`disp`")).unwrap();
        let named: Vec<String> =
            row.split('`').skip(1).step_by(2).map(str::to_ascii_lowercase).collect();
        assert_eq!(named.len(), 12);
        for keyword in named {
            assert!(effect_of(&keyword).is_some(), "{keyword}");
        }
        for keyword in ["Kd", "map_Kd", "Ke", "map_Ke", "d", "Tr", "map_d", "Pm", "Pr"] {
            assert!(page.contains(&format!("`{keyword}`")), "{keyword}");
        }
        assert!(page.contains("png, jpeg, webp, bmp, tga"));
    }
}
