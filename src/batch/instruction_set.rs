//! The instruction sets that the same generic code is compiled for. One of them is selected when the program runs.
//!
//! A *kernel* is generic over the scalar, and is compiled once per scalar and instruction set. The instruction set is
//! selected once, from those that the processor has and from the environment variable `PHIPSI_INSTRUCTION_SET`.

use super::finite::any_not_finite;
use crate::error::{by_name, name_in, named};
use crate::scalar::{ColumnsOf, MOST_LANES, Real};
#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
use crate::scalar::{Fused, Instructions, Lanes};
#[cfg(all(target_arch = "aarch64", feature = "lanes"))]
use pulp::aarch64::Neon;
#[cfg(all(target_arch = "x86_64", feature = "lanes"))]
use pulp::x86::V3;
#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
use pulp::x86::V4;
use std::sync::OnceLock;

/// The environment variable that selects an instruction set: "baseline", "avx2", "avx512" or "neon".
pub const VARIABLE: &str = "PHIPSI_INSTRUCTION_SET";

/// Its name until version 0.1, which has no effect.
const OLD_VARIABLE: &str = "PHIPSI_ARM";

named! {
    /// An instruction set.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    enum InstructionSet;
    /// Every instruction set of every processor with its name, those of one processor the narrowest first.
    const INSTRUCTION_SETS {
        /// The instructions that every processor of the target has, one value at a time.
        Baseline = "baseline",
        /// AVX2 and fused products (x86-64-v3).
        Avx2 = "avx2",
        /// AVX-512 F, BW, CD, DQ, VL (x86-64-v4).
        Avx512 = "avx512",
        /// NEON (aarch64).
        Neon = "neon",
    }
}

impl InstructionSet {
    /// The name, as the environment variable `PHIPSI_INSTRUCTION_SET` takes it.
    #[must_use]
    pub fn name(self) -> &'static str {
        name_in(&self, INSTRUCTION_SETS)
    }

    /// The number of values that a register holds.
    pub(crate) fn lanes(self) -> usize {
        match self {
            Self::Baseline => 1,
            Self::Neon => 2,
            Self::Avx2 => 4,
            Self::Avx512 => 8,
        }
    }

    /// True if this processor has the instruction set and kernels were compiled for it. [`InstructionSet::Avx512`]
    /// needs the feature `avx512`; [`InstructionSet::Avx2`] and [`InstructionSet::Neon`] need the feature `lanes`.
    #[must_use]
    pub fn available(self) -> bool {
        match self {
            Self::Baseline => true,
            #[cfg(all(target_arch = "x86_64", feature = "lanes"))]
            Self::Avx2 => V3::try_new().is_some(),
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            Self::Avx512 => V4::try_new().is_some(),
            #[cfg(all(target_arch = "aarch64", feature = "lanes"))]
            Self::Neon => Neon::try_new().is_some(),
            #[allow(unreachable_patterns)] // those of other processors
            _ => false,
        }
    }

    /// The instruction set of this process: the value of the environment variable `PHIPSI_INSTRUCTION_SET`, or else the
    /// widest of this processor. An unknown or unavailable name is reported on the standard error.
    ///
    /// A build with debug assertions selects the baseline unless the variable is set: without optimization, the kernels
    /// for lanes need more stack than a thread has.
    #[must_use]
    pub fn of_process() -> Self {
        static SELECTED: OnceLock<InstructionSet> = OnceLock::new();
        *SELECTED.get_or_init(|| {
            let most = if cfg!(debug_assertions) { 1 } else { INSTRUCTION_SETS.len() };
            let mut sets = INSTRUCTION_SETS[..most].iter().rev().map(|&(_, set)| set);
            let widest = sets.find(|set| set.available()).unwrap_or(Self::Baseline);
            if std::env::var_os(OLD_VARIABLE).is_some() {
                eprintln!("phipsi: the environment variable {OLD_VARIABLE} has no effect: set {VARIABLE}");
            }
            let Ok(wanted) = std::env::var(VARIABLE) else { return widest };
            let named = INSTRUCTION_SETS.iter().find(|(name, set)| *name == wanted && set.available());
            if named.is_none() && !wanted.is_empty() {
                let known: Vec<&str> =
                    INSTRUCTION_SETS.iter().filter(|(_, set)| set.available()).map(|&(name, _)| name).collect();
                let name = widest.name();
                eprintln!("phipsi: {VARIABLE} is {wanted:?}, expected one of {known:?}: {name:?} is used");
            }
            named.map_or(widest, |&(_, set)| set)
        })
    }
}

