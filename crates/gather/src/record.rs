//! Irradiance records: what one receiver has gathered, how that changes around it, and how far it serves for others (Ward, Rubinstein and
//! Clear 1988; Ward and Heckbert 1992).

use crate::receiver::{Receiver, Shading};
use pbgi_brdf::{Differential, Differentiator, LIGHT, OCCLUSION, Obstacles, QUANTITIES, SKY};
use pbgi_math::{Vec3, larger};

/// Error of an extrapolation over what all borders between texels would change if each changed it for the better.
///
/// Most changes cancel or follow from the first order: from a receiver to the nearest of the records around it, 0.1 of the sum is the median and 0.2 the
/// root mean square of the error of ambient occlusion, in a street, in Sponza and among leaves alike, measured when every border
/// was as near as the nearest thing in its texels. Half and twice of it are twice and half of the tolerance.
const COHERENCE: f32 = 0.15;

/// Change of all borders together, over the value, up to which extrapolation of the first order is of use: at 0.8 to 1.6 it is as wrong as none.
const FIRST_ORDER_MAX: f32 = 0.7;

/// Slope of the way from a record to a receiver, over the mean of their planes, at which they are not on one surface: what is below a record's horizon
/// it does not see, be it a roof's record and all that is beside the house. Half of it gathers more on rough ground; twice lets curbs through.
const STEP_SLOPE: f32 = 0.05;

/// Share of the tolerance that things which loom may change at a record's reach, all of them together. With it a street gathers for 28.0 % of its receivers with
/// 1.65 % of error from interpolation; with two thirds of it for 28.7 % with 1.5 %, with four thirds for 27.5 % with 1.7 %.
const LOOMING_MAX: f32 = 0.3;

/// Share of the way to what stands on a record's plane up to which the record serves: beyond is another room, or the inside of a thing. With 1 the apartment
/// has 2.9 % of error from interpolation instead of 2.4 %; 0.6 and 0.8 are alike.
const NEAREST_APPROACH: f32 = 0.8;

/// Standard deviations of what two records differ by as samples fall, up to which they agree. With half of it Sponza gathers for 28 % of its receivers, not
/// 17 %, at 8 texels; with twice it is as with it, there and in a street and among leaves.
const DEVIATIONS: f32 = 2.0;

/// Steps by which a reach is made shorter at most, where things loom.
const REACH_STEPS: u32 = 12;

/// Share of the mean that is added to what errors are relative to, so that what is all but black does not rule: as where errors are measured.
const LEAST_SHARE: f32 = 0.1;

/// Factor by which a bound is passed whatever rounding does.
const SURELY: f32 = 1.001;

/// What extrapolated values may be wrong by.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// Share of the value.
    share: f32,
    /// What is added to values before, of occlusion and of the sum of all light.
    least: [f32; 2],
}

impl Tolerance {
    /// This share of values like those of a sample.
    #[must_use]
    pub fn new(share: f32, sample: &[Shading]) -> Self {
        let mut sums = [0.0f64; 2];
        for values in sample.iter().map(quantities) {
            sums[0] += f64::from(values[OCCLUSION]);
            sums[1] += f64::from(light(&values));
        }
        let count = sample.len().max(1) as f64;
        let [openness, light] = sums.map(|sum| (sum / count) as f32);
        // Where there is light, occlusion is relative to all that could be open.
        let openness = if light > 0.0 { 1.0 } else { openness };
        Self { share, least: [openness, light].map(|mean| LEAST_SHARE * mean) }
    }

    /// What errors of occlusion and of light are relative to.
    fn scales(&self, values: &[f32; QUANTITIES]) -> [f32; 2] {
        [values[OCCLUSION] + self.least[0], light(values) + self.least[1]]
    }
}

/// Sum of all irradiance.
#[inline]
fn light(values: &[f32; QUANTITIES]) -> f32 {
    values[LIGHT].iter().sum()
}

/// What a receiver has gathered of broad light, and how that changes when it moves and turns.
///
/// Whether it serves is asked far more often than what it says: what tells that lies in one line of the processor's cache.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Record {
    position: Vec3,
    normal: Vec3,
    plane: Vec3,
    /// Distance along the surface at which the expected error is the tolerance.
    reach: f32,
    /// The same off the surface, where nothing cancels.
    rise: f32,
    /// 1 over the square of the angle at which it is.
    inverse_turn2: f32,
    obstacles: Obstacles,
    values: [f32; QUANTITIES],
    bent_normal: Vec3,
    translation: [Vec3; QUANTITIES],
    rotation: [Vec3; QUANTITIES],
    /// What errors of occlusion and light are relative to.
    scales: [f32; 2],
    /// Variances of these, by the raster's samples.
    variances: [f32; 2],
}

