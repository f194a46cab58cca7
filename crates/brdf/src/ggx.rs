//! Glossy reflection: microfacets with the GGX distribution of slopes.
//!
//! Walter et al., *Microfacet models for refraction through rough surfaces* (2007), with Smith's masking of both directions on
//! their own, Schlick's Fresnel term (1994), and the distribution of visible normals (Heitz 2018), from which
//! directions are drawn by spherical caps (Dupuy and Benyoub 2023). What microfacets reflect at each other is put back by a factor on the lobe
//! (Turquin 2019): a white metal reflects all it gets, at every roughness and angle.

use crate::Material;
use crate::albedo::first_bounce_albedo;
use pbgi_math::{Cone, Frame, Vec3};
use pbgi_raster::SAMPLES;
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, PI, TAU};

/// The lobe of one receiver: what it reflects toward its eye, by the direction the light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GgxLobe {
    /// The receiver's normal, and a tangent toward the eye's side.
    frame: Frame,
    /// Direction of the eye in that frame; its second component is 0.
    eye: Vec3,
    alpha: f32,
    /// Direction of the eye where the microfacets are those of a hemisphere.
    stretched: Vec3,
    /// Smith's masking toward the eye.
    seen: f32,
    normal_reflectance: [f32; 3],
    /// What is reflected in all over what is at the first bounce, per channel.
    gain: [f32; 3],
}

/// Directions of a lobe, each of which stands for the same share of what a white surface reflects; in groups of neighbors.
#[derive(Clone, Debug, Default)]
pub struct LobeDirections {
    /// Unit directions the light comes from.
    pub directions: Vec<[[f32; SAMPLES]; 3]>,
    /// What of the radiance from there is reflected, per channel; divided by the number of directions. 0 below the horizon.
    pub weights: Vec<[[f32; SAMPLES]; 3]>,
    /// Solid angle each stands for, steradians.
    pub solid_angles: Vec<[f32; SAMPLES]>,
    /// Which are above the horizon.
    pub above: Vec<u16>,
}

/// Places of a lobe's directions on the unit square, which are the same for all lobes.
#[derive(Clone, Debug)]
pub struct LobePattern {
    /// Cosine and sine of the azimuth, and the height, by groups.
    places: Vec<[[f32; SAMPLES]; 3]>,
    /// The direction in each cell of the square, rows of heights; there is one in each.
    cells: Vec<u16>,
    edge: usize,
}

impl LobePattern {
    /// The highest level: 16 384 directions, which err by 1 to 2 % where 1 024 do by 2 to 5 % (docs/measuring.md).
    pub const LEVEL_MAX: u32 = 5;

    /// A pattern of 4^`level` groups of sixteen directions, `level` at most [`Self::LEVEL_MAX`].
    ///
    /// The first points of the Sobol sequence (1967) on the unit square, laid over a disk by azimuth and squared radius, so that each of as many
    /// rings of equal area holds one. Groups are spots of it: some rings side by side, cut at some azimuths.
    #[must_use]
    pub fn new(level: u32) -> Self {
        let groups = 1usize << (2 * level.min(Self::LEVEL_MAX));
        let count = groups * SAMPLES;
        let offset = 0.5 / count as f32;
        let mut points: Vec<[f32; 2]> =
            (0..count).map(|i| sobol(i as u32).map(|x| x + offset)).collect();
        points.sort_unstable_by(|a, b| a[1].total_cmp(&b[1]));
        let rings = ((groups as f32).sqrt() * RINGS_PER_EDGE).round().max(1.0);
        let mut start = 0;
        for ring in 1..=rings as usize {
            let share = (ring as f32 / rings).powi(2);
            let end = (groups as f32 * share).round() as usize * SAMPLES;
            points[start..end].sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
            start = end;
        }
        let place = |[u, v]: [f32; 2]| [(TAU * u).cos(), (TAU * u).sin(), v];
        let group = |points: &[[f32; 2]]| {
            std::array::from_fn(|axis| std::array::from_fn(|i| place(points[i])[axis]))
        };
        let edge = (count as f32).sqrt().round() as usize;
        let mut cells = vec![0; count];
        for (index, point) in points.iter().enumerate() {
            let [column, row] = point.map(|x| cell_of(x, edge));
            cells[row * edge + column] = index as u16;
        }
        Self { places: points.chunks_exact(SAMPLES).map(group).collect(), cells, edge }
    }

