//! glTF 2.0: `.gltf` and `.glb`.

mod accessor;
mod container;
mod light;
mod material;
mod mesh;

use crate::resources::Resources;
use crate::{Camera, Instance, Mesh, Scene, SceneError};
use accessor::Accessors;
use gltf::json::Root;
use gltf::json::camera::Type as CameraType;
use gltf::json::validation::{Checked, Validate};
use light::Lights;
use material::Materials;
use pbgi_math::{Affine3A, Mat3, Mat4};
use std::path::Path;

/// Extensions that may be required: all that are read.
const EXTENSIONS: [&str; 4] = [
    "KHR_materials_emissive_strength",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_lights_punctual",
];

/// Reads the default scene of a glTF file: one mesh per primitive, one instance per node and
/// primitive.
///
/// Skins, morph targets and animations are left in their rest pose. Directional lights are left out. Candela and nits are taken as
/// W·sr⁻¹ and W·m⁻²·sr⁻¹.
pub(crate) fn read_gltf(path: &Path, resources: &Resources) -> Result<Scene, SceneError> {
    parse_gltf(path, &resources.read(path)?, resources)
}

/// As [`read_gltf`], from the bytes of the file; `path` serves messages and files beside it.
fn parse_gltf(path: &Path, file: &[u8], resources: &Resources) -> Result<Scene, SceneError> {
    let (json, binary) = container::split(path, file)?;
    resources.take(path, parsed_bytes(json))?;
    let mut warnings = Vec::new();
    let document = parse_json(path, json, &mut warnings)?;
    let root = document.as_json();
    let buffers = container::load_buffers(path, root, binary, resources)?;
    let accessors = Accessors { root, buffers: &buffers };
    let mut materials = material::read_materials(path, &document, accessors, resources)?;
    warnings.append(&mut materials.warnings);
    let mut scene = Scene { warnings, ..Scene::default() };
    let primitives = read_meshes(path, &document, (accessors, resources), &materials, &mut scene)?;
    scene.materials = materials.materials;
    scene.textures = materials.textures;
    place_nodes(path, &document, &primitives, &mut scene, resources)?;
    if scene.materials.len() == root.materials.len() + 1
        && !scene.meshes.iter().any(|m| m.material as usize == root.materials.len())
    {
        // The material for those without one was not needed.
        scene.materials.pop();
    }
    Ok(scene)
}

/// Parses and validates the JSON; refuses required extensions by name.
fn parse_json(
    path: &Path,
    json: &[u8],
    warnings: &mut Vec<String>,
) -> Result<gltf::Document, SceneError> {
    let parsed = gltf::Gltf::from_slice_without_validation(json)
        .map_err(|e| SceneError::malformed(path, format!("not valid gltf json: {e}")))?;
    let mut root = parsed.document.into_json();
    for extension in std::mem::take(&mut root.extensions_required) {
        if !EXTENSIONS.contains(&extension.as_str()) {
            let what = format!("the gltf extension {extension}");
            return Err(SceneError::unsupported(path, what, extension_cure(&extension)));
        }
    }
    for extension in &root.extensions_used {
        if !EXTENSIONS.contains(&extension.as_str()) {
            warnings.push(format!("the gltf extension {extension} is ignored"));
        }
    }
    validate(path, &root)?;
    Ok(gltf::Document::from_json_without_validation(root))
}

/// Checks that every index of the document points to something and every constant is known: what
/// keeps the accessors of the gltf crate from panicking.
fn validate(path: &Path, root: &Root) -> Result<(), SceneError> {
    // The crate's own check of positions needs these indices to be right.
    for (i, mesh) in root.meshes.iter().enumerate() {
        let accessors = mesh.primitives.iter().flat_map(|p| p.attributes.values());
        let largest = accessors.map(|a| a.value()).max().unwrap_or(0);
        if largest >= root.accessors.len() {
            let message = format!(
                "mesh {i} refers to accessor {largest}, but there are {}",
                root.accessors.len()
            );
            return Err(SceneError::malformed(path, message));
        }
    }
    let mut problems = Vec::new();
    root.validate(root, gltf::json::Path::new, &mut |place, problem| {
        let place = place().to_string();
        // The bounds of positions are mandatory, but often missing, and not needed here.
        if !place.ends_with(".min") && !place.ends_with(".max") {
            problems.push(format!("{place}: {problem}").to_lowercase());
        }
    });
    if problems.is_empty() {
        return Ok(());
    }
    problems.truncate(3);
    Err(SceneError::malformed(path, format!("invalid gltf: {}", problems.join(", "))))
}

