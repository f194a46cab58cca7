//! A case with its measured error, and whether its promise is kept.

use pbgi_testkit::hard::{HardCase, Refusal};
use std::fmt;

/// What was measured.
pub struct Measured {
    pub case: HardCase,
    /// The error, or why there is none.
    pub error: Result<f64, Refusal>,
}

/// What comes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The error is within the promise.
    Kept,
    /// It is not, as is known, and no worse than it was.
    KnownLimit,
    /// A known limit is within the promise today.
    LimitMet,
    /// It is not, or a known limit is worse than it was.
    Broken,
}

impl Measured {
    pub fn new(case: HardCase, error: Result<f64, Refusal>) -> Self {
        Self { case, error }
    }

    pub fn verdict(&self) -> Verdict {
        let Ok(error) = self.error else { return Verdict::Broken };
        match self.case.limit {
            None if error <= self.case.promise => Verdict::Kept,
            Some(_) if error <= self.case.promise => Verdict::LimitMet,
            Some(limit) if error <= limit.today => Verdict::KnownLimit,
            _ => Verdict::Broken,
        }
    }

    /// What is left of the promise, as a share of it; below 0 where it is not kept. All of a promise of 0 is left where it is kept.
    pub fn margin(&self) -> Option<f64> {
        let error = *self.error.as_ref().ok()?;
        let left = self.case.promise - error;
        Some(if left == 0.0 { 0.0 } else { left / self.case.promise })
    }

    pub fn shown_error(&self) -> String {
        self.error.as_ref().map_or("refused".into(), |error| show(*error))
    }

    pub fn shown_margin(&self) -> String {
        match self.margin() {
            Some(0.0) if self.case.promise == 0.0 => "exact".into(),
            Some(margin) if margin.is_finite() => format!("{:.0} %", 100.0 * margin),
            _ => "none".into(),
        }
    }
}

/// An error in two digits, rounded up.
pub fn show(error: f64) -> String {
    if error == 0.0 || !error.is_finite() {
        return format!("{error}");
    }
    let unit = 10f64.powi(error.log10().floor() as i32 - 1);
    let rounded = (error / unit - 1e-9).ceil() * unit;
    if rounded < 1e-4 {
        format!("{rounded:.1e}")
    } else {
        format!("{}", (rounded * 1e6).round() / 1e6)
    }
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, promise) = (self.case.name, show(self.case.promise));
        let (error, margin) = (self.shown_error(), self.shown_margin());
        write!(f, "{name:<24} {promise:>10} {error:>10} {margin:>8}  ")?;
        match (self.verdict(), &self.case.limit, &self.error) {
            (Verdict::Kept, ..) => write!(f, "kept"),
            (Verdict::KnownLimit, Some(limit), _) => {
                write!(f, "known limit, {} at most", show(limit.today))
            }
            (Verdict::LimitMet, ..) => {
                write!(f, "kept, though listed as a known limit: take it off the list")
            }
            (_, _, Err(refusal)) => {
                write!(f, "BROKEN: ended with {}: {}", refusal.exit_code, refusal.message)
            }
            (_, Some(limit), _) => write!(f, "BROKEN: worse than {}", show(limit.today)),
            _ => write!(f, "BROKEN"),
        }
    }
}
