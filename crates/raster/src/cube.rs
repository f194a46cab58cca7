//! The cube raster: which samples are covered and how far away, and the radiance of each texel.

use crate::footprint::project_box;
use crate::lanes::{Lanes, SAMPLES};
use crate::samples::{Veil, place, sample_near};
use crate::shape::Shape;
use crate::table::{CubeRasterTable, LANES};
use pbgi_math::{CubeFace, Vec3};

/// Most shapes that are drawn together.
pub const SHAPES_MAX: usize = 4;

/// Every sample of a texel.
const ALL: u16 = u16::MAX;

/// Solid angle, in steradians, up to which a piece's own solid angle is better than the count of its samples.
const SMALL_SR: f32 = 0.06;

/// Least share of a texel with which a piece counts for what its rest looks like.
const MAIN_SHARE: f32 = 0.02;

/// Mean brightness over that of the dimmest piece up to which a texel counts as one surface without lamps.
const EVEN: f32 = 2.0;

/// How a piece covers and shines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ink {
    /// The samples it covers among those it meets.
    pub veil: Veil,
    /// Solid angle of its surfaces, as if nothing hid them; sr.
    pub solid_angle: f32,
    /// Radiance toward the receiver, 0 for backs.
    pub radiance: [f32; 3],
    /// Surfaces nearer by no more than this share of the distance are its own neighbors, and do not hide it.
    pub tolerance: f32,
}

/// What eight texels of a row hold when all is drawn.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub struct TexelChunk {
    /// Share of each texel, above the horizon, that surfaces cover.
    pub covered: [f32; LANES],
    /// Radiance of the surfaces, weighted by the share of the texel they show.
    pub radiance: [[f32; LANES]; 3],
}

/// Texels of a face.
#[derive(Clone, Copy, Debug, Default)]
struct TexelRange {
    face: u8,
    /// First and last column.
    columns: [u8; 2],
    /// First and last row.
    rows: [u8; 2],
}

/// The texels that what lies in a box may touch; see [`CubeRaster::footprint`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Footprint {
    ranges: [TexelRange; 6],
    count: u8,
}

impl Footprint {
    #[inline(always)]
    fn ranges(&self) -> &[TexelRange] {
        &self.ranges[..usize::from(self.count)]
    }
}

/// Coverage of a texel.
#[derive(Clone, Copy, Debug, Default)]
struct Texel {
    /// Samples covered, and those below the horizon.
    covered: u16,
    /// Samples above the horizon.
    above: u16,
}

/// Light of a texel.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
struct Light {
    /// Σ of radiance × share of the texel.
    radiance: [f32; 3],
    /// Σ of shares.
    weight: f32,
    /// Radiance of the dimmest piece, and the sum of its channels; that is negative at first.
    dimmest: [f32; 3],
    brightness: f32,
}

/// Samples of a texel that a piece met.
#[derive(Clone, Copy, Debug)]
struct Hit {
    index: u32,
    /// Which of the shapes drawn together.
    shape: u8,
    /// Above the horizon and not hidden.
    visible: u16,
    /// Not covered before by anything.
    new: u16,
}

/// Six faces of texels around a receiver, aligned with the world, sixteen samples each.
///
/// Pieces arrive nearest first, or nearly. A piece covers the samples that meet it, whether they were covered or not: pieces
/// of one surface, which meet or overlap a little, leave no gap between them, and the coverage of
/// a texel never exceeds 1. Each sample keeps the inverse depth of what covered it first.
///
/// A small piece counts by its own exact solid angle, times the share of its samples that are not hidden, so
/// that a lamp smaller than a texel keeps its flux; a piece is not hidden by
/// its neighbors on the same surface, known by their depth. A piece
/// larger than that counts by the samples it newly covers. In a texel that is covered wholly, shares
/// must sum to one: what is missing or in excess is made up with the radiance of the texel's dimmest piece, so that lamps keep their flux.
#[derive(Clone, Debug)]
pub struct CubeRaster {
    n: usize,
    stride: usize,
    shines: bool,
    texels: Vec<Texel>,
    lights: Vec<Light>,
    /// Inverse depth along the face's axis of what covers each sample.
    depths: Vec<[f32; SAMPLES]>,
    /// Texels that are not wholly covered, one bit each, per row of each face.
    open: Vec<u64>,
    /// Scale from face coordinates to texels: `n / 2`.
    scale: f32,
    /// Width of a texel in face coordinates.
    step: f32,
    /// Places of the samples in a texel, in face coordinates.
    places: [[f32; SAMPLES]; 2],
    inverse_solid_angles: Vec<f32>,
    hits: Vec<Hit>,
}

