//! The measured error of a result: a sample of its receivers gathered again, exhaustively.

use pbgi_gather::{Receiver, Shading};
use pbgi_image::{ErrorMetrics, MetricsError, compare, squared_errors};
use serde::Serialize;
use std::collections::BinaryHeap;

/// A receiver of the sample with the result that is to be judged.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampled {
    hash: u64,
    pub index: u64,
    pub receiver: Receiver,
    pub shading: Shading,
}

impl PartialEq for Sampled {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Sampled {}

impl PartialOrd for Sampled {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Sampled {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.hash, self.index).cmp(&(other.hash, other.index))
    }
}

/// Keeps the receivers whose indices have the smallest hashes: an even sample of a stream of
/// unknown length that depends on the indices only, not on how the stream is cut.
#[derive(Debug, Default)]
pub(crate) struct CheckSample {
    wanted: usize,
    /// Receivers offered so far.
    pub offered: u64,
    kept: BinaryHeap<Sampled>,
}

impl CheckSample {
    /// A sample of at most `wanted` receivers.
    pub fn new(wanted: usize) -> Self {
        Self { wanted, offered: 0, kept: BinaryHeap::with_capacity(wanted.min(1 << 20) + 1) }
    }

    /// Offers receivers with their results. `ids` tell them apart whatever the order they come in; without them, that order counts.
    pub fn offer_all(&mut self, receivers: &[Receiver], ids: Option<&[u64]>, shadings: &[Shading]) {
        for (offset, (receiver, shading)) in receivers.iter().zip(shadings).enumerate() {
            let id = ids.map_or(self.offered + offset as u64, |ids| ids[offset]);
            self.offer(id, receiver, shading);
        }
        self.offered += receivers.len() as u64;
    }

    fn offer(&mut self, index: u64, receiver: &Receiver, shading: &Shading) {
        if self.wanted == 0 {
            return;
        }
        let hash = mix(index);
        if self.kept.len() == self.wanted && self.kept.peek().is_some_and(|last| last.hash < hash) {
            return;
        }
        self.kept.push(Sampled { hash, index, receiver: *receiver, shading: *shading });
        if self.kept.len() > self.wanted {
            self.kept.pop();
        }
    }

    /// The sample in the order of the receivers.
    pub fn into_sorted(self) -> Vec<Sampled> {
        let mut sample = self.kept.into_vec();
        sample.sort_unstable_by_key(|s| s.index);
        sample
    }
}

/// The finalizer of SplitMix64 (Steele, Lea and Flood 2014).
fn mix(index: u64) -> u64 {
    let z = index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Error of a result against the exhaustive gather of the same receivers (solid angle 0, same
/// raster): that of the cut and of interpolation. See [`pbgi_image::ErrorMetrics`] for the measures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckReport {
    /// Receivers gathered again.
    pub receivers: u64,
    /// What was compared: `irradiance`, or `AO` where there is no light.
    pub quantity: &'static str,
    /// Relative root mean square error; 0.01 is one percent.
    pub rrmse: f64,
    /// Mean error relative to the mean.
    pub bias: f64,
    /// 95th percentile of the relative error.
    pub p95: f64,
    /// 99th percentile of the relative error.
    pub p99: f64,
    /// Largest relative error.
    pub max: f64,
    /// Mean entries of the exhaustive cuts.
    pub cut_mean: f64,
    /// Seconds the exhaustive gathers took.
    pub seconds: f64,
    /// What of the error is due to interpolation: the result against gathers of each receiver by itself with the same cut. None where nothing is
    /// interpolated.
    pub interpolation: Option<PartReport>,
    /// Error of glossy reflections, if there are any.
    pub gloss: Option<PartReport>,
}

/// A part of the error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PartReport {
    /// Relative root mean square error; 0.01 is one percent.
    pub rrmse: f64,
    /// Mean error relative to the mean.
    pub bias: f64,
    /// 99th percentile of the relative error.
    pub p99: f64,
}

impl PartReport {
    /// Compares irradiance, or ambient occlusion where there is no light; none where both are black.
    pub(crate) fn of_light(results: &[Sampled], references: &[Shading]) -> Option<Self> {
        let (metrics, _) = measure(results.iter().map(|s| &s.shading), references).ok()?;
        Some(metrics.into())
    }

    /// Compares what is reflected glossily; none where nothing is.
    fn of_gloss<'a>(
        results: impl Iterator<Item = &'a Shading>,
        references: &[Shading],
    ) -> Option<Self> {
        let results: Vec<f32> = results.flat_map(|s| s.reflected).collect();
        let truths: Vec<f32> = references.iter().flat_map(|s| s.reflected).collect();
        Some(compare(&results, &truths).ok()?.into())
    }
}

impl From<ErrorMetrics> for PartReport {
    fn from(ErrorMetrics { rrmse, bias, p99, .. }: ErrorMetrics) -> Self {
        Self { rrmse, bias, p99 }
    }
}

/// Error of results, and whether it is that of irradiance: of all channels where anything shines, of ambient
/// occlusion otherwise.
fn measure<'a>(
    results: impl Iterator<Item = &'a Shading>,
    references: &[Shading],
) -> Result<(ErrorMetrics, bool), MetricsError> {
    let lit = is_lit(references);
    let results: Vec<f32> = results.flat_map(|s| judged(s, lit)).collect();
    let truths: Vec<f32> = references.iter().flat_map(|s| judged(s, lit)).collect();
    Ok((compare(&results, &truths)?, lit))
}

fn is_lit(references: &[Shading]) -> bool {
    references.iter().any(|s| s.irradiance().iter().any(|c| *c > 0.0))
}

