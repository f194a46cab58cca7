//! The cube raster: which samples are covered and how far away, and the radiance of each texel.

use crate::footprint::{BOXES, project_box, project_inside, turn};
use crate::lamp::{LAMPS, LampSeen};
use crate::lanes::{Lanes, SAMPLES};
use crate::samples::{Veil, divisor, offset_sum, place, sample_near};
use crate::shape::{Rims, Shape};
use crate::simd::WideKernel;
use crate::table::{CubeRasterTable, LANES};
use crate::texel_bits::{RowsOfWords, TexelBits, TexelRange, WordOfTexels};
use crate::texel_light::TexelLight;
use crate::tilt::TexelTilt;
use pbgi_math::{CubeFace, Vec3, larger};

/// Every sample of a texel.
const ALL: u16 = u16::MAX;

/// Solid angle, in steradians, up to which a piece's own solid angle is better than the count of its samples.
const SMALL_SR: f32 = 0.06;

/// The same of lamps, whose flux must not depend on how far their pieces reach over their edges.
const LARGE_LAMP_SR: f32 = 0.25;

/// How a piece covers and shines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ink {
    /// The samples it covers among those it meets.
    pub veil: Veil,
    /// Solid angle of its surfaces, as if nothing hid them; sr.
    pub solid_angle: f32,
    /// Radiance toward the receiver, 0 for backs.
    pub radiance: [f32; 3],
    /// Whether these are black backs: they show where nothing is before them, whatever is drawn later.
    pub is_back: bool,
    /// Surfaces nearer by no more than this share of the distance are its own neighbors, and do not hide it.
    pub tolerance: f32,
    /// Number of the lamp it is a part of, below [`LAMPS`]; none if it is no lamp. Lamps keep their flux whatever the texels' size.
    pub lamp: Option<u8>,
}

/// What eight texels of a row hold when all is drawn.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub struct TexelChunk {
    /// Whether anything of it is open.
    pub is_open: bool,
    /// Whether anything of it holds light; `radiance` is 0 if not.
    pub is_lit: bool,
    /// Samples of each texel that nothing covers, above the horizon.
    pub open_samples: [u16; LANES],
    /// Share of each texel, above the horizon, that surfaces cover; 0 where nothing of the chunk is open.
    pub covered: [f32; LANES],
    /// How far the middle of what is open lies from the middle of what is above the horizon, along u and v, in halves of a texel;
    /// times the open share of the whole texel.
    pub open_offset: [[f32; LANES]; 2],
    /// Radiance of the surfaces, weighted by the share of the texel they show, and by the cosine where they show it over the texel's mean.
    pub radiance: [[f32; LANES]; 3],
}

/// The texels of one face that what lies in a box may touch, as one number.
pub type FootprintCode = u32;

/// The code of what falls on several faces.
pub const NO_FOOTPRINT_CODE: FootprintCode = u32::MAX;

/// Bits of a code that are a coordinate.
const CODE_BITS: u32 = 6;

/// The texels of a code of one face.
#[inline(always)]
fn range_of(code: FootprintCode) -> TexelRange {
    let at = |index: u32| (code >> (index * CODE_BITS)) as u8 & ((1 << CODE_BITS) - 1);
    TexelRange { face: at(4), columns: [at(3), at(2)], rows: [at(1), at(0)] }
}

/// How far the middle of a texel's open samples lies from the middle of those above the horizon, times the open share of the whole texel
/// ([`TexelChunk::open_offset`]).
#[inline(always)]
fn open_offset(open: u16, above: u16) -> [f32; 2] {
    if open == 0 || open == above {
        return [0.0; 2];
    }
    let share = open.count_ones() as f32 / above.count_ones() as f32;
    let (open, above) = (offset_sum(open), offset_sum(above));
    [0, 1].map(|axis| (open[axis] - share * above[axis]) / SAMPLES as f32)
}

/// The horizon of a normal on a face: n·D is linear there.
#[derive(Clone, Copy, Debug)]
struct FaceHorizon {
    /// n·D in the middle of the face.
    middle: f32,
    /// What it changes by along u and v.
    slopes: [f32; 2],
    /// How much it varies around the middle of a texel.
    reach: f32,
}

impl FaceHorizon {
    #[inline(always)]
    fn new(normal: Vec3, face: CubeFace, step: f32) -> Self {
        let [ua, va] = face.uv_axes();
        let slopes = [normal[ua], normal[va]];
        let reach = 0.5 * step * (slopes[0].abs() + slopes[1].abs());
        Self { middle: normal[face.axis()] * face.sign(), slopes, reach }
    }

    /// Samples above it.
    #[inline(always)]
    fn above<L: Lanes>(&self, x: L, y: L) -> u16 {
        let [nu, nv] = self.slopes;
        let height = L::splat(self.middle).add(L::splat(nu).mul(x)).add(L::splat(nv).mul(y));
        !L::bits(height.le(L::splat(0.0)))
    }

