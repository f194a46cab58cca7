//! Receivers that share irradiance records: some gather, the others blend what these have found.
//!
//! A chunk is shaded in three steps, each by all workers. Runs of neighbors along the Morton curve are covered with records, each run by itself, from
//! coarse to fine. Records are limited to where those around agree with them, whatever run made them. Then each receiver takes the mean of what the
//! records around it say, and gathers only where none serves. So results depend on the chunk and on those before it, and on nothing else.

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
const RUN_RECEIVERS: usize = 512;

/// Receivers, or records, that look for the records around them together.
const BLOCK: usize = 64;

/// Receivers that look together among those of their block, or run.
const SMALL_BLOCK: usize = 8;

/// Expected error over the tolerance from which a receiver gathers for itself: below 1, so that records overlap where they are blended.
const COVERED: f32 = 0.5;

/// Times that receivers which no record serves any more, as records disagree, gather records of their own; then each gathers for itself.
const ROUNDS_MAX: u32 = 4;

/// Receivers of a chunk whose mean tells what is dark.
const SAMPLE_RECEIVERS: usize = 32;

/// Receivers of a chunk per record that is kept for the next one: those that reach farthest.
const KEPT_DIVISOR: usize = 4;

/// Bytes held per receiver, where each gathers for itself.
pub const RECORD_BYTES: usize = {
    let each = size_of::<Record>() + size_of::<[f32; 4]>();
    // What covers a receiver is known twice while it is found anew.
    each + each / KEPT_DIVISOR + 2 * size_of::<RecordId>()
};

/// Records of the chunks before, for the one that follows.
#[derive(Debug, Default)]
pub struct KeptRecords(Pool);

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
        if receivers.is_empty() {
            return Ok(Vec::new());
        }
        let order = morton_order(receivers);
        // Covering and blending count half each.
        let halves = AtomicU64::new(2 * self.receivers);
        let advance = |count: usize| {
            let before = halves.fetch_add(count as u64, Ordering::Relaxed);
            (self.options.progress)((before + count as u64) / 2);
        };
        let kept = std::mem::take(&mut self.kept.0);
        let near = kept.within(receivers, &order);
        let mut records = Pool { parts: vec![kept.copies(&near)] };
        drop(kept);
        let (options, workers) = (self.options, &mut self.workers);
        let sample: Vec<u32> =
            coarse_to_fine(order.len()).take(SAMPLE_RECEIVERS).map(|place| order[place]).collect();
        let sample = in_parallel(workers, options.cancel, sample.len(), |worker, number| {
            worker.gather_broad(&receivers[sample[number] as usize])
        })?;
        let tolerance = Tolerance::new(options.gather.tolerance, &sample);
        let runs: Vec<&[u32]> = order.chunks(RUN_RECEIVERS).collect();
        let mut covering = vec![Vec::new(); runs.len()];
        for round in 0..ROUNDS_MAX {
            let cover = Cover {
                receivers,
                present: &records,
                tolerance: &tolerance,
                cancel: options.cancel,
            };
            let covered = in_parallel(workers, options.cancel, runs.len(), |worker, number| {
                let covered = cover.run(worker, (number, runs[number]), &covering[number])?;
                advance(if round == 0 { runs[number].len() } else { 0 });
                Ok(covered)
            })?;
            let made: Vec<Records>;
            (made, covering) = covered.into_iter().unzip();
            if made.iter().all(|part| part.records.is_empty()) {
                break;
            }
            let first_new = records.parts.len();
            records.parts.extend(made);
            let count = records.parts.len();
            let reaches = in_parallel(workers, options.cancel, count, |_, number| {
                Ok(records.agreed_reaches(number, first_new, &tolerance))
            })?;
            for (part, reaches) in records.parts.iter_mut().zip(reaches) {
                part.limit_reaches(&reaches);
            }
        }
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
        self.kept.0 = records.most_useful(receivers.len() / KEPT_DIVISOR);
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

/// Whether a record serves well enough that a receiver need not gather.
fn covers(record: &Record, receiver: &Receiver) -> bool {
    record.error_at(receiver) < COVERED
}

/// What a run of receivers is covered by.
struct Cover<'c> {
    receivers: &'c [Receiver],
    /// Records there are already.
    present: &'c Pool,
    tolerance: &'c Tolerance,
    cancel: &'c AtomicBool,
}

