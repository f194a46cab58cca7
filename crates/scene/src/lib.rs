//! Meshes, materials, lights and cameras: what surfels and receivers are made from.
//!
//! Dices meshes into micropolygons (one surfel each), hides what the camera does not see.
//! This crate must never know where scenes come from, how surfels are stored or how light is gathered.
#![forbid(unsafe_code)]

mod camera;
mod dice;
mod hide;
mod light;
mod model;
mod texture;

pub use camera::{CameraView, Frustum};
pub use dice::{DiceError, DiceOptions, DicedScene, Spacing, TwoSided};
pub use hide::{
    Coverage, Disk, Fragment, HideError, HideOptions, Micropolygon, PixelWindow, VisibleSet,
    VisibleSurfels, hide, hide_disks,
};
pub use light::PunctualLight;
pub use model::{Camera, Instance, Material, Mesh, Scene};
pub use texture::{Texture, Wrap, display_to_linear, srgb_to_linear};
