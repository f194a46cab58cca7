//! The environment as the engine sees it.

use crate::lat_long::LatLong;
use crate::{EnvironmentPeak, base, extract};
use pbgi_image::RgbImage;
use pbgi_math::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The world axis an environment's top row shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// +Y, as in film and game scenes; the image's middle shows +Z.
    #[default]
    Y,
    /// +Z, as in surveying; the image's middle shows −Y.
    Z,
}

/// How an image becomes an environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentOptions {
    /// Rotation about the up axis in degrees, counterclockwise seen from above.
    pub rotate_degrees: f32,
    /// Factor on all radiance, finite and at least 0.
    pub scale: f32,
    /// The world axis of the image's top row.
    pub up: UpAxis,
    /// Whether small bright lights are taken out of the base map.
    pub peaks: bool,
    /// Most peaks to take out; the strongest are kept.
    pub peaks_max: usize,
}

impl Default for EnvironmentOptions {
    fn default() -> Self {
        Self { rotate_degrees: 0.0, scale: 1.0, up: UpAxis::Y, peaks: true, peaks_max: 32 }
    }
}

/// Why an image cannot be an environment.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EnvironmentError {
    /// The image does not cover the sphere.
    #[error(
        "the environment is {width} x {height} pixels, expected an equirectangular image, twice as \
         wide as high; convert cube crosses and light probes first"
    )]
    NotEquirectangular {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The image holds another number of pixels than its size says.
    #[error("the environment holds {found} pixels, expected {expected}")]
    PixelCount {
        /// Pixels present.
        found: usize,
        /// Columns times rows.
        expected: usize,
    },
    /// A pixel is negative, infinite or not a number, after scaling.
    #[error(
        "environment pixel (column {column}, row {row}) is ({}, {}, {}) after scaling by {scale}, \
         expected finite values of at least 0; repair the image or choose another scale",
        value[0], value[1], value[2]
    )]
    BadPixel {
        /// Column of the first such pixel.
        column: usize,
        /// Its row.
        row: usize,
        /// Its scaled color.
        value: [f32; 3],
        /// The scale from the options.
        scale: f32,
    },
    /// The rotation is not a number of degrees.
    #[error("the environment's rotation is {found} degrees, expected a finite number")]
    Rotation {
        /// What the options say.
        found: f32,
    },
}

/// A distant environment: radiance for every direction, the same from everywhere.
///
/// Invariant: the flux of the image equals that of the base plus that of the peaks.
#[derive(Clone, Debug)]
pub struct Environment {
    grid: LatLong,
    /// Full-detail radiance, W·m⁻²·sr⁻¹, row-major.
    pixels: Vec<[f32; 3]>,
    /// Base radiance of the pixels that peaks took light from.
    residual: BTreeMap<usize, [f32; 3]>,
    peaks: Vec<EnvironmentPeak>,
}

impl Environment {
    /// An environment from an equirectangular image whose pixels are finite and not negative.
    ///
    /// Pixel centers are at φ = 2π(i + ½)/width, θ = π(j + ½)/height. Cost: one pass over the
    /// pixels, on all threads; the peaks do not depend on the number of threads.
    ///
    /// # Errors
    ///
    /// [`EnvironmentError`] if the image is empty or far from twice as wide as high, or if a scaled
    /// pixel is negative, infinite or not a number.
    pub fn from_image(
        image: RgbImage,
        options: EnvironmentOptions,
    ) -> Result<Self, EnvironmentError> {
        let RgbImage { width, height, mut pixels } = image;
        if height == 0 || 2 * width < 3 * height || width > 3 * height {
            return Err(EnvironmentError::NotEquirectangular { width, height });
        }
        if pixels.len() != width * height {
            let (found, expected) = (pixels.len(), width * height);
            return Err(EnvironmentError::PixelCount { found, expected });
        }
        if !options.rotate_degrees.is_finite() {
            return Err(EnvironmentError::Rotation { found: options.rotate_degrees });
        }
        let scale = options.scale;
        if scale != 1.0 {
            pixels.par_iter_mut().for_each(|p| *p = p.map(|c| c * scale));
        }
        let is_bad = |p: &[f32; 3]| !p.iter().all(|c| c.is_finite() && *c >= 0.0);
        if let Some(i) = pixels.par_iter().position_first(is_bad) {
            let (column, row, value) = (i % width, i / width, pixels[i]);
            return Err(EnvironmentError::BadPixel { column, row, value, scale });
        }
        let grid = LatLong::new(width, height, world_axes(options));
        let peaks_max = if options.peaks { options.peaks_max } else { 0 };
        let (peaks, residual) = extract::extract_peaks(&grid, &pixels, peaks_max);
        Ok(Self { grid, pixels, residual, peaks })
    }

