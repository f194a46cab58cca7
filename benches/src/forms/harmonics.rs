//! Forms made of nine spherical harmonics: of each function, of area and luminance with one color, or of a codebook.

use crate::target::{FUNCTIONS, Harmonics, Shown, Sphere};
use pbgi_format::MiniFloat;
use pbgi_math::{SH_COUNT, SharedExponent, luminance};

/// Largest ratio of a coefficient to the first, for any sum of clamped cosines.
const RATIO_MAX: [f32; SH_COUNT - 1] = {
    // √3 · 2/3 for the first band; √5 · 1/4 or √(15/4) · 1/4 for the second.
    const ONE: f32 = 1.154_700_5;
    const SIDE: f32 = 0.484_122_9;
    [ONE, ONE, ONE, SIDE, SIDE, 0.559_017, SIDE, SIDE]
};

/// Coefficients behind the first, over the first; 0 where that is.
pub type Ratios = [f32; SH_COUNT - 1];

pub fn ratios(coefficients: &[f32; SH_COUNT]) -> Ratios {
    let first = coefficients[0];
    std::array::from_fn(|i| if first > 0.0 { coefficients[i + 1] / first } else { 0.0 })
}

/// Ratios rounded to so many bits each.
fn round(ratios: Ratios, bits: u32) -> Ratios {
    let most = ((1u32 << (bits - 1)) - 1) as f32;
    std::array::from_fn(|i| {
        let share = (ratios[i] / RATIO_MAX[i]).clamp(-1.0, 1.0);
        (share * most).round() / most * RATIO_MAX[i]
    })
}

/// A size as the file stores areas.
pub fn round_size(size: f32) -> f32 {
    let codec = MiniFloat::covering(size);
    codec.decode(codec.encode(size))
}

/// A function of the harmonics, never negative.
fn evaluate(first: f32, ratios: &Ratios, basis: &[f32; SH_COUNT]) -> f32 {
    let rest: f32 = ratios.iter().zip(&basis[1..]).map(|(r, y)| r * y).sum();
    (first * (basis[0] + rest)).max(0.0)
}

/// Nine coefficients of each function in 16 bits for the first, `bits` for each of the others.
pub fn show_all(harmonics: &Harmonics, bits: u32, sphere: &Sphere) -> Shown {
    let rounded = harmonics.map(|c| (round_size(c[0]), round(ratios(&c), bits)));
    let show = |basis: &[f32; SH_COUNT]| {
        std::array::from_fn(|f| evaluate(rounded[f].0, &rounded[f].1, basis))
    };
    sphere.basis.iter().map(show).collect()
}

/// The shapes of area and luminance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shapes {
    pub area: Ratios,
    pub light: Ratios,
}

impl Shapes {
    pub fn of(harmonics: &Harmonics) -> Self {
        let [area, r, g, b] = harmonics;
        let light = std::array::from_fn(|i| luminance([r[i], g[i], b[i]]));
        Self { area: ratios(area), light: ratios(&light) }
    }

    pub fn rounded(self, bits: u32) -> Self {
        Self { area: round(self.area, bits), light: round(self.light, bits) }
    }
}

/// Area in 16 bits and the mean radiance in 32, spread as `shapes` say.
pub fn show_shapes(harmonics: &Harmonics, shapes: &Shapes, sphere: &Sphere) -> Shown {
    let area = round_size(harmonics[0][0]);
    let color = mean_radiance(harmonics.map(|c| c[0])).map(|c| c * area);
    let show = |basis: &[f32; SH_COUNT]| {
        let light = evaluate(1.0, &shapes.light, basis);
        let [r, g, b] = color.map(|c| c * light);
        [evaluate(area, &shapes.area, basis), r, g, b]
    };
    sphere.basis.iter().map(show).collect()
}

/// Intensities over area, as the file stores radiance.
pub fn mean_radiance([area, r, g, b]: [f32; FUNCTIONS]) -> [f32; 3] {
    let mean = [r, g, b].map(|c| c / area.max(f32::MIN_POSITIVE));
    let largest = mean.into_iter().fold(f32::MIN_POSITIVE, f32::max);
    // The file's scale makes the largest radiance fit; a power of two changes no mantissa.
    let scale = (largest / 1024.0).log2().ceil().exp2();
    SharedExponent::from_rgb(mean.map(|c| c / scale)).to_rgb().map(|c| c * scale)
}
