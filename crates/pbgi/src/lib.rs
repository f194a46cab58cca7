//! Point-based global illumination for clouds larger than memory: the facade most programs need.
//!
//! [`bake`] turns meshes and point clouds into one octree file of lit surfels. Everything the tools
//! use is re-exported here, so that a program needs this crate only. The facade joins the engine's crates and adds
//! what programs share: errors with exit codes, progress, limits. It must never contain an algorithm
//! of the engine itself.
#![forbid(unsafe_code)]

mod bake;
mod budget;
mod error;
pub mod figures;
mod foreign;
mod frame;
mod gbuffer;
mod inspect;
mod output_path;
mod outputs;
mod points;
mod progress;
mod shade;

pub use bake::bake;
pub use bake::input::{
    DEFAULT_SURFELS, InputKind, Sampling, is_octree, load_scene, load_scene_within,
    starts_as_octree,
};
pub use bake::relight::{BOUNCES_MAX, LightRequest};
pub use bake::report::{BakeReport, BytesPerSurfel, PhaseReport};
pub use bake::request::{BakeRequest, NormalsChoice};
pub use budget::limit::{MEMORY_LIMIT_MIN, check_memory_limit, thread_count};
pub use budget::split::MemorySplit;
pub use error::{
    EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_MISUSED, EXIT_RESOURCES, PbgiError,
};
pub use frame::camera_choice::CameraChoice;
pub use frame::request::{FRAME_AOVS, FrameRequest};
pub use frame::{Frame, shade_frame};
pub use gbuffer::surfaces::GBufferSpace;
pub use gbuffer::{GBUFFER_AOVS, GBufferRequest, shade_gbuffer};
pub use inspect::{LevelInfo, OctreeCheck, OctreeInfo};
pub use output_path::check_suffix;
pub use outputs::{Output, OutputKind, RunFiles, check_writable, write_statistics};
pub use pbgi_cloud::{ClassFilter, CloudOptions, InvalidPolicy, PlyWriter};
pub use pbgi_file::hush_decoder_panics;
pub use pbgi_file::platform::{peak_resident_bytes, resident_bytes};
pub use pbgi_gather::{ImportanceTerms, Material, Shading};
pub use pbgi_image::{Aov, AovNames, AovPreset, write_environment_exr};
pub use pbgi_light::{SkyParameters, UpAxis, synthetic_sky};
pub use pbgi_math::DVec3;
pub use pbgi_procedural::{ProceduralScene, procedural_scene};
pub use pbgi_scene::{Scene, TwoSided};
pub use pbgi_store::Backend;
pub use points::export::export_points;
pub use points::in_memory::{Positions, ReceiversRequest, shade_receivers};
pub use points::{PointSource, PointsRequest, shade_points};
pub use progress::{Phase, Progress, ProgressEvent, ProgressMode, Verbosity};
pub use shade::check::{CheckReport, PartReport};
pub use shade::statistics::{CacheReport, CutReport, LevelReport};
pub use shade::target::TargetReport;
pub use shade::{
    EnvironmentPlacement, EnvironmentSpec, GlossSettings, LightSource, LoadedEnvironment,
    ShadeReport, ShadeSettings, StoreSettings,
};

/// The example of the README, which must compile.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
