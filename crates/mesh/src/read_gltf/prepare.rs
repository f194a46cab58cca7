//! From JSON text to a document: what is not needed is taken out before it can stop the rest, and what extensions say is put
//! where the rest finds it.

use super::accessor::Accessors;
use crate::SceneError;
use gltf::json::{Root, deserialize};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Extensions that are read, and may be required.
const EXTENSIONS_READ: [&str; 10] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Beginnings of names of extensions that neither add nor move triangles: they may be required, and are not read.
const SHAPELESS: [&str; 28] = [
    "ADOBE_materials_",
    "CESIUM_primitive_outline",
    "EXT_instance_features",
    "EXT_lights_",
    "EXT_materials_",
    "EXT_mesh_features",
    "EXT_structural_metadata",
    "EXT_texture_",
    "FB_geometry_metadata",
    "KHR_animation_",
    "KHR_audio",
    "KHR_environment_map",
    "KHR_interactivity",
    "KHR_lights_",
    "KHR_materials_",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_physics_",
    "KHR_techniques_webgl",
    "KHR_texture_",
    "KHR_xmp",
    "MSFT_audio_",
    "MSFT_lod",
    "MSFT_packing_",
    "MSFT_texture_",
    "NV_materials_",
    "VRM",
    "WEB3D_",
];

/// What the JSON says beside the document.
#[derive(Default)]
pub(super) struct Extras {
    /// Instances of nodes: accessors of their attributes.
    pub instances: BTreeMap<usize, InstanceAttributes>,
    /// Nodes that are hidden with all below them.
    pub hidden: BTreeSet<usize>,
    /// Share of light that materials let through.
    pub transmissions: BTreeMap<usize, f32>,
    /// Images from this on stand for those of textures that no reader here finds.
    pub image_count: usize,
}

/// Accessors of what places the instances of a node.
#[derive(Clone, Copy, Default)]
pub(super) struct InstanceAttributes {
    pub translation: Option<usize>,
    pub rotation: Option<usize>,
    pub scale: Option<usize>,
}

impl InstanceAttributes {
    /// Number of instances, by the longest of the accessors.
    pub fn count(&self, accessors: Accessors) -> u64 {
        let used = [self.translation, self.rotation, self.scale].into_iter().flatten();
        let counts = used.filter_map(|i| accessors.root.accessors.get(i)).map(|a| a.count.0);
        counts.max().unwrap_or(0)
    }
}

/// Parses the JSON of a glTF file; refuses versions, and required extensions that change shapes, by name.
pub(super) fn prepare(
    path: &Path,
    json: &[u8],
    warnings: &mut Vec<String>,
) -> Result<(Root, Extras), SceneError> {
    let json = json.strip_prefix("\u{feff}".as_bytes()).unwrap_or(json);
    // What is not UTF-8 can only be in names and remarks.
    let json = &*String::from_utf8_lossy(json);
    let json = json.as_bytes();
    // Chunks are padded, by some writers with zeros.
    let json = json.trim_ascii_end();
    let zeros = json.iter().rev().take_while(|byte| **byte == 0).count();
    let json = &json[..json.len() - zeros];
    let invalid =
        |e: serde_json::Error| SceneError::malformed(path, format!("not valid gltf json: {e}"));
    let mut value: Value = deserialize::from_slice(json).map_err(invalid)?;
    check_version(path, &value)?;
    check_extensions(path, &value, warnings)?;
    check_compression(path, &value)?;
    if let Some(root) = value.as_object_mut() {
        root.remove("extensionsRequired");
    }
    let mut extras = Extras::default();
    drop_animations(&mut value, warnings);
    // `nodes` of a scene is optional.
    for scene in items(&mut value, "scenes") {
        scene.entry("nodes").or_insert_with(|| json!([]));
    }
    // Some writers mean none by 0, which is no stride.
    for view in items(&mut value, "bufferViews") {
        if view.get("byteStride").and_then(Value::as_u64) == Some(0) {
            view.remove("byteStride");
        }
    }
    let mut colored_count = 0;
    for (i, node) in items(&mut value, "nodes").enumerate() {
        let colors = "/EXT_mesh_gpu_instancing/attributes/_COLOR_0";
        let is_colored = node.get("extensions").and_then(|e| e.pointer(colors)).is_some();
        colored_count += u32::from(is_colored);
        read_node(i, node, &mut extras);
    }
    if colored_count > 0 {
        let text = "nodes have instances with colors of their own (_COLOR_0), which are not read";
        warnings.push(format!("{colored_count} {text}"));
    }
    for (i, material) in items(&mut value, "materials").enumerate() {
        if let Some(factor) = read_transmission(material) {
            extras.transmissions.insert(i, factor);
        }
        read_specular_glossiness(material);
    }
    find_images(&mut value, &mut extras, warnings);
    // As text once more: what reads text into the model is compiled with the model.
    let json = value.to_string();
    drop(value);
    let root = Root::from_str(&json).map_err(|error| {
        let error = error.to_string();
        let what = error.split_once(" at line ").map_or(&*error, |(what, _)| what);
        SceneError::malformed(path, format!("not valid gltf json: {what}"))
    })?;
    Ok((root, extras))
}

