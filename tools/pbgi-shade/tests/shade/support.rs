//! A small octree file, and the tool to run on it.

use pbgi::{BakeRequest, EnvironmentSpec, LightRequest, LightSource, Progress, Sampling, bake};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

/// The scene of all tests: spheres and boxes on a plane.
pub const SCENE: &str = "demo:spheres?size=6";

/// Bakes `input` into `target`.
pub fn bake_to(input: &str, surfels: u64, target: &Path) {
    bake_in_light(input, surfels, LightRequest::default(), target);
}

/// Bakes [`SCENE`] into `target` under a white sky.
pub fn bake_lit(target: &Path) {
    let source = LightSource::Uniform([1.0; 3]);
    let environment = Some(EnvironmentSpec { source, rotate_degrees: 0.0, scale: 1.0 });
    bake_in_light(SCENE, 3000, LightRequest { environment, ..LightRequest::default() }, target);
}

fn bake_in_light(input: &str, surfels: u64, light: LightRequest, target: &Path) {
    let request = BakeRequest {
        light,
        inputs: vec![input.to_owned()],
        output: target.to_owned(),
        sampling: Sampling::Surfels(surfels),
        page_bytes: 4096,
        threads: 1,
        ..BakeRequest::default()
    };
    bake(&request, &Progress::silent(), &AtomicBool::new(false)).unwrap();
}

/// The octree of [`SCENE`], baked once for all tests.
pub fn octree() -> PathBuf {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        bake_to(SCENE, 3000, &folder.path().join("scene.pbgi"));
        folder
    });
    folder.path().join("scene.pbgi")
}

/// Runs the tool.
pub fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pbgi-shade")).args(arguments).output().unwrap()
}

/// Runs the tool, which must succeed, and returns its standard output.
pub fn shade(arguments: &[&str]) -> String {
    let output = run(arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

/// Runs the tool, which must fail with `code`; returns what it says.
pub fn fail(code: i32, arguments: &[&str]) -> String {
    let output = run(arguments);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    stderr
}

/// A path as text.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