impl CubeRaster {
    /// An empty raster; `shines` says whether any piece carries light.
    #[must_use]
    pub fn new(table: &CubeRasterTable, shines: bool) -> Self {
        let (n, stride) = (table.edge(), table.stride());
        let step = 2.0 / n as f32;
        let places = |axis: usize| std::array::from_fn(|i| place(i)[axis] * step);
        let inverse = |sr: f32| if sr > 0.0 { 1.0 / sr } else { 0.0 };
        Self {
            n,
            stride,
            shines,
            texels: vec![Texel::default(); 6 * n * stride],
            lights: vec![Light::default(); 6 * n * stride],
            depths: vec![[0.0; SAMPLES]; 6 * n * stride],
            open: vec![0; 6 * n],
            scale: 0.5 * n as f32,
            step,
            places: [places(0), places(1)],
            inverse_solid_angles: table
                .texels()
                .iter()
                .map(|t| inverse(t.solid_angle_sr))
                .collect(),
            hits: Vec::with_capacity(64),
        }
    }

    /// Empties the raster for a receiver with this normal: samples below its horizon count as covered from the
    /// start.
    #[inline(always)]
    pub fn clear<L: Lanes>(&mut self, normal: Vec3) {
        if self.shines {
            self.lights.fill(Light { brightness: -1.0, ..Light::default() });
        }
        let step = self.step;
        for face in CubeFace::ALL {
            let [ua, va] = face.uv_axes();
            let (na, nu, nv) = (normal[face.axis()] * face.sign(), normal[ua], normal[va]);
            // n·D is linear on a face; over a texel it varies by this much around the middle.
            let reach = 0.5 * step * (nu.abs() + nv.abs());
            for row in 0..self.n {
                let v = (row as f32 + 0.5) * step - 1.0;
                let row_index = usize::from(face.0) * self.n + row;
                let mut bits = 0u64;
                for column in 0..self.n {
                    let u = (column as f32 + 0.5) * step - 1.0;
                    let middle = na + nu * u + nv * v;
                    let above = if middle >= reach {
                        ALL
                    } else if middle <= -reach {
                        0
                    } else {
                        let (x, y) = (self.sample_columns::<L>(column), self.sample_rows::<L>(row));
                        let height = L::splat(na).add(L::splat(nu).mul(x)).add(L::splat(nv).mul(y));
                        !L::bits(height.le(L::splat(0.0)))
                    };
                    bits |= u64::from(above != 0) << column;
                    self.texels[row_index * self.stride + column] =
                        Texel { covered: !above, above };
                }
                self.open[row_index] = bits;
            }
        }
    }

    /// Face coordinate u of the samples of the texels in a column.
    #[inline(always)]
    fn sample_columns<L: Lanes>(&self, column: usize) -> L {
        L::splat(self.corner(column)).add(L::load(&self.places[0]))
    }

    /// Face coordinate v of the samples of the texels in a row.
    #[inline(always)]
    fn sample_rows<L: Lanes>(&self, row: usize) -> L {
        L::splat(self.corner(row)).add(L::load(&self.places[1]))
    }

    /// Face coordinate of the boundary before texel `i`.
    #[inline(always)]
    fn corner(&self, i: usize) -> f32 {
        i as u32 as f32 * self.step - 1.0
    }

    /// The texels that the box `low..=high`, relative to the receiver, may touch.
    #[must_use]
    #[inline(always)]
    pub fn footprint(&self, low: Vec3, high: Vec3) -> Footprint {
        let mut footprint = Footprint::default();
        let last = self.n - 1;
        if low.cmple(Vec3::ZERO).all() && high.cmpge(Vec3::ZERO).all() {
            // The receiver is within the box: any face may see what is in it.
            for face in 0..6 {
                footprint.ranges[usize::from(face)] =
                    TexelRange { face, columns: [0, last as u8], rows: [0, last as u8] };
            }
            footprint.count = 6;
            return footprint;
        }
        let texel = |x: f32| smaller_index(((x + 1.0) * self.scale) as i32 as usize, last) as u8;
        let mut count = 0;
        project_box(low, high, |r| {
            // Coordinates are inside −1..=1, so the casts cannot go below 0.
            footprint.ranges[count] = TexelRange {
                face: r.face,
                columns: [texel(r.u0), texel(r.u1)],
                rows: [texel(r.v0), texel(r.v1)],
            };
            count += 1;
        });
        footprint.count = count as u8;
        footprint
    }

