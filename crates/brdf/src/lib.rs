//! Reflection models and their convolution with a cube raster.
//!
//! Sums over texels with exact texel integrals. It must never know how the raster was filled.
#![forbid(unsafe_code)]

mod albedo;
mod differential;
mod diffuse;
mod ggx;
mod material;
mod obstacles;

pub use differential::{Differential, Differentiator, LIGHT, OCCLUSION, QUANTITIES, SKY};
pub use diffuse::{ConvolutionTable, Diffuse, EnvironmentTexels, convolve_diffuse};
pub use ggx::{GgxLobe, LobeDirections, LobePattern};
pub use material::Material;
pub use obstacles::Obstacles;
