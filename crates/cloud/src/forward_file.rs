//! Files that are read once, from front to back.

use crate::CloudError;
use pbgi_file::open_input;
use pbgi_file::platform::forget_cached;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longer files leave nothing in the system's page cache: they would only drive other things out, and pages that are used again at once
/// are far cheaper than ever new ones, above all on virtual machines.
const CACHED_BYTES_MAX: u64 = 1 << 30;

/// Bytes after which the pages behind the reader are given back.
const WINDOW_BYTES: u64 = 8 << 20;

/// A file being read from front to back.
pub(crate) struct ForwardFile {
    file: File,
    /// Whether pages are given back.
    drops: bool,
    /// Bytes read, and how many of them when pages were last given back.
    read: u64,
    dropped: u64,
}

impl ForwardFile {
    /// Opens the file `path`.
    pub fn open(path: &Path) -> Result<Self, CloudError> {
        let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
        Ok(Self::new(file, CACHED_BYTES_MAX))
    }

    /// A file at its start, which gives pages back if it is longer than `cached_bytes_max`. Pipes have no length, and no pages.
    fn new(file: File, cached_bytes_max: u64) -> Self {
        let drops = file.metadata().is_ok_and(|m| m.len() > cached_bytes_max);
        Self { file, drops, read: 0, dropped: 0 }
    }

    fn drop_pages(&mut self) {
        // Once more what lies before, as large pages that reach beyond their window stay.
        let start = self.dropped.saturating_sub(WINDOW_BYTES);
        forget_cached(&self.file, start, self.read - start);
        self.dropped = self.read;
    }
}

impl Read for ForwardFile {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.read += count as u64;
        let is_due = count == 0 || self.read - self.dropped >= WINDOW_BYTES;
        if self.drops && is_due && self.read > self.dropped {
            self.drop_pages();
        }
        Ok(count)
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use rustix::fs::{Advice, fadvise};
    use rustix::io::{Errno, ReadWriteFlags, preadv2};
    use std::io::{IoSliceMut, Write};

    /// Whether the page at `offset` is in the system's page cache; none where that cannot be told.
    fn is_cached(file: &File, offset: u64) -> Option<bool> {
        let mut byte = [0];
        let buffers = &mut [IoSliceMut::new(&mut byte)];
        match preadv2(file, buffers, offset, ReadWriteFlags::NOWAIT) {
            Ok(_) => Some(true),
            Err(Errno::AGAIN) => Some(false),
            Err(_) => None,
        }
    }

    #[test]
    fn long_files_leave_no_pages_behind() {
        let mut file = tempfile::NamedTempFile::new_in(env!("CARGO_MANIFEST_DIR")).unwrap();
        let contents: Vec<u8> = (0..20u32 << 20).map(|i| (i % 251) as u8).collect();
        file.write_all(&contents).unwrap();
        file.as_file().sync_all().unwrap();
        for (cached_bytes_max, stays) in [(contents.len() as u64, true), (1 << 20, false)] {
            let mut forward = ForwardFile::new(File::open(file.path()).unwrap(), cached_bytes_max);
            let mut read = Vec::new();
            forward.read_to_end(&mut read).unwrap();
            assert!(read == contents);
            // The first page is asked for last, as asking may read ahead.
            for offset in [19 << 20, 9 << 20, 0] {
                match is_cached(&forward.file, offset) {
                    Some(true) if !stays => {
                        // Files in memory stay there, whatever is advised.
                        fadvise(&forward.file, 0, None, Advice::DontNeed).unwrap();
                        assert_eq!(is_cached(&forward.file, offset), Some(true), "{offset}");
                        println!("skipped: pages of this folder's files cannot be given back");
                    }
                    Some(false) if stays => println!("skipped: the system is short of memory"),
                    Some(_) => {}
                    None => println!("skipped: the system does not tell what it caches"),
                }
            }
        }
    }
}
