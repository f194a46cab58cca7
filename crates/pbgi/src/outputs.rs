//! What a run writes, judged before the work: nothing of the user's may be destroyed.
//!
//! All tools and the facade ask here. An output is no input, by whatever name; no two outputs are one; a file that exists is replaced only
//! by one of its own kind; what is no regular file is written in place, or refused.

use crate::PbgiError;
use pbgi_file::{FileId, folder_of, kind_name, platform};
use std::collections::HashMap;
use std::fs::{File, Metadata};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// What is written to a file, as its first bytes tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputKind {
    /// An octree file.
    Octree,
    /// An EXR picture.
    Picture,
    /// A PNG picture.
    Preview,
    /// Points, by the extension: .npy, .csv, .las, .laz, .ptc, else PLY.
    Points,
    /// Statistics as JSON.
    Statistics,
    /// A trace of requests for pages.
    Trace,
}

/// How a table as CSV starts.
const CSV_START: &[u8] = b"x,y,z,nx,ny,nz,";

/// Names of the first value of statistics, of every tool.
const STATISTICS_FIRST: [&str; 4] = ["inputs", "receivers", "bake", "shade"];

/// Bytes that tell of what kind a file is.
const START_BYTES: u64 = 64;

impl OutputKind {
    /// What files of this kind and name are called, and whether one that starts thus is one.
    fn judge(self, path: &Path, start: &[u8]) -> (&'static str, bool) {
        match self {
            Self::Octree => ("an octree file", start.starts_with(&pbgi_format::MAGIC)),
            Self::Picture => ("an EXR picture", start.starts_with(b"\x76\x2f\x31\x01")),
            Self::Preview => ("a PNG picture", start.starts_with(b"\x89PNG\r\n\x1a\n")),
            Self::Trace => ("a trace of pages", start.starts_with(&pbgi_store::TRACE_MAGIC)),
            Self::Statistics => ("statistics of this program", are_statistics(start)),
            Self::Points => {
                let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
                match extension.to_ascii_lowercase().as_str() {
                    "npy" => ("a table of NumPy", start.starts_with(b"\x93NUMPY")),
                    "csv" => ("a table of this program", start.starts_with(CSV_START)),
                    "las" | "laz" => ("a scan", start.starts_with(&pbgi_cloud::LAS_MAGIC)),
                    "ptc" => ("a .ptc cloud", start.starts_with(b"pptc")),
                    _ => ("a PLY file", start.starts_with(b"ply")),
                }
            }
        }
    }

    /// Whether it can be written to what takes bytes in their order only.
    fn can_stream(self) -> bool {
        self == Self::Statistics
    }
}

/// Whether this is the start of a JSON object whose first value is called as that of statistics.
fn are_statistics(start: &[u8]) -> bool {
    let mut rest = start.trim_ascii_start();
    let mut next = |token: &[u8]| {
        let after = rest.strip_prefix(token).map(<[u8]>::trim_ascii_start);
        rest = after.unwrap_or(rest);
        after.is_some()
    };
    next(b"{")
        && STATISTICS_FIRST.iter().any(|name| next(format!("\"{name}\"").as_bytes()))
        && next(b":")
}

/// A file to be written.
#[derive(Clone, Copy, Debug)]
pub struct Output<'a> {
    /// The option that names it.
    pub option: &'static str,
    /// The file.
    pub path: &'a Path,
    /// What it will be.
    pub kind: OutputKind,
    /// Whether one of its kind is replaced.
    pub replace: bool,
}

/// What tells an output from others before it is there.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Place {
    File(FileId),
    /// A name in a folder, as the system spells it.
    New(PathBuf),
}

