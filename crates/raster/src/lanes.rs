//! Sixteen numbers at a time: the samples of a texel.

use crate::simd::WideKernel;

/// Samples of a texel, and numbers in a [`Lanes`].
pub const SAMPLES: usize = 16;

/// Sixteen numbers, in whatever registers the processor has for them. Every implementation gives the same bits.
///
/// Only [`crate::run_wide`] chooses an implementation, after asking the processor.
pub trait Lanes: Copy + sealed::Sealed {
    /// Result of a comparison.
    type Mask: Copy;

    /// The same number in all lanes.
    fn splat(x: f32) -> Self;
    /// Numbers from memory.
    fn load(from: &[f32; SAMPLES]) -> Self;
    /// Sum.
    fn add(self, other: Self) -> Self;
    /// Difference.
    fn sub(self, other: Self) -> Self;
    /// Product.
    fn mul(self, other: Self) -> Self;
    /// Without the sign.
    fn abs(self) -> Self;
    /// Lanes that are less than or equal to the other's.
    fn le(self, other: Self) -> Self::Mask;
    /// Lanes in both.
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// One bit per lane, the first lane's lowest.
    fn bits(mask: Self::Mask) -> u16;
    /// Quotient.
    fn div(self, other: Self) -> Self;
    /// Lanes whose cell is set, of eight rows of eight bits, and whose `sign` is not negative: `self` is the column, `row` the row, both counted from 0 along
    /// the whole edge; lanes outside of 0 … 8 are in no cell.
    fn in_cells(self, row: Self, sign: Self, cells: u64) -> u16;
    /// The largest of the lanes whose bits are set, none of which is negative; 0 without any.
    fn largest_where(self, bits: u16) -> f32;
    /// Writes the lanes whose bits are set.
    fn store_where(self, bits: u16, to: &mut [f32; SAMPLES]);
    /// Runs a part of a kernel, which may be a function of its own. No closure does: it may be compiled without the instructions of the lanes.
    #[inline(always)]
    fn run_part<K: WideKernel>(part: K) -> K::Output {
        part.run::<Self>()
    }
}

pub(crate) mod sealed {
    pub trait Sealed {}
}

/// Plain numbers: processors without other lanes, and the oracle of these.
#[derive(Clone, Copy, Debug)]
pub struct Plain([f32; SAMPLES]);

impl sealed::Sealed for Plain {}

impl Plain {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        let mut out = self;
        for (a, b) in out.0.iter_mut().zip(other.0) {
            *a = f(*a, b);
        }
        out
    }
}

impl Lanes for Plain {
    type Mask = u16;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; SAMPLES])
    }
    #[inline(always)]
    fn load(from: &[f32; SAMPLES]) -> Self {
        Self(*from)
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.map(f32::abs))
    }
    #[inline(always)]
    fn le(self, other: Self) -> u16 {
        let mut bits = 0;
        for lane in 0..SAMPLES {
            bits |= u16::from(self.0[lane] <= other.0[lane]) << lane;
        }
        bits
    }
    #[inline(always)]
    fn and(a: u16, b: u16) -> u16 {
        a & b
    }
    #[inline(always)]
    fn bits(mask: u16) -> u16 {
        mask
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn in_cells(self, row: Self, sign: Self, cells: u64) -> u16 {
        let mut bits = 0;
        for lane in 0..SAMPLES {
            let (a, b, is_there) = (self.0[lane], row.0[lane], sign.0[lane].is_sign_positive());
            if is_there && (0.0..8.0).contains(&a) && (0.0..8.0).contains(&b) {
                let cell = 8 * b as u32 + a as u32;
                bits |= ((cells >> cell & 1) as u16) << lane;
            }
        }
        bits
    }
    #[inline(always)]
    fn largest_where(self, bits: u16) -> f32 {
        let mut largest = 0.0;
        for lane in 0..SAMPLES {
            if bits >> lane & 1 != 0 && self.0[lane] > largest {
                largest = self.0[lane];
            }
        }
        largest
    }
    #[inline(always)]
    fn store_where(self, bits: u16, to: &mut [f32; SAMPLES]) {
        for lane in 0..SAMPLES {
            if bits >> lane & 1 != 0 {
                to[lane] = self.0[lane];
            }
        }
    }
}

