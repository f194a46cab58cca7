//! Octree files with their checksums mended, so that what lies behind them is reached.

use pbgi_format::{FORMAT_VERSION, HEADER_BYTES, MAGIC, PAGE_ENTRY_BYTES, page_checksum};

/// Places of fields in the header and in an entry of the page table, as docs/format.md has them.
const PAGE_COUNT: usize = 48;
const TABLE_OFFSET: usize = 56;
const TABLE_CHECKSUM: usize = 64;
const STORED_BYTES: usize = 8;
const ENTRY_CHECKSUM: usize = 16;

/// Sets magic, version, and the checksums of all pages, of the page table and of the header to what the other bytes demand, as far as the
/// bytes that they stand in and for are there.
#[must_use]
pub fn mend_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if bytes.len() < HEADER_BYTES {
        return bytes;
    }
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..12].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
    mend_table(&mut bytes);
    let checksum = page_checksum(&bytes[..HEADER_BYTES - 8]);
    bytes[HEADER_BYTES - 8..HEADER_BYTES].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// Mends pages and page table; nothing where the table is not in the file.
fn mend_table(bytes: &mut [u8]) -> Option<()> {
    let start = read_size(bytes, TABLE_OFFSET)?;
    let table_bytes = read_size(bytes, PAGE_COUNT)?.checked_mul(PAGE_ENTRY_BYTES)?;
    let end = start.checked_add(table_bytes).filter(|&end| end <= bytes.len())?;
    for entry in (start..end).step_by(PAGE_ENTRY_BYTES) {
        let Some(page) = read_size(bytes, entry) else { continue };
        let stored = u32::from_le_bytes(*bytes[entry + STORED_BYTES..].first_chunk()?) as usize;
        let page_end = page.checked_add(stored).filter(|&end| end <= bytes.len());
        let Some(page_end) = page_end else { continue };
        let checksum = page_checksum(&bytes[page..page_end]);
        bytes[entry + ENTRY_CHECKSUM..][..8].copy_from_slice(&checksum.to_le_bytes());
    }
    let checksum = page_checksum(&bytes[start..end]);
    bytes[TABLE_CHECKSUM..][..8].copy_from_slice(&checksum.to_le_bytes());
    Some(())
}

fn read_size(bytes: &[u8], at: usize) -> Option<usize> {
    usize::try_from(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::small_octree;

    #[test]
    fn mending_a_sound_file_changes_nothing_and_damage_is_mended() {
        let sound = small_octree();
        assert!(mend_checksums(sound) == sound);
        let mut damaged = sound.to_vec();
        for at in [0, 8, TABLE_CHECKSUM, HEADER_BYTES - 1] {
            damaged[at] ^= 1;
        }
        assert!(mend_checksums(&damaged) == sound);
        for end in [0, 8, HEADER_BYTES - 1, HEADER_BYTES, sound.len() - 1] {
            assert_eq!(mend_checksums(&sound[..end]).len(), end);
        }
    }
}
