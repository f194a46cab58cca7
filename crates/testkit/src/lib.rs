//! Oracles and scenes for tests: brute force, shared with nothing it judges but `math` and `cloud`.
//!
//! A dev-dependency only, never published.
#![forbid(unsafe_code)]

pub mod hard;
mod oracle;
mod scenes;
mod sorted;

pub use oracle::{OracleResult, ray_cast_gather};
pub use scenes::{SurfelForm, closed_room, random_objects, sphere_directions};
pub use sorted::{sort_in_memory, summarize};
