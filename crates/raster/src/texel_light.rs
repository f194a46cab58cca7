//! The light that pieces shine into a texel.

use crate::tilt::TexelTilt;
use pbgi_math::larger;

/// Light of a texel.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct TexelLight {
    /// Σ of radiance × share of the texel, of surfaces that are no lamps.
    pub radiance: [f32; 3],
    /// Σ of their shares.
    weight: f32,
    /// Σ of the shares of lamps, whose light is not in `radiance`.
    lamp_weight: f32,
    /// Σ of radiance × share of the texel, of lamps.
    pub lamp_radiance: [f32; 3],
    /// What light weighs in its parts.
    pub tilt: TexelTilt,
}

impl TexelLight {
    /// No light.
    #[inline(always)]
    pub fn new(tilt: TexelTilt) -> Self {
        let [radiance, lamp_radiance] = [[0.0; 3]; 2];
        Self { radiance, weight: 0.0, lamp_weight: 0.0, lamp_radiance, tilt }
    }

    /// Radiance of a texel that is covered wholly, by backs to this share: its other surfaces share what lamps and backs leave of it.
    #[inline(always)]
    pub fn made_whole(&self, backs: f32) -> [f32; 3] {
        let rest = larger(1.0 - self.lamp_weight - backs, 0.0);
        let scale = rest / larger(self.weight, 1e-6);
        self.radiance.map(|sum| sum * scale)
    }

    /// Adds a surface that shows this share of the texel.
    #[inline(always)]
    pub fn add(&mut self, share: f32, radiance: &[f32; 3]) {
        for (sum, light) in self.radiance.iter_mut().zip(radiance) {
            *sum += share * light;
        }
        self.weight += share;
    }

    /// Takes this share of the texel for a lamp.
    #[inline(always)]
    pub fn add_lamp(&mut self, share: f32, radiance: &[f32; 3]) {
        for (sum, light) in self.lamp_radiance.iter_mut().zip(radiance) {
            *sum += share * light;
        }
        self.lamp_weight += share;
    }
}
