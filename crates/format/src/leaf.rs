//! Leaves: the surfels of one node, stored relative to what they have in common.

use crate::bits::{SLACK_BYTES, index_bits, read_bits};
use crate::surfel::{RADIANCE, SIZE_RATIO, decode_albedo};
use crate::{Channels, FormatError, LeafSurfel, SurfelLayout, read_u16, read_u32};
use pbgi_math::{
    Aabb, FootCode, Frame, TileCode, Vec3, decode_octahedral20, decode_octahedral24,
    triangle_radius,
};

/// Codes of MiniFloat have these bits; the one above is a flag.
pub(crate) const CODE_MASK: u32 = 0x7fff;

/// Bits of a leaf's width fields.
pub(crate) const WIDTH_BITS: u32 = 4;

/// How normals and tiles of a leaf are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OrientationMode {
    /// Index into a list of 32-bit orientations.
    Listed = 0,
    /// Normals in 20 bits, no tiles.
    Narrow = 1,
    /// 32 bits.
    Wide = 2,
    /// As `Listed`, and all normals are one: positions refer to its plane.
    Plane = 3,
}

/// Where coordinates of a leaf are counted from, and along what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PositionFrame {
    pub origin: Vec3,
    /// Unit vectors at right angles.
    pub axes: [Vec3; 3],
    /// The leaf's box reaches so far from the origin along each of them.
    pub half: [f32; 3],
}

impl PositionFrame {
    /// The axes of the world.
    #[inline(always)]
    pub fn of_box(frame: &Aabb) -> Self {
        let half = frame.extent() * 0.5;
        Self { origin: frame.min + half, axes: [Vec3::X, Vec3::Y, Vec3::Z], half: half.to_array() }
    }

    /// Two axes in the plane with this orientation, the last along its normal.
    #[inline(always)]
    pub fn of_plane(frame: &Aabb, orientation: u32) -> Self {
        let world = Self::of_box(frame);
        let plane = Frame::from_normal(decode_octahedral24(orientation));
        let axes = [plane.tangent, plane.bitangent, plane.normal];
        let half = axes.map(|axis| axis.abs().dot(Vec3::from_array(world.half)));
        Self { axes, half, ..world }
    }

    /// Coordinate of a position, 0 to twice the half extent.
    #[inline(always)]
    pub fn coordinate(&self, axis: usize, position: Vec3) -> f32 {
        self.axes[axis].dot(position - self.origin) + self.half[axis]
    }
}

/// Stands for the length of a list of feet where each surfel has its own code.
pub(crate) const FEET_UNLISTED: u8 = u8::MAX;

/// Bits of a [`FootCode`].
pub(crate) const FOOT_BITS: u32 = 7;

/// How radii and areas of a leaf are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SizeMode {
    /// Index into a list of pairs of codes.
    Listed = 0,
    /// Areas below the largest; the ratio of radius and area is shared.
    Area = 1,
    /// Radii and areas below the largest.
    Both = 2,
    /// Pairs of codes.
    Wide = 3,
}

/// A list of the distinct values of a leaf, or values of their own.
#[derive(Clone, Copy, Debug, Default)]
struct List {
    /// Place of the first value in the page.
    start: usize,
    count: u32,
}

impl List {
    /// Place of value `index`, of `stride` bytes each; an index beyond the list means its last value.
    #[inline(always)]
    fn place(&self, index: u32, stride: usize) -> usize {
        self.start + index.min(self.count - 1) as usize * stride
    }
}

/// A number below a largest one, in steps of a power of two.
#[derive(Clone, Copy, Debug, Default)]
struct Below {
    largest: u32,
    shift: u32,
    width: u32,
}

impl Below {
    #[inline(always)]
    fn code(&self, steps: u32) -> u32 {
        (self.largest & CODE_MASK).saturating_sub(steps << self.shift)
    }
}

/// Three numbers above their smallest ones, in steps of a power of two.
#[derive(Clone, Copy, Debug, Default)]
struct Above {
    least: [u32; 3],
    shift: u32,
    width: [u32; 3],
    /// Zero steps mean 0, one step the least.
    has_zero: bool,
}

