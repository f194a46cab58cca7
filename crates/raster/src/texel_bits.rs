//! Sets of a cube raster's texels, one bit each.

use crate::table::CubeRasterTable;

/// Bits of a word.
const BITS: usize = u64::BITS as usize;

/// Which texels of all faces, one bit each in the order they have in memory. A row lies in one word, as rows in memory are as long as a power of two.
#[derive(Clone, Debug)]
pub(crate) struct TexelBits {
    words: Vec<u64>,
}

impl TexelBits {
    /// The empty set of the texels of a table.
    pub fn new(table: &CubeRasterTable) -> Self {
        Self { words: vec![0; table.texels().len().div_ceil(BITS)] }
    }

    /// Empties the set.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.words.fill(0);
    }

    #[inline(always)]
    pub fn contains(&self, index: usize) -> bool {
        self.words[index / BITS] >> (index % BITS) & 1 != 0
    }

    #[inline(always)]
    pub fn insert(&mut self, index: usize) {
        self.words[index / BITS] |= 1 << (index % BITS);
    }

    #[inline(always)]
    pub fn remove(&mut self, index: usize) {
        self.words[index / BITS] &= !(1 << (index % BITS));
    }

    /// Adds texels of the row that begins at `start`, by their columns.
    #[inline(always)]
    pub fn insert_row(&mut self, start: usize, columns: u64) {
        self.words[start / BITS] |= columns << (start % BITS);
    }

    /// Which of the eight texels from `start`, a multiple of eight, are in the set.
    #[inline(always)]
    pub fn eight(&self, start: usize) -> u8 {
        (self.words[start / BITS] >> (start % BITS)) as u8
    }

    #[inline(always)]
    pub fn word(&self, word: usize) -> u64 {
        self.words[word]
    }
}

/// Texels of one word, all of one face.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WordOfTexels {
    pub face: u8,
    pub word: u32,
    pub texels: u64,
}

/// A rectangle of texels of a face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TexelRange {
    pub face: u8,
    /// First and last column.
    pub columns: [u8; 2],
    /// First and last row.
    pub rows: [u8; 2],
}

/// How rows lie in words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowsOfWords {
    /// Rows of a face.
    edge: usize,
    /// Texels of a row in memory, a power of two, and rows of a word, by their binary logarithms.
    pub stride_log2: u32,
    rows_log2: u32,
    /// The first column of each row of a word.
    first_column: u64,
}

impl RowsOfWords {
    pub fn new(table: &CubeRasterTable) -> Self {
        let stride = table.stride();
        assert!(stride.is_power_of_two() && stride <= BITS, "rows lie in one word");
        let starts = (0..BITS).step_by(stride);
        Self {
            edge: table.edge(),
            stride_log2: stride.ilog2(),
            rows_log2: (BITS / stride).ilog2(),
            first_column: starts.fold(0, |bits, start| bits | 1 << start),
        }
    }

    /// Adds the words of a rectangle, those with an open texel or all, and tells whether any of its texels is open.
    #[inline(always)]
    pub fn find_open(
        self,
        range: &TexelRange,
        open: &TexelBits,
        all: bool,
        found: &mut Vec<WordOfTexels>,
    ) -> bool {
        let TexelRange { face, columns: [c0, c1], rows } = *range;
        let columns = ((u64::MAX >> (63 - (c1 - c0))) << c0) * self.first_column;
        let row = usize::from(face) * self.edge;
        let (first, last) = (row + usize::from(rows[0]), row + usize::from(rows[1]));
        let row_in_word = (1 << self.rows_log2) - 1;
        let (before, after) = (first & row_in_word, row_in_word - (last & row_in_word));
        let (start, end) = (first >> self.rows_log2, last >> self.rows_log2);
        let mut any = false;
        for word in start..=end {
            let mut texels = columns;
            if word == start {
                texels &= u64::MAX << (before << self.stride_log2);
            }
            if word == end {
                texels &= u64::MAX >> (after << self.stride_log2);
            }
            let is_open = open.word(word) & texels != 0;
            if is_open | all {
                found.push(WordOfTexels { face, word: word as u32, texels });
            }
            any |= is_open;
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_rectangle_are_its_texels() {
        for n in [1, 3, 4, 7, 8, 13, 16, 20, 33, 64] {
            let table = CubeRasterTable::new(n);
            let (rows, none) = (RowsOfWords::new(&table), TexelBits::new(&table));
            let mut seed = n as u32;
            let mut below = |n: usize| {
                let x = 0.5 + 0.5 * crate::random(&mut seed);
                ((x * n as f32) as usize).min(n - 1)
            };
            for _ in 0..200 {
                let mut pair = || {
                    let (a, b) = (below(n), below(n));
                    [a.min(b) as u8, a.max(b) as u8]
                };
                let (columns, between) = (pair(), pair());
                let range = TexelRange { face: below(6) as u8, columns, rows: between };
                let (mut words, mut found) = (Vec::new(), Vec::new());
                assert!(!rows.find_open(&range, &none, false, &mut words) && words.is_empty());
                assert!(!rows.find_open(&range, &none, true, &mut words));
                for part in words {
                    assert_eq!(part.face, range.face);
                    let texels = (0..BITS).filter(|bit| part.texels >> bit & 1 != 0);
                    found.extend(texels.map(|bit| part.word as usize * BITS + bit));
                }
                let face = usize::from(range.face) * n;
                let expected = (range.rows[0]..=range.rows[1]).flat_map(|row| {
                    let start = (face + usize::from(row)) * table.stride();
                    (columns[0]..=columns[1]).map(move |column| start + usize::from(column))
                });
                assert!(found.iter().copied().eq(expected), "{n}: {range:?}");
                let (mut one, mut words) = (none.clone(), Vec::new());
                one.insert(found[found.len() / 2]);
                assert!(rows.find_open(&range, &one, false, &mut words) && words.len() == 1);
            }
        }
    }

    #[test]
    fn texels_are_found_where_they_were_added() {
        let table = CubeRasterTable::new(20);
        let mut set = TexelBits::new(&table);
        set.insert_row(32, 0b1010);
        set.insert(70);
        set.insert(35);
        set.remove(33);
        let found: Vec<_> = (0..table.texels().len()).filter(|i| set.contains(*i)).collect();
        assert_eq!(found, [35, 70]);
        assert_eq!([set.eight(32), set.eight(64), set.eight(72)], [8, 64, 0]);
        set.clear();
        assert!((0..10).all(|word| set.word(word) == 0));
    }
}
