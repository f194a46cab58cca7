//! A raster of given directions, as dense as light from there counts: for reflections.

use crate::lanes::{Lanes, SAMPLES};
use crate::samples::Veil;
use crate::shape::Shape;
use pbgi_math::Vec3;

/// How a piece covers and shines in a [`LobeRaster`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeInk {
    /// The directions it covers among those it meets.
    pub veil: Veil,
    /// Surfaces nearer by no more than this share of the distance are its own neighbors, and do not hide it.
    pub tolerance: f32,
    /// Radiance toward the receiver in the directions it covers; 0 for a piece that shines by `reflected`.
    pub radiance: [f32; 3],
    /// What the receiver reflects of all of the piece's light if nothing hides it; 0 for a piece that shines by `radiance`.
    pub reflected: [f32; 3],
}

impl LobeInk {
    fn is_whole(&self) -> bool {
        self.reflected != [0.0; 3]
    }
}

/// Directions around a receiver, in groups of sixteen neighbors, with what covers each: its depth and its radiance.
///
/// Pieces arrive nearest first, or nearly. A direction is covered by the first piece that meets it. A piece small beside the
/// gaps between directions shines by its own solid angle, times the share of the directions it meets that nothing hides.
#[derive(Clone, Debug, Default)]
pub struct LobeRaster {
    directions: Vec<[[f32; SAMPLES]; 3]>,
    /// Directions that are covered, and those not in use.
    covered: Vec<u16>,
    used: Vec<u16>,
    /// Inverse distance of what covers each direction.
    depths: Vec<[f32; SAMPLES]>,
    radiance: Vec<[[f32; SAMPLES]; 3]>,
    /// Cones around the groups, sixteen groups at a time: axes, cosines and sines of half-angles.
    cones: Vec<[[f32; SAMPLES]; 5]>,
    /// Groups with open directions.
    open: Vec<u16>,
    /// Sum over the pieces that shine by their own solid angle.
    reflected: [f32; 3],
    /// Groups that what lies in the box asked about last may meet.
    met: Vec<u16>,
}

impl LobeRaster {
    /// Empties the raster for these unit directions; bits of `used` tell which of each group count.
    #[inline(always)]
    pub fn clear(&mut self, directions: &[[[f32; SAMPLES]; 3]], used: &[u16]) {
        let groups = directions.len();
        self.directions.clear();
        self.directions.extend_from_slice(directions);
        self.used.clear();
        self.used.extend_from_slice(used);
        self.covered.clear();
        self.covered.extend(used.iter().map(|used| !used));
        self.depths.resize(groups, [0.0; SAMPLES]);
        self.radiance.resize(groups, [[0.0; SAMPLES]; 3]);
        for (depths, radiance) in self.depths.iter_mut().zip(&mut self.radiance) {
            *depths = [0.0; SAMPLES];
            *radiance = [[0.0; SAMPLES]; 3];
        }
        self.reflected = [0.0; 3];
        let sets = groups.div_ceil(SAMPLES);
        self.cones.clear();
        // Groups there are none of meet nothing: no cosine reaches 2.
        self.cones.resize(
            sets,
            [[0.0; SAMPLES], [0.0; SAMPLES], [0.0; SAMPLES], [2.0; SAMPLES], [0.0; SAMPLES]],
        );
        self.open.clear();
        self.open.resize(sets, 0);
        self.met.clear();
        self.met.resize(sets, 0);
        for (group, (d, used)) in directions.iter().zip(used).enumerate() {
            let (set, lane) = (group / SAMPLES, group % SAMPLES);
            if *used == 0 {
                continue;
            }
            let (axis, cosine) = bound(d, *used);
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            let cone = [axis.x, axis.y, axis.z, cosine, sine];
            for (plane, value) in self.cones[set].iter_mut().zip(cone) {
                plane[lane] = value;
            }
            self.open[set] |= 1 << lane;
        }
    }

    /// Finds the groups that the box `low..=high`, relative to the receiver, may meet, and tells whether any of them is open.
    #[must_use]
    #[inline(always)]
    pub fn is_open<L: Lanes>(&mut self, low: Vec3, high: Vec3) -> bool {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let (distance2, radius2) = (center.length_squared(), half.length_squared());
        if distance2 <= radius2 {
            // The receiver may be inside.
            self.met.fill(u16::MAX);
            return self.open.iter().any(|open| *open != 0);
        }
        // Cosine of the sum of half-angles, times the distance: cones meet where the angle between their axes is no larger.
        let (along, across) = ((distance2 - radius2).sqrt(), radius2.sqrt());
        let mut any = 0;
        for ((met, open), cone) in self.met.iter_mut().zip(&self.open).zip(&self.cones) {
            let [x, y, z, cosine, sine] = cone;
            let dot = L::load(x)
                .mul(L::splat(center.x))
                .add(L::load(y).mul(L::splat(center.y)))
                .add(L::load(z).mul(L::splat(center.z)));
            let limit =
                L::load(cosine).mul(L::splat(along)).sub(L::load(sine).mul(L::splat(across)));
            *met = L::bits(limit.le(dot));
            any |= *met & open;
        }
        any != 0
    }

