//! A window: a small square of fine texels around one direction, for light from few directions.

use crate::{larger, smaller};
use pbgi_math::{Aabb, Frame, Vec3};

/// Directions of a [`WindowRaster`]: `n × n` texels, gnomonic around `frame.normal`.
///
/// Texel (row, column) points along `normal + x·tangent + y·bitangent` with x (columns) and y (rows)
/// in `−half_width..half_width`.
#[derive(Clone, Debug)]
pub struct Window {
    /// The window's axis and orientation.
    pub frame: Frame,
    /// Half the window's width on the plane at distance 1.
    pub half_width: f32,
    /// Texels along an edge.
    pub n: usize,
}

/// Coverage of a [`Window`]'s texels, composited front to back as in [`crate::CubeRaster`].
#[derive(Clone, Debug)]
pub struct WindowRaster {
    covered: Vec<f32>,
    unmatched: Vec<f32>,
    n: usize,
    half_width: f32,
    open_count: usize,
}

impl Default for WindowRaster {
    fn default() -> Self {
        Self { covered: Vec::new(), unmatched: Vec::new(), n: 0, half_width: 0.0, open_count: 0 }
    }
}

impl WindowRaster {
    /// Empties the raster for `window`.
    #[inline(always)]
    pub fn clear(&mut self, window: &Window) {
        self.n = window.n;
        self.half_width = window.half_width;
        self.covered.clear();
        self.covered.resize(window.n * window.n, 0.0);
        self.unmatched.clear();
        self.unmatched.resize(window.n * window.n, 0.0);
        self.open_count = window.n * window.n;
    }

    /// Whether every texel is opaque.
    #[must_use]
    #[inline(always)]
    pub fn is_closed(&self) -> bool {
        self.open_count == 0
    }

    /// Share of texel (row, column) that no surface covers.
    #[must_use]
    #[inline(always)]
    pub fn openness(&self, row: usize, column: usize) -> f32 {
        1.0 - self.covered[row * self.n + column]
    }

    /// Rectangle of the box `low..=high` (relative to the receiver) in window coordinates:
    /// `(x0, x1, y0, y1)`, or none where it is outside the window or behind the receiver.
    #[inline(always)]
    #[must_use]
    pub fn project_box(&self, window: &Window, low: Vec3, high: Vec3) -> Option<[f32; 4]> {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let frame = &window.frame;
        let c = frame.to_local(center);
        let reach = |axis: Vec3| axis.abs().dot(half);
        let (hx, hy, hz) = (reach(frame.tangent), reach(frame.bitangent), reach(frame.normal));
        let far = c.z + hz;
        if far <= 0.0 {
            return None;
        }
        let w = self.half_width;
        let near = larger(c.z - hz, 1e-3 * far);
        // Outside one of the window's four planes |x| ≤ w z: conservative against the far side.
        if c.x.abs() - hx > w * far || c.y.abs() - hy > w * far {
            return None;
        }
        let (inverse_near, inverse_far) = (1.0 / near, 1.0 / far);
        let project = |low: f32, high: f32| {
            let a = low * if low >= 0.0 { inverse_far } else { inverse_near };
            let b = high * if high >= 0.0 { inverse_near } else { inverse_far };
            (larger(a, -w), smaller(b, w))
        };
        let (x0, x1) = project(c.x - hx, c.x + hx);
        let (y0, y1) = project(c.y - hy, c.y + hy);
        (x0 < x1 && y0 < y1).then_some([x0, x1, y0, y1])
    }

    #[inline(always)]
    fn span(&self, low: f32, high: f32) -> (usize, usize) {
        let scale = self.n as f32 / (2.0 * self.half_width);
        let first = ((low + self.half_width) * scale) as usize;
        let last = ((high + self.half_width) * scale) as usize;
        (first.min(self.n - 1), last.min(self.n - 1))
    }

    /// Whether any texel the box touches is not yet opaque.
    #[must_use]
    #[inline(always)]
    pub fn is_box_open(&self, window: &Window, low: Vec3, high: Vec3) -> bool {
        if self.is_closed() {
            return false;
        }
        let Some([x0, x1, y0, y1]) = self.project_box(window, low, high) else { return false };
        let (c0, c1) = self.span(x0, x1);
        let (r0, r1) = self.span(y0, y1);
        (r0..=r1).any(|row| (c0..=c1).any(|column| self.openness(row, column) > 0.0))
    }

    /// Draws a cluster in the box `low..=high` that covers the shares `front` and `back` of the box's
    /// silhouette, whose area seen from the receiver is `silhouette`.
    #[inline(always)]
    pub fn draw_box(
        &mut self,
        window: &Window,
        low: Vec3,
        high: Vec3,
        silhouette: f32,
        (front, back): (f32, f32),
    ) {
        let Some([x0, x1, y0, y1]) = self.project_box(window, low, high) else { return };
        // Share of the rectangle around the box, turned to the window, that the silhouette fills.
        let half = (high - low) * 0.5;
        let reach = |axis: Vec3| 2.0 * axis.abs().dot(half);
        let rectangle = reach(window.frame.tangent) * reach(window.frame.bitangent);
        let fill = smaller(silhouette / larger(rectangle, 1e-30), 1.0);
        let (front, back) = (front * fill, back * fill);
        let scale = self.n as f32 / (2.0 * self.half_width);
        let texel = |x: f32| (x + self.half_width) * scale;
        let (u0, u1, v0, v1) = (texel(x0), texel(x1), texel(y0), texel(y1));
        let (c0, c1) = self.span(x0, x1);
        let (r0, r1) = self.span(y0, y1);
        for row in r0..=r1 {
            let rows = larger(smaller(v1, row as f32 + 1.0) - larger(v0, row as f32), 0.0);
            for column in c0..=c1 {
                let columns =
                    larger(smaller(u1, column as f32 + 1.0) - larger(u0, column as f32), 0.0);
                self.add(row * self.n + column, front * rows * columns, back * rows * columns);
            }
        }
    }

