//! Detects the processor's instruction sets and compiles kernels for each of them.

use std::fmt;
use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

#[cfg(target_arch = "x86_64")]
use crate::{Avx2, Avx512};
use crate::{Portable, Simd};

/// An instruction set that this processor has.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Isa {
    /// Plain Rust, for every processor.
    Portable(Portable),
    /// 256-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    /// 512-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
}

/// How many entries of [`detected`] may be used, counted from the narrowest.
static ALLOWED: AtomicUsize = AtomicUsize::new(usize::MAX);

/// Every instruction set of this processor, narrowest first.
fn detected() -> &'static [Isa] {
    static DETECTED: OnceLock<Vec<Isa>> = OnceLock::new();
    DETECTED.get_or_init(|| {
        #[cfg(target_arch = "x86_64")]
        let wider = [Avx2::detect().map(Isa::Avx2), Avx512::detect().map(Isa::Avx512)];
        #[cfg(not(target_arch = "x86_64"))]
        let wider: [Option<Isa>; 0] = [];
        std::iter::once(Isa::Portable(Portable)).chain(wider.into_iter().flatten()).collect()
    })
}

impl Isa {
    /// The widest instruction set of this processor, unless [`Isa::limit_process`] chose a narrower one.
    pub fn best() -> Self {
        let isas = detected();
        isas[ALLOWED.load(Ordering::Relaxed).min(isas.len()) - 1]
    }

    /// Makes [`Isa::best`] return this instruction set from now on, in the whole process: to compare results and times.
    pub fn limit_process(self) {
        let position = detected().iter().position(|&isa| isa == self).unwrap_or(0);
        ALLOWED.store(position + 1, Ordering::Relaxed);
    }

    /// Every instruction set of this processor, narrowest first. Prints those that it lacks, and that are therefore not tested,
    /// to standard error, even where the test harness captures output.
    pub fn to_test() -> impl Iterator<Item = Self> {
        static NAMED: OnceLock<()> = OnceLock::new();
        NAMED.get_or_init(|| {
            for name in ["AVX2", "AVX-512"] {
                if !detected().iter().any(|isa| isa.name() == name) {
                    // Not `eprintln!`, which the test harness captures. A closed standard error is no reason to fail.
                    let _ = writeln!(
                        std::io::stderr(),
                        "The kernels for {name} are not tested: this processor does not have it."
                    );
                }
            }
        });
        detected().iter().copied()
    }

    /// Name as in the processor manuals.
    pub fn name(self) -> &'static str {
        match self {
            Isa::Portable(_) => "portable",
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2(_) => "AVX2",
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512(_) => "AVX-512",
        }
    }

    /// [`Simd::LANES`].
    pub fn lanes(self) -> usize {
        match self {
            Isa::Portable(_) => Portable::LANES,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2(_) => Avx2::LANES,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512(_) => Avx512::LANES,
        }
    }

    /// [`Simd::TILE_ROWS`].
    pub fn tile_rows(self) -> usize {
        match self {
            Isa::Portable(_) => Portable::TILE_ROWS,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2(_) => Avx2::TILE_ROWS,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512(_) => Avx512::TILE_ROWS,
        }
    }
}

impl fmt::Debug for Isa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Defines `$name(isa, arguments)`, which runs the generic kernel `$kernel(token, arguments)` compiled for `isa`. Mark
/// kernels and everything they call `#[inline(always)]`: a function that is not inlined is not compiled for the
/// instruction set.
///
/// ```
/// use srflow_simd::{Isa, Simd, dispatch};
///
/// dispatch! {
///     /// Doubles each number.
///     fn double = double_kernel(numbers: &mut [f32])
/// }
///
/// #[inline(always)]
/// fn double_kernel<S: Simd>(s: S, numbers: &mut [f32]) {
///     let (vectors, rest) = numbers.split_at_mut(numbers.len() / S::LANES * S::LANES);
///     for vector in vectors.chunks_exact_mut(S::LANES) {
///         let v = s.read(vector);
///         s.write(s.add(v, v), vector);
///     }
///     rest.iter_mut().for_each(|x| *x *= 2.0);
/// }
///
/// let mut numbers = [1.0; 21];
/// double(Isa::best(), &mut numbers);
/// assert_eq!(numbers, [2.0; 21]);
/// ```
#[macro_export]
macro_rules! dispatch {
    ($(#[$doc:meta])* $vis:vis fn $name:ident $(<const $n:ident: usize>)? =
        $kernel:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)?
    ) => {
        $(#[$doc])*
        #[allow(clippy::too_many_arguments, reason = "the kernel's arguments plus the token")]
        #[inline]
        $vis fn $name $(<const $n: usize>)? (isa: $crate::Isa, $($arg: $ty),*) $(-> $ret)? {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
            #[allow(clippy::too_many_arguments, reason = "the kernel's arguments plus the token")]
            fn avx512 $(<const $n: usize>)? (s: $crate::Avx512, $($arg: $ty),*) $(-> $ret)? {
                $kernel $(::<$n>)? (s, $($arg),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,bmi1,bmi2,popcnt")]
            #[allow(clippy::too_many_arguments, reason = "the kernel's arguments plus the token")]
            fn avx2 $(<const $n: usize>)? (s: $crate::Avx2, $($arg: $ty),*) $(-> $ret)? {
                $kernel $(::<$n>)? (s, $($arg),*)
            }
            match isa {
                $crate::Isa::Portable(s) => $kernel $(::<$n>)? (s, $($arg),*),
                #[cfg(target_arch = "x86_64")]
                // SAFETY: an `Avx2` exists only where `Avx2::detect` found all of the features above.
                $crate::Isa::Avx2(s) => unsafe { avx2 $(::<$n>)? (s, $($arg),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: likewise for `Avx512`.
                $crate::Isa::Avx512(s) => unsafe { avx512 $(::<$n>)? (s, $($arg),*) },
            }
        }
    };
    // An unsafe kernel: the caller upholds its contract.
    ($(#[$doc:meta])* $vis:vis unsafe fn $name:ident = $kernel:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$doc])*
        #[inline]
        $vis unsafe fn $name(isa: $crate::Isa, $($arg: $ty),*) {
            #[inline(always)]
            fn promised<S: $crate::Simd>(s: S, $($arg: $ty),*) {
                // SAFETY: the contract is passed on to the caller; nothing else can see the function.
                unsafe { $kernel(s, $($arg),*) }
            }
            $crate::dispatch! { fn run = promised($($arg: $ty),*) }
            run(isa, $($arg),*)
        }
    };
}

/// Compiles a function of plain loops for every instruction set, and runs the one for [`Isa::best`]. Rust never fuses or
/// reorders floating-point operations by itself: every version gives the same bits.
#[macro_export]
macro_rules! multiversioned {
    ($(#[$attribute:meta])* $vis:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $body:block) => {
        $(#[$attribute])*
        $vis fn $name($($argument: $type),*) {
            #[allow(clippy::too_many_arguments, reason = "the kernel's arguments plus the token")]
            #[inline(always)]
            fn body<S: $crate::Simd>(_: S, $($argument: $type),*) $body
            $crate::dispatch! { fn run = body($($argument: $type),*) }
            run($crate::Isa::best(), $($argument),*)
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_instruction_set_is_the_widest_and_can_be_limited() {
        assert_eq!(Isa::best(), Isa::to_test().last().expect("the portable one"));
        Isa::Portable(Portable).limit_process();
        assert_eq!(Isa::best().name(), "portable");
        Isa::to_test().last().expect("the portable one").limit_process();
        assert_eq!(Some(Isa::best()), Isa::to_test().last());
    }
}
