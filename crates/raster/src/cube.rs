//! The cube raster: coverage and radiance per texel, composited front to back.

use crate::footprint::{FaceRectangle, project_box};
use crate::{larger, smaller};
use pbgi_math::{CubeFace, CubeMap, CubeTexel, Vec3};

/// Texels that are updated together; rows are padded to a multiple.
pub const LANES: usize = 8;

/// Coverage from which on a texel counts as opaque.
const OPAQUE: f32 = 0.999;

/// What never changes for a resolution: geometry of the texels, in padded rows.
#[derive(Clone, Debug)]
pub struct CubeRasterTable {
    map: CubeMap,
    stride: usize,
    texels: Vec<CubeTexel>,
}

impl CubeRasterTable {
    /// Table for `n × n` texels per face.
    ///
    /// # Panics
    ///
    /// If `n` is not in 1..=64.
    #[must_use]
    pub fn new(n: usize) -> Self {
        assert!((1..=64).contains(&n), "1 to 64 texels along a face");
        let map = CubeMap::new(n);
        let stride = n.next_multiple_of(LANES);
        let outside = CubeTexel { direction: Vec3::Z, solid_angle_sr: 0.0, vector: Vec3::ZERO };
        let mut texels = vec![outside; 6 * n * stride];
        for index in 0..map.texel_count() {
            texels[index / n * stride + index % n] = map.texel(index);
        }
        Self { map, stride, texels }
    }

    /// Texels along a face.
    #[must_use]
    #[inline(always)]
    pub fn edge(&self) -> usize {
        self.map.edge()
    }

    /// Texels of a row in memory: `edge` rounded up to [`LANES`].
    #[must_use]
    #[inline(always)]
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Texels in memory, row by row, face by face; those beyond the edge have no solid angle.
    #[must_use]
    #[inline(always)]
    pub fn texels(&self) -> &[CubeTexel] {
        &self.texels
    }

    /// Brings values of the texels of a [`CubeMap`] of this resolution into padded rows.
    ///
    /// # Panics
    ///
    /// If there is not one value per texel.
    #[must_use]
    pub fn pad<T: Copy + Default>(&self, values: &[T]) -> Vec<T> {
        let n = self.edge();
        assert_eq!(values.len(), self.map.texel_count(), "one value per texel");
        let mut padded = vec![T::default(); self.texels.len()];
        for (row, values) in values.chunks_exact(n).enumerate() {
            padded[row * self.stride..][..n].copy_from_slice(values);
        }
        padded
    }

    /// Index in memory of the texel a direction falls into.
    #[must_use]
    pub fn texel_index(&self, direction: Vec3) -> usize {
        let (n, index) = (self.edge(), self.map.texel_index(direction));
        index / n * self.stride + index % n
    }
}

/// What is drawn: how much of the sphere it fills, seen from the receiver, and its light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Splat {
    /// Solid angle that surfaces facing the receiver fill.
    pub front_sr: f32,
    /// Solid angle that surfaces turned away fill (black).
    pub back_sr: f32,
    /// Mean radiance of the facing surfaces.
    pub radiance: [f32; 3],
}

/// Six faces of texels around a receiver, aligned with the world.
///
/// A texel keeps the coverage by facing surfaces and by surfaces turned away apart and counts the larger as covered: the back of a closed object is
/// always behind its front, so adding the two would block twice. Each saturates at 1. Radiance
/// is weighted by the coverage a splat still found open. Splats must arrive nearest first.
#[derive(Clone, Debug)]
pub struct CubeRaster {
    n: usize,
    stride: usize,
    shines: bool,
    front: Vec<f32>,
    back: Vec<f32>,
    radiance: [Vec<f32>; 3],
    /// Texels that are not opaque, one bit each, per row of each face.
    open: Vec<u64>,
    /// Scale from face coordinates to texels: `n / 2`.
    scale: f32,
    /// Mean solid angle per face area of each texel of a face.
    density: Vec<f32>,
}

impl CubeRaster {
    /// An empty raster; `shines` says whether any splat carries light.
    #[must_use]
    pub fn new(table: &CubeRasterTable, shines: bool) -> Self {
        let (n, stride) = (table.edge(), table.stride());
        let texels = 6 * n * stride;
        let light = if shines { texels } else { 0 };
        Self {
            n,
            stride,
            shines,
            front: vec![0.0; texels],
            back: vec![0.0; texels],
            radiance: std::array::from_fn(|_| vec![0.0; light]),
            open: vec![0; 6 * n],
            scale: 0.5 * n as f32,
            density: (0..n * n)
                .map(|i| {
                    let texel = table.texels[i / n * stride + i % n];
                    texel.solid_angle_sr * (n * n) as f32 / 4.0
                })
                .collect(),
        }
    }

