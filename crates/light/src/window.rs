//! Windows around small lights: where they lie, and the light that goes into them.

use crate::EnvironmentPeak;
use crate::lat_long::LatLong;
use pbgi_math::{Frame, Vec3, luminance};

/// Texels along the edge of a peak's window.
const TEXELS: std::ops::RangeInclusive<usize> = 6..=12;

/// A square on the plane at distance 1 around `frame.normal`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub frame: Frame,
    pub half_width: f32,
}

impl Window {
    pub fn project(&self, direction: Vec3) -> (f32, f32) {
        project(&self.frame, direction)
    }

    pub fn holds(&self, direction: Vec3) -> bool {
        let (x, y) = self.project(direction);
        x.abs().max(y.abs()) <= self.half_width
    }

    /// Angle from the center to a corner, in radians.
    pub fn radius(&self) -> f32 {
        (self.half_width * std::f32::consts::SQRT_2).atan()
    }
}

/// Position of a direction on the plane at distance 1 around the frame's normal.
pub(crate) fn project(frame: &Frame, direction: Vec3) -> (f32, f32) {
    let local = frame.to_local(direction);
    (local.x / local.z, local.y / local.z)
}

/// A frame whose tangent is horizontal, so that windows are aligned with the rows of the image.
pub(crate) fn frame_around(grid: &LatLong, direction: Vec3) -> Frame {
    let normal = direction.normalize();
    let horizontal = grid.zenith().cross(normal);
    if horizontal.length_squared() < 1e-4 {
        return Frame::from_normal(normal);
    }
    let tangent = horizontal.normalize();
    Frame { tangent, bitangent: normal.cross(tangent), normal }
}

/// The smallest window around whole pixels; `None` where the pixels are too large for any.
pub(crate) fn fit_window(grid: &LatLong, region: &[usize]) -> Option<Window> {
    let sum: Vec3 = region.iter().map(|index| grid.center(*index)).sum();
    let corners: Vec<Vec3> = region.iter().flat_map(|index| grid.corners(*index)).collect();
    let mut frame = frame_around(grid, sum);
    let (mut min, mut max) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for corner in &corners {
        let (x, y) = project(&frame, *corner);
        (min, max) = ([min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]);
    }
    let middle = Vec3::new((min[0] + max[0]) * 0.5, (min[1] + max[1]) * 0.5, 1.0);
    frame = frame_around(grid, frame.to_world(middle));
    let reach = corners.iter().map(|corner| {
        let (x, y) = project(&frame, *corner);
        x.abs().max(y.abs())
    });
    // A little wider, so that rounding leaves no corner outside; pixels add to the largest region.
    let half_width = reach.fold(0f32, f32::max) * 1.0001 + 1e-6;
    (half_width < 0.05).then_some(Window { frame, half_width })
}