    /// Of a row of `n` texels at `v`: first and one past the last column that are wholly above, and the same of those not wholly below. By
    /// one column more than there may be between the two on either side, for rounding.
    #[inline(always)]
    fn columns(&self, v: f32, step: f32, n: usize) -> [[usize; 2]; 2] {
        let [nu, nv] = self.slopes;
        let middle = self.middle + nv * v;
        if nu.abs() * n as f32 <= 1e-3 * self.reach {
            let above = middle > 1.01 * self.reach;
            let below = middle < -1.01 * self.reach;
            return [[0, if above { n } else { 0 }], [0, if below { 0 } else { n }]];
        }
        // Column c, with its middle at (c + ½) step − 1, is wholly above where nu u ≥ reach − middle.
        let column = |height: f32| ((height - middle) / nu + 1.0) / step - 0.5;
        let index = |c: f32| (c.clamp(0.0, n as f32)) as usize;
        let (whole, touched) = (column(self.reach), column(-self.reach));
        if nu > 0.0 {
            [[index(whole + 2.0), n], [index(touched - 1.0), n]]
        } else {
            [[0, index(whole - 1.0)], [0, index(touched + 2.0)]]
        }
    }
}

/// Samples of a texel that a piece met.
#[derive(Clone, Copy, Debug)]
struct Hit {
    index: u32,
    face: u8,
    column: u8,
    row: u8,
    /// Above the horizon and not hidden.
    visible: u16,
    /// Those before which nothing was that is as near.
    taken: u16,
}

/// A piece whose light is added once all are drawn that may hide it.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    inverse: Vec3,
    /// Its middle.
    toward: Vec3,
    solid_angle: f32,
    radiance: [f32; 3],
    tolerance: f32,
    lamp: Option<u8>,
    /// Samples inside of its outline, and where the hits of the next piece begin.
    met: u32,
    hits_end: u32,
}

/// Pieces and hits that wait for others that may hide them, at most: 1.8 MiB. The default cut has a third of them at most; what comes later is farther, give or
/// take the size of a surfel.
const DRAWN_MAX: usize = 1 << 14;
const HITS_MAX: usize = 1 << 16;

/// Six faces of texels around a receiver, aligned with the world, sixteen samples each.
///
/// A piece covers the samples that meet it, whether they were covered or not: pieces
/// of one surface, which meet or overlap a little, leave no gap between them, and the coverage of
/// a texel never exceeds 1. Where there is light, each sample keeps the inverse depth of the nearest piece that covers it, and pieces shine once
/// all are drawn ([`Self::resolve`]): surfaces that stick in each other come in any order, and what is inside of a wall must not shine for being drawn
/// before it. Pieces still arrive nearest first, or nearly, as the walk leaves out what is behind texels that are covered.
///
/// A small piece counts by its own exact solid angle, times the share of its samples that are not hidden, so
/// that a lamp smaller than a texel keeps its flux; a piece is not hidden by
/// its neighbors on the same surface, known by their depth. A piece
/// larger than that counts by the samples in which it is the nearest. In a texel that is covered wholly, shares must sum to one: surfaces share what
/// lamps leave of it. Lamps, pieces far brighter than usual, count by their own solid angle and cosine, whatever the texels' size.
#[derive(Clone, Debug)]
pub struct CubeRaster {
    n: usize,
    stride: usize,
    shines: bool,
    keeps_depths: bool,
    keeps_backs: bool,
    lamps: [LampSeen; LAMPS],
    /// Samples of each texel that lamps cover.
    of_lamps: Vec<u16>,
    /// Samples of each texel before which nothing but a black back is.
    of_backs: Vec<u16>,
    normal: Vec3,
    /// Samples of each texel that are covered, and those below the horizon.
    covered: Vec<u16>,
    /// Samples of each texel above the horizon.
    above: Vec<u16>,
    /// Samples of each texel in rims.
    rims: Vec<Rims>,
    /// Valid where `lit` says so.
    lights: Vec<TexelLight>,
    /// Texels that hold light.
    lit: TexelBits,
    /// Inverse depth along the face's axis of what covers each sample.
    depths: Vec<[f32; SAMPLES]>,
    /// Texels that are not wholly covered.
    open: TexelBits,
    rows: RowsOfWords,
    /// Those that what is drawn next may touch.
    looked_at: Vec<WordOfTexels>,
    /// Scale from face coordinates to texels: `n / 2`.
    scale: f32,
    /// Width of a texel in face coordinates.
    step: f32,
    /// Coordinates u of the samples in each column, and v of those in each row.
    directions: [Vec<[f32; SAMPLES]>; 2],
    inverse_solid_angles: Vec<f32>,
    hits: Vec<Hit>,
    drawn: Vec<Drawn>,
}

