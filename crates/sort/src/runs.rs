//! Runs: what was in memory when it was full, written down cell by cell.

use crate::SortError;
use crate::aligned::{ALIGNMENT, AlignedBuffer};
use crate::buckets::Buckets;
use crate::form::RecordForm;
use crate::temp_file::TempFile;
use crate::trie::Trie;
use crossbeam::channel::{Receiver, Sender, bounded};
use pbgi_cloud::Surfel;

/// Bytes written at once.
const WRITE_BYTES: usize = 1 << 20;

/// Buffers of a run being written: one is filled while the others are written.
const WRITE_BUFFERS: usize = 3;

/// Space is given back by multiples of this many bytes.
const RELEASE_BYTES: u64 = 1 << 20;

/// Runs in one temporary file, one after another. Each holds its cells in the order of [`Trie::visit`]; later divisions
/// only insert cells behind their parents, so that all runs can be read side by side.
pub(crate) struct Runs {
    file: TempFile,
    runs: Vec<Run>,
}

pub(crate) struct Run {
    /// Its first byte in the file, aligned.
    pub start: u64,
    pub form: RecordForm,
    /// Nodes of its cells and how many surfels of each.
    pub cells: Vec<(u32, u32)>,
}

impl Run {
    /// Bytes of all its records.
    fn len_bytes(&self) -> u64 {
        let surfels: u64 = self.cells.iter().map(|&(_, len)| u64::from(len)).sum();
        surfels * self.form.record_bytes() as u64
    }
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
    #[cfg(all(test, target_os = "linux"))]
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
        let mut cells = Vec::new();
        trie.visit(&mut |node| {
            let len = buckets.len(node);
            if len > 0 {
                cells.push((node, len as u32));
            }
        });
        let mut run = Run { start: 0, form, cells };
        run.start = self.file.extend(run.len_bytes())?;
        let file = &self.file;
        std::thread::scope(|scope| {
            let (full_sender, full) = bounded::<(u64, AlignedBuffer)>(WRITE_BUFFERS);
            let (empty_sender, empty) = bounded(WRITE_BUFFERS);
            for _ in 0..WRITE_BUFFERS {
                let _ = empty_sender.send(AlignedBuffer::new(WRITE_BYTES));
            }
            let writer = scope.spawn(move || -> Result<(), SortError> {
                for (offset, mut buffer) in full {
                    file.write_blocks(offset, buffer.aligned())?;
                    let _ = empty_sender.send(buffer);
                }
                Ok(())
            });
            let mut output =
                RunOutput { offset: run.start, filled: 0, buffer: None, empty, full: full_sender };
            let mut records = Vec::new();
            for piece in run.cells.iter().flat_map(|&(node, _)| buckets.pieces(node)) {
                records.clear();
                form.encode(piece, &mut records);
                // Without buffers the writer has failed.
                if output.put(&records).is_none() {
                    break;
                }
            }
            output.finish();
            writer.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })?;
        self.runs.push(run);
        Ok(())
    }
}

/// Fills buffers for the thread that writes them.
struct RunOutput {
    /// Place of the buffer at hand in the file.
    offset: u64,
    filled: usize,
    buffer: Option<AlignedBuffer>,
    empty: Receiver<AlignedBuffer>,
    full: Sender<(u64, AlignedBuffer)>,
}

impl RunOutput {
    /// Appends bytes; `None` if nobody writes any more.
    fn put(&mut self, mut bytes: &[u8]) -> Option<()> {
        while !bytes.is_empty() {
            let mut buffer = match self.buffer.take() {
                Some(buffer) => buffer,
                None => self.empty.recv().ok()?,
            };
            let now = bytes.len().min(WRITE_BYTES - self.filled);
            buffer.aligned()[self.filled..self.filled + now].copy_from_slice(&bytes[..now]);
            self.filled += now;
            bytes = &bytes[now..];
            if self.filled < WRITE_BYTES {
                self.buffer = Some(buffer);
            } else {
                self.full.send((self.offset, buffer)).ok()?;
                self.offset += WRITE_BYTES as u64;
                self.filled = 0;
            }
        }
        Some(())
    }

    /// Sends what is left, as whole blocks.
    fn finish(mut self) {
        if let Some(mut buffer) = self.buffer.take() {
            let len = self.filled.next_multiple_of(ALIGNMENT);
            buffer.aligned()[self.filled..len].fill(0);
            buffer.truncate(len);
            // If nobody writes any more, the writer says why.
            let _ = self.full.send((self.offset, buffer));
        }
    }
}

/// Where reading all runs side by side has come to.
pub(crate) struct RunCursors {
    cursors: Vec<Cursor>,
    /// Whether what was read is not read again.
    releases: bool,
    /// Node being read, the run it is read from, and what of that is left.
    node: u32,
    run: usize,
    left: usize,
}

struct Cursor {
    /// Index of the run's next cell.
    cell: usize,
    /// Place in the file behind what is in the buffer.
    position: u64,
    /// Place behind the last record of the run.
    end: u64,
    /// Place up to which space was given back.
    released: u64,
    buffer: AlignedBuffer,
    /// Bytes of a record that lie in front of the aligned ones, and aligned ones that are filled.
    carried: usize,
    filled: usize,
    /// Bytes already handed out, counted from the carried ones on.
    used: usize,
}

impl RunCursors {
    /// At the start of all runs, with buffers of so many bytes. With `releases` the disk space of what was read is given back.
    pub fn new(runs: &Runs, buffer_bytes: usize, releases: bool) -> Self {
        let start = |run: &Run| Cursor {
            cell: 0,
            position: run.start,
            end: run.start + run.len_bytes(),
            released: run.start,
            buffer: AlignedBuffer::new(buffer_bytes),
            carried: 0,
            filled: 0,
            used: 0,
        };
        let cursors: Vec<Cursor> = runs.runs.iter().map(start).collect();
        Self { run: cursors.len(), cursors, releases, node: 0, left: 0 }
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
            let form = &runs.runs[self.run].form;
            let size = form.record_bytes();
            if cursor.ready().len() < size {
                cursor.refill(&runs.file, self.releases)?;
            }
            let ready = cursor.ready();
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
    /// Bytes read and not handed out.
    fn ready(&self) -> &[u8] {
        &self.buffer.with_carried(self.carried, self.filled)[self.used..]
    }

    /// Reads the next blocks of the run. Less than a record is left of those before.
    fn refill(&mut self, file: &TempFile, releases: bool) -> Result<(), SortError> {
        let left = self.ready().len();
        self.buffer.carry(self.filled - left, left);
        let done = self.position / RELEASE_BYTES * RELEASE_BYTES;
        if releases && done > self.released {
            file.release(self.released, done - self.released);
            self.released = done;
        }
        let to_end = self.end - self.position;
        let blocks = to_end.next_multiple_of(ALIGNMENT as u64).min(self.buffer.capacity() as u64);
        file.read_blocks(self.position, &mut self.buffer.aligned()[..blocks as usize])?;
        self.position += blocks;
        (self.carried, self.used) = (left, 0);
        self.filled = blocks.min(to_end) as usize;
        Ok(())
    }
}
