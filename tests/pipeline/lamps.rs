//! Lamps, whole and cut by edges, against Lambert's formula.

use crate::support::{bake_and_open, gather};
use pbgi_build::BuildOptions;
use pbgi_cloud::Surfel;
use pbgi_gather::{GatherSettings, Receiver};
use pbgi_math::{DVec3, Vec3};
use pbgi_testkit::hard::{above_horizon, polygon_share, sheet};

/// Irradiance of a polygon of the radiance 1.
fn polygon_irradiance(corners: &[DVec3], receiver: &Receiver) -> f32 {
    let (position, normal) = (receiver.position.as_dvec3(), receiver.normal.as_dvec3());
    (std::f64::consts::PI * polygon_share(corners, position, normal)) as f32
}

/// A lamp of one by 0.7 just before a black wall, as bright as it is by Lambert's formula, however fine raster and cut.
#[test]
fn a_lamp_before_a_wall_has_its_irradiance() {
    let facing = |x: f32, half, counts, radiance| {
        sheet(Vec3::X * x, Vec3::X, Vec3::Z, half, counts, radiance)
    };
    let lamp = facing(0.02, [0.5, 0.35], [50, 35], 1.0);
    let surfels: Vec<Surfel> = lamp.chain(facing(0.0, [2.2, 1.1], [220, 110], 0.0)).collect();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let corner = |y: f64, z: f64| DVec3::new(f64::from(0.02f32), y, z);
    let lamp = [corner(-0.35, -0.5), corner(-0.35, 0.5), corner(0.35, 0.5), corner(0.35, -0.5)];
    let receivers = (0..60).map(|i| {
        let f = |k: usize| ((i * k) % 37) as f32 / 37.0 * 1.8 - 0.9;
        let position = Vec3::new(1.2 + f(5), 1.0 + 0.3 * f(7), 1.2 * f(11));
        Receiver::diffuse(position, Vec3::NEG_Y)
    });
    for raster_edge in [4, 8, 32, 64] {
        for (solid_angle_sr, tolerance) in [(0.08, 0.015), (0.0, 0.001)] {
            let settings =
                GatherSettings { solid_angle_sr, raster_edge, ..GatherSettings::default() };
            let square = |receiver: Receiver| {
                let truth = polygon_irradiance(&lamp, &receiver);
                (gather(&octree, &settings, receiver).surface_irradiance[0] / truth - 1.0).powi(2)
            };
            let rms = (receivers.clone().map(square).sum::<f32>() / 60.0).sqrt();
            assert!(rms < tolerance, "{raster_edge} {solid_angle_sr}: {rms}");
        }
    }
}

/// Two lamps, one red and one blue, over a plate with a straight edge over a floor: in its penumbra the floor has the irradiance of the parts of both that it sees,
/// however coarse raster and cut. By the cube's samples alone the error is 22, 10 and 5 % of a lamp.
#[test]
fn an_edge_cuts_a_lamp_where_it_is() {
    let lamp_at = |x: f32| {
        let center = Vec3::new(x, 3.0, 0.1);
        let corners = [[-0.4, -0.4], [0.4, -0.4], [0.4, 0.4], [-0.4, 0.4]];
        (center, corners.map(|[x, z]| (center + Vec3::new(x, 0.0, z)).as_dvec3()))
    };
    // The plate's edge is turned, so that no row of samples lies along it.
    let (height, turn) = (1.5, 0.3f32);
    let across = Vec3::new(turn.cos(), 0.0, -turn.sin());
    let (middle, half) = (Vec3::Y * height - across * 2.0, [2.0, 4.0]);
    let plate = sheet(middle, Vec3::NEG_Y, across, half, [80, 160], 0.0);
    let floor = sheet(Vec3::ZERO, Vec3::Y, Vec3::X, [6.0; 2], [120; 2], 0.0);
    let mut surfels: Vec<Surfel> = plate.chain(floor).collect();
    let lamps = [(lamp_at(-1.2), 0), (lamp_at(1.2), 2)];
    for ((center, _), channel) in &lamps {
        let mut radiance = [0.0; 3];
        radiance[*channel] = 5.0;
        let lamp = sheet(*center, Vec3::NEG_Y, Vec3::X, [0.4; 2], [16; 2], 1.0);
        surfels.extend(lamp.map(|surfel| surfel.with_radiance(radiance)));
    }
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for (raster_edge, solid_angle_sr, tolerance) in
        [(4, 1.0, 0.012), (8, 0.3, 0.009), (16, 0.04, 0.009)]
    {
        let settings = GatherSettings { solid_angle_sr, raster_edge, ..GatherSettings::default() };
        let (mut square, mut count) = (0.0, 0);
        for i in 0..120 {
            let position = Vec3::new(-2.5 + i as f32 * (5.0 / 120.0), 0.0, 0.3 * (i % 7) as f32);
            let receiver = Receiver::diffuse(position, Vec3::Y);
            let found = gather(&octree, &settings, receiver).surface_irradiance;
            for ((_, corners), channel) in &lamps {
                // A line of sight goes through the plate's height halfway between the two: there, half their sum must be beyond the edge.
                let opposite = -position.as_dvec3();
                let seen = above_horizon(corners, opposite, across.as_dvec3());
                let seen: Vec<DVec3> = seen.iter().map(|corner| opposite + *corner).collect();
                let whole = 5.0 * polygon_irradiance(corners, &receiver);
                let right = 5.0 * polygon_irradiance(&seen, &receiver);
                if (0.001..0.999).contains(&(right / whole)) {
                    square += ((found[*channel] - right) / whole).powi(2);
                    count += 1;
                }
            }
        }
        let rms = (square / count as f32).sqrt();
        assert!(count > 30 && rms < tolerance, "{raster_edge}: {rms} of {count}");
    }
}
