//! An octree's nodes, decoded once and kept for the receivers that come by next.

use crate::group::{Boxes, KnownGroup};
use crate::lobe::KnownLobe;
use crate::node::{NodePlace, bad_link, node_seed, pin_sound_page, view_group};
use crate::stats::CutStats;
use crate::surfel::CutSurfel;
use pbgi_format::{CHILDREN_MAX, Channels, ChildLink, Lobe, PageId, SurfelLayout, SurfelPage};
use pbgi_math::{Aabb, Vec3};
use pbgi_store::{Octree, Reader, StoreError};

/// No node is known by this number yet.
const UNKNOWN: u32 = u32::MAX;

/// The node lies in a damaged page that is left out.
const MISSING: u32 = u32::MAX - 1;

/// Bytes of decoded nodes that serve neighboring receivers well: what a few cuts take. With 4 MiB, foliage takes 15 % longer where receivers lie a
/// tenth of a tree apart.
pub const KNOWN_BYTES: usize = 16 << 20;

/// An octree's nodes, decoded as walks come by: neighboring receivers walk the same ones.
///
/// What is kept changes which pages are asked for, and when, and nothing else. Beyond `bytes_max` what was not walked for longest is forgotten, so that
/// three quarters are left. Half leaves a tenth more pages to be read again, all at once twice as many.
pub struct NodeReader<'a> {
    reader: Reader<'a>,
    layout: SurfelLayout,
    bytes_max: usize,
    is_full: bool,
    /// Walks so far.
    walks: u32,
    /// How often some was forgotten, and the numbers that groups of the last time have now.
    generation: u32,
    moved: Vec<u32>,
    groups: Vec<KnownGroup>,
    root: u32,
    lobes: Vec<KnownLobe>,
    leaves: Vec<KnownLeaf>,
    /// Surfels of the leaves, and their centers relative to the file's origin.
    surfels: Vec<CutSurfel>,
    centers: Vec<Vec3>,
}

/// A group, by its number among those known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct GroupIndex {
    index: u32,
    generation: u32,
}

/// Surfels of a leaf: where they begin and how many they are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownLeaf {
    /// The walk that last came by.
    walk: u32,
    start: u32,
    count: u32,
    page: PageId,
    offset: u32,
}

/// What a child links to.
pub(crate) enum Below {
    Group(GroupIndex),
    Leaf(KnownLeaf),
}

impl<'a> NodeReader<'a> {
    /// Keeps up to `bytes_max` of decoded nodes, and one group or leaf more.
    #[must_use]
    pub fn new(reader: Reader<'a>, bytes_max: usize) -> Self {
        Self {
            layout: reader.octree().layout(),
            reader,
            bytes_max,
            is_full: false,
            walks: 0,
            generation: 0,
            moved: Vec::new(),
            groups: Vec::new(),
            root: UNKNOWN,
            lobes: Vec::new(),
            leaves: Vec::new(),
            surfels: Vec::new(),
            centers: Vec::new(),
        }
    }

