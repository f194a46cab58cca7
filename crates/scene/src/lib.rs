//! Meshes, materials and cameras: what surfels and receivers are made from.
//!
//! Reads scene files, dices meshes into micropolygons (one surfel each), hides what the camera does not see.
//! This crate must never know how surfels are stored or how light is gathered.
#![forbid(unsafe_code)]

mod error;
mod model;
mod texture;

pub use error::SceneError;
pub use model::{Camera, Instance, Material, Mesh, Scene};
pub use texture::Texture;
