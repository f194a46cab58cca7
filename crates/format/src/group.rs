//! Groups: an inner node with what is stored of its children.

use crate::{
    Channels, FormatError, LOBES_MAX, Lobe, MiniFloat, read_f32, read_u16, read_u32, read_u64,
};
use pbgi_math::{Aabb, Stencil, Vec3};

/// Most children of a group: the octants of its cell.
pub const CHILDREN_MAX: usize = 8;

/// Bytes of a group before its links.
pub const GROUP_FIXED_BYTES: usize = 41;

const EXTERNAL: u32 = 1 << 31;
const LEAF_COUNT_BITS: u32 = 8;

/// Where the contents of a child lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChildLink {
    /// A group in the same page, at this byte offset.
    Group(u32),
    /// A group in another page: index into the page's external links.
    External(u32),
    /// A leaf in the page's surfel page.
    Leaf {
        /// Its first byte.
        offset: u32,
        /// Surfels, 1..=255.
        count: u32,
    },
}

/// Box of a child in 255ths of its group's box, rounded to nearest: boxes of neighbors then tile as their surfaces
/// do. What sticks out by rounding is part of the group's `cover_margin`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChildBox {
    /// Smallest corner.
    pub min: [u8; 3],
    /// Largest corner.
    pub max: [u8; 3],
}

impl ChildBox {
    /// The stored box nearest to `child`, which lies in `group`.
    #[must_use]
    pub fn around(child: &Aabb, group: &Aabb) -> Self {
        let extent = group.extent();
        let mut stored = Self { min: [0; 3], max: [0; 3] };
        for axis in 0..3 {
            let step = extent[axis] * (1.0 / 255.0);
            if !(step > 0.0) {
                continue;
            }
            let round = |x: f32| ((x - group.min[axis]) / step).round().clamp(0.0, 255.0) as u8;
            let (low, high) = (round(child.min[axis]), round(child.max[axis]));
            stored.min[axis] = low;
            stored.max[axis] = high;
        }
        stored
    }

    /// The box in scene units.
    #[must_use]
    pub fn decode(&self, group: &Aabb) -> Aabb {
        let step = group.extent() * (1.0 / 255.0);
        let corner = |codes: [u8; 3]| group.min + step * Vec3::from_array(codes.map(f32::from));
        Aabb { min: corner(self.min), max: corner(self.max) }
    }

    /// The box that positions of a leaf with this box refer to: larger by half a step on every side, so that nothing sticks out.
    #[must_use]
    pub fn leaf_frame(&self, group: &Aabb) -> Aabb {
        let half_step = group.extent() * (0.5 / 255.0);
        let Aabb { min, max } = self.decode(group);
        Aabb { min: min - half_step, max: max + half_step }
    }
}

/// What is written of a group besides its children.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupFields {
    /// Tight box of all its surfels' area-true disks.
    pub bounds: Aabb,
    /// Center of the octree cell: where its octants meet.
    pub split: Vec3,
    /// How far covering disks reach out of the stored boxes of the children at most. Stored as at most one part in 128 more.
    pub cover_margin: f32,
    /// Octants that have a child; children are stored in octant order.
    pub octants: u8,
    /// Octants whose child is a leaf.
    pub leaves: u8,
}

/// Bytes of a group's two sets of lobes with stencils.
const STENCIL_SETS_BYTES: usize = 8;

/// Bytes of a group of children with these lobes.
#[must_use]
pub fn group_bytes(child_count: usize, lobes: &[Lobe], channels: Channels) -> usize {
    let [wide, narrow] = stencil_sets(lobes.iter());
    let stencils = stencil_bytes(wide, narrow);
    stencils_start(child_count, lobes.len(), channels) + stencils
}

/// Bytes of a group before its stencils.
#[inline(always)]
fn stencils_start(child_count: usize, lobe_count: usize, channels: Channels) -> usize {
    let unaligned = GROUP_FIXED_BYTES + 4 * child_count + 7 * child_count;
    unaligned.next_multiple_of(4) + lobe_count * Lobe::stored_bytes(channels)
}

/// Bytes of the sets and of the stencils they say there are.
#[inline(always)]
fn stencil_bytes(wide: u32, narrow: u32) -> usize {
    let (wide, narrow) = (wide.count_ones() as usize, narrow.count_ones() as usize);
    (STENCIL_SETS_BYTES + 8 * wide + 2 * narrow).next_multiple_of(4)
}

/// Lobes (bit = index) with a stencil of 64 bits, and those with one of 16; all others have a full one.
fn stencil_sets<'l>(lobes: impl Iterator<Item = &'l Lobe>) -> [u32; 2] {
    let mut sets = [0; 2];
    for (index, lobe) in lobes.enumerate() {
        if lobe.stencil != Stencil::FULL {
            sets[usize::from(lobe.stencil.to_narrow().is_some())] |= 1 << index;
        }
    }
    sets
}

