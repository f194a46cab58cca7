//! Primitives: one mesh each.

use super::accessor::Accessors;
use super::material::UvSource;
use gltf::json::accessor::Type;
use gltf::mesh::{Mode, Semantic};
use pbgi_math::{Vec2, Vec3};
use pbgi_scene::Mesh;

/// What a primitive gives.
pub(super) struct ReadPrimitive {
    /// `None` if it has no triangles.
    pub mesh: Option<Mesh>,
    pub warnings: Vec<String>,
}

/// Reads a primitive whose textures, if any, use `uv_source`, and whose morph targets weigh `weights`. The error names what is wrong,
/// not the primitive.
pub(super) fn read_primitive(
    primitive: &gltf::Primitive,
    accessors: Accessors,
    material: u32,
    uv_source: Option<UvSource>,
    weights: &[f32],
) -> Result<ReadPrimitive, String> {
    let mut warnings = Vec::new();
    let mode = primitive.mode();
    if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
        warnings.push("consists of points or lines and is left out".into());
        return Ok(ReadPrimitive { mesh: None, warnings });
    }
    let find = |semantic: Semantic| primitive.get(&semantic).map(|a| a.index());
    let Some(positions) = find(Semantic::Positions) else {
        warnings.push("has no positions and is left out".into());
        return Ok(ReadPrimitive { mesh: None, warnings });
    };
    let mut positions = read_positions(accessors, positions)?;
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
    let normals = find(Semantic::Normals).map(|i| read_normals(accessors, i, count)).transpose()?;
    let mut normals = normals.unwrap_or_default();
    morph(primitive, accessors, weights, &mut positions, &mut normals)?;
    normalize(&mut normals, &mut warnings);
    let uvs = uv_source
        .and_then(|source| Some((source, find(Semantic::TexCoords(source.set))?)))
        .map(|(source, i)| read_uvs(accessors, i, count, &source, &mut warnings))
        .transpose()?;
    if uv_source.is_some() && uvs.is_none() {
        warnings.push("has a texture but no texture coordinates; the texture is ignored".into());
    }
    let colors = find(Semantic::Colors(0)).map(|i| read_colors(accessors, i, count)).transpose()?;
    let (colors, alphas) = colors.unwrap_or_default();
    let mesh = Mesh {
        positions,
        normals,
        uvs: uvs.unwrap_or_default(),
        colors,
        alphas,
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

/// Positions, which need not be finite where nothing uses them.
fn read_positions(accessors: Accessors, index: usize) -> Result<Vec<Vec3>, String> {
    let read = accessors.read_vectors::<3>(index, &[Type::Vec3], 0.0);
    let positions = read.map_err(|e| format!("POSITION: {e}"))?;
    Ok(positions.into_iter().map(Vec3::from_array).collect())
}

/// Checks that all positions that triangles use are finite.
pub(super) fn check_positions(mesh: &Mesh) -> Result<(), String> {
    let mut used = mesh.triangles.iter().flatten();
    match used.find(|&&v| !mesh.positions[v as usize].is_finite()) {
        Some(bad) => Err(format!("position of vertex {bad} is not finite")),
        None => Ok(()),
    }
}

fn read_normals(accessors: Accessors, index: usize, count: usize) -> Result<Vec<Vec3>, String> {
    let read = accessors.read_vectors::<3>(index, &[Type::Vec3], 0.0);
    let normals = read.map_err(|e| format!("NORMAL: {e}"))?;
    check_count("NORMAL", normals.len(), count)?;
    Ok(normals.into_iter().map(Vec3::from_array).collect())
}

/// Gives normals unit length; those without direction become 0, where the geometric normal serves.
fn normalize(normals: &mut [Vec3], warnings: &mut Vec<String>) {
    let mut zero_count = 0;
    for normal in normals {
        *normal = normal.try_normalize().unwrap_or(Vec3::ZERO);
        zero_count += usize::from(*normal == Vec3::ZERO);
    }
    if zero_count > 0 {
        warnings.push(format!(
            "has {zero_count} normals without direction; those of their faces are used there"
        ));
    }
}

/// Adds the weighted morph targets (§ 3.7.2.2 of the specification).
fn morph(
    primitive: &gltf::Primitive,
    accessors: Accessors,
    weights: &[f32],
    positions: &mut [Vec3],
    normals: &mut [Vec3],
) -> Result<(), String> {
    for (k, (target, &weight)) in primitive.morph_targets().zip(weights).enumerate() {
        if weight == 0.0 {
            continue;
        }
        let add = |name: &str, index: Option<usize>, values: &mut [Vec3]| {
            let Some(index) = index.filter(|_| !values.is_empty()) else { return Ok(()) };
            let place = format!("{name} of morph target {k}");
            let read = accessors.read_vectors::<3>(index, &[Type::Vec3], 0.0);
            let offsets = read.map_err(|e| format!("{place}: {e}"))?;
            check_count(&place, offsets.len(), values.len())?;
            for (value, offset) in values.iter_mut().zip(offsets) {
                *value += Vec3::from_array(offset) * weight;
            }
            Ok::<_, String>(())
        };
        add("POSITION", target.positions().map(|a| a.index()), positions)?;
        add("NORMAL", target.normals().map(|a| a.index()), normals)?;
    }
    Ok(())
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

/// Linear colors, and alphas where one is below 1.
type Colors = (Vec<[f32; 3]>, Vec<f32>);

fn read_colors(accessors: Accessors, index: usize, count: usize) -> Result<Colors, String> {
    // Integers are shares of their range, even where the file forgets to say so.
    let read = accessors.read_shares::<4>(index, &[Type::Vec3, Type::Vec4], 1.0);
    let colors = read.map_err(|e| format!("COLOR_0: {e}"))?;
    check_count("COLOR_0", colors.len(), count)?;
    let clamp = |c: f32| if c.is_finite() { c.clamp(0.0, 1.0) } else { 1.0 };
    let is_opaque = colors.iter().all(|rgba| clamp(rgba[3]) == 1.0);
    let alphas = colors.iter().filter(|_| !is_opaque).map(|rgba| clamp(rgba[3])).collect();
    Ok((colors.into_iter().map(|[r, g, b, _]| [r, g, b].map(clamp)).collect(), alphas))
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
