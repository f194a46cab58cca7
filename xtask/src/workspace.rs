//! Where the workspace lies and which files belong to it.

use std::path::{Path, PathBuf};
use std::process::Command;

/// The workspace this program was built in.
pub struct Workspace {
    root: PathBuf,
}

impl Workspace {
    /// The folder above this package.
    pub fn find() -> Result<Self, String> {
        // Cargo tells which workspace it runs for; one that was built elsewhere may be gone.
        let package = std::env::var_os("CARGO_MANIFEST_DIR");
        let package = package.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
        let root = Path::new(&package).parent().ok_or("xtask lies in no workspace")?;
        Ok(Self { root: root.to_owned() })
    }

    /// The folder of the workspace.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Cargo, run in the folder of the workspace.
    pub fn cargo(&self) -> Command {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut command = Command::new(cargo);
        command.current_dir(&self.root);
        command
    }

    /// Cargo of the nightly toolchain, run in the folder of the workspace.
    pub fn nightly_cargo(&self) -> Command {
        // Not by the Cargo that runs this: its toolchain is another.
        let mut command = Command::new("rustup");
        command.args(["run", "nightly", "cargo"]).current_dir(&self.root);
        for name in ["CARGO", "RUSTC", "RUSTUP_TOOLCHAIN"] {
            command.env_remove(name);
        }
        command
    }

    /// Where Cargo puts what it makes.
    pub fn target(&self) -> PathBuf {
        std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| self.root.join("target"), PathBuf::from)
    }

    /// The program `pbgi`, to be built by [`Self::build_program`].
    pub fn program(&self) -> PathBuf {
        self.target().join("release").join("pbgi")
    }

    /// The command that builds [`Self::program`].
    pub fn build_program(&self) -> Command {
        let mut build = self.cargo();
        build.args(["build", "--release", "--package", "pbgi-cli", "--bin", "pbgi"]);
        build
    }

    /// Text of a file, given relative to the root.
    pub fn read(&self, path: &str) -> Result<String, String> {
        std::fs::read_to_string(self.root.join(path)).map_err(|e| format!("{path}: {e}"))
    }

    /// Replaces the text of a file, given relative to the root.
    pub fn write(&self, path: &str, text: &str) -> Result<(), String> {
        std::fs::write(self.root.join(path), text).map_err(|e| format!("{path}: {e}"))
    }

    /// Names of the folders in `crates/`, sorted.
    pub fn crates(&self) -> Result<Vec<String>, String> {
        let folder = self.root.join("crates");
        let entries = std::fs::read_dir(folder).map_err(|e| format!("crates: {e}"))?;
        let mut names: Vec<String> = entries
            .filter_map(Result::ok)
            .filter(|entry| entry.path().join("Cargo.toml").is_file())
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        Ok(names)
    }

    /// Files that are tracked or could be, relative to the root, sorted.
    pub fn files(&self) -> Result<Vec<String>, String> {
        let output = Command::new("git")
            .args(["ls-files", "--cached", "--others", "--exclude-standard", "-z"])
            .current_dir(&self.root)
            .output()
            .map_err(|e| format!("git ls-files: {e}"))?;
        if !output.status.success() {
            return Err(format!("git ls-files: {}", String::from_utf8_lossy(&output.stderr)));
        }
        let listed = String::from_utf8_lossy(&output.stdout).into_owned();
        let mut files: Vec<String> = listed
            .split('\0')
            .filter(|path| !path.is_empty() && self.root.join(path).is_file())
            .map(str::to_owned)
            .collect();
        files.sort();
        Ok(files)
    }

    /// Files of `files` below `folder` that are Rust sources.
    pub fn sources<'a>(files: &'a [String], folder: &str) -> Vec<&'a str> {
        let inside = |path: &&str| path.starts_with(folder) && path.ends_with(".rs");
        files.iter().map(String::as_str).filter(inside).collect()
    }
}

/// Runs a command, which must succeed.
pub fn succeed(command: &mut Command) -> Result<(), String> {
    let status = command.status().map_err(|e| format!("{command:?}: {e}"))?;
    if status.success() { Ok(()) } else { Err(format!("{command:?} failed: {status}")) }
}

/// The same for a command that is shown before.
pub fn succeed_shown(command: &mut Command) -> Result<(), String> {
    println!("+ {command:?}");
    succeed(command)
}

/// The system this runs on, as Cargo names it.
pub fn host_triple() -> Result<String, String> {
    let output = Command::new("rustc").arg("-vV").output().map_err(|e| format!("rustc: {e}"))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    host.map(str::to_owned).ok_or_else(|| "rustc -vV names no host".to_owned())
}