    /// The octree.
    #[must_use]
    #[inline(always)]
    pub fn octree(&self) -> &'a Octree {
        self.reader.octree()
    }

    /// Forgets some nodes if they take too much. Indices of groups are found anew by [`Self::refresh`].
    #[inline(always)]
    pub(crate) fn trim(&mut self) {
        if self.is_full {
            self.forget();
        }
    }

    fn weigh(&mut self) {
        let bytes = self.groups.len() * size_of::<KnownGroup>()
            + self.lobes.len() * size_of::<KnownLobe>()
            + self.leaves.len() * size_of::<KnownLeaf>()
            + self.surfels.len() * SURFEL_BYTES;
        self.is_full = bytes > self.bytes_max;
    }

    /// Keeps what was walked last, in three quarters of the room; nothing if the last walk alone takes more.
    #[cold]
    fn forget(&mut self) {
        let age_max = self.age_kept();
        let is_kept = |walk: u32| age_max.is_some_and(|max| self.walks.wrapping_sub(walk) <= max);
        self.moved.clear();
        self.moved.extend(renumbered(self.groups.iter().map(|group| is_kept(group.walk))));
        let leaves: Vec<u32> =
            renumbered(self.leaves.iter().map(|leaf| is_kept(leaf.walk))).collect();
        self.move_lobes();
        self.move_surfels(&leaves);
        let mut from = self.moved.iter();
        self.groups.retain(|_| from.next() != Some(&UNKNOWN));
        let mut from = leaves.iter();
        self.leaves.retain(|_| from.next() != Some(&UNKNOWN));
        for group in &mut self.groups {
            for octant in (0..CHILDREN_MAX as u8).filter(|octant| group.octants >> octant & 1 != 0)
            {
                let is_leaf = group.leaves >> octant & 1 != 0;
                let numbers = if is_leaf { &leaves } else { &self.moved };
                let index = group.index(octant);
                let link = &mut group.links[index];
                // What is missing stays so.
                *link = numbers.get(*link as usize).copied().unwrap_or(*link);
            }
        }
        self.root = self.moved.get(self.root as usize).copied().unwrap_or(UNKNOWN);
        self.generation = self.generation.wrapping_add(1);
        self.weigh();
    }

    /// The age, in walks, up to which nodes are kept: those that take three quarters of the room at most.
    fn age_kept(&self) -> Option<u32> {
        let age = |walk: u32| self.walks.wrapping_sub(walk);
        let groups = self.groups.iter().map(|group| {
            let lobes = group.lobes[CHILDREN_MAX] - group.lobes[0];
            (age(group.walk), size_of::<KnownGroup>() + lobes as usize * size_of::<KnownLobe>())
        });
        let leaves = self.leaves.iter().map(|leaf| {
            (age(leaf.walk), size_of::<KnownLeaf>() + leaf.count as usize * SURFEL_BYTES)
        });
        let mut sizes: Vec<(u32, usize)> = groups.chain(leaves).collect();
        sizes.sort_unstable();
        let (mut sum, mut kept) = (0, None);
        for of_age in sizes.chunk_by(|a, b| a.0 == b.0) {
            sum += of_age.iter().map(|(_, bytes)| bytes).sum::<usize>();
            if sum > self.bytes_max / 4 * 3 {
                break;
            }
            kept = Some(of_age[0].0);
        }
        kept
    }

    /// Moves the lobes of the groups that are kept together.
    fn move_lobes(&mut self) {
        let has_lobes =
            |i: &usize| self.moved[*i] != UNKNOWN && self.groups[*i].lobes[0] != UNKNOWN;
        let mut order: Vec<usize> = (0..self.groups.len()).filter(has_lobes).collect();
        order.sort_unstable_by_key(|i| self.groups[*i].lobes[0]);
        let mut end = 0;
        for i in order {
            let starts = &mut self.groups[i].lobes;
            let (from, to) = (starts[0] as usize, starts[CHILDREN_MAX] as usize);
            self.lobes.copy_within(from..to, end);
            for start in starts.iter_mut() {
                *start -= (from - end) as u32;
            }
            end += to - from;
        }
        self.lobes.truncate(end);
    }

    /// Moves the surfels of the leaves that are kept, those that have a number, together.
    fn move_surfels(&mut self, numbers: &[u32]) {
        let mut end = 0;
        for (leaf, _) in self.leaves.iter_mut().zip(numbers).filter(|(_, n)| **n != UNKNOWN) {
            let range = leaf.start as usize..(leaf.start + leaf.count) as usize;
            self.surfels.copy_within(range.clone(), end);
            self.centers.copy_within(range, end);
            leaf.start = end as u32;
            end += leaf.count as usize;
        }
        self.surfels.truncate(end);
        self.centers.truncate(end);
    }

    /// The root's group.
    #[inline(always)]
    pub(crate) fn root(&mut self, stats: &mut CutStats) -> Result<GroupIndex, StoreError> {
        self.walks = self.walks.wrapping_add(1);
        if self.root == UNKNOWN {
            let header = *self.octree().header();
            let (page, offset) = (header.root_page, header.root_offset);
            // The root's page is never left out.
            let before = self.reader.stats();
            self.reader.pin_page(page)?;
            stats.levels[0].note(&before, &self.reader.stats());
            self.root = self.read_group(NodePlace { page, offset, level: 1 }, stats)?;
        }
        self.groups[self.root as usize].walk = self.walks;
        Ok(self.numbered(self.root))
    }

    #[inline(always)]
    fn numbered(&self, index: u32) -> GroupIndex {
        GroupIndex { index, generation: self.generation }
    }

    /// The number that a group has now, of this place and this number before.
    #[inline(always)]
    pub(crate) fn refresh(
        &mut self,
        at: &mut GroupIndex,
        place: NodePlace,
        stats: &mut CutStats,
    ) -> Result<bool, StoreError> {
        if at.generation != self.generation {
            let is_of_last = at.generation == self.generation.wrapping_sub(1);
            let moved = self.moved.get(at.index as usize).filter(|_| is_of_last);
            let index = match moved {
                Some(&index) if index != UNKNOWN => index,
                _ => self.read_group(place, stats)?,
            };
            if index == MISSING {
                return Ok(false);
            }
            *at = self.numbered(index);
        }
        Ok(true)
    }

    /// A group by a number of now.
    #[inline(always)]
    pub(crate) fn group(&self, at: GroupIndex) -> &KnownGroup {
        debug_assert_eq!(at.generation, self.generation, "a number of now");
        &self.groups[at.index as usize]
    }

    #[cold]
    fn read_group(&mut self, place: NodePlace, stats: &mut CutStats) -> Result<u32, StoreError> {
        let NodePlace { page: id, offset, level } = place;
        let Self { reader, layout, .. } = self;
        let Some(page) = pin_sound_page(reader, id, usize::from(level) - 1, stats)? else {
            return Ok(MISSING);
        };
        let (_, view) = view_group(reader, &page, id, offset, layout.channels)?;
        let fields = view.fields();
        let step = fields.bounds.extent() * (1.0 / 255.0);
        let base = fields.bounds.min;
        let corners = view.corners();
        let mut group = KnownGroup {
            place,
            walk: self.walks,
            octants: fields.octants,
            leaves: fields.leaves,
            planes: 0,
            split: fields.split,
            cover_margin: fields.cover_margin,
            half_step: step.length() * 0.5,
            boxes: Boxes::default(),
            brightness: [0.0; CHILDREN_MAX],
            links: [UNKNOWN; CHILDREN_MAX],
            lobes: [UNKNOWN; CHILDREN_MAX + 1],
        };
        for axis in 0..3 {
            for lane in 0..CHILDREN_MAX {
                let corner = |axis_of: usize| f32::from(corners[axis_of][lane]);
                group.boxes.low[axis][lane] = base[axis] + step[axis] * corner(axis);
                group.boxes.high[axis][lane] = base[axis] + step[axis] * corner(axis + 3);
            }
        }
        let stride = Lobe::stored_bytes(layout.channels);
        for index in 0..view.child_count() {
            let lobes = view.lobe_bytes(index, layout.channels);
            let is_plane = lobes.len() == stride && Lobe::is_filled_plane(lobes);
            group.planes |= u8::from(is_plane) << index;
            if layout.channels == Channels::Rgb {
                let largest = lobes.chunks_exact(stride).map(Lobe::stored_brightness);
                group.brightness[index] = largest.fold(0.0, f32::max) * layout.radiance_scale;
            }
        }
        let index = self.groups.len() as u32;
        self.groups.push(group);
        self.weigh();
        Ok(index)
    }

    /// What is below a child; none in a damaged page that is left out.
    #[inline(always)]
    pub(crate) fn below(
        &mut self,
        at: GroupIndex,
        octant: u8,
        stats: &mut CutStats,
    ) -> Result<Option<Below>, StoreError> {
        let group = self.group(at);
        let (index, is_leaf) = (group.index(octant), group.leaves >> octant & 1 != 0);
        let mut link = group.links[index];
        if link == UNKNOWN {
            link = self.read_link(group.place, index, is_leaf, stats)?;
            self.groups[at.index as usize].links[index] = link;
        }
        if link == MISSING {
            return Ok(None);
        }
        Ok(Some(match is_leaf {
            true => {
                let leaf = &mut self.leaves[link as usize];
                leaf.walk = self.walks;
                Below::Leaf(*leaf)
            }
            false => {
                self.groups[link as usize].walk = self.walks;
                Below::Group(self.numbered(link))
            }
        }))
    }

    /// The number of what a child of the group at a place links to.
    #[cold]
    fn read_link(
        &mut self,
        NodePlace { page: id, offset, level }: NodePlace,
        index: usize,
        is_leaf: bool,
        stats: &mut CutStats,
    ) -> Result<u32, StoreError> {
        let Self { reader, layout, .. } = self;
        let Some(page) = pin_sound_page(reader, id, usize::from(level) - 1, stats)? else {
            return Ok(MISSING);
        };
        let (view, group) = view_group(reader, &page, id, offset, layout.channels)?;
        let (page, offset) = match group.link(index, is_leaf) {
            ChildLink::Leaf { offset, count } => {
                let Some(surfel_page) = view.fields().surfel_page else {
                    let error = bad_link("leaf: surfel page", u32::MAX);
                    return Err(reader.invalid_page(id, error));
                };
                let place = (offset, count);
                return self.read_leaf(surfel_page, place, &group.leaf_frame(index), level, stats);
            }
            ChildLink::Group(offset) => (id, offset),
            ChildLink::External(link) => match view.external_link(link) {
                Some(link) => (link.page, link.offset),
                None => return Err(reader.invalid_page(id, bad_link("link: index", link))),
            },
        };
        let depth = reader.octree().header().depth;
        if u32::from(level) >= depth {
            return Err(reader.invalid_page(page, bad_link("tree: depth", depth)));
        }
        self.read_group(NodePlace { page, offset, level: level + 1 }, stats)
    }

    /// The number of a leaf, whose first byte and count these are, and whose positions refer to `frame`.
    fn read_leaf(
        &mut self,
        id: PageId,
        place: (u32, u32),
        frame: &Aabb,
        level: u8,
        stats: &mut CutStats,
    ) -> Result<u32, StoreError> {
        let Self { reader, layout, .. } = self;
        let Some(page) = pin_sound_page(reader, id, usize::from(level), stats)? else {
            return Ok(MISSING);
        };
        let found = SurfelPage::new(page.bytes()).and_then(|page| page.leaf(place, frame, layout));
        let found = found.map_err(|error| reader.invalid_page(id, error))?;
        let start = self.surfels.len() as u32;
        for surfel in (0..found.count()).map(|index| found.surfel(index)) {
            self.centers.push(surfel.center);
            let error = found.position_error(surfel.normal);
            self.surfels.push(CutSurfel::new(&surfel, error));
        }
        join_disks(&self.centers[start as usize..], &mut self.surfels[start as usize..]);
        let number = self.leaves.len() as u32;
        let (count, walk) = (found.count(), self.walks);
        self.leaves.push(KnownLeaf { walk, start, count, page: id, offset: place.0 });
        self.weigh();
        Ok(number)
    }

    /// Centers and the rest of the surfels of a leaf.
    #[inline(always)]
    pub(crate) fn surfels(&self, leaf: KnownLeaf) -> (&[Vec3], &[CutSurfel]) {
        let range = leaf.start as usize..(leaf.start + leaf.count) as usize;
        (&self.centers[range.clone()], &self.surfels[range])
    }

    /// The lobes of a child.
    #[inline(always)]
    pub(crate) fn lobes(
        &mut self,
        at: GroupIndex,
        index: usize,
        stats: &mut CutStats,
    ) -> Result<&[KnownLobe], StoreError> {
        if self.group(at).lobes[0] == UNKNOWN {
            self.read_lobes(at, stats)?;
        }
        let lobes = &self.groups[at.index as usize].lobes;
        Ok(&self.lobes[lobes[index] as usize..lobes[index + 1] as usize])
    }

    #[cold]
    fn read_lobes(&mut self, at: GroupIndex, stats: &mut CutStats) -> Result<(), StoreError> {
        let group = &self.groups[at.index as usize];
        let NodePlace { page: id, offset, level } = group.place;
        let Self { reader, layout, .. } = self;
        let mut starts = [self.lobes.len() as u32; CHILDREN_MAX + 1];
        if let Some(page) = pin_sound_page(reader, id, usize::from(level) - 1, stats)? {
            let (_, view) = view_group(reader, &page, id, offset, layout.channels)?;
            let stride = Lobe::stored_bytes(layout.channels);
            for index in 0..view.child_count() {
                let bounds = group.bounds(index);
                let stored = view.lobe_bytes(index, layout.channels).chunks_exact(stride);
                for (stored, stencil) in stored.zip(view.stencils(index)) {
                    let mut lobe =
                        Lobe::read(stored, layout.channels, layout.area, layout.radiance_scale);
                    lobe.stencil = stencil;
                    self.lobes.push(KnownLobe::new(&lobe, &bounds));
                }
                starts[index + 1..].fill(self.lobes.len() as u32);
            }
        }
        self.groups[at.index as usize].lobes = starts;
        self.weigh();
        Ok(())
    }

    /// Whether two children of a group have the same box and, but for how much there is of it, show the same.
    pub(crate) fn look_alike(
        &mut self,
        at: GroupIndex,
        [a, b]: [u8; 2],
        stats: &mut CutStats,
    ) -> Result<bool, StoreError> {
        let group = self.group(at);
        let [a, b] = [a, b].map(|octant| group.index(octant));
        if group.boxes.get(a) != group.boxes.get(b) {
            return Ok(false);
        }
        self.lobes(at, a, stats)?;
        let starts = &self.group(at).lobes;
        let [a, b] =
            [a, b].map(|index| &self.lobes[starts[index] as usize..starts[index + 1] as usize]);
        let alike = |(a, b): (&KnownLobe, &KnownLobe)| are_alike(&a.lobe, &b.lobe);
        Ok(a.len() == b.len() && a.iter().zip(b).all(alike))
    }

    /// Mean radiance of all surfaces of a file, of the brightest channel, weighted by area; W·m⁻²·sr⁻¹. 0 for files without light.
    ///
    /// # Errors
    ///
    /// If the root's page cannot be read or contradicts itself.
    pub fn mean_brightness(&mut self) -> Result<f32, StoreError> {
        if self.layout.channels != Channels::Rgb {
            return Ok(0.0);
        }
        let mut stats = CutStats::default();
        let root = self.root(&mut stats)?;
        let (mut light, mut area) = (0.0, 0.0);
        for index in 0..self.group(root).count() {
            for KnownLobe { lobe, .. } in self.lobes(root, index, &mut stats)? {
                let size = lobe.vector.length() + lobe.width;
                light += size * lobe.radiance.into_iter().fold(0.0, f32::max);
                area += size;
            }
        }
        Ok(if area > 0.0 { light / area } else { 0.0 })
    }
}

