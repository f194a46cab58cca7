//! How a leaf is stored: for each kind of field what its surfels share, and the least bits for what they do not.

use crate::bits::{BitWriter, PUSH_BITS_MAX, Word, index_bits, number_bits};
use crate::leaf::{
    CODE_MASK, FEET_UNLISTED, FOOT_BITS, OrientationMode, PositionFrame, SizeMode, WIDTH_BITS,
};
use crate::surfel::{RADIANCE, SIZE_RATIO, encode_albedo};
use crate::{Channels, MiniFloat, SurfelLayout};
use pbgi_math::{
    Aabb, FootCode, OCTAHEDRAL24_ERROR, Vec3, decode_octahedral24, narrow_octahedral24,
};

/// Most bits of a coordinate.
const POSITION_WIDTH_MAX: u32 = 15;

/// Steps of a coordinate per half edge: of the shortest edge of the rectangles and triangles, and of the squares of the mean and of the
/// least area.
struct StepsPerEdge {
    tile: f32,
    mean: f32,
    least: f32,
}

/// Steps across a plane: what stands a hundredth of an edge before a wall must stay there.
const ACROSS: StepsPerEdge = StepsPerEdge { tile: 256.0, mean: 128.0, least: 32.0 };

/// Steps along the axes of the world, where surfaces have several normals.
const MIXED: StepsPerEdge = StepsPerEdge { tile: 256.0, mean: 64.0, least: 32.0 };

/// Steps from a surface to one that faces it or away from it: one step of 1/8 leaves each where it is to within a quarter of the way to the other.
const STEPS_BETWEEN_SHEETS: f32 = 8.0;

/// Half diagonals of two squares, in halves of an edge: centers farther from each other than that are those of surfels side by side.
const HALF_DIAGONALS: f32 = 2.9;

/// Cosine between normals below which two are opposed.
const OPPOSED_COSINE: f32 = -0.99;

/// Steps along a plane, where neighbors overlap.
const ALONG: StepsPerEdge = StepsPerEdge { tile: 64.0, mean: 32.0, least: 16.0 };

/// Heights of triangles below this share of their longest edge count as that.
const LOW_HEIGHT: f32 = 0.25;

/// Share of a step below which coordinates count as one.
const SHARED_STEP: f32 = 0.25;

/// Steps of sizes are so many bits above those of [`crate::MiniFloat`]: ±1.6 %, of rectangles, which must meet, ±0.4 %.
const DISK_SIZE_SHIFT: u32 = 4;
const TILE_SIZE_SHIFT: u32 = 2;

/// Ratios of radius and area within this share are one.
const SIZE_RATIO_TOLERANCE: f32 = 1.0 / 128.0;

/// Steps of radiance are at least so many bits above those of [`crate::MiniFloat`], ±1.6 %, and larger where a channel would
/// need more than `RADIANCE_WIDTH_MAX` bits. Below `RADIANCE_SPAN` under the leaf's brightest channel (16 octaves) is 0, unless a surfel would lose
/// all of its light: then steps stay small and take what bits they need, `RADIANCE_WIDTH_WIDE` at most, and nothing is lost.
const RADIANCE_SHIFT_MIN: u32 = 4;
const RADIANCE_WIDTH_MAX: u32 = 8;
const RADIANCE_SPAN: u32 = 16 << 9;
const RADIANCE_WIDTH_WIDE: u32 = MiniFloat::BITS - RADIANCE_SHIFT_MIN;

/// Bits of an orientation that hold the normal.
const NORMAL_BITS: u32 = 0xff_ffff;

/// Bits of [`Codes::sizes`] that are flags.
const SIZE_FLAGS: u32 = !(CODE_MASK | CODE_MASK << 16);

/// Bits of an albedo's channel at most, above the leaf's least.
const ALBEDO_WIDTH_MAX: u32 = 6;

/// What [`LeafWriter::record`] puts into one word fits it.
const _: () =
    assert!(3 * POSITION_WIDTH_MAX <= PUSH_BITS_MAX && 3 * MiniFloat::BITS <= PUSH_BITS_MAX);

/// How much a leaf rounds what it stores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LeafRounding {
    /// To steps small against the surfels, for few bytes.
    #[default]
    Compact,
    /// To the finest steps the layout has: what `Compact` costs is measured against it.
    Finest,
}

/// A surfel to be stored.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfelFields {
    /// Center relative to the file's origin.
    pub center: Vec3,
    /// Bits 0–23: the normal, octahedral; bits 24–31: the TileCode of the longest edge, or 0.
    pub orientation: u32,
    /// Where the foot of a triangle's height is; none of a rectangle or disk.
    pub foot: FootCode,
    /// Radius of the covering disk, or half the longest edge where the TileCode is not 0; above 0.
    pub size: f32,
    /// True area, above 0.
    pub area: f32,
    /// Radiance of the front, W·m⁻²·sr⁻¹.
    pub radiance: [f32; 3],
    /// Diffuse albedo, 0..=1.
    pub albedo: [f32; 3],
    /// Shows half its area to every direction; its orientation is not stored.
    pub isotropic: bool,
    /// Blocks and shines on its front only.
    pub front_only: bool,
}

/// A surfel's fields as the widest codes.
#[derive(Clone, Copy, Debug, Default)]
struct Codes {
    center: Vec3,
    orientation: u32,
    foot: u8,
    /// Size in bits 0–14, area in bits 16–30, with their flags above.
    sizes: u32,
    radiance: [u32; 3],
    albedo: u32,
}

/// The distinct values of a leaf, and which of them each surfel has.
#[derive(Default)]
struct Listed {
    values: Vec<u32>,
    indices: Vec<u8>,
}

impl Listed {
    /// Lists values of so many bytes. Whether list and indices take at most `bits_max` bits; where they do not, only the first value is sure to be there.
    fn collect(&mut self, all: impl Iterator<Item = u32>, value_bytes: u32, bits_max: u32) -> bool {
        let values_max = bits_max.saturating_sub(8) / (8 * value_bytes);
        self.values.clear();
        self.indices.clear();
        let mut last = 0;
        for value in all {
            if self.values.get(last) != Some(&value) {
                last = self.values.iter().position(|&v| v == value).unwrap_or(self.values.len());
                if last == self.values.len() {
                    self.values.push(value);
                    if last >= values_max as usize {
                        return false;
                    }
                }
            }
            self.indices.push(last as u8);
        }
        let index_bits = self.indices.len() as u32 * self.index_bits();
        8 + self.values.len() as u32 * 8 * value_bytes + index_bits <= bits_max
    }

