//! What a node shows to a receiver.

use crate::lobe::{KnownLobe, thick_half};
use pbgi_format::{LOBES_MAX, Lobe};
use pbgi_math::{
    Stencil, Vec3, box_silhouette, central_section_area, patch_solid_angle_factor, scramble,
    stencil_axis,
};

/// A piece of a plane that stands for one lobe of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Piece {
    /// The plane: its normal over its signed distance from the receiver.
    pub inverse: Vec3,
    /// Whether it stands for surfaces of all orientations, which lie anywhere in the node's box, and faces the receiver.
    pub is_round: bool,
    /// Which share of what the stencil leaves of the plane's section with the node's box it covers: from here …
    pub start: f32,
    /// … to here. Pieces of a node cover different shares.
    pub end: f32,
    /// Solid angle of the surfaces seen, as if nothing outside the node hid them; sr.
    pub solid_angle: f32,
    /// Cosine between the plane's normal and the line of sight to its middle, without sign.
    pub cosine: f32,
    /// Their radiance: of backs, that of what of a bent surface is still seen from its front, over all that is seen.
    pub radiance: [f32; 3],
    /// Where in the box it lies, seen along `axis`: all of the section where it is full.
    pub stencil: Stencil,
    /// The axis of the largest component of its normal.
    pub axis: u8,
    /// Which samples its share is: pieces of one seed complement each other, those of different seeds hide each other at random.
    pub seed: u32,
}

/// What a node shows to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cluster {
    /// Smallest corner of a box around the pieces, relative to the receiver.
    pub low: Vec3,
    /// Largest corner.
    pub high: Vec3,
    /// Radius of the bounding sphere over its distance.
    pub spread: f32,
    pieces: [Piece; LOBES_MAX],
    count: usize,
}

/// Fill from which on a flat lobe of a solid thing has no holes: its stencil says where it lies, and cells that hold its rim are covered in part. With
/// 0.3, 0.5 and 0.75, Sponza's occlusion has an error of 6.8, 6.5 and 7.3 % at the default cut and a bias of −1.3, −0.7 and +0.9 %, the street's 2.0, 2.0 and
/// 2.1 %, and the irradiance of a fire of small balls, which are all rim, 5.0, 3.3 and 3.6 %.
const SOLID_CLOSED: f32 = 0.5;

/// The same for sheets, which may have holes. At the default cut a cone of cloth hides 9 % too little with 0.95, within 0.5 % with 0.8 and 0.6, while foliage
/// has an error of 3.9, 3.9 and 4.5 %.
const SHEET_CLOSED: f32 = 0.8;

/// The seed of the veil of a node's loose lobe, as if drawn at random: lobes and nodes must not be combined by what seeds of nodes are made of, or
/// the lobe of one node has the veil of the next page's.
#[inline(always)]
fn loose_seed(node: u32, lobe: usize) -> u32 {
    scramble(node.wrapping_add((lobe as u32).wrapping_mul(0x9e37_79b9)))
}

/// A lobe as the receiver sees it.
#[derive(Clone, Copy, Default)]
struct Shown {
    piece: Piece,
    /// Its number among the node's.
    lobe: usize,
    distance2: f32,
    /// Share of the section it covers.
    opacity: f32,
    /// Area, front or back.
    area: f32,
    is_sheet: bool,
    is_flat: bool,
    is_front: bool,
    /// Its area is that of both sides that block.
    is_loose: bool,
}

impl Shown {
    /// What does not depend on where it is seen from.
    #[inline(always)]
    fn of(lobe: &Lobe) -> Self {
        let is_sheet = !lobe.blocks_back && !lobe.is_loose;
        Self { is_sheet, is_loose: lobe.is_loose, ..Self::default() }
    }
}

impl Cluster {
    /// Share of a box's largest edge by which its sections reach out of it: neighboring pieces of a surface then
    /// leave no gap, whatever rounding did to their boxes.
    pub(crate) const REACH: f32 = 0.006;

