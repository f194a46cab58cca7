//! Batches of neighboring receivers, shared out to workers; results in the receivers' order.

use crate::gather::{GatherSettings, Gatherer};
use crate::light::PreparedLight;
use crate::receiver::{Receiver, Shading};
use pbgi_cut::CutStats;
use pbgi_math::{Aabb, RootCube};
use pbgi_store::{Octree, StoreError};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Receivers of a batch: neighbors along the Morton curve, shaded by one worker.
const BATCH_RECEIVERS: usize = 64;

/// How to shade.
#[derive(Clone, Copy)]
pub struct ShadeOptions<'a> {
    /// Quality.
    pub gather: GatherSettings,
    /// Worker threads, at least 1.
    pub threads: usize,
    /// Set from outside to stop.
    pub cancel: &'a AtomicBool,
    /// Told the number of receivers done, now and then, from any worker.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

static NEVER: AtomicBool = AtomicBool::new(false);

impl Default for ShadeOptions<'_> {
    fn default() -> Self {
        Self { gather: GatherSettings::default(), threads: 1, cancel: &NEVER, progress: &|_| {} }
    }
}

/// Why shading stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScheduleError {
    /// The octree file failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A receiver is not a place with a direction.
    #[error(
        "receiver {index} has position {position} and normal {normal}; expected finite numbers and a normal of unit length"
    )]
    BadReceiver {
        /// Its index.
        index: usize,
        /// Its position.
        position: String,
        /// Its normal.
        normal: String,
    },
    /// Stopped from outside.
    #[error("interrupted")]
    Cancelled,
}

/// What shading did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShadeReport {
    /// Receivers shaded.
    pub receivers: u64,
    /// Sums over their cuts.
    pub cut: CutStats,
    /// Seconds of wall time.
    pub seconds: f64,
}

/// Shades receivers in batches of Morton neighbors and returns their results in the order given.
///
/// Which worker shades which batch is left to chance; the results are not.
///
/// # Errors
///
/// If a receiver is not finite, the octree file fails, or on cancellation.
pub fn shade_receivers(
    octree: &Octree,
    light: Option<&PreparedLight>,
    receivers: &[Receiver],
    options: &ShadeOptions<'_>,
) -> Result<(Vec<Shading>, ShadeReport), ScheduleError> {
    let start = std::time::Instant::now();
    let order = morton_order(receivers)?;
    let next = AtomicUsize::new(0);
    let done = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let work = || -> Result<(Vec<(u32, Shading)>, CutStats), ScheduleError> {
        let mut gatherer = Gatherer::new(octree.reader(), &options.gather, light);
        let mut results = Vec::new();
        while !failed.load(Ordering::Relaxed) {
            if options.cancel.load(Ordering::Relaxed) {
                return Err(ScheduleError::Cancelled);
            }
            let first = next.fetch_add(BATCH_RECEIVERS, Ordering::Relaxed);
            if first >= order.len() {
                break;
            }
            let batch = &order[first..(first + BATCH_RECEIVERS).min(order.len())];
            for &index in batch {
                let shading = gatherer.gather(&receivers[index as usize]).inspect_err(|_| {
                    failed.store(true, Ordering::Relaxed);
                })?;
                results.push((index, shading));
            }
            let before = done.fetch_add(batch.len(), Ordering::Relaxed);
            (options.progress)((before + batch.len()) as u64);
        }
        Ok((results, gatherer.stats()))
    };
    let parts: Vec<_> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.threads.max(1)).map(|_| scope.spawn(work)).collect();
        workers
            .into_iter()
            .map(|w| w.join().unwrap_or_else(|p| std::panic::resume_unwind(p)))
            .collect()
    });
    let mut shadings = vec![Shading::default(); receivers.len()];
    let mut report = ShadeReport { receivers: receivers.len() as u64, ..ShadeReport::default() };
    for part in parts {
        let (results, cut) = part?;
        report.cut.add(&cut);
        for (index, shading) in results {
            shadings[index as usize] = shading;
        }
    }
    report.seconds = start.elapsed().as_secs_f64();
    Ok((shadings, report))
}

/// Indices of the receivers along the Morton curve of their own bounds, ties in the order given.
fn morton_order(receivers: &[Receiver]) -> Result<Vec<u32>, ScheduleError> {
    for (index, receiver) in receivers.iter().enumerate() {
        let unit = (receiver.normal.length_squared() - 1.0).abs() < 1e-2;
        if !receiver.position.is_finite() || !unit {
            return Err(ScheduleError::BadReceiver {
                index,
                position: receiver.position.to_string(),
                normal: receiver.normal.to_string(),
            });
        }
    }
    let root = RootCube::from_bounds(&Aabb::from_points(receivers.iter().map(|r| r.position)));
    let mut keyed: Vec<(u64, u32)> =
        receivers.iter().enumerate().map(|(i, r)| (root.code(r.position).0, i as u32)).collect();
    keyed.sort_unstable();
    Ok(keyed.into_iter().map(|(_, index)| index).collect())
}
