//! What shines brightly around a receiver, whether or not anything hides it: what may be cut is looked at through a window.

use crate::primitive::surfel_solid_angle;
use pbgi_cut::{Cluster, CutVisitor, Kept, NodeSeen, SurfelSeen, Threshold};
use pbgi_math::{Vec3, larger, sphere_sin2_for_solid_angle};
use pbgi_raster::{LAMPS, NO_LAMP};

/// Brightness over what is usual from which on a surface is a lamp.
const LAMP_BRIGHTNESS: f32 = 4.0;

/// Largest solid angle of a node that is taken as a part of a lamp, in steradians.
const PART_SR: f32 = 0.03;

/// Squared sine of the half-angle of nodes that are looked into whatever their brightness: what stands for a large node is a mean, and lamps in it
/// are near.
const NEAR_SIN2: f32 = 0.25;

/// Width of the gap between two parts of one lamp, over the extent of the smaller.
const PART_GAP: f32 = 0.5;

/// Share of a lamp's extent by which its parts may lie beside it, as those that have been found are not those that are drawn.
const PLACE_SLACK: f32 = 0.1;

/// Bright surfaces that touch each other, or nearly.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Lamp {
    /// Corners of its box, relative to the receiver.
    pub low: Vec3,
    pub high: Vec3,
    /// Irradiance from it, if nothing hid it; W·m⁻².
    pub irradiance: [f32; 3],
}

impl Lamp {
    /// Whether another is a part of the same lamp.
    fn is_with(&self, other: &Self) -> bool {
        let gap = (self.low - other.high).max(other.low - self.high).max(Vec3::ZERO);
        let extent = |lamp: &Self| (lamp.high - lamp.low).max_element();
        gap.length() <= PART_GAP * extent(self).min(extent(other))
    }

    fn join(&mut self, other: &Self) {
        (self.low, self.high) = (self.low.min(other.low), self.high.max(other.high));
        for (sum, light) in self.irradiance.iter_mut().zip(other.irradiance) {
            *sum += light;
        }
    }

    /// How far away any of it is, at most.
    pub fn farthest(&self) -> f32 {
        self.low.abs().max(self.high.abs()).length()
    }

    fn strength(&self) -> f32 {
        largest(self.irradiance)
    }
}

/// The lamps around a receiver.
#[derive(Clone, Debug)]
pub(crate) struct Lamps {
    /// Those that have a number, in its order.
    numbered: Vec<Lamp>,
    /// Radiance from which on surfaces are lamps, of the brightest channel; W·m⁻²·sr⁻¹.
    pub least: f32,
}

impl Lamps {
    /// No lamps.
    pub fn new() -> Self {
        Self { numbered: Vec::with_capacity(LAMPS), least: 0.0 }
    }

    /// Forgets all lamps; surfaces are lamps where they are much brighter than `usual`.
    pub fn clear(&mut self, usual: f32) {
        self.least = if usual > 0.0 { LAMP_BRIGHTNESS * usual } else { f32::INFINITY };
        self.numbered.clear();
    }

    /// Adds a part to the lamps it touches, which are one from then on, or as another. When all numbers are taken, the weakest lamp has none.
    fn add(&mut self, part: &Lamp) {
        let mut lamp = *part;
        let mut number = 0;
        while number < self.numbered.len() {
            if self.numbered[number].is_with(&lamp) {
                lamp.join(&self.numbered.swap_remove(number));
                // The larger one may touch those before.
                number = 0;
            } else {
                number += 1;
            }
        }
        if self.numbered.len() < usize::from(NO_LAMP) {
            self.numbered.push(lamp);
            return;
        }
        let weaker = |a: &&mut Lamp, b: &&mut Lamp| a.strength().total_cmp(&b.strength());
        if let Some(weakest) = self.numbered.iter_mut().min_by(weaker)
            && weakest.strength() < lamp.strength()
        {
            *weakest = lamp;
        }
    }

    /// Lamps that have a number, in its order.
    pub fn numbered(&self) -> &[Lamp] {
        &self.numbered
    }

    /// Number of the lamp at a place, relative to the receiver.
    #[inline(always)]
    pub fn number_at(&self, place: Vec3) -> u8 {
        for (number, lamp) in self.numbered.iter().enumerate() {
            let slack = (lamp.high - lamp.low) * PLACE_SLACK;
            if place.cmpge(lamp.low - slack).all() && place.cmple(lamp.high + slack).all() {
                return number as u8;
            }
        }
        NO_LAMP
    }
}

/// Whether lamps of this radiance or more may lie in a node.
#[inline(always)]
pub(crate) fn may_hold_lamps(node: &NodeSeen, least: f32) -> bool {
    node.brightness >= least || node.radius2 > NEAR_SIN2 * node.distance2
}

/// Nodes that may be lamps, no larger than parts of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LampThreshold {
    sin2_max: f32,
    least: f32,
}

impl LampThreshold {
    pub fn new(lamps: &Lamps) -> Self {
        Self { sin2_max: sphere_sin2_for_solid_angle(PART_SR), least: lamps.least }
    }
}

