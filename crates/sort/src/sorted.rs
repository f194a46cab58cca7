//! The sorted stream.

use crate::merge::Merger;
use crate::run_buffer::RunBuffer;
use crate::temp_file::TempFile;
use crate::{SortError, SurfelSummary};
use pbgi_cloud::Surfel;
use pbgi_math::MortonCode;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Surfels appended per chunk, at most.
pub(crate) const CHUNK: usize = 4096;

/// Surfels in the order of (Morton code, input index), as a stream that can be read again.
pub struct SortedSurfels {
    summary: SurfelSummary,
    pub(crate) store: Store,
    pub(crate) temp_dir: PathBuf,
    /// Rank of the next surfel.
    next: u64,
}

/// Where the surfels are.
pub(crate) enum Store {
    /// In memory.
    Memory(RunBuffer),
    /// On disk as sorted runs.
    Runs(Box<Runs>),
    /// On disk in their final order.
    File {
        /// All of them.
        file: TempFile,
        /// Those being handed out.
        chunk: Vec<Surfel>,
    },
}

/// Sorted runs and the state of merging them.
pub(crate) struct Runs {
    pub file: TempFile,
    pub runs: Vec<Range<u64>>,
    pub merger: Merger,
    /// Where the order is written down as it is first read.
    pub record: Option<TempFile>,
}

impl SortedSurfels {
    pub(crate) fn new(summary: SurfelSummary, store: Store, temp_dir: &Path) -> Self {
        Self { summary, store, temp_dir: temp_dir.to_owned(), next: 0 }
    }

    /// What the stream holds.
    #[must_use]
    pub fn summary(&self) -> &SurfelSummary {
        &self.summary
    }

    /// Sorted runs on disk; 0 when the surfels are in memory or in one file.
    #[must_use]
    pub fn run_count(&self) -> usize {
        match &self.store {
            Store::Runs(runs) => runs.runs.len(),
            Store::Memory(_) | Store::File { .. } => 0,
        }
    }

    /// Appends the next surfels with their codes to `out`, at most a few thousand; `false` when
    /// there are no more.
    ///
    /// # Errors
    ///
    /// If a temporary file cannot be read or written.
    pub fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, SortError> {
        let start = out.len();
        let len = (self.summary.count - self.next).min(CHUNK as u64) as usize;
        match &mut self.store {
            Store::Memory(buffer) => {
                let first = self.next as usize;
                out.extend((first..first + len).map(|rank| buffer.sorted(rank)));
            }
            Store::Runs(runs) => {
                runs.merger.read(&runs.file, len, out)?;
                if let Some(record) = &mut runs.record {
                    let surfels: Vec<Surfel> = out[start..].iter().map(|(_, s)| *s).collect();
                    record.append(&surfels)?;
                }
            }
            Store::File { file, chunk } => {
                chunk.resize(len, Surfel::default());
                file.read_at(self.next, chunk)?;
                let root = &self.summary.root;
                out.extend(chunk.iter().map(|s| (root.code(s.center()), *s)));
            }
        }
        self.next += (out.len() - start) as u64;
        Ok(self.next < self.summary.count)
    }

    /// Starts again at the first surfel. Runs on disk are merged again, unless the stream is
    /// replayable and was read to its end.
    ///
    /// # Errors
    ///
    /// If a temporary file cannot be read or written.
    pub fn rewind(&mut self) -> Result<(), SortError> {
        self.next = 0;
        let Store::Runs(runs) = &mut self.store else { return Ok(()) };
        if let Some(record) = runs.record.take() {
            if record.count() == self.summary.count {
                self.store = Store::File { file: record, chunk: Vec::new() };
                return Ok(());
            }
            runs.record = Some(TempFile::create(&self.temp_dir)?);
        }
        runs.merger.restart(&runs.file, &runs.runs)
    }

    /// Makes reading again cheap: runs on disk are written in their final order to one more
    /// temporary file while they are first read. In memory this does nothing.
    ///
    /// # Errors
    ///
    /// If the file cannot be created, or the disk has no room for it.
    pub fn into_replayable(mut self) -> Result<Self, SortError> {
        if let Store::Runs(runs) = &mut self.store {
            let record = TempFile::create(&self.temp_dir)?;
            record.check_room(self.summary.count)?;
            runs.record = Some(record);
            self.rewind()?;
        }
        Ok(self)
    }
}
