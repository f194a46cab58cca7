//! Numbers that come in any order, read back in that of their indices: in a temporary file, with little memory.

use crate::PbgiError;
use pbgi_file::platform::{read_exact_at, write_all_at};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Indices of a bucket, which is put in order in memory.
const BUCKET: u64 = 1 << 18;
/// Bytes of a record: index in its bucket and value.
const RECORD_BYTES: usize = 8;
/// Bytes of records collected per bucket before they are written.
const BUFFER_BYTES: usize = 4096;

/// Values for all indices below a count, each put once. The file has no name and is gone however the process ends.
pub(crate) struct Scatter {
    file: File,
    dir: PathBuf,
    count: u64,
    /// Records yet to be written, and bytes written, per bucket.
    buffers: Vec<(Vec<u8>, u64)>,
}

impl Scatter {
    /// Room for `count` values in a file in `dir`.
    ///
    /// # Errors
    ///
    /// If no file can be created there.
    pub fn create(dir: &Path, count: u64) -> Result<Self, PbgiError> {
        let file = tempfile::tempfile_in(dir)
            .map_err(|e| PbgiError::output(dir, "create a temporary file", e))?;
        let buckets = count.div_ceil(BUCKET) as usize;
        Ok(Self { file, dir: dir.to_owned(), count, buffers: vec![(Vec::new(), 0); buckets] })
    }

    /// Puts the value of an index.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    ///
    /// # Panics
    ///
    /// If `index` is not below the count.
    pub fn put(&mut self, index: u64, value: u32) -> Result<(), PbgiError> {
        assert!(index < self.count, "index {index} of {}", self.count);
        let bucket = (index / BUCKET) as usize;
        let buffer = &mut self.buffers[bucket].0;
        buffer.extend(((index % BUCKET) as u32).to_le_bytes());
        buffer.extend(value.to_le_bytes());
        if buffer.len() >= BUFFER_BYTES { self.flush(bucket) } else { Ok(()) }
    }

    fn flush(&mut self, bucket: usize) -> Result<(), PbgiError> {
        let (buffer, written) = &mut self.buffers[bucket];
        let offset = bucket as u64 * BUCKET * RECORD_BYTES as u64 + *written;
        write_all_at(&self.file, buffer, offset)
            .map_err(|e| PbgiError::output(&self.dir, "write to a temporary file", e))?;
        *written += buffer.len() as u64;
        buffer.clear();
        Ok(())
    }

    /// All values in the order of their indices.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub fn finish(mut self) -> Result<InOrder, PbgiError> {
        (0..self.buffers.len()).try_for_each(|bucket| self.flush(bucket))?;
        let written: u64 = self.buffers.iter().map(|(_, written)| written).sum();
        assert_eq!(written, self.count * RECORD_BYTES as u64, "every index has its value");
        let Self { file, dir, count, .. } = self;
        Ok(InOrder { file, dir, count, next: 0, values: Vec::new() })
    }
}

/// Values in the order of their indices.
pub(crate) struct InOrder {
    file: File,
    dir: PathBuf,
    count: u64,
    next: u64,
    /// Those of the bucket being handed out.
    values: Vec<u32>,
}

impl InOrder {
    /// The next value; none after the last.
    ///
    /// # Errors
    ///
    /// If the file cannot be read.
    pub fn next(&mut self) -> Result<Option<u32>, PbgiError> {
        if self.next == self.count {
            return Ok(None);
        }
        if self.next.is_multiple_of(BUCKET) {
            self.read_bucket()?;
        }
        let value = self.values[(self.next % BUCKET) as usize];
        self.next += 1;
        Ok(Some(value))
    }

    /// Starts over.
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    fn read_bucket(&mut self) -> Result<(), PbgiError> {
        let len = BUCKET.min(self.count - self.next) as usize;
        self.values.clear();
        self.values.resize(len, 0);
        let mut records = vec![0; BUFFER_BYTES];
        for first in (0..len * RECORD_BYTES).step_by(BUFFER_BYTES) {
            let part = &mut records[..BUFFER_BYTES.min(len * RECORD_BYTES - first)];
            let offset = self.next * RECORD_BYTES as u64 + first as u64;
            read_exact_at(&self.file, part, offset)
                .map_err(|e| PbgiError::output(&self.dir, "read from a temporary file", e))?;
            for [a, b, c, d, e, f, g, h] in part.as_chunks::<RECORD_BYTES>().0 {
                let index = u32::from_le_bytes([*a, *b, *c, *d]);
                self.values[index as usize] = u32::from_le_bytes([*e, *f, *g, *h]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_in_order_and_again() {
        let folder = tempfile::tempdir().unwrap();
        for count in [0, 1, 1000, BUCKET, 2 * BUCKET + 777] {
            let mut scatter = Scatter::create(folder.path(), count).unwrap();
            // A step prime to every count visits every index once.
            for i in 0..count {
                let index = i * 1_000_003 % count;
                scatter.put(index, (index * 7) as u32).unwrap();
            }
            let mut values = scatter.finish().unwrap();
            for _ in 0..2 {
                for index in 0..count {
                    assert_eq!(values.next().unwrap(), Some((index * 7) as u32));
                }
                assert_eq!(values.next().unwrap(), None);
                values.rewind();
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
