//! The walk over leaves: every surfel once, in the order of the Morton curve.

use crate::support::bake_and_open;
use pbgi_build::BuildOptions;
use pbgi_cloud::Surfel;
use pbgi_math::Vec3;
use pbgi_store::{StoreError, for_each_leaf, try_for_each_leaf};
use pbgi_testkit::{random_objects, sort_in_memory};

#[test]
fn surfels_come_in_the_order_of_the_morton_curve() {
    let mut surfels = random_objects(20_000, 0.02, 3);
    // Many at one place: a list, whose order is that of the input.
    surfels.extend((0..500).map(|i| {
        let normal = Vec3::new(1.0, i as f32 / 500.0, 0.3).normalize();
        Surfel::new(Vec3::splat(0.125), normal, 0.01, 1e-4)
    }));
    let (_, sorted) = sort_in_memory(&surfels);
    for page_bytes in [4096, 65536] {
        let options = BuildOptions { page_bytes, ..BuildOptions::default() };
        let (_folder, octree) = bake_and_open(&surfels, &options);
        let mut next = 0;
        for_each_leaf(&mut octree.reader(), |first, leaf| {
            assert_eq!(first, next);
            for (surfel, (_, expected)) in leaf.iter().zip(&sorted[next as usize..]) {
                assert!((surfel.center - expected.center()).length() < 1e-3);
                assert!(surfel.normal.dot(expected.normal()) > 0.999);
            }
            next += leaf.len() as u64;
        })
        .unwrap();
        assert_eq!(next, surfels.len() as u64);
    }
}

#[test]
fn visitors_can_end_the_walk() {
    #[derive(Debug)]
    enum Stop {
        Wish,
        Store(#[expect(dead_code, reason = "shown if the test fails")] StoreError),
    }
    impl From<StoreError> for Stop {
        fn from(error: StoreError) -> Self {
            Self::Store(error)
        }
    }
    let surfels = random_objects(1000, 0.02, 3);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let mut calls = 0;
    let stopped = try_for_each_leaf(&mut octree.reader(), |_, _| {
        calls += 1;
        if calls == 3 { Err(Stop::Wish) } else { Ok(()) }
    });
    assert!(matches!(stopped, Err(Stop::Wish)), "{stopped:?}");
    assert_eq!(calls, 3);
}
