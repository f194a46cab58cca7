//! Disks that are slow, files that change while they are open, and pages that are damaged.

use crate::support::bake;
use pbgi_build::BuildOptions;
use pbgi_format::{PageEntry, PageId, PageKind};
use pbgi_gather::{GatherSettings, Receiver, Shading};
use pbgi_math::Vec3;
use pbgi_schedule::{ShadeOptions, shade_receivers};
use pbgi_store::{Backend, FileState, Octree, OpenOptions, PageSource, StoreError, for_each_leaf};
use pbgi_testkit::{random_objects, sphere_directions};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

const BACKENDS: [Backend; 2] = [Backend::Read, Backend::Map];

/// A file of many small pages.
fn scene() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    let options = BuildOptions { page_bytes: 4096, ..BuildOptions::default() };
    bake(&random_objects(10_000, 0.02, 7), &options, &path);
    (folder, path)
}

/// Room for about forty pages, of more than two hundred.
const SMALL: OpenOptions =
    OpenOptions { cache_bytes: 220 << 10, readers: 1, backend: Backend::Read, skip_damaged: false };

fn receivers() -> Vec<Receiver> {
    let place = |i: usize, k: usize| ((i * k) % 41) as f32 / 41.0;
    let receiver =
        |(i, normal)| Receiver::diffuse(Vec3::new(place(i, 5), place(i, 11), place(i, 17)), normal);
    sphere_directions(300).enumerate().map(receiver).collect()
}

fn shade(octree: &Octree) -> Result<Vec<Shading>, String> {
    let gather = GatherSettings { solid_angle_sr: 0.01, ..GatherSettings::default() };
    let options = ShadeOptions { gather, ..ShadeOptions::default() };
    let result = shade_receivers(octree, None, &receivers(), &options);
    result.map(|(shadings, _)| shadings).map_err(|error| error.to_string())
}

/// A file whose every read takes a while, and fails in some bytes.
struct Trouble {
    file: File,
    delay: Duration,
    bad: Option<u64>,
}

impl PageSource for Trouble {
    fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        std::thread::sleep(self.delay);
        if self.bad.is_some_and(|bad| (offset..offset + out.len() as u64).contains(&bad)) {
            return Err(io::Error::other("the disk has a bad sector"));
        }
        self.file.read_at(offset, out)
    }

    fn state(&self) -> io::Result<FileState> {
        self.file.state()
    }
}

fn open_troubled(path: &Path, delay: Duration, bad: Option<u64>, options: &OpenOptions) -> Octree {
    let source = Trouble { file: File::open(path).unwrap(), delay, bad };
    Octree::open_from(Box::new(source), path, options).unwrap()
}

#[test]
fn slow_disks_only_slow() {
    let (_folder, path) = scene();
    let fast = Octree::open(&path, &SMALL).unwrap();
    let expected = shade(&fast).unwrap();
    assert!(fast.stats().evictions > 100, "pages are read again and again");
    let options = OpenOptions { cache_bytes: 2 * SMALL.cache_bytes, readers: 2, ..SMALL };
    let slow = open_troubled(&path, Duration::from_micros(200), None, &options);
    assert_eq!(shade(&slow).unwrap(), expected);
    let stats = slow.stats();
    let least = stats.pages_read * 200_000;
    assert!(stats.read_ns >= least && stats.wait_ns >= stats.read_ns, "{stats:?}");
}

/// Pins pages until one fails.
fn first_error(octree: &Octree) -> Option<StoreError> {
    let mut reader = octree.reader();
    (0..octree.pages().len()).find_map(|page| reader.pin_page(PageId(page as u32)).err())
}

#[test]
fn files_shortened_while_open_are_errors_with_both_backends() {
    for backend in BACKENDS {
        let (_folder, path) = scene();
        let whole = std::fs::metadata(&path).unwrap().len();
        let octree = Octree::open(&path, &OpenOptions { backend, ..SMALL }).unwrap();
        let file = File::options().write(true).open(&path).unwrap();
        file.set_len(whole / 2).unwrap();
        let error = first_error(&octree).unwrap();
        let StoreError::Changed { page, found, expected, .. } = &error else { panic!("{error}") };
        let cut =
            octree.pages().iter().position(|p| p.offset + u64::from(p.stored_bytes) > whole / 2);
        assert_eq!((Some(page.0 as usize), *found, *expected), (cut, whole / 2, whole));
        let message = error.to_string();
        assert!(message.contains("scene.pbgi") && message.contains("run again"), "{message}");
        assert!(shade(&octree).unwrap_err().contains("while it was open"));
    }
}

