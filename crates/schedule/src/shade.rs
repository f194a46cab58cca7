//! Receivers as a stream: chunks come in, neighbors go to workers in batches, results come out in the order of the receivers.

use crate::queue::{Chunk, Queue, StopOnDrop};
use crate::records::{KeptRecords, RecordShader};
use crate::spread::Spread;
use pbgi_gather::{CutStats, GatherSettings, Gatherer, PreparedLight, Receiver, Shading};
use pbgi_math::{Aabb, RootCube};
use pbgi_store::{Octree, StoreError};
use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};

/// Chunks that are shaded or wait to be taken at the same time; while one is written, workers have the other.
pub const CHUNKS_IN_FLIGHT: usize = 2;

/// Bytes held per receiver of a chunk in flight, besides what the caller attaches to it.
pub const RECEIVER_BYTES_IN_FLIGHT: usize =
    size_of::<Receiver>() + size_of::<Shading>() + size_of::<(u64, u32)>() + size_of::<u32>();

/// In which order the receivers of a chunk are shaded. Changes no result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReceiverOrder {
    /// Along the Morton curve, so that neighbors share pages.
    #[default]
    Morton,
    /// As they come, to measure other orders.
    AsGiven,
}

/// How to shade.
#[derive(Clone, Copy)]
pub struct ShadeOptions<'a> {
    /// Quality.
    pub gather: GatherSettings,
    /// Worker threads, at least 1.
    pub threads: usize,
    /// Order within a chunk.
    pub order: ReceiverOrder,
    /// Set from outside to stop.
    pub cancel: &'a AtomicBool,
    /// Told the number of receivers done, now and then, from any worker.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

static NEVER: AtomicBool = AtomicBool::new(false);

impl Default for ShadeOptions<'_> {
    fn default() -> Self {
        Self {
            gather: GatherSettings::default(),
            threads: 1,
            order: ReceiverOrder::Morton,
            cancel: &NEVER,
            progress: &|_| {},
        }
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
        /// Its index among all receivers.
        index: u64,
        /// Its position.
        position: String,
        /// Its normal.
        normal: String,
    },
    /// Stopped from outside.
    #[error("interrupted")]
    Cancelled,
}

/// What shading did. Only seconds depend on threads and chance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShadeReport {
    /// Receivers shaded.
    pub receivers: u64,
    /// Batches they were divided into.
    pub batches: u64,
    /// Sums over their cuts.
    pub cut: CutStats,
    /// Entries of the cuts.
    pub cut_sizes: Spread,
    /// Seconds of wall time.
    pub seconds: f64,
    /// Seconds workers waited for receivers, summed over workers.
    pub idle_seconds: f64,
}

impl ShadeReport {
    /// Seconds workers spent in the shared cache, reading pages or waiting for them, summed over workers.
    #[must_use]
    pub fn wait_seconds(&self) -> f64 {
        self.cut.levels.iter().map(|level| level.wait_ns).sum::<u64>() as f64 * 1e-9
    }

    /// Adds what another run did.
    pub fn add(&mut self, other: &Self) {
        self.receivers += other.receivers;
        self.batches += other.batches;
        self.cut.add(&other.cut);
        self.cut_sizes.add(&other.cut_sizes);
        self.seconds += other.seconds;
        self.idle_seconds += other.idle_seconds;
    }
}

/// A chunk with its results, in the order it was pushed.
pub struct Shaded<'s, T> {
    /// The receivers.
    pub receivers: &'s [Receiver],
    /// Their results.
    pub shadings: Vec<Shading>,
    /// What was attached to them.
    pub attached: T,
}

/// Where chunks of receivers are pushed into a running stream.
pub struct Feed<'q, 'r, T, E> {
    shades: Shades<'q, 'r, T>,
    pushed: u64,
    take: &'q mut dyn FnMut(Shaded<'_, T>) -> Result<(), E>,
}

/// Shades a chunk by records.
type ShadeChunk<'s> = dyn FnMut(&[Receiver]) -> Result<Vec<Shading>, ScheduleError> + 's;

/// How a stream's chunks are shaded.
enum Shades<'q, 'r, T> {
    /// Each receiver by itself, by workers that have several chunks under way; with what is attached to these.
    Alone { queue: &'q Queue<'r>, order: ReceiverOrder, attached: VecDeque<T> },
    /// With records, chunk by chunk.
    ByRecords(&'q mut ShadeChunk<'q>),
}

