//! What reading a scene takes: memory, and the files that it refers to.

use crate::SceneError;
use pbgi_file::{Allowance, Excess, FileId};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Whether an error is a lack of memory. That fails the scene: what memory there is must not decide what is left out.
pub(crate) fn is_lack_of_memory(error: &SceneError) -> bool {
    matches!(error, SceneError::Io { source, .. } if Excess::of(source).is_some())
}

/// Memory granted to a scene, and the files read for it.
pub(crate) struct Resources<'a> {
    allowance: &'a Allowance,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    files: Vec<PathBuf>,
    /// Contents of the files of buffers, which may be named many times.
    contents: HashMap<FileId, Arc<[u8]>>,
}

impl<'a> Resources<'a> {
    pub fn new(allowance: &'a Allowance) -> Self {
        Self { allowance, state: Mutex::new(State::default()) }
    }

    /// Takes memory for what `path` holds.
    pub fn take(&self, path: &Path, bytes: u64) -> Result<(), SceneError> {
        self.allowance.take(bytes).map_err(|e| SceneError::io(path, "read", e))
    }

    /// Whether there is memory for what is held for a while only.
    pub fn check(&self, path: &Path, bytes: u64) -> Result<(), SceneError> {
        self.allowance.check(bytes).map_err(|e| SceneError::io(path, "read", e))
    }

    /// Reads the file that is the scene itself.
    pub fn read(&self, path: &Path) -> Result<Vec<u8>, SceneError> {
        self.allowance.read(path).map_err(|e| SceneError::io(path, "read", e))
    }

    /// Reads a file that the scene refers to, once however often it is named.
    pub fn read_referred(&self, path: &Path) -> Result<Arc<[u8]>, SceneError> {
        let io = |e| SceneError::io(path, "read", e);
        let id = FileId::of(path).map_err(io)?;
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = state.contents.get(&id) {
            return Ok(Arc::clone(known));
        }
        let bytes: Arc<[u8]> = self.allowance.read(path).map_err(io)?.into();
        state.files.push(path.to_owned());
        state.contents.insert(id, Arc::clone(&bytes));
        Ok(bytes)
    }

    /// Adds a file that is read in another way.
    pub fn add_file(&self, path: &Path) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).files.push(path.to_owned());
    }

    /// The files that were read besides the scene's own.
    pub fn into_files(self) -> Vec<PathBuf> {
        self.state.into_inner().unwrap_or_else(PoisonError::into_inner).files
    }
}
