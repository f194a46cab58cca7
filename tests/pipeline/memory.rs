//! What a gatherer holds, by what its thread allocates.

use crate::support::bake_and_open;
use pbgi_build::BuildOptions;
use pbgi_gather::{
    GatherSettings, Gatherer, Gloss, LOBE_LEVEL_MAX, Material, Receiver, Tolerance, gatherer_bytes,
};
use pbgi_math::Vec3;
use pbgi_store::Octree;
use pbgi_testkit::random_objects;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    /// Bytes that the thread allocated and did not free, and the most there were.
    static HELD: Cell<(isize, isize)> = const { Cell::new((0, 0)) };
}

fn add(bytes: isize) {
    // None while the thread ends.
    let _ = HELD.try_with(|held| {
        let now = held.get().0 + bytes;
        held.set((now, held.get().1.max(now)));
    });
}

struct Counted;

#[global_allocator]
static COUNTED: Counted = Counted;

#[expect(unsafe_code, reason = "an allocator that counts stands before the system's")]
// SAFETY: every call is passed on to the system's allocator with the arguments it came with.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        add(layout.size() as isize);
        // SAFETY: the caller's promises are those of this function.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        add(-(layout.size() as isize));
        // SAFETY: the caller's promises are those of this function, and `pointer` came from the system's allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// The most bytes that `work` holds at a time beyond what there were.
fn peak_bytes(work: impl FnOnce()) -> usize {
    let before = HELD.get().0;
    HELD.set((before, before));
    work();
    (HELD.get().1 - before) as usize
}

/// A gatherer holds no more than it says, whatever its raster: with light, glossy reflections, records and surfel by surfel, of large things and of many.
#[test]
fn gatherers_hold_what_they_say() {
    for objects in [random_objects(2000, 2.0, 7), random_objects(20_000, 0.02, 7)] {
        let (_folder, octree) = bake_and_open(&objects, &BuildOptions::default());
        for raster_edge in [1, 6, 16, 17, 64] {
            let (peak, said) = (
                peak_of_gatherer(&octree, raster_edge),
                gatherer_bytes(raster_edge, LOBE_LEVEL_MAX),
            );
            println!("{raster_edge}: {peak} of {said}");
            assert!(peak <= said, "{raster_edge}: {peak} of {said}");
        }
    }
}

/// The most bytes that a gatherer holds that does all it can for some receivers, one surfel after the other.
fn peak_of_gatherer(octree: &Octree, raster_edge: usize) -> usize {
    let settings = GatherSettings {
        raster_edge,
        solid_angle_sr: 0.0,
        lobe_level: LOBE_LEVEL_MAX,
        tolerance: 0.1,
        finds_backs: true,
        node_bytes: 0,
        ..GatherSettings::default()
    };
    let tolerance = Tolerance::new(0.1, &[]);
    let material = Material { metalness: 1.0, ..Material::default() };
    let gloss = Some(Gloss { material, toward_eye: Vec3::Y });
    peak_bytes(|| {
        let mut gatherer = Gatherer::new(octree.reader(), &settings, None);
        for at in 0..40 {
            let position = Vec3::new(at as f32 * 0.07 - 1.4, 0.02, 0.3);
            let receiver = Receiver { gloss, ..Receiver::diffuse(position, Vec3::Y) };
            gatherer.gather(&receiver).unwrap();
            gatherer.record(&receiver, &tolerance).unwrap();
        }
    })
}
