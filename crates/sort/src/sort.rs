//! From a source to the sorted stream.

use crate::buckets::Buckets;
use crate::checkpoint::Checkpoint;
use crate::form::RecordForm;
use crate::options::{Plan, SortOptions, SortPhase};
use crate::pieces::{Content, DividedSurfels, PieceWalk};
use crate::reader::{Checked, Chunk, with_chunks};
use crate::runs::Runs;
use crate::sorted::{SortedSurfels, Store};
use crate::temp_file::{SURFEL_BYTES, SpooledSource, TempFile};
use crate::trie::{Cell, Trie};
use crate::{SortError, SurfelSummary};
use pbgi_cloud::{Surfel, SurfelSource};
use pbgi_math::{Aabb, MortonCode, RootCube, Vec3};
use std::path::Path;

/// Surfels after which a cell may be divided although it is not full, where the rest of the input will fill it.
const EARLY_SURFELS: u64 = 1024;

/// Sorts all surfels of `source` into Morton order, equal codes in input order.
///
/// The root cube is that of the bounds of all centers. The result is the same for every budget, number of threads and
/// chunking of the source. A source that does not know its bounds ([`SurfelSource::find_bounds`]) is written down once more.
/// See [`SortOptions::budget_bytes`] for the memory held and [`SortOptions::temp_dir`] for the disk.
///
/// # Errors
///
/// If the source fails or lies about its bounds, the budget is below
/// [`crate::BUDGET_BYTES_MIN`], a temporary file fails or finds no room, or the caller cancels.
pub fn sort_surfels(
    source: &mut dyn SurfelSource,
    options: &SortOptions,
) -> Result<SortedSurfels, SortError> {
    sort_with_plan(source, options, Plan::new(options.budget_bytes, options.thread_count())?)
}

pub(crate) fn sort_with_plan(
    source: &mut dyn SurfelSource,
    options: &SortOptions,
    plan: Plan,
) -> Result<SortedSurfels, SortError> {
    if let Some((summary, plan, trie, runs)) =
        options.checkpoint.as_ref().and_then(Checkpoint::load)
    {
        let mut sorted = divided(summary, plan, trie, Content::Disk(runs), &options.temp_dir);
        sorted.is_resumed = true;
        return Ok(sorted);
    }
    match source.find_bounds()? {
        Some(bounds) => Sorter::new(options, plan, &bounds, source.count()).sort(source),
        None => {
            let (mut spooled, bounds) = spool(source, options)?;
            let count = spooled.count();
            Sorter::new(options, plan, &bounds, count).sort(&mut spooled)
        }
    }
}

/// Writes a source down as it is, and finds its bounds.
fn spool(
    source: &mut dyn SurfelSource,
    options: &SortOptions,
) -> Result<(SpooledSource, Aabb), SortError> {
    let (origin, total) = (source.origin(), source.count());
    let mut file = TempFile::create(&options.temp_dir)?;
    file.check_room(total.unwrap_or(0).saturating_mul(SURFEL_BYTES))?;
    let Checked { summary, .. } =
        with_chunks(source, None, options.thread_count(), &mut |chunk: &Chunk| {
            file.append(bytemuck::cast_slice(&chunk.surfels))?;
            options.check(SortPhase::Bounds, file.len() / SURFEL_BYTES, total)
        })?;
    Ok((SpooledSource::new(file, origin), summary.bounds))
}

struct Sorter<'a> {
    options: &'a SortOptions<'a>,
    plan: Plan,
    bounds: Aabb,
    root: RootCube,
    total: Option<u64>,
    trie: Trie,
    buckets: Buckets,
    runs: Option<Runs>,
    /// Form of all surfels in memory, and that of the chunk at hand.
    form: RecordForm,
    chunk_form: RecordForm,
    /// Surfels divided so far.
    done: u64,
}

impl<'a> Sorter<'a> {
    fn new(options: &'a SortOptions<'a>, plan: Plan, bounds: &Aabb, total: Option<u64>) -> Self {
        let root = match bounds.is_empty() {
            true => RootCube { min: Vec3::ZERO, edge: 1.0 },
            false => RootCube::from_bounds(bounds),
        };
        let mut buckets = Buckets::new(plan.for_total(total).held_surfels);
        let trie = Trie::new();
        buckets.reserve_lists(trie.node_count());
        Self {
            options,
            plan,
            bounds: *bounds,
            root,
            total,
            trie,
            buckets,
            runs: None,
            form: RecordForm::none(),
            chunk_form: RecordForm::none(),
            done: 0,
        }
    }