    fn index_bits(&self) -> u32 {
        index_bits(self.values.len())
    }

    fn write(&self, value_bytes: usize, out: &mut Vec<u8>) {
        out.push(self.values.len() as u8);
        for value in &self.values {
            out.extend_from_slice(&value.to_le_bytes()[..value_bytes]);
        }
    }

    /// Adds the index of surfel `index`.
    #[inline(always)]
    fn push_index(&self, index: usize, word: Word) -> Word {
        word.with(self.indices[index].into(), self.index_bits())
    }
}

/// How coordinates along one axis are stored.
#[derive(Clone, Copy)]
struct Axis {
    width: u32,
    /// Codes per unit of length, and the largest.
    scale: f32,
    largest: u32,
    /// What is stored is so many steps of `1 << shift` above the least code.
    least: u32,
    shift: u32,
}

/// Bits of a coordinate that all share, and of heights before the shift.
const FINE_BITS: u32 = 16;

impl Axis {
    fn new(bits: u32, extent: f32) -> Self {
        let scale = if extent > 0.0 { (1u32 << bits) as f32 / extent } else { 0.0 };
        Self { width: bits, scale, largest: (1 << bits) - 1, least: 0, shift: 0 }
    }

    /// For the coordinates `low` to `high` of 0 to `extent`.
    fn fit((low, high): (f32, f32), extent: f32, step: f32) -> Self {
        if high - low <= SHARED_STEP * step {
            return Self::shared(0.5 * (low + high), extent);
        }
        Self::new(least_exponent(extent / step).clamp(1, POSITION_WIDTH_MAX), extent)
    }

    /// The same, counted from the least.
    fn fit_heights((low, high): (f32, f32), extent: f32, step: f32) -> Self {
        if high - low <= SHARED_STEP * step {
            return Self::shared(0.5 * (low + high), extent);
        }
        let fine = Self::new(FINE_BITS, extent);
        let least = fine.code(low);
        let range = fine.code(high) - least;
        let shift = least_exponent(step * fine.scale).max(1) - 1;
        let shift = shift.clamp(number_bits(range).saturating_sub(POSITION_WIDTH_MAX), 15);
        Self { width: number_bits(range >> shift), least, shift, ..fine }
    }

    /// No bits, but one code for all.
    fn shared(coordinate: f32, extent: f32) -> Self {
        let fine = Self::new(FINE_BITS, extent);
        Self { width: 0, least: fine.code(coordinate), ..fine }
    }

    fn code(&self, coordinate: f32) -> u32 {
        ((coordinate * self.scale) as u32).min(self.largest).saturating_sub(self.least)
            >> self.shift
    }
}

/// Least exponent of a power of two above `x`; 0 below 1.
fn least_exponent(x: f32) -> u32 {
    (x.to_bits() >> 23).saturating_sub(126)
}

/// The least and the largest of some codes.
#[derive(Clone, Copy)]
struct Span {
    least: u32,
    largest: u32,
}

impl Default for Span {
    /// Of no codes.
    fn default() -> Self {
        Self { least: CODE_MASK, largest: 0 }
    }
}

impl Span {
    fn with(self, code: u32) -> Self {
        Self { least: self.least.min(code), largest: self.largest.max(code) }
    }
}

/// Numbers below a largest one.
#[derive(Clone, Copy, Default)]
struct Below {
    largest: u32,
    shift: u32,
    width: u32,
}

impl Below {
    /// For codes from `least` to `largest`.
    fn fit(Span { least, largest }: Span, shift: u32) -> Self {
        let fit = Self { largest, shift, width: 0 };
        Self { width: number_bits(fit.steps(least)), ..fit }
    }

    /// Rounded to nearest, but not to 0.
    fn steps(&self, code: u32) -> u32 {
        let most = self.largest.saturating_sub(1) >> self.shift;
        round_shift(self.largest - code, self.shift).min(most)
    }

    fn control(&self) -> u8 {
        (self.width | self.shift << WIDTH_BITS) as u8
    }
}

/// Three numbers above their smallest ones.
#[derive(Clone, Copy, Default)]
struct Above {
    least: [u32; 3],
    shift: u32,
    width: [u32; 3],
    /// Codes below this are 0; 0 where there is no such code.
    floor: u32,
}

impl Above {
    /// Steps are `1 << shift_min`, or larger where a channel needs more than `width_max` bits.
    fn fit(
        codes: impl Iterator<Item = [u32; 3]> + Clone,
        (shift_min, width_max): (u32, u32),
        span: u32,
    ) -> Self {
        let brightest = codes.clone().flatten().max().unwrap_or(0);
        let floor = if span == 0 { 0 } else { brightest.saturating_sub(span).max(1) };
        let (mut least, mut largest) = ([u32::MAX; 3], [0; 3]);
        let mut has_zero = false;
        for code in codes {
            for channel in 0..3 {
                if code[channel] < floor {
                    has_zero = true;
                } else {
                    least[channel] = least[channel].min(code[channel]);
                    largest[channel] = largest[channel].max(code[channel]);
                }
            }
        }
        let least = least.map(|l| if l == u32::MAX { 0 } else { l });
        let floor = if has_zero { floor } else { 0 };
        let mut fit = Self { least, shift: shift_min, width: [0; 3], floor };
        loop {
            fit.width = fit.steps(largest).map(number_bits);
            if fit.width.iter().all(|&w| w <= width_max) {
                return fit;
            }
            fit.shift += 1;
        }
    }

    fn steps(&self, codes: [u32; 3]) -> [u32; 3] {
        let zero = u32::from(self.floor > 0);
        std::array::from_fn(|channel| {
            let code = codes[channel];
            if code < self.floor {
                return 0;
            }
            round_shift(code - self.least[channel], self.shift) + zero
        })
    }

    fn bits(&self) -> u32 {
        self.width.iter().sum()
    }

    fn control(&self) -> u16 {
        let widths = self.width[0] | self.width[1] << 4 | self.width[2] << 8;
        (widths | self.shift << 12 | u32::from(self.floor > 0) << 15) as u16
    }
}

/// How the surfels of a leaf are stored.
struct Form {
    axes: [Axis; 3],
    orientation: OrientationMode,
    /// Bits of a surfel's foot that is not listed.
    foot_width: u32,
    size: SizeMode,
    radius: Below,
    area: Below,
    radiance: Above,
    /// `None` where albedos are listed.
    albedo: Option<Above>,
}

