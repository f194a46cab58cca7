//! Running a kernel with the widest instructions the processor has.

/// Instruction sets a kernel can be compiled for. The results are the same bits at every level: no level reorders a sum
/// or fuses a multiplication with an addition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimdLevel {
    /// What the target always has (SSE2 on x86-64).
    Baseline,
    /// AVX2.
    Avx2,
}

impl SimdLevel {
    /// The widest level of this processor.
    #[must_use]
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self::Avx2;
        }
        Self::Baseline
    }
}

/// Runs `kernel` compiled for `level`. The kernel must be `#[inline(always)]` all the way down, or
/// the parts that are not run as baseline code.
#[inline]
pub fn run_wide<T>(level: SimdLevel, kernel: impl FnOnce() -> T) -> T {
    match level {
        SimdLevel::Baseline => kernel(),
        SimdLevel::Avx2 => avx2::run(kernel),
    }
}

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calling code compiled for a newer processor")]
mod avx2 {
    pub(super) fn run<T>(kernel: impl FnOnce() -> T) -> T {
        assert!(std::arch::is_x86_feature_detected!("avx2"), "this processor has no AVX2");
        // SAFETY: the processor has AVX2, the only condition of the call.
        unsafe { run_compiled(kernel) }
    }

    #[target_feature(enable = "avx2")]
    fn run_compiled<T>(kernel: impl FnOnce() -> T) -> T {
        kernel()
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod avx2 {
    pub(super) fn run<T>(kernel: impl FnOnce() -> T) -> T {
        kernel()
    }
}
