//! Materials and their textures.

use super::accessor::Accessors;
use super::container::{Buffer, data_of, resolve_uri};
use super::prepare::Extras;
use crate::SceneError;
use crate::decode_texture::{DecodedImage, TextureSize, decode_image};
use crate::resources::{Resources, is_lack_of_memory};
use gltf::json::Root;
use gltf::material::AlphaMode;
use gltf::texture::WrappingMode;
use pbgi_math::Vec2;
use pbgi_scene::{Material, Scene, Texture, Wrap};
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::Path;

/// Which texture coordinates the textures of a material use, and how they are transformed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvSource {
    pub set: u32,
    offset: [f32; 2],
    rotation: f32,
    scale: [f32; 2],
}

/// The materials of a document.
pub(super) struct Materials {
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    /// Index of the gray one for primitives without any.
    default: usize,
    /// One per material; `None` without textures.
    pub uv_sources: Vec<Option<UvSource>>,
    pub warnings: Vec<String>,
}

/// An image as a texture: alpha is dropped where no material that uses it has holes.
#[derive(Clone, Copy, PartialEq)]
struct TextureKey {
    image: usize,
    keeps_alpha: bool,
    srgb: bool,
    wrap: [Wrap; 2],
}

impl TextureKey {
    fn new(info: &gltf::texture::Info, firsts: &[usize], keeps_alpha: bool, srgb: bool) -> Self {
        let image = firsts[info.texture().source().index()];
        let sampler = info.texture().sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            WrappingMode::Repeat => Wrap::Repeat,
            WrappingMode::ClampToEdge => Wrap::Clamp,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
        });
        Self { image, keeps_alpha, srgb, wrap }
    }
}

impl UvSource {
    fn new(info: &gltf::texture::Info) -> Self {
        let identity =
            Self { set: info.tex_coord(), offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] };
        info.texture_transform().map_or(identity, |t| Self {
            set: t.tex_coord().unwrap_or(identity.set),
            offset: t.offset(),
            rotation: t.rotation(),
            scale: t.scale(),
        })
    }

    /// Coordinates in the texture, by the formula of `KHR_texture_transform`.
    pub fn transform(&self, uv: [f32; 2]) -> Vec2 {
        let (sin, cos) = self.rotation.sin_cos();
        let [u, v] = [uv[0] * self.scale[0], uv[1] * self.scale[1]];
        Vec2::new(cos * u + sin * v, cos * v - sin * u) + Vec2::from_array(self.offset)
    }
}

/// Reads all materials. Textures that cannot be read are left out with a warning: the shape matters more than its color.
pub(super) fn read_materials(
    path: &Path,
    document: &gltf::Document,
    accessors: Accessors,
    extras: &Extras,
    resources: &Resources,
) -> Result<Materials, SceneError> {
    let mut keys = Keys { firsts: first_of_equals(accessors.root, extras), keys: Vec::new() };
    let mut result = Materials {
        materials: vec![],
        textures: vec![],
        default: document.materials().len(),
        uv_sources: vec![],
        warnings: vec![],
    };
    for material in document.materials() {
        let (mut material, uv_source) = read_material(&material, &mut keys, &mut result.warnings);
        let number = result.materials.len();
        if let Some(&factor) = extras.transmissions.get(&number) {
            result.warnings.push(let_through(&mut material, factor));
        }
        result.materials.push(material);
        result.uv_sources.push(uv_source);
    }
    let source = Source { path, accessors, extras, resources };
    let textures = source.decode_all(&keys.keys)?;
    // Where each went.
    let mut places = Vec::new();
    for texture in textures {
        let texture = texture.transpose();
        let texture = texture.unwrap_or_else(|e| {
            if !result.warnings.contains(&e) {
                result.warnings.push(e);
            }
            None
        });
        places.push(texture.map(|texture| {
            result.textures.push(texture);
            result.textures.len() as u32 - 1
        }));
    }
    let bumpy = document.materials().filter(|m| m.normal_texture().is_some()).count();
    if bumpy > 0 {
        let text = "materials have normal maps, which are not read; surfaces have the normals of their vertices";
        result.warnings.push(format!("{bumpy} {text}"));
    }
    let place = |key: Option<u32>| key.and_then(|key| places[key as usize]);
    let metal_maps =
        document.materials().map(|m| metallic_roughness_key(&m, &keys.firsts)).collect::<Vec<_>>();
    let mut known = HashMap::new();
    for (material, key) in result.materials.iter_mut().zip(metal_maps) {
        material.base_color_texture = place(material.base_color_texture);
        let glow = place(material.emission_texture);
        if material.emission_texture.is_some() && glow.is_none() {
            material.emission = [0.0; 3];
        }
        material.emission_texture = glow;
        let Some(key) = key else { continue };
        let name = &material.name;
        let means = match known.get(&key.image) {
            Some(means) => means,
            None => {
                let means = source.find_means(key)?;
                known.entry(key.image).or_insert(means)
            }
        };
        result.warnings.push(match means {
            Some(Ok(means)) => {
                let text = "has a metallic-roughness texture; its mean is used";
                let text = format!("material {name} {text}");
                apply_metallic_roughness(*means, material);
                text
            }
            found => {
                let why = found.as_ref().and_then(|e| e.as_ref().err()).map_or("", String::as_str);
                let text =
                    "has a metallic-roughness texture that is not read; it is taken for no metal";
                let text = format!("material {name} {text}. {why}");
                material.metallic = 0.0;
                text
            }
        });
    }
    Ok(result)
}

