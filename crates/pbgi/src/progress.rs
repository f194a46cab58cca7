//! Progress of long work on standard error: phases, rates, estimates of what is left.

use crate::figures::{format_count, format_seconds};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProgressMode {
    /// A bar on a terminal, plain lines elsewhere.
    #[default]
    Auto,
    /// One line, redrawn in place.
    Bar,
    /// A line at the end of a phase, and before it ever more rarely: tens of lines for hours.
    Plain,
    /// A JSON object per line, every second at most.
    Json,
    /// Nothing.
    None,
}

impl ProgressMode {
    /// Milliseconds to the next line, `now` milliseconds into a phase.
    fn pause_ms(self, now: u64) -> u64 {
        match self {
            Self::Bar => 100,
            // Each line comes half as late again as the one before.
            Self::Plain => (now / 2).max(2000),
            _ => 1000,
        }
    }
}

/// Phases of a run that each write their plain lines.
const PLAIN_PHASES: u32 = 12;

/// How much a program tells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Warnings and errors only.
    Quiet,
    /// The settings in effect, too.
    #[default]
    Normal,
    /// Everything.
    Verbose,
}

/// What a watcher of a run is told.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ProgressEvent<'a> {
    /// A phase began, went on or ended.
    Phase {
        /// Its name, such as `sort`.
        name: &'static str,
        /// Things done.
        done: u64,
        /// Things there are, where known.
        total: Option<u64>,
        /// Whether it ended.
        is_final: bool,
    },
    /// What the user should know of.
    Warning(&'a str),
}

/// Who is told what happens instead of standard error.
type Watch = Box<dyn Fn(ProgressEvent<'_>) + Send + Sync>;

/// Progress of one run, written to standard error or told to a watcher. Shared by all threads.
pub struct Progress {
    mode: ProgressMode,
    watch: Option<Watch>,
    verbosity: Verbosity,
    phase_count: AtomicU32,
    started: AtomicU32,
    start: Instant,
    /// Milliseconds after the start when the last plain line was written.
    line_ms: AtomicU64,
    /// Whether a bar stands on the current line; held while writing.
    bar: Mutex<bool>,
}

impl Progress {
    /// Progress of a run in `phase_count` phases.
    #[must_use]
    pub fn new(mode: ProgressMode, verbosity: Verbosity, phase_count: u32) -> Self {
        let mode = match mode {
            _ if verbosity == Verbosity::Quiet => ProgressMode::None,
            ProgressMode::Auto if std::io::stderr().is_terminal() => ProgressMode::Bar,
            ProgressMode::Auto => ProgressMode::Plain,
            mode => mode,
        };
        Self {
            mode,
            watch: None,
            verbosity,
            phase_count: AtomicU32::new(phase_count),
            started: AtomicU32::new(0),
            start: Instant::now(),
            line_ms: AtomicU64::new(0),
            bar: Mutex::new(false),
        }
    }

    /// Shows nothing but warnings.
    #[must_use]
    pub fn silent() -> Self {
        Self::new(ProgressMode::None, Verbosity::Quiet, 0)
    }

    /// Writes nothing and tells `watch` instead, from any thread, phases a few times a second. It should return soon: work waits for it.
    #[must_use]
    pub fn watched(watch: impl Fn(ProgressEvent<'_>) + Send + Sync + 'static) -> Self {
        Self { watch: Some(Box::new(watch)), ..Self::silent() }
    }

    /// Changes the number of phases, where it becomes known late.
    pub fn set_phase_count(&self, phase_count: u32) {
        self.phase_count.store(phase_count, Ordering::Relaxed);
    }

    /// Starts the next phase, called `name`: `total` things called `unit`, where known. The phase
    /// ends when the returned value is dropped.
    pub fn start_phase(
        &self,
        name: &'static str,
        unit: &'static str,
        total: Option<u64>,
    ) -> Phase<'_> {
        let index = self.started.fetch_add(1, Ordering::Relaxed) + 1;
        self.phase_count.fetch_max(index, Ordering::Relaxed);
        let start = Instant::now();
        let total = AtomicU64::new(total.unwrap_or(UNKNOWN));
        let phase = Phase {
            progress: self,
            index,
            name,
            unit,
            start,
            total,
            done: AtomicU64::new(0),
            next_ms: AtomicU64::new(self.pause_ms(0)),
        };
        if self.mode == ProgressMode::Bar || self.watch.is_some() {
            phase.write_line(false);
        }
        phase
    }

    /// Whether phase `index` may write a plain line now: runs of many phases, as large pictures are, do so ever more rarely.
    fn is_plain_line_due(&self, index: u32) -> bool {
        let (now, last) = (self.start.elapsed().as_millis() as u64, &self.line_ms);
        let is_due = index <= PLAIN_PHASES || now >= last.load(Ordering::Relaxed) * 6 / 5 + 1000;
        if is_due {
            last.store(now, Ordering::Relaxed);
        }
        is_due
    }

    /// Tells a setting in effect or a fact, unless quiet.
    pub fn note(&self, text: &str) {
        self.tell(Verbosity::Normal, text);
    }

    /// Tells a detail, if verbose.
    pub fn detail(&self, text: &str) {
        self.tell(Verbosity::Verbose, text);
    }

    /// Tells what the user should know even when quiet.
    pub fn warn(&self, text: &str) {
        if let Some(watch) = &self.watch {
            return watch(ProgressEvent::Warning(text));
        }
        self.tell(Verbosity::Quiet, &format!("warning: {text}"));
    }

    /// Milliseconds to the next line of a phase, `now` milliseconds into it.
    fn pause_ms(&self, now: u64) -> u64 {
        if self.watch.is_some() { 100 } else { self.mode.pause_ms(now) }
    }

    fn tell(&self, least: Verbosity, text: &str) {
        if self.verbosity >= least {
            self.write(&format!("{text}\n"), false);
        }
    }

    /// Writes `text`, past a bar that may stand there; `is_bar` if `text` is one.
    fn write(&self, text: &str, is_bar: bool) {
        let mut bar = self.bar.lock().unwrap_or_else(PoisonError::into_inner);
        let clear = if *bar { "\r\x1b[K" } else { "" };
        // There is nobody left to tell if this fails.
        let _ = std::io::stderr().lock().write_all(format!("{clear}{text}").as_bytes());
        let _ = std::io::stderr().lock().flush();
        *bar = is_bar;
    }
}

const UNKNOWN: u64 = u64::MAX;

/// A phase under way; dropping it ends it.
pub struct Phase<'a> {
    progress: &'a Progress,
    index: u32,
    name: &'static str,
    unit: &'static str,
    start: Instant,
    total: AtomicU64,
    done: AtomicU64,
    /// Milliseconds after the start when the next line is due.
    next_ms: AtomicU64,
}

