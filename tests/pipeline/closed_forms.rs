//! Closed forms and the ray-cast oracle.

use crate::support::{bake_and_open, boxed, gather, mean_radiance_in_room};
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{GatherSettings, ImportanceTerms, Receiver};
use pbgi_math::{Mat3, Vec3};
use pbgi_testkit::{SurfelForm, closed_room, random_objects, ray_cast_gather, sphere_directions};
use std::f32::consts::{FRAC_1_PI, PI};

/// Gathers for 400 receivers in a closed room of radiance 2: root mean square and worst of `E/(πL) − 1`.
fn closed_room_errors(form: SurfelForm, solid_angle_sr: f32) -> (f32, f32) {
    let half = Vec3::new(2.0, 1.3, 1.7);
    let (_folder, octree) =
        bake_and_open(&closed_room(half, 40, 2.0, form), &BuildOptions::default());
    let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
    let (mut squares, mut worst) = (0.0, 0f32);
    for (i, normal) in sphere_directions(400).enumerate() {
        let f = |k: usize| ((i * k) % 37) as f32 / 37.0 * 1.8 - 0.9;
        let position = half * Vec3::new(f(5), f(11), f(17));
        let found = gather(&octree, &settings, Receiver::diffuse(position, normal));
        let error = found.surface_irradiance[0] / (2.0 * PI) - 1.0;
        squares += error * error / 400.0;
        worst = worst.max(error.abs()).max(found.ambient_occlusion);
    }
    (squares.sqrt(), worst)
}

/// A closed room of uniform radiance L gives E = πL at every place and orientation, however
/// coarse the cut: pieces of walls tile, and leave no sample open. Receivers float in the air here; what is at worst missing
/// are the surfels that rise too little above their horizon to be told from their own surface.
#[test]
fn a_uniform_closed_room_gives_pi_times_its_radiance() {
    for solid_angle_sr in [0.3, 0.1, 0.03, 0.0] {
        let (rms, worst) = closed_room_errors(SurfelForm::Rectangles, solid_angle_sr);
        assert!(rms < 0.005 && worst < 0.025, "{solid_angle_sr}: {rms}, {worst}");
    }
}

/// Disks do not know what they stand for: where cells are oblong, boxes of their area-true squares leave gaps.
#[test]
fn a_closed_room_of_disks_leaks_little() {
    for solid_angle_sr in [0.3, 0.1, 0.03, 0.0] {
        let (rms, worst) = closed_room_errors(SurfelForm::Disks, solid_angle_sr);
        assert!(rms < 0.02 && worst < 0.06, "{solid_angle_sr}: {rms}, {worst}");
    }
}

/// Receivers on the walls themselves see the room, not their own wall.
#[test]
fn receivers_on_the_walls_of_a_closed_room_see_all_of_it() {
    let half = Vec3::new(2.0, 1.3, 1.7);
    let surfels = closed_room(half, 40, 1.0, SurfelForm::Rectangles);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for solid_angle_sr in [0.1, 0.01] {
        let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
        for (i, surfel) in surfels.iter().enumerate().step_by(97) {
            // Not at the surfels' centers only.
            let slide = surfel.normal().any_orthonormal_vector() * 0.3 * surfel.radius;
            let offset = if i % 2 == 0 { Vec3::ZERO } else { slide };
            let receiver = Receiver::diffuse(surfel.center() + offset, surfel.normal());
            let found = gather(&octree, &settings, receiver);
            let relative = found.surface_irradiance[0] / PI;
            assert!((relative - 1.0).abs() < 0.05, "{solid_angle_sr} {receiver:?}: {relative}");
        }
    }
}

/// A lattice of 24 × 24 squares around the foot of the origin on a plane, facing `normal` at `height`.
fn sheet(normal: Vec3, height: f32, step: f32, flags: SurfelFlags) -> impl Iterator<Item = Surfel> {
    let place = move |i: i32| (i as f32 - 11.5) * step;
    let centers = (0..24 * 24).map(move |i| Vec3::new(place(i % 24), height, place(i / 24)));
    let radius = step * std::f32::consts::FRAC_1_SQRT_2;
    centers.map(move |center| {
        let surfel = Surfel::new(center, normal, radius, step * step);
        surfel.with_flags(flags).with_tile(Vec3::X, 1.0)
    })
}