impl CubeRaster {
    /// An empty raster; `shines` says whether any piece carries light.
    #[must_use]
    pub fn new(table: &CubeRasterTable, shines: bool) -> Self {
        let (n, stride) = (table.edge(), table.stride());
        let step = 2.0 / n as f32;
        let places = |axis: usize| std::array::from_fn(|i| place(i)[axis] * step);
        let inverse = |sr: f32| if sr > 0.0 { 1.0 / sr } else { 0.0 };
        let places: [[f32; SAMPLES]; 2] = [places(0), places(1)];
        let corner = |i: usize| i as f32 * step - 1.0;
        let samples = |i: usize, axis: usize| places[axis].map(|place| corner(i) + place);
        let directions = [0, 1].map(|axis| (0..n).map(|i| samples(i, axis)).collect());
        Self {
            n,
            stride,
            shines,
            keeps_depths: shines,
            keeps_backs: shines,
            lamps: [LampSeen::default(); LAMPS],
            of_lamps: vec![0; if shines { 6 * n * stride } else { 0 }],
            of_backs: vec![0; if shines { 6 * n * stride } else { 0 }],
            normal: Vec3::Z,
            covered: vec![ALL; 6 * n * stride],
            above: vec![0; 6 * n * stride],
            rims: vec![Rims::default(); 6 * n * stride],
            lights: vec![
                TexelLight::new(TexelTilt::default());
                if shines { 6 * n * stride } else { 0 }
            ],
            lit: TexelBits::new(table),
            depths: vec![[0.0; SAMPLES]; 6 * n * stride],
            open: TexelBits::new(table),
            rows: RowsOfWords::new(table),
            looked_at: Vec::with_capacity(64),
            scale: 0.5 * n as f32,
            step,
            directions,
            inverse_solid_angles: table
                .texels()
                .iter()
                .map(|t| inverse(t.solid_angle_sr))
                .collect(),
            hits: Vec::with_capacity(64),
            drawn: Vec::with_capacity(64),
        }
    }

    /// Keeps how far away what covers samples is, also where nothing shines, for [`Self::nearest`].
    pub fn keep_depths(&mut self) {
        self.keeps_depths = true;
    }

    /// Notes where backs are seen, also where nothing shines, for [`Self::backs`].
    pub fn keep_backs(&mut self) {
        self.keeps_backs = true;
        self.of_backs.resize(self.covered.len(), 0);
    }

    /// Empties the raster for a receiver with this normal: samples below its horizon count as covered from the
    /// start.
    #[inline(always)]
    pub fn clear<L: Lanes>(&mut self, normal: Vec3) {
        self.clear_above::<L>(normal, normal);
    }

    /// The same for a receiver whose surface has another `plane` than the normal it is shaded with: samples below either count as covered.
    #[inline(always)]
    pub fn clear_above<L: Lanes>(&mut self, normal: Vec3, plane: Vec3) {
        self.lit.clear();
        self.hits.clear();
        self.drawn.clear();
        self.open.clear();
        self.rims.fill(Rims::default());
        self.lamps = [LampSeen::default(); LAMPS];
        self.of_lamps.fill(0);
        self.of_backs.fill(0);
        self.normal = normal;
        for face in CubeFace::ALL {
            let horizon = FaceHorizon::new(normal, face, self.step);
            let own = (plane != normal).then(|| FaceHorizon::new(plane, face, self.step));
            for row in 0..self.n {
                self.clear_row::<L>(face, row, &horizon, own.as_ref());
            }
        }
    }

    /// Empties a row of texels: columns that are wholly above the horizon, and above the receiver's own plane where that is another; columns that
    /// are wholly below the horizon, and the few between.
    #[inline(always)]
    fn clear_row<L: Lanes>(
        &mut self,
        face: CubeFace,
        row: usize,
        horizon: &FaceHorizon,
        own: Option<&FaceHorizon>,
    ) {
        let n = self.n;
        let v = (row as f32 + 0.5) * self.step - 1.0;
        let [mut whole, touched] = horizon.columns(v, self.step, n);
        if let Some(own) = own {
            let [above, _] = own.columns(v, self.step, n);
            whole = [whole[0].max(above[0]), whole[1].min(above[1])];
        }
        let start = (usize::from(face.0) * n + row) * self.stride;
        self.covered[start..start + n].fill(ALL);
        self.above[start..start + n].fill(0);
        // Rows are at most 64 wide.
        let mut bits = 0u64;
        if whole[0] < whole[1] {
            self.covered[start + whole[0]..start + whole[1]].fill(0);
            self.above[start + whole[0]..start + whole[1]].fill(ALL);
            bits = (u64::MAX >> (64 - (whole[1] - whole[0]))) << whole[0];
        }
        let is_between = |column: &usize| !(whole[0]..whole[1]).contains(column);
        for column in (touched[0]..touched[1]).filter(is_between) {
            let [u, v] = &self.directions;
            let (x, y) = (L::load(&u[column]), L::load(&v[row]));
            let index = start + column;
            let above = horizon.above(x, y);
            let mut open = above;
            if let Some(own) = own {
                open &= own.above(x, y);
                // The own plane hides whatever is drawn there.
                L::splat(f32::MAX).store_where(above & !open, &mut self.depths[index]);
            }
            bits |= u64::from(open != 0) << column;
            (self.covered[index], self.above[index]) = (!open, above);
        }
        self.open.insert_row(start, bits);
    }

