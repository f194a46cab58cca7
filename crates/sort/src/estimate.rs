//! Normals and sizes for clouds that have none.

use crate::eigen::Symmetric3;
use crate::neighbors::{Nearest, NeighborSearch};
use crate::options::{SortOptions, SortPhase};
use crate::sorted::{SortedSurfels, SortedWalk, Store};
use crate::temp_file::{SURFEL_BYTES, TempFile};
use crate::{SortError, SurfelSummary};
use pbgi_cloud::{Surfel, SurfelFlags};
use pbgi_math::{DVec3, MORTON_AXIS_BITS, RootCube, Vec3, encode_octahedral24};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Surfels estimated together.
const BATCH: usize = 1 << 13;
/// Surfels before and behind a batch among which neighbors are found.
const MARGIN: usize = 1 << 13;
/// Surfels estimated by one task.
const TASK: usize = 256;
/// Fewest neighbors that tell a plane.
const PLANE_NEIGHBORS_MIN: usize = 3;
/// A neighborhood is a surface where its smallest variance is below this part of the middle one.
const SURFACE_VARIANCE_RATIO: f64 = 0.3;
/// A surfel is lone where its last neighbor is farther away than this many times the radius of the disk its neighbors would fill,
/// and its own disk reaches at most this many times as far as theirs: birds, wires and stray echoes get the size of what is
/// sampled near them, not that of the gap.
const LONE_RATIO: f32 = 2.0;
/// Neighbors that make a clump of their own, such as the few echoes of a lamp.
const CLUMP_NEIGHBORS: usize = 3;
/// Largest distance to the last neighbor over that to the last of the clump, which is 1.9 on an even surface: of points strewn at
/// random one in fifty is cut short.
const CLUMP_RATIO: f32 = 5.0;
/// It is a line where the middle variance is at most this part of the largest.
const LINE_VARIANCE_RATIO: f64 = 1e-4;

/// What to estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimateOptions {
    /// Whether isotropic surfels get a normal where their neighborhood is a surface.
    pub normals: bool,
    /// Estimated normals point to this side: +Z for LiDAR.
    pub up: Vec3,
}

impl Default for EstimateOptions {
    fn default() -> Self {
        Self { normals: true, up: Vec3::Z }
    }
}

/// What was estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EstimateReport {
    /// Surfels that got radius and area.
    pub sizes: u64,
    /// Isotropic surfels that got a normal.
    pub normals: u64,
    /// Isotropic surfels that stayed so, as their neighborhood is no surface.
    pub rough: u64,
}

/// Gives surfels without size a radius and an area, and isotropic ones a normal, from their
/// *k* = 12 nearest neighbors.
///
/// With *d* the distance to the *k*-th neighbor, area is `π d² / (k + ½)`: for points strewn at
/// random on a surface the expected area per point is that with *k*, for points kept apart, as by a
/// scanner or a lattice, that with *k* + 1. Radius is `2 √(area / π)`: disks of four times the area
/// leave holes in `e⁻⁴`, below 2 %, of a random cloud and none in a regular one. The normal is the
/// eigenvector of the smallest eigenvalue of the covariance of the surfel and its neighbors, on the
/// side of `up`; where that eigenvalue is above 0.3 times the middle one, as in foliage, or all lie
/// on a line, the surfel stays isotropic. A lone surfel far from a dense clump gets at most four times the area of its
/// neighbors. Sizes are at least one cell of the finest level.
///
/// Neighbors are found among the 8192 surfels before and behind in Morton order, so beside the edges
/// of large cells some are missed. Reads the stream once; 2 MiB of memory, within what every sort sets
/// aside. The result is held in memory where the budget of the sort holds the surfels twice, else it goes into one more temporary file. It is the same for
/// any number of threads. Without anything to estimate, `sorted` comes back as it is.
///
/// # Errors
///
/// If a temporary file fails or finds no room, or the caller cancels.
pub fn estimate_surfels(
    mut sorted: SortedSurfels,
    options: &EstimateOptions,
    sort_options: &SortOptions,
) -> Result<(SortedSurfels, EstimateReport), SortError> {
    let before = *sorted.summary();
    let mut report = EstimateReport::default();
    if !(before.any_missing_size || (options.normals && before.any_isotropic)) {
        return Ok((sorted, report));
    }
    if sort_options.checkpoint.is_none() {
        sorted.release_as_read();
    } else {
        sorted.rewind();
    }
    let pool = sort_options.thread_pool()?;
    let mut window = Window::default();
    let mut summary = SurfelSummary { root: before.root, ..SurfelSummary::new(before.origin) };
    // Beside what is read from, where both fit.
    let is_held = sorted.run_count() == 0 && 2 * before.count as usize <= sorted.plan.held_surfels;
    let mut held = Vec::with_capacity(if is_held { before.count as usize } else { 0 });
    let mut file = None;
    if !is_held {
        let created = TempFile::create(&sorted.temp_dir)?;
        created.check_room(before.count.saturating_mul(SURFEL_BYTES))?;
        file = Some(created);
    }
    let mut surfels = Vec::with_capacity(BATCH);
    while summary.count < before.count {
        let first = summary.count;
        window.advance(&mut sorted, first)?;
        let batch = window.estimate(&before.root, first, options, &pool);
        surfels.clear();
        for (surfel, outcome) in batch {
            summary.add(&surfel);
            outcome.count(&mut report);
            surfels.push(surfel);
        }
        match &mut file {
            Some(file) => file.append(bytemuck::cast_slice(&surfels))?,
            None => held.extend_from_slice(&surfels),
        }
        sort_options.check(SortPhase::Estimate, summary.count, Some(before.count))?;
    }
    let store = match file {
        Some(file) => Store::File(file, SortedWalk::default()),
        None => Store::Memory(held, SortedWalk::default()),
    };
    Ok((SortedSurfels::new(summary, sorted.plan, store, &sorted.temp_dir), report))
}

