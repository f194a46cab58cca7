//! As many surfels as the budget holds, and their order.

use crate::SortError;
use crate::temp_file::TempFile;
use pbgi_cloud::Surfel;
use pbgi_math::{MortonCode, RootCube};
use rayon::prelude::*;

/// Surfels of a block: memory grows by blocks, so that growing moves and doubles nothing.
const BLOCK: usize = 1 << 14;

/// Surfels in input order, and after [`RunBuffer::sort`] their Morton order.
pub(crate) struct RunBuffer {
    blocks: Vec<Vec<Surfel>>,
    len: usize,
    capacity: usize,
    /// Morton code and input index, sorted: equal codes stay in input order.
    order: Vec<(u64, u32)>,
}

impl RunBuffer {
    /// An empty buffer for up to `capacity` surfels.
    pub fn new(capacity: usize) -> Self {
        Self { blocks: Vec::new(), len: 0, capacity, order: Vec::new() }
    }

    /// Surfels held.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Takes as many of `surfels` as there is room for, and returns their number.
    pub fn push(&mut self, surfels: &[Surfel]) -> usize {
        let taken = surfels.len().min(self.capacity - self.len);
        let mut rest = &surfels[..taken];
        while !rest.is_empty() {
            let (block, within) = (self.len / BLOCK, self.len % BLOCK);
            if block == self.blocks.len() {
                self.blocks.push(Vec::with_capacity(BLOCK.min(self.capacity - self.len)));
            }
            let now = rest.len().min(BLOCK - within);
            self.blocks[block].extend_from_slice(&rest[..now]);
            self.len += now;
            rest = &rest[now..];
        }
        taken
    }

    /// Forgets all surfels but keeps their memory.
    pub fn clear(&mut self) {
        self.blocks.iter_mut().for_each(Vec::clear);
        self.len = 0;
        self.order.clear();
    }

    /// Finds the Morton order.
    pub fn sort(&mut self, root: &RootCube, pool: &rayon::ThreadPool) {
        self.order.clear();
        self.order.reserve_exact(self.len);
        self.order.resize(self.len, (0, 0));
        pool.install(|| {
            self.order.par_chunks_mut(BLOCK).zip(&self.blocks).enumerate().for_each(
                |(block, (keys, surfels))| {
                    for (within, (key, surfel)) in keys.iter_mut().zip(surfels).enumerate() {
                        *key = (root.code(surfel.center()).0, (block * BLOCK + within) as u32);
                    }
                },
            );
            // No two entries are equal, so that an unstable sort has one result only.
            self.order.par_sort_unstable();
        });
    }

    /// The surfel at `rank` in Morton order and its code.
    #[inline]
    pub fn sorted(&self, rank: usize) -> (MortonCode, Surfel) {
        let (code, index) = self.order[rank];
        (MortonCode(code), self.blocks[index as usize / BLOCK][index as usize % BLOCK])
    }

    /// Replaces the surfel at `rank` in Morton order; its position must stay.
    pub fn replace_sorted(&mut self, rank: usize, surfel: Surfel) {
        let index = self.order[rank].1 as usize;
        self.blocks[index / BLOCK][index % BLOCK] = surfel;
    }

    /// Writes the surfels in input order to `file` from `index` on.
    pub fn write_unsorted(&self, file: &TempFile, index: u64) -> Result<(), SortError> {
        for (i, block) in self.blocks.iter().filter(|b| !b.is_empty()).enumerate() {
            file.write_at(index + (i * BLOCK) as u64, block)?;
        }
        Ok(())
    }

    /// Replaces the contents by `len` surfels of `file` from `index` on.
    pub fn read(&mut self, file: &TempFile, index: u64, len: usize) -> Result<(), SortError> {
        self.clear();
        let mut chunk = vec![Surfel::default(); BLOCK.min(len)];
        while self.len < len {
            let now = chunk.len().min(len - self.len);
            file.read_at(index + self.len as u64, &mut chunk[..now])?;
            self.push(&chunk[..now]);
        }
        Ok(())
    }

    /// Writes the surfels in Morton order to `file` from `index` on.
    pub fn write_sorted(
        &self,
        file: &TempFile,
        index: u64,
        pool: &rayon::ThreadPool,
    ) -> Result<(), SortError> {
        let mut chunk = vec![Surfel::default(); BLOCK.min(self.len)];
        for start in (0..self.len).step_by(BLOCK) {
            let now = BLOCK.min(self.len - start);
            pool.install(|| {
                chunk[..now].par_chunks_mut(BLOCK / 8).enumerate().for_each(|(part, out)| {
                    for (i, surfel) in out.iter_mut().enumerate() {
                        *surfel = self.sorted(start + part * (BLOCK / 8) + i).1;
                    }
                });
            });
            file.write_at(index + start as u64, &chunk[..now])?;
        }
        Ok(())
    }
}