/// A leaf a tenth of its surfels' spacing above another hides the sky from it, though it rises less than the bias; the lower leaf's own other
/// side does not.
#[test]
fn a_leaf_close_above_another_hides_its_sky() {
    let step = 0.02;
    let mut surfels = Vec::new();
    for height in [0.0, 0.1 * step] {
        for normal in [Vec3::Y, Vec3::NEG_Y] {
            surfels.extend(sheet(normal, height, step, SurfelFlags::FRONT_ONLY));
        }
    }
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings = GatherSettings { solid_angle_sr: 0.0, ..GatherSettings::default() };
    for place in [Vec3::ZERO, Vec3::new(0.013, 0.0, -0.031)] {
        let between = gather(&octree, &settings, Receiver::diffuse(place, Vec3::Y));
        assert!(between.ambient_occlusion < 0.05, "{place}: {}", between.ambient_occlusion);
        let above = Receiver::diffuse(place + 0.1 * step * Vec3::Y, Vec3::Y);
        let above = gather(&octree, &settings, above);
        assert!(above.ambient_occlusion > 0.999, "{place}: {}", above.ambient_occlusion);
    }
}

/// Slats that face the same way hide each other, though they are nearer to each other than their surfels are wide.
#[test]
fn slats_hide_what_lies_behind_them() {
    let step = 0.02;
    let solid = SurfelFlags::default();
    let settings = GatherSettings { solid_angle_sr: 0.0, ..GatherSettings::default() };
    // Radii are 0.7 of a step.
    for apart in [0.5 * step, 0.2 * step, 0.08 * step] {
        let slats = [0.0, apart].map(|height| sheet(Vec3::Y, height, step, solid));
        let surfels: Vec<Surfel> = slats.into_iter().flatten().collect();
        let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
        let openness = |height: f32| {
            let receiver = Receiver::diffuse(Vec3::new(0.013, height, -0.031), Vec3::Y);
            gather(&octree, &settings, receiver).ambient_occlusion
        };
        assert!(openness(0.0) < 0.05, "{apart}: {}", openness(0.0));
        assert!(openness(apart) > 0.999, "{apart}: {}", openness(apart));
    }
}

/// Disks of a scanned box, as wide as estimated ones are, reach far over its edges. From a side of it, the ones of the next side are seen
/// from behind, and hide nothing: a convex thing hides no sky from itself. It stands askew, so that nodes rise above the side's plane.
#[test]
fn disks_that_reach_over_a_convex_edge_hide_nothing() {
    let (half, per_edge) = (Vec3::new(0.8, 1.0, 0.6), 20);
    let radius = |s: &Surfel| 2.0 * (s.area * FRAC_1_PI).sqrt();
    let turn = Mat3::from_axis_angle(Vec3::new(1.0, 2.0, -0.7).normalize(), 0.7);
    let outward =
        |s: Surfel| Surfel::new(turn * s.center(), turn * -s.normal(), radius(&s), s.area);
    let room = closed_room(half, per_edge, 0.0, SurfelForm::Disks);
    let surfels: Vec<Surfel> = room.into_iter().map(outward).collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings = GatherSettings { solid_angle_sr: 0.0, ..GatherSettings::default() };
    let step = 2.0 * half / per_edge as f32;
    for [u, v] in [[0.05, 0.05], [0.3, 5.3], [0.5, 0.5], [7.1, 0.2], [1.0, 4.0]] {
        let place = Vec3::new(half.x - u * step.x, half.y, half.z - v * step.z);
        let found = gather(&octree, &settings, Receiver::diffuse(turn * place, turn * Vec3::Y));
        assert!(found.ambient_occlusion > 0.999, "{u} {v}: {}", found.ambient_occlusion);
    }
}

