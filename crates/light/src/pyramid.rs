//! The environment at every coarseness: a cube map and its means over ever larger texels.

use crate::Environment;
use pbgi_math::{CubeFace, CubeMap, Vec3};
use std::f32::consts::PI;

/// Share of an averaged solid angle that a texel of the level used for it may have: smaller texels follow its outline better.
const TEXEL_SHARE: f32 = 0.25;

/// Radiance of an environment without its peaks, averaged over solid angles of any size.
///
/// Levels halve in edge down to one texel per face; a texel's radiance is the mean of the four below it, weighted by their exact solid
/// angles, so that all levels have the flux of the image without peaks.
#[derive(Clone, Debug)]
pub struct EnvironmentPyramid {
    /// Texels in the order of [`CubeMap`], finest level first.
    levels: Vec<(CubeMap, Vec<[f32; 3]>)>,
    /// Largest brightness of each texel of a level and the eight around it, on whichever face they lie.
    brightest: Vec<Vec<f32>>,
    variation: Variation,
}

/// How much an environment varies, as far as nodes of a cut can tell; the same however it is turned, but for where texels lie.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Variation {
    /// Mean brightness over the sphere, W·m⁻²·sr⁻¹.
    pub mean: f32,
    /// Brightness *B* at which nodes may be as large as under an even sky, W·m⁻²·sr⁻¹.
    ///
    /// Where nodes have the solid angle ω = *u* (*b*/*B*)^(−2/3) at the brightness *b*, the squared error of the light they hide is the mean
    /// of *L*² ω², and it is that of an even sky of the same mean with ω = *u* where *B*^(2/3) = mean(*L*) / √mean(*L*² *b*^(−4/3)).
    pub usual: f32,
    /// How many times as many nodes of one size take for the same error: √mean(*L*²) / (mean(*b*^(2/3)) √mean(*L*² *b*^(−4/3))).
    pub gain: f32,
}

impl Variation {
    /// Of texels of this solid angle, mean brightness *L*, and brightness *b* they count for.
    fn new(texels: impl Iterator<Item = [f32; 3]>) -> Self {
        let mut sums = [0.0f64; 5];
        for texel in texels {
            let [solid_angle, light, counted] = texel.map(f64::from);
            // What is black needs no nodes.
            let inverse = if counted > 0.0 { counted.powf(-2.0 / 3.0) } else { 0.0 };
            let error2 = (light * inverse).powi(2);
            let terms = [1.0, light, light * light, counted.powf(2.0 / 3.0), error2];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum += solid_angle * term;
            }
        }
        let [all, light, light2, work, error2] = sums;
        if light <= 0.0 {
            return Self { gain: 1.0, ..Self::default() };
        }
        let (mean, error) = (light / all, (error2 / all).sqrt());
        Self {
            mean: mean as f32,
            usual: (mean / error).powf(1.5) as f32,
            gain: ((light2 / all).sqrt() / (work / all * error)) as f32,
        }
    }
}

/// Texels along a face of the level at which variation is found: of 0.03 sr, about what nodes are.
const VARIATION_EDGE: usize = 8;

impl EnvironmentPyramid {
    /// The pyramid of `environment`, as fine as its image up to `edge_max` texels along a face.
    #[must_use]
    pub fn new(environment: &Environment, edge_max: usize) -> Self {
        // A face spans a quarter of the image's width.
        let edge = (environment.width() / 4).clamp(1, edge_max.max(1)).next_power_of_two();
        let mut levels = vec![(CubeMap::new(edge), environment.base_texels(edge))];
        for _ in 0..edge.trailing_zeros() {
            let (fine, texels) = &levels[levels.len() - 1];
            levels.push(coarsen(fine, texels));
        }
        let brightest: Vec<Vec<f32>> =
            levels.iter().map(|(map, texels)| spread(map, texels)).collect();
        let level = levels.iter().position(|(map, _)| map.edge() <= VARIATION_EDGE).unwrap_or(0);
        let (map, texels) = &levels[level];
        let variation = Variation::new((0..texels.len()).map(|index| {
            [map.texel(index).solid_angle_sr, largest(texels[index]), brightest[level][index]]
        }));
        Self { levels, brightest, variation }
    }

    /// How much it varies.
    #[must_use]
    pub fn variation(&self) -> Variation {
        self.variation
    }