by_name!(InstructionSet, "instruction set", INSTRUCTION_SETS);

/// Work that is compiled for an instruction set; everything that it calls must be inlined into it.
pub trait Work {
    /// The result.
    type Output;

    /// Runs the work.
    fn call(self) -> Self::Output;
}

/// Functions that are compiled for the instructions of their caller's `target`, which is an additional first argument.
/// The body is the method of a struct that holds the arguments, because a closure is not always inlined, and is then
/// compiled for the baseline.
macro_rules! within_target {
    ($($(#[$meta:meta])* $visible:vis fn $name:ident<$($life:lifetime),+, $T:ident>(
        $($argument:ident: $kind:ty),* $(,)?
    ) -> $result:ty $body:block)*) => { $(
        $crate::batch::instruction_set::within_target! {
            $(#[$meta])*
            $visible fn $name<$($life),+, $T, I>(target; $($argument: $kind),*) -> $result $body
        }
    )* };
    // The same, for functions that pass their target on.
    ($($(#[$meta:meta])* $visible:vis fn $name:ident<$($life:lifetime),+, $T:ident, $I:ident>(
        $target:ident; $($argument:ident: $kind:ty),* $(,)?
    ) -> $result:ty $body:block)*) => { $(
        $(#[$meta])*
        $visible fn $name<
            $($life,)+ $T: $crate::batch::instruction_set::Vectorized, $I: $crate::batch::instruction_set::Target
        >($target: $I, $($argument: $kind),*) -> $result {
            use $crate::batch::instruction_set::{Target, Vectorized, Work};

            struct Call<$($life,)+ $T: Vectorized, $I: Target>($I, $($kind),*);

            impl<$($life,)+ $T: Vectorized, $I: Target> Work for Call<$($life,)+ $T, $I> {
                type Output = $result;

                #[inline(always)]
                fn call(self) -> $result {
                    let Self($target, $($argument),*) = self;
                    let _ = $target;
                    $body
                }
            }

            $target.within(Call($target, $($argument),*))
        }
    )* };
}
pub(crate) use within_target;

/// Scratch memory in the scalar of an instruction set, for one state or for several: the result of `boxed`, which the
/// macro calls with the instruction set as a further argument. Without `lanes`, and for the baseline, the scalar is
/// f64.
#[cfg(feature = "motion")]
macro_rules! on_instruction_set {
    (($arm:expr, $alone:expr), $Compiled:ident::boxed($($argument:expr),*)) => {{
        #[allow(unused_imports)] // without `lanes`
        use $crate::batch::instruction_set::{Baseline, InstructionSet, Target};
        let on_arm = match ($arm, $alone) {
            #[cfg(all(target_arch = "x86_64", feature = "lanes"))]
            (InstructionSet::Avx2, false) => pulp::x86::V3::here()
                .map(|target| $Compiled::<$crate::scalar::Lanes<pulp::x86::V3>, _>::boxed($($argument,)* target)),
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            (InstructionSet::Avx512, false) => pulp::x86::V4::here()
                .map(|target| $Compiled::<$crate::scalar::Lanes<pulp::x86::V4>, _>::boxed($($argument,)* target)),
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            (InstructionSet::Avx512, true) => pulp::x86::V4::here()
                .map(|target| $Compiled::<$crate::scalar::Fused, _>::boxed($($argument,)* target)),
            #[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
            #[allow(unreachable_patterns)] // Avx512 is above if it is compiled
            (InstructionSet::Avx2 | InstructionSet::Avx512 | InstructionSet::Neon, _) => {
                <$crate::scalar::Fused as $crate::batch::instruction_set::Vectorized>::Least::here()
                    .map(|target| $Compiled::<$crate::scalar::Fused, _>::boxed($($argument,)* target))
            }
            // The baseline; others are not compiled, and therefore never selected.
            _ => None,
        };
        on_arm.unwrap_or_else(|| $Compiled::<f64, _>::boxed($($argument,)* Baseline))
    }};
}
#[cfg(feature = "motion")]
pub(crate) use on_instruction_set;

/// Functions that are compiled for the widest instructions of this processor; see `within_target!`.
#[cfg(feature = "estimation")]
macro_rules! within_widest {
    ($($(#[$meta:meta])* $visible:vis fn $name:ident<$life:lifetime>(
        $($argument:ident: $kind:ty),* $(,)?
    ) $body:block)*) => { $(
        $(#[$meta])*
        $visible fn $name<$life>($($argument: $kind),*) {
            struct Call<$life>($($kind),*);

            impl<$life> $crate::batch::instruction_set::Work for Call<$life> {
                type Output = ();

                #[inline(always)]
                fn call(self) {
                    let Self($($argument),*) = self;
                    $body
                }
            }

            $crate::batch::instruction_set::with_widest(Call($($argument),*));
        }
    )* };
}
#[cfg(feature = "estimation")]
pub(crate) use within_widest;

/// Runs `work` with the widest instructions of this processor; without the feature `lanes`, with those that the crate
/// is compiled for.
#[inline]
pub(crate) fn with_widest<W: Work>(work: W) -> W::Output {
    #[cfg(feature = "lanes")]
    return pulp::Arch::new().dispatch(Dispatched(work));
    #[cfg(not(feature = "lanes"))]
    work.call()
}

#[cfg(feature = "lanes")]
struct Dispatched<W>(W);

#[cfg(feature = "lanes")]
impl<W: Work> pulp::WithSimd for Dispatched<W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> W::Output {
        self.0.call()
    }
}

/// Instructions for which work can be compiled.
pub trait Target: Copy + Send + Sync + 'static {
    /// The target, if this processor has its instructions.
    fn here() -> Option<Self>;

    /// Runs `work` with these instructions.
    fn within<W: Work>(self, work: W) -> W::Output;
}

/// The instructions that every processor has.
#[derive(Debug, Clone, Copy)]
pub struct Baseline;

impl Target for Baseline {
    fn here() -> Option<Self> {
        Some(Self)
    }

    #[inline(always)]
    fn within<W: Work>(self, work: W) -> W::Output {
        work.call()
    }
}

#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
impl<S: Instructions> Target for S {
    fn here() -> Option<Self> {
        S::token()
    }

    #[inline(always)]
    fn within<W: Work>(self, work: W) -> W::Output {
        self.vectorize(Job(work))
    }
}

/// An entry of a matrix, as it is stored.
pub type Entry<T> = <<T as Vectorized>::Columns as ColumnsOf<T>>::Entry;

/// A scalar of kernels.
pub trait Vectorized: Real {
    /// The type that holds several columns of a matrix of one state.
    type Columns: ColumnsOf<Self>;

    /// The instructions that it requires.
    type Least: Target;

    /// The values of the lanes in place: a copy would pass each of them through memory.
    fn lanes(&self) -> &[f64];

    /// The mutable values of the lanes.
    fn lanes_mut(&mut self) -> &mut [f64];

    /// Gathers values into lanes: `of` returns a slice for each lane, of the length of `numbers`, whose entries are set
    /// from these. Returns zero in a lane whose values are all finite, otherwise NaN.
    ///
    /// Empty slices leave `numbers` unchanged.
    #[inline(always)]
    fn take_lanes<'a>(numbers: &mut [Self], of: impl Fn(usize) -> &'a [f64]) -> Self {
        for lane in 0..Self::LANES {
            for (number, &value) in numbers.iter_mut().zip(of(lane)) {
                number.lanes_mut()[lane] = value;
            }
        }
        if of(0).is_empty() { Self::zero() } else { any_not_finite(numbers) }
    }

    /// Scatters lanes: writes `numbers` of each state, one state after another, for the number of states in `out`.
    #[inline(always)]
    fn put_lanes(numbers: &[Self], out: &mut [f64]) {
        for (lane, out) in out.chunks_exact_mut(numbers.len()).enumerate() {
            for (value, number) in out.iter_mut().zip(numbers) {
                *value = number.lanes()[lane];
            }
        }
    }

    /// The buffer to which the entries of a matrix are written; for one state the result itself.
    fn entries_in<'a>(entries: &'a mut [Entry<Self>], out: &'a mut [f64]) -> &'a mut [Entry<Self>];

    /// As [`Self::put_lanes`], with the values that `chosen` selects by their index in `entries`, of which the first is
    /// zero. Does nothing if the entries were written to the result.
    fn put_entries(entries: &[Entry<Self>], chosen: &[u32], out: &mut [f64]);
}