    /// The direction whose cell holds this place, as [`GgxLobe::place`] gives it, or where that is below the horizon, the next toward the middle
    /// of the lobe; none if all are.
    #[must_use]
    #[inline(always)]
    pub fn direction_at(&self, [u, v]: [f32; 2], above: &[u16]) -> Option<usize> {
        let (column, row) = (cell_of(u, self.edge), cell_of(v, self.edge));
        for row in (0..=row).rev() {
            let index = usize::from(self.cells[row * self.edge + column]);
            if above[index / SAMPLES] >> (index % SAMPLES) & 1 != 0 {
                return Some(index);
            }
        }
        None
    }

    /// Groups of sixteen directions.
    #[must_use]
    pub fn group_count(&self) -> usize {
        self.places.len()
    }
}

/// Rings of a pattern over the square root of its groups, for groups about as wide as long.
const RINGS_PER_EDGE: f32 = 0.75;

/// The cell of an edge of so many that holds `x`, 0..=1.
#[inline(always)]
fn cell_of(x: f32, edge: usize) -> usize {
    ((x * edge as f32) as i32 as usize).min(edge - 1)
}

/// Angle of (x, y) as a share of a full turn, 0..=1, within 10⁻⁴.
#[inline(always)]
fn turns(x: f32, y: f32) -> f32 {
    let (a, b) = (x.abs(), y.abs());
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    let t = low / high.max(1e-20);
    let t2 = t * t;
    let eighth = t * (0.158_416 - t2 * (0.045_945 - t2 * 0.012_626));
    let quarter = if a < b { 0.25 - eighth } else { eighth };
    let half = if x < 0.0 { 0.5 - quarter } else { quarter };
    if y < 0.0 { 1.0 - half } else { half }
}

/// Point `index` of the two-dimensional Sobol sequence, 0..1.
fn sobol(index: u32) -> [f32; 2] {
    let (mut second, mut direction, mut rest) = (0u32, 1u32 << 31, index);
    while rest != 0 {
        second ^= if rest & 1 != 0 { direction } else { 0 };
        direction ^= direction >> 1;
        rest >>= 1;
    }
    [index.reverse_bits(), second].map(|bits| (bits >> 8) as f32 / (1 << 24) as f32)
}

/// Smith's share of microfacets not masked in a direction at `cosine` over the horizon, above 0.
#[inline(always)]
fn smith(cosine: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    2.0 * cosine / (cosine + (a2 + (1.0 - a2) * cosine * cosine).sqrt())
}

/// What surfaces of these reflectances reflect in all over what they do at the first bounce, of which a white one reflects the share `albedo`: of
/// what is left, each bounce more reflects as much as the surface does.
#[inline(always)]
fn gains(normal_reflectance: [f32; 3], albedo: f32) -> [f32; 3] {
    let lost = (1.0 - albedo).max(0.0) / albedo.max(ALBEDO_MIN);
    normal_reflectance.map(|r| 1.0 + r * lost)
}

/// No lobe reflects less at the first bounce: 1 − ln 2.
const ALBEDO_MIN: f32 = 0.3;

impl GgxLobe {
    /// The lobe of `material` on a surface with this unit normal, seen from the unit direction `toward_eye`; none if that is below
    /// the horizon.
    #[must_use]
    #[inline]
    pub fn new(material: &Material, normal: Vec3, toward_eye: Vec3) -> Option<Self> {
        Self::with_alpha(material.alpha(), material.normal_reflectance(), normal, toward_eye)
    }

