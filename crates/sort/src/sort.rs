//! From a source to the sorted stream.

use crate::merge::Merger;
use crate::options::{Plan, SortOptions, SortPhase};
use crate::run_buffer::RunBuffer;
use crate::sorted::{CHUNK, Runs, SortedSurfels, Store};
use crate::temp_file::TempFile;
use crate::{SortError, SurfelSummary};
use pbgi_cloud::{Surfel, SurfelSource};
use pbgi_math::{Aabb, RootCube, Vec3};
use std::ops::Range;

/// Sorts all surfels of `source` into Morton order, equal codes in input order.
///
/// The root cube is that of the source's bounds where it knows them, else that of all centers. The
/// result is the same for every budget, number of threads and chunking of the source. The source is
/// read once; see [`SortOptions::budget_bytes`] for the memory held and [`SortOptions::temp_dir`]
/// for the disk.
///
/// # Errors
///
/// If the source fails or lies about its bounds, the budget is below
/// [`crate::BUDGET_BYTES_MIN`], a temporary file fails or finds no room, or the caller cancels.
pub fn sort_surfels(
    source: &mut dyn SurfelSource,
    options: &SortOptions,
) -> Result<SortedSurfels, SortError> {
    sort_with_plan(source, options, Plan::new(options.budget_bytes)?)
}

pub(crate) fn sort_with_plan(
    source: &mut dyn SurfelSource,
    options: &SortOptions,
    plan: Plan,
) -> Result<SortedSurfels, SortError> {
    let mut sorter = Sorter {
        options,
        plan,
        pool: options.thread_pool()?,
        stated_bounds: source.bounds(),
        stated_count: source.count(),
        summary: SurfelSummary::new(source.origin()),
        buffer: RunBuffer::new(plan.run_surfels),
        spill: None,
    };
    sorter.read_all(source)?;
    sorter.finish()
}

/// Runs on disk.
struct Spill {
    file: TempFile,
    runs: Vec<Range<u64>>,
}

struct Sorter<'a> {
    options: &'a SortOptions<'a>,
    plan: Plan,
    pool: rayon::ThreadPool,
    stated_bounds: Option<Aabb>,
    stated_count: Option<u64>,
    summary: SurfelSummary,
    buffer: RunBuffer,
    spill: Option<Spill>,
}

