//! Readers of files, one function each.

use crate::mend::mend_checksums;
use pbgi_cloud::{
    CloudOptions, InvalidPolicy, LasPlaces, LasPoints, LasSurvey, LazyCloud, PlyPoints, PtcPoints,
    RawSource, ReceiverReader, ReceiverTable, Surfel, SurfelSource,
};
use pbgi_file::Allowance;
use pbgi_format::COORDINATE_MAX;
use pbgi_image::{read_environment_noting_within, read_exr_metadata, read_stored_exr_within};
use pbgi_mesh::{read_scene_within};
use pbgi_scene::{DiceOptions, DicedScene, Scene, Spacing, TwoSided};
use pbgi_store::{FileState, Octree, OpenOptions, PageSource, for_each_leaf};
use std::fmt::Display;
use std::io;
use std::path::Path;

/// Bytes that readers may take which are told so.
const GRANTED: u64 = 16 << 20;

/// Calls `read` with a folder that holds these files, and nothing else.
pub fn with_files(files: &[(&str, &[u8])], read: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir().expect("a folder can be made");
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).expect("a file can be written");
    }
    read(folder.path());
}

/// Checks that an error names the file, or one beside it.
pub fn check_error(path: &Path, error: &impl Display) {
    let (text, folder) = (error.to_string(), path.parent().unwrap_or(path).display().to_string());
    assert!(text.contains(&folder), "an error does not name its file: {text}");
}

/// The bytes of an octree file in memory.
struct Bytes(Vec<u8>);

impl PageSource for Bytes {
    fn read_at(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        let end = start.checked_add(out.len()).filter(|&end| end <= self.0.len());
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        out.copy_from_slice(&self.0[start..end]);
        Ok(())
    }

    fn state(&self) -> io::Result<FileState> {
        Ok(FileState { bytes: self.0.len() as u64, modified: None })
    }
}

/// Opens an octree file with mended checksums, verifies it, and walks its leaves, also where the verification found something.
pub fn read_octree(data: &[u8]) {
    let path = Path::new("folder/fuzzed.pbgi");
    let options = OpenOptions { cache_bytes: GRANTED, ..OpenOptions::default() };
    let octree = match Octree::open_from(Box::new(Bytes(mend_checksums(data))), path, &options) {
        Ok(octree) => octree,
        Err(error) => return check_error(path, &error),
    };
    let verified = octree.verify(1, |_| {});
    let mut seen = 0;
    let walked = for_each_leaf(&mut octree.reader(), |first, surfels| {
        assert_eq!(first, seen);
        seen += surfels.len() as u64;
    });
    match (verified, walked) {
        (Ok(report), Ok(())) => {
            assert_eq!(report.levels.iter().map(|level| level.surfels).sum::<u64>(), seen);
            assert_eq!(octree.header().surfel_count, seen);
        }
        (Ok(_), Err(error)) => panic!("verified, but {error}"),
        (Err(error), _) => check_error(path, &error),
    }
}

/// Reads all surfels, with invalid ones refused and left out, and checks those that come.
fn read_cloud<S: SurfelSource>(
    path: &Path,
    open: impl Fn(&CloudOptions) -> Result<S, pbgi_cloud::CloudError>,
) {
    for invalid in [InvalidPolicy::Refuse, InvalidPolicy::Skip] {
        let options = CloudOptions { invalid, ..CloudOptions::default() };
        let read = open(&options).and_then(|mut source| {
            let mut surfels = Vec::new();
            while source.read_chunk(&mut surfels)? {
                surfels.drain(..).for_each(check_surfel);
            }
            surfels.drain(..).for_each(check_surfel);
            assert!(source.origin().is_finite());
            Ok(())
        });
        if let Err(error) = read {
            check_error(path, &error);
        }
    }
    let search = LazyCloud::open(path, &CloudOptions::default()).and_then(|mut cloud| {
        cloud.find_bounds()?;
        let mut surfels = Vec::new();
        while cloud.read_chunk(&mut surfels)? {
            surfels.clear();
        }
        Ok(())
    });
    if let Err(error) = search {
        check_error(path, &error);
    }
}

fn check_surfel(surfel: Surfel) {
    assert!(surfel.center().is_finite(), "{surfel:?}");
    let is_sized = surfel.radius > 0.0 && surfel.area > 0.0;
    assert!(is_sized || surfel.radius == 0.0 && surfel.area == 0.0, "{surfel:?}");
    assert!(surfel.radius.is_finite() && surfel.area.is_finite(), "{surfel:?}");
    assert!(surfel.albedo_rgb().iter().all(|a| (0.0..=1.0).contains(a)), "{surfel:?}");
}

/// Reads a PLY file as points, and as receivers.
pub fn read_ply_points(data: &[u8]) {
    with_files(&[("a.ply", data)], |folder| {
        let path = folder.join("a.ply");
        read_cloud(&path, |options| PlyPoints::open(&path, options));
        let mut table = ReceiverTable::default();
        let read = ReceiverReader::open(&path).and_then(|mut reader| {
            while reader.read_chunk(1024, &mut table)? {}
            Ok(())
        });
        if let Err(error) = read {
            check_error(&path, &error);
        }
    });
}

