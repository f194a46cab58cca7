//! A raster of given directions, as dense as light from there counts: for reflections.

use crate::lanes::{Lanes, SAMPLES};
use crate::samples::Veil;
use crate::shape::{Rims, Shape};
use pbgi_math::Vec3;

/// How a piece covers and shines in a [`LobeRaster`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeInk {
    /// What share of each direction it meets it covers.
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

/// A direction is covered where less than this shows through.
const TRANSMITTANCE_MIN: f32 = 0.01;

/// Directions around a receiver, in groups of sixteen neighbors, with what covers each: its depth and its radiance.
///
/// Pieces arrive nearest first, or nearly. A direction is covered by the nearest opaque piece that meets it; what is translucent, or
/// a particle smaller than what the direction stands for, lets some of what comes later show through. A piece small beside the
/// gaps between directions shines by its own solid angle, times what shows through of the directions it meets.
#[derive(Clone, Debug, Default)]
pub struct LobeRaster {
    directions: Vec<[[f32; SAMPLES]; 3]>,
    /// Directions that are covered, and those not in use.
    covered: Vec<u16>,
    used: Vec<u16>,
    /// Directions in rims.
    rims: Vec<Rims>,
    /// Solid angle each direction stands for.
    solid_angles: Vec<[f32; SAMPLES]>,
    /// Inverse distance of what covers each direction.
    depths: Vec<[f32; SAMPLES]>,
    /// What shows through what is before that.
    transmittance: Vec<[f32; SAMPLES]>,
    radiance: Vec<[[f32; SAMPLES]; 3]>,
    /// What of it is of what covers each direction: it is taken back where something nearer comes later.
    covering: Vec<[[f32; SAMPLES]; 3]>,
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
    /// Empties the raster for these unit directions, which stand for these solid angles; bits of `used` tell which of each group count.
    #[inline(always)]
    pub fn clear(
        &mut self,
        directions: &[[[f32; SAMPLES]; 3]],
        solid_angles: &[[f32; SAMPLES]],
        used: &[u16],
    ) {
        let groups = directions.len();
        self.directions.clear();
        self.directions.extend_from_slice(directions);
        self.solid_angles.clear();
        self.solid_angles.extend_from_slice(solid_angles);
        self.used.clear();
        self.used.extend_from_slice(used);
        self.covered.clear();
        self.covered.extend(used.iter().map(|used| !used));
        self.rims.clear();
        self.rims.resize(groups, Rims::default());
        self.depths.clear();
        self.depths.resize(groups, [0.0; SAMPLES]);
        self.transmittance.clear();
        self.transmittance.resize(groups, [1.0; SAMPLES]);
        self.radiance.clear();
        self.radiance.resize(groups, [[0.0; SAMPLES]; 3]);
        self.covering.clear();
        self.covering.resize(groups, [[0.0; SAMPLES]; 3]);
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

    /// Draws a shape into the groups found by the last [`Self::is_open`], and tells whether it meets any direction there. What shines whole and
    /// meets none does not shine yet: see [`Self::shine`].
    #[inline(always)]
    pub fn draw<L: Lanes, S: Shape>(&mut self, shape: &S, ink: &LobeInk) -> bool {
        let inverse = shape.inverse();
        let nearer = L::splat(1.0 + ink.tolerance);
        let share = L::splat(ink.veil.share_of_rest());
        let is_whole = ink.is_whole();
        let (mut met_count, mut visible) = (0, 0.0);
        for set in 0..self.met.len() {
            // Also where all is covered: a piece that shines by its own solid angle wants to know how much of it is hidden, others may be nearer.
            let mut rest = self.met[set];
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
                let met = shape.meets(d, w).close(shape, &mut self.rims[group]) & self.used[group];
                if met == 0 {
                    continue;
                }
                met_count += met.count_ones();
                let before = self.covered[group];
                let through = &mut self.transmittance[group];
                if is_whole {
                    let hidden = before & L::bits(w.mul(nearer).le(L::load(&self.depths[group])));
                    visible += sum_where(through, met & !hidden);
                }
                let mut new = met & !before;
                if ink.veil.is_opaque() {
                    // Before what covers it already, unless that let through next to nothing.
                    let is_behind = L::bits(w.le(L::load(&self.depths[group])));
                    let is_seen = L::bits(L::splat(TRANSMITTANCE_MIN).le(L::load(through)));
                    let nearer_ones = met & before & !is_behind & is_seen;
                    if nearer_ones != 0 {
                        let planes = self.radiance[group].iter_mut();
                        for (plane, covering) in planes.zip(&mut self.covering[group]) {
                            let left = L::load(plane).sub(L::load(covering));
                            left.store_where(nearer_ones, plane);
                            L::splat(0.0).store_where(nearer_ones, covering);
                        }
                        new |= nearer_ones;
                    }
                }
                if new == 0 {
                    continue;
                }
                let (seen, mut covered) = (L::load(through), new);
                let taken = seen.mul(share);
                if !ink.veil.is_opaque() {
                    let left = seen.sub(taken);
                    left.store_where(new, through);
                    covered &= L::bits(left.le(L::splat(TRANSMITTANCE_MIN)));
                }
                if ink.radiance != [0.0; 3] {
                    let planes = self.radiance[group].iter_mut().zip(&mut self.covering[group]);
                    for ((plane, covering), light) in planes.zip(ink.radiance) {
                        let added = taken.mul(L::splat(light));
                        L::load(plane).add(added).store_where(new, plane);
                        added.store_where(covered, covering);
                    }
                }
                w.store_where(covered, &mut self.depths[group]);
                self.covered[group] = before | covered;
                if before | covered == u16::MAX {
                    self.open[set] &= !(1 << lane);
                }
            }
        }
        if is_whole && met_count > 0 {
            self.reflect(ink.reflected, visible / met_count as f32);
        }
        met_count > 0
    }

