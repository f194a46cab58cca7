//! glTF 2.0: `.gltf` and `.glb`.

mod accessor;
mod container;
mod instancing;
mod light;
mod material;
mod mesh;
mod prepare;
mod skin;

use crate::SceneError;
use crate::resources::Resources;
use accessor::Accessors;
use gltf::json::Root;
use gltf::json::camera::Type as CameraType;
use gltf::json::validation::{Checked, Validate};
use light::Lights;
use material::Materials;
use mesh::ReadPrimitive;
use pbgi_math::{Affine3A, Mat3, Mat4};
use pbgi_scene::{Camera, Instance, Mesh, Scene};
use prepare::Extras;
use skin::Skin;
use std::path::Path;

/// Reads the default scene of a glTF file: one mesh per primitive, one instance per node and
/// primitive.
///
/// Skins and morph targets are posed as the file stands; animations are not played. Directional lights are left out. Candela and nits
/// are taken as W·sr⁻¹ and W·m⁻²·sr⁻¹.
pub(crate) fn read_gltf(path: &Path, resources: &Resources) -> Result<Scene, SceneError> {
    parse_gltf(path, &resources.read(path)?, resources)
}

/// As [`read_gltf`], from the bytes of the file; `path` serves messages and files beside it.
fn parse_gltf(path: &Path, file: &[u8], resources: &Resources) -> Result<Scene, SceneError> {
    let (json, binary) = container::split(path, file)?;
    let fields = json.iter().filter(|byte| matches!(byte, b',' | b'{' | b'[')).count() as u64;
    resources.take(path, json.len() as u64 + FIELD_BYTES * fields)?;
    // It is values of any kind before it is a document.
    resources.check(path, json.len() as u64 + VALUE_BYTES * fields)?;
    let mut warnings = Vec::new();
    let (root, extras) = prepare::prepare(path, json, &mut warnings)?;
    validate(path, &root)?;
    let document = gltf::Document::from_json_without_validation(root);
    let root = document.as_json();
    let buffers = container::load_buffers(path, root, binary, resources)?;
    let accessors = Accessors { root, buffers: &buffers };
    let mut materials = material::read_materials(path, &document, accessors, &extras, resources)?;
    warnings.append(&mut materials.warnings);
    let scene = Scene { warnings, ..Scene::default() };
    let (document, shared) = (&document, vec![]);
    let reader = Reader { path, document, accessors, resources, extras, materials, scene, shared };
    reader.read()
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
        let is_bound = place.ends_with(".min") || place.ends_with(".max");
        // What has no positions is left out, with a warning.
        if !is_bound && !place.ends_with("attributes[\"POSITION\"]") {
            problems.push(format!("{place}: {problem}").to_lowercase());
        }
    });
    if problems.is_empty() {
        return Ok(());
    }
    problems.truncate(3);
    Err(SceneError::malformed(path, format!("invalid gltf: {}", problems.join(", "))))
}

/// A document on its way into a scene.
struct Reader<'a> {
    path: &'a Path,
    document: &'a gltf::Document,
    accessors: Accessors<'a>,
    resources: &'a Resources<'a>,
    extras: Extras,
    materials: Materials,
    scene: Scene,
    /// Meshes of the scene that nodes share, of each mesh of the document.
    shared: Vec<Vec<u32>>,
}

