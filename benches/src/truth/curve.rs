//! Error against time, and the time an error takes.

use serde::Serialize;

/// One setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// What was set.
    pub setting: String,
    /// Core-microseconds per receiver.
    pub microseconds: f64,
    /// rRMSE.
    pub error: f64,
}

/// Points that no other beats in both time and error, from fast to right.
fn front(points: &[Point]) -> Vec<&Point> {
    let mut sorted: Vec<&Point> = points.iter().collect();
    sorted.sort_by(|a, b| a.microseconds.total_cmp(&b.microseconds));
    let mut best = f64::INFINITY;
    sorted.retain(|p| {
        let better = p.error < best;
        best = best.min(p.error);
        better
    });
    sorted
}

/// Microseconds for an error: between the settings around it, or those of the fastest if that is as good. None where no setting is.
pub fn time_at(points: &[Point], error: f64) -> Option<f64> {
    let front = front(points);
    let at = front.iter().position(|p| p.error <= error)?;
    let fine = front[at];
    let Some(coarse) = at.checked_sub(1).map(|i| front[i]) else {
        return Some(fine.microseconds);
    };
    if fine.error <= 0.0 {
        return Some(fine.microseconds);
    }
    let share = (coarse.error / error).ln() / (coarse.error / fine.error).ln();
    Some(coarse.microseconds * (fine.microseconds / coarse.microseconds).powf(share))
}

/// The same of rays, whose error falls with the root of their number: also beyond the ends of the curve.
pub fn ray_time_at(points: &[Point], error: f64) -> Option<f64> {
    let by_root = |p: &Point| p.microseconds * (p.error / error).powi(2);
    match front(points)[..] {
        [] => None,
        [first, ..] if first.error <= error => Some(by_root(first)),
        [.., last] if last.error > error => Some(by_root(last)),
        _ => time_at(points, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(microseconds: f64, error: f64) -> Point {
        Point { setting: String::new(), microseconds, error }
    }

    #[test]
    fn times_lie_between_settings_that_pay() {
        // The third is slower than the second and no better.
        let points = [point(100.0, 0.02), point(1.0, 0.2), point(50.0, 0.3)];
        assert_eq!(time_at(&points, 0.02), Some(100.0));
        assert!((time_at(&points, 0.04f64.sqrt() * 0.1f64.sqrt()).unwrap() - 10.0).abs() < 1e-9);
        assert_eq!(time_at(&points, 0.5), Some(1.0));
        assert_eq!(time_at(&points, 0.01), None);
        assert_eq!(time_at(&[], 0.01), None);
    }

    #[test]
    fn rays_follow_the_root_beyond_their_curve() {
        let points = [point(4.0, 0.4), point(16.0, 0.1)];
        assert_eq!(ray_time_at(&points, 0.8), Some(1.0));
        assert!((ray_time_at(&points, 0.05).unwrap() - 64.0).abs() < 1e-9);
        assert_eq!(ray_time_at(&points, 0.1), Some(16.0));
        assert!((ray_time_at(&points, 0.2).unwrap() - 8.0).abs() < 1e-9);
        assert_eq!(ray_time_at(&[], 0.1), None);
    }
}
