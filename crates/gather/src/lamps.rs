//! Where bright surfaces lie around a receiver, whether or not anything hides them: what stands before them must be fine.

use crate::primitive::surfel_solid_angle;
use pbgi_cut::{Cluster, CutVisitor, Kept, NodeSeen, SurfelSeen, Threshold};
use pbgi_math::{CubeMap, Vec3, sphere_sin2_for_solid_angle};
use std::f32::consts::PI;

/// Texels along a face of the finest level.
const EDGE: usize = 8;

/// Levels: 8, 4, 2 and 1 texels along a face.
const LEVELS: usize = EDGE.trailing_zeros() as usize + 1;

/// Brightness over what is usual from which on a surface is a lamp.
const LAMP_BRIGHTNESS: f32 = 4.0;

/// A cube map at every coarseness of the light that lamps send to a receiver, and of how far away they are.
///
/// A texel's brightness is the sum over its lamps of radiance × solid angle, over the texel's own. It is kept for each texel as the largest
/// of its own and of the eight around it, on whichever face they lie, so that no lamp is lost between texels or levels.
#[derive(Clone, Debug)]
pub(crate) struct Lamps {
    levels: Vec<Level>,
    is_empty: bool,
    /// Radiance from which on surfaces are lamps, of the brightest channel; W·m⁻²·sr⁻¹.
    pub least: f32,
}

/// One level.
#[derive(Clone, Debug)]
struct Level {
    map: CubeMap,
    /// The texels around each, itself among them.
    around: Vec<[u16; 9]>,
    /// 1 over the solid angle of a texel, the mean of all; sr⁻¹.
    inverse_solid_angle: f32,
    /// Brightness and farthest distance of each texel's own lamps.
    own: Vec<[f32; 2]>,
    /// The largest of each among a texel and those around it.
    spread: Vec<[f32; 2]>,
}

impl Level {
    fn new(edge: usize) -> Self {
        let map = CubeMap::new(edge);
        let count = map.texel_count();
        let around = |index| map.around(index).map(|beside| beside as u16);
        Self {
            around: (0..count).map(around).collect(),
            inverse_solid_angle: count as f32 / (4.0 * PI),
            own: vec![[0.0; 2]; count],
            spread: vec![[0.0; 2]; count],
            map,
        }
    }
}

impl Lamps {
    /// No lamps.
    pub fn new() -> Self {
        let levels = (0..LEVELS).map(|level| Level::new(EDGE >> level)).collect();
        Self { levels, is_empty: true, least: 0.0 }
    }

    /// Forgets all lamps; surfaces are lamps where they are much brighter than `usual`.
    pub fn clear(&mut self, usual: f32) {
        self.least = LAMP_BRIGHTNESS * usual;
        if !self.is_empty {
            for level in &mut self.levels {
                level.own.fill([0.0; 2]);
                level.spread.fill([0.0; 2]);
            }
            self.is_empty = true;
        }
    }

    /// Adds a lamp in the direction `toward`, as long as it is far away, that shines by `light`, radiance × solid angle.
    #[inline(always)]
    fn add(&mut self, toward: Vec3, light: f32) {
        let distance = toward.length();
        for level in &mut self.levels {
            let own = &mut level.own[level.map.texel_index(toward)];
            own[0] += light * level.inverse_solid_angle;
            own[1] = own[1].max(distance);
        }
        self.is_empty = false;
    }

    /// Makes [`Self::behind`] right for all lamps added.
    pub fn finish(&mut self) {
        if self.is_empty {
            return;
        }
        for level in &mut self.levels {
            for (own, around) in level.own.iter().zip(&level.around) {
                if own[0] == 0.0 {
                    continue;
                }
                for beside in around {
                    let spread = &mut level.spread[usize::from(*beside)];
                    *spread = [spread[0].max(own[0]), spread[1].max(own[1])];
                }
            }
        }
    }

    /// Brightness of the lamps in and just beside the cone around a node, where any of them is farther away than its nearest point; as a
    /// mean over a texel as wide as the cone.
    #[inline(always)]
    pub fn behind(&self, node: &NodeSeen) -> f32 {
        if self.is_empty {
            return 0.0;
        }
        // A texel in the middle of a face spans 2/n; the cone twice its sine.
        let texels2 = node.radius2 / node.distance2 * (EDGE * EDGE) as f32;
        let level = if texels2 <= 1.0 {
            0
        } else if texels2 <= 4.0 {
            1
        } else if texels2 <= 16.0 {
            2
        } else {
            3
        };
        let level = &self.levels[level];
        let [brightness, distance] = level.spread[level.map.texel_index(node.to_center)];
        let reach = distance + node.radius2.sqrt();
        if node.distance2 <= reach * reach { brightness } else { 0.0 }
    }
}