/// The objects of an array of the document.
fn items<'a>(value: &'a mut Value, name: &str) -> impl Iterator<Item = &'a mut Map<String, Value>> {
    let array = value.get_mut(name).and_then(Value::as_array_mut);
    array.into_iter().flatten().filter_map(Value::as_object_mut)
}

fn check_version(path: &Path, value: &Value) -> Result<(), SceneError> {
    let text = |name| value.pointer(name).and_then(Value::as_str);
    let version = text("/asset/minVersion").or(text("/asset/version"));
    let Some(version) = version else {
        let message = "not a gltf file: its json has no asset.version";
        return Err(SceneError::malformed(path, message));
    };
    if version.split('.').next() == Some("2")
        && text("/asset/minVersion").is_none_or(|v| v == "2.0")
    {
        return Ok(());
    }
    let what = format!("glTF version {version}");
    Err(SceneError::unsupported(path, what, "convert it to glTF 2.0"))
}

fn check_extensions(
    path: &Path,
    value: &Value,
    warnings: &mut Vec<String>,
) -> Result<(), SceneError> {
    let names = |list: &str| -> BTreeSet<String> {
        let list = value.get(list).and_then(Value::as_array).into_iter().flatten();
        list.filter_map(Value::as_str).map(str::to_owned).collect()
    };
    let is_shapeless = |name: &str| SHAPELESS.iter().any(|start| name.starts_with(start));
    let required = names("extensionsRequired");
    for name in required.iter().filter(|name| !EXTENSIONS_READ.contains(&name.as_str())) {
        if !is_shapeless(name) {
            let what = format!("the gltf extension {name}");
            return Err(SceneError::unsupported(path, what, extension_cure(name)));
        }
    }
    // Some writers forget to list what they use.
    let mut used = names("extensionsUsed");
    collect_extensions(value, &mut used);
    for name in required.union(&used) {
        if !EXTENSIONS_READ.contains(&name.as_str()) {
            warnings.push(format!("the gltf extension {name} is not read; {}", effect_of(name)));
        }
    }
    Ok(())
}

/// Adds the names of all extensions that parts of the document have.
fn collect_extensions(value: &Value, names: &mut BTreeSet<String>) {
    match value {
        Value::Array(values) => values.iter().for_each(|value| collect_extensions(value, names)),
        Value::Object(map) => {
            for (key, value) in map {
                if key == "extras" {
                    continue;
                }
                if let ("extensions", Value::Object(own)) = (key.as_str(), value) {
                    // Textures whose images are not read are named one by one.
                    let told =
                        |name: &&String| !name.contains("_texture_") && !names.contains(*name);
                    names.extend(own.keys().filter(told).cloned().collect::<Vec<_>>());
                }
                collect_extensions(value, names);
            }
        }
        _ => {}
    }
}