/// x86-64 registers of 256 and 512 bits.
///
/// Values of these types exist only in code that [`crate::run_wide`] runs after it has found the
/// instructions on this processor; that is the condition of every intrinsic called here.
#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "intrinsics of processors that run_wide has asked for them")]
#[allow(
    clippy::undocumented_unsafe_blocks,
    clippy::multiple_unsafe_ops_per_block,
    reason = "one condition for all, stated above"
)]
pub(crate) mod x86 {
    use super::{Lanes, Plain, SAMPLES, sealed::Sealed};
    use crate::simd::WideKernel;
    use std::arch::x86_64::*;
    use std::array::from_fn;

    /// Four SSE2 registers, which every x86-64 has. Kernels take half of the time to compile that they take for [`Plain`].
    #[derive(Clone, Copy, Debug)]
    pub struct Sse2([__m128; 4]);

    impl Sealed for Sse2 {}

    impl Sse2 {
        #[inline(always)]
        fn zip(self, o: Self, f: impl Fn(__m128, __m128) -> __m128) -> Self {
            Self([
                f(self.0[0], o.0[0]),
                f(self.0[1], o.0[1]),
                f(self.0[2], o.0[2]),
                f(self.0[3], o.0[3]),
            ])
        }

        #[inline(always)]
        fn plain(self) -> Plain {
            let mut lanes = [0.0; SAMPLES];
            self.store_where(u16::MAX, &mut lanes);
            Plain(lanes)
        }
    }

    /// One function for all kernels: without shifts by lane and whole parts, this takes a loop.
    #[inline(never)]
    fn in_cells(column: Plain, row: Plain, sign: Plain, cells: u64) -> u16 {
        column.in_cells(row, sign, cells)
    }

    impl Lanes for Sse2 {
        type Mask = [__m128; 4];