impl Threshold for LampThreshold {
    #[inline(always)]
    fn sin2_max(&self, _: &NodeSeen) -> f32 {
        self.sin2_max
    }

    #[inline(always)]
    fn is_wanted(&self, node: &NodeSeen) -> bool {
        may_hold_lamps(node, self.least)
    }
}

/// Collects lamps.
pub(crate) struct LampVisitor<'a> {
    pub lamps: &'a mut Lamps,
    /// Of the receiver.
    pub normal: Vec3,
}

impl LampVisitor<'_> {
    /// Adds what shines in a box, whose middle is `toward`, if it is a lamp.
    #[inline(always)]
    fn add(&mut self, [low, high]: [Vec3; 2], toward: Vec3, solid_angle: f32, radiance: [f32; 3]) {
        let weight = solid_angle * larger(self.normal.dot(toward) / toward.length(), 0.0);
        self.lamps.add(&Lamp { low, high, irradiance: radiance.map(|light| light * weight) });
    }
}

impl CutVisitor for LampVisitor<'_> {
    #[inline(always)]
    fn is_open(&mut self, _: Vec3, _: Vec3, _: Kept) -> bool {
        true
    }

    #[inline(always)]
    fn take_cluster(&mut self, cluster: &Cluster) {
        let (bounds, toward) = ([cluster.low, cluster.high], (cluster.low + cluster.high) * 0.5);
        for piece in cluster.pieces() {
            if is_lamp(piece.radiance, self.lamps.least) {
                self.add(bounds, toward, piece.solid_angle, piece.radiance);
            }
        }
    }

    #[inline(always)]
    fn take_surfel(&mut self, seen: &SurfelSeen<'_>) {
        let surfel = seen.surfel;
        let is_seen = surfel.isotropic || surfel.normal.dot(seen.center) < 0.0;
        if is_seen && is_lamp(surfel.radiance, self.lamps.least) {
            self.add(seen.bounds(), seen.center, surfel_solid_angle(seen), surfel.radiance);
        }
    }

    #[inline(always)]
    fn minds_order(&self) -> bool {
        false
    }
}

/// Whether what has this radiance is a lamp, where lamps have at least so much of it.
#[inline(always)]
pub(crate) fn is_lamp(radiance: [f32; 3], least: f32) -> bool {
    largest(radiance) >= least
}

#[inline(always)]
fn largest(radiance: [f32; 3]) -> f32 {
    radiance[0].max(radiance[1]).max(radiance[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(x: f32, size: f32, light: f32) -> Lamp {
        let low = Vec3::new(x, 5.0, 0.0);
        Lamp { low, high: low + Vec3::new(size, 0.0, size), irradiance: [light; 3] }
    }

    #[test]
    fn parts_that_touch_are_one_lamp() {
        let mut lamps = Lamps::new();
        lamps.clear(1.0);
        // The third closes the gap between the first two, the last stands apart.
        for (x, light) in [(0.0, 1.0), (2.5, 2.0), (1.2, 4.0), (9.0, 8.0)] {
            lamps.add(&part(x, 1.0, light));
        }
        let [one, other] = lamps.numbered() else { panic!("{:?}", lamps.numbered()) };
        assert_eq!((one.low.x, one.high.x, one.irradiance), (0.0, 3.5, [7.0; 3]));
        assert_eq!((other.low.x, other.irradiance), (9.0, [8.0; 3]));
        assert_eq!(lamps.number_at(Vec3::new(1.8, 5.0, 0.5)), 0);
        assert_eq!(lamps.number_at(Vec3::new(9.9, 5.0, 0.1)), 1);
        assert_eq!(lamps.number_at(Vec3::new(6.0, 5.0, 0.5)), NO_LAMP);
        // The small one is too far from the first, but what it makes of the second is not.
        lamps.clear(1.0);
        for (x, size) in [(0.0, 1.0), (1.55, 1.0), (1.3, 0.2)] {
            lamps.add(&part(x, size, 1.0));
        }
        assert!(matches!(lamps.numbered(), [whole] if whole.irradiance == [3.0; 3]));
        lamps.clear(2.0);
        assert!(lamps.numbered().is_empty() && lamps.least == 2.0 * LAMP_BRIGHTNESS);
    }

    #[test]
    fn the_strongest_lamps_have_numbers() {
        let mut lamps = Lamps::new();
        let lights = (0..3 * LAMPS).map(|i| (i * 7 % (3 * LAMPS)) as f32);
        for (i, light) in lights.enumerate() {
            lamps.add(&part(3.0 * i as f32, 1.0, light));
        }
        let mut found: Vec<f32> = lamps.numbered().iter().map(Lamp::strength).collect();
        found.sort_by(f32::total_cmp);
        let strongest = (2 * LAMPS + 1..3 * LAMPS).map(|light| light as f32);
        assert_eq!(found, strongest.collect::<Vec<_>>());
    }
}
