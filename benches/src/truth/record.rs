//! Runs on record: a table of settings with their times and errors, as `cargo xtask bench-compare` reads it.

use crate::curve::Point;
use anyhow::{Context, Result};
use std::fmt::Write as _;
use std::path::Path;

/// The first line.
const HEADER: &str = "scene,quantity,setting,core_us_per_receiver,rrmse";

/// A file of records that grows by scene and quantity.
pub struct Records(String);

impl Default for Records {
    fn default() -> Self {
        Self(format!("{HEADER}\n"))
    }
}

impl Records {
    /// Adds settings of the engine and counts of paths.
    pub fn add(&mut self, scene: &str, quantity: &str, engine: &[Point], rays: &[Point]) {
        for Point { setting, microseconds, error } in engine.iter().chain(rays) {
            // Settings are told with commas.
            let setting = setting.replace(',', "");
            let _ = writeln!(self.0, "{scene},{quantity},{setting},{microseconds:.2},{error:.5}");
        }
    }

    /// Writes them.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        std::fs::write(path, &self.0).with_context(|| path.display().to_string())
    }
}
