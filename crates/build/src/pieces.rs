//! Pieces of the sorted stream, built by several threads and handed on in their order.

use crate::error::BuildError;
use crate::items::{Item, build_piece};
use crate::stitch::NextItems;
use crate::tree::TreeSettings;
use crate::{BuildOptions, Piece, PieceSource, PieceTask, SortedStream, StreamError};
use crossbeam::channel::{Receiver, Sender, bounded};
use pbgi_cloud::Surfel;
use pbgi_math::MortonCode;
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::Ordering;

/// Surfels of a piece cut from a stream.
const STREAM_PIECE_SURFELS: usize = 1 << 15;

/// A sorted stream as pieces.
pub(crate) struct StreamPieces<'a> {
    stream: &'a mut dyn SortedStream,
    /// Surfels read beyond the last piece.
    ahead: Vec<(MortonCode, Surfel)>,
    is_ended: bool,
    /// One more than the last code handed on.
    done: u64,
}

impl<'a> StreamPieces<'a> {
    pub fn new(stream: &'a mut dyn SortedStream) -> Self {
        Self { stream, ahead: Vec::new(), is_ended: false, done: 0 }
    }
}

impl PieceSource for StreamPieces<'_> {
    fn next_piece(&mut self) -> Result<Option<PieceTask>, StreamError> {
        while !self.is_ended && self.ahead.len() <= STREAM_PIECE_SURFELS {
            self.is_ended = !self.stream.read_chunk(&mut self.ahead)?;
        }
        let len = self.ahead.len().min(STREAM_PIECE_SURFELS);
        let end = self.ahead.get(len).map_or(u64::MAX, |(code, _)| code.0);
        let (codes, surfels): (Vec<_>, Vec<_>) = self.ahead.drain(..len).unzip();
        let Some(last) = codes.last() else { return Ok(None) };
        let whole = self.done..end.max(self.done);
        self.done = last.0 + 1;
        Ok(Some(Box::new(move || Piece { codes, surfels, whole })))
    }
}

/// A piece that was built.
struct Built {
    items: Vec<Item>,
    surfels: u64,
    /// First and last code.
    ends: Option<(MortonCode, MortonCode)>,
}

/// Checks pieces as they come in order.
struct Joint<'a> {
    options: &'a BuildOptions<'a>,
    last: Option<MortonCode>,
    /// Surfels so far.
    surfels: u64,
}

impl Joint<'_> {
    fn check(&mut self, built: Result<Built, BuildError>) -> Result<Vec<Item>, BuildError> {
        let built = built.map_err(|error| match error {
            BuildError::Unsorted { index } => BuildError::Unsorted { index: self.surfels + index },
            other => other,
        })?;
        if let Some((first, last)) = built.ends {
            if self.last.is_some_and(|before| first < before) {
                return Err(BuildError::Unsorted { index: self.surfels });
            }
            self.last = Some(last);
        }
        self.surfels += built.surfels;
        (self.options.progress)(self.surfels);
        Ok(built.items)
    }
}

fn run(
    task: PieceTask,
    settings: &TreeSettings,
    options: &BuildOptions<'_>,
) -> Result<Built, BuildError> {
    if options.cancel.load(Ordering::Relaxed) {
        return Err(BuildError::Cancelled);
    }
    let piece = task();
    let items = build_piece(&piece, settings)?;
    let ends = piece.codes.first().copied().zip(piece.codes.last().copied());
    Ok(Built { items, surfels: piece.codes.len() as u64, ends })
}

/// Calls `join` with a function that gives the items of one piece after another. With two threads or more they are built by these, while
/// `join` works on those before and the source prepares those behind. Returns what `join` does, and the number of surfels.
pub(crate) fn with_items<R>(
    source: &mut dyn PieceSource,
    settings: &TreeSettings,
    options: &BuildOptions<'_>,
    join: impl FnOnce(&mut NextItems<'_>) -> Result<R, BuildError>,
) -> Result<(R, u64), BuildError> {
    let mut joint = Joint { options, last: None, surfels: 0 };
    if options.threads < 2 {
        let result = join(&mut || match source.next_piece().map_err(BuildError::Stream)? {
            Some(task) => joint.check(run(task, settings, options)).map(Some),
            None => Ok(None),
        })?;
        return Ok((result, joint.surfels));
    }
    std::thread::scope(|scope| {
        // A piece is asked for when another was joined, so that no more wait than memory was planned for.
        let in_flight = options.pieces_in_flight.max(1);
        let (permit_sender, permits) = bounded(in_flight);
        let (task_sender, tasks) = bounded::<(u64, PieceTask)>(in_flight);
        let (done_sender, done) = bounded(in_flight);
        for _ in 0..in_flight {
            let _ = permit_sender.send(());
        }
        let failed = done_sender.clone();
        let named = |name: &str| std::thread::Builder::new().name(name.to_owned());
        named("pieces")
            .spawn_scoped(scope, move || feed(source, &permits, &task_sender, &failed))
            .map_err(BuildError::Threads)?;
        for _ in 0..options.threads {
            let (tasks, done) = (tasks.clone(), done_sender.clone());
            named("build")
                .spawn_scoped(scope, move || work(&tasks, &done, settings, options))
                .map_err(BuildError::Threads)?;
        }
        drop((tasks, done_sender));
        let mut waiting = HashMap::new();
        let mut next = 0;
        let result = join(&mut || {
            loop {
                if let Some(outcome) = waiting.remove(&next) {
                    next += 1;
                    let built = match outcome {
                        Outcome::Built(built) => built,
                        Outcome::Panicked(panic) => resume_unwind(panic),
                    };
                    let items = joint.check(built)?;
                    // The feeder may have ended.
                    let _ = permit_sender.try_send(());
                    return Ok(Some(items));
                }
                // Without senders there are no more pieces.
                let Ok((index, outcome)) = done.recv() else { return Ok(None) };
                waiting.insert(index, outcome);
            }
        });
        // Ends the feeder, and with it the workers.
        drop((permit_sender, done));
        Ok((result?, joint.surfels))
    })
}

enum Outcome {
    Built(Result<Built, BuildError>),
    Panicked(Box<dyn std::any::Any + Send>),
}

/// Hands pieces to workers as permits come; the number of the piece tells its place.
fn feed(
    source: &mut dyn PieceSource,
    permits: &Receiver<()>,
    tasks: &Sender<(u64, PieceTask)>,
    failed: &Sender<(u64, Outcome)>,
) {
    for index in 0.. {
        if permits.recv().is_err() {
            return;
        }
        match source.next_piece() {
            Ok(Some(task)) => {
                if tasks.send((index, task)).is_err() {
                    return;
                }
            }
            Ok(None) => return,
            Err(error) => {
                let failure = Outcome::Built(Err(BuildError::Stream(error)));
                // Nobody listens any more where joining has failed.
                drop(failed.send((index, failure)));
                return;
            }
        }
    }
}

fn work(
    tasks: &Receiver<(u64, PieceTask)>,
    done: &Sender<(u64, Outcome)>,
    settings: &TreeSettings,
    options: &BuildOptions<'_>,
) {
    for (index, task) in tasks {
        // A panic must not leave the others waiting for this piece.
        let outcome = catch_unwind(AssertUnwindSafe(|| run(task, settings, options)));
        let outcome = outcome.map_or_else(Outcome::Panicked, Outcome::Built);
        if done.send((index, outcome)).is_err() {
            return;
        }
    }
}
