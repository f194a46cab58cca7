//! The shading tool from its command line to its files and exit codes.
#![allow(missing_docs, reason = "tests are named by what they claim")]

mod errors;
mod frames;
mod gbuffers;
mod outputs;
mod points;
mod support;
