//! A scan as receivers: every point of a LAS or LAZ file, with the normal its neighbors tell.

use crate::points::scatter::{InOrder, Scatter};
use crate::shade::ShadeSettings;
use crate::{PbgiError, Progress};
use pbgi_cloud::{
    CloudError, LAS_MAGIC, LasPlaces, LasSurvey, ReceiverTable, Surfel, SurfelSource,
};
use pbgi_file::open_input;
use pbgi_math::{DVec3, Vec3, decode_octahedral24};
use pbgi_sort::{
    BUDGET_BYTES_MIN, EstimateOptions, SortOptions, SortProgress, estimate_surfels, sort_surfels,
};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Surfels handed to the sort at once.
const CHUNK: usize = 4096;
/// Part of the memory limit that sorting may take while normals are estimated.
const SORT_SHARE: u64 = 4;
/// Indices travel as two floats, which hold this many bits exactly.
const INDEX_BITS: u32 = 24;
/// Those of an encoded normal, and what stands for one that is not known.
const NORMAL_BITS: u32 = (1 << 24) - 1;
const NO_NORMAL: u32 = u32::MAX;

/// Whether `path` begins as LAS and LAZ files do.
///
/// # Errors
///
/// If the file cannot be read.
pub(crate) fn is_scan(path: &Path) -> Result<bool, PbgiError> {
    let file = open_input(path).map_err(|e| CloudError::io(path, "open", e))?;
    let mut start = Vec::new();
    file.take(4).read_to_end(&mut start).map_err(|e| CloudError::io(path, "read", e))?;
    Ok(start == LAS_MAGIC)
}

/// Whether `path` is named as LAS and LAZ files are.
pub(crate) fn is_scan_name(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    ["las", "laz"].iter().any(|e| extension.eq_ignore_ascii_case(e))
}

/// All points of a scan in the order of the file, noise and withheld ones too, in parts of bounded size. Normals are estimated as those of
/// baked clouds are, on the side of `up`; points whose neighborhood is no surface look up.
pub(crate) struct ScanReader {
    path: PathBuf,
    places: Places,
    normals: InOrder,
    up: Vec3,
}

impl ScanReader {
    /// Opens a scan and estimates its normals. Sorting for it happens within a quarter of the memory limit, with temporary files in
    /// `temp_dir`, as are the normals.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or is damaged, a temporary file fails, or on cancellation.
    pub fn open(
        path: &Path,
        settings: &ShadeSettings,
        temp_dir: &Path,
        up: Vec3,
        progress: &Progress,
        cancel: &AtomicBool,
    ) -> Result<Self, PbgiError> {
        let survey = LasPlaces::survey(path)?;
        let mut places = Places::open(path, survey)?;
        let count = places.count();
        let mut scatter = Scatter::create(temp_dir, count)?;
        if count > 0 {
            let phase = progress.start_phase("normals", "points", Some(count));
            let report_progress = |p: SortProgress| phase.set_done(p.done);
            let options = SortOptions {
                budget_bytes: (settings.memory_bytes / SORT_SHARE).max(BUDGET_BYTES_MIN),
                temp_dir: temp_dir.to_owned(),
                threads: settings.threads,
                cancel: Some(cancel),
                progress: Some(&report_progress),
                ..SortOptions::default()
            };
            estimate_normals(&mut places, &options, up, &mut scatter)?;
        }
        let (path, places) = (path.to_owned(), Places::open(path, survey)?);
        Ok(Self { path, places, normals: scatter.finish()?, up })
    }

    /// Number of points.
    pub fn count(&self) -> u64 {
        self.places.count()
    }

    /// World position of the coordinate origin: near most points.
    pub fn origin(&self) -> DVec3 {
        self.places.origin
    }

    /// Starts over.
    ///
    /// # Errors
    ///
    /// If the file cannot be opened again.
    pub fn rewind(&mut self) -> Result<(), PbgiError> {
        self.places = Places::open(&self.path, self.places.survey)?;
        self.normals.rewind();
        Ok(())
    }

    /// Replaces `table` by the next points, at most `points_max`; `false` when there are no more.
    ///
    /// # Errors
    ///
    /// If the points cannot be read on.
    pub fn read_chunk(
        &mut self,
        points_max: usize,
        table: &mut ReceiverTable,
    ) -> Result<bool, PbgiError> {
        *table = ReceiverTable { origin: self.origin(), ..ReceiverTable::default() };
        while table.len() < points_max {
            let Some(place) = self.places.next_place()? else { return Ok(false) };
            let code = self.normals.next()?.unwrap_or(NO_NORMAL);
            let normal = if code == NO_NORMAL { self.up } else { decode_octahedral24(code) };
            table.positions.push((place - table.origin).as_vec3());
            table.normals.push(normal);
            let [nx, ny, nz] = normal.as_dvec3().to_array();
            table.given.push([place.x, place.y, place.z, nx, ny, nz]);
        }
        Ok(self.places.done < self.count())
    }
}

