//! From linear radiance to a pleasant picture.

use pbgi_math::luminance;
use std::convert::Infallible;

/// How linear radiance becomes display color in a preview.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneMap {
    /// Exposure in stops: radiance is multiplied by 2 to this power.
    pub exposure: f32,
    /// Whether highlights roll off along a shoulder; without it they clip at 1.
    pub filmic: bool,
}

impl Default for ToneMap {
    fn default() -> Self {
        Self { exposure: 0.0, filmic: true }
    }
}

/// Below this, [`ToneMap`] is linear.
const SHOULDER_START: f32 = 0.5;
/// How fast highlights beyond the display's range lose their color.
const DESATURATION: f32 = 0.1;

impl ToneMap {
    /// Linear display color in 0..=1 of a linear color; NaN becomes 0.
    ///
    /// With `m` the largest channel after exposure, `s` the shoulder's start (0.5) and `d = 1 − s`,
    /// the filmic curve is `f(m) = m` up to `s` and `1 − d² / (m − s + d)` above: value and slope are
    /// continuous at `s`, and 1 is reached at infinity only. All channels are scaled by `f(m)/m`, so
    /// that hue and saturation hold; then the color moves to white by `1 − 1/(1 + 0.1 (m − f(m)))`,
    /// as film does for light far beyond its range.
    #[must_use]
    pub fn map(&self, rgb: [f32; 3]) -> [f32; 3] {
        let gain = self.exposure.exp2();
        let exposed =
            rgb.map(|c| (c * gain).clamp(0.0, 1e30)).map(|c| if c > 0.0 { c } else { 0.0 });
        if !self.filmic {
            return exposed.map(|c| c.min(1.0));
        }
        let largest = exposed[0].max(exposed[1]).max(exposed[2]);
        if largest <= SHOULDER_START {
            return exposed;
        }
        let d = 1.0 - SHOULDER_START;
        let compressed = 1.0 - d * d / (largest - SHOULDER_START + d);
        let white = 1.0 - 1.0 / (1.0 + DESATURATION * (largest - compressed));
        exposed.map(|c| {
            let hued = c * (compressed / largest);
            hued + (compressed - hued) * white
        })
    }

    /// sRGB bytes of a linear color.
    #[must_use]
    pub fn to_srgb8(&self, rgb: [f32; 3]) -> [u8; 3] {
        self.map(rgb).map(|c| (encode_srgb(c) * 255.0 + 0.5) as u8)
    }
}

/// The transfer function of sRGB (IEC 61966-2-1) for `linear` in 0..=1.
fn encode_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// An exposure in stops that suits a picture: the log-average luminance goes to 0.18, unless that
/// sends the brightest twentieth of the pixels above 4, which then bounds it.
///
/// Only pixels where `mask` is true count (all, without a mask; pixels beyond its end do not), and
/// of these only those that are lit. 0 when none is. Reinhard et al., "Photographic Tone Reproduction for
/// Digital Images" (2002), for the log-average.
#[must_use]
pub fn auto_exposure(rgb: &[[f32; 3]], mask: Option<&[bool]>) -> f32 {
    let counts = |i: usize| mask.is_none_or(|m| m.get(i).copied().unwrap_or(false));
    let stops = auto_exposure_of::<Infallible>(|take| {
        rgb.iter().enumerate().filter(|(i, _)| counts(*i)).for_each(|(_, color)| take(*color));
        Ok(())
    });
    match stops {
        Ok(stops) => stops,
    }
}

/// As [`auto_exposure`], of colors that are not in memory: `pass` hands all that count to the function it is given, and is called
/// twice. Half a MiB is held, whatever their number.
///
/// # Errors
///
/// Those of `pass`.
pub fn auto_exposure_of<E>(
    mut pass: impl FnMut(&mut dyn FnMut([f32; 3])) -> Result<(), E>,
) -> Result<f32, E> {
    // Bits of positive floats are ordered as the floats are: the upper half places a rank in a bucket, the lower half within it.
    let mut buckets = vec![0u64; 1 << 16];
    let (mut sum, mut count) = (0.0, 0u64);
    pass(&mut |color| {
        if let Some(y) = lit_luminance(color) {
            sum += f64::from(y.ln());
            count += 1;
            buckets[(y.to_bits() >> 16) as usize] += 1;
        }
    })?;
    if count == 0 {
        return Ok(0.0);
    }
    let (upper, rank) = bucket_of(&buckets, (count - 1) * 19 / 20);
    buckets.fill(0);
    pass(&mut |color| {
        let bits = lit_luminance(color).map(f32::to_bits).filter(|bits| bits >> 16 == upper);
        if let Some(bits) = bits {
            buckets[(bits & 0xffff) as usize] += 1;
        }
    })?;
    let (lower, _) = bucket_of(&buckets, rank);
    let bright = f32::from_bits(upper << 16 | lower);
    let log_average = (sum / count as f64).exp();
    let gain = (0.18 / log_average).min(4.0 / f64::from(bright));
    Ok(gain.log2() as f32)
}

