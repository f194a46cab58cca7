//! A folder to run programs in, and the library that makes their calls fail.

use super::scenario::{INPUTS, PREPARATION, Scenario};
use crate::workspace::{Workspace, succeed};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

const SHIM: &str = "xtask/src/faults/shim.c";

/// A program that takes longer hangs.
const SECONDS_MAX: u64 = 120;

/// Kinds of calls, and the size of what is written.
pub const KINDS: [&str; 6] = ["open", "read", "write", "sync", "rename", "full"];

/// What happens at a call.
pub struct Fault {
    pub kind: &'static str,
    pub at: u64,
    pub does: &'static str,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.kind, self.does) {
            ("full", _) => write!(f, "disk full after {} bytes", self.at),
            (kind, does) => write!(f, "{does} at {kind} {}", self.at),
        }
    }
}

/// What a run left.
pub struct Run {
    /// None where it was killed.
    pub code: Option<i32>,
    pub said: String,
}

/// The folder and the programs.
pub struct Bench {
    folder: PathBuf,
    program: PathBuf,
    shim: PathBuf,
}

impl Bench {
    /// Builds what is needed and makes the inputs.
    pub fn new(workspace: &Workspace) -> Result<Self, String> {
        let root = workspace.root();
        succeed(&mut workspace.build_program())?;
        let out = workspace.target().join("faults");
        // What another run has left.
        let _ = fs::remove_dir_all(&out);
        let folder = out.join("work");
        fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let shim = out.join("shim.so");
        let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
        cc.args(["-shared", "-fPIC", "-O1", "-Wall", "-o"]).arg(&shim).arg(root.join(SHIM));
        succeed(cc.arg("-ldl"))?;
        let bench = Self { folder, program: workspace.program(), shim };
        for args in PREPARATION {
            let run = bench.finish(bench.command(args).spawn(), args)?;
            if run.code != Some(0) {
                return Err(format!("pbgi {}: {}", args.join(" "), run.said));
            }
        }
        fs::write(bench.path("sky.hdr"), sky()).map_err(|e| format!("sky.hdr: {e}"))?;
        Ok(bench)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Names in the folder that are no inputs, sorted.
    pub fn others(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut names: Vec<String> =
            names.filter(|name| !INPUTS.contains(&name.as_str())).collect();
        names.sort();
        names
    }

    pub fn remove_others(&self) -> Result<(), String> {
        let remove =
            |name: String| fs::remove_file(self.path(&name)).map_err(|e| format!("{name}: {e}"));
        self.others().into_iter().try_for_each(remove)
    }

    pub fn inputs(&self) -> Vec<Option<Vec<u8>>> {
        INPUTS.iter().map(|name| fs::read(self.path(name)).ok()).collect()
    }

    /// The program, its errors at hand.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(args).current_dir(&self.folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    /// The program of a scenario on one thread, so that its calls come in one order, with a fault, if any.
    pub fn scenario(&self, scenario: &Scenario, fault: Option<&Fault>) -> Command {
        let mut command = self.command(scenario.args);
        command.args(["--force", "--threads", "1", "--progress", "none"]);
        command.env("LD_PRELOAD", &self.shim).env("PBGI_FAULT_FOLDER", &self.folder);
        if let Some(fault) = fault {
            command.env("PBGI_FAULT_KIND", fault.kind).env("PBGI_FAULT_DO", fault.does);
            command.env("PBGI_FAULT_AT", fault.at.to_string());
        }
        command
    }

    /// How many calls of each kind a scenario makes, and how many bytes it writes.
    pub fn count(&self, scenario: &Scenario) -> Result<[u64; KINDS.len()], String> {
        let path = self.shim.with_extension("counts");
        let mut command = self.scenario(scenario, None);
        command.env("PBGI_FAULT_COUNTS", &path);
        let run = self.finish(command.spawn(), scenario.args)?;
        if run.code != Some(0) {
            return Err(format!("{}: {}", scenario.name, run.said));
        }
        let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        let count = |kind: &str| {
            let line = text.lines().find_map(|line| line.strip_prefix(kind)?.strip_prefix(' '));
            line.and_then(|count| count.parse().ok()).ok_or_else(|| format!("no count of {kind}"))
        };
        let mut counts = [0; KINDS.len()];
        for (out, kind) in counts.iter_mut().zip(KINDS) {
            *out = count(kind)?;
        }
        Ok(counts)
    }

    /// Runs a scenario to its end.
    pub fn run(&self, scenario: &Scenario, fault: Option<&Fault>) -> Result<Run, String> {
        self.finish(self.scenario(scenario, fault).spawn(), scenario.args)
    }

    /// Waits for a program.
    pub fn finish(&self, child: std::io::Result<Child>, args: &[&str]) -> Result<Run, String> {
        let mut child = child.map_err(|e| format!("{}: {e}", self.program.display()))?;
        let mut stderr = child.stderr.take();
        let reading = thread::spawn(move || {
            let mut text = String::new();
            if let Some(pipe) = &mut stderr {
                // What is no text is not looked at.
                let _ = std::io::Read::read_to_string(pipe, &mut text);
            }
            text
        });
        let start = Instant::now();
        let status = loop {
            match child.try_wait() {
                Ok(Some(status)) => break status,
                Ok(None) if start.elapsed() < Duration::from_secs(SECONDS_MAX) => {
                    thread::sleep(Duration::from_millis(1));
                }
                _ => {
                    let _ = child.kill();
                    let _ = child.wait();
                    return Err(format!("pbgi {} hangs", args.join(" ")));
                }
            }
        };
        Ok(Run { code: status.code(), said: reading.join().unwrap_or_default() })
    }
}

/// A sky of 16 × 8 texels, brighter toward its right.
fn sky() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n".to_vec();
    bytes.extend((0..128u8).flat_map(|i| [100, 120 + i % 16, 140, 128]));
    bytes
}

impl Drop for Bench {
    fn drop(&mut self) {
        if let Some(folder) = self.folder.parent().filter(|folder| Path::is_dir(folder)) {
            // It lies in the target folder: what cannot be removed is in nobody's way.
            let _ = fs::remove_dir_all(folder);
        }
    }
}