    /// The light of a texel, to add to.
    #[inline(always)]
    fn light(&mut self, index: usize, [face, row, column]: [u8; 3]) -> &mut TexelLight {
        if !self.lit.contains(index) {
            self.lit.insert(index);
            let (row, column) = (usize::from(row), usize::from(column));
            let tilt = self.tilt(CubeFace(face), row, column, self.above[index]);
            self.lights[index] = TexelLight::new(tilt);
        }
        &mut self.lights[index]
    }

    /// What light weighs in the parts of a texel, for the receiver's normal.
    #[inline(always)]
    fn tilt(&self, face: CubeFace, row: usize, column: usize, above: u16) -> TexelTilt {
        let [ua, va] = face.uv_axes();
        let normal = self.normal;
        let (na, nu, nv) = (normal[face.axis()] * face.sign(), normal[ua], normal[va]);
        let [u, v] = [column, row].map(|i| (i as f32 + 0.5) * self.step - 1.0);
        TexelTilt::new(na + nu * u + nv * v, [nu, nv], [u, v], 0.5 * self.step, above)
    }

    /// Face coordinate of the boundary before texel `i`.
    #[inline(always)]
    fn corner(&self, i: usize) -> f32 {
        i as u32 as f32 * self.step - 1.0
    }

    /// Looks at the texels that the box `low..=high`, relative to the receiver, may touch, to draw what lies in it, and tells whether any of them is open.
    #[inline(always)]
    pub fn look_at_box(&mut self, low: Vec3, high: Vec3) -> bool {
        self.look(NO_FOOTPRINT_CODE, low, high)
    }

    /// The same for a box whose code was found before.
    #[inline(always)]
    pub fn look(&mut self, code: FootprintCode, low: Vec3, high: Vec3) -> bool {
        self.looked_at.clear();
        if code != NO_FOOTPRINT_CODE {
            return self.look_at(&range_of(code));
        }
        let last = (self.n - 1) as u8;
        let mut is_open = false;
        if low.cmple(Vec3::ZERO).all() && high.cmpge(Vec3::ZERO).all() {
            // The receiver is within the box: any face may see what is in it.
            for face in 0..6 {
                is_open |= self.look_at(&TexelRange { face, columns: [0, last], rows: [0, last] });
            }
            return is_open;
        }
        let (mut faces, rectangles) = project_box(low, high);
        let mut texels = [[0; BOXES]; 4];
        for (texels, plane) in texels.iter_mut().zip(&rectangles) {
            for i in 0..BOXES {
                texels[i] = self.texel(plane[i]);
            }
        }
        while faces != 0 {
            let face = faces.trailing_zeros() as usize;
            faces &= faces - 1;
            let [u0, u1, v0, v1] = &texels;
            let columns = [u0[face] as u8, u1[face] as u8];
            let rows = [v0[face] as u8, v1[face] as u8];
            is_open |= self.look_at(&TexelRange { face: face as u8, columns, rows });
        }
        is_open
    }

    /// The texel of a coordinate inside −1..=1.
    #[inline(always)]
    fn texel(&self, x: f32) -> u32 {
        let (texel, last) = (whole((x + 1.0) * self.scale), (self.n - 1) as u32);
        if texel < last { texel } else { last }
    }

    /// Looks at the texels of a rectangle, too. Where none of a word is open, light alone needs to be looked at.
    #[inline(always)]
    fn look_at(&mut self, range: &TexelRange) -> bool {
        let Self { rows, open, looked_at, shines, .. } = self;
        rows.find_open(range, open, *shines, looked_at)
    }

    /// Codes of the texels of eight boxes, relative to the receiver, as [`Self::look_at_box`] finds them.
    #[must_use]
    #[inline(always)]
    pub fn footprint_codes(
        &self,
        low: &[[f32; BOXES]; 3],
        high: &[[f32; BOXES]; 3],
    ) -> [FootprintCode; BOXES] {
        let (faces, rectangles) = project_inside(low, high);
        let mut codes = [0; BOXES];
        for i in 0..BOXES {
            let mut code = faces[i] as u32;
            for plane in &rectangles {
                code = code << CODE_BITS | self.texel(plane[i]);
            }
            codes[i] = if faces[i] == 255 { NO_FOOTPRINT_CODE } else { code };
        }
        codes
    }

