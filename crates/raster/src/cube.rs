//! The cube raster: coverage and radiance per texel, composited front to back.

use crate::footprint::{FaceRectangle, project_box};
use crate::{larger, smaller};
use pbgi_math::{CubeFace, CubeMap, CubeTexel, Vec3};

/// Texels that are updated together; rows are padded to a multiple.
pub const LANES: usize = 8;

/// Lanes as floats: converting them in the loop would leave the vector units.
pub(crate) const LANE_NUMBERS: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Coverage from which on a texel counts as opaque.
const OPAQUE: f32 = 0.999;

/// Coverage from which on a layer of solid pieces counts as whole.
///
/// Footprints of neighboring pieces sum to one only on average: where they overlap the sum saturates, where they
/// part it falls short, and light would leak through walls. A texel that is truly covered by seven eighths and more,
/// at the edge of something solid, gains a sixteenth on average; that is 0.4 % of a silhouette's texels' area.
pub(crate) const SOLID_WHOLE: f32 = 0.875;

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

/// What is drawn: how opaque a box's silhouette is, seen from the receiver, and its light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Splat {
    /// Share of the silhouette that surfaces facing the receiver cover, 0..=1.
    pub front: f32,
    /// Share that surfaces turned away cover (black), 0..=1.
    pub back: f32,
    /// Whether it is a piece of a solid thing's surface, whose neighbors leave no gap.
    pub solid: bool,
    /// Mean radiance of the facing surfaces.
    pub radiance: [f32; 3],
    /// Distance of the nearest of the surfaces, as far as known.
    pub near: f32,
    /// Distance of the farthest.
    pub far: f32,
}

/// What is added to texels: the share of a wholly covered texel, light, and depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ink {
    pub front: f32,
    pub back: f32,
    /// Coverage from which on a layer counts as whole.
    pub whole: f32,
    pub radiance: [f32; 3],
    pub near: f32,
    pub far: f32,
}

/// Eight texels of a row.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub struct TexelChunk {
    /// Coverage by all layers.
    pub covered: [f32; LANES],
    /// Radiance of the surfaces in each texel, weighted by the share of the texel they show.
    pub radiance: [[f32; LANES]; 3],
    /// Coverage by the layers before the current one, by the current one alone, and how far the
    /// current one reaches.
    passed: [f32; LANES],
    layer: [f32; LANES],
    layer_far: [f32; LANES],
    /// Facing coverage that no coverage by surfaces turned away has matched yet.
    unmatched: [f32; LANES],
}

/// Six faces of texels around a receiver, aligned with the world.
///
/// Splats arrive nearest first. Those whose depths overlap or touch are pieces of one surface, which do not
/// hide each other: their coverage adds up and saturates at 1. A splat that lies wholly behind starts a
/// new layer, which shows through what the layers before it left open, wherever in the texel that
/// is: their transmittances multiply. Adding across layers would block too much where leaves
/// overlap; multiplying within one would leak between the pieces of a wall.
///
/// The back of a closed object is always behind its front, so counting both would block twice where an object
/// is smaller than a texel: coverage by surfaces turned away counts only as far as it exceeds the facing
/// coverage that came before it and has not yet been matched. A wall seen from behind blocks in full. Radiance is weighted by the
/// coverage a splat still found open.
#[derive(Clone, Debug)]
pub struct CubeRaster {
    n: usize,
    stride: usize,
    shines: bool,
    chunks: Vec<TexelChunk>,
    /// Texels that are not opaque, one bit each, per row of each face.
    open: Vec<u64>,
    /// Scale from face coordinates to texels: `n / 2`.
    scale: f32,
    /// Face area per mean solid angle of each texel of a face.
    inverse_density: Vec<f32>,
}

impl CubeRaster {
    /// An empty raster; `shines` says whether any splat carries light.
    #[must_use]
    pub fn new(table: &CubeRasterTable, shines: bool) -> Self {
        let (n, stride) = (table.edge(), table.stride());
        Self {
            n,
            stride,
            shines,
            chunks: vec![TexelChunk::default(); 6 * n * stride / LANES],
            open: vec![0; 6 * n],
            scale: 0.5 * n as f32,
            inverse_density: (0..n * n)
                .map(|i| {
                    let texel = table.texels[i / n * stride + i % n];
                    4.0 / ((n * n) as f32 * texel.solid_angle_sr)
                })
                .collect(),
        }
    }