/// Luminance of a color that is lit.
fn lit_luminance(color: [f32; 3]) -> Option<f32> {
    Some(luminance(color)).filter(|y| y.is_finite() && *y > 0.0)
}

/// The bucket that holds the value of a rank, counted from 0, and the rank within it.
fn bucket_of(counts: &[u64], mut rank: u64) -> (u32, u64) {
    for (bucket, count) in counts.iter().enumerate() {
        if rank < *count {
            return (bucket as u32, rank);
        }
        rank -= count;
    }
    panic!("rank {rank} lies beyond the last value")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_is_monotone_and_smooth_and_stays_in_range() {
        let tone = ToneMap::default();
        let mut last = -1.0;
        for i in 0..20_000 {
            let [r, g, b] = tone.map([i as f32 * 0.01; 3]);
            assert!(r == g && g == b && r > last && r <= 1.0, "{i}: {r} after {last}");
            assert!(i == 0 || r - last < 0.010_01);
            last = r;
        }
        assert_eq!(tone.map([0.4, 0.1, 0.2]), [0.4, 0.1, 0.2]);
    }

    #[test]
    fn hue_holds_in_the_shoulder_and_turns_white_far_beyond() {
        let tone = ToneMap::default();
        let [r, g, b] = tone.map([1.2, 0.6, 0.3]);
        assert!(r < 1.0 && (g / r - 0.5).abs() < 0.05 && (b / r - 0.25).abs() < 0.05);
        let [r, _, b] = tone.map([1e5, 4e4, 1e4]);
        assert!(r > 0.99 && b > 0.99);
    }

    #[test]
    fn odd_values_stay_in_range() {
        for filmic in [false, true] {
            let tone = ToneMap { exposure: 3.0, filmic };
            for c in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, f32::MAX] {
                assert!(tone.map([c, 0.5, 0.0]).iter().all(|c| (0.0..=1.0).contains(c)), "{c}");
            }
        }
    }

    #[test]
    fn srgb_bytes_match_known_values() {
        let linear = ToneMap { exposure: 0.0, filmic: false };
        assert_eq!(linear.to_srgb8([0.0, 0.5, 1.0]), [0, 188, 255]);
        assert_eq!(linear.to_srgb8([0.214_041, 0.003_035, 2.0]), [127, 10, 255]);
    }

    #[test]
    fn exposure_brings_the_log_average_to_middle_gray() {
        let pixels = [[0.5f32; 3], [2.0; 3], [0.0; 3], [1e6; 3]];
        let mask = [true, true, true, false];
        let stops = auto_exposure(&pixels, Some(&mask));
        assert!((stops.exp2() - 0.18).abs() < 1e-4);
        assert_eq!(auto_exposure(&[[0.0; 3]], None), 0.0);
        let mut night = vec![[0.001f32; 3]; 90];
        night.extend([[1.0; 3]; 10]);
        assert!((auto_exposure(&night, None).exp2() - 4.0).abs() < 1e-3);
    }

    /// The rank by sorting, and the sum of a list.
    fn exposure_by_sorting(pixels: &[[f32; 3]]) -> f32 {
        let mut lit: Vec<f32> = pixels.iter().map(|p| luminance(*p)).collect();
        lit.retain(|y| y.is_finite() && *y > 0.0);
        let Some(last) = lit.len().checked_sub(1) else { return 0.0 };
        let sum: f64 = lit.iter().map(|y| f64::from(y.ln())).sum();
        let average = (sum / lit.len() as f64).exp();
        lit.sort_by(f32::total_cmp);
        (0.18 / average).min(4.0 / f64::from(lit[last * 19 / 20])).log2() as f32
    }

    #[test]
    fn exposure_without_a_list_is_that_of_the_sorted_list() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state
        };
        for count in [0, 1, 2, 19, 20, 21, 1000, 30_000] {
            // Any bits at all, and colors that differ in the last ones, bright enough for the rank to tell.
            let wild: Vec<[f32; 3]> =
                (0..count).map(|_| [0; 3].map(|_: i32| f32::from_bits(random()))).collect();
            let near: Vec<[f32; 3]> = (0..count)
                .map(|i| if i % 9 == 0 { 1e3 + (random() >> 16) as f32 * 1e-2 } else { 1e-4 })
                .map(|y| [y; 3])
                .collect();
            for pixels in [wild, near] {
                let expected = exposure_by_sorting(&pixels).to_bits();
                assert_eq!(auto_exposure(&pixels, None).to_bits(), expected, "{count}");
            }
        }
        let failing = auto_exposure_of(|_| Err("broken"));
        assert_eq!(failing, Err("broken"));
    }
}