/// What of a shading is judged besides gloss.
fn judged(shading: &Shading, lit: bool) -> Vec<f32> {
    if lit { shading.irradiance().to_vec() } else { vec![shading.ambient_occlusion] }
}

/// Relative root mean square error of a sample of receivers, and what it says of others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SampleError {
    /// That of the sample.
    pub rrmse: f64,
    /// What that of another sample of the size is below, with two standard errors: squares are means of few large ones.
    pub bound: f64,
}

impl SampleError {
    /// The larger of that of irradiance, or ambient occlusion where there is no light, and that of gloss; 0 of what is dark.
    pub fn new(results: &[Shading], references: &[Shading]) -> Self {
        let lit = is_lit(references);
        let light = Self::of(results, references, |s| judged(s, lit));
        let gloss = Self::of(results, references, |s| s.reflected.to_vec());
        Self { rrmse: light.rrmse.max(gloss.rrmse), bound: light.bound.max(gloss.bound) }
    }

    fn of(
        results: &[Shading],
        references: &[Shading],
        values: impl Fn(&Shading) -> Vec<f32>,
    ) -> Self {
        let all = |shadings: &[Shading]| shadings.iter().flat_map(&values).collect::<Vec<f32>>();
        let Ok(squares) = squared_errors(&all(results), &all(references)) else {
            return Self::default();
        };
        // Channels of a receiver err alike.
        let channels = squares.len() / references.len().max(1);
        let receivers = squares.chunks_exact(channels.max(1));
        let means: Vec<f64> = receivers.map(|c| c.iter().sum::<f64>() / channels as f64).collect();
        let count = means.len() as f64;
        let mean = means.iter().sum::<f64>() / count;
        let variance =
            means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        let bound = mean + 2.0 * (variance / count).sqrt();
        Self { rrmse: mean.sqrt(), bound: bound.sqrt() }
    }
}

impl CheckReport {
    /// Compares `sample` with its `references`: irradiance of all channels where anything shines,
    /// ambient occlusion otherwise.
    ///
    /// # Errors
    ///
    /// If the references are all dark, or a value is not finite.
    pub(crate) fn new(sample: &[Sampled], references: &[Shading]) -> Result<Self, MetricsError> {
        let (metrics, lit) = measure(sample.iter().map(|s| &s.shading), references)?;
        let ErrorMetrics { rrmse, bias, p95, p99, max, .. } = metrics;
        let cuts: f64 = references.iter().map(|s| f64::from(s.cut_size)).sum();
        Ok(Self {
            receivers: sample.len() as u64,
            quantity: if lit { "irradiance" } else { "AO" },
            rrmse,
            bias,
            p95,
            p99,
            max,
            cut_mean: cuts / references.len().max(1) as f64,
            seconds: 0.0,
            interpolation: None,
            gloss: PartReport::of_gloss(sample.iter().map(|s| &s.shading), references),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_is_two_standard_errors_above() {
        let shading = |x: f32| Shading { ambient_occlusion: x, ..Shading::default() };
        let truths = vec![shading(1.0); 100];
        let found: Vec<Shading> =
            (0..100).map(|i| shading(if i % 10 == 0 { 1.2 } else { 1.0 })).collect();
        let error = SampleError::new(&found, &truths);
        let square = 0.04 / 1.01;
        assert!((error.rrmse - f64::sqrt(0.1 * square)).abs() < 1e-6);
        // The variance of a share p of 100 is p (1 − p) / 99.
        let spread = f64::sqrt(0.1 * 0.9 / 99.0);
        assert!((error.bound - f64::sqrt((0.1 + 2.0 * spread) * square)).abs() < 1e-6);
        // Three channels that err alike tell no more than one.
        let colored = |s: &[Shading]| -> Vec<Shading> {
            let light =
                |s: &Shading| Shading { reflected: [s.ambient_occlusion; 3], ..shading(1.0) };
            s.iter().map(light).collect()
        };
        let gloss = SampleError::new(&colored(&found), &colored(&truths));
        assert!((gloss.bound - error.bound).abs() < 1e-6);
    }

    fn sample(count: u64, wanted: usize) -> Vec<Sampled> {
        let mut sample = CheckSample::new(wanted);
        for index in 0..count {
            sample.offer(index, &Receiver::default(), &Shading::default());
        }
        sample.into_sorted()
    }

    #[test]
    fn samples_have_the_wanted_size_and_are_spread() {
        assert_eq!(sample(10, 0).len(), 0);
        assert_eq!(sample(10, 20).len(), 10);
        let spread = sample(100_000, 200);
        assert_eq!(spread.len(), 200);
        for tenth in 0..10 {
            let here = spread.iter().filter(|s| s.index / 10_000 == tenth).count();
            // Binomial: 20 ± 4.2; five deviations.
            assert!((0..=41).contains(&here) && here > 2, "{tenth}: {here}");
        }
    }

    #[test]
    fn errors_are_those_of_irradiance_or_of_occlusion() {
        let lit = Shading { surface_irradiance: [1.0; 3], ..Shading::default() };
        let off = Shading { surface_irradiance: [1.1; 3], ..Shading::default() };
        let sampled =
            |shading| Sampled { hash: 0, index: 0, receiver: Receiver::default(), shading };
        let report = CheckReport::new(&[sampled(off)], &[lit]).unwrap();
        assert_eq!(report.quantity, "irradiance");
        assert!((report.bias - 0.1).abs() < 1e-6);
        let open = Shading { ambient_occlusion: 0.5, ..Shading::default() };
        let report = CheckReport::new(&[sampled(open)], &[open]).unwrap();
        assert_eq!((report.quantity, report.rrmse), ("AO", 0.0));
        assert!(CheckReport::new(&[sampled(off)], &[Shading::default()]).is_err());
    }
}
