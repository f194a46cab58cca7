//! The distant environment: its radiance, its cube map, and the small bright lights in it.
//!
//! A bright lamp or the sun does not fit into a cube map of a few texels per face: it is taken out as
//! an [`EnvironmentPeak`], a narrow window with texels of its own, and what is left is smooth enough
//! for the map. This crate must never know what a node, a surfel or a BRDF is.
#![forbid(unsafe_code)]

mod base;
mod environment;
mod extract;
mod lat_long;
mod peak;
mod pyramid;
mod sky;
#[cfg(test)]
mod test_images;
mod window;

pub use environment::{Environment, EnvironmentError, EnvironmentOptions, UpAxis};
pub use peak::EnvironmentPeak;
pub use pyramid::{EnvironmentPyramid, Variation};
pub use sky::{SkyParameters, synthetic_sky};
