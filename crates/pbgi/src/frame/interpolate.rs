//! Pieces of surface that are near each other in the image share gathers: what arrives from surfaces and from the broad
//! sky varies slowly, and is interpolated. Small bright lights cast sharp shadows and are never shared.
//!
//! The image is divided into square blocks. In each, the pieces that face the same way and lie in one plane form a group;
//! the member nearest to the group's middle is gathered for, its leader. A piece takes the mean of the leaders of
//! its own and the eight blocks around it, weighted by how near they are in the image, how much they face the same way and
//! how near its plane they lie; where leaders differ much it gathers for itself. Groups depend on what is visible in the blocks alone, not on the bands in which an image is made.

use crate::frame::band::Piece;
use pbgi_gather::Shading;
use pbgi_math::{Vec2, Vec3, luminance};
use pbgi_scene::CameraView;
use std::collections::HashMap;

/// Cosine between normals above which pieces may be in one group.
const SAME_GROUP_COSINE: f32 = 0.95;

/// Cosine between normals below which a leader counts nothing.
const FARTHEST_COSINE: f32 = 0.8;

/// Reach of a leader along the image, in blocks.
const REACH_BLOCKS: f32 = 1.5;

/// How far from a leader's plane pieces may lie that share with it, in blocks.
const PLANE_BLOCKS: f32 = 0.25;

/// Standard deviation over mean of what the leaders receive up to which it is interpolated.
const SPREAD_MAX: f32 = 0.32;

/// Weight of a piece's own leader on top of what it deserves, so that the sum is never 0.
const OWN_WEIGHT: f32 = 1e-3;

/// A piece as the grouping sees it.
#[derive(Clone, Copy)]
struct Member {
    block: [i32; 2],
    pixel: Vec2,
    position: Vec3,
    normal: Vec3,
    /// Width of a block at the piece's depth.
    width: f32,
}

/// Pieces that share a gather.
#[derive(Clone, Copy, Debug)]
struct Group {
    seed: Vec3,
    seed_normal: Vec3,
    sum: Vec3,
    count: f32,
    /// The member nearest to the middle.
    leader: usize,
    leader_distance2: f32,
}

/// Groups of the pieces that are visible in an image, or in a band of it and the rows around it.
pub(crate) struct Groups<'a> {
    view: &'a CameraView,
    /// Pixels along a block's edge.
    edge: f32,
    members: Vec<Member>,
    /// Groups of each block: a range of `leaders`.
    blocks: HashMap<[i32; 2], std::ops::Range<usize>>,
    /// Members that are gathered for.
    leaders: Vec<usize>,
}

impl<'a> Groups<'a> {
    /// Groups `pieces` in blocks of `edge` pixels. Positions are relative to the view's origin.
    pub fn new(pieces: &[Piece], view: &'a CameraView, edge: u32) -> Self {
        let mut groups = Self {
            view,
            edge: edge.max(1) as f32,
            members: Vec::with_capacity(pieces.len()),
            blocks: HashMap::new(),
            leaders: Vec::new(),
        };
        let members = pieces.iter().map(|p| groups.member(p)).collect();
        groups.members = members;
        // An order that depends on what the pieces are, not on how they came.
        let key = |m: &Member| {
            let bits = |v: Vec3| v.to_array().map(f32::to_bits);
            (m.block[1], m.block[0], bits(m.position), bits(m.normal))
        };
        groups.members.sort_unstable_by_key(key);
        let mut start = 0;
        while start < groups.members.len() {
            let block = groups.members[start].block;
            let len = groups.members[start..].iter().take_while(|m| m.block == block).count();
            let first = groups.leaders.len();
            groups.group_block(start..start + len);
            groups.blocks.insert(block, first..groups.leaders.len());
            start += len;
        }
        groups
    }

    fn member(&self, piece: &Piece) -> Member {
        let (pixel, depth) = self.view.project(piece.position).unwrap_or((Vec2::splat(-1.0), 0.0));
        let block = (pixel / self.edge).floor();
        let pixel_width = 2.0 * self.view.half_extent().y / self.view.height as f32;
        Member {
            block: [block.x as i32, block.y as i32],
            pixel,
            position: piece.position,
            normal: piece.normal,
            width: depth * pixel_width * self.edge,
        }
    }

