//! Surfaces that stick in others, as things that are put together from parts have them.

use crate::support::{bake_and_open, boxed, mean_radiance_in_room};
use pbgi_bounce::light_on_surfels;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{GatherSettings, Gatherer, PreparedLight, Receiver};
use pbgi_image::RgbImage;
use pbgi_light::{Environment, EnvironmentOptions};
use pbgi_math::Vec3;
use pbgi_schedule::ShadeOptions;
use pbgi_testkit::{SurfelForm, closed_room};
use std::f32::consts::PI;

/// The upper side of a ledge, whose center lies in its wall, is lit as the strip of it before the wall is, and what is wholly in the wall is known to be.
#[test]
fn ledges_are_lit_as_what_stands_out_of_their_walls() {
    let wall = boxed(Vec3::new(-4.0, -4.0, -2.0), Vec3::new(4.0, 4.0, 0.0), 16);
    let ledge = boxed(Vec3::new(-0.6, -0.1, -0.6), Vec3::new(0.6, 0.0, 0.4), 1);
    let (top, rear) = (ledge[1], ledge[5]);
    assert_eq!((top.normal(), rear.normal()), (Vec3::Y, Vec3::NEG_Z));
    assert!(top.center().z < 0.0);
    let surfels = [wall, ledge].concat();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let image = RgbImage { width: 8, height: 4, pixels: vec![[1.0; 3]; 32] };
    let sky = Environment::from_image(image, EnvironmentOptions::default()).unwrap();
    for (solid_angle_sr, raster_edge) in [(0.2, 6), (0.04, 16)] {
        let gather = GatherSettings { solid_angle_sr, raster_edge, ..GatherSettings::default() };
        let light = PreparedLight::new(&sky, raster_edge);
        let options = ShadeOptions { gather, ..ShadeOptions::default() };
        let found =
            light_on_surfels(&octree, Some(&light), &[&top, &rear, &surfels[0]], &options).unwrap();
        // In the middle of the strip, 0.2 before a wall that is as good as infinite.
        let mut gatherer = Gatherer::new(octree.reader(), &gather, Some(&light));
        let strip = Receiver::diffuse(Vec3::new(0.0, 0.0, 0.2), Vec3::Y);
        let expected = gatherer.gather(&strip).unwrap().irradiance()[0];
        assert!((expected / PI - 0.5).abs() < 0.05, "{expected}");
        assert!((found[0].irradiance[0] / expected - 1.0).abs() < 0.05, "{found:?}");
        let buried: Vec<bool> = found.iter().map(|light| light.is_buried).collect();
        assert_eq!(buried, [false, true, false], "{found:?}");
    }
}

/// Below a roof that has no ceiling, backs fill most of the hemisphere, and what lies there is seen all the same.
#[test]
fn what_lies_below_a_roof_without_a_ceiling_is_not_buried() {
    let tile = |center: Vec3, normal: Vec3, half: f32| {
        Surfel::new(center, normal, half * 2f32.sqrt(), 4.0 * half * half).with_tile(Vec3::X, 1.0)
    };
    let floor = tile(Vec3::ZERO, Vec3::Y, 0.5);
    let roof = (0..36).map(|i| {
        let [x, z] = [i % 6, i / 6].map(|place| place as f32 - 2.5);
        tile(Vec3::new(x, 1.0, z), Vec3::Y, 0.5)
    });
    let surfels: Vec<Surfel> = roof.chain([floor]).collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let gather =
        GatherSettings { solid_angle_sr: 0.2, raster_edge: 6, ..GatherSettings::default() };
    let settings = GatherSettings { finds_backs: true, ..gather };
    let receiver = Receiver::diffuse(floor.center(), floor.normal());
    let found = Gatherer::new(octree.reader(), &settings, None).gather(&receiver).unwrap();
    // The face of the cube overhead, and of the upper half of four others two thirds: seven ninths of what is over the horizon.
    assert!((found.backs - 7.0 / 9.0).abs() < 0.01, "{found:?}");
    let options = ShadeOptions { gather, ..ShadeOptions::default() };
    let found = light_on_surfels(&octree, None, &[&floor], &options).unwrap();
    assert!(!found[0].is_buried);
}

/// A room of radiance 1 with black things in its walls, close behind their surface and parallel to it: where each surfel is looked at for itself, none shows;
/// where nodes are, they must know.
#[test]
fn things_in_walls_do_not_darken_them() {
    let room = closed_room(Vec3::splat(2.0), 20, 1.0, SurfelForm::Rectangles);
    for flags in [SurfelFlags::default(), SurfelFlags::BURIED] {
        let mut surfels = room.clone();
        for wall in room.iter().step_by(2) {
            // As large as four of the wall's.
            let depth = 0.02 + 0.03 * (wall.center().length() * 7.0).fract();
            let hidden = Surfel::new(
                wall.center() - wall.normal() * depth,
                wall.normal(),
                2.0 * wall.radius,
                4.0 * wall.area,
            );
            let along = wall.half_edges().unwrap()[0];
            surfels.push(hidden.with_tile(along, 1.0).with_flags(flags));
        }
        let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
        for (solid_angle_sr, raster_edge) in [(0.0, 16), (0.0, 8), (0.04, 16), (0.2, 6)] {
            if solid_angle_sr > 0.0 && flags == SurfelFlags::default() {
                continue;
            }
            let settings =
                GatherSettings { solid_angle_sr, raster_edge, ..GatherSettings::default() };
            let sum = mean_radiance_in_room(&octree, &settings);
            assert!((sum - 1.0).abs() < 0.002, "{solid_angle_sr} sr, {raster_edge}: {sum}");
        }
    }
}