    /// The pieces, nearest first.
    #[must_use]
    #[inline(always)]
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces[..self.count]
    }

    /// Evaluates the lobes of a node with this box, relative to a receiver at `position`.
    ///
    /// Opaque surfaces enclose things: the areas their fronts show do not overlap, and add up; their backs are behind
    /// their fronts. Sheets (front-only surfels back to back: leaves, cloth) do overlap, unless they are one flat
    /// piece: only the largest flat lobe is taken as it is and the rest hides itself as a cloud of
    /// random pieces does, covering `1 − e^−τ` where its area is `τ` times the box's silhouette.
    #[inline(always)]
    pub(crate) fn from_lobes(
        low: Vec3,
        high: Vec3,
        lobes: &[KnownLobe],
        seed: u32,
        position: Vec3,
    ) -> Self {
        let (center, half) = ((low + high) * 0.5, thick_half(low, high));
        let inverse_distance = 1.0 / center.length();
        let toward_receiver = center * -inverse_distance;
        let mut shown = [Shown::default(); LOBES_MAX];
        let mut count = 0;
        for (number, lobe) in lobes.iter().enumerate() {
            let seen = if lobe.is_flat {
                see_flat(lobe, lobe.point - position)
            } else {
                see_round(lobe, center, half, toward_receiver)
            };
            let Some(mut seen) = seen else { continue };
            seen.lobe = number;
            // By distance, nearest first.
            let mut at = count;
            while at > 0 && shown[at - 1].distance2 > seen.distance2 {
                shown[at] = shown[at - 1];
                at -= 1;
            }
            shown[at] = seen;
            count += 1;
        }
        thin_loose(&mut shown[..count], lobes, center, half);
        // One lobe of a solid thing hides nothing of itself.
        if count > 1 || shown[0].is_sheet {
            count = drop_backs(&mut shown[..count]);
            thin_sheets(&mut shown[..count], lobes, || box_silhouette(half, toward_receiver));
        }
        let margin = Self::REACH * (high - low).max_element();
        let mut cluster = Self {
            low: low - margin,
            high: high + margin,
            spread: half.length() * inverse_distance,
            count,
            ..Self::default()
        };
        let mut covered = 0.0;
        for (piece, seen) in cluster.pieces.iter_mut().zip(&shown[..count]) {
            (*piece, piece.seed) = (seen.piece, seed);
            let closed = if seen.is_sheet { SHEET_CLOSED } else { SOLID_CLOSED };
            if seen.is_loose {
                piece.end = seen.opacity;
                piece.seed = loose_seed(seed, seen.lobe);
            } else if seen.is_flat {
                piece.end = if seen.opacity >= closed { 1.0 } else { seen.opacity };
            } else if seen.is_front {
                piece.start = covered;
                piece.end = (covered + seen.opacity).min(1.0);
                covered = piece.end;
            } else {
                piece.end = seen.opacity.min(1.0);
            }
        }
        cluster
    }
}

/// Lets loose lobes cover `1 − e^−τ` of what they are drawn as, where their area is `τ` times that: the optical depth of a piece times its outline is
/// the area of its surfels, whatever the outline, so that the depths along a line of sight are right on the mean. Each is a veil of its own: pieces of
/// one node, like those behind each other, multiply what they leave open.
#[inline(always)]
fn thin_loose(shown: &mut [Shown], lobes: &[KnownLobe], center: Vec3, half: Vec3) {
    let grown = (1.0 + 2.0 * Cluster::REACH).powi(2);
    for seen in shown.iter_mut().filter(|seen| seen.is_loose) {
        let (depth, outline) = if seen.is_flat {
            let known = &lobes[seen.lobe];
            let cosine = seen.piece.cosine;
            (known.depth_per_area * seen.area / cosine, known.outline * cosine)
        } else {
            // Those of cells side by side tile the plane, so that each line of sight meets one of each layer.
            let axis = stencil_axis(center);
            let cosine = center[axis].abs() / center.length();
            let face = 4.0 * half[(axis + 1) % 3] * half[(axis + 2) % 3];
            seen.piece.inverse = Vec3::ZERO;
            seen.piece.inverse[axis] = 1.0 / center[axis];
            (seen.area / (face * cosine * grown), face * cosine * grown)
        };
        seen.opacity = 1.0 - (-depth).exp();
        // What is hidden inside does not shine.
        seen.piece.solid_angle *= (seen.opacity * outline / seen.area).min(1.0);
    }
}

