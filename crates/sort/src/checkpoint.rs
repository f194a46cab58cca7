//! A divided cloud on disk that outlives a killed process.

use crate::form::RecordForm;
use crate::options::Plan;
use crate::runs::{Run, Runs};
use crate::temp_file::TempFile;
use crate::trie::Trie;
use crate::{SortError, SurfelSummary};
use pbgi_cloud::Surfel;
use pbgi_file::{create_new, folder_of, open_kept};
use pbgi_math::{Aabb, DVec3, RootCube, Vec3};
use std::io::{Read, Write};
use std::path::PathBuf;

/// First word of a state file; another layout gets another.
const MAGIC: u64 = u64::from_le_bytes(*b"PBGISRT1");

/// Where a sort keeps what it has finished: the divided surfels and what it knows of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// Path without extension; the files are `.runs` and `.state`.
    pub path: PathBuf,
    /// Tells inputs and options apart: what was kept serves only the same.
    pub fingerprint: u64,
}

impl Checkpoint {
    pub(crate) fn runs_path(&self) -> PathBuf {
        self.path.with_added_extension("runs")
    }

    fn state_path(&self) -> PathBuf {
        self.path.with_added_extension("state")
    }

    fn unfinished_state_path(&self) -> PathBuf {
        self.path.with_added_extension("state.part")
    }

