//! Receivers to coherent batches to workers to results.
//!
//! Joins the cut, the raster, the light and the BRDF, and is, with the sort, the only crate that starts threads. It must never know where
//! receivers come from or what becomes of the results.
#![forbid(unsafe_code)]

mod drawing;
mod gather;
mod importance;
mod lamps;
mod light;
mod queue;
mod receiver;
mod reflect;
mod shade;
mod spread;

pub use gather::{GatherParts, GatherSettings, Gatherer};
pub use importance::ImportanceTerms;
pub use light::PreparedLight;
pub use pbgi_brdf::Material;
pub use pbgi_cut::{CutStats, LevelStats};
pub use pbgi_raster::SimdLevel;
pub use receiver::{Gloss, Receiver, Shading};
pub use shade::{
    CHUNKS_IN_FLIGHT, Feed, RECEIVER_BYTES_IN_FLIGHT, ReceiverOrder, ScheduleError, ShadeOptions,
    ShadeReport, Shaded, shade_receivers, shade_stream,
};
pub use spread::Spread;
