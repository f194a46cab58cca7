//! Memory that reading may take: what headers and lengths state is counted before any of it is read.

use crate::open_input;
use std::fmt;
use std::io::{self, Read};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes of memory that readers share.
#[derive(Debug)]
pub struct Allowance {
    granted: u64,
    taken: AtomicU64,
}

/// More memory is needed than there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excess {
    /// Bytes in all, as far as they are known.
    pub needed: u64,
    /// Bytes granted.
    pub granted: u64,
}

impl fmt::Display for Excess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { needed, granted } = self;
        write!(f, "{needed} bytes of memory are needed, and {granted} are left")
    }
}

impl std::error::Error for Excess {}

impl Excess {
    /// The excess that an error tells of, if it does.
    #[must_use]
    pub fn of(error: &io::Error) -> Option<Self> {
        error.get_ref()?.downcast_ref().copied()
    }
}

impl Allowance {
    /// So many bytes.
    #[must_use]
    pub const fn new(granted: u64) -> Self {
        Self { granted, taken: AtomicU64::new(0) }
    }

    /// No bound.
    #[must_use]
    pub const fn unlimited() -> Self {
        Self::new(u64::MAX)
    }

    /// Takes bytes that are about to be held.
    ///
    /// # Errors
    ///
    /// An [`Excess`] if there are not so many left; they count as taken nevertheless.
    pub fn take(&self, bytes: u64) -> io::Result<()> {
        let add = |taken: u64| Some(taken.saturating_add(bytes));
        let before = self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add);
        self.check_total(before.unwrap_or_else(|taken| taken).saturating_add(bytes))
    }

    /// Whether bytes could be held for a while, besides those that are taken.
    ///
    /// # Errors
    ///
    /// An [`Excess`] if there are not so many left.
    pub fn check(&self, bytes: u64) -> io::Result<()> {
        self.check_total(self.taken.load(Ordering::Relaxed).saturating_add(bytes))
    }

    fn check_total(&self, needed: u64) -> io::Result<()> {
        let granted = self.granted;
        if needed <= granted {
            return Ok(());
        }
        Err(io::Error::new(io::ErrorKind::OutOfMemory, Excess { needed, granted }))
    }

    /// Reads all of a regular file, whose length is taken.
    ///
    /// # Errors
    ///
    /// If that is too much, if it is no regular file or cannot be read.
    pub fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let file = open_input(path)?;
        let length = file.metadata()?.len();
        self.take(length)?;
        let mut bytes = Vec::with_capacity(length as usize);
        // Files of the system tell no length.
        file.take(length.max(FILE_BYTES_UNTOLD)).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// Most bytes that are read of a file that tells no length.
const FILE_BYTES_UNTOLD: u64 = 1 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_in_all_is_bounded() {
        let allowance = Allowance::new(10);
        allowance.take(4).unwrap();
        allowance.check(6).unwrap();
        let excess = Excess::of(&allowance.check(7).unwrap_err());
        assert_eq!(excess, Some(Excess { needed: 11, granted: 10 }));
        allowance.take(6).unwrap();
        assert!(allowance.take(1).is_err());
        assert!(allowance.take(u64::MAX).is_err() && allowance.take(u64::MAX).is_err());
        Allowance::unlimited().take(u64::MAX).unwrap();
        assert_eq!(Excess::of(&io::Error::other("other")), None);
    }

    #[test]
    fn files_are_counted_before_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hole");
        std::fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let allowance = Allowance::new(1 << 20);
        let excess = Excess::of(&allowance.read(&path).unwrap_err());
        assert_eq!(excess, Some(Excess { needed: 1 << 40, granted: 1 << 20 }));
        std::fs::write(&path, "text").unwrap();
        assert_eq!(Allowance::new(4).read(&path).unwrap(), b"text");
    }
}