/// The files of a run.
#[derive(Clone, Debug, Default)]
pub struct RunFiles {
    inputs: HashMap<FileId, PathBuf>,
    outputs: HashMap<Place, (&'static str, PathBuf)>,
}

impl RunFiles {
    /// Adds a file that is read. What does not exist, or is no file, is of no consequence.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`] if it is an output, too.
    pub fn add_input(&mut self, path: &Path) -> Result<(), PbgiError> {
        let Ok(id) = FileId::of(path) else { return Ok(()) };
        if let Some((option, output)) = self.outputs.get(&Place::File(id)) {
            return Err(is_input(option, output, path));
        }
        self.inputs.entry(id).or_insert_with(|| path.to_owned());
        Ok(())
    }

    /// Adds inputs as a user names them: `-` and procedural scenes are none.
    ///
    /// # Errors
    ///
    /// As [`Self::add_input`].
    pub fn add_named_inputs<'n>(
        &mut self,
        names: impl IntoIterator<Item = &'n String>,
    ) -> Result<(), PbgiError> {
        let are_files =
            |name: &&String| *name != "-" && !crate::InputKind::is_procedural_name(name);
        names.into_iter().filter(are_files).try_for_each(|name| self.add_input(Path::new(name)))
    }

    /// Adds a file that is to be written.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`] if it is an input or another output; if it exists and is not to be replaced, or is of another kind; if it cannot be
    /// written as what it is.
    pub fn add_output(&mut self, output: &Output<'_>) -> Result<(), PbgiError> {
        let Output { option, path, .. } = *output;
        let shown = path.display();
        if path.file_name().is_none() {
            return Err(PbgiError::usage(format!("`{shown}` is no file name ({option})")));
        }
        let place = match std::fs::metadata(path) {
            Ok(found) if found.is_file() => {
                let id = FileId::of(path).map_err(|e| PbgiError::output(path, "look at", e))?;
                if let Some(input) = self.inputs.get(&id) {
                    return Err(is_input(option, path, input));
                }
                check_replaced(output)?;
                Place::File(id)
            }
            Ok(found) => return check_special(output, &found),
            Err(_) if path.is_symlink() => {
                return Err(PbgiError::usage(format!(
                    "{shown} is a link that leads nowhere; name a file ({option})"
                )));
            }
            Err(_) => {
                let folder = folder_of(path);
                let folder = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
                Place::New(folder.join(path.file_name().unwrap_or_default()))
            }
        };
        match self.outputs.insert(place, (option, path.to_owned())) {
            Some((other, _)) => Err(PbgiError::usage(format!(
                "{shown} would be written twice ({other} and {option}); give each output a name of its own"
            ))),
            None => Ok(()),
        }
    }
}

fn is_input(option: &str, output: &Path, input: &Path) -> PbgiError {
    let (output, input) = (output.display(), input.display());
    PbgiError::usage(format!(
        "{output} is the input {input}, too; choose another output ({option})"
    ))
}

/// Refuses to replace a file unasked, or one of another kind.
fn check_replaced(output: &Output<'_>) -> Result<(), PbgiError> {
    let Output { option, path, kind, replace } = *output;
    let shown = path.display();
    if !replace {
        return Err(PbgiError::usage(format!(
            "{shown} exists; --force replaces it, {option} names another output"
        )));
    }
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(START_BYTES).read_to_end(&mut start));
    match (read, kind.judge(path, &start)) {
        (Ok(_), (_, true)) => Ok(()),
        // Nothing is lost with it.
        (Ok(0), _) => Ok(()),
        (Err(e), _) if e.kind() != ErrorKind::PermissionDenied => {
            Err(PbgiError::output(path, "read what is to be replaced", e))
        }
        (_, (name, _)) => Err(PbgiError::usage(format!(
            "{shown} exists and is not {name}, and nothing else is replaced by one; choose another output ({option}) or remove it"
        ))),
    }
}

