//! Where the samples of a texel lie, and which of them a partly transparent piece covers.

use crate::lanes::SAMPLES;
use pbgi_math::{larger, scramble};

/// Place of sample `index` in its texel, 0..1 along u and v.
///
/// The first sixteen points of the Sobol sequence, moved to the middles of their cells: sixteen
/// different columns and rows, so that an edge along a texel's side passes them one by one, and any run of
/// them spreads over the texel.
pub(crate) const fn place(index: usize) -> [f32; 2] {
    let (mut u, mut v, mut bit) = (0, 0, 0);
    let steps = [[8, 8], [4, 12], [2, 10], [1, 15]];
    while bit < 4 {
        if index >> bit & 1 != 0 {
            u ^= steps[bit][0];
            v ^= steps[bit][1];
        }
        bit += 1;
    }
    [(u as f32 + 0.5) / SAMPLES as f32, (v as f32 + 0.5) / SAMPLES as f32]
}

/// Sums over the samples of each set of eight, of how far they lie from the texel's middle along u and v; 1 is its border.
const OFFSET_SUMS: [[[f32; 2]; 256]; 2] = {
    let mut sums = [[[0.0; 2]; 256]; 2];
    let mut half = 0;
    while half < 2 {
        let mut set = 0;
        while set < 256 {
            let mut bit = 0;
            while bit < 8 {
                if set >> bit & 1 != 0 {
                    let [u, v] = place(half * 8 + bit);
                    sums[half][set][0] += 2.0 * u - 1.0;
                    sums[half][set][1] += 2.0 * v - 1.0;
                }
                bit += 1;
            }
            set += 1;
        }
        half += 1;
    }
    sums
};

/// Sum over a set of samples of how far they lie from the texel's middle, along u and v; 1 is its border.
#[inline(always)]
pub(crate) fn offset_sum(samples: u16) -> [f32; 2] {
    let low = OFFSET_SUMS[0][usize::from(samples & 0xff)];
    let high = OFFSET_SUMS[1][usize::from(samples >> 8)];
    [low[0] + high[0], low[1] + high[1]]
}

/// How many samples a set has, to divide by: 1 of none.
#[inline(always)]
pub(crate) fn divisor(samples: u16) -> f32 {
    larger(samples.count_ones() as f32, 1.0)
}

/// Cells along each side of a texel that hold one sample each.
pub const SAMPLE_CELLS: usize = 4;

/// The sample in each cell of a texel, by row (along v) and column.
pub const SAMPLE_OF_CELL: [[u8; SAMPLE_CELLS]; SAMPLE_CELLS] = {
    let mut samples = [[u8::MAX; SAMPLE_CELLS]; SAMPLE_CELLS];
    let mut index = 0;
    while index < SAMPLES {
        let [u, v] = place(index);
        let cell =
            &mut samples[(v * SAMPLE_CELLS as f32) as usize][(u * SAMPLE_CELLS as f32) as usize];
        assert!(*cell == u8::MAX, "one sample a cell");
        *cell = index as u8;
        index += 1;
    }
    samples
};

/// The sample that speaks for what is smaller than the gaps between samples, at a place in the texel, 0..=1: the one in
/// the same of sixteen cells.
#[inline(always)]
pub(crate) fn sample_near(u: f32, v: f32) -> u32 {
    let cell = |x: f32| ((x * SAMPLE_CELLS as f32) as i32 as usize).min(SAMPLE_CELLS - 1);
    u32::from(SAMPLE_OF_CELL[cell(v)][cell(u)])
}

/// Orders of the sequence apart from XOR keys.
const ORDERS: usize = 4;

/// `index` times `x`ᵖᵒʷᵉʳ in the field of sixteen elements, *x*⁴ = *x* + 1: a permutation that is linear, as XOR keys are not.
const fn times_x(mut index: usize, power: usize) -> usize {
    let mut i = 0;
    while i < power {
        index <<= 1;
        if index & SAMPLES != 0 {
            index ^= SAMPLES | 3;
        }
        i += 1;
    }
    index
}

/// The first `count` samples of the sequence for each key and count, scrambled: those with `times_x(index) XOR key < count`.
///
/// With XOR keys alone two runs of half the samples cover the same half or its complement; with an order each, a half of both.
const RUNS: [[u16; SAMPLES + 1]; SAMPLES * ORDERS] = {
    let mut runs = [[0; SAMPLES + 1]; SAMPLES * ORDERS];
    let mut key = 0;
    while key < SAMPLES * ORDERS {
        let mut count = 0;
        while count <= SAMPLES {
            let mut index = 0;
            while index < SAMPLES {
                if times_x(index, key / SAMPLES) ^ (key % SAMPLES) < count {
                    runs[key][count] |= 1 << index;
                }
                index += 1;
            }
            count += 1;
        }
        key += 1;
    }
    runs
};

