//! From inputs to one octree file of lit surfels.

pub(crate) mod input;
pub(crate) mod octree_source;
pub(crate) mod pass_files;
pub(crate) mod relight;
pub(crate) mod report;
pub(crate) mod request;

use crate::PbgiError;
use crate::bake::input::{Inputs, OctreeUse, SceneSampling};
use crate::bake::pass_files::{FinishedPass, PassFiles};
use crate::bake::relight::{EmissionPieces, Light, PassSettings, RelitStream, check_canceled};
use crate::bake::report::{BakeReport, BytesPerSurfel, PhaseReport};
use crate::bake::request::{BakeRequest, NormalsChoice};
use crate::budget::bake::BakeMemory;
use crate::budget::disk_space::{DiskSpace, DiskUse};
use crate::budget::split::node_bytes;
use crate::figures::format_bytes;
use crate::output_path::{are_on_one_disk, free_bytes, kept_files};
use crate::progress::{Phase, Progress};
use pbgi_build::{
    BuildOptions, BuildReport, ChannelChoice, StreamSummary, build_octree, build_octree_from_pieces,
};
use pbgi_cloud::SurfelSource;
use pbgi_file::platform::{peak_resident_bytes, process_use};
use pbgi_file::{Claim, ClaimError, KeptFiles, folder_of};
use pbgi_format::COORDINATE_MAX;
use pbgi_light::UpAxis;
use pbgi_math::{Aabb, Vec3};
use pbgi_sort::{
    BUDGET_BYTES_MIN, Checkpoint, EstimateOptions, SortOptions, SortPhase, SortProgress,
    SortedSurfels, SurfelSummary, estimate_surfels, pieces_in_flight, sort_surfels,
};
use pbgi_store::{Octree, OpenOptions};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Bakes inputs into one octree file.
///
/// The memory limit is split thus: what the process holds once the inputs are open (program,
/// meshes, prepared environment); a reserve for building and shading; of the rest all goes to the
/// sort, or half where light is baked. The page cache then gets what the sorted surfels leave. The
/// file depends on the inputs and on the options of sampling, light and layout, never on limit,
/// threads or folders.
///
/// Baking light: the first octree holds emission only. With an environment, a pass lights every
/// surfel by it; each bounce is one more pass, with the light of environment and surfels.
///
/// # Errors
///
/// [`PbgiError`]; the output is then as it was before, and no temporary file stays.
pub fn bake(
    request: &BakeRequest,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<BakeReport, PbgiError> {
    let start = Instant::now();
    let peak_before = peak_resident_bytes();
    request.check()?;
    let _claim = claim(&request.output)?;
    let raster_edge = request.light.is_any().then_some(request.light.raster_edge);
    let memory = BakeMemory::new(request.memory_limit, request.threads, raster_edge);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(memory.threads)
        .build()
        .map_err(|e| PbgiError::failed(format!("cannot start {} threads: {e}", memory.threads)))?;
    let octrees = match (request.light.is_any(), request.unlit) {
        (false, _) => OctreeUse::Keep,
        (true, false) => OctreeUse::Light,
        (true, true) => OctreeUse::LightUnlit,
    };
    let mut inputs = pool
        .install(|| Inputs::open(&request.inputs, &request.cloud, octrees, request.memory_limit))?;
    check_canceled(cancel)?;
    let z_up = request.up.map_or(inputs.any_z_up, |up| up == UpAxis::Z);
    let mut light = pool.install(|| Light::load(&request.light, z_up, request.memory_limit))?;
    light.settings.node_bytes = node_bytes(request.memory_limit, memory.threads);
    // Sort, estimate where there may be something to estimate, build, light.
    progress.set_phase_count(2 + u32::from(inputs.any_cloud()) + light.pass_count());
    let report = BakeReport {
        warnings: light.warnings.clone(),
        inputs: request.inputs.clone(),
        output: request.output.display().to_string(),
        threads: memory.threads,
        memory_limit_bytes: request.memory_limit,
        ..BakeReport::default()
    };
    let mut files = request.files()?;
    inputs.files().iter().try_for_each(|file| files.add_input(file))?;
    let kept = kept_files(&request.temp_dir(), &request.output);
    let path = take_up_or_start(request, &kept)?;
    let fingerprint = request.fingerprint(&inputs.files());
    let passes = PassFiles { path: path.clone(), fingerprint };
    let checkpoint = Checkpoint { path, fingerprint };
    let mut baker =
        Baker { request, memory, progress, cancel, light, z_up, report, checkpoint, passes };
    let sorted = pool.install(|| baker.sort(&mut inputs))?;
    baker.report.warnings.append(&mut inputs.warnings);
    baker.report.lights = inputs.light_count as u64;
    let lacks_normals = inputs.any_lacks_normals;
    // Meshes are not needed any more; what they held goes to the page cache.
    drop((inputs, pool));
    let sorted = baker.estimate(sorted, lacks_normals)?;
    let build = baker.build(sorted)?;
    remove_kept(&kept, None, request)?;
    Ok(baker.finish(&build, start, peak_before))
}

/// Claims the output: what another bake of it has made so far must not be touched.
fn claim(output: &Path) -> Result<Claim, PbgiError> {
    Claim::take(output).map_err(|error| match error {
        ClaimError::Busy => PbgiError::failed(format!(
            "{}: another bake works on this output; wait for it, or name another output (-o)",
            output.display()
        )),
        ClaimError::Io(source) => PbgiError::output(output, "create", source),
    })
}

/// Path without extension of what this bake keeps for the next one: that of an earlier run to be taken up, or a new one. What other runs
/// have left is removed.
fn take_up_or_start(request: &BakeRequest, kept: &KeptFiles) -> Result<PathBuf, PbgiError> {
    let found = if request.resume { kept.find() } else { None };
    remove_kept(kept, found.as_deref(), request)?;
    Ok(found.unwrap_or_else(|| kept.new_path()))
}

fn remove_kept(
    kept: &KeptFiles,
    but: Option<&Path>,
    request: &BakeRequest,
) -> Result<(), PbgiError> {
    kept.remove(but).map_err(|e| PbgiError::output(&request.temp_dir(), "remove files in", e))
}

/// Largest area of an estimated surfel, as a share of the root cube's face, below which points lie on each other.
const COINCIDENT_AREA_SHARE: f32 = 1.0 / (1u64 << 36) as f32;

/// A bake under way.
struct Baker<'a> {
    request: &'a BakeRequest,
    memory: BakeMemory,
    progress: &'a Progress,
    cancel: &'a AtomicBool,
    light: Light,
    z_up: bool,
    report: BakeReport,
    /// What the sort leaves for a run that takes up this one.
    checkpoint: Checkpoint,
    /// What passes of light leave for one another, and for such a run.
    passes: PassFiles,
}