    /// Draws a disk: texels whose central direction meets it farther than `distance_min` away are
    /// covered.
    #[inline(always)]
    pub fn draw_disk(
        &mut self,
        window: &Window,
        disk: &crate::Disk,
        opacity: f32,
        front_only: bool,
        distance_min: f32,
    ) {
        let height = disk.center.dot(disk.normal);
        let facing = height < 0.0;
        if height == 0.0 || (front_only && !facing) {
            return;
        }
        let (front, back) = if facing { (opacity, 0.0) } else { (0.0, opacity) };
        let aabb = Aabb::from_disk(disk.center, disk.normal, disk.radius);
        let Some([x0, x1, y0, y1]) = self.project_box(window, aabb.min, aabb.max) else { return };
        let (c0, c1) = self.span(x0, x1);
        let (r0, r1) = self.span(y0, y1);
        let n = window.frame.to_local(disk.normal);
        let c = window.frame.to_local(disk.center);
        let slack = c.length_squared() - disk.radius * disk.radius;
        let step = 2.0 * self.half_width / self.n as f32;
        let near2 = distance_min * distance_min;
        for row in r0..=r1 {
            let y = (row as f32 + 0.5) * step - self.half_width;
            for column in c0..=c1 {
                let x = (column as f32 + 0.5) * step - self.half_width;
                // As in `CubeRaster::draw_disk`.
                let (nd, cd) = (n.x * x + n.y * y + n.z, c.x * x + c.y * y + c.z);
                let dd = x * x + y * y + 1.0;
                let q = height * height * dd - 2.0 * height * cd * nd + slack * nd * nd;
                let hit =
                    (q <= 0.0) & (nd * height > 0.0) & (height * height * dd > near2 * nd * nd);
                if hit {
                    self.add(row * self.n + column, front, back);
                }
            }
        }
    }

    #[inline(always)]
    fn add(&mut self, index: usize, front: f32, back: f32) {
        let before = self.covered[index];
        let surplus = back - (self.unmatched[index] + front);
        self.unmatched[index] = larger(-surplus, 0.0);
        let after = smaller(before + front + larger(surplus, 0.0), 1.0);
        self.covered[index] = after;
        if before < 1.0 && after >= 1.0 {
            self.open_count -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Disk;

    fn window() -> Window {
        let frame = Frame::from_normal(Vec3::new(0.3, 0.9, -0.2).normalize());
        Window { frame, half_width: 0.01, n: 8 }
    }

    fn open_share(raster: &WindowRaster) -> f32 {
        (0..64).map(|i| raster.openness(i / 8, i % 8)).sum::<f32>() / 64.0
    }

    #[test]
    fn a_half_covering_disk_covers_half_the_window() {
        let window = window();
        let mut raster = WindowRaster::default();
        raster.clear(&window);
        let axis = window.frame.normal;
        // A big disk whose rim passes through the window's middle.
        let disk =
            Disk { center: axis * 10.0 + window.frame.tangent * 5.0, normal: -axis, radius: 5.0 };
        assert!(raster.is_box_open(&window, axis * 10.0 - 0.1, axis * 10.0 + 0.1));
        raster.draw_disk(&window, &disk, 1.0, false, 0.0);
        assert!((open_share(&raster) - 0.5).abs() < 0.07);
        let full = Disk { center: axis * 12.0, normal: axis, radius: 5.0 };
        raster.draw_disk(&window, &full, 1.0, true, 0.0);
        assert!((open_share(&raster) - 0.5).abs() < 0.07);
        raster.draw_disk(&window, &full, 1.0, false, 0.0);
        assert!(raster.is_closed());
        assert!(!raster.is_box_open(&window, axis * 20.0 - 0.1, axis * 20.0 + 0.1));
    }

    #[test]
    fn boxes_carry_their_solid_angle() {
        let window = window();
        let mut raster = WindowRaster::default();
        raster.clear(&window);
        let center = window.frame.normal * 100.0 + window.frame.tangent * 0.3;
        let half = Vec3::splat(0.2);
        let d = window.frame.normal.abs();
        let silhouette = 4.0 * 0.04 * (d.x + d.y + d.z);
        let solid_angle = 0.5 * silhouette / 1e4;
        raster.draw_box(&window, center - half, center + half, silhouette, (0.5, 0.0));
        let texel = (0.02f32 / 8.0).powi(2);
        let drawn = (1.0 - open_share(&raster)) * 64.0 * texel;
        assert!((drawn / solid_angle - 1.0).abs() < 0.02, "{drawn} {solid_angle}");
    }

    #[test]
    fn boxes_outside_or_behind_are_not_seen() {
        let window = window();
        let mut raster = WindowRaster::default();
        raster.clear(&window);
        for center in [window.frame.normal * -10.0, window.frame.tangent * 10.0] {
            assert!(!raster.is_box_open(&window, center - 0.5, center + 0.5));
        }
    }
}