    /// The same for a width α of the slopes, 0.0004..=1, and a reflectance at normal incidence.
    #[must_use]
    #[inline]
    pub fn with_alpha(
        alpha: f32,
        normal_reflectance: [f32; 3],
        normal: Vec3,
        toward_eye: Vec3,
    ) -> Option<Self> {
        let height = normal.dot(toward_eye);
        if !(height > 1e-4) {
            return None;
        }
        let along = toward_eye - normal * height;
        let length = along.length();
        let frame = if length > 1e-4 {
            let tangent = along * (1.0 / length);
            Frame { tangent, bitangent: normal.cross(tangent), normal }
        } else {
            Frame::from_normal(normal)
        };
        let sine = (1.0 - height * height).max(0.0).sqrt();
        let eye = if length > 1e-4 { Vec3::new(sine, 0.0, height) } else { Vec3::Z };
        let stretched = Vec3::new(alpha * eye.x, 0.0, eye.z).normalize_or(Vec3::Z);
        let seen = smith(eye.z, alpha);
        let gain = gains(normal_reflectance, first_bounce_albedo(alpha, eye.z));
        Some(Self { frame, eye, alpha, stretched, seen, normal_reflectance, gain })
    }

    /// The direction a mirror would show.
    #[must_use]
    #[inline]
    pub fn mirror(&self) -> Vec3 {
        self.frame.to_world(Vec3::new(-self.eye.x, 0.0, self.eye.z))
    }

    /// Radiance reflected per irradiance from the unit direction `from` times its cosine, without the Fresnel term, sr⁻¹;
    /// and the cosine to the microfacet that reflects. 0 below the horizon.
    #[inline(always)]
    fn reflect_white(&self, from: Vec3) -> (f32, f32) {
        let d = self.frame.to_local(from);
        if !(d.z > 0.0) {
            return (0.0, 1.0);
        }
        let h = d + self.eye;
        let masked = self.seen * smith(d.z, self.alpha);
        let value = masked / (4.0 * self.eye.z * self.inverse_density(h));
        (value, self.eye.dot(h) / h.length())
    }

    /// Schlick's reflectance of a microfacet met at this cosine.
    #[inline(always)]
    fn fresnel(&self, cosine: f32) -> [f32; 3] {
        let x = (1.0 - cosine).max(0.0);
        let grazing = x * x * x * x * x;
        self.normal_reflectance.map(|r| r + (1.0 - r) * grazing)
    }

    /// Radiance reflected toward the eye per irradiance from the unit direction `from`, times the cosine there: its integral with
    /// the radiance over all directions is what is reflected. sr⁻¹, per channel.
    #[must_use]
    #[inline(always)]
    pub fn reflect(&self, from: Vec3) -> [f32; 3] {
        let (white, cosine) = self.reflect_white(from);
        let reflected = self.fresnel(cosine);
        std::array::from_fn(|c| reflected[c] * white * self.gain[c])
    }

    /// Solid angle, in steradians, that one of `count` equal shares of the lobe has in the unit direction `from`.
    #[must_use]
    #[inline(always)]
    pub fn share_solid_angle(&self, from: Vec3, count: f32) -> f32 {
        let h = self.frame.to_local(from) + self.eye;
        4.0 * self.eye.z / (self.seen * count) * self.inverse_density(h)
    }

    /// Where a [`LobePattern`] holds the unit direction `from`, above the horizon: azimuth and height, 0..=1.
    #[must_use]
    #[inline(always)]
    pub fn place(&self, from: Vec3) -> [f32; 2] {
        // The inverse of what `directions` does.
        let h = self.frame.to_local(from) + self.eye;
        let h = Vec3::new(h.x, h.y, self.alpha * h.z);
        let cap =
            h * (2.0 * h.dot(self.stretched) / h.length_squared().max(1e-20)) - self.stretched;
        let height = 1.0 - (cap.z + self.stretched.z) / (1.0 + self.stretched.z);
        [turns(cap.x, cap.y), height]
    }

    /// 1 over the density of microfacets that face along `h`, of any length but 0.
    #[inline(always)]
    fn inverse_density(&self, h: Vec3) -> f32 {
        let inverse2 = 1.0 / h.length_squared().max(1e-20);
        let (sin2, cos2) = ((h.x * h.x + h.y * h.y) * inverse2, h.z * h.z * inverse2);
        let a2 = self.alpha * self.alpha;
        // α²cos² + sin² keeps the digits that 1 + (α² − 1) cos² loses for narrow lobes.
        let width = a2 * cos2 + sin2;
        PI * width * width / a2
    }