impl<'r, T, E: From<ScheduleError>> Feed<'_, 'r, T, E> {
    /// Hands a chunk to the workers, with whatever belongs to it. Where [`CHUNKS_IN_FLIGHT`] are under way, waits for the oldest and has
    /// it taken first; where receivers share records, it is shaded and taken at once.
    ///
    /// # Errors
    ///
    /// If a receiver is no place with a direction, a worker failed, or from taking a chunk.
    pub fn push(&mut self, receivers: Cow<'r, [Receiver]>, attached: T) -> Result<(), E> {
        check_receivers(&receivers, self.pushed)?;
        self.pushed += receivers.len() as u64;
        match &mut self.shades {
            Shades::ByRecords(shade) => {
                let shadings = shade(&receivers)?;
                (self.take)(Shaded { receivers: &receivers, shadings, attached })
            }
            Shades::Alone { queue, order, attached: waiting } => {
                while waiting.len() >= CHUNKS_IN_FLIGHT {
                    take_oldest(queue, waiting, self.take)?;
                }
                let order = match order {
                    ReceiverOrder::Morton => morton_order(&receivers),
                    ReceiverOrder::AsGiven => (0..receivers.len() as u32).collect(),
                };
                waiting.push_back(attached);
                queue.push(Chunk { receivers, order });
                Ok(())
            }
        }
    }

    /// Has all chunks taken that are under way.
    fn drain(&mut self) -> Result<(), E> {
        let Shades::Alone { queue, attached, .. } = &mut self.shades else { return Ok(()) };
        while !attached.is_empty() {
            take_oldest(queue, attached, self.take)?;
        }
        Ok(())
    }
}

fn take_oldest<T, E: From<ScheduleError>>(
    queue: &Queue<'_>,
    attached: &mut VecDeque<T>,
    take: &mut dyn FnMut(Shaded<'_, T>) -> Result<(), E>,
) -> Result<(), E> {
    let Some(attached) = attached.pop_front() else { return Ok(()) };
    let (chunk, shadings) = queue.take_oldest()?;
    take(Shaded { receivers: &chunk.receivers, shadings, attached })
}

/// Shades a stream of receivers: `fill` pushes them into a [`Feed`] chunk by chunk, `take` gets each chunk with its results, in the order
/// of pushing; both run on the calling thread.
///
/// Where each receiver gathers for itself, workers shade while `fill` and `take` run; batches of Morton neighbors go to them one after the other, so
/// that these share pages. Which worker shades which batch is left to chance; the results are not. Holds [`CHUNKS_IN_FLIGHT`] chunks and what
/// `fill` and `take` hold.
///
/// Where receivers share records ([`GatherSettings::tolerance`]), a chunk is shaded when it is pushed; its records are left in `kept` for the next one,
/// [`RECORD_BYTES`](crate::RECORD_BYTES) for each receiver at most.
///
/// # Errors
///
/// From `fill` or `take`, if a receiver is not finite, the octree file fails, or on cancellation.
pub fn shade_stream<'r, T, E: From<ScheduleError>>(
    octree: &Octree,
    light: Option<&PreparedLight>,
    options: &ShadeOptions<'_>,
    kept: &mut KeptRecords,
    fill: impl FnOnce(&mut Feed<'_, 'r, T, E>) -> Result<(), E>,
    mut take: impl FnMut(Shaded<'_, T>) -> Result<(), E>,
) -> Result<ShadeReport, E> {
    let start = std::time::Instant::now();
    let mut report = if options.gather.tolerance > 0.0 {
        let mut shader = RecordShader::new(octree, light, options, kept);
        let mut shade = |receivers: &[Receiver]| shader.shade(receivers);
        fill(&mut Feed { shades: Shades::ByRecords(&mut shade), pushed: 0, take: &mut take })?;
        shader.report()
    } else {
        shade_alone(octree, light, options, fill, &mut take)?
    };
    report.seconds = start.elapsed().as_secs_f64();
    Ok(report)
}

/// Shades a stream of receivers of which each gathers for itself.
fn shade_alone<'r, T, E: From<ScheduleError>>(
    octree: &Octree,
    light: Option<&PreparedLight>,
    options: &ShadeOptions<'_>,
    fill: impl FnOnce(&mut Feed<'_, 'r, T, E>) -> Result<(), E>,
    take: &mut dyn FnMut(Shaded<'_, T>) -> Result<(), E>,
) -> Result<ShadeReport, E> {
    let queue = Queue::default();
    let work = || {
        let guard = StopOnDrop(&queue);
        let done = run_worker(octree, light, options, &queue);
        std::mem::forget(guard);
        done
    };
    let (fed, parts) = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.threads.max(1)).map(|_| scope.spawn(work)).collect();
        let guard = StopOnDrop(&queue);
        let attached = VecDeque::with_capacity(CHUNKS_IN_FLIGHT);
        let shades = Shades::Alone { queue: &queue, order: options.order, attached };
        let mut feed = Feed { shades, pushed: 0, take };
        let fed = fill(&mut feed).and_then(|()| feed.drain());
        drop(guard);
        let join = |worker: std::thread::ScopedJoinHandle<'_, ShadeReport>| {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        (fed, workers.into_iter().map(join).collect::<Vec<_>>())
    });
    fed?;
    let mut report = ShadeReport::default();
    parts.iter().for_each(|part| report.add(part));
    Ok(report)
}