    /// Empties the raster for a receiver with this normal: texels wholly below its horizon are
    /// opaque from the start.
    #[inline(always)]
    pub fn clear(&mut self, normal: Vec3) {
        self.front.fill(0.0);
        self.back.fill(0.0);
        for plane in &mut self.radiance {
            plane.fill(0.0);
        }
        let step = 1.0 / self.scale;
        for face in CubeFace::ALL {
            let [ua, va] = face.uv_axes();
            let (nu, nv) = (normal[ua] * step, normal[va] * step);
            // n·d is linear on a face; its maximum over a texel is half a step toward n.
            let reach = 0.5 * (nu.abs() + nv.abs());
            let first = normal[face.axis()] * face.sign() + nu * (0.5 - self.scale) + reach;
            for row in 0..self.n {
                let base = first + nv * (row as f32 + 0.5 - self.scale);
                let mut bits = 0u64;
                for column in 0..self.n {
                    bits |= u64::from(base + nu * column as f32 > 0.0) << column;
                }
                self.open[usize::from(face.0) * self.n + row] = bits;
            }
        }
    }

    /// First and last texel of a coordinate interval.
    #[inline(always)]
    fn span(&self, low: f32, high: f32) -> (usize, usize) {
        // Coordinates are inside −1..=1, so the casts cannot go below 0.
        let first = ((low + 1.0) * self.scale) as usize;
        let last = ((high + 1.0) * self.scale) as usize;
        (first.min(self.n - 1), last.min(self.n - 1))
    }

    /// Whether any texel that the box `low..=high` (relative to the receiver) touches is not yet
    /// opaque. Conservative: true where in doubt.
    #[must_use]
    #[inline(always)]
    pub fn is_box_open(&self, low: Vec3, high: Vec3) -> bool {
        if low.cmple(Vec3::ZERO).all() && high.cmpge(Vec3::ZERO).all() {
            return true;
        }
        let (rectangles, count) = project_box(low, high);
        rectangles[..count].iter().any(|r| self.is_rectangle_open(r))
    }

    #[inline(always)]
    fn is_rectangle_open(&self, r: &FaceRectangle) -> bool {
        let (c0, c1) = self.span(r.u0, r.u1);
        let (r0, r1) = self.span(r.v0, r.v1);
        let mask = (u64::MAX >> (63 - (c1 - c0))) << c0;
        let rows = usize::from(r.face) * self.n;
        self.open[rows + r0..=rows + r1].iter().any(|&bits| bits & mask != 0)
    }

    /// Draws a cluster whose surfaces lie in the box `low..=high` (relative to the receiver, which
    /// is outside): its solid angles spread evenly over the box's footprint, which continues across
    /// cube edges and is fractional at its borders.
    #[inline(always)]
    pub fn draw_box(&mut self, low: Vec3, high: Vec3, splat: &Splat) {
        let (mut rectangles, count) = project_box(low, high);
        // A footprint thinner than a 16th of a texel gets that width, so that it can be filled.
        let width_min = 0.0625 / self.scale;
        let mut total = 0.0;
        for r in &mut rectangles[..count] {
            widen(&mut r.u0, &mut r.u1, width_min);
            widen(&mut r.v0, &mut r.v1, width_min);
            total += self.footprint_sr(r);
        }
        if !(total > 0.0) {
            return;
        }
        let front = smaller(splat.front_sr / total, 1.0);
        let back = smaller(splat.back_sr / total, 1.0);
        if !(larger(front, back) > 1e-6) {
            return;
        }
        for r in &rectangles[..count] {
            self.fill_rectangle(r, front, back, &splat.radiance);
        }
    }

    /// Solid angle that filling a rectangle covers. Inside a texel the solid angle is spread evenly
    /// over the face's area, so a small rectangle sums its texels' densities; over many texels the
    /// sum tends to the rectangle's own solid angle.
    #[inline(always)]
    fn footprint_sr(&self, r: &FaceRectangle) -> f32 {
        let (du, dv) = (r.u1 - r.u0, r.v1 - r.v0);
        if larger(du, dv) * self.scale > 2.0 {
            return r.solid_angle_sr();
        }
        let (c0, c1) = self.span(r.u0, r.u1);
        let (r0, r1) = self.span(r.v0, r.v1);
        if c0 == c1 && r0 == r1 {
            return du * dv * self.density[r0 * self.n + c0];
        }
        let part = |low: f32, high: f32, i: usize| {
            let start = i as f32 / self.scale - 1.0;
            larger(smaller(high, start + 1.0 / self.scale) - larger(low, start), 0.0)
        };
        let mut sum = 0.0;
        for row in r0..=r1 {
            let rows = part(r.v0, r.v1, row);
            for column in c0..=c1 {
                sum += rows * part(r.u0, r.u1, column) * self.density[row * self.n + column];
            }
        }
        sum
    }

