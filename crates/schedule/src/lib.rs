//! Receivers to coherent batches to workers to results.
//!
//! Joins the cut, the raster, the light and the BRDF, and is, with the sort, the only crate that starts threads. It must never know where
//! receivers come from or what becomes of the results.
#![forbid(unsafe_code)]

mod gather;
mod light;
mod receiver;
mod shade;

pub use gather::{GatherParts, GatherSettings, Gatherer};
pub use light::PreparedLight;
pub use receiver::{Receiver, Shading};
pub use shade::{ScheduleError, ShadeOptions, ShadeReport, shade_receivers};
