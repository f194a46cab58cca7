//! The whole pipeline against oracles and closed forms.
#![allow(missing_docs, reason = "tests are named by what they claim")]

mod buried;
mod closed_forms;
mod cycles;
mod faults;
mod format_document;
mod invariances;
mod lamps;
mod leaks;
mod lights;
mod memory;
mod octree_file;
mod one_place;
mod own_surface;
mod records;
mod reflections;
mod schedule;
mod support;
mod walk;