/// How to do without an extension.
fn extension_cure(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "write it without compression: `gltf-transform copy in.glb out.glb`"
        }
        "KHR_texture_basisu" => {
            "write its textures as png: `gltf-transform ktxdecompress in.glb out.glb`"
        }
        "EXT_texture_webp" | "EXT_texture_avif" | "MSFT_texture_dds" => {
            "write its textures as png: `gltf-transform png in.glb out.glb`"
        }
        "KHR_materials_pbrSpecularGlossiness" => {
            "convert its materials: `gltf-transform metalrough in.glb out.glb`"
        }
        _ => "export it again without that extension",
    }
}

/// Reads every primitive; returns the scene's meshes of each glTF mesh.
fn read_meshes(
    path: &Path,
    document: &gltf::Document,
    (accessors, resources): (Accessors, &Resources),
    materials: &Materials,
    scene: &mut Scene,
) -> Result<Vec<Vec<u32>>, SceneError> {
    let default_material = document.materials().len();
    let mut primitives = Vec::with_capacity(document.meshes().len());
    for mesh in document.meshes() {
        let mut indices = Vec::new();
        for primitive in mesh.primitives() {
            let place = describe_primitive(&mesh, &primitive);
            let material = primitive.material().index().unwrap_or(default_material);
            resources.take(path, primitive_bytes(&primitive))?;
            let uv_source = materials.uv_sources.get(material).copied().flatten();
            let read = mesh::read_primitive(&primitive, accessors, material as u32, uv_source)
                .map_err(|e| SceneError::malformed(path, format!("{place}: {e}")))?;
            scene.warnings.extend(read.warnings.iter().map(|w| format!("{place} {w}")));
            if let Some(mesh) = read.mesh {
                indices.push(scene.meshes.len() as u32);
                scene.meshes.push(mesh);
            }
        }
        primitives.push(indices);
    }
    Ok(primitives)
}

/// Bytes that the JSON takes once it is parsed: its texts, and the fields of its objects.
fn parsed_bytes(json: &[u8]) -> u64 {
    let fields = json.iter().filter(|byte| matches!(byte, b',' | b'{' | b'[')).count();
    json.len() as u64 + FIELD_BYTES * fields as u64
}

/// Bytes a field of JSON takes on average; primitives, the largest, have a few hundred.
const FIELD_BYTES: u64 = 64;

/// Bytes of an instance, in a list that doubles as it grows, and of what is diced of it.
const INSTANCE_BYTES: u64 = 3 * size_of::<Instance>() as u64;

/// Bytes of a primitive's mesh, with what is held while it is read, and of its lists.
fn primitive_bytes(primitive: &gltf::Primitive) -> u64 {
    let vertices = primitive.attributes().map(|(_, accessor)| accessor.count()).max().unwrap_or(0);
    let corners = primitive.indices().map_or(vertices, |indices| indices.count());
    (vertices as u64)
        .saturating_mul(VERTEX_BYTES)
        .saturating_add((corners as u64).saturating_mul(CORNER_BYTES))
        .saturating_add(size_of::<Mesh>() as u64)
}

/// Position, normal, color and texture coordinates; an index, and its part of a triangle, of which strips make one for each.
const VERTEX_BYTES: u64 = 44;
const CORNER_BYTES: u64 = 4 + 12;

fn describe_primitive(mesh: &gltf::Mesh, primitive: &gltf::Primitive) -> String {
    let name = mesh.name().map_or(String::new(), |name| format!(" ({name})"));
    format!("mesh {}{name}, primitive {}", mesh.index(), primitive.index())
}