/// A curtain bends from facet to facet. The other side of the next facet reaches over the fold, faces whoever stands on this one, and hides
/// nothing: outside, a drum of cloth is open to half the world.
#[test]
fn folds_of_a_sheet_hide_nothing_from_outside() {
    let facets = 24;
    let step = 2.0 * (PI / facets as f32).tan();
    let outward = |facet: f32| {
        let (sin, cos) = (facet * 2.0 * PI / facets as f32).sin_cos();
        Vec3::new(cos, 0.0, sin)
    };
    let mut surfels = Vec::new();
    for facet in 0..facets {
        let normal = outward(facet as f32);
        for row in -8..=8 {
            let center = normal + row as f32 * step * Vec3::Y;
            for side in [normal, -normal] {
                let surfel = Surfel::new(center, side, 0.5f32.sqrt() * step, step * step);
                surfels.push(surfel.with_flags(SurfelFlags::FRONT_ONLY));
            }
        }
    }
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings = GatherSettings { solid_angle_sr: 0.0, ..GatherSettings::default() };
    for facet in [0.0, 5.0, 11.0] {
        let normal = outward(facet);
        let along = normal.cross(Vec3::Y);
        for [u, v] in [[0.0, 0.0], [0.3, 0.1], [0.45, -0.4], [-0.49, 0.2]] {
            let place = normal + step * (u * along + v * Vec3::Y);
            let outside = gather(&octree, &settings, Receiver::diffuse(place, normal));
            assert!(outside.ambient_occlusion > 0.995, "{u} {v}: {}", outside.ambient_occlusion);
            let inside = gather(&octree, &settings, Receiver::diffuse(place, -normal));
            assert!(inside.ambient_occlusion < 0.3, "{u} {v}: {}", inside.ambient_occlusion);
        }
    }
}

/// With a zero threshold the gather is that of rays against the disks, up to the raster's resolution.
#[test]
fn a_zero_threshold_matches_rays_against_all_disks() {
    let surfels = random_objects(150, 0.06, 7);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings =
        GatherSettings { solid_angle_sr: 0.0, raster_edge: 32, ..GatherSettings::default() };
    let (mut open_error, mut light_error) = (0.0, 0.0);
    for (i, normal) in sphere_directions(12).enumerate() {
        let position = normal * (0.2 + 0.15 * i as f32);
        let found = gather(&octree, &settings, Receiver::diffuse(position, -normal));
        // Surfels that know no rectangle are drawn as disks of their area; these have no neighbors.
        let drawn = |s: &Surfel| s.radius.min((s.area * FRAC_1_PI).sqrt());
        let rays = ray_cast_gather(&surfels, position, -normal, 100_000, drawn);
        open_error += (found.ambient_occlusion - rays.ambient_occlusion).powi(2) / 12.0;
        let light = found.surface_irradiance[0] / rays.surface_irradiance[0] - 1.0;
        light_error += light * light / 12.0;
    }
    assert!(open_error.sqrt() < 0.04, "{}", open_error.sqrt());
    assert!(light_error.sqrt() < 0.15, "{}", light_error.sqrt());
}

/// A coarse cut comes near the exhaustive one, and nearer the finer it is. What nodes do not know is how much of the boxes inside of them hides behind
/// others: of this crowd, whose optical depth is 2, coarse nodes are a tenth too bright.
#[test]
fn error_falls_with_the_threshold() {
    let surfels = random_objects(5000, 0.02, 3);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let error = |solid_angle_sr: f32| {
        let mut sum = 0.0;
        for normal in sphere_directions(30) {
            let receiver = Receiver::diffuse(normal * 1.4, -normal);
            let at = |s: f32| {
                let plain = GatherSettings { raster_edge: 8, ..GatherSettings::default() };
                gather(&octree, &GatherSettings { solid_angle_sr: s, ..plain }, receiver)
            };
            let (found, truth) = (at(solid_angle_sr), at(0.0));
            let relative = found.surface_irradiance[0] / truth.surface_irradiance[0] - 1.0;
            sum += relative * relative;
        }
        (sum / 30.0f32).sqrt()
    };
    let [coarse, usual, fine] = [0.1, 0.04, 0.003].map(error);
    assert!(fine < usual && usual < coarse, "{coarse} {usual} {fine}");
    assert!(coarse < 0.13 && usual < 0.06 && fine < 0.01, "{coarse} {usual} {fine}");
}

