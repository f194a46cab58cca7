//! Receivers as a tree: what is far from a block of them is drawn once, from a few places, and blended for each.
//!
//! Surfels are clustered where they are small as seen from the receiver. By the same argument receivers are clustered where they are close
//! together as seen from the surfels. A block draws the *ring* of nodes that are far enough from it and not far enough from the block around it, as
//! seen from the corners of a box around its receivers, over what lies behind: the rings of larger blocks, blended for that corner. A
//! receiver draws only what is near, over the blend of its block's corners. Blending is linear along each axis of the box, so that the error is of
//! second order in the parallax (Christensen 2008 draws all for each; Kontkanen et al. 2011 share the cut, not what is drawn of it).
//!
//! Coverage is blended by dealing samples out among the corners, so that near and far, which overlap, close without a gap.

use crate::importance::ParallaxSeparation;
use crate::integrator::{GatherParts, Gatherer};
use crate::receiver::{Receiver, Shading};
use pbgi_cut::{CutReceiver, Division, Normals, WalkFrom};
use pbgi_math::{Aabb, CubeFace, Frame, Vec3};
use pbgi_raster::{CubeRasterTable, FAR_PLACES_MAX, FarBlend, FarField, LANES};
use pbgi_store::StoreError;
use std::sync::atomic::{AtomicBool, Ordering};

/// Receivers of a block that is not divided further.
const LEAF_RECEIVERS: usize = 16;

/// Fewest receivers of a block, per place that would stand for them.
const RECEIVERS_PER_PLACE: usize = 2;

/// Deepest nesting of blocks.
const LEVELS_MAX: usize = 16;

/// Share of a block's largest extent below which it is flat along an axis: its places lie in the middle.
const FLAT_SHARE: f32 = 0.1;

/// Length of the mean of normals above which they say how a block lies.
const ALIKE_NORMALS: f32 = 0.95;

/// Overlap of near and far, in extents of the block: what is seen from a place and from a receiver is apart by up to one extent, and more along
/// surfaces seen at a slant. At 0.5 the closed Cornell box has twice the error.
const OVERLAP: f32 = 1.5;

/// Corners of a box that span a tetrahedron.
const TETRAHEDRON: [[f32; 3]; 4] =
    [[-1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]];

/// A box whose corners stand for the receivers in it.
#[derive(Clone, Copy, Debug)]
struct PlaceBox {
    /// Middle, axes, and half the extents along them; 0 where there is one place in the middle.
    middle: Vec3,
    axes: [Vec3; 3],
    half: [f32; 3],
    /// Length of its diagonal.
    extent: f32,
    /// Box of the receivers.
    around: Aabb,
    normals: Normals,
}

impl PlaceBox {
    fn new(receivers: &[Receiver], members: &[u32]) -> Self {
        let each = || members.iter().map(|index| &receivers[*index as usize]);
        let around = Aabb::from_points(each().map(|r| r.position));
        let normals = Normals::around(each().flat_map(|r| [r.normal, r.plane]));
        let mean = each().map(|r| r.plane).sum::<Vec3>() / members.len() as f32;
        let axes = if mean.length() > ALIKE_NORMALS {
            let Frame { tangent, bitangent, normal } = Frame::from_normal(mean.normalize());
            [tangent, bitangent, normal]
        } else {
            Vec3::AXES
        };
        let spans = axes.map(|axis| {
            let along = each().map(|r| axis.dot(r.position));
            along.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
        });
        let middle = [0, 1, 2].map(|i| axes[i] * (0.5 * (spans[i][0] + spans[i][1])));
        let half = spans.map(|[low, high]| 0.5 * (high - low));
        let largest = half[0].max(half[1]).max(half[2]);
        let half = half.map(|h| if h > FLAT_SHARE * largest { h } else { 0.0 });
        Self {
            middle: middle[0] + middle[1] + middle[2],
            axes,
            half,
            extent: 2.0 * Vec3::from_array(half).length(),
            around,
            normals,
        }
    }

    /// Its middle, which stands for all its receivers.
    fn at_middle(&self) -> CutReceiver {
        CutReceiver::standing_for(self.middle, &self.around, self.normals)
    }

    /// Number of places.
    fn count(&self) -> usize {
        1 << self.half.iter().filter(|half| **half > 0.0).count().min(2)
    }