        /// A function of its own: parts of kernels compile faster apart, and one kernel has no others' copies.
        #[inline(never)]
        fn run_part<K: WideKernel>(part: K) -> K::Output {
            part.run::<Self>()
        }

        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self([unsafe { _mm_set1_ps(x) }; 4])
        }
        #[inline(always)]
        fn load(from: &[f32; SAMPLES]) -> Self {
            // SAFETY: four floats from 0, 4, 8 and 12 are inside the array.
            let four = |at: usize| unsafe { _mm_loadu_ps(from[at..at + 4].as_ptr()) };
            Self([four(0), four(4), four(8), four(12)])
        }
        #[inline(always)]
        fn add(self, o: Self) -> Self {
            self.zip(o, |a, b| unsafe { _mm_add_ps(a, b) })
        }
        #[inline(always)]
        fn sub(self, o: Self) -> Self {
            self.zip(o, |a, b| unsafe { _mm_sub_ps(a, b) })
        }
        #[inline(always)]
        fn mul(self, o: Self) -> Self {
            self.zip(o, |a, b| unsafe { _mm_mul_ps(a, b) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self::splat(-0.0).zip(self, |sign, a| unsafe { _mm_andnot_ps(sign, a) })
        }
        #[inline(always)]
        fn le(self, o: Self) -> Self::Mask {
            self.zip(o, |a, b| unsafe { _mm_cmple_ps(a, b) }).0
        }
        #[inline(always)]
        fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            Self(a).zip(Self(b), |a, b| unsafe { _mm_and_ps(a, b) }).0
        }
        #[inline(always)]
        fn bits(mask: Self::Mask) -> u16 {
            let [a, b, c, d] = mask.map(|mask| unsafe { _mm_movemask_ps(mask) });
            (a | b << 4 | c << 8 | d << 12) as u16
        }
        #[inline(always)]
        fn div(self, o: Self) -> Self {
            self.zip(o, |a, b| unsafe { _mm_div_ps(a, b) })
        }
        #[inline(always)]
        fn in_cells(self, row: Self, sign: Self, cells: u64) -> u16 {
            in_cells(self.plain(), row.plain(), sign.plain(), cells)
        }
        #[inline(always)]
        fn largest_where(self, bits: u16) -> f32 {
            let Self([a, b, c, d]) =
                Self(spread_fours(bits)).zip(self, |mask, a| unsafe { _mm_and_ps(mask, a) });
            unsafe {
                let four = _mm_max_ps(_mm_max_ps(a, b), _mm_max_ps(c, d));
                let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_max_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }
        #[inline(always)]
        fn store_where(self, bits: u16, to: &mut [f32; SAMPLES]) {
            let (masks, old) = (spread_fours(bits), Self::load(to));
            for i in 0..4 {
                // SAFETY: as in `load`.
                unsafe {
                    let kept = _mm_andnot_ps(masks[i], old.0[i]);
                    let new = _mm_or_ps(_mm_and_ps(masks[i], self.0[i]), kept);
                    _mm_storeu_ps(to[4 * i..4 * i + 4].as_mut_ptr(), new);
                }
            }
        }
    }

    /// Four lanes each, all bits of those whose bit is set.
    #[inline(always)]
    fn spread_fours(bits: u16) -> [__m128; 4] {
        from_fn(|i| unsafe {
            let bit = _mm_setr_epi32(1, 2, 4, 8);
            let all = _mm_set1_epi32(i32::from(bits >> (4 * i)));
            _mm_castsi128_ps(_mm_cmpeq_epi32(_mm_and_si128(all, bit), bit))
        })
    }

    /// Two AVX2 registers.
    #[derive(Clone, Copy, Debug)]
    pub struct Avx2(__m256, __m256);

    impl Sealed for Avx2 {}

    impl Lanes for Avx2 {
        type Mask = (__m256, __m256);

        #[inline(always)]
        fn splat(x: f32) -> Self {
            let v = unsafe { _mm256_set1_ps(x) };
            Self(v, v)
        }
        #[inline(always)]
        fn load(from: &[f32; SAMPLES]) -> Self {
            // SAFETY: eight floats from 0 and eight from 8 are inside the array.
            unsafe { Self(_mm256_loadu_ps(from.as_ptr()), _mm256_loadu_ps(from[8..].as_ptr())) }
        }
        #[inline(always)]
        fn add(self, o: Self) -> Self {
            unsafe { Self(_mm256_add_ps(self.0, o.0), _mm256_add_ps(self.1, o.1)) }
        }
        #[inline(always)]
        fn sub(self, o: Self) -> Self {
            unsafe { Self(_mm256_sub_ps(self.0, o.0), _mm256_sub_ps(self.1, o.1)) }
        }
        #[inline(always)]
        fn mul(self, o: Self) -> Self {
            unsafe { Self(_mm256_mul_ps(self.0, o.0), _mm256_mul_ps(self.1, o.1)) }
        }
        #[inline(always)]
        fn abs(self) -> Self {
            unsafe {
                let sign = _mm256_set1_ps(-0.0);
                Self(_mm256_andnot_ps(sign, self.0), _mm256_andnot_ps(sign, self.1))
            }
        }
        #[inline(always)]
        fn le(self, o: Self) -> Self::Mask {
            unsafe {
                (_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, o.0), _mm256_cmp_ps::<_CMP_LE_OQ>(self.1, o.1))
            }
        }
        #[inline(always)]
        fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            unsafe { (_mm256_and_ps(a.0, b.0), _mm256_and_ps(a.1, b.1)) }
        }
        #[inline(always)]
        fn bits(mask: Self::Mask) -> u16 {
            let (a, b) = unsafe { (_mm256_movemask_ps(mask.0), _mm256_movemask_ps(mask.1)) };
            (a | b << 8) as u16
        }
        #[inline(always)]
        fn div(self, o: Self) -> Self {
            unsafe { Self(_mm256_div_ps(self.0, o.0), _mm256_div_ps(self.1, o.1)) }
        }
        #[inline(always)]
        fn in_cells(self, row: Self, sign: Self, cells: u64) -> u16 {
            unsafe {
                let rows = _mm256_cvtepu8_epi32(_mm_set_epi64x(0, cells as i64));
                let half = |a: __m256, b: __m256, sign: __m256| {
                    // Whole numbers below 0 and from 8 on are large without a sign.
                    let (a, b) = (
                        _mm256_cvttps_epi32(_mm256_floor_ps(a)),
                        _mm256_cvttps_epi32(_mm256_floor_ps(b)),
                    );
                    let row = _mm256_permutevar8x32_epi32(rows, b);
                    // Shifted by 32 or more, nothing is left.
                    let bit = _mm256_slli_epi32::<31>(_mm256_srlv_epi32(row, a));
                    let high = _mm256_andnot_si256(_mm256_set1_epi32(7), b);
                    let is_row = _mm256_cmpeq_epi32(high, _mm256_setzero_si256());
                    let is_set = _mm256_castsi256_ps(_mm256_and_si256(bit, is_row));
                    // Of both, the highest bits count.
                    _mm256_movemask_ps(_mm256_andnot_ps(sign, is_set))
                };
                (half(self.0, row.0, sign.0) | half(self.1, row.1, sign.1) << 8) as u16
            }
        }
        #[inline(always)]
        fn largest_where(self, bits: u16) -> f32 {
            unsafe {
                let [low, high] = [spread(bits & 0xff), spread(bits >> 8)];
                let low = _mm256_and_ps(_mm256_castsi256_ps(low), self.0);
                let eight = _mm256_max_ps(low, _mm256_and_ps(_mm256_castsi256_ps(high), self.1));
                let four =
                    _mm_max_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
                let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_max_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }
        #[inline(always)]
        fn store_where(self, bits: u16, to: &mut [f32; SAMPLES]) {
            // SAFETY: as in `load`; masked lanes are not written.
            unsafe {
                _mm256_maskstore_ps(to.as_mut_ptr(), spread(bits & 0xff), self.0);
                _mm256_maskstore_ps(to[8..].as_mut_ptr(), spread(bits >> 8), self.1);
            }
        }
    }

