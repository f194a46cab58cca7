//! Reading a source beside the work on what was read.

use crate::{SortError, SurfelSummary};
use crossbeam::channel::{Receiver, Sender, bounded};
use pbgi_cloud::{Surfel, SurfelSource};
use pbgi_math::Aabb;

/// Surfels handed over together, at least, but at the end.
const CHUNK_SURFELS: usize = 1 << 13;

/// Chunks that may wait, or come back for reuse.
const CHUNKS_WAITING: usize = 4;

/// Surfels checked and summed as they are read.
pub(crate) struct Checked {
    pub summary: SurfelSummary,
    bounds: Option<Aabb>,
}

impl Checked {
    /// Appends the next surfels of `source`; `false` when there are no more.
    fn read(
        &mut self,
        source: &mut dyn SurfelSource,
        out: &mut Vec<Surfel>,
    ) -> Result<bool, SortError> {
        let mut more = true;
        while more && out.len() < CHUNK_SURFELS {
            let start = out.len();
            more = source.read_chunk(out)?;
            for surfel in &out[start..] {
                self.check(surfel)?;
                self.summary.add(surfel);
            }
        }
        Ok(more)
    }

    fn check(&self, surfel: &Surfel) -> Result<(), SortError> {
        let bad = |what| Err(SortError::BadSource { index: self.summary.count, what });
        let center = surfel.center();
        let sizes = [surfel.radius, surfel.area];
        if !center.is_finite() {
            return bad("has a position that is not finite");
        }
        if !sizes.iter().all(|s| (0.0..f32::INFINITY).contains(s))
            || (surfel.radius > 0.0) != (surfel.area > 0.0)
        {
            return bad("has a radius or area that is not above 0");
        }
        match &self.bounds {
            Some(bounds) if !bounds.contains(center) => bad("lies outside the stated bounds"),
            _ => Ok(()),
        }
    }
}

/// Reads all of `source` and hands it on chunk by chunk, with two threads or more while the next chunk is read. `bounds` are those the
/// source states. Returns the summary of all, its root cube not set.
pub(crate) fn with_chunks(
    source: &mut dyn SurfelSource,
    bounds: Option<&Aabb>,
    threads: usize,
    take: &mut dyn FnMut(&[Surfel]) -> Result<(), SortError>,
) -> Result<Checked, SortError> {
    let summary = SurfelSummary::new(source.origin());
    let mut checked = Checked { summary, bounds: bounds.copied() };
    if threads < 2 {
        let mut chunk = Vec::new();
        let mut more = true;
        while more {
            chunk.clear();
            more = checked.read(source, &mut chunk)?;
            take(&chunk)?;
        }
        return Ok(checked);
    }
    std::thread::scope(|scope| {
        let (full_sender, full) = bounded::<Vec<Surfel>>(CHUNKS_WAITING);
        let (empty_sender, empty) = bounded(CHUNKS_WAITING);
        let reader = std::thread::Builder::new()
            .name("read".to_owned())
            .spawn_scoped(scope, move || read_all(checked, source, &full_sender, &empty))
            .map_err(|e| SortError::Threads { threads, message: e.to_string() })?;
        let taken = take_all(full, &empty_sender, take);
        let checked = reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        // An error of the taker ends the reader, whose own comes first where both have one.
        let checked = checked?;
        taken.map(|()| checked)
    })
}

fn read_all(
    mut checked: Checked,
    source: &mut dyn SurfelSource,
    full: &Sender<Vec<Surfel>>,
    empty: &Receiver<Vec<Surfel>>,
) -> Result<Checked, SortError> {
    loop {
        let mut chunk = empty.try_recv().unwrap_or_default();
        chunk.clear();
        let more = checked.read(source, &mut chunk)?;
        // Nobody takes chunks any more where taking has failed.
        if full.send(chunk).is_err() || !more {
            return Ok(checked);
        }
    }
}

fn take_all(
    full: Receiver<Vec<Surfel>>,
    empty: &Sender<Vec<Surfel>>,
    take: &mut dyn FnMut(&[Surfel]) -> Result<(), SortError>,
) -> Result<(), SortError> {
    for chunk in full {
        take(&chunk)?;
        // One chunk more than fits is dropped.
        drop(empty.try_send(chunk));
    }
    Ok(())
}
