//! What all command-line tools share: options, sizes, Ctrl-C, exit codes.

use pbgi::{
    Backend, EXIT_INTERRUPTED, PbgiError, Progress, ProgressMode, Verbosity, check_memory_limit,
    write_statistics,
};
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::ExitCode;
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

/// Most threads per core.
const THREADS_PER_CORE: usize = 8;

/// Bytes of the memory limit there must be for each thread.
const THREAD_LIMIT_BYTES: u64 = 8 << 20;

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
    /// Threads to start, at least 1: at most a few per core, and so many that each has a small part of the memory limit. More would
    /// change no result and gain nothing.
    #[must_use]
    pub fn thread_count(&self) -> usize {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let affordable = usize::try_from(self.memory_limit / THREAD_LIMIT_BYTES).unwrap_or(1);
        match self.threads {
            0 => cores,
            threads => threads.min(THREADS_PER_CORE * cores).min(affordable).max(1),
        }
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

/// A number of bytes: `4GiB`, `512M`, `1.5g`, `100000`. K, M, G, T and KiB … are powers of 1024,
/// kB, MB, GB and TB powers of 1000.
///
/// # Errors
///
/// Says what is expected.
///
/// ```
/// assert_eq!(pbgi_cli::cli::parse_bytes("1.5GiB"), Ok(3 << 29));
/// ```
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let expected = || format!("`{text}` is no size; expected one such as 512MiB or 4G");
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (digits, suffix) = text.split_at(end);
    let binary = ["", "k", "m", "g", "t"];
    let suffix = suffix.trim_start().to_ascii_lowercase();
    let stem = suffix.strip_suffix("ib").or(suffix.strip_suffix('b'));
    let is_decimal = stem.is_some_and(|s| !s.is_empty()) && !suffix.ends_with("ib");
    let power = binary.iter().position(|&s| s == stem.unwrap_or(&suffix)).ok_or_else(expected)?;
    let base: f64 = if is_decimal { 1000.0 } else { 1024.0 };
    scale_number(digits, base.powi(power as i32)).ok_or_else(expected)
}

/// A count: `2M`, `1.5G`, `250k`, `1000`, `1e6`, `1_000_000`; the suffixes are powers of 1000.
///
/// # Errors
///
/// Says what is expected.
///
/// ```
/// assert_eq!(pbgi_cli::cli::parse_count("1.5M"), Ok(1_500_000));
/// ```
pub fn parse_count(text: &str) -> Result<u64, String> {
    let expected = || format!("`{text}` is no count; expected one such as 2M, 5e5 or 500000");
    let text = text.replace('_', "");
    let (digits, factor) = match text.char_indices().last() {
        Some((end, 'k' | 'K')) => (&text[..end], 1e3),
        Some((end, 'm' | 'M')) => (&text[..end], 1e6),
        Some((end, 'g' | 'G')) => (&text[..end], 1e9),
        _ => (&text[..], 1.0),
    };
    let (digits, factor) = match digits.split_once(['e', 'E']) {
        Some((digits, power)) => (digits, factor * ten_to(power).ok_or_else(expected)?),
        None => (digits, factor),
    };
    scale_number(digits, factor).ok_or_else(expected)
}

/// A power of ten, of one digit or two.
fn ten_to(power: &str) -> Option<f64> {
    let digits = power.strip_prefix('+').unwrap_or(power);
    let is_short = (1..=2).contains(&digits.len()) && digits.bytes().all(|b| b.is_ascii_digit());
    is_short.then(|| digits.parse().ok()).flatten().map(|power| 10f64.powi(power))
}

/// `digits` times `factor`, rounded; only unsigned decimal numbers below 2⁵³ pass.
fn scale_number(digits: &str, factor: f64) -> Option<u64> {
    if !digits.bytes().all(|b| b.is_ascii_digit() || b == b'.') {
        return None;
    }
    let value = (digits.parse::<f64>().ok()? * factor).round();
    (value < (1u64 << 53) as f64).then_some(value as u64)
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
/// standard error after the tool's name, and decides the exit code. A second Ctrl-C ends the
/// process at once.
pub fn run(
    tool: &str,
    body: impl FnOnce(&'static AtomicBool) -> Result<(), PbgiError>,
) -> ExitCode {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(EXIT_INTERRUPTED));
        }
    };
    // Without a handler Ctrl-C still works, only less cleanly.
    let _ = ctrlc::set_handler(handler);
    match body(&INTERRUPTED) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tell(&format!("{tool}: {error}"));
            ExitCode::from(error.exit_code())
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
    fn sizes_are_read() {
        for (text, bytes) in [
            ("1000", 1000),
            ("4GiB", 4 << 30),
            ("2M", 2 << 20),
            ("2 MiB", 2 << 20),
            ("0.5g", 1 << 29),
            ("3kB", 3000),
            ("2GB", 2_000_000_000),
            ("10b", 10),
            ("1T", 1 << 40),
        ] {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "M", "-1", "4XiB", "1..2", "1e9", "é", "ib", "99999999999999999T"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn counts_are_read() {
        assert_eq!(parse_count("250k"), Ok(250_000));
        assert_eq!(parse_count("1.25G"), Ok(1_250_000_000));
        assert_eq!(parse_count("1e6"), Ok(1_000_000));
        assert_eq!(parse_count("2.5E+3"), Ok(2500));
        assert_eq!(parse_count("1_000_000"), Ok(1_000_000));
        for text in
            ["1e", "1e-3", "1e999", "e6", "_", "1e16", "1e6.5", "", "M", "-2M", "two", "nan", "é"]
        {
            assert!(parse_count(text).is_err(), "{text}");
        }
    }

    #[test]
    fn triples_are_read() {
        assert_eq!(parse_triple("0, 1.5,-2"), Ok([0.0, 1.5, -2.0]));
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(parse_triple(text).is_err(), "{text}");
        }
    }
}