/// The state of each lane; lanes without a state repeat the last one.
#[inline(always)]
pub(super) fn in_lanes<S>(states: &[S]) -> [&S; MOST_LANES] {
    std::array::from_fn(|lane| &states[lane.min(states.len() - 1)])
}

/// Gathers one array of every state into lanes; lanes without a state repeat the last one.
#[inline(always)]
pub(crate) fn take_states<'a, T: Vectorized>(numbers: &mut [T], states: usize, of: impl Fn(usize) -> &'a [f64]) {
    T::take_lanes(numbers, |lane| of(lane.min(states - 1)));
}

/// The lanes given as bits.
#[cfg(feature = "motion")]
pub(crate) fn lanes_of(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = bits.trailing_zeros() as usize;
        (bits != 0).then(|| {
            bits &= bits - 1;
            lane
        })
    })
}

#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
struct Job<W>(W);

#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
impl<W: Work> pulp::NullaryFnOnce for Job<W> {
    type Output = W::Output;

    #[inline(always)]
    fn call(self) -> W::Output {
        self.0.call()
    }
}

impl Vectorized for f64 {
    type Columns = Self;
    type Least = Baseline;

    #[inline(always)]
    fn lanes(&self) -> &[f64] {
        std::slice::from_ref(self)
    }

    #[inline(always)]
    fn lanes_mut(&mut self) -> &mut [f64] {
        std::slice::from_mut(self)
    }

