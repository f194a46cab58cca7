//! A window: a small square of fine texels around one direction, for light from few directions.

use crate::lanes::{Lanes, SAMPLES};
use crate::samples::Veil;
use crate::shape::{Rims, Shape};
use pbgi_math::{Frame, Vec3};

/// Directions of a [`WindowRaster`]: `n × n` texels, gnomonic around `frame.normal`.
///
/// Texel (row, column) points along `normal + x·tangent + y·bitangent` with x (columns) and y (rows)
/// in `−half_width..half_width`.
#[derive(Clone, Debug)]
pub struct Window {
    frame: Frame,
    half_width: f32,
    /// Directions of the texels, row by row, in groups of sixteen; those beyond the last are 0.
    directions: Vec<[[f32; SAMPLES]; 3]>,
    /// Which of each group are texels.
    used: Vec<u16>,
}

impl Window {
    /// Window of `n × n` texels around `frame.normal`, `2 half_width` wide at distance 1.
    #[must_use]
    pub fn new(frame: Frame, half_width: f32, n: usize) -> Self {
        let groups = (n * n).div_ceil(SAMPLES);
        let mut directions = vec![[[0.0; SAMPLES]; 3]; groups];
        let mut used = vec![0; groups];
        let at = |i: usize| ((2 * i + 1) as f32 / n as f32 - 1.0) * half_width;
        for index in 0..n * n {
            let (x, y) = (at(index % n), at(index / n));
            let d = frame.normal + frame.tangent * x + frame.bitangent * y;
            let (group, lane) = (index / SAMPLES, index % SAMPLES);
            for axis in 0..3 {
                directions[group][axis][lane] = d[axis];
            }
            used[group] |= 1 << lane;
        }
        Self { frame, half_width, directions, used }
    }

    /// The window's axis and orientation.
    #[must_use]
    #[inline(always)]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Whether the box `low..=high`, relative to the receiver, may reach into the window. Conservative.
    #[must_use]
    #[inline(always)]
    pub fn is_met_by(&self, low: Vec3, high: Vec3) -> bool {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let c = self.frame.to_local(center);
        let reach = |axis: Vec3| axis.abs().dot(half);
        let Frame { tangent, bitangent, normal } = self.frame;
        let far = c.z + reach(normal);
        // Outside one of the window's four planes |x| ≤ w z: conservative against the far side.
        let w = self.half_width;
        far > 0.0
            && c.x.abs() - reach(tangent) <= w * far
            && c.y.abs() - reach(bitangent) <= w * far
    }
}

/// Which of a [`Window`]'s texels surfaces cover.
#[derive(Clone, Debug, Default)]
pub struct WindowRaster {
    covered: Vec<u16>,
    rims: Vec<Rims>,
    is_closed: bool,
}

impl WindowRaster {
    /// Empties the raster for `window`.
    #[inline(always)]
    pub fn clear(&mut self, window: &Window) {
        self.covered.clear();
        self.covered.extend(window.used.iter().map(|used| !used));
        self.rims.clear();
        self.rims.resize(self.covered.len(), Rims::default());
        self.is_closed = false;
    }

    /// Whether every texel is covered.
    #[must_use]
    #[inline(always)]
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// Whether texel `row · n + column` is open.
    #[must_use]
    #[inline(always)]
    pub fn is_open(&self, index: usize) -> bool {
        self.covered[index / SAMPLES] >> (index % SAMPLES) & 1 == 0
    }

    /// Draws a shape: texels whose middle meets it are covered, as far as the veil does.
    #[inline(always)]
    pub fn draw<L: Lanes, S: Shape>(&mut self, window: &Window, shape: &S, veil: &Veil) {
        let inverse = shape.inverse();
        let mut open = 0;
        for (group, (covered, d)) in self.covered.iter_mut().zip(&window.directions).enumerate() {
            if *covered == u16::MAX {
                continue;
            }
            let d = [L::load(&d[0]), L::load(&d[1]), L::load(&d[2])];
            let w = d[0]
                .mul(L::splat(inverse.x))
                .add(d[1].mul(L::splat(inverse.y)))
                .add(d[2].mul(L::splat(inverse.z)));
            let met = shape.meets(d, w).close(shape, &mut self.rims[group]);
            *covered |= if veil.is_opaque() { met } else { met & veil.samples(group) };
            open |= !*covered;
        }
        self.is_closed = open == 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Plain;
    use crate::{Disk, Section};

    const N: usize = 8;

    fn window() -> Window {
        let frame = Frame::from_normal(Vec3::new(0.3, 0.9, -0.2).normalize());
        Window::new(frame, 0.01, N)
    }

    fn open_share(raster: &WindowRaster) -> f32 {
        (0..N * N).filter(|i| raster.is_open(*i)).count() as f32 / (N * N) as f32
    }

    fn disk(center: Vec3, normal: Vec3, radius: f32) -> Disk {
        Disk {
            inverse: normal / center.dot(normal),
            center,
            radius,
            reach: radius,
            ..Disk::default()
        }
    }

    #[test]
    fn a_half_covering_disk_covers_half_the_window() {
        let window = window();
        let mut raster = WindowRaster::default();
        raster.clear(&window);
        let axis = window.frame.normal;
        // A big disk whose rim passes through the window's middle.
        let half = disk(axis * 10.0 + window.frame.tangent * 5.0, -axis, 5.0);
        raster.draw::<Plain, _>(&window, &half, &Veil::OPAQUE);
        assert!((open_share(&raster) - 0.5).abs() < 0.07);
        assert!(!raster.is_closed());
        raster.draw::<Plain, _>(&window, &disk(axis * 12.0, axis, 5.0), &Veil::OPAQUE);
        assert!(raster.is_closed());
    }

    #[test]
    fn a_veiled_section_covers_its_share() {
        let window = window();
        let axis = window.frame.normal;
        let center = axis * 100.0;
        let (low, high) = (center - 10.0, center + 10.0);
        let section = Section::new(axis / 100.0, low, high);
        let mut open = 0.0;
        for seed in 0..200 {
            let mut raster = WindowRaster::default();
            raster.clear(&window);
            let veil = Veil { start: 0.0, end: 0.3, seed };
            raster.draw::<Plain, _>(&window, &section, &veil);
            open += open_share(&raster) / 200.0;
        }
        assert!((open - 0.7).abs() < 0.01, "{open}");
    }

    #[test]
    fn boxes_outside_or_behind_are_not_met() {
        let window = window();
        for center in [window.frame.normal * -10.0, window.frame.tangent * 10.0] {
            assert!(!window.is_met_by(center - 0.5, center + 0.5));
        }
        let ahead = window.frame.normal * 10.0;
        assert!(window.is_met_by(ahead - 0.5, ahead + 0.5));
    }
}