    /// Empties the raster for a receiver with this normal: texels wholly below its horizon are
    /// opaque from the start.
    #[inline(always)]
    pub fn clear(&mut self, normal: Vec3) {
        self.chunks.fill(TexelChunk::default());
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
    /// is outside): its opacities spread evenly over the rectangles around the box's silhouette,
    /// which continue across cube edges and cover texels at their borders in part. The solid angle covered is that of the silhouette times
    /// the opacity.
    #[inline(always)]
    pub fn draw_box(&mut self, low: Vec3, high: Vec3, splat: &Splat) {
        if !(larger(splat.front, splat.back) > 1e-6) {
            return;
        }
        let (rectangles, count) = project_box(low, high);
        for r in &rectangles[..count] {
            let ink = self.mix_ink(r, splat, r.fill);
            self.fill_rectangle(r, &ink);
        }
    }

    /// The ink for a splat in rectangle `r`, its opacities times `fill`.
    ///
    /// Shares of texels are shares of face area, so that pieces of a surface add up to whole texels. Inside a texel the solid angle per face area
    /// falls toward the face's corners as `1/(1 + u² + v²)^(3/2)`: a light smaller than a texel must
    /// not count for more or less than it is, so its radiance takes up the ratio to the texel's mean.
    #[inline(always)]
    pub(crate) fn mix_ink(&self, r: &FaceRectangle, splat: &Splat, fill: f32) -> Ink {
        let Splat { front, back, solid, mut radiance, near, far } = *splat;
        if self.shines {
            let ((c0, c1), (r0, r1)) = self.texel_range(r);
            if c0 == c1 && r0 == r1 {
                let (u, v) = (0.5 * (r.u0 + r.u1), 0.5 * (r.v0 + r.v1));
                let s = 1.0 + u * u + v * v;
                let ratio = self.inverse_density[r0 * self.n + c0] / (s * s.sqrt());
                radiance = radiance.map(|c| c * ratio);
            }
        }
        let whole = if solid { SOLID_WHOLE } else { 1.0 };
        Ink { front: front * fill, back: back * fill, whole, radiance, near, far }
    }

    #[inline(always)]
    fn fill_rectangle(&mut self, r: &FaceRectangle, ink: &Ink) {
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
                let first = (chunk * LANES) as u32 as f32;
                let mut weights = [0.0; LANES];
                for (lane, weight) in weights.iter_mut().enumerate() {
                    let column = first + LANE_NUMBERS[lane];
                    let part = smaller(u1, column + 1.0) - larger(u0, column);
                    *weight = larger(part, 0.0) * covered;
                }
                self.add_chunk(row_index, chunk, &weights, ink);
            }
        }
    }

    /// Adds ink to eight texels of a row, by the share of each texel in `weights`.
    #[inline(always)]
    pub(crate) fn add_chunk(
        &mut self,
        row_index: usize,
        chunk: usize,
        weights: &[f32; LANES],
        ink: &Ink,
    ) {
        let texels = &mut self.chunks[row_index * (self.stride / LANES) + chunk];
        // Worked on in local arrays and written back whole, so that lanes become registers.
        let before = texels.covered;
        let (mut passed, mut layer) = (texels.passed, texels.layer);
        let (mut far, mut unmatched) = (texels.layer_far, texels.unmatched);
        let (mut total, mut shown) = ([0.0f32; LANES], [0.0f32; LANES]);
        let extends_always = ink.whole < 1.0;
        for lane in 0..LANES {
            let weight = weights[lane];
            let inked = weight > 0.0;
            let behind = inked & (ink.near > far[lane]);
            passed[lane] = if behind { before[lane] } else { passed[lane] };
            let old_layer = if behind { 0.0 } else { layer[lane] };
            let old_far = if behind { 0.0 } else { far[lane] };
            let front = ink.front * weight;
            let surplus = ink.back * weight - (unmatched[lane] + front);
            unmatched[lane] = larger(-surplus, 0.0);
            let added = front + larger(surplus, 0.0);
            let new_layer = old_layer + added;
            let whole = inked & (new_layer >= ink.whole);
            layer[lane] = if whole { 1.0 } else { new_layer };
            // Sheets start layers but do not extend them: a crown of leaves is not one surface.
            let extends = inked & (extends_always | behind);
            far[lane] = if extends { larger(old_far, ink.far) } else { old_far };
            total[lane] = 1.0 - (1.0 - passed[lane]) * (1.0 - layer[lane]);
            shown[lane] = larger(total[lane] - before[lane], 0.0) * (front / larger(added, 1e-30));
        }
        texels.covered = total;
        texels.passed = passed;
        texels.layer = layer;
        texels.layer_far = far;
        texels.unmatched = unmatched;
        if self.shines {
            for (plane, light) in texels.radiance.iter_mut().zip(ink.radiance) {
                for lane in 0..LANES {
                    plane[lane] += light * shown[lane];
                }
            }
        }
        let mut opaque = 0u64;
        for (lane, total) in total.iter().enumerate() {
            opaque |= u64::from(*total >= OPAQUE) << lane;
        }
        self.open[row_index] &= !(opaque << (chunk * LANES));
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
        1.0 - self.chunks[index / LANES].covered[index % LANES]
    }

    /// Texels `8 index ..` in memory.
    #[must_use]
    #[inline(always)]
    pub fn chunk(&self, index: usize) -> &TexelChunk {
        &self.chunks[index]
    }

    /// Whether any splat may carry light.
    #[must_use]
    #[inline(always)]
    pub fn shines(&self) -> bool {
        self.shines
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

    /// Solid angle of the silhouette of a small box at distance 5 by its projected area.
    fn silhouette(center: Vec3, half: Vec3) -> f32 {
        let d = center.normalize().abs();
        4.0 * (d.x * half.y * half.z + d.y * half.x * half.z + d.z * half.x * half.y)
            / center.length_squared()
    }

    #[test]
    fn footprints_carry_their_solid_angle_everywhere() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        for scale in [0.2, 1.0] {
            let (mut squares, mut sum) = (0f32, 0.0);
            for i in 0..400u32 {
                let z = -1.0 + 2.0 * (i as f32 + 0.5) / 400.0;
                let phi = i as f32 * 2.399_963;
                let r = (1.0 - z * z).sqrt();
                let center = Vec3::new(r * phi.cos(), r * phi.sin(), z) * 5.0;
                let half = Vec3::new(0.2, 0.5, 0.4) * scale;
                // Every texel near the center's direction is open.
                raster.clear(center.normalize());
                let splat = Splat { front: 0.5, ..Splat::default() };
                raster.draw_box(center - half, center + half, &splat);
                let error = covered(&raster, &table) / (0.5 * silhouette(center, half)) - 1.0;
                squares += error * error / 400.0;
                sum += error / 400.0;
            }
            // Shares of face area stand for shares of solid angle: up to a fifth off within a corner
            // texel, both ways.
            let rms = squares.sqrt();
            assert!(rms < 0.12 && sum.abs() < 0.02, "{scale}: {rms} {sum}");
        }
    }

    #[test]
    fn a_ring_of_walls_covers_all_directions_without_seams() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear(Vec3::Y);
        // Six slabs of a closed box, in pieces that continue across the cube's edges.
        let splat = Splat { front: 1.0, radiance: [2.0; 3], far: 4.0, ..Splat::default() };
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
                irradiance += raster.chunk(i / LANES).radiance[0][i % LANES] * texel.vector.y;
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
        let half =
            Splat { front: 0.5, radiance: [1.0; 3], near: 0.9, far: 1.3, ..Splat::default() };
        let full = |near: f32| Splat {
            front: 1.0,
            radiance: [3.0; 3],
            near,
            far: near + 0.5,
            ..Splat::default()
        };
        raster.draw_box(low, high, &half);
        raster.draw_box(low * 2.0, high * 2.0, &full(1.9));
        raster.draw_box(low * 3.0, high * 3.0, &full(2.9));
        let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
        assert!(raster.openness(up) < 1e-6);
        assert!(
            (raster.chunk(up / LANES).radiance[0][up % LANES] - (0.5 + 0.5 * 3.0)).abs() < 1e-4
        );
    }

    #[test]
    fn coverage_adds_within_a_layer_and_multiplies_across_layers() {
        let table = CubeRasterTable::new(8);
        let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
        for (second_near, expected) in [(1.2, 0.0), (1.4, 0.25)] {
            let mut raster = CubeRaster::new(&table, false);
            raster.clear(Vec3::Y);
            let (low, high) = (Vec3::new(-0.6, 1.0, -0.6), Vec3::new(0.6, 1.0, 0.6));
            let splat = Splat { front: 0.5, near: 0.9, far: 1.3, ..Splat::default() };
            raster.draw_box(low, high, &splat);
            raster.draw_box(low, high, &Splat { near: second_near, far: 1.6, ..splat });
            assert!((raster.openness(up) - expected).abs() < 1e-5, "{}", raster.openness(up));
        }
    }

    #[test]
    fn backs_of_closed_objects_do_not_block_twice() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        raster.clear(Vec3::Y);
        let (low, high) = (Vec3::new(-0.1, 5.0, -0.1), Vec3::new(0.1, 5.2, 0.1));
        raster.draw_box(low, high, &Splat { front: 0.7, ..Splat::default() });
        let front = covered(&raster, &table);
        raster.draw_box(low, high, &Splat { back: 0.7, ..Splat::default() });
        assert!((covered(&raster, &table) / front - 1.0).abs() < 1e-3);
        raster.draw_box(low, high, &Splat { back: 0.7, ..Splat::default() });
        assert!((covered(&raster, &table) / front - 2.0).abs() < 1e-3);
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
