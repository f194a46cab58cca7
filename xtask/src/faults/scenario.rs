//! What programs do while something fails.

/// A run of a program.
pub struct Scenario {
    pub name: &'static str,
    /// Its arguments, without `--force`.
    pub args: &'static [&'static str],
    /// Files that it writes.
    pub outputs: &'static [&'static str],
    /// Whether a run that fails keeps files for the next one.
    pub keeps: bool,
    /// Whether it takes a second and more.
    pub is_long: bool,
}

/// Makes the inputs of all scenarios, in this order.
pub const PREPARATION: [&[&str]; 2] = [
    &["bake", "demo:room?surfels=600", "-o", "room.pbgi", "-q"],
    &["info", "room.pbgi", "--points", "cloud.ply", "-q"],
];

/// Files that must stay as they are.
pub const INPUTS: [&str; 3] = ["room.pbgi", "cloud.ply", "sky.hdr"];

pub const SCENARIOS: [Scenario; 7] = [
    Scenario {
        name: "bake of a cloud",
        args: &["bake", "cloud.ply", "-o", "out.pbgi", "--stats-json", "out.json"],
        outputs: &["out.pbgi", "out.json"],
        keeps: false,
        is_long: false,
    },
    Scenario {
        name: "bake by way of the disk",
        args: &["bake", "demo:street?surfels=450k", "-o", "out.pbgi", "--memory-limit", "64MiB"],
        outputs: &["out.pbgi"],
        keeps: false,
        is_long: true,
    },
    Scenario {
        name: "bake with light, to be resumed",
        args: &[
            "bake",
            "cloud.ply",
            "-o",
            "out.pbgi",
            "--env",
            "sky.hdr",
            "--bounces",
            "1",
            "--resume",
        ],
        outputs: &["out.pbgi"],
        keeps: true,
        is_long: false,
    },
    Scenario {
        name: "shade of a picture",
        args: &[
            "shade",
            "room.pbgi",
            "--scene",
            "demo:room",
            "--env",
            "sky.hdr",
            "-o",
            "out.exr",
            "--preview",
            "out.png",
            "--contact-sheet",
            "sheet.png",
            "--stats-json",
            "out.json",
            "--resolution",
            "48x27",
        ],
        outputs: &["out.exr", "out.png", "sheet.png", "out.json"],
        keeps: false,
        is_long: false,
    },
    Scenario {
        name: "shade of points",
        args: &["shade", "room.pbgi", "--receivers", "cloud.ply", "-o", "out.ply"],
        outputs: &["out.ply"],
        keeps: false,
        is_long: false,
    },
    Scenario {
        name: "shade of surfels",
        args: &["shade", "room.pbgi", "--surfels", "-o", "out.csv", "--trace-pages", "out.trace"],
        outputs: &["out.csv", "out.trace"],
        keeps: false,
        is_long: false,
    },
    Scenario {
        name: "info with points",
        args: &["info", "room.pbgi", "--verify", "--points", "out.ply"],
        outputs: &["out.ply"],
        keeps: false,
        is_long: false,
    },
];