    #[inline(always)]
    fn fill_rectangle(&mut self, r: &FaceRectangle, front: f32, back: f32, radiance: &[f32; 3]) {
        let texel = |x: f32| (x + 1.0) * self.scale;
        let (u0, u1, v0, v1) = (texel(r.u0), texel(r.u1), texel(r.v0), texel(r.v1));
        let (c0, c1) = self.span(r.u0, r.u1);
        let (r0, r1) = self.span(r.v0, r.v1);
        let chunks = c0 / LANES..c1 / LANES + 1;
        for row in r0..=r1 {
            let row_index = usize::from(r.face) * self.n + row;
            if self.open[row_index] == 0 {
                continue;
            }
            let covered = larger(smaller(v1, row as f32 + 1.0) - larger(v0, row as f32), 0.0);
            for chunk in chunks.clone() {
                let mut weights = [0.0; LANES];
                for (lane, weight) in weights.iter_mut().enumerate() {
                    let column = (chunk * LANES + lane) as f32;
                    let part = smaller(u1, column + 1.0) - larger(u0, column);
                    *weight = larger(part, 0.0) * covered;
                }
                self.add_chunk(row_index, chunk, &weights, front, back, radiance);
            }
        }
    }

    /// Adds `front · weight` and `back · weight` to the coverage of eight texels of a row, light to
    /// the part that was still open.
    #[inline(always)]
    pub(crate) fn add_chunk(
        &mut self,
        row_index: usize,
        chunk: usize,
        weights: &[f32; LANES],
        front: f32,
        back: f32,
        radiance: &[f32; 3],
    ) {
        let start = row_index * self.stride + chunk * LANES;
        let fronts: &mut [f32; LANES] =
            (&mut self.front[start..start + LANES]).try_into().expect("a chunk of a padded row");
        let backs: &mut [f32; LANES] =
            (&mut self.back[start..start + LANES]).try_into().expect("a chunk of a padded row");
        let mut shown = [0.0; LANES];
        let mut opaque = 0u64;
        for lane in 0..LANES {
            let before = larger(fronts[lane], backs[lane]);
            fronts[lane] = smaller(fronts[lane] + front * weights[lane], 1.0);
            backs[lane] = smaller(backs[lane] + back * weights[lane], 1.0);
            shown[lane] = larger(fronts[lane] - before, 0.0);
        }
        for lane in 0..LANES {
            opaque |= u64::from(larger(fronts[lane], backs[lane]) >= OPAQUE) << lane;
        }
        self.open[row_index] &= !(opaque << (chunk * LANES));
        if self.shines {
            for (plane, light) in self.radiance.iter_mut().zip(radiance) {
                let plane: &mut [f32; LANES] =
                    (&mut plane[start..start + LANES]).try_into().expect("a chunk of a padded row");
                for lane in 0..LANES {
                    plane[lane] += light * shown[lane];
                }
            }
        }
    }

    /// Texels along a face.
    #[must_use]
    #[inline(always)]
    pub fn edge(&self) -> usize {
        self.n
    }

    /// Texels of a row in memory.
    #[must_use]
    #[inline(always)]
    pub fn stride(&self) -> usize {
        self.stride
    }

    #[inline(always)]
    pub(crate) fn row_is_closed(&self, row_index: usize) -> bool {
        self.open[row_index] == 0
    }

    /// First and last row and column of a rectangle.
    #[inline(always)]
    pub(crate) fn texel_range(&self, r: &FaceRectangle) -> ((usize, usize), (usize, usize)) {
        (self.span(r.u0, r.u1), self.span(r.v0, r.v1))
    }

    /// Share of texel `index` (in memory) that no surface covers.
    #[must_use]
    #[inline(always)]
    pub fn openness(&self, index: usize) -> f32 {
        1.0 - larger(self.front[index], self.back[index])
    }

    /// Radiance of the surfaces in each texel, weighted by the share of the texel they show; three
    /// channels, empty where nothing shines.
    #[must_use]
    #[inline(always)]
    pub fn radiance(&self) -> &[Vec<f32>; 3] {
        &self.radiance
    }
}