impl Cover<'_> {
    /// Records that cover, with those present, what of a run is not; and what covers each receiver, as told for the round before.
    fn run(
        &self,
        worker: &mut Worker<'_>,
        (number, run): (usize, &[u32]),
        covering: &[RecordId],
    ) -> Result<(Records, Vec<RecordId>), ScheduleError> {
        let receiver = |index: u32| &self.receivers[index as usize];
        let covers = |id: RecordId, index: u32| {
            self.present.get(id).is_some_and(|record| covers(record, receiver(index)))
        };
        let mut found = vec![RecordId::NONE; run.len()];
        let mut open: Vec<usize> = Vec::new();
        for (place, &index) in run.iter().enumerate() {
            match covering.get(place) {
                Some(&id) if covers(id, index) => found[place] = id,
                _ => open.push(place),
            }
        }
        let chosen: Vec<u32> = open.iter().map(|&place| run[place]).collect();
        // What covers a receiver covers most of its neighbors.
        let mut last = RecordId::NONE;
        let present = self.present.by_block(self.receivers, &chosen, |near, index| {
            if !covers(last, index) {
                let mut around = near.around(receiver(index).position);
                last = around.find(|&id| covers(id, index)).unwrap_or(RecordId::NONE);
            }
            last
        });
        open.iter().zip(present).for_each(|(&place, id)| found[place] = id);
        // The part of the pool that what is made here will be.
        let part = (self.present.parts.len() + number) as u32;
        let mut made = Records::default();
        for place in coarse_to_fine(run.len()) {
            if found[place] != RecordId::NONE {
                continue;
            }
            let receiver = receiver(run[place]);
            let number = match made.covering(receiver) {
                Some(number) => number,
                None => {
                    if self.cancel.load(Ordering::Relaxed) {
                        return Err(ScheduleError::Cancelled);
                    }
                    let mut record = worker.record(receiver, self.tolerance)?;
                    made.agree(&mut record, self.tolerance);
                    made.push(record);
                    made.records.len() - 1
                }
            };
            found[place] = RecordId { part, number: number as u32 };
        }
        Ok((made, found))
    }
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
    records: &Pool,
    parts: GatherParts,
) -> Result<Vec<Shading>, ScheduleError> {
    let blends = records.by_block(receivers, block, |near, index| {
        let receiver = &receivers[index as usize];
        let around = near.around(receiver.position).filter_map(|id| records.get(id));
        let mut blend = Blend::default();
        around.for_each(|record| blend.add(record, receiver));
        blend
    });
    let mut shadings = Vec::with_capacity(block.len());
    for (&index, blend) in block.iter().zip(blends) {
        let receiver = &receivers[index as usize];
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

/// The box around the chosen of the receivers.
fn bounds_of(receivers: &[Receiver], chosen: &[u32]) -> Aabb {
    Aabb::from_points(chosen.iter().map(|&index| receivers[index as usize].position))
}

/// Square of the distance from a point to a box.
fn distance2(bounds: &Aabb, point: Vec3) -> f32 {
    (point - point.clamp(bounds.min, bounds.max)).length_squared()
}

/// Records, and the balls in which they serve.
#[derive(Debug, Default)]
struct Records {
    records: Vec<Record>,
    balls: Vec<[f32; 4]>,
}

/// The ball of a record: its position, and the square of its reach.
fn ball(record: &Record) -> [f32; 4] {
    let [x, y, z] = record.position().to_array();
    [x, y, z, record.reach() * record.reach()]
}

/// Squares of distances up to this many times that of a reach are looked at more closely: rounding must not decide.
const ROUNDING: f32 = 1.0001;

/// The middle of a ball.
fn center(&[x, y, z, _]: &[f32; 4]) -> Vec3 {
    Vec3::new(x, y, z)
}

impl Records {
    fn push(&mut self, record: Record) {
        self.balls.push(ball(&record));
        self.records.push(record);
    }

    fn reaches(&self) -> impl Iterator<Item = f32> {
        self.records.iter().map(Record::reach)
    }

    /// Leaves out records of which something does not hold.
    fn retain(&mut self, holds: impl Fn(&Record) -> bool) {
        self.records.retain(holds);
        self.records.shrink_to_fit();
        self.balls = self.records.iter().map(ball).collect();
    }

    /// The first record that covers a receiver.
    fn covering(&self, receiver: &Receiver) -> Option<usize> {
        let place = receiver.position;
        let is_in = |ball: &[f32; 4]| place.distance_squared(center(ball)) < ball[3];
        let mut records = self.balls.iter().zip(&self.records);
        records.position(|(ball, record)| is_in(ball) && covers(record, receiver))
    }

    /// Limits a new record and those that are here to where they agree.
    fn agree(&mut self, new: &mut Record, tolerance: &Tolerance) {
        let (place, own) = (new.position(), ROUNDING * new.reach() * new.reach());
        let mut reach = new.reach();
        for (record, ball) in self.records.iter_mut().zip(&mut self.balls) {
            let distance2 = place.distance_squared(center(ball));
            if distance2 < own {
                reach = reach.min(new.reach_beside(record, tolerance));
            }
            if distance2 < ROUNDING * ball[3] {
                let limited = record.reach_beside(new, tolerance);
                record.limit_reach(limited);
                ball[3] = record.reach() * record.reach();
            }
        }
        new.limit_reach(reach);
    }

    fn limit_reaches(&mut self, reaches: &[f32]) {
        for ((record, place), reach) in self.records.iter_mut().zip(&mut self.balls).zip(reaches) {
            record.limit_reach(*reach);
            *place = ball(record);
        }
    }
}

/// Where a record is in a pool.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RecordId {
    part: u32,
    number: u32,
}

impl RecordId {
    /// Of no pool.
    const NONE: Self = Self { part: u32::MAX, number: u32::MAX };
}

/// Records near some place, in the order of the pool.
#[derive(Default)]
struct Near {
    balls: Vec<[f32; 4]>,
    ids: Vec<RecordId>,
}

impl Near {
    /// Adds those whose balls touch a box.
    fn push_within<'b>(
        &mut self,
        bounds: &Aabb,
        records: impl Iterator<Item = (&'b [f32; 4], RecordId)>,
    ) {
        for (ball, id) in records {
            if distance2(bounds, center(ball)) < ROUNDING * ball[3] {
                self.balls.push(*ball);
                self.ids.push(id);
            }
        }
    }

    /// Those in whose balls a place lies, and maybe some of which it lies just outside.
    fn around(&self, place: Vec3) -> impl Iterator<Item = RecordId> {
        let is_in =
            move |ball: &[f32; 4]| place.distance_squared(center(ball)) < ROUNDING * ball[3];
        self.balls.iter().zip(&self.ids).filter(move |(ball, _)| is_in(ball)).map(|pair| *pair.1)
    }
}

/// Records of several runs.
#[derive(Debug, Default)]
struct Pool {
    parts: Vec<Records>,
}

impl Pool {
    fn get(&self, id: RecordId) -> Option<&Record> {
        self.parts.get(id.part as usize)?.records.get(id.number as usize)
    }

    /// Those that may serve for some of the receivers.
    fn within(&self, receivers: &[Receiver], chosen: &[u32]) -> Near {
        let bounds = bounds_of(receivers, chosen);
        let mut near = Near::default();
        for (part, records) in (0..).zip(&self.parts) {
            let ids = (0..).map(|number| RecordId { part, number });
            near.push_within(&bounds, records.balls.iter().zip(ids));
        }
        near
    }

    /// What is to be told of each receiver by the records near its block.
    fn by_block<T>(
        &self,
        receivers: &[Receiver],
        chosen: &[u32],
        mut tell: impl FnMut(&Near, u32) -> T,
    ) -> Vec<T> {
        if chosen.is_empty() {
            return Vec::new();
        }
        let all = self.within(receivers, chosen);
        let mut told = Vec::with_capacity(chosen.len());
        let mut near = Near::default();
        for block in chosen.chunks(SMALL_BLOCK) {
            near.balls.clear();
            near.ids.clear();
            let bounds = bounds_of(receivers, block);
            near.push_within(&bounds, all.balls.iter().zip(all.ids.iter().copied()));
            told.extend(block.iter().map(|&index| tell(&near, index)));
        }
        told
    }

    fn copies(&self, near: &Near) -> Records {
        let records = near.ids.iter().filter_map(|&id| self.get(id)).copied().collect();
        Records { records, balls: near.balls.clone() }
    }

    /// The `count` that reach farthest, or a few less.
    fn most_useful(mut self, count: usize) -> Self {
        let mut reaches: Vec<f32> = self.parts.iter().flat_map(Records::reaches).collect();
        if reaches.len() > count {
            let (_, least, _) = reaches.select_nth_unstable_by(count, |a, b| b.total_cmp(a));
            let least = *least;
            self.parts.iter_mut().for_each(|part| part.retain(|record| record.reach() > least));
        }
        self
    }

    /// Records of parts no farther from a box than this, and where they are.
    fn places<'p>(
        parts: impl Iterator<Item = &'p Records>,
        bounds: &Aabb,
        farthest: f32,
    ) -> Vec<(Vec3, &'p Record)> {
        let farthest2 = ROUNDING * farthest * farthest;
        let mut near = Vec::new();
        for part in parts {
            let places = part.balls.iter().map(center).zip(&part.records);
            near.extend(places.filter(|(place, _)| distance2(bounds, *place) < farthest2));
        }
        near
    }

    /// Reaches of the records of a part to where they agree with all. Those of parts before `first_new` agree with each other, as do those of one
    /// part: with a shorter reach a record allows more, so that no pair need be looked at twice.
    fn agreed_reaches(&self, number: usize, first_new: usize, tolerance: &Tolerance) -> Vec<f32> {
        let is_other = |part: &usize| *part != number && (*part).max(number) >= first_new;
        let others = || (0..self.parts.len()).filter(is_other).map(|part| &self.parts[part]);
        let mut reaches = Vec::with_capacity(self.parts[number].records.len());
        for block in self.parts[number].records.chunks(BLOCK) {
            let bounds = Aabb::from_points(block.iter().map(Record::position));
            let farthest = block.iter().map(Record::reach).fold(0.0, f32::max);
            let near = Self::places(others(), &bounds, farthest);
            let agreed = |record: &Record| {
                let (place, reach2) = (record.position(), ROUNDING * record.reach().powi(2));
                let is_near = |other: &&(Vec3, &Record)| place.distance_squared(other.0) < reach2;
                let beside = near.iter().filter(is_near);
                let reaches = beside.map(|(_, other)| record.reach_beside(other, tolerance));
                reaches.fold(record.reach(), f32::min)
            };
            reaches.extend(block.iter().map(agreed));
        }
        reaches
    }
}