    /// Draws a shape inside the texels that were looked at last; `toward` leads to its middle. Its light is added by [`Self::resolve`].
    #[inline(always)]
    pub fn draw<L: Lanes, S: Shape>(&mut self, shape: &S, ink: &Ink, toward: Vec3) {
        let hits_start = self.hits.len();
        let met = L::run_part(Cover { raster: self, shape, ink });
        if !self.shines || ink.is_back {
            return;
        }
        let &Ink { solid_angle, radiance, tolerance, lamp, .. } = ink;
        if let Some(lamp) = lamp {
            let seen = &mut self.lamps[usize::from(lamp)];
            if solid_angle >= LARGE_LAMP_SR {
                seen.note_large();
            }
            let weight = solid_angle * self.normal.dot(toward);
            seen.note_drawn(weight / larger(toward.length(), f32::MIN_POSITIVE), &radiance);
        }
        if met == 0 {
            self.hits.truncate(hits_start);
            if toward == Vec3::ZERO {
                return;
            }
        } else if self.hits.len() == hits_start {
            return;
        }
        let (inverse, hits_end) = (shape.inverse(), self.hits.len() as u32);
        let drawn =
            Drawn { inverse, toward, solid_angle, radiance, tolerance, lamp, met, hits_end };
        self.drawn.push(drawn);
        if self.drawn.len() >= DRAWN_MAX || self.hits.len() >= HITS_MAX {
            self.resolve::<L>();
        }
    }

    /// Adds the light of all that was drawn since the last time.
    #[inline(always)]
    pub fn resolve<L: Lanes>(&mut self) {
        let mut hits_start = 0;
        for number in 0..self.drawn.len() {
            let drawn = self.drawn[number];
            let hits_end = drawn.hits_end as usize;
            if drawn.met == 0 {
                self.shine_unmet::<L>(&drawn);
            }
            for number in hits_start..hits_end {
                self.shine_hit::<L>(number, &drawn);
            }
            hits_start = hits_end;
        }
        self.drawn.clear();
        self.hits.clear();
    }

    /// Adds the light of a piece to a texel in which it met some samples, as far as nothing hides it.
    #[inline(always)]
    fn shine_hit<L: Lanes>(&mut self, number: usize, drawn: &Drawn) {
        let mut hit = self.hits[number];
        let index = hit.index as usize;
        let [across, along] = &self.directions;
        let (u, v) = (&across[usize::from(hit.column)], &along[usize::from(hit.row)]);
        let w = inverse_depths(turn(drawn.inverse, CubeFace(hit.face)), L::load(u), L::load(v));
        let depths = L::load(&self.depths[index]);
        let hidden =
            self.covered[index] & L::bits(w.mul(L::splat(1.0 + drawn.tolerance)).le(depths));
        hit.visible &= !hidden;
        hit.taken &= L::bits(depths.le(w));
        if let Some(lamp) = drawn.lamp {
            let there =
                self.above[index] & !own_plane::<L>(self.covered[index], &self.depths[index]);
            self.lamps[usize::from(lamp)].note(there, hidden, self.of_lamps[index]);
        }
        if hit.visible | hit.taken != 0 {
            self.shine(&hit, drawn);
        }
    }

    /// Adds the light of a piece to a texel in which it shows.
    #[inline(always)]
    fn shine(&mut self, hit: &Hit, drawn: &Drawn) {
        let &Drawn { toward, solid_angle, ref radiance, lamp, met, .. } = drawn;
        let (index, place) = (hit.index as usize, [hit.face, hit.row, hit.column]);
        let above = self.above[index];
        let count = hit.visible.count_ones();
        if let Some(lamp) = lamp
            && solid_angle < LARGE_LAMP_SR
        {
            let seen = solid_angle * count as f32 / met as f32;
            // Where it met samples of one texel only, their places say less of it than its own.
            let cosine = if count == met && toward != Vec3::ZERO {
                self.normal.dot(toward) / toward.length()
            } else {
                self.cosine_in(hit, offset_sum(hit.visible).map(|sum| sum / divisor(hit.visible)))
            };
            self.shine_lamp((index, place), lamp, seen, cosine, radiance);
            return;
        }
        let per_sample = solid_angle * self.inverse_solid_angles[index] / met as f32;
        let light = self.light(index, place);
        let tilt = light.tilt;
        let samples = if solid_angle < SMALL_SR {
            count as f32 * per_sample * SAMPLES as f32 * tilt.cosine.mean(hit.visible)
        } else {
            hit.taken.count_ones() as f32 * tilt.sample.mean(hit.taken)
        };
        let share = samples / divisor(above);
        light.add(share, radiance);
    }

    /// Adds the light of a lamp that shows this solid angle in a texel, at this cosine: it counts as it is, whatever the texel's size.
    #[inline(always)]
    fn shine_lamp(
        &mut self,
        (index, place): (usize, [u8; 3]),
        lamp: u8,
        solid_angle: f32,
        cosine: f32,
        radiance: &[f32; 3],
    ) {
        self.lamps[usize::from(lamp)].add(solid_angle * larger(cosine, 0.0), radiance);
        let texel = self.inverse_solid_angles[index] * SAMPLES as f32 / divisor(self.above[index]);
        self.light(index, place).add_lamp(solid_angle * texel, radiance);
    }

