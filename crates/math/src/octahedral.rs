//! Unit vectors in two small numbers.

use glam::Vec3;

/// Octahedral code of a unit vector, 16 bits per axis, signed and normalized. The angle to the decoded vector stays
/// below 0.004° (`tests::octahedral_error_is_bounded`). Cigolle et al., "A Survey of Efficient
/// Representations for Independent Unit Vectors" (2014).
#[must_use]
#[inline(always)] // Loops over many become vector code only where it is inlined.
pub fn encode_octahedral(unit: Vec3) -> u32 {
    let sum = unit.x.abs() + unit.y.abs() + unit.z.abs();
    let (mut u, mut v) = (unit.x / sum, unit.y / sum);
    if unit.z < 0.0 {
        (u, v) = ((1.0 - v.abs()) * 1f32.copysign(u), (1.0 - u.abs()) * 1f32.copysign(v));
    }
    let quantize = |x: f32| round_small(x * 32767.0).clamp(-32767, 32767) as u16;
    u32::from(quantize(u)) | (u32::from(quantize(v)) << 16)
}

/// `x.round()` of numbers below 2²¹, without calls and conversions that keep loops over it from becoming vector code.
/// The sum with a large number has the whole number nearest to `x`, ties to even, in its lowest bits.
#[inline(always)]
fn round_small(x: f32) -> i32 {
    const LARGE: f32 = 12_582_912.0;
    let whole = (x + LARGE).to_bits().wrapping_sub(LARGE.to_bits()) as i32;
    let rest = x - whole as f32;
    whole.wrapping_add(i32::from((rest == 0.5) & (x > 0.0))) - i32::from((rest == -0.5) & (x < 0.0))
}

/// Unit vector of an octahedral code; every code, also one never written, decodes to a unit vector.
#[must_use]
#[inline]
pub fn decode_octahedral(code: u32) -> Vec3 {
    let dequantize = |bits: u32| (f32::from(bits as u16 as i16) / 32767.0).max(-1.0);
    unfold(dequantize(code), dequantize(code >> 16))
}

#[inline]
fn unfold(u: f32, v: f32) -> Vec3 {
    let z = 1.0 - u.abs() - v.abs();
    let fold = (-z).max(0.0);
    let x = u - fold.copysign(u);
    let y = v - fold.copysign(v);
    Vec3::new(x, y, z).normalize()
}

/// Angle, in radians, by which a unit vector's code of 24 bits is off at most: 0.07°.
pub const OCTAHEDRAL24_ERROR: f32 = 1.25e-3;

/// The same of a code of 20 bits: 0.25°.
pub const OCTAHEDRAL20_ERROR: f32 = 4.4e-3;

/// Octahedral code of a unit vector in 24 bits, 12 per axis. The angle to the decoded vector stays below 0.07°
/// (`tests::octahedral_error_is_bounded`).
#[must_use]
#[inline(always)] // As above.
pub fn encode_octahedral24(unit: Vec3) -> u32 {
    let wide = encode_octahedral(unit);
    let narrow = |bits: u32| {
        let x = f32::from(bits as u16 as i16) * (2047.0 / 32767.0);
        (round_small(x) as u32) & 0xfff
    };
    narrow(wide) | (narrow(wide >> 16) << 12)
}

/// Unit vector of a 24-bit octahedral code; every code decodes to a unit vector.
#[must_use]
#[inline]
pub fn decode_octahedral24(code: u32) -> Vec3 {
    // The sign of the 12-bit numbers moves to bit 31 and back.
    let dequantize = |bits: u32| ((((bits << 20) as i32) >> 20) as f32 * (1.0 / 2047.0)).max(-1.0);
    unfold(dequantize(code), dequantize(code >> 12))
}

/// The 20-bit code, 10 bits per axis, nearest to a 24-bit one. The angle between the vectors stays below 0.25°
/// (`tests::octahedral_error_is_bounded`).
#[must_use]
#[inline]
pub fn narrow_octahedral24(code: u32) -> u32 {
    let narrow = |bits: u32| {
        let wide = (((bits << 20) as i32) >> 20).max(-2047);
        // To nearest, away from 0 in the middle: the sign makes no difference.
        let rounded = (wide.abs() * 511 + 1023) / 2047;
        (if wide < 0 { -rounded } else { rounded }) as u32 & 0x3ff
    };
    narrow(code) | narrow(code >> 12) << 10
}

/// Unit vector of a 20-bit octahedral code; every code decodes to a unit vector.
#[must_use]
#[inline(always)]
pub fn decode_octahedral20(code: u32) -> Vec3 {
    let dequantize = |bits: u32| ((((bits << 22) as i32) >> 22) as f32 * (1.0 / 511.0)).max(-1.0);
    unfold(dequantize(code), dequantize(code >> 10))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octahedral_error_is_bounded() {
        let (mut worst, mut worst24, mut worst20) = (0f32, 0f32, 0f32);
        for i in (0..100_000u32).step_by(if cfg!(miri) { 100 } else { 1 }) {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 100_000.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let unit = Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize();
            worst = worst.max(decode_octahedral(encode_octahedral(unit)).cross(unit).length());
            let code = encode_octahedral24(unit);
            let narrow = decode_octahedral24(code);
            worst24 = worst24.max(narrow.cross(unit).length());
            let narrower = decode_octahedral20(narrow_octahedral24(code));
            worst20 = worst20.max(narrower.cross(narrow).length());
        }
        assert!(worst.to_degrees() < 0.004, "{}°", worst.to_degrees());
        assert!(worst24.to_degrees() < 0.07, "{}°", worst24.to_degrees());
        assert!(worst20.to_degrees() < 0.25, "{}°", worst20.to_degrees());
    }

    #[test]
    fn small_numbers_are_rounded_away_from_zero_at_halves() {
        let next = |x: f32, up: i32| f32::from_bits((x.to_bits() as i32 + up) as u32);
        for half in -70_000..=70_000 {
            for up in -2..=2 {
                let x = next(half as f32 * 0.5, up);
                if x.is_finite() {
                    assert_eq!(round_small(x), x.round() as i32, "{x}");
                }
            }
        }
    }

    #[test]
    fn axes_are_exact_and_every_code_decodes() {
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            assert_eq!(decode_octahedral(encode_octahedral(axis)), axis);
            assert_eq!(decode_octahedral24(encode_octahedral24(axis)), axis);
            assert_eq!(decode_octahedral20(narrow_octahedral24(encode_octahedral24(axis))), axis);
        }
        for code in (0..=u32::MAX).step_by(65_537 * 3) {
            assert!((decode_octahedral(code).length() - 1.0).abs() < 1e-5);
            assert!((decode_octahedral24(code >> 8).length() - 1.0).abs() < 1e-5);
            assert!((decode_octahedral20(code >> 12).length() - 1.0).abs() < 1e-5);
        }
    }
}
