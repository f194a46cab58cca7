//! A clear late-afternoon sky made from formulas.

use crate::lat_long::LatLong;
use pbgi_image::RgbImage;
use pbgi_math::Vec3;
use rayon::prelude::*;

/// What [`synthetic_sky`] paints. Radiance in W·m⁻²·sr⁻¹, linear Rec. 709; +Y is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyParameters {
    /// Direction to the sun, of any length but 0.
    pub sun_direction: Vec3,
    /// Angular radius of the sun's disk in degrees.
    pub sun_angular_radius: f32,
    /// Irradiance in W·m⁻² on a surface that faces the sun; 0 leaves the disk out.
    pub sun_irradiance: [f32; 3],
    /// Radiance straight up.
    pub zenith: [f32; 3],
    /// Radiance at the horizon, away from the sun.
    pub horizon: [f32; 3],
    /// Radiance from below the horizon.
    pub ground: [f32; 3],
    /// Radiance the sun's side of the sky has in addition, where it is strongest.
    pub glow: [f32; 3],
}

impl Default for SkyParameters {
    /// A sun 18° above the horizon, 10⁵ times the sky's typical radiance of 0.3.
    fn default() -> Self {
        Self {
            sun_direction: Vec3::new(0.62, 0.325, -0.71),
            sun_angular_radius: 0.265,
            sun_irradiance: [2.65, 1.95, 1.15],
            zenith: [0.085, 0.17, 0.39],
            horizon: [0.50, 0.44, 0.37],
            ground: [0.075, 0.062, 0.050],
            glow: [0.85, 0.46, 0.16],
        }
    }
}

impl SkyParameters {
    /// Radiance of the sky without the sun's disk, from the unit direction `d`, with `sun` the unit
    /// direction of the sun.
    ///
    /// With y the height of `d` and γ its angle to the sun: the gradient is
    /// `horizon + (zenith − horizon)(1 − (1 − y)³)`; the glow is the sum of a wide lobe
    /// `0.55 e^{4 (cos γ − 1)}`, which fades with height as `0.25 + 0.75 (1 − y)²`, and an aureole
    /// `0.45 e^{90 (cos γ − 1)}`. A logistic step 1.5° wide at the horizon leads to the ground.
    fn radiance(&self, d: Vec3, sun: Vec3) -> [f32; 3] {
        let above = 1.0 / (1.0 + (-d.y / 0.012).exp());
        let y = d.y.clamp(0.0, 1.0);
        let low = 1.0 - y;
        let gradient = 1.0 - low * low * low;
        let offset = d.dot(sun) - 1.0;
        let wide = 0.55 * (4.0 * offset).exp() * (0.25 + 0.75 * low * low);
        let glow = wide + 0.45 * (90.0 * offset).exp();
        [0, 1, 2].map(|k| {
            let sky = self.horizon[k] + (self.zenith[k] - self.horizon[k]) * gradient;
            self.ground[k] + (sky + self.glow[k] * glow - self.ground[k]) * above
        })
    }
}

/// Paints an equirectangular sky: gradient, warm glow around the sun, ground, and the sun's disk.
///
/// The disk is uniform; each pixel holds its share of it by area, scaled so that the irradiance of a
/// surface facing the sun is exactly `sun_irradiance` at every size. Cost: one pass over the pixels
/// on all threads, 0.1 s at 2048 × 1024. Results do not depend on the number of threads.
///
/// # Panics
///
/// If `width` or `height` is 0, or the sun's direction is the zero vector.
#[must_use]
pub fn synthetic_sky(width: usize, height: usize, parameters: &SkyParameters) -> RgbImage {
    assert!(width > 0 && height > 0, "a sky needs pixels");
    let sun = parameters.sun_direction.try_normalize();
    let sun = sun.expect("the sun's direction must not be the zero vector");
    let grid = LatLong::new(width, height, [Vec3::X, Vec3::Y, Vec3::Z]);
    let horizontals: Vec<Vec3> = (0..width).map(|c| grid.horizontal(c as f64 + 0.5)).collect();
    let mut pixels = vec![[0.0; 3]; width * height];
    pixels.par_chunks_mut(width).enumerate().for_each(|(row, pixels)| {
        let (sin, cos) = grid.polar(row as f64 + 0.5);
        for (pixel, horizontal) in pixels.iter_mut().zip(&horizontals) {
            *pixel = parameters.radiance(*horizontal * sin + Vec3::new(0.0, cos, 0.0), sun);
        }
    });
    add_sun(&grid, &mut pixels, parameters, sun);
    RgbImage { width, height, pixels }
}

