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
    /// It ends with this code.
    Code(i32),
    /// The numbers before this unit that it says on standard error, or where there are none, at all, as many as there are bounds, are at
    /// most these.
    AtMost { unit: &'static str, bounds: &'static [f64] },
    /// All pairs `a,b` that it says: the first within a share, the second within a difference.
    Pairs { expected: &'static [[f64; 2]], relative: f64, absolute: f64 },
    /// What follows each `begins`, up to the next, says one of these.
    EachSays { begins: &'static str, any: &'static [&'static str] },
    /// A shell script that is run behind it prints this.
    Prints { script: &'static str, expected: &'static str },
}

use Check::{
    Areas, AtMost, Code, Column, EachSays, Holds, Largest, Never, Pairs, Prints, Says, Values,
};

/// KiB.
const MIB: f64 = 1024.0;

/// Least and largest sum of RenderMan's `occlusion` and of the openness of the same picture.
const OCCLUSION: &str = r#"
pbgi-shade out.pbgi --scene corner.obj --camera-position 0,1,4 --camera-target 0,0.5,0 --resolution 32x32 --env-color 1,1,1 -o open.exr -q
python3 -c '
import OpenEXR
read = lambda name: OpenEXR.File(name, separate_channels=True).channels()
covered, opened = read("out.exr"), read("open.exr")
seen = opened["A"].pixels > 0.999
both = (covered["occlusion"].pixels + opened["AO"].pixels)[seen]
print("%.4f %.4f" % (both.min(), both.max()))'
"#;

/// The picture of `picture-of-4k` within a small limit, against the one in memory, which the case has left.
const PICTURE_OF_4K: &str = r#"
peak=$(/usr/bin/time -f %M pbgi-shade room.pbgi --env-color 1,1,1 --resolution 3840x2160 --samples 1 --shading-rate 256 --solid-angle 3 --raster 2 -o small.exr -q --memory-limit 256MiB 2>&1 | tail -1)
if [ "$peak" -le 262144 ]; then printf 'within 256 MiB, '; fi
if cmp a.exr small.exr; then echo same; fi"#;

/// π/(1 + h²) and 1 − 1/(1 + h²) for the heights of `facing-surfel`, each of a disk and of a square.
const FACING: [[f64; 2]; 10] = [
    [PI, 1e-6],
    [PI, 1e-6],
    [3.1413, 1e-4],
    [3.1413, 1e-4],
    [3.1341, 0.0024],
    [3.1341, 0.0024],
    [3.1334, 0.0026],
    [3.1334, 0.0026],
    [3.1105, 0.0099],
    [3.1105, 0.0099],
];

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
        "big-environment" => {
            let bounds = &[64.0 * MIB, 256.0 * MIB, 512.0 * MIB, 256.0 * MIB];
            vec![AtMost { unit: "KiB", bounds }]
        }
        "facing-surfel" => {
            vec![Pairs { expected: &FACING, relative: 0.01, absolute: 0.01 }]
        }
        "gltf-too-many-instances" => vec![
            AtMost { unit: "KiB", bounds: &[80.0 * MIB; 2] },
            AtMost { unit: "s", bounds: &[10.0; 2] },
            Never("Aborted"),
        ],
        "library-read-again" => vec![
            AtMost { unit: "KiB", bounds: &[80.0 * MIB] },
            AtMost { unit: "s", bounds: &[20.0] },
            Holds { file: "o.pbgi", text: "PBGITREE" },
        ],
        "textures-in-sum" => vec![
            AtMost { unit: "KiB", bounds: &[80.0 * MIB] },
            AtMost { unit: "s", bounds: &[20.0] },
        ],
        "limit-above-memory" => vec![Says("surfels 2")],
        "linked-temporary" => vec![Code(0), Says("precious; out.pbgi is a regular file")],
        "many-at-one-place" => vec![
            AtMost { unit: "s", bounds: &[3.0; 3] },
            AtMost { unit: "KiB", bounds: &[256.0 * MIB; 3] },
            Values { file: "o.csv", column: "irradiance_r", expected: &[0.2 * PI] },
            Values { file: "o.csv", column: "ao", expected: &[0.8] },
        ],
        "map-exceeds-limit" => {
            vec![AtMost { unit: "KiB", bounds: &[64.0 * MIB; 2] }, Says("read:"), Says("map:")]
        }
        "octree-link-graph" => {
            vec![Says("verify 3 shade 3 points 3 verify 3 shade 3 points 3")]
        }
        "octree-sparse-table" => vec![
            AtMost { unit: "KiB", bounds: &[64.0 * MIB; 2] },
            EachSays { begins: "non-zero status ", any: &["3", "4"] },
        ],
        "output-is-device" => vec![Code(0), Says("to a null device: exit")],
        "output-is-input" => {
            vec![Code(0), Says("0 inputs lost"), Never("instead of 2"), Never("one is lost")]
        }
        // Made within the default limit, and within 256 MiB, too; with 2334 MiB it stays in memory.
        "picture-of-4k" => vec![
            Code(0),
            Never("a memory limit of"),
            AtMost { unit: "KiB", bounds: &[1150.0 * MIB] },
            Prints { script: PICTURE_OF_4K, expected: "within 256 MiB, same" },
        ],
        "renderman-occlusion" => vec![Prints { script: OCCLUSION, expected: "1.0000 1.0000" }],
        "resume-with-changed-library" => vec![Code(0), Says("as a fresh bake")],
        // The same, or refused: never NaN, never other without a word.
        "scale-extremes" => vec![
            EachSays { begins: ": exit ", any: &["0, 0 rows with NaN, same", "3, "] },
            Says("2^28: exit 0, 0 rows with NaN, same"),
        ],
        "stderr-closed" => vec![
            Says("closed: 3 (expected 3)"),
            Says("full: 3 (expected 3)"),
            Says("closed: 0 (expected 0), 3 frames"),
        ],
        "two-resumed-bakes" => {
            vec![Says("another bake works on this output"), Says("first: exit 0")]
        }
        "uri-devices" => vec![
            AtMost { unit: "s", bounds: &[2.0; 8] },
            AtMost { unit: "KiB", bounds: &[80.0 * MIB; 8] },
        ],
        "verified-but-nan" => vec![Says("3 3 pbgi info")],
        _ => vec![],
    }
}