impl<'a> Baker<'a> {
    /// Dices meshes, reads clouds, and sorts it all.
    fn sort(&mut self, inputs: &mut Inputs) -> Result<SortedSurfels, PbgiError> {
        let BakeRequest { sampling, two_sided, occlusion_only, .. } = *self.request;
        let light_scale = if occlusion_only { 0.0 } else { self.request.light_scale };
        let start = Instant::now();
        let cache_bytes = inputs.cache_bytes;
        let (mut source, spacing) =
            inputs.read_as_one(SceneSampling { sampling, two_sided, light_scale }, self.cancel)?;
        self.report.spacing = spacing;
        if let Some(spacing) = spacing {
            self.progress.note(&format!(
                "meshes are diced into micropolygons of at most {spacing:.6} units \
                 (--spacing or --surfels set it)"
            ));
        }
        let budget_bytes =
            self.memory.sort_bytes()?.saturating_sub(cache_bytes).max(BUDGET_BYTES_MIN);
        self.progress.note(&format!(
            "memory limit {}: {} to sort with, {} in reserve; {} threads; temporary files in {}",
            format_bytes(self.request.memory_limit),
            format_bytes(budget_bytes),
            format_bytes(self.memory.reserve()),
            self.memory.threads,
            self.request.temp_dir().display()
        ));
        if let Some(count) = source.count() {
            self.state_disk_space(count, budget_bytes);
        }
        let phases = SortPhases::new(self.progress, source.count());
        let report_progress = |p: SortProgress| phases.show(p);
        let options =
            SortOptions { progress: Some(&report_progress), ..self.sort_options(budget_bytes) };
        let sorted = sort_surfels(&mut source, &options)?;
        drop(phases);
        if sorted.is_resumed() {
            self.progress.note("taking up the surfels that an earlier run has sorted (--resume)");
        }
        self.report.skipped = source.skipped();
        let left_out = source.left_out();
        self.report.left_out_by_class = left_out.by_class;
        self.report.left_out_withheld = left_out.withheld;
        self.report.warnings.extend(source.warnings());
        let count = sorted.summary().count;
        if count == 0 {
            drop(source);
            inputs.warnings.iter().for_each(|warning| self.progress.warn(warning));
            let names = self.request.inputs.join(", ");
            let why: String = inputs.all_holes.iter().map(|why| format!("; {why}")).collect();
            return Err(PbgiError::input(format!(
                "{names}: no surfels; an octree needs at least one{why}"
            )));
        }
        check_scale(sorted.summary())?;
        self.report.sorted_runs = sorted.run_count() as u64;
        self.end_phase("sort", start, count);
        Ok(sorted)
    }

