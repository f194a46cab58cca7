//! What a node shows to a receiver.

use pbgi_format::{LOBES_MAX, Lobe, SurfelLayout};
use pbgi_math::{
    Stencil, Vec3, box_silhouette, central_section_area, patch_solid_angle_factor, stencil_axis,
};

/// A piece of a plane that stands for one lobe of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Piece {
    /// The plane: its normal over its signed distance from the receiver.
    pub inverse: Vec3,
    /// Smallest corner of the box that cuts the piece out of the plane, relative to the receiver; inside the node's.
    pub low: Vec3,
    /// Largest corner.
    pub high: Vec3,
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
    /// Their radiance; 0 for backs.
    pub radiance: [f32; 3],
    /// Where in the box it lies, seen along `axis`: all of the section where it is full.
    pub stencil: Stencil,
    /// The axis of the largest component of its normal.
    pub axis: u8,
}

/// What a node shows to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cluster {
    /// Smallest corner of a box around the pieces, relative to the receiver.
    pub low: Vec3,
    /// Largest corner.
    pub high: Vec3,
    /// Tells nodes apart.
    pub seed: u32,
    /// Radius of the bounding sphere over its distance.
    pub spread: f32,
    pieces: [Piece; LOBES_MAX],
    count: usize,
}

/// Largest `h/(|V| + h)` of a lobe of a solid thing that is drawn in its plane, where its stencil says; rounder ones are drawn facing the receiver.
/// A half sphere has 0.55. At 0.3 sr, the street has an error of 8.0 % with 0.25, of 2.9 % with 0.7 and the same with 1.
const SOLID_FLAT_WIDTH: f32 = 0.7;

/// The same for sheets, whose parts lie in no plane where their normals differ: leaves. 0.05 and 0.25 change errors by a tenth of themselves.
const SHEET_FLAT_WIDTH: f32 = 0.1;

/// Fill from which on a flat lobe of a solid thing has no holes: its stencil says where it lies, and cells that hold its rim are covered in part. At
/// 0.1 sr, foliage has an error of 9.5 % with 0.5, of 6.1 % with 0.3 and of 6.0 % with 0.15; the street, at 0.3 sr, of 3.2, 3.6 and 3.9 %.
const SOLID_CLOSED: f32 = 0.3;

/// The same for sheets, which have holes.
const SHEET_WHOLE: f32 = 0.95;

/// Thickness of a flat box, as a share of its largest edge; known to the builder.
const THICKNESS: f32 = 1e-3;

/// A lobe as the receiver sees it.
#[derive(Clone, Copy, Default)]
struct Shown {
    piece: Piece,
    distance2: f32,
    /// Share of the section it covers.
    opacity: f32,
    /// Area, front or back.
    area: f32,
    is_sheet: bool,
    is_flat: bool,
    is_front: bool,
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

