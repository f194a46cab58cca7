//! Finding the small bright lights of an environment and taking them out.
//!
//! Greedy, from the brightest pixel down. Around a seed the connected region above a threshold is
//! grown; the threshold rises until the region fits a window. If the region's excess over its
//! surroundings carries enough of the environment's flux, the window shrinks to where nearly all of
//! that excess is, and the excess moves from the image to a peak.

use crate::EnvironmentPeak;
use crate::lat_long::LatLong;
use crate::window::{Window, fill_window, fit_window, frame_around, project};
use pbgi_math::luminance;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet};

/// Least share of the environment's flux (luminance) that makes a peak.
const FLUX_SHARE_MIN: f64 = 0.003;
/// Solid angle of a disk 2° across, in steradians. A seed is a pixel whose radiance, all over such a
/// disk, would just make a peak.
const SEED_SOLID_ANGLE: f64 = 9.57e-4;
/// Radiance at which regions are first cut off, relative to a seed's: a third of the least peak, all
/// over the disk, may stay outside.
const FIRST_THRESHOLD: f64 = 1.0 / 3.0;
/// Factor between thresholds.
const THRESHOLD_STEP: f32 = 1.5;
/// Half of a window's largest edge on the plane at distance 1: 4° across.
const HALF_WIDTH_MAX: f32 = 0.034_92;
/// Share of the excess that a tighter window may leave outside.
const SPILL_MAX: f64 = 0.02;
/// Share of the environment's flux that a tighter window may leave outside, if more.
const SPILL_FLUX_MAX: f64 = 0.0015;
/// Largest solid angle over which the excess of the weakest peak may spread, in steradians: a disk
/// 1.1° across. A light that spreads wider must be stronger in proportion.
const SPREAD_MAX: f64 = 3e-4;

/// Light to move from pixels to a window.
struct Capture {
    window: Window,
    /// Excess radiance by pixel index.
    excess: Vec<(usize, [f32; 3])>,
    /// Luminance of the excess times solid angle, summed.
    flux: f64,
    /// The same with the square of the luminance.
    square: f64,
}

impl Capture {
    /// Solid angle over which the excess spreads, in steradians: that of a uniform disk with the
    /// same flux and the same sum of squares.
    fn spread(&self) -> f64 {
        self.flux * self.flux / self.square
    }
}

/// Peaks of an image, strongest first, at most `peaks_max`, and the radiance that is left of the
/// pixels they took light from. The flux of the image is that of the peaks and of what is left.
pub(crate) fn extract_peaks(
    grid: &LatLong,
    pixels: &[[f32; 3]],
    peaks_max: usize,
) -> (Vec<EnvironmentPeak>, BTreeMap<usize, [f32; 3]>) {
    let mut residual = BTreeMap::new();
    let flux = total_flux(grid, pixels);
    if peaks_max == 0 || flux <= 0.0 {
        return (Vec::new(), residual);
    }
    let seed_radiance = (FLUX_SHARE_MIN * flux / SEED_SOLID_ANGLE) as f32;
    let mut finder = Finder { grid, pixels, residual, settled: HashSet::new(), flux };
    let mut captures = Vec::new();
    for seed in find_seeds(pixels, seed_radiance) {
        if finder.settled.contains(&seed) || finder.luminance(seed) < seed_radiance {
            continue;
        }
        if let Some(capture) = finder.capture_around(seed, seed_radiance) {
            finder.take(&capture);
            captures.push(capture);
        }
    }
    residual = finder.residual;
    captures.sort_by(|a, b| b.flux.total_cmp(&a.flux));
    for capture in captures.drain(peaks_max.min(captures.len())..) {
        give_back(&mut residual, &capture);
    }
    let peaks = captures.iter().map(|c| fill_window(grid, c.window, &c.excess)).collect();
    (peaks, residual)
}

/// Luminance times solid angle over the sphere, summed by rows.
fn total_flux(grid: &LatLong, pixels: &[[f32; 3]]) -> f64 {
    let rows: Vec<f64> = pixels
        .par_chunks(grid.width)
        .enumerate()
        .map(|(row, pixels)| {
            pixels.iter().map(|p| f64::from(luminance(*p))).sum::<f64>() * grid.solid_angle(row)
        })
        .collect();
    rows.iter().sum()
}