/// Appends a group: its fields, and of each child its link, its box and its lobes.
///
/// # Panics
///
/// If the children do not match `fields.octants`, or a link is out of range.
pub fn write_group(
    fields: &GroupFields,
    children: &[(ChildLink, ChildBox, &[Lobe])],
    codecs: (Channels, MiniFloat, f32),
    out: &mut Vec<u8>,
) {
    assert_eq!(children.len(), fields.octants.count_ones() as usize, "one child per octant");
    let start = out.len();
    for v in [fields.bounds.min, fields.bounds.max, fields.split] {
        for c in v.to_array() {
            out.extend_from_slice(&c.to_le_bytes());
        }
    }
    // The upper half of a float, rounded up: no disk reaches farther.
    let margin = fields.cover_margin.to_bits().div_ceil(1 << 16) as u16;
    out.extend_from_slice(&margin.to_le_bytes());
    let lobe_count: usize = children.iter().map(|c| c.2.len()).sum();
    assert!(lobe_count <= CHILDREN_MAX * LOBES_MAX, "at most four lobes per child");
    out.extend_from_slice(&[fields.octants, fields.leaves, lobe_count as u8]);
    for (link, ..) in children {
        let code = match *link {
            ChildLink::Group(offset) => {
                assert!(offset % 4 == 0 && offset < EXTERNAL, "aligned offset in the page");
                offset
            }
            ChildLink::External(index) => EXTERNAL | index,
            ChildLink::Leaf { offset, count } => {
                assert!((1..256).contains(&count) && offset < 1 << 24, "leaf fits its link");
                (offset << LEAF_COUNT_BITS) | count
            }
        };
        out.extend_from_slice(&code.to_le_bytes());
    }
    for axis in 0..3 {
        out.extend(children.iter().map(|c| c.1.min[axis]));
    }
    for axis in 0..3 {
        out.extend(children.iter().map(|c| c.1.max[axis]));
    }
    let mut end = 0u8;
    for child in children {
        end += child.2.len() as u8;
        out.push(end);
    }
    out.resize(start + (out.len() - start).next_multiple_of(4), 0);
    let (channels, area, radiance_scale) = codecs;
    for lobe in children.iter().flat_map(|c| c.2) {
        lobe.write(channels, area, radiance_scale, out);
    }
    let lobes = || children.iter().flat_map(|c| c.2);
    let sets = stencil_sets(lobes());
    for set in sets {
        out.extend_from_slice(&set.to_le_bytes());
    }
    let of_set = |set: u32| {
        lobes().enumerate().filter(move |(index, _)| set >> index & 1 != 0).map(|(_, l)| l.stencil)
    };
    for stencil in of_set(sets[0]) {
        out.extend_from_slice(&stencil.0.to_le_bytes());
    }
    for narrow in of_set(sets[1]).filter_map(Stencil::to_narrow) {
        out.extend_from_slice(&narrow.to_le_bytes());
    }
    out.resize(start + (out.len() - start).next_multiple_of(4), 0);
}

/// A group in a verified page.
#[derive(Clone, Copy, Debug)]
pub struct GroupView<'a> {
    bytes: &'a [u8],
    child_count: usize,
    /// Where its stencils begin.
    stencils: usize,
}

impl<'a> GroupView<'a> {
    /// Views the group at `offset` of a page whose groups end at `groups_end`.
    ///
    /// # Errors
    ///
    /// If the group is not wholly inside.
    #[inline(always)]
    pub fn new(
        page: &'a [u8],
        groups_end: usize,
        offset: u32,
        channels: Channels,
    ) -> Result<Self, FormatError> {
        let offset = offset as usize;
        if offset < crate::NODE_PAGE_HEADER_BYTES || offset + GROUP_FIXED_BYTES > groups_end {
            return Err(FormatError::new("group: offset", offset, "a place inside its page"));
        }
        let child_count = page[offset + 38].count_ones() as usize;
        let lobe_count = usize::from(page[offset + 40]);
        let stencils = stencils_start(child_count, lobe_count, channels);
        let sets = offset + stencils;
        let bytes = if sets + STENCIL_SETS_BYTES > groups_end {
            usize::MAX
        } else {
            stencils + stencil_bytes(read_u32(page, sets), read_u32(page, sets + 4))
        };
        if child_count == 0 || lobe_count < child_count || bytes > groups_end - offset {
            return Err(FormatError::new(
                "group: children",
                child_count,
                "1 to 8, inside the page",
            ));
        }
        Ok(Self { bytes: &page[offset..offset + bytes], child_count, stencils })
    }

