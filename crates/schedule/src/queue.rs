//! Chunks of receivers under way: divided into batches for workers, completed in any order, taken back in that of their arrival.

use crate::shade::ScheduleError;
use pbgi_gather::{Receiver, Shading};
use std::borrow::Cow;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Receivers of a batch: neighbors along the Morton curve, shaded by one worker.
pub(crate) const BATCH_RECEIVERS: usize = 64;

/// Receivers and the order to shade them in.
pub(crate) struct Chunk<'r> {
    pub receivers: Cow<'r, [Receiver]>,
    pub order: Vec<u32>,
}

/// A batch a worker has to shade: a range of its chunk's order.
pub(crate) struct Batch<'r> {
    pub chunk: Arc<Chunk<'r>>,
    pub range: Range<usize>,
    number: u64,
}

impl Batch<'_> {
    /// Indices of its receivers in the chunk.
    pub fn indices(&self) -> &[u32] {
        &self.chunk.order[self.range.clone()]
    }
}

/// A chunk in the queue.
struct Entry<'r> {
    chunk: Arc<Chunk<'r>>,
    /// By index of the receiver.
    shadings: Vec<Shading>,
    /// Receivers that were given to workers, in `order`, and those that came back.
    given: usize,
    done: usize,
}

#[derive(Default)]
struct State<'r> {
    entries: VecDeque<Entry<'r>>,
    /// Number of the first entry.
    first: u64,
    /// Receivers done in all chunks.
    done: u64,
    /// Nobody shall go on.
    stopped: bool,
    failure: Option<ScheduleError>,
}

/// The queue between the thread that reads and writes, and the workers.
#[derive(Default)]
pub(crate) struct Queue<'r> {
    state: Mutex<State<'r>>,
    /// There is more to do, or work has ended.
    filled: Condvar,
    /// A chunk is complete, or work has ended.
    completed: Condvar,
}

impl<'r> Queue<'r> {
    fn lock(&self) -> MutexGuard<'_, State<'r>> {
        // A panic while holding the lock is a defect that has been reported already.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends a chunk.
    pub fn push(&self, chunk: Chunk<'r>) {
        let shadings = vec![Shading::default(); chunk.receivers.len()];
        let entry = Entry { chunk: Arc::new(chunk), shadings, given: 0, done: 0 };
        self.lock().entries.push_back(entry);
        self.filled.notify_all();
    }

    /// The next batch, in the order of the chunks, and the nanoseconds spent waiting for it; none
    /// when work has ended.
    pub fn next_batch(&self) -> (Option<Batch<'r>>, u64) {
        let mut waited: Option<Instant> = None;
        let mut state = self.lock();
        let batch = loop {
            if state.stopped {
                break None;
            }
            let first = state.first;
            let mut entries = state.entries.iter_mut().enumerate();
            if let Some((at, entry)) = entries.find(|(_, e)| e.given < e.shadings.len()) {
                let end = (entry.given + BATCH_RECEIVERS).min(entry.shadings.len());
                let range = entry.given..end;
                entry.given = end;
                let number = first + at as u64;
                break Some(Batch { chunk: entry.chunk.clone(), range, number });
            }
            waited.get_or_insert_with(Instant::now);
            state = self.filled.wait(state).unwrap_or_else(PoisonError::into_inner);
        };
        (batch, waited.map_or(0, |since| since.elapsed().as_nanos() as u64))
    }

    /// Takes the results of a batch and returns how many receivers are done in all.
    pub fn complete(&self, batch: Batch<'r>, shadings: &[Shading]) -> u64 {
        let mut state = self.lock();
        let at = (batch.number - state.first) as usize;
        let entry = &mut state.entries[at];
        for (index, shading) in batch.indices().iter().zip(shadings) {
            entry.shadings[*index as usize] = *shading;
        }
        entry.done += shadings.len();
        let is_complete = entry.done == entry.shadings.len();
        // Whoever takes the chunk shall be its only owner.
        drop(batch);
        state.done += shadings.len() as u64;
        let done = state.done;
        drop(state);
        if is_complete {
            self.completed.notify_all();
        }
        done
    }

    /// Waits for the oldest chunk and removes it.
    ///
    /// # Errors
    ///
    /// The failure of a worker. A worker that has panicked counts as an interruption; the panic itself goes on when it is joined.
    pub fn take_oldest(&self) -> Result<(Arc<Chunk<'r>>, Vec<Shading>), ScheduleError> {
        let mut state = self.lock();
        loop {
            if state.stopped {
                return Err(state.failure.take().unwrap_or(ScheduleError::Cancelled));
            }
            if state.entries.front().is_some_and(|entry| entry.done == entry.shadings.len())
                && let Some(entry) = state.entries.pop_front()
            {
                state.first += 1;
                return Ok((entry.chunk, entry.shadings));
            }
            state = self.completed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Ends all work; the first failure is kept.
    pub fn stop(&self, failure: Option<ScheduleError>) {
        let mut state = self.lock();
        state.stopped = true;
        if state.failure.is_none() {
            state.failure = failure;
        }
        drop(state);
        self.filled.notify_all();
        self.completed.notify_all();
    }
}

/// Stops the queue when dropped, so that nobody waits for a thread that has ended early.
pub(crate) struct StopOnDrop<'q, 'r>(pub &'q Queue<'r>);

impl Drop for StopOnDrop<'_, '_> {
    fn drop(&mut self) {
        self.0.stop(None);
    }
}