    /// Draws a shape into the groups found by the last [`Self::is_open`]; `toward` leads to its middle.
    #[inline(always)]
    pub fn draw<L: Lanes, S: Shape>(&mut self, shape: &S, ink: &LobeInk, toward: Vec3) {
        let inverse = shape.inverse();
        let nearer = L::splat(1.0 + ink.tolerance);
        let (mut met_count, mut visible_count) = (0, 0);
        for set in 0..self.met.len() {
            // A piece that shines by its own solid angle wants to know how much of it is hidden.
            let mut rest =
                if ink.is_whole() { self.met[set] } else { self.met[set] & self.open[set] };
            while rest != 0 {
                let lane = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let group = set * SAMPLES + lane;
                if group >= self.directions.len() {
                    break;
                }
                let d = &self.directions[group];
                let d = [L::load(&d[0]), L::load(&d[1]), L::load(&d[2])];
                let w = d[0]
                    .mul(L::splat(inverse.x))
                    .add(d[1].mul(L::splat(inverse.y)))
                    .add(d[2].mul(L::splat(inverse.z)));
                let met = shape.meets(d, w) & self.used[group];
                if met == 0 {
                    continue;
                }
                let before = self.covered[group];
                let depths = &mut self.depths[group];
                if ink.is_whole() {
                    let hidden = before & L::bits(w.mul(nearer).le(L::load(depths)));
                    met_count += met.count_ones();
                    visible_count += (met & !hidden).count_ones();
                }
                let covered =
                    if ink.veil.is_opaque() { met } else { met & ink.veil.samples(group) };
                let new = covered & !before;
                if new == 0 {
                    continue;
                }
                w.store_where(new, depths);
                if ink.radiance != [0.0; 3] {
                    for (plane, light) in self.radiance[group].iter_mut().zip(ink.radiance) {
                        L::splat(light).store_where(new, plane);
                    }
                }
                self.covered[group] = before | new;
                if before | new == u16::MAX {
                    self.open[set] &= !(1 << lane);
                }
            }
        }
        if ink.is_whole() {
            if met_count == 0 {
                visible_count = u32::from(self.is_seen(shape.inverse(), ink.tolerance, toward));
                met_count = 1;
            }
            let share = visible_count as f32 / met_count as f32;
            for (sum, light) in self.reflected.iter_mut().zip(ink.reflected) {
                *sum += share * light;
            }
        }
    }

    /// Whether a piece that met no direction is seen: what covers the direction nearest to its middle, of the groups it may meet, tells.
    #[inline(always)]
    fn is_seen(&self, inverse: Vec3, tolerance: f32, toward: Vec3) -> bool {
        let (mut best, mut group_of_best, mut lane_of_best) = (f32::NEG_INFINITY, 0, 0);
        for set in 0..self.met.len() {
            let mut rest = self.met[set];
            while rest != 0 {
                let group = set * SAMPLES + rest.trailing_zeros() as usize;
                rest &= rest - 1;
                if group >= self.directions.len() {
                    break;
                }
                let (d, used) = (&self.directions[group], self.used[group]);
                for lane in 0..SAMPLES {
                    let dot = d[0][lane] * toward.x + d[1][lane] * toward.y + d[2][lane] * toward.z;
                    if dot > best && used >> lane & 1 != 0 {
                        (best, group_of_best, lane_of_best) = (dot, group, lane);
                    }
                }
            }
        }
        if best == f32::NEG_INFINITY || self.covered[group_of_best] >> lane_of_best & 1 == 0 {
            return best != f32::NEG_INFINITY;
        }
        let d = &self.directions[group_of_best];
        let d = Vec3::new(d[0][lane_of_best], d[1][lane_of_best], d[2][lane_of_best]);
        inverse.dot(d) * (1.0 + tolerance) > self.depths[group_of_best][lane_of_best]
    }

    /// Directions of a group that nothing covers.
    #[must_use]
    #[inline(always)]
    pub fn open_directions(&self, group: usize) -> u16 {
        !self.covered[group]
    }

    /// Radiance of what covers the directions of a group, per channel.
    #[must_use]
    #[inline(always)]
    pub fn radiance(&self, group: usize) -> &[[f32; SAMPLES]; 3] {
        &self.radiance[group]
    }

