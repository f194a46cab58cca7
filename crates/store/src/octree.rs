//! An open octree file and its readers.

use crate::cache::{Cache, Lookup, PageRef};
use crate::error::StoreError;
use crate::source::{Backend, Source, open_file};
use crate::stats::{CacheStats, ReaderStats};
use pbgi_format::{
    FormatError, HEADER_BYTES, Header, NodePage, PAGE_ENTRY_BYTES, PageEntry, PageId, PageKind,
    SurfelLayout, SurfelPage, page_checksum,
};
use std::path::{Path, PathBuf};

/// How to open a file.
#[derive(Clone, Copy, Debug)]
pub struct OpenOptions {
    /// Bytes of decoded pages to hold at most.
    pub cache_bytes: u64,
    /// Readers that will be used at the same time.
    pub readers: usize,
    /// How pages are brought in.
    pub backend: Backend,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { cache_bytes: 256 << 20, readers: 1, backend: Backend::Map }
    }
}

/// Pages a reader may hold pinned besides the ones on its way down the tree.
const LOCAL_PINS: usize = 64;

/// Pages on the way from the root to a leaf, and one being loaded.
const PATH_PINS: u64 = 24;

/// Least cache a reader needs, per byte of the file's largest page.
pub const PIN_BYTES_PER_READER_MIN: u64 = PATH_PINS + 2;

/// An octree file opened for reading, shared by all threads.
pub struct Octree {
    path: PathBuf,
    header: Header,
    table: Vec<PageEntry>,
    source: Source,
    cache: Cache,
    local_pins: usize,
}

impl Octree {
    /// Opens and validates the header and the page table; pages are read and verified when first
    /// used.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is no octree file, is damaged, or if the budget is too small.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, StoreError> {
        let io = |action| {
            let path = path.to_owned();
            move |source| StoreError::Io { path, action, source }
        };
        let malformed = |source| StoreError::Malformed { path: path.to_owned(), source };
        let (file, file_bytes) = open_file(path).map_err(io("open"))?;
        if file_bytes < HEADER_BYTES as u64 {
            let found = format!("{file_bytes} bytes");
            let expected = format!("at least {HEADER_BYTES}");
            return Err(malformed(FormatError { place: "file", found, expected }));
        }
        let source = Source::open(file, options.backend).map_err(io("map"))?;
        let mut bytes = [0; HEADER_BYTES];
        source.read_at(0, &mut bytes).map_err(io("read"))?;
        let header = Header::from_bytes(&bytes, file_bytes).map_err(malformed)?;
        // The header is consistent with the file's size, so the table is no larger than the file.
        let mut bytes = vec![0; header.page_count as usize * PAGE_ENTRY_BYTES];
        source.read_at(header.page_table_offset, &mut bytes).map_err(io("read"))?;
        let table = read_table(&bytes, &header).map_err(malformed)?;
        let largest = u64::from(header.page_bytes_max);
        let needed = options.readers as u64 * PIN_BYTES_PER_READER_MIN * largest;
        let fixed = table.len() as u64 * (Cache::BYTES_PER_PAGE + size_of::<PageEntry>() as u64);
        if options.cache_bytes < needed + fixed {
            return Err(StoreError::Budget {
                path: path.to_owned(),
                needed: needed + fixed,
                granted: options.cache_bytes,
                readers: options.readers,
            });
        }
        let cache_bytes = options.cache_bytes - fixed;
        // Readers' own pins take at most half of what is left beyond the ways down.
        let spare = (cache_bytes - needed) / 2 / options.readers.max(1) as u64 / largest.max(1);
        Ok(Self {
            path: path.to_owned(),
            header,
            cache: Cache::new(table.len(), cache_bytes),
            table,
            source,
            local_pins: (spare as usize).clamp(1, LOCAL_PINS),
        })
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's header.
    #[must_use]
    #[inline(always)]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// How surfels and lobes are stored.
    #[must_use]
    #[inline(always)]
    pub fn layout(&self) -> SurfelLayout {
        self.header.surfel_layout()
    }

    /// The page table.
    #[must_use]
    pub fn pages(&self) -> &[PageEntry] {
        &self.table
    }

    /// What the cache did so far; readers add their requests when they are dropped.
    #[must_use]
    pub fn stats(&self) -> CacheStats {
        self.cache.stats()
    }