    /// Directions of the lobe into `out`.
    ///
    /// They follow the microfacets that the eye sees, so that the sum of radiance times weight is what is reflected; under uniform
    /// light that sum is the reflectance, to 1 % for 256 directions, and that of a white metal is 1 (`tests::a_white_furnace_comes_back`).
    #[inline(always)]
    pub fn directions(&self, pattern: &LobePattern, out: &mut LobeDirections) {
        let groups = pattern.places.len();
        let count = (groups * SAMPLES) as f32;
        let to_solid_angle = 4.0 * self.eye.z / (self.seen * count);
        out.directions.resize(groups, [[0.0; SAMPLES]; 3]);
        out.weights.resize(groups, [[0.0; SAMPLES]; 3]);
        out.solid_angles.resize(groups, [0.0; SAMPLES]);
        out.above.resize(groups, 0);
        let stretched = self.stretched;
        let mut albedo = 0.0;
        for (group, places) in pattern.places.iter().enumerate() {
            out.above[group] = 0;
            for i in 0..SAMPLES {
                let z = (1.0 - places[2][i]) * (1.0 + stretched.z) - stretched.z;
                let r = (1.0 - z * z).max(0.0).sqrt();
                let h = Vec3::new(r * places[0][i], r * places[1][i], z) + stretched;
                let h = Vec3::new(self.alpha * h.x, self.alpha * h.y, h.z.max(0.0));
                let inverse2 = 1.0 / h.length_squared().max(1e-20);
                let along = self.eye.dot(h);
                let d = h * (2.0 * along * inverse2) - self.eye;
                let cosine = along * inverse2.sqrt();
                let shadow = smith(d.z.max(1e-6), self.alpha);
                let is_above = d.z > 0.0;
                let weight = if is_above { shadow / count } else { 0.0 };
                albedo += weight;
                let reflected = self.fresnel(cosine);
                let world = self.frame.to_world(d);
                for axis in 0..3 {
                    out.directions[group][axis][i] = world[axis];
                    out.weights[group][axis][i] = weight * reflected[axis];
                }
                out.solid_angles[group][i] = to_solid_angle * self.inverse_density(h);
                out.above[group] |= u16::from(is_above) << i;
            }
        }
        // By their own sum, so that no surface reflects more than it gets.
        let gain = gains(self.normal_reflectance, albedo);
        for weights in &mut out.weights {
            for (weights, gain) in weights.iter_mut().zip(gain) {
                weights.iter_mut().for_each(|weight| *weight *= gain);
            }
        }
    }

    /// A cone around the mirror direction from which at least `share` (0..1) of what a white surface reflects toward the eye comes, light
    /// that would arrive from below the horizon included.
    ///
    /// A microfacet tilted by θ turns the mirror direction by at most 2θ. Of the visible microfacets, those tilted by at most θ are, with
    /// tan θ = α tan t, as many as show on a cap of the unit hemisphere up to t toward the stretched direction of the eye,
    /// at cosine μ and sine s. The mean over azimuths of the positive part of μ cos t + s sin t cos φ is at least the mean of
    /// μ cos t and the larger of μ cos t and (2/π) s sin t, which bounds that share from below in closed form.
    #[must_use]
    pub fn cone(&self, share: f32) -> Cone {
        let stretched = self.stretched;
        let (mu, s) = (stretched.z, stretched.x.abs());
        let switch = (mu * FRAC_PI_2).atan2(s);
        let inside = |t: f32| {
            let below = t.min(switch);
            let slanted = |t: f32| 0.5 * (t - t.sin() * t.cos());
            let larger = 0.5 * mu * below.sin().powi(2)
                + 2.0 * FRAC_1_PI * s * (slanted(t) - slanted(below));
            2.0 * (0.5 * mu * t.sin().powi(2) + larger) / (1.0 + mu)
        };
        let (mut low, mut high) = (0.0, FRAC_PI_2);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if inside(middle) < share {
                low = middle;
            } else {
                high = middle;
            }
        }
        let tilt = (self.alpha * high.sin()).atan2(high.cos());
        // Rounded toward the wider cone.
        let cosine = (2.0 * tilt).min(PI).cos() - f32::EPSILON;
        Cone { axis: self.mirror(), cos_half_angle: cosine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn eye(cosine: f32) -> Vec3 {
        Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine)
    }

