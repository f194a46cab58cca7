//! Long work beside the interpreter: its lock is released, signals and callbacks are seen to by the calling thread.

use pbgi::{EXIT_INPUT, EXIT_INTERRUPTED, EXIT_MISUSED, EXIT_RESOURCES};
use pbgi::{PbgiError, Progress, ProgressEvent};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

mod errors {
    pyo3::import_exception!(pbgi.errors, Error);
    pyo3::import_exception!(pbgi.errors, InputError);
    pyo3::import_exception!(pbgi.errors, UsageError);
    pyo3::import_exception!(pbgi.errors, BudgetError);
    pyo3::import_exception!(pbgi.errors, Interrupted);
}

/// How long the calling thread sleeps between looks at signals.
const LOOK: Duration = Duration::from_millis(50);

/// The exception of an error, by its exit code.
pub fn raise(_: Python<'_>, error: &PbgiError) -> PyErr {
    let text = error.to_string();
    match error.exit_code() {
        EXIT_MISUSED => errors::UsageError::new_err(text),
        EXIT_INPUT => errors::InputError::new_err(text),
        EXIT_RESOURCES => errors::BudgetError::new_err(text),
        EXIT_INTERRUPTED => errors::Interrupted::new_err(text),
        _ => errors::Error::new_err(text),
    }
}

/// What the work has told and Python has not heard yet.
#[derive(Default)]
struct Told {
    /// Phases and the share of each that is done; only the last state of each is kept.
    phases: Vec<(&'static str, f64)>,
    warnings: Vec<String>,
}

impl Told {
    fn note(&mut self, event: ProgressEvent<'_>) {
        match event {
            ProgressEvent::Phase { name, done, total, is_final } => {
                let share = match total {
                    _ if is_final => 1.0,
                    Some(total) if total > 0 => (done as f64 / total as f64).min(1.0),
                    _ => 0.0,
                };
                match self.phases.last_mut().filter(|(last, _)| *last == name) {
                    Some(last) => last.1 = share,
                    None => self.phases.push((name, share)),
                }
            }
            ProgressEvent::Warning(text) => self.warnings.push(text.to_owned()),
            _ => {}
        }
    }
}

/// Gives Python what was told: phases to `callback`, warnings as such. A callback that returns `False` stops the work.
fn pass_on(py: Python<'_>, told: &Mutex<Told>, callback: Option<&Py<PyAny>>) -> PyResult<()> {
    let Told { phases, warnings } =
        std::mem::take(&mut *told.lock().unwrap_or_else(PoisonError::into_inner));
    for text in warnings {
        warn(py, &text)?;
    }
    let Some(callback) = callback else { return Ok(()) };
    for phase in phases {
        let answer = callback.call1(py, phase)?;
        if answer.bind(py).is(pyo3::types::PyBool::new(py, false)) {
            return Err(errors::Interrupted::new_err("the progress callback returned False"));
        }
    }
    Ok(())
}

/// Warns as Python does.
pub fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = CString::new(text.replace('\0', " "))?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 2)
}

/// Runs `work` on a thread of its own, without the interpreter's lock. A signal whose handler raises (Ctrl-C), or an exception of
/// `callback`, stops it and is raised once it has stopped.
pub fn run<T: Send>(
    py: Python<'_>,
    callback: Option<Py<PyAny>>,
    work: impl FnOnce(&Progress, &AtomicBool) -> Result<T, PbgiError> + Send,
) -> PyResult<T> {
    let told = Arc::new(Mutex::new(Told::default()));
    let cancel = AtomicBool::new(false);
    let progress = {
        let told = Arc::clone(&told);
        let note = move |event: ProgressEvent<'_>| {
            told.lock().unwrap_or_else(PoisonError::into_inner).note(event);
        };
        Progress::watched(note)
    };
    let (result, stopped) = py.detach(|| {
        std::thread::scope(|scope| {
            let (sender, receiver) = channel::<()>();
            let (progress, cancel) = (&progress, &cancel);
            let worker = scope.spawn(move || {
                // Dropped at the end, also of a panic.
                let _done = sender;
                work(progress, cancel)
            });
            let mut stopped: Option<PyErr> = None;
            while receiver.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                if stopped.is_some() {
                    continue;
                }
                stopped = Python::attach(|py| {
                    py.check_signals()?;
                    pass_on(py, &told, callback.as_ref())
                })
                .err();
                if stopped.is_some() {
                    cancel.store(true, Ordering::Relaxed);
                }
            }
            let result = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            (result, stopped)
        })
    });
    if let Some(error) = stopped {
        return Err(error);
    }
    let value = result.map_err(|error| raise(py, &error))?;
    pass_on(py, &told, callback.as_ref())?;
    Ok(value)
}
