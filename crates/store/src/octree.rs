//! An open octree file and its readers.

use crate::cache::{Cache, LoadedPage, Lookup, PageRef};
use crate::error::StoreError;
use crate::source::{Backend, FileState, PageSource, open_source};
use crate::stats::{CacheStats, ReaderStats};
use crate::trace::{ReaderTrace, TraceWriter};
use pbgi_format::{
    FormatError, GROUP_FIXED_BYTES, HEADER_BYTES, Header, NodePage, PAGE_ENTRY_BYTES, PageChecksum,
    PageEntry, PageId, PageKind, SurfelLayout, SurfelPage, page_checksum,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// How to open a file.
#[derive(Clone, Copy, Debug)]
pub struct OpenOptions {
    /// Bytes of decoded pages to hold at most.
    pub cache_bytes: u64,
    /// Readers that will be used at the same time.
    pub readers: usize,
    /// How pages are brought in.
    pub backend: Backend,
    /// Whether readers may go on without pages that are damaged ([`Reader::pin_sound_page`]).
    pub skip_damaged: bool,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            cache_bytes: 256 << 20,
            readers: 1,
            backend: Backend::default(),
            skip_damaged: false,
        }
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
    source: Box<dyn PageSource>,
    /// What the file was when it was opened.
    opened: FileState,
    skip_damaged: bool,
    cache: Cache,
    local_pins: usize,
    trace: Option<TraceWriter>,
    /// Of each page, the page that links to it, as far as it is known.
    parents: Vec<AtomicU32>,
}

/// No page has this number.
const NO_PARENT: u32 = u32::MAX;

/// Bytes that are held of each page of the file, in memory or not.
const BYTES_PER_PAGE: u64 =
    Cache::BYTES_PER_PAGE + (size_of::<PageEntry>() + size_of::<u32>()) as u64;

/// Bytes of the page table read at once.
const TABLE_PART_BYTES: usize = PAGE_ENTRY_BYTES << 12;

/// Why header or page table cannot be used.
enum TableError {
    Io(std::io::Error),
    Format(FormatError),
}