/// Refuses what is no regular file, but for devices and pipes that can be written in place.
fn check_special(output: &Output<'_>, found: &Metadata) -> Result<(), PbgiError> {
    let Output { option, path, kind, .. } = *output;
    let special = found.file_type();
    let can_stream =
        kind.can_stream() && (platform::is_character_device(special) || platform::is_pipe(special));
    // What is written is gone over again at its end.
    let can_seek = || {
        let opened = File::options().write(true).open(path);
        opened.and_then(|mut device| device.stream_position()).is_ok()
    };
    if can_stream
        || (kind != OutputKind::Octree && platform::is_character_device(special) && can_seek())
    {
        return Ok(());
    }
    Err(PbgiError::usage(format!(
        "{} is {}, which this cannot be written to; name a regular file ({option})",
        path.display(),
        kind_name(special)
    )))
}

/// Makes sure that `path` can be written before long work is done for it: a temporary file is made in its folder and removed, with what
/// killed runs have left there for `path`.
///
/// # Errors
///
/// [`PbgiError::Output`] if the folder is missing or cannot be written.
pub fn check_writable(path: &Path) -> Result<(), PbgiError> {
    if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        // Opening a pipe and closing it would end it for its reader.
        return Ok(());
    }
    let folder = folder_of(path);
    if !folder.is_dir() {
        let text =
            format!("there is no folder {0}; make it first (mkdir -p {0})", folder.display());
        let missing = std::io::Error::new(ErrorKind::NotFound, text);
        return Err(PbgiError::output(path, "create", missing));
    }
    let created = pbgi_file::AtomicFile::create(path);
    created.map(drop).map_err(|e| PbgiError::output(path, "create", e))
}

