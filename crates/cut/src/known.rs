//! Nodes and leaves as walks need them: decoded once, and kept for the receivers that come by next.

use crate::cluster::Cluster;
use crate::metric::{NodeSeen, Threshold};
use crate::node::{NodePlace, Viewpoint, bad_link, larger, pin_sound_page, view_group};
use crate::stats::CutStats;
use pbgi_format::{
    CHILDREN_MAX, Channels, ChildLink, LOBES_MAX, LeafSurfel, Lobe, PageId, SurfelLayout,
    SurfelPage,
};
use pbgi_math::{Aabb, STENCIL_EDGE, Stencil, Vec3, central_section_area, stencil_axis};
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
/// What is kept changes which pages are asked for, and when, and nothing else. Beyond `bytes_max` all is forgotten at once.
pub struct NodeReader<'a> {
    reader: Reader<'a>,
    layout: SurfelLayout,
    bytes_max: usize,
    is_full: bool,
    /// How often all was forgotten.
    generation: u32,
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

/// A group of nodes.
#[derive(Clone, Debug)]
pub(crate) struct KnownGroup {
    pub place: NodePlace,
    /// Octants with a child, and those whose child is a leaf.
    pub octants: u8,
    pub leaves: u8,
    /// Whether a child is one piece of a plane, by index.
    pub planes: u8,
    pub split: Vec3,
    /// How far covering disks reach out of the boxes of the children at most.
    pub cover_margin: f32,
    /// Boxes of the children relative to the file's origin, by index, and their brightness.
    boxes: Boxes,
    pub brightness: [f32; CHILDREN_MAX],
    /// Numbers of the children among groups or leaves.
    links: [u32; CHILDREN_MAX],
    /// Where each child's lobes begin, and where the last one's end.
    lobes: [u32; CHILDREN_MAX + 1],
}

/// Eight boxes, by axis: those of a group's children or of some of a leaf's surfels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Boxes {
    /// Smallest corners.
    pub low: [[f32; CHILDREN_MAX]; 3],
    /// Largest corners.
    pub high: [[f32; CHILDREN_MAX]; 3],
}

impl Boxes {
    /// Smallest and largest corner of one.
    #[must_use]
    #[inline(always)]
    pub fn get(&self, index: usize) -> [Vec3; 2] {
        [&self.low, &self.high].map(|of| Vec3::new(of[0][index], of[1][index], of[2][index]))
    }

    /// Sets one.
    #[inline(always)]
    pub fn set(&mut self, index: usize, low: Vec3, high: Vec3) {
        for axis in 0..3 {
            (self.low[axis][index], self.high[axis][index]) = (low[axis], high[axis]);
        }
    }
}

/// What a walk knows of a group's children as seen from a place.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct GroupSeen {
    /// Octants whose child is below the horizon or not wanted, and those whose child is too large to be taken as one.
    pub below: u8,
    pub large: u8,
    /// Boxes around all that is drawn of the children, by index, relative to the place.
    pub boxes: Boxes,
}

/// A lobe of a node: what of it does not depend on the receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct KnownLobe {
    pub lobe: Lobe,
    pub is_flat: bool,
    /// Of a flat one, which share of it lies where another flat one of its node does, by its number: in cells of both stencils, or where these are seen
    /// along different axes, in the box around the other.
    pub shares: [f32; LOBES_MAX],
    /// The normal of its plane and a point of it, relative to the file's origin.
    pub normal: Vec3,
    pub point: Vec3,
    pub axis: u8,
    /// Variances of the points it stands for along the axes, and their sum in its plane.
    pub variance: Vec3,
    pub spread2: f32,
    /// Share of its area that a flat sheet covers: leaves above each other cover less than they have.
    pub covered: f32,
}

/// Surfels of a leaf: where they begin and how many they are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownLeaf {
    start: u32,
    count: u32,
    page: PageId,
    offset: u32,
}

/// What a surfel stands for, relative to its center.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfelShape {
    /// A disk that covers it.
    Disk,
    /// A rectangle: unit vectors along its edges, and half their lengths.
    Rectangle {
        /// Unit vectors, perpendicular to each other and to the normal.
        edges: [Vec3; 2],
        /// Half the lengths.
        half: [f32; 2],
    },
    /// A triangle.
    Triangle {
        /// Its corners from its center.
        corners: [Vec3; 3],
    },
}

