//! What `--stats-json` writes is what docs/stats.schema.json says.

use crate::schema::faults_of;
use crate::support::{octree, succeed_in};
use serde_json::Value;
use std::path::Path;

fn schema() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/stats.schema.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Runs a command and compares the statistics it prints with a definition of the schema.
fn check(folder: &Path, definition: &str, arguments: &[&str]) -> Value {
    let run = succeed_in(folder, &[arguments, &["--stats-json", "-"]].concat());
    let value: Value = serde_json::from_str(&run.stdout).unwrap();
    let root = schema();
    let faults = faults_of(&value, &root["$defs"][definition], &root, "$");
    assert!(faults.is_empty(), "{arguments:?}: {faults:#?}");
    let faults = faults_of(&value, &root, &root, "$");
    assert!(faults.is_empty(), "{arguments:?}: {faults:#?}");
    value
}

#[test]
fn statistics_conform_to_the_schema() {
    let folder = tempfile::tempdir().unwrap();
    let octree = octree();
    let octree = octree.to_str().unwrap();
    let lit = ["bake", "demo:cornell", "-o", "c.pbgi", "--surfels", "2k", "--bounces", "1", "-q"];
    let report = check(folder.path(), "BakeReport", &lit);
    assert!(report["phases"].as_array().unwrap().iter().any(|phase| phase["bounce"] == 1));
    let picture = ["shade", "c.pbgi", "--scene", "demo:cornell", "--resolution", "16x9", "-q"];
    let measured = ["-o", "a.exr", "--check", "10", "--roughness", "0.3", "--quality", "draft"];
    let report = check(folder.path(), "ShadeReport", &[&picture[..], &measured].concat());
    assert!(report["check"]["gloss"].is_object() && report["target"].is_object());
    let plain = ["shade", octree, "--surfels", "-o", "a.ply", "--env-color", "1,1,1", "-q"];
    let report = check(folder.path(), "ShadeReport", &plain);
    assert!(report["check"].is_null() && report["target"].is_null());
}