/// Reads a LAS or LAZ file as points, as receivers, and surveys it.
pub fn read_las(data: &[u8]) {
    with_files(&[("a.las", data)], |folder| {
        let path = folder.join("a.las");
        read_cloud(&path, |options| LasPoints::open(&path, options));
        let read = LasPlaces::open(&path).and_then(|mut reader| {
            let mut places = Vec::new();
            while reader.read_chunk(&mut places)? {
                places.clear();
            }
            Ok(())
        });
        let surveyed = LasPlaces::survey(&path).map(|_: LasSurvey| ());
        for error in [read, surveyed].into_iter().filter_map(Result::err) {
            check_error(&path, &error);
        }
    });
}

/// Reads a PTC file.
pub fn read_ptc(data: &[u8]) {
    with_files(&[("a.ptc", data)], |folder| {
        let path = folder.join("a.ptc");
        read_cloud(&path, |options| PtcPoints::open(&path, options));
    });
}

/// Reads a raw stream.
pub fn read_raw(data: &[u8]) {
    with_files(&[("a.raw", data)], |folder| {
        let path = folder.join("a.raw");
        read_cloud(&path, |options| RawSource::new(data, &path, options));
    });
}

/// Reads a scene, and dices what is let through.
fn read_mesh(path: &Path) {
    match read_scene_within(path, &Allowance::new(GRANTED)) {
        Ok(scene) => dice(&scene),
        Err(error) => check_error(path, &error),
    }
}

fn dice(scene: &Scene) {
    for mesh in &scene.meshes {
        let count = mesh.positions.len();
        let mut used = mesh.triangles.iter().flatten().map(|v| *v as usize);
        assert!(used.all(|v| v < count && mesh.positions[v].is_finite()));
        assert!((mesh.material as usize) < scene.materials.len());
    }
    for instance in &scene.instances {
        assert!((instance.mesh as usize) < scene.meshes.len());
    }
    // What is larger is diced, but not baked.
    let bounds = scene.bounds();
    let is_usual = bounds.min.abs().max(bounds.max.abs()).max_element() <= COORDINATE_MAX;
    let options = DiceOptions { spacing: Spacing::Count(64), two_sided: TwoSided::Material };
    let Ok(mut diced) = DicedScene::new(scene, options) else { return };
    let mut surfels = Vec::new();
    for _ in 0..16 {
        let more = diced.read_chunk(&mut surfels);
        surfels.drain(..).filter(|_| is_usual).for_each(check_surfel);
        if !matches!(more, Ok(true)) {
            return;
        }
    }
}

/// Reads a PLY mesh.
pub fn read_ply_mesh(data: &[u8]) {
    with_files(&[("a.ply", data)], |folder| read_mesh(&folder.join("a.ply")));
}

/// Reads an OBJ file and, behind the first 0 byte, its material library `a.mtl`.
pub fn read_obj(data: &[u8]) {
    let end = data.iter().position(|byte| *byte == 0).unwrap_or(data.len());
    let (obj, mtl) = (&data[..end], data.get(end + 1..).unwrap_or_default());
    with_files(&[("a.obj", obj), ("a.mtl", mtl)], |folder| read_mesh(&folder.join("a.obj")));
}

/// Reads a binary glTF file, or one of JSON.
pub fn read_gltf(data: &[u8]) {
    let name = if data.starts_with(b"glTF") { "a.glb" } else { "a.gltf" };
    with_files(&[(name, data)], |folder| read_mesh(&folder.join(name)));
}

/// A triangle with a texture.
const TEXTURED: &[u8] =
    b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n";

/// Reads an image of any kind as a texture.
pub fn read_texture(data: &[u8]) {
    let mtl = b"newmtl a\nmap_Kd a.tga\n";
    with_files(&[("a.obj", TEXTURED), ("a.mtl", mtl), ("a.tga", data)], |folder| {
        read_mesh(&folder.join("a.obj"));
    });
}

/// Reads an EXR image as stored, as an environment, and its attributes.
pub fn read_exr(data: &[u8]) {
    with_files(&[("a.exr", data)], |folder| {
        let path = folder.join("a.exr");
        let allowance = Allowance::new(GRANTED);
        let stored = read_stored_exr_within(&path, &allowance, 12).map(|(image, _)| {
            for channel in &image.channels {
                assert_eq!(channel.samples.len(), image.width * image.height);
            }
        });
        let metadata = read_exr_metadata(&path).map(|_| ());
        for error in [stored, metadata].into_iter().filter_map(Result::err) {
            check_error(&path, &error);
        }
        read_environment(&path);
    });
}

/// Reads a Radiance image as an environment.
pub fn read_hdr(data: &[u8]) {
    with_files(&[("a.hdr", data)], |folder| read_environment(&folder.join("a.hdr")));
}

fn read_environment(path: &Path) {
    match read_environment_noting_within(path, &Allowance::new(GRANTED)) {
        Ok(read) => {
            let image = read.image;
            assert_eq!(image.pixels.len(), image.width * image.height);
            assert!(image.pixels.iter().flatten().all(|v| *v >= 0.0 && v.is_finite()));
        }
        Err(error) => check_error(path, &error),
    }
}
