//! Undefined behavior: tests under Miri and under sanitizers, by the nightly toolchain.

use crate::workspace::{Workspace, host_triple, succeed_shown};

/// Crates whose tests Miri runs: what is computed with, what bytes of a file become, and pages in memory.
const INTERPRETED: [&str; 3] = ["pbgi-math", "pbgi-format", "pbgi-store"];

/// Crates whose tests run under a sanitizer: those with unsafe code, and those that run them on many threads.
const SANITIZED: [&str; 6] =
    ["pbgi-format", "pbgi-store", "pbgi-raster", "pbgi-cut", "pbgi-sort", "pbgi-tests"];

/// Runs unit tests under Miri, those of all crates or those whose names contain one of these. Needs Miri and the library's sources.
pub fn miri(workspace: &Workspace, filters: &[&str]) -> Result<(), String> {
    let mut cargo = workspace.nightly_cargo();
    cargo.args(["miri", "test", "--lib"]).args(INTERPRETED.map(|name| format!("--package={name}")));
    cargo.arg("--").args(filters);
    // Files are read and written; each test sees those of its own folder.
    cargo.env("MIRIFLAGS", "-Zmiri-disable-isolation");
    cargo.env("CARGO_TARGET_DIR", workspace.target().join("miri"));
    succeed_shown(&mut cargo)
}

/// Runs tests under a sanitizer, `address` or `thread`. Needs the library's sources, as it is built anew.
pub fn sanitize(workspace: &Workspace, sanitizer: &str) -> Result<(), String> {
    if !["address", "thread"].contains(&sanitizer) {
        return Err(format!("`{sanitizer}` is no sanitizer; there are address and thread"));
    }
    let mut cargo = workspace.nightly_cargo();
    cargo.args(["test", "--release", "-Zbuild-std", "--target", &host_triple()?]);
    cargo.args(["--lib", "--tests"]).args(SANITIZED.map(|name| format!("--package={name}")));
    cargo.arg("--no-fail-fast").env("RUSTFLAGS", format!("-Zsanitizer={sanitizer}"));
    // The decoder of LAZ tells its depth by places on the real stack.
    cargo.env("ASAN_OPTIONS", "detect_stack_use_after_return=0");
    cargo.env("CARGO_TARGET_DIR", workspace.target().join(sanitizer));
    succeed_shown(&mut cargo)
}
