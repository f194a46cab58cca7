//! The sorted stream.

use crate::options::Plan;
use crate::pieces::{Content, DividedSurfels, PieceWalk, SortedPiece, UnsortedPiece};
use crate::temp_file::{SURFEL_BYTES, TempFile};
use crate::{SortError, SurfelSummary};
use pbgi_cloud::Surfel;
use pbgi_math::MortonCode;
use std::path::{Path, PathBuf};

/// Surfels appended per chunk, at most.
const CHUNK: usize = 4096;

/// Surfels in the order of (Morton code, input index), as a stream that can be read again: in pieces to be sorted elsewhere, or in
/// sorted chunks.
pub struct SortedSurfels {
    summary: SurfelSummary,
    pub(crate) plan: Plan,
    pub(crate) store: Store,
    pub(crate) temp_dir: PathBuf,
    /// Piece being handed out by chunks, and how far.
    piece: SortedPiece,
    used: usize,
    pub(crate) is_resumed: bool,
}

/// Where the surfels are.
pub(crate) enum Store {
    /// Divided by place, each part yet to be sorted.
    Divided(Box<DividedSurfels>, PieceWalk),
    /// In memory in their final order.
    Memory(Vec<Surfel>, SortedWalk),
    /// On disk in their final order.
    File(TempFile, SortedWalk),
}

/// How far a sorted list is handed out.
#[derive(Clone, Copy, Default)]
pub(crate) struct SortedWalk {
    next: u64,
    /// One more than the code of the last surfel handed out.
    codes_done: u64,
}

impl SortedSurfels {
    pub(crate) fn new(summary: SurfelSummary, plan: Plan, store: Store, temp_dir: &Path) -> Self {
        Self {
            summary,
            plan,
            store,
            temp_dir: temp_dir.to_owned(),
            piece: SortedPiece::default(),
            used: 0,
            is_resumed: false,
        }
    }

    /// Whether the surfels were not read from the source, but are those an earlier run has kept.
    #[must_use]
    pub fn is_resumed(&self) -> bool {
        self.is_resumed
    }

    /// What the stream holds.
    #[must_use]
    pub fn summary(&self) -> &SurfelSummary {
        &self.summary
    }

    /// Runs on disk; 0 when the surfels are in memory or in one sorted file.
    #[must_use]
    pub fn run_count(&self) -> usize {
        match &self.store {
            Store::Divided(divided, _) => match &divided.content {
                Content::Disk(runs) => runs.run_count(),
                Content::Memory(_) => 0,
            },
            Store::Memory(..) | Store::File(..) => 0,
        }
    }

    /// The next piece, yet to be sorted; `None` at the end. Not to be mixed with [`Self::read_chunk`] before the next
    /// [`Self::rewind`].
    ///
    /// # Errors
    ///
    /// If a temporary file cannot be read.
    pub fn next_piece(&mut self) -> Result<Option<UnsortedPiece>, SortError> {
        let count = self.summary.count;
        let most = self.plan.piece_surfels as u64;
        let walk = match &mut self.store {
            Store::Divided(divided, walk) => return walk.next(divided),
            Store::Memory(_, walk) | Store::File(_, walk) => walk,
        };
        let (start, end) = (walk.next, count.min(walk.next + most));
        if start == end {
            return Ok(None);
        }
        let codes_done = walk.codes_done;
        walk.next = end;
        // One more than the piece, whose code tells where the piece ends.
        let ahead = count.min(end + 1);
        let mut surfels = match &self.store {
            Store::Memory(all, _) => all[start as usize..ahead as usize].to_vec(),
            Store::File(file, _) => {
                let mut surfels = vec![Surfel::default(); (ahead - start) as usize];
                file.read_at(start * SURFEL_BYTES, bytemuck::cast_slice_mut(&mut surfels))?;
                surfels
            }
            Store::Divided(..) => unreachable!("handled above"),
        };
        let root = self.summary.root;
        let code = |surfel: Option<&Surfel>| surfel.map(|s| root.code(s.center()).0);
        let next_code = if ahead > end { code(surfels.pop().as_ref()) } else { None };
        if let Store::Memory(_, walk) | Store::File(_, walk) = &mut self.store {
            walk.codes_done = code(surfels.last()).map_or(0, |last| last + 1);
        }
        let whole = codes_done..next_code.unwrap_or(u64::MAX).max(codes_done);
        Ok(Some(UnsortedPiece { root, surfels, whole }))
    }

    /// Appends the next surfels with their codes to `out`, at most a few thousand; `false` when
    /// there are no more.
    ///
    /// # Errors
    ///
    /// If a temporary file cannot be read.
    pub fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, SortError> {
        while self.used == self.piece.surfels.len() {
            let Some(piece) = self.next_piece()? else { return Ok(false) };
            (self.piece, self.used) = (piece.sort(), 0);
        }
        let end = self.piece.surfels.len().min(self.used + CHUNK);
        let chunk = self.used..end;
        out.extend(chunk.map(|i| (self.piece.codes[i], self.piece.surfels[i])));
        self.used = end;
        Ok(true)
    }

    /// Starts again at the first surfel.
    ///
    /// # Panics
    ///
    /// If what was read has been given back ([`Self::release_as_read`]).
    pub fn rewind(&mut self) {
        (self.piece, self.used) = (SortedPiece::default(), 0);
        match &mut self.store {
            Store::Divided(divided, walk) => {
                assert!(!divided.releases, "what was read is gone");
                *walk = PieceWalk::new(divided);
            }
            Store::Memory(_, walk) | Store::File(_, walk) => *walk = SortedWalk::default(),
        }
    }

    /// Starts at the first surfel for the last time: temporary files give their space back as they are read.
    pub fn release_as_read(&mut self) {
        self.rewind();
        if let Store::Divided(divided, walk) = &mut self.store {
            divided.releases = true;
            *walk = PieceWalk::new(divided);
        }
    }
}
