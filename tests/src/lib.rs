//! Whole-pipeline suites.
