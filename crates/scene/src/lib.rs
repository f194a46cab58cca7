//! Meshes, materials and cameras: what surfels and receivers are made from.
//!
//! Reads scene files, dices meshes into micropolygons (one surfel each), hides what the camera does not see.
//! This crate must never know how surfels are stored or how light is gathered.
#![forbid(unsafe_code)]

mod decode_texture;
mod dice;
mod error;
mod model;
mod read_gltf;
mod read_obj;
mod read_ply_mesh;
mod read_scene;
mod texture;

pub use dice::{DiceError, DiceOptions, DicedScene, Spacing, TwoSided};
pub use error::SceneError;
pub use model::{Camera, Instance, Material, Mesh, Scene};
pub use read_scene::read_scene;
pub use texture::Texture;
