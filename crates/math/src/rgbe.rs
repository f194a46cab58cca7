//! Non-negative RGB in four bytes with a shared exponent.

/// Three 9-bit mantissas and a 5-bit exponent, as in `EXT_texture_shared_exponent`, with bias 15.
/// Holds 0 and values up to [`SharedExponent::MAX`]; the largest
/// channel, where it is above 2⁻¹⁵, is exact to 1 part in 512.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SharedExponent(pub u32);

impl SharedExponent {
    /// Largest value of a channel.
    pub const MAX: f32 = 65408.0;

    /// Rounds to the nearest representable color; negative and NaN channels become 0, large ones
    /// [`SharedExponent::MAX`].
    #[must_use]
    #[inline]
    pub fn from_rgb(rgb: [f32; 3]) -> Self {
        let rgb = rgb.map(|c| if c > 0.0 { c.min(Self::MAX) } else { 0.0 });
        let largest = rgb[0].max(rgb[1]).max(rgb[2]);
        if largest < 2f32.powi(-25) {
            return Self(0);
        }
        // Exponent e such that largest < 2^(e − 15), kept within 0..=31.
        let mut exponent = ((largest.to_bits() >> 23) as i32 - 127 + 16).clamp(0, 31);
        let quantum = |exponent: i32| f32::from_bits(((exponent - 24 + 127) as u32) << 23);
        if (largest / quantum(exponent)).round() >= 512.0 {
            exponent += 1;
        }
        let scale = 1.0 / quantum(exponent);
        let mantissa = |c: f32| ((c * scale).round() as u32).min(511);
        Self(
            mantissa(rgb[0])
                | (mantissa(rgb[1]) << 9)
                | (mantissa(rgb[2]) << 18)
                | ((exponent as u32) << 27),
        )
    }

    /// The largest channel.
    #[must_use]
    #[inline]
    pub fn largest(self) -> f32 {
        let channel = |shift: u32| (self.0 >> shift) & 511;
        let mantissa = channel(0).max(channel(9)).max(channel(18));
        mantissa as f32 * f32::from_bits(((self.0 >> 27) + 127 - 24) << 23)
    }

    /// The color; finite and non-negative for every bit pattern.
    #[must_use]
    #[inline]
    pub fn to_rgb(self) -> [f32; 3] {
        let scale = f32::from_bits(((self.0 >> 27) + 127 - 24) << 23);
        let channel = |shift: u32| ((self.0 >> shift) & 511) as f32 * scale;
        [channel(0), channel(9), channel(18)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn largest_channel_is_exact_to_one_in_512() {
        let mut value = 4e-5f32;
        while value < SharedExponent::MAX {
            let [r, g, b] = SharedExponent::from_rgb([value, value * 0.5, 0.0]).to_rgb();
            assert!((r / value - 1.0).abs() < 1.0 / 511.0, "{value} {r}");
            assert!((g / value - 0.5).abs() < 1.0 / 511.0);
            assert_eq!(b, 0.0);
            value *= 1.037;
        }
    }

    #[test]
    fn extremes_stay_in_range() {
        assert_eq!(SharedExponent::from_rgb([f32::NAN, -1.0, 0.0]).to_rgb(), [0.0; 3]);
        assert_eq!(SharedExponent::from_rgb([1e30, 0.0, 0.0]).to_rgb()[0], SharedExponent::MAX);
        assert!(SharedExponent(u32::MAX).to_rgb()[0].is_finite());
        let round = SharedExponent::from_rgb([511.7 / 512.0, 0.0, 0.0]).to_rgb()[0];
        assert!((round - 1.0).abs() < 2e-3);
    }
}
