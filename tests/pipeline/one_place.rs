//! Many surfels at one place: they show what few of them show, and take about as long.

use crate::support::bake_and_open;
use pbgi_build::BuildOptions;
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{GatherSettings, Gatherer, Receiver, Shading};
use pbgi_math::Vec3;

/// What receivers below, above, beside and on a place get from surfels there, and how many surfels were drawn for each at most.
fn shade(surfels: &[Surfel], solid_angle_sr: f32) -> (Vec<Shading>, u64) {
    // Far away, so that the root is divided down to the place.
    let crumb = Surfel::new(Vec3::new(0.0, 40.0, 90.0), Vec3::Y, 1e-3, 1e-6);
    let surfels: Vec<Surfel> = surfels.iter().copied().chain([crumb]).collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let settings = GatherSettings { solid_angle_sr, ..GatherSettings::default() };
    let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
    let mut drawn_max = 0;
    let places = [
        (Vec3::new(0.25, 0.0, 0.25), Vec3::Y),
        (Vec3::new(0.25, 2.0, 0.25), Vec3::NEG_Y),
        (Vec3::new(1.4, 0.7, 0.2), Vec3::NEG_X),
        (Vec3::new(0.3, 0.9, 0.2), Vec3::Y),
        (Vec3::new(0.3, 1.0, 0.2), Vec3::NEG_Y),
    ];
    let shade = |(position, normal)| {
        let before = gatherer.stats().surfels;
        let found = gatherer.gather(&Receiver::diffuse(position, normal)).unwrap();
        drawn_max = drawn_max.max(gatherer.stats().surfels - before);
        Shading { cut_size: 0, ..found }
    };
    (places.map(shade).to_vec(), drawn_max)
}

fn disk(normal: Vec3, radiance: f32) -> Surfel {
    let radius = 0.5f32;
    let area = std::f32::consts::PI * radius * radius;
    Surfel::new(Vec3::new(0.25, 1.0, 0.25), normal, radius, area).with_radiance([radiance; 3])
}

/// Samples are placed anew for every surfel: what shows is the same within half of one along an outline, 1 %.
fn assert_near(found: &[Shading], expected: &[Shading]) {
    for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
        let pairs = [
            (found.surface_irradiance[0], expected.surface_irradiance[0]),
            (found.ambient_occlusion, expected.ambient_occlusion),
        ];
        for (found, expected) in pairs {
            let error = (found - expected).abs();
            assert!(error <= 0.01 * expected.max(0.1), "{index}: {found}, expected {expected}");
        }
    }
}

#[test]
fn equal_surfels_at_one_place_show_what_one_shows_and_most_are_not_drawn() {
    for solid_angle_sr in [0.0, GatherSettings::default().solid_angle_sr] {
        let (one, _) = shade(&[disk(Vec3::NEG_Y, 1.0)], solid_angle_sr);
        assert!(one[0].surface_irradiance[0] > 0.6);
        for count in [17, 1000, 20_000] {
            let (many, drawn) = shade(&vec![disk(Vec3::NEG_Y, 1.0); count], solid_angle_sr);
            assert_near(&many, &one);
            assert!(drawn <= 200, "{drawn} of {count} are drawn at {solid_angle_sr}");
        }
    }
}

/// Surfels that differ are not behind each other, though they are at one place: thousands that face down, then thousands that face up.
#[test]
fn surfels_at_one_place_that_face_two_ways_are_seen_from_both() {
    for solid_angle_sr in [0.0, GatherSettings::default().solid_angle_sr] {
        let pair = [disk(Vec3::NEG_Y, 1.0), disk(Vec3::Y, 5.0)];
        let pair = pair.map(|disk| disk.with_flags(SurfelFlags::FRONT_ONLY));
        let (two, _) = shade(&pair, solid_angle_sr);
        let many: Vec<Surfel> = (0..8000).map(|i| pair[i / 4000]).collect();
        let (many, drawn) = shade(&many, solid_angle_sr);
        assert!(drawn < 400, "{drawn} are drawn at {solid_angle_sr}");
        assert_near(&many, &two);
    }
}
