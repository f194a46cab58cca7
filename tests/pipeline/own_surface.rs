//! What is a receiver's own surface hides nothing, what is another hides all it should.

use crate::support::bake_and_open;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{GatherSettings, Gatherer, Receiver};
use pbgi_math::Vec3;

/// Triangles of an octahedron, each quartered so often, pushed out onto the unit sphere.
fn sphere_triangles(quarterings: u32) -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::new();
    for octant in 0..8u32 {
        let sign = |bit: u32| if octant >> bit & 1 != 0 { -1.0 } else { 1.0 };
        let [x, y, z] = [Vec3::X * sign(0), Vec3::Y * sign(1), Vec3::Z * sign(2)];
        let is_odd = octant.count_ones() % 2 == 1;
        triangles.push(if is_odd { [x, z, y] } else { [x, y, z] });
    }
    for _ in 0..quarterings {
        let quarter = |[a, b, c]: [Vec3; 3]| {
            let [ab, bc, ca] = [a + b, b + c, c + a].map(Vec3::normalize);
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(quarter).collect();
    }
    triangles
}

/// Both sides of a triangle, each blocking on its front only, as a double-sided mesh is diced.
fn both_sides([a, b, c]: [Vec3; 3]) -> [Surfel; 2] {
    // Its longest edge from `a` to `b`.
    let rotations = [[a, b, c], [b, c, a], [c, a, b]];
    let by_length = |t: &&[Vec3; 3]| (t[1] - t[0]).length_squared();
    let longest = rotations.iter().max_by(|s, t| by_length(s).total_cmp(&by_length(t)));
    let [a, b, c] = *longest.unwrap();
    let (base, center) = (b - a, (a + b + c) / 3.0);
    let cross = base.cross(c - a);
    let (area, normal) = (0.5 * cross.length(), cross.normalize());
    let foot = (c - a).dot(base) / base.length_squared();
    let side = |normal: Vec3, base: Vec3, foot: f32| {
        let surfel = Surfel::new(center, normal, base.length(), area);
        surfel.with_flags(SurfelFlags::FRONT_ONLY).with_triangle(base, foot)
    };
    [side(normal, base, foot), side(-normal, -base, 1.0 - foot)]
}

/// A convex double-sided mesh whose normals are interpolated: a receiver sees what is above its own triangle, (1 + cos θ)/2 of the
/// sky where its normal is turned by θ from that of the triangle. The back of the own triangle rises over the tangent plane of the normal, and made
/// one in twenty of these receivers black.
#[test]
fn smooth_double_sided_meshes_have_no_black_spots() {
    let triangles = sphere_triangles(3);
    let surfels: Vec<Surfel> = triangles.iter().flat_map(|t| both_sides(*t)).collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let mut gatherer = Gatherer::new(octree.reader(), &GatherSettings::default(), None);
    for (index, [a, b, c]) in triangles.into_iter().enumerate() {
        let plane = (b - a).cross(c - a).normalize();
        // Near the corners, too, where normals differ most.
        let [u, v] = [[0.8, 0.1], [0.1, 0.8], [0.1, 0.1], [0.34, 0.33]][index % 4];
        let position = a * u + b * v + c * (1.0 - u - v);
        let normal = position.normalize();
        let receiver = Receiver { plane, ..Receiver::diffuse(position, normal) };
        let found = gatherer.gather(&receiver).unwrap().ambient_occlusion;
        let expected = 0.5 + 0.5 * normal.dot(plane);
        assert!((found - expected).abs() < 0.01, "{index}: {found}, expected {expected}");
    }
}