/// Share of the backs' area that fronts must show to hide them.
const HIDING: f32 = 0.7;

/// Leaves out the backs where fronts show about as much: they are the far side of the same thing, and what of them is seen from its front shows at the
/// fronts' rims. Returns how many are left.
#[inline(always)]
fn drop_backs(shown: &mut [Shown]) -> usize {
    let (mut fronts, mut backs) = (0.0, 0.0);
    for seen in shown.iter().filter(|seen| !seen.is_loose) {
        if seen.is_front {
            fronts += seen.area;
        } else {
            backs += seen.area;
        }
    }
    if backs == 0.0 || fronts < HIDING * backs {
        return shown.len();
    }
    let mut kept = 0;
    let (mut solid_angle, mut moved) = (0.0, [0.0; 3]);
    for index in 0..shown.len() {
        let seen = shown[index];
        if seen.is_front || seen.is_loose {
            shown[kept] = seen;
            kept += 1;
            solid_angle += if seen.is_loose { 0.0 } else { seen.piece.solid_angle };
        } else {
            for (moved, light) in moved.iter_mut().zip(seen.piece.radiance) {
                *moved += light * seen.piece.solid_angle;
            }
        }
    }
    if moved != [0.0; 3] && solid_angle > 0.0 {
        for seen in shown[..kept].iter_mut().filter(|seen| !seen.is_loose) {
            for (light, moved) in seen.piece.radiance.iter_mut().zip(moved) {
                *light += moved * (1.0 / solid_angle);
            }
        }
    }
    kept
}

/// What a lobe shows of its front and its back to a receiver at the other end of `point`: areas, and the distance and its square.
#[inline(always)]
fn sides(lobe: &KnownLobe, point: Vec3) -> ([f32; 2], f32, f32) {
    let distance2 = point.length_squared();
    let inverse_distance = 1.0 / distance2.sqrt();
    let along = lobe.lobe.vector.dot(point) * -inverse_distance;
    let root = (along * along + lobe.lobe.width * lobe.lobe.width).sqrt();
    let back = if lobe.lobe.blocks_back { 0.5 * (root - along) } else { 0.0 };
    ([0.5 * (along + root), back], distance2, inverse_distance)
}

/// What a flat lobe shows, a piece of its plane, or none where it shows nothing that blocks. Which side is seen follows from the lobe's own plane,
/// which may lie far from the box's middle.
#[inline(always)]
fn see_flat(known: &KnownLobe, point: Vec3) -> Option<Shown> {
    let &KnownLobe { ref lobe, normal, axis, .. } = known;
    let ([front, back], distance2, inverse_distance) = sides(known, point);
    let height = normal.dot(point);
    let is_front = height < 0.0;
    let mut area = if is_front { front.max(back) } else { back };
    if !(area > 0.0) {
        return None;
    }
    // Seen along its edge it covers nothing; the plane must not contain the receiver.
    let least = 1e-6 * (distance2 * inverse_distance);
    let across = point - normal * height;
    let height = if height.abs() < least { least } else { height };
    let mut solid_angle = if is_front { front } else { back } / distance2;
    // Behind the mean plane of a bent surface, some of it still turns its front to the receiver.
    let shining = if is_front { 1.0 } else { front / back };
    let along2 = known.variance.dot(across * across);
    solid_angle *= patch_solid_angle_factor(distance2, known.spread2, along2);
    if is_front {
        // Leaves above each other hide as much of their light.
        solid_angle *= known.covered;
        area *= known.covered;
    }
    let piece = Piece {
        inverse: normal * (1.0 / height),
        solid_angle,
        cosine: height.abs() * inverse_distance,
        radiance: lobe.radiance.map(|light| light * shining),
        stencil: lobe.stencil,
        axis,
        ..Piece::default()
    };
    if lobe.is_loose {
        area = front + back;
    }
    let opacity = lobe.fill;
    Some(Shown { piece, distance2, opacity, area, is_flat: true, is_front, ..Shown::of(lobe) })
}

