//! Runs: what was in memory when it was full, written down cell by cell.

use crate::SortError;
use crate::buckets::Buckets;
use crate::form::RecordForm;
use crate::temp_file::TempFile;
use crate::trie::Trie;
use pbgi_cloud::Surfel;

/// Bytes written at once.
const WRITE_BYTES: usize = 1 << 20;

/// Space is given back by multiples of this many bytes.
const RELEASE_BYTES: u64 = 1 << 20;

/// Runs in one temporary file, one after another. Each holds its cells in the order of [`Trie::visit`]; later divisions
/// only insert cells behind their parents, so that all runs can be read side by side.
pub(crate) struct Runs {
    file: TempFile,
    runs: Vec<Run>,
}

pub(crate) struct Run {
    /// Its first byte in the file.
    pub start: u64,
    pub form: RecordForm,
    /// Nodes of its cells and how many surfels of each.
    pub cells: Vec<(u32, u32)>,
}

impl Runs {
    /// No runs yet.
    pub fn new(file: TempFile) -> Self {
        Self { file, runs: Vec::new() }
    }

    /// Runs that are in a file already.
    pub fn from_parts(file: TempFile, runs: Vec<Run>) -> Self {
        Self { file, runs }
    }

    pub fn file(&self) -> &TempFile {
        &self.file
    }

    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    pub fn run_count(&self) -> usize {
        self.runs.len()
    }

    /// Bytes of disk space held.
    #[cfg(test)]
    pub fn disk_bytes(&self) -> u64 {
        self.file.disk_bytes()
    }

    /// Writes all surfels in memory, which are of this form, as one more run.
    pub fn write(
        &mut self,
        trie: &Trie,
        buckets: &Buckets,
        form: RecordForm,
    ) -> Result<(), SortError> {
        let start = self.file.len();
        let mut buffer: Vec<u8> = Vec::with_capacity(WRITE_BYTES + (1 << 12));
        let mut cells = Vec::new();
        trie.visit(&mut |node| {
            let len = buckets.len(node);
            if len > 0 {
                cells.push((node, len as u32));
            }
        });
        for &(node, _) in &cells {
            for piece in buckets.pieces(node) {
                form.encode(piece, &mut buffer);
                if buffer.len() >= WRITE_BYTES {
                    self.file.append(&buffer)?;
                    buffer.clear();
                }
            }
        }
        self.file.append(&buffer)?;
        self.runs.push(Run { start, form, cells });
        Ok(())
    }
}

/// Where reading all runs side by side has come to.
pub(crate) struct RunCursors {
    cursors: Vec<Cursor>,
    buffer_bytes: usize,
    /// Whether what was read is not read again.
    releases: bool,
    /// Node being read, the run it is read from, and what of that is left.
    node: u32,
    run: usize,
    left: usize,
}

#[derive(Default)]
struct Cursor {
    /// Index of the run's next cell.
    cell: usize,
    /// Place in the file behind what is in the buffer.
    position: u64,
    /// Place up to which space was given back.
    released: u64,
    buffer: Vec<u8>,
    /// Bytes of the buffer already handed out.
    used: usize,
}

impl RunCursors {
    /// At the start of all runs, with buffers of so many bytes. With `releases` the disk space of what was read is given back.
    pub fn new(runs: &Runs, buffer_bytes: usize, releases: bool) -> Self {
        let start = |run: &Run| {
            let position = run.start;
            Cursor { position, released: position, ..Cursor::default() }
        };
        let cursors: Vec<Cursor> = runs.runs.iter().map(start).collect();
        Self { run: cursors.len(), cursors, buffer_bytes, releases, node: 0, left: 0 }
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
                cursor.refill(runs, self.run, self.buffer_bytes, self.releases)?;
            }
            let form = &runs.runs[self.run].form;
            let size = form.record_bytes();
            let ready = &cursor.buffer[cursor.used..];
            let now = self.left.min(max).min(ready.len() / size);
            form.decode(&ready[..now * size], out);
            cursor.used += now * size;
            self.left -= now;
            max -= now;
        }
        Ok(())
    }
}

impl Cursor {
    /// Reads the next whole records of a run.
    fn refill(
        &mut self,
        runs: &Runs,
        run: usize,
        bytes: usize,
        releases: bool,
    ) -> Result<(), SortError> {
        let size = runs.runs[run].form.record_bytes();
        let end = runs.runs.get(run + 1).map_or(runs.file.len(), |next| next.start);
        let whole = (bytes / size).max(1) * size;
        let len = (whole as u64).min(end - self.position) as usize;
        let done = self.position / RELEASE_BYTES * RELEASE_BYTES;
        if releases && done > self.released {
            runs.file.release(self.released, done - self.released);
            self.released = done;
        }
        self.buffer.resize(len, 0);
        runs.file.read_at(self.position, &mut self.buffer)?;
        self.position += len as u64;
        self.used = 0;
        Ok(())
    }
}