    fn group_block(&mut self, range: std::ops::Range<usize>) {
        let mut groups: Vec<Group> = Vec::new();
        let mut group_of = Vec::with_capacity(range.len());
        for member in &self.members[range.clone()] {
            let is_same = |g: &Group| {
                let offset = member.position - g.seed;
                g.seed_normal.dot(member.normal) >= SAME_GROUP_COSINE
                    && g.seed_normal.dot(offset).abs() <= PLANE_BLOCKS * member.width
                    && offset.length_squared() <= 9.0 * member.width * member.width
            };
            let place = groups.iter().position(is_same).unwrap_or(groups.len());
            if place == groups.len() {
                groups.push(Group {
                    seed: member.position,
                    seed_normal: member.normal,
                    sum: Vec3::ZERO,
                    count: 0.0,
                    leader: 0,
                    leader_distance2: f32::INFINITY,
                });
            }
            groups[place].sum += member.position;
            groups[place].count += 1.0;
            group_of.push(place);
        }
        for (index, place) in range.zip(group_of) {
            let group = &mut groups[place];
            let middle = group.sum / group.count;
            let distance2 = self.members[index].position.distance_squared(middle);
            if distance2 < group.leader_distance2 {
                (group.leader, group.leader_distance2) = (index, distance2);
            }
        }
        self.leaders.extend(groups.iter().map(|g| g.leader));
    }

    /// Position and normal of every leader that one of `pieces` needs, and where in the result of the gathers
    /// it is found.
    pub fn needed(&self, pieces: &[Piece]) -> (Vec<(Vec3, Vec3)>, Vec<u32>) {
        const NONE: u32 = u32::MAX;
        let mut is_needed = vec![false; self.leaders.len()];
        let mut seen = std::collections::HashSet::new();
        for piece in pieces {
            let block = self.member(piece).block;
            if seen.insert(block) {
                self.around(block, |leader| is_needed[leader] = true);
            }
        }
        let mut places = vec![NONE; self.leaders.len()];
        let mut needed = Vec::new();
        for (leader, _) in is_needed.iter().enumerate().filter(|(_, needed)| **needed) {
            places[leader] = needed.len() as u32;
            let member = &self.members[self.leaders[leader]];
            needed.push((member.position, member.normal));
        }
        (needed, places)
    }

    fn around(&self, [x, y]: [i32; 2], mut visit: impl FnMut(usize)) {
        for dy in -1..=1 {
            for dx in -1..=1 {
                if let Some(range) = self.blocks.get(&[x + dx, y + dy]) {
                    range.clone().for_each(&mut visit);
                }
            }
        }
    }

    /// What is interpolated for `piece` from the leaders' shadings, or none where they differ too much.
    pub fn interpolate(
        &self,
        piece: &Piece,
        shadings: &[Shading],
        places: &[u32],
    ) -> Option<Shading> {
        let member = self.member(piece);
        let mut sum = Shading::default();
        let (mut weights, mut light, mut light2) = (0.0, 0.0, 0.0);
        self.around(member.block, |leader| {
            let other = &self.members[self.leaders[leader]];
            let offset = (member.pixel - other.pixel).abs() / (REACH_BLOCKS * self.edge);
            let near = (1.0 - offset.x).max(0.0) * (1.0 - offset.y).max(0.0);
            let cosine = member.normal.dot(other.normal);
            let alike = ((cosine - FARTHEST_COSINE) / (1.0 - FARTHEST_COSINE)).max(0.0);
            let height = member.normal.dot(other.position - member.position).abs();
            let in_plane =
                (1.0 - height / (PLANE_BLOCKS * member.width).max(f32::MIN_POSITIVE)).max(0.0);
            let own = if member.block == other.block { OWN_WEIGHT * alike } else { 0.0 };
            let weight = near * alike * in_plane + own;
            add_weighted(&mut sum, &shadings[places[leader] as usize], weight);
            weights += weight;
            let shading = &shadings[places[leader] as usize];
            // Where nothing shines, occlusion is what counts.
            let lit = luminance(shading.irradiance());
            let value = if lit > 0.0 { lit } else { shading.ambient_occlusion };
            light += weight * value;
            light2 += weight * value * value;
        });
        if !(weights > 0.0) {
            return None;
        }
        let mean = light / weights;
        if light2 / weights - mean * mean > (SPREAD_MAX * mean).powi(2) {
            return None;
        }
        let mut mean = Shading::default();
        add_weighted(&mut mean, &sum, 1.0 / weights);
        mean.bent_normal = mean.bent_normal.try_normalize().unwrap_or(piece.normal);
        mean.cut_size = 0;
        Some(mean)
    }
}

