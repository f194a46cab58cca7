//! Primitives: one mesh each.

use super::accessor::Accessors;
use super::material::UvSource;
use crate::Mesh;
use gltf::json::accessor::Type;
use gltf::mesh::{Mode, Semantic};
use pbgi_math::{Vec2, Vec3};

/// What a primitive gives.
pub(super) struct ReadPrimitive {
    /// `None` if it has no triangles.
    pub mesh: Option<Mesh>,
    pub warnings: Vec<String>,
}

/// Reads a primitive whose textures, if any, use `uv_source`. The error names what is wrong, not
/// the primitive.
pub(super) fn read_primitive(
    primitive: &gltf::Primitive,
    accessors: Accessors,
    material: u32,
    uv_source: Option<UvSource>,
) -> Result<ReadPrimitive, String> {
    let mut warnings = Vec::new();
    let mode = primitive.mode();
    if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        warnings.push("consists of points or lines and is left out".into());
        return Ok(ReadPrimitive { mesh: None, warnings });
    }
    let find = |semantic: Semantic| primitive.get(&semantic).map(|a| a.index());
    let positions = find(Semantic::Positions).ok_or("has no POSITION attribute")?;
    let positions = read_positions(accessors, positions)?;
    let count = positions.len();
    let indices = match primitive.indices() {
        Some(indices) => {
            accessors.read_indices(indices.index()).map_err(|e| format!("indices: {e}"))?
        }
        None => (0..u32::try_from(count).map_err(|_| "has too many vertices")?).collect(),
    };
    if let Some(bad) = indices.iter().find(|&&i| i as usize >= count) {
        return Err(format!("vertex index {bad} is not below the vertex count {count}"));
    }
    let normals = find(Semantic::Normals)
        .map(|i| read_normals(accessors, i, count, &mut warnings))
        .transpose()?;
    let uvs = uv_source
        .and_then(|source| Some((source, find(Semantic::TexCoords(source.set))?)))
        .map(|(source, i)| read_uvs(accessors, i, count, &source, &mut warnings))
        .transpose()?;
    if uv_source.is_some() && uvs.is_none() {
        warnings.push("has a texture but no texture coordinates; the texture is ignored".into());
    }
    let colors = find(Semantic::Colors(0)).map(|i| read_colors(accessors, i, count)).transpose()?;
    let mesh = Mesh {
        positions,
        normals: normals.unwrap_or_default(),
        uvs: uvs.unwrap_or_default(),
        colors: colors.unwrap_or_default(),
        triangles: list_triangles(&indices, mode),
        material,
    };
    Ok(ReadPrimitive { mesh: (!mesh.triangles.is_empty()).then_some(mesh), warnings })
}

/// Triangles of an index list (§ 3.7.2.1 of the specification); what is left over is ignored.
fn list_triangles(indices: &[u32], mode: Mode) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            // Every other triangle of a strip runs backward.
            .map(|(k, w)| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
        Mode::TriangleFan => match indices {
            [hub, rim @ ..] => rim.windows(2).map(|w| [*hub, w[0], w[1]]).collect(),
            [] => Vec::new(),
        },
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

fn read_positions(accessors: Accessors, index: usize) -> Result<Vec<Vec3>, String> {
    let read = accessors.read_vectors::<3>(index, &[Type::Vec3], 0.0);
    let positions = read.map_err(|e| format!("POSITION: {e}"))?;
    if let Some(bad) = positions.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        return Err(format!("position of vertex {bad} is not finite"));
    }
    Ok(positions.into_iter().map(Vec3::from_array).collect())
}

fn read_normals(
    accessors: Accessors,
    index: usize,
    count: usize,
    warnings: &mut Vec<String>,
) -> Result<Vec<Vec3>, String> {
    let read = accessors.read_vectors::<3>(index, &[Type::Vec3], 0.0);
    let normals = read.map_err(|e| format!("NORMAL: {e}"))?;
    check_count("NORMAL", normals.len(), count)?;
    let unit: Option<Vec<Vec3>> =
        normals.into_iter().map(|n| Vec3::from_array(n).try_normalize()).collect();
    if unit.is_none() {
        warnings.push("has normals without direction; all its normals are ignored".into());
    }
    Ok(unit.unwrap_or_default())
}

fn read_uvs(
    accessors: Accessors,
    index: usize,
    count: usize,
    source: &UvSource,
    warnings: &mut Vec<String>,
) -> Result<Vec<Vec2>, String> {
    let place = format!("TEXCOORD_{}", source.set);
    let read = accessors.read_vectors::<2>(index, &[Type::Vec2], 0.0);
    let uvs = read.map_err(|e| format!("{place}: {e}"))?;
    check_count(&place, uvs.len(), count)?;
    let mut bad_count = 0;
    let mut transform = |uv: [f32; 2]| {
        let uv = source.transform(uv);
        bad_count += usize::from(!uv.is_finite());
        if uv.is_finite() { uv } else { Vec2::ZERO }
    };
    let uvs = uvs.into_iter().map(&mut transform).collect();
    if bad_count > 0 {
        warnings
            .push(format!("has {bad_count} texture coordinates that are not finite; 0 is used"));
    }
    Ok(uvs)
}

fn read_colors(accessors: Accessors, index: usize, count: usize) -> Result<Vec<[f32; 3]>, String> {
    let read = accessors.read_vectors::<3>(index, &[Type::Vec3, Type::Vec4], 1.0);
    let colors = read.map_err(|e| format!("COLOR_0: {e}"))?;
    check_count("COLOR_0", colors.len(), count)?;
    let clamp = |c: f32| if c.is_finite() { c.clamp(0.0, 1.0) } else { 1.0 };
    Ok(colors.into_iter().map(|rgb| rgb.map(clamp)).collect())
}

fn check_count(place: &str, found: usize, expected: usize) -> Result<(), String> {
    if found == expected {
        return Ok(());
    }
    Err(format!("{place} has {found} elements, but POSITION has {expected}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_their_orientation() {
        let strip = list_triangles(&[0, 1, 2, 3, 4], Mode::TriangleStrip);
        assert_eq!(strip, [[0, 1, 2], [2, 1, 3], [2, 3, 4]]);
        let fan = list_triangles(&[0, 1, 2, 3], Mode::TriangleFan);
        assert_eq!(fan, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(list_triangles(&[0, 1, 2, 3, 4], Mode::Triangles), [[0, 1, 2]]);
        assert!(list_triangles(&[], Mode::TriangleFan).is_empty());
        assert!(list_triangles(&[1, 2], Mode::TriangleStrip).is_empty());
    }
}
