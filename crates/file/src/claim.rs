//! One run at a time for an output.

use crate::folder_of;
use crate::temporary::{Lock, create_beside, remove_left, try_lock};
use std::fs::File;
use std::io;
use std::path::Path;
use std::time::Duration;
use tempfile::NamedTempFile;

/// That this run alone makes an output, until it is dropped or the process ends, however it does.
pub struct Claim {
    _mark: NamedTempFile,
}

/// Why an output could not be claimed.
#[derive(Debug)]
pub enum ClaimError {
    /// Another run has it.
    Busy,
    /// Its folder cannot be written.
    Io(io::Error),
}

/// How often, and how far apart, a folder that another run is just looking through is tried.
const TRIES: u32 = 100;
const BETWEEN_TRIES: Duration = Duration::from_millis(10);

impl Claim {
    /// Claims `target`, whose folder exists, at once or not at all.
    ///
    /// # Errors
    ///
    /// [`ClaimError::Busy`] while another run has claimed it or writes it.
    pub fn take(target: &Path) -> Result<Self, ClaimError> {
        // Two runs that start at once must not both find nobody; where folders have no locks, they may.
        let folder = File::open(folder_of(target)).ok();
        for _ in 0..TRIES {
            match folder.as_ref().map(try_lock) {
                Some(Lock::Held) => std::thread::sleep(BETWEEN_TRIES),
                _ => break,
            }
        }
        if remove_left(target).map_err(ClaimError::Io)? {
            return Err(ClaimError::Busy);
        }
        create_beside(target).map(|mark| Self { _mark: mark }).map_err(ClaimError::Io)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AtomicFile;

    #[test]
    fn an_output_has_one_claim_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let claim = Claim::take(&path("a")).unwrap();
        assert!(matches!(Claim::take(&path("a")), Err(ClaimError::Busy)));
        let _other = Claim::take(&path("b")).unwrap();
        // The run that has claimed it writes it.
        AtomicFile::create(&path("a")).unwrap().commit().unwrap();
        drop(claim);
        Claim::take(&path("a")).unwrap();
    }

    #[test]
    fn of_many_that_start_at_once_one_has_the_claim() {
        let folder = tempfile::tempdir().unwrap();
        for round in 0..20 {
            let path = folder.path().join(format!("a{round}"));
            let claims: Vec<_> = std::thread::scope(|scope| {
                let threads: Vec<_> = (0..8).map(|_| scope.spawn(|| Claim::take(&path))).collect();
                threads.into_iter().map(|thread| thread.join().unwrap()).collect()
            });
            assert_eq!(claims.iter().filter(|claim| claim.is_ok()).count(), 1, "round {round}");
        }
    }
}
