//! Choosing the solid angle by measuring: the coarsest one whose error on a sample of receivers is small enough.

use crate::PbgiError;
use crate::progress::Progress;
use crate::shade::check::SampleError;
use pbgi_gather::{GatherSettings, PreparedLight, Receiver, Shading};
use pbgi_schedule::{ShadeOptions, shade_receivers};
use pbgi_store::Octree;
use serde::Serialize;
use std::sync::atomic::AtomicBool;

/// Receivers that are measured.
pub(crate) const SAMPLE_RECEIVERS: usize = 250;

/// How many times the target the error of other receivers may be, as far as the sample tells.
const EXCESS: f64 = 1.3;

/// The coarsest solid angle that is tried, in steradians, and how many are, each finer by the square root of 2.
const COARSEST_SR: f32 = 2.5;
const TRIES: i32 = 33;

/// How often the gap between the last solid angle that does not do and the first that does is halved.
const HALVINGS: usize = 2;

/// The settings that were chosen for an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TargetReport {
    /// The relative root mean square error that was asked for.
    pub target: f64,
    /// The solid angle chosen, in steradians.
    pub solid_angle_sr: f32,
    /// Error of the sample with it: the larger of irradiance's, or ambient occlusion's where there is no light, and of gloss's.
    pub error: f64,
    /// What the error of as many other receivers is below, with two standard errors.
    pub error_bound: f64,
    /// Receivers of the sample.
    pub receivers: u64,
}

/// Where a sample is gathered.
pub(crate) struct Calibration<'a> {
    pub octree: &'a Octree,
    pub light: Option<&'a PreparedLight>,
    pub gather: GatherSettings,
    pub threads: usize,
    pub cancel: &'a AtomicBool,
}

impl Calibration<'_> {
    /// The coarsest of the solid angles tried with which the error of `receivers`, against taking every surfel, is below `target`, and that
    /// of others probably not far above; 0, which takes every surfel, if none is. Nothing depends on threads or memory.
    pub fn choose(
        &self,
        target: f64,
        receivers: &[Receiver],
        progress: &Progress,
    ) -> Result<TargetReport, PbgiError> {
        let phase = progress.start_phase("calibrate", "receivers", Some(receivers.len() as u64));
        let report = |solid_angle_sr, SampleError { rrmse: error, bound: error_bound }| {
            let receivers = receivers.len() as u64;
            TargetReport { target, solid_angle_sr, error, error_bound, receivers }
        };
        if receivers.is_empty() {
            return Ok(report(0.0, SampleError::default()));
        }
        let references = self.shade(0.0, receivers, &|done| phase.set_done(done))?;
        let measure = |solid_angle_sr: f32| -> Result<Option<SampleError>, PbgiError> {
            let found = self.shade(solid_angle_sr, receivers, &|_| ())?;
            let error = SampleError::new(&found, &references);
            Ok((error.rrmse <= target && error.bound <= EXCESS * target).then_some(error))
        };
        let mut coarse = None;
        for step in 0..TRIES {
            let fine = COARSEST_SR * 0.5f32.powf(0.5 * step as f32);
            if let Some(error) = measure(fine)? {
                let (fine, error) = between(coarse, (fine, error), measure)?;
                return Ok(report(fine, error));
            }
            coarse = Some(fine);
        }
        Ok(report(0.0, SampleError::default()))
    }

    fn shade(
        &self,
        solid_angle_sr: f32,
        receivers: &[Receiver],
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<Vec<Shading>, PbgiError> {
        let options = ShadeOptions {
            gather: GatherSettings { solid_angle_sr, ..self.gather },
            threads: self.threads,
            cancel: self.cancel,
            progress,
            ..ShadeOptions::default()
        };
        Ok(shade_receivers(self.octree, self.light, receivers, &options)?.0)
    }
}

/// The coarsest solid angle found that does, with its error, between one that does not and one that does.
fn between(
    coarse: Option<f32>,
    mut fine: (f32, SampleError),
    measure: impl Fn(f32) -> Result<Option<SampleError>, PbgiError>,
) -> Result<(f32, SampleError), PbgiError> {
    let Some(mut coarse) = coarse else { return Ok(fine) };
    for _ in 0..HALVINGS {
        let middle = (coarse * fine.0).sqrt();
        match measure(middle)? {
            Some(error) => fine = (middle, error),
            None => coarse = middle,
        }
    }
    Ok(fine)
}

/// Every so many of `count`, so that about [`SAMPLE_RECEIVERS`] are taken, from the middles of equal parts.
pub(crate) fn spread(count: usize) -> impl Iterator<Item = usize> {
    let wanted = SAMPLE_RECEIVERS.min(count);
    (0..wanted).map(move |i| (2 * i + 1) * count / (2 * wanted.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gap_is_halved_toward_the_coarsest_that_does() {
        let error = SampleError { rrmse: 0.01, bound: 0.01 };
        for (limit, expected) in [(0.65, 0.5f32.powf(0.75)), (0.8, 0.5f32.powf(0.5)), (0.5, 0.5)] {
            let measure = |sr: f32| Ok((sr <= limit).then_some(error));
            let (found, _) = between(Some(1.0), (0.5, error), measure).unwrap();
            assert!((found - expected).abs() < 1e-5, "{limit}: {found}");
        }
        let first = between(None, (0.5, error), |_| unreachable!()).unwrap();
        assert_eq!(first.0, 0.5);
    }

    #[test]
    fn samples_are_spread_over_all() {
        assert_eq!(spread(0).count(), 0);
        assert_eq!(spread(3).collect::<Vec<_>>(), [0, 1, 2]);
        let some: Vec<usize> = spread(1_000_000).collect();
        assert_eq!(some.len(), SAMPLE_RECEIVERS);
        assert!(some[0] < 4000 && some[SAMPLE_RECEIVERS - 1] > 990_000);
        assert!(some.windows(2).all(|w| w[1] - w[0] == 4000));
    }
}