    fn lobe(alpha: f32, cosine: f32) -> GgxLobe {
        GgxLobe::with_alpha(alpha, [1.0, 0.04, 0.5], Vec3::Z, eye(cosine)).unwrap()
    }

    /// ∫ f cos dω by a fine grid over the microfacets around the normal, which resolves any lobe: dω = 4 (o·h) dω_h.
    fn quadrature(lobe: &GgxLobe, mut value: impl FnMut(Vec3) -> f64) -> f64 {
        let (rings, spokes) = (2000, 256);
        let mut sum = 0.0;
        for ring in 0..rings {
            // Slopes up to infinity, dense where the distribution is.
            let u = (f64::from(ring) + 0.5) / f64::from(rings);
            let tan2 = f64::from(lobe.alpha).powi(2) * u / (1.0 - u);
            let cos = 1.0 / (1.0 + tan2).sqrt();
            // Of D cos dω_h an equal share for each.
            let density = f64::from(lobe.alpha).powi(2)
                / (std::f64::consts::PI
                    * (cos * cos * f64::from(lobe.alpha).powi(2) + 1.0 - cos * cos).powi(2));
            let area = 1.0 / (density * cos * f64::from(rings * spokes));
            for spoke in 0..spokes {
                let phi = (f64::from(spoke) + 0.5) / f64::from(spokes) * std::f64::consts::TAU;
                let sin = (1.0 - cos * cos).sqrt();
                let h = Vec3::new((sin * phi.cos()) as f32, (sin * phi.sin()) as f32, cos as f32);
                let along = lobe.eye.dot(h);
                if along > 0.0 {
                    let from = lobe.frame.to_world(h * (2.0 * along) - lobe.eye);
                    sum += value(from) * 4.0 * f64::from(along) * area;
                }
            }
        }
        sum
    }

    const ALPHAS: [f32; 5] = [0.0004, 0.01, 0.1, 0.3, 1.0];
    const COSINES: [f32; 4] = [1.0, 0.7, 0.3, 0.08];

    /// Under uniform light the directions' weights sum to the integral of the reflectance, and no surface reflects more than it gets.
    #[test]
    fn a_white_furnace_comes_back() {
        let pattern = LobePattern::new(2);
        for alpha in ALPHAS {
            for cosine in COSINES {
                let lobe = lobe(alpha, cosine);
                let mut found = LobeDirections::default();
                lobe.directions(&pattern, &mut found);
                for channel in 0..3 {
                    let sum: f32 = found.weights.iter().flat_map(|w| w[channel]).sum();
                    let exact = quadrature(&lobe, |d| f64::from(lobe.reflect(d)[channel])) as f32;
                    assert!((sum - exact).abs() < 0.01, "{alpha} {cosine}: {sum} {exact}");
                    assert!(sum <= 1.0 + 1e-5 && sum > 0.0);
                }
            }
        }
    }

    /// White metals reflect all of uniform light, at every roughness and however slanted the view; as directions exactly, and as the integral of the
    /// reflectance within what the table of albedos is off by.
    #[test]
    fn white_metals_lose_nothing() {
        let pattern = LobePattern::new(2);
        for alpha in ALPHAS {
            for cosine in [1.0, 0.7, 0.3, 0.08, 0.01, 0.002, 0.0005] {
                let lobe = GgxLobe::with_alpha(alpha, [1.0; 3], Vec3::Z, eye(cosine)).unwrap();
                let mut found = LobeDirections::default();
                lobe.directions(&pattern, &mut found);
                let sum: f32 = found.weights.iter().flat_map(|w| w[0]).sum();
                assert!((sum - 1.0).abs() < 1e-4, "{alpha} {cosine}: {sum}");
                if cosine > 0.05 {
                    let integral = quadrature(&lobe, |d| f64::from(lobe.reflect(d)[0]));
                    assert!((integral - 1.0).abs() < 0.006, "{alpha} {cosine}: {integral}");
                }
            }
        }
    }