    /// Brightness, that of the brightest channel, of what lies in a cone around `direction`, of any length, whose half-angle has the squared
    /// sine `sin2`, or brightest just beside it; W·m⁻²·sr⁻¹.
    ///
    /// The level is the finest whose texels are as wide as the cone. Since a texel knows the eight around it, also over the edges of
    /// faces, light is never lost between texels or levels: it counts at least as the mean over the texel of that level it lies in.
    #[must_use]
    #[inline(always)]
    pub fn brightness(&self, direction: Vec3, sin2: f32) -> f32 {
        // A texel in the middle of a face spans 2/n; the cone twice its sine.
        let finest = self.levels[0].0.edge() as f32;
        let texels2 = sin2 * finest * finest;
        // Half the logarithm, rounded up: the exponent is that of the next smaller power of two.
        let exponent = (texels2.to_bits() >> (f32::MANTISSA_DIGITS - 1)) as usize;
        let level = exponent.saturating_sub(f32::MAX_EXP as usize - 2).div_ceil(2);
        let level = level.min(self.levels.len() - 1);
        self.brightest[level][self.levels[level].0.texel_index(direction)]
    }

    /// Mean radiance around the unit direction `direction` over about `solid_angle_sr` steradians, W·m⁻²·sr⁻¹.
    ///
    /// Linear between texels of a face and between levels; texels at the edges of faces reach over no edge.
    #[must_use]
    pub fn radiance(&self, direction: Vec3, solid_angle_sr: f32) -> [f32; 3] {
        let finest = self.levels[0].0.edge() as f32;
        let texel_sr = 4.0 * PI / 6.0 / (finest * finest);
        let depth = 0.5 * (solid_angle_sr * TEXEL_SHARE / texel_sr).max(1.0).log2();
        let last = self.levels.len() - 1;
        let depth = depth.min(last as f32);
        let (level, share) = (depth as usize, depth.fract());
        let fine = self.sample(level, direction);
        if share == 0.0 {
            return fine;
        }
        let coarse = self.sample((level + 1).min(last), direction);
        std::array::from_fn(|c| fine[c] + (coarse[c] - fine[c]) * share)
    }

    /// Radiance of a level, linear between the middles of texels.
    fn sample(&self, level: usize, direction: Vec3) -> [f32; 3] {
        let (map, texels) = &self.levels[level];
        let n = map.edge();
        let (face, u, v) = CubeFace::from_direction(direction);
        let place = |x: f32| ((x + 1.0) * 0.5 * n as f32 - 0.5).clamp(0.0, (n - 1) as f32);
        let (x, y) = (place(u), place(v));
        let (column, row) = (x as usize, y as usize);
        let (right, below) = ((column + 1).min(n - 1), (row + 1).min(n - 1));
        let (fx, fy) = (x.fract(), y.fract());
        let at = |row: usize, column: usize| &texels[(usize::from(face.0) * n + row) * n + column];
        let (a, b, c, d) = (at(row, column), at(row, right), at(below, column), at(below, right));
        std::array::from_fn(|k| {
            let top = a[k] + (b[k] - a[k]) * fx;
            let bottom = c[k] + (d[k] - c[k]) * fx;
            top + (bottom - top) * fy
        })
    }
}

/// For each texel the largest brightness among itself and those around it.
fn spread(map: &CubeMap, texels: &[[f32; 3]]) -> Vec<f32> {
    let brightest = |index| {
        map.around(index).into_iter().map(|beside| largest(texels[beside])).fold(0.0, f32::max)
    };
    (0..texels.len()).map(brightest).collect()
}

/// The brightest channel.
fn largest(radiance: [f32; 3]) -> f32 {
    radiance.into_iter().fold(0.0, f32::max)
}

