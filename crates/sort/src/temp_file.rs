//! Temporary files, which have no name unless they are to outlive the process.

use crate::SortError;
use crate::aligned::ALIGNMENT;
use pbgi_cloud::{CloudError, Surfel, SurfelSource};
use pbgi_file::platform::{self, read_exact_at, write_all_at};
use pbgi_file::{create_new, folder_of, open_kept};
use pbgi_math::DVec3;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Bytes of a surfel as it is in memory, in this machine's byte order.
pub(crate) const SURFEL_BYTES: u64 = size_of::<Surfel>() as u64;
/// Room left on the disk for others.
const FREE_BYTES_MIN: u64 = 16 << 20;

/// An unlinked file, so that nothing stays behind however the process ends, or a named one.
///
/// What is written and read in large blocks goes past the system's page cache where the file system allows: it is read once only, and
/// copying costs more than the disk.
pub(crate) struct TempFile {
    file: File,
    /// The same file, to be read and written in aligned blocks.
    direct: Option<File>,
    dir: PathBuf,
    len: u64,
}

impl TempFile {
    /// Creates an empty file in `dir`.
    pub fn create(dir: &Path) -> Result<Self, SortError> {
        let file = tempfile::tempfile_in(dir).map_err(|source| SortError::Temp {
            dir: dir.to_owned(),
            action: "create",
            source,
        })?;
        Ok(Self::of(file, dir.to_owned(), 0))
    }

    fn of(file: File, dir: PathBuf, len: u64) -> Self {
        let direct = platform::reopen_direct(&file);
        Self { file, direct, dir, len }
    }

    /// Creates a new file of this name, in place of one that is there, which stays when it is closed.
    pub fn create_named(path: &Path) -> Result<Self, SortError> {
        let dir = folder_of(path).to_owned();
        match create_new(path) {
            Ok(file) => Ok(Self::of(file, dir, 0)),
            Err(source) => Err(SortError::Temp { dir, action: "create", source }),
        }
    }

    /// Opens a file of this name, if it has this length.
    pub fn open(path: &Path, len: u64) -> Option<Self> {
        let file = open_kept(path).ok()?;
        let dir = folder_of(path).to_owned();
        (file.metadata().ok()?.len() == len).then(|| Self::of(file, dir, len))
    }

    /// Waits until all of it is on disk.
    pub fn sync(&self) -> Result<(), SortError> {
        self.file.sync_data().map_err(|source| self.error("sync", source))
    }

    /// Bytes in the file.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// Errors unless the disk has room for `bytes` more.
    pub fn check_room(&self, bytes: u64) -> Result<(), SortError> {
        let needed = bytes.saturating_add(FREE_BYTES_MIN);
        match self.free_bytes() {
            Some(free) if free < needed => {
                Err(SortError::DiskFull { dir: self.dir.clone(), needed, free })
            }
            _ => Ok(()),
        }
    }

