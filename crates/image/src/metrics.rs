//! Distance of a result from a reference.

/// Errors over all receivers and channels. With r the reference and x the result, both divided by
/// the mean of r (one factor for all channels), so that the reference's mean is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorMetrics {
    /// Relative root mean square error, `√mean((x − r)² / (r² + 0.01))`.
    pub rrmse: f64,
    /// `mean(x − r)`: 0.01 means one percent too bright.
    pub bias: f64,
    /// Median of `|x − r| / (r + 0.01)`.
    pub p50: f64,
    /// 95th percentile of the same.
    pub p95: f64,
    /// 99th percentile of the same: shows leaks and missing contact shadows.
    pub p99: f64,
    /// Largest of the same.
    pub max: f64,
    /// Mean of the reference before scaling, in its own unit.
    pub reference_mean: f64,
}

/// Why two sets of values cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MetricsError {
    /// The sets differ in length.
    #[error(
        "the result has {result} values, the reference {reference}; compare the same receivers"
    )]
    Lengths {
        /// Values of the result.
        result: usize,
        /// Values of the reference.
        reference: usize,
    },
    /// A value is infinite or not a number.
    #[error(
        "value {index} is {result} in the result and {reference} in the reference, expected finite values"
    )]
    NotFinite {
        /// Index of the first such value.
        index: usize,
        /// The result there.
        result: f32,
        /// The reference there.
        reference: f32,
    },
    /// The reference has no mean to scale by.
    #[error("the mean of the reference is {mean}, expected more than 0; compare lit receivers")]
    DarkReference {
        /// The mean; 0 without values.
        mean: f64,
    },
}

/// Compares all values, channels interleaved or not: `result[i]` with `reference[i]`. Percentiles
/// interpolate between ranks.
///
/// # Errors
///
/// [`MetricsError`] for sets of different length, values that are not finite, and references whose
/// mean is not above 0.
pub fn compare(result: &[f32], reference: &[f32]) -> Result<ErrorMetrics, MetricsError> {
    let mean = reference_mean(result, reference)?;
    let count = reference.len() as f64;
    let scaled = || scaled(result, reference, mean);
    let squares: f64 = scaled().map(squared_error).sum();
    let differences: f64 = scaled().map(|(x, r)| x - r).sum();
    let mut relative: Vec<f64> = scaled().map(|(x, r)| (x - r).abs() / (r + 0.01)).collect();
    relative.sort_unstable_by(f64::total_cmp);
    Ok(ErrorMetrics {
        rrmse: (squares / count).sqrt(),
        bias: differences / count,
        p50: percentile(&relative, 0.50),
        p95: percentile(&relative, 0.95),
        p99: percentile(&relative, 0.99),
        max: percentile(&relative, 1.0),
        reference_mean: mean,
    })
}

/// The squared relative error of every value, `(x − r)² / (r² + 0.01)`: their mean is the square of [`ErrorMetrics::rrmse`].
///
/// # Errors
///
/// As [`compare`].
pub fn squared_errors(result: &[f32], reference: &[f32]) -> Result<Vec<f64>, MetricsError> {
    let mean = reference_mean(result, reference)?;
    Ok(scaled(result, reference, mean).map(squared_error).collect())
}

/// Pairs of result and reference over the reference's mean.
fn scaled(result: &[f32], reference: &[f32], mean: f64) -> impl Iterator<Item = (f64, f64)> {
    let pairs = result.iter().zip(reference);
    pairs.map(move |(x, r)| (f64::from(*x) / mean, f64::from(*r) / mean))
}

fn squared_error((x, r): (f64, f64)) -> f64 {
    (x - r) * (x - r) / (r * r + 0.01)
}

/// The mean of the reference, if the two can be compared.
fn reference_mean(result: &[f32], reference: &[f32]) -> Result<f64, MetricsError> {
    if result.len() != reference.len() {
        let (result, reference) = (result.len(), reference.len());
        return Err(MetricsError::Lengths { result, reference });
    }
    let pairs = || result.iter().zip(reference);
    if let Some(index) = pairs().position(|(x, r)| !(x.is_finite() && r.is_finite())) {
        let (result, reference) = (result[index], reference[index]);
        return Err(MetricsError::NotFinite { index, result, reference });
    }
    let count = reference.len().max(1) as f64;
    let mean = reference.iter().map(|r| f64::from(*r)).sum::<f64>() / count;
    if mean <= 0.0 {
        return Err(MetricsError::DarkReference { mean });
    }
    Ok(mean)
}

/// Value at `fraction` of the way through `sorted`, which is not empty.
fn percentile(sorted: &[f64], fraction: f64) -> f64 {
    let place = fraction * (sorted.len() - 1) as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_sets_have_no_error() {
        let metrics = compare(&[1.0, 2.0, 0.0], &[1.0, 2.0, 0.0]).unwrap();
        assert_eq!((metrics.rrmse, metrics.bias, metrics.p99, metrics.max), (0.0, 0.0, 0.0, 0.0));
        assert_eq!(metrics.reference_mean, 1.0);
    }

    /// References 0 and 4 have the mean 2, so r = (0, 2) and x = (0.5, 2.5).
    #[test]
    fn formulas_match_a_case_by_hand() {
        let metrics = compare(&[1.0, 5.0], &[0.0, 4.0]).unwrap();
        let expected = ((0.25 / 0.01 + 0.25 / 4.01) / 2.0f64).sqrt();
        assert!((metrics.rrmse - expected).abs() < 1e-12);
        let squares = squared_errors(&[1.0, 5.0], &[0.0, 4.0]).unwrap();
        assert_eq!(squares, [0.25 / 0.01, 0.25 / 4.01]);
        assert!((metrics.bias - 0.5).abs() < 1e-12);
        let (low, high) = (0.5 / 2.01, 0.5 / 0.01);
        assert!((metrics.p50 - (low + high) / 2.0).abs() < 1e-9);
        assert!((metrics.p99 - (low + (high - low) * 0.99)).abs() < 1e-9);
        assert!((metrics.max - high).abs() < 1e-9);
    }

    #[test]
    fn scaling_both_changes_nothing() {
        let (x, r) = ([0.2f32, 0.9, 1.7], [0.25f32, 1.0, 1.5]);
        let (a, b) = (compare(&x, &r), compare(&x.map(|v| v * 8.0), &r.map(|v| v * 8.0)));
        let (a, b) = (a.unwrap(), b.unwrap());
        assert!((a.rrmse - b.rrmse).abs() < 1e-12 && (a.bias - b.bias).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_compared_is_an_error() {
        assert!(matches!(compare(&[1.0], &[]), Err(MetricsError::Lengths { .. })));
        assert!(matches!(compare(&[], &[]), Err(MetricsError::DarkReference { .. })));
        assert!(matches!(compare(&[1.0], &[0.0]), Err(MetricsError::DarkReference { .. })));
        let nan = compare(&[1.0, f32::NAN], &[1.0, 1.0]);
        assert!(matches!(nan, Err(MetricsError::NotFinite { index: 1, .. })));
    }
}