/// Puts the normal of every place by its index.
fn estimate_normals(
    places: &mut Places,
    options: &SortOptions,
    up: Vec3,
    scatter: &mut Scatter,
) -> Result<(), PbgiError> {
    let sorted = sort_surfels(places, options)?;
    places.strays.iter().try_for_each(|&index| scatter.put(index, NO_NORMAL))?;
    let estimate = EstimateOptions { normals: true, up };
    let (mut sorted, _) = estimate_surfels(sorted, &estimate, options)?;
    sorted.rewind();
    let mut chunk = Vec::new();
    loop {
        chunk.clear();
        let more = sorted.read_chunk(&mut chunk)?;
        for (_, surfel) in &chunk {
            let normal = surfel.orientation & NORMAL_BITS;
            let code = if surfel.is_isotropic() { NO_NORMAL } else { normal };
            scatter.put(index_of(surfel), code)?;
        }
        if !more {
            return Ok(());
        }
    }
}

/// The places of a scan relative to an origin near most of them, one after the other.
struct Places {
    path: PathBuf,
    file: LasPlaces,
    survey: LasSurvey,
    origin: DVec3,
    /// Indices of the strays read so far.
    strays: Vec<u64>,
    /// Read from the file, and how far they are handed out.
    ahead: Vec<DVec3>,
    used: usize,
    done: u64,
}

impl Places {
    fn open(path: &Path, survey: LasSurvey) -> Result<Self, CloudError> {
        let (mut file, mut ahead) = (LasPlaces::open(path)?, Vec::new());
        file.read_chunk(&mut ahead)?;
        let (path, origin) = (path.to_owned(), survey.origin);
        let strays = Vec::new();
        Ok(Self { path, file, survey, origin, strays, ahead, used: 0, done: 0 })
    }

    /// Whether a place is far from all others: where neighbors are looked for, strays may not take the levels of the rest.
    fn is_stray(&self, place: DVec3) -> bool {
        let holds = |[min, max]: [DVec3; 2]| place.cmpge(min).all() && place.cmple(max).all();
        self.survey.limits.is_some_and(|limits| !holds(limits))
    }

    fn count(&self) -> u64 {
        self.file.count()
    }

    /// The next place, in the world.
    fn next_place(&mut self) -> Result<Option<DVec3>, CloudError> {
        if self.done == self.count() {
            return Ok(None);
        }
        if self.used == self.ahead.len() {
            self.ahead.clear();
            self.used = 0;
            self.file.read_chunk(&mut self.ahead)?;
        }
        let Some(place) = self.ahead.get(self.used).copied() else { return Ok(None) };
        if !((place - self.origin).abs().max_element() <= 1e18) {
            let message =
                format!("point {}: place {place} is not finite, or beyond 1e18", self.done);
            return Err(CloudError::malformed(&self.path, message));
        }
        self.used += 1;
        self.done += 1;
        Ok(Some(place))
    }
}

/// Bare points as surfels that know their index.
impl SurfelSource for Places {
    fn origin(&self) -> DVec3 {
        DVec3::ZERO
    }

    fn count(&self) -> Option<u64> {
        self.survey.limits.is_none().then(|| self.file.count())
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        for _ in 0..CHUNK {
            let index = self.done;
            let Some(place) = self.next_place()? else { break };
            match self.is_stray(place) {
                true => self.strays.push(index),
                false => out.push(tagged((place - self.origin).as_vec3(), index)),
            }
        }
        Ok(self.done < self.file.count())
    }
}

/// A surfel of unknown size and normal. Sorting and estimating leave the radiance alone: the index travels in it.
fn tagged(position: Vec3, index: u64) -> Surfel {
    let low = index & ((1 << INDEX_BITS) - 1);
    Surfel::new(position, Vec3::Z, 0.0, 0.0)
        .with_flags(pbgi_cloud::SurfelFlags::ISOTROPIC)
        .with_radiance([low as f32, (index >> INDEX_BITS) as f32, 0.0])
}

fn index_of(surfel: &Surfel) -> u64 {
    (surfel.radiance[1] as u64) << INDEX_BITS | surfel.radiance[0] as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_survive_their_travel() {
        for index in [0, 1, (1 << 24) - 1, 1 << 24, (1 << 24) + 1, 123_456_789_012] {
            assert_eq!(index_of(&tagged(Vec3::ZERO, index)), index);
        }
    }
}
