//! Light that falls on surfels: irradiance of each, and who shares a gather with whom.
//!
//! It must never know how surfels are sorted, streamed or stored, or what becomes of their light.
#![forbid(unsafe_code)]

mod irradiance;
mod share;

pub use irradiance::{SurfelLight, light_on_surfels};
pub use share::{Shared, cell_len};
