//! Portable code with the widest registers that the processor has.

/// Work whose `run` is `#[inline(always)]`, with all that it calls: then it is compiled once for each width. A closure
/// in its place would be compiled once, for the narrowest.
pub(crate) trait Work {
    /// What it returns.
    type Out;

    fn run(self) -> Self::Out;
}

/// Runs `work` with the widest registers. No two roundings become one: the numbers are those of every other processor.
#[inline(always)]
pub(crate) fn widest<W: Work>(work: W) -> W::Out {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected;

        #[target_feature(enable = "avx512f")]
        fn with_avx512<W: Work>(work: W) -> W::Out {
            work.run()
        }
        #[target_feature(enable = "avx2")]
        fn with_avx2<W: Work>(work: W) -> W::Out {
            work.run()
        }
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has just said that it knows the instructions.
            return unsafe { with_avx512(work) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: as above.
            return unsafe { with_avx2(work) };
        }
    }
    work.run()
}

/// The registers that are chosen here and by the other kernels: what the processor has of `avx2` and `avx512f`, else
/// `portable`.
#[cfg_attr(not(feature = "python"), allow(dead_code, reason = "the package reports it"))]
pub(crate) fn registers() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected;

        if is_x86_feature_detected!("avx512f") {
            return "avx512f";
        }
        if is_x86_feature_detected!("avx2") {
            return "avx2";
        }
    }
    "portable"
}
