//! Where a page's stored bytes come from: the mapped file, or reads.

use std::fs::File;
use std::path::Path;

/// How pages are brought in. Both give the same bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// From a memory map of the file. Fastest on a local disk.
    #[default]
    Map,
    /// By positioned reads: survives a file that is truncated meanwhile, as on network disks.
    Read,
}

pub(crate) enum Source {
    Map(map::MappedFile),
    Read(File),
}

impl Source {
    pub fn open(file: File, backend: Backend) -> std::io::Result<Self> {
        match backend {
            Backend::Map => map::MappedFile::new(&file).map(Self::Map),
            Backend::Read => Ok(Self::Read(file)),
        }
    }

    /// Fills `out` with the bytes at `offset`.
    pub fn read_at(&self, offset: u64, out: &mut [u8]) -> std::io::Result<()> {
        match self {
            Self::Map(map) => map.read_at(offset, out),
            Self::Read(file) => std::os::unix::fs::FileExt::read_exact_at(file, out, offset),
        }
    }
}

/// Opens `path` for reading and returns its size, too.
pub(crate) fn open_file(path: &Path) -> std::io::Result<(File, u64)> {
    let file = File::open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_dir() {
        return Err(std::io::Error::other("it is a folder, not an octree file"));
    }
    Ok((file, metadata.len()))
}

#[expect(unsafe_code, reason = "mapping a file is unsafe: another process may change it")]
mod map {
    use memmap2::{Advice, Mmap, UncheckedAdvice};
    use std::fs::File;

    /// A read-only map whose bytes are only ever copied out.
    pub(crate) struct MappedFile {
        map: Mmap,
    }

    impl MappedFile {
        pub fn new(file: &File) -> std::io::Result<Self> {
            // SAFETY: the map is private to this module and read only through `read_at`, which
            // copies. A file that another process rewrites can therefore yield stale or mixed
            // bytes, which the checksum of each page catches, but no reference to changing memory
            // ever leaves this module. Truncation while mapped raises SIGBUS, the documented
            // limit of this back end; `Backend::Read` is for disks where that can happen.
            let map = unsafe { Mmap::map(file)? };
            // Pages are brought in whole, by `read_at`; read-ahead around them is waste.
            map.advise(Advice::Random)?;
            Ok(Self { map })
        }

        pub fn read_at(&self, offset: u64, out: &mut [u8]) -> std::io::Result<()> {
            let start = usize::try_from(offset).unwrap_or(usize::MAX);
            let end = start.checked_add(out.len()).filter(|&end| end <= self.map.len());
            let end = end.ok_or(std::io::ErrorKind::UnexpectedEof)?;
            // One request for the whole page: faults taken singly, which is what populating a map without read-ahead does, are a
            // hundred times slower. Where the kernel cannot populate, the copy below faults the bytes in.
            let _ = self.map.advise_range(Advice::WillNeed, start, out.len());
            let _ = self.map.advise_range(Advice::PopulateRead, start, out.len());
            out.copy_from_slice(&self.map[start..end]);
            // SAFETY: the map is read-only and shared with the file, so dropped pages come back
            // with the same contents; nothing refers to them here.
            unsafe { self.map.unchecked_advise_range(UncheckedAdvice::DontNeed, start, out.len()) }
        }
    }
}
