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

/// Points that a transform brings to the surfels span at least this share of the octree's diagonal then: small factors bring any point near
/// the origin, and what surfels are there.
const SPAN_SHARE: f64 = 1.0 / 32.0;

/// Points are elsewhere if they lie outside the octree's box by more than so many times its diagonal.
const ELSEWHERE: f64 = 10.0;

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

impl Cure {
    /// What the transform tells of the receivers.
    pub fn causes(&self) -> String {
        let up = self.up.map(|up| format!("+{} is up in it", letter(up).to_ascii_uppercase()));
        let unit =
            (self.scale != 1.0).then(|| format!("its unit is {} of the octree's", self.scale));
        up.into_iter().chain(unit).collect::<Vec<_>>().join(" and ")
    }

    /// How to carry it out on coordinates.
    fn instructions(&self) -> String {
        let vector = match self.up {
            Some(UpAxis::Z) => "(x, z, -y)",
            Some(UpAxis::Y) => "(x, -z, y)",
            None => "(x, y, z)",
        };
        let factor =
            if self.scale == 1.0 { String::new() } else { format!("{} times ", self.scale) };
        let normals = self.up.map(|_| format!(", and {vector} as normal")).unwrap_or_default();
        format!("give {factor}{vector} as position{normals}")
    }
}

/// How an axis is called.
pub(crate) fn letter(up: UpAxis) -> char {
    if up == UpAxis::Y { 'y' } else { 'z' }
}

impl FarReceivers {
    /// What to say of points, called `name`, that a mistake of axes or units keeps from the surfels, or that are elsewhere altogether. Other
    /// points may be in the air: they are measured, not seen.
    pub fn warn_of_points(
        octree: &Octree,
        name: &str,
        places: &[DVec3],
    ) -> Result<Option<String>, PbgiError> {
        let Some(Self { sample, far, cure }) = Self::find(octree, places, &DMat4::IDENTITY)? else {
            return Ok(None);
        };
        let bounds = octree.header().bounds;
        let diagonal = f64::from((bounds.max - bounds.min).length());
        let text =
            format!("{name}: {far} of {sample} receivers looked at are far from all surfels");
        if let Some(cure) = cure.filter(|cure| cure.scale * span(places) >= SPAN_SHARE * diagonal) {
            return Ok(Some(format!(
                "{text}; {} of them are near if {}: {}",
                cure.near,
                cure.causes(),
                cure.instructions()
            )));
        }
        let origin = octree.header().origin;
        let is_elsewhere = |place: &&DVec3| {
            let place = **place - origin;
            let inside = place.clamp(bounds.min.as_dvec3(), bounds.max.as_dvec3());
            inside.distance(place) > ELSEWHERE * diagonal
        };
        let elsewhere = places.iter().filter(is_elsewhere).count();
        Ok((2 * elsewhere > places.len()).then(|| {
            format!("{text}, most by more than ten times the octree's size; check that they belong to its scene")
        }))
    }

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

/// Diagonal of the box around places.
fn span(places: &[DVec3]) -> f64 {
    let min = places.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let max = places.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    min.distance(max)
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
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    /// An octree of a street, and the places of its surfels.
    fn street(folder: &Path) -> (Octree, Vec<DVec3>) {
        let output = folder.join("s.pbgi");
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
        (octree, places)
    }

    /// Surfels of a scene, led away by another axis up or another unit, are found to be so.
    #[test]
    fn axes_and_units_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let (octree, places) = street(folder.path());
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
    fn misplaced_points_are_warned_of_and_points_in_the_air_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let (octree, places) = street(folder.path());
        let warn = |change: &dyn Fn(DVec3) -> DVec3| {
            let places: Vec<DVec3> = places.iter().map(|place| change(*place)).collect();
            FarReceivers::warn_of_points(&octree, "p.ply", &places).unwrap()
        };
        assert_eq!(warn(&|p| p), None);
        let text = warn(&|p| 100.0 * DVec3::new(p.x, -p.z, p.y)).unwrap();
        let expected = "p.ply: 64 of 64 receivers looked at are far from all surfels; 64 of them are near if +Z is up in it \
                        and its unit is 0.01 of the octree's: give 0.01 times (x, z, -y) as position, and (x, z, -y) as normal";
        assert_eq!(text, expected);
        let text = warn(&|p| 100.0 * p).unwrap();
        assert!(text.ends_with(": give 0.01 times (x, y, z) as position"), "{text}");
        // Above the ground that the origin lies on: a thousandth of them would be on it.
        let above = |p: DVec3| DVec3::new(p.x, 3.0 + 5.0 * (p.x * 7.0).sin().abs(), p.z);
        let diagonal = f64::from(octree.header().bounds.max.distance(octree.header().bounds.min));
        assert_eq!(warn(&|p| above(p) + DVec3::Y * diagonal), None);
        let text = warn(&|p| p + DVec3::new(5e5, 0.0, 4e6)).unwrap();
        assert!(text.contains("64 of 64") && text.contains("belong to its scene"), "{text}");
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