/// What shares of a texel's samples a partly transparent piece covers: those from `start` to `end`, both
/// 0..=1, in an order that `seed` scrambles. Pieces of one seed whose shares do not overlap cover different
/// samples; pieces of different seeds cover samples independently of each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Veil {
    /// Where the share begins.
    pub start: f32,
    /// Where it ends.
    pub end: f32,
    /// What scrambles the order.
    pub seed: u32,
}

impl Veil {
    /// Covers all.
    pub const OPAQUE: Self = Self { start: 0.0, end: 1.0, seed: 0 };

    #[inline(always)]
    pub(crate) fn is_opaque(&self) -> bool {
        self.start <= 0.0 && self.end >= 1.0
    }

    /// What of what the shares before its own leave is covered: pieces of a node that meet the same direction cover the sum of their shares.
    #[inline(always)]
    pub(crate) fn share_of_rest(&self) -> f32 {
        let rest = 1.0 - self.start;
        if self.end < 1.0 { (self.end - self.start) / rest } else { 1.0 }
    }

    /// What tells quickly which samples are covered in a texel.
    #[inline(always)]
    pub(crate) fn pattern(&self) -> VeilPattern {
        const ALL: u32 = (SAMPLES as u32) << ROUND_BITS;
        let count = |share: f32| ((share * ALL as f32) as u32).min(ALL);
        VeilPattern { start: count(self.start), end: count(self.end), seed: scramble(self.seed) }
    }
}

/// Bits of a number of samples behind the point.
const ROUND_BITS: u32 = 16;

/// Bits of a key of [`RUNS`].
const KEY_BITS: u32 = RUNS.len().trailing_zeros();

/// A veil whose shares are numbers of samples, in 2⁻¹⁶.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VeilPattern {
    start: u32,
    end: u32,
    seed: u32,
}

impl VeilPattern {
    /// The samples covered in texel `index`. On average over texels they are exactly the share.
    #[inline(always)]
    pub(crate) fn samples(&self, index: usize) -> u16 {
        // The upper bits are those that all others reach.
        let hash = (self.seed ^ (index as u32).wrapping_mul(0x9e37_79b9)).wrapping_mul(0x7feb_352d);
        let runs = &RUNS[(hash >> (u32::BITS - KEY_BITS)) as usize];
        let round = hash << KEY_BITS >> (u32::BITS - ROUND_BITS);
        let run = |count: u32| runs[((count + round) >> ROUND_BITS) as usize];
        run(self.end) & !run(self.start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_spread_over_columns_rows_and_quarters() {
        let places: Vec<_> = (0..SAMPLES).map(place).collect();
        for axis in 0..2 {
            let mut seen: Vec<_> = places.iter().map(|p| (p[axis] * 16.0) as usize).collect();
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(0..16));
        }
        let mut cells: Vec<_> =
            places.iter().map(|p| ((p[0] * 4.0) as usize, (p[1] * 4.0) as usize)).collect();
        cells.sort_unstable();
        cells.dedup();
        assert_eq!(cells.len(), 16);
    }

    #[test]
    fn veils_cover_their_share_on_average_and_complement_each_other() {
        for share in [0.0f32, 0.03, 0.3, 0.77, 1.0] {
            let (mut covered, mut rest) = (0, 0);
            for index in 0..10_000 {
                let first = Veil { start: 0.0, end: share, seed: 7 }.pattern().samples(index);
                let second = Veil { start: share, end: 1.0, seed: 7 }.pattern().samples(index);
                assert_eq!(first & second, 0);
                covered += first.count_ones();
                rest += second.count_ones();
            }
            assert!((covered as f32 / 160_000.0 - share).abs() < 0.003, "{share}: {covered}");
            assert_eq!(covered + rest, 160_000, "{share}");
        }
    }

    #[test]
    fn veils_of_different_seeds_are_independent() {
        let both: u32 = (0..10_000)
            .map(|seed| {
                let one = Veil { start: 0.0, end: 0.5, seed }.pattern().samples(3);
                (one & Veil { start: 0.0, end: 0.5, seed: !seed }.pattern().samples(3)).count_ones()
            })
            .sum();
        assert!((both as f32 / 160_000.0 - 0.25).abs() < 0.005, "{both}");
    }

    /// Two veils of half a texel let through a quarter in most texels, whichever these are; with one order of samples, a half or nothing in all.
    #[test]
    fn veils_of_different_seeds_share_texels_evenly() {
        let (mut open, mut uneven) = (0, 0);
        for seed in 0..100u32 {
            let veil = |seed| Veil { start: 0.0, end: 0.5, seed }.pattern();
            let (one, other) = (veil(seed), veil(1000 + 7 * seed));
            for index in 0..100 {
                let left = (!one.samples(index) & !other.samples(index)).count_ones();
                open += left;
                uneven += u32::from(left == 0 || left == 8);
            }
        }
        assert!((open as f32 / 160_000.0 - 0.25).abs() < 0.005, "{open}");
        assert!(uneven < 3000, "{uneven} of 10 000 texels");
    }
}
