//! The page table: where each page lies and what its bytes must sum to.

use crate::{FormatError, PageKind, read_u32, read_u64};

/// Number of a page, from 0 in file order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageId(pub u32);

impl std::fmt::Display for PageId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// Pages start at multiples of this many bytes.
pub const PAGE_ALIGNMENT: u64 = 64;

/// Bytes of one entry.
pub const PAGE_ENTRY_BYTES: usize = 32;

/// Where a page lies in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageEntry {
    /// First byte in the file.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_bytes: u32,
    /// Bytes once decoded; equal to `stored_bytes` where the page is not compressed.
    pub decoded_bytes: u32,
    /// XXH3-64 of the stored bytes.
    pub checksum: u64,
    /// What the page holds.
    pub kind: PageKind,
}

impl PageEntry {
    /// Whether the stored bytes are LZ4-compressed.
    #[must_use]
    pub fn is_compressed(&self) -> bool {
        self.stored_bytes != self.decoded_bytes
    }

    /// Appends the stored form.
    pub fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.offset.to_le_bytes());
        out.extend_from_slice(&self.stored_bytes.to_le_bytes());
        out.extend_from_slice(&self.decoded_bytes.to_le_bytes());
        out.extend_from_slice(&self.checksum.to_le_bytes());
        out.extend_from_slice(&(self.kind as u32).to_le_bytes());
        out.extend_from_slice(&[0; 4]);
    }

    /// Reads an entry.
    ///
    /// # Errors
    ///
    /// If a field is out of range.
    pub fn read(bytes: &[u8; PAGE_ENTRY_BYTES]) -> Result<Self, FormatError> {
        let entry = Self {
            offset: read_u64(bytes, 0),
            stored_bytes: read_u32(bytes, 8),
            decoded_bytes: read_u32(bytes, 12),
            checksum: read_u64(bytes, 16),
            kind: PageKind::from_code(read_u32(bytes, 24))?,
        };
        if !entry.offset.is_multiple_of(PAGE_ALIGNMENT) || entry.offset == 0 {
            return Err(FormatError::new(
                "page table: offset",
                entry.offset,
                "a positive multiple of 64",
            ));
        }
        if entry.stored_bytes == 0 || entry.decoded_bytes < entry.stored_bytes {
            return Err(FormatError::new(
                "page table: stored bytes",
                entry.stored_bytes,
                format_args!("1 to {}", entry.decoded_bytes),
            ));
        }
        if read_u32(bytes, 28) != 0 {
            return Err(FormatError::new("page table: reserved", read_u32(bytes, 28), 0));
        }
        Ok(entry)
    }
}

/// [`page_checksum`] of bytes that come in parts.
#[derive(Default)]
pub struct PageChecksum(xxhash_rust::xxh3::Xxh3Default);

impl PageChecksum {
    /// Goes on with the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The checksum of all bytes so far.
    #[must_use]
    pub fn finish(&self) -> u64 {
        self.0.digest()
    }
}

/// Checksum of a page's stored bytes, and of the page table's.
#[must_use]
pub fn page_checksum(bytes: &[u8]) -> u64 {
    xxhash_rust::xxh3::xxh3_64(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_the_checksum_of_the_whole() {
        let bytes: Vec<u8> = (0..5000u32).map(|i| ((i * i) >> 3) as u8).collect();
        let mut sum = PageChecksum::default();
        bytes.chunks(700).for_each(|part| sum.update(part));
        assert_eq!(sum.finish(), page_checksum(&bytes));
        assert_eq!(PageChecksum::default().finish(), page_checksum(&[]));
    }

    #[test]
    fn entries_round_trip_and_refuse_nonsense() {
        let entry = PageEntry {
            offset: 8192,
            stored_bytes: 100,
            decoded_bytes: 200,
            checksum: 77,
            kind: PageKind::Surfels,
        };
        let mut bytes = Vec::new();
        entry.write(&mut bytes);
        let array: [u8; PAGE_ENTRY_BYTES] = bytes.try_into().unwrap();
        assert_eq!(PageEntry::read(&array), Ok(entry));
        for (at, value) in [(0, 1), (8, 255), (24, 9), (28, 1)] {
            let mut bad = array;
            bad[at] = value;
            assert!(PageEntry::read(&bad).is_err(), "byte {at}");
        }
    }
}