    /// An environment of radiance `rgb` from every direction. Negative and non-finite channels
    /// become 0.
    #[must_use]
    pub fn uniform(rgb: [f32; 3]) -> Self {
        let rgb = rgb.map(|c| if c.is_finite() { c.max(0.0) } else { 0.0 });
        Self {
            grid: LatLong::new(4, 2, [Vec3::X, Vec3::Y, Vec3::Z]),
            pixels: vec![rgb; 8],
            residual: BTreeMap::new(),
            peaks: Vec::new(),
        }
    }

    /// Full-detail radiance from the unit direction `direction`, W·m⁻²·sr⁻¹, peaks included:
    /// bilinear between pixel centers, wrapping in columns.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> [f32; 3] {
        let at = self.grid.coordinates(direction);
        let (x, y) = (at.x - 0.5, at.y - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (fx, fy) = (x - column, y - row);
        let (width, height) = (self.grid.width as i64, self.grid.height as i64);
        let pixel = |dc: i64, dr: i64| {
            let c = (column as i64 + dc).rem_euclid(width) as usize;
            let r = (row as i64 + dr).clamp(0, height - 1) as usize;
            self.pixels[r * self.grid.width + c]
        };
        let (p00, p10, p01, p11) = (pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1));
        [0, 1, 2].map(|k| {
            let top = p00[k] + (p10[k] - p00[k]) * fx;
            let bottom = p01[k] + (p11[k] - p01[k]) * fx;
            top + (bottom - top) * fy
        })
    }

    /// Mean radiance of each texel of [`pbgi_math::CubeMap::new`]`(n)`, in its index order, without
    /// the peaks.
    ///
    /// Each pixel's flux (radiance times its exact solid angle) goes to the texels it covers; pixels
    /// across a texel's boundary are divided to 1/32 of a texel. The map's flux equals that of the
    /// image without peaks; a uniform image gives uniform texels. Cost: a pass over the pixels on
    /// all threads, 0.1 s for 4096 × 2048; results do not depend on the number of threads.
    ///
    /// # Panics
    ///
    /// If `n` is 0.
    #[must_use]
    pub fn base_texels(&self, n: usize) -> Vec<[f32; 3]> {
        base::resample(&self.grid, &self.pixels, &self.residual, n)
    }

    /// Columns of the image.
    pub(crate) fn width(&self) -> usize {
        self.grid.width
    }

    /// The small bright lights that are not in the base, strongest first.
    #[must_use]
    pub fn peaks(&self) -> &[EnvironmentPeak] {
        &self.peaks
    }

    /// Irradiance in W·m⁻² on a surface with the unit normal `normal` that sees the whole
    /// hemisphere: the sum over all pixels, peaks included. Cost: a pass over the pixels.
    #[must_use]
    pub fn irradiance(&self, normal: Vec3) -> [f32; 3] {
        let horizontals: Vec<Vec3> = column_vectors(&self.grid);
        let row_sums: Vec<[f64; 3]> = (0..self.grid.height)
            .into_par_iter()
            .map(|row| {
                // ∫ sin θ dω and ∫ cos θ dω of a pixel, per radian of azimuth.
                let (polar, axial) = row_integrals(&self.grid, row);
                let up = f64::from(self.grid.zenith().dot(normal)) * axial;
                let pixels = &self.pixels[row * self.grid.width..][..self.grid.width];
                let mut sum = [0.0; 3];
                for (pixel, horizontal) in pixels.iter().zip(&horizontals) {
                    let weight = (f64::from(horizontal.dot(normal)) * polar + up).max(0.0);
                    for k in 0..3 {
                        sum[k] += f64::from(pixel[k]) * weight;
                    }
                }
                sum
            })
            .collect();
        [0, 1, 2].map(|k| row_sums.iter().map(|sum| sum[k]).sum::<f64>() as f32)
    }
}

