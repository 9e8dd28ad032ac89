//! The instruction sets that the same generic code is compiled for, one of which is picked when the program runs.
//!
//! A *kernel* is generic over the scalar; an *arm* is a scalar together with the instructions it is compiled for. Which arm runs
//! is decided once, from what the processor has and from the environment variable `PHIPSI_ARM`.

#[cfg(target_arch = "x86_64")]
use crate::scalar::Lanes;
use crate::scalar::{ColumnsOf, Fused, Real};
use std::sync::OnceLock;

/// The variable that forces an arm: "baseline", "avx2" or "avx512".
pub const VARIABLE: &str = "PHIPSI_ARM";

/// A set of instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Arm {
    /// Those that every processor of the target has: SSE2 on x86-64, NEON on aarch64.
    Baseline,
    /// AVX2 and fused products (x86-64-v3).
    Avx2,
    /// AVX-512 F, BW, CD, DQ, VL (x86-64-v4).
    Avx512,
}

/// Every arm with its name, the narrowest first.
pub const ARMS: [(&str, Arm); 3] = [("baseline", Arm::Baseline), ("avx2", Arm::Avx2), ("avx512", Arm::Avx512)];

impl Arm {
    /// The name, as [`VARIABLE`] takes it.
    #[must_use]
    pub fn name(self) -> &'static str {
        ARMS.iter().find(|(_, arm)| *arm == self).map_or("", |(name, _)| name)
    }

    /// Whether this processor can run it.
    #[must_use]
    pub fn available(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return match self {
            Self::Baseline => true,
            Self::Avx2 => pulp::x86::V3::try_new().is_some(),
            Self::Avx512 => pulp::x86::V4::try_new().is_some(),
        };
        #[cfg(not(target_arch = "x86_64"))]
        return self == Self::Baseline;
    }

    /// The arm of this process: what [`VARIABLE`] names if that can run here, else the widest that can.
    ///
    /// A build with debug assertions picks the baseline unless told otherwise: without optimisation the kernels of the lanes need
    /// more stack than a thread has.
    #[must_use]
    pub fn of_process() -> Self {
        static PICKED: OnceLock<Arm> = OnceLock::new();
        *PICKED.get_or_init(|| {
            let widest = if cfg!(debug_assertions) { 1 } else { ARMS.len() };
            let widest =
                ARMS[..widest].iter().rev().map(|&(_, arm)| arm).find(|arm| arm.available()).unwrap_or(Self::Baseline);
            let wanted = std::env::var(VARIABLE).unwrap_or_default();
            ARMS.iter().find(|(name, arm)| *name == wanted && arm.available()).map_or(widest, |&(_, arm)| arm)
        })
    }
}

/// Work that an arm compiles for its instructions; everything that it calls must be inlined into it.
pub trait Work {
    /// What it gives.
    type Output;

    /// Does it.
    fn call(self) -> Self::Output;
}

/// A scalar with the instructions that it wants.
pub trait Vectorised: Real {
    /// What holds several columns of a matrix of one state.
    type Columns: ColumnsOf<Self>;

    /// Does `work` with these instructions where the processor has them.
    fn within<W: Work>(work: W) -> W::Output;

    /// The numbers, lane by lane, where they are: a copy would go through memory for each.
    fn lanes(&self) -> &[f64];

    /// The same, to be written.
    fn lanes_mut(&mut self) -> &mut [f64];

    /// Numbers into lanes: `states` has a slice for each lane, `numbers` becomes entry by entry what they hold.
    ///
    /// Slices that are empty leave all as it is.
    #[inline(always)]
    fn take_lanes(states: &[&[f64]], numbers: &mut [Self]) {
        for (lane, state) in states.iter().enumerate() {
            for (number, &value) in numbers.iter_mut().zip(*state) {
                number.lanes_mut()[lane] = value;
            }
        }
    }

    /// Lanes into numbers: of each state as many as there are in `numbers`, one state after another; as many states as `out` has.
    #[inline(always)]
    fn put_lanes(numbers: &[Self], out: &mut [f64]) {
        for (lane, out) in out.chunks_exact_mut(numbers.len()).enumerate() {
            for (value, number) in out.iter_mut().zip(numbers) {
                *value = number.lanes()[lane];
            }
        }
    }
}

struct Job<W>(W);

impl<W: Work> pulp::NullaryFnOnce for Job<W> {
    type Output = W::Output;

    #[inline(always)]
    fn call(self) -> W::Output {
        self.0.call()
    }
}

impl Vectorised for f64 {
    type Columns = Self;

    #[inline(always)]
    fn within<W: Work>(work: W) -> W::Output {
        work.call()
    }

    #[inline(always)]
    fn lanes(&self) -> &[f64] {
        std::slice::from_ref(self)
    }

    #[inline(always)]
    fn lanes_mut(&mut self) -> &mut [f64] {
        std::slice::from_mut(self)
    }
}

impl Vectorised for Fused {
    #[cfg(target_arch = "x86_64")]
    type Columns = Lanes<pulp::x86::V3>;
    #[cfg(not(target_arch = "x86_64"))]
    type Columns = Self;

    #[inline(always)]
    fn within<W: Work>(work: W) -> W::Output {
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            return simd.vectorize(Job(work));
        }
        work.call()
    }

    #[inline(always)]
    fn lanes(&self) -> &[f64] {
        std::slice::from_ref(&self.0)
    }

    #[inline(always)]
    fn lanes_mut(&mut self) -> &mut [f64] {
        std::slice::from_mut(&mut self.0)
    }
}

#[cfg(target_arch = "x86_64")]
macro_rules! arm {
    ($level:ident) => {
        impl Vectorised for Lanes<pulp::x86::$level> {
            type Columns = Self;

            #[inline(always)]
            fn within<W: Work>(work: W) -> W::Output {
                match pulp::x86::$level::try_new() {
                    Some(simd) => simd.vectorize(Job(work)),
                    None => work.call(),
                }
            }

            #[inline(always)]
            fn lanes(&self) -> &[f64] {
                Lanes::lanes(self)
            }

            #[inline(always)]
            fn lanes_mut(&mut self) -> &mut [f64] {
                Lanes::lanes_mut(self)
            }

            #[inline(always)]
            fn take_lanes(states: &[&[f64]], numbers: &mut [Self]) {
                Lanes::take_lanes(states, numbers);
            }

            #[inline(always)]
            fn put_lanes(numbers: &[Self], out: &mut [f64]) {
                Lanes::put_lanes(numbers, out);
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
arm!(V3);
#[cfg(target_arch = "x86_64")]
arm!(V4);
