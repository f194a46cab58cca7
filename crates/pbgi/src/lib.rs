//! Point-based global illumination for clouds larger than memory: the facade most programs need.
//!
//! [`bake`] turns meshes and point clouds into one octree file of lit surfels. Everything the tools
//! use is re-exported here, so that a program needs this crate only. The facade joins the engine's crates and adds
//! what programs share: errors with exit codes, progress, limits. It must never contain an algorithm
//! of the engine itself.
#![forbid(unsafe_code)]

mod bake;
mod bake_memory;
mod bake_report;
mod bake_request;
mod band;
mod camera_choice;
mod camera_file;
mod check;
pub mod cli;
mod contact;
mod disk_space;
mod error;
mod export;
mod frame;
mod frame_request;
mod gbuffer;
mod gbuffer_surfaces;
mod input;
mod inspect;
mod interpolate;
mod memory;
mod memory_split;
mod octree_source;
mod output;
mod output_path;
mod pass_files;
mod point_results;
mod point_rows;
mod points;
mod progress;
mod relight;
mod scan;
mod scatter;
mod shade;
mod shade_statistics;
mod share;
mod splat;
mod table_receivers;
mod target;

pub use bake::bake;
pub use bake_report::{BakeReport, BytesPerSurfel, PhaseReport};
pub use bake_request::{BakeRequest, NormalsChoice};
pub use camera_choice::CameraChoice;
pub use check::{AloneReport, CheckReport};
pub use error::PbgiError;
pub use export::export_points;
pub use frame::{Frame, shade_frame};
pub use frame_request::{FRAME_AOVS, FrameRequest};
pub use gbuffer::{GBUFFER_AOVS, GBufferRequest, shade_gbuffer};
pub use gbuffer_surfaces::GBufferSpace;
pub use input::{DEFAULT_SURFELS, InputKind, Sampling, load_scene};
pub use inspect::{LevelInfo, OctreeCheck, OctreeInfo};
pub use memory::{peak_resident_bytes, resident_bytes};
pub use memory_split::MemorySplit;
pub use output::{check_writable, refuse_to_overwrite};
pub use output_path::check_suffix;
pub use pbgi_cloud::{ClassFilter, CloudOptions, InvalidPolicy, PlyWriter};
pub use pbgi_image::{Aov, AovNames, AovPreset, write_environment_exr};
pub use pbgi_light::{SkyParameters, UpAxis, synthetic_sky};
pub use pbgi_scene::{ProceduralScene, Scene, TwoSided, procedural_scene};
pub use pbgi_schedule::{ImportanceTerms, Material};
pub use pbgi_store::Backend;
pub use points::{PointSource, PointsRequest, shade_points};
pub use progress::{Phase, Progress, ProgressMode, Verbosity};
pub use relight::{BOUNCES_MAX, LightRequest};
pub use shade::{
    EnvironmentSpec, GlossSettings, LightSource, LoadedEnvironment, ShadeReport, ShadeSettings,
    StoreSettings,
};
pub use shade_statistics::{CacheReport, CutReport, LevelReport};
pub use target::TargetReport;

/// The example of the README, which must compile.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