impl Record {
    #[inline(always)]
    pub(crate) fn new(
        receiver: &Receiver,
        shading: &Shading,
        differential: &Differential,
        differentiator: Option<&Differentiator>,
        tolerance: &Tolerance,
    ) -> Self {
        let values = quantities(shading);
        let scales = tolerance.scales(&values);
        let rise = |i: usize| match differential.slope_sums[i] {
            0.0 => f32::MAX,
            slope => tolerance.share * scales[i] / slope,
        };
        let rise = rise(0).min(rise(1));
        let mut reach = rise / COHERENCE.max(tolerance.share / FIRST_ORDER_MAX);
        for _ in 0..REACH_STEPS {
            let Some(differentiator) = differentiator else { break };
            let errors = differentiator.looming(reach);
            let excess = |i: usize| {
                errors[i] / (LOOMING_MAX * tolerance.share * scales[i]).max(f32::MIN_POSITIVE)
            };
            let excess = excess(0).max(excess(1));
            if excess <= 1.0 {
                break;
            }
            // What looms grows with the square of the distance, or faster.
            reach *= excess.sqrt().recip().clamp(0.05, 0.9);
        }
        Self {
            position: receiver.position,
            normal: receiver.normal,
            plane: receiver.plane,
            values,
            bent_normal: shading.bent_normal,
            translation: differential.translation,
            rotation: differential.rotation,
            scales,
            variances: differential.variances,
            reach,
            rise,
            // Turning by φ is wrong by the light of the lune that rises over the horizon: φ²/4 of what a hemisphere of it would give.
            inverse_turn2: 1.0 / (4.0 * tolerance.share),
            obstacles: differential.obstacles,
        }
    }

    /// Its place.
    #[must_use]
    #[inline]
    pub fn position(&self) -> Vec3 {
        self.position
    }

    /// Distance beyond which the record does not serve.
    #[must_use]
    #[inline]
    pub fn reach(&self) -> f32 {
        self.reach
    }

    /// Expected error for a receiver over the tolerance; from 1 on the record does not serve.
    #[must_use]
    #[inline]
    pub fn error_at(&self, receiver: &Receiver) -> f32 {
        self.error(receiver.position, receiver.normal, receiver.plane)
    }

    /// [`Self::error_at`]; where a part of it alone is too large, some number above 1.
    #[inline]
    fn error(&self, position: Vec3, normal: Vec3, plane: Vec3) -> f32 {
        let turned = self.normal.distance_squared(normal);
        let turn = turned.max(self.plane.distance_squared(plane)) * self.inverse_turn2;
        let offset = position - self.position;
        let length2 = offset.length_squared();
        let height = offset.dot(0.5 * (self.plane + plane)).abs();
        let is_step = height * height > SURELY * STEP_SLOPE * STEP_SLOPE * length2;
        if turn >= 1.0 || is_step || height > SURELY * self.rise {
            return f32::INFINITY;
        }
        let length = length2.sqrt();
        let distance = length / self.reach;
        let step = height / (STEP_SLOPE * length + f32::MIN_POSITIVE);
        let error = distance + turn + height / self.rise + step;
        let is_behind =
            error < 1.0 && self.obstacles.are_reached(self.plane, offset, NEAREST_APPROACH);
        if is_behind { f32::INFINITY } else { error }
    }

    /// What a place gathers, extrapolated.
    #[inline]
    fn at(&self, position: Vec3, normal: Vec3) -> [f32; QUANTITIES] {
        let (offset, turn) = (position - self.position, normal - self.normal);
        let mut values = self.values;
        for (i, value) in values.iter_mut().enumerate() {
            *value += self.translation[i].dot(offset) + self.rotation[i].dot(turn);
        }
        values
    }

