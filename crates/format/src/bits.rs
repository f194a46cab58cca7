//! Numbers of any width, one after the other, lowest bit first.

/// Bytes that must follow the last bit in the slice [`read_bits`] reads from.
pub(crate) const SLACK_BYTES: usize = 8;

/// Number of `width` bits, at most 32, from bit `at` on.
///
/// # Panics
///
/// If fewer than [`SLACK_BYTES`] bytes follow the one that holds the first bit.
#[inline(always)]
pub(crate) fn read_bits(bytes: &[u8], at: usize, width: u32) -> u32 {
    let start = at >> 3;
    let word: [u8; 8] = bytes[start..start + 8].try_into().expect("eight bytes");
    let word = u64::from_le_bytes(word) >> (at & 7);
    (word & ((1 << width) - 1)) as u32
}

/// Bits needed to tell `count` things apart: 0 for one.
#[inline(always)]
pub(crate) fn index_bits(count: usize) -> u32 {
    usize::BITS - count.saturating_sub(1).leading_zeros()
}

/// Bits of the number itself: 0 for 0.
#[inline(always)]
pub(crate) fn number_bits(number: u32) -> u32 {
    u32::BITS - number.leading_zeros()
}

/// Appends numbers to bytes.
pub(crate) struct BitWriter<'a> {
    out: &'a mut Vec<u8>,
    word: u64,
    used: u32,
}

impl<'a> BitWriter<'a> {
    /// Starts at the end of `out`.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        Self { out, word: 0, used: 0 }
    }

    /// Appends the lowest `width` bits, at most 32, of a number that has no others.
    #[inline(always)]
    pub fn push(&mut self, number: u32, width: u32) {
        debug_assert!(number_bits(number) <= width, "{number} in {width} bits");
        self.word |= u64::from(number) << self.used;
        self.used += width;
        if self.used >= 32 {
            self.out.extend_from_slice(&(self.word as u32).to_le_bytes());
            self.word >>= 32;
            self.used -= 32;
        }
    }

    /// Fills the last byte with zeros.
    pub fn finish(self) {
        let bytes = self.word.to_le_bytes();
        self.out.extend_from_slice(&bytes[..self.used.div_ceil(8) as usize]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_width_come_back() {
        let number = |i: u32| i.wrapping_mul(0x9e37_79b9) ^ 0xdead_beef;
        let cut = |i: u32, width: u32| (u64::from(number(i)) & ((1 << width) - 1)) as u32;
        let mut bytes = vec![0xff];
        let mut writer = BitWriter::new(&mut bytes);
        let widths: Vec<u32> =
            (0..=32).chain((0..=32).rev()).chain([1, 32, 7, 32, 0, 31]).collect();
        for (i, &width) in widths.iter().enumerate() {
            writer.push(cut(i as u32, width), width);
        }
        writer.finish();
        let total: u32 = widths.iter().sum();
        assert_eq!(bytes.len(), 1 + total.div_ceil(8) as usize);
        bytes.extend([0xff; SLACK_BYTES]);
        let mut at = 8;
        for (i, &width) in widths.iter().enumerate() {
            assert_eq!(read_bits(&bytes, at, width), cut(i as u32, width), "{i}");
            at += width as usize;
        }
    }

    #[test]
    fn widths_are_the_least() {
        assert_eq!([1, 2, 3, 4, 5, 8, 9, 255].map(index_bits), [0, 1, 2, 2, 3, 3, 4, 8]);
        assert_eq!([0, 1, 2, 3, 4, 255, 256].map(number_bits), [0, 1, 2, 2, 3, 8, 9]);
    }
}