    /// Cosine to the receiver's normal at a place of a texel, −1..=1 from border to border.
    #[inline(always)]
    fn cosine_in(&self, hit: &Hit, place: [f32; 2]) -> f32 {
        let [u, v] = [(hit.column, place[0]), (hit.row, place[1])]
            .map(|(i, place)| self.corner(usize::from(i)) + (0.5 * place + 0.5) * self.step);
        let direction = CubeFace(hit.face).direction(u, v);
        self.normal.dot(direction) / direction.length()
    }

    /// Irradiance from lamps, W·m⁻².
    #[must_use]
    #[inline(always)]
    pub fn lamp_irradiance(&self) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for lamp in &self.lamps {
            for channel in 0..3 {
                sum[channel] += lamp.irradiance[channel];
            }
        }
        sum
    }

    /// What is seen of each lamp.
    #[must_use]
    #[inline(always)]
    pub fn lamps(&self) -> &[LampSeen; LAMPS] {
        &self.lamps
    }

    /// Covers the samples that meet a shape, and counts those inside of its outline. Without light, texels that are covered already need not meet anything.
    #[inline(always)]
    fn cover<L: Lanes, S: Shape>(&mut self, shape: &S, ink: &Ink) -> u32 {
        let Self { n, stride, shines, keeps_depths, covered, above, rims, depths, .. } = self;
        let Self { open, rows, looked_at, directions: [across, along], hits, .. } = self;
        let Self { of_lamps, of_backs, keeps_backs, .. } = self;
        let (face_texels, shines, keeps_depths) = (*n * *stride, *shines, *keeps_depths);
        let keeps_backs = *keeps_backs;
        let (stride_log2, in_row) = (rows.stride_log2, *stride - 1);
        let (opaque, veil) = (ink.veil.is_opaque(), ink.veil.pattern());
        let nearer = L::splat(1.0 + ink.tolerance);
        let mut met_count = 0;
        for &WordOfTexels { face, word, texels } in looked_at.iter() {
            let mut rest = if shines { texels } else { texels & open.word(word as usize) };
            if rest == 0 {
                continue;
            }
            let shape = shape.turned(CubeFace(face));
            let inverse = shape.inverse();
            let start = word as usize * u64::BITS as usize;
            let of_face = usize::from(face) * face_texels;
            while rest != 0 {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let index = start + bit;
                let (row, column) = ((index - of_face) >> stride_log2, index & in_row);
                let (u, v) = (L::load(&across[column]), L::load(&along[row]));
                let w = inverse_depths(inverse, u, v);
                let found = shape.meets([L::splat(1.0), u, v], w);
                let met = found.close(&shape, &mut rims[index]);
                if met == 0 {
                    continue;
                }
                // What lies between it and its neighbors is covered, and no part of what shines.
                let inside = found.inside;
                met_count += inside.count_ones();
                let (before, depths) = (covered[index], &mut depths[index]);
                let inked = if opaque { met } else { met & veil.samples(index) };
                let new = inked & !before;
                if shines {
                    let (above, old) = (above[index], L::load(depths));
                    let mut nearer_ones = before & L::bits(w.le(old));
                    let backs = of_backs[index];
                    if backs & nearer_ones != 0 && !ink.is_back {
                        // A back at the same place gives way.
                        nearer_ones &= !(backs & L::bits(old.le(w)));
                    }
                    let taken = inked & above & !nearer_ones;
                    if taken != 0 {
                        w.store_where(taken, depths);
                        of_backs[index] = backs & !taken | if ink.is_back { taken } else { 0 };
                        let of_lamp = if ink.lamp.is_some() { taken } else { 0 };
                        of_lamps[index] = of_lamps[index] & !taken | of_lamp;
                    }
                    if !ink.is_back {
                        // What is hidden now stays so: to leave it out here already takes 4 % less time than to ask in the end only.
                        let hidden = before & L::bits(w.mul(nearer).le(old));
                        let visible = inside & above & !hidden;
                        if visible | taken != 0 || ink.lamp.is_some() {
                            let (row, column, index) = (row as u8, column as u8, index as u32);
                            hits.push(Hit { index, face, column, row, visible, taken });
                        }
                    }
                } else if keeps_backs && ink.is_back {
                    of_backs[index] |= new;
                }
                if new != 0 {
                    if keeps_depths && !shines {
                        w.store_where(new, depths);
                    }
                    covered[index] = before | new;
                    if before | new == ALL {
                        open.remove(index);
                    }
                }
            }
        }
        met_count
    }

    /// Adds the light of a piece that met no sample to the texel at its middle. Whether it is hidden says the sample next to it:
    /// others in the texel may lie on other surfaces.
    #[inline(always)]
    fn shine_unmet<L: Lanes>(&mut self, drawn: &Drawn) {
        let &Drawn { inverse, toward, solid_angle, ref radiance, tolerance, lamp, .. } = drawn;
        let (face, u, v) = CubeFace::from_direction(toward);
        let [x, y] = [u, v].map(|c| (c + 1.0) * self.scale);
        let texel = |c: f32| smaller_index(c as i32 as usize, self.n - 1);
        let (column, row) = (texel(x), texel(y));
        let index = (usize::from(face.0) * self.n + row) * self.stride + column;
        let place_in_texel = [x - column as u32 as f32, y - row as u32 as f32];
        let sample = sample_near(place_in_texel[0], place_in_texel[1]);
        let above = self.above[index];
        if above >> sample & 1 == 0 {
            return;
        }
        let [across, along] = &self.directions;
        let inverse = turn(inverse, face);
        let w = inverse_depths(inverse, L::load(&across[column]), L::load(&along[row]));
        let (nearer, depths) = (L::splat(1.0 + tolerance), &self.depths[index]);
        let hidden = self.covered[index] & L::bits(w.mul(nearer).le(L::load(depths)));
        if let Some(lamp) = lamp {
            let there = above & !own_plane::<L>(self.covered[index], depths);
            self.lamps[usize::from(lamp)].note(there, hidden, self.of_lamps[index]);
        }
        if hidden >> sample & 1 != 0 {
            return;
        }
        let place_in_texel = place_in_texel.map(|x| 2.0 * x - 1.0);
        let place = [face.0, row as u8, column as u8];
        if let Some(lamp) = lamp {
            let cosine = self.normal.dot(toward) / toward.length();
            self.shine_lamp((index, place), lamp, solid_angle, cosine, radiance);
            return;
        }
        let whole = self.inverse_solid_angles[index] * SAMPLES as f32 / above.count_ones() as f32;
        let light = self.light(index, place);
        let cosine = light.tilt.cosine.at(place_in_texel);
        let share = solid_angle * whole * cosine;
        light.add(share, radiance);
    }

    /// Share of texel `index` (in memory), above the horizon, that no surface covers.
    #[must_use]
    #[inline(always)]
    pub fn openness(&self, index: usize) -> f32 {
        let open = (!self.covered[index]).count_ones() as f32;
        open / divisor(self.above[index])
    }

    /// Inverse depth, along its face's axis, of the nearest thing that covers samples of texel `index` (in memory) above the horizon; 0
    /// where nothing does. Needs [`Self::keep_depths`] where nothing shines.
    #[must_use]
    #[inline(always)]
    pub fn nearest<L: Lanes>(&self, index: usize) -> f32 {
        L::load(&self.depths[index]).largest_where(self.things::<L>(index))
    }

    /// Samples of texel `index` (in memory) above the horizon that things cover: the receiver's own plane is none.
    #[inline(always)]
    fn things<L: Lanes>(&self, index: usize) -> u16 {
        let drawn = self.covered[index] & self.above[index];
        drawn & !own_plane::<L>(drawn, &self.depths[index])
    }

    /// Inverse distance, along a plane through the receiver, to the nearest of what stands on it in texel `index` (in memory): what covers samples whose
    /// slope over the plane lies between two `slopes`. 0 where nothing does. Needs [`Self::keep_depths`] where nothing shines.
    #[must_use]
    #[inline(always)]
    pub fn standing<L: Lanes>(&self, index: usize, plane: Vec3, slopes: [f32; 2]) -> f32 {
        let (row, column) = (index / self.stride, index % self.stride);
        let (face, row) = (CubeFace((row / self.n) as u8), row % self.n);
        let (u, v) = (L::load(&self.directions[0][column]), L::load(&self.directions[1][row]));
        let sine = inverse_depths(turn(plane, face), u, v);
        let sine2 = sine.mul(sine);
        let along2 = L::splat(1.0).add(u.mul(u)).add(v.mul(v)).sub(sine2);
        let is_over = |slope: f32| L::bits(along2.mul(L::splat(slope * slope)).le(sine2));
        let over = is_over(slopes[0]) & !is_over(slopes[1]) & L::bits(L::splat(0.0).le(sine));
        let depths = L::load(&self.depths[index]);
        depths.mul(depths).div(along2).largest_where(self.things::<L>(index) & over).sqrt()
    }

    /// Share of the samples of texel `index` (in memory) that lie above the horizon.
    #[must_use]
    #[inline(always)]
    pub fn share_above(&self, index: usize) -> f32 {
        self.above[index].count_ones() as f32 / SAMPLES as f32
    }

    /// Radiance of the lamps in texel `index` (in memory), whose light is not in [`TexelChunk::radiance`], times the share of it they show.
    #[must_use]
    #[inline(always)]
    pub fn lamp_radiance(&self, index: usize) -> [f32; 3] {
        if self.lit.contains(index) { self.lights[index].lamp_radiance } else { [0.0; 3] }
    }

    /// Texels `8 index ..` in memory; none where all of them are below the horizon.
    #[must_use]
    #[inline(always)]
    pub fn chunk(&self, index: usize) -> Option<TexelChunk> {
        let start = index * LANES;
        let above: &[u16; LANES] = self.above[start..start + LANES].try_into().ok()?;
        if *above == [0; LANES] {
            return None;
        }
        let covered: &[u16; LANES] = self.covered[start..start + LANES].try_into().ok()?;
        let is_open = *covered != [ALL; LANES];
        let mut chunk = TexelChunk { is_open, ..TexelChunk::default() };
        if chunk.is_open {
            chunk.open_samples = covered.map(|covered| !covered);
            for lane in 0..LANES {
                let open = chunk.open_samples[lane].count_ones() as f32;
                let all = divisor(above[lane]);
                chunk.covered[lane] = 1.0 - open / all;
            }
            for lane in 0..LANES {
                // Texels that the horizon or an edge crosses are few.
                if covered[lane] != ALL && covered[lane] != !above[lane] {
                    let offset = open_offset(!covered[lane], above[lane]);
                    (chunk.open_offset[0][lane], chunk.open_offset[1][lane]) =
                        (offset[0], offset[1]);
                }
            }
        }
        let lit = self.lit.eight(start);
        chunk.is_lit = lit != 0;
        if chunk.is_lit {
            for lane in (0..LANES).filter(|lane| lit >> lane & 1 != 0) {
                let light = &self.lights[start + lane];
                let whole = covered[lane] == ALL;
                let radiance = if whole {
                    light.made_whole(self.backs_share(start + lane))
                } else {
                    light.radiance
                };
                for (plane, light) in chunk.radiance.iter_mut().zip(radiance) {
                    plane[lane] = light;
                }
            }
        }
        Some(chunk)
    }

    /// Share of a lit texel before which nothing but black backs is, weighted as light is.
    #[inline(always)]
    fn backs_share(&self, index: usize) -> f32 {
        let backs = self.of_backs[index];
        if backs == 0 {
            return 0.0;
        }
        let weight = self.lights[index].tilt.sample.mean(backs);
        backs.count_ones() as f32 * weight / divisor(self.above[index])
    }

    /// Share of the samples above the horizon before which nothing but black backs is, of all texels together. Without light, what is drawn later but
    /// nearer does not count.
    #[must_use]
    #[inline(always)]
    pub fn backs(&self) -> f32 {
        let mut counts = [0u32; 2];
        for (backs, above) in self.of_backs.iter().zip(&self.above) {
            counts[0] += (backs & above).count_ones();
            counts[1] += above.count_ones();
        }
        counts[0] as f32 / larger(counts[1] as f32, 1.0)
    }

    /// Whether it makes a difference which of two pieces at nearly one place is drawn first: whose backs those are that are seen, where there is no light.
    #[must_use]
    #[inline(always)]
    pub fn minds_order(&self) -> bool {
        self.keeps_backs && !self.shines
    }

    /// Whether any piece may carry light.
    #[must_use]
    #[inline(always)]
    pub fn shines(&self) -> bool {
        self.shines
    }
}