impl Above {
    #[inline(always)]
    fn bits(&self) -> u32 {
        self.width[0] + self.width[1] + self.width[2]
    }

    #[inline(always)]
    fn from_control(control: u32) -> Self {
        let width = |i: u32| (control >> (WIDTH_BITS * i)) & 15;
        Self {
            least: [0; 3],
            shift: (control >> 12) & 7,
            width: [width(0), width(1), width(2)],
            has_zero: control >> 15 != 0,
        }
    }
}

/// A leaf in a verified page.
#[derive(Clone, Copy, Debug)]
pub struct LeafView<'a> {
    page: &'a [u8],
    layout: SurfelLayout,
    count: u32,
    /// First bit of the first surfel, and bits per surfel.
    records: usize,
    stride: u32,
    position_width: [u32; 3],
    /// Position of code 0, and what a step of each code adds.
    position_start: Vec3,
    position_step: [Vec3; 3],
    orientation: OrientationMode,
    orientations: List,
    orientation_width: u32,
    /// Empty where no surfel is a triangle, and where each has its own code.
    feet: List,
    foot_width: u32,
    size: SizeMode,
    sizes: List,
    size_width: u32,
    radius: Below,
    area: Below,
    ratio: f32,
    radiance: Above,
    albedos: List,
    albedo: Above,
}

/// How much larger than the largest radius one that is reckoned from rounded sizes may be.
const RADIUS_ROUNDING: f32 = 2.0;

/// What is stored of a surfel between its position and its colors.
struct Shape {
    /// First bit of its colors.
    end: usize,
    normal: Vec3,
    tile: TileCode,
    foot: FootCode,
    radius: f32,
    half_long: f32,
    area: f32,
    isotropic: bool,
    front_only: bool,
}

/// Reads a leaf's fields in order; past the end of the page all bytes are 0, and `end` says so.
struct Fields<'a> {
    page: &'a [u8],
    at: usize,
    end: usize,
}

impl Fields<'_> {
    #[inline(always)]
    fn skip(&mut self, bytes: usize) -> usize {
        let start = self.at;
        self.at += bytes;
        start
    }

    #[inline(always)]
    fn u8(&mut self) -> u32 {
        let at = self.skip(1);
        if self.at <= self.end { u32::from(self.page[at]) } else { 0 }
    }

    #[inline(always)]
    fn u16(&mut self) -> u32 {
        let at = self.skip(2);
        if self.at <= self.end { u32::from(read_u16(self.page, at)) } else { 0 }
    }

    /// Without moving on.
    #[inline(always)]
    fn u32_at(&self, at: usize) -> u32 {
        if at + 4 <= self.end { read_u32(self.page, at) } else { 0 }
    }

    #[inline(always)]
    fn list(&mut self, count: u32, stride: usize) -> List {
        List { start: self.skip(count as usize * stride), count }
    }
}

impl<'a> LeafView<'a> {
    /// Views the leaf of `count` surfels at byte `offset` of a surfel page; `frame` is the box its positions refer to.
    ///
    /// # Errors
    ///
    /// If the leaf is not wholly inside the page.
    #[inline(always)]
    pub fn new(
        page: &'a [u8],
        (offset, count): (u32, u32),
        frame: &Aabb,
        layout: &SurfelLayout,
    ) -> Result<Self, FormatError> {
        let mut fields =
            Fields { page, at: offset as usize, end: page.len().saturating_sub(SLACK_BYTES) };
        let inside = offset as usize >= crate::SURFEL_PAGE_HEADER_BYTES;
        let leaf = Self::read_fields(&mut fields, count, frame, layout);
        let end = fields.at + (count as usize * leaf.stride as usize).div_ceil(8);
        let is_listed =
            matches!(leaf.orientation, OrientationMode::Listed | OrientationMode::Plane);
        let sound = (!is_listed || leaf.orientations.count > 0)
            && (leaf.size != SizeMode::Listed || leaf.sizes.count > 0);
        if !inside || count == 0 || end > fields.end || !sound {
            return Err(FormatError::new("leaf: surfels", end, "a leaf inside its page"));
        }
        Ok(leaf)
    }