    /// Removes what is kept, if anything is.
    ///
    /// # Errors
    ///
    /// If a file is there and cannot be removed.
    pub fn remove(&self) -> Result<(), SortError> {
        for path in [self.state_path(), self.unfinished_state_path(), self.runs_path()] {
            match std::fs::remove_file(&path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    return Err(self.error("remove", e));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn error(&self, action: &'static str, source: std::io::Error) -> SortError {
        let dir = folder_of(&self.path).to_owned();
        SortError::Temp { dir, action, source }
    }

    /// Writes down what is known of runs that are complete; they are on disk before that is.
    pub(crate) fn save(
        &self,
        summary: &SurfelSummary,
        plan: &Plan,
        trie: &Trie,
        runs: &Runs,
    ) -> Result<(), SortError> {
        runs.file().sync()?;
        let mut words = vec![MAGIC, self.fingerprint, runs.file().len()];
        words.extend([plan.held_surfels, plan.piece_surfels].map(|n| n as u64));
        words.extend([plan.early_cells as u64, plan.read_bytes]);
        save_summary(summary, &mut words);
        trie.save(&mut words);
        words.push(runs.runs().len() as u64);
        for run in runs.runs() {
            words.push(run.start);
            words.extend(run.form.to_words());
            words.push(run.cells.len() as u64);
            words.extend(run.cells.iter().map(|&(n, len)| u64::from(n) << 32 | u64::from(len)));
        }
        words.push(checksum(&words));
        let (path, part) = (self.state_path(), self.unfinished_state_path());
        let write = || {
            let mut file = create_new(&part)?;
            file.write_all(bytemuck::cast_slice(&words))?;
            file.sync_all()?;
            std::fs::rename(&part, &path)
        };
        write().map_err(|e| self.error("write", e))
    }

    /// What was kept for the same fingerprint, if all of it is there.
    pub(crate) fn load(&self) -> Option<(SurfelSummary, Plan, Trie, Runs)> {
        let mut bytes = Vec::new();
        open_kept(&self.state_path()).ok()?.read_to_end(&mut bytes).ok()?;
        let words: Vec<u64> = bytes
            .chunks_exact(8)
            .map(|b| u64::from_le_bytes(std::array::from_fn(|i| b[i])))
            .collect();
        let (&last, words) = words.split_last()?;
        if last != checksum(words) || !bytes.len().is_multiple_of(8) {
            return None;
        }
        let mut words = words.iter().copied();
        if words.next()? != MAGIC || words.next()? != self.fingerprint {
            return None;
        }
        let file = TempFile::open(&self.runs_path(), words.next()?)?;
        let plan = Plan {
            held_surfels: words.next()? as usize,
            piece_surfels: words.next()? as usize,
            early_cells: words.next()? as usize,
            read_bytes: words.next()?,
        };
        let summary = load_summary(&mut words)?;
        let trie = Trie::load(&mut words)?;
        let run_count = words.next()?;
        let mut runs = Vec::new();
        for _ in 0..run_count {
            let start = words.next()?;
            let form = RecordForm::from_words(&mut words)?;
            let cell_count = words.next()?;
            let cells: Vec<(u32, u32)> = words
                .by_ref()
                .take(cell_count as usize)
                .map(|w| ((w >> 32) as u32, w as u32))
                .collect();
            runs.push(Run { start, form, cells });
        }
        words.next().is_none().then(|| (summary, plan, trie, Runs::from_parts(file, runs)))
    }
}

fn checksum(words: &[u64]) -> u64 {
    xxhash_rust::xxh3::xxh3_64(bytemuck::cast_slice(words))
}

fn save_summary(summary: &SurfelSummary, words: &mut Vec<u64>) {
    let SurfelSummary { root, origin, bounds, .. } = summary;
    let vec3 = |v: Vec3| v.to_array().map(|x| u64::from(x.to_bits()));
    words.extend([root.min, bounds.min, bounds.max].map(vec3).as_flattened());
    words.extend(origin.to_array().map(f64::to_bits));
    let floats = [root.edge, summary.radius_max, summary.area_max, summary.radiance_max];
    words.extend(floats.map(|x| u64::from(x.to_bits())));
    words.extend([summary.count, summary.area_sum.to_bits()]);
    words.extend(
        [
            summary.any_albedo,
            summary.any_isotropic,
            summary.any_front_only,
            summary.any_missing_size,
        ]
        .map(u64::from),
    );
}

fn load_summary(words: &mut impl Iterator<Item = u64>) -> Option<SurfelSummary> {
    let mut float = || words.next().map(|w| f32::from_bits(w as u32));
    let mut vec3 = || Some(Vec3::new(float()?, float()?, float()?));
    let (root_min, bounds) = (vec3()?, Aabb { min: vec3()?, max: vec3()? });
    let mut double = || words.next().map(f64::from_bits);
    let origin = DVec3::new(double()?, double()?, double()?);
    let mut float = || words.next().map(|w| f32::from_bits(w as u32));
    Some(SurfelSummary {
        root: RootCube { min: root_min, edge: float()? },
        origin,
        bounds,
        radius_max: float()?,
        area_max: float()?,
        radiance_max: float()?,
        count: words.next()?,
        area_sum: f64::from_bits(words.next()?),
        any_albedo: words.next()? != 0,
        any_isotropic: words.next()? != 0,
        any_front_only: words.next()? != 0,
        any_missing_size: words.next()? != 0,
    })
}

impl RecordForm {
    /// The form as whole words.
    fn to_words(self) -> [u64; WORDS_OF_FORM] {
        let mut bytes = [0; WORDS_OF_FORM * 8];
        let (common, stored) = self.to_parts();
        bytes[..size_of::<Surfel>()].copy_from_slice(bytemuck::bytes_of(&common));
        bytes[size_of::<Surfel>()..][..stored.len()].copy_from_slice(&stored.map(u8::from));
        std::array::from_fn(|i| u64::from_le_bytes(std::array::from_fn(|byte| bytes[8 * i + byte])))
    }

    fn from_words(words: &mut impl Iterator<Item = u64>) -> Option<Self> {
        let mut bytes = Vec::with_capacity(WORDS_OF_FORM * 8);
        for _ in 0..WORDS_OF_FORM {
            bytes.extend_from_slice(&words.next()?.to_le_bytes());
        }
        let (common, stored) = bytes.split_at(size_of::<Surfel>());
        let common: Surfel = bytemuck::pod_read_unaligned(common);
        Some(Self::from_parts(common, [stored[0] != 0, stored[1] != 0, stored[2] != 0]))
    }
}

/// A surfel of 44 bytes and three flags.
const WORDS_OF_FORM: usize = 6;