impl Phase<'_> {
    /// States that `done` things are done by now. Cheap; may be called from any thread, also out of
    /// order.
    pub fn set_done(&self, done: u64) {
        self.done.fetch_max(done, Ordering::Relaxed);
        if self.progress.mode == ProgressMode::None && self.progress.watch.is_none() {
            return;
        }
        let now = self.start.elapsed().as_millis() as u64;
        let due = self.next_ms.load(Ordering::Relaxed);
        let pause = self.progress.pause_ms(now);
        let is_mine = now >= due
            && self
                .next_ms
                .compare_exchange(due, now + pause, Ordering::Relaxed, Ordering::Relaxed)
                .is_ok();
        if is_mine {
            self.write_line(false);
        }
    }

    /// States how many things there are, where that becomes known late.
    pub fn set_total(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    /// Time since the phase started.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    fn write_line(&self, is_final: bool) {
        let state = PhaseState {
            index: self.index,
            count: self.progress.phase_count.load(Ordering::Relaxed),
            name: self.name,
            unit: self.unit,
            done: self.done.load(Ordering::Relaxed),
            total: Some(self.total.load(Ordering::Relaxed)).filter(|&t| t != UNKNOWN),
            seconds: self.start.elapsed().as_secs_f64(),
            is_final,
        };
        if let Some(watch) = &self.progress.watch {
            let PhaseState { name, done, total, is_final, .. } = state;
            watch(ProgressEvent::Phase { name, done, total, is_final });
        }
        match self.progress.mode {
            ProgressMode::Bar => {
                let end = if is_final { "\n" } else { "" };
                self.progress.write(&format!("{}{end}", state.to_line()), !is_final);
            }
            ProgressMode::Plain if !self.progress.is_plain_line_due(self.index) => {}
            ProgressMode::Plain => self.progress.write(&format!("{}\n", state.to_line()), false),
            ProgressMode::Json => self.progress.write(&format!("{}\n", state.to_json()), false),
            ProgressMode::Auto | ProgressMode::None => {}
        }
    }
}

impl Drop for Phase<'_> {
    fn drop(&mut self) {
        self.write_line(true);
    }
}