    fn sort(mut self, source: &mut dyn SurfelSource) -> Result<SortedSurfels, SortError> {
        let (root, threads) = (self.root, self.options.thread_count());
        let place = Some((self.bounds, root));
        let Checked { summary, .. } =
            with_chunks(source, place, threads, &mut |Chunk { surfels, codes }: &Chunk| {
                self.chunk_form = RecordForm::none();
                self.chunk_form.widen(surfels);
                self.form.widen(surfels);
                for (surfel, code) in surfels.iter().zip(codes) {
                    self.take(surfel, *code)?;
                }
                self.options.check(SortPhase::Read, self.done, self.total)
            })?;
        self.finish(SurfelSummary { root, ..summary })
    }

    /// Puts a surfel where it belongs.
    #[inline]
    fn take(&mut self, surfel: &Surfel, code: MortonCode) -> Result<(), SortError> {
        let mut cell = self.trie.locate(code);
        if self.is_to_divide(cell) {
            self.trie.divide(cell);
            self.buckets.reserve_lists(self.trie.node_count());
            cell = self.trie.locate(code);
        }
        if !self.buckets.push(cell.node, surfel) {
            self.spill()?;
            self.buckets.push(cell.node, surfel);
        }
        self.trie.add(cell.node);
        self.done += 1;
        Ok(())
    }

    /// Whether a cell is full, or will be.
    #[inline]
    fn is_to_divide(&self, cell: Cell) -> bool {
        let count = self.trie.count(cell.node);
        if count < EARLY_SURFELS.min(self.cell_surfels()) || cell.child_count() == 0 {
            return false;
        }
        if count >= self.cell_surfels() {
            return true;
        }
        // Where the rest of the input lies as what came so far does.
        let expected = self.total.map_or(0, |total| count as u128 * u128::from(total));
        self.trie.node_count() < self.plan.early_cells
            && expected > u128::from(self.cell_surfels()) * u128::from(self.done)
    }

    fn cell_surfels(&self) -> u64 {
        self.plan.piece_surfels as u64 / 2
    }

    /// Moves all surfels in memory to disk.
    fn spill(&mut self) -> Result<(), SortError> {
        if self.runs.is_none() {
            let file = match &self.options.checkpoint {
                Some(checkpoint) => TempFile::create_named(&checkpoint.runs_path())?,
                None => TempFile::create(&self.options.temp_dir)?,
            };
            file.check_room(
                self.total.unwrap_or(0).saturating_mul(self.form.record_bytes() as u64),
            )?;
            self.runs = Some(Runs::new(file));
        }
        if let Some(runs) = &mut self.runs {
            runs.write(&self.trie, &self.buckets, self.form)?;
        }
        self.buckets.clear();
        // Surfels of the chunk at hand are still to come.
        self.form = self.chunk_form;
        Ok(())
    }

    fn finish(mut self, summary: SurfelSummary) -> Result<SortedSurfels, SortError> {
        if self.runs.is_some() || self.options.checkpoint.is_some() {
            self.spill()?;
        }
        if let (Some(checkpoint), Some(runs)) = (&self.options.checkpoint, &self.runs) {
            checkpoint.save(&summary, &self.plan, &self.trie, runs)?;
        }
        // Where there are runs, the memory of the lists goes to read buffers.
        let content = match self.runs {
            Some(runs) => Content::Disk(runs),
            None => Content::Memory(self.buckets),
        };
        Ok(divided(summary, self.plan, self.trie, content, &self.options.temp_dir))
    }
}