/// An uneven ground of disks in shifted rows, cut apart along ragged lines by the boxes of its nodes, is as closed in a cut as it is surfel by
/// surfel: what is missing of a node's section is at its rim, where its neighbors are.
#[test]
fn uneven_ground_is_closed_at_every_threshold() {
    let (count, spacing) = (200usize, 0.25f32);
    let height = |x: f32, z: f32| 0.18 * (0.6 * x).sin() * (0.5 * z).cos();
    let surfels: Vec<Surfel> = (0..count * count)
        .map(|i| {
            let (row, column) = (i / count, i % count);
            let shift = ((row * 37) % 101) as f32 / 101.0;
            let (x, z) =
                ((column as f32 - 100.0 + shift) * spacing, (row as f32 - 100.0) * spacing);
            let slope = |a: f32, b: f32| (a - b) / 0.02;
            let (dx, dz) = (
                slope(height(x + 0.01, z), height(x - 0.01, z)),
                slope(height(x, z + 0.01), height(x, z - 0.01)),
            );
            let normal = Vec3::new(-dx, 1.0, -dz).normalize();
            Surfel::new(Vec3::new(x, height(x, z), z), normal, 1.2 * spacing, spacing * spacing)
        })
        .collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let openness = |solid_angle_sr: f32, receiver: Receiver| {
        let settings = GatherSettings {
            solid_angle_sr,
            importance: ImportanceTerms::OFF,
            ..GatherSettings::default()
        };
        gather(&octree, &settings, receiver).ambient_occlusion
    };
    let receivers: Vec<Receiver> = (0..12)
        .map(|i| {
            let f = |k: usize| ((i * k) % 13) as f32 - 6.0;
            let normal = Vec3::new(0.02 * f(5), -1.0, 0.03 * f(3)).normalize();
            Receiver::diffuse(Vec3::new(f(3), 3.0, f(7)), normal)
        })
        .collect();
    let mean = |solid_angle_sr: f32| {
        receivers.iter().map(|r| openness(solid_angle_sr, *r)).sum::<f32>() / 12.0
    };
    let closed = mean(0.0);
    for solid_angle_sr in [0.1, 0.05, 0.02, 0.01] {
        let excess = mean(solid_angle_sr) - closed;
        assert!(excess.abs() < 0.012, "{solid_angle_sr}: {excess} of {closed}");
    }
}

/// A ledge of two rows of oblong micropolygons, as rectangles, hides what it should, up to their reserve of 2 % per edge and
/// the raster's samples. As disks of the same areas the micropolygons would reach far out of its edges.
#[test]
fn a_ledge_of_rectangles_has_the_form_factor_of_a_rectangle() {
    let normal = Vec3::new(0.1, -1.0, 0.05).normalize();
    let along = normal.cross(Vec3::new(1.0, 0.0, 0.7)).normalize();
    let across = normal.cross(along);
    let piece = |i: i32, j: i32| {
        let at = along * (0.2 * (i as f32 + 0.5)) + across * (0.05 * (j as f32 + 0.5));
        Surfel::new(at, normal, 0.1031, 0.01)
    };
    let pieces = || (-10..10).flat_map(|i| (-1..1).map(move |j| piece(i, j)));
    let occlusion = |surfels: &[Surfel]| {
        let (_folder, octree) = bake_and_open(surfels, &BuildOptions::default());
        let settings =
            GatherSettings { solid_angle_sr: 0.0, raster_edge: 64, ..GatherSettings::default() };
        let receiver = Receiver::diffuse(normal * 0.2, -normal);
        1.0 - gather(&octree, &settings, receiver).ambient_occlusion
    };
    // Half edges over the distance of 0.2; four quarters.
    let (a, b) = (2.0f32 / 0.2, 0.05f32 / 0.2);
    let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
    let exact = 2.0 * FRAC_1_PI * (a / p * (b / p).atan() + b / q * (a / q).atan());
    let tiles: Vec<_> = pieces().map(|s| s.with_tile(along, 4.0)).collect();
    let disks: Vec<_> = pieces().collect();
    let (tiled, round) = (occlusion(&tiles) / exact, occlusion(&disks) / exact);
    assert!((tiled - 1.015).abs() < 0.025, "{tiled}");
    assert!((round - 1.0).abs() > 0.05, "{round}");
}

