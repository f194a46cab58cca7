//! The environment in the shape the gather reads it.

use pbgi_brdf::EnvironmentTexels;
use pbgi_light::{Environment, EnvironmentPeak, EnvironmentPyramid};
use pbgi_math::Vec3;
use pbgi_raster::{CubeRasterTable, SAMPLE_CELLS, Window};
use std::f32::consts::PI;

/// A peak of the environment: the window its visibility is resolved in, and its light per texel.
#[derive(Clone, Debug)]
pub(crate) struct PreparedPeak {
    pub window: Window,
    /// Width of its texels at distance 1.
    pub texel_width: f32,
    /// Unit direction and radiance times solid angle, row by row.
    pub texels: Vec<(Vec3, [f32; 3])>,
    /// Half-angle's sine of the cone around the window's axis that holds the window.
    pub sin_half_angle: f32,
    /// How many times as wide what is drawn in its window may be as in that of a sun which is all the light there is.
    ///
    /// The error of its light is as its share *f* of all flux times the width *w* of what is drawn, and what is drawn as 1/*w*: the same error as that
    /// of the only sun costs least where *w* is *f*^(−2/3) / √Σ*f*^(2/3), summed over all peaks.
    pub relief: f32,
}

/// An environment prepared for one raster resolution.
#[derive(Clone, Debug)]
pub struct PreparedLight {
    pub(crate) base: EnvironmentTexels,
    pub(crate) peaks: Vec<PreparedPeak>,
    /// For what is seen in reflections, and for importance.
    pub(crate) pyramid: EnvironmentPyramid,
}

/// Texels along a face of the finest raster whose samples see the environment each by itself: those of finer ones are 1.4° wide and less.
const SAMPLED_EDGE_MAX: usize = 32;

/// Texels along a face of the pyramid that reflections show: a third of a degree each.
const REFLECTED_EDGE: usize = 256;

/// The same where only importance asks.
const IMPORTANCE_EDGE: usize = 32;

impl PreparedLight {
    /// Averages the environment over the texels of a raster with `n` texels per face and sets up a
    /// window for each of its peaks.
    #[must_use]
    pub fn new(environment: &Environment, n: usize) -> Self {
        Self::with_detail(environment, n, IMPORTANCE_EDGE)
    }

    /// The same with the detail that glossy receivers reflect: 6 MiB more, and 0.3 s.
    #[must_use]
    pub fn for_reflections(environment: &Environment, n: usize) -> Self {
        Self::with_detail(environment, n, REFLECTED_EDGE)
    }

    fn with_detail(environment: &Environment, n: usize, edge_max: usize) -> Self {
        let table = CubeRasterTable::new(n);
        let pyramid = EnvironmentPyramid::new(environment, edge_max);
        let flux = |peak: &EnvironmentPeak| peak.flux().into_iter().fold(0.0, f32::max);
        let all: f32 = environment.peaks().iter().map(flux).sum();
        let all = all + 4.0 * PI * pyramid.variation().mean;
        let weight = |peak: &EnvironmentPeak| (flux(peak) / all).cbrt().powi(2);
        let error = environment.peaks().iter().map(weight).sum::<f32>().sqrt();
        let peaks = environment.peaks().iter().map(|peak| {
            let texels = (0..peak.n * peak.n).map(|i| {
                let (row, column) = (i / peak.n, i % peak.n);
                let solid_angle = peak.texel_solid_angle(row, column);
                (peak.texel_direction(row, column), peak.texels[i].map(|c| c * solid_angle))
            });
            let half_diagonal = peak.half_width * std::f32::consts::SQRT_2;
            PreparedPeak {
                window: Window::new(peak.frame, peak.half_width, peak.n),
                texel_width: 2.0 * peak.half_width / peak.n as f32,
                texels: texels.collect(),
                sin_half_angle: half_diagonal / (1.0 + half_diagonal * half_diagonal).sqrt(),
                relief: 1.0 / (weight(peak) * error),
            }
        });
        let cells = if n <= SAMPLED_EDGE_MAX { SAMPLE_CELLS * n } else { n };
        Self {
            base: EnvironmentTexels::new(&table, &environment.base_texels(cells)),
            peaks: peaks.collect(),
            pyramid,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_light::{EnvironmentOptions, SkyParameters, synthetic_sky};

    /// Windows of an environment of suns of these irradiances, far from each other, and nothing else.
    fn reliefs(suns: &[f32]) -> Vec<f32> {
        let mut image = synthetic_sky(256, 128, &SkyParameters::default());
        image.pixels.fill([0.0; 3]);
        for (index, sun) in suns.iter().enumerate() {
            image.pixels[64 * 256 + 16 + 40 * index] = [*sun; 3];
        }
        let environment = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
        PreparedLight::new(&environment, 8).peaks.iter().map(|peak| peak.relief).collect()
    }

    #[test]
    fn windows_share_the_error_of_a_single_sun() {
        let one = reliefs(&[100.0]);
        assert!(one.len() == 1 && (one[0] - 1.0).abs() < 1e-3, "{one:?}");
        for suns in [&[50.0, 50.0][..], &[90.0, 10.0], &[5.0, 30.0, 60.0, 5.0]] {
            let mut reliefs = reliefs(suns);
            reliefs.sort_by(f32::total_cmp);
            let mut shares: Vec<f32> =
                suns.iter().map(|sun| sun / suns.iter().sum::<f32>()).collect();
            shares.sort_by(|a, b| b.total_cmp(a));
            let error2: f32 = shares.iter().zip(&reliefs).map(|(f, w)| (f * w).powi(2)).sum();
            assert!(reliefs.len() == suns.len() && (error2 - 1.0).abs() < 0.01, "{reliefs:?}");
            // What is drawn costs as 1/w: it is never more than that of as many single suns.
            assert!(reliefs.iter().all(|w| *w >= 1.0), "{reliefs:?}");
        }
    }
}
