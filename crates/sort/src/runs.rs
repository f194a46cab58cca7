//! Runs: what was in memory when it was full, written down cell by cell.

use crate::SortError;
use crate::buckets::Buckets;
use crate::temp_file::TempFile;
use crate::trie::Trie;
use pbgi_cloud::Surfel;

/// Surfels written at once.
const WRITE_SURFELS: usize = (1 << 20) / size_of::<Surfel>();

/// Runs in one temporary file, one after another. Each holds its cells in the order of [`Trie::visit`]; later divisions
/// only insert cells behind their parents, so that all runs can be read side by side.
pub(crate) struct Runs {
    file: TempFile,
    runs: Vec<Run>,
}

struct Run {
    /// Rank of its first surfel in the file.
    start: u64,
    /// Nodes of its cells and how many surfels of each.
    cells: Vec<(u32, u32)>,
}

impl Runs {
    /// No runs yet.
    pub fn new(file: TempFile) -> Self {
        Self { file, runs: Vec::new() }
    }

    pub fn run_count(&self) -> usize {
        self.runs.len()
    }

    /// Writes all surfels in memory as one more run.
    pub fn write(&mut self, trie: &Trie, buckets: &Buckets) -> Result<(), SortError> {
        let start = self.file.count();
        let mut buffer: Vec<Surfel> = Vec::with_capacity(WRITE_SURFELS);
        let mut cells = Vec::new();
        trie.visit(&mut |node| {
            let len = buckets.len(node);
            if len > 0 {
                cells.push((node, len as u32));
            }
        });
        for &(node, _) in &cells {
            for piece in buckets.pieces(node) {
                if buffer.len() + piece.len() > WRITE_SURFELS {
                    self.file.append(&buffer)?;
                    buffer.clear();
                }
                buffer.extend_from_slice(piece);
            }
        }
        self.file.append(&buffer)?;
        self.runs.push(Run { start, cells });
        Ok(())
    }
}

/// Where reading all runs side by side has come to.
pub(crate) struct RunCursors {
    cursors: Vec<Cursor>,
    buffer_surfels: usize,
    /// Node being read, the run it is read from, and what of that is left.
    node: u32,
    run: usize,
    left: usize,
}

#[derive(Default)]
struct Cursor {
    /// Index of the run's next cell.
    cell: usize,
    /// Rank in the file behind what is in the buffer.
    position: u64,
    buffer: Vec<Surfel>,
    /// Surfels of the buffer already handed out.
    used: usize,
}

impl RunCursors {
    /// At the start of all runs, with buffers of so many surfels.
    pub fn new(runs: &Runs, buffer_surfels: usize) -> Self {
        let start = |run: &Run| Cursor { position: run.start, ..Cursor::default() };
        let cursors: Vec<Cursor> = runs.runs.iter().map(start).collect();
        Self { run: cursors.len(), cursors, buffer_surfels, node: 0, left: 0 }
    }

    /// Turns to the cell of `node`. Cells must be asked for in the order of [`Trie::visit`], none left out.
    pub fn begin(&mut self, runs: &Runs, node: u32) {
        (self.node, self.run) = (node, 0);
        self.left = self.cell_len(runs);
    }

    /// Surfels of the node in the run at hand.
    fn cell_len(&mut self, runs: &Runs) -> usize {
        let Some(cursor) = self.cursors.get_mut(self.run) else { return 0 };
        match runs.runs[self.run].cells.get(cursor.cell) {
            Some(&(node, count)) if node == self.node => {
                cursor.cell += 1;
                count as usize
            }
            _ => 0,
        }
    }

    /// Appends the next surfels of the cell to `out`, at most `max`, earlier runs first; nothing at its end.
    pub fn read(
        &mut self,
        runs: &Runs,
        mut max: usize,
        out: &mut Vec<Surfel>,
    ) -> Result<(), SortError> {
        while max > 0 && self.run < self.cursors.len() {
            if self.left == 0 {
                self.run += 1;
                self.left = self.cell_len(runs);
                continue;
            }
            let cursor = &mut self.cursors[self.run];
            if cursor.used == cursor.buffer.len() {
                cursor.refill(runs, self.run, self.buffer_surfels)?;
            }
            let ready = &cursor.buffer[cursor.used..];
            let now = self.left.min(max).min(ready.len());
            out.extend_from_slice(&ready[..now]);
            cursor.used += now;
            self.left -= now;
            max -= now;
        }
        Ok(())
    }
}

impl Cursor {
    fn refill(&mut self, runs: &Runs, run: usize, surfels: usize) -> Result<(), SortError> {
        let end = runs.runs.get(run + 1).map_or(runs.file.count(), |next| next.start);
        let len = (surfels as u64).min(end - self.position) as usize;
        self.buffer.resize(len, Surfel::default());
        runs.file.read_at(self.position, &mut self.buffer)?;
        self.position += len as u64;
        self.used = 0;
        Ok(())
    }
}
