//! Positive numbers of one quantity in 15 bits.

/// Codec of non-negative numbers in 15 bits: 6 bits of exponent, 9 of mantissa, code 0 is zero.
///
/// Codes cover 63 octaves below a largest power of two that the file states, with a relative error of at
/// most 2⁻¹⁰ (`tests::relative_error_is_bounded`); smaller numbers become the smallest code, larger
/// ones the largest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MiniFloat {
    /// All numbers are below 2^`exponent_max`.
    pub exponent_max: i32,
}

impl MiniFloat {
    /// Bits of a code.
    pub const BITS: u32 = 15;

    /// Codec whose largest number is at least `largest`.
    #[must_use]
    pub fn covering(largest: f32) -> Self {
        let exponent_max = if largest.is_finite() && largest > 0.0 {
            (largest.log2().floor() as i32 + 1).clamp(-60, 127)
        } else {
            0
        };
        Self { exponent_max }
    }

    /// Code of `value`, rounded to nearest.
    #[must_use]
    pub fn encode(self, value: f32) -> u16 {
        if !(value > 0.0) {
            return 0;
        }
        // Round the mantissa to 9 bits in the float's own bits; a carry moves into the exponent.
        let rounded = (value.to_bits() + (1 << 13)) >> 14;
        let exponent = (rounded >> 9) as i32 - 127;
        let code = exponent - (self.exponent_max - 64);
        if code < 0 {
            return 1;
        }
        if code > 63 {
            return 0x7fff;
        }
        (((code as u16) << 9) | (rounded & 0x1ff) as u16).max(1)
    }

    /// Number of a code; bit 15 is ignored.
    #[must_use]
    #[inline(always)]
    pub fn decode(self, code: u16) -> f32 {
        let code = u32::from(code & 0x7fff);
        let bits = (code << 14).wrapping_add(((self.exponent_max - 64 + 127) as u32) << 23);
        if code == 0 { 0.0 } else { f32::from_bits(bits) }
    }

    /// What all numbers are below: 2^`exponent_max`.
    #[must_use]
    #[inline(always)]
    pub fn limit(self) -> f32 {
        f32::from_bits(((self.exponent_max + 127) as u32) << 23)
    }

    /// Whether every code of this codec is a finite normal number.
    #[must_use]
    pub fn is_valid(self) -> bool {
        (-60..=127).contains(&self.exponent_max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_error_is_bounded() {
        let codec = MiniFloat::covering(3.0);
        let mut value = 1e-15f32;
        while value < 3.9 {
            let decoded = codec.decode(codec.encode(value));
            assert!((decoded / value - 1.0).abs() <= 1.0 / 1024.0, "{value} {decoded}");
            value *= 1.0137;
        }
    }

    #[test]
    fn every_code_round_trips_in_order() {
        for exponent_max in [-60, -10, 0, 20, 127] {
            let codec = MiniFloat { exponent_max };
            assert!(codec.is_valid());
            let mut last = -1.0;
            for code in 0..=0x7fff {
                let value = codec.decode(code);
                assert!(value.is_finite() && value > last);
                assert_eq!(codec.encode(value), code);
                last = value;
            }
        }
    }

    #[test]
    fn out_of_range_numbers_saturate() {
        let codec = MiniFloat::covering(1.0);
        assert_eq!(codec.encode(1e30), 0x7fff);
        assert_eq!(codec.encode(1e-30), 1);
        assert_eq!(codec.encode(0.0), 0);
        assert_eq!(codec.encode(f32::NAN), 0);
    }
}