    /// Whether any texel of a footprint is not yet covered.
    #[must_use]
    #[inline(always)]
    pub fn is_open(&self, footprint: &Footprint) -> bool {
        footprint.ranges().iter().any(|r| {
            let [c0, c1] = r.columns;
            let mask = (u64::MAX >> (63 - (c1 - c0))) << c0;
            let rows = usize::from(r.face) * self.n;
            let [r0, r1] = r.rows.map(usize::from);
            self.open[rows + r0..=rows + r1].iter().any(|&bits| bits & mask != 0)
        })
    }

    /// Draws up to [`SHAPES_MAX`] shapes that lie in one box, nearest first; `footprint` is the box's, `toward` leads to its
    /// middle.
    #[inline(always)]
    pub fn draw<L: Lanes, S: Shape>(
        &mut self,
        shapes: &[(S, Ink)],
        footprint: &Footprint,
        toward: Vec3,
    ) {
        self.hits.clear();
        let mut met = [0u32; SHAPES_MAX];
        for range in footprint.ranges() {
            self.cover::<L, S>(shapes, range, &mut met);
        }
        if self.shines {
            for hit in &self.hits {
                let ink = &shapes[usize::from(hit.shape)].1;
                let above = self.texels[hit.index as usize].above.count_ones() as f32;
                let samples = if ink.solid_angle < SMALL_SR {
                    let per_sample = ink.solid_angle
                        * self.inverse_solid_angles[hit.index as usize]
                        / met[usize::from(hit.shape)] as f32;
                    hit.visible.count_ones() as f32 * per_sample * SAMPLES as f32
                } else {
                    hit.new.count_ones() as f32
                };
                let share = samples / larger_than_zero(above);
                self.lights[hit.index as usize].add(share, &ink.radiance);
            }
            for ((shape, ink), met) in shapes.iter().zip(met) {
                if met == 0 {
                    self.shine_unmet(shape, toward, ink);
                }
            }
        }
    }

    /// Covers the samples in a range of texels that meet the shapes, and counts for each how many do.
    #[inline(always)]
    fn cover<L: Lanes, S: Shape>(
        &mut self,
        shapes: &[(S, Ink)],
        range: &TexelRange,
        met_total: &mut [u32; SHAPES_MAX],
    ) {
        let face = CubeFace(range.face);
        let [c0, c1] = range.columns.map(usize::from);
        let [r0, r1] = range.rows.map(usize::from);
        for (number, (shape, ink)) in shapes.iter().enumerate() {
            let shape = shape.turned(face);
            let inverse = shape.inverse();
            let opaque = ink.veil.is_opaque();
            let nearer = L::splat(1.0 + ink.tolerance);
            let mut met_here = 0;
            let mut row = r0;
            while row <= r1 {
                let row_index = usize::from(range.face) * self.n + row;
                let y = self.sample_rows::<L>(row);
                let w_row = L::splat(inverse.x).add(L::splat(inverse.z).mul(y));
                let mut column = c0;
                while column <= c1 {
                    let index = row_index * self.stride + column;
                    let x = self.sample_columns::<L>(column);
                    let w = w_row.add(L::splat(inverse.y).mul(x));
                    let met = shape.meets([L::splat(1.0), x, y], w);
                    column += 1;
                    if met == 0 {
                        continue;
                    }
                    met_here += met.count_ones();
                    let texel = &mut self.texels[index];
                    let before = texel.covered;
                    if !self.shines && before == ALL {
                        continue;
                    }
                    let depths = &mut self.depths[index];
                    let covered = if opaque { met } else { met & ink.veil.samples(index) };
                    let new = covered & !before;
                    if self.shines {
                        let hidden = before & L::bits(w.mul(nearer).le(L::load(depths)));
                        let visible = met & texel.above & !hidden;
                        if visible | new != 0 {
                            let shape = number as u8;
                            self.hits.push(Hit { index: index as u32, shape, visible, new });
                        }
                    }
                    if new != 0 {
                        if self.shines {
                            w.store_where(new, depths);
                        }
                        texel.covered = before | new;
                        if texel.covered == ALL {
                            self.open[row_index] &= !(1 << (column - 1));
                        }
                    }
                }
                row += 1;
            }
            met_total[number] += met_here;
        }
    }