    /// Whether it is wide along all axes: four of its corners stand for its receivers, those of a tetrahedron, between which what is linear is exact.
    fn is_thick(&self) -> bool {
        self.half.iter().all(|half| *half > 0.0)
    }

    /// Axes along which there are two places.
    fn wide_axes(&self) -> impl Iterator<Item = usize> {
        let half = self.half;
        (0..3).filter(move |axis| half[*axis] > 0.0)
    }

    /// The place of a number: bit by bit, low or high along the wide axes.
    fn place(&self, number: usize) -> Vec3 {
        if self.is_thick() {
            let signs = TETRAHEDRON[number];
            let along = |axis: usize| self.axes[axis] * (self.half[axis] * signs[axis]);
            return self.middle + along(0) + along(1) + along(2);
        }
        self.wide_axes().enumerate().fold(self.middle, |place, (bit, axis)| {
            let half = self.half[axis];
            place + self.axes[axis] * if number >> bit & 1 != 0 { half } else { -half }
        })
    }

    /// Weights of the places for a position between them.
    fn weights(&self, position: Vec3) -> [f32; FAR_PLACES_MAX] {
        let mut weights = [0.0; FAR_PLACES_MAX];
        if self.is_thick() {
            let local = Vec3::from_array(
                [0, 1, 2].map(|axis| self.axes[axis].dot(position - self.middle) / self.half[axis]),
            );
            let mut sum = 0.0;
            for (weight, signs) in weights.iter_mut().zip(TETRAHEDRON) {
                *weight = (0.25 + 0.25 * Vec3::from_array(signs).dot(local)).max(0.0);
                sum += *weight;
            }
            return weights.map(|weight| weight / sum);
        }
        weights[0] = 1.0;
        let mut count = 1;
        for axis in self.wide_axes() {
            let along = self.axes[axis].dot(position - self.middle) / self.half[axis];
            let high = (0.5 + 0.5 * along).clamp(0.0, 1.0);
            for number in 0..count {
                weights[number + count] = weights[number] * high;
                weights[number] *= 1.0 - high;
            }
            count *= 2;
        }
        weights
    }
}

/// What a block has drawn.
#[derive(Clone, Debug, Default)]
struct BlockState {
    place_box: Option<PlaceBox>,
    division: Division,
    fields: Vec<FarField>,
}

impl BlockState {
    fn blend(&self, position: Vec3) -> Option<FarBlend<'_>> {
        let place_box = self.place_box.as_ref()?;
        let fields = &self.fields[..place_box.count()];
        Some(FarBlend::new(fields, place_box.weights(position)))
    }
}

/// Memory of the blocks around a receiver, largest first.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blocks {
    states: Vec<BlockState>,
    /// Directions of each texel, in memory: a box around them.
    texels: Vec<Aabb>,
    needed: Vec<bool>,
}

impl Blocks {
    /// For blocks that share at a raster's resolution.
    pub fn new(table: &CubeRasterTable) -> Self {
        let (n, stride) = (table.edge(), table.stride());
        let mut texels = vec![Aabb { min: Vec3::ZERO, max: Vec3::ZERO }; 6 * n * stride];
        for (index, texel) in texels.iter_mut().enumerate() {
            let (column, row, face) = (index % stride, index / stride % n, index / stride / n);
            let at = |i: usize| 2.0 * i as f32 / n as f32 - 1.0;
            let face = CubeFace(face as u8);
            let corner = |(u, v)| face.direction(at(column + u), at(row + v));
            *texel = Aabb::from_points([(0, 0), (1, 0), (0, 1), (1, 1)].map(corner));
        }
        Self { states: vec![BlockState::default(); LEVELS_MAX], texels, needed: Vec::new() }
    }

    /// Finds the texels that receivers with these normals look through.
    fn find_needed(&mut self, normals: &Normals) {
        self.needed.clear();
        self.needed.extend(self.texels.iter().map(|t| normals.top(t.min, t.max) > 0.0));
    }
}

/// Most bytes that the blocks of one thread take, at a raster of so many texels along a face.
#[must_use]
pub fn block_bytes(raster_edge: usize) -> usize {
    let texels = 6 * raster_edge * raster_edge.next_multiple_of(LANES);
    LEVELS_MAX * FAR_PLACES_MAX * FarField::bytes(texels)
}

