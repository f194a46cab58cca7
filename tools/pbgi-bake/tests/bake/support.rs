//! Running the tool, and clouds to feed it.

use std::fmt::Write;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A folder with input files, in which the tool runs.
pub struct Bench {
    folder: tempfile::TempDir,
}

/// What a run of the tool left.
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Bench {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), bytes).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap()
    }

    /// Names of all files in the folder, hidden ones too.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<String> =
            entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pbgi-bake"));
        command.current_dir(self.folder.path()).args(args);
        command
    }

    pub fn run(&self, args: &[&str]) -> Run {
        self.command(args).stdin(Stdio::null()).output().unwrap().into()
    }

    pub fn run_with_input(&self, args: &[&str], input: &[u8]) -> Run {
        let mut command = self.command(args);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        // The tool may refuse before it has read everything.
        let _ = child.stdin.take().unwrap().write_all(input);
        child.wait_with_output().unwrap().into()
    }

    /// Runs the tool, which must succeed, and checks every invariant of the file it wrote.
    pub fn bake(&self, args: &[&str], output: &str) -> pbgi::OctreeInfo {
        let run = self.run(args);
        assert_eq!(run.code, 0, "{args:?}: {}", run.stderr);
        self.check(output)
    }

    pub fn check(&self, output: &str) -> pbgi::OctreeInfo {
        pbgi::OctreeCheck::read(&self.path(output), pbgi::Backend::Read, 2, 1 << 30, |_| {})
            .unwrap();
        pbgi::OctreeInfo::read(&self.path(output), 1 << 30).unwrap()
    }
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }
}

/// Shared test data, or none, with a notice, if it is not there.
pub fn shared(name: &str) -> Option<String> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(name);
    if path.exists() {
        return path.to_str().map(str::to_owned);
    }
    println!("skipped: {} is not there", path.display());
    None
}

/// Positions and normals on a unit sphere, on a spiral.
pub fn sphere(count: usize) -> Vec<[f32; 3]> {
    (0..count)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / count as f32;
            let (sin, cos) = (2.399_963_2 * i as f32).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            [radius * cos, radius * sin, z]
        })
        .collect()
}

const COLUMNS: [&str; 10] =
    ["x", "y", "z", "nx", "ny", "nz", "radius", "radiance_r", "radiance_g", "radiance_b"];

/// How a PLY file is written.
#[derive(Clone, Copy)]
pub enum Ply {
    Ascii,
    Little,
    Big,
}

/// A sphere of disks with normals and sizes as PLY.
pub fn ply_sphere(count: usize, format: Ply) -> Vec<u8> {
    let radius = (8.0 / count as f32).sqrt();
    let rows =
        sphere(count).into_iter().map(|[x, y, z]| [x, y, z, x, y, z, radius, 1.0 + z, 1.0, 0.5]);
    ply(&COLUMNS, rows.flatten().collect(), format)
}

/// A PLY file of float columns; `values` row after row.
pub fn ply(columns: &[&str], values: Vec<f32>, format: Ply) -> Vec<u8> {
    let name = match format {
        Ply::Ascii => "ascii",
        Ply::Little => "binary_little_endian",
        Ply::Big => "binary_big_endian",
    };
    let count = values.len() / columns.len();
    let mut header = format!("ply\nformat {name} 1.0\nelement vertex {count}\n");
    for column in columns {
        writeln!(header, "property float {column}").unwrap();
    }
    header.push_str("end_header\n");
    let mut bytes = header.into_bytes();
    for row in values.chunks(columns.len()) {
        match format {
            Ply::Ascii => {
                let texts: Vec<String> = row.iter().map(f32::to_string).collect();
                bytes.extend_from_slice(format!("{}\n", texts.join(" ")).as_bytes());
            }
            Ply::Little => bytes.extend(row.iter().flat_map(|v| v.to_le_bytes())),
            Ply::Big => bytes.extend(row.iter().flat_map(|v| v.to_be_bytes())),
        }
    }
    bytes
}
