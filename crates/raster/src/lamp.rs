//! What a cube raster sees of lamps.

use pbgi_math::larger;

/// Lamps that are told apart by number, and one more number for all others.
pub const LAMPS: usize = 33;

/// The number of lamps that have none of their own.
pub const NO_LAMP: u8 = (LAMPS - 1) as u8;

/// What is seen of a lamp.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LampSeen {
    /// Irradiance from what shows of it, W·m⁻².
    pub irradiance: [f32; 3],
    /// The same of all channels together from what was drawn of it, if nothing hid it.
    pub drawn: f32,
    /// Whether any sample in its texels is hidden from its plane by what is no lamp.
    is_hidden: bool,
    /// Whether any sample in its texels is not hidden from its plane.
    is_open: bool,
    /// Whether a part of it was too large to be seen as one of a lamp.
    is_large: bool,
}

impl LampSeen {
    /// Whether the edge of something may cut it: what hides its plane ends in one of its texels. Not where a part of it was too large: that has
    /// shone into texels.
    #[must_use]
    #[inline(always)]
    pub fn may_be_cut(&self) -> bool {
        self.is_hidden && self.is_open && !self.is_large
    }

    /// Notes a part that shines into texels.
    #[inline(always)]
    pub(crate) fn note_large(&mut self) {
        self.is_large = true;
    }

    /// Notes a texel by its samples: those above the horizon, those that something hides from the lamp's plane, and those that lamps cover.
    #[inline(always)]
    pub(crate) fn note(&mut self, above: u16, hidden: u16, of_lamps: u16) {
        self.is_hidden |= above & hidden & !of_lamps != 0;
        self.is_open |= above & !hidden != 0;
    }

    /// Notes what a part that is drawn shines if nothing hides it.
    #[inline(always)]
    pub(crate) fn note_drawn(&mut self, weight: f32, radiance: &[f32; 3]) {
        self.drawn += larger(weight, 0.0) * (radiance[0] + radiance[1] + radiance[2]);
    }

    /// Adds irradiance.
    #[inline(always)]
    pub(crate) fn add(&mut self, weight: f32, radiance: &[f32; 3]) {
        for (sum, light) in self.irradiance.iter_mut().zip(radiance) {
            *sum += weight * light;
        }
    }
}