/// A block around another: what lies behind the other's ring, and what the other has to divide.
#[derive(Clone, Copy)]
struct Outer<'b> {
    /// The innermost block that has drawn anything.
    behind: Option<&'b BlockState>,
    /// What is near to the block around.
    near: Option<&'b BlockState>,
}

impl Outer<'_> {
    fn from(&self) -> WalkFrom<'_> {
        let drawn = self.near.and_then(|state| Some((state.place_box.as_ref()?, &state.division)));
        drawn.map_or(WalkFrom::Root, |(PlaceBox { around, .. }, division)| {
            WalkFrom::Nodes(&division.near, [around, around])
        })
    }
}

/// Receivers that are shaded together, and their results.
struct Block<'b> {
    receivers: &'b [Receiver],
    shadings: &'b mut [Shading],
    stop: &'b AtomicBool,
}

impl Gatherer<'_> {
    /// Gathers for a block of receivers that are near each other, and sets their results, which depend on which receivers are in the block. Ends early,
    /// with results that do not count, once `stop` is set.
    ///
    /// # Errors
    ///
    /// If a page cannot be read or contradicts itself.
    pub fn gather_block(
        &mut self,
        receivers: &[Receiver],
        shadings: &mut [Shading],
        stop: &AtomicBool,
    ) -> Result<(), StoreError> {
        let is_shared = self.settings.parallax > 0.0 && self.settings.parts != GatherParts::Sharp;
        if !is_shared {
            for (receiver, shading) in receivers.iter().zip(shadings) {
                if stop.load(Ordering::Relaxed) {
                    return Ok(());
                }
                *shading = self.gather(receiver)?;
            }
            return Ok(());
        }
        let mut members: Vec<u32> = (0..receivers.len() as u32).collect();
        let outer = Outer { behind: None, near: None };
        let mut block = Block { receivers, shadings, stop };
        self.shade_block(&mut block, &mut members, 0, outer)
    }

    fn shade_block(
        &mut self,
        block: &mut Block<'_>,
        members: &mut [u32],
        level: usize,
        outer: Outer<'_>,
    ) -> Result<(), StoreError> {
        // All at one place lie in one half.
        if members.is_empty() || block.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        let place_box = PlaceBox::new(block.receivers, members);
        let is_worth = members.len() >= RECEIVERS_PER_PLACE * place_box.count();
        if !is_worth || level == LEVELS_MAX {
            self.find_lamps(&place_box.at_middle())?;
            return self.shade_members(block, members, outer);
        }
        let mut state = std::mem::take(&mut self.blocks.states[level]);
        let done = self.draw_block(&place_box, outer, &mut state).and_then(|()| {
            let behind = if state.division.far.is_empty() { outer.behind } else { Some(&state) };
            let inner = Outer { behind, near: Some(&state) };
            if members.len() <= LEAF_RECEIVERS || state.division.has_few_near() {
                return self.shade_members(block, members, inner);
            }
            let parts = divide_members(block.receivers, members, &place_box.around);
            let mut rest = members;
            for len in parts {
                let (part, others) = rest.split_at_mut(len);
                rest = others;
                self.shade_block(block, part, level + 1, inner)?;
            }
            Ok(())
        });
        self.blocks.states[level] = state;
        done
    }

    /// Draws a block's ring from its places.
    fn draw_block(
        &mut self,
        place_box: &PlaceBox,
        outer: Outer<'_>,
        state: &mut BlockState,
    ) -> Result<(), StoreError> {
        let PlaceBox { around, normals, extent, .. } = *place_box;
        let at_middle = place_box.at_middle();
        self.find_lamps(&at_middle)?;
        let distance = extent / self.settings.parallax;
        let stakes = self.stakes()?;
        let separation = ParallaxSeparation { distance, stakes, lamps: &self.lamps };
        let overlap = OVERLAP * extent;
        let (nodes, stats) = (&mut self.walker.nodes, &mut self.walker.stats);
        let division = &mut state.division;
        division.divide(nodes, outer.from(), &at_middle, &around, overlap, &separation, stats)?;
        state.place_box = Some(*place_box);
        if division.far.is_empty() {
            return Ok(());
        }
        self.blocks.find_needed(&normals);
        let needed = std::mem::take(&mut self.blocks.needed);
        let count = place_box.count();
        if state.fields.len() < count {
            state.fields.resize(count, FarField::default());
        }
        let outer_box = outer.near.and_then(|outer| outer.place_box.as_ref());
        let outer_box = outer_box.map_or(&around, |outer| &outer.around);
        for number in 0..count {
            let position = place_box.place(number);
            let place = CutReceiver::standing_for(position, &around, normals);
            let behind = outer.behind.and_then(|outer| outer.blend(position));
            let boxes = [&around, outer_box];
            let from = WalkFrom::Nodes(&state.division.far, boxes);
            self.draw_far(&place, from, behind.as_ref(), &needed, &mut state.fields[number])?;
        }
        self.blocks.needed = needed;
        Ok(())
    }

    /// Gathers for receivers one by one what is near to them.
    fn shade_members(
        &mut self,
        block: &mut Block<'_>,
        members: &[u32],
        outer: Outer<'_>,
    ) -> Result<(), StoreError> {
        for index in members.iter().map(|index| *index as usize) {
            let receiver = &block.receivers[index];
            let behind = outer.behind.and_then(|outer| outer.blend(receiver.position));
            block.shadings[index] = self.gather_near(receiver, outer.from(), behind.as_ref())?;
        }
        Ok(())
    }
}