/// A two-sided sheet that is bent up a little, seen from above by receivers beside its folds, which rounding has moved behind it by a millionth: the other
/// side of the piece behind the fold rises over their own piece's plane, and hid all of the sky.
#[test]
fn receivers_beside_folds_of_sheets_are_open() {
    let place = |i: i32, k: i32| {
        let [x, z] = [i, k].map(|i| i as f32 * 0.1 - 0.4);
        Vec3::new(x, 0.05 * (x * x + z * z), z)
    };
    let mut triangles = Vec::new();
    for (i, k) in (0..64).map(|cell| (cell % 8, cell / 8)) {
        let [a, b, c, d] =
            [(i, k), (i, k + 1), (i + 1, k + 1), (i + 1, k)].map(|(i, k)| place(i, k));
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    let surfels: Vec<Surfel> = triangles.iter().flat_map(|t| both_sides(*t)).collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let mut gatherer = Gatherer::new(octree.reader(), &GatherSettings::default(), None);
    for [a, b, c] in triangles {
        let plane = (b - a).cross(c - a).normalize();
        for [u, v] in [[0.49, 0.5], [0.01, 0.49], [0.49, 0.01]] {
            let position = a * u + b * v + c * (1.0 - u - v) - plane * 1e-6;
            let found = gatherer.gather(&Receiver::diffuse(position, plane)).unwrap();
            assert!(found.ambient_occlusion > 0.97, "{position}: {}", found.ambient_occlusion);
        }
    }
}

/// Two sheets that face each other, a hundredth of a micropolygon apart and more: between them it is dark.
#[test]
fn between_two_close_sheets_it_is_dark() {
    let cells = 24i32;
    let edge = 1.0 / cells as f32;
    for apart in [1e-2, 1e-3, 1e-4] {
        let sheet = |height: f32, normal: Vec3| {
            (0..cells * cells).map(move |i| {
                let place = |i: i32| (i as f32 + 0.5) * edge - 0.5;
                let center = Vec3::new(place(i % cells), height, place(i / cells));
                Surfel::new(center, normal, edge, edge * edge).with_tile(Vec3::X, 1.0)
            })
        };
        let surfels: Vec<Surfel> = sheet(0.0, Vec3::Y).chain(sheet(apart, Vec3::NEG_Y)).collect();
        let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
        let mut gatherer = Gatherer::new(octree.reader(), &GatherSettings::default(), None);
        for i in 0..9 {
            let place = Vec3::new((i % 3 - 1) as f32 * 0.1 + 0.013, 0.0, (i / 3 - 1) as f32 * 0.1);
            let found = gatherer.gather(&Receiver::diffuse(place, Vec3::Y)).unwrap();
            assert!(found.ambient_occlusion < 0.01, "{apart}: {}", found.ambient_occlusion);
        }
    }
}

/// A lattice of disks in a square of edge 1, which looks up, each off it by up to so much.
fn rough_sheet(noise: f32) -> Vec<Surfel> {
    let cells = 32i32;
    let edge = 1.0 / cells as f32;
    let place = |i: i32| (i as f32 + 0.5) * edge - 0.5;
    (0..cells * cells)
        .map(|i| {
            // Golden ratios: as if at random, and as many above as below.
            let off = noise * (2.0 * (i as f32 * 0.618_034).fract() - 1.0);
            let center = Vec3::new(place(i % cells), off, place(i / cells));
            Surfel::new(center, Vec3::Y, 0.8 * edge, edge * edge)
        })
        .collect()
}

/// Points of a scan hide nothing from each other, nor from what lies between them; just behind a sheet of them it is dark.
#[test]
fn receivers_on_rough_points_are_open_and_behind_them_dark() {
    let radius = 0.8 / 32.0;
    let surfels = rough_sheet(0.1 * radius);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let mut gatherer = Gatherer::new(octree.reader(), &GatherSettings::default(), None);
    let mut open = |place: Vec3| {
        gatherer.gather(&Receiver::diffuse(place, Vec3::Y)).unwrap().ambient_occlusion
    };
    let inner = surfels.iter().map(Surfel::center).filter(|c| c.abs().max_element() < 0.3);
    for place in inner {
        assert!(open(place) > 0.97, "on a point at {place}: {}", open(place));
        let between = Vec3::new(place.x + 0.6 * radius, 0.0, place.z + 0.6 * radius);
        assert!(open(between) > 0.97, "between points at {between}: {}", open(between));
        let behind = Vec3::new(place.x, -0.3 * radius, place.z);
        assert!(open(behind) < 0.03, "behind points at {behind}: {}", open(behind));
    }
}