    /// Eight lanes, all bits of those whose bit is set.
    #[inline(always)]
    fn spread(bits: u16) -> __m256i {
        unsafe {
            let bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let all = _mm256_set1_epi32(i32::from(bits));
            _mm256_cmpeq_epi32(_mm256_and_si256(all, bit), bit)
        }
    }

    /// One AVX-512 register.
    #[derive(Clone, Copy, Debug)]
    pub struct Avx512(__m512);

    impl Sealed for Avx512 {}

    impl Lanes for Avx512 {
        type Mask = __mmask16;

        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self(unsafe { _mm512_set1_ps(x) })
        }
        #[inline(always)]
        fn load(from: &[f32; SAMPLES]) -> Self {
            // SAFETY: sixteen floats are the whole array.
            Self(unsafe { _mm512_loadu_ps(from.as_ptr()) })
        }
        #[inline(always)]
        fn add(self, o: Self) -> Self {
            Self(unsafe { _mm512_add_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn sub(self, o: Self) -> Self {
            Self(unsafe { _mm512_sub_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn mul(self, o: Self) -> Self {
            Self(unsafe { _mm512_mul_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm512_abs_ps(self.0) })
        }
        #[inline(always)]
        fn le(self, o: Self) -> Self::Mask {
            unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, o.0) }
        }
        #[inline(always)]
        fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            a & b
        }
        #[inline(always)]
        fn bits(mask: Self::Mask) -> u16 {
            mask
        }
        #[inline(always)]
        fn div(self, o: Self) -> Self {
            Self(unsafe { _mm512_div_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn in_cells(self, row: Self, sign: Self, cells: u64) -> u16 {
            unsafe {
                let rows = _mm512_cvtepu8_epi32(_mm_set_epi64x(0, cells as i64));
                let floor = |x: __m512| _mm512_cvttps_epi32(_mm512_roundscale_ps::<1>(x));
                let (a, b) = (floor(self.0), floor(row.0));
                // Rows from 8 on are empty.
                let is_row = _mm512_cmplt_epu32_mask(b, _mm512_set1_epi32(8));
                let row = _mm512_permutexvar_epi32(b, rows);
                let bit = _mm512_srlv_epi32(row, a);
                let is_negative = _mm512_movepi32_mask(_mm512_castps_si512(sign.0));
                _mm512_test_epi32_mask(bit, _mm512_set1_epi32(1)) & is_row & !is_negative
            }
        }
        #[inline(always)]
        fn largest_where(self, bits: u16) -> f32 {
            unsafe { _mm512_reduce_max_ps(_mm512_maskz_mov_ps(bits, self.0)) }
        }
        #[inline(always)]
        fn store_where(self, bits: u16, to: &mut [f32; SAMPLES]) {
            // SAFETY: as in `load`; masked lanes are not written.
            unsafe { _mm512_mask_storeu_ps(to.as_mut_ptr(), bits, self.0) }
        }
    }
}