/// Bytes of a surfel that is kept.
const SURFEL_BYTES: usize = size_of::<CutSurfel>() + size_of::<Vec3>();

/// Numbers of those that are kept, in order, and [`UNKNOWN`] of the others.
fn renumbered(kept: impl Iterator<Item = bool>) -> impl Iterator<Item = u32> {
    let mut next = 0;
    kept.map(move |is_kept| {
        if !is_kept {
            return UNKNOWN;
        }
        next += 1;
        next - 1
    })
}

/// Difference of shares and of radiances that cannot be told, as a share of the whole.
const ALIKE: f32 = 1.0 / 32.0;

/// Whether two lobes of boxes at one place show the same toward every direction, but for how much area there is behind it.
fn are_alike(a: &Lobe, b: &Lobe) -> bool {
    let size = |lobe: &Lobe| (lobe.vector.length() + lobe.width).max(f32::MIN_POSITIVE);
    let parts = |lobe: &Lobe| (lobe.vector / size(lobe), lobe.width / size(lobe));
    let ((vector_a, width_a), (vector_b, width_b)) = (parts(a), parts(b));
    let near = |x: f32, y: f32, whole: f32| (x - y).abs() <= ALIKE * whole;
    a.blocks_back == b.blocks_back
        && a.stencil == b.stencil
        && near(a.height, b.height, 1.0)
        && near(a.fill, b.fill, 1.0)
        && near(width_a, width_b, 1.0)
        && vector_a.distance(vector_b) <= ALIKE
        && a.radiance.iter().zip(b.radiance).all(|(x, y)| near(*x, y, x.max(y)))
}

impl KnownLeaf {
    /// A number that tells its surfels apart from those of others.
    #[inline(always)]
    pub fn seed(&self, index: u32) -> u32 {
        node_seed(self.page, self.offset + (index << 24), 0)
    }
}

/// Lets disks at one place that face one way be as large as all of them together: what was halved there hides as before.
fn join_disks(centers: &[Vec3], surfels: &mut [CutSurfel]) {
    let mut start = 0;
    for place in centers.chunk_by(|a, b| a == b) {
        let here = &mut surfels[start..start + place.len()];
        start += place.len();
        if here.len() < 2 {
            continue;
        }
        let areas: Vec<f32> = here.iter().map(|own| own.area_like_it(here)).collect();
        for (surfel, area) in here.iter_mut().zip(areas) {
            surfel.draw_area(area);
        }
    }
}
