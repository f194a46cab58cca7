//! Materials and their textures.

use super::accessor::Accessors;
use super::container::{Buffer, resolve_uri};
use crate::decode_texture::{TextureSize, decode_texture};
use crate::resources::Resources;
use crate::{Material, SceneError, Texture};
use gltf::json::Root;
use gltf::material::AlphaMode;
use pbgi_math::Vec2;
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

/// Reads all materials, and last, under the index after theirs, one for primitives without any.
pub(super) fn read_materials(
    path: &Path,
    document: &gltf::Document,
    accessors: Accessors,
    resources: &Resources,
) -> Result<Materials, SceneError> {
    let mut keys = Keys { firsts: first_of_equals(accessors.root), keys: Vec::new() };
    let mut result =
        Materials { materials: vec![], textures: vec![], uv_sources: vec![], warnings: vec![] };
    for material in document.materials() {
        let (material, uv_source) = read_material(&material, &mut keys, &mut result.warnings);
        result.materials.push(material);
        result.uv_sources.push(uv_source);
    }
    result.textures = decode_images(path, accessors, &keys.keys, resources)?;
    let metal_maps =
        document.materials().map(|m| metallic_roughness_key(&m, &keys.firsts)).collect::<Vec<_>>();
    let mut known = HashMap::new();
    for (material, key) in result.materials.iter_mut().zip(metal_maps) {
        if let Some(key) = key {
            let means = match known.get(&key.image) {
                Some(means) => *means,
                None => {
                    let image = Image::find(path, accessors, key, resources)?;
                    // It is held for its mean only.
                    resources.check(path, image.size.decoding_bytes() + image.size.held_bytes())?;
                    let means = metallic_roughness_means(&image.decode(path)?);
                    known.insert(key.image, means);
                    means
                }
            };
            apply_metallic_roughness(means, material);
            let text = "has a metallic-roughness texture; its mean is used";
            result.warnings.push(format!("material {} {text}", material.name));
        }
        drop_needless_cutoff(material, &result.textures);
    }
    result.materials.push(Material { name: "default".into(), ..Material::default() });
    result.uv_sources.push(None);
    Ok(result)
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
        let image = keys.firsts[info.texture().source().index()];
        let key = TextureKey { image, keeps_alpha, srgb: true };
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
    let image = firsts[info.texture().source().index()];
    Some(TextureKey { image, keeps_alpha: false, srgb: false })
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
fn drop_needless_cutoff(material: &mut Material, textures: &[Texture]) {
    let texture = material.base_color_texture.and_then(|t| textures.get(t as usize));
    let alpha_min = texture.map_or(1.0, Texture::alpha_min);
    if material.alpha_cutoff.is_some_and(|cutoff| cutoff <= alpha_min) {
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
fn first_of_equals(root: &Root) -> Vec<usize> {
    let mut firsts = HashMap::new();
    let source =
        |image: &gltf::json::Image| (image.buffer_view.map(|view| view.value()), image.uri.clone());
    let images = root.images.iter().enumerate();
    images.map(|(index, image)| *firsts.entry(source(image)).or_insert(index)).collect()
}

/// An image whose header is read.
struct Image<'a> {
    key: TextureKey,
    bytes: Buffer<'a>,
    size: TextureSize,
}

impl<'a> Image<'a> {
    fn find(
        path: &Path,
        accessors: Accessors<'a>,
        key: TextureKey,
        resources: &Resources,
    ) -> Result<Self, SceneError> {
        let place = format!("image {}", key.image);
        let malformed =
            |message: String| SceneError::malformed(path, format!("{place}: {message}"));
        let image = accessors.root.images.get(key.image);
        let image = image.ok_or_else(|| malformed("there is no such image".into()))?;
        let bytes = match (&image.buffer_view, &image.uri) {
            (Some(view), _) => Buffer::Chunk(accessors.view(view.value()).map_err(malformed)?),
            (None, Some(uri)) => Buffer::Read(resolve_uri(path, &place, uri, resources)?),
            (None, None) => return Err(malformed("has neither a buffer view nor a uri".into())),
        };
        let size = TextureSize::of(path, &place, &bytes)?;
        Ok(Self { key, bytes, size })
    }

    fn decode(&self, path: &Path) -> Result<Texture, SceneError> {
        let place = format!("image {}", self.key.image);
        decode_texture(path, &place, &self.bytes, self.key.keeps_alpha, self.key.srgb)
    }
}

/// Decodes the images, at once as far as memory allows. All their sizes are known, and counted, before the first is decoded.
fn decode_images(
    path: &Path,
    accessors: Accessors,
    keys: &[TextureKey],
    resources: &Resources,
) -> Result<Vec<Texture>, SceneError> {
    let images: Vec<Image> = keys
        .iter()
        .map(|key| Image::find(path, accessors, *key, resources))
        .collect::<Result<_, _>>()?;
    resources.take(path, images.iter().map(|image| image.size.held_bytes()).sum())?;
    let largest = images.iter().map(|image| image.size.decoding_bytes()).max().unwrap_or(0);
    resources.check(path, largest)?;
    let at_once = largest.saturating_mul(rayon::current_num_threads() as u64);
    match resources.check(path, at_once) {
        Ok(()) => images.par_iter().map(|image| image.decode(path)).collect(),
        Err(_) => images.iter().map(|image| image.decode(path)).collect(),
    }
}
