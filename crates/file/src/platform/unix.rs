//! Linux, macOS and other Unix systems.

use rustix::fs::OFlags;
use rustix::io::Errno;
use std::ffi::OsString;
use std::fs::{File, FileType, Metadata, Permissions};
use std::io;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::{FileExt, FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;
use tempfile::TempPath;

/// Fills `out` with the bytes from `offset` on.
///
/// # Errors
///
/// If not all of them can be read.
pub fn read_exact_at(file: &File, out: &mut [u8], offset: u64) -> io::Result<()> {
    file.read_exact_at(out, offset)
}

/// Writes `bytes` from `offset` on.
///
/// # Errors
///
/// If not all of them can be written.
pub fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> io::Result<()> {
    file.write_all_at(bytes, offset)
}

/// Whether this is a pipe.
#[must_use]
pub fn is_pipe(kind: FileType) -> bool {
    kind.is_fifo()
}

/// Whether this is a device of characters.
#[must_use]
pub fn is_character_device(kind: FileType) -> bool {
    kind.is_char_device()
}

/// Whether this is a socket.
#[must_use]
pub fn is_socket(kind: FileType) -> bool {
    kind.is_socket()
}

/// Opens a file for reading; a pipe that nobody writes to is not waited for.
///
/// # Errors
///
/// If it cannot be opened.
pub fn open_without_waiting(path: &Path) -> io::Result<File> {
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
    File::options().read(true).custom_flags(flags).open(path)
}

/// Opens a pipe or a device for writing. A reader of a pipe is not waited for; writing is, once there is one.
///
/// # Errors
///
/// If it cannot be opened; if nobody reads the pipe.
pub fn open_in_place(path: &Path) -> io::Result<File> {
    let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
    let opened = File::options().write(true).custom_flags(flags).open(path);
    let file = opened.map_err(|e| match Errno::from_io_error(&e) {
        Some(Errno::NXIO) => io::Error::new(e.kind(), "nobody reads the pipe"),
        _ => e,
    })?;
    let flags = rustix::fs::fcntl_getfl(&file)?;
    rustix::fs::fcntl_setfl(&file, flags - OFlags::NONBLOCK)?;
    Ok(file)
}

/// Opens a file, but no link and without waiting, for reading and, if wanted, for writing.
///
/// # Errors
///
/// If it cannot be opened.
pub fn open_unfollowed(path: &Path, write: bool) -> io::Result<File> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    File::options().read(true).write(write).custom_flags(flags).open(path)
}

/// Makes a new file that this user alone may read and write.
///
/// # Errors
///
/// If it cannot be made.
pub fn create_private(path: &Path) -> io::Result<File> {
    File::options().read(true).write(true).create_new(true).mode(0o600).open(path)
}

/// Gives files the permissions of ordinary ones.
pub fn use_ordinary_permissions(builder: &mut tempfile::Builder<'_, '_>) {
    builder.permissions(Permissions::from_mode(0o666));
}

/// Gives a temporary file a name for good, in place of any file of that name.
///
/// # Errors
///
/// If that fails; the temporary file is then removed.
pub fn rename_over(name: TempPath, target: &Path) -> io::Result<()> {
    // By the system's library, which `cargo xtask faults` makes fail; TempPath::persist calls the kernel itself.
    std::fs::rename(&name, target)?;
    name.keep().map(drop).map_err(|e| e.error)
}

/// Whether this is a regular file of this user with one name.
#[must_use]
pub fn is_ours_alone(found: &Metadata) -> bool {
    let user = rustix::process::geteuid().as_raw();
    found.is_file() && found.nlink() == 1 && found.uid() == user
}

/// Whether an open file still has a name.
///
/// # Errors
///
/// If the system does not tell.
pub fn has_name(file: &File) -> io::Result<bool> {
    Ok(file.metadata()?.nlink() > 0)
}

/// A name of these bytes, which may be part of a name.
#[must_use]
pub fn name_of_bytes(bytes: &[u8]) -> OsString {
    OsString::from_vec(bytes.to_vec())
}

/// Device and inode of the file that a path leads to.
///
/// # Errors
///
/// If there is none.
pub fn identity_of(path: &Path) -> io::Result<[u64; 2]> {
    let found = std::fs::metadata(path)?;
    Ok([found.dev(), found.ino()])
}

/// What changes with the content of a file: its inode, when it was written, and when its inode was, which nobody can set.
#[must_use]
pub fn stamps_of(found: &Metadata) -> [i64; 5] {
    let inode = found.ino() as i64;
    [inode, found.mtime(), found.mtime_nsec(), found.ctime(), found.ctime_nsec()]
}

/// Syncs a folder, where its file system can and it may be opened.
///
/// # Errors
///
/// If that fails for another reason.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(e)
            if e.kind() == io::ErrorKind::PermissionDenied
                || matches!(
                    Errno::from_io_error(&e),
                    Some(Errno::INVAL | Errno::NOTSUP | Errno::NOSYS)
                ) =>
        {
            Ok(())
        }
        result => result,
    }
}

/// Bytes free to users in the file system of a folder or file; none where the system does not tell.
#[must_use]
pub fn free_bytes(path: &Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(path).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// As [`free_bytes`], of an open file, which may have no name.
#[must_use]
pub fn free_bytes_beside(file: &File) -> Option<u64> {
    let stat = rustix::fs::fstatvfs(file).ok()?;
    Some(stat.f_bavail.saturating_mul(stat.f_frsize))
}

/// Reserves disk space, where the file system can.
///
/// # Errors
///
/// If there is none, or the quota is used up.
pub fn reserve(file: &File, offset: u64, bytes: u64) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        let flags = rustix::fs::FallocateFlags::empty();
        match rustix::fs::fallocate(file, flags, offset, bytes) {
            Err(e) if e == Errno::NOSPC || e == Errno::DQUOT => return Err(e.into()),
            // Other file systems reserve as they write.
            _ => {}
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, offset, bytes);
    Ok(())
}

/// Gives disk space back, where the file system can.
pub fn release(file: &File, offset: u64, bytes: u64) {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::FallocateFlags;
        let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        // Space that cannot be given back now is when the file is closed.
        let _ = rustix::fs::fallocate(file, hole, offset, bytes);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, offset, bytes);
}

/// The same file, to be read and written past the system's page cache in aligned blocks, where that can be had.
#[must_use]
pub fn reopen_direct(file: &File) -> Option<File> {
    #[cfg(target_os = "linux")]
    {
        use std::os::fd::AsRawFd;
        let name = format!("/proc/self/fd/{}", file.as_raw_fd());
        let flags = OFlags::DIRECT.bits() as i32;
        File::options().read(true).write(true).custom_flags(flags).open(name).ok()
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = file;
        None
    }
}

/// Tells the system that these bytes of a file need not stay in its page cache.
pub fn forget_cached(file: &File, offset: u64, bytes: u64) {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{Advice, fadvise};
        // Where the system does not take the hint, its cache is as it would have been.
        let _ = fadvise(file, offset, std::num::NonZeroU64::new(bytes), Advice::DontNeed);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, offset, bytes);
}
