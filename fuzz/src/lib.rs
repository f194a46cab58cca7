//! What readers do with any bytes: a function per reader, which must return, soon and within its memory, whatever it is given.
//!
//! The same functions are searched for failures by a fuzzer (`cargo xtask fuzz`) and replayed over the seeds and past findings in
//! `seeds/` by an ordinary test. They take from the engine what its users take, and check besides what readers promise of what they let
//! through. It must never hold an algorithm of the engine.
#![deny(unsafe_code)]

mod memory;
mod mend;
mod shading;
mod targets;

use std::sync::{Mutex, OnceLock, PoisonError};

pub use memory::{LIVE_BYTES_MAX, peak_bytes};
pub use mend::mend_checksums;
pub use shading::{bake_octree, small_octree};

/// A reader with any bytes.
pub struct Target {
    /// Name on the command line, and of its folder of seeds.
    pub name: &'static str,
    /// Reads the bytes.
    pub run: fn(&[u8]),
    /// Most bytes of an input: enough for what the reader knows, and few enough to try many.
    pub bytes_max: usize,
}

/// All targets.
pub const TARGETS: [Target; 14] = [
    Target { name: "octree", run: targets::read_octree, bytes_max: 32 << 10 },
    Target { name: "ply_points", run: targets::read_ply_points, bytes_max: 4 << 10 },
    Target { name: "ply_mesh", run: targets::read_ply_mesh, bytes_max: 4 << 10 },
    Target { name: "las", run: targets::read_las, bytes_max: 8 << 10 },
    Target { name: "ptc", run: targets::read_ptc, bytes_max: 4 << 10 },
    Target { name: "raw", run: targets::read_raw, bytes_max: 4 << 10 },
    Target { name: "obj", run: targets::read_obj, bytes_max: 4 << 10 },
    Target { name: "gltf", run: targets::read_gltf, bytes_max: 8 << 10 },
    Target { name: "texture", run: targets::read_texture, bytes_max: 8 << 10 },
    Target { name: "exr", run: targets::read_exr, bytes_max: 8 << 10 },
    Target { name: "hdr", run: targets::read_hdr, bytes_max: 4 << 10 },
    Target { name: "gbuffer", run: shading::read_gbuffer, bytes_max: 8 << 10 },
    Target { name: "camera", run: shading::read_camera, bytes_max: 1 << 10 },
    Target { name: "shade", run: shading::shade_octree, bytes_max: 32 << 10 },
];

/// The target called `name`.
#[must_use]
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

/// Runs the target that the environment variable `PBGI_FUZZ_TARGET` names; ends the process where it panics.
///
/// # Panics
///
/// If the variable names no target.
pub fn run_chosen(data: &[u8]) {
    static CHOSEN: OnceLock<&Target> = OnceLock::new();
    static LAST_PANIC: Mutex<String> = Mutex::new(String::new());
    let last_panic = || LAST_PANIC.lock().unwrap_or_else(PoisonError::into_inner);
    let chosen = CHOSEN.get_or_init(|| {
        let name = std::env::var("PBGI_FUZZ_TARGET").unwrap_or_default();
        let names = TARGETS.map(|target| target.name).join(", ");
        let chosen = target(&name);
        let chosen = chosen
            .unwrap_or_else(|| panic!("PBGI_FUZZ_TARGET is `{name}`, expected one of {names}"));
        // The fuzzer's own hook ends the process at panics of decoders, too, which are caught and become errors.
        std::panic::set_hook(Box::new(move |info| *last_panic() = info.to_string()));
        chosen
    });
    if std::panic::catch_unwind(|| (chosen.run)(data)).is_err() {
        eprintln!("{}: {}", chosen.name, last_panic());
        std::process::abort();
    }
}
