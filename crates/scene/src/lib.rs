//! Meshes, materials, lights and cameras: what surfels and receivers are made from.
//!
//! Reads scene files, dices meshes into micropolygons (one surfel each), hides what the camera does not see.
//! This crate must never know how surfels are stored or how light is gathered.
#![forbid(unsafe_code)]

mod camera;
mod decode_texture;
mod dice;
mod error;
mod find_file;
mod hide;
mod light;
mod model;
mod origin;
mod polygon;
mod procedural;
mod read_gltf;
mod read_obj;
mod read_ply_mesh;
mod read_scene;
mod resources;
mod texture;

pub use camera::{CameraView, Frustum};
pub use dice::{DiceError, DiceOptions, DicedScene, Spacing, TwoSided};
pub use error::SceneError;
pub use hide::{
    Coverage, Disk, Fragment, HideError, HideOptions, Micropolygon, PixelWindow, VisibleSet,
    VisibleSurfels, hide, hide_disks,
};
pub use light::PunctualLight;
pub use model::{Camera, Instance, Material, Mesh, Scene};
pub use procedural::{ProceduralError, ProceduralScene, ProceduralSpec, procedural_scene};
pub use read_scene::{read_scene, read_scene_within};
pub use texture::{Texture, Wrap};
