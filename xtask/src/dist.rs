//! What is given away: the program for a system, stripped and where possible static, in an archive with all licenses.

use crate::licenses::texts_of;
use crate::packages::Packages;
use crate::workspace::{Workspace, succeed_shown};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The package of the program, which does all that the programs for single commands do.
const PACKAGE: &str = "pbgi-cli";
/// Files of the workspace that go along.
const COPIED: [&str; 4] = ["README.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE"];
const THIRD_PARTY: &str = "THIRD-PARTY-LICENSES.txt";
/// Shells and the names of their completions.
const SHELLS: [(&str, &str); 4] =
    [("bash", "pbgi.bash"), ("zsh", "_pbgi"), ("fish", "pbgi.fish"), ("powershell", "pbgi.ps1")];

/// Builds the program for a target, which is that of this machine if not named, and packs it into `target/dist`. With `--dry-run` first,
/// all is looked up and told, and nothing built or written.
pub fn run(workspace: &Workspace, arguments: &[&str]) -> Result<(), String> {
    let (is_dry, rest) = match arguments {
        ["--dry-run", rest @ ..] => (true, rest),
        _ => (false, arguments),
    };
    let target = match rest {
        [] => own_target(),
        [target] if !target.starts_with('-') => (*target).to_owned(),
        _ => return Err("expected: cargo xtask dist [--dry-run] [TARGET]".into()),
    };
    let release = Release::plan(workspace, &target)?;
    println!("{}: {}", release.archive(), release.files().join(", "));
    if is_dry {
        return Ok(());
    }
    let archive = release.pack(workspace)?;
    let bytes = fs::metadata(&archive).map_err(|e| e.to_string())?.len();
    println!("{}: {:.1} MB", archive.display(), bytes as f64 * 1e-6);
    Ok(())
}

/// The target of programs that run here; on Linux without any library of the system.
fn own_target() -> String {
    let processor = std::env::consts::ARCH;
    match std::env::consts::OS {
        "macos" => format!("{processor}-apple-darwin"),
        "windows" => format!("{processor}-pc-windows-gnu"),
        system => format!("{processor}-unknown-{system}-musl"),
    }
}

/// An archive to be made.
struct Release {
    target: String,
    version: String,
    third_party: String,
}

impl Release {
    fn plan(workspace: &Workspace, target: &str) -> Result<Self, String> {
        let packages = Packages::read(workspace, "Cargo.toml", Some(target))?;
        let linked = packages.linked_into(PACKAGE)?;
        let program = linked.iter().find(|package| package.name == PACKAGE);
        let version = program.map(|program| program.version.clone()).unwrap_or_default();
        let third_party = texts_of(workspace, &linked)?;
        Ok(Self { target: target.to_owned(), version, third_party })
    }

    /// Name of the archive's folder.
    fn stem(&self) -> String {
        format!("pbgi-{}-{}", self.version, self.target)
    }

    fn archive(&self) -> String {
        format!("{}.tar.gz", self.stem())
    }

    fn program(&self) -> &'static str {
        if self.target.contains("windows") { "pbgi.exe" } else { "pbgi" }
    }

    /// Names of the files that are always there.
    fn files(&self) -> Vec<&str> {
        [&[self.program()][..], &COPIED[..], &[THIRD_PARTY][..]].concat()
    }

    /// Builds, gathers and packs.
    fn pack(&self, workspace: &Workspace) -> Result<PathBuf, String> {
        let built = self.build(workspace)?;
        let dist = workspace.target().join("dist");
        let folder = dist.join(self.stem());
        let fault = |e: std::io::Error| format!("{}: {e}", folder.display());
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).map_err(fault)?;
        let program = folder.join(self.program());
        fs::copy(&built, &program).map_err(|e| format!("{}: {e}", built.display()))?;
        if self.target.contains("musl") {
            let bytes = fs::read(&program).map_err(fault)?;
            if !is_static(&bytes).ok_or("the program is no 64-bit ELF file")? {
                return Err(format!("{}: needs libraries of the system", program.display()));
            }
        }
        for name in COPIED {
            fs::copy(workspace.root().join(name), folder.join(name)).map_err(fault)?;
        }
        fs::write(folder.join(THIRD_PARTY), &self.third_party).map_err(fault)?;
        match add_manual(&program, &folder) {
            Ok(()) => {}
            Err(error) => println!("no manual pages and completions: {error}"),
        }
        let archive = dist.join(self.archive());
        // The same files make the same bytes, whoever packs them and when.
        let mut tar = Command::new("tar");
        tar.args(["--sort=name", "--mtime=@0", "--owner=0", "--group=0", "--numeric-owner"]);
        tar.args(["--mode=u=rwX,go=rX", "--format=ustar", "--use-compress-program=gzip -n9"]);
        tar.arg("-C").arg(&dist).arg("-cf").arg(&archive).arg(self.stem());
        succeed_shown(&mut tar)?;
        Ok(archive)
    }

    /// Compiles the program; where it lies.
    fn build(&self, workspace: &Workspace) -> Result<PathBuf, String> {
        let mut build = workspace.cargo();
        build.args(["build", "--release", "--locked", "--package", PACKAGE, "--bin", "pbgi"]);
        build.args(["--target", &self.target]);
        build.env("CARGO_PROFILE_RELEASE_STRIP", "symbols");
        build.env("RUSTFLAGS", shorten_paths(workspace)?);
        succeed_shown(&mut build)?;
        Ok(workspace.target().join(&self.target).join("release").join(self.program()))
    }
}

