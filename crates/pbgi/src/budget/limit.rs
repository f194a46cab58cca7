//! The smallest memory limit.

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