/// What happened to one surfel.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    size: bool,
    normal: bool,
    rough: bool,
}

impl Outcome {
    fn count(self, report: &mut EstimateReport) {
        report.sizes += u64::from(self.size);
        report.normals += u64::from(self.normal);
        report.rough += u64::from(self.rough);
    }
}

/// Part of the sorted stream around the batch at hand.
#[derive(Default)]
struct Window {
    /// Rank of the first surfel.
    first: u64,
    codes: Vec<u64>,
    surfels: Vec<Surfel>,
    is_complete: bool,
}

impl Window {
    /// Moves on to the batch whose first surfel has rank `first`.
    fn advance(&mut self, sorted: &mut SortedSurfels, first: u64) -> Result<(), SortError> {
        let start = first.saturating_sub(MARGIN as u64);
        let passed = (start - self.first) as usize;
        self.codes.drain(..passed);
        self.surfels.drain(..passed);
        self.first = start;
        let wanted = (first - start) as usize + BATCH + MARGIN;
        let mut chunk = Vec::new();
        while self.surfels.len() < wanted && !self.is_complete {
            chunk.clear();
            self.is_complete = !sorted.read_chunk(&mut chunk)?;
            self.codes.extend(chunk.iter().map(|(code, _)| code.0));
            self.surfels.extend(chunk.iter().map(|(_, surfel)| *surfel));
        }
        Ok(())
    }

    /// Estimates the batch that starts at rank `first`.
    fn estimate(
        &self,
        root: &RootCube,
        first: u64,
        options: &EstimateOptions,
        pool: &rayon::ThreadPool,
    ) -> Vec<(Surfel, Outcome)> {
        let start = (first - self.first) as usize;
        // What was read ahead by whole chunks must not change the result.
        let end = self.surfels.len().min(start + BATCH + MARGIN);
        let (codes, surfels) = (&self.codes[..end], &self.surfels[..end]);
        let batch = start..end.min(start + BATCH);
        pool.install(|| {
            surfels[batch.clone()]
                .par_chunks(TASK)
                .enumerate()
                .flat_map_iter(|(task, chunk)| {
                    let mut search = NeighborSearch::new(*root, codes, surfels);
                    let task_start = start + task * TASK;
                    (task_start..task_start + chunk.len())
                        .map(|i| estimate_surfel(surfels, i, &mut search, options, root))
                        .collect::<Vec<_>>()
                })
                .collect()
        })
    }
}

