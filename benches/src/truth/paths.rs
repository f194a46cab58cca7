//! Truth and its noise, and how long rays take for an error.

use crate::cases::{Case, Light, Quantity};
use crate::curve::Point;
use crate::workers::spread;
use anyhow::Result;
use pbgi_benches::{Caster, PATHS_MAX, ThreadTimer};
use pbgi_gather::Receiver;
use pbgi_image::compare;
use std::ops::Range;

/// Paths per receiver of the caster's curve of error against time.
const CURVE: [u32; 6] = [4, 16, 64, 256, 1024, 4096];

/// Seeds of the curve, apart from the truth's.
const CURVE_SEED: u32 = 0x5eed_0000;

/// Seeds of the second half of the truth.
const SECOND_SEED: u32 = 0x2a00_0000;

/// Paths of each half to begin with.
const FIRST_PATHS: u32 = 256;

/// Least processor time that is measured, in seconds: what takes less is done again.
pub const SECONDS_MIN: f64 = 0.1;

/// Truth for receivers, as two independent halves, whose difference tells its noise.
pub struct Truth {
    halves: [Vec<Light>; 2],
    /// The mean of both.
    pub light: Vec<Light>,
    /// Paths per receiver.
    pub paths: u32,
}

impl Truth {
    /// Doubles the paths until the noise of every quantity is at most `noise`, or `paths_max` are reached.
    pub fn cast(
        case: &Case,
        caster: &Caster,
        places: &[(usize, Receiver)],
        noise: f64,
        paths_max: u32,
    ) -> Result<Self> {
        let mut truth = Self { halves: Default::default(), light: Vec::new(), paths: 0 };
        let mut range = 0..FIRST_PATHS.min(paths_max / 2).max(1);
        loop {
            for (half, seed) in [0, SECOND_SEED].into_iter().enumerate() {
                let more = cast_all(case, caster, places, range.clone(), seed);
                let weight = range.len() as f32 / range.end as f32;
                if range.start == 0 {
                    truth.halves[half] = more;
                } else {
                    let lights = truth.halves[half].iter_mut().zip(&more);
                    lights.for_each(|(sum, more)| *sum = mix(sum, more, weight));
                }
            }
            let [first, second] = &truth.halves;
            truth.light = first.iter().zip(second).map(|(a, b)| mix(a, b, 0.5)).collect();
            truth.paths = 2 * range.end;
            let done = range.end >= PATHS_MAX || 4 * range.end > paths_max;
            if done || truth.noise_max(case)? <= noise {
                return Ok(truth);
            }
            range = range.end..2 * range.end;
        }
    }

    fn noise_max(&self, case: &Case) -> Result<f64> {
        let mut each = case.quantities().iter().map(|q| self.noise(*q));
        each.try_fold(0f64, |most, noise| Ok(most.max(noise?)))
    }

    /// rRMSE of the truth, by half the difference of its halves.
    pub fn noise(&self, quantity: Quantity) -> Result<f64> {
        let [first, second] = &self.halves;
        let truth = quantity.values(&self.light);
        let halves = quantity.values(first).into_iter().zip(quantity.values(second));
        let off: Vec<f32> = halves.zip(&truth).map(|((a, b), r)| r + 0.5 * (a - b)).collect();
        Ok(compare(&off, &truth)?.rrmse)
    }
}

/// Between two results, by the weight of the second.
fn mix(a: &Light, b: &Light, weight: f32) -> Light {
    let rgb = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|c| a[c] + (b[c] - a[c]) * weight);
    Light {
        openness: a.openness + (b.openness - a.openness) * weight,
        irradiance: rgb(a.irradiance, b.irradiance),
        reflected: rgb(a.reflected, b.reflected),
    }
}

/// What paths bring to one receiver; its pixel makes its estimate independent of others'.
fn cast(
    case: &Case,
    caster: &Caster,
    (pixel, r): &(usize, Receiver),
    paths: Range<u32>,
    seed: u32,
) -> Light {
    let seed = seed ^ *pixel as u32;
    if let (Some(alpha), Some(gloss)) = (case.gloss, r.gloss) {
        let reflected = caster.reflect(r.position, r.normal, gloss.toward_eye, alpha, paths, seed);
        return Light { reflected, ..Light::default() };
    }
    let found = caster.gather(r.position, r.normal, case.bounces, paths, seed);
    let irradiance = found.irradiance_from(0);
    Light { openness: found.openness as f32, irradiance, ..Light::default() }
}

fn cast_all(
    case: &Case,
    caster: &Caster,
    places: &[(usize, Receiver)],
    paths: Range<u32>,
    seed: u32,
) -> Vec<Light> {
    let some = |places: &[(usize, Receiver)]| -> Vec<Light> {
        places.iter().map(|place| cast(case, caster, place, paths.clone(), seed)).collect()
    };
    spread(places, some).concat()
}

/// Estimates by few to many paths with their microseconds per receiver, on this thread.
pub struct RayCurve(Vec<(u32, Vec<Light>, f64)>);

impl RayCurve {
    /// Up to a quarter of the truth's paths.
    pub fn cast(case: &Case, caster: &Caster, places: &[(usize, Receiver)], truth: &Truth) -> Self {
        let counts = CURVE.into_iter().filter(|count| 4 * count <= truth.paths);
        let estimate = |count: u32| {
            let (timer, mut rounds) = (ThreadTimer::start(), 0.0);
            loop {
                let one = |place| cast(case, caster, place, 0..count, CURVE_SEED ^ count);
                let found: Vec<Light> = places.iter().map(one).collect();
                rounds += 1.0;
                // The system counts in steps of milliseconds.
                let seconds = timer.seconds();
                if seconds >= SECONDS_MIN || places.is_empty() {
                    let us = seconds * 1e6 / (rounds * places.len().max(1) as f64);
                    return (count, found, us);
                }
            }
        };
        Self(counts.map(estimate).collect())
    }

    /// Errors without the noise of the truth. Those it drowns are left out.
    pub fn points(&self, quantity: Quantity, truth: &Truth) -> Result<Vec<Point>> {
        let (expected, noise) = (quantity.values(&truth.light), truth.noise(quantity)?);
        let mut points = Vec::new();
        for (count, found, microseconds) in &self.0 {
            let found = compare(&quantity.values(found), &expected)?.rrmse;
            if found > 2.0 * noise {
                let setting = format!("{count} paths");
                let error = without_noise(found, noise);
                points.push(Point { setting, microseconds: *microseconds, error });
            }
        }
        Ok(points)
    }
}

/// An error that was measured against noisy truth, without the noise; where that is the larger part, the noise: the error is no larger.
pub fn without_noise(error: f64, noise: f64) -> f64 {
    (error * error - noise * noise).max(noise * noise).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_taken_off_and_never_gives_less_than_itself() {
        assert!((without_noise(0.05, 0.03) - 0.04).abs() < 1e-12);
        assert_eq!(without_noise(0.031, 0.03), 0.03);
    }
}