/// Refuses meshes that are there in compressed form only, where the file does not say that it needs a reader of that.
fn check_compression(path: &Path, value: &Value) -> Result<(), SceneError> {
    let list = |name: &str| value.get(name).and_then(Value::as_array).into_iter().flatten();
    let refuse = |name: &str| {
        let what = format!("the gltf extension {name} without an uncompressed copy");
        Err(SceneError::unsupported(path, what, extension_cure(name)))
    };
    let draco = "KHR_draco_mesh_compression";
    let primitives = list("meshes").filter_map(|mesh| mesh.get("primitives")?.as_array()).flatten();
    for primitive in primitives.filter(|p| p.pointer(&format!("/extensions/{draco}")).is_some()) {
        let positions = primitive.pointer("/attributes/POSITION").and_then(Value::as_u64);
        let accessor = positions.and_then(|i| list("accessors").nth(usize::try_from(i).ok()?));
        if accessor.is_some_and(|a| a.get("bufferView").is_none() && a.get("sparse").is_none()) {
            return refuse(draco);
        }
    }
    for name in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        let is_copy = |buffer: &&Value| buffer.pointer(&format!("/extensions/{name}")).is_some();
        if list("buffers").filter(is_copy).any(|buffer| buffer.get("uri").is_none()) {
            return refuse(name);
        }
    }
    Ok(())
}

/// What becomes of files with an extension that is not read.
fn effect_of(extension: &str) -> &'static str {
    match extension {
        "KHR_materials_unlit" => {
            "it shows colors as they are, without light; its materials are lit here as matte ones"
        }
        "KHR_materials_transmission" => {
            "materials that let most light through are left out, as those of alpha below 0.5 are"
        }
        "KHR_materials_volume" | "KHR_materials_diffuse_transmission" => {
            "light does not pass through the materials that have it"
        }
        "KHR_materials_variants" => "the look without any variant is used",
        "KHR_materials_sheen"
        | "KHR_materials_clearcoat"
        | "KHR_materials_anisotropy"
        | "KHR_materials_iridescence"
        | "KHR_materials_dispersion" => "its materials shine as they do without it",
        "KHR_texture_basisu" | "EXT_texture_avif" | "MSFT_texture_dds" => {
            "textures that exist in that form only are left out"
        }
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "its meshes are read from the uncompressed copy beside it"
        }
        "MSFT_lod" => "the finest level is used",
        "EXT_lights_image_based" | "KHR_environment_map" => {
            "give its environment with --env to be lit by it"
        }
        _ => "what it says is left out",
    }
}

/// How to do without an extension that changes shapes.
fn extension_cure(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "write it without compression: `gltf-transform copy in.glb out.glb`"
        }
        _ => "export it again without that extension",
    }
}

/// Animations are never read, and must not stop what is.
fn drop_animations(value: &mut Value, warnings: &mut Vec<String>) {
    let animations = value.as_object_mut().and_then(|root| root.remove("animations"));
    let count = animations.as_ref().and_then(Value::as_array).map_or(0, Vec::len);
    if count > 0 {
        warnings.push(format!("{count} animations are not played; the scene is read as it stands"));
    }
}

fn read_node(index: usize, node: &mut Map<String, Value>, extras: &mut Extras) {
    let Some(extensions) = node.get("extensions") else { return };
    if let Some(attributes) = extensions.pointer("/EXT_mesh_gpu_instancing/attributes") {
        let accessor = |name: &str| attributes.get(name)?.as_u64()?.try_into().ok();
        let attributes = InstanceAttributes {
            translation: accessor("TRANSLATION"),
            rotation: accessor("ROTATION"),
            scale: accessor("SCALE"),
        };
        extras.instances.insert(index, attributes);
    }
    if extensions.pointer("/KHR_node_visibility/visible") == Some(&Value::Bool(false)) {
        extras.hidden.insert(index);
    }
}