/// What light passes through is left out, as what blends below one half is.
fn let_through(material: &mut Material, factor: f32) -> String {
    let name = &material.name;
    if factor > 0.5 {
        let text =
            format!("material {name} lets light through (transmission {factor}); it is left out");
        material.alpha_cutoff = Some(f32::INFINITY);
        return text;
    }
    format!(
        "material {name} lets some light through (transmission {factor}, or by a texture); it blocks all of it here"
    )
}

impl Materials {
    /// Index of the material of primitives without any: gray, or where vertices have colors, of those.
    pub fn default_index(&self, is_colored: bool) -> usize {
        self.default + usize::from(is_colored)
    }

    /// Puts materials and textures into the scene whose meshes use them; those for primitives without any only where there are such.
    pub fn finish(mut self, scene: &mut Scene) {
        for (number, material) in self.materials.iter_mut().enumerate() {
            let meshes = scene.meshes.iter().filter(|mesh| mesh.material as usize == number);
            let alphas = meshes.flat_map(|mesh| &mesh.alphas).copied();
            drop_needless_cutoff(material, &self.textures, alphas.reduce(f32::min).unwrap_or(1.0));
        }
        for base_color in [Material::default().base_color, [1.0; 3]] {
            let next =
                scene.meshes.iter().any(|mesh| mesh.material as usize == self.materials.len());
            let colored = self.default + 1;
            if next {
                self.materials.push(Material {
                    name: "default".into(),
                    base_color,
                    ..Material::default()
                });
            } else if base_color != [1.0; 3] {
                // Those of the colored one move up.
                let moved = scene.meshes.iter_mut().filter(|m| m.material as usize == colored);
                moved.for_each(|mesh| mesh.material = self.default as u32);
            }
        }
        (scene.materials, scene.textures) = (self.materials, self.textures);
    }
}

