//! Receivers that share irradiance records: some gather, the others blend what these have found.
//!
//! A chunk is shaded in three steps, each by all workers. Runs of neighbors along the Morton curve are covered with records, each run by itself, from
//! coarse to fine. Records are limited to where those around agree with them, whatever run made them. Then each receiver takes the mean of what the
//! records around it say, and gathers only where none serves. So results depend on the chunk and on the one before it, and on nothing else.

use crate::shade::{ScheduleError, ShadeOptions, ShadeReport, morton_order};
use crate::spread::Spread;
use pbgi_gather::{
    Blend, GatherParts, Gatherer, PreparedLight, Receiver, Record, Shading, Tolerance,
};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::Octree;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Receivers of a run. Of half as many, more lie at borders between runs, and more gather for themselves; twice as many leave less work to share out.
const RUN_RECEIVERS: usize = 1024;

/// Receivers, or records, that look for the records around them together.
const BLOCK: usize = 64;

/// Expected error over the tolerance from which a receiver gathers for itself: below 1, so that records overlap where they are blended.
const COVERED: f32 = 0.5;

/// Receivers of a chunk whose mean tells what is dark.
const SAMPLE_RECEIVERS: usize = 32;

/// Bytes held per receiver, where each gathers for itself.
pub const RECORD_BYTES: usize = size_of::<Record>() + size_of::<[f32; 4]>();

/// Records of a chunk, for the one that follows.
#[derive(Debug, Default)]
pub struct KeptRecords(Vec<Record>);

/// Shades receivers chunk by chunk with records.
pub(crate) struct RecordShader<'a, 'o, 'k> {
    workers: Vec<Worker<'a>>,
    options: &'o ShadeOptions<'o>,
    kept: &'k mut KeptRecords,
    receivers: u64,
    runs: u64,
}

/// One thread's.
struct Worker<'a> {
    gatherer: Gatherer<'a>,
    cut_sizes: Spread,
}

impl Worker<'_> {
    /// Gathers broad light for a receiver.
    fn gather_broad(&mut self, receiver: &Receiver) -> Result<Shading, ScheduleError> {
        let shading = self.gatherer.broad(receiver)?;
        self.cut_sizes.note(u64::from(shading.cut_size));
        Ok(shading)
    }

    /// Gathers a record.
    fn record(
        &mut self,
        receiver: &Receiver,
        tolerance: &Tolerance,
    ) -> Result<Record, ScheduleError> {
        let before = self.gatherer.stats().cut_size();
        let record = self.gatherer.record(receiver, tolerance)?;
        self.cut_sizes.note(self.gatherer.stats().cut_size() - before);
        Ok(record)
    }
}

impl<'a, 'o, 'k> RecordShader<'a, 'o, 'k> {
    pub fn new(
        octree: &'a Octree,
        light: Option<&'a PreparedLight>,
        options: &'o ShadeOptions<'o>,
        kept: &'k mut KeptRecords,
    ) -> Self {
        let worker = |_| Worker {
            gatherer: Gatherer::new(octree.reader(), &options.gather, light),
            cut_sizes: Spread::default(),
        };
        let workers = (0..options.threads.max(1)).map(worker).collect();
        Self { workers, options, kept, receivers: 0, runs: 0 }
    }

    /// Shades a chunk, also with the records of the one before.
    pub fn shade(&mut self, receivers: &[Receiver]) -> Result<Vec<Shading>, ScheduleError> {
        let order = morton_order(receivers);
        // Covering and blending count half each.
        let halves = AtomicU64::new(2 * self.receivers);
        let advance = |count: usize| {
            let before = halves.fetch_add(count as u64, Ordering::Relaxed);
            (self.options.progress)((before + count as u64) / 2);
        };
        let kept = around_all(std::mem::take(&mut self.kept.0), receivers);
        let (options, workers) = (self.options, &mut self.workers);
        let sample: Vec<u32> =
            coarse_to_fine(order.len()).take(SAMPLE_RECEIVERS).map(|place| order[place]).collect();
        let sample = in_parallel(workers, options.cancel, sample.len(), |worker, number| {
            worker.gather_broad(&receivers[sample[number] as usize])
        })?;
        let tolerance = Tolerance::new(options.gather.tolerance, &sample);
        let runs: Vec<&[u32]> = order.chunks(RUN_RECEIVERS).collect();
        let made = in_parallel(workers, options.cancel, runs.len(), |worker, number| {
            let records = cover(worker, receivers, runs[number], &kept, &tolerance, options.cancel);
            advance(runs[number].len());
            records
        })?;
        let made: Vec<Record> = made.into_iter().flatten().collect();
        let made_count = made.len();
        let mut records = Records::new(made.into_iter().chain(kept.records).collect());
        let reaches = in_parallel(
            workers,
            options.cancel,
            records.records.len().div_ceil(BLOCK),
            |_, number| Ok(records.agreed_reaches(number, &tolerance)),
        )?;
        records.limit_reaches(reaches.into_iter().flatten());
        let blocks: Vec<&[u32]> = order.chunks(BLOCK).collect();
        let blended = in_parallel(workers, options.cancel, blocks.len(), |worker, number| {
            let shadings = blend(worker, receivers, blocks[number], &records, options.gather.parts);
            advance(blocks[number].len());
            shadings
        })?;
        let mut shadings = vec![Shading::default(); receivers.len()];
        for (index, shading) in order.iter().zip(blended.into_iter().flatten()) {
            shadings[*index as usize] = shading;
        }
        self.runs += runs.len() as u64;
        self.receivers += receivers.len() as u64;
        records.records.truncate(made_count);
        self.kept.0 = records.records;
        Ok(shadings)
    }