/// World directions of the image's axes.
fn world_axes(options: EnvironmentOptions) -> [Vec3; 3] {
    let (sin, cos) = f64::from(options.rotate_degrees).to_radians().sin_cos();
    let (sin, cos) = (sin as f32, cos as f32);
    let axes = [Vec3::new(cos, 0.0, -sin), Vec3::Y, Vec3::new(sin, 0.0, cos)];
    match options.up {
        UpAxis::Y => axes,
        UpAxis::Z => axes.map(|a| Vec3::new(a.x, -a.z, a.y)),
    }
}

/// Mean of the horizontal direction over each column, times the column's width in radians.
fn column_vectors(grid: &LatLong) -> Vec<Vec3> {
    let step = std::f64::consts::TAU / grid.width as f64;
    let length = 2.0 * (step * 0.5).sin();
    (0..grid.width).map(|c| grid.horizontal(c as f64 + 0.5) * length as f32).collect()
}

/// Integrals over a row, with `dω = sin θ dθ dφ`: `∫ sin² θ dθ`, which multiplies a column's vector,
/// and `∫ cos θ sin θ dθ` times the column's width.
fn row_integrals(grid: &LatLong, row: usize) -> (f64, f64) {
    use std::f64::consts::{PI, TAU};
    let (t0, t1) =
        (row as f64 * PI / grid.height as f64, (row + 1) as f64 * PI / grid.height as f64);
    // sin²θ integrates to (θ − sin θ cos θ)/2; differences of sin 2θ as a product.
    let double = (t0 + t1).cos() * (t1 - t0).sin();
    let polar = 0.5 * (t1 - t0 - double);
    let axial = 0.5 * (t0 + t1).sin() * (t1 - t0).sin();
    (polar, axial * TAU / grid.width as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{read_data, read_reference, sphere};
    use pbgi_math::CubeMap;
    use std::f32::consts::PI;

    /// An environment without peaks whose pixels are `f(direction)`.
    fn paint(width: usize, options: EnvironmentOptions, f: impl Fn(Vec3) -> f32) -> Environment {
        let grid = LatLong::new(width, width / 2, [Vec3::X, Vec3::Y, Vec3::Z]);
        let count = width * width / 2;
        let pixels = (0..count).map(|i| [f(grid.center(i)); 3]).collect();
        Environment::from_image(RgbImage { width, height: width / 2, pixels }, options).unwrap()
    }

    #[test]
    fn uniform_light_gives_pi_times_radiance() {
        let environment = Environment::uniform([1.0, 2.0, 0.5]);
        for normal in sphere(50) {
            let e = environment.irradiance(normal);
            // Two rows of 90° cannot follow a tilted horizon, so only the axis is exact here.
            assert!((e[0] * 2.0 - e[1]).abs() < 1e-4);
        }
        assert!((environment.irradiance(Vec3::Y)[0] - PI).abs() < 1e-6);
        let fine = paint(512, EnvironmentOptions::default(), |_| 1.0);
        for normal in sphere(50) {
            assert!((fine.irradiance(normal)[0] / PI - 1.0).abs() < 1e-4);
        }
        assert_eq!(environment.radiance(Vec3::new(0.6, 0.0, 0.8)), [1.0, 2.0, 0.5]);
    }

    /// The table "Irradiance of open receivers" of the reference data.
    #[test]
    fn reference_skies_have_their_listed_irradiance() {
        let normals = [Vec3::Y, Vec3::X, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Z];
        let sky = [
            [0.8778, 0.9778, 1.4462],
            [0.7764, 0.7278, 0.7960],
            [0.5887, 0.6152, 0.7449],
            [0.6125, 0.6295, 0.7513],
            [0.9402, 0.8261, 0.8407],
        ];
        let sky_sun = [
            [2.6948, 2.6019, 2.7673],
            [0.7764, 0.7278, 0.7960],
            [0.5887, 0.6152, 0.7449],
            [1.7656, 1.6601, 1.5897],
            [1.4779, 1.3067, 1.2316],
        ];
        for (name, table) in [("plaza_sky.exr", sky), ("plaza_sky_sun.exr", sky_sun)] {
            let Some(image) = read_reference(name) else { continue };
            let environment =
                Environment::from_image(image, EnvironmentOptions::default()).unwrap();
            for (normal, expected) in normals.into_iter().zip(table) {
                let found = environment.irradiance(normal);
                for k in 0..3 {
                    // The table has four decimals.
                    assert!((found[k] - expected[k]).abs() < 1.5e-4, "{name} {normal}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn rotation_is_counterclockwise_from_above_and_z_up_tilts() {
        let lobe = |d: Vec3| d.x.max(0.0).powi(8);
        let rotated = EnvironmentOptions { rotate_degrees: 90.0, ..Default::default() };
        // Seen from +Y, a quarter turn counterclockwise takes +X to −Z.
        let environment = paint(128, rotated, lobe);
        assert!(environment.radiance(Vec3::NEG_Z)[0] > 0.99);
        let z_up = EnvironmentOptions { up: UpAxis::Z, ..rotated };
        // Seen from +Z, it takes +X to +Y.
        assert!(paint(128, z_up, lobe).radiance(Vec3::Y)[0] > 0.99);
        let top = paint(128, z_up, |d| d.y.max(0.0).powi(8));
        assert!(top.radiance(Vec3::Z)[0] > 0.99);
        assert!(top.irradiance(Vec3::Z)[0] > 10.0 * top.irradiance(Vec3::Y)[0].min(0.05));
    }

    #[test]
    fn radiance_interpolates_across_the_seam() {
        let environment = paint(64, EnvironmentOptions::default(), |d| 1.0 + d.x * 0.5 + d.y * 0.2);
        for d in sphere(500) {
            let expected = 1.0 + d.x * 0.5 + d.y * 0.2;
            // Bilinear error is an eighth of the squared pitch (0.1 rad) times the curvature; at the
            // poles rows are clamped half a pitch away.
            let tolerance = if d.y.abs() > 0.99 { 0.03 } else { 2e-3 };
            assert!((environment.radiance(d)[0] - expected).abs() < tolerance, "{d}");
        }
    }

    #[test]
    fn scale_multiplies_everything() {
        let options = EnvironmentOptions { scale: 3.0, ..Default::default() };
        let one = paint(64, EnvironmentOptions::default(), |d| 1.0 + d.z);
        let three = paint(64, options, |d| 1.0 + d.z);
        let ratio = three.irradiance(Vec3::Z)[0] / one.irradiance(Vec3::Z)[0];
        assert!((ratio - 3.0).abs() < 1e-5);
        assert!((three.base_texels(4)[7][1] / one.base_texels(4)[7][1] - 3.0).abs() < 1e-5);
    }

    #[test]
    fn what_is_no_environment_is_an_error() {
        let image = |width, height, value| RgbImage {
            width,
            height,
            pixels: vec![[value; 3]; width * height],
        };
        let make = |image, options| Environment::from_image(image, options).unwrap_err();
        let default = EnvironmentOptions::default();
        for (width, height) in [(0, 0), (4, 0), (4, 4), (40, 10)] {
            let error = make(image(width, height, 1.0), default);
            assert!(matches!(error, EnvironmentError::NotEquirectangular { .. }));
        }
        let mut short = image(8, 4, 1.0);
        short.pixels.pop();
        assert!(matches!(make(short, default), EnvironmentError::PixelCount { found: 31, .. }));
        for scale in [-1.0, f32::NAN, f32::INFINITY] {
            let error = make(image(8, 4, 1.0), EnvironmentOptions { scale, ..default });
            assert!(matches!(error, EnvironmentError::BadPixel { column: 0, row: 0, .. }));
        }
        let spun = EnvironmentOptions { rotate_degrees: f32::NAN, ..default };
        assert!(matches!(make(image(8, 4, 1.0), spun), EnvironmentError::Rotation { .. }));
    }

    /// Irradiance of a cube map of constant texels; texels across the horizon in 8 × 8 parts.
    fn base_irradiance(texels: &[[f32; 3]], n: usize, normal: Vec3) -> [f32; 3] {
        let (map, fine) = (CubeMap::new(n), CubeMap::new(n * 8));
        let mut sum = [0f64; 3];
        for (index, radiance) in texels.iter().enumerate() {
            let texel = map.texel(index);
            let height = texel.direction.dot(normal);
            let weight = if height > 2.0 / n as f32 {
                texel.vector.dot(normal)
            } else if height < -2.0 / n as f32 {
                continue;
            } else {
                let (face, row, column) = (index / (n * n), index / n % n, index % n);
                (0..64)
                    .map(|k| ((face * n + row) * 8 + k / 8) * n * 8 + column * 8 + k % 8)
                    .map(|i| fine.texel(i).vector.dot(normal).max(0.0))
                    .sum()
            };
            (0..3).for_each(|k| sum[k] += f64::from(radiance[k]) * f64::from(weight));
        }
        sum.map(|s| s as f32)
    }

    fn all_environments() -> Vec<(&'static str, RgbImage)> {
        let data = [
            "kloppenheim_05_1k.hdr",
            "potsdamer_platz_1k.hdr",
            "st_peters_square_night_1k.hdr",
            "StageEnvLatLong.exr",
        ];
        let reference = ["plaza_sky.exr", "plaza_sky_sun.exr"];
        data.into_iter()
            .filter_map(|name| read_data(name).map(|image| (name, image)))
            .chain(reference.into_iter().filter_map(|n| read_reference(n).map(|image| (n, image))))
            .collect()
    }

    /// The image without what the peaks took.
    fn without_peaks(environment: &Environment) -> Environment {
        let mut rest = environment.clone();
        for (index, residual) in std::mem::take(&mut rest.residual) {
            rest.pixels[index] = residual;
        }
        rest
    }

    /// Moving light from pixels to windows changes irradiance by less than 1e-4 of the largest. A map
    /// of 64 × 64 texels, constant over 1.4° each, adds its own error: a gradient of L̄ per radian
    /// gives (0.025)²/12 = 5e-5, edges of bright lights more.
    #[test]
    fn base_and_peaks_give_the_irradiance_of_the_image() {
        for (name, image) in all_environments() {
            let options = EnvironmentOptions::default();
            let environment = Environment::from_image(image, options).unwrap();
            let base = environment.base_texels(64);
            let rest = without_peaks(&environment);
            let exact: Vec<[f32; 3]> = sphere(50).map(|n| environment.irradiance(n)).collect();
            let largest = exact.iter().map(|e| e[1]).fold(0f32, f32::max);
            let (mut worst_peaks, mut worst) = (0f32, 0f32);
            for (normal, exact) in sphere(50).zip(exact) {
                let rest = rest.irradiance(normal);
                let base = base_irradiance(&base, 64, normal);
                for k in 0..3 {
                    let peaks: f32 =
                        environment.peaks().iter().map(|p| p.irradiance(normal)[k]).sum();
                    worst_peaks = worst_peaks.max((rest[k] + peaks - exact[k]).abs() / largest);
                    worst = worst.max((base[k] + peaks - exact[k]).abs() / largest);
                }
            }
            println!(
                "{name}: largest change by peaks {worst_peaks:.1e}, by 6 x 64² texels {worst:.1e}"
            );
            assert!(worst_peaks < 1e-4, "{name}: {worst_peaks}");
            assert!(worst < 1e-3, "{name}: {worst}");
        }
    }

    #[test]
    fn results_do_not_depend_on_the_number_of_threads() {
        let Some(image) = read_data("st_peters_square_night_1k.hdr") else { return };
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let environment =
                    Environment::from_image(image.clone(), EnvironmentOptions::default()).unwrap();
                let e = environment.irradiance(Vec3::new(0.6, 0.8, 0.0));
                (environment.base_texels(16), environment.peaks().to_vec(), e)
            })
        };
        assert_eq!(run(1), run(3));
    }
}