impl Sorter<'_> {
    fn read_all(&mut self, source: &mut dyn SurfelSource) -> Result<(), SortError> {
        let mut chunk = Vec::new();
        loop {
            chunk.clear();
            let more = source.read_chunk(&mut chunk)?;
            for surfel in &chunk {
                self.check(surfel)?;
                self.summary.add(surfel);
            }
            let mut rest = chunk.as_slice();
            loop {
                rest = &rest[self.buffer.push(rest)..];
                if rest.is_empty() {
                    break;
                }
                self.spill()?;
            }
            self.options.check(SortPhase::Read, self.summary.count, self.stated_count)?;
            if !more {
                return Ok(());
            }
        }
    }

    fn check(&self, surfel: &Surfel) -> Result<(), SortError> {
        let bad = |what| Err(SortError::BadSource { index: self.summary.count, what });
        let center = surfel.center();
        let sizes = [surfel.radius, surfel.area];
        if !center.is_finite() {
            return bad("has a position that is not finite");
        }
        if !sizes.iter().all(|s| (0.0..f32::INFINITY).contains(s))
            || (surfel.radius > 0.0) != (surfel.area > 0.0)
        {
            return bad("has a radius or area that is not above 0");
        }
        match &self.stated_bounds {
            Some(bounds) if !bounds.contains(center) => bad("lies outside the stated bounds"),
            _ => Ok(()),
        }
    }

    /// The root cube, as soon as bounds are known.
    fn root_of(bounds: &Aabb) -> RootCube {
        if bounds.is_empty() {
            RootCube { min: Vec3::ZERO, edge: 1.0 }
        } else {
            RootCube::from_bounds(bounds)
        }
    }

    /// Moves the buffer to disk as one more run: sorted where the root cube is known already.
    fn spill(&mut self) -> Result<(), SortError> {
        let len = self.buffer.len() as u64;
        if self.spill.is_none() {
            let file = TempFile::create(&self.options.temp_dir)?;
            file.check_room(self.stated_count.unwrap_or(0))?;
            self.spill = Some(Spill { file, runs: Vec::new() });
        }
        let spill = self.spill.as_mut().expect("just created");
        let start = spill.runs.last().map_or(0, |run| run.end);
        spill.file.check_room(len)?;
        match &self.stated_bounds {
            Some(bounds) => {
                self.buffer.sort(&Self::root_of(bounds), &self.pool);
                self.buffer.write_sorted(&spill.file, start, &self.pool)?;
            }
            None => self.buffer.write_unsorted(&spill.file, start)?,
        }
        spill.runs.push(start..start + len);
        self.buffer.clear();
        Ok(())
    }

    fn finish(mut self) -> Result<SortedSurfels, SortError> {
        self.summary.root = Self::root_of(&self.stated_bounds.unwrap_or(self.summary.bounds));
        if self.spill.is_none() {
            self.buffer.sort(&self.summary.root, &self.pool);
            let store = Store::Memory(self.buffer);
            return Ok(SortedSurfels::new(self.summary, store, &self.options.temp_dir));
        }
        self.spill()?;
        if self.stated_bounds.is_none() {
            self.sort_runs()?;
        }
        // The merge buffers take the place of the run.
        self.buffer = RunBuffer::new(0);
        let mut spill = self.spill.take().expect("checked above");
        while spill.runs.len() > self.plan.fan_in {
            spill = self.merge_pass(spill)?;
        }
        let merger = Merger::new(&spill.file, &spill.runs, &self.plan, self.summary.root)?;
        let Spill { file, runs } = spill;
        let runs = Runs { file, runs, merger, record: None };
        Ok(SortedSurfels::new(self.summary, Store::Runs(Box::new(runs)), &self.options.temp_dir))
    }

    /// Sorts each run in its place.
    fn sort_runs(&mut self) -> Result<(), SortError> {
        let Some(spill) = &self.spill else { return Ok(()) };
        for run in &spill.runs {
            self.buffer.read(&spill.file, run.start, (run.end - run.start) as usize)?;
            self.buffer.sort(&self.summary.root, &self.pool);
            self.buffer.write_sorted(&spill.file, run.start, &self.pool)?;
            self.options.check(SortPhase::SortRuns, run.end, Some(self.summary.count))?;
        }
        Ok(())
    }

    /// Merges groups of neighboring runs into longer ones, in another file.
    fn merge_pass(&self, spill: Spill) -> Result<Spill, SortError> {
        let mut file = TempFile::create(&self.options.temp_dir)?;
        file.check_room(self.summary.count)?;
        let mut runs = Vec::new();
        let (mut chunk, mut surfels) = (Vec::new(), Vec::new());
        for group in spill.runs.chunks(self.plan.fan_in) {
            let start = file.count();
            let mut merger = Merger::new(&spill.file, group, &self.plan, self.summary.root)?;
            let mut more = true;
            while more {
                chunk.clear();
                more = merger.read(&spill.file, 4 * CHUNK, &mut chunk)?;
                surfels.clear();
                surfels.extend(chunk.iter().map(|(_, surfel)| *surfel));
                file.append(&surfels)?;
                self.options.check(SortPhase::Merge, file.count(), Some(self.summary.count))?;
            }
            runs.push(start..file.count());
        }
        Ok(Spill { file, runs })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pbgi_cloud::CloudError;
    use pbgi_math::{DVec3, MortonCode};
    use std::sync::atomic::AtomicBool;

    /// A source over surfels in memory with chunks and promises to choose.
    struct Source<'a> {
        surfels: &'a [Surfel],
        chunk: usize,
        bounds: Option<Aabb>,
    }

    impl SurfelSource for Source<'_> {
        fn origin(&self) -> DVec3 {
            DVec3::new(1.0, 2.0, 3.0)
        }

        fn bounds(&self) -> Option<Aabb> {
            self.bounds
        }

        fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
            let (now, later) = self.surfels.split_at(self.chunk.min(self.surfels.len()));
            out.extend_from_slice(now);
            self.surfels = later;
            Ok(!later.is_empty())
        }
    }

    fn source(surfels: &[Surfel], is_bounded: bool) -> Source<'_> {
        let bounds = Aabb::from_points(surfels.iter().map(Surfel::center));
        Source { surfels, chunk: 4096, bounds: is_bounded.then_some(bounds) }
    }

    fn options(budget_bytes: u64, threads: usize) -> SortOptions<'static> {
        SortOptions { budget_bytes, threads, ..SortOptions::default() }
    }

    fn random(seed: &mut u64) -> f32 {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Surfels at these positions, told apart by their radiance.
    fn surfels_at(positions: impl Iterator<Item = Vec3>) -> Vec<Surfel> {
        positions
            .enumerate()
            .map(|(i, p)| Surfel::new(p, Vec3::Z, 1.0, 1.0).with_radiance([i as f32, 0.0, 0.0]))
            .collect()
    }

    fn random_surfels(count: usize) -> Vec<Surfel> {
        let mut seed = 42;
        surfels_at(
            (0..count).map(|_| {
                Vec3::new(random(&mut seed), random(&mut seed), random(&mut seed)) * 100.0
            }),
        )
    }

    fn read_all(sorted: &mut SortedSurfels) -> Vec<(MortonCode, Surfel)> {
        let mut out = Vec::new();
        while sorted.read_chunk(&mut out).unwrap() {}
        out
    }

    /// The same by the standard library's stable sort.
    fn oracle(surfels: &[Surfel]) -> Vec<(MortonCode, Surfel)> {
        let root = RootCube::from_bounds(&Aabb::from_points(surfels.iter().map(Surfel::center)));
        let mut all: Vec<_> = surfels.iter().map(|s| (root.code(s.center()), *s)).collect();
        all.sort_by_key(|(code, _)| *code);
        all
    }

    /// Small runs and few at a time, so that small clouds take every path.
    const SMALL: Plan = Plan { run_surfels: 1000, fan_in: 3, merge_bytes: 20_000 };

    #[test]
    fn every_path_gives_the_order_of_a_stable_sort() {
        let shuffled = random_surfels(20_000);
        let sorted: Vec<Surfel> = oracle(&shuffled).into_iter().map(|(_, s)| s).collect();
        let reversed: Vec<Surfel> = sorted.iter().rev().copied().collect();
        let line = surfels_at((0..5000).map(|i| Vec3::new((i * 7919 % 5000) as f32, 3.0, -1.0)));
        let duplicates = surfels_at((0..100_000).map(|i| Vec3::splat((i / 99_000) as f32)));
        let exact_runs = random_surfels(3000);
        let clouds = [shuffled, sorted, reversed, line, duplicates, exact_runs];
        for (number, cloud) in clouds.iter().enumerate() {
            let expected = oracle(cloud);
            for is_bounded in [false, true] {
                for plan in [Plan::new(64 << 20).unwrap(), SMALL] {
                    let mut source = source(cloud, is_bounded);
                    let mut sorted = sort_with_plan(&mut source, &options(0, 2), plan).unwrap();
                    assert_eq!(sorted.run_count() > 0, plan == SMALL);
                    assert!(sorted.run_count() <= SMALL.fan_in);
                    assert!(read_all(&mut sorted) == expected, "{number} {is_bounded} {plan:?}");
                    sorted.rewind().unwrap();
                    assert!(read_all(&mut sorted) == expected, "{number}, read again");
                }
            }
        }
    }

    #[test]
    fn none_and_one_surfel_are_sorted() {
        for count in [0, 1] {
            let surfels = random_surfels(count);
            for plan in [Plan::new(64 << 20).unwrap(), SMALL] {
                let mut sorted =
                    sort_with_plan(&mut source(&surfels, false), &options(0, 1), plan).unwrap();
                assert_eq!(sorted.summary().count, count as u64);
                assert!(sorted.summary().root.edge > 0.0);
                assert_eq!(read_all(&mut sorted).len(), count);
            }
        }
    }

    #[test]
    fn budgets_threads_and_chunks_change_nothing() {
        let surfels = random_surfels(600_000);
        let expected = oracle(&surfels);
        for (budget, runs) in [(16, 4), (32, 2), (256, 0)] {
            for (threads, chunk) in [(1, 4096), (2, 777)] {
                let mut source = Source { chunk, ..source(&surfels, threads == 1) };
                let mut sorted =
                    sort_surfels(&mut source, &options(budget << 20, threads)).unwrap();
                assert_eq!(sorted.run_count(), runs);
                assert!(read_all(&mut sorted) == expected, "{budget} MiB, {threads} threads");
            }
        }
    }

    #[test]
    fn replayable_streams_repeat_themselves() {
        let surfels = random_surfels(20_000);
        let expected = oracle(&surfels);
        let sorted = sort_with_plan(&mut source(&surfels, true), &options(0, 1), SMALL).unwrap();
        let mut sorted = sorted.into_replayable().unwrap();
        // Rewinding halfway must not leave half a record.
        sorted.read_chunk(&mut Vec::new()).unwrap();
        for _ in 0..3 {
            sorted.rewind().unwrap();
            assert!(read_all(&mut sorted) == expected);
        }
        assert!(matches!(sorted.store, Store::File { .. }));
    }

    #[test]
    fn summaries_tell_what_is_there() {
        let mut surfels = random_surfels(100);
        surfels[7] = surfels[7].with_albedo([0.0, 0.5, 0.0]);
        surfels[8].radius = 4.0;
        let sorted = sort_surfels(&mut source(&surfels, false), &options(16 << 20, 1)).unwrap();
        let summary = sorted.summary();
        assert_eq!((summary.count, summary.radius_max, summary.area_sum), (100, 4.0, 100.0));
        assert_eq!((summary.radiance_max, summary.area_max), (99.0, 1.0));
        assert_eq!(summary.bounds, Aabb::from_points(surfels.iter().map(Surfel::center)));
        assert_eq!(summary.origin, DVec3::new(1.0, 2.0, 3.0));
        assert!(summary.any_albedo && !summary.any_isotropic && !summary.any_missing_size);
    }

    #[test]
    fn unusable_folders_are_errors() {
        let surfels = random_surfels(2000);
        let options = SortOptions { temp_dir: "no/such/folder".into(), ..options(0, 1) };
        let result = sort_with_plan(&mut source(&surfels, true), &options, SMALL);
        assert!(matches!(result.err(), Some(SortError::Temp { action: "create", .. })));
        // What fits the budget needs no folder.
        assert!(sort_with_plan(&mut source(&surfels[..900], true), &options, SMALL).is_ok());
    }

    #[test]
    fn lying_sources_are_found_out() {
        let surfels = random_surfels(100);
        let bounds = Some(Aabb { min: Vec3::ZERO, max: Vec3::splat(50.0) });
        let mut outside = Source { bounds, ..source(&surfels, true) };
        let error = sort_surfels(&mut outside, &options(16 << 20, 1)).err().unwrap();
        assert!(error.to_string().contains("outside the stated bounds"), "{error}");
        for position in [f32::NAN, f32::INFINITY] {
            let mut bad = surfels.clone();
            bad[5].position[1] = position;
            let error = sort_surfels(&mut source(&bad, false), &options(16 << 20, 1));
            assert!(matches!(error.err(), Some(SortError::BadSource { index: 5, .. })));
        }
    }

    #[test]
    fn sorting_can_be_canceled() {
        let surfels = random_surfels(100);
        let cancel = AtomicBool::new(true);
        let options = SortOptions { cancel: Some(&cancel), ..options(16 << 20, 1) };
        let result = sort_surfels(&mut source(&surfels, false), &options);
        assert!(matches!(result.err(), Some(SortError::Canceled)));
    }

    #[test]
    #[ignore = "measures speed; run with --release --ignored --nocapture"]
    fn speed_of_four_million_surfels() {
        let surfels = random_surfels(4_000_000);
        for (budget, is_bounded) in [(512, true), (512, false), (18, true), (18, false)] {
            let start = std::time::Instant::now();
            let mut source = source(&surfels, is_bounded);
            let mut sorted = sort_surfels(&mut source, &options(budget << 20, 0)).unwrap();
            let sort_time = start.elapsed();
            let (mut chunk, mut more) = (Vec::new(), true);
            while more {
                chunk.clear();
                more = sorted.read_chunk(&mut chunk).unwrap();
            }
            let total = start.elapsed();
            println!(
                "{budget} MiB, bounds known: {is_bounded}, {} runs: sorted in {sort_time:?}, read \
                 in {:?}, {:.2} M surfels/s",
                sorted.run_count(),
                total - sort_time,
                4.0 / total.as_secs_f64()
            );
        }
    }

    /// Random surfels made as they are read.
    struct Generator {
        left: usize,
        seed: u64,
        missing_sizes: bool,
    }

    impl SurfelSource for Generator {
        fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
            let now = self.left.min(4096);
            let size = if self.missing_sizes { 0.0 } else { 1.0 };
            out.extend((0..now).map(|_| {
                let mut next = || random(&mut self.seed) * 100.0;
                Surfel::new(Vec3::new(next(), next(), next()), Vec3::Z, size, size)
            }));
            self.left -= now;
            Ok(self.left > 0)
        }
    }

    #[cfg(target_os = "linux")]
    fn memory_bytes(key: &str) -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find(|line| line.starts_with(key)).unwrap();
        line.split_ascii_whitespace().nth(1).unwrap().parse::<u64>().unwrap() * 1024
    }

    #[test]
    #[cfg(target_os = "linux")]
    #[ignore = "measures the whole process; run alone with --ignored --nocapture"]
    fn peak_memory_stays_within_the_budget() {
        let run = |count, budget| {
            let mut source = Generator { left: count, seed: 1, missing_sizes: true };
            let options = options(budget, 0);
            let sorted = sort_surfels(&mut source, &options).unwrap();
            let estimate = crate::EstimateOptions::default();
            let (mut sorted, _) = crate::estimate_surfels(sorted, &estimate, &options).unwrap();
            let mut chunk = Vec::new();
            while sorted.read_chunk(&mut chunk).unwrap() {
                chunk.clear();
            }
        };
        // Pages of the program itself are not the sort's.
        run(10_000, crate::BUDGET_BYTES_MIN);
        let before = memory_bytes("VmRSS");
        for budget in [16 << 20, 64 << 20, 256 << 20] {
            run(4_000_000, budget);
            let held = memory_bytes("VmHWM") - before;
            println!("budget {budget}, peak {held}");
            assert!(held <= budget);
        }
    }
}