/// Walks the node trees of the default scene in file order.
fn place_nodes(
    path: &Path,
    document: &gltf::Document,
    primitives: &[Vec<u32>],
    scene: &mut Scene,
    resources: &Resources,
) -> Result<(), SceneError> {
    let malformed = |message: String| SceneError::malformed(path, message);
    let mut lights = Lights::default();
    let mut seen = vec![false; document.nodes().len()];
    let mut stack: Vec<(gltf::Node, Affine3A)> =
        find_roots(document).into_iter().rev().map(|node| (node, Affine3A::IDENTITY)).collect();
    while let Some((node, parent)) = stack.pop() {
        let place = format!("node {}", node.index());
        if std::mem::replace(&mut seen[node.index()], true) {
            return Err(malformed(format!("{place} is reached twice; nodes must form a tree")));
        }
        let transform = parent * local_transform(&node);
        if !transform.is_finite() {
            return Err(malformed(format!("{place} has a transform that is not finite")));
        }
        if let Some(mesh) = node.mesh() {
            if node.skin().is_some() {
                scene.warnings.push(format!("{place} has a skin; its rest pose is used"));
            }
            let meshes = primitives.get(mesh.index()).map_or(&[][..], Vec::as_slice);
            resources.take(path, INSTANCE_BYTES * meshes.len() as u64)?;
            scene.instances.extend(meshes.iter().map(|&mesh| Instance { mesh, transform }));
        }
        if let Some(camera) = node.camera() {
            let name = node.name().or(camera.name()).unwrap_or_default();
            let camera = &document.as_json().cameras[camera.index()];
            match read_camera(camera, name, &transform) {
                Ok(camera) => scene.cameras.push(camera),
                Err(reason) => scene.warnings.push(format!("camera of {place} {reason}")),
            }
        }
        lights.place(document.as_json(), &node, &transform, scene);
        let first_child = stack.len();
        stack.extend(node.children().map(|child| (child, transform)));
        stack[first_child..].reverse();
    }
    lights.warn(&mut scene.warnings);
    Ok(())
}

/// Roots of the default or first scene; without any scene, all nodes that are no one's child.
fn find_roots(document: &gltf::Document) -> Vec<gltf::Node<'_>> {
    if let Some(scene) = document.default_scene().or_else(|| document.scenes().next()) {
        return scene.nodes().collect();
    }
    let mut is_child = vec![false; document.nodes().len()];
    for node in document.nodes() {
        node.children().for_each(|child| is_child[child.index()] = true);
    }
    document.nodes().filter(|node| !is_child[node.index()]).collect()
}

fn local_transform(node: &gltf::Node) -> Affine3A {
    use gltf::scene::Transform;
    let transform = match node.transform() {
        // Files round their quaternions; unit length keeps the scale apart.
        Transform::Decomposed { translation, rotation, scale } => {
            let length = rotation.iter().map(|c| c * c).sum::<f32>().sqrt();
            let rotation =
                if length > 0.0 { rotation.map(|c| c / length) } else { [0., 0., 0., 1.] };
            Transform::Decomposed { translation, rotation, scale }
        }
        matrix => matrix,
    };
    Affine3A::from_mat4(Mat4::from_cols_array_2d(&transform.matrix()))
}

/// The rigid part of a camera node; the error says why there is none.
fn read_camera(
    camera: &gltf::json::Camera,
    name: &str,
    transform: &Affine3A,
) -> Result<Camera, &'static str> {
    let perspective = match (&camera.type_, &camera.perspective) {
        (Checked::Valid(CameraType::Perspective), Some(perspective)) => perspective,
        _ => return Err("is not a perspective camera and is left out"),
    };
    let yfov = perspective.yfov;
    if !(yfov > 0.0 && yfov < std::f32::consts::PI) {
        return Err("has a field of view beyond 0 to 180 degrees and is left out");
    }
    let axes = transform.matrix3;
    let back = axes.z_axis.try_normalize();
    let side = back.and_then(|back| axes.y_axis.cross(back).try_normalize());
    let (Some(back), Some(side)) = (back, side) else {
        return Err("has no direction and is left out");
    };
    let axes = Mat3::from_cols(side.into(), back.cross(side).into(), back.into());
    let transform = Affine3A::from_mat3_translation(axes, transform.translation.into());
    Ok(Camera { name: name.to_owned(), transform, yfov })
}

#[cfg(test)]
mod tests;
