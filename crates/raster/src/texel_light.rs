//! The light that pieces shine into a texel.

/// Least share of a texel with which a piece counts for what its rest looks like.
const MAIN_SHARE: f32 = 0.02;

/// Mean brightness over that of the dimmest piece up to which a texel counts as one surface without lamps.
const EVEN: f32 = 2.0;

/// Light of a texel.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct TexelLight {
    /// Σ of radiance × share of the texel.
    pub radiance: [f32; 3],
    /// Σ of shares.
    weight: f32,
    /// Radiance of the dimmest piece, and the sum of its channels; that is negative at first.
    dimmest: [f32; 3],
    brightness: f32,
}

impl TexelLight {
    /// No light.
    pub const NONE: Self =
        Self { radiance: [0.0; 3], weight: 0.0, dimmest: [0.0; 3], brightness: -1.0 };

    /// Radiance of a texel that is covered wholly, with shares that sum to one.
    #[inline(always)]
    pub fn made_whole(&self) -> [f32; 3] {
        let inverse = 1.0 / crate::larger(self.weight, 1e-6);
        let mean = self.radiance.map(|sum| sum * inverse);
        if self.brightness < 0.0 {
            // No piece is large enough to take an excess from.
            return if self.weight > 1.0 { self.radiance } else { mean };
        }
        if mean[0] + mean[1] + mean[2] <= EVEN * self.brightness {
            return mean;
        }
        let missing = 1.0 - self.weight;
        std::array::from_fn(|c| crate::larger(self.radiance[c] + missing * self.dimmest[c], 0.0))
    }

    #[inline(always)]
    pub fn add(&mut self, share: f32, radiance: &[f32; 3]) {
        for (sum, light) in self.radiance.iter_mut().zip(radiance) {
            *sum += share * light;
        }
        self.weight += share;
        let brightness = radiance[0] + radiance[1] + radiance[2];
        if share > MAIN_SHARE && (brightness < self.brightness || self.brightness < 0.0) {
            (self.dimmest, self.brightness) = (*radiance, brightness);
        }
    }
}