/// A surfel but for its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutSurfel {
    /// Unit normal; meaningless when isotropic.
    pub normal: Vec3,
    /// Radius of the covering disk: the distance of the farthest corner of a rectangle or triangle.
    pub radius: f32,
    /// True area.
    pub area: f32,
    /// What it stands for.
    pub shape: SurfelShape,
    /// Corners of a box around it from its center, larger by [`OUTLINE_RESERVE`].
    pub reach: [Vec3; 2],
    /// Radiance of the front, W·m⁻²·sr⁻¹.
    pub radiance: [f32; 3],
    /// Shows half its area to every direction.
    pub isotropic: bool,
    /// Blocks and shines on its front only.
    pub front_only: bool,
}

/// Factor by which rectangles and triangles are drawn larger than they are: rounding and the codes' errors leave no gap between neighbors.
pub const OUTLINE_RESERVE: f32 = 1.02;

impl CutSurfel {
    /// A leaf's surfel.
    #[must_use]
    #[inline(always)]
    pub fn new(surfel: &LeafSurfel) -> Self {
        let &LeafSurfel { normal, radius, area, radiance, isotropic, front_only, .. } = surfel;
        let (shape, reach) = if surfel.is_triangle() {
            let corners = surfel.corners();
            let [a, b, c] = corners.map(|corner| corner * OUTLINE_RESERVE);
            (SurfelShape::Triangle { corners }, [a.min(b).min(c), a.max(b).max(c)])
        } else if surfel.is_rectangle() {
            let (edges, half) = (surfel.tile.edges(normal), surfel.half_edges());
            let [a, b] = half.map(|half| half * OUTLINE_RESERVE);
            let reach = edges[0].abs() * a + edges[1].abs() * b;
            (SurfelShape::Rectangle { edges, half }, [-reach, reach])
        } else if isotropic {
            (SurfelShape::Disk, [-Vec3::splat(radius), Vec3::splat(radius)])
        } else {
            let Aabb { min, max } = Aabb::from_disk(Vec3::ZERO, normal, radius);
            (SurfelShape::Disk, [min, max])
        };
        Self { normal, radius, area, shape, reach, radiance, isotropic, front_only }
    }
}

