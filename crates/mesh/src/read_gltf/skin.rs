//! Skins: vertices that joints move, as the joints stand in the file.

use super::accessor::Accessors;
use super::local_transform;
use gltf::Semantic;
use gltf::json::accessor::Type;
use pbgi_math::{Affine3A, Mat3, Mat4, Vec3};
use pbgi_scene::Mesh;

/// Most sets of joints of a vertex, four in each.
const SETS_MAX: u32 = 8;

/// The matrix of each joint: where it is in the world, after what takes the mesh to it.
pub(super) struct Skin(Vec<Affine3A>);

impl Skin {
    /// Reads a skin. The error says what is wrong with it.
    pub fn read(
        document: &gltf::Document,
        skin: &gltf::Skin,
        accessors: Accessors,
    ) -> Result<Self, String> {
        let place = format!("skin {}", skin.index());
        let joints: Vec<gltf::Node> = skin.joints().collect();
        let inverses = match skin.inverse_bind_matrices() {
            Some(accessor) => accessors
                .read_vectors::<16>(accessor.index(), &[Type::Mat4], 0.0)
                .map_err(|e| format!("{place}: inverseBindMatrices: {e}"))?,
            None => vec![Mat4::IDENTITY.to_cols_array(); joints.len()],
        };
        if inverses.len() < joints.len() {
            let (found, expected) = (inverses.len(), joints.len());
            return Err(format!("{place} has {found} inverse bind matrices for {expected} joints"));
        }
        let parents = find_parents(document);
        let matrices = joints.iter().zip(&inverses).map(|(joint, inverse)| {
            let world = world_transform(document, &parents, joint.index()).ok_or_else(|| {
                format!("{place}: the nodes above joint {} form a ring", joint.index())
            })?;
            Ok(world * Affine3A::from_mat4(Mat4::from_cols_array(inverse)))
        });
        matrices.collect::<Result<_, String>>().map(Self)
    }

    /// Moves positions and normals of a primitive's mesh to where its joints are.
    pub fn pose(
        &self,
        primitive: &gltf::Primitive,
        accessors: Accessors,
        mesh: &mut Mesh,
    ) -> Result<(), String> {
        let count = mesh.positions.len();
        let mut sums = vec![(Mat3::ZERO, Vec3::ZERO, 0f32); count];
        for set in 0..SETS_MAX {
            let find = |semantic: Semantic| primitive.get(&semantic).map(|a| a.index());
            let joints = find(Semantic::Joints(set));
            let weights = find(Semantic::Weights(set));
            let (Some(joints), Some(weights)) = (joints, weights) else { break };
            let read = |index: usize, name: &str| {
                let read = accessors.read_vectors::<4>(index, &[Type::Vec4], 0.0);
                let read = read.map_err(|e| format!("{name}_{set}: {e}"))?;
                let found = read.len();
                match found == count {
                    true => Ok(read),
                    false => {
                        Err(format!("{name}_{set} has {found} elements, but POSITION has {count}"))
                    }
                }
            };
            let (joints, weights) = (read(joints, "JOINTS")?, read(weights, "WEIGHTS")?);
            for (sum, (joints, weights)) in sums.iter_mut().zip(joints.iter().zip(weights)) {
                for (&joint, weight) in joints.iter().zip(weights) {
                    // What weighs nothing may name anything.
                    if !(weight > 0.0) {
                        continue;
                    }
                    let matrix = self.0.get(joint as usize).ok_or_else(|| {
                        format!(
                            "JOINTS_{set} names joint {joint}, but the skin has {}",
                            self.0.len()
                        )
                    })?;
                    sum.0 += Mat3::from(matrix.matrix3) * weight;
                    sum.1 += Vec3::from(matrix.translation) * weight;
                    sum.2 += weight;
                }
            }
        }
        for (vertex, (matrix, translation, weight)) in sums.into_iter().enumerate() {
            // What no joint holds stays where it is.
            if !(weight > 0.0) {
                continue;
            }
            let (matrix, translation) = (matrix * (1.0 / weight), translation / weight);
            mesh.positions[vertex] = matrix * mesh.positions[vertex] + translation;
            if let Some(normal) = mesh.normals.get_mut(vertex) {
                // Normals go through the adjugate's transpose.
                let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
                let turned = y.cross(z) * normal.x + z.cross(x) * normal.y + x.cross(y) * normal.z;
                *normal = turned.try_normalize().unwrap_or(Vec3::ZERO);
            }
        }
        Ok(())
    }
}

/// The node above each node.
fn find_parents(document: &gltf::Document) -> Vec<Option<usize>> {
    let mut parents = vec![None; document.nodes().len()];
    for node in document.nodes() {
        node.children().for_each(|child| parents[child.index()] = Some(node.index()));
    }
    parents
}

/// Where a node is; `None` if it is above itself.
fn world_transform(
    document: &gltf::Document,
    parents: &[Option<usize>],
    index: usize,
) -> Option<Affine3A> {
    let mut transform = Affine3A::IDENTITY;
    let mut next = Some(index);
    for _ in 0..=parents.len() {
        let Some(index) = next else { return Some(transform) };
        transform = local_transform(&document.nodes().nth(index)?) * transform;
        next = parents[index];
    }
    None
}
