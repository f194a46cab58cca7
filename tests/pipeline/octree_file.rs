//! The octree file: what is in it, that it is the same for every way of making it, and that damage is named.

use crate::support::{bake, bake_and_open, stream};
use pbgi_build::{BuildOptions, SortedStream, StreamError, build_octree};
use pbgi_cloud::Surfel;
use pbgi_math::{MortonCode, Vec3};
use pbgi_store::{Backend, Octree, OpenOptions, StoreError};
use pbgi_testkit::{SurfelForm, closed_room, random_objects};

#[test]
fn every_surfel_is_in_the_file_exactly_once() {
    for (count, leaf_surfels_max, page_bytes) in
        [(1, 16, 65536), (16, 16, 65536), (17, 16, 65536), (5000, 4, 4096), (20_000, 16, 16384)]
    {
        let mut surfels = random_objects(count, 0.02, 11);
        surfels.truncate(count);
        let options = BuildOptions { leaf_surfels_max, page_bytes, ..BuildOptions::default() };
        let (_folder, octree) = bake_and_open(&surfels, &options);
        let report = octree.verify(2, |_| {}).unwrap();
        let total: u64 = report.levels.iter().map(|l| l.surfels).sum();
        assert_eq!(total, count as u64);
        assert!(octree.header().page_bytes_max as usize <= page_bytes);
        let area: f64 = surfels.iter().map(|s| f64::from(s.area)).sum();
        assert!((octree.header().area_total / area - 1.0).abs() < 1e-9);
    }
}

#[test]
fn neither_chunks_nor_threads_change_a_byte() {
    let mut surfels = random_objects(10_000, 0.02, 5);
    // More at one place than a leaf holds.
    surfels.extend([Surfel::new(Vec3::splat(0.3), Vec3::Y, 0.01, 1e-4); 100]);
    let folder = tempfile::tempdir().unwrap();
    let mut files = Vec::new();
    for (chunk, threads) in [(1, 1), (333, 1), (100_000, 1), (1, 2), (100_000, 2)] {
        let path = folder.path().join(format!("{chunk}-{threads}.pbgi"));
        let (mut stream, summary) = stream(&surfels, chunk);
        let options = BuildOptions { threads, ..BuildOptions::default() };
        build_octree(&mut stream, &summary, &options, &path).unwrap();
        files.push(std::fs::read(path).unwrap());
    }
    assert!(files.iter().all(|file| *file == files[0]));
}

/// Gives surfels in the order of their codes, but for two; or fails after some.
struct Broken {
    surfels: Vec<(MortonCode, Surfel)>,
    fails: bool,
}

impl SortedStream for Broken {
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError> {
        if self.surfels.is_empty() && self.fails {
            return Err("the disk is gone".into());
        }
        out.append(&mut self.surfels);
        Ok(false)
    }
}

#[test]
fn streams_that_fail_or_are_not_in_order_leave_nothing() {
    let all = random_objects(2000, 0.02, 5);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.pbgi");
    for threads in [1, 2] {
        for (fails, expected) in [(false, "surfel 1500 is out of Morton order"), (true, "is gone")]
        {
            let (mut whole, summary) = stream(&all, usize::MAX);
            let mut surfels = Vec::new();
            whole.read_chunk(&mut surfels).unwrap();
            if fails {
                surfels.clear();
            } else {
                surfels.swap(1500, 0);
                surfels[0] = surfels[1];
            }
            let options = BuildOptions { threads, ..BuildOptions::default() };
            let error = build_octree(&mut Broken { surfels, fails }, &summary, &options, &path);
            let message = error.unwrap_err().to_string();
            assert!(message.contains(expected), "{threads}: {message}");
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        }
    }
}

#[test]
fn a_hundred_thousand_surfels_at_one_place_bake() {
    let mut surfels = vec![Surfel::new(Vec3::splat(0.25), Vec3::Y, 0.01, 1e-4); 100_000];
    surfels.extend(random_objects(100, 0.02, 1));
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let report = octree.verify(2, |_| {}).unwrap();
    assert_eq!(report.levels.iter().map(|l| l.surfels).sum::<u64>(), surfels.len() as u64);
}

#[test]
fn both_backends_and_compression_give_the_same_pages() {
    let surfels = closed_room(Vec3::ONE, 30, 1.0, SurfelForm::Disks);
    let folder = tempfile::tempdir().unwrap();
    let mut reports = Vec::new();
    for compress in [false, true] {
        let path = folder.path().join(format!("{compress}.pbgi"));
        bake(&surfels, &BuildOptions { compress, ..BuildOptions::default() }, &path);
        for backend in [Backend::Map, Backend::Read] {
            let options = OpenOptions { backend, ..OpenOptions::default() };
            let octree = Octree::open(&path, &options).unwrap();
            let mut report = octree.verify(2, |_| {}).unwrap();
            assert!(!compress || octree.pages().iter().any(|p| p.is_compressed()));
            report.bytes_read = 0;
            reports.push(report);
        }
    }
    assert!(reports.windows(2).all(|pair| pair[0] == pair[1]));
}

/// Each flipped byte is noticed: in the header and page table when opening, in a page by its checksum.
#[test]
fn damage_anywhere_is_named() {
    let surfels = random_objects(300, 0.02, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(&surfels, &BuildOptions::default(), &path);
    let good = std::fs::read(&path).unwrap();
    let pages: Vec<_> = {
        let octree = Octree::open(&path, &OpenOptions::default()).unwrap();
        octree
            .pages()
            .iter()
            .map(|p| p.offset as usize..(p.offset + u64::from(p.stored_bytes)) as usize)
            .collect()
    };
    let damaged = folder.path().join("damaged.pbgi");
    for at in (0..good.len()).step_by(13).chain(0..256) {
        let mut bytes = good.clone();
        bytes[at] ^= 0x10;
        std::fs::write(&damaged, bytes).unwrap();
        let result = Octree::open(&damaged, &OpenOptions::default())
            .and_then(|octree| octree.verify(2, |_| {}));
        // Between pages lies padding that means nothing.
        let padding = at >= 256
            && at < *pages.last().map(|p| &p.end).unwrap()
            && !pages.iter().any(|p| p.contains(&at));
        let tail_padding = at >= pages.last().unwrap().end
            && (at as u64)
                < Octree::open(&path, &OpenOptions::default()).unwrap().header().page_table_offset;
        assert_eq!(result.is_err(), !padding && !tail_padding, "byte {at}");
        if pages.iter().any(|p| p.contains(&at)) {
            assert!(matches!(result, Err(StoreError::Damaged { .. })), "byte {at}");
        }
    }
}

#[test]
fn truncation_at_any_structure_is_a_typed_error() {
    let surfels = random_objects(300, 0.02, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(&surfels, &BuildOptions::default(), &path);
    let good = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.pbgi");
    for length in
        [0, 1, 7, 8, 100, 255, 256, 257, 4095, 4096, 5000, good.len() - 32, good.len() - 1]
    {
        std::fs::write(&cut, &good[..length]).unwrap();
        for backend in [Backend::Map, Backend::Read] {
            let options = OpenOptions { backend, ..OpenOptions::default() };
            assert!(Octree::open(&cut, &options).is_err(), "{length}");
        }
    }
}

#[test]
fn a_budget_that_cannot_hold_the_pins_is_refused() {
    let surfels = random_objects(20_000, 0.02, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(&surfels, &BuildOptions::default(), &path);
    let options = OpenOptions { cache_bytes: 1000, ..OpenOptions::default() };
    assert!(matches!(Octree::open(&path, &options), Err(StoreError::Budget { .. })));
}
