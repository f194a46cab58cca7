//! A window: a small square of fine texels around one direction, for light from few directions.

use crate::cube::Ink;
use crate::lanes::{Lanes, SAMPLES};
use crate::samples::Veil;
use crate::shape::{Rims, Shape};
use pbgi_math::{Frame, Vec3, larger};

/// Directions of a [`WindowRaster`]: `n × n` texels, gnomonic around `frame.normal`.
///
/// Texel (row, column) points along `normal + x·tangent + y·bitangent` with x (columns) and y (rows) in `−half_width..half_width` of each: along its
/// middle, or a place in it.
#[derive(Clone, Debug)]
pub struct Window {
    frame: Frame,
    half_widths: [f32; 2],
    /// Places along x of a texel in each row, and along y of one in each column, 0 to 1.
    places: Vec<f32>,
    /// Directions of the texels, row by row, in groups of sixteen; those beyond the last are 0.
    directions: Vec<[[f32; SAMPLES]; 3]>,
    /// Which of each group are texels.
    used: Vec<u16>,
}

impl Window {
    /// Window of `n × n` texels around `frame.normal`, `2 half_width` wide at distance 1.
    #[must_use]
    pub fn new(frame: Frame, half_width: f32, n: usize) -> Self {
        Self::with_places(frame, half_width, vec![0.5; n])
    }

    /// A window of 2ⁿ × 2ⁿ texels, to be aimed. No two of their directions have the same x or y: an edge along rows or columns is as sharp as any.
    #[must_use]
    pub fn scattered(log2_n: u32) -> Self {
        let n = 1u32 << log2_n;
        let place = |i: u32| ((i << (u32::BITS - log2_n)).reverse_bits() as f32 + 0.5) / n as f32;
        Self::with_places(Frame::from_normal(Vec3::Z), 1.0, (0..n).map(place).collect())
    }

    fn with_places(frame: Frame, half_width: f32, places: Vec<f32>) -> Self {
        let n = places.len();
        let groups = (n * n).div_ceil(SAMPLES);
        let mut used = vec![0; groups];
        for index in 0..n * n {
            used[index / SAMPLES] |= 1 << (index % SAMPLES);
        }
        let directions = vec![[[0.0; SAMPLES]; 3]; groups];
        let mut window = Self { frame, half_widths: [half_width; 2], places, directions, used };
        window.aim(frame, [half_width; 2]);
        window
    }

    /// Turns the window to another direction and makes it so wide along its tangent and bitangent.
    pub fn aim(&mut self, frame: Frame, half_widths: [f32; 2]) {
        (self.frame, self.half_widths) = (frame, half_widths);
        let n = self.places.len();
        let at =
            |i: usize, place: f32, half: f32| (2.0 * (i as f32 + place) / n as f32 - 1.0) * half;
        for row in 0..n {
            for column in 0..n {
                let x = at(column, self.places[row], half_widths[0]);
                let y = at(row, self.places[column], half_widths[1]);
                let d = frame.normal + frame.bitangent * y + frame.tangent * x;
                let index = row * n + column;
                let group = &mut self.directions[index / SAMPLES];
                for axis in 0..3 {
                    group[axis][index % SAMPLES] = d[axis];
                }
            }
        }
    }

    /// The window's axis and orientation.
    #[must_use]
    #[inline(always)]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Width and height of a texel at distance 1.
    #[must_use]
    #[inline(always)]
    pub fn texel_widths(&self) -> [f32; 2] {
        self.half_widths.map(|half| 2.0 * half / self.places.len() as f32)
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
        let [wx, wy] = self.half_widths;
        far > 0.0
            && c.x.abs() - reach(tangent) <= wx * far
            && c.y.abs() - reach(bitangent) <= wy * far
    }
}

/// Which of a [`Window`]'s texels surfaces cover: those that stand before the light behind it, which is infinitely far away, or of lamps.
#[derive(Clone, Debug, Default)]
pub struct WindowRaster {
    covered: Vec<u16>,
    rims: Vec<Rims>,
    is_closed: bool,
    /// Lamps, if that is what the window looks at.
    lamps: Vec<LampTexels>,
}

/// The lamps that sixteen texels show.
#[derive(Clone, Copy, Debug, Default)]
struct LampTexels {
    shown: u16,
    /// Inverse depth along the window's axis, times 1 + the tolerance for neighbors on the same surface; 0 where no lamp is.
    depths: [f32; SAMPLES],
    /// By channel.
    radiance: [[f32; SAMPLES]; 3],
}

