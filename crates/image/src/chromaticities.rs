//! Primaries and white of colors, and the way to those of Rec. 709.

use pbgi_math::{DMat3, DVec3};

/// Where red, green, blue and white lie in the CIE xy diagram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chromaticities {
    /// The primaries: red, green, blue.
    pub primaries: [[f32; 2]; 3],
    /// White.
    pub white: [f32; 2],
}

impl Chromaticities {
    /// Those of Rec. ITU-R BT.709, the working space of the engine: what colors without chromaticities are in.
    pub const REC_709: Self =
        Self { primaries: [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06]], white: [0.3127, 0.329] };

    /// Those of CIE XYZ.
    pub const XYZ: Self =
        Self { primaries: [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], white: [1.0 / 3.0, 1.0 / 3.0] };

    /// Whether both are the same, to the digits that files round to.
    #[must_use]
    pub fn is_near(&self, other: &Self) -> bool {
        let values = |c: &Self| [c.primaries[0], c.primaries[1], c.primaries[2], c.white].concat();
        values(self).iter().zip(values(other)).all(|(a, b)| (a - b).abs() < 2e-3)
    }

    /// The matrix from colors of these chromaticities to linear Rec. 709. Whites that differ are adapted by Bradford's method; XYZ are
    /// values, not colors under a white, and are not. `None` if there is none: primaries in a line, or a white without luminance.
    ///
    /// Rec. SMPTE RP 177; Bradford as in ICC.1.
    #[must_use]
    pub fn to_rec_709(&self) -> Option<DMat3> {
        let own = self.to_xyz()?;
        let target = Self::REC_709;
        let adapted = match self.is_near(&Self::XYZ) {
            true => DMat3::IDENTITY,
            false => adapt_white(xyz_of(self.white), xyz_of(target.white)),
        };
        let matrix = target.to_xyz()?.inverse() * adapted * own;
        matrix.is_finite().then_some(matrix)
    }

    fn to_xyz(self) -> Option<DMat3> {
        let [r, g, b] = self.primaries.map(|[x, y]| {
            let (x, y) = (f64::from(x), f64::from(y));
            DVec3::new(x, y, 1.0 - x - y)
        });
        let columns = DMat3::from_cols(r, g, b);
        if !(columns.determinant().abs() > 1e-6) || !(self.white[1] > 1e-3) {
            return None;
        }
        let scales = columns.inverse() * xyz_of(self.white);
        let matrix = columns * DMat3::from_diagonal(scales);
        matrix.is_finite().then_some(matrix)
    }
}

/// XYZ of the luminance 1.
fn xyz_of([x, y]: [f32; 2]) -> DVec3 {
    let (x, y) = (f64::from(x), f64::from(y));
    DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

fn adapt_white(from: DVec3, to: DVec3) -> DMat3 {
    let cones = DMat3::from_cols(
        DVec3::new(0.8951, -0.7502, 0.0389),
        DVec3::new(0.2664, 1.7135, -0.0685),
        DVec3::new(-0.1614, 0.0367, 1.0296),
    );
    cones.inverse() * DMat3::from_diagonal((cones * to) / (cones * from)) * cones
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: DVec3, expected: [f64; 3], tolerance: f64) {
        assert!((found - DVec3::from_array(expected)).abs().max_element() < tolerance, "{found}");
    }

    #[test]
    fn rec_709_is_itself() {
        let matrix = Chromaticities::REC_709.to_rec_709().unwrap();
        near(matrix * DVec3::new(0.2, 0.5, 0.9), [0.2, 0.5, 0.9], 1e-12);
    }

    #[test]
    fn xyz_are_the_values_of_the_standard() {
        // Rec. 709 red, green and blue in XYZ, by its annex.
        for (xyz, rgb) in [
            ([0.412_391, 0.212_639, 0.019_331], [1.0, 0.0, 0.0]),
            ([0.357_584, 0.715_169, 0.119_195], [0.0, 1.0, 0.0]),
            ([0.180_481, 0.072_192, 0.950_532], [0.0, 0.0, 1.0]),
        ] {
            let matrix = Chromaticities::XYZ.to_rec_709().unwrap();
            near(matrix * DVec3::from_array(xyz), rgb, 1e-4);
        }
    }

    #[test]
    fn white_stays_white() {
        // ACES 2065-1, and ACEScg.
        let ap0 = Chromaticities {
            primaries: [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077]],
            white: [0.321_68, 0.337_67],
        };
        let ap1 = Chromaticities {
            primaries: [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044]],
            white: [0.321_68, 0.337_67],
        };
        for space in [ap0, ap1] {
            near(space.to_rec_709().unwrap() * DVec3::ONE, [1.0; 3], 1e-6);
        }
        // Red of ACEScg by the published matrix (Bradford, D60 to D65).
        let red = ap1.to_rec_709().unwrap() * DVec3::X;
        near(red, [1.705_05, -0.130_26, -0.024_00], 2e-3);
    }

    #[test]
    fn nonsense_has_no_matrix() {
        for (primaries, white) in [
            ([[0.3, 0.3]; 3], [0.3127, 0.329]),
            (Chromaticities::REC_709.primaries, [0.3, 0.0]),
            (Chromaticities::REC_709.primaries, [f32::NAN, 0.3]),
            ([[f32::INFINITY, 0.0], [0.3, 0.6], [0.15, 0.06]], [0.3, 0.3]),
        ] {
            assert!(Chromaticities { primaries, white }.to_rec_709().is_none());
        }
    }
}