#[inline(always)]
fn widen(low: &mut f32, high: &mut f32, width_min: f32) {
    let lacking = width_min - (*high - *low);
    if lacking > 0.0 {
        *low = larger(*low - 0.5 * lacking, -1.0);
        *high = smaller(*high + 0.5 * lacking, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    fn covered(raster: &CubeRaster, table: &CubeRasterTable) -> f32 {
        let texels = table.texels().iter().enumerate();
        texels.map(|(i, t)| (1.0 - raster.openness(i)) * t.solid_angle_sr).sum()
    }

    #[test]
    fn footprints_carry_their_solid_angle_everywhere() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        let mut worst = 0f32;
        for i in 0..400u32 {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / 400.0;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let center = Vec3::new(r * phi.cos(), r * phi.sin(), z) * 5.0;
            let half = Vec3::new(0.2, 0.5, 0.4);
            // The normal below leaves every texel open but a few; draw where it is open.
            raster.clear(center.normalize());
            let solid_angle = 0.01;
            let splat = Splat { front_sr: solid_angle, ..Splat::default() };
            raster.draw_box(center - half, center + half, &splat);
            let drawn = covered(&raster, &table);
            // Exact up to rounding for footprints of up to two texels; larger ones differ by the
            // change of density from a texel's middle to its border.
            worst = worst.max((drawn / solid_angle - 1.0).abs());
        }
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn a_ring_of_walls_covers_all_directions_without_seams() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear(Vec3::Y);
        // Six slabs of a closed box, in pieces that continue across the cube's edges.
        let splat = Splat { front_sr: 100.0, back_sr: 0.0, radiance: [2.0; 3] };
        for axis in 0..3 {
            for side in [-1.0f32, 1.0] {
                for i in -3..3 {
                    for j in -3..3 {
                        let mut low = Vec3::ZERO;
                        low[axis] = side;
                        low[(axis + 1) % 3] = i as f32 / 3.0;
                        low[(axis + 2) % 3] = j as f32 / 3.0;
                        let mut high = low;
                        high[(axis + 1) % 3] += 1.0 / 3.0;
                        high[(axis + 2) % 3] += 1.0 / 3.0;
                        raster.draw_box(low * 2.0, high * 2.0, &splat);
                    }
                }
            }
        }
        let mut irradiance = 0.0;
        for (i, texel) in table.texels().iter().enumerate() {
            if texel.solid_angle_sr > 0.0 && texel.direction.y > 0.0 {
                assert!(raster.openness(i) < 1e-4, "texel {i} is open");
                irradiance += raster.radiance()[0][i] * texel.vector.y;
            }
        }
        // E = πL; the texels at the horizon are all whole here.
        assert!((irradiance / (2.0 * PI) - 1.0).abs() < 1e-3, "{irradiance}");
        assert!(!raster.is_box_open(Vec3::splat(3.0), Vec3::splat(3.5)));
    }

    #[test]
    fn nearer_splats_hide_farther_ones() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear(Vec3::Y);
        let (low, high) = (Vec3::new(-0.6, 1.0, -0.6), Vec3::new(0.6, 1.0, 0.6));
        let half = Splat {
            front_sr: 0.5
                * FaceRectangle { face: 2, u0: -0.6, u1: 0.6, v0: -0.6, v1: 0.6 }.solid_angle_sr(),
            back_sr: 0.0,
            radiance: [1.0; 3],
        };
        let full = Splat { front_sr: 10.0, back_sr: 0.0, radiance: [3.0; 3] };
        raster.draw_box(low, high, &half);
        raster.draw_box(low * 2.0, high * 2.0, &full);
        raster.draw_box(low * 3.0, high * 3.0, &full);
        let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
        assert!(raster.openness(up) < 1e-6);
        assert!((raster.radiance()[0][up] - (0.5 + 0.5 * 3.0)).abs() < 1e-4);
    }

    #[test]
    fn backs_of_closed_objects_do_not_block_twice() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        raster.clear(Vec3::Y);
        let (low, high) = (Vec3::new(-0.1, 5.0, -0.1), Vec3::new(0.1, 5.2, 0.1));
        raster.draw_box(low, high, &Splat { front_sr: 0.001, ..Splat::default() });
        raster.draw_box(low, high, &Splat { back_sr: 0.001, ..Splat::default() });
        let drawn = covered(&raster, &table);
        assert!((drawn / 0.001 - 1.0).abs() < 0.05, "{drawn}");
    }

    #[test]
    fn texels_below_the_horizon_start_opaque() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        raster.clear(Vec3::new(0.3, 0.8, -0.2).normalize());
        assert!(!raster.is_box_open(Vec3::new(-0.1, -3.0, -0.1), Vec3::new(0.1, -2.0, 0.1)));
        assert!(raster.is_box_open(Vec3::new(-0.1, 2.0, -0.1), Vec3::new(0.1, 3.0, 0.1)));
    }
}