impl WindowRaster {
    /// Empties the raster for `window`, for light that is infinitely far away.
    #[inline(always)]
    pub fn clear(&mut self, window: &Window) {
        self.covered.clear();
        self.covered.extend(window.used.iter().map(|used| !used));
        self.rims.clear();
        self.rims.resize(self.covered.len(), Rims::default());
        self.is_closed = false;
        self.lamps.clear();
    }

    /// Empties the raster for lamps, none yet: nothing else is looked at.
    #[inline(always)]
    pub fn clear_for_lamps(&mut self, window: &Window) {
        self.clear(window);
        self.lamps.resize(self.covered.len(), LampTexels::default());
    }

    /// Closes all texels that show no lamp.
    #[inline(always)]
    pub fn close_around_lamps(&mut self) {
        let mut shown = 0;
        for (group, lamps) in self.lamps.iter().enumerate() {
            self.covered[group] = !lamps.shown;
            self.rims[group] = Rims::default();
            shown |= lamps.shown;
        }
        self.is_closed = shown == 0;
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

    /// Shows a lamp of this radiance, where no nearer one is; surfaces nearer by no more than the share `tolerance` are its own neighbors.
    #[inline(always)]
    pub fn show_lamp<L: Lanes, S: Shape>(&mut self, window: &Window, shape: &S, ink: &Ink) {
        let inverse = shape.inverse();
        for (group, (lamps, d)) in self.lamps.iter_mut().zip(&window.directions).enumerate() {
            let (d, w) = depths_along::<L>(inverse, d);
            let met = shape.meets(d, w).close(shape, &mut self.rims[group]) & window.used[group];
            let w = w.mul(L::splat(1.0 + ink.tolerance));
            let nearer = met & !L::bits(w.le(L::load(&lamps.depths)));
            if nearer == 0 {
                continue;
            }
            w.store_where(nearer, &mut lamps.depths);
            for (plane, radiance) in lamps.radiance.iter_mut().zip(ink.radiance) {
                L::splat(radiance).store_where(nearer, plane);
            }
            lamps.shown |= nearer;
        }
    }

    /// Draws a shape: texels whose middle meets it before their light are covered, as far as the veil does.
    #[inline(always)]
    pub fn draw<L: Lanes, S: Shape>(&mut self, window: &Window, shape: &S, veil: &Veil) {
        let (inverse, pattern) = (shape.inverse(), veil.pattern());
        let mut open = 0;
        for (group, (covered, d)) in self.covered.iter_mut().zip(&window.directions).enumerate() {
            if *covered == u16::MAX {
                continue;
            }
            let (d, w) = depths_along::<L>(inverse, d);
            let mut met = shape.meets(d, w).close(shape, &mut self.rims[group]);
            if let Some(lamps) = self.lamps.get(group) {
                met &= !L::bits(w.le(L::load(&lamps.depths)));
            }
            *covered |= if veil.is_opaque() { met } else { met & pattern.samples(group) };
            open |= !*covered;
        }
        self.is_closed = open == 0;
    }

    /// Irradiance, W·m⁻² by channel, from lamps on a receiver with this normal and own plane: from all that the window sees, and from what is open.
    #[must_use]
    pub fn lamp_irradiance(&self, window: &Window, [normal, plane]: [Vec3; 2]) -> [[f32; 3]; 2] {
        let mut sums = [[0.0; 3]; 2];
        let [width, height] = window.texel_widths();
        for (group, lamps) in self.lamps.iter().enumerate() {
            let mut shown = lamps.shown;
            while shown != 0 {
                let lane = shown.trailing_zeros() as usize;
                shown &= shown - 1;
                let d = Vec3::from_array(window.directions[group].map(|plane| plane[lane]));
                let above = if d.dot(plane) > 0.0 { d.dot(normal) } else { 0.0 };
                // The cosine, and the solid angle of a texel, which is as the direction's length to the power −3.
                let weight = larger(above, 0.0) * width * height / d.length_squared().powi(2);
                let is_open = self.covered[group] >> lane & 1 == 0;
                for channel in 0..3 {
                    let light = weight * lamps.radiance[channel][lane];
                    sums[0][channel] += light;
                    sums[1][channel] += if is_open { light } else { 0.0 };
                }
            }
        }
        sums
    }
}

/// Directions of sixteen texels, and inverse depths of a plane along them.
#[inline(always)]
fn depths_along<L: Lanes>(inverse: Vec3, directions: &[[f32; SAMPLES]; 3]) -> ([L; 3], L) {
    let d = [L::load(&directions[0]), L::load(&directions[1]), L::load(&directions[2])];
    let w = d[0]
        .mul(L::splat(inverse.x))
        .add(d[1].mul(L::splat(inverse.y)))
        .add(d[2].mul(L::splat(inverse.z)));
    (d, w)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Plain;
    use crate::{Disk, Section, Tile};

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

    /// A square of this half-width, square to the window's axis, so far along it.
    fn square(frame: &Frame, distance: f32, aside: f32, half: f32) -> Tile {
        let (center, edges) =
            (frame.normal * distance + frame.tangent * aside, [frame.tangent, frame.bitangent]);
        let (inverse, half) = (frame.normal / distance, [half; 2]);
        Tile { inverse, center, edges, half, reach: half, ground: Vec3::ZERO, side: 0 }
    }

    #[test]
    fn what_stands_before_a_lamp_hides_it_and_what_stands_behind_does_not() {
        let mut window = Window::scattered(4);
        let frame = *self::window().frame();
        window.aim(frame, [0.25, 0.5]);
        let ink = Ink { radiance: [1.0, 2.0, 0.0], tolerance: 0.01, ..Ink::default() };
        let mut raster = WindowRaster::default();
        raster.clear_for_lamps(&window);
        raster.show_lamp::<Plain, _>(&window, &square(&frame, 4.0, 0.0, 1.0), &ink);
        // Behind the lamp, another is not seen.
        let other = Ink { radiance: [0.0, 0.0, 9.0], ..ink };
        raster.show_lamp::<Plain, _>(&window, &square(&frame, 5.0, 0.0, 0.5), &other);
        raster.close_around_lamps();
        let normals = [frame.normal, frame.normal];
        // A square seen from its axis: 4 atan-terms of Lambert's formula.
        let k = 0.25f32;
        let exact = 4.0 * k / (1.0 + k * k).sqrt() * (k / (1.0 + k * k).sqrt()).atan();
        let [all, shown] = raster.lamp_irradiance(&window, normals);
        assert_eq!(all, shown);
        assert!((all[0] / exact - 1.0).abs() < 0.01, "{all:?} {exact}");
        assert!(all[1] == 2.0 * all[0] && all[2] == 0.0, "{all:?}");
        // Neighbors on its own surface, and a wall behind it, hide nothing; a half plane before it hides half.
        for distance in [4.5, 3.99] {
            raster.draw::<Plain, _>(&window, &square(&frame, distance, 0.0, 5.0), &Veil::OPAQUE);
            assert_eq!(raster.lamp_irradiance(&window, normals)[1], all);
        }
        raster.draw::<Plain, _>(&window, &square(&frame, 2.0, 5.0, 5.0), &Veil::OPAQUE);
        let [_, half] = raster.lamp_irradiance(&window, normals);
        assert!((half[0] / all[0] - 0.5).abs() < 0.005 && !raster.is_closed(), "{half:?}");
        raster.draw::<Plain, _>(&window, &square(&frame, 1.0, 0.0, 5.0), &Veil::OPAQUE);
        assert!(raster.is_closed() && raster.lamp_irradiance(&window, normals)[1] == [0.0; 3]);
        // From below the receiver's own plane nothing shines.
        assert_eq!(raster.lamp_irradiance(&window, [frame.normal, -frame.normal])[0], [0.0; 3]);
    }

    #[test]
    fn no_two_places_of_a_scattered_window_share_a_row_or_a_column() {
        let window = Window::scattered(4);
        let along = |axis: Vec3| {
            let mut all: Vec<f32> = window
                .directions
                .iter()
                .flat_map(|d| (0..SAMPLES).map(|i| Vec3::from_array(d.map(|plane| plane[i]))))
                .map(|d| d.dot(axis))
                .collect();
            all.sort_by(f32::total_cmp);
            all
        };
        for axis in [window.frame.tangent, window.frame.bitangent] {
            for (i, x) in along(axis).iter().enumerate() {
                assert!((x - ((2 * i + 1) as f32 / 256.0 - 1.0)).abs() < 1e-5, "{i}: {x}");
            }
        }
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
