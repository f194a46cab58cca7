//! Reflection models and their convolution with a cube raster.
//!
//! Sums over texels with exact texel integrals. It must never know how the raster was filled.
#![forbid(unsafe_code)]

mod diffuse;

pub use diffuse::{ConvolutionTable, Diffuse, EnvironmentTexels, convolve_diffuse};