    /// Says how much room temporary files and output will need, and warns where there is less.
    fn state_disk_space(&mut self, surfels: u64, sort_bytes: u64) {
        let resumes = self.request.resume;
        let passes = self.light.pass_count();
        let is_held = self.sort_options(sort_bytes).holds(surfels);
        let space = DiskSpace::new(DiskUse { surfels, is_held, passes, resumes });
        let (temp_dir, folder) = (self.request.temp_dir(), folder_of(&self.request.output));
        let free = free_bytes(&temp_dir).zip(free_bytes(folder));
        let shown_free = free.map_or(String::new(), |(temp, output)| {
            format!(" ({} and {} are free)", format_bytes(temp), format_bytes(output))
        });
        let temporary = match passes {
            0 => "temporary files, given back as they are read",
            _ => "temporary files, octrees between passes of light among them",
        };
        self.progress.note(&format!(
            "disk space: at most {} for {temporary}, and about {} for the output{shown_free}",
            format_bytes(space.temporary),
            format_bytes(space.output),
        ));
        let is_one_disk = are_on_one_disk(&temp_dir, folder);
        if free.is_some_and(|(temp, output)| space.exceeds(temp, output, is_one_disk)) {
            self.report.warnings.push(
                "the disk may become full; should it, nothing half-written stays (--temp-dir names another for temporary files)"
                    .to_owned(),
            );
        }
    }

