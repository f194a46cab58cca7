//! The program `pbgi` from its command line to its exit codes, files and words.
#![allow(missing_docs, reason = "tests are named by what they claim")]

mod manual;
mod mistakes;
mod schema;
mod statistics;
mod support;
mod versions;