    /// Adds the light of a piece that met no sample to the texel at its middle. Whether it is hidden says the sample next to it:
    /// others in the texel may lie on other surfaces.
    #[inline(always)]
    fn shine_unmet<S: Shape>(&mut self, shape: &S, toward: Vec3, ink: &Ink) {
        if toward == Vec3::ZERO {
            return;
        }
        let (face, u, v) = CubeFace::from_direction(toward);
        let [x, y] = [u, v].map(|c| (c + 1.0) * self.scale);
        let texel = |c: f32| smaller_index(c as i32 as usize, self.n - 1);
        let (column, row) = (texel(x), texel(y));
        let index = (usize::from(face.0) * self.n + row) * self.stride + column;
        let sample = sample_near(x - column as u32 as f32, y - row as u32 as f32);
        let texel = self.texels[index];
        if texel.above >> sample & 1 == 0 {
            return;
        }
        let place = |axis: usize| self.places[axis][sample as usize];
        let (su, sv) = (self.corner(column) + place(0), self.corner(row) + place(1));
        let inverse = shape.turned(face).inverse();
        let w = inverse.x + inverse.y * su + inverse.z * sv;
        let is_hidden = w * (1.0 + ink.tolerance) <= self.depths[index][sample as usize];
        if texel.covered >> sample & 1 != 0 && is_hidden {
            return;
        }
        let above = texel.above.count_ones() as f32;
        let whole = self.inverse_solid_angles[index] * SAMPLES as f32 / above;
        self.lights[index].add(ink.solid_angle * whole, &ink.radiance);
    }

    /// Share of texel `index` (in memory), above the horizon, that no surface covers.
    #[must_use]
    #[inline(always)]
    pub fn openness(&self, index: usize) -> f32 {
        let texel = &self.texels[index];
        let open = (!texel.covered).count_ones() as f32;
        open / larger_than_zero(texel.above.count_ones() as f32)
    }

    /// Texels `8 index ..` in memory.
    #[must_use]
    #[inline(always)]
    pub fn chunk(&self, index: usize) -> TexelChunk {
        let mut chunk = TexelChunk::default();
        for lane in 0..LANES {
            let texel = &self.texels[index * LANES + lane];
            chunk.covered[lane] = 1.0 - self.openness(index * LANES + lane);
            let light = &self.lights[index * LANES + lane];
            let radiance = if texel.covered == ALL { light.made_whole() } else { light.radiance };
            for (plane, light) in chunk.radiance.iter_mut().zip(radiance) {
                plane[lane] = light;
            }
        }
        chunk
    }

    /// Whether any piece may carry light.
    #[must_use]
    #[inline(always)]
    pub fn shines(&self) -> bool {
        self.shines
    }
}

impl Light {
    /// Radiance of a texel that is covered wholly, with shares that sum to one.
    #[inline(always)]
    fn made_whole(&self) -> [f32; 3] {
        let inverse = 1.0 / crate::larger(self.weight, 1e-6);
        let mean = self.radiance.map(|sum| sum * inverse);
        if self.brightness < 0.0 && self.weight > 1.0 {
            // Nothing large enough to take the excess from.
            return self.radiance;
        }
        if self.brightness < 0.0 || mean[0] + mean[1] + mean[2] <= EVEN * self.brightness {
            return mean;
        }
        let missing = 1.0 - self.weight;
        std::array::from_fn(|c| crate::larger(self.radiance[c] + missing * self.dimmest[c], 0.0))
    }

    #[inline(always)]
    fn add(&mut self, share: f32, radiance: &[f32; 3]) {
        for (sum, light) in self.radiance.iter_mut().zip(radiance) {
            *sum += share * light;
        }
        self.weight += share;
        let brightness = radiance[0] + radiance[1] + radiance[2];
        if share > MAIN_SHARE && (brightness < self.brightness || self.brightness < 0.0) {
            (self.dimmest, self.brightness) = (*radiance, brightness);
        }
    }
}