fn divided(
    summary: SurfelSummary,
    plan: Plan,
    trie: Trie,
    content: Content,
    temp_dir: &Path,
) -> SortedSurfels {
    let run_count = match &content {
        Content::Disk(runs) => runs.run_count(),
        Content::Memory(_) => 0,
    };
    let divided = DividedSurfels {
        root: summary.root,
        trie,
        content,
        cell_surfels: plan.piece_surfels / 2,
        buffer_bytes: plan.read_buffer_bytes(run_count),
        releases: false,
    };
    let walk = PieceWalk::new(&divided);
    SortedSurfels::new(summary, plan, Store::Divided(Box::new(divided), walk), temp_dir)
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

    /// Small runs, cells and buffers, so that small clouds take every path.
    const SMALL: Plan =
        Plan { held_surfels: 1024, piece_surfels: 256, early_cells: 500, read_bytes: 20_000 };

    fn large() -> Plan {
        Plan::new(64 << 20, 2).unwrap()
    }

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
                for plan in [large(), SMALL] {
                    let mut source = source(cloud, is_bounded);
                    let mut sorted = sort_with_plan(&mut source, &options(0, 2), plan).unwrap();
                    assert_eq!(sorted.run_count() > 0, plan == SMALL);
                    assert!(read_all(&mut sorted) == expected, "{number} {is_bounded} {plan:?}");
                    sorted.rewind();
                    assert!(read_all(&mut sorted) == expected, "{number}, read again");
                    check_pieces(&mut sorted, 3 * plan.piece_surfels / 2);
                }
            }
        }
    }

    /// Pieces are small, and tell truly of which codes they hold all.
    fn check_pieces(sorted: &mut SortedSurfels, most: usize) {
        sorted.rewind();
        let mut pieces = Vec::new();
        while let Some(piece) = sorted.next_piece().unwrap() {
            assert!(!piece.is_empty() && piece.len() <= most, "{} of {most}", piece.len());
            pieces.push(piece.sort());
        }
        let mut whole_surfels = 0;
        for piece in &pieces {
            let is_whole = |code: &&MortonCode| piece.whole.contains(&code.0);
            let all = pieces.iter().flat_map(|p| &p.codes).filter(is_whole).count();
            assert_eq!(piece.codes.iter().filter(is_whole).count(), all);
            whole_surfels += all;
        }
        let equal = pieces.windows(2).filter(|p| p[0].codes.last() == p[1].codes.first()).count();
        let count = sorted.summary().count as usize;
        assert!(equal > 0 || whole_surfels == count, "{whole_surfels} of {count}");
    }

    #[test]
    fn none_and_one_surfel_are_sorted() {
        for count in [0, 1] {
            let surfels = random_surfels(count);
            for plan in [large(), SMALL] {
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
        for (budget, runs) in [(16, 5), (32, 2), (256, 0)] {
            for (threads, chunk) in [(1, 4096), (2, 777)] {
                let mut source = Source { chunk, ..source(&surfels, threads == 1) };
                let mut sorted =
                    sort_surfels(&mut source, &options(budget << 20, threads)).unwrap();
                assert_eq!(sorted.run_count(), runs, "{budget} MiB");
                let holds = options(budget << 20, threads).holds(expected.len() as u64);
                assert_eq!(holds, runs == 0, "{budget} MiB");
                assert!(read_all(&mut sorted) == expected, "{budget} MiB, {threads} threads");
            }
        }
    }

    /// Other systems give it back at the end.
    #[test]
    #[cfg(target_os = "linux")]
    fn space_is_given_back_as_it_is_read() {
        let surfels = random_surfels(200_000);
        let plan = Plan { held_surfels: 100_000, piece_surfels: 4096, ..SMALL };
        let mut sorted = sort_with_plan(&mut source(&surfels, true), &options(0, 1), plan).unwrap();
        sorted.release_as_read();
        assert!(read_all(&mut sorted) == oracle(&surfels));
        let Store::Divided(divided, _) = &sorted.store else { panic!("it is divided") };
        let Content::Disk(runs) = &divided.content else { panic!("it is on disk") };
        // Of 7.2 MB, less than the last megabyte of each run stays.
        let (count, held) = (runs.run_count(), runs.disk_bytes());
        assert!(count > 1 && held < 4_000_000, "{count} runs, {held} bytes");
    }

    #[test]
    fn kept_surfels_are_taken_up_again() {
        let folder = tempfile::tempdir().unwrap();
        let surfels = random_surfels(20_000);
        let checkpoint = |fingerprint| {
            let path = folder.path().join(".kept");
            let checkpoint = Some(Checkpoint { path, fingerprint });
            SortOptions { checkpoint, ..options(0, 1) }
        };
        let sort = |options: &SortOptions, surfels: &[Surfel], plan| {
            sort_with_plan(&mut source(surfels, true), options, plan).unwrap()
        };
        for plan in [SMALL, large()] {
            let first = sort(&checkpoint(7), &surfels, plan);
            assert!(!first.is_resumed() && first.run_count() > 0);
            let summary = *first.summary();
            drop(first);
            // The source is not asked again.
            let mut again = sort(&checkpoint(7), &[], plan);
            assert!(again.is_resumed() && *again.summary() == summary);
            assert!(read_all(&mut again) == oracle(&surfels));
            drop(again);
            // Other inputs, and damaged files, do not count.
            let other = sort(&checkpoint(8), &surfels[..5000], plan);
            assert!(!other.is_resumed() && other.summary().count == 5000);
        }
        let state = folder.path().join(".kept.state");
        let bytes = std::fs::read(&state).unwrap();
        for damage in 0..200 {
            let mut bytes = bytes.clone();
            let at = damage * 7919 % bytes.len();
            match damage % 2 {
                0 => bytes[at] ^= 1 << (damage % 8),
                _ => bytes.truncate(at),
            }
            std::fs::write(&state, bytes).unwrap();
            assert!(checkpoint(8).checkpoint.unwrap().load().is_none(), "{damage} at {at}");
        }
        checkpoint(8).checkpoint.unwrap().remove().unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
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
        assert!(sort_with_plan(&mut source(&surfels[..100], true), &options, SMALL).is_ok());
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
    #[cfg(target_os = "linux")]
    struct Generator {
        left: usize,
        seed: u64,
        missing_sizes: bool,
    }

    #[cfg(target_os = "linux")]
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
