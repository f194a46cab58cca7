//! How far what a form shows is from what the surfels show.

use crate::target::{FUNCTIONS, Shown};
use serde::Serialize;

/// Errors of one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeErrors {
    /// Root of the mean squared error over all directions, over the mean.
    pub area: f64,
    /// The same of all three channels together; none where the node is black.
    pub flux: Option<f64>,
}

impl NodeErrors {
    /// Both at once: the root of their mean square.
    pub fn combined(self) -> f64 {
        match self.flux {
            Some(flux) => (0.5 * (self.area.powi(2) + flux.powi(2))).sqrt(),
            None => self.area,
        }
    }
}

/// Errors of a form that shows `shown` where `exact` is right.
pub fn errors(shown: &Shown, exact: &Shown) -> NodeErrors {
    let relative = |functions: std::ops::Range<usize>| {
        let (mut squares, mut sum, mut count) = (0f64, 0f64, 0f64);
        for (a, b) in shown.iter().zip(exact) {
            for f in functions.clone() {
                squares += f64::from(a[f] - b[f]).powi(2);
                sum += f64::from(b[f]);
                count += 1.0;
            }
        }
        (sum > 0.0).then(|| (squares / count).sqrt() / (sum / count))
    };
    NodeErrors { area: relative(0..1).unwrap_or(0.0), flux: relative(1..FUNCTIONS) }
}

/// Errors over many nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Root of the mean squared error.
    pub rrmse: f64,
    /// What the error exceeds in a hundredth of the weight only.
    pub p99: f64,
}

impl Spread {
    /// Over pairs of weight and error.
    pub fn of(mut errors: Vec<(f64, f64)>) -> Self {
        errors.sort_by(|a, b| a.1.total_cmp(&b.1));
        let total: f64 = errors.iter().map(|e| e.0).sum();
        let squares: f64 = errors.iter().map(|(weight, e)| weight * e * e).sum();
        let mut below = 0.0;
        let p99 = errors.iter().find(|e| {
            below += e.0;
            below >= 0.99 * total
        });
        Self {
            rrmse: (squares / total.max(f64::MIN_POSITIVE)).sqrt(),
            p99: p99.map_or(0.0, |e| e.1),
        }
    }
}
