//! The baking tool from its command line to its files and exit codes.
#![allow(missing_docs, reason = "tests are named by what they claim")]

mod errors;
mod formats;
mod invariance;
mod kill;
mod promises;
mod relight;
mod support;
