//! The file being written: pages first, then the page table, the header last, and a rename.

use crate::error::BuildError;
use crate::pack::{Group, pack_treelets};
use pbgi_format::{
    ExternalLink, HEADER_BYTES, Header, NodePageFields, PAGE_ALIGNMENT, PageEntry, PageId,
    PageKind, SURFEL_PAGE_HEADER_BYTES, SurfelLayout, finish_node_page, page_checksum,
    write_surfel_page_header,
};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

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
        let mut name = std::ffi::OsString::from(".");
        name.push(target.file_name().unwrap_or_else(|| "scene.pbgi".as_ref()));
        name.push(".tmp");
        let temporary = target.with_file_name(name);
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

    /// Writes treelets as a node page, after the page of their surfels if they have any.
    pub fn write_treelets(
        &mut self,
        roots: &[&Group],
        layout: &SurfelLayout,
    ) -> Result<Vec<ExternalLink>, BuildError> {
        let mut packed = pack_treelets(roots, layout);
        let mut surfel_page = None;
        if !packed.surfels.is_empty() {
            self.surfel_bytes += packed.surfels.len() as u64;
            let stride = layout.stored_bytes();
            let mut page = Vec::with_capacity(SURFEL_PAGE_HEADER_BYTES + packed.surfels.len());
            let count = (packed.surfels.len() / stride) as u32;
            write_surfel_page_header(count, stride as u32, &mut page);
            page.append(&mut packed.surfels);
            surfel_page = Some(self.write_page(PageKind::Surfels, &page)?);
        }
        let fields = NodePageFields { group_count: packed.group_count, surfel_page };
        finish_node_page(&mut packed.nodes, fields, &packed.links);
        let page = self.write_page(PageKind::Nodes, &packed.nodes)?;
        Ok(packed.root_offsets.iter().map(|&offset| ExternalLink { page, offset }).collect())
    }

    fn write_page(&mut self, kind: PageKind, decoded: &[u8]) -> Result<PageId, BuildError> {
        let id = u32::try_from(self.page_count).ok().filter(|&id| id < u32::MAX);
        let id = id.ok_or(BuildError::TooManyPages { limit: u64::from(u32::MAX) })?;
        let packed = self.compress.then(|| lz4_flex::block::compress(decoded));
        let stored = match &packed {
            Some(smaller) if smaller.len() < decoded.len() => smaller,
            _ => decoded,
        };
        self.align()?;
        PageEntry {
            offset: self.position,
            stored_bytes: stored.len() as u32,
            decoded_bytes: decoded.len() as u32,
            checksum: page_checksum(stored),
            kind,
        }
        .write(&mut self.table);
        self.write(stored)?;
        self.page_count += 1;
        self.page_bytes_max = self.page_bytes_max.max(decoded.len() as u32);
        Ok(PageId(id))
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

impl Drop for FileWriter {
    fn drop(&mut self) {
        if !self.finished {
            // Nothing better can be done in a destructor; a later run takes the file over.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}