    #[inline(always)]
    fn reflect(&mut self, light: [f32; 3], share: f32) {
        for (sum, light) in self.reflected.iter_mut().zip(light) {
            *sum += share * light;
        }
    }

    /// What shows through in a direction of the plane of this normal over its distance.
    #[inline(always)]
    fn shown(&self, direction: usize, inverse: Vec3, tolerance: f32) -> f32 {
        let (group, lane) = (direction / SAMPLES, direction % SAMPLES);
        let d = &self.directions[group];
        // Where the plane is in that direction, not where the piece is: of a slanting surface, that may be far behind.
        let w = inverse.dot(Vec3::new(d[0][lane], d[1][lane], d[2][lane]));
        let is_covered = self.covered[group] >> lane & 1 != 0;
        if is_covered && w * (1.0 + tolerance) <= self.depths[group][lane] {
            0.0
        } else {
            self.transmittance[group][lane]
        }
    }

    /// What shines whole, of the plane of this normal over its distance, does so as far as it shows in this direction.
    #[inline(always)]
    pub fn shine(&mut self, ink: &LobeInk, inverse: Vec3, direction: usize) {
        let share = self.shown(direction, inverse, ink.tolerance);
        self.reflect(ink.reflected, share);
    }

    /// A particle smaller than what this direction stands for, in a plane as of [`Self::shine`], shines as [`Self::shine`] says, and hides the
    /// share of what is behind that its solid angle has of the direction's.
    ///
    /// Particles are as if each were anywhere in what the direction stands for: of what is behind many, the product of what each
    /// lets through is seen.
    #[inline(always)]
    pub fn scatter(&mut self, ink: &LobeInk, solid_angle: f32, inverse: Vec3, direction: usize) {
        self.shine(ink, inverse, direction);
        let (group, lane) = (direction / SAMPLES, direction % SAMPLES);
        let bit = 1 << lane;
        if self.covered[group] & bit != 0 {
            return;
        }
        let share = solid_angle / self.solid_angles[group][lane];
        let left = self.transmittance[group][lane] * (1.0 - share.min(1.0));
        self.transmittance[group][lane] = left;
        if left <= TRANSMITTANCE_MIN {
            self.depths[group][lane] = inverse.length();
            self.covered[group] |= bit;
            if self.covered[group] == u16::MAX {
                self.open[group / SAMPLES] &= !(1 << (group % SAMPLES));
            }
        }
    }

