//! Records which pages readers ask for, in order, to replay with other policies and budgets.
//!
//! Little-endian. A header: `PBGITRC1`, u32 pages, and for each page u32 decoded bytes. Then chunks: u32 reader, u32 entries, and for
//! each entry u32 page, u32 requests in a row. A chunk without entries says that the reader is gone, with all it had pinned. Chunks
//! of one reader are in order, and so are those of readers that run one after the other; of readers that run at the same
//! time, stretches of up to [`CHUNK_ENTRIES`] follow each other.

use pbgi_file::AtomicFile;
use pbgi_format::{PageEntry, PageId};
use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

/// First bytes of a trace.
pub const TRACE_MAGIC: [u8; 8] = *b"PBGITRC1";

/// Entries a reader keeps before it writes them.
const CHUNK_ENTRIES: usize = 1024;

/// A trace being written.
pub(crate) struct TraceWriter {
    /// The file, or the first error.
    file: Mutex<io::Result<AtomicFile>>,
    readers: AtomicU32,
}

impl TraceWriter {
    pub fn create(path: &Path, pages: &[PageEntry]) -> io::Result<Self> {
        let mut file = AtomicFile::create(path)?;
        file.write_all(&TRACE_MAGIC)?;
        file.write_all(&(pages.len() as u32).to_le_bytes())?;
        for page in pages {
            file.write_all(&page.decoded_bytes.to_le_bytes())?;
        }
        Ok(Self { file: Mutex::new(Ok(file)), readers: AtomicU32::new(0) })
    }

    /// A recorder for a new reader.
    pub fn reader(&self) -> ReaderTrace<'_> {
        let reader = self.readers.fetch_add(1, Ordering::Relaxed);
        ReaderTrace { trace: self, reader, entries: Vec::new() }
    }

    /// Completes the file, which appears under its name. Nothing can be recorded any more.
    ///
    /// # Errors
    ///
    /// The first error of any write.
    pub fn finish(&self) -> io::Result<()> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let file = std::mem::replace(&mut *file, Err(io::ErrorKind::Other.into()))?;
        file.commit()
            .map_err(|e| io::Error::new(e.source.kind(), format!("{}: {}", e.action, e.source)))
    }

    /// Writes, unless a write failed before.
    fn write_with(&self, write: impl FnOnce(&mut AtomicFile) -> io::Result<()>) {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        if let Ok(open) = &mut *file
            && let Err(error) = write(open)
        {
            *file = Err(error);
        }
    }
}

/// What one reader asked for.
pub(crate) struct ReaderTrace<'a> {
    trace: &'a TraceWriter,
    reader: u32,
    /// Pages, each with the number of requests in a row.
    entries: Vec<(PageId, u32)>,
}

impl ReaderTrace<'_> {
    #[cold]
    pub fn record(&mut self, id: PageId) {
        match self.entries.last_mut() {
            Some((last, requests)) if *last == id && *requests < u32::MAX => *requests += 1,
            _ => {
                if self.entries.len() == CHUNK_ENTRIES {
                    self.write();
                }
                self.entries.push((id, 1));
            }
        }
    }

    /// Writes the entries as one chunk.
    fn write(&mut self) {
        self.trace.write_with(|file| {
            file.write_all(&self.reader.to_le_bytes())?;
            file.write_all(&(self.entries.len() as u32).to_le_bytes())?;
            for (id, requests) in &self.entries {
                file.write_all(&id.0.to_le_bytes())?;
                file.write_all(&requests.to_le_bytes())?;
            }
            Ok(())
        });
        self.entries.clear();
    }
}

impl Drop for ReaderTrace<'_> {
    fn drop(&mut self) {
        if !self.entries.is_empty() {
            self.write();
        }
        self.write();
    }
}

/// A part of a trace: pages that one reader asked for, each with the number of requests in a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TraceChunk {
    /// The reader, by the order in which readers were made.
    pub reader: u32,
    /// Pages and requests; none where the reader is gone.
    pub entries: Vec<(PageId, u32)>,
}

/// A recorded trace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageTrace {
    /// Decoded bytes of each page of the file.
    pub page_bytes: Vec<u32>,
    /// What readers asked for, in the order of the file.
    pub chunks: Vec<TraceChunk>,
}

impl PageTrace {
    /// Reads a trace.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or is no complete trace.
    pub fn read(path: &Path) -> io::Result<Self> {
        let bytes = std::fs::read(path)?;
        let invalid = || {
            let text = format!("{} is no complete trace of pages; record it again", path.display());
            io::Error::new(io::ErrorKind::InvalidData, text)
        };
        Self::parse(&bytes).ok_or_else(invalid)
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.strip_prefix(&TRACE_MAGIC)?;
        let (words, []) = bytes.as_chunks::<4>() else { return None };
        let mut words = words.iter().copied().map(u32::from_le_bytes);
        let page_count = words.next()? as usize;
        let page_bytes: Vec<u32> = words.by_ref().take(page_count).collect();
        if page_bytes.len() != page_count {
            return None;
        }
        let mut chunks = Vec::new();
        while let Some(reader) = words.next() {
            let count = words.next()?;
            let mut entries = Vec::new();
            for _ in 0..count {
                let id = words.next().filter(|id| (*id as usize) < page_count)?;
                entries.push((PageId(id), words.next()?));
            }
            chunks.push(TraceChunk { reader, entries });
        }
        Some(Self { page_bytes, chunks })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_format::PageKind;

    #[test]
    fn traces_come_back_and_cut_ones_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.trace");
        let page = |decoded_bytes| PageEntry {
            offset: 256,
            stored_bytes: 10,
            decoded_bytes,
            checksum: 0,
            kind: PageKind::Nodes,
        };
        let writer = TraceWriter::create(&path, &[page(100), page(70)]).unwrap();
        let mut reader = writer.reader();
        let other = writer.reader();
        [1, 1, 1, 0, 1].into_iter().for_each(|id| reader.record(PageId(id)));
        drop((reader, other));
        writer.finish().unwrap();
        let trace = PageTrace::read(&path).unwrap();
        assert_eq!(trace.page_bytes, [100, 70]);
        let entries = vec![(PageId(1), 3), (PageId(0), 1), (PageId(1), 1)];
        let chunk = |reader, entries| TraceChunk { reader, entries };
        let expected = [chunk(0, entries), chunk(0, Vec::new()), chunk(1, Vec::new())];
        assert_eq!(trace.chunks, expected);
        let bytes = std::fs::read(&path).unwrap();
        for length in (0..20).chain(21..bytes.len() - 16) {
            // Whole chunks from the beginning are a shorter trace.
            assert!(PageTrace::parse(&bytes[..length]).is_none() || length == 52, "{length}");
        }
    }

    #[test]
    fn long_traces_are_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.trace");
        let page = PageEntry {
            offset: 256,
            stored_bytes: 10,
            decoded_bytes: 10,
            checksum: 0,
            kind: PageKind::Nodes,
        };
        let writer = TraceWriter::create(&path, &[page; 7]).unwrap();
        let mut reader = writer.reader();
        let asked: Vec<PageId> = (0..5000).map(|k| PageId(k % 7)).collect();
        asked.iter().for_each(|id| reader.record(*id));
        drop(reader);
        writer.finish().unwrap();
        let trace = PageTrace::read(&path).unwrap();
        let read = trace.chunks.iter().flat_map(|chunk| chunk.entries.iter().map(|e| e.0));
        assert!(read.eq(asked));
    }
}
