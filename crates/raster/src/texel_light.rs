//! The light that pieces shine into a texel.

/// Light of a texel.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct TexelLight {
    /// Σ of radiance × share of the texel, of surfaces that are no lamps.
    radiance: [f32; 3],
    /// Σ of their shares.
    weight: f32,
    /// The same of lamps.
    lamp_radiance: [f32; 3],
    lamp_weight: f32,
}

impl TexelLight {
    /// No light.
    pub const NONE: Self =
        Self { radiance: [0.0; 3], weight: 0.0, lamp_radiance: [0.0; 3], lamp_weight: 0.0 };

    /// Radiance of a texel that is open in part.
    #[inline(always)]
    pub fn as_it_is(&self) -> [f32; 3] {
        std::array::from_fn(|c| self.radiance[c] + self.lamp_radiance[c])
    }

    /// Radiance of a texel that is covered wholly: its surfaces share what lamps leave of it.
    #[inline(always)]
    pub fn made_whole(&self) -> [f32; 3] {
        let rest = crate::larger(1.0 - self.lamp_weight, 0.0);
        let scale = rest / crate::larger(self.weight, 1e-6);
        std::array::from_fn(|c| self.radiance[c] * scale + self.lamp_radiance[c])
    }

    /// Adds a surface that shows this share of the texel.
    #[inline(always)]
    pub fn add(&mut self, share: f32, radiance: &[f32; 3], is_lamp: bool) {
        let (sums, weight) = if is_lamp {
            (&mut self.lamp_radiance, &mut self.lamp_weight)
        } else {
            (&mut self.radiance, &mut self.weight)
        };
        for (sum, light) in sums.iter_mut().zip(radiance) {
            *sum += share * light;
        }
        *weight += share;
    }
}