impl Reader<'_> {
    fn read(mut self) -> Result<Scene, SceneError> {
        for mesh in self.document.meshes() {
            let meshes = self.read_mesh(&mesh, mesh.weights().unwrap_or_default(), None)?;
            self.shared.push(meshes);
        }
        self.place_nodes()?;
        self.materials.finish(&mut self.scene);
        Ok(self.scene)
    }

    /// Reads the primitives of a mesh, posed; returns the scene's meshes.
    fn read_mesh(
        &mut self,
        mesh: &gltf::Mesh,
        weights: &[f32],
        skin: Option<&Skin>,
    ) -> Result<Vec<u32>, SceneError> {
        let mut indices = Vec::new();
        for primitive in mesh.primitives() {
            let place = describe_primitive(mesh, &primitive);
            self.resources.take(self.path, primitive_bytes(&primitive))?;
            self.resources.check(self.path, posing_bytes(&primitive))?;
            let read = self
                .read_primitive(&primitive, weights, skin)
                .map_err(|e| SceneError::malformed(self.path, format!("{place}: {e}")))?;
            for warning in read.warnings {
                let warning = format!("{place} {warning}");
                if !self.scene.warnings.contains(&warning) {
                    self.scene.warnings.push(warning);
                }
            }
            if let Some(mesh) = read.mesh {
                indices.push(self.scene.meshes.len() as u32);
                self.scene.meshes.push(mesh);
            }
        }
        Ok(indices)
    }

    fn read_primitive(
        &self,
        primitive: &gltf::Primitive,
        weights: &[f32],
        skin: Option<&Skin>,
    ) -> Result<ReadPrimitive, String> {
        let number = primitive.material().index();
        let is_colored = primitive.get(&gltf::Semantic::Colors(0)).is_some();
        let material = number.unwrap_or_else(|| self.materials.default_index(is_colored));
        let uv_source = self.materials.uv_sources.get(material).copied().flatten();
        let mut read =
            mesh::read_primitive(primitive, self.accessors, material as u32, uv_source, weights)?;
        if let (Some(mesh), Some(skin)) = (&mut read.mesh, skin) {
            skin.pose(primitive, self.accessors, mesh)?;
        }
        if let Some(mesh) = &read.mesh {
            mesh::check_positions(mesh)?;
        }
        Ok(read)
    }

    /// Walks the node trees of the default scene in file order.
    fn place_nodes(&mut self) -> Result<(), SceneError> {
        let malformed = |message: String| SceneError::malformed(self.path, message);
        let document = self.document;
        let mut lights = Lights::default();
        let mut seen = vec![false; document.nodes().len()];
        let mut stack: Vec<(gltf::Node, Affine3A)> =
            find_roots(document).into_iter().rev().map(|node| (node, Affine3A::IDENTITY)).collect();
        let mut hidden_count = 0;
        while let Some((node, parent)) = stack.pop() {
            let place = format!("node {}", node.index());
            if std::mem::replace(&mut seen[node.index()], true) {
                return Err(malformed(format!("{place} is reached twice; nodes must form a tree")));
            }
            if self.extras.hidden.contains(&node.index()) {
                hidden_count += 1;
                mark_below(&node, &mut seen);
                continue;
            }
            let transform = parent * local_transform(&node);
            if !transform.is_finite() {
                return Err(malformed(format!("{place} has a transform that is not finite")));
            }
            if let Some(mesh) = node.mesh() {
                self.place_mesh(&node, &mesh, transform)?;
            }
            if let Some(camera) = node.camera() {
                let name = node.name().or(camera.name()).unwrap_or_default();
                let camera = &document.as_json().cameras[camera.index()];
                match read_camera(camera, name, &transform) {
                    Ok(camera) => self.scene.cameras.push(camera),
                    Err(reason) => {
                        self.scene.warnings.push(format!("camera of {place} {reason}"));
                    }
                }
            }
            lights.place(document.as_json(), &node, &transform, &mut self.scene);
            let first_child = stack.len();
            stack.extend(node.children().map(|child| (child, transform)));
            stack[first_child..].reverse();
        }
        if hidden_count > 0 {
            let text = "nodes are hidden (KHR_node_visibility) and left out with all below them";
            self.scene.warnings.push(format!("{hidden_count} {text}"));
        }
        lights.warn(&mut self.scene.warnings);
        let is_missed = |node: &gltf::Node| !seen[node.index()] && node.mesh().is_some();
        let missed = document.nodes().filter(is_missed).count();
        if missed > 0 {
            let text = "nodes with meshes are not in the scene that is read (the default one, else the first); they are left out";
            self.scene.warnings.push(format!("{missed} {text}"));
        }
        Ok(())
    }

    /// Places the mesh of a node, where its skin, its own weights and its instances say.
    fn place_mesh(
        &mut self,
        node: &gltf::Node,
        mesh: &gltf::Mesh,
        transform: Affine3A,
    ) -> Result<(), SceneError> {
        let path = self.path;
        let in_node = |message: String| {
            SceneError::malformed(path, format!("node {}: {message}", node.index()))
        };
        let weights = node.weights().or(mesh.weights()).unwrap_or_default();
        // Only the joints move what has a skin.
        let (meshes, transform) = if let Some(skin) = node.skin() {
            let skin = Skin::read(self.document, &skin, self.accessors).map_err(in_node)?;
            (self.read_mesh(mesh, weights, Some(&skin))?, Affine3A::IDENTITY)
        } else if node.weights().is_some() && node.weights() != mesh.weights() {
            (self.read_mesh(mesh, weights, None)?, transform)
        } else {
            (self.shared[mesh.index()].clone(), transform)
        };
        let transforms = match self.extras.instances.get(&node.index()) {
            Some(attributes) => {
                let count = attributes.count(self.accessors);
                self.resources.check(path, TRANSFORM_BYTES.saturating_mul(count))?;
                instancing::read_transforms(attributes, self.accessors).map_err(in_node)?
            }
            None => vec![Affine3A::IDENTITY],
        };
        let count = transforms.len() as u64 * meshes.len() as u64;
        self.resources.take(path, INSTANCE_BYTES * count)?;
        for own in transforms {
            let transform = transform * own;
            if !transform.is_finite() {
                return Err(in_node("an instance has a transform that is not finite".into()));
            }
            self.scene.instances.extend(meshes.iter().map(|&mesh| Instance { mesh, transform }));
        }
        Ok(())
    }
}

