//! The light that pieces shine into a texel.

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
    /// The light of lamps, where it is kept here.
    lamps: [f32; 3],
    /// Σ of brightness × share × place in the texel, where light keeps its place.
    moment: [f32; 2],
}

impl TexelLight {
    /// No light.
    pub const NONE: Self = Self {
        radiance: [0.0; 3],
        weight: 0.0,
        lamp_weight: 0.0,
        lamps: [0.0; 3],
        moment: [0.0; 2],
    };

    /// Radiance of a texel that is covered wholly: its surfaces share what lamps leave of it.
    #[inline(always)]
    pub fn made_whole(&self) -> [f32; 3] {
        let rest = crate::larger(1.0 - self.lamp_weight, 0.0);
        let scale = rest / crate::larger(self.weight, 1e-6);
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
    pub fn add_lamp(&mut self, share: f32) {
        self.lamp_weight += share;
    }

    /// Adds a surface, perhaps a lamp, that shows this share of the texel at this place of it, −1..=1 from border to border.
    #[inline(always)]
    pub fn add_at(&mut self, share: f32, radiance: &[f32; 3], place: [f32; 2], is_lamp: bool) {
        if is_lamp {
            self.add_lamp(share);
            for (sum, light) in self.lamps.iter_mut().zip(radiance) {
                *sum += share * light;
            }
        } else {
            self.add(share, radiance);
        }
        let brightness = share * radiance.iter().sum::<f32>();
        for (sum, place) in self.moment.iter_mut().zip(place) {
            *sum += brightness * place;
        }
    }

    /// Light as a [`FarField`](crate::FarField) keeps it: three channels and its moment along u and v.
    #[inline(always)]
    pub fn spread(&self, is_whole: bool) -> [f32; 5] {
        let own = if is_whole { self.made_whole() } else { self.radiance };
        let before = self.radiance.iter().chain(&self.lamps).sum::<f32>();
        let all: [f32; 3] = std::array::from_fn(|c| own[c] + self.lamps[c]);
        let scale = all.iter().sum::<f32>() / crate::larger(before, f32::MIN_POSITIVE);
        let [u, v] = self.moment.map(|moment| moment * scale);
        [all[0], all[1], all[2], u, v]
    }
}
