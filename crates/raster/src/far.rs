//! What lies far away, as seen from a few places, blended for a receiver between them.

use crate::lanes::SAMPLES;
use crate::samples::run;
use crate::table::LANES;

/// Most places whose far fields are blended: the corners of a rectangle, or of a tetrahedron.
pub const FAR_PLACES_MAX: usize = 4;

/// Numbers of light per texel: three channels, and its moment along u and v.
pub(crate) const FAR_PLANES: usize = 5;

/// What a place sees beyond some distance: covered samples and light of each texel, in the layout of a [`CubeRaster`](crate::CubeRaster).
#[derive(Clone, Debug, Default)]
pub struct FarField {
    masks: Vec<u16>,
    /// Radiance, weighted by the share of the texel that shows it, and Σ of brightness × share × place in the texel. Empty without light.
    planes: [Vec<f32>; FAR_PLANES],
}

impl FarField {
    pub(crate) fn resize(&mut self, texels: usize, shines: bool) {
        self.masks.resize(texels, 0);
        for plane in &mut self.planes {
            plane.resize(if shines { texels } else { 0 }, 0.0);
        }
    }

    #[inline(always)]
    pub(crate) fn set(
        &mut self,
        start: usize,
        masks: &[u16; LANES],
        light: &[[f32; LANES]; FAR_PLANES],
    ) {
        self.masks[start..start + LANES].copy_from_slice(masks);
        if !self.planes[0].is_empty() {
            for (plane, light) in self.planes.iter_mut().zip(light) {
                plane[start..start + LANES].copy_from_slice(light);
            }
        }
    }

    /// Bytes of the far field of a raster with so many texels in memory.
    #[must_use]
    pub fn bytes(texels: usize) -> usize {
        texels * (size_of::<u16>() + FAR_PLANES * size_of::<f32>())
    }
}

/// Patterns in which samples are dealt out among places; texels of a row take them in turn.
const PATTERNS: usize = 16;

/// Far fields of some places, blended: light by weight; of the samples, each takes the coverage of one place, as many of a texel as its weight
/// says, so that what is blended is still covered or open.
#[derive(Clone, Debug)]
pub struct FarBlend<'a> {
    fields: &'a [FarField],
    weights: [f32; FAR_PLACES_MAX],
    /// Samples that each place decides, by pattern, twice in a row.
    deals: [[u16; 2 * PATTERNS]; FAR_PLACES_MAX],
}

impl<'a> FarBlend<'a> {
    /// A blend of at most [`FAR_PLACES_MAX`] fields by weights that sum to 1.
    ///
    /// # Panics
    ///
    /// If there are more fields than that.
    #[must_use]
    #[inline(always)]
    pub fn new(fields: &'a [FarField], weights: [f32; FAR_PLACES_MAX]) -> Self {
        assert!(fields.len() <= FAR_PLACES_MAX, "at most four places");
        let mut deals = [[0; 2 * PATTERNS]; FAR_PLACES_MAX];
        for pattern in 0..PATTERNS {
            // The rounding differs from pattern to pattern, so that on the mean over texels weights are exact.
            let round =
                ((pattern * 7) % PATTERNS) as f32 * (1.0 / PATTERNS as f32) + 0.5 / PATTERNS as f32;
            let (mut end, mut before) = (0.0f32, 0);
            for place in 0..fields.len() {
                end += weights[place];
                let is_last = place + 1 == fields.len();
                let until = if is_last { SAMPLES } else { (end * SAMPLES as f32 + round) as usize };
                let until = until.clamp(before, SAMPLES);
                let deal = run(pattern, until) & !run(pattern, before);
                deals[place][pattern] = deal;
                deals[place][pattern + PATTERNS] = deal;
                before = until;
            }
        }
        Self { fields, weights, deals }
    }

    #[inline(always)]
    pub(crate) fn shines(&self) -> bool {
        self.fields.first().is_some_and(|field| !field.planes[0].is_empty())
    }

    /// Covered samples of the texels from `start` on.
    #[inline(always)]
    pub(crate) fn masks(&self, start: usize) -> [u16; LANES] {
        let first = (start / LANES * 5) % PATTERNS;
        let mut blended = [0; LANES];
        for (field, deal) in self.fields.iter().zip(&self.deals) {
            let (masks, deal) = (&field.masks[start..start + LANES], &deal[first..first + LANES]);
            for lane in 0..LANES {
                blended[lane] |= masks[lane] & deal[lane];
            }
        }
        blended
    }

    /// Light of the texels from `start` on, of which these shares come through.
    #[inline(always)]
    pub(crate) fn planes(
        &self,
        start: usize,
        through: &[f32; LANES],
    ) -> [[f32; LANES]; FAR_PLANES] {
        let mut blended = [[0.0f32; LANES]; FAR_PLANES];
        for (field, weight) in self.fields.iter().zip(&self.weights) {
            for (sum, plane) in blended.iter_mut().zip(&field.planes) {
                let plane = &plane[start..start + LANES];
                for lane in 0..LANES {
                    sum[lane] += weight * plane[lane];
                }
            }
        }
        for plane in &mut blended {
            for lane in 0..LANES {
                plane[lane] *= through[lane];
            }
        }
        blended
    }

    /// The same as radiance of three channels and where in the texel it comes from.
    #[inline(always)]
    pub(crate) fn light(
        &self,
        start: usize,
        through: &[f32; LANES],
    ) -> ([[f32; LANES]; 3], [[f32; LANES]; 2]) {
        let [r, g, b, mut u, mut v] = self.planes(start, through);
        for lane in 0..LANES {
            let brightness = crate::larger(r[lane] + g[lane] + b[lane], f32::MIN_POSITIVE);
            u[lane] /= brightness;
            v[lane] /= brightness;
        }
        ([r, g, b], [u, v])
    }
}