    /// Appends bytes.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), SortError> {
        write_all_at(&self.file, bytes, self.len)
            .map_err(|source| self.write_error(source, bytes.len()))?;
        self.len += bytes.len() as u64;
        Ok(())
    }

    /// Reserves disk space for `len` more bytes, to be written by [`Self::write_blocks`], and returns where they start.
    pub fn extend(&mut self, len: u64) -> Result<u64, SortError> {
        let start = self.len.next_multiple_of(ALIGNMENT as u64);
        self.len = (start + len).next_multiple_of(ALIGNMENT as u64);
        match platform::reserve(&self.file, start, self.len - start) {
            Err(e) => Err(self.write_error(e, (self.len - start) as usize)),
            Ok(()) => Ok(start),
        }
    }

    /// Writes whole blocks.
    pub fn write_blocks(&self, offset: u64, blocks: &[u8]) -> Result<(), SortError> {
        self.direct_or_buffered(|file| write_all_at(file, blocks, offset))
            .map_err(|source| self.write_error(source, blocks.len()))
    }

    /// Reads whole blocks.
    pub fn read_blocks(&self, offset: u64, out: &mut [u8]) -> Result<(), SortError> {
        self.direct_or_buffered(|file| read_exact_at(file, out, offset))
            .map_err(|source| self.error("read", source))
    }

    /// Calls `access` with the file that goes past the page cache; where there is none, or it takes no such blocks, with the other.
    fn direct_or_buffered(
        &self,
        mut access: impl FnMut(&File) -> io::Result<()>,
    ) -> io::Result<()> {
        match self.direct.as_ref().map(&mut access) {
            Some(Err(error)) if error.kind() == io::ErrorKind::InvalidInput => access(&self.file),
            Some(result) => result,
            None => access(&self.file),
        }
    }

    fn write_error(&self, source: io::Error, needed: usize) -> SortError {
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => SortError::DiskFull {
                dir: self.dir.clone(),
                needed: needed as u64,
                free: self.free_bytes().unwrap_or(0),
            },
            _ => self.error("write", source),
        }
    }

    /// Fills `out` with the bytes from `offset` on.
    pub fn read_at(&self, offset: u64, out: &mut [u8]) -> Result<(), SortError> {
        self.read_raw(offset, out).map_err(|source| self.error("read", source))
    }

    fn read_raw(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        read_exact_at(&self.file, out, offset)
    }

    /// Gives the disk space of `len` bytes from `offset` on back, where the file system can.
    pub fn release(&self, offset: u64, len: u64) {
        platform::release(&self.file, offset, len);
    }

    /// Bytes of disk space held.
    #[cfg(all(test, target_os = "linux"))]
    pub fn disk_bytes(&self) -> u64 {
        std::os::unix::fs::MetadataExt::blocks(&self.file.metadata().unwrap()) * 512
    }

    fn free_bytes(&self) -> Option<u64> {
        platform::free_bytes_beside(&self.file)
    }

    fn error(&self, action: &'static str, source: io::Error) -> SortError {
        SortError::Temp { dir: self.dir.clone(), action, source }
    }
}

/// Surfels of a temporary file as a source, which gives its space back as it is read.
pub(crate) struct SpooledSource {
    file: TempFile,
    origin: DVec3,
    next: u64,
}

impl SpooledSource {
    /// All surfels of `file`, around `origin`.
    pub fn new(file: TempFile, origin: DVec3) -> Self {
        Self { file, origin, next: 0 }
    }
}

impl SurfelSource for SpooledSource {
    fn origin(&self) -> DVec3 {
        self.origin
    }

    fn count(&self) -> Option<u64> {
        Some(self.file.len / SURFEL_BYTES)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let (start, count) = (out.len(), self.file.len / SURFEL_BYTES);
        let now = (count - self.next).min(SPOOL_CHUNK);
        out.resize(start + now as usize, Surfel::default());
        let (offset, bytes) =
            (self.next * SURFEL_BYTES, bytemuck::cast_slice_mut(&mut out[start..]));
        self.file
            .read_raw(offset, bytes)
            .map_err(|source| CloudError::io(&self.file.dir, "read a temporary file", source))?;
        self.file.release(offset, now * SURFEL_BYTES);
        self.next += now;
        Ok(self.next < count)
    }
}

/// Surfels a [`SpooledSource`] reads at once.
const SPOOL_CHUNK: u64 = 1 << 14;

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the system tells how much room there is.
    #[test]
    #[cfg(unix)]
    fn a_full_disk_is_found_out_before_writing() {
        let dir = tempfile::tempdir().unwrap();
        let file = TempFile::create(dir.path()).unwrap();
        file.check_room(1).unwrap();
        let error = file.check_room(1 << 50).unwrap_err();
        assert!(matches!(error, SortError::DiskFull { .. }));
        let text = error.to_string();
        assert!(text.contains(dir.path().to_str().unwrap()) && text.contains("bytes free"));
    }

    /// Elsewhere they lose it when they are closed.
    #[test]
    #[cfg(unix)]
    fn files_have_no_name() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = TempFile::create(dir.path()).unwrap();
        file.append(&[7; 100]).unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
