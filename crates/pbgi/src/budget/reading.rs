//! What reading an input may take of the memory limit, judged by headers before anything is read.

use crate::PbgiError;
use crate::figures::format_bytes;
use pbgi_file::platform::resident_bytes;
use pbgi_file::{Allowance, Excess};
use std::error::Error;
use std::io;

/// What a program holds before it does anything, where the system does not tell.
const PROGRAM_BYTES: u64 = 24 << 20;

/// Left for small things.
const MARGIN_BYTES: u64 = 4 << 20;

/// Calls `read` with what the process does not hold yet of its memory limit.
///
/// # Errors
///
/// Those of `read`; where it takes too much, [`PbgiError::Budget`] with the limit that would do.
pub(crate) fn read_within<T, E: Into<PbgiError>>(
    memory_limit: u64,
    read: impl FnOnce(&Allowance) -> Result<T, E>,
) -> Result<T, PbgiError> {
    let held = resident_bytes().unwrap_or(PROGRAM_BYTES) + MARGIN_BYTES;
    let allowance = Allowance::new(memory_limit.saturating_sub(held));
    read(&allowance).map_err(|error| explain(error.into(), memory_limit, held))
}

/// An error of reading, as one of the budget if that is its cause.
fn explain(error: PbgiError, limit: u64, held: u64) -> PbgiError {
    let Some(Excess { needed, .. }) = excess_of(&error) else { return error };
    let total = held.saturating_add(needed);
    PbgiError::budget(format!(
        "{error}: a memory limit of {} does not hold it; at least {} are needed (--memory-limit {}MiB)",
        format_bytes(limit),
        format_bytes(total),
        total.div_ceil(1 << 20)
    ))
}

/// The excess at the end of the chain of causes.
pub(crate) fn excess_of(error: &PbgiError) -> Option<Excess> {
    let mut cause: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(excess) = error.downcast_ref::<io::Error>().and_then(Excess::of) {
            return Some(excess);
        }
        cause = error.source();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_names_the_limit_that_would_do() {
        let read = |bytes| {
            move |allowance: &Allowance| {
                allowance.take(bytes).map_err(|e| PbgiError::output("a".as_ref(), "read", e))
            }
        };
        let error = read_within(1 << 30, read(5 << 30)).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        let text = error.to_string();
        let needed = text.split("--memory-limit ").nth(1).unwrap().strip_suffix("MiB)").unwrap();
        // What a process holds changes from moment to moment.
        let needed = (needed.parse::<u64>().unwrap() << 20) + (64 << 20);
        assert!(needed > 5 << 30, "{text}");
        read_within(needed, read(5 << 30)).unwrap();
    }
}
