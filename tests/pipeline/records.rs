//! Receivers that share irradiance records: the same bits whoever shades them, near to what each would gather, and fewer gathers.

use crate::support::{bake, bake_and_open};
use pbgi_build::BuildOptions;
use pbgi_cloud::Surfel;
use pbgi_gather::{GatherSettings, Receiver, Shading};
use pbgi_math::Vec3;
use pbgi_schedule::{
    Feed, KeptRecords, ScheduleError, ShadeOptions, ShadeReport, shade_receivers, shade_stream,
};
use pbgi_store::{Octree, OpenOptions};
use pbgi_testkit::{SurfelForm, closed_room, sphere_directions};
use std::borrow::Cow;
use std::sync::atomic::AtomicBool;

/// What interpolation may be wrong by, here.
const TOLERANCE: f32 = 0.1;

/// A ball of radius 1 that shines.
fn ball() -> Vec<Surfel> {
    const COUNT: u32 = 8_000;
    let area = 4.0 * std::f32::consts::PI / COUNT as f32;
    let radius = 1.5 * (area / std::f32::consts::PI).sqrt();
    let surfel = |d: Vec3| Surfel::new(d, d, radius, area).with_radiance([1.0, 0.5, 0.25]);
    sphere_directions(COUNT).map(surfel).collect()
}

/// A floor of `edge` by `edge` receivers below the ball, in no order.
fn floor(edge: usize) -> Vec<Receiver> {
    let step = 1.2 / edge as f32;
    let place = |i: usize| {
        // 7 and `edge`² have no common divisor.
        let i = i * 7 % (edge * edge);
        Vec3::new((i % edge) as f32 * step - 0.6, -2.0, (i / edge) as f32 * step - 0.6)
    };
    (0..edge * edge).map(|i| Receiver::diffuse(place(i), Vec3::Y)).collect()
}

fn options<'a>(tolerance: f32) -> ShadeOptions<'a> {
    let gather = GatherSettings { tolerance, ..GatherSettings::default() };
    ShadeOptions { gather, ..ShadeOptions::default() }
}

/// Shades in two chunks.
fn shade_in_two(
    octree: &Octree,
    receivers: &[Receiver],
    options: &ShadeOptions<'_>,
    kept: &mut KeptRecords,
) -> (Vec<Shading>, ShadeReport) {
    let mut all = Vec::new();
    let report = shade_stream(
        octree,
        None,
        options,
        kept,
        |feed: &mut Feed<'_, '_, (), ScheduleError>| {
            let mut chunks = receivers.chunks(receivers.len().div_ceil(2));
            chunks.try_for_each(|chunk| feed.push(Cow::Borrowed(chunk), ()))
        },
        |shaded| {
            all.extend(shaded.shadings);
            Ok(())
        },
    );
    (all, report.unwrap())
}

#[test]
fn neither_threads_nor_budget_change_a_bit() {
    let surfels = ball();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(&surfels, &BuildOptions { page_bytes: 4096, ..BuildOptions::default() }, &path);
    let receivers = floor(60);
    let mut expected = None;
    for (threads, cache_bytes, node_bytes) in
        [(1, 64 << 20, 1 << 30), (3, 500 << 10, 0), (2, 64 << 20, 100_000)]
    {
        let open = OpenOptions { cache_bytes, readers: 4, ..OpenOptions::default() };
        let octree = Octree::open(&path, &open).unwrap();
        let mut options = ShadeOptions { threads, ..options(TOLERANCE) };
        options.gather.node_bytes = node_bytes;
        let found = shade_in_two(&octree, &receivers, &options, &mut KeptRecords::default());
        let (shadings, report) = expected.get_or_insert_with(|| found.clone());
        assert!(found.0 == *shadings, "{threads}");
        assert_eq!(found.1.cut_sizes, report.cut_sizes, "{threads}");
    }
}

/// Openness of all receivers interpolated and gathered, relative to the value and a tenth of the mean.
#[test]
fn what_is_interpolated_is_near_what_is_gathered() {
    let surfels = ball();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let receivers = floor(60);
    let shade =
        |tolerance| shade_receivers(&octree, None, &receivers, &options(tolerance)).unwrap();
    let (alone, _) = shade(0.0);
    let mean = alone.iter().map(|s| s.ambient_occlusion).sum::<f32>() / alone.len() as f32;
    assert!(mean < 0.95, "the ball hides something: {mean}");
    let mut gathers = u64::MAX;
    for tolerance in [0.02, TOLERANCE] {
        let (shared, report) = shade(tolerance);
        assert_eq!(report.receivers, receivers.len() as u64);
        assert!(report.cut_sizes.count < gathers, "{tolerance}: {}", report.cut_sizes.count);
        gathers = report.cut_sizes.count;
        let errors = shared.iter().zip(&alone).map(|(shared, alone)| {
            let difference = shared.ambient_occlusion - alone.ambient_occlusion;
            difference.abs() / (alone.ambient_occlusion + 0.1 * mean)
        });
        let (mut squares, mut largest) = (0.0, 0.0f32);
        for error in errors {
            squares += error * error;
            largest = largest.max(error);
        }
        let rms = (squares / alone.len() as f32).sqrt();
        // An expected error is what an extrapolation is off by where all went wrong; the mean is far below.
        assert!(rms < 0.2 * tolerance + 0.002 && largest < tolerance, "{rms} {largest}");
        let mut bent = shared.iter().zip(&alone).map(|(s, a)| s.bent_normal.dot(a.bent_normal));
        assert!(bent.all(|cosine| cosine > 0.98));
    }
    // Twice as many with gradients of the other sign, as records then disagree.
    assert!(gathers < receivers.len() as u64 / 16, "{gathers}");
}

