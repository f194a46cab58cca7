//! Memory that disks can read into and write from without a copy in between.

/// Direct reads and writes start at multiples of this many bytes, in the file and in memory.
pub(crate) const ALIGNMENT: usize = 4096;

/// Bytes in front of the aligned ones, for the start of a record that the last read has cut.
const HEADROOM: usize = 64;

/// A buffer of fixed size at an aligned address, with some room in front.
pub(crate) struct AlignedBuffer {
    bytes: Vec<u8>,
    /// Index of the first aligned byte.
    start: usize,
    capacity: usize,
}

impl AlignedBuffer {
    /// A buffer of `capacity` bytes, rounded up to whole blocks.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.next_multiple_of(ALIGNMENT);
        let bytes = vec![0; HEADROOM + ALIGNMENT + capacity];
        // The vector never grows, so that its address stays.
        let start = HEADROOM + bytes[HEADROOM..].as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT);
        Self { bytes, start, capacity }
    }

    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Keeps the first `len` aligned bytes only, whole blocks.
    pub fn truncate(&mut self, len: usize) {
        self.capacity = self.capacity.min(len);
    }

    /// The aligned bytes.
    pub fn aligned(&mut self) -> &mut [u8] {
        &mut self.bytes[self.start..self.start + self.capacity]
    }

    /// Aligned bytes, with `carried` bytes in front of them.
    pub fn with_carried(&self, carried: usize, len: usize) -> &[u8] {
        &self.bytes[self.start - carried..self.start + len]
    }

    /// Moves `len` bytes from index `at` of the aligned ones in front of them.
    pub fn carry(&mut self, at: usize, len: usize) {
        debug_assert!(len <= HEADROOM);
        let from = self.start + at;
        self.bytes.copy_within(from..from + len, self.start - len);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_aligned_and_carry_what_was_cut() {
        for capacity in [1, 4096, 100_000] {
            let mut buffer = AlignedBuffer::new(capacity);
            assert!(buffer.capacity() >= capacity && buffer.capacity().is_multiple_of(ALIGNMENT));
            assert_eq!(buffer.aligned().as_ptr().align_offset(ALIGNMENT), 0);
            let last = buffer.capacity() - 3;
            buffer.aligned()[last..].copy_from_slice(&[1, 2, 3]);
            buffer.carry(last, 3);
            buffer.aligned()[0] = 4;
            assert_eq!(buffer.with_carried(3, 1), [1, 2, 3, 4]);
        }
    }
}
