//! What of the cases can be told from what the tools say and write.

use std::f64::consts::PI;

/// What must hold of a case.
#[derive(Clone, Copy)]
pub enum Check {
    /// It says this text, blanks taken as one.
    Says(&'static str),
    /// It never says this.
    Never(&'static str),
    /// The areas that `pbgi info` prints, in their order, within 2 %.
    Areas(&'static [f64]),
    /// The mean of a column of a file that it writes.
    Column { file: &'static str, column: &'static str, expected: f64, tolerance: f64 },
    /// All values of a column of a file that it writes, within 2 %.
    Values { file: &'static str, column: &'static str, expected: &'static [f64] },
    /// The row with the largest value of a column of a file that it writes.
    Largest { file: &'static str, column: &'static str, row: usize },
    /// A file that it writes holds this text.
    Holds { file: &'static str, text: &'static str },
}

use Check::{Areas, Column, Holds, Largest, Never, Says, Values};

fn albedo(column: &'static str, expected: f64) -> Check {
    Column { file: "surfels.ply", column, expected, tolerance: 0.01 }
}

fn lit(file: &'static str, expected: &'static [f64]) -> Check {
    Values { file, column: "irradiance_r", expected }
}

const AO_ABOUT_1: Check = Says("pbgi_ao");

/// The checks of a case; empty where none is known.
pub fn checks_of(case: &str) -> Vec<Check> {
    match case {
        "all-holes-never-end" => vec![Says("no surfels"), Says("Tr 1")],
        "concave-polygon-obj" => vec![Areas(&[3.0, 7.0])],
        "tristrips-ply" => vec![Areas(&[4.0])],
        "morph-mesh-weights" => vec![Says("bounds min -1 3 -1"), Says("bounds max 1 3 1")],
        "skin-node-transform" => vec![Says("bounds min -1 5 -1"), Says("bounds max 1 5 1")],
        "mask-by-vertex-alpha" => vec![Areas(&[4.0])],
        "gpu-instancing" => vec![Areas(&[12.0])],
        "gltf-glass-blocks" => vec![Says("material pane lets light through")],
        "env-cropped" => vec![lit("lit.csv", &[1.571, 0.0, 1.571, 0.0, 0.785, 0.785])],
        "env-chromaticities" => vec![lit("lit.csv", &[PI; 6]), lit("lit2.csv", &[PI; 6])],
        "env-orientation" => vec![
            Largest { file: "lit.csv", column: "irradiance_r", row: 4 },
            Largest { file: "lit2.csv", column: "irradiance_r", row: 0 },
        ],
        "env-layers" => vec![lit("lit.csv", &[PI; 6])],
        "hdr-exposure" => vec![lit("lit.csv", &[1.571; 6])],
        "hdr-rgbe-signature" => vec![lit("lit.csv", &[PI; 6])],
        "texture-clamp" => {
            vec![Column { file: "surfels.ply", column: "albedo_r", expected: 0.5, tolerance: 0.02 }]
        }
        "ply-mesh-color" => vec![albedo("albedo_r", 0.216)],
        "obj-vertex-colors" => vec![albedo("albedo_r", 0.214)],
        "mtl-d-and-tr" => vec![Areas(&[8.0])],
        "mtl-black-with-texture" => vec![albedo("albedo_r", 0.216), Says("Kd 0 0 0")],
        "mtl-mask" => vec![Areas(&[2.0])],
        "mtl-keywords" => vec![albedo("albedo_r", 0.216)],
        "mtllib-names" => vec![albedo("albedo_r", 1.0), albedo("albedo_g", 0.0)],
        "zero-normals" => vec![
            Column { file: "lit.ply", column: "ao", expected: 1.0, tolerance: 0.02 },
            Column { file: "lit.ply", column: "ny", expected: 1.0, tolerance: 0.01 },
        ],
        "las-zero-box" => vec![Areas(&[116.0])],
        "las-stray-point" => vec![Areas(&[156.0, 156.0]), Says("lie far away from all others")],
        "las-14-counts" => vec![Says("surfels 900")],
        "many-copies-of-points" => vec![Says("coincide")],
        "las-several-extra-records" | "las-undescribed-bytes" => vec![AO_ABOUT_1, Never("Error")],
        "table-column-types" => vec![Values {
            file: "lit.ply",
            column: "id",
            expected: &[16_777_217.0, 123_456_789.0, 2_000_000_001.0],
        }],
        "table-faces-lost" => vec![Holds { file: "lit.ply", text: "element face " }],
        "message-output-name" => vec![Says(".exr"), Says(".npy")],
        "gltf-animation-without-node"
        | "gltf-scene-without-nodes"
        | "gltf-texture-without-source"
        | "gltf-missing-texture-file"
        | "gltf-required-material-extension"
        | "obj-missing-texture-coordinates"
        | "obj-comment-behind-face"
        | "obj-byte-order-mark"
        | "ply-latin1-comment" => vec![Areas(&[4.0])],
        "ply-nan-spelling" => vec![Says("surfels 4")],
        "message-deep-exr" => vec![Says("--flatten")],
        "message-png-environment" => vec![Says("--colorconvert srgb linear"), Says("no sun")],
        "message-gltf-1" => vec![Says("glTF version 1.0 is not supported; convert it to glTF 2.0")],
        _ => vec![],
    }
}
