//! A scan as receivers: every point of a LAS or LAZ file, with the normal its neighbors tell.

use crate::shade::ShadeSettings;
use crate::{PbgiError, Progress};
use pbgi_cloud::{CloudError, LasPlaces, ReceiverTable, Surfel, SurfelSource};
use pbgi_math::{DVec3, Vec3};
use pbgi_sort::{
    BUDGET_BYTES_MIN, EstimateOptions, SortOptions, SortProgress, estimate_surfels, sort_surfels,
};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Surfels handed to the sort at once.
const CHUNK: usize = 4096;
/// Bytes a receiver is held in: place and normal.
const RECEIVER_BYTES: u64 = 24;
/// Part of the memory limit that sorting may take while normals are estimated.
const SORT_SHARE: u64 = 4;
/// Indices travel as two floats, which hold this many bits exactly.
const INDEX_BITS: u32 = 24;

/// Whether `path` begins as LAS and LAZ files do.
///
/// # Errors
///
/// If the file cannot be read.
pub(crate) fn is_scan(path: &Path) -> Result<bool, PbgiError> {
    let file = File::open(path).map_err(|e| CloudError::io(path, "open", e))?;
    let mut start = Vec::new();
    file.take(4).read_to_end(&mut start).map_err(|e| CloudError::io(path, "read", e))?;
    Ok(start == *b"LASF")
}

/// Whether `path` is named as LAS and LAZ files are.
pub(crate) fn is_scan_name(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    ["las", "laz"].iter().any(|e| extension.eq_ignore_ascii_case(e))
}

/// All points of a scan in the order of the file, noise and withheld ones too. Normals are estimated as those of baked
/// clouds are, on the side of `up`; points whose neighborhood is no surface look up. Sorting for it happens within a
/// quarter of the memory limit, with temporary files in `temp_dir`.
///
/// # Errors
///
/// If the file cannot be read or is damaged, the points do not fit into the memory limit, or on cancellation.
pub(crate) fn read_scan(
    path: &Path,
    settings: &ShadeSettings,
    temp_dir: &Path,
    up: Vec3,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<ReceiverTable, PbgiError> {
    let mut table = read_places(path, settings.memory_bytes)?;
    table.normals = vec![up; table.len()];
    if table.is_empty() {
        return Ok(table);
    }
    let phase = progress.start_phase("normals", "points", Some(table.len() as u64));
    let report_progress = |p: SortProgress| phase.set_done(p.done);
    let options = SortOptions {
        budget_bytes: (settings.memory_bytes / SORT_SHARE).max(BUDGET_BYTES_MIN),
        temp_dir: temp_dir.to_owned(),
        threads: settings.threads,
        cancel: Some(cancel),
        progress: Some(&report_progress),
        ..SortOptions::default()
    };
    let sorted = sort_surfels(&mut Places { positions: &table.positions, next: 0 }, &options)?;
    let estimate = EstimateOptions { normals: true, up };
    let (mut sorted, _) = estimate_surfels(sorted, &estimate, &options)?;
    sorted.rewind();
    let mut chunk = Vec::new();
    loop {
        chunk.clear();
        let more = sorted.read_chunk(&mut chunk)?;
        for (_, surfel) in chunk.iter().filter(|(_, surfel)| !surfel.is_isotropic()) {
            table.normals[index_of(surfel)] = surfel.normal();
        }
        if !more {
            return Ok(table);
        }
    }
}

fn read_places(path: &Path, memory_bytes: u64) -> Result<ReceiverTable, PbgiError> {
    let mut places = LasPlaces::open(path)?;
    let needed = places.count().saturating_mul(RECEIVER_BYTES);
    if needed > memory_bytes {
        return Err(PbgiError::budget(format!(
            "{}: {} receivers do not fit into {memory_bytes} bytes of memory; at least {needed} are needed \
             (--memory-limit), or shade the scan in tiles",
            path.display(),
            places.count()
        )));
    }
    let (mut table, mut chunk) = (ReceiverTable::default(), Vec::new());
    loop {
        chunk.clear();
        let more = places.read_chunk(&mut chunk)?;
        for place in &chunk {
            if table.is_empty() && place.is_finite() {
                table.origin = place.round();
            }
            let position = (*place - table.origin).as_vec3();
            if !(position.abs().max_element() <= 1e18) {
                let index = table.len();
                let message = format!("point {index}: place {place} is not finite, or beyond 1e18");
                return Err(CloudError::malformed(path, message).into());
            }
            table.positions.push(position);
        }
        if !more {
            return Ok(table);
        }
    }
}

/// Bare points as surfels that know their index.
struct Places<'a> {
    positions: &'a [Vec3],
    next: usize,
}

impl SurfelSource for Places<'_> {
    fn origin(&self) -> DVec3 {
        DVec3::ZERO
    }

    fn count(&self) -> Option<u64> {
        Some(self.positions.len() as u64)
    }

    fn read_chunk(&mut self, out: &mut Vec<Surfel>) -> Result<bool, CloudError> {
        let end = (self.next + CHUNK).min(self.positions.len());
        out.extend((self.next..end).map(|index| tagged(self.positions[index], index)));
        self.next = end;
        Ok(end < self.positions.len())
    }
}

/// A surfel of unknown size and normal. Sorting and estimating leave the radiance alone: the index travels in it.
fn tagged(position: Vec3, index: usize) -> Surfel {
    let low = index & ((1 << INDEX_BITS) - 1);
    Surfel::new(position, Vec3::Z, 0.0, 0.0)
        .with_flags(pbgi_cloud::SurfelFlags::ISOTROPIC)
        .with_radiance([low as f32, (index >> INDEX_BITS) as f32, 0.0])
}

fn index_of(surfel: &Surfel) -> usize {
    (surfel.radiance[1] as usize) << INDEX_BITS | surfel.radiance[0] as usize
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