/// A floor that goes on below the walls of a closed room: inside, nothing changes wherever one goes, and outside it is bright.
#[test]
fn records_do_not_serve_behind_walls() {
    let surfels = closed_room(Vec3::ONE, 40, 0.0, SurfelForm::Rectangles);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let place = |i: usize| {
        let [x, z] = [i % 40, i / 40].map(|i| (i as f32 + 0.5) * 0.1 - 2.0);
        Vec3::new(x, -0.999, z)
    };
    let receivers: Vec<Receiver> =
        (0..1600).map(|i| Receiver::diffuse(place(i), Vec3::Y)).collect();
    let shade =
        |tolerance| shade_receivers(&octree, None, &receivers, &options(tolerance)).unwrap();
    let ((shared, report), (alone, _)) = (shade(TOLERANCE), shade(0.0));
    assert!(report.cut_sizes.count < receivers.len() as u64 / 2, "{}", report.cut_sizes.count);
    for (receiver, (shared, alone)) in receivers.iter().zip(shared.iter().zip(&alone)) {
        let error = shared.ambient_occlusion - alone.ambient_occlusion;
        assert!(error.abs() < TOLERANCE, "{}: {error}", receiver.position);
    }
}

/// A floor whose normals swing as those of ripples do.
#[test]
fn normals_that_turn_are_followed() {
    let (_folder, octree) = bake_and_open(&ball(), &BuildOptions::default());
    let ripple = |mut receiver: Receiver| {
        let slope = 0.2 * (12.0 * receiver.position.x).sin();
        receiver.normal = Vec3::new(slope, 1.0, 0.0).normalize();
        receiver
    };
    let receivers: Vec<Receiver> = floor(40).into_iter().map(ripple).collect();
    let shade =
        |tolerance| shade_receivers(&octree, None, &receivers, &options(tolerance)).unwrap();
    let ((shared, report), (alone, _)) = (shade(TOLERANCE), shade(0.0));
    let errors = shared
        .iter()
        .zip(&alone)
        .map(|(s, a)| (s.surface_irradiance[0] / a.surface_irradiance[0] - 1.0).abs());
    let largest = errors.fold(0.0, f32::max);
    assert!(largest < 0.3 * TOLERANCE, "{largest}");
    assert!(report.cut_sizes.count < receivers.len() as u64 / 4, "{}", report.cut_sizes.count);
}

#[test]
fn one_receiver_gathers_for_itself() {
    let surfels = ball();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    for receiver in floor(3) {
        let shade = |tolerance| {
            let (shadings, _) =
                shade_receivers(&octree, None, &[receiver], &options(tolerance)).unwrap();
            Shading { cut_size: 0, ..shadings[0] }
        };
        let (shared, alone) = (shade(TOLERANCE), shade(0.0));
        assert!(shared.bent_normal.distance(alone.bent_normal) < 1e-6);
        // A mean of one, but for its normalization.
        assert_eq!(Shading { bent_normal: alone.bent_normal, ..shared }, alone);
    }
    let (none, report) = shade_receivers(&octree, None, &[], &options(TOLERANCE)).unwrap();
    assert!(none.is_empty() && report.receivers == 0);
}

#[test]
fn records_serve_the_chunks_that_follow() {
    let surfels = ball();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let receivers = floor(40);
    let gathers = |kept: &mut KeptRecords| {
        shade_in_two(&octree, &receivers, &options(TOLERANCE), kept).1.cut_sizes.count
    };
    let mut kept = KeptRecords::default();
    let first = gathers(&mut kept);
    let second = gathers(&mut kept);
    // All that remains are the receivers whose mean tells what is dark, and those that records left disagree about.
    assert!(second < first * 2 / 3, "{first} {second}");
}

/// Records left by a chunk that saw next to nothing reach over the next one, below a ball: they do not serve where its own records tell otherwise.
#[test]
fn records_give_way_where_those_of_other_chunks_disagree() {
    let (_folder, below_ball) = bake_and_open(&ball(), &BuildOptions::default());
    let bead = |mut surfel: Surfel| {
        surfel.position = surfel.position.map(|x| 0.05 * x);
        (surfel.radius, surfel.area) = (0.05 * surfel.radius, 0.0025 * surfel.area);
        surfel
    };
    let beads: Vec<Surfel> = ball().into_iter().map(bead).collect();
    let (_folder, below_bead) = bake_and_open(&beads, &BuildOptions::default());
    let is_left = |receiver: &Receiver| receiver.position.x < 0.0;
    let (left, right): (Vec<Receiver>, Vec<Receiver>) = floor(60).into_iter().partition(is_left);
    let options = options(TOLERANCE);
    let mut kept = KeptRecords::default();
    shade_in_two(&below_bead, &left, &options, &mut kept);
    let (shared, _) = shade_in_two(&below_ball, &right, &options, &mut kept);
    let (alone, _) = shade_receivers(&below_ball, None, &right, &self::options(0.0)).unwrap();
    let errors = shared.iter().zip(&alone).map(|(shared, alone)| {
        (shared.ambient_occlusion - alone.ambient_occlusion).abs() / alone.ambient_occlusion
    });
    let wrong = errors.filter(|error| *error > TOLERANCE).count();
    // Along the border, where records of both are near; where none gave way, all would be.
    assert!(wrong < right.len() / 50, "{wrong} of {}", right.len());
}

#[test]
fn sharing_stops_when_asked_to() {
    let surfels = ball();
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let cancel = AtomicBool::new(true);
    let options = ShadeOptions { cancel: &cancel, ..options(TOLERANCE) };
    let ended = shade_receivers(&octree, None, &floor(10), &options);
    assert!(matches!(ended, Err(ScheduleError::Cancelled)));
}