fn estimate_surfel(
    surfels: &[Surfel],
    index: usize,
    search: &mut NeighborSearch,
    options: &EstimateOptions,
    root: &RootCube,
) -> (Surfel, Outcome) {
    let mut surfel = surfels[index];
    let mut outcome = Outcome::default();
    let lacks_size = surfel.radius == 0.0;
    let lacks_normal = options.normals && surfel.is_isotropic();
    if !(lacks_size || lacks_normal) {
        return (surfel, outcome);
    }
    let nearest = search.nearest(index);
    if lacks_size {
        outcome.size = true;
        let mut reach = if nearest.is_sampled() || is_lone(surfels, index, &nearest) {
            // Its neighbors' size, not that of the gap between them.
            let beside = nearest.indices().next().map_or(0.0, |i| search.nearest(i).reach());
            nearest.reach().min(LONE_RATIO * beside)
        } else {
            nearest.reach()
        };
        if nearest.len() > CLUMP_NEIGHBORS {
            let clump = nearest.reach_of(CLUMP_NEIGHBORS);
            reach = reach.min(CLUMP_RATIO * clump.max(cell_edge(root)));
        }
        (surfel.radius, surfel.area) = size_of_neighborhood(nearest.len(), reach, root);
    }
    if lacks_normal {
        match normal_of_neighborhood(surfels, index, &nearest) {
            Some(normal) => {
                let normal = if normal.dot(options.up) < 0.0 { -normal } else { normal };
                surfel.orientation = encode_octahedral24(normal);
                surfel.flags = SurfelFlags(surfel.flags.0 & !SurfelFlags::ISOTROPIC.0);
                outcome.normal = true;
            }
            None => outcome.rough = true,
        }
    }
    (surfel, outcome)
}

/// Edge of a cell of the finest level.
fn cell_edge(root: &RootCube) -> f32 {
    root.edge / (1u32 << MORTON_AXIS_BITS) as f32
}

/// Radius and area of a surfel whose `count` nearest neighbors lie within `reach`.
fn size_of_neighborhood(count: usize, reach: f32, root: &RootCube) -> (f32, f32) {
    let (reach, count) = match count {
        // A cloud of one surfel has no scale but that of its cube.
        0 => (root.edge, 1.0),
        count => (reach.max(cell_edge(root)), count as f32 + 0.5),
    };
    let area = (PI * reach * reach / count).max(f32::MIN_POSITIVE);
    (2.0 * (area / PI).sqrt(), area)
}

/// Whether a surfel stands apart from its neighbors: they lie closer together than it lies to them.
fn is_lone(surfels: &[Surfel], index: usize, nearest: &Nearest) -> bool {
    if nearest.len() < PLANE_NEIGHBORS_MIN {
        return false;
    }
    let center = surfels[index].center();
    let offset = |i: usize| surfels[i].center() - center;
    let mean = nearest.indices().map(offset).sum::<Vec3>() / nearest.len() as f32;
    let squares = nearest.indices().map(|i| (offset(i) - mean).length_squared()).sum::<f32>();
    // Of an even disk of radius r around it the variance is r²/2.
    let spread = (2.0 * squares / nearest.len() as f32).sqrt();
    nearest.reach() > LONE_RATIO * spread
}