    /// Evaluates a node's lobes toward the receiver; `margin` is [`Self::REACH`] times the box's largest edge.
    ///
    /// Opaque surfaces enclose things: the areas their fronts show do not overlap, and add up; their backs are behind
    /// their fronts. Sheets (front-only surfels back to back: leaves, cloth) do overlap, unless they are one flat
    /// piece: only the largest flat lobe is taken as it is and the rest hides itself as a cloud of
    /// random pieces does, covering `1 − e^−τ` where its area is `τ` times the box's silhouette.
    #[inline(always)]
    pub(crate) fn from_lobes(
        low: Vec3,
        high: Vec3,
        margin: f32,
        (lobes, stencils): (&[u8], &[Stencil; LOBES_MAX]),
        seed: u32,
        layout: &SurfelLayout,
    ) -> Self {
        let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let largest = half.max_element();
        let half = half.max(Vec3::splat(THICKNESS * largest));
        let distance = center.length();
        let toward_receiver = center * (-1.0 / distance);
        let mut shown = [Shown::default(); LOBES_MAX];
        let mut count = 0;
        let stored = lobes.chunks_exact(Lobe::stored_bytes(layout.channels));
        for (stored, stencil) in stored.zip(stencils) {
            let mut lobe = Lobe::read(stored, layout.channels, layout.area, layout.radiance_scale);
            lobe.stencil = *stencil;
            let Some(seen) = see_lobe(&lobe, center, half, toward_receiver) else { continue };
            // By distance, nearest first.
            let mut at = count;
            while at > 0 && shown[at - 1].distance2 > seen.distance2 {
                shown[at] = shown[at - 1];
                at -= 1;
            }
            shown[at] = seen;
            count += 1;
        }
        let shown = drop_backs(&mut shown[..count]);
        thin_sheets(shown, box_silhouette(half, toward_receiver));
        let mut cluster = Self {
            low: low - margin,
            high: high + margin,
            seed,
            spread: half.length() / distance,
            count: shown.len(),
            ..Self::default()
        };
        let mut covered = 0.0;
        for (piece, seen) in cluster.pieces.iter_mut().zip(shown.iter()) {
            *piece = seen.piece;
            (piece.low, piece.high) = (cluster.low, cluster.high);
            let closed = if seen.is_sheet { SHEET_WHOLE } else { SOLID_CLOSED };
            if seen.is_flat {
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

/// Share of the backs' area that fronts must show to hide them.
const HIDING: f32 = 0.7;

/// Leaves out the backs where fronts show about as much: they are the far side of the same thing.
#[inline(always)]
fn drop_backs(shown: &mut [Shown]) -> &mut [Shown] {
    let (mut fronts, mut backs) = (0.0, 0.0);
    for seen in shown.iter() {
        if seen.is_front {
            fronts += seen.area;
        } else {
            backs += seen.area;
        }
    }
    if backs == 0.0 || fronts < HIDING * backs {
        return shown;
    }
    let mut kept = 0;
    for index in 0..shown.len() {
        if shown[index].is_front {
            shown[kept] = shown[index];
            kept += 1;
        }
    }
    &mut shown[..kept]
}

/// What a lobe shows, or none where it shows nothing that blocks.
#[inline(always)]
fn see_lobe(lobe: &Lobe, center: Vec3, half: Vec3, toward_receiver: Vec3) -> Option<Shown> {
    let length = lobe.vector.length();
    let flat_width = if lobe.blocks_back { SOLID_FLAT_WIDTH } else { SHEET_FLAT_WIDTH };
    let is_flat = lobe.width <= flat_width * (length + lobe.width);
    let (mut normal, mut point) = (toward_receiver, center);
    if is_flat {
        normal = lobe.vector * (1.0 / length);
        point = center + normal * (lobe.height * normal.abs().dot(half));
    }
    let (distance2, height) = (point.length_squared(), normal.dot(point));
    let distance = distance2.sqrt();
    // Which side is seen follows from the lobe's own plane: that may lie far from the box's middle.
    let along = lobe.vector.dot(point) * (-1.0 / distance);
    let root = (along * along + lobe.width * lobe.width).sqrt();
    let (front, back) = (0.5 * (along + root), 0.5 * (root - along));
    let back = if lobe.blocks_back { back } else { 0.0 };
    let is_front = if is_flat { height < 0.0 } else { front > 0.0 };
    let mut area = if is_flat && !is_front { back } else { front.max(back) };
    if !(area > 0.0) {
        return None;
    }
    let opacity = if is_flat {
        lobe.fill
    } else {
        (area / central_section_area(half, toward_receiver)).min(1.0)
    };
    // Seen along its edge it covers nothing; the plane must not contain the receiver.
    let least = 1e-6 * distance;
    let height = if height.abs() < least { least } else { height };
    let mut piece = Piece {
        inverse: normal * (1.0 / height),
        low: Vec3::ZERO,
        high: Vec3::ZERO,
        is_round: !is_flat,
        start: 0.0,
        end: 0.0,
        solid_angle: if is_front { front } else { back } / distance2,
        cosine: height.abs() * (1.0 / distance),
        radiance: if is_front { lobe.radiance } else { [0.0; 3] },
        stencil: if is_flat { lobe.stencil } else { Stencil::FULL },
        axis: stencil_axis(normal) as u8,
    };
    if is_flat {
        // Points spread evenly over the box's section with the plane: those over the box, laid into it.
        let variance = half * half * (opacity * lobe.stencil.share() * (1.0 / 3.0));
        let across = point - normal * height;
        let spread2 = variance.dot(Vec3::ONE - normal * normal);
        piece.solid_angle *=
            patch_solid_angle_factor(distance2, spread2, variance.dot(across * across));
    }
    let is_sheet = !lobe.blocks_back;
    if is_flat && is_sheet && is_front && lobe.fill < SHEET_WHOLE {
        // Leaves above each other cover less than they have area, and hide as much of their light.
        let covered = lobe.fill * lobe.stencil.share() * central_section_area(half, normal);
        if covered < length {
            piece.solid_angle *= covered / length;
            area *= covered / length;
        }
    }
    Some(Shown { piece, distance2, opacity, area, is_sheet, is_flat, is_front })
}

/// Reduces what sheets show that are not one flat piece to `1 − e^−τ`.
#[inline(always)]
fn thin_sheets(shown: &mut [Shown], silhouette: f32) {
    let (mut total, mut flat, mut flat_index) = (0.0, 0.0, usize::MAX);
    for (index, seen) in shown.iter().enumerate() {
        if seen.is_sheet {
            total += seen.area;
            if seen.is_flat && seen.area > flat {
                (flat, flat_index) = (seen.area, index);
            }
        }
    }
    let rest = total - flat;
    if !(rest > 1e-3 * total) {
        return;
    }
    let open = (silhouette - flat).max(0.0);
    let factor = (open * (1.0 - (-rest / silhouette).exp()) / rest).min(1.0);
    for (index, seen) in shown.iter_mut().enumerate() {
        if seen.is_sheet && index != flat_index {
            seen.opacity *= factor;
            seen.piece.solid_angle *= factor;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_format::{Channels, MiniFloat};

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
                stencil: Stencil::FULL,
            };
            lobe.write(layout.channels, layout.area, layout.radiance_scale, &mut bytes);
        }
        let lobes = (&bytes[..], &[CORNER; LOBES_MAX]);
        Cluster::from_lobes(-receiver, Vec3::ONE - receiver, 0.0, lobes, 1, &layout)
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
            assert!(piece.start == 0.0 && (piece.end - end).abs() < 3e-3, "{fill}: {piece:?}");
            assert_eq!((piece.low, piece.high), (cluster.low, cluster.high));
            assert_eq!((piece.stencil, piece.axis), (CORNER, 1));
        }
        // What is round lies anywhere in the box.
        let cluster = see(receiver, &[Vec3::Y], 1.0, 4.0);
        assert_eq!(cluster.pieces()[0].stencil, Stencil::FULL);
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