/// Encodes leaves, one after the other; keeps its memory.
#[derive(Default)]
pub struct LeafWriter {
    rounding: LeafRounding,
    surfels: Vec<Codes>,
    /// Least half edge of rectangles and triangles.
    tile_edge: Option<f32>,
    any_triangle: bool,
    area_sum: f32,
    any_isotropic: bool,
    /// Least and largest square of the size over the area.
    ratio: Option<(f32, f32)>,
    /// Codes of sizes and areas.
    size_span: Span,
    area_span: Span,
    orientations: Listed,
    feet: Listed,
    sizes: Listed,
    albedos: Listed,
    /// Coordinates of the leaf under way.
    places: Vec<[f32; 3]>,
    /// Surfels of two orientations: heights along a normal, orientations, centers.
    heights: Vec<(f32, u8, Vec3)>,
}

impl LeafWriter {
    /// A writer of leaves rounded so.
    #[must_use]
    pub fn new(rounding: LeafRounding) -> Self {
        Self { rounding, ..Self::default() }
    }

    fn is_finest(&self) -> bool {
        self.rounding == LeafRounding::Finest
    }

    /// Adds a surfel to the leaf.
    #[inline]
    pub fn push(&mut self, surfel: &SurfelFields, layout: &SurfelLayout) {
        let is_tile = surfel.orientation >> 24 != 0 && !surfel.isotropic;
        let foot = if is_tile { surfel.foot } else { FootCode::NONE };
        self.any_triangle |= foot.is_known();
        if is_tile {
            let half = surfel.area / surfel.size;
            let short = match foot {
                FootCode::NONE => 0.25 * half,
                _ => (0.5 * half).max(LOW_HEIGHT * surfel.size),
            };
            self.tile_edge = Some(self.tile_edge.map_or(short, |edge| edge.min(short)));
        }
        self.area_sum += surfel.area;
        self.any_isotropic |= surfel.isotropic;
        let ratio = surfel.size * surfel.size / surfel.area;
        let (least, largest) = self.ratio.unwrap_or((ratio, ratio));
        self.ratio = Some((least.min(ratio), largest.max(ratio)));
        let size = u32::from(layout.radius.encode(surfel.size).max(1));
        let area = u32::from(layout.area.encode(surfel.area).max(1));
        self.size_span = self.size_span.with(size);
        self.area_span = self.area_span.with(area);
        let flags = u32::from(surfel.isotropic) << 15 | u32::from(surfel.front_only) << 31;
        let mut codes = Codes {
            center: surfel.center,
            orientation: if surfel.isotropic { 0 } else { surfel.orientation },
            foot: foot.0,
            sizes: size | area << 16 | flags,
            ..Codes::default()
        };
        if layout.channels == Channels::Rgb {
            let scale = 1.0 / layout.radiance_scale;
            codes.radiance = surfel.radiance.map(|c| u32::from(RADIANCE.encode(c * scale)));
        }
        if layout.albedo {
            let [r, g, b] = surfel.albedo.map(|c| u32::from(encode_albedo(c)));
            codes.albedo = r | g << 8 | b << 16;
        }
        self.surfels.push(codes);
    }

    /// Appends the leaf of all surfels since the last and forgets them; positions refer to `frame`.
    ///
    /// # Panics
    ///
    /// If there are no surfels, or more than 255.
    pub fn finish(&mut self, frame: &Aabb, layout: &SurfelLayout, out: &mut Vec<u8>) {
        let count = self.surfels.len();
        assert!((1..=255).contains(&count), "a leaf holds 1 to 255 surfels");
        let orientation = self.choose_orientation();
        let is_plane = orientation == OrientationMode::Plane;
        let frame = match is_plane {
            true => PositionFrame::of_plane(frame, self.orientations.values[0]),
            false => PositionFrame::of_box(frame),
        };
        let axes = self.fit_axes(&frame, orientation, layout);
        let (size, radius, area) = self.choose_sizes();
        let widths = axes[0].width | axes[1].width << 4 | axes[2].width << 8;
        let control = widths | (orientation as u32) << 12 | (size as u32) << 14;
        out.extend_from_slice(&(control as u16).to_le_bytes());
        if is_plane || orientation == OrientationMode::Listed {
            self.orientations.write(4, out);
        }
        let foot_width = self.write_feet(orientation, out);
        for (axis, stored) in axes.iter().enumerate() {
            let is_height = is_plane && axis == 2;
            if stored.width == 0 || is_height {
                out.extend_from_slice(&(stored.least as u16).to_le_bytes());
            }
            if stored.width > 0 && is_height {
                out.push(stored.shift as u8);
            }
        }
        self.write_sizes(size, &radius, &area, out);
        let radiance = self.write_radiance(layout, out);
        let albedo = self.write_albedo(layout, out);
        let form = Form { axes, orientation, foot_width, size, radius, area, radiance, albedo };
        let record_bits: u32 = self.record(0, &form).iter().map(|word| word.width).sum();
        let mut bits = BitWriter::new(out, count * record_bits as usize);
        for index in 0..count {
            for word in self.record(index, &form) {
                bits.push(word.number, word.width);
            }
        }
        bits.finish();
        self.forget();
    }

    /// A surfel as it is stored: its place, its orientation, its size and area, its light, its albedo.
    #[inline(always)]
    fn record(&self, index: usize, form: &Form) -> [Word; 5] {
        let Form { radius, area, radiance, .. } = form;
        let surfel = &self.surfels[index];
        let word = Word::default();
        let mut place = word;
        for (axis, coordinate) in form.axes.iter().zip(self.places[index]) {
            if axis.width > 0 {
                place = place.with(axis.code(coordinate), axis.width);
            }
        }
        let turn = match form.orientation {
            OrientationMode::Listed | OrientationMode::Plane => {
                self.orientations.push_index(index, word)
            }
            OrientationMode::Narrow => word.with(narrow_octahedral24(surfel.orientation), 20),
            OrientationMode::Wide => word.with(surfel.orientation, 32),
        };
        let turn = match form.foot_width {
            0 if self.any_triangle => self.feet.push_index(index, turn),
            width => turn.with(surfel.foot.into(), width),
        };
        let sizes = match form.size {
            SizeMode::Listed => self.sizes.push_index(index, word),
            SizeMode::Area => word.with(area.steps(area_code(surfel)), area.width),
            SizeMode::Both => word
                .with(radius.steps(radius_code(surfel)), radius.width)
                .with(area.steps(area_code(surfel)), area.width),
            SizeMode::Wide => word.with(surfel.sizes, 32),
        };
        let light = push_all(word, radiance.steps(surfel.radiance), radiance.width);
        let color = match &form.albedo {
            None => self.albedos.push_index(index, word),
            Some(fit) => push_all(word, fit.steps(albedo_codes(surfel)), fit.width),
        };
        [place, turn, sizes, light, color]
    }