impl<'a> NodeReader<'a> {
    /// Keeps up to `bytes_max` of decoded nodes, and as much again as one page holds.
    #[must_use]
    pub fn new(reader: Reader<'a>, bytes_max: usize) -> Self {
        Self {
            layout: reader.octree().layout(),
            reader,
            bytes_max,
            is_full: false,
            generation: 0,
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

    /// Forgets all nodes if they take too much. Indices of groups are found anew by [`Self::refresh`].
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
            + self.surfels.len() * (size_of::<CutSurfel>() + size_of::<Vec3>());
        self.is_full = bytes > self.bytes_max;
    }

    #[cold]
    fn forget(&mut self) {
        self.is_full = false;
        self.generation = self.generation.wrapping_add(1);
        self.groups.clear();
        self.root = UNKNOWN;
        self.lobes.clear();
        self.leaves.clear();
        self.surfels.clear();
        self.centers.clear();
    }

    /// The root's group.
    #[inline(always)]
    pub(crate) fn root(&mut self, stats: &mut CutStats) -> Result<GroupIndex, StoreError> {
        if self.root == UNKNOWN {
            let header = *self.octree().header();
            let (page, offset) = (header.root_page, header.root_offset);
            // The root's page is never left out.
            let before = self.reader.stats();
            self.reader.pin_page(page)?;
            stats.levels[0].note(&before, &self.reader.stats());
            self.root = self.read_group(NodePlace { page, offset, level: 1 }, stats)?;
        }
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
            let index = self.read_group(place, stats)?;
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
            octants: fields.octants,
            leaves: fields.leaves,
            planes: 0,
            split: fields.split,
            cover_margin: fields.cover_margin,
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

    /// The group below a child that is no leaf; none in a damaged page that is left out.
    #[inline(always)]
    pub(crate) fn child(
        &mut self,
        at: GroupIndex,
        index: usize,
        stats: &mut CutStats,
    ) -> Result<Option<GroupIndex>, StoreError> {
        let mut child = self.group(at).links[index];
        if child == UNKNOWN {
            child = self.read_child(at, index, stats)?;
            self.groups[at.index as usize].links[index] = child;
        }
        Ok((child != MISSING).then(|| self.numbered(child)))
    }

    #[cold]
    fn read_child(
        &mut self,
        at: GroupIndex,
        index: usize,
        stats: &mut CutStats,
    ) -> Result<u32, StoreError> {
        let NodePlace { page: id, offset, level } = self.group(at).place;
        let Self { reader, layout, .. } = self;
        let depth = reader.octree().header().depth;
        let Some(page) = pin_sound_page(reader, id, usize::from(level) - 1, stats)? else {
            return Ok(MISSING);
        };
        let (view, group) = view_group(reader, &page, id, offset, layout.channels)?;
        let (page, offset) = match group.link(index, false) {
            ChildLink::Leaf { .. } => return Ok(MISSING),
            ChildLink::Group(offset) => (id, offset),
            ChildLink::External(link) => match view.external_link(link) {
                Some(link) => (link.page, link.offset),
                None => return Err(reader.invalid_page(id, bad_link("link: index", link))),
            },
        };
        if u32::from(level) >= depth {
            return Err(reader.invalid_page(page, bad_link("tree: depth", depth)));
        }
        let place = NodePlace { page, offset, level: level + 1 };
        self.read_group(place, stats)
    }

    /// The surfels of a child that is a leaf; none in a damaged page that is left out.
    #[inline(always)]
    pub(crate) fn leaf(
        &mut self,
        at: GroupIndex,
        index: usize,
        stats: &mut CutStats,
    ) -> Result<Option<KnownLeaf>, StoreError> {
        let mut leaf = self.group(at).links[index];
        if leaf == UNKNOWN {
            leaf = self.read_leaf(at, index, stats)?;
            self.groups[at.index as usize].links[index] = leaf;
        }
        Ok((leaf != MISSING).then(|| self.leaves[leaf as usize]))
    }

    #[cold]
    fn read_leaf(
        &mut self,
        at: GroupIndex,
        index: usize,
        stats: &mut CutStats,
    ) -> Result<u32, StoreError> {
        let NodePlace { page: owner, offset, level } = self.group(at).place;
        let Self { reader, layout, .. } = self;
        let Some(page) = pin_sound_page(reader, owner, usize::from(level) - 1, stats)? else {
            return Ok(MISSING);
        };
        let (view, group) = view_group(reader, &page, owner, offset, layout.channels)?;
        let ChildLink::Leaf { offset, count } = group.link(index, true) else {
            return Ok(MISSING);
        };
        let frame = group.leaf_frame(index);
        let Some(id) = view.fields().surfel_page else {
            return Err(reader.invalid_page(owner, bad_link("leaf: surfel page", u32::MAX)));
        };
        let Some(page) = pin_sound_page(reader, id, usize::from(level), stats)? else {
            return Ok(MISSING);
        };
        let found = SurfelPage::new(page.bytes())
            .and_then(|page| page.leaf((offset, count), &frame, layout));
        let found = match found {
            Ok(found) => found,
            Err(error) => return Err(reader.invalid_page(id, error)),
        };
        let start = self.surfels.len() as u32;
        for surfel in (0..found.count()).map(|index| found.surfel(index)) {
            self.centers.push(surfel.center);
            self.surfels.push(CutSurfel::new(&surfel));
        }
        let number = self.leaves.len() as u32;
        self.leaves.push(KnownLeaf { start, count: found.count(), page: id, offset });
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
                let first = self.lobes.len();
                for (stored, stencil) in stored.zip(view.stencils(index)) {
                    let mut lobe =
                        Lobe::read(stored, layout.channels, layout.area, layout.radiance_scale);
                    lobe.stencil = stencil;
                    self.lobes.push(KnownLobe::new(&lobe, &bounds));
                }
                find_shares(&mut self.lobes[first..], &bounds);
                starts[index + 1..].fill(self.lobes.len() as u32);
            }
        }
        self.groups[at.index as usize].lobes = starts;
        self.weigh();
        Ok(())
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

/// How far disks reach out of the box of their node at most, as a share of the box's largest edge.
const OVERHANG: f32 = 0.125;

/// How far what is in the box of an open node reaches out of it: disks by an eighth of the box's edge, needles farther but transparent; the group's margin
/// may come from one giant among its surfels.
#[inline(always)]
pub(crate) fn open_margin(cover_margin: f32, edge: f32) -> f32 {
    cover_margin.min(OVERHANG * edge)
}

impl KnownLeaf {
    /// A number that tells its surfels apart from those of others.
    #[inline(always)]
    pub fn seed(&self, index: u32) -> u32 {
        crate::node::node_seed(self.page, self.offset + (index << 24), 0)
    }
}

impl KnownGroup {
    /// Children.
    #[inline(always)]
    pub fn count(&self) -> usize {
        self.octants.count_ones() as usize
    }

    /// Index of the child of an octant.
    #[inline(always)]
    pub fn index(&self, octant: u8) -> usize {
        (self.octants & ((1 << octant) - 1)).count_ones() as usize
    }

    /// Box of a child, relative to the file's origin.
    #[inline(always)]
    pub fn bounds(&self, index: usize) -> Aabb {
        let [min, max] = self.boxes.get(index);
        Aabb { min, max }
    }

    /// Tests all children against horizon and threshold.
    #[inline(always)]
    pub fn see<T: Threshold>(
        &self,
        view: &Viewpoint,
        threshold: &T,
        stats: &mut CutStats,
    ) -> GroupSeen {
        // Eight boxes at a time; what there are no children for is not looked at.
        let mut found = GroupSeen::default();
        let mut center = [[0.0; CHILDREN_MAX]; 3];
        let (mut distance2, mut radius2) = ([0.0; CHILDREN_MAX], [0.0; CHILDREN_MAX]);
        let mut edge = [0.0; CHILDREN_MAX];
        let Boxes { low, high } = &mut found.boxes;
        for axis in 0..3 {
            let at = view.position[axis];
            for lane in 0..CHILDREN_MAX {
                let (a, b) = (self.boxes.low[axis][lane] - at, self.boxes.high[axis][lane] - at);
                let (middle, half) = ((a + b) * 0.5, (b - a) * 0.5);
                (low[axis][lane], high[axis][lane]) = (a, b);
                center[axis][lane] = middle;
                distance2[lane] += middle * middle;
                radius2[lane] += half * half;
                edge[lane] = larger(edge[lane], b - a);
            }
        }
        let top = view.tops(low, high);
        let mut margin = edge.map(|edge| edge * Cluster::REACH);
        let mut rest = self.octants;
        let mut index = 0;
        while rest != 0 {
            let bit = rest & rest.wrapping_neg();
            rest &= rest - 1;
            let seen = NodeSeen {
                to_center: Vec3::new(center[0][index], center[1][index], center[2][index]),
                distance2: distance2[index],
                radius2: radius2[index],
                top: top[index],
                is_plane: self.planes >> index & 1 != 0,
                brightness: self.brightness[index],
            };
            if seen.top <= 0.0 || !threshold.is_wanted(&seen) {
                found.below |= bit;
            } else if seen.radius2 > threshold.sin2_max(&seen) * seen.distance2 {
                found.large |= bit;
                margin[index] = open_margin(self.cover_margin, edge[index]);
            }
            index += 1;
        }
        for axis in 0..3 {
            for lane in 0..CHILDREN_MAX {
                found.boxes.low[axis][lane] -= margin[lane];
                found.boxes.high[axis][lane] += margin[lane];
            }
        }
        stats.nodes_visited += index as u64;
        stats.culled_horizon += u64::from(found.below.count_ones());
        found
    }
}

/// Largest `h/(|V| + h)` of a lobe of a solid thing that is drawn in its plane, where its stencil says; rounder ones are drawn facing the receiver.
/// A half sphere has 0.55. At 0.3 sr, the street has an error of 8.0 % with 0.25, of 2.9 % with 0.7 and the same with 1.
const SOLID_FLAT_WIDTH: f32 = 0.7;

/// The same for sheets, whose parts lie in no plane where their normals differ: leaves. 0.05 and 0.25 change errors by a tenth of themselves.
const SHEET_FLAT_WIDTH: f32 = 0.1;

/// Fill from which on a sheet is one layer: with less, its parts lie above each other.
const SHEET_WHOLE: f32 = 0.95;

/// Thickness of a flat box, as a share of its largest edge; known to the builder.
const THICKNESS: f32 = 1e-3;

/// Half the extents of a box, thick enough to be cut by planes.
#[inline(always)]
pub(crate) fn thick_half(low: Vec3, high: Vec3) -> Vec3 {
    let half = (high - low) * 0.5;
    half.max(Vec3::splat(THICKNESS * half.max_element()))
}

/// Box around what a stencil of a box leaves of a plane.
fn outline_bounds(normal: Vec3, point: Vec3, stencil: Stencil, around: &Aabb) -> Aabb {
    let axis = stencil_axis(normal);
    let mut found = *around;
    let (mut height, mut reach) = (point[axis], 0.0);
    for ([first, end], across) in stencil.bounds().into_iter().zip([(axis + 1) % 3, (axis + 2) % 3])
    {
        let cell = (around.max[across] - around.min[across]) * (1.0 / STENCIL_EDGE as f32);
        let [low, high] = [first, end].map(|i| around.min[across] + cell * i as f32);
        (found.min[across], found.max[across]) = (low, high);
        let slope = normal[across] / normal[axis];
        height -= slope * (0.5 * (low + high) - point[across]);
        reach += 0.5 * slope.abs() * (high - low);
    }
    found.min[axis] = found.min[axis].max(height - reach);
    found.max[axis] = found.max[axis].min(height + reach);
    found
}

/// Share of a box that lies in another, 0..=1; of what is thin along an axis as of what is thick.
fn share_of_box(own: &Aabb, other: &Aabb) -> f32 {
    let common = own.max.min(other.max) - own.min.max(other.min);
    let least = THICKNESS * own.extent().max_element();
    let share = (common + least) / (own.extent() + least);
    share.clamp(Vec3::ZERO, Vec3::ONE).element_product()
}

/// Finds [`KnownLobe::shares`] of the lobes of the node with this box.
pub(crate) fn find_shares(lobes: &mut [KnownLobe], bounds: &Aabb) {
    if lobes.len() < 2 {
        return;
    }
    let boxes: Vec<Aabb> = lobes
        .iter()
        .map(|known| outline_bounds(known.normal, known.point, known.lobe.stencil, bounds))
        .collect();
    for own in 0..lobes.len() {
        for other in 0..lobes.len() {
            let share = match lobes[own].axis == lobes[other].axis {
                true => lobes[own].lobe.stencil.share_in(lobes[other].lobe.stencil),
                false => share_of_box(&boxes[own], &boxes[other]),
            };
            if lobes[own].is_flat && lobes[other].is_flat {
                lobes[own].shares[other] = share;
            }
        }
    }
}

impl KnownLobe {
    /// A lobe of the node with this box.
    #[must_use]
    #[inline(always)]
    pub fn new(lobe: &Lobe, bounds: &Aabb) -> Self {
        let half = thick_half(bounds.min, bounds.max);
        let length = lobe.vector.length();
        let flat_width = if lobe.blocks_back { SOLID_FLAT_WIDTH } else { SHEET_FLAT_WIDTH };
        let is_flat = lobe.width <= flat_width * (length + lobe.width);
        let mut known = Self {
            lobe: *lobe,
            is_flat,
            covered: 1.0,
            shares: [1.0; LOBES_MAX],
            ..Self::default()
        };
        if !is_flat {
            known.lobe.stencil = Stencil::FULL;
            return known;
        }
        let normal = lobe.vector * (1.0 / length);
        let share = lobe.fill * lobe.stencil.share();
        known.normal = normal;
        known.axis = stencil_axis(normal) as u8;
        known.point = bounds.center() + normal * (lobe.height * normal.abs().dot(half));
        // Points spread evenly over the box's section with the plane: those over the box, laid into it.
        known.variance = half * half * (share * (1.0 / 3.0));
        known.spread2 = known.variance.dot(Vec3::ONE - normal * normal);
        if !lobe.blocks_back && lobe.fill < SHEET_WHOLE {
            known.covered = (share * central_section_area(half, normal) / length).min(1.0);
        }
        known
    }
}