    fn sort_options(&self, budget_bytes: u64) -> SortOptions<'_> {
        SortOptions {
            budget_bytes,
            temp_dir: self.request.temp_dir(),
            threads: self.memory.threads,
            cancel: Some(self.cancel),
            checkpoint: self.request.resume.then(|| self.checkpoint.clone()),
            progress: None,
        }
    }

    /// Gives surfels the sizes and normals their clouds did not have.
    fn estimate(
        &mut self,
        sorted: SortedSurfels,
        lacks_normals: bool,
    ) -> Result<SortedSurfels, PbgiError> {
        let summary = *sorted.summary();
        let normals = lacks_normals && self.request.normals == NormalsChoice::Estimate;
        if !(summary.any_missing_size || (normals && summary.any_isotropic)) {
            return Ok(sorted);
        }
        let start = Instant::now();
        let phase = self.progress.start_phase("estimate", "surfels", Some(summary.count));
        let report_progress = |p: SortProgress| phase.set_done(p.done);
        let up = if self.z_up { Vec3::Z } else { Vec3::Y };
        let sort_options = SortOptions {
            progress: Some(&report_progress),
            ..self.sort_options(self.request.memory_limit)
        };
        let (sorted, estimated) =
            estimate_surfels(sorted, &EstimateOptions { normals, up }, &sort_options)?;
        drop(phase);
        self.report.estimated_sizes = estimated.sizes;
        self.report.estimated_normals = estimated.normals;
        let summary = *sorted.summary();
        // Points on a surface that wide have larger sizes, however many they are.
        let least = summary.root.edge.powi(2) * COINCIDENT_AREA_SHARE;
        if estimated.sizes == summary.count && summary.area_max < least {
            self.report.warnings.push(
                "most points coincide with a dozen others, so that no sizes can be told: nothing blocks or reflects; leave out the copies"
                    .to_owned(),
            );
        }
        self.end_phase("estimate", start, summary.count);
        Ok(sorted)
    }

    /// Writes the output, after the passes of light it needs.
    fn build(&mut self, mut sorted: SortedSurfels) -> Result<BuildReport, PbgiError> {
        let request = self.request;
        let summary = *sorted.summary();
        let passes = self.count_passes(&summary);
        if passes == 0 {
            let channels = match request.occlusion_only {
                true => ChannelChoice::Occlusion,
                false => ChannelChoice::AsNeeded,
            };
            let options = BuildOptions { channels, ..self.output_options() };
            if !request.resume {
                sorted.release_as_read();
            }
            return self.build_emission(&mut sorted, &options, &request.output);
        }
        let mut finished = match self.take_up_pass(passes) {
            Some(finished) => finished,
            None => self.build_dark(&mut sorted)?,
        };
        loop {
            let (octree, threads) = self.open_temporary(&self.passes.octree(finished.pass))?;
            sorted.rewind();
            let pass = finished.pass + 1;
            let is_last = pass == passes;
            let (options, target) = if is_last {
                (self.output_options(), request.output.clone())
            } else {
                (self.temporary_options(), self.passes.octree(pass))
            };
            let pass_light =
                PassLight { octree: &octree, threads, source_max: finished.radiance_max, pass };
            let (build, radiance_max) =
                self.light_pass(&mut sorted, &pass_light, &options, &target)?;
            if is_last {
                return Ok(build);
            }
            finished = FinishedPass { pass, radiance_max };
            self.keep_pass(finished)?;
        }
    }

    /// Builds the octree that the first pass of light gathers from.
    fn build_dark(&mut self, sorted: &mut SortedSurfels) -> Result<FinishedPass, PbgiError> {
        // What the environment's pass needs is only what blocks.
        let has_environment = self.light.has_environment();
        let channels =
            if has_environment { ChannelChoice::Occlusion } else { ChannelChoice::AsNeeded };
        let options = BuildOptions { channels, ..self.temporary_options() };
        let emitted = sorted.summary().radiance_max;
        self.build_emission(sorted, &options, &self.passes.octree(0))?;
        let finished =
            FinishedPass { pass: 0, radiance_max: if has_environment { 0.0 } else { emitted } };
        self.keep_pass(finished)?;
        Ok(finished)
    }

    /// The pass to go on from, if an earlier run has kept one of the `passes`.
    fn take_up_pass(&self, passes: u32) -> Option<FinishedPass> {
        let kept = self.request.resume.then(|| self.passes.load()).flatten();
        let kept = kept.filter(|kept| kept.pass < passes)?;
        self.progress.note(&format!(
            "going on after pass {} of {passes} of light, which an earlier run has finished (--resume)",
            kept.pass
        ));
        Some(kept)
    }

    /// Lets a finished pass outlive this run, if asked to.
    fn keep_pass(&self, finished: FinishedPass) -> Result<(), PbgiError> {
        if self.request.resume { self.passes.save(finished) } else { Ok(()) }
    }

    /// Passes of light; 0 where they would change nothing.
    fn count_passes(&mut self, summary: &SurfelSummary) -> u32 {
        let passes = self.light.pass_count();
        let reason = if passes == 0 {
            return 0;
        } else if !summary.any_albedo {
            "all surfels are black, so that no light is reflected"
        } else if !self.light.has_environment() && summary.radiance_max == 0.0 {
            "nothing shines: no surfel emits light, and there is no environment (--env)"
        } else {
            return passes;
        };
        self.report.warnings.push(format!("light was not baked: {reason}"));
        0
    }

    /// Builds `target` from the surfels as they are.
    fn build_emission(
        &mut self,
        sorted: &mut SortedSurfels,
        options: &BuildOptions<'_>,
        target: &Path,
    ) -> Result<BuildReport, PbgiError> {
        let start = Instant::now();
        let summary = *sorted.summary();
        let phase = self.progress.start_phase("build", "surfels", Some(summary.count));
        let options = BuildOptions { progress: &|done| phase.set_done(done), ..*options };
        let summary = self.stream_summary(&summary, summary.radiance_max);
        let mut pieces = EmissionPieces { sorted };
        let build = build_octree_from_pieces(&mut pieces, &summary, &options, target)?;
        phase.set_done(build.surfels);
        drop(phase);
        self.end_phase("build", start, build.surfels);
        Ok(build)
    }

    /// Builds `target` from the surfels with the light they receive; returns the largest radiance,
    /// too.
    fn light_pass(
        &mut self,
        sorted: &mut SortedSurfels,
        from: &PassLight<'_>,
        options: &BuildOptions<'_>,
        target: &Path,
    ) -> Result<(BuildReport, f32), PbgiError> {
        let start = Instant::now();
        let summary = *sorted.summary();
        let bounce = from.pass - u32::from(self.light.has_environment());
        let name = if bounce == 0 { "light" } else { "bounce" };
        let phase = self.progress.start_phase(name, "surfels", Some(summary.count));
        let radiance_bound = self.light.radiance_bound(summary.radiance_max, from.source_max);
        let pass = PassSettings {
            octree: from.octree,
            light: &self.light,
            threads: from.threads,
            radiance_bound,
            phase: &phase,
            cancel: self.cancel,
        };
        let mut stream = RelitStream::new(sorted, pass);
        let summary = self.stream_summary(&summary, radiance_bound);
        let build = build_octree(&mut stream, &summary, options, target)?;
        let (reached, gathers) = (stream.radiance_max, stream.gathers);
        phase.set_done(build.surfels);
        drop(phase);
        let report = PhaseReport::new(name, start.elapsed().as_secs_f64(), build.surfels);
        self.report.phases.push(report.of_light(bounce, gathers));
        Ok((build, reached))
    }

    /// Opens the octree of the pass before and takes its name away, so that nothing stays behind
    /// however this run ends, unless it is to be kept. Returns the number of threads its cache serves, too.
    fn open_temporary(&self, path: &Path) -> Result<(Octree, usize), PbgiError> {
        let (cache_bytes, readers) = self.memory.cache();
        self.progress.detail(&format!(
            "page cache {} for {readers} threads while surfels are lit",
            format_bytes(cache_bytes)
        ));
        let options = OpenOptions { cache_bytes, readers, ..OpenOptions::default() };
        let octree = Octree::open(path, &options);
        if !self.request.resume {
            std::fs::remove_file(path).map_err(|e| PbgiError::output(path, "remove", e))?;
        }
        Ok((octree?, readers))
    }

    fn output_options(&self) -> BuildOptions<'a> {
        BuildOptions {
            page_bytes: self.request.page_bytes,
            leaf_surfels_max: self.request.leaf_surfels_max,
            compress: self.request.compress,
            albedo: !self.request.occlusion_only,
            ..self.temporary_options()
        }
    }

    fn temporary_options(&self) -> BuildOptions<'a> {
        BuildOptions {
            albedo: false,
            threads: self.memory.threads,
            pieces_in_flight: pieces_in_flight(self.memory.threads),
            cancel: self.cancel,
            ..BuildOptions::default()
        }
    }

    fn stream_summary(&self, summary: &SurfelSummary, radiance_max: f32) -> StreamSummary {
        StreamSummary {
            root: summary.root,
            origin: summary.origin,
            surfel_count: summary.count,
            radius_max: summary.radius_max,
            area_max: summary.area_max,
            radiance_max,
            any_albedo: summary.any_albedo,
            any_isotropic: summary.any_isotropic,
            z_up: self.z_up,
        }
    }

    fn end_phase(&mut self, name: &'static str, start: Instant, surfels: u64) {
        let seconds = start.elapsed().as_secs_f64();
        self.report.phases.push(PhaseReport::new(name, seconds, surfels));
    }

    /// The report of the whole, and its warnings to the user. What the process held before, at its peak, is not the bake's doing.
    fn finish(
        mut self,
        build: &BuildReport,
        start: Instant,
        peak_before: Option<u64>,
    ) -> BakeReport {
        let seconds = start.elapsed().as_secs_f64();
        let peak = peak_resident_bytes();
        let used = process_use().unwrap_or_default();
        let exceeds = |&peak: &u64| peak > self.request.memory_limit && Some(peak) > peak_before;
        if let Some(peak) = peak.filter(exceeds) {
            let (peak, limit) = (format_bytes(peak), format_bytes(self.request.memory_limit));
            self.report.warnings.push(format!(
                "the peak of memory, {peak}, exceeds the limit of {limit}: reading the inputs took more"
            ));
        }
        // Some are dark in any scene; where many are, something is too bright.
        if build.dim_surfels * DIM_SHARE_INVERSE > build.surfels {
            self.report.warnings.push(format!(
                "{} of {} surfels shine about 10^10 times less than the brightest, and more: the file cannot hold both, so that clusters of them \
                 lose light and may be black; leave out what is so bright, or make it darker",
                build.dim_surfels, build.surfels,
            ));
        }
        for warning in &self.report.warnings {
            self.progress.warn(warning);
        }
        BakeReport {
            surfels: build.surfels,
            nodes: build.nodes,
            leaves: build.leaves,
            pages: build.pages,
            file_bytes: build.file_bytes,
            bytes_per_surfel: BytesPerSurfel::new(build),
            seconds,
            surfels_per_second: build.surfels as f64 / seconds.max(1e-9),
            user_seconds: used.user_seconds,
            system_seconds: used.system_seconds,
            read_bytes: used.read_bytes,
            written_bytes: used.written_bytes,
            memory_peak_bytes: peak,
            ..self.report
        }
    }
}