    fn forget(&mut self) {
        self.surfels.clear();
        (self.tile_edge, self.ratio, self.area_sum) = (None, None, 0.0);
        (self.size_span, self.area_span) = (Span::default(), Span::default());
        (self.any_isotropic, self.any_triangle) = (false, false);
    }

    /// Lists the feet of triangles, or says that each surfel has its own; returns the bits of those.
    fn write_feet(&mut self, orientation: OrientationMode, out: &mut Vec<u8>) -> u32 {
        if orientation == OrientationMode::Narrow {
            return 0;
        }
        let bits_max = FOOT_BITS * self.surfels.len() as u32;
        let all = self.surfels.iter().map(|s| u32::from(s.foot));
        if !self.any_triangle {
            out.push(0);
        } else if self.feet.collect(all, 1, bits_max) {
            self.feet.write(1, out);
        } else {
            out.push(FEET_UNLISTED);
            return FOOT_BITS;
        }
        0
    }

    /// Finds all coordinates, and their widths: steps small against the surfels.
    fn fit_axes(
        &mut self,
        frame: &PositionFrame,
        orientation: OrientationMode,
        layout: &SurfelLayout,
    ) -> [Axis; 3] {
        let is_plane = orientation == OrientationMode::Plane;
        let half_edge = |area: f32| 0.5 * area.sqrt();
        let mean = half_edge(self.area_sum / self.surfels.len() as f32);
        let least = half_edge(layout.area.decode(self.area_span.least as u16));
        let tile = self.tile_edge.unwrap_or(f32::MAX);
        let rounding = self.rounding;
        let step = |steps: &StepsPerEdge| match rounding {
            LeafRounding::Compact => {
                (mean / steps.mean).min(least / steps.least).min(tile / steps.tile)
            }
            // No more bits than there are make a step of nothing.
            LeafRounding::Finest => 0.0,
        };
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        self.places.clear();
        for surfel in &self.surfels {
            let place: [f32; 3] = std::array::from_fn(|axis| frame.coordinate(axis, surfel.center));
            for axis in 0..3 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
            self.places.push(place);
        }
        let mut mixed = [step(&MIXED); 3];
        if orientation == OrientationMode::Listed && self.tile_edge.is_some() {
            self.keep_sheets_apart(mean, &mut mixed);
        }
        std::array::from_fn(|axis| {
            let (range, extent) = ((low[axis], high[axis]), 2.0 * frame.half[axis]);
            match (is_plane, axis) {
                (true, 2) => Axis::fit_heights(range, extent, step(&ACROSS)),
                (true, _) => Axis::fit(range, extent, step(&ALONG)),
                _ => Axis::fit(range, extent, mixed[axis]),
            }
        })
    }

    /// Makes the steps of coordinates so small that surfaces whose listed normals are opposed stay apart where one lies over the other: sides of a board, or
    /// two boards that nearly touch. Sides at one place, a sheet's, stay there.
    fn keep_sheets_apart(&mut self, half_edge: f32, steps: &mut [f32; 3]) {
        let reach = STEPS_BETWEEN_SHEETS * steps.iter().fold(0f32, |a, b| a.max(*b));
        for first in 0..self.orientations.values.len() {
            let normal = self.listed_normal(first);
            for second in first + 1..self.orientations.values.len() {
                if normal.dot(self.listed_normal(second)) > OPPOSED_COSINE {
                    continue;
                }
                let apart = self.least_apart(normal, [first, second], half_edge, reach);
                let most = apart / STEPS_BETWEEN_SHEETS;
                for (step, along) in steps.iter_mut().zip(normal.abs().to_array()) {
                    *step = step.min(most / along.max(f32::MIN_POSITIVE));
                }
            }
        }
    }

    fn listed_normal(&self, index: usize) -> Vec3 {
        decode_octahedral24(self.orientations.values[index] & NORMAL_BITS)
    }

    /// Least distance along a normal between surfels of two listed orientations that lie over each other, and apart; infinite if none are within `reach`.
    fn least_apart(&mut self, normal: Vec3, pair: [usize; 2], half_edge: f32, reach: f32) -> f32 {
        let Self { surfels, orientations, heights, .. } = self;
        heights.clear();
        for (surfel, index) in surfels.iter().zip(&orientations.indices) {
            if pair.contains(&usize::from(*index)) {
                heights.push((normal.dot(surfel.center), *index, surfel.center));
            }
        }
        heights.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let overlap2 = (HALF_DIAGONALS * half_edge).powi(2);
        let mut least = f32::INFINITY;
        for (place, &(height, index, center)) in heights.iter().enumerate() {
            let one_place = 4.0 * f32::EPSILON * center.abs().max_element();
            for &(above, other, over) in &heights[place + 1..] {
                let apart = above - height;
                if apart > reach {
                    break;
                }
                let across2 = (over - center).length_squared() - apart * apart;
                let one_plane = OCTAHEDRAL24_ERROR * across2.max(0.0).sqrt() + one_place;
                if index != other && apart > one_plane && across2 <= overlap2 {
                    least = least.min(apart);
                }
            }
        }
        least
    }

    fn choose_orientation(&mut self) -> OrientationMode {
        let is_wide = self.tile_edge.is_some() || self.is_finest();
        let bits_max = self.surfels.len() as u32 * if is_wide { 32 } else { 20 };
        let all = self.surfels.iter().map(|s| s.orientation);
        if self.orientations.collect(all, 4, bits_max) {
            let normal = |orientation: u32| orientation & NORMAL_BITS;
            let values = &self.orientations.values;
            let is_one = values.iter().all(|&o| normal(o) == normal(values[0]));
            let is_plane = is_one && !self.any_isotropic;
            if is_plane { OrientationMode::Plane } else { OrientationMode::Listed }
        } else if is_wide {
            OrientationMode::Wide
        } else {
            OrientationMode::Narrow
        }
    }