    /// Dark surfaces gain next to nothing, and what is reflected more than once is colored more deeply.
    #[test]
    fn colors_deepen_with_every_bounce() {
        let lobe = GgxLobe::with_alpha(1.0, [0.9, 0.5, 0.04], Vec3::Z, eye(0.7)).unwrap();
        let lost = 1.0 / first_bounce_albedo(1.0, 0.7) - 1.0;
        for (gain, color) in lobe.gain.into_iter().zip([0.9, 0.5, 0.04]) {
            assert!((gain - 1.0 - color * lost).abs() < 1e-5, "{gain}");
        }
        let [red, green, blue] = lobe.reflect(Vec3::Z);
        assert!(red / green > 0.9 / 0.5 && green / blue > 0.5 / 0.04);
    }

    /// Directions sum varying light as the integral does.
    #[test]
    fn directions_follow_the_lobe() {
        let pattern = LobePattern::new(2);
        let sky = |d: Vec3| 2.0 + d.x - 0.5 * d.y + if d.y > 0.1 { 2.0 } else { 0.0 };
        for alpha in [0.05, 0.3] {
            for cosine in COSINES {
                let lobe = lobe(alpha, cosine);
                let mut found = LobeDirections::default();
                lobe.directions(&pattern, &mut found);
                let mut sum = 0.0;
                for (d, w) in found.directions.iter().zip(&found.weights) {
                    for i in 0..SAMPLES {
                        sum += w[0][i] * sky(Vec3::new(d[0][i], d[1][i], d[2][i]));
                    }
                }
                let exact = quadrature(&lobe, |d| f64::from(lobe.reflect(d)[0] * sky(d))) as f32;
                assert!((sum / exact - 1.0).abs() < 0.02, "{alpha} {cosine}: {sum} {exact}");
            }
        }
    }

    #[test]
    fn a_direction_stands_for_the_inverse_of_its_density() {
        let mut found = LobeDirections::default();
        let lobe = lobe(0.2, 0.6);
        lobe.directions(&LobePattern::new(2), &mut found);
        for (group, d) in found.directions.iter().enumerate() {
            for i in (0..SAMPLES).filter(|i| found.above[group] >> i & 1 != 0) {
                let from = Vec3::new(d[0][i], d[1][i], d[2][i]);
                let (own, at) = (found.solid_angles[group][i], lobe.share_solid_angle(from, 256.0));
                assert!((own / at - 1.0).abs() < 1e-2, "{own} {at}");
            }
        }
    }

    /// Every direction lies in its own cell, and each cell has the same share of the lobe.
    #[test]
    fn cells_hold_their_directions_and_equal_shares() {
        let pattern = LobePattern::new(2);
        for alpha in [0.01, 0.1, 0.3, 1.0] {
            for cosine in COSINES {
                let lobe = lobe(alpha, cosine);
                let mut found = LobeDirections::default();
                lobe.directions(&pattern, &mut found);
                let (mut own, mut above) = (0, 0);
                for (group, d) in found.directions.iter().enumerate() {
                    for i in (0..SAMPLES).filter(|i| found.above[group] >> i & 1 != 0) {
                        let from = Vec3::new(d[0][i], d[1][i], d[2][i]);
                        let index = pattern.direction_at(lobe.place(from), &found.above);
                        above += 1;
                        own += usize::from(index == Some(group * SAMPLES + i));
                    }
                }
                assert!(own == above, "{alpha} {cosine}: {own} of {above}");
                // A finer pattern has sixteen directions in each cell.
                let mut finer = LobeDirections::default();
                lobe.directions(&LobePattern::new(4), &mut finer);
                let mut counts = [0; 256];
                for (group, d) in finer.directions.iter().enumerate() {
                    for i in (0..SAMPLES).filter(|i| finer.above[group] >> i & 1 != 0) {
                        let from = Vec3::new(d[0][i], d[1][i], d[2][i]);
                        let all = [u16::MAX; 16];
                        let index = pattern.direction_at(lobe.place(from), &all);
                        counts[index.unwrap()] += 1;
                    }
                }
                for (index, count) in counts.into_iter().enumerate() {
                    assert!(count <= 18, "{alpha} {cosine} {index}: {count}");
                    if finer.above.iter().all(|above| *above == u16::MAX) {
                        assert!(count >= 14, "{alpha} {cosine} {index}: {count}");
                    }
                }
            }
        }
    }