/// Shades batches until there are no more; a failure stops the queue.
fn run_worker(
    octree: &Octree,
    light: Option<&PreparedLight>,
    options: &ShadeOptions<'_>,
    queue: &Queue<'_>,
) -> ShadeReport {
    let mut gatherer = Gatherer::new(octree.reader(), &options.gather, light);
    let mut report = ShadeReport::default();
    let mut shadings = Vec::new();
    let mut idle_ns = 0;
    loop {
        let (batch, waited_ns) = queue.next_batch();
        idle_ns += waited_ns;
        let Some(batch) = batch else { break };
        shadings.clear();
        for index in batch.indices() {
            if options.cancel.load(Ordering::Relaxed) {
                queue.stop(Some(ScheduleError::Cancelled));
                break;
            }
            match gatherer.gather(&batch.chunk.receivers[*index as usize]) {
                Ok(shading) => shadings.push(shading),
                Err(error) => {
                    queue.stop(Some(ScheduleError::Store(error)));
                    break;
                }
            }
        }
        if shadings.len() < batch.indices().len() {
            break;
        }
        shadings.iter().for_each(|shading| report.cut_sizes.note(u64::from(shading.cut_size)));
        report.batches += 1;
        report.receivers += shadings.len() as u64;
        (options.progress)(queue.complete(batch, &shadings));
    }
    report.cut = gatherer.stats();
    report.idle_seconds = idle_ns as f64 * 1e-9;
    report
}

/// Shades receivers that are all at hand and returns their results in the order given. See [`shade_stream`].
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
    let mut shadings = Vec::new();
    let report = shade_stream(
        octree,
        light,
        options,
        &mut KeptRecords::default(),
        |feed: &mut Feed<'_, '_, (), ScheduleError>| feed.push(Cow::Borrowed(receivers), ()),
        |chunk| {
            shadings = chunk.shadings;
            Ok(())
        },
    )?;
    Ok((shadings, report))
}

/// Refuses receivers that are no places with directions. The first is the `first`th of all.
fn check_receivers(receivers: &[Receiver], first: u64) -> Result<(), ScheduleError> {
    for (index, receiver) in receivers.iter().enumerate() {
        let unit = (receiver.normal.length_squared() - 1.0).abs() < 1e-2;
        if !receiver.position.is_finite() || !unit {
            return Err(ScheduleError::BadReceiver {
                index: first + index as u64,
                position: receiver.position.to_string(),
                normal: receiver.normal.to_string(),
            });
        }
    }
    Ok(())
}

/// Indices of the receivers along the Morton curve of their own bounds, ties in the order given.
pub(crate) fn morton_order(receivers: &[Receiver]) -> Vec<u32> {
    let root = RootCube::from_bounds(&Aabb::from_points(receivers.iter().map(|r| r.position)));
    let mut keyed: Vec<(u64, u32)> =
        receivers.iter().enumerate().map(|(i, r)| (root.code(r.position).0, i as u32)).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, index)| index).collect()
}