/// Bytes a field of JSON takes on average, parsed to the document, whose primitives, the largest, have a few hundred; and before.
const FIELD_BYTES: u64 = 64;
const VALUE_BYTES: u64 = 128;

/// Bytes of an instance, in a list that doubles as it grows, and of what is diced of it.
const INSTANCE_BYTES: u64 = 3 * size_of::<Instance>() as u64;

/// Bytes of the transform of one of a node's instances, and of what it is made of, while it is read.
const TRANSFORM_BYTES: u64 = 144;

/// Vertices of a primitive.
fn vertex_count(primitive: &gltf::Primitive) -> u64 {
    primitive.attributes().map(|(_, accessor)| accessor.count()).max().unwrap_or(0) as u64
}

/// Bytes of a primitive's mesh, with what is held while it is read, and of its lists.
fn primitive_bytes(primitive: &gltf::Primitive) -> u64 {
    let vertices = vertex_count(primitive);
    let corners = primitive.indices().map_or(vertices, |indices| indices.count() as u64);
    vertices
        .saturating_mul(VERTEX_BYTES)
        .saturating_add(corners.saturating_mul(CORNER_BYTES))
        .saturating_add(size_of::<Mesh>() as u64)
}

/// Bytes that are held for a while where a primitive is posed: of a target, or joints and weights of all sets.
fn posing_bytes(primitive: &gltf::Primitive) -> u64 {
    let is_posed = |semantic: &gltf::Semantic| {
        matches!(semantic, gltf::Semantic::Joints(_) | gltf::Semantic::Weights(_))
    };
    let attributes = primitive.attributes().filter(|(semantic, _)| is_posed(semantic)).count();
    let lists = attributes as u64 + 2 * u64::from(primitive.morph_targets().next().is_some());
    vertex_count(primitive).saturating_mul(lists * POSED_BYTES)
}

/// Position, normal, color with alpha and texture coordinates; an index, and its part of a triangle, of which strips make one for each.
const VERTEX_BYTES: u64 = 48;
const CORNER_BYTES: u64 = 4 + 12;
/// A vector of four, packed and unpacked.
const POSED_BYTES: u64 = 32;

fn describe_primitive(mesh: &gltf::Mesh, primitive: &gltf::Primitive) -> String {
    let name = mesh.name().map_or(String::new(), |name| format!(" ({name})"));
    format!("mesh {}{name}, primitive {}", mesh.index(), primitive.index())
}

/// Marks all nodes below one as seen, which may be seen already.
fn mark_below(node: &gltf::Node, seen: &mut [bool]) {
    let mut stack: Vec<gltf::Node> = node.children().collect();
    while let Some(node) = stack.pop() {
        if !std::mem::replace(&mut seen[node.index()], true) {
            stack.extend(node.children());
        }
    }
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
