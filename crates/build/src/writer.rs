//! The file being written: pages first, then the page table, the header last, and a rename.

use crate::error::BuildError;
use crate::pack::Group;
use crate::pages::{PageBatch, PageSink};
use pbgi_format::{
    ExternalLink, HEADER_BYTES, Header, PAGE_ALIGNMENT, PageEntry, SurfelLayout, page_checksum,
};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Removes what a killed build of `target` has left, but not what a running one is writing.
///
/// # Errors
///
/// If it is there and cannot be removed.
pub fn remove_unfinished(target: &Path) -> std::io::Result<()> {
    let path = unfinished_path(target);
    let file = match File::options().write(true).open(&path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        other => other?,
    };
    match rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => std::fs::remove_file(&path),
        Err(_) => Ok(()),
    }
}

/// Path of the file that becomes `target` when it is complete.
fn unfinished_path(target: &Path) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(target.file_name().unwrap_or_else(|| "scene.pbgi".as_ref()));
    name.push(".tmp");
    target.with_file_name(name)
}

/// An octree file that does not exist under its name before [`FileWriter::finish`].
pub(crate) struct FileWriter {
    target: PathBuf,
    temporary: PathBuf,
    file: BufWriter<File>,
    position: u64,
    table: Vec<u8>,
    page_count: u64,
    page_bytes_max: u32,
    surfel_bytes: u64,
    compress: bool,
    finished: bool,
}

impl FileWriter {
    /// Starts a file beside `target`, under a name of its own that a later run takes over should
    /// this one be killed.
    pub fn create(target: &Path, compress: bool) -> Result<Self, BuildError> {
        let temporary = unfinished_path(target);
        let io = |action| {
            let path = temporary.clone();
            move |source| BuildError::Io { path, action, source }
        };
        let file = File::options()
            .write(true)
            .create(true)
            .truncate(false)
            .open(&temporary)
            .map_err(io("create"))?;
        // Two bakes of one file at once: the second must not destroy what the first writes.
        rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockExclusive)
            .map_err(|e| io("lock (is another bake writing the same file?)")(e.into()))?;
        file.set_len(0).map_err(io("truncate"))?;
        let mut writer = Self {
            target: target.to_owned(),
            temporary: temporary.clone(),
            file: BufWriter::with_capacity(1 << 20, file),
            position: 0,
            table: Vec::new(),
            page_count: 0,
            page_bytes_max: 0,
            surfel_bytes: 0,
            compress,
            finished: false,
        };
        writer.write(&[0; HEADER_BYTES])?;
        Ok(writer)
    }

    /// Writes pages, and returns the number of the first. They were made as pages of any number.
    pub fn append(&mut self, batch: PageBatch) -> Result<u32, BuildError> {
        let first = self.page_count;
        self.page_count += batch.entries.len() as u64;
        if self.page_count >= u64::from(u32::MAX) {
            return Err(BuildError::TooManyPages { limit: u64::from(u32::MAX) });
        }
        self.surfel_bytes += batch.surfel_bytes;
        self.align()?;
        for entry in batch.entries {
            self.page_bytes_max = self.page_bytes_max.max(entry.decoded_bytes);
            PageEntry { offset: self.position + entry.offset, ..entry }.write(&mut self.table);
        }
        self.write(&batch.bytes)?;
        Ok(first as u32)
    }

    fn align(&mut self) -> Result<(), BuildError> {
        let gap = self.position.next_multiple_of(PAGE_ALIGNMENT) - self.position;
        self.write(&[0; PAGE_ALIGNMENT as usize][..gap as usize])
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), BuildError> {
        self.position += bytes.len() as u64;
        self.file.write_all(bytes).map_err(|source| self.io("write", source))
    }

    fn io(&self, action: &'static str, source: std::io::Error) -> BuildError {
        BuildError::Io { path: self.target.clone(), action, source }
    }

    /// Bytes of stored surfels so far.
    pub fn surfel_bytes(&self) -> u64 {
        self.surfel_bytes
    }

    /// Completes the header's page fields, writes table and header, syncs, and renames the file to
    /// its target. Returns the file's bytes and the number of pages.
    pub fn finish(mut self, mut header: Header) -> Result<(u64, u64), BuildError> {
        self.align()?;
        header.page_count = self.page_count;
        header.page_bytes_max = self.page_bytes_max;
        header.page_table_offset = self.position;
        header.page_table_checksum = page_checksum(&self.table);
        let table = std::mem::take(&mut self.table);
        self.write(&table)?;
        let file_bytes = self.position;
        let written = self
            .file
            .seek(SeekFrom::Start(0))
            .and_then(|_| self.file.write_all(&header.to_bytes()))
            .and_then(|()| self.file.flush())
            .and_then(|()| self.file.get_ref().sync_all());
        written.map_err(|source| self.io("write", source))?;
        std::fs::rename(&self.temporary, &self.target).map_err(|e| self.io("rename", e))?;
        self.finished = true;
        // The rename itself must survive a power cut; not every file system can sync a folder.
        if let Some(folder) = self.target.parent() {
            let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
            if let Ok(folder) = File::open(folder) {
                let _ = folder.sync_all();
            }
        }
        Ok((file_bytes, self.page_count))
    }
}

impl PageSink for FileWriter {
    fn write_treelets(
        &mut self,
        roots: &[&Group],
        layout: &SurfelLayout,
    ) -> Result<Vec<ExternalLink>, BuildError> {
        let mut batch = PageBatch::new(self.page_count as u32, self.compress);
        let links = batch.write_treelets(roots, layout)?;
        self.append(batch)?;
        Ok(links)
    }
}

impl Drop for FileWriter {
    fn drop(&mut self) {
        if !self.finished {
            // Nothing better can be done in a destructor; a later run takes the file over.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}
