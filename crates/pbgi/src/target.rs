//! Choosing the solid angle by measuring: the coarsest one whose error on a sample of receivers is small enough.

use crate::PbgiError;
use crate::check::sample_error;
use crate::progress::Progress;
use pbgi_schedule::{
    GatherSettings, PreparedLight, Receiver, ScheduleError, ShadeOptions, shade_receivers,
};
use pbgi_store::Octree;
use serde::Serialize;
use std::sync::atomic::AtomicBool;

/// Receivers that are measured.
pub(crate) const SAMPLE_RECEIVERS: usize = 160;

/// Share of the target that the sample's error may have: other receivers differ.
const MARGIN: f64 = 0.9;

/// The coarsest solid angle that is tried, in steradians, and how many are, each finer by the square root of 2.
const COARSEST_SR: f32 = 0.9;
const TRIES: i32 = 30;

/// The settings that were chosen for an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TargetReport {
    /// The relative root mean square error that was asked for.
    pub target: f64,
    /// The solid angle chosen, in steradians.
    pub solid_angle_sr: f32,
    /// Error of the sample with it: the larger of irradiance's, or ambient occlusion's where there is no light, and of gloss's.
    pub error: f64,
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
    /// The coarsest of a row of solid angles with which the error of `receivers`, against taking every surfel, is below `target`; 0, which
    /// takes every surfel, if none is. Nothing depends on threads or memory.
    pub fn choose(
        &self,
        target: f64,
        receivers: &[Receiver],
        progress: &Progress,
    ) -> Result<TargetReport, PbgiError> {
        let phase = progress.start_phase("calibrate", "receivers", Some(receivers.len() as u64));
        let shade = |solid_angle_sr: f32, progress: &(dyn Fn(u64) + Sync)| {
            let options = ShadeOptions {
                gather: GatherSettings { solid_angle_sr, ..self.gather },
                threads: self.threads,
                cancel: self.cancel,
                progress,
                ..ShadeOptions::default()
            };
            shade_receivers(self.octree, self.light, receivers, &options).map(|(found, _)| found)
        };
        let count = receivers.len() as u64;
        let exact = |error| TargetReport { target, solid_angle_sr: 0.0, error, receivers: count };
        if receivers.is_empty() {
            return Ok(exact(0.0));
        }
        let references = shade(0.0, &|done| phase.set_done(done))?;
        for step in 0..TRIES {
            let solid_angle_sr = COARSEST_SR * 0.5f32.powf(0.5 * step as f32);
            let found: Result<_, ScheduleError> = shade(solid_angle_sr, &|_| ());
            let error = sample_error(&found?, &references);
            if error <= MARGIN * target {
                return Ok(TargetReport { target, solid_angle_sr, error, receivers: count });
            }
        }
        Ok(exact(0.0))
    }
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
    fn samples_are_spread_over_all() {
        assert_eq!(spread(0).count(), 0);
        assert_eq!(spread(3).collect::<Vec<_>>(), [0, 1, 2]);
        let some: Vec<usize> = spread(1_000_000).collect();
        assert_eq!(some.len(), SAMPLE_RECEIVERS);
        assert!(some[0] < 6250 && some[SAMPLE_RECEIVERS - 1] > 990_000);
        assert!(some.windows(2).all(|w| w[1] - w[0] == 6250));
    }
}