    /// What was done, but for the seconds.
    pub fn report(&self) -> ShadeReport {
        let (receivers, batches) = (self.receivers, self.runs);
        let mut report = ShadeReport { receivers, batches, ..ShadeReport::default() };
        for worker in &self.workers {
            report.cut.add(&worker.gatherer.stats());
            report.cut_sizes.add(&worker.cut_sizes);
        }
        report
    }
}

/// Has the workers do pieces of work, and returns what comes of them in their order.
fn in_parallel<'a, T: Send>(
    workers: &mut [Worker<'a>],
    cancel: &AtomicBool,
    count: usize,
    work: impl Fn(&mut Worker<'a>, usize) -> Result<T, ScheduleError> + Sync,
) -> Result<Vec<T>, ScheduleError> {
    let (next, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let done: Mutex<Vec<(usize, Result<T, ScheduleError>)>> = Mutex::new(Vec::new());
    let run = |worker: &mut Worker<'a>| {
        while !stopped.load(Ordering::Relaxed) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                break;
            }
            let result = match cancel.load(Ordering::Relaxed) {
                true => Err(ScheduleError::Cancelled),
                false => work(worker, number),
            };
            stopped.fetch_or(result.is_err(), Ordering::Relaxed);
            done.lock().unwrap_or_else(PoisonError::into_inner).push((number, result));
        }
    };
    std::thread::scope(|scope| {
        let run = &run;
        let mut workers = workers.iter_mut();
        let own = workers.next();
        workers.for_each(|worker| {
            scope.spawn(move || run(worker));
        });
        own.into_iter().for_each(run);
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_unstable_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Records that cover a run of receivers.
fn cover(
    worker: &mut Worker<'_>,
    receivers: &[Receiver],
    run: &[u32],
    kept: &Records,
    tolerance: &Tolerance,
    cancel: &AtomicBool,
) -> Result<Vec<Record>, ScheduleError> {
    let positions = run.iter().map(|&index| receivers[index as usize].position);
    let near = kept.around(&Aabb::from_points(positions));
    let mut made = Records::default();
    for place in coarse_to_fine(run.len()) {
        let receiver = &receivers[run[place] as usize];
        let covers = |record: &Record| record.error_at(receiver) < COVERED;
        if near.iter().any(|&number| covers(&kept.records[number as usize]))
            || made.any_around(receiver.position, covers)
        {
            continue;
        }
        if cancel.load(Ordering::Relaxed) {
            return Err(ScheduleError::Cancelled);
        }
        let mut record = worker.record(receiver, tolerance)?;
        made.agree(&mut record, tolerance);
        made.push(record);
    }
    Ok(made.records)
}

/// The numbers below `count`, each as far from those before as may be.
fn coarse_to_fine(count: usize) -> impl Iterator<Item = usize> {
    let bits = count.next_power_of_two().trailing_zeros();
    let reverse = move |i: usize| i.reverse_bits().checked_shr(usize::BITS - bits).unwrap_or(0);
    (0..1 << bits).map(reverse).filter(move |place| *place < count)
}

/// What the receivers of a block receive.
fn blend(
    worker: &mut Worker<'_>,
    receivers: &[Receiver],
    block: &[u32],
    records: &Records,
    parts: GatherParts,
) -> Result<Vec<Shading>, ScheduleError> {
    let positions = block.iter().map(|&index| receivers[index as usize].position);
    let near = records.around(&Aabb::from_points(positions));
    let mut shadings = Vec::with_capacity(block.len());
    for &index in block {
        let receiver = &receivers[index as usize];
        let mut blend = Blend::default();
        near.iter().for_each(|&number| blend.add(&records.records[number as usize], receiver));
        let mut shading = match blend.shading(receiver) {
            Some(shading) => shading,
            None => worker.gather_broad(receiver)?,
        };
        if parts == GatherParts::All {
            worker.gatherer.add_sharp(receiver, &mut shading)?;
        }
        shadings.push(shading);
    }
    Ok(shadings)
}

/// Those of `records` that may serve for some of the receivers.
fn around_all(records: Vec<Record>, receivers: &[Receiver]) -> Records {
    let bounds = Aabb::from_points(receivers.iter().map(|receiver| receiver.position));
    let serves = |record: &Record| distance2(&bounds, record.position()) < record.reach().powi(2);
    Records::new(records.into_iter().filter(serves).collect())
}

/// Square of the distance from a point to a box.
fn distance2(bounds: &Aabb, point: Vec3) -> f32 {
    (point - point.clamp(bounds.min, bounds.max)).length_squared()
}

/// Records, and the balls in which they serve.
#[derive(Default)]
struct Records {
    records: Vec<Record>,
    /// Position and square of the reach.
    balls: Vec<[f32; 4]>,
}

/// The ball of a record.
fn ball(record: &Record) -> [f32; 4] {
    let [x, y, z] = record.position().to_array();
    [x, y, z, record.reach() * record.reach()]
}

impl Records {
    fn new(records: Vec<Record>) -> Self {
        let balls = records.iter().map(ball).collect();
        Self { records, balls }
    }

    fn push(&mut self, record: Record) {
        self.balls.push(ball(&record));
        self.records.push(record);
    }

    /// Numbers of those whose balls meet a box.
    fn around(&self, bounds: &Aabb) -> Vec<u32> {
        let meets = |ball: &[f32; 4]| distance2(bounds, Vec3::from_slice(&ball[..3])) < ball[3];
        let balls = self.balls.iter().enumerate();
        balls.filter(|(_, ball)| meets(ball)).map(|(number, _)| number as u32).collect()
    }

    /// Whether something holds of any record in whose ball a place lies.
    fn any_around(&self, place: Vec3, holds: impl Fn(&Record) -> bool) -> bool {
        let is_in =
            |ball: &[f32; 4]| place.distance_squared(Vec3::from_slice(&ball[..3])) < ball[3];
        self.balls.iter().zip(&self.records).any(|(ball, record)| is_in(ball) && holds(record))
    }

    /// Limits a new record and those that are here to where they agree.
    fn agree(&mut self, new: &mut Record, tolerance: &Tolerance) {
        let mut reach = new.reach();
        for (record, ball) in self.records.iter_mut().zip(&mut self.balls) {
            reach = reach.min(new.reach_beside(record, tolerance));
            let limited = record.reach_beside(new, tolerance);
            if limited < record.reach() {
                record.limit_reach(limited);
                ball[3] = limited * limited;
            }
        }
        new.limit_reach(reach);
    }

    /// Reaches of a block of records to where they agree with all others.
    fn agreed_reaches(&self, number: usize, tolerance: &Tolerance) -> Vec<f32> {
        let block = &self.records[number * BLOCK..self.records.len().min((number + 1) * BLOCK)];
        let bounds = Aabb::from_points(block.iter().map(Record::position));
        let farthest = block.iter().map(Record::reach).fold(0.0, f32::max);
        let is_near = |ball: &&[f32; 4]| {
            distance2(&bounds, Vec3::from_slice(&ball[..3])) < farthest * farthest
        };
        let balls = self.balls.iter().zip(&self.records);
        let near: Vec<&Record> =
            balls.filter(|(ball, _)| is_near(ball)).map(|(_, record)| record).collect();
        let agreed = |record: &Record| {
            let beside = near.iter().map(|other| record.reach_beside(other, tolerance));
            beside.fold(record.reach(), f32::min)
        };
        block.iter().map(agreed).collect()
    }

    fn limit_reaches(&mut self, reaches: impl Iterator<Item = f32>) {
        for ((record, place), reach) in self.records.iter_mut().zip(&mut self.balls).zip(reaches) {
            record.limit_reach(reach);
            *place = ball(record);
        }
    }
}