    #[inline(always)]
    fn read_fields(
        fields: &mut Fields<'a>,
        count: u32,
        frame: &Aabb,
        layout: &SurfelLayout,
    ) -> Self {
        let control = fields.u16();
        let mut leaf = Self {
            page: fields.page,
            layout: *layout,
            count,
            records: 0,
            stride: 0,
            position_width: [control & 15, (control >> 4) & 15, (control >> 8) & 15],
            position_start: Vec3::ZERO,
            position_step: [Vec3::ZERO; 3],
            orientation: match (control >> 12) & 3 {
                0 => OrientationMode::Listed,
                1 => OrientationMode::Narrow,
                2 => OrientationMode::Wide,
                _ => OrientationMode::Plane,
            },
            orientations: List::default(),
            orientation_width: 0,
            feet: List::default(),
            foot_width: 0,
            size: match control >> 14 {
                0 => SizeMode::Listed,
                1 => SizeMode::Area,
                2 => SizeMode::Both,
                _ => SizeMode::Wide,
            },
            sizes: List::default(),
            size_width: 0,
            radius: Below::default(),
            area: Below::default(),
            ratio: 0.0,
            radiance: Above::default(),
            albedos: List::default(),
            albedo: Above::default(),
        };
        leaf.read_orientations(fields);
        leaf.read_positions(fields, frame);
        leaf.read_sizes(fields);
        leaf.read_colors(fields);
        leaf.records = fields.at * 8;
        leaf.stride = leaf.position_width.iter().sum::<u32>()
            + leaf.orientation_width
            + leaf.foot_width
            + leaf.size_width
            + leaf.radiance.bits()
            + leaf.albedo.bits();
        leaf
    }

    #[inline(always)]
    fn read_positions(&mut self, fields: &mut Fields<'a>, frame: &Aabb) {
        let is_plane = self.orientation == OrientationMode::Plane;
        let frame = match is_plane {
            true => PositionFrame::of_plane(frame, fields.u32_at(self.orientations.start)),
            false => PositionFrame::of_box(frame),
        };
        self.position_start = frame.origin;
        for axis in 0..3 {
            let width = self.position_width[axis];
            // Steps of a whole extent, those of a height, or one place for all.
            let (mut least, mut bits, mut shift) = (0, width, 0);
            if width == 0 || is_plane && axis == 2 {
                (least, bits) = (fields.u16(), 16);
                shift = if width == 0 { 0 } else { fields.u8() & 15 };
            }
            let unit = frame.half[axis] * (2.0 / (1u32 << bits) as f32);
            let step = unit * (1u32 << shift) as f32;
            let start = unit * least as f32 + 0.5 * step - frame.half[axis];
            self.position_start += frame.axes[axis] * start;
            self.position_step[axis] = frame.axes[axis] * step;
        }
    }

    #[inline(always)]
    fn read_orientations(&mut self, fields: &mut Fields<'a>) {
        self.orientation_width = match self.orientation {
            OrientationMode::Listed | OrientationMode::Plane => {
                let count = fields.u8();
                self.orientations = fields.list(count, 4);
                index_bits(count as usize)
            }
            OrientationMode::Narrow => 20,
            OrientationMode::Wide => 32,
        };
        if self.orientation == OrientationMode::Narrow {
            return;
        }
        let count = fields.u8();
        if count == u32::from(FEET_UNLISTED) {
            self.foot_width = FOOT_BITS;
        } else {
            self.feet = fields.list(count, 1);
            self.foot_width = index_bits(count as usize);
        }
    }

    #[inline(always)]
    fn foot(&self, number: u32) -> FootCode {
        let code = match self.feet.count {
            0 => number as u8,
            _ => self.page[self.feet.place(number, 1)],
        };
        FootCode(code & FootCode::MAX)
    }