    /// What shows through in the directions of a group: 0 where they are covered.
    #[must_use]
    #[inline(always)]
    pub fn transmittance(&self, group: usize) -> [f32; SAMPLES] {
        let covered = self.covered[group];
        let mut through = self.transmittance[group];
        for (lane, through) in through.iter_mut().enumerate() {
            if covered >> lane & 1 != 0 {
                *through = 0.0;
            }
        }
        through
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

/// Sum of the lanes whose bits are set, in their order.
#[inline(always)]
fn sum_where(lanes: &[f32; SAMPLES], bits: u16) -> f32 {
    let (mut sum, mut rest) = (0.0, bits);
    while rest != 0 {
        sum += lanes[rest.trailing_zeros() as usize];
        rest &= rest - 1;
    }
    sum
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

    const SOLID_ANGLE: f32 = 0.0025;

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
        raster.clear(
            &[group(0), group(1), group(2), group(3)],
            &[[SOLID_ANGLE; SAMPLES]; 4],
            &[u16::MAX; 4],
        );
        raster
    }

    fn disk(x: f32, z: f32, radius: f32) -> Disk {
        let center = Vec3::new(x, 0.0, z);
        Disk { inverse: Vec3::NEG_Z / -z, center, radius, reach: radius, ..Disk::default() }
    }

    fn draw(raster: &mut LobeRaster, disk: Disk, ink: &LobeInk) -> bool {
        assert!(raster.is_open::<Plain>(disk.center - disk.radius, disk.center + disk.radius));
        raster.draw::<Plain, _>(&disk, ink)
    }

    fn open(raster: &LobeRaster) -> f32 {
        (0..4).flat_map(|g| raster.transmittance(g)).sum()
    }

    fn light(raster: &LobeRaster) -> f32 {
        (0..4).flat_map(|g| raster.radiance(g)[0]).sum()
    }

    #[test]
    fn the_nearest_piece_covers_in_any_order() {
        let ink = |radiance| LobeInk {
            veil: Veil::OPAQUE,
            radiance: [radiance; 3],
            ..LobeInk::default()
        };
        let pieces = [(disk(-5.0, 1.0, 5.0), 2.0), (disk(0.0, 2.0, 9.0), 3.0)];
        let mut found = Vec::new();
        for order in [[0, 1], [1, 0]] {
            let mut raster = raster();
            for (disk, radiance) in order.map(|index| pieces[index]) {
                // The farther one leaves nothing open.
                let _ = raster.is_open::<Plain>(disk.center - 9.0, disk.center + 9.0);
                assert!(raster.draw::<Plain, _>(&disk, &ink(radiance)));
            }
            found.push(light(&raster));
        }
        assert_eq!(found, [160.0; 2]);
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
        assert_eq!(open(&raster), 32.0);
        draw(&mut raster, disk(0.0, 2.0, 9.0), &ink(3.0));
        assert_eq!(open(&raster), 0.0);
        assert_eq!(light(&raster), 32.0 * 5.0);
        assert!(!raster.is_open::<Plain>(Vec3::new(-1.0, -1.0, 3.0), Vec3::new(1.0, 1.0, 3.1)));
    }

    #[test]
    fn small_pieces_shine_by_their_own_light_unless_hidden() {
        let mut raster = raster();
        let lamp = LobeInk { veil: Veil::OPAQUE, reflected: [0.5; 3], ..LobeInk::default() };
        // Between directions, before and then behind a screen that covers half: the direction that is named tells.
        assert!(!draw(&mut raster, disk(-0.05, 1.0, 0.001), &lamp));
        assert_eq!((raster.reflected(), open(&raster)), ([0.0; 3], 64.0));
        raster.shine(&lamp, Vec3::Z, 9);
        assert_eq!(raster.reflected(), [0.5; 3]);
        let screen = LobeInk { veil: Veil::OPAQUE, ..LobeInk::default() };
        draw(&mut raster, disk(-5.0, 1.0, 5.0), &screen);
        raster.shine(&lamp, Vec3::Z * 0.5, 9);
        assert_eq!(raster.reflected(), [0.5; 3]);
        raster.shine(&lamp, Vec3::Z * 0.5, 14);
        assert_eq!(raster.reflected(), [1.0; 3]);
        // Neighbors of what hides are seen.
        raster.shine(&LobeInk { tolerance: 0.1, ..lamp }, Vec3::Z * 0.95, 9);
        assert_eq!(raster.reflected(), [1.5; 3]);
        // So is what slants, where its plane comes before the screen in that direction.
        raster.shine(&lamp, Vec3::new(-8.0, 0.0, 0.5), 9);
        assert_eq!(raster.reflected(), [2.0; 3]);
        // One that meets four directions of which two are hidden.
        assert!(draw(&mut raster, disk(0.0, 2.0, 0.08), &lamp));
        assert_eq!(raster.reflected(), [2.25; 3]);
    }

    #[test]
    fn shares_of_a_node_add_up_and_those_of_others_hide_each_other() {
        let mut raster = raster();
        let ink = |start, end, radiance| LobeInk {
            veil: Veil { start, end, seed: 0 },
            radiance: [radiance; 3],
            ..LobeInk::default()
        };
        // Halves and quarters of one node, then half of what a second one lets through, then a wall.
        draw(&mut raster, disk(0.0, 1.0, 9.0), &ink(0.0, 0.5, 1.0));
        assert_eq!((open(&raster), light(&raster)), (32.0, 32.0));
        draw(&mut raster, disk(0.0, 1.0, 9.0), &ink(0.5, 0.75, 1.0));
        assert_eq!((open(&raster), light(&raster)), (16.0, 48.0));
        draw(&mut raster, disk(0.0, 2.0, 9.0), &ink(0.0, 0.5, 10.0));
        assert_eq!((open(&raster), light(&raster)), (8.0, 128.0));
        draw(&mut raster, disk(0.0, 3.0, 9.0), &ink(0.0, 1.0, 100.0));
        assert_eq!((open(&raster), light(&raster)), (0.0, 928.0));
        // Shares that fill a node leave nothing.
        let mut raster = self::raster();
        draw(&mut raster, disk(0.0, 1.0, 9.0), &ink(0.0, 0.5, 1.0));
        draw(&mut raster, disk(0.0, 1.0, 9.0), &ink(0.5, 1.0, 1.0));
        assert_eq!((open(&raster), light(&raster)), (0.0, 64.0));
    }

    /// A cloud of particles of optical thickness τ shows 1 − e^−τ of its light and lets e^−τ through.
    #[test]
    fn particles_hide_each_other_as_a_cloud_does() {
        for thickness in [0.1f32, 1.0, 3.0] {
            let mut raster = raster();
            let count = 4000;
            let solid_angle = thickness * SOLID_ANGLE / count as f32;
            let ink = LobeInk { reflected: [solid_angle; 3], ..LobeInk::default() };
            for _ in 0..count {
                raster.scatter(&ink, solid_angle, Vec3::Z, 37);
            }
            let through = (-thickness).exp();
            let shown = raster.reflected()[0] / SOLID_ANGLE;
            assert!((shown - (1.0 - through)).abs() < 1e-3, "{thickness}: {shown}");
            assert!((raster.transmittance(2)[5] - through).abs() < 1e-3);
            assert!((open(&raster) - 63.0 - through).abs() < 1e-3, "only where they are");
            // A lamp behind them, and one before.
            let lamp = LobeInk { reflected: [1.0; 3], ..LobeInk::default() };
            let before = raster.reflected()[0];
            raster.shine(&lamp, Vec3::Z * 0.5, 37);
            assert!((raster.reflected()[0] - before - through).abs() < 1e-3);
        }
        // Whoever fills all that the direction stands for closes it.
        let mut raster = raster();
        raster.scatter(&LobeInk::default(), SOLID_ANGLE, Vec3::Z, 37);
        assert_eq!((open(&raster), raster.transmittance(2)[5]), (63.0, 0.0));
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
