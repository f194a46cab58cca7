//! Leaves cut from a stream in Morton order.
//!
//! A leaf is the largest cell that holds no more than `leaf_surfels_max` surfels. In Morton order it begins where the surfel
//! before it is outside, and ends before the surfel `leaf_surfels_max` further on: its level is the
//! first at which both are in other cells.

use crate::aggregate::NodeAggregate;
use crate::error::BuildError;
use crate::{BuildOptions, SortedStream};
use crossbeam::channel::{Receiver, Sender, bounded};
use pbgi_cloud::Surfel;
use pbgi_math::{MORTON_AXIS_BITS, MortonCode};
use std::sync::atomic::Ordering;

/// Leaves that are handed over together.
const BATCH_LEAVES: usize = 512;

/// Batches that may wait.
const BATCHES_WAITING: usize = 4;

/// A leaf.
pub(crate) struct Leaf {
    /// Code of its first surfel.
    pub code: MortonCode,
    /// Level of its cell; one more than the finest where others share that.
    pub level: u32,
    pub surfels: Vec<Surfel>,
    pub aggregate: NodeAggregate,
}

/// Sums over all surfels, in the order of the stream.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Totals {
    pub surfels: u64,
    pub area: f64,
    pub flux: [f64; 3],
}

/// Cuts leaves from the stream.
struct LeafCutter<'a> {
    stream: &'a mut dyn SortedStream,
    options: &'a BuildOptions<'a>,
    buffer: Vec<(MortonCode, Surfel)>,
    start: usize,
    ended: bool,
    last: Option<MortonCode>,
    totals: Totals,
}

impl LeafCutter<'_> {
    /// The next leaves; empty at the end.
    fn cut_batch(&mut self) -> Result<Vec<Leaf>, BuildError> {
        let mut batch = Vec::with_capacity(BATCH_LEAVES);
        while batch.len() < BATCH_LEAVES {
            let Some(leaf) = self.cut()? else { break };
            batch.push(leaf);
        }
        if self.options.cancel.load(Ordering::Relaxed) {
            return Err(BuildError::Cancelled);
        }
        (self.options.progress)(self.totals.surfels);
        Ok(batch)
    }

    fn cut(&mut self) -> Result<Option<Leaf>, BuildError> {
        let most = self.options.leaf_surfels_max;
        while !self.ended && self.buffer.len() - self.start <= most {
            self.buffer.drain(..self.start);
            self.start = 0;
            self.ended = !self.stream.read_chunk(&mut self.buffer).map_err(BuildError::Stream)?;
        }
        let ahead = &self.buffer[self.start..];
        let Some(&(code, _)) = ahead.first() else { return Ok(None) };
        let below = |other: Option<MortonCode>| other.map_or(0, |o| code.common_level(o) + 1);
        let level = below(self.last).max(below(ahead.get(most).map(|s| s.0)));
        let cell_level = level.min(MORTON_AXIS_BITS);
        let cell = code.cell_at(cell_level);
        let ahead = &ahead[..ahead.len().min(most)];
        let count = ahead.iter().take_while(|s| s.0.cell_at(cell_level) == cell).count();
        let mut surfels = Vec::with_capacity(count);
        for &(code, surfel) in &ahead[..count] {
            if self.last.is_some_and(|last| code < last) {
                return Err(BuildError::Unsorted { index: self.totals.surfels });
            }
            self.last = Some(code);
            self.totals.surfels += 1;
            let area = f64::from(surfel.area);
            self.totals.area += area;
            for (sum, l) in self.totals.flux.iter_mut().zip(surfel.radiance) {
                *sum += area * f64::from(l);
            }
            surfels.push(surfel);
        }
        self.start += count;
        let aggregate = NodeAggregate::from_surfels(&surfels);
        Ok(Some(Leaf { code, level, surfels, aggregate }))
    }

    fn send_all(mut self, sender: &Sender<Result<Vec<Leaf>, BuildError>>) -> Totals {
        loop {
            let batch = self.cut_batch();
            let is_last = batch.as_ref().map_or(true, Vec::is_empty);
            // Nobody listens any more where the builder has failed.
            if sender.send(batch).is_err() || is_last {
                return self.totals;
            }
        }
    }
}

/// Where batches come from.
enum Source<'a> {
    Own(Box<LeafCutter<'a>>),
    Thread(Receiver<Result<Vec<Leaf>, BuildError>>),
}

/// Leaves in the order of the stream.
pub(crate) struct Leaves<'a> {
    source: Source<'a>,
    batch: std::vec::IntoIter<Leaf>,
    ended: bool,
}

impl Leaves<'_> {
    /// The next leaf, which stays.
    pub fn peek(&mut self) -> Result<Option<&Leaf>, BuildError> {
        while !self.ended && self.batch.as_slice().is_empty() {
            let batch = match &mut self.source {
                Source::Own(cutter) => cutter.cut_batch()?,
                Source::Thread(receiver) => receiver.recv().unwrap_or(Ok(Vec::new()))?,
            };
            self.ended = batch.is_empty();
            self.batch = batch.into_iter();
        }
        Ok(self.batch.as_slice().first())
    }

    /// The next leaf.
    pub fn take(&mut self) -> Result<Option<Leaf>, BuildError> {
        self.peek()?;
        Ok(self.batch.next())
    }
}

/// Calls `build` with the leaves of a stream, which another thread cuts where there are two. Gives what `build` gives, with
/// the totals of the stream.
pub(crate) fn with_leaves<R>(
    stream: &mut dyn SortedStream,
    options: &BuildOptions<'_>,
    build: impl FnOnce(&mut Leaves<'_>) -> Result<R, BuildError>,
) -> Result<(R, Totals), BuildError> {
    let cutter = LeafCutter {
        stream,
        options,
        buffer: Vec::new(),
        start: 0,
        ended: false,
        last: None,
        totals: Totals::default(),
    };
    let leaves = |source| Leaves { source, batch: Vec::new().into_iter(), ended: false };
    if options.threads < 2 {
        let mut leaves = leaves(Source::Own(Box::new(cutter)));
        let result = build(&mut leaves)?;
        let Source::Own(cutter) = leaves.source else { unreachable!("it was made so") };
        return Ok((result, cutter.totals));
    }
    std::thread::scope(|scope| {
        let (sender, receiver) = bounded(BATCHES_WAITING);
        let worker = scope.spawn(move || cutter.send_all(&sender));
        let result = build(&mut leaves(Source::Thread(receiver)));
        let totals = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok((result?, totals))
    })
}
