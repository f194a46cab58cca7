//! Files, read and written so that nothing of the user's is destroyed and nothing hangs.
//!
//! An output appears whole or not at all ([`AtomicFile`]); what a killed run has left beside it, the next one removes; one run at a time
//! claims an output ([`Claim`]). Inputs are regular files ([`open_input`]), told apart by what they are and not by their names
//! ([`FileId`]), and what they hold is counted against an [`Allowance`] of memory. Files that outlive a run for the next one have names that nobody can foretell ([`KeptFiles`]). What decoders of other crates do to damaged
//! files becomes an error ([`catch_decoder_panic`]). This crate must never know
//! what is in a file.
#![forbid(unsafe_code)]

mod allowance;
mod atomic;
mod claim;
mod decoder_panic;
mod id;
mod input;
mod kept;
pub mod platform;
mod temporary;

pub use allowance::{Allowance, Excess};
pub use atomic::{AtomicFile, StepError};
pub use claim::{Claim, ClaimError};
pub use decoder_panic::{catch_decoder_panic, hush_decoder_panics};
pub use id::{FileId, FileState};
pub use input::{kind_name, open_input, read_input};
pub use kept::{KeptFiles, create_new, open_kept};

use std::path::Path;

/// The folder a file lies in.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}