/// Indices of the pixels above a luminance, brightest first.
fn find_seeds(pixels: &[[f32; 3]], threshold: f32) -> Vec<usize> {
    let mut seeds: Vec<(f32, usize)> = pixels
        .par_iter()
        .enumerate()
        .map(|(index, pixel)| (luminance(*pixel), index))
        .filter(|(y, _)| *y >= threshold)
        .collect();
    seeds.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    seeds.into_iter().map(|(_, index)| index).collect()
}

fn give_back(residual: &mut BTreeMap<usize, [f32; 3]>, capture: &Capture) {
    for (index, excess) in &capture.excess {
        if let Some(rest) = residual.get_mut(index) {
            (0..3).for_each(|k| rest[k] += excess[k]);
        }
    }
}

struct Finder<'a> {
    grid: &'a LatLong,
    pixels: &'a [[f32; 3]],
    /// Radiance left of the pixels that light was taken from.
    residual: BTreeMap<usize, [f32; 3]>,
    /// Pixels that cannot be seeds any more.
    settled: HashSet<usize>,
    /// Luminance flux of the whole image.
    flux: f64,
}

impl Finder<'_> {
    fn radiance(&self, index: usize) -> [f32; 3] {
        self.residual.get(&index).copied().unwrap_or(self.pixels[index])
    }

    fn luminance(&self, index: usize) -> f32 {
        luminance(self.radiance(index))
    }

    fn take(&mut self, capture: &Capture) {
        for (index, excess) in &capture.excess {
            let radiance = self.radiance(*index);
            // Not below 0: the excess was computed from this radiance, but rounds.
            let rest = [0, 1, 2].map(|k| (radiance[k] - excess[k]).max(0.0));
            self.residual.insert(*index, rest);
        }
    }

    /// The light to take around a seed, if it is small and strong enough. Settles its pixels.
    fn capture_around(&mut self, seed: usize, seed_radiance: f32) -> Option<Capture> {
        let top = self.luminance(seed);
        let mut threshold = seed_radiance * FIRST_THRESHOLD as f32;
        let region = loop {
            match self.grow(seed, threshold) {
                Ok(region) => break region,
                Err(visited) if threshold * THRESHOLD_STEP > top * 0.5 => {
                    // Still too large at half its own radiance: an extended light, or smooth sky.
                    self.settled.extend(visited);
                    return None;
                }
                Err(_) => threshold *= THRESHOLD_STEP,
            }
        };
        self.settled.extend(region.iter().copied());
        let window = fit_window(self.grid, &region)?;
        let level = self.level_around(&window);
        let mut best = self.capture(window, level);
        let least = FLUX_SHARE_MIN * self.flux * (best.spread() / SPREAD_MAX).max(1.0);
        if best.flux < least {
            return None;
        }
        let enough = best.flux - (SPILL_MAX * best.flux).max(SPILL_FLUX_MAX * self.flux);
        loop {
            threshold *= THRESHOLD_STEP;
            if threshold > top * 0.5 {
                return Some(best);
            }
            let Ok(region) = self.grow(seed, threshold) else { return Some(best) };
            let Some(window) = fit_window(self.grid, &region) else { return Some(best) };
            let tighter = self.capture(window, level);
            if tighter.flux < enough {
                return Some(best);
            }
            best = tighter;
        }
    }

    /// Pixels connected to the seed that are brighter than `threshold`; as an error what was visited
    /// when they turned out not to fit any window.
    fn grow(&self, seed: usize, threshold: f32) -> Result<Vec<usize>, HashSet<usize>> {
        let frame = frame_around(self.grid, self.grid.center(seed));
        let (mut min, mut max) = ([0f32; 2], [0f32; 2]);
        let mut visited = HashSet::from([seed]);
        let mut region = vec![seed];
        let mut next = 0;
        while let Some(&index) = region.get(next) {
            next += 1;
            let (x, y) = project(&frame, self.grid.center(index));
            (min, max) = ([min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]);
            if (max[0] - min[0]).max(max[1] - min[1]) > 2.0 * HALF_WIDTH_MAX {
                return Err(visited);
            }
            self.grid.visit_neighbors(index, |neighbor| {
                if self.luminance(neighbor) > threshold && visited.insert(neighbor) {
                    region.push(neighbor);
                }
            });
        }
        Ok(region)
    }

    /// What the window's surroundings shine with: the median of each channel over a ring.
    fn level_around(&self, window: &Window) -> [f32; 3] {
        let inner = window.radius() + self.grid.row_angle();
        let outer = inner + (3.0 * self.grid.row_angle()).max(1f32.to_radians());
        let chord = 2.0 * (inner * 0.5).sin();
        let mut ring = Vec::new();
        self.grid.visit_near(window.frame.normal, outer, |index| {
            let offset = self.grid.center(index) - window.frame.normal;
            if offset.length_squared() > chord * chord {
                ring.push(self.radiance(index));
            }
        });
        [0, 1, 2].map(|k| {
            let mut values: Vec<f32> = ring.iter().map(|radiance| radiance[k]).collect();
            if values.is_empty() {
                return 0.0;
            }
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        })
    }

    /// All radiance above `level` of the pixels that lie within the window with all corners.
    fn capture(&self, window: Window, level: [f32; 3]) -> Capture {
        let mut capture = Capture { window, excess: Vec::new(), flux: 0.0, square: 0.0 };
        let reach = window.radius() + self.grid.row_angle();
        self.grid.visit_near(window.frame.normal, reach, |index| {
            let radiance = self.radiance(index);
            let excess = [0, 1, 2].map(|k| (radiance[k] - level[k]).max(0.0));
            let inside = || self.grid.corners(index).iter().all(|c| window.holds(*c));
            if excess != [0.0; 3] && inside() {
                let solid_angle = self.grid.solid_angle(index / self.grid.width);
                let luminance = f64::from(luminance(excess));
                capture.flux += luminance * solid_angle;
                capture.square += luminance * luminance * solid_angle;
                capture.excess.push((index, excess));
            }
        });
        capture
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{read_data, read_reference};
    use pbgi_image::RgbImage;
    use pbgi_math::Vec3;

    const AXES: [Vec3; 3] = [Vec3::X, Vec3::Y, Vec3::Z];

    /// Flux and vector irradiance of green: of all pixels, and of what is left plus the peaks.
    fn balance(
        grid: &LatLong,
        pixels: &[[f32; 3]],
        peaks: &[EnvironmentPeak],
        residual: &BTreeMap<usize, [f32; 3]>,
    ) -> [(f64, [f64; 3]); 2] {
        let mut sums = [(0.0, [0.0; 3]); 2];
        let mut add = |which: usize, flux: f64, direction: Vec3| {
            sums[which].0 += flux;
            (0..3).for_each(|k| sums[which].1[k] += flux * f64::from(direction[k]));
        };
        for (index, pixel) in pixels.iter().enumerate() {
            let solid_angle = grid.solid_angle(index / grid.width);
            let rest = residual.get(&index).unwrap_or(pixel);
            add(0, f64::from(pixel[1]) * solid_angle, grid.center(index));
            add(1, f64::from(rest[1]) * solid_angle, grid.center(index));
        }
        for peak in peaks {
            for i in 0..peak.n * peak.n {
                let (row, column) = (i / peak.n, i % peak.n);
                let solid_angle = f64::from(peak.texel_solid_angle(row, column));
                let flux = f64::from(peak.texels[i][1]) * solid_angle;
                add(1, flux, peak.texel_direction(row, column));
            }
        }
        sums
    }

    fn assert_balanced(
        name: &str,
        grid: &LatLong,
        pixels: &[[f32; 3]],
        peaks: &[EnvironmentPeak],
        residual: &BTreeMap<usize, [f32; 3]>,
    ) {
        let [(flux, vector), (found, found_vector)] = balance(grid, pixels, peaks, residual);
        assert!((found / flux - 1.0).abs() < 1e-5, "{name}: {found} {flux}");
        for k in 0..3 {
            let difference = (found_vector[k] - vector[k]).abs() / flux;
            assert!(difference < 5e-5, "{name}: {difference} {vector:?} {found_vector:?}");
        }
        assert!(residual.values().flatten().all(|c| *c >= 0.0 && c.is_finite()));
    }

    /// Luminance flux that the brightest thousandth of the sphere sends.
    fn brightest_flux(grid: &LatLong, radiance: impl Fn(usize) -> [f32; 3]) -> f64 {
        let mut pixels: Vec<(f64, f64)> = (0..grid.width * grid.height)
            .map(|i| (f64::from(luminance(radiance(i))), grid.solid_angle(i / grid.width)))
            .collect();
        pixels.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut area, mut flux) = (0.0, 0.0);
        for (y, w) in pixels {
            if area > 4.0 * std::f64::consts::PI * 1e-3 {
                break;
            }
            area += w;
            flux += y * w;
        }
        flux
    }

    /// Runs the extraction, prints a summary, and returns the peaks and the brightest share left.
    fn examine(name: &str, image: &RgbImage) -> (Vec<EnvironmentPeak>, f64) {
        let grid = LatLong::new(image.width, image.height, AXES);
        let (peaks, residual) = extract_peaks(&grid, &image.pixels, 32);
        let total = total_flux(&grid, &image.pixels);
        let before = brightest_flux(&grid, |i| image.pixels[i]) / total;
        let left = |i: usize| residual.get(&i).copied().unwrap_or(image.pixels[i]);
        let after = brightest_flux(&grid, left) / total;
        println!(
            "{name}: {} peaks, {} pixels changed; brightest 0.1 % of the sphere: {:.2} % of the flux, then {:.2} %",
            peaks.len(),
            residual.len(),
            before * 100.0,
            after * 100.0
        );
        for peak in &peaks {
            println!(
                "    {:.2}° across, n {}, {:.2} % of the flux, toward {:.3}",
                2.0 * peak.half_width.atan().to_degrees(),
                peak.n,
                f64::from(luminance(peak.flux())) / total * 100.0,
                peak.frame.normal
            );
        }
        assert_balanced(name, &grid, &image.pixels, &peaks, &residual);
        (peaks, after)
    }

    #[test]
    fn real_environments_keep_no_spike() {
        // Name, most peaks, most flux left in the brightest thousandth.
        let cases = [
            ("kloppenheim_05_1k.hdr", 1..=2, 0.03),
            ("st_peters_square_night_1k.hdr", 8..=32, 0.20),
            ("StageEnvLatLong.exr", 2..=12, 0.20),
            ("potsdamer_platz_1k.hdr", 0..=0, 0.01),
        ];
        for (name, count, share) in cases {
            let Some(image) = read_data(name) else { continue };
            let (peaks, left) = examine(name, &image);
            assert!(count.contains(&peaks.len()), "{name}: {}", peaks.len());
            assert!(left < share, "{name}: {left}");
        }
    }

    #[test]
    fn reference_sun_is_one_tight_peak() {
        if let Some(image) = read_reference("plaza_sky.exr") {
            assert!(examine("plaza_sky.exr", &image).0.is_empty());
        }
        let Some(image) = read_reference("plaza_sky_sun.exr") else { return };
        let (peaks, _) = examine("plaza_sky_sun.exr", &image);
        assert_eq!(peaks.len(), 1);
        let sun = Vec3::new(-0.519_837, 0.819_152, -0.242_404);
        let facing = [peaks[0].irradiance(Vec3::X)[1], peaks[0].irradiance(Vec3::NEG_X)[1]];
        let height = peaks[0].irradiance(Vec3::Y)[1] / peaks[0].flux()[1];
        assert!((height - sun.y).abs() < 5e-5, "{height}");
        assert!((facing[1] / peaks[0].flux()[1] + sun.x).abs() < 5e-5 && facing[0] == 0.0);
        let width = 2.0 * peaks[0].half_width.atan().to_degrees();
        assert!((0.53..0.8).contains(&width), "{width}");
        assert!(8 <= peaks[0].n, "{}", peaks[0].n);
        for (found, expected) in peaks[0].flux().into_iter().zip([2.2177, 1.9825, 1.6129]) {
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        }
    }

    /// A gray sky of radiance 1 with pixels of radiance 10⁵ in it.
    fn sky_with(width: usize, lit: &[usize]) -> (LatLong, Vec<[f32; 3]>) {
        let grid = LatLong::new(width, width / 2, AXES);
        let mut pixels = vec![[1.0; 3]; width * width / 2];
        for index in lit {
            pixels[*index] = [1e5, 9e4, 7e4];
        }
        (grid, pixels)
    }

    #[test]
    fn suns_of_one_pixel_survive_anywhere() {
        let width = 1024;
        let at = |u: usize, v: usize| v * width + u;
        // Cube face corner: direction (1, 1, 1)/√3 is at φ = 135°, θ = 54.7°.
        let cases = [
            ("corner", at(384, 155)),
            ("seam", at(0, 200)),
            ("other side of the seam", at(1023, 200)),
            ("near the pole", at(700, 9)),
            ("near the nadir", at(30, 505)),
        ];
        for (name, index) in cases {
            let (grid, pixels) = sky_with(width, &[index]);
            let (peaks, residual) = extract_peaks(&grid, &pixels, 32);
            assert_eq!(peaks.len(), 1, "{name}");
            assert_eq!(residual.len(), 1, "{name}");
            assert_eq!(residual[&index], [1.0; 3], "{name}");
            assert!((peaks[0].frame.normal - grid.center(index)).length() < 1e-4, "{name}");
            assert!(peaks[0].half_width.atan().to_degrees() < 0.2, "{name}");
            assert_balanced(name, &grid, &pixels, &peaks, &residual);
        }
    }

    #[test]
    fn pixels_of_one_lamp_make_one_peak_across_the_seam() {
        let width = 1024;
        let lit: Vec<usize> =
            (0..3).flat_map(|r| [1022, 1023, 0, 1].map(|c| (250 + r) * width + c)).collect();
        let (grid, pixels) = sky_with(width, &lit);
        let (peaks, residual) = extract_peaks(&grid, &pixels, 32);
        assert_eq!(peaks.len(), 1);
        let across = 2.0 * peaks[0].half_width.atan().to_degrees();
        assert!((across - 4.0 * 360.0 / 1024.0).abs() < 0.02, "{across}");
        assert_balanced("seam", &grid, &pixels, &peaks, &residual);
    }

    #[test]
    fn a_ring_of_pixels_around_the_pole_is_one_peak() {
        let lit: Vec<usize> = (0..2048).collect();
        let (grid, pixels) = sky_with(1024, &lit);
        let (peaks, residual) = extract_peaks(&grid, &pixels, 32);
        assert_eq!(peaks.len(), 1);
        assert!(peaks[0].frame.normal.y > 0.999_99);
        assert_balanced("pole", &grid, &pixels, &peaks, &residual);
    }

    #[test]
    fn distant_lamps_are_apart_and_the_strongest_are_kept() {
        let width = 1024;
        let lit = [200 * width + 100, 250 * width + 500, 300 * width + 900];
        let (grid, mut pixels) = sky_with(width, &lit);
        pixels[lit[1]] = [3e5; 3];
        let (peaks, residual) = extract_peaks(&grid, &pixels, 32);
        assert_eq!(peaks.len(), 3);
        assert_balanced("three", &grid, &pixels, &peaks, &residual);
        let (peaks, residual) = extract_peaks(&grid, &pixels, 1);
        assert_eq!(peaks.len(), 1);
        assert!((peaks[0].frame.normal - grid.center(lit[1])).length() < 1e-4);
        assert_eq!(residual[&lit[0]], pixels[lit[0]]);
        assert_balanced("one", &grid, &pixels, &peaks, &residual);
    }

    #[test]
    fn lights_become_peaks_from_their_share_of_the_flux_on() {
        let width = 1024;
        let index = 250 * width + 300;
        for (share, count) in [(0.002, 0), (0.0029, 0), (0.0031, 1), (0.01, 1)] {
            let (grid, mut pixels) = sky_with(width, &[]);
            // The rest of the sky sends 4π.
            let flux = 4.0 * std::f64::consts::PI * share / (1.0 - share);
            pixels[index] = [(1.0 + flux / grid.solid_angle(250)) as f32; 3];
            let (peaks, residual) = extract_peaks(&grid, &pixels, 32);
            assert_eq!((peaks.len(), residual.len()), (count, count), "{share}");
        }
    }

    #[test]
    fn extended_lights_stay_in_the_base() {
        let width = 512;
        let (grid, mut pixels) = sky_with(width, &[]);
        for (index, pixel) in pixels.iter_mut().enumerate() {
            let (x, y) = (index % width, index / width);
            if (100..112).contains(&x) && (120..132).contains(&y) {
                *pixel = [1e4; 3];
            }
        }
        let (peaks, residual) = extract_peaks(&grid, &pixels, 32);
        assert!(peaks.is_empty() && residual.is_empty());
    }
}
