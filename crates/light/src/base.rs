//! From equirectangular pixels to cube map texels.

use crate::lat_long::LatLong;
use pbgi_math::{CubeMap, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Parts of a texel to which pixels across its boundary are divided, per axis.
const PARTS_PER_TEXEL: f32 = 32.0;
/// Most bytes the bands' accumulators may take together.
const ACCUMULATOR_BYTES_MAX: usize = 128 << 20;
/// Bands of rows that are summed on their own; fixed, so that sums do not depend on threads.
const BANDS_MAX: usize = 32;

/// Flux and solid angle gathered for a texel: red, green, blue, steradians.
type Sum = [f64; 4];

/// Mean radiance of each texel; `replaced` overrides pixels.
pub(crate) fn resample(
    grid: &LatLong,
    pixels: &[[f32; 3]],
    replaced: &BTreeMap<usize, [f32; 3]>,
    n: usize,
) -> Vec<[f32; 3]> {
    let map = CubeMap::new(n);
    let splitter = Splitter::new(grid, map);
    let texel_bytes = map.texel_count() * size_of::<Sum>();
    let bands = (ACCUMULATOR_BYTES_MAX / texel_bytes).clamp(1, BANDS_MAX).min(grid.height);
    let sums = (0..bands)
        .into_par_iter()
        .map(|band| {
            let rows = band * grid.height / bands..(band + 1) * grid.height / bands;
            let mut sums = vec![[0.0; 4]; map.texel_count()];
            rows.for_each(|row| splitter.add_row(row, pixels, replaced, &mut sums));
            sums
        })
        .collect::<Vec<_>>()
        .into_iter()
        .reduce(|mut total, band| {
            for (total, part) in total.iter_mut().zip(band) {
                (0..4).for_each(|k| total[k] += part[k]);
            }
            total
        })
        .unwrap_or_default();
    normalize(&map, &sums)
}

/// Means from sums: flux over the solid angle that was gathered with it, which is exact for uniform
/// light, then scaled so that the whole map's flux is exact for any light.
fn normalize(map: &CubeMap, sums: &[Sum]) -> Vec<[f32; 3]> {
    // No texel is missed: parts are at most an eighth of one.
    debug_assert!(sums.iter().all(|sum| sum[3] > 0.0));
    let mean = |sum: &Sum| [0, 1, 2].map(|k| sum[k] / sum[3]);
    let means: Vec<[f64; 3]> = sums.iter().map(mean).collect();
    let mut gathered = [0.0; 3];
    let mut resampled = [0.0; 3];
    for (index, mean) in means.iter().enumerate() {
        let solid_angle = f64::from(map.texel(index).solid_angle_sr);
        for k in 0..3 {
            gathered[k] += sums[index][k];
            resampled[k] += mean[k] * solid_angle;
        }
    }
    let factors = [0, 1, 2].map(|k| match gathered[k] / resampled[k] {
        factor if factor.is_finite() => factor,
        _ => 1.0,
    });
    means.into_iter().map(|mean| [0, 1, 2].map(|k| (mean[k] * factors[k]) as f32)).collect()
}

/// Divides pixels among the texels they cover.
struct Splitter<'a> {
    grid: &'a LatLong,
    map: CubeMap,
    /// Parts per axis of a pixel that is divided.
    parts: usize,
    /// Horizontal directions of pixel boundaries.
    boundaries: Vec<Vec3>,
    /// Horizontal directions of the parts of all pixels of a row.
    part_centers: Vec<Vec3>,
}

impl<'a> Splitter<'a> {
    fn new(grid: &'a LatLong, map: CubeMap) -> Self {
        let texel_angle = std::f32::consts::FRAC_PI_2 / map.edge() as f32;
        let width_angle = std::f32::consts::TAU / grid.width as f32;
        let pixel_angle = grid.row_angle().max(width_angle);
        // Fine enough for the boundary, and never so coarse that a texel is missed.
        let parts = (PARTS_PER_TEXEL * pixel_angle / texel_angle).ceil() as usize;
        let parts = parts.clamp(1, 16.max((8.0 * pixel_angle / texel_angle).ceil() as usize));
        let boundaries = (0..=grid.width).map(|c| grid.horizontal(c as f64)).collect();
        let part_centers = (0..grid.width * parts)
            .map(|p| grid.horizontal((p as f64 + 0.5) / parts as f64))
            .collect();
        Self { grid, map, parts, boundaries, part_centers }
    }

    /// Adds all pixels of a row: whole where the four corners fall into one texel, else in parts.
    fn add_row(
        &self,
        row: usize,
        pixels: &[[f32; 3]],
        replaced: &BTreeMap<usize, [f32; 3]>,
        sums: &mut [Sum],
    ) {
        let width = self.grid.width;
        let start = row * width;
        let mut replaced = replaced.range(start..start + width).peekable();
        let solid_angle = self.grid.solid_angle(row);
        let corner_texels = [row, row + 1].map(|v| {
            let (sin, cos) = self.grid.polar(v as f64);
            let up = self.grid.zenith() * cos;
            let texel = |h: &Vec3| self.map.texel_index(*h * sin + up);
            self.boundaries.iter().map(texel).collect::<Vec<_>>()
        });
        let slices = self.slices(row);
        for column in 0..width {
            let index = start + column;
            let radiance = match replaced.next_if(|(i, _)| **i == index) {
                Some((_, residual)) => *residual,
                None => pixels[index],
            };
            let texel = corner_texels[0][column];
            let whole = corner_texels[0][column + 1] == texel
                && corner_texels[1][column] == texel
                && corner_texels[1][column + 1] == texel;
            if whole {
                add(&mut sums[texel], radiance, solid_angle);
            } else {
                self.add_parts(column, radiance, &slices, sums);
            }
        }
    }