    #[inline(always)]
    fn read_sizes(&mut self, fields: &mut Fields<'a>) {
        let below = |largest: u32, control: u32| Below {
            largest,
            shift: control >> 4,
            width: control & 15,
        };
        match self.size {
            SizeMode::Listed => {
                let count = fields.u8();
                self.sizes = fields.list(count, 4);
                self.size_width = index_bits(count as usize);
            }
            SizeMode::Area => {
                let (ratio, area, control) = (fields.u16(), fields.u16(), fields.u8());
                self.ratio = SIZE_RATIO.decode(ratio as u16);
                // The isotropic flag stands beside the ratio.
                self.radius.largest = ratio & !CODE_MASK;
                self.area = below(area, control);
                self.size_width = self.area.width;
            }
            SizeMode::Both => {
                let (radius, area) = (fields.u16(), fields.u16());
                self.radius = below(radius, fields.u8());
                self.area = below(area, fields.u8());
                self.size_width = self.radius.width + self.area.width;
            }
            SizeMode::Wide => self.size_width = 32,
        }
    }

    #[inline(always)]
    fn read_colors(&mut self, fields: &mut Fields<'a>) {
        if self.layout.channels == Channels::Rgb {
            self.radiance = Above::from_control(fields.u16());
            if !(self.radiance.has_zero && self.radiance.bits() == 0) {
                self.radiance.least = [fields.u16(), fields.u16(), fields.u16()];
            }
        }
        if self.layout.albedo {
            let count = fields.u8();
            if count == 0 {
                self.albedo = Above::from_control(fields.u16());
                self.albedo.least = [fields.u8(), fields.u8(), fields.u8()];
            } else {
                self.albedos = fields.list(count, 3);
                self.albedo.width = [index_bits(count as usize), 0, 0];
            }
        }
    }

    /// Surfels.
    #[must_use]
    #[inline(always)]
    pub fn count(&self) -> u32 {
        self.count
    }

    #[inline(always)]
    fn start(&self, index: u32) -> usize {
        debug_assert!(index < self.count, "a surfel of the leaf");
        self.records + index as usize * self.stride as usize
    }

    /// Center of surfel `index`.
    ///
    /// # Panics
    ///
    /// May panic where the leaf has no surfel `index`.
    #[must_use]
    #[inline(always)]
    pub fn center(&self, index: u32) -> Vec3 {
        let mut at = self.start(index);
        let mut center = self.position_start;
        for axis in 0..3 {
            let width = self.position_width[axis];
            center += self.position_step[axis] * read_bits(self.page, at, width) as f32;
            at += width as usize;
        }
        center
    }

    /// How far codes of positions may move a center along a unit vector.
    #[must_use]
    #[inline(always)]
    pub fn position_error(&self, along: Vec3) -> f32 {
        self.position_step.iter().map(|step| 0.5 * step.dot(along).abs()).sum()
    }

    /// Orientation and size of surfel `index`.
    #[inline(always)]
    fn shape(&self, index: u32) -> Shape {
        let mut at = self.start(index) + self.position_width.iter().sum::<u32>() as usize;
        let mut take = |width: u32| {
            let number = read_bits(self.page, at, width);
            at += width as usize;
            number
        };
        let (normal, tile) = self.orientation(take(self.orientation_width));
        let foot = self.foot(if self.foot_width > 0 { take(self.foot_width) } else { 0 });
        let sizes = match self.size {
            SizeMode::Both => [take(self.radius.width), take(self.area.width)],
            _ => [take(self.size_width), 0],
        };
        let (radius_code, area_code) = self.size_codes(sizes);
        let isotropic = radius_code & !CODE_MASK != 0;
        let area = self.layout.area.decode(area_code as u16);
        let size = match self.size {
            SizeMode::Area => (self.ratio * area).sqrt(),
            _ => self.layout.radius.decode(radius_code as u16),
        };
        let tile = if isotropic { TileCode::NONE } else { tile };
        let foot = if tile.is_known() { foot } else { FootCode::NONE };
        let (mut radius, mut half_long) = (size, 0.0);
        if foot.is_known() {
            (radius, half_long) = (triangle_radius(2.0 * size, area, foot.share()), size);
        } else if tile.is_known() {
            let half_short = 0.25 * area / size;
            (radius, half_long) = ((size * size + half_short * half_short).sqrt(), size);
        }
        // Only damage makes a rectangle or triangle larger than all of the file's radii: it is a disk then, and finite.
        let radius_max = self.layout.radius.limit() * RADIUS_ROUNDING;
        let is_sound = radius <= radius_max;
        let (tile, foot) = if is_sound { (tile, foot) } else { (TileCode::NONE, FootCode::NONE) };
        (radius, half_long) = if is_sound { (radius, half_long) } else { (radius_max, 0.0) };
        let front_only = area_code & !CODE_MASK != 0;
        Shape { end: at, normal, tile, foot, radius, half_long, area, isotropic, front_only }
    }