#[test]
fn files_rewritten_while_open_are_errors_and_renamed_ones_are_not() {
    for backend in BACKENDS {
        for skip_damaged in [false, true] {
            let (folder, path) = scene();
            let options = OpenOptions { backend, skip_damaged, ..SMALL };
            let octree = Octree::open(&path, &options).unwrap();
            let expected = shade(&octree).unwrap();
            // Another file under the same name is another file.
            let other = folder.path().join("other.pbgi");
            std::fs::write(&other, vec![0; 100]).unwrap();
            std::fs::rename(&other, &path).unwrap();
            assert_eq!(shade(&octree).unwrap(), expected);
            let (_folder, path) = scene();
            let octree = Octree::open(&path, &options).unwrap();
            std::thread::sleep(Duration::from_millis(20));
            let zeros = vec![0; std::fs::metadata(&path).unwrap().len() as usize];
            std::fs::write(&path, zeros).unwrap();
            let error = first_error(&octree).unwrap();
            assert!(matches!(error, StoreError::Changed { .. }), "{error}");
            assert!(shade(&octree).unwrap_err().contains("while it was open"));
        }
    }
}

/// The surfels of a walk over the leaves.
fn surfels_of(octree: &Octree) -> Result<u64, StoreError> {
    let mut count = 0;
    for_each_leaf(&mut octree.reader(), |first, surfels| {
        assert_eq!(first, count);
        count += surfels.len() as u64;
    })?;
    Ok(count)
}

/// Flips a bit in the middle of a page.
fn damage(path: &Path, page: &PageEntry) {
    let mut bytes = std::fs::read(path).unwrap();
    bytes[(page.offset + u64::from(page.stored_bytes) / 2) as usize] ^= 0x10;
    std::fs::write(path, bytes).unwrap();
}

/// The page in the middle of the file that holds surfels, or nodes.
fn middle_page(octree: &Octree, kind: PageKind) -> (u32, PageEntry) {
    let middle = octree.pages().len() / 2;
    let found = (middle..).find(|&page| octree.pages()[page].kind == kind).unwrap();
    (found as u32, octree.pages()[found])
}

#[test]
fn damaged_pages_stop_a_run_unless_they_are_skipped() {
    for kind in [PageKind::Surfels, PageKind::Nodes] {
        let (_folder, path) = scene();
        let sound = Octree::open(&path, &SMALL).unwrap();
        let all = surfels_of(&sound).unwrap();
        let (number, page) = middle_page(&sound, kind);
        damage(&path, &page);
        let strict = Octree::open(&path, &SMALL).unwrap();
        let error = surfels_of(&strict).unwrap_err().to_string();
        let named = format!("page {number} of {}", path.display());
        assert!(error.contains(&named) && error.contains("--skip-damaged"), "{error}");
        assert!(shade(&strict).unwrap_err().contains(&named));
        let mut results = Vec::new();
        for backend in BACKENDS {
            for cache_bytes in [SMALL.cache_bytes, 1 << 20] {
                let options = OpenOptions { cache_bytes, backend, skip_damaged: true, ..SMALL };
                let skipping = Octree::open(&path, &options).unwrap();
                let left = surfels_of(&skipping).unwrap();
                assert!(left < all && left * 2 > all, "{left} of {all}");
                results.push(shade(&skipping).unwrap());
                assert_eq!(skipping.damaged_pages(), [PageId(number)]);
                let error = skipping.reader().pin_page(PageId(number)).err();
                assert!(matches!(error, Some(StoreError::Damaged { .. })));
            }
        }
        assert!(results.iter().all(|result| *result == results[0]));
    }
}

#[test]
fn without_its_root_a_file_is_nothing() {
    let (_folder, path) = scene();
    let options = OpenOptions { skip_damaged: true, ..SMALL };
    let octree = Octree::open(&path, &options).unwrap();
    let root = octree.header().root_page;
    damage(&path, &octree.pages()[root.0 as usize]);
    let octree = Octree::open(&path, &options).unwrap();
    let named = format!("page {root} of");
    assert!(surfels_of(&octree).unwrap_err().to_string().contains(&named));
    assert!(shade(&octree).unwrap_err().contains(&named));
}

#[test]
fn bad_sectors_are_named_by_page_and_skipped_as_damage() {
    let (_folder, path) = scene();
    let (number, page) = middle_page(&Octree::open(&path, &SMALL).unwrap(), PageKind::Surfels);
    let bad = Some(page.offset + 5);
    let octree = open_troubled(&path, Duration::ZERO, bad, &SMALL);
    let error = surfels_of(&octree).unwrap_err();
    assert!(matches!(error, StoreError::Unreadable { page, .. } if page.0 == number), "{error}");
    assert!(error.to_string().contains("bad sector"), "{error}");
    let options = OpenOptions { skip_damaged: true, ..SMALL };
    let octree = open_troubled(&path, Duration::ZERO, bad, &options);
    surfels_of(&octree).unwrap();
    assert_eq!(octree.damaged_pages(), [PageId(number)]);
}
