//! Octrees between passes of light, and what a run needs to know to go on from the last finished one.

use crate::PbgiError;
use pbgi_file::{create_new, open_kept};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// A pass of light that is finished; its octree lies under [`PassFiles::octree`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FinishedPass {
    /// Its number; 0 is the octree of the surfels' own light.
    pub pass: u32,
    /// Largest radiance of its surfels.
    pub radiance_max: f32,
}

/// Where passes leave their octrees.
pub(crate) struct PassFiles {
    /// Path without extension.
    pub path: PathBuf,
    /// Tells inputs and options apart: what was kept serves only the same.
    pub fingerprint: u64,
}

/// What the state file holds.
#[derive(Serialize, Deserialize)]
struct State {
    fingerprint: u64,
    pass: u32,
    /// Bits of the largest radiance, which must come back exactly.
    radiance_max_bits: u32,
    /// The octree's header, whose checksums name the content of all of it.
    header: Vec<u8>,
    octree_bytes: u64,
}

/// Bytes that tell one octree file from another.
const HEADER_BYTES: usize = pbgi_format::HEADER_BYTES;

impl PassFiles {
    /// The octree that a pass leaves. That of the next one has another name, so that one of them is always whole.
    pub fn octree(&self, pass: u32) -> PathBuf {
        let extension = if pass.is_multiple_of(2) { "even.pbgi" } else { "odd.pbgi" };
        self.path.with_added_extension(extension)
    }

    fn state(&self) -> PathBuf {
        self.path.with_added_extension("passes")
    }

    fn unfinished_state(&self) -> PathBuf {
        self.path.with_added_extension("passes.part")
    }

    /// Writes down that a pass is finished, whose octree is on disk, and removes that of the pass before.
    ///
    /// # Errors
    ///
    /// If a file cannot be written, read or removed.
    pub fn save(&self, finished: FinishedPass) -> Result<(), PbgiError> {
        let octree = self.octree(finished.pass);
        let (header, octree_bytes) =
            read_header(&octree).map_err(|e| PbgiError::output(&octree, "read", e))?;
        let state = State {
            fingerprint: self.fingerprint,
            pass: finished.pass,
            radiance_max_bits: finished.radiance_max.to_bits(),
            header,
            octree_bytes,
        };
        let (path, part) = (self.state(), self.unfinished_state());
        let write = || {
            let mut file = create_new(&part)?;
            file.write_all(&serde_json::to_vec(&state)?)?;
            file.sync_all()?;
            std::fs::rename(&part, &path)
        };
        write().map_err(|e| PbgiError::output(&path, "write", e))?;
        remove(&self.octree(finished.pass + 1))
    }

    /// The last finished pass of the same inputs and options, if its octree is there.
    pub fn load(&self) -> Option<FinishedPass> {
        let state: State = serde_json::from_reader(open_kept(&self.state()).ok()?).ok()?;
        let found = read_header(&self.octree(state.pass)).ok()?;
        let is_same = state.fingerprint == self.fingerprint;
        (is_same && found == (state.header, state.octree_bytes)).then_some(FinishedPass {
            pass: state.pass,
            radiance_max: f32::from_bits(state.radiance_max_bits),
        })
    }
}

/// The header of an octree file, and the file's length.
fn read_header(octree: &Path) -> std::io::Result<(Vec<u8>, u64)> {
    let mut file = open_kept(octree)?;
    let mut header = vec![0; HEADER_BYTES];
    file.read_exact(&mut header)?;
    Ok((header, file.metadata()?.len()))
}

fn remove(path: &Path) -> Result<(), PbgiError> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(PbgiError::output(path, "remove", e))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_finished_pass_is_found_again_and_only_that() {
        let folder = tempfile::tempdir().unwrap();
        let files = PassFiles { path: folder.path().join(".scene"), fingerprint: 7 };
        let write = |pass: u32, byte: u8| {
            std::fs::write(files.octree(pass), vec![byte; HEADER_BYTES + 10]).unwrap();
        };
        assert_eq!(files.load(), None);
        for pass in 0..3 {
            write(pass, pass as u8);
            let finished = FinishedPass { pass, radiance_max: 0.1 + pass as f32 };
            files.save(finished).unwrap();
            assert_eq!(files.load(), Some(finished));
            // The next one is being written.
            write(pass + 1, 99);
            assert_eq!(files.load(), Some(finished));
        }
        let other = PassFiles { path: files.path.clone(), fingerprint: 8 };
        assert_eq!(other.load(), None);
        write(2, 5);
        assert_eq!(files.load(), None, "another octree has the name");
    }
}