fn add_weighted(sum: &mut Shading, part: &Shading, weight: f32) {
    for c in 0..3 {
        sum.surface_irradiance[c] += weight * part.surface_irradiance[c];
        sum.environment_irradiance[c] += weight * part.environment_irradiance[c];
    }
    sum.ambient_occlusion += weight * part.ambient_occlusion;
    sum.sky_visibility += weight * part.sky_visibility;
    sum.bent_normal += weight * part.bent_normal;
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_math::Aabb;
    use pbgi_scene::Camera;

    fn view() -> CameraView {
        let bounds = Aabb { min: Vec3::splat(-1.0), max: Vec3::splat(1.0) };
        let camera = Camera::framing(&bounds, Vec3::Y, 1.0, 0.7);
        CameraView { camera, width: 64, height: 64 }
    }

    /// A wall facing the camera.
    fn wall(edge: usize, normal: Vec3) -> Vec<Piece> {
        let at = |i: usize| -1.0 + (2 * i + 1) as f32 / edge as f32;
        let piece = |i: usize| Piece {
            position: view().camera.transform.transform_vector3(Vec3::new(
                at(i % edge),
                at(i / edge),
                0.0,
            )),
            normal,
            plane: normal,
            radius: 0.1,
            material: pbgi_gather::Material::default(),
            albedo: [0.5; 3],
            emission: [0.0; 3],
            is_back: false,
        };
        (0..edge * edge).map(piece).collect()
    }

    /// Shadings that vary linearly over the wall.
    fn linear(places: &[(Vec3, Vec3)]) -> Vec<Shading> {
        let light = |p: &(Vec3, Vec3)| Shading {
            surface_irradiance: [2.0 + p.0.x, 1.0, 0.0],
            ambient_occlusion: 0.5,
            bent_normal: Vec3::Z,
            ..Shading::default()
        };
        places.iter().map(light).collect()
    }

    #[test]
    fn few_gathers_stand_for_a_wall_and_follow_a_gradient() {
        let view = view();
        let pieces = wall(60, -view.forward());
        let groups = Groups::new(&pieces, &view, 6);
        let (needed, places) = groups.needed(&pieces);
        assert!(needed.len() * 15 < pieces.len(), "{}", needed.len());
        let shadings = linear(&needed);
        for piece in &pieces {
            let found = groups.interpolate(piece, &shadings, &places).unwrap();
            let error = found.surface_irradiance[0] - (2.0 + piece.position.x);
            // At the rim the mean leans inward by up to half a block.
            assert!(error.abs() < 0.15, "{error} at {}", piece.position);
            assert!((found.surface_irradiance[1] - 1.0).abs() < 1e-5);
            assert!((found.ambient_occlusion - 0.5).abs() < 1e-5);
        }
    }

    #[test]
    fn groups_do_not_depend_on_the_order_or_on_what_is_far_away() {
        let view = view();
        let pieces = wall(40, -view.forward());
        let mut reversed = pieces.clone();
        reversed.reverse();
        let part: Vec<Piece> = pieces[..pieces.len() / 2].to_vec();
        let own = &pieces[..200];
        let results: Vec<Vec<Shading>> = [&pieces, &reversed, &part]
            .into_iter()
            .map(|all| {
                let groups = Groups::new(all, &view, 4);
                let (needed, places) = groups.needed(own);
                let shadings = linear(&needed);
                own.iter().map(|p| groups.interpolate(p, &shadings, &places).unwrap()).collect()
            })
            .collect();
        assert!(results[0] == results[1] && results[0] == results[2]);
    }

    #[test]
    fn pieces_that_face_elsewhere_do_not_share() {
        let view = view();
        let (front, side) = (-view.forward(), view.forward().any_orthonormal_vector());
        let mut pieces = wall(30, front);
        pieces.extend(wall(30, side));
        let groups = Groups::new(&pieces, &view, 6);
        let (needed, places) = groups.needed(&pieces);
        let light = |p: &(Vec3, Vec3)| Shading {
            ambient_occlusion: f32::from(p.1.dot(front) > 0.5),
            ..Shading::default()
        };
        let shadings: Vec<Shading> = needed.iter().map(light).collect();
        for piece in &pieces {
            let found = groups.interpolate(piece, &shadings, &places).unwrap().ambient_occlusion;
            let exact = f32::from(piece.normal.dot(front) > 0.5);
            assert!((found - exact).abs() < 1e-4, "{found} {exact}");
        }
    }

    #[test]
    fn where_leaders_differ_nothing_is_interpolated() {
        let view = view();
        let pieces = wall(60, -view.forward());
        let groups = Groups::new(&pieces, &view, 6);
        let (needed, places) = groups.needed(&pieces);
        let step = |p: &(Vec3, Vec3)| Shading {
            ambient_occlusion: if p.0.x > 0.0 { 1.0 } else { 0.2 },
            ..Shading::default()
        };
        let shadings: Vec<Shading> = needed.iter().map(step).collect();
        let refused = |p: &&Piece| groups.interpolate(p, &shadings, &places).is_none();
        let count = pieces.iter().filter(refused).count();
        assert!(count > 0 && count < pieces.len() / 2, "{count}");
        assert!(pieces.iter().filter(refused).all(|p| p.position.x.abs() < 0.7));
    }
}