    /// Bytes of the group.
    #[must_use]
    pub fn stored_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// Number of children.
    #[must_use]
    #[inline(always)]
    pub fn child_count(&self) -> usize {
        self.child_count
    }

    /// Fields other than the children's.
    #[must_use]
    #[inline(always)]
    pub fn fields(&self) -> GroupFields {
        let v = |at| {
            Vec3::new(
                read_f32(self.bytes, at),
                read_f32(self.bytes, at + 4),
                read_f32(self.bytes, at + 8),
            )
        };
        GroupFields {
            bounds: Aabb { min: v(0), max: v(12) },
            split: v(24),
            cover_margin: f32::from_bits(u32::from(read_u16(self.bytes, 36)) << 16),
            octants: self.bytes[38],
            leaves: self.bytes[39],
        }
    }

    /// Link of child `index` (in octant order).
    #[must_use]
    #[inline(always)]
    pub fn link(&self, index: usize, is_leaf: bool) -> ChildLink {
        let code = read_u32(self.bytes, GROUP_FIXED_BYTES + 4 * index);
        if is_leaf {
            ChildLink::Leaf { offset: code >> LEAF_COUNT_BITS, count: code & 0xff }
        } else if code & EXTERNAL != 0 {
            ChildLink::External(code & !EXTERNAL)
        } else {
            ChildLink::Group(code)
        }
    }

    /// Stored corners of all children: `[min x, min y, min z, max x, max y, max z]`, each with a
    /// byte per child; bytes from [`GroupView::child_count`] on mean nothing.
    #[must_use]
    #[inline(always)]
    pub fn corners(&self) -> [[u8; CHILDREN_MAX]; 6] {
        let n = self.child_count;
        let start = GROUP_FIXED_BYTES + 4 * n;
        // Eight bytes are always there: each child has a lobe of at least eight bytes further on.
        std::array::from_fn(|i| {
            let at = start + i * n;
            self.bytes[at..at + CHILDREN_MAX].try_into().expect("eight bytes")
        })
    }

    /// Stored box of child `index`.
    #[must_use]
    #[inline(always)]
    pub fn child_box(&self, index: usize) -> ChildBox {
        let corner = |i: usize| self.bytes[GROUP_FIXED_BYTES + (4 + i) * self.child_count + index];
        ChildBox { min: [0, 1, 2].map(corner), max: [3, 4, 5].map(corner) }
    }

    /// Decoded box of child `index`.
    #[must_use]
    pub fn child_bounds(&self, index: usize) -> Aabb {
        self.child_box(index).decode(&self.fields().bounds)
    }

    /// The box that positions of leaf `index` refer to.
    #[must_use]
    #[inline(always)]
    pub fn leaf_frame(&self, index: usize) -> Aabb {
        self.child_box(index).leaf_frame(&self.fields().bounds)
    }

