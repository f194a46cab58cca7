//! What a receiver receives.
//!
//! Joins the cut, the raster, the light and the BRDF. It must never start a thread, nor know where receivers come from or what becomes of the
//! results.
#![forbid(unsafe_code)]

mod importance;
mod integrator;
mod lamps;
mod light;
mod primitive;
mod receiver;
mod record;
mod reflect;
mod visitors;
mod windows;

pub use importance::ImportanceTerms;
pub use integrator::{
    GatherParts, GatherSettings, Gatherer, LOBE_LEVEL_MAX, gatherer_bytes, lobe_directions,
    lobe_level,
};
pub use light::PreparedLight;
pub use pbgi_brdf::Material;
pub use pbgi_cut::{CutStats, KNOWN_BYTES, LevelStats};
pub use pbgi_raster::SimdLevel;
pub use receiver::{Gloss, Receiver, Shading};
pub use record::{Blend, Record, Tolerance};