/// What a line says.
struct PhaseState {
    index: u32,
    count: u32,
    name: &'static str,
    unit: &'static str,
    done: u64,
    total: Option<u64>,
    seconds: f64,
    is_final: bool,
}

impl PhaseState {
    fn rate(&self) -> f64 {
        self.done as f64 / self.seconds.max(1e-3)
    }

    /// Seconds left at the rate so far.
    fn eta_seconds(&self) -> Option<f64> {
        let left = self.total?.saturating_sub(self.done);
        (self.done > 0).then(|| left as f64 / self.rate())
    }

    /// Share done, 0 to 100, rounded down.
    fn percent(&self) -> Option<u64> {
        self.total.filter(|&t| t > 0).map(|t| self.done.min(t) * 100 / t)
    }

    fn to_line(&self) -> String {
        let Self { index, count, name, unit, .. } = self;
        let mut line = format!("[{index}/{count}] {name}");
        if self.done > 0 {
            let (done, rate) = (format_count(self.done as f64), format_count(self.rate()));
            line += &format!("  {done} {unit}  {rate}/s");
        }
        if self.is_final {
            return line + &format!("  {}", format_seconds(self.seconds));
        }
        if let Some(percent) = self.percent() {
            line += &format!("  {percent}%");
        }
        if let Some(eta) = self.eta_seconds() {
            line += &format!("  eta {}", format_seconds(eta));
        }
        line
    }

    fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "phase": self.index,
            "phase_count": self.count,
            "name": self.name,
            "unit": self.unit,
            "done": self.done,
            "total": self.total,
            "percent": self.percent(),
            "per_second": self.rate(),
            "eta_seconds": self.eta_seconds(),
            "seconds": self.seconds,
            "finished": self.is_final,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state() -> PhaseState {
        PhaseState {
            index: 2,
            count: 4,
            name: "sort",
            unit: "surfels",
            done: 1_200_000,
            total: Some(2_400_000),
            seconds: 0.5,
            is_final: false,
        }
    }

    #[test]
    fn lines_state_phase_count_rate_and_what_is_left() {
        assert_eq!(state().to_line(), "[2/4] sort  1.20 M surfels  2.40 M/s  50%  eta 0.50 s");
        let unknown = PhaseState { total: None, ..state() };
        assert_eq!(unknown.to_line(), "[2/4] sort  1.20 M surfels  2.40 M/s");
        let ended = PhaseState { is_final: true, ..state() };
        assert_eq!(ended.to_line(), "[2/4] sort  1.20 M surfels  2.40 M/s  0.50 s");
        let begun = PhaseState { done: 0, ..state() };
        assert_eq!(begun.to_line(), "[2/4] sort  0%");
    }

    #[test]
    fn json_lines_hold_numbers() {
        let json = state().to_json();
        assert_eq!(json["percent"], 50);
        assert_eq!(json["total"], 2_400_000);
        let unknown = PhaseState { total: None, ..state() }.to_json();
        assert!(unknown["eta_seconds"].is_null() && unknown["percent"].is_null());
    }

    #[test]
    fn plain_lines_are_tens_for_hours() {
        let lines_within = |end_ms: u64| {
            let times = std::iter::successors(Some(0), |&now| {
                Some(now + ProgressMode::Plain.pause_ms(now))
            });
            times.skip(1).take_while(|&now| now < end_ms).count()
        };
        assert_eq!(lines_within(1900), 0);
        assert!((3..8).contains(&lines_within(20_000)));
        assert!(lines_within(36_000_000) < 30, "{}", lines_within(36_000_000));
    }

    #[test]
    fn watchers_are_told_of_phases_and_warnings() {
        let told = std::sync::Arc::new(Mutex::new(Vec::new()));
        let kept = std::sync::Arc::clone(&told);
        let progress =
            Progress::watched(move |event| kept.lock().unwrap().push(format!("{event:?}")));
        progress.start_phase("sort", "surfels", Some(4)).set_done(3);
        progress.warn("bright");
        let phase = |done, is_final| {
            let (name, total) = ("sort", Some(4));
            format!("{:?}", ProgressEvent::Phase { name, done, total, is_final })
        };
        let expected = [phase(0, false), phase(3, true), "Warning(\"bright\")".to_owned()];
        assert_eq!(*told.lock().unwrap(), expected);
    }

    #[test]
    fn more_phases_than_announced_are_counted() {
        let progress = Progress::silent();
        for _ in 0..3 {
            progress.start_phase("x", "things", None).set_done(1);
        }
        assert_eq!(progress.phase_count.load(Ordering::Relaxed), 3);
    }
}
