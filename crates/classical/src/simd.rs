//! Compiling a kernel for several instruction sets and picking one when it is called.

/// Wraps a function so that its body is also compiled for AVX-512 and for AVX2 with FMA, and the best one that the
/// processor has is called. The body is written as plain loops, which the compiler vectorises for each set. Rust
/// never fuses or reorders floating-point operations by itself, so that every version gives the same bits.
macro_rules! multiversioned {
    ($(#[$attribute:meta])* $visibility:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $body:block) => {
        $(#[$attribute])*
        $visibility fn $name($($argument: $type),*) {
            #[inline(always)]
            fn all_versions($($argument: $type),*) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")]
                fn avx512($($argument: $type),*) {
                    all_versions($($argument),*);
                }

                #[target_feature(enable = "avx2,fma")]
                fn avx2($($argument: $type),*) {
                    all_versions($($argument),*);
                }

                let has_fma = std::arch::is_x86_feature_detected!("fma");
                if std::arch::is_x86_feature_detected!("avx512f")
                    && std::arch::is_x86_feature_detected!("avx512bw")
                    && std::arch::is_x86_feature_detected!("avx512dq")
                    && std::arch::is_x86_feature_detected!("avx512vl")
                    && has_fma
                {
                    // SAFETY: the processor has every feature that the function is compiled for.
                    return unsafe { avx512($($argument),*) };
                }
                if std::arch::is_x86_feature_detected!("avx2") && has_fma {
                    // SAFETY: as above.
                    return unsafe { avx2($($argument),*) };
                }
            }
            all_versions($($argument),*);
        }
    };
}

pub(crate) use multiversioned;