    #[test]
    fn below_the_horizon_the_next_direction_toward_the_middle_stands_in() {
        let pattern = LobePattern::new(2);
        let lobe = lobe(1.0, 0.3);
        let mut found = LobeDirections::default();
        lobe.directions(&pattern, &mut found);
        assert!(found.above.iter().any(|above| *above != u16::MAX));
        for step in 0..64 {
            let place = [step as f32 / 64.0, 1.0];
            let index = pattern.direction_at(place, &found.above).unwrap();
            assert!(found.above[index / SAMPLES] >> (index % SAMPLES) & 1 != 0);
        }
        assert_eq!(pattern.direction_at([0.5; 2], &[0; 16]), None);
    }

    /// Conservative at every angle, and tight where the lobe is round.
    #[test]
    fn cones_hold_their_share() {
        let pattern = LobePattern::new(4);
        for alpha in ALPHAS {
            for cosine in COSINES {
                let lobe = lobe(alpha, cosine);
                let mut found = LobeDirections::default();
                lobe.directions(&pattern, &mut found);
                for share in [0.5f32, 0.9] {
                    let cone = lobe.cone(share);
                    let mut inside = 0;
                    for d in &found.directions {
                        for i in 0..SAMPLES {
                            let from = Vec3::new(d[0][i], d[1][i], d[2][i]);
                            // The chord keeps the digits that the cosine of a narrow cone loses.
                            let chord2 = (from - cone.axis).length_squared();
                            let limit2 = 2.0 - 2.0 * cone.cos_half_angle;
                            inside += u32::from(chord2 <= limit2 * 1.001 + 1e-7);
                        }
                    }
                    let inside = inside as f32 / 4096.0;
                    assert!(inside >= share - 2e-3, "{alpha} {cosine} {share}: {inside}");
                    if cosine == 1.0 && alpha >= 0.01 {
                        assert!(inside < share + 0.02, "{alpha} {share}: {inside}");
                    }
                }
            }
        }
    }

    /// But for the factor of what is reflected more than once, which is that of the eye.
    #[test]
    fn reflection_is_reciprocal_and_nothing_comes_from_below() {
        let (a, b) = (Vec3::new(0.48, 0.6, 0.64), Vec3::new(-0.6, 0.0, 0.8));
        let from = |eye: Vec3| GgxLobe::with_alpha(0.3, [0.2; 3], Vec3::Z, eye).unwrap();
        let single = |eye: Vec3, light: Vec3| {
            let lobe = from(eye);
            lobe.reflect(light)[0] / (light.z * lobe.gain[0])
        };
        let (ab, ba) = (single(a, b), single(b, a));
        assert!((ab / ba - 1.0).abs() < 1e-5);
        assert_eq!(from(a).reflect(Vec3::new(0.6, 0.0, -0.8)), [0.0; 3]);
        assert!(GgxLobe::with_alpha(0.3, [0.2; 3], Vec3::Z, -a).is_none());
        let mirror = from(a).mirror();
        assert!((mirror - Vec3::new(-0.48, -0.6, 0.64)).length() < 1e-6);
    }

    #[test]
    fn groups_are_spots() {
        let pattern = LobePattern::new(2);
        for (group, places) in pattern.places.iter().enumerate() {
            let at = |i: usize| {
                let r = places[2][i].sqrt();
                (places[0][i] * r, places[1][i] * r)
            };
            let (x, y) = at(0);
            for i in 1..SAMPLES {
                let (u, v) = at(i);
                assert!((u - x).hypot(v - y) < 0.8, "{group}: {:?} {:?}", at(0), at(i));
            }
        }
        assert_eq!(pattern.group_count(), 16);
    }
}
