//! Receivers as a stream: the same bits however they come, bounded chunks, and every way it can end.

use crate::support::{bake, bake_and_open};
use pbgi_build::BuildOptions;
use pbgi_gather::{CutStats, GatherSettings, Gatherer, Receiver, Shading};
use pbgi_math::Vec3;
use pbgi_schedule::{
    CHUNKS_IN_FLIGHT, Feed, KeptRecords, ReceiverOrder, ScheduleError, ShadeOptions, ShadeReport,
    shade_receivers, shade_stream,
};
use pbgi_store::{Octree, OpenOptions};
use pbgi_testkit::random_objects;
use std::borrow::Cow;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

/// Receivers strewn over the cube of the objects, in no order.
fn receivers(count: usize) -> Vec<Receiver> {
    let place = |i: usize| {
        let part = |factor: f32| (i as f32 * factor).fract() * 1.6 - 0.8;
        Vec3::new(part(0.618_034), part(0.754_878), part(0.569_84))
    };
    let normals = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
    (0..count).map(|i| Receiver::diffuse(place(i), normals[i % 6])).collect()
}

/// Shades in chunks of a size.
fn shade_in_chunks(
    octree: &Octree,
    receivers: &[Receiver],
    chunk: usize,
    options: &ShadeOptions<'_>,
) -> Vec<Shading> {
    let mut all = Vec::new();
    let mut next = 0;
    let report = shade_stream(
        octree,
        None,
        options,
        &mut KeptRecords::default(),
        |feed: &mut Feed<'_, '_, usize, ScheduleError>| {
            let chunks = receivers.chunks(chunk).enumerate();
            chunks.into_iter().try_for_each(|(i, part)| feed.push(Cow::Borrowed(part), i))
        },
        |shaded| {
            assert_eq!(shaded.attached, next);
            next += 1;
            all.extend(shaded.shadings);
            Ok(())
        },
    );
    let report = report.unwrap();
    assert_eq!(report.receivers, receivers.len() as u64);
    assert_eq!(report.cut_sizes.sum, all.iter().map(|s| u64::from(s.cut_size)).sum::<u64>());
    all
}

#[test]
fn neither_budget_nor_order_nor_threads_nor_chunks_change_a_bit() {
    let surfels = random_objects(20_000, 0.02, 3);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(&surfels, &BuildOptions { page_bytes: 4096, ..BuildOptions::default() }, &path);
    let receivers = receivers(400);
    let mut expected = None;
    for cache_bytes in [500 << 10, 64 << 20] {
        let options = OpenOptions { cache_bytes, readers: 4, ..OpenOptions::default() };
        let octree = Octree::open(&path, &options).unwrap();
        for (threads, chunk) in [(1, 2000), (3, 100), (2, 777)] {
            for order in [ReceiverOrder::Morton, ReceiverOrder::AsGiven] {
                let options = ShadeOptions { threads, order, ..ShadeOptions::default() };
                let found = shade_in_chunks(&octree, &receivers, chunk, &options);
                assert!(found == *expected.get_or_insert_with(|| found.clone()));
            }
        }
        let dropped = octree.stats().evictions;
        assert_eq!(dropped > 0, cache_bytes < 1 << 20, "{dropped} pages dropped");
    }
}

/// What of the octree is decoded already, all of it or nothing at all, changes no bit, and only how often pages are asked for.
#[test]
fn nodes_that_are_kept_change_only_requests() {
    let surfels = random_objects(20_000, 0.02, 3);
    let options = BuildOptions { page_bytes: 4096, ..BuildOptions::default() };
    let (_folder, octree) = bake_and_open(&surfels, &options);
    let receivers = receivers(60);
    let shade = |node_bytes, solid_angle_sr| {
        let gather = GatherSettings { node_bytes, solid_angle_sr, ..GatherSettings::default() };
        let options = ShadeOptions { gather, ..ShadeOptions::default() };
        shade_receivers(&octree, None, &receivers, &options).unwrap()
    };
    for solid_angle_sr in [0.05, 0.0] {
        let (all, many) = shade(1 << 30, solid_angle_sr);
        let requests = |report: &ShadeReport| -> u64 {
            report.cut.levels.iter().map(|level| level.requests).sum()
        };
        for node_bytes in [0, 10_000, 100_000] {
            let (found, report) = shade(node_bytes, solid_angle_sr);
            assert!(found == all, "{node_bytes}");
            let counts =
                |report: &ShadeReport| CutStats { levels: Default::default(), ..report.cut };
            assert_eq!(counts(&report), counts(&many));
            assert!(requests(&report) > 2 * requests(&many), "{node_bytes}");
        }
    }
}

