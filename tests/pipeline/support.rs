//! Baking surfels in memory, the obvious way.

use pbgi_build::{
    BuildOptions, BuildReport, SortedStream, StreamError, StreamSummary, build_octree,
};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_gather::{GatherSettings, Gatherer, Receiver, Shading};
use pbgi_math::{DVec3, MortonCode, Vec3};
use pbgi_store::{Octree, OpenOptions};
use pbgi_testkit::sphere_directions;
use std::f32::consts::FRAC_1_PI;
use std::path::Path;

/// Sorted surfels handed out in chunks of a given size.
pub struct MemoryStream {
    surfels: Vec<(MortonCode, Surfel)>,
    next: usize,
    chunk: usize,
}

impl SortedStream for MemoryStream {
    fn read_chunk(&mut self, out: &mut Vec<(MortonCode, Surfel)>) -> Result<bool, StreamError> {
        let end = (self.next + self.chunk).min(self.surfels.len());
        out.extend_from_slice(&self.surfels[self.next..end]);
        self.next = end;
        Ok(end < self.surfels.len())
    }
}

pub fn stream(surfels: &[Surfel], chunk: usize) -> (MemoryStream, StreamSummary) {
    let (root, sorted) = pbgi_testkit::sort_in_memory(surfels);
    let (radius_max, area_max, radiance_max) = pbgi_testkit::summarize(surfels);
    let summary = StreamSummary {
        root,
        origin: DVec3::ZERO,
        surfel_count: surfels.len() as u64,
        radius_max,
        area_max,
        radiance_max,
        any_albedo: surfels.iter().any(|s| s.albedo_rgb() != [0.0; 3]),
        any_isotropic: surfels.iter().any(|s| s.flags.contains(SurfelFlags::ISOTROPIC)),
        z_up: false,
    };
    (MemoryStream { surfels: sorted, next: 0, chunk }, summary)
}

pub fn bake(surfels: &[Surfel], options: &BuildOptions<'_>, target: &Path) -> BuildReport {
    let (mut stream, summary) = stream(surfels, 1000);
    build_octree(&mut stream, &summary, options, target).expect("a valid cloud bakes")
}

/// Bakes and opens with room for everything.
pub fn bake_and_open(
    surfels: &[Surfel],
    options: &BuildOptions<'_>,
) -> (tempfile::TempDir, Octree) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.pbgi");
    bake(surfels, options, &path);
    let octree =
        Octree::open(&path, &OpenOptions { readers: 2, ..OpenOptions::default() }).unwrap();
    (folder, octree)
}

/// Surfels of a box, `per_edge` rectangles along each edge, its fronts outside.
pub fn boxed(low: Vec3, high: Vec3, per_edge: usize) -> Vec<Surfel> {
    let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
    let mut surfels = Vec::new();
    for face in 0..6 {
        let (axis, sign) = (face % 3, if face < 3 { 1.0 } else { -1.0 });
        let [x, y, z] = [axis, (axis + 1) % 3, (axis + 2) % 3].map(|axis| Vec3::AXES[axis]);
        let edges = [y * half.dot(y), z * half.dot(z)].map(|edge| edge / per_edge as f32);
        let long = usize::from(edges[1].length() > edges[0].length());
        let [longer, shorter] = [edges[long].length(), edges[1 - long].length()];
        for place in 0..per_edge * per_edge {
            let at = |i: usize| (2 * i + 1) as f32 - per_edge as f32;
            let offset = edges[0] * at(place % per_edge) + edges[1] * at(place / per_edge);
            let middle = center + x * (sign * half.dot(x)) + offset;
            let face = Surfel::new(middle, x * sign, longer.hypot(shorter), 4.0 * longer * shorter);
            surfels.push(face.with_tile(edges[long], longer / shorter));
        }
    }
    surfels
}

/// Mean of E/π of receivers all over a room of half-extents of 2, facing all directions: its radiance, where that is the same everywhere.
pub fn mean_radiance_in_room(octree: &Octree, settings: &GatherSettings) -> f32 {
    let (count, mut sum) = (60, 0.0);
    for (i, normal) in sphere_directions(count).enumerate() {
        let f = |k: usize| ((i * k) % 37) as f32 / 37.0 * 2.4 - 1.2;
        let position = Vec3::new(f(5), f(11), f(17));
        let found = gather(octree, settings, Receiver::diffuse(position, normal));
        sum += found.surface_irradiance[0] * FRAC_1_PI / count as f32;
    }
    sum
}

/// What a receiver receives from surfels alone.
pub fn gather(octree: &Octree, settings: &GatherSettings, receiver: Receiver) -> Shading {
    Gatherer::new(octree.reader(), settings, None).gather(&receiver).unwrap()
}