    fn choose_sizes(&mut self) -> (SizeMode, Below, Below) {
        let count = self.surfels.len() as u32;
        let has_tiles = self.tile_edge.is_some();
        let shift = if has_tiles { TILE_SIZE_SHIFT } else { DISK_SIZE_SHIFT };
        let radius = Below::fit(self.size_span, shift);
        let area = Below::fit(self.area_span, shift);
        let mut best = (32 * count, SizeMode::Wide);
        // A list is taken where it is shorter than this.
        let mut list_bits_max = best.0 - 1;
        let flags = self.surfels[0].sizes & SIZE_FLAGS;
        if !self.is_finest() && self.surfels.iter().all(|s| s.sizes & SIZE_FLAGS == flags) {
            let both = 48 + count * (radius.width + area.width);
            let one = 40 + count * area.width;
            let (least, largest) = self.ratio.unwrap_or_default();
            let has_ratio = !has_tiles && largest <= least * (1.0 + SIZE_RATIO_TOLERANCE);
            if both < best.0 {
                best = (both, SizeMode::Both);
            }
            if has_ratio && one < best.0 {
                best = (one, SizeMode::Area);
            }
            list_bits_max = list_bits_max.min(best.0);
        }
        let all = self.surfels.iter().map(|s| s.sizes);
        if self.sizes.collect(all, 4, list_bits_max) {
            best.1 = SizeMode::Listed;
        }
        (best.1, radius, area)
    }

    fn write_sizes(&self, size: SizeMode, radius: &Below, area: &Below, out: &mut Vec<u8>) {
        let flags = self.surfels[0].sizes & SIZE_FLAGS;
        let (isotropic, front_only) = (flags & 0xffff, flags >> 16);
        let largest = |below: &Below, flag: u32| ((below.largest | flag) as u16).to_le_bytes();
        match size {
            SizeMode::Listed => self.sizes.write(4, out),
            SizeMode::Area => {
                let (least, most) = self.ratio.unwrap_or_default();
                let ratio = u32::from(SIZE_RATIO.encode(0.5 * (least + most)).max(1));
                out.extend_from_slice(&((ratio | isotropic) as u16).to_le_bytes());
                out.extend_from_slice(&largest(area, front_only));
                out.push(area.control());
            }
            SizeMode::Both => {
                out.extend_from_slice(&largest(radius, isotropic));
                out.extend_from_slice(&largest(area, front_only));
                out.extend_from_slice(&[radius.control(), area.control()]);
            }
            SizeMode::Wide => {}
        }
    }

    fn write_radiance(&self, layout: &SurfelLayout, out: &mut Vec<u8>) -> Above {
        if layout.channels == Channels::Occlusion {
            return Above::default();
        }
        let (limits, span) = match self.rounding {
            LeafRounding::Compact if self.dims_lose_light() => {
                ((RADIANCE_SHIFT_MIN, RADIANCE_WIDTH_WIDE), CODE_MASK)
            }
            LeafRounding::Compact => ((RADIANCE_SHIFT_MIN, RADIANCE_WIDTH_MAX), RADIANCE_SPAN),
            LeafRounding::Finest => ((0, MiniFloat::BITS), RADIANCE_SPAN),
        };
        let fit = Above::fit(self.surfels.iter().map(|s| s.radiance), limits, span);
        out.extend_from_slice(&fit.control().to_le_bytes());
        if fit.floor == 0 || fit.bits() > 0 {
            for least in fit.least {
                out.extend_from_slice(&(least as u16).to_le_bytes());
            }
        }
        fit
    }

    /// Whether a surfel that shines is so much darker than another that none of its light would be kept.
    fn dims_lose_light(&self) -> bool {
        let brightest = self.surfels.iter().map(|s| s.radiance.into_iter().fold(0, u32::max));
        let lit = brightest.filter(|&code| code > 0);
        let (least, largest) = lit.fold((u32::MAX, 0), |(a, b), code| (a.min(code), b.max(code)));
        largest.saturating_sub(least) > RADIANCE_SPAN
    }

    /// What the surfels' albedos are stored as; a list where it is none.
    fn write_albedo(&mut self, layout: &SurfelLayout, out: &mut Vec<u8>) -> Option<Above> {
        if !layout.albedo {
            return Some(Above::default());
        }
        let width_max = if self.is_finest() { u8::BITS } else { ALBEDO_WIDTH_MAX };
        let fit = Above::fit(self.surfels.iter().map(albedo_codes), (0, width_max), 0);
        let all = self.surfels.iter().map(|s| s.albedo);
        if self.albedos.collect(all, 3, 48 + self.surfels.len() as u32 * fit.bits()) {
            self.albedos.write(3, out);
            return None;
        }
        out.push(0);
        out.extend_from_slice(&fit.control().to_le_bytes());
        out.extend_from_slice(&fit.least.map(|least| least as u8));
        Some(fit)
    }
}

/// `x` in steps of `1 << shift`, rounded to nearest; halves to even, so that sums keep their mean.
fn round_shift(x: u32, shift: u32) -> u32 {
    let steps = x >> shift;
    // Twice the rest in units of a step, less than a half's where the steps are even.
    let rest = 2 * (x & ((1 << shift) - 1)) + (steps & 1);
    steps + u32::from(rest > 1 << shift)
}

#[inline(always)]
fn push_all(word: Word, numbers: [u32; 3], widths: [u32; 3]) -> Word {
    numbers.into_iter().zip(widths).fold(word, |word, (number, width)| word.with(number, width))
}

fn radius_code(surfel: &Codes) -> u32 {
    surfel.sizes & CODE_MASK
}

fn area_code(surfel: &Codes) -> u32 {
    surfel.sizes >> 16 & CODE_MASK
}

