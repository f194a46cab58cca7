//! The engine as a Python module: arguments come in as arrays and plain values, the work runs without the interpreter's lock, and what
//! comes back is arrays and JSON. `pbgi/__init__.py` gives it the shape that Python programs see.

mod run;
mod settings;
mod shade;

use crate::run::{raise, run};
use crate::settings::BakeSettings;
use pbgi::{BakeReport, OctreeInfo, PbgiError};
use pyo3::prelude::*;
use serde_json::to_string;
use std::ffi::OsString;
use std::path::PathBuf;

/// Bakes as asked for; the report as JSON.
#[pyfunction]
fn bake(py: Python<'_>, settings: BakeSettings, progress: Option<Py<PyAny>>) -> PyResult<String> {
    let request = settings.request().map_err(|error| raise(py, &error))?;
    let report: BakeReport =
        run(py, progress, |progress, cancel| pbgi::bake(&request, progress, cancel))?;
    json(py, &report)
}

/// What header and page table of an octree file say, as JSON.
#[pyfunction]
fn info(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let read = py.detach(|| OctreeInfo::read(&path, 1 << 30));
    json(py, &read.map_err(|error| raise(py, &error))?)
}

/// Runs the program `pbgi` in this process, which does nothing else; its exit code.
#[pyfunction]
fn run_program(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| pbgi_cli::run(&arguments))
}

fn json(py: Python<'_>, value: &impl serde::Serialize) -> PyResult<String> {
    let failed = |error| PbgiError::failed(format!("the report is no JSON: {error}"));
    to_string(value).map_err(|error| raise(py, &failed(error)))
}

#[pymodule]
fn _pbgi(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(bake, module)?)?;
    module.add_function(wrap_pyfunction!(info, module)?)?;
    module.add_function(wrap_pyfunction!(run_program, module)?)?;
    module.add_function(wrap_pyfunction!(shade::shade, module)?)
}
