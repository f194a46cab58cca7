//! Errors, times and factors of a quantity of a case: as lines, JSON and plots.

use crate::cases::{Case, Light, Quantity};
use crate::curve::{Point, ray_time_at, time_at};
use crate::paths::{RayCurve, Truth, without_noise};
use anyhow::Result;
use pbgi_benches::Line;
use pbgi_image::compare;
use serde::Serialize;
use std::fmt::{self, Write as _};

/// Above the lines that rows print.
pub const HEADER: &str = "\
core-us per receiver at default settings; rays: how many times as long they take for the same error; at 10, 5, 2 %: core-us of engine and rays, and how many
times as long rays take
scene            quantity       rRMSE   noise     bias      p95      p99       us     rays |   10 %                    |    5 %                    |    2 %";

/// Errors at which times are told.
pub const ERRORS: [f64; 3] = [0.1, 0.05, 0.02];

/// A quantity of a case.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub scene: String,
    #[serde(skip)]
    pub of: Quantity,
    pub quantity: &'static str,
    pub receivers: usize,
    /// Paths per receiver of the truth, and its rRMSE.
    pub paths: u32,
    pub noise: f64,
    /// Of the default settings, without the truth's noise; bias and percentiles have it in them.
    pub rrmse: f64,
    pub bias: f64,
    pub p95: f64,
    pub p99: f64,
    pub microseconds: f64,
    /// Settings of the engine, the default first, and counts of paths.
    pub engine: Vec<Point>,
    pub rays: Vec<Point>,
    pub times: Vec<Times>,
}

/// Core-microseconds per receiver for an error, where it is reached.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Times {
    pub error: f64,
    pub engine: Option<f64>,
    pub rays: Option<f64>,
}

impl Times {
    pub fn at(error: f64, engine: &[Point], rays: &[Point]) -> Self {
        Self { error, engine: time_at(engine, error), rays: ray_time_at(rays, error) }
    }

    /// How many times as long rays take.
    pub fn factor(&self) -> Option<f64> {
        Some(self.rays? / self.engine?)
    }

    /// Both, and the factor, as text.
    pub fn short(&self) -> [String; 3] {
        [self.engine, self.rays, self.factor()].map(short)
    }
}

impl Row {
    /// Compares runs of the engine, the first at default settings, and rays with the truth.
    ///
    /// # Errors
    ///
    /// If values are not finite, or the truth is dark.
    pub fn new(
        case: &Case,
        quantity: Quantity,
        truth: &Truth,
        runs: &[(String, Vec<Light>, f64)],
        rays: Option<&RayCurve>,
    ) -> Result<Self> {
        let (expected, noise) = (quantity.values(&truth.light), truth.noise(quantity)?);
        let mut engine = Vec::new();
        for (setting, found, microseconds) in runs {
            let error = compare(&quantity.values(found), &expected)?.rrmse;
            let (setting, microseconds) = (setting.clone(), *microseconds);
            engine.push(Point { setting, microseconds, error: without_noise(error, noise) });
        }
        let rays = rays.map(|rays| rays.points(quantity, truth)).transpose()?.unwrap_or_default();
        let plain = compare(&quantity.values(&runs[0].1), &expected)?;
        Ok(Self {
            scene: case.name.clone(),
            of: quantity,
            quantity: quantity.name(),
            receivers: truth.light.len(),
            paths: truth.paths,
            noise,
            rrmse: engine[0].error,
            bias: plain.bias,
            p95: plain.p95,
            p99: plain.p99,
            microseconds: engine[0].microseconds,
            times: ERRORS.iter().map(|e| Times::at(*e, &engine, &rays)).collect(),
            engine,
            rays,
        })
    }

    /// How many times as long rays take for the error of the default settings.
    pub fn factor(&self) -> Option<f64> {
        Some(ray_time_at(&self.rays, self.rrmse)? / self.microseconds)
    }
}

/// A number in so few digits that its size is seen, or a dash.
pub fn short(value: Option<f64>) -> String {
    match value {
        None => "-".to_owned(),
        Some(v) if v >= 10.0 => format!("{v:.0}"),
        Some(v) if v >= 1.0 => format!("{v:.1}"),
        Some(v) => format!("{v:.2}"),
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:16} {:10} {:6.2} % {:5.2} % {:+6.2} % {:6.1} % {:6.1} % {:8.0} {:>8}",
            self.scene,
            self.quantity,
            self.rrmse * 100.0,
            self.noise * 100.0,
            self.bias * 100.0,
            self.p95 * 100.0,
            self.p99 * 100.0,
            self.microseconds,
            short(self.factor()),
        )?;
        self.times.iter().try_for_each(|t| {
            let [engine, rays, factor] = t.short();
            write!(f, " | {engine:>7} {rays:>8} {factor:>8}")
        })
    }
}

/// Errors at default settings, in Markdown.
pub fn error_table(rows: &[Row]) -> String {
    let mut out = String::from(
        "| scene | quantity | rRMSE | bias | p95 | p99 | noise of the truth | core-µs | rays, times as long |\n|---|---|---|---|---|---|---|---|---|",
    );
    for row in rows {
        let _ = write!(
            out,
            "\n| {} | {} | {:.1} % | {:+.1} % | {:.0} % | {:.0} % | {:.1} % | {:.0} | {} |",
            row.scene,
            row.quantity,
            row.rrmse * 100.0,
            row.bias * 100.0,
            row.p95 * 100.0,
            row.p99 * 100.0,
            row.noise * 100.0,
            row.microseconds,
            short(row.factor()),
        );
    }
    out
}

/// Core-microseconds of engine and rays at [`ERRORS`], in Markdown.
pub fn time_table(rows: &[Row]) -> String {
    let mut out = String::from("| scene | quantity |");
    for error in ERRORS {
        let _ = write!(out, " engine, {0:.0} % | rays, {0:.0} % | factor |", error * 100.0);
    }
    let _ = write!(out, "\n|---|---|{}", "---|".repeat(3 * ERRORS.len()));
    for row in rows {
        let _ = write!(out, "\n| {} | {} |", row.scene, row.quantity);
        for times in &row.times {
            let [engine, rays, factor] = times.short();
            let _ = write!(out, " {engine} | {rays} | {factor} |");
        }
    }
    out
}

/// One plot per row: the engine and rays.
pub fn plot(rows: &[Row]) -> String {
    let line = |row: &Row, label: &str, points: &[Point]| {
        let mut points: Vec<(f64, f64)> =
            points.iter().filter(|p| p.error > 0.0).map(|p| (p.microseconds, p.error)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Line { plot: format!("{} {}", row.scene, row.quantity), label: label.to_owned(), points }
    };
    let lines = rows
        .iter()
        .flat_map(|row| [line(row, "engine", &row.engine), line(row, "rays", &row.rays)]);
    let lines: Vec<Line> = lines.filter(|l| !l.points.is_empty()).collect();
    pbgi_benches::plot(&lines, "relative RMSE against core-us per receiver")
}