    /// What the receiver reflects of pieces that shine by their own solid angle.
    #[must_use]
    #[inline(always)]
    pub fn reflected(&self) -> [f32; 3] {
        self.reflected
    }
}

/// Axis and cosine of the half-angle of a cone around the directions of a group that are in use.
#[inline(always)]
fn bound(d: &[[f32; SAMPLES]; 3], used: u16) -> (Vec3, f32) {
    let at = |lane: usize| Vec3::new(d[0][lane], d[1][lane], d[2][lane]);
    let lanes = || (0..SAMPLES).filter(|lane| used >> lane & 1 != 0);
    let sum: Vec3 = lanes().map(at).sum();
    let axis = sum.normalize_or(Vec3::Z);
    let cosine = lanes().map(|lane| at(lane).dot(axis)).fold(1f32, f32::min);
    // A little wider than rounding may need.
    (axis, cosine - 1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Disk;
    use crate::lanes::Plain;

    /// Four groups of directions in a band around +z.
    fn raster() -> LobeRaster {
        let direction = |i: usize| {
            let (x, y) = ((i % 8) as f32 * 0.05 - 0.175, (i / 8) as f32 * 0.05 - 0.175);
            Vec3::new(x, y, 1.0).normalize()
        };
        let group = |g: usize| {
            std::array::from_fn(|axis| std::array::from_fn(|i| direction(g * SAMPLES + i)[axis]))
        };
        let mut raster = LobeRaster::default();
        raster.clear(&[group(0), group(1), group(2), group(3)], &[u16::MAX; 4]);
        raster
    }

    fn disk(x: f32, z: f32, radius: f32) -> Disk {
        let center = Vec3::new(x, 0.0, z);
        Disk { inverse: Vec3::NEG_Z / -z, center, radius, distance_min: 0.0 }
    }

    fn draw(raster: &mut LobeRaster, disk: Disk, ink: &LobeInk) {
        assert!(raster.is_open::<Plain>(disk.center - disk.radius, disk.center + disk.radius));
        raster.draw::<Plain, _>(&disk, ink, disk.center);
    }

    fn open(raster: &LobeRaster) -> u32 {
        (0..4).map(|g| raster.open_directions(g).count_ones()).sum()
    }

    #[test]
    fn the_first_piece_covers_and_later_ones_do_not() {
        let mut raster = raster();
        let ink = |radiance| LobeInk {
            veil: Veil::OPAQUE,
            radiance: [radiance; 3],
            ..LobeInk::default()
        };
        draw(&mut raster, disk(-5.0, 1.0, 5.0), &ink(2.0));
        assert_eq!(open(&raster), 32);
        draw(&mut raster, disk(0.0, 2.0, 9.0), &ink(3.0));
        assert_eq!(open(&raster), 0);
        let sum: f32 = (0..4).flat_map(|g| raster.radiance(g)[0]).sum();
        assert_eq!(sum, 32.0 * 5.0);
        assert!(!raster.is_open::<Plain>(Vec3::new(-1.0, -1.0, 3.0), Vec3::new(1.0, 1.0, 3.1)));
    }

    #[test]
    fn small_pieces_shine_by_their_own_light_unless_hidden() {
        let mut raster = raster();
        let lamp = LobeInk { veil: Veil::OPAQUE, reflected: [0.5; 3], ..LobeInk::default() };
        // Between directions, before and then behind a screen that covers half.
        draw(&mut raster, disk(-0.05, 1.0, 0.001), &lamp);
        assert_eq!((raster.reflected(), open(&raster)), ([0.5; 3], 64));
        let screen = LobeInk { veil: Veil::OPAQUE, ..LobeInk::default() };
        draw(&mut raster, disk(-5.0, 1.0, 5.0), &screen);
        draw(&mut raster, disk(-0.1, 2.0, 0.001), &lamp);
        assert_eq!(raster.reflected(), [0.5; 3]);
        // One that meets four directions of which two are hidden.
        draw(&mut raster, disk(0.0, 2.0, 0.08), &lamp);
        assert_eq!(raster.reflected(), [0.75; 3]);
    }

    #[test]
    fn boxes_elsewhere_are_not_open_and_those_around_the_receiver_are() {
        let mut raster = raster();
        for center in [Vec3::NEG_Z, Vec3::X * 3.0, Vec3::new(2.0, 0.0, 3.0)] {
            assert!(!raster.is_open::<Plain>(center - 0.1, center + 0.1), "{center}");
        }
        assert!(raster.is_open::<Plain>(Vec3::splat(-1.0), Vec3::ONE));
        assert!(raster.is_open::<Plain>(Vec3::new(0.2, -0.1, 1.0), Vec3::new(0.5, 0.1, 1.2)));
    }
}