/// Share of light a material lets through; that of a texture is not known.
fn read_transmission(material: &Map<String, Value>) -> Option<f32> {
    let transmission = material.get("extensions")?.get("KHR_materials_transmission")?;
    let factor = transmission.get("transmissionFactor")?.as_f64()?;
    let is_known = transmission.get("transmissionTexture").is_none();
    Some(if is_known { factor as f32 } else { 0.0 })
}

/// The diffuse color of the older model of materials becomes the base color of a surface that is no metal.
fn read_specular_glossiness(material: &mut Map<String, Value>) {
    let name = "KHR_materials_pbrSpecularGlossiness";
    let Some(old) = material.get("extensions").and_then(|e| e.get(name)).cloned() else { return };
    let mut new = Map::new();
    for (from, to) in [("diffuseFactor", "baseColorFactor"), ("diffuseTexture", "baseColorTexture")]
    {
        if let Some(value) = old.get(from) {
            new.insert(to.into(), value.clone());
        }
    }
    let glossiness = old.get("glossinessFactor").and_then(Value::as_f64).unwrap_or(1.0);
    new.insert("metallicFactor".into(), json!(0.0));
    new.insert("roughnessFactor".into(), json!(1.0 - glossiness.clamp(0.0, 1.0)));
    material.insert("pbrMetallicRoughness".into(), Value::Object(new));
}

/// Gives each texture an image: that of an extension that is read, else one behind the last that stands for none.
fn find_images(value: &mut Value, extras: &mut Extras, warnings: &mut Vec<String>) {
    let images = value.get("images").and_then(Value::as_array).map_or(0, Vec::len);
    extras.image_count = images;
    let mut missing = 0;
    for (i, texture) in items(value, "textures").enumerate() {
        let webp = texture
            .get("extensions")
            .and_then(|extensions| extensions.pointer("/EXT_texture_webp/source"))
            .cloned();
        if let Some(source) = webp {
            texture.insert("source".into(), source);
        }
        if texture.contains_key("source") {
            continue;
        }
        let extensions = texture.get("extensions").and_then(Value::as_object);
        let names: Vec<&str> = extensions.into_iter().flatten().map(|(k, _)| k.as_str()).collect();
        let names = if names.is_empty() { "no extension".into() } else { names.join(", ") };
        warnings.push(format!(
            "texture {i} has an image by {names} only, which is not read; the color without it is used. To read it, write it as png: \
             `gltf-transform png in.glb out.glb`, or for ktx2 files `gltf-transform ktxdecompress in.glb out.glb`"
        ));
        texture.insert("source".into(), json!(images + missing));
        missing += 1;
    }
    if missing > 0
        && let Some(root) = value.as_object_mut()
    {
        let images = root.entry("images").or_insert_with(|| json!([]));
        if let Some(images) = images.as_array_mut() {
            images.extend((0..missing).map(|_| json!({ "uri": "data:," })));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The page of formats and this reader tell the same.
    #[test]
    fn extensions_are_documented() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/formats.md");
        let page = std::fs::read_to_string(page).unwrap();
        let row = |name: &str| page.lines().find(|line| line.starts_with(&format!("| `{name}`")));
        for name in EXTENSIONS_READ {
            let row = row(name).unwrap_or_else(|| panic!("no row of {name}"));
            assert!(row.contains("| read"), "{row}");
        }
        // And what the page says to be read is.
        for line in page.lines().filter(|line| line.contains("` | read")) {
            let name = line.split('`').nth(1).unwrap();
            let is_extension = name.split('_').next().is_some_and(|vendor| vendor.len() >= 2)
                && name.starts_with(|c: char| c.is_ascii_uppercase())
                && name.contains('_');
            assert!(!is_extension || EXTENSIONS_READ.contains(&name), "{name}");
        }
        for line in page.lines().filter(|line| line.contains("may be required")) {
            for name in line.split('`').skip(1).step_by(2) {
                let name = name.trim_end_matches('…');
                assert!(
                    SHAPELESS
                        .iter()
                        .any(|start| name.starts_with(start) || start.starts_with(name)),
                    "{name}"
                );
            }
        }
    }
}
