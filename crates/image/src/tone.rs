//! From linear radiance to a pleasant picture.

use pbgi_math::luminance;

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
    let mut luminances: Vec<f32> = rgb
        .iter()
        .enumerate()
        .filter(|(i, _)| counts(*i))
        .map(|(_, p)| luminance(*p))
        .filter(|y| y.is_finite() && *y > 0.0)
        .collect();
    if luminances.is_empty() {
        return 0.0;
    }
    let sum: f64 = luminances.iter().map(|y| f64::from(y.ln())).sum();
    let log_average = (sum / luminances.len() as f64).exp();
    let rank = (luminances.len() - 1) * 19 / 20;
    let (_, bright, _) = luminances.select_nth_unstable_by(rank, f32::total_cmp);
    let gain = (0.18 / log_average).min(4.0 / f64::from(*bright));
    gain.log2() as f32
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
}