fn read_material(
    material: &gltf::Material,
    keys: &mut Keys,
    warnings: &mut Vec<String>,
) -> (Material, Option<UvSource>) {
    let number = material.index().unwrap_or_default();
    let name = material.name().map_or_else(|| format!("material {number}"), str::to_owned);
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, alpha] = pbr.base_color_factor();
    let cutoff = match material.alpha_mode() {
        AlphaMode::Opaque => None,
        AlphaMode::Mask => Some(material.alpha_cutoff().unwrap_or(0.5)),
        AlphaMode::Blend => {
            warnings.push(format!("material {name} blends; it is cut out at alpha 0.5 instead"));
            Some(0.5)
        }
    };
    // The factor belongs to the alpha; our cutoff is compared with that of the texture alone.
    let alpha_cutoff = cutoff.map(|c| if alpha > 0.0 { c / alpha } else { f32::INFINITY });
    let mut add_texture = |info: &gltf::texture::Info, keeps_alpha| {
        let key = TextureKey::new(info, &keys.firsts, keeps_alpha, true);
        let place = keys.keys.iter().position(|k| *k == key);
        place.unwrap_or_else(|| {
            keys.keys.push(key);
            keys.keys.len() - 1
        }) as u32
    };
    let (base, glow) = (pbr.base_color_texture(), material.emissive_texture());
    let strength = material.emissive_strength().unwrap_or(1.0);
    let read = Material {
        base_color: [r, g, b],
        base_color_texture: base.as_ref().map(|info| add_texture(info, alpha_cutoff.is_some())),
        emission: material.emissive_factor().map(|e| e * strength),
        emission_texture: glow.as_ref().map(|info| add_texture(info, false)),
        metallic: pbr.metallic_factor(),
        roughness: pbr.roughness_factor(),
        specular: read_specular(material),
        alpha_cutoff,
        double_sided: material.double_sided(),
        name,
        ..Material::default()
    };
    let sources = [base.map(|info| UvSource::new(&info)), glow.map(|info| UvSource::new(&info))];
    if let [Some(first), Some(second)] = sources
        && first != second
    {
        let text = "places its emission texture unlike its base color; the latter's place is used";
        warnings.push(format!("material {} {text}", read.name));
    }
    (read, sources[0].or(sources[1]))
}

/// Reflectance at normal incidence, by index of refraction (1.5 without one) and factor, over the 0.08 of the strongest gloss.
fn read_specular(material: &gltf::Material) -> f32 {
    let ior = material.ior().unwrap_or(1.5);
    let factor = material.specular().map_or(1.0, |s| s.specular_factor());
    let reflectance = ((ior - 1.0) / (ior + 1.0)).powi(2) * factor;
    if reflectance.is_finite() { (reflectance / 0.08).clamp(0.0, 1.0) } else { 0.5 }
}

fn metallic_roughness_key(material: &gltf::Material, firsts: &[usize]) -> Option<TextureKey> {
    let info = material.pbr_metallic_roughness().metallic_roughness_texture()?;
    Some(TextureKey::new(&info, firsts, false, false))
}

/// Means of roughness, in green, and metalness, in blue.
fn metallic_roughness_means(texture: &Texture) -> [f32; 2] {
    let [_, roughness, metallic, _] = texture.sample_level(Vec2::splat(0.5), f32::INFINITY);
    [roughness, metallic]
}

/// Multiplies the factors by the texture's means.
fn apply_metallic_roughness([roughness, metallic]: [f32; 2], material: &mut Material) {
    material.roughness *= roughness;
    material.metallic *= metallic;
}

/// A surface without a single hole is cheaper as an opaque one.
fn drop_needless_cutoff(material: &mut Material, textures: &[Texture], vertex_min: f32) {
    let texture = material.base_color_texture.and_then(|t| textures.get(t as usize));
    let alpha_min = texture.map_or(1.0, Texture::alpha_min);
    if material.alpha_cutoff.is_some_and(|cutoff| cutoff <= alpha_min * vertex_min) {
        material.alpha_cutoff = None;
    }
}

/// The textures asked for so far.
struct Keys {
    /// Of each image the first with the same content.
    firsts: Vec<usize>,
    keys: Vec<TextureKey>,
}

/// Of each image the first that names the same file, or the same part of a buffer: it is decoded once.
fn first_of_equals(root: &Root, extras: &Extras) -> Vec<usize> {
    let mut firsts = HashMap::new();
    let source =
        |image: &gltf::json::Image| (image.buffer_view.map(|view| view.value()), image.uri.clone());
    let first = |(index, image)| match index < extras.image_count {
        true => *firsts.entry(source(image)).or_insert(index),
        false => index,
    };
    root.images.iter().enumerate().map(first).collect()
}

/// An image whose header is read.
struct Image<'a> {
    key: TextureKey,
    /// Empty where the bytes alone tell its kind.
    name: &'a str,
    bytes: Buffer<'a>,
    size: TextureSize,
}