/// Of so many surfels one may be too dim for the file without a warning.
const DIM_SHARE_INVERSE: u64 = 10;

/// Least size of a cloud, 2⁻²³ scene units, with which results are those of the same cloud at any other scale.
const SCALE_MIN: f32 = 1.0 / (1 << 23) as f32;

/// Refuses clouds so large or so small that sums and products of their sizes are no numbers any more.
fn check_scale(summary: &SurfelSummary) -> Result<(), PbgiError> {
    let Aabb { min, max } = summary.bounds;
    let farthest = min.abs().max(max.abs()).max_element() + summary.radius_max;
    let size = summary.root.edge.max(summary.radius_max);
    if farthest <= COORDINATE_MAX && size >= SCALE_MIN {
        return Ok(());
    }
    Err(PbgiError::input(format!(
        "the surfels reach to {farthest} units from the origin of the file and lie in a cube of {size} units; results are right up to \
         {COORDINATE_MAX} units, and from {SCALE_MIN} units on: scale the scene"
    )))
}

/// What a pass of light gathers from.
struct PassLight<'a> {
    /// Octree of the pass before.
    octree: &'a Octree,
    /// Threads its cache has room for.
    threads: usize,
    /// Its largest radiance.
    source_max: f32,
    /// Number of the pass, from 1.
    pass: u32,
}

/// Phases of the sort, each shown as one of the run.
struct SortPhases<'a> {
    progress: &'a Progress,
    total: Option<u64>,
    current: Mutex<Option<(SortPhase, Phase<'a>)>>,
}

impl<'a> SortPhases<'a> {
    fn new(progress: &'a Progress, total: Option<u64>) -> Self {
        let first = (SortPhase::Read, progress.start_phase("sort", "surfels", total));
        Self { progress, total, current: Mutex::new(Some(first)) }
    }

    fn show(&self, state: SortProgress) {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_none_or(|(phase, _)| *phase != state.phase) {
            // The phase before ends before the next one starts.
            *current = None;
            let name = match state.phase {
                SortPhase::Bounds => "bounds",
                SortPhase::Read | SortPhase::Estimate => "sort",
            };
            let phase = self.progress.start_phase(name, "surfels", state.total.or(self.total));
            *current = Some((state.phase, phase));
        }
        if let Some((_, phase)) = current.as_ref() {
            phase.set_done(state.done);
        }
    }
}