    /// Radius of the covering disk and true area of surfel `index`.
    ///
    /// # Panics
    ///
    /// May panic where the leaf has no surfel `index`.
    #[must_use]
    #[inline(always)]
    pub fn size(&self, index: u32) -> (f32, f32) {
        let Shape { radius, area, .. } = self.shape(index);
        (radius, area)
    }

    /// Surfel `index`, decoded.
    ///
    /// # Panics
    ///
    /// May panic where the leaf has no surfel `index`.
    #[must_use]
    #[inline(always)]
    pub fn surfel(&self, index: u32) -> LeafSurfel {
        let shape = self.shape(index);
        let mut at = shape.end;
        let mut take = |width: u32| {
            let number = read_bits(self.page, at, width);
            at += width as usize;
            number
        };
        let radiance = self.radiance.width.map(&mut take);
        let albedo = self.albedo.width.map(&mut take);
        LeafSurfel {
            center: self.center(index),
            normal: shape.normal,
            radius: shape.radius,
            area: shape.area,
            tile: shape.tile,
            foot: shape.foot,
            half_long: shape.half_long,
            radiance: self.radiance(radiance),
            albedo: self.albedo(albedo),
            isotropic: shape.isotropic,
            front_only: shape.front_only,
        }
    }

    #[inline(always)]
    fn orientation(&self, number: u32) -> (Vec3, TileCode) {
        let code = match self.orientation {
            OrientationMode::Narrow => return (decode_octahedral20(number), TileCode::NONE),
            OrientationMode::Wide => number,
            OrientationMode::Listed | OrientationMode::Plane => {
                read_u32(self.page, self.orientations.place(number, 4))
            }
        };
        (decode_octahedral24(code), TileCode((code >> 24) as u8))
    }

    /// Codes of radius and area with their flags; of a shared ratio the flag alone.
    #[inline(always)]
    fn size_codes(&self, numbers: [u32; 2]) -> (u32, u32) {
        let flag = |below: &Below| below.largest & !CODE_MASK;
        let pair = match self.size {
            SizeMode::Area => {
                return (flag(&self.radius), flag(&self.area) | self.area.code(numbers[0]));
            }
            SizeMode::Both => {
                return (
                    flag(&self.radius) | self.radius.code(numbers[0]),
                    flag(&self.area) | self.area.code(numbers[1]),
                );
            }
            SizeMode::Listed => read_u32(self.page, self.sizes.place(numbers[0], 4)),
            SizeMode::Wide => numbers[0],
        };
        (pair & 0xffff, pair >> 16)
    }

    #[inline(always)]
    fn radiance(&self, steps: [u32; 3]) -> [f32; 3] {
        let Above { least, shift, has_zero, .. } = self.radiance;
        let zero = u32::from(has_zero);
        std::array::from_fn(|channel| {
            let steps = steps[channel];
            let code = least[channel] + (steps.saturating_sub(zero) << shift);
            let code = if steps < zero { 0 } else { code.min(CODE_MASK) };
            RADIANCE.decode(code as u16) * self.layout.radiance_scale
        })
    }

    #[inline(always)]
    fn albedo(&self, steps: [u32; 3]) -> [f32; 3] {
        if !self.layout.albedo {
            return [0.0; 3];
        }
        if self.albedos.count > 0 {
            let at = self.albedos.place(steps[0], 3);
            return std::array::from_fn(|c| decode_albedo(u32::from(self.page[at + c])));
        }
        let Above { least, shift, .. } = self.albedo;
        std::array::from_fn(|c| decode_albedo(least[c] + (steps[c] << shift)))
    }
}
