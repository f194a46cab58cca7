//! Instances of one node: `EXT_mesh_gpu_instancing`.

use super::accessor::Accessors;
use super::prepare::InstanceAttributes;
use gltf::json::accessor::Type;
use pbgi_math::{Affine3A, Quat, Vec3};

/// Most instances of one node.
const INSTANCES_MAX: usize = 10_000_000;

/// A transform per instance: scale, then rotation, then translation.
pub(super) fn read_transforms(
    attributes: &InstanceAttributes,
    accessors: Accessors,
) -> Result<Vec<Affine3A>, String> {
    let InstanceAttributes { translation, rotation, scale } = *attributes;
    let used = [translation, rotation, scale].into_iter().flatten();
    let counts: Vec<u64> =
        used.filter_map(|i| accessors.root.accessors.get(i)).map(|a| a.count.0).collect();
    let count = counts.first().copied().unwrap_or(0);
    if counts.iter().any(|other| *other != count) {
        return Err(format!(
            "the attributes of its instances have {counts:?} elements, expected as many of each"
        ));
    }
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    if count > INSTANCES_MAX {
        return Err(format!("has {count} instances, more than the {INSTANCES_MAX} that are read"));
    }
    let vectors = |index: Option<usize>, name: &str, default: [f32; 3]| match index {
        Some(index) => accessors
            .read_vectors::<3>(index, &[Type::Vec3], 0.0)
            .map_err(|e| format!("{name} of its instances: {e}")),
        None => Ok(vec![default; count]),
    };
    let translations = vectors(translation, "TRANSLATION", [0.0; 3])?;
    let scales = vectors(scale, "SCALE", [1.0; 3])?;
    let rotations = match rotation {
        Some(index) => accessors
            .read_vectors::<4>(index, &[Type::Vec4], 0.0)
            .map_err(|e| format!("ROTATION of its instances: {e}"))?,
        None => vec![[0.0, 0.0, 0.0, 1.0]; count],
    };
    let parts = translations.into_iter().zip(rotations).zip(scales);
    Ok(parts
        .map(|((translation, rotation), scale)| {
            let rotation = Quat::from_array(rotation);
            let length = rotation.length();
            let rotation = if length > 0.0 { rotation / length } else { Quat::IDENTITY };
            Affine3A::from_scale_rotation_translation(
                Vec3::from_array(scale),
                rotation,
                Vec3::from_array(translation),
            )
        })
        .collect())
}