/// Moves the excess of pixels into the texels of a window.
///
/// Each pixel is divided into parts of a quarter texel at most. Then the window is moved by the
/// difference of the light's centroid before and after (below a texel), so that the irradiance of
/// every surface above whose horizon the window stands is that of the pixels.
pub(crate) fn fill_window(
    grid: &LatLong,
    window: Window,
    excess: &[(usize, [f32; 3])],
) -> EnvironmentPeak {
    let pixel = grid.row_angle();
    let wanted = (1.25 * 2.0 * window.half_width / pixel).ceil() as usize;
    let n = wanted.clamp(*TEXELS.start(), *TEXELS.end());
    let texel_edge = 2.0 * window.half_width / n as f32;
    let parts = ((4.0 * pixel / texel_edge).ceil() as usize).clamp(2, 32);
    let mut flux = vec![[0f64; 3]; n * n];
    let mut moment = [0f64; 3];
    for (index, radiance) in excess {
        let (column, row) = (index % grid.width, index / grid.width);
        let step = 1.0 / parts as f64;
        for part in 0..parts * parts {
            let u = column as f64 + ((part % parts) as f64 + 0.5) * step;
            let v = row as f64 + (part / parts) as f64 * step;
            let azimuth = std::f64::consts::TAU / grid.width as f64 * step;
            let solid_angle = grid.slice_solid_angle(v, v + step) * azimuth;
            let (x, y) = window.project(grid.direction(u, v + 0.5 * step));
            let cell =
                |p: f32| (((p / window.half_width + 1.0) * 0.5 * n as f32) as usize).min(n - 1);
            let texel = &mut flux[cell(y) * n + cell(x)];
            (0..3).for_each(|k| texel[k] += f64::from(radiance[k]) * solid_angle);
            let weight = f64::from(luminance(*radiance)) * solid_angle;
            moment[0] += weight * f64::from(x);
            moment[1] += weight * f64::from(y);
            moment[2] += weight;
        }
    }
    let half_width = window.half_width;
    let mut peak = EnvironmentPeak { frame: window.frame, half_width, n, texels: Vec::new() };
    for (i, flux) in flux.into_iter().enumerate() {
        let (row, column) = (i / n, i % n);
        let solid_angle = f64::from(peak.texel_solid_angle(row, column));
        let position = peak.texel_direction(row, column);
        let (x, y) = window.project(position);
        let rgb = flux.map(|f| f as f32);
        let weight = f64::from(luminance(rgb));
        moment[0] -= weight * f64::from(x);
        moment[1] -= weight * f64::from(y);
        peak.texels.push(flux.map(|f| (f / solid_angle) as f32));
    }
    peak.frame = shift(&window.frame, moment[0] / moment[2], moment[1] / moment[2]);
    peak
}

/// The frame turned so that its normal moves by (x, y) on the plane at distance 1.
fn shift(frame: &Frame, x: f64, y: f64) -> Frame {
    if !(x.is_finite() && y.is_finite()) {
        return *frame;
    }
    let normal = frame.to_world(Vec3::new(x as f32, y as f32, 1.0)).normalize();
    let bitangent = normal.cross(frame.tangent).normalize();
    Frame { tangent: bitangent.cross(normal), bitangent, normal }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light of one hue, so that the centroid of luminance is that of each channel.
    #[test]
    fn light_keeps_its_flux_and_centroid() {
        let grid = LatLong::new(1024, 512, [Vec3::X, Vec3::Y, Vec3::Z]);
        for start in [100 * 1024 + 300, 250 * 1024 + 1022, 7 * 1024 + 511] {
            let region: Vec<usize> =
                (0..3).flat_map(|r| (0..2).map(move |c| start + r * 1024 + c)).collect();
            let window = fit_window(&grid, &region).unwrap();
            let excess: Vec<(usize, [f32; 3])> = region
                .iter()
                .enumerate()
                .map(|(i, index)| (*index, [1.0, 0.7, 0.2].map(|c| c * (i * i + 1) as f32)))
                .collect();
            let peak = fill_window(&grid, window, &excess);
            let (mut exact, mut found) = ([0f64; 4], [0f64; 4]);
            let add = |sum: &mut [f64; 4], flux: f64, direction: Vec3| {
                (0..3).for_each(|k| sum[k] += flux * f64::from(direction[k]));
                sum[3] += flux;
            };
            for (index, radiance) in &excess {
                let (u, v) = ((index % 1024) as f64 + 0.5, (index / 1024) as f64);
                for slice in 0..64 {
                    let (v0, v1) = (v + slice as f64 / 64.0, v + (slice + 1) as f64 / 64.0);
                    let solid_angle =
                        grid.slice_solid_angle(v0, v1) * std::f64::consts::TAU / 1024.0;
                    let flux = f64::from(radiance[0]) * solid_angle;
                    add(&mut exact, flux, grid.direction(u, 0.5 * (v0 + v1)));
                }
            }
            for i in 0..peak.n * peak.n {
                let (row, column) = (i / peak.n, i % peak.n);
                let solid_angle = f64::from(peak.texel_solid_angle(row, column));
                let flux = f64::from(peak.texels[i][0]) * solid_angle;
                add(&mut found, flux, peak.texel_direction(row, column));
            }
            for k in 0..4 {
                // Rounding of directions, and the curvature of a window 0.02 rad wide.
                let difference = (found[k] - exact[k]).abs() / exact[3];
                assert!(difference < 3e-6, "{start}: {found:?} {exact:?}");
            }
        }
    }
}
