//! The file being written: pages first, then the page table, the header last.

use crate::error::BuildError;
use crate::pack::Group;
use crate::pages::{PageBatch, PageSink};
use pbgi_file::AtomicFile;
use pbgi_format::{
    ExternalLink, HEADER_BYTES, Header, PAGE_ALIGNMENT, PageEntry, SurfelLayout, page_checksum,
};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// An octree file that does not exist under its name before [`FileWriter::finish`].
pub(crate) struct FileWriter {
    target: PathBuf,
    file: AtomicFile,
    position: u64,
    table: Vec<u8>,
    page_count: u64,
    page_bytes_max: u32,
    surfel_bytes: u64,
    compress: bool,
}

impl FileWriter {
    /// Starts a file beside `target`.
    pub fn create(target: &Path, compress: bool) -> Result<Self, BuildError> {
        let file = AtomicFile::create(target).map_err(|source| BuildError::Io {
            path: target.to_owned(),
            action: "create",
            source,
        })?;
        let mut writer = Self {
            target: target.to_owned(),
            file,
            position: 0,
            table: Vec::new(),
            page_count: 0,
            page_bytes_max: 0,
            surfel_bytes: 0,
            compress,
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
            .and_then(|_| self.file.write_all(&header.to_bytes()));
        written.map_err(|source| self.io("write", source))?;
        let Self { file, target: path, page_count, .. } = self;
        let committed = file.commit();
        committed.map_err(|e| BuildError::Io { path, action: e.action, source: e.source })?;
        Ok((file_bytes, page_count))
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