    /// Stored bytes of the lobes of child `index`: a whole number of [`Lobe::stored_bytes`]; empty
    /// where the counts are contradictory.
    #[must_use]
    #[inline(always)]
    pub fn lobe_bytes(&self, index: usize, channels: Channels) -> &'a [u8] {
        let [first, end] = self.lobes_of(index);
        let start = (GROUP_FIXED_BYTES + 11 * self.child_count).next_multiple_of(4);
        let stride = Lobe::stored_bytes(channels);
        self.bytes.get(start + first * stride..start + end * stride).unwrap_or(&[])
    }

    /// First lobe of child `index`, and one past its last.
    #[inline(always)]
    fn lobes_of(&self, index: usize) -> [usize; 2] {
        let ends = GROUP_FIXED_BYTES + 10 * self.child_count;
        let first = if index == 0 { 0 } else { self.bytes[ends + index - 1] };
        [first, self.bytes[ends + index]].map(usize::from)
    }

    /// Stencils of the lobes of child `index`.
    #[must_use]
    #[inline(always)]
    pub fn stencils(&self, index: usize) -> [Stencil; LOBES_MAX] {
        let [first, end] = self.lobes_of(index);
        let sets = [0, 4].map(|at| read_u32(self.bytes, self.stencils + at));
        let [wide, narrow] = sets;
        let wide_start = self.stencils + STENCIL_SETS_BYTES;
        let narrow_start = wide_start + 8 * wide.count_ones() as usize;
        let mut stencils = [Stencil::FULL; LOBES_MAX];
        for (stencil, lobe) in stencils.iter_mut().zip(first..end.min(32)) {
            let bit = 1u32 << lobe;
            let before = |set: u32| (set & (bit - 1)).count_ones() as usize;
            // Both sets are inside of the group; a lobe in both is read as wide.
            if wide & bit != 0 {
                *stencil = Stencil(read_u64(self.bytes, wide_start + 8 * before(wide)));
            } else if narrow & bit != 0 {
                let code = read_u16(self.bytes, narrow_start + 2 * before(narrow));
                *stencil = Stencil::from_narrow(code);
            }
        }
        stencils
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> (GroupFields, Vec<(ChildLink, Aabb, Vec<Lobe>)>) {
        let fields = GroupFields {
            bounds: Aabb { min: Vec3::new(-1.0, 2.0, 3.0), max: Vec3::new(4.0, 2.5, 9.0) },
            split: Vec3::new(1.5, 2.2, 6.0),
            cover_margin: 0.05,
            octants: 0b1001_0010,
            leaves: 0b1000_0000,
        };
        let lobe = |x: f32, stencil: u64| Lobe {
            vector: Vec3::X * x,
            width: 0.1,
            stencil: Stencil(stencil),
            ..Lobe::default()
        };
        let child = |a: f32, b: f32| Aabb {
            min: Vec3::new(-1.0 + a, 2.0, 3.3),
            max: Vec3::new(-1.0 + b, 2.41, 8.7),
        };
        let children = vec![
            (ChildLink::Group(64), child(0.0, 1.3), vec![lobe(1.0, 0x0c0c)]),
            (ChildLink::External(5), child(1.1, 2.7), vec![lobe(2.0, 5), lobe(3.0, u64::MAX)]),
            (ChildLink::Leaf { offset: 1000, count: 255 }, child(2.2, 5.0), vec![lobe(4.0, 6)]),
        ];
        (fields, children)
    }

    #[test]
    fn groups_round_trip() {
        let (fields, children) = sample();
        let boxed: Vec<_> = children
            .iter()
            .map(|c| (c.0, ChildBox::around(&c.1, &fields.bounds), c.2.as_slice()))
            .collect();
        for channels in [Channels::Occlusion, Channels::Rgb] {
            let mut page = vec![0; crate::NODE_PAGE_HEADER_BYTES];
            let area = MiniFloat::covering(10.0);
            write_group(&fields, &boxed, (channels, area, 1.0), &mut page);
            let view = GroupView::new(&page, page.len(), 32, channels).unwrap();
            assert_eq!(view.stored_bytes(), page.len() - 32);
            assert_eq!(view.stored_bytes(), {
                let lobes: Vec<Lobe> = children.iter().flat_map(|c| c.2.clone()).collect();
                group_bytes(3, &lobes, channels)
            });
            let stored = view.fields();
            assert_eq!(GroupFields { cover_margin: fields.cover_margin, ..stored }, fields);
            let more = stored.cover_margin / fields.cover_margin;
            assert!((1.0..=1.0 + 1.0 / 128.0).contains(&more), "{more}");
            for (i, child) in children.iter().enumerate() {
                assert_eq!(view.link(i, i == 2), child.0);
                let slack = fields.bounds.extent() * (0.501 / 255.0);
                assert!((view.child_bounds(i).min - child.1.min).abs().cmple(slack).all());
                assert!((view.child_bounds(i).max - child.1.max).abs().cmple(slack).all());
                let bytes = view.lobe_bytes(i, channels);
                let stride = Lobe::stored_bytes(channels);
                assert_eq!(bytes.len(), child.2.len() * stride);
                let stencils: Vec<Stencil> = child.2.iter().map(|lobe| lobe.stencil).collect();
                assert_eq!(&view.stencils(i)[..stencils.len()], &stencils);
                let first = Lobe::read(bytes, channels, area, 1.0);
                assert!((first.vector - child.2[0].vector).length() < 2e-2);
            }
        }
    }

    #[test]
    fn groups_outside_their_page_are_refused() {
        let (fields, children) = sample();
        let boxed: Vec<_> = children
            .iter()
            .map(|c| (c.0, ChildBox::around(&c.1, &fields.bounds), c.2.as_slice()))
            .collect();
        let mut page = vec![0; 32];
        let codecs = (Channels::Rgb, MiniFloat::covering(1.0), 1.0);
        write_group(&fields, &boxed, codecs, &mut page);
        for end in 32..page.len() {
            assert!(GroupView::new(&page[..end], end, 32, Channels::Rgb).is_err());
        }
        for offset in [0, 4, page.len() as u32, u32::MAX] {
            assert!(GroupView::new(&page, page.len(), offset, Channels::Rgb).is_err());
        }
    }

    #[test]
    fn flat_groups_store_flat_children() {
        let group = Aabb { min: Vec3::new(0.0, 5.0, 0.0), max: Vec3::new(1.0, 5.0, 1.0) };
        let stored = ChildBox::around(&group, &group);
        assert_eq!((stored.min, stored.max), ([0; 3], [255, 0, 255]));
    }
}
