//! Streams of surfels.

use crate::Surfel;
use pbgi_math::{Aabb, DVec3, Vec3};
use std::path::{Path, PathBuf};

/// Surfels the sources of this crate append per chunk, at most.
pub(crate) const CHUNK_SURFELS: usize = 4096;

/// Why a cloud could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CloudError {
    /// The operating system refused.
    #[error("{}: {action} failed: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried: "open", "read", "write" …
        action: &'static str,
        /// The cause.
        source: std::io::Error,
    },
    /// The file is not what it claims to be.
    #[error("{}: {message}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Place, what was found, what was expected, and the cure if there is one.
        message: String,
    },
}

impl CloudError {
    /// An [`CloudError::Io`] for `path`.
    pub fn io(path: &Path, action: &'static str, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), action, source }
    }

    /// A [`CloudError::Malformed`] for `path`.
    pub fn malformed(path: &Path, message: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), message: message.into() }
    }
}

/// Points that are sound, yet were not read, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Of a class that is not wanted ([`crate::ClassFilter`]).
    pub by_class: u64,
    /// Marked as withheld, which means deleted.
    pub withheld: u64,
    /// So far from all others that they would take the digits and the levels of these.
    pub strays: u64,
}

impl LeftOut {
    /// Sums of each.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            by_class: self.by_class + other.by_class,
            withheld: self.withheld + other.withheld,
            strays: self.strays + other.strays,
        }
    }

    /// All points.
    #[must_use]
    pub fn total(self) -> u64 {
        self.by_class + self.withheld + self.strays
    }
}

/// A stream of surfels in a fixed order: reading it again from the start gives the same surfels.
pub trait SurfelSource: Send {
    /// World position of the surfels' coordinate origin.
    fn origin(&self) -> DVec3 {
        DVec3::ZERO
    }

    /// Box of all centers, where known before reading.
    fn bounds(&self) -> Option<Aabb> {
        None
    }

    /// Box of all centers, found by reading the positions once more where it is not known and the source can be read twice;
    /// `None` where it cannot. The next chunk stays the same.
    ///
    /// # Errors
    ///
    /// If the cloud cannot be read.
    fn find_bounds(&mut self) -> Result<Option<Aabb>, CloudError> {
        Ok(self.bounds())
    }

    /// Number of surfels, where known before reading.
    fn count(&self) -> Option<u64> {
        None
    }

    /// Records dropped so far because they hold no valid surfel.
    fn skipped(&self) -> u64 {
        0
    }

    /// Points left out so far.
    fn left_out(&self) -> LeftOut {
        LeftOut::default()
    }

    /// What of the file was left out or read differently than it says, so far, one sentence each that names the file.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    /// Appends the next surfels to `out`, at most a few thousand; `false` when there are no more.
    /// Every surfel is valid: finite, radius and area above 0, or both 0 where the cloud has
    /// neither and they are to be estimated from the neighborhood.
    ///
    /// # Errors
    ///
    /// If the cloud cannot be read on.
    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError>;
}

/// Surfels in memory as a stream.
pub struct SliceSource<'a> {
    surfels: &'a [Surfel],
    next: usize,
}

impl<'a> SliceSource<'a> {
    /// A stream over `surfels`.
    #[must_use]
    pub fn new(surfels: &'a [Surfel]) -> Self {
        Self { surfels, next: 0 }
    }
}

impl SurfelSource for SliceSource<'_> {
    fn bounds(&self) -> Option<Aabb> {
        Some(Aabb::from_points(self.surfels.iter().map(|s| Vec3::from_array(s.position))))
    }

    fn count(&self) -> Option<u64> {
        Some(self.surfels.len() as u64)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let end = (self.next + CHUNK_SURFELS).min(self.surfels.len());
        out.extend_from_slice(&self.surfels[self.next..end]);
        self.next = end;
        Ok(end < self.surfels.len())
    }
}