/// A shape to cover samples with.
struct Cover<'a, S> {
    raster: &'a mut CubeRaster,
    shape: &'a S,
    ink: &'a Ink,
}

impl<S: Shape> WideKernel for Cover<'_, S> {
    type Output = u32;

    #[inline(always)]
    fn run<L: Lanes>(self) -> u32 {
        self.raster.cover::<L, S>(self.shape, self.ink)
    }
}

/// Inverse depths of a plane, turned to a face, along the directions of a texel's samples.
#[inline(always)]
fn inverse_depths<L: Lanes>(inverse: Vec3, u: L, v: L) -> L {
    L::splat(inverse.x).add(u.mul(L::splat(inverse.y))).add(v.mul(L::splat(inverse.z)))
}

/// Of a texel's covered samples, those that the receiver's own plane hides.
#[inline(always)]
fn own_plane<L: Lanes>(covered: u16, depths: &[f32; SAMPLES]) -> u16 {
    covered & L::bits(L::splat(f32::MAX).le(L::load(depths)))
}

/// The whole part of a number from 0 up to 2²², in few instructions; of a whole one, it may be one less.
#[inline(always)]
fn whole(x: f32) -> u32 {
    // From 2²³ on, numbers are whole: a sum is rounded to the nearest one, which the lowest bits hold.
    const TO_WHOLE: f32 = (1 << 23) as f32;
    (larger(x - 0.5, 0.0) + TO_WHOLE).to_bits() - TO_WHOLE.to_bits()
}

/// The smaller of two indices.
#[inline(always)]
fn smaller_index(a: usize, b: usize) -> usize {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests;
