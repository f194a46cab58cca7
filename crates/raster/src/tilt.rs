//! How a cosine varies over a texel.

use crate::samples::{divisor, offset_sum};
use pbgi_math::larger;

/// How something varies over a texel: relative to its mean above the horizon, and linear.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tilt {
    /// In the texel's middle.
    middle: f32,
    /// From there to the border along u and v.
    slope: [f32; 2],
}

impl Tilt {
    /// For what is `middle` in a texel's middle and `reach` more at its borders along u and v.
    #[inline(always)]
    pub fn new(middle: f32, reach: [f32; 2], above: u16) -> Self {
        let sum = offset_sum(above);
        let count = divisor(above);
        let mean = middle + (reach[0] * sum[0] + reach[1] * sum[1]) / count;
        // Where the horizon leaves a corner, what is linear may not be positive there.
        let least = 0.1 * (reach[0].abs() + reach[1].abs()) + 1e-6;
        let inverse = 1.0 / larger(mean, least);
        let slope = reach.map(|r| r * inverse);
        let middle = 1.0 - (slope[0] * sum[0] + slope[1] * sum[1]) / count;
        Self { middle, slope }
    }

    /// At a place of the texel, −1..=1 from border to border.
    #[inline(always)]
    pub fn at(&self, place: [f32; 2]) -> f32 {
        larger(self.middle + self.slope[0] * place[0] + self.slope[1] * place[1], 0.0)
    }

    /// On the mean over samples.
    #[inline(always)]
    pub fn mean(&self, samples: u16) -> f32 {
        let inverse = 1.0 / divisor(samples);
        self.at(offset_sum(samples).map(|sum| sum * inverse))
    }
}

/// What light weighs in the parts of a texel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TexelTilt {
    /// The cosine: for pieces that count by their own solid angle.
    pub cosine: Tilt,
    /// The cosine times a sample's solid angle: for pieces that count by samples.
    pub sample: Tilt,
}

impl TexelTilt {
    /// For a texel with its middle at (u, v) on a face. There, n·D is `height`, and changes by `slope` times what u and v change.
    #[inline(always)]
    pub fn new(height: f32, slope: [f32; 2], [u, v]: [f32; 2], half: f32, above: u16) -> Self {
        // The cosine is n·D/|D|, and a sample's solid angle goes as 1/|D|³.
        let fall = height / (1.0 + u * u + v * v);
        let reach = |power: f32| {
            let fall = power * fall;
            [(slope[0] - fall * u) * half, (slope[1] - fall * v) * half]
        };
        Self {
            cosine: Tilt::new(height, reach(1.0), above),
            sample: Tilt::new(height, reach(4.0), above),
        }
    }
}