    #[inline(always)]
    fn entries_in<'a>(_entries: &'a mut [f64], out: &'a mut [f64]) -> &'a mut [f64] {
        out
    }

    #[inline(always)]
    fn put_entries(_entries: &[f64], _chosen: &[u32], _out: &mut [f64]) {}
}

/// The instructions of this target with fused multiply-add.
#[cfg(all(target_arch = "x86_64", feature = "lanes"))]
type WithFused = V3;
#[cfg(all(target_arch = "aarch64", feature = "lanes"))]
type WithFused = Neon;

#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
impl Vectorized for Fused {
    type Columns = Lanes<WithFused>;
    type Least = WithFused;

    #[inline(always)]
    fn lanes(&self) -> &[f64] {
        std::slice::from_ref(&self.0)
    }

    #[inline(always)]
    fn lanes_mut(&mut self) -> &mut [f64] {
        std::slice::from_mut(&mut self.0)
    }

    #[inline(always)]
    fn entries_in<'a>(_entries: &'a mut [f64], out: &'a mut [f64]) -> &'a mut [f64] {
        out
    }

    #[inline(always)]
    fn put_entries(_entries: &[Entry<Self>], _chosen: &[u32], _out: &mut [f64]) {}
}

#[cfg(all(feature = "lanes", any(target_arch = "x86_64", target_arch = "aarch64")))]
impl<S: Instructions> Vectorized for Lanes<S> {
    type Columns = Self;
    type Least = S;

    #[inline(always)]
    fn lanes(&self) -> &[f64] {
        Lanes::lanes(self)
    }

    #[inline(always)]
    fn lanes_mut(&mut self) -> &mut [f64] {
        Lanes::lanes_mut(self)
    }

    #[inline(always)]
    fn take_lanes<'a>(numbers: &mut [Self], of: impl Fn(usize) -> &'a [f64]) -> Self {
        Lanes::take_lanes(numbers, of)
    }

    #[inline(always)]
    fn put_lanes(numbers: &[Self], out: &mut [f64]) {
        Lanes::put_lanes(numbers, out);
    }

    #[inline(always)]
    fn entries_in<'a>(entries: &'a mut [Self], _out: &'a mut [f64]) -> &'a mut [Self] {
        entries
    }

    #[inline(always)]
    fn put_entries(entries: &[Self], chosen: &[u32], out: &mut [f64]) {
        Lanes::put_chosen(entries, chosen, out);
    }
}
