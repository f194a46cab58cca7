//! The smallest memory limit, and the threads a limit allows.

use crate::PbgiError;
use crate::figures::format_bytes;

/// Smallest memory limit a bake accepts.
pub const MEMORY_LIMIT_MIN: u64 = 64 << 20;

/// Refuses a memory limit below [`MEMORY_LIMIT_MIN`].
///
/// # Errors
///
/// [`PbgiError::Usage`], naming the smallest limit.
pub fn check_memory_limit(bytes: u64) -> Result<(), PbgiError> {
    if bytes >= MEMORY_LIMIT_MIN {
        return Ok(());
    }
    Err(PbgiError::usage(format!(
        "a memory limit of {} is too small; at least {} are needed (--memory-limit {}MiB)",
        format_bytes(bytes),
        format_bytes(MEMORY_LIMIT_MIN),
        MEMORY_LIMIT_MIN >> 20
    )))
}

/// Most threads per core.
const THREADS_PER_CORE: usize = 8;

/// Bytes of the memory limit there must be for each thread.
const THREAD_LIMIT_BYTES: u64 = 8 << 20;

/// Threads to start where so many are asked for, 0 being one per core; at least 1: at most a few per core, and so many that each has a small part
/// of the memory limit. More would change no result and gain nothing.
#[must_use]
pub fn thread_count(threads: usize, memory_limit: u64) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let affordable = usize::try_from(memory_limit / THREAD_LIMIT_BYTES).unwrap_or(1);
    match threads {
        0 => cores,
        threads => threads.min(THREADS_PER_CORE * cores).min(affordable).max(1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_too_small_name_what_is_needed() {
        let error = check_memory_limit(1 << 20).unwrap_err();
        assert_eq!(error.exit_code(), crate::EXIT_MISUSED);
        assert!(error.to_string().contains("--memory-limit 64MiB"), "{error}");
    }
}