impl Image<'_> {
    fn decode(&self) -> Result<Texture, String> {
        let DecodedImage { width, height, mut texels } = decode_image(self.name, &self.bytes)?;
        if !self.key.keeps_alpha {
            texels.iter_mut().for_each(|texel| texel[3] = 255);
        }
        let texture =
            Texture::new(width, height, texels, self.key.srgb).ok_or("it has no pixels")?;
        Ok(texture.with_wrap(self.key.wrap))
    }
}

/// What may be missing. `None` where a warning tells of its image already; the error is one.
type Found<T> = Option<Result<T, String>>;

/// Where images come from.
#[derive(Clone, Copy)]
struct Source<'a> {
    path: &'a Path,
    accessors: Accessors<'a>,
    extras: &'a Extras,
    resources: &'a Resources<'a>,
}

fn left_out(key: TextureKey, why: &str) -> String {
    format!("image {} is left out: {why}", key.image)
}

impl<'a> Source<'a> {
    /// Finds an image and reads its header; lack of memory alone fails the scene.
    fn find(&self, key: TextureKey) -> Result<Found<Image<'a>>, SceneError> {
        if key.image >= self.extras.image_count {
            return Ok(None);
        }
        match self.open(key) {
            Err(error) if is_lack_of_memory(&error) => Err(error),
            Err(error) => Ok(Some(Err(left_out(key, &error.to_string())))),
            Ok(opened) => {
                let image = opened.and_then(|(name, bytes)| {
                    let size = TextureSize::of(name, &bytes)?;
                    Ok(Image { key, name, bytes, size })
                });
                Ok(Some(image.map_err(|why| left_out(key, &why))))
            }
        }
    }

    /// Name and bytes of an image.
    fn open(&self, key: TextureKey) -> Result<Result<(&'a str, Buffer<'a>), String>, SceneError> {
        let Some(image) = self.accessors.root.images.get(key.image) else {
            return Ok(Err("there is no such image".into()));
        };
        Ok(match (&image.buffer_view, &image.uri) {
            (Some(view), _) => {
                self.accessors.view(view.value()).map(|bytes| ("", Buffer::Chunk(bytes)))
            }
            (None, Some(uri)) => {
                let place = format!("image {}", key.image);
                let bytes = resolve_uri(self.path, &place, uri, self.resources)?;
                let name = if data_of(uri).is_some() { "" } else { uri.as_str() };
                Ok((name, Buffer::Read(bytes)))
            }
            (None, None) => Err("it has neither a buffer view nor a uri".into()),
        })
    }

    /// Decodes images, at once as far as memory allows. All their sizes are known, and counted, before the first is decoded.
    fn decode_all(&self, keys: &[TextureKey]) -> Result<Vec<Found<Texture>>, SceneError> {
        let images: Vec<Found<Image>> =
            keys.iter().map(|key| self.find(*key)).collect::<Result<_, _>>()?;
        let sizes = || images.iter().flatten().flatten().map(|image| image.size);
        let (path, resources) = (self.path, self.resources);
        let held = sizes().map(TextureSize::held_bytes).fold(0, u64::saturating_add);
        resources.take(path, held)?;
        let largest = sizes().map(TextureSize::decoding_bytes).max().unwrap_or(0);
        resources.check(path, largest)?;
        let decode = |found: Found<Image>| {
            let decode = |image: Image| image.decode().map_err(|why| left_out(image.key, &why));
            found.map(|image| image.and_then(decode))
        };
        let at_once = largest.saturating_mul(rayon::current_num_threads() as u64);
        Ok(match resources.check(path, at_once) {
            Ok(()) => images.into_par_iter().map(decode).collect(),
            Err(_) => images.into_iter().map(decode).collect(),
        })
    }

    /// Decodes an image for its means only.
    fn find_means(&self, key: TextureKey) -> Result<Found<[f32; 2]>, SceneError> {
        let image = match self.find(key)? {
            Some(Ok(image)) => image,
            Some(Err(why)) => return Ok(Some(Err(why))),
            None => return Ok(None),
        };
        let needed = image.size.decoding_bytes().saturating_add(image.size.held_bytes());
        self.resources.check(self.path, needed)?;
        let means = image.decode().map(|texture| metallic_roughness_means(&texture));
        Ok(Some(means.map_err(|why| left_out(key, &why))))
    }
}