impl Octree {
    /// Opens and validates the header and the page table; pages are read and verified when first
    /// used.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is no octree file, is damaged, or if the budget is too small.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, StoreError> {
        let source = open_source(path, options.backend);
        let source = source.map_err(|source| StoreError::Io {
            path: path.to_owned(),
            action: "open",
            source,
        })?;
        Self::open_from(source, path, options)
    }

    /// [`Octree::open`] for bytes that come from elsewhere; `options.backend` does not count. `path` names them in errors.
    ///
    /// # Errors
    ///
    /// As [`Octree::open`].
    pub fn open_from(
        source: Box<dyn PageSource>,
        path: &Path,
        options: &OpenOptions,
    ) -> Result<Self, StoreError> {
        let io = |source| StoreError::Io { path: path.to_owned(), action: "read", source };
        let malformed = |source| StoreError::Malformed { path: path.to_owned(), source };
        let opened = source.state().map_err(io)?;
        let explained = |error| match error {
            TableError::Io(source) => io(source),
            TableError::Format(source) => malformed(source),
        };
        let header = read_header(&*source, opened.bytes).map_err(explained)?;
        // What the header states is accounted for before any of it is read: a file may be mostly hole.
        let largest = u64::from(header.page_bytes_max);
        let needed = (options.readers as u64).saturating_mul(PIN_BYTES_PER_READER_MIN * largest);
        let fixed = header.page_count.saturating_mul(BYTES_PER_PAGE);
        if options.cache_bytes < needed.saturating_add(fixed) {
            return Err(StoreError::Budget {
                path: path.to_owned(),
                needed: needed.saturating_add(fixed),
                granted: options.cache_bytes,
                readers: options.readers,
            });
        }
        let table = read_table(&*source, &header).map_err(explained)?;
        let cache_bytes = options.cache_bytes - fixed;
        // Readers' own pins save asking the cache, yet what they hold is not what it would hold: they take a small share of what
        // is left beyond the ways down.
        let spare = (cache_bytes - needed) / 16 / options.readers.max(1) as u64 / largest.max(1);
        let decoded_bytes: Vec<u32> = table.iter().map(|entry| entry.decoded_bytes).collect();
        let cache = Cache::new(&decoded_bytes, cache_bytes).map_err(|source| {
            let action = "reserving memory for its pages";
            StoreError::Io { path: path.to_owned(), action, source }
        })?;
        let parents = (0..table.len()).map(|_| AtomicU32::new(NO_PARENT)).collect();
        Ok(Self {
            path: path.to_owned(),
            header,
            cache,
            parents,
            table,
            source,
            opened,
            skip_damaged: options.skip_damaged,
            local_pins: (spare as usize).clamp(1, LOCAL_PINS),
            trace: None,
        })
    }

    /// Reads and validates the header alone.
    ///
    /// # Errors
    ///
    /// As [`Octree::open`].
    pub fn read_header(path: &Path) -> Result<Header, StoreError> {
        let io = |action| move |source| StoreError::Io { path: path.to_owned(), action, source };
        let source = open_source(path, Backend::Read).map_err(io("open"))?;
        let file_bytes = source.state().map_err(io("read"))?.bytes;
        read_header(&*source, file_bytes).map_err(|error| match error {
            TableError::Io(source) => io("read")(source),
            TableError::Format(source) => StoreError::Malformed { path: path.to_owned(), source },
        })
    }

    /// More groups than the file can hold, whatever its header states: a bound for walks.
    #[must_use]
    pub fn group_count_max(&self) -> u64 {
        let nodes = self.table.iter().filter(|page| page.kind == PageKind::Nodes);
        let bytes: u64 = nodes.map(|page| u64::from(page.decoded_bytes)).sum();
        bytes / GROUP_FIXED_BYTES as u64 + 1
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

    /// Pages that readers asked for, that are damaged, and that were left out.
    #[must_use]
    pub fn damaged_pages(&self) -> Vec<PageId> {
        self.cache.left_out()
    }

    /// From now on, records in a new file `path` which pages readers ask for: all requests, before a reader looks among the pages it
    /// has pinned itself.
    ///
    /// # Errors
    ///
    /// If the file cannot be created.
    pub fn record_trace(&mut self, path: &Path) -> std::io::Result<()> {
        self.trace = Some(TraceWriter::create(path, &self.table)?);
        Ok(())
    }

    /// Completes the trace, if one is recorded. All readers must be gone.
    ///
    /// # Errors
    ///
    /// If any of it could not be written.
    pub fn finish_trace(&self) -> std::io::Result<()> {
        self.trace.as_ref().map_or(Ok(()), TraceWriter::finish)
    }

    /// A reader, for one thread.
    #[must_use]
    pub fn reader(&self) -> Reader<'_> {
        let pins = self.local_pins.next_power_of_two();
        let pins = if pins > self.local_pins { pins / 2 } else { pins };
        Reader {
            octree: self,
            pins: vec![None; pins],
            stats: ReaderStats::default(),
            trace: self.trace.as_ref().map(TraceWriter::reader),
        }
    }

    pub(crate) fn entry(&self, id: PageId) -> Result<&PageEntry, StoreError> {
        self.table.get(id.0 as usize).ok_or_else(|| StoreError::InvalidPage {
            path: self.path.clone(),
            page: id,
            source: FormatError {
                place: "link",
                found: format!("page {id}"),
                expected: format!("a page below {}", self.table.len()),
            },
        })
    }

    /// The page, from the cache or from the file, and the stored bytes that were read for it; none where it is damaged and `skips` such
    /// pages.
    fn load_page(&self, id: PageId, skips: bool) -> Result<Option<(PageRef, u32)>, StoreError> {
        let entry = self.entry(id)?;
        let mut buffer = match self.cache.get(id, entry.decoded_bytes) {
            Lookup::Found(page) => return Ok(Some((page, 0))),
            Lookup::LeftOut if skips => return Ok(None),
            // Read again for the error alone.
            Lookup::LeftOut => return self.read_page(id, entry).map(|_| None),
            Lookup::Load(buffer) => buffer,
        };
        let start = std::time::Instant::now();
        let result = self.read_page_into(id, entry, buffer.bytes_mut());
        match result {
            Ok(()) => {
                let read_ns = start.elapsed().as_nanos() as u64;
                let stored_bytes = entry.stored_bytes;
                let page = self.cache.insert(id, LoadedPage { buffer, stored_bytes, read_ns });
                Ok(Some((page, stored_bytes)))
            }
            Err(error) => {
                drop(buffer);
                if skips && error.is_damaged_page() {
                    self.cache.leave_out(id);
                    return Ok(None);
                }
                self.cache.abandon(id);
                Err(error)
            }
        }
    }

    /// Reads, verifies and decodes a page, past the cache.
    pub(crate) fn read_page(&self, id: PageId, entry: &PageEntry) -> Result<Vec<u8>, StoreError> {
        let mut bytes = vec![0; entry.decoded_bytes as usize];
        self.read_page_into(id, entry, &mut bytes)?;
        Ok(bytes)
    }

    /// Reads, verifies and decodes a page into `out`, as long as the page is once decoded.
    fn read_page_into(
        &self,
        id: PageId,
        entry: &PageEntry,
        out: &mut [u8],
    ) -> Result<(), StoreError> {
        let read = |out: &mut [u8]| {
            self.source.read_at(entry.offset, out).map_err(|source| {
                let path = self.path.clone();
                self.explain(StoreError::Unreadable { path, page: id, source }, id)
            })
        };
        if entry.is_compressed() {
            let mut stored = vec![0; entry.stored_bytes as usize];
            read(&mut stored)?;
            self.decode_page(id, entry, &stored, out)
        } else {
            read(out)?;
            self.check_page(id, entry, out)
        }
    }

    /// Reads stored bytes of neighboring pages.
    pub(crate) fn read_stored(&self, offset: u64, out: &mut [u8]) -> std::io::Result<()> {
        self.source.read_at(offset, out)
    }

    /// Verifies the stored bytes of a page that is not compressed.
    pub(crate) fn check_page(
        &self,
        id: PageId,
        entry: &PageEntry,
        stored: &[u8],
    ) -> Result<(), StoreError> {
        self.check_stored(id, entry, stored)?;
        self.check_decoded(id, entry, stored)
    }

    /// Verifies the stored bytes of a compressed page and decodes them into `out`.
    pub(crate) fn decode_page(
        &self,
        id: PageId,
        entry: &PageEntry,
        stored: &[u8],
        out: &mut [u8],
    ) -> Result<(), StoreError> {
        self.check_stored(id, entry, stored)?;
        let found = match lz4_flex::block::decompress_into(stored, out) {
            Ok(length) if length == out.len() => return self.check_decoded(id, entry, out),
            Ok(length) => format!("{length} bytes"),
            Err(error) => error.to_string(),
        };
        let expected = format!("{} bytes", out.len());
        Err(self.invalid_page(id, FormatError { place: "LZ4 data", found, expected }))
    }

    fn check_stored(&self, id: PageId, entry: &PageEntry, stored: &[u8]) -> Result<(), StoreError> {
        let found = page_checksum(stored);
        if found == entry.checksum {
            return Ok(());
        }
        let (path, expected) = (self.path.clone(), entry.checksum);
        Err(self.explain(StoreError::Damaged { path, page: id, found, expected }, id))
    }

    fn check_decoded(&self, id: PageId, entry: &PageEntry, bytes: &[u8]) -> Result<(), StoreError> {
        let checked = match entry.kind {
            PageKind::Nodes => {
                NodePage::new(bytes, id).and_then(|page| self.check_nodes(&page, id))
            }
            PageKind::Surfels => SurfelPage::new(bytes).map(drop),
        };
        checked.map_err(|source| self.invalid_page(id, source))
    }

    /// Checks that the links of a page can be followed: each group is linked once. Within a page that is seen at once; and as all links
    /// into a page come from one page, which page that is need only be known once.
    fn check_nodes(&self, page: &NodePage<'_>, id: PageId) -> Result<(), FormatError> {
        page.check_links(self.header.channels)?;
        for link in (0..).map_while(|index| page.external_link(index)) {
            let Some(parent) = self.parents.get(link.page.0 as usize) else { continue };
            let known =
                parent.compare_exchange(NO_PARENT, id.0, Ordering::Relaxed, Ordering::Relaxed);
            match known {
                Err(other) if other != id.0 => {
                    return Err(FormatError {
                        place: "link: page",
                        found: format!("{}, to which page {other} links, too", link.page),
                        expected: "a page that is linked from one page".to_owned(),
                    });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// `error`, unless the file was written to since it was opened, which explains any damage.
    #[cold]
    fn explain(&self, error: StoreError, page: PageId) -> StoreError {
        match self.source.state() {
            Ok(now) if now != self.opened => self.changed(page),
            _ => error,
        }
    }

    /// The error for a page of a file that was written to.
    #[cold]
    fn changed(&self, page: PageId) -> StoreError {
        let found = self.source.state().map_or(0, |state| state.bytes);
        StoreError::Changed { path: self.path.clone(), page, found, expected: self.opened.bytes }
    }

    /// The error for a page that contradicts itself.
    #[cold]
    pub(crate) fn invalid_page(&self, page: PageId, source: FormatError) -> StoreError {
        StoreError::InvalidPage { path: self.path.clone(), page, source }
    }
}

fn read_header(source: &dyn PageSource, file_bytes: u64) -> Result<Header, TableError> {
    if file_bytes < HEADER_BYTES as u64 {
        let found = format!("{file_bytes} bytes");
        let expected = format!("at least {HEADER_BYTES}");
        return Err(TableError::Format(FormatError { place: "file", found, expected }));
    }
    let mut bytes = [0; HEADER_BYTES];
    source.read_at(0, &mut bytes).map_err(TableError::Io)?;
    Header::from_bytes(&bytes, file_bytes).map_err(TableError::Format)
}

/// Reads the page table in parts, so that one that is a hole ends at its first entry.
fn read_table(source: &dyn PageSource, header: &Header) -> Result<Vec<PageEntry>, TableError> {
    let mut table = Vec::new();
    let mut checksum = PageChecksum::default();
    let (mut end, mut left) = (HEADER_BYTES as u64, header.page_count as usize * PAGE_ENTRY_BYTES);
    let mut offset = header.page_table_offset;
    let mut part = vec![0; TABLE_PART_BYTES.min(left)];
    while left > 0 {
        let part = &mut part[..TABLE_PART_BYTES.min(left)];
        source.read_at(offset, part).map_err(TableError::Io)?;
        checksum.update(part);
        for entry in part.as_chunks::<PAGE_ENTRY_BYTES>().0 {
            let entry = read_entry(entry, &mut end, header).map_err(TableError::Format)?;
            table.push(entry);
        }
        offset += part.len() as u64;
        left -= part.len();
    }
    let found = checksum.finish();
    if found != header.page_table_checksum {
        return Err(TableError::Format(FormatError {
            place: "page table: checksum",
            found: format!("{found:#018x}"),
            expected: format!("{:#018x}", header.page_table_checksum),
        }));
    }
    Ok(table)
}

/// An entry of a page that starts at or after `end`, which becomes the end of it.
fn read_entry(
    bytes: &[u8; PAGE_ENTRY_BYTES],
    end: &mut u64,
    header: &Header,
) -> Result<PageEntry, FormatError> {
    let entry = PageEntry::read(bytes)?;
    let next = entry.offset.checked_add(u64::from(entry.stored_bytes));
    let next = next.filter(|&next| entry.offset >= *end && next <= header.page_table_offset);
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
    *end = next;
    Ok(entry)
}

/// One thread's access to an octree: pins pages, remembering the most recent ones.
pub struct Reader<'a> {
    octree: &'a Octree,
    /// Recently used pages by their number modulo the (power of two) length.
    pins: Vec<Option<(PageId, PageRef)>>,
    stats: ReaderStats,
    trace: Option<ReaderTrace<'a>>,
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
        match self.find_page(id, false)? {
            Some(page) => Ok(page),
            // The page was damaged when it was left out, and is sound now.
            None => Err(self.octree.changed(id)),
        }
    }

    /// Pins a page, or gives none where it is damaged and the file was opened with [`OpenOptions::skip_damaged`].
    ///
    /// # Errors
    ///
    /// If the page cannot be read or is damaged, and is not to be skipped; if the file has changed since it was opened.
    #[inline]
    pub fn pin_sound_page(&mut self, id: PageId) -> Result<Option<PageRef>, StoreError> {
        self.find_page(id, self.octree.skip_damaged)
    }

    #[inline]
    fn find_page(&mut self, id: PageId, skips: bool) -> Result<Option<PageRef>, StoreError> {
        self.stats.requests += 1;
        if let Some(trace) = &mut self.trace {
            trace.record(id);
        }
        let slot = id.0 as usize & (self.pins.len() - 1);
        if let Some((pinned, page)) = &self.pins[slot]
            && *pinned == id
        {
            self.stats.local_hits += 1;
            return Ok(Some(page.clone()));
        }
        // Unpin first, so that the budget can be met.
        self.pins[slot] = None;
        let start = std::time::Instant::now();
        let loaded = self.octree.load_page(id, skips)?;
        self.stats.wait_ns += start.elapsed().as_nanos() as u64;
        let Some((page, bytes_read)) = loaded else { return Ok(None) };
        self.stats.pages_read += u64::from(bytes_read > 0);
        self.stats.bytes_read += u64::from(bytes_read);
        self.pins[slot] = Some((id, page.clone()));
        Ok(Some(page))
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
        self.octree.invalid_page(page, source)
    }
}

impl Drop for Reader<'_> {
    fn drop(&mut self) {
        self.octree.cache.add_requests(self.stats.requests, self.stats.local_hits);
    }
}