#[test]
fn requests_by_level_are_those_of_all_readers() {
    let surfels = random_objects(20_000, 0.02, 3);
    let options = BuildOptions { page_bytes: 4096, ..BuildOptions::default() };
    let (_folder, octree) = bake_and_open(&surfels, &options);
    let (_, report) =
        shade_receivers(&octree, None, &receivers(300), &ShadeOptions::default()).unwrap();
    let stats = octree.stats();
    let levels = &report.cut.levels;
    // Every gatherer asks for the root once more, and for its lobes, for what importance weighs brightness by.
    let requests: u64 = levels.iter().map(|level| level.requests).sum();
    assert!(requests <= stats.requests && stats.requests <= requests + 3);
    let bytes_read: u64 = levels.iter().map(|level| level.bytes_read).sum();
    assert!(bytes_read > 0 && bytes_read <= stats.bytes_read);
    assert!(levels.iter().filter(|level| level.misses > 0).count() >= 3);
}

#[test]
fn no_more_than_a_few_chunks_are_under_way() {
    let (_folder, octree) = bake_and_open(&random_objects(500, 0.02, 3), &BuildOptions::default());
    let (pushed, taken) = (Cell::new(0), Cell::new(0));
    let receivers = receivers(64);
    shade_stream(
        &octree,
        None,
        &ShadeOptions { threads: 2, ..ShadeOptions::default() },
        &mut KeptRecords::default(),
        |feed: &mut Feed<'_, '_, (), ScheduleError>| {
            for _ in 0..20 {
                feed.push(Cow::Borrowed(&receivers), ())?;
                pushed.set(pushed.get() + 1);
                assert!(pushed.get() - taken.get() <= CHUNKS_IN_FLIGHT);
            }
            Ok(())
        },
        |_| {
            taken.set(taken.get() + 1);
            Ok(())
        },
    )
    .unwrap();
    assert_eq!(taken.get(), 20);
}

#[test]
fn streams_end_with_what_went_wrong() {
    let (_folder, octree) = bake_and_open(&random_objects(500, 0.02, 3), &BuildOptions::default());
    let all = receivers(1000);
    let run = |cancel: &AtomicBool, bad: Option<usize>, take_fails: bool| {
        let mut receivers = all.clone();
        if let Some(bad) = bad {
            receivers[bad].normal = Vec3::ZERO;
        }
        let options = ShadeOptions { threads: 2, cancel, ..ShadeOptions::default() };
        let ended = shade_stream(
            &octree,
            None,
            &options,
            &mut KeptRecords::default(),
            |feed: &mut Feed<'_, '_, (), ScheduleError>| {
                let mut chunks = receivers.chunks(100);
                chunks.try_for_each(|chunk| feed.push(Cow::Owned(chunk.to_vec()), ()))
            },
            |_| if take_fails { Err(ScheduleError::Cancelled) } else { Ok(()) },
        );
        ended.map(|report| report.receivers).map_err(|error| error.to_string())
    };
    let never = AtomicBool::new(false);
    assert_eq!(run(&never, None, false), Ok(1000));
    assert!(run(&never, Some(765), false).unwrap_err().contains("receiver 765"));
    assert_eq!(run(&never, None, true), Err("interrupted".to_owned()));
    let cancel = AtomicBool::new(false);
    cancel.store(true, Ordering::Relaxed);
    assert_eq!(run(&cancel, None, false), Err("interrupted".to_owned()));
}

/// A receiver that comes again and again, between others whose nodes do not fit, asks for no page again: what was walked last is kept.
#[test]
fn what_was_walked_last_is_kept() {
    let surfels = random_objects(20_000, 0.02, 3);
    let options = BuildOptions { page_bytes: 4096, ..BuildOptions::default() };
    let (_folder, octree) = bake_and_open(&surfels, &options);
    let settings =
        GatherSettings { node_bytes: 8 << 20, solid_angle_sr: 0.05, ..GatherSettings::default() };
    let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
    let mut requests_of = |receiver: &Receiver| {
        let count = |stats: CutStats| stats.levels.iter().map(|l| l.requests).sum::<u64>();
        let before = count(gatherer.stats());
        gatherer.gather(receiver).unwrap();
        count(gatherer.stats()) - before
    };
    let receivers = receivers(200);
    let (first, others) = receivers.split_first().unwrap();
    assert!(requests_of(first) > 0);
    let mut asked = 0;
    for other in others {
        asked += requests_of(other);
        assert_eq!(requests_of(first), 0);
    }
    println!("{asked} requests of the others");
    assert!(asked > 1000, "{asked} requests of the others");
}