/// Thin boxes before the walls of a closed room, all of one radiance: wherever one looks, one sees a front. The backs of the boxes lie closely behind their
/// fronts, and closely before the walls, and show nothing.
#[test]
fn thin_boxes_before_walls_take_none_of_their_light() {
    let mut surfels = closed_room(Vec3::splat(2.0), 20, 1.0, SurfelForm::Rectangles);
    for index in 0..6 * 25 {
        let (axis, sign) = (index % 3, if index % 6 < 3 { 1.0 } else { -1.0 });
        let [x, y, z] = [axis, (axis + 1) % 3, (axis + 2) % 3].map(|axis| Vec3::AXES[axis]);
        let place = |i: usize| i as f32 * 0.6 - 1.2;
        let middle = x * (sign * 1.92) + y * place(index / 6 % 5) + z * place(index / 30);
        // 0.02 thick, 0.3 wide.
        let half = x * 0.01 + (y + z) * 0.15;
        let thin = boxed(middle - half, middle + half, 1);
        surfels.extend(thin.iter().map(|surfel| surfel.with_radiance([1.0; 3])));
    }
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for (solid_angle_sr, raster_edge) in [(0.0, 16), (0.0, 8), (0.04, 16), (0.1, 8)] {
        let settings = GatherSettings { solid_angle_sr, raster_edge, ..GatherSettings::default() };
        let sum = mean_radiance_in_room(&octree, &settings);
        assert!((sum - 1.0).abs() < 0.005, "{solid_angle_sr} sr, {raster_edge} texels: {sum}");
    }
}

/// A ball that glows, of radius 1, sends what a disk of its size does, πL/d² at the distance d: its lobes, which lie in planes before each other, take nothing of each
/// other's light.
#[test]
fn lobes_of_a_ball_take_nothing_of_each_others_light() {
    let ball = sphere_directions(2000).map(|normal| {
        let area = 4.0 * PI / 2000.0;
        Surfel::new(normal, normal, (area * FRAC_1_PI).sqrt() * 1.2, area).with_radiance([1.0; 3])
    });
    let (_folder, octree) = bake_and_open(&ball.collect::<Vec<_>>(), &BuildOptions::default());
    for distance in [8.0, 24.0f32] {
        for solid_angle_sr in [0.003, 0.01, 0.04, 0.3] {
            let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
            let mean: f32 = sphere_directions(60)
                .map(|direction| {
                    let receiver = Receiver::diffuse(direction * distance, -direction);
                    let found = gather(&octree, &settings, receiver).surface_irradiance[0];
                    found * distance * distance * FRAC_1_PI / 60.0
                })
                .sum();
            assert!((mean - 1.0).abs() < 0.03, "{distance} {solid_angle_sr}: {mean}");
        }
    }
}

/// A ball of particles that glow, of radius 1 and this optical depth along its diameter; places by a generator of numbers evenly in the ball.
fn glowing_ball(depth: f32, count: usize) -> Vec<Surfel> {
    let mut state = 0x9e37_79b9u32;
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    // Extinction times the ball's volume is the area that all show.
    let area = 2.0 / 3.0 * PI * depth / count as f32;
    let places = std::iter::from_fn(|| Some(Vec3::new(next(), next(), next())));
    let places = places.filter(|place| place.length_squared() < 1.0).take(count);
    places
        .map(|place| {
            let surfel = Surfel::new(place, Vec3::Y, (area * FRAC_1_PI).sqrt(), 2.0 * area);
            surfel.with_flags(SurfelFlags::ISOTROPIC).with_radiance([1.0; 3])
        })
        .collect()
}

/// Particles that glow and hide each other send what a medium does, however many of them a node holds: with the extinction k, radiance is 1 − e^(−k c) along a chord
/// c, and irradiance at the distance d from the middle of a ball of radius 1 is (2π/d²) ∫ (1 − e^(−2k√(1−b²))) b db.
#[test]
fn a_ball_of_glowing_particles_shines_as_a_medium() {
    for (depth, at_most) in [(0.3, 0.033), (1.0, 0.095f32)] {
        let (_folder, octree) =
            bake_and_open(&glowing_ball(depth, 20_000), &BuildOptions::default());
        let integral = 0.5 - (1.0 - (1.0 + depth) * (-depth).exp()) / (depth * depth);
        for distance in [1.5, 4.0, 16.0f32] {
            let right = 2.0 * PI / (distance * distance) * integral;
            for solid_angle_sr in [0.003, 0.04, 0.3] {
                let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
                let mean: f32 = sphere_directions(60)
                    .map(|direction| {
                        let receiver = Receiver::diffuse(direction * distance, -direction);
                        gather(&octree, &settings, receiver).surface_irradiance[0] / right / 60.0
                    })
                    .sum();
                let place = format_args!("depth {depth}, distance {distance}, {solid_angle_sr} sr");
                assert!((mean - 1.0).abs() < at_most, "{place}: {mean}");
            }
        }
    }
}