/// The smaller of two indices.
#[inline(always)]
fn smaller_index(a: usize, b: usize) -> usize {
    if a < b { a } else { b }
}

/// A count to divide by.
#[inline(always)]
fn larger_than_zero(count: f32) -> f32 {
    crate::larger(count, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::Plain;
    use crate::{Disk, Section, SimdLevel, Tile, WideKernel, run_wide};
    use pbgi_math::Aabb;
    use std::f32::consts::PI;

    fn ink(solid_angle: f32, light: f32) -> Ink {
        Ink { veil: Veil::OPAQUE, solid_angle, radiance: [light; 3], tolerance: 0.01 }
    }

    /// Draws the part of the plane through `point` with `normal` in a box.
    fn draw_section(raster: &mut CubeRaster, (low, high): (Vec3, Vec3), normal: Vec3, ink: &Ink) {
        let point = (low + high) * 0.5;
        let section = Section { inverse: normal / normal.dot(point), low, high };
        let footprint = raster.footprint(low, high);
        raster.draw::<Plain, _>(&[(section, *ink)], &footprint, point);
    }

    fn is_box_open(raster: &CubeRaster, low: Vec3, high: Vec3) -> bool {
        raster.is_open(&raster.footprint(low, high))
    }

    fn irradiance(raster: &CubeRaster, table: &CubeRasterTable, normal: Vec3) -> f32 {
        let texels = table.texels().iter().enumerate();
        texels
            .map(|(i, t)| {
                raster.chunk(i / LANES).radiance[0][i % LANES] * normal.dot(t.vector).max(0.0)
            })
            .sum()
    }

    /// Irradiance of a disk of radiance 1; its solid angle by counting samples.
    fn disk_irradiance(n: usize, center: Vec3, normal: Vec3, receiver_normal: Vec3) -> f32 {
        let table = CubeRasterTable::new(n);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear::<Plain>(receiver_normal);
        let inverse = normal / normal.dot(center);
        let disk = Disk { inverse, center, radius: 1.0, distance_min: 0.0 };
        let aabb = Aabb::from_disk(center, normal, 1.0);
        let footprint = raster.footprint(aabb.min, aabb.max);
        raster.draw::<Plain, _>(&[(disk, ink(1.0, 1.0))], &footprint, center);
        irradiance(&raster, &table, receiver_normal)
    }

    #[test]
    fn a_parallel_disk_has_the_analytic_form_factor() {
        for (distance, n, tolerance) in
            [(0.25, 8, 0.01), (0.5, 8, 0.01), (1.0, 8, 0.02), (3.0, 16, 0.03)]
        {
            // E = π L r² / (r² + d²) for a parallel disk on the axis.
            let exact = PI / (1.0 + distance * distance);
            let found = disk_irradiance(n, Vec3::Y * distance, Vec3::NEG_Y, Vec3::Y);
            assert!((found / exact - 1.0).abs() < tolerance, "{distance}: {found} {exact}");
        }
    }

    #[test]
    fn a_perpendicular_disk_matches_quadrature() {
        // A disk standing beside the receiver, half of it below the horizon.
        let mut exact = 0f64;
        let steps = 400;
        for i in 0..steps {
            for j in 0..steps {
                let (y, z) = (
                    -1.0 + 2.0 * (i as f32 + 0.5) / steps as f32,
                    -1.0 + 2.0 * (j as f32 + 0.5) / steps as f32,
                );
                if y > 0.0 && y * y + z * z <= 1.0 {
                    let p = Vec3::new(1.3, y, z);
                    let d2 = p.length_squared();
                    exact += f64::from(y * 1.3 / (d2 * d2)) * 4.0 / f64::from(steps * steps);
                }
            }
        }
        let found = f64::from(disk_irradiance(8, Vec3::X * 1.3, Vec3::NEG_X, Vec3::Y));
        assert!((found / exact - 1.0).abs() < 0.03, "{found} {exact}");
    }

    #[test]
    fn small_pieces_carry_their_solid_angle_wherever_they_fall() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        // Tiny ones exactly; where one covers a texel wholly, its share of it is rounded to 1.
        for (radius, tolerance) in [(0.02f32, 1e-3), (0.1, 1e-3), (0.4, 0.1)] {
            for i in 0..400u32 {
                let z = -1.0 + 2.0 * (i as f32 + 0.5) / 400.0;
                let phi = i as f32 * 2.399_963;
                let r = (1.0 - z * z).sqrt();
                let d = Vec3::new(r * phi.cos(), r * phi.sin(), z);
                raster.clear::<Plain>(d);
                let (center, solid_angle) = (d * 5.0, PI * radius * radius / 25.0);
                let disk = Disk { inverse: d / 5.0, center, radius, distance_min: 0.0 };
                let aabb = Aabb::from_disk(center, d, radius);
                let footprint = raster.footprint(aabb.min, aabb.max);
                raster.draw::<Plain, _>(&[(disk, ink(solid_angle, 1.0))], &footprint, center);
                let texels = table.texels().iter().enumerate();
                let found: f32 = texels
                    .map(|(i, t)| raster.chunk(i / LANES).radiance[0][i % LANES] * t.solid_angle_sr)
                    .sum();
                let error = found / solid_angle - 1.0;
                assert!(error.abs() < tolerance, "{i} {radius}: {error}");
            }
        }
    }

    #[test]
    fn tiles_of_a_closed_box_leave_no_sample_open() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear::<Plain>(Vec3::Y);
        let (cells, mut sum) = (12, 0.0);
        for axis in 0..3 {
            for side in [-1.0f32, 1.0] {
                for i in 0..cells * cells {
                    let at = |i: i32| -1.0 + 2.0 * i as f32 / cells as f32;
                    let mut low = Vec3::ZERO;
                    low[axis] = side;
                    low[(axis + 1) % 3] = at(i % cells);
                    low[(axis + 2) % 3] = at(i / cells);
                    let mut high = low;
                    high[(axis + 1) % 3] += 2.0 / cells as f32;
                    high[(axis + 2) % 3] += 2.0 / cells as f32;
                    let normal = Vec3::AXES[axis] * side;
                    let center = (low + high) * 0.5;
                    let d2 = center.length_squared();
                    let solid_angle = 4.0 / (cells * cells) as f32 / (d2 * d2.sqrt());
                    let margin = 1e-4;
                    let bounds = (low - margin, high + margin);
                    draw_section(&mut raster, bounds, normal, &ink(solid_angle, 2.0));
                    sum += solid_angle;
                }
            }
        }
        assert!((sum / (4.0 * PI) - 1.0).abs() < 0.01);
        for (i, texel) in table.texels().iter().enumerate() {
            if texel.direction.y > 0.0 {
                assert!(raster.openness(i) == 0.0, "texel {i} is open");
            }
        }
        let found = irradiance(&raster, &table, Vec3::Y);
        assert!((found / (2.0 * PI) - 1.0).abs() < 2e-3, "{found}");
        assert!(!is_box_open(&raster, Vec3::splat(3.0), Vec3::splat(3.5)));
    }

    /// Draws an opaque tile of radiance 1, its edges scaled by `reserve`.
    fn draw_tile(raster: &mut CubeRaster, center: Vec3, halves: [Vec3; 2], reserve: f32) {
        let edges = halves.map(Vec3::normalize);
        let normal = edges[0].cross(edges[1]);
        let tile = Tile {
            inverse: normal / normal.dot(center),
            center,
            edges,
            half: halves.map(|half| half.length() * reserve),
            distance_min: 0.0,
        };
        let (d2, area) = (center.length_squared(), 4.0 * halves[0].length() * halves[1].length());
        let ink = ink(area * normal.dot(center).abs() / (d2 * d2.sqrt()), 1.0);
        let bounds = tile.bounds();
        let footprint = raster.footprint(bounds.min, bounds.max);
        raster.draw::<Plain, _>(&[(tile, ink)], &footprint, center);
    }

    #[test]
    fn rectangles_that_tile_a_plane_leave_no_sample_open() {
        let table = CubeRasterTable::new(16);
        let mut raster = CubeRaster::new(&table, true);
        // A ceiling of oblong tiles, turned in its plane and tilted.
        let normal = Vec3::new(0.2, -1.0, 0.1).normalize();
        let first = Vec3::new(0.8, 0.0, -0.5).cross(normal).normalize();
        let halves = [first * 0.3, normal.cross(first) * 0.12];
        for (reserve, complete) in [(1.001, true), (0.9, false)] {
            raster.clear::<Plain>(Vec3::Y);
            for i in -30..=30 {
                for j in -80..=80 {
                    let (i, j) = (i as f32 * 2.0, j as f32 * 2.0);
                    let center = normal * -1.0 + halves[0] * i + halves[1] * j;
                    draw_tile(&mut raster, center, halves, reserve);
                }
            }
            let mut open = 0.0;
            for (i, texel) in table.texels().iter().enumerate() {
                if texel.direction.dot(normal) < -0.25 {
                    open += raster.openness(i);
                }
            }
            assert_eq!(open == 0.0, complete, "{reserve}: {open}");
        }
    }

    #[test]
    fn a_rectangle_has_the_analytic_form_factor_and_no_point_beyond_its_edges() {
        let table = CubeRasterTable::new(16);
        let mut raster = CubeRaster::new(&table, true);
        let (a, b) = (2.0f32, 0.25);
        for turn in [0.0f32, 0.4, 1.2] {
            raster.clear::<Plain>(Vec3::Y);
            let (sin, cos) = turn.sin_cos();
            let halves = [Vec3::new(cos, 0.0, sin) * a, Vec3::new(-sin, 0.0, cos) * b];
            draw_tile(&mut raster, Vec3::Y, halves, 1.0);
            // E = 2 L (a/√(1+a²) atan(b/√(1+a²)) + b/√(1+b²) atan(a/√(1+b²))), four quarters.
            let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
            let exact = 2.0 * (a / p * (b / p).atan() + b / q * (a / q).atan());
            let found = irradiance(&raster, &table, Vec3::Y);
            assert!((found / exact - 1.0).abs() < 0.02, "{turn}: {found} {exact}");
            for (i, texel) in table.texels().iter().enumerate() {
                let at = texel.direction / texel.direction.y;
                let beyond = |half: Vec3| at.dot(half) > 1.3 * half.length_squared() + 0.3;
                if texel.direction.y <= 0.0 || beyond(halves[0]) || beyond(halves[1]) {
                    let open = raster.openness(i);
                    assert!(texel.direction.y < 0.2 || open == 1.0, "{turn} {at}: {open}");
                }
            }
        }
    }

    #[test]
    fn nearer_pieces_hide_farther_ones_but_not_their_neighbors() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        let (low, high) = (Vec3::new(-0.6, 0.99, -0.6), Vec3::new(0.6, 1.01, 0.6));
        let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
        // Of the second, at the first's depth or far behind it, all or nothing is seen.
        for (scale, expected) in [(1.0, 0.7), (2.0, 0.2)] {
            raster.clear::<Plain>(Vec3::Y);
            let whole = table.texels()[up].solid_angle_sr;
            draw_section(&mut raster, (low, high), Vec3::Y, &ink(1.0, 0.0));
            let light = raster.chunk(up / LANES).radiance[0][up % LANES];
            assert_eq!(light, 0.0);
            let small = Vec3::new(0.05, 1.0, 0.05) * scale;
            let piece = (small - 0.01, small + 0.01);
            // Tiny: met by no sample or one.
            draw_section(&mut raster, piece, Vec3::Y, &ink(0.5 * whole, 1.4));
            draw_section(&mut raster, (low * 3.0, high * 3.0), Vec3::Y, &ink(2.0, 9.0));
            let found = raster.lights[up].radiance[0];
            let expected = if scale == 1.0 { expected } else { 0.0 };
            assert!((found - expected).abs() < 1e-4, "{scale}: {found}");
        }
    }

    #[test]
    fn shares_of_a_covered_texel_sum_to_one() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        raster.clear::<Plain>(Vec3::Y);
        let up = table.texel_index(Vec3::new(0.05, 1.0, 0.05));
        let whole = table.texels()[up].solid_angle_sr;
        let (low, high) = (Vec3::new(0.0, 1.0, 0.0), Vec3::new(0.25, 1.0, 0.25));
        for share in [0.5, 0.2] {
            let bounds = (low - 1e-3, high + 1e-3);
            draw_section(&mut raster, bounds, Vec3::Y, &ink(share * whole, 3.0));
        }
        let light = raster.chunk(up / LANES).radiance[0][up % LANES];
        assert!((light - 3.0).abs() < 1e-3, "{light}");
    }

    /// Pieces far smaller than the gaps between samples that tile the sky: in texels that the horizon crosses, too, their shares
    /// are of the part above it.
    #[test]
    fn tiny_pieces_over_the_horizon_fill_the_sky() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, true);
        let normal = Vec3::new(0.3, 1.0, 0.45).normalize();
        raster.clear::<Plain>(normal);
        let count = 60_000u32;
        for i in 0..count {
            let z = -1.0 + 2.0 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let center = Vec3::new(r * cos as f32, r * sin as f32, z);
            if center.dot(normal) > 0.0 {
                let piece = (center - 1e-3, center + 1e-3);
                draw_section(&mut raster, piece, center, &ink(4.0 * PI / count as f32, 1.0));
            }
        }
        let (mut crossed, mut shares) = (0f32, 0f32);
        for (texel, light) in raster.texels.iter().zip(&raster.lights) {
            if texel.above == ALL {
                assert!((light.radiance[0] - 1.0).abs() < 0.1, "{}", light.radiance[0]);
            } else if texel.above != 0 {
                let above = texel.above.count_ones() as f32;
                crossed += above;
                shares += light.radiance[0] * above;
            }
        }
        assert!(crossed > 200.0 && (shares / crossed - 1.0).abs() < 0.1, "{shares} {crossed}");
    }

    #[test]
    fn samples_below_the_horizon_do_not_count() {
        let table = CubeRasterTable::new(8);
        let mut raster = CubeRaster::new(&table, false);
        let normal = Vec3::new(0.3, 0.8, -0.2).normalize();
        raster.clear::<Plain>(normal);
        assert!(!is_box_open(&raster, Vec3::new(-0.1, -3.0, -0.1), Vec3::new(0.1, -2.0, 0.1)));
        assert!(is_box_open(&raster, Vec3::new(-0.1, 2.0, -0.1), Vec3::new(0.1, 3.0, 0.1)));
        for (i, texel) in table.texels().iter().enumerate() {
            let above = f32::from(texel.direction.dot(normal) > 0.2);
            let below = f32::from(texel.direction.dot(normal) < -0.2);
            let open = raster.openness(i);
            assert!(open >= above && open <= 1.0 - below && (open == 0.0 || open == 1.0));
        }
    }

    /// Draws pieces of all kinds and gives every number of the raster.
    struct Everything;

    impl WideKernel for Everything {
        type Output = Vec<u32>;

        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u32> {
            let table = CubeRasterTable::new(8);
            let mut raster = CubeRaster::new(&table, true);
            raster.clear::<L>(Vec3::new(0.1, 0.9, 0.3).normalize());
            for i in 0..500u32 {
                let f = |k: u32| (i.wrapping_mul(k) >> 7) as f32 % 1009.0 / 504.0 - 1.0;
                let d = Vec3::new(f(2_654_435_761), f(40_503_227), f(1_442_695_041)).normalize();
                let n = Vec3::new(f(97_531), f(1_357_911), f(86_028_121)).normalize();
                let (center, radius) = (d * (1.0 + 0.01 * i as f32), 0.3);
                let inverse = n / n.dot(center);
                let veil = Veil { start: 0.0, end: 0.6, seed: i };
                let ink = Ink { veil, ..ink(0.03, i as f32) };
                let aabb = Aabb::from_disk(center, n, radius);
                let footprint = raster.footprint(aabb.min, aabb.max);
                if i % 3 == 2 {
                    let tangent = n.any_orthonormal_vector();
                    let (edges, half) = ([tangent, n.cross(tangent)], [0.2, 0.1]);
                    let tile = Tile { inverse, center, edges, half, distance_min: 0.5 };
                    raster.draw::<L, _>(&[(tile, ink)], &footprint, center);
                } else if i % 3 == 1 {
                    let disk = Disk { inverse, center, radius, distance_min: 0.5 };
                    raster.draw::<L, _>(&[(disk, ink)], &footprint, center);
                } else {
                    let section = Section { inverse, low: aabb.min, high: aabb.max };
                    raster.draw::<L, _>(&[(section, ink)], &footprint, center);
                }
            }
            let chunks = (0..48).map(|i| raster.chunk(i));
            chunks
                .flat_map(|c| c.covered.into_iter().chain(c.radiance.into_iter().flatten()))
                .map(f32::to_bits)
                .collect()
        }
    }

    #[test]
    fn every_level_gives_the_same_bits() {
        let expected = run_wide(SimdLevel::Baseline, Everything);
        for level in SimdLevel::available() {
            assert_eq!(run_wide(level, Everything), expected, "{level:?}");
        }
    }
}