/// Parts per axis into which pixels at the sun are divided to find how much of them it covers.
const SUN_PARTS: usize = 16;

fn add_sun(grid: &LatLong, pixels: &mut [[f32; 3]], parameters: &SkyParameters, sun: Vec3) {
    let radius = parameters.sun_angular_radius.max(1e-3).to_radians();
    // A pixel's corner is at most this far from its center.
    let reach = radius + 1.5 * grid.row_angle().max(std::f32::consts::TAU / grid.width as f32);
    let chord = 2.0 * (radius * 0.5).sin();
    let mut covered = Vec::new();
    let mut facing = 0.0;
    grid.visit_near(sun, reach.min(0.7), |index| {
        let (column, row) = (index % grid.width, index / grid.width);
        let part = |i: usize| (i as f64 + 0.5) / SUN_PARTS as f64;
        let inside = (0..SUN_PARTS * SUN_PARTS).filter(|i| {
            let u = column as f64 + part(i % SUN_PARTS);
            let v = row as f64 + part(i / SUN_PARTS);
            (grid.direction(u, v) - sun).length_squared() <= chord * chord
        });
        let share = inside.count() as f32 / (SUN_PARTS * SUN_PARTS) as f32;
        if share > 0.0 {
            let weight = grid.solid_angle(row) * f64::from(grid.center(index).dot(sun));
            facing += weight * f64::from(share);
            covered.push((index, share));
        }
    });
    if covered.is_empty() {
        // A sun smaller than a part of a pixel: all of it is in one pixel.
        let at = grid.coordinates(sun);
        let (column, row) = (at.x as usize % grid.width, (at.y as usize).min(grid.height - 1));
        let index = row * grid.width + column;
        facing = grid.solid_angle(row) * f64::from(grid.center(index).dot(sun));
        covered.push((index, 1.0));
    }
    for (index, share) in covered {
        for (channel, irradiance) in pixels[index].iter_mut().zip(parameters.sun_irradiance) {
            *channel += (f64::from(irradiance * share) / facing) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Environment, EnvironmentOptions};
    use pbgi_math::luminance;

    #[test]
    fn sun_adds_its_irradiance_at_every_size() {
        let parameters = SkyParameters::default();
        let dark = SkyParameters { sun_irradiance: [0.0; 3], ..parameters };
        let sun = parameters.sun_direction.normalize();
        for width in [64, 250, 1024, 2048] {
            let facing = |p: &SkyParameters| {
                let image = synthetic_sky(width, width / 2, p);
                let options = EnvironmentOptions { peaks: false, ..Default::default() };
                Environment::from_image(image, options).unwrap().irradiance(sun)
            };
            let (with, without) = (facing(&parameters), facing(&dark));
            for k in 0..3 {
                let found = with[k] - without[k];
                // A pixel's mean direction is shorter than 1: 4e-4 at 64 columns.
                assert!(
                    (found / parameters.sun_irradiance[k] - 1.0).abs() < 1e-3,
                    "{width} {found}"
                );
            }
        }
    }

    #[test]
    fn suns_at_the_pole_and_the_seam_are_complete() {
        for direction in
            [Vec3::Y, Vec3::NEG_Z, Vec3::new(1e-4, 1.0, 0.0), Vec3::new(0.0, 0.3, -1.0)]
        {
            let parameters = SkyParameters { sun_direction: direction, ..Default::default() };
            let image = synthetic_sky(512, 256, &parameters);
            let environment =
                Environment::from_image(image, EnvironmentOptions::default()).unwrap();
            assert_eq!(environment.peaks().len(), 1, "{direction}");
            let flux = environment.peaks()[0].flux()[0];
            // The aureole inside the window is part of the peak.
            assert!(
                (flux / parameters.sun_irradiance[0] - 1.0).abs() < 2e-3,
                "{direction}: {flux}"
            );
        }
    }

    #[test]
    fn sun_outshines_the_sky_a_hundred_thousand_times() {
        let start = std::time::Instant::now();
        let image = synthetic_sky(2048, 1024, &SkyParameters::default());
        println!("2048 x 1024 sky: {:?}", start.elapsed());
        let mut values: Vec<f32> = image.pixels.iter().map(|p| luminance(*p)).collect();
        values.sort_by(f32::total_cmp);
        let typical = values[values.len() * 3 / 4];
        let ratio = values[values.len() - 1] / typical;
        assert!((5e4..2e5).contains(&ratio), "{ratio}");
        assert!(values[0] > 0.0);
    }
}
