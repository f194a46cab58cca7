//! Materials and their textures.

use super::accessor::Accessors;
use super::container::resolve_uri;
use crate::decode_texture::decode_texture;
use crate::{Material, SceneError, Texture};
use gltf::material::AlphaMode;
use pbgi_math::Vec2;
use rayon::prelude::*;
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
) -> Result<Materials, SceneError> {
    let mut keys = Vec::new();
    let mut result =
        Materials { materials: vec![], textures: vec![], uv_sources: vec![], warnings: vec![] };
    for material in document.materials() {
        let (material, uv_source) = read_material(&material, &mut keys, &mut result.warnings);
        result.materials.push(material);
        result.uv_sources.push(uv_source);
    }
    let decode = |key: &TextureKey| decode_image(path, accessors, *key);
    let textures: Result<Vec<Texture>, SceneError> = keys.par_iter().map(decode).collect();
    result.textures = textures?;
    let metal_maps = document.materials().map(|m| metallic_roughness_key(&m)).collect::<Vec<_>>();
    for (material, key) in result.materials.iter_mut().zip(metal_maps) {
        if let Some(key) = key {
            apply_metallic_roughness(&decode_image(path, accessors, key)?, material);
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
    keys: &mut Vec<TextureKey>,
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
        let image = info.texture().source().index();
        let key = TextureKey { image, keeps_alpha, srgb: true };
        let place = keys.iter().position(|k| *k == key);
        place.unwrap_or_else(|| {
            keys.push(key);
            keys.len() - 1
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

fn metallic_roughness_key(material: &gltf::Material) -> Option<TextureKey> {
    let info = material.pbr_metallic_roughness().metallic_roughness_texture()?;
    Some(TextureKey { image: info.texture().source().index(), keeps_alpha: false, srgb: false })
}

/// Multiplies the factors by the texture's means: roughness in green, metalness in blue.
fn apply_metallic_roughness(texture: &Texture, material: &mut Material) {
    let [_, roughness, metallic, _] = texture.sample_level(Vec2::splat(0.5), f32::INFINITY);
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

fn decode_image(path: &Path, accessors: Accessors, key: TextureKey) -> Result<Texture, SceneError> {
    let place = format!("image {}", key.image);
    let malformed = |message: String| SceneError::malformed(path, format!("{place}: {message}"));
    let image = accessors.root.images.get(key.image);
    let image = image.ok_or_else(|| malformed("there is no such image".into()))?;
    let owned;
    let bytes = match (&image.buffer_view, &image.uri) {
        (Some(view), _) => accessors.view(view.value()).map_err(malformed)?,
        (None, Some(uri)) => {
            owned = resolve_uri(path, &place, uri)?;
            &owned
        }
        (None, None) => return Err(malformed("has neither a buffer view nor a uri".into())),
    };
    decode_texture(path, &place, bytes, key.keeps_alpha, key.srgb)
}
