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

/// Bits of a number at most that [`BitWriter::push`] takes at once.
pub(crate) const PUSH_BITS_MAX: u32 = 57;

/// Appends numbers to bytes, at most as many bits as were promised.
pub(crate) struct BitWriter<'a> {
    out: &'a mut Vec<u8>,
    /// Place of the byte that holds the next bit, and the bits before that in it.
    at: usize,
    word: u64,
    used: u32,
}

impl<'a> BitWriter<'a> {
    /// Starts at the end of `out`, for at most `bits_max` bits.
    pub fn new(out: &'a mut Vec<u8>, bits_max: usize) -> Self {
        let at = out.len();
        out.resize(at + bits_max / 8 + size_of::<u64>(), 0);
        Self { out, at, word: 0, used: 0 }
    }

    /// Appends the lowest `width` bits, at most [`PUSH_BITS_MAX`], of a number that has no others.
    ///
    /// # Panics
    ///
    /// If there is no room for more.
    #[inline(always)]
    pub fn push(&mut self, number: u64, width: u32) {
        debug_assert!(u64::BITS - number.leading_zeros() <= width, "{number} in {width} bits");
        self.word |= number << self.used;
        self.out[self.at..self.at + size_of::<u64>()].copy_from_slice(&self.word.to_le_bytes());
        let end = self.used + width;
        self.at += (end >> 3) as usize;
        self.word >>= end & !7;
        self.used = end & 7;
    }

    /// Fills the last byte with zeros.
    pub fn finish(self) {
        self.out.truncate(self.at + usize::from(self.used > 0));
    }
}

/// Several numbers that are pushed as one.
#[derive(Clone, Copy, Default)]
pub(crate) struct Word {
    pub number: u64,
    pub width: u32,
}

impl Word {
    /// Adds a number of `width` bits above those before.
    #[inline(always)]
    pub fn with(self, number: u32, width: u32) -> Self {
        debug_assert!(number_bits(number) <= width, "{number} in {width} bits");
        Self { number: self.number | u64::from(number) << self.width, width: self.width + width }
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
        let widths: Vec<u32> =
            (0..=32).chain((0..=32).rev()).chain([1, 32, 7, 32, 0, 31]).collect();
        let total: u32 = widths.iter().sum();
        let mut writer = BitWriter::new(&mut bytes, total as usize);
        for (i, &width) in widths.iter().enumerate() {
            writer.push(cut(i as u32, width).into(), width);
        }
        writer.finish();
        assert_eq!(bytes.len(), 1 + total.div_ceil(8) as usize);
        bytes.extend([0xff; SLACK_BYTES]);
        let mut at = 8;
        for (i, &width) in widths.iter().enumerate() {
            assert_eq!(read_bits(&bytes, at, width), cut(i as u32, width), "{i}");
            at += width as usize;
        }
    }

    #[test]
    fn words_are_their_numbers() {
        let (mut one, mut many) = (vec![7], vec![7]);
        let numbers = [(5, 3), (0, 0), (0x7fff, 15), (1, 20), (0x7_ffff, 19)];
        let mut writer = BitWriter::new(&mut many, 57);
        let mut word = Word::default();
        for (number, width) in numbers {
            writer.push(number.into(), width);
            word = word.with(number, width);
        }
        writer.finish();
        assert_eq!(word.width, PUSH_BITS_MAX);
        let mut writer = BitWriter::new(&mut one, 57);
        writer.push(word.number, word.width);
        writer.finish();
        assert_eq!((one.len(), &one), (9, &many));
    }

    #[test]
    fn widths_are_the_least() {
        assert_eq!([1, 2, 3, 4, 5, 8, 9, 255].map(index_bits), [0, 1, 2, 2, 3, 3, 4, 8]);
        assert_eq!([0, 1, 2, 3, 4, 255, 256].map(number_bits), [0, 1, 2, 2, 3, 8, 9]);
    }
}
