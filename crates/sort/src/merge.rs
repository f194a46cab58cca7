//! Merging sorted runs with a tree of losers.

use crate::SortError;
use crate::options::Plan;
use crate::temp_file::TempFile;
use pbgi_cloud::Surfel;
use pbgi_math::{MortonCode, RootCube};
use std::ops::Range;

/// Code behind the last surfel of a run; true codes have 63 bits.
const EXHAUSTED: u64 = u64::MAX;

/// One run being read: where it lies in the file and what of it is in memory.
struct Cursor {
    left: Range<u64>,
    buffer: Vec<Surfel>,
    next: usize,
}

impl Cursor {
    /// The current surfel, reading on if the buffer is used up.
    fn current(
        &mut self,
        file: &TempFile,
        buffer_surfels: usize,
    ) -> Result<Option<Surfel>, SortError> {
        if self.next == self.buffer.len() {
            let len = (buffer_surfels as u64).min(self.left.end - self.left.start) as usize;
            self.buffer.reserve_exact(len.saturating_sub(self.buffer.len()));
            self.buffer.resize(len, Surfel::default());
            file.read_at(self.left.start, &mut self.buffer)?;
            self.left.start += len as u64;
            self.next = 0;
        }
        Ok(self.buffer.get(self.next).copied())
    }
}

/// Reads several sorted runs of a file as one.
///
/// A tree of losers (Knuth, "The Art of Computer Programming", vol. 3, 5.4.1): each inner node keeps
/// the run that lost there, so that the next surfel costs one comparison per level. Runs follow one
/// another in input order, so equal codes go to the earlier run.
pub(crate) struct Merger {
    root: RootCube,
    buffer_surfels: usize,
    cursors: Vec<Cursor>,
    /// Code of each run's current surfel.
    codes: Vec<u64>,
    /// Loser at each inner node; node 0 is not used.
    losers: Vec<u32>,
    winner: usize,
}

impl Merger {
    /// Starts merging `runs` of `file`, which must lie there in input order.
    pub fn new(
        file: &TempFile,
        runs: &[Range<u64>],
        plan: &Plan,
        root: RootCube,
    ) -> Result<Self, SortError> {
        let cursor = |run: &Range<u64>| Cursor { left: run.clone(), buffer: Vec::new(), next: 0 };
        let mut merger = Self {
            root,
            buffer_surfels: plan.merge_buffer_surfels(runs.len()),
            cursors: runs.iter().map(cursor).collect(),
            codes: vec![EXHAUSTED; runs.len()],
            losers: vec![0; runs.len()],
            winner: 0,
        };
        merger.start(file)?;
        Ok(merger)
    }

    /// Starts again at the first surfel of `runs`, the ones given to [`Merger::new`], in the memory
    /// already held.
    pub fn restart(&mut self, file: &TempFile, runs: &[Range<u64>]) -> Result<(), SortError> {
        for (cursor, run) in self.cursors.iter_mut().zip(runs) {
            cursor.left = run.clone();
            cursor.buffer.clear();
            cursor.next = 0;
        }
        self.start(file)
    }

    fn start(&mut self, file: &TempFile) -> Result<(), SortError> {
        for run in 0..self.cursors.len() {
            self.load_code(file, run)?;
        }
        self.play_all();
        Ok(())
    }

    /// Appends the next surfels to `out`, at most `max`; `false` when there are no more.
    pub fn read(
        &mut self,
        file: &TempFile,
        max: usize,
        out: &mut Vec<(MortonCode, Surfel)>,
    ) -> Result<bool, SortError> {
        if self.cursors.is_empty() {
            return Ok(false);
        }
        for _ in 0..max {
            let code = self.codes[self.winner];
            if code == EXHAUSTED {
                return Ok(false);
            }
            let cursor = &mut self.cursors[self.winner];
            out.push((MortonCode(code), cursor.buffer[cursor.next]));
            cursor.next += 1;
            self.load_code(file, self.winner)?;
            self.replay(self.winner);
        }
        Ok(self.codes[self.winner] != EXHAUSTED)
    }

    fn load_code(&mut self, file: &TempFile, run: usize) -> Result<(), SortError> {
        let current = self.cursors[run].current(file, self.buffer_surfels)?;
        self.codes[run] = current.map_or(EXHAUSTED, |s| self.root.code(s.center()).0);
        Ok(())
    }

    fn beats(&self, a: usize, b: usize) -> bool {
        (self.codes[a], a) < (self.codes[b], b)
    }

    /// Plays every match, bottom up. Leaf `run` is node `runs + run`; node *n* has children 2*n* and
    /// 2*n* + 1.
    fn play_all(&mut self) {
        let runs = self.cursors.len();
        let mut winners: Vec<usize> = (0..2 * runs).map(|n| n.saturating_sub(runs)).collect();
        for node in (1..runs).rev() {
            let (a, b) = (winners[2 * node], winners[2 * node + 1]);
            let (winner, loser) = if self.beats(a, b) { (a, b) } else { (b, a) };
            winners[node] = winner;
            self.losers[node] = loser as u32;
        }
        self.winner = winners.get(1).copied().unwrap_or(0);
    }

    /// Plays the matches of `run`, whose code has changed, up to the root.
    fn replay(&mut self, run: usize) {
        let mut winner = run;
        let mut node = (self.cursors.len() + run) / 2;
        while node > 0 {
            let loser = self.losers[node] as usize;
            if self.beats(loser, winner) {
                self.losers[node] = winner as u32;
                winner = loser;
            }
            node /= 2;
        }
        self.winner = winner;
    }
}
