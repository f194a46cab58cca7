//! Windows.

use std::ffi::OsString;
use std::fs::{File, FileType, Metadata};
use std::io;
use std::os::windows::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use tempfile::TempPath;
use winapi_util::Handle;
use winapi_util::file::information;

/// Opens a link itself and not what it leads to.
const FILE_FLAG_OPEN_REPARSE_POINT: u32 = 0x0020_0000;

/// Fills `out` with the bytes from `offset` on.
///
/// # Errors
///
/// If not all of them can be read.
pub fn read_exact_at(file: &File, mut out: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !out.is_empty() {
        match file.seek_read(out, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                out = &mut out[count..];
                offset += count as u64;
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// Writes `bytes` from `offset` on.
///
/// # Errors
///
/// If not all of them can be written.
pub fn write_all_at(file: &File, mut bytes: &[u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match file.seek_write(bytes, offset) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(count) => {
                bytes = &bytes[count..];
                offset += count as u64;
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

/// Whether this is a pipe: pipes have no names in folders here.
#[must_use]
pub fn is_pipe(_kind: FileType) -> bool {
    false
}

/// Whether this is a device of characters: what is neither file, folder nor link.
#[must_use]
pub fn is_character_device(kind: FileType) -> bool {
    !(kind.is_file() || kind.is_dir() || kind.is_symlink())
}

/// Whether this is a socket: sockets have no names in folders here.
#[must_use]
pub fn is_socket(_kind: FileType) -> bool {
    false
}

/// Opens a file for reading.
///
/// # Errors
///
/// If it cannot be opened.
pub fn open_without_waiting(path: &Path) -> io::Result<File> {
    File::open(path)
}

/// Opens a device for writing.
///
/// # Errors
///
/// If it cannot be opened.
pub fn open_in_place(path: &Path) -> io::Result<File> {
    File::options().write(true).open(path)
}

/// Opens a file, but not what a link leads to, for reading and, if wanted, for writing.
///
/// # Errors
///
/// If it cannot be opened.
pub fn open_unfollowed(path: &Path, write: bool) -> io::Result<File> {
    File::options().read(true).write(write).custom_flags(FILE_FLAG_OPEN_REPARSE_POINT).open(path)
}

/// Makes a new file, which has the permissions of its folder.
///
/// # Errors
///
/// If it cannot be made.
pub fn create_private(path: &Path) -> io::Result<File> {
    File::options().read(true).write(true).create_new(true).open(path)
}

/// Files have the permissions of their folder.
pub fn use_ordinary_permissions(_builder: &mut tempfile::Builder<'_, '_>) {}

/// Gives a temporary file a name for good, in place of any file of that name.
///
/// # Errors
///
/// If that fails; the temporary file is then removed.
pub fn rename_over(name: TempPath, target: &Path) -> io::Result<()> {
    name.persist(target).map_err(|e| e.error)
}

/// Whether this is a regular file; folders tell who may make one.
#[must_use]
pub fn is_ours_alone(found: &Metadata) -> bool {
    found.is_file()
}

/// Whether an open file still has a name: nothing takes it away while it is open.
///
/// # Errors
///
/// None.
pub fn has_name(_file: &File) -> io::Result<bool> {
    Ok(true)
}

/// A name of these bytes, which may be part of a name.
#[must_use]
pub fn name_of_bytes(bytes: &[u8]) -> OsString {
    OsString::from(String::from_utf8_lossy(bytes).into_owned())
}

/// Volume and number of the file that a path leads to.
///
/// # Errors
///
/// If there is none.
pub fn identity_of(path: &Path) -> io::Result<[u64; 2]> {
    let found = information(&Handle::from_path_any(path)?)?;
    Ok([found.volume_serial_number(), found.file_index()])
}

/// What changes with the content of a file: when it was made and written.
#[must_use]
pub fn stamps_of(found: &Metadata) -> [i64; 5] {
    [found.creation_time() as i64, found.last_write_time() as i64, 0, 0, 0]
}

/// Folders are synced by the system itself.
///
/// # Errors
///
/// None.
pub fn sync_folder(_folder: &Path) -> io::Result<()> {
    Ok(())
}

/// Bytes free to users: the system is not asked.
#[must_use]
pub fn free_bytes(_path: &Path) -> Option<u64> {
    None
}

/// As [`free_bytes`].
#[must_use]
pub fn free_bytes_beside(_file: &File) -> Option<u64> {
    None
}

/// Space is reserved as it is written.
///
/// # Errors
///
/// None.
pub fn reserve(_file: &File, _offset: u64, _bytes: u64) -> io::Result<()> {
    Ok(())
}

/// Space is given back when the file is closed.
pub fn release(_file: &File, _offset: u64, _bytes: u64) {}

/// There is one way into a file.
#[must_use]
pub fn reopen_direct(_file: &File) -> Option<File> {
    None
}

/// The system is not told.
pub fn forget_cached(_file: &File, _offset: u64, _bytes: u64) {}
