//! Temporary files without a name, counted in surfels.

use crate::SortError;
use pbgi_cloud::{CloudError, Surfel, SurfelSource};
use pbgi_math::DVec3;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Bytes of a surfel on disk: as in memory, in this machine's byte order.
const SURFEL_BYTES: u64 = size_of::<Surfel>() as u64;
/// Room left on the disk for others.
const FREE_BYTES_MIN: u64 = 16 << 20;

/// An unlinked file of surfels: however the process ends, it leaves nothing behind.
pub(crate) struct TempFile {
    file: File,
    dir: PathBuf,
    count: u64,
}

impl TempFile {
    /// Creates an empty file in `dir`.
    pub fn create(dir: &Path) -> Result<Self, SortError> {
        let file = tempfile::tempfile_in(dir).map_err(|source| SortError::Temp {
            dir: dir.to_owned(),
            action: "create",
            source,
        })?;
        Ok(Self { file, dir: dir.to_owned(), count: 0 })
    }

    /// Surfels in the file.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Errors unless the disk has room for `surfels` more.
    pub fn check_room(&self, surfels: u64) -> Result<(), SortError> {
        let needed = surfels.saturating_mul(SURFEL_BYTES).saturating_add(FREE_BYTES_MIN);
        match self.free_bytes() {
            Some(free) if free < needed => {
                Err(SortError::DiskFull { dir: self.dir.clone(), needed, free })
            }
            _ => Ok(()),
        }
    }

    /// Appends surfels.
    pub fn append(&mut self, surfels: &[Surfel]) -> Result<(), SortError> {
        self.write_at(self.count, surfels)?;
        self.count += surfels.len() as u64;
        Ok(())
    }

    /// Overwrites surfels from the one at `index` on.
    pub fn write_at(&self, index: u64, surfels: &[Surfel]) -> Result<(), SortError> {
        let bytes: &[u8] = bytemuck::cast_slice(surfels);
        self.file.write_all_at(bytes, index * SURFEL_BYTES).map_err(|source| match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => SortError::DiskFull {
                dir: self.dir.clone(),
                needed: bytes.len() as u64,
                free: self.free_bytes().unwrap_or(0),
            },
            _ => self.error("write", source),
        })
    }

    /// Fills `out` with the surfels from the one at `index` on.
    pub fn read_at(&self, index: u64, out: &mut [Surfel]) -> Result<(), SortError> {
        self.read_raw(index, out).map_err(|source| self.error("read", source))
    }

    fn read_raw(&self, index: u64, out: &mut [Surfel]) -> io::Result<()> {
        self.file.read_exact_at(bytemuck::cast_slice_mut(out), index * SURFEL_BYTES)
    }

    fn free_bytes(&self) -> Option<u64> {
        let stat = rustix::fs::fstatvfs(&self.file).ok()?;
        Some(stat.f_bavail.saturating_mul(stat.f_frsize))
    }

    fn error(&self, action: &'static str, source: io::Error) -> SortError {
        SortError::Temp { dir: self.dir.clone(), action, source }
    }
}

/// Surfels of a temporary file as a source.
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
        Some(self.file.count)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let start = out.len();
        let now = (self.file.count - self.next).min(SPOOL_CHUNK);
        out.resize(start + now as usize, Surfel::default());
        self.file
            .read_raw(self.next, &mut out[start..])
            .map_err(|source| CloudError::io(&self.file.dir, "read a temporary file", source))?;
        self.next += now;
        Ok(self.next < self.file.count)
    }
}

/// Surfels a [`SpooledSource`] reads at once.
const SPOOL_CHUNK: u64 = 1 << 14;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_found_out_before_writing() {
        let dir = tempfile::tempdir().unwrap();
        let file = TempFile::create(dir.path()).unwrap();
        file.check_room(1).unwrap();
        let error = file.check_room(1 << 50).unwrap_err();
        assert!(matches!(error, SortError::DiskFull { .. }));
        let text = error.to_string();
        assert!(text.contains(dir.path().to_str().unwrap()) && text.contains("bytes free"));
    }

    #[test]
    fn files_have_no_name() {
        let dir = tempfile::tempdir().unwrap();
        let mut file = TempFile::create(dir.path()).unwrap();
        file.append(&[Surfel::default(); 100]).unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
