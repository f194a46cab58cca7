//! Readers of scene files: glTF, OBJ and PLY meshes with their materials, textures, cameras and lights.
//!
//! This crate must never know what scenes are used for.
#![forbid(unsafe_code)]

mod decode_texture;
mod error;
mod find_file;
mod origin;
mod polygon;
mod read_gltf;
mod read_obj;
mod read_ply_mesh;
mod read_scene;
mod resources;

pub use error::SceneError;
pub use read_scene::{read_scene, read_scene_within};