/// Nodes that may be lamps, no larger than a texel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LampThreshold {
    sin2_max: f32,
    least: f32,
}

impl LampThreshold {
    pub fn new(lamps: &Lamps) -> Self {
        let texel_sr = 4.0 * PI / (6 * EDGE * EDGE) as f32;
        Self { sin2_max: sphere_sin2_for_solid_angle(texel_sr), least: lamps.least }
    }
}

impl Threshold for LampThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: &NodeSeen) -> f32 {
        self.sin2_max
    }

    #[inline(always)]
    fn is_wanted(&self, node: &NodeSeen) -> bool {
        node.brightness >= self.least
    }
}

/// Collects lamps.
pub(crate) struct LampVisitor<'a> {
    pub lamps: &'a mut Lamps,
}

impl CutVisitor for LampVisitor<'_> {
    #[inline(always)]
    fn is_open(&mut self, _: Vec3, _: Vec3, _: Kept) -> bool {
        true
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        for piece in cluster.pieces() {
            let brightness = largest(piece.radiance);
            if brightness >= self.lamps.least {
                let toward = (cluster.low + cluster.high) * 0.5;
                self.lamps.add(toward, brightness * piece.solid_angle);
            }
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen<'_>) {
        let surfel = seen.surfel;
        let brightness = largest(surfel.radiance);
        let is_seen = surfel.isotropic || surfel.normal.dot(seen.center) < 0.0;
        if brightness >= self.lamps.least && is_seen {
            let solid_angle = surfel_solid_angle(seen);
            self.lamps.add(seen.center, brightness * solid_angle);
        }
    }

    #[inline(always)]
    fn minds_order(&self) -> bool {
        false
    }
}

fn largest(radiance: [f32; 3]) -> f32 {
    radiance[0].max(radiance[1]).max(radiance[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::importance::tests::node;

    fn one_lamp(toward: Vec3, light: f32) -> Lamps {
        let mut lamps = Lamps::new();
        lamps.clear(1.0);
        lamps.add(toward, light);
        lamps.finish();
        lamps
    }

    #[test]
    fn a_lamp_counts_for_what_stands_before_it_and_for_nothing_else() {
        // In the middle of a face, in a corner of three, and on an edge.
        for toward in [Vec3::Z, Vec3::ONE, Vec3::new(1.0, 1.0, 0.2)] {
            let toward = toward.normalize() * 5.0;
            let lamps = one_lamp(toward, 0.5);
            for radius in [0.01, 0.3, 0.9] {
                let before = lamps.behind(&node(toward * 0.4, radius));
                // At least the mean over the texels around the node.
                let sr = PI * (radius / 2.0).powi(2);
                assert!(before > 0.5 / (64.0 * sr).max(0.1), "{toward} {radius}: {before}");
                assert_eq!(lamps.behind(&node(toward * 3.0, radius)), 0.0);
                assert_eq!(lamps.behind(&node(toward * -0.4, radius * 0.1)), 0.0);
            }
            // A little beside it, over whichever border, but not far.
            let aside = toward.any_orthonormal_vector();
            assert!(lamps.behind(&node(toward * 0.4 + aside * 0.1, 0.01)) > 1.0);
            assert_eq!(lamps.behind(&node(toward * 0.4 + aside * 1.5, 0.01)), 0.0);
        }
    }

    #[test]
    fn lamps_are_forgotten() {
        let mut lamps = one_lamp(Vec3::X, 1.0);
        lamps.clear(2.0);
        assert_eq!(lamps.behind(&node(Vec3::X * 0.5, 0.01)), 0.0);
        assert_eq!(lamps.least, 2.0 * LAMP_BRIGHTNESS);
        lamps.add(Vec3::Y, 1.0);
        lamps.finish();
        assert_eq!(lamps.behind(&node(Vec3::X * 0.5, 0.01)), 0.0);
        assert!(lamps.behind(&node(Vec3::Y * 0.5, 0.01)) > 0.0);
    }
}
