//! Where the bytes of an octree file come from: a map of it, or reads.

use pbgi_file::{open_input, platform};
use std::fs::File;
use std::io;
use std::path::Path;
use std::time::SystemTime;

/// How pages are brought in. Both give the same bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// By positioned reads, one for each page. An error of the disk, or a file that gets shorter, ends in an error.
    #[default]
    Read,
    /// From a memory map of the file, each page brought in by one request and copied out. A file that another process shortens at the
    /// moment of the copy kills this one: not for network disks. Only Linux can bring pages in so; other systems read.
    Map,
}

/// What tells that a file is not the one that was opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileState {
    /// Its size.
    pub bytes: u64,
    /// When it was last written, where the system tells.
    pub modified: Option<SystemTime>,
}

/// The bytes of an octree file, wherever they are. Called by several threads at once.
pub trait PageSource: Send + Sync {
    /// Fills `out` with the bytes from `offset` on.
    ///
    /// # Errors
    ///
    /// If not all of them can be read.
    fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()>;

    /// Size and age of the file now.
    ///
    /// # Errors
    ///
    /// If the system does not tell.
    fn state(&self) -> io::Result<FileState>;
}

/// Opens `path` for reading.
pub(crate) fn open_source(path: &Path, backend: Backend) -> io::Result<Box<dyn PageSource>> {
    let file = open_input(path)?;
    Ok(match backend {
        Backend::Read => Box::new(file),
        #[cfg(target_os = "linux")]
        Backend::Map => Box::new(map::MappedFile::new(file)?),
        #[cfg(not(target_os = "linux"))]
        Backend::Map => Box::new(file),
    })
}

impl PageSource for File {
    fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        platform::read_exact_at(self, out, offset)
    }

    fn state(&self) -> io::Result<FileState> {
        let metadata = self.metadata()?;
        Ok(FileState { bytes: metadata.len(), modified: metadata.modified().ok() })
    }
}

#[cfg(target_os = "linux")]
#[expect(unsafe_code, reason = "mapping a file is unsafe: another process may change it")]
mod map {
    use super::{FileState, PageSource};
    use memmap2::{Advice, Mmap, UncheckedAdvice};
    use std::fs::File;
    use std::io;
    use std::sync::{PoisonError, RwLock};

    /// A read-only map whose bytes are only ever copied out.
    pub(super) struct MappedFile {
        map: Mmap,
        file: File,
        /// Shared while bytes are copied, exclusive while what was mapped for that is dropped.
        copying: RwLock<()>,
    }

    /// The system maps as much at once where it caches a file in large pages.
    const WINDOW_BYTES: usize = 2 << 20;

    impl MappedFile {
        pub fn new(file: File) -> io::Result<Self> {
            // SAFETY: the map is private to this module and read only through `read_at`, which
            // copies. A file that another process rewrites can therefore yield stale or mixed
            // bytes, which the checksum of each page catches, but no reference to changing memory
            // ever leaves this module. Truncation between populating and copying raises SIGBUS, the
            // documented limit of this back end; `Backend::Read` is for disks where that can happen.
            let map = unsafe { Mmap::map(&file)? };
            // Pages are brought in whole, by `read_at`; read-ahead around them is waste.
            map.advise(Advice::Random)?;
            Ok(Self { map, file, copying: RwLock::new(()) })
        }
    }

    impl PageSource for MappedFile {
        fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
            let start = usize::try_from(offset).unwrap_or(usize::MAX);
            let end = start.checked_add(out.len()).filter(|&end| end <= self.map.len());
            let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
            let shared = self.copying.read().unwrap_or_else(PoisonError::into_inner);
            // One request for the whole page: faults taken singly, which is what populating a map without read-ahead does, are a
            // hundred times slower.
            let _ = self.map.advise_range(Advice::WillNeed, start, out.len());
            // Nothing is touched that is not there: what cannot be populated, on old kernels, behind the end of a shortened file
            // or on a bad disk, is read, which faults nothing in and tells what is wrong.
            if self.map.advise_range(Advice::PopulateRead, start, out.len()).is_err() {
                return self.file.read_at(offset, out);
            }
            out.copy_from_slice(&self.map[start..end]);
            drop(shared);
            let window = start / WINDOW_BYTES * WINDOW_BYTES;
            let length = end.next_multiple_of(WINDOW_BYTES).min(self.map.len()) - window;
            let _exclusive = self.copying.write().unwrap_or_else(PoisonError::into_inner);
            // SAFETY: the map is read-only and shared with the file, so dropped pages come back
            // with the same contents; nothing refers to them here, and nobody copies from them now.
            unsafe { self.map.unchecked_advise_range(UncheckedAdvice::DontNeed, window, length) }
        }

        fn state(&self) -> io::Result<FileState> {
            self.file.state()
        }
    }
}