/// Writes `value` as JSON to the file `path`, which appears when it is complete.
///
/// # Errors
///
/// [`PbgiError::Output`] if it cannot be written.
pub fn write_statistics(path: &Path, value: &impl serde::Serialize) -> Result<(), PbgiError> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|e| PbgiError::failed(format!("statistics cannot be written as JSON: {e}")))?;
    text.push('\n');
    let mut file =
        pbgi_file::AtomicFile::create(path).map_err(|e| PbgiError::output(path, "create", e))?;
    file.write_all(text.as_bytes()).map_err(|e| PbgiError::output(path, "write", e))?;
    file.commit().map_err(|e| PbgiError::output(path, e.action, e.source))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    struct Folder(tempfile::TempDir);

    impl Folder {
        fn new(files: &[(&str, &str)]) -> Self {
            let folder = Self(tempfile::tempdir().unwrap());
            files.iter().for_each(|(name, text)| std::fs::write(folder.path(name), text).unwrap());
            folder
        }

        fn path(&self, name: &str) -> PathBuf {
            self.0.path().join(name)
        }
    }

    fn add(
        files: &mut RunFiles,
        path: &Path,
        kind: OutputKind,
        replace: bool,
    ) -> Result<(), String> {
        let output = Output { option: "-o", path, kind, replace };
        files.add_output(&output).map_err(|error| {
            assert_eq!(error.exit_code(), 2, "{error}");
            error.to_string()
        })
    }

    #[test]
    fn no_output_is_an_input_by_whatever_name() {
        let folder = Folder::new(&[("in.ply", "ply\n"), ("other.ply", "ply\n")]);
        symlink("in.ply", folder.path("link.ply")).unwrap();
        std::fs::hard_link(folder.path("in.ply"), folder.path("hard.ply")).unwrap();
        std::fs::create_dir(folder.path("deep")).unwrap();
        let mut files = RunFiles::default();
        files.add_input(&folder.path("in.ply")).unwrap();
        for name in ["in.ply", "link.ply", "hard.ply", "deep/../in.ply", "./in.ply"] {
            let error = add(&mut files, &folder.path(name), OutputKind::Points, true).unwrap_err();
            assert!(error.contains("in.ply, too"), "{error}");
        }
        add(&mut files, &folder.path("other.ply"), OutputKind::Points, true).unwrap();
        // What is found to be read later is judged as well.
        assert_eq!(files.add_input(&folder.path("other.ply")).unwrap_err().exit_code(), 2);
        files.add_input(&folder.path("none.ply")).unwrap();
    }

    #[test]
    fn no_two_outputs_are_one() {
        let folder = Folder::new(&[("old.exr", "\x76\x2f\x31\x01")]);
        std::fs::create_dir(folder.path("deep")).unwrap();
        symlink("deep", folder.path("link")).unwrap();
        let mut files = RunFiles::default();
        add(&mut files, &folder.path("deep/new.exr"), OutputKind::Picture, true).unwrap();
        add(&mut files, &folder.path("old.exr"), OutputKind::Picture, true).unwrap();
        for name in ["link/new.exr", "deep/./new.exr"] {
            let error = add(&mut files, &folder.path(name), OutputKind::Preview, true).unwrap_err();
            assert!(error.contains("written twice"), "{error}");
        }
        assert!(
            add(&mut files, &folder.path("deep/../old.exr"), OutputKind::Picture, true).is_err()
        );
        add(&mut files, &folder.path("new.exr"), OutputKind::Picture, true).unwrap();
    }

    #[test]
    fn only_files_of_the_kind_that_is_written_are_replaced() {
        use OutputKind::{Octree, Picture, Points, Preview, Statistics, Trace};
        let folder = Folder::new(&[
            ("text", "dear diary"),
            ("octree", "PBGITREE"),
            ("exr", "\x76\x2f\x31\x01"),
            ("ply", "ply\nformat"),
            ("t.csv", "x,y,z,nx,ny,nz,irradiance_r"),
            ("t.npy", "name,age"),
            ("stats", "{\n  \"receivers\": 3}"),
            ("gltf", "{\"asset\": {\"version\": \"2.0\"}}"),
            ("trace", "PBGITRC1"),
            ("empty", ""),
        ]);
        std::fs::write(folder.path("png"), b"\x89PNG\r\n\x1a\n").unwrap();
        let kinds = [Octree, Picture, Preview, Points, Statistics, Trace];
        let of_kind =
            [("octree", 0), ("exr", 1), ("png", 2), ("ply", 3), ("stats", 4), ("trace", 5)];
        let names = ["text", "octree", "exr", "ply", "png", "t.npy", "stats", "gltf", "trace"];
        for (index, kind) in kinds.into_iter().enumerate() {
            for name in names {
                let result = add(&mut RunFiles::default(), &folder.path(name), kind, true);
                assert_eq!(result.is_ok(), of_kind.contains(&(name, index)), "{name} {kind:?}");
                let unasked = add(&mut RunFiles::default(), &folder.path(name), kind, false);
                assert!(unasked.unwrap_err().contains("--force"));
            }
            add(&mut RunFiles::default(), &folder.path("empty"), kind, true).unwrap();
        }
        add(&mut RunFiles::default(), &folder.path("t.csv"), Points, true).unwrap();
    }

    #[test]
    fn what_is_no_file_is_written_in_place_or_refused() {
        let folder = Folder::new(&[]);
        let pipe = folder.path("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
        symlink("none", folder.path("lost")).unwrap();
        let of = |path: &Path, kind| add(&mut RunFiles::default(), path, kind, true);
        for path in [folder.0.path(), &folder.path("lost"), Path::new(""), Path::new("/")] {
            assert!(of(path, OutputKind::Statistics).is_err(), "{}", path.display());
        }
        assert!(of(&pipe, OutputKind::Points).unwrap_err().contains("a pipe"));
        of(&pipe, OutputKind::Statistics).unwrap();
        of(Path::new("/dev/null"), OutputKind::Points).unwrap();
        assert!(of(Path::new("/dev/null"), OutputKind::Octree).is_err());
    }

    #[test]
    fn outputs_are_tried_before_the_work() {
        let folder = Folder::new(&[]);
        check_writable(&folder.path("new.exr")).unwrap();
        assert_eq!(check_writable(&folder.path("none/new.exr")).unwrap_err().exit_code(), 1);
        assert_eq!(std::fs::read_dir(folder.0.path()).unwrap().count(), 0);
    }
}
