//! Unit vectors in two 16-bit numbers.

use glam::Vec3;

/// Octahedral code of a unit vector, 16 bits per axis, signed and normalized. The angle to the decoded vector stays
/// below 0.004° (`tests::octahedral_error_is_bounded`). Cigolle et al., "A Survey of Efficient
/// Representations for Independent Unit Vectors" (2014).
#[must_use]
#[inline]
pub fn encode_octahedral(unit: Vec3) -> u32 {
    let sum = unit.x.abs() + unit.y.abs() + unit.z.abs();
    let (mut u, mut v) = (unit.x / sum, unit.y / sum);
    if unit.z < 0.0 {
        (u, v) = ((1.0 - v.abs()) * 1f32.copysign(u), (1.0 - u.abs()) * 1f32.copysign(v));
    }
    let quantize = |x: f32| (x * 32767.0).round().clamp(-32767.0, 32767.0) as i16 as u16;
    u32::from(quantize(u)) | (u32::from(quantize(v)) << 16)
}

/// Unit vector of an octahedral code; every code, also one never written, decodes to a unit vector.
#[must_use]
#[inline]
pub fn decode_octahedral(code: u32) -> Vec3 {
    let dequantize = |bits: u32| (f32::from(bits as u16 as i16) / 32767.0).max(-1.0);
    let (u, v) = (dequantize(code), dequantize(code >> 16));
    let z = 1.0 - u.abs() - v.abs();
    let fold = (-z).max(0.0);
    let x = u - fold.copysign(u);
    let y = v - fold.copysign(v);
    Vec3::new(x, y, z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octahedral_error_is_bounded() {
        let mut worst = 0f32;
        for i in 0..100_000u32 {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 100_000.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let unit = Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize();
            worst = worst.max(decode_octahedral(encode_octahedral(unit)).cross(unit).length());
        }
        assert!(worst.to_degrees() < 0.004, "{}°", worst.to_degrees());
    }

    #[test]
    fn axes_are_exact_and_every_code_decodes() {
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
            assert_eq!(decode_octahedral(encode_octahedral(axis)), axis);
        }
        for code in (0..=u32::MAX).step_by(65_537 * 3) {
            assert!((decode_octahedral(code).length() - 1.0).abs() < 1e-5);
        }
    }
}
