//! MTL material libraries.

use super::{read_floats, read_lines};
use crate::decode_texture::{TextureSize, decode_texture};
use crate::resources::Resources;
use crate::{Material, SceneError, Texture};
use pbgi_file::Excess;
use std::collections::HashSet;
use std::path::Path;

/// Bytes that a line of a library may come to hold: a material, or a warning.
const LINE_BYTES: usize = size_of::<Material>() + 64;

/// Materials read so far. Nothing in a library is an error: the shape matters more than its color,
/// so what cannot be read is a warning.
#[derive(Default)]
pub(super) struct Library {
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub warnings: Vec<String>,
    /// Why the scene cannot be read: what memory there is must not decide what is ignored.
    pub failed: Option<SceneError>,
    /// Names of the libraries.
    names: HashSet<String>,
    /// File names of the textures.
    texture_names: Vec<String>,
}

impl Library {
    /// Adds the library `name` that the OBJ file at `obj` refers to.
    ///
    /// `Kd` and `map_Kd` give the base color, `Ke` the emitted radiance; `d` below 0.5 (or `Tr` above)
    /// makes the surface a hole. `Ka` is the reflection of an ambient light, no emission. A color given
    /// for a textured material multiplies the texture.
    pub fn read(&mut self, obj: &Path, name: &str, resources: &Resources) {
        let path = obj.parent().unwrap_or(Path::new("")).join(name);
        // Some programs name it before every object.
        if !self.names.insert(name.to_owned()) {
            return;
        }
        resources.add_file(&path);
        let read = read_lines(&path, |number, keyword, rest| {
            resources.take(&path, (LINE_BYTES + rest.len()) as u64)?;
            if let Err(message) = self.read_line(&path, keyword, rest, resources) {
                self.warnings.push(format!("{name}, line {number}: {message}"));
            }
            Ok(())
        });
        if let Err(error) = read {
            let error = match self.fail_of_memory(error) {
                Some(error) => error,
                None => return,
            };
            self.warnings.push(format!("material library {name} is left out: {error}"));
        }
    }

    /// Gives an error back, unless it is a lack of memory, which fails the scene.
    fn fail_of_memory(&mut self, error: SceneError) -> Option<SceneError> {
        match &error {
            SceneError::Io { source, .. } if Excess::of(source).is_some() => {
                self.failed = Some(error);
                None
            }
            _ => Some(error),
        }
    }

    fn read_line(
        &mut self,
        path: &Path,
        keyword: &str,
        rest: &str,
        resources: &Resources,
    ) -> Result<(), String> {
        if keyword == "newmtl" {
            let name = rest.to_owned();
            self.materials.push(Material { name, ..Material::default() });
            return Ok(());
        }
        let Some(material) = self.materials.last_mut() else { return Ok(()) };
        match keyword {
            "Kd" => material.base_color = read_color(rest)?.map(|c| c.min(1.0)),
            "Ke" => material.emission = read_color(rest)?,
            "d" | "Tr" => {
                let [value] = read_floats(rest.trim_start_matches("-halo"), [f32::NAN])?;
                let opacity = if keyword == "d" { value } else { 1.0 - value };
                material.alpha_cutoff = (opacity < 0.5).then_some(f32::INFINITY);
                if opacity < 1.0 {
                    let effect = if opacity < 0.5 { "a hole" } else { "opaque" };
                    return Err(format!("{keyword} {value} is read as {effect}"));
                }
            }
            "map_Kd" => {
                let index = self.add_texture(path, rest, resources)?;
                if let Some(material) = self.materials.last_mut() {
                    material.base_color_texture = Some(index);
                }
            }
            "map_d" | "map_Ke" => return Err(format!("{keyword} is ignored")),
            _ => {}
        }
        Ok(())
    }

    /// Index of the texture in the file named last in `rest`.
    fn add_texture(
        &mut self,
        path: &Path,
        rest: &str,
        resources: &Resources,
    ) -> Result<u32, String> {
        // Names may hold spaces; options before them begin with a minus.
        let name = if rest.starts_with('-') {
            rest.split_ascii_whitespace().next_back().unwrap_or(rest)
        } else {
            rest
        };
        // Paths are often written with backslashes.
        let name = name.replace('\\', "/");
        if let Some(known) = self.texture_names.iter().position(|n| *n == name) {
            return Ok(known as u32);
        }
        let file = path.parent().unwrap_or(Path::new("")).join(&name);
        let texture = resources
            .read_referred(&file)
            .and_then(|bytes| {
                let size = TextureSize::of(&file, "texture", &bytes)?;
                resources.take(&file, size.held_bytes())?;
                resources.check(&file, size.decoding_bytes())?;
                decode_texture(&file, "texture", &bytes, false, true)
            })
            .map_err(|e: SceneError| match self.fail_of_memory(e) {
                Some(e) => format!("texture {name} is ignored: {e}"),
                None => "it takes too much memory".to_owned(),
            })?;
        self.texture_names.push(name);
        self.textures.push(texture);
        Ok(self.textures.len() as u32 - 1)
    }
}

/// Three numbers, or one for gray; none below 0.
fn read_color(text: &str) -> Result<[f32; 3], String> {
    if text.split_ascii_whitespace().count() == 1 {
        let [gray] = read_floats(text, [f32::NAN])?;
        return Ok([gray.max(0.0); 3]);
    }
    Ok(read_floats(text, [f32::NAN; 3])?.map(|c| c.max(0.0)))
}
