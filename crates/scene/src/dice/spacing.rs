//! The spacing that gives a wanted number of surfels.

/// Most evaluations of the count.
const EVALUATIONS_MAX: u32 = 8;

/// How far from the target a count may stay, relative.
const TOLERANCE: f64 = 0.02;

/// Surfels beside one for each triangle, as a share of these, that are there at least: the largest triangles are cut with them, of which some are a hundred
/// times as long as the mean, and a strip of ten meters hides nothing right a meter away. A street's occlusion has an error of 49 % with nothing and with a
/// tenth, 2.2 % with a quarter, 2.1 % with a half and 2.3 % with twice as many surfels as triangles.
const SPARE: f64 = 0.25;

/// A spacing and the count it gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evaluation {
    pub spacing: f64,
    pub count: u64,
}

/// Spacing at which `count` (never rising with the spacing) is within 2 % of `target`, or as near as
/// at most eight evaluations find. Small scenes have few triangles whose counts jump together: not
/// every target can be met.
///
/// Starts at √(`area` / `target`), then interpolates linearly in the logarithms of spacing and of what is more than one surfel per triangle
/// between the nearest known spacings on both sides, or extrapolates as that ∝ spacing⁻².
/// Deterministic. The target is at least one surfel per triangle and a quarter more. An infinite spacing is returned where one surfel per triangle
/// is nearest to that. `count` gives `None` where counting would take too long: no finer spacing is then tried.
pub(super) fn find_spacing(
    target: u64,
    area: f64,
    count: impl Fn(f64) -> Option<u64>,
) -> Evaluation {
    let evaluate = |spacing: f64| Some(Evaluation { spacing, count: count(spacing)? });
    let fewest = evaluate(f64::INFINITY);
    let fewest = fewest.unwrap_or(Evaluation { spacing: f64::INFINITY, count: target });
    if !area.is_normal() {
        return fewest;
    }
    let target = target.max((fewest.count as f64 * (1.0 + SPARE)) as u64).max(1);
    let ratio = |e: Evaluation| e.count.max(1) as f64 / target as f64;
    let error = |e: Evaluation| ratio(e).ln().abs();
    let more_than_fewest = |count: u64| count.saturating_sub(fewest.count).max(1) as f64;
    let more = |e: Evaluation| more_than_fewest(e.count) / more_than_fewest(target);
    let (mut fine, mut coarse): (Option<Evaluation>, Option<Evaluation>) = (None, None);
    let mut best = fewest;
    let mut spacing = (area / target as f64).sqrt();
    let mut too_fine = 0.0f64;
    for _ in 1..EVALUATIONS_MAX {
        // Half way back to what could be counted.
        if spacing <= too_fine {
            spacing = (too_fine * coarse.map_or(4.0 * too_fine, |c| c.spacing)).sqrt();
        }
        let Some(now) = evaluate(spacing) else {
            too_fine = spacing;
            continue;
        };
        let both_none = now.count == 0 && best.count == 0;
        if error(now) < error(best) || both_none {
            best = now;
        }
        if (ratio(now) - 1.0).abs() <= TOLERANCE {
            break;
        }
        *(if ratio(now) > 1.0 { &mut fine } else { &mut coarse }) = Some(now);
        spacing = match (fine, coarse) {
            (Some(f), Some(c)) => {
                let (above, below) = (more(f).ln(), -more(c).ln());
                let both = above + below;
                let t = if both > 0.0 { (above / both).clamp(0.1, 0.9) } else { 0.5 };
                f.spacing * (c.spacing / f.spacing).powf(t)
            }
            _ => now.spacing * more(now).sqrt(),
        };
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_counts_are_met_within_two_percent() {
        for (base, needles) in [(0.0, 0.0), (5e4, 0.0), (1e3, 3e5), (9e4, 1e6)] {
            for target in [100_000u64, 1_000_000, 100_000_000] {
                // Some triangles that never split, some split along one edge, the rest along two.
                let count = |h: f64| (base + needles * (1.0 + 0.01 / h) + 7.0 / (h * h)) as u64;
                if target <= count(f64::INFINITY) {
                    continue;
                }
                let found = find_spacing(target, 10.0, |h| Some(count(h)));
                assert!((found.count as f64 / target as f64 - 1.0).abs() <= 0.02, "{found:?}");
                assert_eq!(found.count, count(found.spacing));
            }
        }
    }

    #[test]
    fn targets_below_the_fewest_cut_the_largest() {
        let found = find_spacing(10, 1.0, |h| Some(1000 + (1.0 / (h * h)) as u64));
        assert!(found.count.abs_diff(1250) <= 25 && found.spacing.is_finite(), "{found:?}");
        // Where all are alike, none is.
        let found = find_spacing(10, 1.0, |h| Some(if h < 0.1 { 24 } else { 12 }));
        assert_eq!(found, Evaluation { spacing: f64::INFINITY, count: 12 });
        assert_eq!(find_spacing(10, 0.0, |_| Some(0)).count, 0);
    }

    #[test]
    fn nothing_finer_is_tried_than_what_can_be_counted() {
        // One in ten thousand is no hole; what is finer than 0.01 takes too long.
        let count = |h: f64| (h >= 0.01).then(|| (1e-4 / (h * h)) as u64);
        let found = find_spacing(1000, 1.0, count);
        assert!(found.spacing >= 0.01 && found.spacing < 0.013, "{found:?}");
        assert_eq!(find_spacing(10, 1.0, |_| Some(0)).count, 0);
        assert!(find_spacing(10, 1.0, |_| None).spacing.is_infinite());
    }

    #[test]
    fn jumps_end_the_search_at_the_nearest_count() {
        let found = find_spacing(100, 1.0, |h| Some(if h < 0.1 { 120 } else { 72 }));
        assert_eq!(found.count, 120);
    }
}
