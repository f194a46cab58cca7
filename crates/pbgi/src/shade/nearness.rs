//! Whether receivers lie on the surfels of an octree, and what is likely wrong where they do not: another axis up, another unit.

use crate::PbgiError;
use pbgi_format::LeafSurfel;
use pbgi_light::UpAxis;
use pbgi_math::{DMat4, DVec3, Vec3};
use pbgi_store::{LeafWalk, Octree, Reader};

/// Receivers that are looked at.
const SAMPLE_RECEIVERS: usize = 64;

/// A receiver is near a surfel within so many times the typical distance of surfels of its plane, and within as much, or 1.5 of its radii, of its center.
const REACH: f32 = 1.5;

/// Factors from the units of receivers to those of an octree that people meet: centimeters, millimeters, inches and feet against
/// meters, and back.
const SCALES: [f64; 9] =
    [1.0, 0.01, 100.0, 0.001, 1000.0, 0.0254, 1.0 / 0.0254, 0.3048, 1.0 / 0.3048];

/// Receivers that are not where the surfels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FarReceivers {
    /// Receivers looked at.
    pub sample: usize,
    /// How many of them are far from every surfel.
    pub far: usize,
    /// What would bring them to the surfels.
    pub cure: Option<Cure>,
}

/// A transform that brings receivers to the surfels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cure {
    /// The axis that is up where they come from, if not that of the octree.
    pub up: Option<UpAxis>,
    /// Factor from their units to the octree's.
    pub scale: f64,
    /// How many of the sample are near a surfel then.
    pub near: usize,
}

/// From coordinates with `from` up to those with `to` up, in units that are so many of theirs.
pub(crate) fn placement(from: UpAxis, to: UpAxis, scale: f64) -> DMat4 {
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z];
    let axes = match (from, to) {
        (UpAxis::Z, UpAxis::Y) => [x, -z, y],
        (UpAxis::Y, UpAxis::Z) => [x, z, -y],
        _ => [x, y, z],
    };
    let [x, y, z] = axes.map(|axis| (axis * scale).extend(0.0));
    DMat4::from_cols(x, y, z, DVec3::ZERO.extend(1.0))
}

impl FarReceivers {
    /// Looks at some of the receivers at `places` of their own world, which `to_octree` is meant to lead to the octree's; nothing where
    /// most of them are near surfels.
    pub fn find(
        octree: &Octree,
        places: &[DVec3],
        to_octree: &DMat4,
    ) -> Result<Option<Self>, PbgiError> {
        let wanted = SAMPLE_RECEIVERS.min(places.len());
        let sample: Vec<DVec3> =
            (0..wanted).map(|i| places[(2 * i + 1) * places.len() / (2 * wanted)]).collect();
        let up = if octree.header().flags.z_up { UpAxis::Z } else { UpAxis::Y };
        let near = count_near(octree, &sample, to_octree)?;
        if 2 * near >= sample.len() {
            return Ok(None);
        }
        let other = if up == UpAxis::Y { UpAxis::Z } else { UpAxis::Y };
        let mut cure: Option<Cure> = None;
        for scale in SCALES {
            for from in [up, other] {
                let near = count_near(octree, &sample, &placement(from, up, scale))?;
                let best = cure.map_or(sample.len() * 3 / 4, |cure| cure.near);
                if near > best {
                    cure = Some(Cure { up: (from != up).then_some(from), scale, near });
                }
            }
        }
        Ok(Some(Self { sample: sample.len(), far: sample.len() - near, cure }))
    }
}

/// How many of `places` are near a surfel after `transform`.
fn count_near(octree: &Octree, places: &[DVec3], transform: &DMat4) -> Result<usize, PbgiError> {
    let (mut near, mut reader) = (0, octree.reader());
    for place in places {
        let place = transform.transform_point3(*place) - octree.header().origin;
        near += usize::from(is_near(octree, &mut reader, place.as_vec3())?);
    }
    Ok(near)
}

fn is_near(octree: &Octree, reader: &mut Reader<'_>, place: Vec3) -> Result<bool, PbgiError> {
    let reach = REACH * octree.header().spacing;
    let mut walk = LeafWalk::near(octree, place, reach);
    while let Some((_, surfels)) = walk.next_leaf(reader)? {
        let brings_near = |s: &LeafSurfel| {
            let apart = place - s.center;
            let height = if s.isotropic { 0.0 } else { s.normal.dot(apart) };
            let across2 = apart.length_squared() - height * height;
            height.abs() <= reach && across2 <= reach.max(1.5 * s.radius).powi(2)
        };
        if surfels.iter().any(brings_near) {
            return Ok(true);
        }
    }
    Ok(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BakeRequest, Progress, Sampling, bake};
    use pbgi_store::{OpenOptions, try_for_each_leaf};
    use std::sync::atomic::AtomicBool;

    /// Surfels of a scene, led away by another axis up or another unit, are found to be so.
    #[test]
    fn axes_and_units_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("s.pbgi");
        let request = BakeRequest {
            inputs: vec!["demo:street?seed=1".into()],
            output: output.clone(),
            sampling: Sampling::Surfels(20_000),
            ..BakeRequest::default()
        };
        bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
        let octree = Octree::open(&output, &OpenOptions::default()).unwrap();
        let mut places = Vec::new();
        try_for_each_leaf(&mut octree.reader(), |_, surfels| {
            places.extend(surfels.iter().map(|s| s.center.as_dvec3() + octree.header().origin));
            Ok::<(), PbgiError>(())
        })
        .unwrap();
        let find = |up: UpAxis, scale: f64| {
            let away = placement(UpAxis::Y, up, 1.0 / scale);
            let places: Vec<DVec3> = places.iter().map(|p| away.transform_point3(*p)).collect();
            FarReceivers::find(&octree, &places, &DMat4::IDENTITY).unwrap()
        };
        assert_eq!(find(UpAxis::Y, 1.0), None);
        for (up, scale) in [(UpAxis::Z, 1.0), (UpAxis::Y, 0.01), (UpAxis::Z, 0.01)] {
            let found = find(up, scale).unwrap_or_else(|| panic!("{up:?} {scale}"));
            let other = (up != UpAxis::Y).then_some(up);
            assert_eq!(found.cure, Some(Cure { up: other, scale, near: 64 }), "{found:?}");
        }
        let elsewhere: Vec<DVec3> =
            places.iter().map(|p| *p + DVec3::new(1e3, 7e4, -3e5)).collect();
        let found = FarReceivers::find(&octree, &elsewhere, &DMat4::IDENTITY).unwrap();
        assert_eq!(found, Some(FarReceivers { sample: 64, far: 64, cure: None }));
        assert_eq!(FarReceivers::find(&octree, &[], &DMat4::IDENTITY).unwrap(), None);
    }

    #[test]
    fn up_stays_up() {
        for (from, to) in [(UpAxis::Y, UpAxis::Z), (UpAxis::Z, UpAxis::Y)] {
            let axis = |up: UpAxis| if up == UpAxis::Y { DVec3::Y } else { DVec3::Z };
            let there = placement(from, to, 2.0);
            assert_eq!(there.transform_vector3(axis(from)), 2.0 * axis(to));
            assert_eq!(there.transform_vector3(DVec3::X), 2.0 * DVec3::X);
            assert_eq!(there.determinant(), 8.0);
            assert_eq!(placement(to, from, 0.5) * there, DMat4::IDENTITY);
        }
    }
}