/// Flags that leave the folders of this machine out of the program's messages.
fn shorten_paths(workspace: &Workspace) -> Result<String, String> {
    let packages = Packages::read(workspace, "Cargo.toml", None)?;
    let dependency = packages.all().iter().find(|package| package.source.is_some());
    let registry = dependency.and_then(|package| package.folder().parent());
    let folders = [registry, Some(workspace.root())];
    let flags = folders
        .into_iter()
        .flatten()
        .zip(["crates", "pbgi"])
        .map(|(folder, name)| format!("--remap-path-prefix={}={name}", folder.display()));
    Ok(flags.collect::<Vec<_>>().join(" "))
}

/// Manual pages and completions, which the program writes itself, where it runs here.
fn add_manual(program: &Path, folder: &Path) -> Result<(), String> {
    let output = |arguments: &[&OsStr]| {
        let output = Command::new(program).args(arguments).output().map_err(|e| e.to_string())?;
        if output.status.success() { Ok(output.stdout) } else { Err(output.status.to_string()) }
    };
    let pages = folder.join("man");
    output(&["man".as_ref(), "--out".as_ref(), pages.as_ref()])?;
    let completions = folder.join("completions");
    fs::create_dir_all(&completions).map_err(|e| e.to_string())?;
    for (shell, name) in SHELLS {
        let text = output(&["completions".as_ref(), shell.as_ref()])?;
        fs::write(completions.join(name), text).map_err(|e| e.to_string())?;
    }
    Ok(())
}

/// Whether a program needs no loader: whether its headers name none. Nothing if it is no ELF file of 64 bits with the lowest byte first.
fn is_static(elf: &[u8]) -> Option<bool> {
    /// Type of the header that names the loader.
    const INTERPRETER: u32 = 3;
    if !elf.starts_with(b"\x7fELF\x02\x01") {
        return None;
    }
    let first = u64::from_le_bytes(*elf.get(0x20..)?.first_chunk()?) as usize;
    let stride = usize::from(u16::from_le_bytes(*elf.get(0x36..)?.first_chunk()?));
    let count = usize::from(u16::from_le_bytes(*elf.get(0x38..)?.first_chunk()?));
    let mut is_static = true;
    for header in 0..count {
        let at = first.checked_add(header * stride)?;
        is_static &= u32::from_le_bytes(*elf.get(at..)?.first_chunk()?) != INTERPRETER;
    }
    Some(is_static)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn archives_are_called_by_version_and_target_and_hold_all_licenses() {
        let workspace = Workspace::find().unwrap();
        let plan = |target| Release::plan(&workspace, target).unwrap();
        let [linux, windows] = ["x86_64-unknown-linux-musl", "x86_64-pc-windows-gnu"].map(plan);
        let version = env!("CARGO_PKG_VERSION");
        assert_eq!(linux.archive(), format!("pbgi-{version}-x86_64-unknown-linux-musl.tar.gz"));
        assert_eq!(linux.files()[0], "pbgi");
        assert_eq!(windows.files()[0], "pbgi.exe");
        for name in [&linux, &windows].iter().flat_map(|release| release.files()).skip(1) {
            let is_made = [THIRD_PARTY, "pbgi.exe"].contains(&name);
            assert!(is_made || workspace.root().join(name).is_file(), "{name}");
        }
        let has =
            |release: &Release, name: &str| release.third_party.contains(&format!("\n{name} "));
        assert!(has(&linux, "clap") && has(&linux, "rustix") && !has(&linux, "windows-sys"));
        assert!(has(&windows, "clap") && has(&windows, "windows-sys") && !has(&windows, "rustix"));
        assert_eq!(plan("x86_64-unknown-linux-musl").third_party, linux.third_party);
    }

    /// A header and two program headers, of these types.
    fn elf(types: [u32; 2]) -> Vec<u8> {
        let mut bytes = b"\x7fELF\x02\x01".to_vec();
        bytes.resize(64, 0);
        bytes[0x20] = 64;
        bytes[0x36] = 56;
        bytes[0x38] = 2;
        for kind in types {
            bytes.extend(kind.to_le_bytes());
            bytes.resize(bytes.len() + 52, 0);
        }
        bytes
    }

    #[test]
    fn programs_with_a_loader_are_not_static() {
        assert_eq!(is_static(&elf([1, 2])), Some(true));
        assert_eq!(is_static(&elf([1, 3])), Some(false));
        assert_eq!(is_static(&elf([1, 2])[..100]), None);
        assert_eq!(is_static(b"MZ"), None);
    }
}