/// Means of four texels each.
fn coarsen(fine: &CubeMap, texels: &[[f32; 3]]) -> (CubeMap, Vec<[f32; 3]>) {
    let n = fine.edge();
    let coarse = CubeMap::new(n / 2);
    let mean = |index: usize| {
        let (column, row, face) = (index % (n / 2), index / (n / 2) % (n / 2), index * 4 / (n * n));
        let (mut sum, mut total) = ([0.0f64; 3], 0.0f64);
        for part in 0..4 {
            let child = (face * n + 2 * row + part / 2) * n + 2 * column + part % 2;
            let solid_angle = f64::from(fine.texel(child).solid_angle_sr);
            total += solid_angle;
            for (sum, light) in sum.iter_mut().zip(texels[child]) {
                *sum += f64::from(light) * solid_angle;
            }
        }
        sum.map(|sum| (sum / total) as f32)
    };
    (coarse, (0..coarse.texel_count()).map(mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EnvironmentOptions;
    use crate::lat_long::LatLong;
    use crate::test_images::sphere;
    use pbgi_image::RgbImage;

    /// Dark but for one pixel, which stays in the base.
    fn one_pixel(width: usize, bright: usize) -> Environment {
        let mut pixels = vec![[1.0; 3]; width * width / 2];
        pixels[bright] = [500.0, 400.0, 300.0];
        let image = RgbImage { width, height: width / 2, pixels };
        let options = EnvironmentOptions { peaks: false, ..EnvironmentOptions::default() };
        Environment::from_image(image, options).unwrap()
    }

    #[test]
    fn every_level_has_the_flux_of_the_image() {
        let pyramid = EnvironmentPyramid::new(&one_pixel(256, 40 * 256 + 31), 64);
        let flux = |(map, texels): &(CubeMap, Vec<[f32; 3]>)| -> f64 {
            let of = |i: usize| f64::from(map.texel(i).solid_angle_sr) * f64::from(texels[i][1]);
            (0..texels.len()).map(of).sum()
        };
        let finest = flux(&pyramid.levels[0]);
        assert_eq!(pyramid.levels.len(), 7);
        for level in &pyramid.levels {
            assert!((flux(level) / finest - 1.0).abs() < 1e-5);
        }
    }

    /// A sun of one pixel in the corner of a face counts from all three faces, at every level and however large the cone that holds it.
    #[test]
    fn a_sun_in_the_corner_of_a_face_is_never_lost() {
        let width = 256;
        // Of all pixels the one nearest to the corner (1, 1, 1).
        let grid = LatLong::new(width, width / 2, [Vec3::X, Vec3::Y, Vec3::Z]);
        let corner = Vec3::ONE.normalize();
        let toward = |i: &usize| grid.center(*i).dot(corner);
        let pixel = (0..width * width / 2).max_by(|a, b| toward(a).total_cmp(&toward(b))).unwrap();
        let environment = one_pixel(width, pixel);
        let pyramid = EnvironmentPyramid::new(&environment, 64);
        let sun = grid.center(pixel);
        for d in sphere(20_000) {
            let chord = (d - sun).length();
            for sine in [0.002f32, 0.01, 0.05, 0.2, 0.5] {
                if chord > sine {
                    continue;
                }
                let found = pyramid.brightness(d * 7.0, sine * sine);
                // At least the mean over a texel at most four times as wide as the cone, or of the finest.
                let texel = (8.0 * sine).max(2.0 / 64.0).powi(2);
                let pixel_sr = 2.0 * PI * PI / (width * width / 2) as f32 * corner.y.acos().sin();
                let least = 400.0 * (pixel_sr / texel).min(1.0) * 0.2;
                assert!(found > 1.0 + least.min(100.0) * 0.5, "{d} {sine}: {found} {least}");
            }
        }
        // Far away there is nothing but sky.
        assert!((pyramid.brightness(Vec3::NEG_ONE, 1e-4) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn small_solid_angles_show_the_image_and_large_ones_its_mean() {
        let environment = one_pixel(256, 40 * 256 + 31);
        let pyramid = EnvironmentPyramid::new(&environment, 64);
        for d in sphere(300) {
            let found = pyramid.radiance(d, 1e-6)[0];
            // The lamp spreads over the texels around it, no further.
            let near = environment.radiance(d)[0] > 1.0 || found > 1.0;
            assert!((found - 1.0).abs() < 1e-3 || near, "{d}: {found}");
            let mean = pyramid.radiance(d, 4.0 * PI)[0];
            assert!(mean > 0.99 && mean < 1.5);
        }
        let uniform = EnvironmentPyramid::new(&Environment::uniform([3.0; 3]), 64);
        assert!((uniform.radiance(Vec3::X, 0.1)[2] - 3.0).abs() < 1e-5);
    }

    #[test]
    fn variation_is_that_of_the_sky_however_it_is_turned() {
        let even = EnvironmentPyramid::new(&Environment::uniform([0.5, 2.0, 1.0]), 32).variation();
        for (found, expected) in [(even.mean, 2.0), (even.usual, 2.0), (even.gain, 1.0)] {
            assert!((found - expected).abs() < 1e-4, "{even:?}");
        }
        // Bright where a horizontal axis leads; rows at the poles are narrow.
        let width = 128;
        let sky = |up: Vec3, rotate_degrees: f32| {
            let grid = LatLong::new(width, width / 2, [Vec3::X, Vec3::Y, Vec3::Z]);
            let light = |i| if grid.center(i).dot(up) > 0.6 { [8.0, 2.0, 1.0] } else { [0.1; 3] };
            let pixels = (0..width * width / 2).map(light).collect();
            let image = RgbImage { width, height: width / 2, pixels };
            let options = EnvironmentOptions { peaks: false, rotate_degrees, ..Default::default() };
            let environment = Environment::from_image(image, options).unwrap();
            EnvironmentPyramid::new(&environment, 32).variation()
        };
        let first = sky(Vec3::Y, 0.0);
        // A fifth of the sphere.
        assert!((first.mean / (0.2 * 8.0 + 0.8 * 0.1) - 1.0).abs() < 0.02, "{first:?}");
        assert!(first.gain > 1.5 && first.usual > first.mean, "{first:?}");
        for turned in [sky(Vec3::X, 0.0), sky(Vec3::Z, 0.0), sky(Vec3::X, 90.0), sky(-Vec3::Y, 0.0)]
        {
            for (a, b) in [(first.mean, turned.mean), (first.usual, turned.usual)] {
                assert!((a / b - 1.0).abs() < 0.03, "{first:?} {turned:?}");
            }
        }
    }
}