fn albedo_codes(surfel: &Codes) -> [u32; 3] {
    [surfel.albedo & 255, surfel.albedo >> 8 & 255, surfel.albedo >> 16]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LeafSurfel, LeafView, SURFEL_PAGE_HEADER_BYTES, finish_surfel_page};
    use pbgi_math::{TileCode, decode_octahedral24, encode_octahedral24};

    const LAYOUT: SurfelLayout = SurfelLayout {
        channels: Channels::Rgb,
        albedo: true,
        radius: MiniFloat { exponent_max: 1 },
        area: MiniFloat { exponent_max: 4 },
        radiance_scale: 0.25,
    };

    const FRAME: Aabb = Aabb { min: Vec3::new(1.0, -2.0, 0.5), max: Vec3::new(2.0, -1.25, 1.5) };

    /// Numbers 0..1, the same in every run.
    struct Random(u32);

    impl Random {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / (1 << 24) as f32
        }

        fn normal(&mut self) -> Vec3 {
            let v = Vec3::new(self.next() - 0.5, self.next() - 0.5, self.next() - 0.5);
            (v + Vec3::splat(1e-3)).normalize()
        }

        fn place(&mut self) -> Vec3 {
            FRAME.min + FRAME.extent() * Vec3::new(self.next(), self.next(), self.next())
        }

        /// A scattered disk of a scan: 2 : 1 in size, 8 : 1 in light.
        fn disk(&mut self) -> SurfelFields {
            let area = 0.01 * (1.0 + 3.0 * self.next());
            let light = 10.0 * 8f32.powf(self.next());
            SurfelFields {
                center: self.place(),
                orientation: encode_octahedral24(self.normal()),
                size: (area * 1.3).sqrt(),
                area,
                radiance: [light, 0.5 * light, 0.1],
                albedo: [self.next(), self.next(), 0.25],
                ..SurfelFields::default()
            }
        }
    }

    fn page_of(surfels: &[SurfelFields], layout: &SurfelLayout) -> Vec<u8> {
        page_by(&mut LeafWriter::default(), surfels, layout)
    }

    fn page_by(
        writer: &mut LeafWriter,
        surfels: &[SurfelFields],
        layout: &SurfelLayout,
    ) -> Vec<u8> {
        let mut page = vec![0; SURFEL_PAGE_HEADER_BYTES];
        surfels.iter().for_each(|s| writer.push(s, layout));
        writer.finish(&FRAME, layout, &mut page);
        finish_surfel_page(&mut page, surfels.len() as u32);
        page
    }

    fn store(surfels: &[SurfelFields], layout: &SurfelLayout) -> Vec<LeafSurfel> {
        read_page(&page_of(surfels, layout), surfels, layout)
    }

    fn read_page(page: &[u8], surfels: &[SurfelFields], layout: &SurfelLayout) -> Vec<LeafSurfel> {
        let place = (SURFEL_PAGE_HEADER_BYTES as u32, surfels.len() as u32);
        let leaf = LeafView::new(page, place, &FRAME, layout).unwrap();
        (0..leaf.count())
            .map(|i| {
                assert_eq!(leaf.surfel(i).center, leaf.center(i));
                leaf.surfel(i)
            })
            .collect()
    }

    /// Bits per surfel.
    fn cost(surfels: &[SurfelFields]) -> f32 {
        let fixed = crate::SURFEL_PAGE_FIXED_BYTES;
        8.0 * (page_of(surfels, &LAYOUT).len() - fixed) as f32 / surfels.len() as f32
    }

    /// A wall of equal tiles, slanted.
    fn wall() -> Vec<SurfelFields> {
        let orientation = encode_octahedral24(Vec3::new(0.6, 0.0, 0.8));
        let normal = decode_octahedral24(orientation);
        let [long, short] = TileCode(128).edges(normal);
        (0..32)
            .map(|i| SurfelFields {
                center: FRAME.center()
                    + long * (0.1 * ((i % 8) as f32 - 3.5))
                    + short * (0.05 * ((i / 8) as f32 - 1.5)),
                orientation: orientation | 128 << 24,
                size: 0.05,
                area: 0.1 * 0.05,
                radiance: [3.0, 2.0, 1.0],
                albedo: [0.5, 0.25, 0.125],
                ..SurfelFields::default()
            })
            .collect()
    }

    #[test]
    fn scattered_disks_come_back() {
        let mut random = Random(1);
        for count in [1, 2, 16, 32, 255] {
            let surfels: Vec<_> = (0..count).map(|_| random.disk()).collect();
            for (surfel, back) in surfels.iter().zip(store(&surfels, &LAYOUT)) {
                // A 64th of the half edge of the mean area along each axis, at most.
                let step = (FRAME.extent() * 0.0009).max(Vec3::splat(0.5 * 0.2 / 128.0));
                assert!((back.center - surfel.center).abs().cmple(step).all());
                let normal = decode_octahedral24(surfel.orientation);
                assert!(back.normal.cross(normal).length() < 0.25f32.to_radians());
                assert!((back.area / surfel.area - 1.0).abs() < 0.018);
                assert!((back.radius / surfel.size - 1.0).abs() < 0.018);
                for channel in 0..3 {
                    let error = back.radiance[channel] / surfel.radiance[channel] - 1.0;
                    assert!(error.abs() < 0.018, "{error}");
                    let error = back.albedo[channel].sqrt() - surfel.albedo[channel].sqrt();
                    assert!(error.abs() <= 2.51 / 255.0);
                }
                assert!(!back.isotropic && !back.front_only && !back.tile.is_known());
            }
        }
    }

    /// Of scattered disks as along the axes of a box, of a wall as along its own, where heights are hardly rounded at all.
    #[test]
    fn centers_are_no_farther_off_than_their_leaf_says() {
        let mut random = Random(5);
        let disks: Vec<_> = (0..255).map(|_| random.disk()).collect();
        for (surfels, along_normal) in [(disks, 0.0..1.0), (wall(), 0.0..2e-5)] {
            let page = page_of(&surfels, &LAYOUT);
            let place = (SURFEL_PAGE_HEADER_BYTES as u32, surfels.len() as u32);
            let leaf = LeafView::new(&page, place, &FRAME, &LAYOUT).unwrap();
            let normal = decode_octahedral24(surfels[0].orientation);
            assert!(along_normal.contains(&leaf.position_error(normal)));
            for along in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(0.6, 0.0, 0.8), normal] {
                let bound = leaf.position_error(along);
                let off = |(i, surfel): (u32, &SurfelFields)| {
                    (leaf.center(i) - surfel.center).dot(along).abs()
                };
                let worst = (0..).zip(&surfels).map(off).fold(0.0, f32::max);
                assert!(worst <= bound + 4.0 * f32::EPSILON, "{along}: {worst} of {bound}");
            }
            let bound = leaf.position_error(Vec3::X);
            assert!(bound > 1e-4 && bound < 2e-3, "{bound}");
        }
    }

    #[test]
    fn finest_leaves_round_by_the_last_bits_of_their_codes() {
        let mut random = Random(2);
        let disks: Vec<_> = (0..32).map(|_| random.disk()).collect();
        let mut writer = LeafWriter::new(LeafRounding::Finest);
        for surfels in [disks, wall()] {
            let page = page_by(&mut writer, &surfels, &LAYOUT);
            for (surfel, back) in surfels.iter().zip(read_page(&page, &surfels, &LAYOUT)) {
                // Coordinates of 15 bits.
                let step = FRAME.extent().max_element() / f32::from(1u16 << 15);
                assert!((back.center - surfel.center).length() < 2.0 * step);
                assert_eq!(back.normal, decode_octahedral24(surfel.orientation));
                assert!((back.area / surfel.area - 1.0).abs() < 1e-3);
                for channel in 0..3 {
                    assert!((back.radiance[channel] / surfel.radiance[channel] - 1.0).abs() < 1e-3);
                    let error = back.albedo[channel].sqrt() - surfel.albedo[channel].sqrt();
                    assert!(error.abs() <= 0.51 / 255.0);
                }
            }
        }
    }

    #[test]
    fn walls_of_tiles_are_exact_and_meet() {
        let surfels = wall();
        let stored = store(&surfels, &LAYOUT);
        for (surfel, back) in surfels.iter().zip(&stored) {
            // All alike: the codes' own rounding, 2⁻¹⁰, and the same for all.
            assert!((back.area / surfel.area - 1.0).abs() < 1e-3);
            assert!((back.half_long / surfel.size - 1.0).abs() < 1e-3);
            assert_eq!((back.area, back.radiance), (stored[0].area, stored[0].radiance));
            assert_eq!(back.normal, decode_octahedral24(surfel.orientation));
            assert_eq!(back.tile, TileCode(128));
            // In one plane, and along it no farther off than rectangles are drawn too long: two in a hundred.
            let off = back.center - surfel.center;
            let [long, short] = back.tile.edges(back.normal);
            assert!(off.dot(back.normal).abs() < 2e-5, "{off}");
            let [half_long, half_short] = back.half_edges();
            assert!(off.dot(long).abs() < 0.01 * half_long);
            assert!(off.dot(short).abs() < 0.01 * half_short);
        }
        // Two coordinates of 11 bits; what is shared takes the rest.
        assert!(cost(&surfels) < 32.0, "{}", cost(&surfels));
    }

    /// Two sides of a board of some hundredths of a tile are told apart, those of a sheet stay at one place and cost nothing.
    #[test]
    fn sides_of_thin_boards_are_apart() {
        const SIZE: f32 = 0.4;
        let normal = decode_octahedral24(wall()[0].orientation);
        let other = encode_octahedral24(-normal);
        assert_eq!(decode_octahedral24(other), -normal);
        let board = |thickness: f32| {
            let mut surfels = wall();
            surfels.truncate(8);
            for index in 0..8 {
                surfels[index].size = SIZE;
                surfels[index].area = 2.0 * SIZE * SIZE;
                let mut back = surfels[index];
                back.center -= normal * thickness;
                back.orientation = other | back.orientation & !NORMAL_BITS;
                surfels.push(back);
            }
            surfels
        };
        let mut sheet_bits = 0.0;
        for thickness in [0.0, 0.1, 0.01, 1e-3] {
            let thickness = thickness * SIZE;
            let surfels = board(thickness);
            let stored = store(&surfels, &LAYOUT);
            for (front, back) in stored[..8].iter().zip(&stored[8..]) {
                let apart = (front.center - back.center).dot(normal);
                assert!((apart - thickness).abs() <= 0.5 * thickness, "{apart} of {thickness}");
            }
            let bits = cost(&surfels);
            match thickness {
                0.0 => sheet_bits = bits,
                _ => assert!(bits < sheet_bits + 30.0, "{bits} of {sheet_bits}"),
            }
        }
    }

    #[test]
    fn mixed_leaves_keep_flags_tiles_and_sizes() {
        let mut surfels = wall();
        surfels.truncate(9);
        surfels[1].front_only = true;
        surfels[2].isotropic = true;
        surfels[3].orientation &= 0xff_ffff;
        surfels[4].size = 0.9;
        surfels[5].area = 1e-9;
        surfels[6].orientation = encode_octahedral24(Vec3::X) | 1 << 24;
        surfels[7].radiance = [0.0, 0.0, 7.0];
        surfels[8].radiance = [1e4, 1e-4, 1.0];
        surfels[2].foot = FootCode(9);
        surfels[3].foot = FootCode(9);
        surfels[7].foot = FootCode(1);
        surfels[8].foot = FootCode(127);
        let stored = store(&surfels, &LAYOUT);
        for (i, (surfel, back)) in surfels.iter().zip(&stored).enumerate() {
            assert_eq!((back.isotropic, back.front_only), (surfel.isotropic, surfel.front_only));
            let tile = if back.isotropic { 0 } else { surfel.orientation >> 24 };
            assert_eq!(back.tile, TileCode(tile as u8), "{i}");
            assert_eq!(back.foot, if tile == 0 { FootCode::NONE } else { surfel.foot }, "{i}");
            assert!((back.area / surfel.area - 1.0).abs() < 1e-3);
            let size = if tile == 0 { back.radius } else { back.half_long };
            assert!((size / surfel.size - 1.0).abs() < 1e-3, "{i}");
            // 16 octaves in 8 bits: a sixteenth of an octave; less than the brightest over 65536 is none.
            for (found, expected) in back.radiance.into_iter().zip(surfel.radiance) {
                assert!((found - expected).abs() <= 0.036 * expected.max(1e4 / 65536.0));
            }
        }
        assert_eq!(stored[7].radiance[..2], [0.0; 2]);
    }

    /// A lamp 10¹² times brighter than its neighbors takes nothing from them, and is rounded as little.
    #[test]
    fn bright_surfels_leave_their_neighbors_light() {
        let layout = SurfelLayout { radiance_scale: 2f32.powi(24), ..LAYOUT };
        for bright in [1e6f32, 1e12] {
            let mut surfels = wall();
            surfels.truncate(9);
            surfels[4].radiance = [bright, 0.9 * bright, 0.0];
            surfels[5].radiance = [0.0; 3];
            let stored = store(&surfels, &layout);
            for (surfel, back) in surfels.iter().zip(&stored) {
                for (found, expected) in back.radiance.into_iter().zip(surfel.radiance) {
                    assert!((found - expected).abs() <= 0.018 * expected, "{found} {expected}");
                }
            }
        }
    }

    #[test]
    fn triangles_keep_their_corners() {
        let normal = decode_octahedral24(encode_octahedral24(Vec3::new(0.6, 0.0, 0.8)));
        // One shape beside rectangles, two, and more than are worth a list.
        for kinds in [1u8, 2, 30] {
            let mut surfels = wall();
            for (i, surfel) in surfels.iter_mut().enumerate().skip(2) {
                surfel.foot = FootCode(1 + (i as u8 % kinds) * 4);
                surfel.orientation = encode_octahedral24(normal) | 33 << 24;
            }
            for (surfel, back) in surfels.iter().zip(store(&surfels, &LAYOUT)) {
                assert_eq!(back.foot, surfel.foot);
                assert_eq!(
                    (back.is_triangle(), back.is_rectangle()),
                    match surfel.foot {
                        FootCode::NONE => (false, true),
                        _ => (true, false),
                    }
                );
                if back.is_triangle() {
                    let [a, b, c] = back.corners();
                    assert!(((b - a).length() / (2.0 * surfel.size) - 1.0).abs() < 1e-3);
                    let doubled = (b - a).cross(c - a);
                    assert!((doubled.dot(normal) / (2.0 * surfel.area) - 1.0).abs() < 2e-3);
                    let foot = (c - a).dot(b - a) / (b - a).length_squared();
                    assert!((foot - surfel.foot.share()).abs() < 1e-3);
                    let reach = [a, b, c].map(Vec3::length).into_iter().fold(0.0, f32::max);
                    assert!((reach / back.radius - 1.0).abs() < 1e-3);
                }
            }
        }
    }

    #[test]
    fn rounding_does_not_darken() {
        let mut random = Random(7);
        let (mut area, mut flux, mut albedo) = ([0f64; 2], [0f64; 2], [0f64; 2]);
        for _ in 0..400 {
            let surfels: Vec<_> = (0..16).map(|_| random.disk()).collect();
            for (surfel, back) in surfels.iter().zip(store(&surfels, &LAYOUT)) {
                for (sum, x) in [
                    (&mut area, [surfel.area, back.area]),
                    (&mut flux, [surfel.area * surfel.radiance[0], back.area * back.radiance[0]]),
                    (&mut albedo, [surfel.albedo[0], back.albedo[0]]),
                ] {
                    sum[0] += f64::from(x[0]);
                    sum[1] += f64::from(x[1]);
                }
            }
        }
        // Random errors of at most 1.8 % and 2 % for 6400 surfels: 3 σ is below 0.07 %.
        for [before, after] in [area, flux, albedo] {
            assert!((after / before - 1.0).abs() < 7e-4, "{}", after / before);
        }
    }

    #[test]
    fn what_a_file_does_not_store_costs_nothing() {
        let surfels = wall();
        let plain = SurfelLayout { channels: Channels::Occlusion, albedo: false, ..LAYOUT };
        let back = store(&surfels, &plain);
        assert_eq!((back[0].radiance, back[0].albedo), ([0.0; 3], [0.0; 3]));
        assert!(page_of(&surfels, &plain).len() < page_of(&surfels, &LAYOUT).len());
        let dark: Vec<_> =
            surfels.iter().map(|s| SurfelFields { radiance: [0.0; 3], ..*s }).collect();
        assert_eq!(store(&dark, &LAYOUT)[3].radiance, [0.0; 3]);
        assert_eq!(page_of(&dark, &LAYOUT).len() + 6, page_of(&surfels, &LAYOUT).len());
    }

    #[test]
    fn flat_boxes_and_one_place_are_exact() {
        let flat = Aabb { min: Vec3::new(1.0, 2.0, 3.0), max: Vec3::new(2.0, 2.0, 4.0) };
        let mut surfel = wall()[0];
        (surfel.center, surfel.orientation) = (flat.center(), encode_octahedral24(Vec3::Y));
        let mut page = vec![0; SURFEL_PAGE_HEADER_BYTES];
        let mut writer = LeafWriter::default();
        (0..200).for_each(|_| writer.push(&surfel, &LAYOUT));
        writer.finish(&flat, &LAYOUT, &mut page);
        finish_surfel_page(&mut page, 200);
        let leaf = LeafView::new(&page, (16, 200), &flat, &LAYOUT).unwrap();
        assert_eq!(leaf.center(0), leaf.center(199));
        assert_eq!(leaf.center(0).y, 2.0);
        assert!((leaf.center(0) - surfel.center).abs().max_element() < 1e-5);
        assert!(page.len() < 100, "all is shared: {}", page.len());
    }

    #[test]
    fn leaves_outside_their_page_are_refused() {
        let mut random = Random(3);
        let disks: Vec<_> = (0..20).map(|_| random.disk()).collect();
        for surfels in [wall(), disks] {
            let page = page_of(&surfels, &LAYOUT);
            let count = surfels.len() as u32;
            let view = |page: &[u8], place| LeafView::new(page, place, &FRAME, &LAYOUT).is_ok();
            assert!(view(&page, (16, count)));
            for end in 0..page.len() {
                assert!(!view(&page[..end], (16, count)), "{end}");
            }
            for place in [(16, 0), (0, count), (page.len() as u32, 1), (u32::MAX, 255)] {
                assert!(!view(&page, place), "{place:?}");
            }
        }
    }

    #[test]
    fn no_bytes_make_the_reader_panic() {
        let mut random = Random(5);
        let (mut accepted, mut page) = (0, vec![0u8; 4096]);
        let rounds = if cfg!(miri) { 40 } else { 20_000 };
        for round in 0..rounds {
            let start = 16 + (round % 4000) as usize;
            page.iter_mut().skip(start).take(96).for_each(|b| *b = (random.next() * 256.0) as u8);
            let layout = SurfelLayout {
                channels: if round % 3 == 0 { Channels::Occlusion } else { Channels::Rgb },
                albedo: round % 2 == 0,
                ..LAYOUT
            };
            let place = (start as u32, 1 + round % 255);
            if let Ok(leaf) = LeafView::new(&page, place, &FRAME, &layout) {
                accepted += 1;
                for index in 0..leaf.count() {
                    let surfel = leaf.surfel(index);
                    assert!(surfel.center.is_finite() && surfel.area >= 0.0);
                }
            }
        }
        assert!(accepted * 20 > rounds, "{accepted}");
    }
}
