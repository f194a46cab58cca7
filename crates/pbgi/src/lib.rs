//! Point-based global illumination for clouds larger than memory: the facade most programs need.
//!
//! [`bake`] turns meshes and point clouds into one octree file of lit surfels. Everything the tools
//! use is re-exported here, so that a program needs this crate only. The facade joins the engine's crates and adds
//! what programs share: errors with exit codes, progress, limits. It must never contain an algorithm
//! of the engine itself.
#![forbid(unsafe_code)]

pub mod cli;
mod error;
mod memory;
mod camera_choice;
mod check;
mod frame;
mod memory_split;
mod output;
mod points;
mod shade;
mod splat;
mod progress;

pub use error::PbgiError;
pub use memory::{peak_resident_bytes, resident_bytes};
pub use progress::{Phase, Progress, ProgressMode, Verbosity};
pub use camera_choice::CameraChoice;
pub use check::CheckReport;
pub use frame::{FRAME_AOVS, Frame, FrameRequest, shade_frame};
pub use memory_split::MemorySplit;
pub use output::{check_writable, refuse_to_overwrite};
pub use points::{PointSource, PointsRequest, shade_points};
pub use shade::{CacheReport, EnvironmentSpec, LightSource, ShadeReport, ShadeSettings};