    /// Distance up to which the record serves as far as another tells: where its expectation is wrong there by more than it allows for itself
    /// and samples explain, it reaches no farther than to where that is the tolerance.
    #[must_use]
    pub fn reach_beside(&self, other: &Self, tolerance: &Tolerance) -> f32 {
        let expected_error = self.error(other.position, other.normal, other.plane);
        if expected_error >= 1.0 {
            return self.reach;
        }
        let expected = self.at(other.position, other.normal);
        let openness = expected[OCCLUSION] - other.values[OCCLUSION];
        let mismatches = [openness, light(&expected) - light(&other.values)];
        let share = |i: usize| {
            let by_samples = DEVIATIONS * (self.variances[i] + other.variances[i]).sqrt();
            let mismatch = larger(mismatches[i].abs() - by_samples, 0.0);
            mismatch / self.scales[i].min(other.scales[i])
        };
        let mismatch = if self.scales[1] > 0.0 { share(0).max(share(1)) } else { share(0) };
        if mismatch <= tolerance.share * expected_error {
            return self.reach;
        }
        self.reach.min(self.position.distance(other.position) * tolerance.share / mismatch)
    }

    /// Lets it serve no farther than this.
    pub fn limit_reach(&mut self, reach: f32) {
        self.reach = self.reach.min(reach);
    }
}

/// What is differentiated of a shading, in the order of `pbgi_brdf`.
fn quantities(shading: &Shading) -> [f32; QUANTITIES] {
    let Shading { surface_irradiance: s, environment_irradiance: e, .. } = shading;
    [s[0], s[1], s[2], e[0], e[1], e[2], shading.ambient_occlusion, shading.sky_visibility]
}

/// The mean of what records say of a receiver, each weighted by how far its expected error is below the tolerance.
#[derive(Clone, Copy, Debug, Default)]
pub struct Blend {
    values: [f32; QUANTITIES],
    bent_normal: Vec3,
    weight: f32,
}

impl Blend {
    /// Adds what a record says, if it serves for the receiver.
    #[inline]
    pub fn add(&mut self, record: &Record, receiver: &Receiver) {
        let weight = 1.0 - record.error_at(receiver);
        if weight <= 0.0 {
            return;
        }
        let values = record.at(receiver.position, receiver.normal);
        for (sum, value) in self.values.iter_mut().zip(values) {
            *sum += weight * value;
        }
        self.bent_normal += record.bent_normal * weight;
        self.weight += weight;
    }

    /// The mean, if any record served.
    #[must_use]
    pub fn shading(&self, receiver: &Receiver) -> Option<Shading> {
        if self.weight <= 0.0 {
            return None;
        }
        let v = self.values.map(|sum| (sum / self.weight).max(0.0));
        Some(Shading {
            surface_irradiance: [v[0], v[1], v[2]],
            environment_irradiance: [v[3], v[4], v[5]],
            ambient_occlusion: v[OCCLUSION].min(1.0),
            sky_visibility: v[SKY].min(1.0),
            bent_normal: self.bent_normal.try_normalize().unwrap_or(receiver.normal),
            ..Shading::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A record of so much occlusion at a place of a plane, of which samples make this variance.
    fn record(x: f32, openness: f32, variance: f32) -> Record {
        let mut values = [0.0; QUANTITIES];
        values[OCCLUSION] = openness;
        Record {
            position: x * Vec3::X,
            normal: Vec3::Z,
            plane: Vec3::Z,
            reach: 1.0,
            rise: 1.0,
            inverse_turn2: 1.0,
            obstacles: Obstacles::default(),
            values,
            bent_normal: Vec3::Z,
            translation: [Vec3::ZERO; QUANTITIES],
            rotation: [Vec3::ZERO; QUANTITIES],
            scales: [openness, 0.0],
            variances: [variance, 0.0],
        }
    }

    /// Two records that differ by five times what they may where they are agree if that is two standard deviations of what samples make of both.
    #[test]
    fn records_agree_within_what_samples_make_of_them() {
        let tolerance = Tolerance { share: 0.1, least: [0.0; 2] };
        let reach = |variance: f32| {
            record(0.0, 0.5, variance).reach_beside(&record(0.1, 0.525, variance), &tolerance)
        };
        // A tenth of a tenth of 0.5 may they differ by; they do by 0.025.
        let explained = 0.0105f32;
        assert_eq!(reach(0.5 * explained * explained), 1.0);
        assert!((reach(0.0) - 0.1 * 0.1 / 0.05).abs() < 1e-4, "{}", reach(0.0));
        let half = reach(0.125 * explained * explained);
        assert!(half > 0.2 && half < 0.5, "{half}");
    }
}