    /// A reader, for one thread.
    #[must_use]
    pub fn reader(&self) -> Reader<'_> {
        let pins = self.local_pins.next_power_of_two();
        let pins = if pins > self.local_pins { pins / 2 } else { pins };
        Reader { octree: self, pins: vec![None; pins], stats: ReaderStats::default() }
    }

    /// The page, from the cache or from the file, and the stored bytes that were read for it.
    fn load_page(&self, id: PageId) -> Result<(PageRef, u32), StoreError> {
        let entry = self.table.get(id.0 as usize).ok_or_else(|| StoreError::InvalidPage {
            path: self.path.clone(),
            page: id,
            source: FormatError {
                place: "link",
                found: format!("page {id}"),
                expected: format!("a page below {}", self.table.len()),
            },
        })?;
        match self.cache.get(id, entry.decoded_bytes) {
            Lookup::Found(page) => Ok((page, 0)),
            Lookup::Load => {
                let start = std::time::Instant::now();
                match self.read_page(id, entry) {
                    Ok(bytes) => {
                        let ns = start.elapsed().as_nanos() as u64;
                        let page = self.cache.insert(id, bytes, entry.stored_bytes, ns);
                        Ok((page, entry.stored_bytes))
                    }
                    Err(error) => {
                        self.cache.abandon(id, entry.decoded_bytes);
                        Err(error)
                    }
                }
            }
        }
    }

    /// Reads, verifies and decodes a page, past the cache.
    pub(crate) fn read_page(&self, id: PageId, entry: &PageEntry) -> Result<Box<[u8]>, StoreError> {
        let mut stored = vec![0; entry.stored_bytes as usize].into_boxed_slice();
        self.source.read_at(entry.offset, &mut stored).map_err(|source| StoreError::Io {
            path: self.path.clone(),
            action: "read",
            source,
        })?;
        let found = page_checksum(&stored);
        if found != entry.checksum {
            let (path, expected) = (self.path.clone(), entry.checksum);
            return Err(StoreError::Damaged { path, page: id, found, expected });
        }
        let invalid =
            |source| StoreError::InvalidPage { path: self.path.clone(), page: id, source };
        let decoded = if entry.is_compressed() {
            lz4_flex::block::decompress(&stored, entry.decoded_bytes as usize)
                .map(Vec::into_boxed_slice)
                .map_err(|error| {
                    invalid(FormatError {
                        place: "LZ4 data",
                        found: error.to_string(),
                        expected: format!("{} bytes", entry.decoded_bytes),
                    })
                })?
        } else {
            stored
        };
        let checked = match entry.kind {
            PageKind::Nodes => NodePage::new(&decoded, id).map(drop),
            PageKind::Surfels => SurfelPage::new(&decoded).map(drop),
        };
        checked.map_err(invalid)?;
        Ok(decoded)
    }
}

fn read_table(bytes: &[u8], header: &Header) -> Result<Vec<PageEntry>, FormatError> {
    let found = page_checksum(bytes);
    if found != header.page_table_checksum {
        return Err(FormatError {
            place: "page table: checksum",
            found: format!("{found:#018x}"),
            expected: format!("{:#018x}", header.page_table_checksum),
        });
    }
    let mut table = Vec::with_capacity(bytes.len() / PAGE_ENTRY_BYTES);
    let mut end = HEADER_BYTES as u64;
    for entry in bytes.as_chunks::<PAGE_ENTRY_BYTES>().0 {
        let entry = PageEntry::read(entry)?;
        let next = entry.offset.checked_add(u64::from(entry.stored_bytes));
        let next = next.filter(|&next| entry.offset >= end && next <= header.page_table_offset);
        let Some(next) = next else {
            return Err(FormatError {
                place: "page table: page",
                found: format!("{} bytes at {}", entry.stored_bytes, entry.offset),
                expected: format!("between {end} and {}", header.page_table_offset),
            });
        };
        if entry.decoded_bytes > header.page_bytes_max {
            return Err(FormatError {
                place: "page table: decoded bytes",
                found: entry.decoded_bytes.to_string(),
                expected: format!("at most {}", header.page_bytes_max),
            });
        }
        end = next;
        table.push(entry);
    }
    Ok(table)
}

/// One thread's access to an octree: pins pages, remembering the most recent ones.
pub struct Reader<'a> {
    octree: &'a Octree,
    /// Recently used pages by their number modulo the (power of two) length.
    pins: Vec<Option<(PageId, PageRef)>>,
    stats: ReaderStats,
}

impl<'a> Reader<'a> {
    /// The octree.
    #[must_use]
    #[inline(always)]
    pub fn octree(&self) -> &'a Octree {
        self.octree
    }

    /// Pins a page until the returned reference is dropped.
    ///
    /// # Errors
    ///
    /// If the page cannot be read or is damaged.
    #[inline]
    pub fn pin_page(&mut self, id: PageId) -> Result<PageRef, StoreError> {
        self.stats.requests += 1;
        let slot = id.0 as usize & (self.pins.len() - 1);
        if let Some((pinned, page)) = &self.pins[slot]
            && *pinned == id
        {
            self.stats.local_hits += 1;
            return Ok(page.clone());
        }
        // Unpin first, so that the budget can be met.
        self.pins[slot] = None;
        let start = std::time::Instant::now();
        let (page, bytes_read) = self.octree.load_page(id)?;
        self.stats.pages_read += u64::from(bytes_read > 0);
        self.stats.bytes_read += u64::from(bytes_read);
        self.stats.wait_ns += start.elapsed().as_nanos() as u64;
        self.pins[slot] = Some((id, page.clone()));
        Ok(page)
    }

    /// This reader's counters.
    #[must_use]
    #[inline(always)]
    pub fn stats(&self) -> ReaderStats {
        self.stats
    }

    /// The error for a page that contradicts itself.
    #[must_use]
    #[cold]
    pub fn invalid_page(&self, page: PageId, source: FormatError) -> StoreError {
        StoreError::InvalidPage { path: self.octree.path.clone(), page, source }
    }
}

impl Drop for Reader<'_> {
    fn drop(&mut self) {
        self.octree.cache.add_requests(self.stats.requests, self.stats.local_hits);
    }
}
