//! Files beside an output that are to become it, and those that killed runs have left there.
//!
//! They are called `.NAME.RANDOM.pbgi-tmp`, are made new, and are locked as long as their run lives: what is not locked was left.

use crate::folder_of;
use crate::platform::{has_name, name_of_bytes, open_unfollowed, use_ordinary_permissions};
use std::ffi::{OsStr, OsString};
use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;
use tempfile::NamedTempFile;

const SUFFIX: &str = ".pbgi-tmp";

/// Random letters of a name.
const RANDOM_LETTERS: usize = 12;

/// Most bytes of an output's name that go into those of its temporary files: names have 255 at most.
const NAME_BYTES_MAX: usize = 200;

/// Attempts to make a file that no other run takes away.
const ATTEMPTS: usize = 16;

/// How the names of an output's temporary files start.
fn prefix_of(target: &Path) -> io::Result<OsString> {
    let name = target.file_name().ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidInput, "the path does not end in a file name")
    })?;
    let name = &name.as_encoded_bytes()[..name.len().min(NAME_BYTES_MAX)];
    Ok(name_of_bytes(&[b".", name, b"."].concat()))
}

/// Whether a file is called like one that is to become another.
pub(crate) fn is_temporary_name(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(b".")
        && name.as_encoded_bytes().ends_with(SUFFIX.as_bytes())
}

/// Makes a new file beside `target`, which is locked, and removes those that killed runs have left for it.
pub(crate) fn create_beside(target: &Path) -> io::Result<NamedTempFile> {
    remove_left(target)?;
    let prefix = prefix_of(target)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(SUFFIX).rand_bytes(RANDOM_LETTERS);
    // It stays under its new name, with the permissions of ordinary files.
    use_ordinary_permissions(&mut builder);
    for _ in 0..ATTEMPTS {
        let file = builder.tempfile_in(folder_of(target))?;
        // Before it was locked, another run may have taken it for one that was left.
        let is_taken = matches!(try_lock(file.as_file()), Lock::Held);
        if !is_taken && has_name(file.as_file())? {
            return Ok(file);
        }
    }
    Err(io::Error::other("other runs remove every temporary file"))
}

/// Removes files that killed runs have left for `target`; returns whether a run that lives has one.
pub(crate) fn remove_left(target: &Path) -> io::Result<bool> {
    let prefix = prefix_of(target)?;
    let is_ours = |name: &OsStr| {
        let rest = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
        let letters = rest.and_then(|rest| rest.strip_suffix(SUFFIX.as_bytes()));
        letters
            .is_some_and(|l| l.len() == RANDOM_LETTERS && l.iter().all(u8::is_ascii_alphanumeric))
    };
    // A folder that cannot be listed keeps what was left.
    let Ok(entries) = std::fs::read_dir(folder_of(target)) else { return Ok(false) };
    let mut any_alive = false;
    for entry in entries.flatten().filter(|entry| is_ours(&entry.file_name())) {
        if !entry.file_type().is_ok_and(|kind| kind.is_file()) {
            continue;
        }
        let Ok(file) = open_unfollowed(&entry.path(), false) else { continue };
        match try_lock(&file) {
            Lock::Held => any_alive = true,
            // What cannot be removed stays as it is: it is litter only.
            Lock::Taken => drop(std::fs::remove_file(entry.path())),
            Lock::Unknown => {}
        }
    }
    Ok(any_alive)
}

/// What came of a try to lock a file.
pub(crate) enum Lock {
    /// It is locked now, until the file is closed.
    Taken,
    /// Another holds it.
    Held,
    /// The file system knows no locks.
    Unknown,
}

pub(crate) fn try_lock(file: &File) -> Lock {
    match file.try_lock() {
        Ok(()) => Lock::Taken,
        Err(TryLockError::WouldBlock) => Lock::Held,
        Err(TryLockError::Error(_)) => Lock::Unknown,
    }
}