/// Unit normal of the plane through a surfel and its neighbors, if they lie on one.
fn normal_of_neighborhood(surfels: &[Surfel], index: usize, nearest: &Nearest) -> Option<Vec3> {
    if nearest.len() < PLANE_NEIGHBORS_MIN {
        return None;
    }
    // Relative to the surfel itself, so that its distance from the origin costs no digits.
    let center = surfels[index].center().as_dvec3();
    let offset = |i: usize| surfels[i].center().as_dvec3() - center;
    let mean = nearest.indices().map(offset).sum::<DVec3>() / (nearest.len() + 1) as f64;
    let mut covariance = Symmetric3::default();
    covariance.add_outer(-mean);
    for i in nearest.indices() {
        covariance.add_outer(offset(i) - mean);
    }
    let [smallest, middle, largest] = covariance.eigenvalues();
    if smallest > SURFACE_VARIANCE_RATIO * middle || middle <= LINE_VARIANCE_RATIO * largest {
        return None;
    }
    covariance.eigenvector(smallest).map(DVec3::as_vec3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sort_surfels;
    use pbgi_cloud::{CloudOptions, LasPoints, SliceSource};
    use std::path::Path;

    fn bare(position: Vec3) -> Surfel {
        Surfel::new(position, Vec3::Z, 0.0, 0.0).with_flags(SurfelFlags::ISOTROPIC)
    }

    fn random(seed: &mut u64) -> f32 {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 40) as f32 / (1u64 << 24) as f32
    }

    fn estimate(
        surfels: &[Surfel],
        budget_bytes: u64,
        threads: usize,
    ) -> (SurfelSummary, EstimateReport, Vec<Surfel>) {
        let options = SortOptions { budget_bytes, threads, ..SortOptions::default() };
        let sorted = sort_surfels(&mut SliceSource::new(surfels), &options).unwrap();
        let (mut sorted, report) =
            estimate_surfels(sorted, &EstimateOptions::default(), &options).unwrap();
        let mut out = Vec::new();
        while sorted.read_chunk(&mut out).unwrap() {}
        (*sorted.summary(), report, out.into_iter().map(|(_, s)| s).collect())
    }

    /// Points on a tilted plane, at random or on a jittered lattice, with the plane's true area.
    fn plane(count: usize, jitter: f32) -> (Vec<Surfel>, Vec3, f64) {
        let normal = Vec3::new(0.3, -0.2, 0.9).normalize();
        let u = normal.any_orthonormal_vector();
        let v = normal.cross(u);
        let edge = (count as f32).sqrt().ceil() as usize;
        let mut seed = 7;
        let surfels = (0..edge * edge)
            .map(|i| {
                let (x, y) = if jitter > 1.0 {
                    (random(&mut seed), random(&mut seed))
                } else {
                    let mut at = |i: usize| {
                        (i as f32 + 0.5 + (random(&mut seed) - 0.5) * jitter) / edge as f32
                    };
                    (at(i % edge), at(i / edge))
                };
                bare(u * x * 30.0 + v * y * 30.0)
            })
            .collect();
        (surfels, normal, 900.0)
    }

    #[test]
    fn a_lone_point_gets_the_size_of_its_neighbors() {
        let (mut surfels, normal, area) = plane(10_000, 0.5);
        let each = area / surfels.len() as f64;
        surfels.push(bare(surfels[5050].center() + normal * 10.0));
        let (_, _, estimated) = estimate(&surfels, 64 << 20, 1);
        let largest = estimated.iter().map(|s| f64::from(s.area)).fold(0.0, f64::max);
        assert!(largest < 8.0 * each, "{largest} {each}");
    }

    #[test]
    fn a_clump_far_from_everything_stays_small() {
        let (mut surfels, normal, _) = plane(10_000, 0.5);
        let place = surfels[5050].center() + normal * 4.0;
        surfels.extend((0..8).map(|i| bare(place + Vec3::new(0.1, 0.07, 0.0) * i as f32)));
        let (_, _, estimated) = estimate(&surfels, 64 << 20, 1);
        // The clump is 0.9 long, the ground 4 away.
        let largest = estimated.iter().map(|s| s.radius).fold(0.0, f32::max);
        assert!(largest < 1.2, "{largest}");
    }

    #[test]
    fn planes_get_their_area_and_normal() {
        for jitter in [0.0, 0.5, 2.0] {
            let (surfels, normal, area) = plane(40_000, jitter);
            let (summary, report, estimated) = estimate(&surfels, 64 << 20, 1);
            println!("jitter {jitter}: area {} of {area}", summary.area_sum);
            assert!((summary.area_sum / area - 1.0).abs() < 0.1);
            assert_eq!(report.sizes, surfels.len() as u64);
            assert_eq!(report.normals, surfels.len() as u64);
            for surfel in &estimated {
                assert!(!surfel.is_isotropic() && surfel.radius > 0.0);
                assert!(surfel.normal().dot(normal) > 0.999);
            }
            // Disks cover: few random places are outside all of them.
            let u = normal.any_orthonormal_vector();
            let v = normal.cross(u);
            let mut seed = 99;
            let missed = (0..500)
                .filter(|_| {
                    let place = u * random(&mut seed) * 30.0 + v * random(&mut seed) * 30.0;
                    estimated.iter().all(|s| s.center().distance(place) > s.radius)
                })
                .count();
            assert!(missed <= 20, "{missed} of 500 places are not covered");
        }
    }

    #[test]
    fn spheres_get_their_area_and_normals() {
        let surfels: Vec<Surfel> = (0..20_000u32)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f32 + 0.5) / 20_000.0;
                let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
                let r = (1.0 - z * z).sqrt();
                bare(Vec3::new(r * cos, r * sin, z) * 5.0)
            })
            .collect();
        let (summary, _, estimated) = estimate(&surfels, 64 << 20, 1);
        let area = 4.0 * std::f64::consts::PI * 25.0;
        println!("sphere: area {} of {area}", summary.area_sum);
        assert!((summary.area_sum / area - 1.0).abs() < 0.1);
        for surfel in &estimated {
            let outward = surfel.center() / 5.0;
            assert!(surfel.normal().dot(outward).abs() > 0.99);
            assert!(surfel.normal().z > -1e-3);
        }
    }

    #[test]
    fn estimates_depend_neither_on_threads_nor_budget() {
        let (surfels, _, _) = plane(200_000, 2.0);
        let one = estimate(&surfels, 64 << 20, 1);
        assert!(one == estimate(&surfels, 64 << 20, 2));
        assert!(one == estimate(&surfels, 9 << 20, 2));
    }

    #[test]
    fn odd_clouds_get_valid_sizes() {
        let line: Vec<_> = (0..50).map(|i| bare(Vec3::X * i as f32)).collect();
        let pair = [bare(Vec3::ZERO), bare(Vec3::ONE)];
        for cloud in [&line[..], &pair, &pair[..1], &[bare(Vec3::ONE); 5000]] {
            let (summary, report, estimated) = estimate(cloud, 64 << 20, 1);
            assert_eq!(report.rough, cloud.len() as u64);
            for surfel in estimated {
                assert!(surfel.is_isotropic() && surfel.area > 0.0);
                assert!(surfel.radius > summary.root.edge / (1u32 << 22) as f32);
                assert!(surfel.radius.is_finite() && surfel.area.is_finite());
            }
        }
    }

    #[test]
    fn given_sizes_and_normals_stay() {
        let given = Surfel::new(Vec3::ONE, Vec3::X, 2.0, 3.0);
        let sized = Surfel { radius: 5.0, area: 7.0, ..bare(Vec3::Y) };
        let surfels = [given, bare(Vec3::ZERO), bare(Vec3::X), sized];
        let (_, report, estimated) = estimate(&surfels, 64 << 20, 1);
        assert!(estimated.contains(&given));
        assert!(estimated.iter().any(|s| (s.radius, s.area) == (5.0, 7.0)));
        assert_eq!(report, EstimateReport { sizes: 2, normals: 3, rough: 0 });
    }

    #[test]
    fn ground_of_autzen_stadium_faces_up() {
        let path = Path::new(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../shared/data/autzen_stadium.laz"
        ));
        if !path.exists() {
            println!("skipped: autzen_stadium.laz is not here");
            return;
        }
        let mut source = LasPoints::open(path, &CloudOptions::default()).unwrap();
        let options = SortOptions { budget_bytes: 64 << 20, ..SortOptions::default() };
        let start = std::time::Instant::now();
        let sorted = sort_surfels(&mut source, &options).unwrap();
        let (sort_time, start) = (start.elapsed(), std::time::Instant::now());
        let (mut sorted, report) =
            estimate_surfels(sorted, &EstimateOptions::default(), &options).unwrap();
        let estimate_time = start.elapsed();
        let area = sorted.summary().area_sum / 1800f64.powi(2);
        let mut all = Vec::new();
        while sorted.read_chunk(&mut all).unwrap() {}
        // The file has no classes: level ground is what lies within 1 foot of the lowest point of
        // its 20-foot square, where the squares beside are as low within 1 foot.
        let square = |p: Vec3| ((p.x / 20.0).floor() as i32, (p.y / 20.0).floor() as i32);
        let mut lowest = std::collections::HashMap::new();
        for (_, s) in &all {
            let z = lowest.entry(square(s.center())).or_insert(f32::INFINITY);
            *z = z.min(s.center().z);
        }
        let is_level_ground = |p: Vec3| {
            let (x, y) = square(p);
            p.z < lowest[&(x, y)] + 1.0
                && (0..9).all(|i| {
                    let beside = lowest.get(&(x + i % 3 - 1, y + i / 3 - 1));
                    beside.is_some_and(|z| (z - lowest[&(x, y)]).abs() < 1.0)
                })
        };
        let ground: Vec<_> = all.iter().filter(|(_, s)| is_level_ground(s.center())).collect();
        let upright = |s: &Surfel| !s.is_isotropic() && s.normal().z > 15f32.to_radians().cos();
        let share = ground.iter().filter(|(_, s)| upright(s)).count() as f64 / ground.len() as f64;
        let mut squares = std::collections::HashMap::<_, (f64, bool)>::new();
        for (_, s) in &all {
            let (area, is_level) = squares.entry(square(s.center())).or_insert((0.0, true));
            *area += f64::from(s.area);
            *is_level &= is_level_ground(s.center());
        }
        let level: Vec<f64> = squares.values().filter(|s| s.1).map(|s| s.0 / 400.0).collect();
        let level_area = level.iter().sum::<f64>() / level.len() as f64;
        println!(
            "{} surfels, {report:?}, {} on level ground, of them within 15° of up {:.1} %, area \
             {area:.3} of 1800², {level_area:.3} of level squares, read and sort {sort_time:?}, estimate {estimate_time:?}",
            all.len(),
            ground.len(),
            share * 100.0,
        );
        assert!(ground.len() > 500_000 && share > 0.9);
        assert!((1.0..1.5).contains(&area) && (0.95..1.1).contains(&level_area));
    }
}
