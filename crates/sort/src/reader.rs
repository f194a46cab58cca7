//! Reading a source beside the work on what was read.

use crate::{SortError, SurfelSummary};
use crossbeam::channel::{Receiver, Sender, bounded};
use pbgi_cloud::{Surfel, SurfelSource};
use pbgi_math::{Aabb, MortonCode, RootCube};

/// Surfels handed over together, at least, but at the end.
const CHUNK_SURFELS: usize = 1 << 13;

/// Chunks that may wait, or come back for reuse.
const CHUNKS_WAITING: usize = 4;

/// Surfels that were read together.
#[derive(Default)]
pub(crate) struct Chunk {
    pub surfels: Vec<Surfel>,
    /// Their codes, where the root cube is known.
    pub codes: Vec<MortonCode>,
}

/// Surfels checked and summed as they are read.
pub(crate) struct Checked {
    pub summary: SurfelSummary,
    /// Bounds the source states, and the root cube that follows from them.
    place: Option<(Aabb, RootCube)>,
}

impl Checked {
    /// Reads the next surfels of `source`; `false` when there are no more.
    fn read(
        &mut self,
        source: &mut dyn SurfelSource,
        chunk: &mut Chunk,
    ) -> Result<bool, SortError> {
        let Chunk { surfels, codes } = chunk;
        surfels.clear();
        codes.clear();
        let mut more = true;
        while more && surfels.len() < CHUNK_SURFELS {
            let start = surfels.len();
            more = source.read_chunk(surfels)?;
            for surfel in &surfels[start..] {
                self.check(surfel)?;
                self.summary.add(surfel);
            }
        }
        if let Some((_, root)) = &self.place {
            codes.extend(surfels.iter().map(|surfel| root.code(surfel.center())));
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
        match &self.place {
            Some((bounds, _)) if !bounds.contains(center) => bad("lies outside the stated bounds"),
            _ => Ok(()),
        }
    }
}

/// Reads all of `source` and hands it on chunk by chunk, with two threads or more while the next chunk is read. `place` is the bounds the
/// source states and its root cube. Returns the summary of all, its root cube not set.
pub(crate) fn with_chunks(
    source: &mut dyn SurfelSource,
    place: Option<(Aabb, RootCube)>,
    threads: usize,
    take: &mut dyn FnMut(&Chunk) -> Result<(), SortError>,
) -> Result<Checked, SortError> {
    let summary = SurfelSummary::new(source.origin());
    let mut checked = Checked { summary, place };
    if threads < 2 {
        let mut chunk = Chunk::default();
        let mut more = true;
        while more {
            more = checked.read(source, &mut chunk)?;
            take(&chunk)?;
        }
        return Ok(checked);
    }
    std::thread::scope(|scope| {
        let (full_sender, full) = bounded::<Chunk>(CHUNKS_WAITING);
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
    full: &Sender<Chunk>,
    empty: &Receiver<Chunk>,
) -> Result<Checked, SortError> {
    loop {
        let mut chunk = empty.try_recv().unwrap_or_default();
        let more = checked.read(source, &mut chunk)?;
        // Nobody takes chunks any more where taking has failed.
        if full.send(chunk).is_err() || !more {
            return Ok(checked);
        }
    }
}

fn take_all(
    full: Receiver<Chunk>,
    empty: &Sender<Chunk>,
    take: &mut dyn FnMut(&Chunk) -> Result<(), SortError>,
) -> Result<(), SortError> {
    for chunk in full {
        take(&chunk)?;
        // One chunk more than fits is dropped.
        drop(empty.try_send(chunk));
    }
    Ok(())
}