/// Puts the members of a block in order of its halves along the longest axis of their box, and returns how many each has.
fn divide_members(receivers: &[Receiver], members: &mut [u32], around: &Aabb) -> [usize; 2] {
    let axis = around.extent().max_position();
    let middle = 0.5 * (around.min + around.max)[axis];
    let is_high = |index: &u32| receivers[*index as usize].position[axis] > middle;
    members.sort_by_key(is_high);
    let low = members.partition_point(|index| !is_high(index));
    [low, members.len() - low]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Receivers on a lattice of a box with these edges, turned so that no axis is the world's.
    fn lattice(edges: Vec3) -> Vec<Receiver> {
        let turn = Frame::from_normal(Vec3::new(0.3, 0.8, -0.4).normalize());
        let at = |i: usize| {
            let part = Vec3::new((i % 3) as f32, (i / 3 % 3) as f32, (i / 9) as f32) * 0.5;
            turn.tangent * (part.x * edges.x)
                + turn.bitangent * (part.y * edges.y)
                + turn.normal * (part.z * edges.z)
        };
        (0..27).map(|i| Receiver::diffuse(at(i), turn.normal)).collect()
    }

    #[test]
    fn what_is_linear_is_blended_exactly() {
        for (edges, count) in [
            (Vec3::new(2.0, 1.0, 0.0), 4),
            (Vec3::new(2.0, 0.0, 0.0), 2),
            (Vec3::ZERO, 1),
            (Vec3::new(2.0, 1.0, 1.5), 4),
        ] {
            let receivers = lattice(edges);
            let members: Vec<u32> = (0..27).collect();
            let place_box = PlaceBox::new(&receivers, &members);
            assert_eq!(place_box.count(), count, "{edges}");
            for receiver in &receivers {
                let weights = place_box.weights(receiver.position);
                assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                let place = |number| place_box.place(number) * weights[number];
                let blended: Vec3 = (0..count).map(place).sum();
                // Of a box, only what lies in the tetrahedron is between its places.
                let is_between = !place_box.is_thick() || weights.iter().all(|w| *w > 0.0);
                let apart = blended.distance(receiver.position);
                assert!(!is_between || apart < 1e-5, "{edges}: {apart}");
            }
        }
    }

    #[test]
    fn halves_have_all_members_once() {
        let receivers = lattice(Vec3::new(2.0, 1.0, 0.5));
        let mut members: Vec<u32> = (0..27).collect();
        let around = Aabb::from_points(receivers.iter().map(|r| r.position));
        let parts = divide_members(&receivers, &mut members, &around);
        assert!(parts.iter().sum::<usize>() == 27 && parts.iter().all(|len| *len > 6), "{parts:?}");
        let axis = around.extent().max_position();
        let (low, high) = members.split_at(parts[0]);
        let along = |index: &u32| receivers[*index as usize].position[axis];
        let lowest_high = high.iter().map(along).fold(f32::INFINITY, f32::min);
        assert!(low.iter().map(along).all(|x| x <= lowest_high));
        members.sort_unstable();
        assert!(members.into_iter().eq(0..27));
    }
}