/// What a round lobe shows, a section through the middle of its box that faces the receiver, or none where it shows nothing that blocks.
#[inline(always)]
fn see_round(known: &KnownLobe, center: Vec3, half: Vec3, toward_receiver: Vec3) -> Option<Shown> {
    let ([front, back], distance2, inverse_distance) = sides(known, center);
    let area = if known.lobe.is_loose { front + back } else { front.max(back) };
    let is_front = front > 0.0;
    if !(area > 0.0) {
        return None;
    }
    let lobe = &known.lobe;
    let piece = Piece {
        inverse: toward_receiver * -inverse_distance,
        is_round: true,
        solid_angle: if is_front { front } else { back } / distance2,
        cosine: 1.0,
        radiance: if is_front { lobe.radiance } else { [0.0; 3] },
        stencil: Stencil::FULL,
        ..Piece::default()
    };
    let opacity = (area / central_section_area(half, toward_receiver)).min(1.0);
    Some(Shown { piece, distance2, opacity, area, is_front, ..Shown::of(lobe) })
}

/// Reduces what sheets show that are not one flat piece to `1 − e^−τ`. A flat lobe is another piece of cloth beside the largest as far as they
/// cover different cells, and hides as it is. So does a board, whose outline is known: which of two boards is before the other, a lamp below a ceiling,
/// the raster finds by their depths.
#[inline(always)]
fn thin_sheets(shown: &mut [Shown], lobes: &[KnownLobe], silhouette: impl Fn() -> f32) {
    let (mut total, mut flat, mut flat_index) = (0.0, 0.0, usize::MAX);
    for (index, seen) in shown.iter().enumerate() {
        if seen.is_sheet {
            total += seen.area;
            if seen.is_flat && seen.area > flat {
                (flat, flat_index) = (seen.area, index);
            }
        }
    }
    if !(total - flat > 1e-3 * total) {
        return;
    }
    // Of each, the share that lies anywhere in what is left of the box.
    let mut loose = [1.0; LOBES_MAX];
    let mut rest = 0.0;
    let largest = shown.get(flat_index).map(|seen| seen.lobe);
    for (index, (seen, loose)) in shown.iter().zip(&mut loose).enumerate() {
        if !seen.is_sheet || index == flat_index || lobes[seen.lobe].is_board() {
            *loose = 0.0;
        } else if let Some(largest) = largest
            && seen.is_flat
        {
            *loose = lobes[seen.lobe].shares[largest];
        }
        rest += *loose * seen.area;
    }
    if !(rest > 1e-3 * total) {
        return;
    }
    let silhouette = silhouette();
    let open = (silhouette - (total - rest)).max(0.0);
    let factor = (open * (1.0 - (-rest / silhouette).exp()) / rest).min(1.0);
    for (seen, loose) in shown.iter_mut().zip(loose) {
        let kept = 1.0 - loose * (1.0 - factor);
        seen.opacity *= kept;
        seen.piece.solid_angle *= kept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_format::{Channels, MiniFloat, SurfelLayout};
    use pbgi_math::Aabb;

    /// Floor and wall of a node, as the receiver sees them.
    fn see_corner(receiver: Vec3) -> Cluster {
        see(receiver, &[Vec3::Y, Vec3::X], 1.0, 0.0)
    }

    /// A quarter of the box.
    const CORNER: Stencil = Stencil(0x0f0f_0f0f);

    /// Lobes of a node of the box 0 ..= 1, whose planes lie at its lower sides, with this fill and width.
    fn see(receiver: Vec3, vectors: &[Vec3], fill: f32, width: f32) -> Cluster {
        let layout = SurfelLayout {
            channels: Channels::Rgb,
            albedo: false,
            radius: MiniFloat::covering(1.0),
            area: MiniFloat::covering(1.0),
            radiance_scale: 1.0,
        };
        let mut bytes = Vec::new();
        for &vector in vectors {
            let lobe = Lobe {
                vector,
                width,
                blocks_back: true,
                radiance: [1.0; 3],
                height: -1.0,
                fill,
                is_loose: false,
                stencil: Stencil::FULL,
            };
            lobe.write(layout.channels, layout.area, layout.radiance_scale, &mut bytes);
        }
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let stored = bytes.chunks_exact(Lobe::stored_bytes(layout.channels));
        let known = |stored: &[u8]| {
            let mut lobe = Lobe::read(stored, layout.channels, layout.area, 1.0);
            lobe.stencil = CORNER;
            KnownLobe::new(&lobe, &bounds)
        };
        let lobes: Vec<KnownLobe> = stored.map(known).collect();
        Cluster::from_lobes(-receiver, Vec3::ONE - receiver, &lobes, 1, receiver)
    }

    #[test]
    fn which_side_is_seen_follows_from_the_planes_not_from_the_middle() {
        // Before floor and wall, though under the middle of their box; behind the wall; under the floor.
        for (receiver, floor, wall) in [
            (Vec3::new(6.0, 0.1, 0.5), 1.0, 1.0),
            (Vec3::new(-6.0, 0.1, 0.5), 1.0, 0.0),
            (Vec3::new(6.0, -0.1, 0.5), 0.0, 1.0),
        ] {
            let cluster = see_corner(receiver);
            let shown = |axis: usize| {
                let of_axis = |p: &&Piece| p.inverse[axis] != 0.0;
                cluster.pieces().iter().find(of_axis).map_or(0.0, |p| p.radiance[0])
            };
            assert_eq!((shown(1), shown(0)), (floor, wall), "{receiver}");
        }
    }

    #[test]
    fn a_solid_plane_is_closed_where_its_stencil_says_it_is() {
        let receiver = Vec3::new(0.5, 3.0, 0.5);
        for (fill, end) in [(0.95, 1.0), (0.6, 1.0), (0.2, 0.2)] {
            let cluster = see(receiver, &[Vec3::Y], fill, 0.0);
            let [piece] = cluster.pieces() else { panic!("one piece") };
            assert!(piece.start == 0.0 && (piece.end - end).abs() < 4e-3, "{fill}: {piece:?}");
            assert_eq!((piece.stencil, piece.axis), (CORNER, 1));
        }
        // What is round lies anywhere in the box.
        let cluster = see(receiver, &[Vec3::Y], 1.0, 4.0);
        assert_eq!(cluster.pieces()[0].stencil, Stencil::FULL);
    }

    /// Cloth over the box 0 ..= 1: two sheets, the larger first, with these normals and stencils and a width, as seen from below.
    fn see_cloth(normals: [Vec3; 2], stencils: [u64; 2], width: f32) -> Vec<f32> {
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let sheet = |(k, normal): (usize, Vec3)| {
            let stencil = Stencil(stencils[k]);
            let vector = normal.normalize() * if k == 0 { 0.6 } else { 0.3 };
            let lobe = Lobe { vector, width, fill: 0.9, stencil, ..Lobe::default() };
            KnownLobe::new(&lobe, &bounds)
        };
        let mut lobes: Vec<KnownLobe> = normals.into_iter().enumerate().map(sheet).collect();
        crate::lobe::find_shares(&mut lobes, &bounds);
        let receiver = Vec3::new(0.4, -3.0, 0.6);
        let cluster = Cluster::from_lobes(-receiver, Vec3::ONE - receiver, &lobes, 1, receiver);
        let mut ends: Vec<f32> = cluster.pieces().iter().map(|piece| piece.end).collect();
        ends.sort_by(f32::total_cmp);
        ends
    }

    #[test]
    fn cloth_is_thinned_only_where_it_lies_above_other_cloth() {
        let (left, right) = (0x0f0f_0f0f_0f0f_0f0f, 0xf0f0_f0f0_f0f0_f0f0);
        let down = Vec3::NEG_Y;
        // Beside each other both are closed, above each other the smaller one hides itself in part.
        assert_eq!(see_cloth([down, down], [left, right], 0.02), [1.0, 1.0]);
        let above = see_cloth([down, down], [left, left], 0.02);
        assert!(above[0] > 0.3 && above[0] < 0.8 && above[1] == 1.0, "{above:?}");
        // Boards, all of whose surfels lie one way, hide nothing of themselves: a lamp below a ceiling.
        assert_eq!(see_cloth([down, down], [left, left], 0.0), [1.0, 1.0]);
        // A plane half way up, in the box around a slanted one or beside it, which has its cells along y and z.
        let slanted = Vec3::new(1.0, -1.0, 0.0);
        let within = see_cloth([slanted, down], [u64::MAX, u64::MAX], 0.02);
        assert!(within[0] > 0.3 && within[0] < 0.8 && within[1] == 1.0, "{within:?}");
        let upper = 0xe0e0_e0e0_e0e0_e0e0;
        assert_eq!(see_cloth([slanted, down], [upper, u64::MAX], 0.02), [1.0, 1.0]);
    }

    /// Loose lobes of the box 0 ..= 1, of these normals, each of this area and width.
    fn see_loose(receiver: Vec3, normals: &[Vec3], area: f32, width: f32, fill: f32) -> Cluster {
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let loose = |normal: &Vec3| {
            let vector = normal.normalize() * area;
            let (blocks_back, is_loose) = (true, true);
            let lobe = Lobe { vector, width, fill, blocks_back, is_loose, ..Lobe::default() };
            KnownLobe::new(&lobe, &bounds)
        };
        let lobes: Vec<KnownLobe> = normals.iter().map(loose).collect();
        Cluster::from_lobes(-receiver, Vec3::ONE - receiver, &lobes, 8, receiver)
    }

    #[test]
    fn depths_of_loose_lobes_are_their_areas() {
        // From far away; along an axis, and from the side.
        for receiver in [Vec3::new(0.5, 1000.0, 0.5), Vec3::new(500.0, 800.0, -300.0)] {
            let toward = (receiver - Vec3::splat(0.5)).normalize();
            let normals = [Vec3::Y, Vec3::NEG_Y, Vec3::new(1.0, 1.0, 1.0)];
            let cluster = see_loose(receiver, &normals, 0.1, 0.2, 1.0);
            assert_eq!(cluster.pieces().len(), normals.len());
            // A face of the box, grown.
            let outline = toward.y * 1.012f32.powi(2);
            let depth: f32 = cluster.pieces().iter().map(|p| -(1.0 - p.end).ln()).sum();
            let shown = |n: &Vec3| (0.1 * n.normalize().dot(toward)).hypot(0.2);
            let expected = normals.iter().map(shown).sum::<f32>() / outline;
            assert!((depth / expected - 1.0).abs() < 0.01, "{depth} {expected}");
            // The planes across the y axis, and a veil for each.
            let of_axis = |p: &Piece| p.inverse.x == 0.0 && p.inverse.z == 0.0;
            assert!(cluster.pieces().iter().all(of_axis));
            let mut seeds: Vec<u32> = cluster.pieces().iter().map(|p| p.seed).collect();
            seeds.sort_unstable();
            seeds.dedup();
            assert_eq!(seeds.len(), normals.len());
        }
    }

    #[test]
    fn loose_lobes_of_a_file_share_no_veils() {
        let mut seeds = Vec::new();
        for page in 0..8 {
            for offset in (32..1632).step_by(4) {
                for octant in 0..8 {
                    let node = crate::node::node_seed(pbgi_format::PageId(page), offset, octant);
                    seeds.extend((0..LOBES_MAX).map(|lobe| loose_seed(node, lobe)));
                }
            }
        }
        let count = seeds.len();
        seeds.sort_unstable();
        seeds.dedup();
        // Random numbers meet by chance: 1.2 of these pairs, so that more than 8 are one case in a hundred thousand.
        assert!(count - seeds.len() <= 8, "{} of {count}", count - seeds.len());
    }

    #[test]
    fn loose_planes_cover_their_fill_and_are_never_closed() {
        let receiver = Vec3::new(0.5, 1000.0, 0.5);
        for fill in [0.1, 0.5, 0.9] {
            let normals = [Vec3::Y, Vec3::new(1.0, 2.0, 0.0)];
            for piece in see_loose(receiver, &normals, 0.5, 0.0, fill).pieces() {
                assert!((piece.end - fill).abs() < 0.01 && piece.start == 0.0, "{piece:?}");
            }
        }
        // What shines is what covers: that of a piece which hides half of itself is halved.
        let shining = see_loose(receiver, &[Vec3::Y], 1.0, 0.0, 0.5);
        let piece = shining.pieces()[0];
        assert!((piece.solid_angle * 999.5f32.powi(2) - 0.5).abs() < 0.01, "{piece:?}");
    }

    /// A ball of radiance 1, its surface in four lobes as a builder sums it: caps around the corners of a tetrahedron.
    #[test]
    fn a_ball_shines_alike_to_all_sides() {
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
            .map(|corner| Vec3::from_array(corner).normalize());
        let area = 1.0 / corners.len() as f32;
        // What a cap's normals sum to is 0.70 of its area; with this width the mean it shows is a quarter of that.
        let lobes = corners.map(|corner| {
            let vector = corner * (0.7 * area);
            let lobe = Lobe {
                vector,
                width: 0.3252 * area,
                blocks_back: true,
                radiance: [1.0; 3],
                height: 0.4,
                fill: 0.7,
                ..Lobe::default()
            };
            assert!(
                (mean_front(&lobe) / (0.25 * area) - 1.0).abs() < 0.01,
                "{}",
                mean_front(&lobe)
            );
            KnownLobe::new(&lobe, &bounds)
        });
        let mut sum = 0.0;
        let directions: Vec<Vec3> = sphere(500).collect();
        for direction in &directions {
            let receiver = Vec3::splat(0.5) + *direction * 100.0;
            let cluster = Cluster::from_lobes(-receiver, Vec3::ONE - receiver, &lobes, 1, receiver);
            let flux: f32 = cluster.pieces().iter().map(|p| p.radiance[0] * p.solid_angle).sum();
            // A quarter of the surface over the square of the distance.
            let share = flux * 1e4 / 0.25;
            assert!((share - 1.0).abs() < 0.12, "{direction}: {share}");
            sum += share;
        }
        let mean = sum / directions.len() as f32;
        assert!((mean - 1.0).abs() < 0.01, "{mean}");
    }

    /// Directions spread evenly.
    fn sphere(count: u16) -> impl Iterator<Item = Vec3> {
        (0..count).map(move |i| {
            let z = -1.0 + 2.0 * (f32::from(i) + 0.5) / f32::from(count);
            let (sin, cos) = (f32::from(i) * 2.399_963).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            Vec3::new(radius * cos, radius * sin, z)
        })
    }

    fn mean_front(lobe: &Lobe) -> f32 {
        sphere(1000).map(|direction| lobe.front_area(direction)).sum::<f32>() / 1000.0
    }

    #[test]
    fn pieces_tell_whether_they_are_planes() {
        let receiver = Vec3::new(0.5, 3.0, 0.5);
        for (width, is_round) in [(0.0, false), (4.0, true)] {
            let cluster = see(receiver, &[Vec3::Y], 1.0, width);
            assert_eq!(cluster.pieces()[0].is_round, is_round);
        }
    }

    #[test]
    fn pieces_know_their_distance_and_cosine() {
        let cluster = see_corner(Vec3::new(4.0, 2.0, 0.5));
        let floor = cluster.pieces().iter().find(|p| p.inverse.y != 0.0).unwrap();
        // The floor's middle is 3.5 away along x and 2 below.
        let d2 = 3.5f32 * 3.5 + 2.0 * 2.0;
        assert!((floor.cosine - 2.0 / d2.sqrt()).abs() < 1e-3, "{floor:?}");
        // A square of edge 1 of which a quarter is covered, nearer than a point would be.
        let factor = patch_solid_angle_factor(d2, 2.0 / 48.0, 3.5 * 3.5 / 48.0);
        assert!(factor > 1.001 && factor < 1.1);
        assert!((floor.solid_angle - factor * floor.cosine / d2).abs() < 1e-4, "{floor:?}");
    }
}