    /// Sine and cosine of the polar angle and the solid angle of the parts of a row's pixels.
    fn slices(&self, row: usize) -> Vec<(f32, f32, f64)> {
        let parts = self.parts as f64;
        let azimuth = TAU / self.grid.width as f64 / parts;
        (0..self.parts)
            .map(|p| {
                let v = row as f64 + p as f64 / parts;
                let (sin, cos) = self.grid.polar(v + 0.5 / parts);
                (sin, cos, self.grid.slice_solid_angle(v, v + 1.0 / parts) * azimuth)
            })
            .collect()
    }

    fn add_parts(
        &self,
        column: usize,
        radiance: [f32; 3],
        slices: &[(f32, f32, f64)],
        sums: &mut [Sum],
    ) {
        let centers = &self.part_centers[column * self.parts..][..self.parts];
        for (sin, cos, solid_angle) in slices {
            let up = self.grid.zenith() * *cos;
            for center in centers {
                let texel = self.map.texel_index(*center * *sin + up);
                add(&mut sums[texel], radiance, *solid_angle);
            }
        }
    }
}

fn add(sum: &mut Sum, radiance: [f32; 3], solid_angle: f64) {
    for k in 0..3 {
        sum[k] += f64::from(radiance[k]) * solid_angle;
    }
    sum[3] += solid_angle;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{read_data, read_reference};
    use crate::{Environment, EnvironmentOptions};

    #[test]
    fn uniform_light_gives_uniform_texels() {
        let environment = Environment::uniform([0.7, 1.0, 3.0]);
        for n in [1, 3, 8, 32, 65] {
            for texel in environment.base_texels(n) {
                for (found, expected) in texel.into_iter().zip([0.7f32, 1.0, 3.0]) {
                    assert!((found / expected - 1.0).abs() < 1e-6, "{n}: {texel:?}");
                }
            }
        }
    }

    #[test]
    fn map_holds_the_flux_of_the_image() {
        let options = EnvironmentOptions { peaks: false, ..Default::default() };
        for name in ["st_peters_square_night_1k.hdr", "StageEnvLatLong.exr"] {
            let Some(image) = read_data(name) else { continue };
            let grid = LatLong::new(image.width, image.height, [Vec3::X, Vec3::Y, Vec3::Z]);
            let sum =
                |(i, p): (usize, &[f32; 3])| f64::from(p[0]) * grid.solid_angle(i / grid.width);
            let exact: f64 = image.pixels.iter().enumerate().map(sum).sum();
            let environment = Environment::from_image(image, options).unwrap();
            for n in [4, 16, 100] {
                let map = CubeMap::new(n);
                let texels = environment.base_texels(n);
                let flux: f64 = texels
                    .iter()
                    .enumerate()
                    .map(|(i, t)| f64::from(t[0]) * f64::from(map.texel(i).solid_angle_sr))
                    .sum();
                assert!((flux / exact - 1.0).abs() < 1e-6, "{name} {n}: {flux} {exact}");
            }
        }
    }

    #[test]
    fn smooth_light_keeps_its_place() {
        let width = 256;
        let grid = LatLong::new(width, 128, [Vec3::X, Vec3::Y, Vec3::Z]);
        let f = |d: Vec3| [1.0 + 0.9 * d.x, 1.0 + 0.9 * d.y, 1.0 + 0.9 * d.z];
        let pixels = (0..width * 128).map(|i| f(grid.center(i))).collect();
        let image = pbgi_image::RgbImage { width, height: 128, pixels };
        let environment = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
        let map = CubeMap::new(16);
        for (index, texel) in environment.base_texels(16).into_iter().enumerate() {
            let exact = map.texel(index);
            let mean = exact.vector / exact.solid_angle_sr;
            for (found, expected) in texel.into_iter().zip(f(mean)) {
                // Texels are 5.6° wide, image pixels 1.4° (center sampled, error 1e-4).
                assert!((found - expected).abs() < 2e-3, "{index}: {texel:?} {:?}", f(mean));
            }
        }
    }

    #[test]
    fn large_images_are_fast() {
        let Some(image) = read_reference("plaza_sky_sun.exr") else { return };
        let start = std::time::Instant::now();
        let environment = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
        let extracted = start.elapsed();
        for n in [8, 32, 128] {
            let start = std::time::Instant::now();
            let texels = environment.base_texels(n);
            println!("4096 x 2048 to 6 x {n}²: {:?} ({})", start.elapsed(), texels.len());
        }
        println!("4096 x 2048 extraction: {extracted:?}");
    }
}
