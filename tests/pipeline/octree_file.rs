//! The octree file: what is in it, that it is the same for every way of making it, and that damage is named.

use crate::support::{bake, bake_and_open, stream};
use pbgi_build::{BuildOptions, SortedStream, StreamError, build_octree};
use pbgi_cloud::Surfel;
use pbgi_format::{PageKind, page_checksum};
use pbgi_gather::Receiver;
use pbgi_math::{MortonCode, Vec3};
use pbgi_schedule::{ShadeOptions, shade_receivers};
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

/// Makes all checksums right again after bytes of pages were changed.
fn reseal(bytes: &mut [u8]) {
    let word = |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let table = word(bytes, 56) as usize;
    for entry in (table..bytes.len()).step_by(32) {
        let start = word(bytes, entry) as usize;
        let stored = (word(bytes, entry + 8) & 0xffff_ffff) as usize;
        let checksum = page_checksum(&bytes[start..start + stored]);
        bytes[entry + 16..entry + 24].copy_from_slice(&checksum.to_le_bytes());
    }
    let checksum = page_checksum(&bytes[table..]);
    bytes[64..72].copy_from_slice(&checksum.to_le_bytes());
    let checksum = page_checksum(&bytes[..248]);
    bytes[248..256].copy_from_slice(&checksum.to_le_bytes());
}

/// Where a file contradicts itself though all its checksums are right, verifying says so.
#[test]
fn trees_that_contradict_themselves_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    let options = BuildOptions { page_bytes: 4096, ..BuildOptions::default() };
    bake(&random_objects(10_000, 0.02, 7), &options, &path);
    let good = std::fs::read(&path).unwrap();
    let octree = Octree::open(&path, &OpenOptions::default()).unwrap();
    let u32_at = |at: usize| u32::from_le_bytes(good[at..at + 4].try_into().unwrap());
    // A page of nodes with leaves and with two links to other pages, and its first group.
    let nodes = octree.pages().iter().filter(|page| page.kind == PageKind::Nodes);
    let starts: Vec<usize> = nodes.map(|page| page.offset as usize).collect();
    let linking = *starts.iter().find(|at| u32_at(*at + 16) >= 2).unwrap();
    let leafy = *starts.iter().find(|at| good[*at + 32 + 39] != 0).unwrap();
    let links = linking + u32_at(linking + 12) as usize;
    let group = leafy + 32;
    let children = good[group + 38].count_ones() as usize;
    let leaf =
        (good[group + 38] & ((1 << good[group + 39].trailing_zeros()) - 1)).count_ones() as usize;
    type Change = Box<dyn Fn(&mut Vec<u8>)>;
    let cases: [(&str, Change); 5] = [
        ("linked once", Box::new(move |b| b.copy_within(links..links + 8, links + 8))),
        ("group: links to it", Box::new(move |b| b[links + 4] ^= 4)),
        ("link: index", Box::new(move |b| b[links..links + 4].fill(0xff))),
        ("node page: groups", Box::new(move |b| b[leafy + 4] += 1)),
        // One surfel less in a leaf: the page has more than its leaves.
        ("surfel page: surfels", Box::new(move |b| b[group + 41 + 4 * leaf] -= 1)),
    ];
    assert!(leaf < children && u32_at(group + 41 + 4 * leaf) & 0xff > 1);
    for (expected, change) in cases {
        let mut bytes = good.clone();
        change(&mut bytes);
        assert_ne!(bytes, good, "{expected}");
        reseal(&mut bytes);
        std::fs::write(&path, bytes).unwrap();
        let octree = Octree::open(&path, &OpenOptions::default()).unwrap();
        let errors = [1, 2].map(|threads| octree.verify(threads, |_| {}).unwrap_err().to_string());
        assert!(errors[0].contains(expected), "{expected}: {}", errors[0]);
        assert_eq!(errors[0], errors[1]);
    }
}

#[test]
fn any_number_of_threads_verifies_the_same() {
    let surfels = random_objects(50_000, 0.02, 3);
    let (_folder, octree) = bake_and_open(&surfels, &BuildOptions::default());
    let bytes: u64 = octree.pages().iter().map(|page| u64::from(page.stored_bytes)).sum();
    assert!(bytes > 2 << 20, "more than is read at once: {bytes}");
    let mut told = 0;
    let one = octree.verify(1, |read| told = read).unwrap();
    assert_eq!((told, one.bytes_read), (bytes, bytes));
    assert_eq!(one.levels.iter().map(|level| level.surfels).sum::<u64>(), surfels.len() as u64);
    assert_eq!(one, octree.verify(3, |_| {}).unwrap());
}

#[test]
fn a_walk_uses_much_of_each_page_it_reads() {
    let (folder, octree) =
        bake_and_open(&random_objects(200_000, 0.004, 3), &BuildOptions::default());
    let path = octree.path().to_owned();
    drop(octree);
    let (mut opened, mut bytes_read) = (0, 0);
    for place in [Vec3::ZERO, Vec3::new(0.5, -0.3, 0.2), Vec3::new(-0.7, 0.6, -0.4)] {
        // With nothing in memory before.
        let octree = Octree::open(&path, &OpenOptions::default()).unwrap();
        let receivers = [Vec3::Y, Vec3::NEG_Y].map(|normal| Receiver::diffuse(place, normal));
        let (_, report) =
            shade_receivers(&octree, None, &receivers, &ShadeOptions::default()).unwrap();
        opened += report.cut.opened;
        bytes_read += octree.stats().bytes_read;
    }
    drop(folder);
    // 1.6 KB a group; 2.5 KB where treelets grow until they fill a page.
    assert!(bytes_read < 2000 * opened, "{bytes_read} bytes for {opened} groups and leaves");
}
