//! Running a kernel with the widest instructions the processor has.

use crate::lanes::Lanes;
#[cfg(not(target_arch = "x86_64"))]
use crate::lanes::Plain as Baseline;
#[cfg(target_arch = "x86_64")]
use crate::lanes::x86::Sse2 as Baseline;

/// Instruction sets a kernel can be compiled for. The results are the same bits at every level: no level reorders a sum
/// or fuses a multiplication with an addition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimdLevel {
    /// What the target always has (SSE2 on x86-64).
    Baseline,
    /// AVX2.
    Avx2,
    /// AVX-512 F, BW, DQ and VL.
    Avx512,
}

impl SimdLevel {
    /// Every level this processor has, narrowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        #[cfg_attr(not(target_arch = "x86_64"), expect(unused_mut, reason = "there are no others"))]
        let mut levels = vec![Self::Baseline];
        #[cfg(target_arch = "x86_64")]
        {
            if x86::has_avx2() {
                levels.push(Self::Avx2);
            }
            if x86::has_avx512() {
                levels.push(Self::Avx512);
            }
        }
        levels
    }

    /// The widest level of this processor.
    #[must_use]
    pub fn detect() -> Self {
        Self::available().pop().unwrap_or(Self::Baseline)
    }
}

/// Work that is compiled for every level. `run` and all it calls must be `#[inline(always)]`, or
/// those parts are not compiled for the level.
pub trait WideKernel {
    /// What the work gives.
    type Output;
    /// Does the work.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Runs `kernel` compiled for `level`.
///
/// # Panics
///
/// If this processor has no such level.
#[inline]
pub fn run_wide<K: WideKernel>(level: SimdLevel, kernel: K) -> K::Output {
    match level {
        SimdLevel::Baseline => compiled_baseline(kernel),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx2 => x86::run_avx2(kernel),
        #[cfg(target_arch = "x86_64")]
        SimdLevel::Avx512 => x86::run_avx512(kernel),
        #[cfg(not(target_arch = "x86_64"))]
        SimdLevel::Avx2 | SimdLevel::Avx512 => panic!("this processor has no {level:?}"),
    }
}

/// One copy of a kernel, wherever it is run.
#[inline(never)]
fn compiled_baseline<K: WideKernel>(kernel: K) -> K::Output {
    kernel.run::<Baseline>()
}

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calling code compiled for a newer processor")]
mod x86 {
    use super::WideKernel;
    use crate::lanes::x86::{Avx2, Avx512};
    use std::arch::is_x86_feature_detected as has;

    pub(super) fn has_avx2() -> bool {
        has!("avx2") && has!("bmi1") && has!("bmi2") && has!("popcnt") && has!("lzcnt")
    }

    pub(super) fn has_avx512() -> bool {
        has_avx2() && has!("avx512f") && has!("avx512bw") && has!("avx512dq") && has!("avx512vl")
    }

    pub(super) fn run_avx2<K: WideKernel>(kernel: K) -> K::Output {
        assert!(has_avx2(), "this processor has no AVX2");
        // SAFETY: the processor has what the function is compiled for, the only condition of the call.
        unsafe { compiled_avx2(kernel) }
    }

    pub(super) fn run_avx512<K: WideKernel>(kernel: K) -> K::Output {
        assert!(has_avx512(), "this processor has no AVX-512");
        // SAFETY: as above.
        unsafe { compiled_avx512(kernel) }
    }

    #[target_feature(enable = "avx2,bmi1,bmi2,popcnt,lzcnt")]
    fn compiled_avx2<K: WideKernel>(kernel: K) -> K::Output {
        kernel.run::<Avx2>()
    }

    #[target_feature(enable = "avx2,bmi1,bmi2,popcnt,lzcnt,avx512f,avx512bw,avx512dq,avx512vl")]
    fn compiled_avx512<K: WideKernel>(kernel: K) -> K::Output {
        kernel.run::<Avx512>()
    }
}
