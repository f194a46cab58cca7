//! What all command-line tools share: options, sizes, Ctrl-C, exit codes.

pub use pbgi::figures::{parse_bytes, parse_count};
use pbgi::{
    Backend, EXIT_INTERRUPTED, PbgiError, Progress, ProgressMode, Verbosity, check_memory_limit,
    thread_count, write_statistics,
};
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// What the code means that a command ends with.
pub const EXIT_CODES_HELP: &str = "\
Exit codes:
    0  done
    1  failed: an output cannot be written, or the program is at fault
    2  the command cannot be carried out as given
    3  an input is missing, damaged or of no known kind (also: warnings, with --strict)
    4  disk space, quota or memory limit do not suffice
  130  interrupted; nothing half-written stays";

/// The exit code of a command that did what it was told.
const EXIT_DONE: u8 = 0;

/// Options of every tool.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct CommonArgs {
    /// Memory the process may hold, such as 512MiB or 4G
    #[arg(long, value_name = "SIZE", default_value = "1GiB", value_parser = parse_bytes)]
    pub memory_limit: u64,
    /// Threads; 0 is one per core
    #[arg(short, long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// How progress is shown on standard error
    #[arg(long, value_enum, value_name = "MODE", default_value = "auto", hide_short_help = true)]
    pub progress: ProgressArg,
    /// End with exit code 3 if there was a warning
    #[arg(long, hide_short_help = true)]
    pub strict: bool,
    /// Tell more
    #[arg(short, long, conflicts_with = "quiet")]
    pub verbose: bool,
    /// Tell warnings and errors only
    #[arg(short, long)]
    pub quiet: bool,
}

impl CommonArgs {
    /// Threads to start, see [`thread_count`].
    #[must_use]
    pub fn thread_count(&self) -> usize {
        thread_count(self.threads, self.memory_limit)
    }

    /// How much to tell.
    #[must_use]
    pub fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }

    /// Progress as asked for, of a run in `phase_count` phases.
    #[must_use]
    pub fn start_progress(&self, phase_count: u32) -> Progress {
        Progress::new(self.progress.into(), self.verbosity(), phase_count)
    }

    /// What becomes of a run with these warnings: what was written stays, and with `--strict` the run ends as one of an input that
    /// cannot be read as it is.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Input`] if there is a warning and `--strict` is set.
    pub fn judge(&self, warnings: &[String]) -> Result<(), PbgiError> {
        if !self.strict || warnings.is_empty() {
            return Ok(());
        }
        let count = warnings.len();
        Err(PbgiError::input(format!(
            "{count} warnings, which --strict forbids; the result was written"
        )))
    }

    /// Refuses limits no tool can keep.
    ///
    /// # Errors
    ///
    /// [`PbgiError::Usage`], naming the smallest limit.
    pub fn check(&self) -> Result<(), PbgiError> {
        check_memory_limit(self.memory_limit)?;
        if self.threads > 4096 {
            return Err(PbgiError::usage(format!(
                "--threads {} is out of range; expected 0 (one per core) to 4096",
                self.threads
            )));
        }
        Ok(())
    }
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum ProgressArg {
    /// A bar on a terminal, plain lines elsewhere
    #[default]
    Auto,
    /// One line, redrawn in place
    Bar,
    /// A few lines per phase
    Plain,
    /// A JSON object per line, every second at most
    Json,
    /// Nothing
    None,
}

impl From<ProgressArg> for ProgressMode {
    fn from(mode: ProgressArg) -> Self {
        match mode {
            ProgressArg::Auto => Self::Auto,
            ProgressArg::Bar => Self::Bar,
            ProgressArg::Plain => Self::Plain,
            ProgressArg::Json => Self::Json,
            ProgressArg::None => Self::None,
        }
    }
}

/// How an octree file is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum IoMode {
    /// By reads of whole pages; a file that gets shorter meanwhile is an error
    #[default]
    Read,
    /// Through a map of the file; not for network disks
    Map,
}

impl From<IoMode> for Backend {
    fn from(mode: IoMode) -> Self {
        match mode {
            IoMode::Read => Self::Read,
            IoMode::Map => Self::Map,
        }
    }
}

/// Three numbers separated by commas, such as `0,1.5,-2`.
///
/// # Errors
///
/// Says what is expected.
pub fn parse_triple(text: &str) -> Result<[f32; 3], String> {
    let parts: Vec<f32> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|x: &f32| x.is_finite()))
        .collect::<Option<_>>()
        .unwrap_or_default();
    parts
        .try_into()
        .map_err(|_| format!("`{text}` are not three numbers; expected such as 0,1.5,-2"))
}

/// Columns and rows of an image, such as `960x540`.
///
/// # Errors
///
/// Says what is expected.
///
/// ```
/// assert_eq!(pbgi_cli::cli::parse_resolution("960x540"), Ok([960, 540]));
/// ```
pub fn parse_resolution(text: &str) -> Result<[u32; 2], String> {
    let edge = |text: &str| text.trim().parse().ok().filter(|x| (1..=65536).contains(x));
    text.split_once(['x', 'X'])
        .and_then(|(width, height)| Some([edge(width)?, edge(height)?]))
        .ok_or_else(|| format!("`{text}` is no size; expected one such as 960x540"))
}

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Runs a tool: `body` gets a flag that Ctrl-C (or a termination signal) sets. An error goes to
/// standard error after the tool's name, and decides the exit code, which is returned. A second Ctrl-C ends the
/// process at once. Panics of decoders, which become errors, are not printed.
pub fn run(tool: &str, body: impl FnOnce(&'static AtomicBool) -> Result<(), PbgiError>) -> u8 {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(EXIT_INTERRUPTED));
        }
    };
    pbgi::hush_decoder_panics();
    // Without a handler Ctrl-C still works, only less cleanly.
    let _ = ctrlc::set_handler(handler);
    match body(&INTERRUPTED) {
        Ok(()) => EXIT_DONE,
        Err(error) => {
            tell(&format!("{tool}: {error}"));
            error.exit_code()
        }
    }
}

/// Writes a line to standard error. That nobody reads it, or that it cannot be written, changes nothing.
pub fn tell(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Writes `text` to standard output. A reader that has seen enough (`| head`) is no error.
///
/// # Errors
///
/// If standard output cannot be written.
pub fn print(text: &str) -> Result<(), PbgiError> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(PbgiError::output(Path::new("standard output"), "write", e))
        }
        _ => Ok(()),
    }
}

/// Writes `value` as JSON to the file `path`, or to standard output where that is `-`.
///
/// # Errors
///
/// If it cannot be written.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), PbgiError> {
    if path.as_os_str() != "-" {
        return write_statistics(path, value);
    }
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| PbgiError::failed(format!("statistics cannot be written as JSON: {e}")))?;
    print(&format!("{text}\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triples_are_read() {
        assert_eq!(parse_triple("0, 1.5,-2"), Ok([0.0, 1.5, -2.0]));
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(parse_triple(text).is_err(), "{text}");
        }
    }
}
