//! Several states side by side: one number of each in a lane of a vector register, and every operation on all lanes at once.
//!
//! The registers and their instructions are pulp's, for the instruction set `S`. Operations are one instruction inside work that an
//! arm runs (see [`arms`](crate::batch::arms)), and slow calls outside.

use super::trigonometry as t;
use super::{Precision, Real};
use num_traits::{One, Zero};
use pulp::Simd;
use pulp::bytemuck::{cast_slice, cast_slice_mut};
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use pulp::cast;
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use std::slice::{from_mut, from_ref};

/// An instruction set, and how its registers are aligned in memory.
pub trait Instructions: Simd {
    /// A type of no size with that alignment.
    type Alignment: Debug + Copy + Send + Sync + 'static;

    /// The set, where this processor has it.
    fn token() -> Option<Self>;

    /// As many registers as each has lanes: what was number j of register i becomes number i of register j.
    fn transpose(self, block: &mut [Self::f64s]);
}

/// 16 bytes.
#[cfg(target_arch = "aarch64")]
#[derive(Debug, Clone, Copy)]
#[repr(align(16))]
pub struct Align16;

/// 32 bytes.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub struct Align32;

/// 64 bytes.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub struct Align64;

#[cfg(target_arch = "x86_64")]
impl Instructions for pulp::x86::V3 {
    type Alignment = Align32;

    #[inline(always)]
    fn transpose(self, block: &mut [Self::f64s]) {
        let [a, b, c, d] = block else { return };
        let s = self.avx;
        let [ra, rb, rc, rd] = [cast(*a), cast(*b), cast(*c), cast(*d)];
        // Numbers 0 and 2, and 1 and 3, of two registers.
        let (ab, ab_odd) = (s._mm256_unpacklo_pd(ra, rb), s._mm256_unpackhi_pd(ra, rb));
        let (cd, cd_odd) = (s._mm256_unpacklo_pd(rc, rd), s._mm256_unpackhi_pd(rc, rd));
        *a = cast(s._mm256_permute2f128_pd::<0x20>(ab, cd));
        *b = cast(s._mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd));
        *c = cast(s._mm256_permute2f128_pd::<0x31>(ab, cd));
        *d = cast(s._mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd));
    }

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }
}

#[cfg(target_arch = "x86_64")]
impl Instructions for pulp::x86::V4 {
    type Alignment = Align64;

    #[inline(always)]
    fn transpose(self, block: &mut [Self::f64s]) {
        /// Quarters 0 and 2, and 1 and 3, of two registers.
        const EVEN: i32 = 0b10_00_10_00;
        const ODD: i32 = 0b11_01_11_01;
        let [a, b, c, d, e, f, g, h] = block else { return };
        let s = self.avx512f;
        let r = [cast(*a), cast(*b), cast(*c), cast(*d), cast(*e), cast(*f), cast(*g), cast(*h)];
        // Even numbers of two registers, then odd ones.
        let (ab, ab_odd) = (s._mm512_unpacklo_pd(r[0], r[1]), s._mm512_unpackhi_pd(r[0], r[1]));
        let (cd, cd_odd) = (s._mm512_unpacklo_pd(r[2], r[3]), s._mm512_unpackhi_pd(r[2], r[3]));
        let (ef, ef_odd) = (s._mm512_unpacklo_pd(r[4], r[5]), s._mm512_unpackhi_pd(r[4], r[5]));
        let (gh, gh_odd) = (s._mm512_unpacklo_pd(r[6], r[7]), s._mm512_unpackhi_pd(r[6], r[7]));
        let (low, high) = (s._mm512_shuffle_f64x2::<EVEN>(ab, cd), s._mm512_shuffle_f64x2::<EVEN>(ef, gh));
        *a = cast(s._mm512_shuffle_f64x2::<EVEN>(low, high));
        *e = cast(s._mm512_shuffle_f64x2::<ODD>(low, high));
        let (low, high) = (s._mm512_shuffle_f64x2::<ODD>(ab, cd), s._mm512_shuffle_f64x2::<ODD>(ef, gh));
        *c = cast(s._mm512_shuffle_f64x2::<EVEN>(low, high));
        *g = cast(s._mm512_shuffle_f64x2::<ODD>(low, high));
        let (low, high) =
            (s._mm512_shuffle_f64x2::<EVEN>(ab_odd, cd_odd), s._mm512_shuffle_f64x2::<EVEN>(ef_odd, gh_odd));
        *b = cast(s._mm512_shuffle_f64x2::<EVEN>(low, high));
        *f = cast(s._mm512_shuffle_f64x2::<ODD>(low, high));
        let (low, high) =
            (s._mm512_shuffle_f64x2::<ODD>(ab_odd, cd_odd), s._mm512_shuffle_f64x2::<ODD>(ef_odd, gh_odd));
        *d = cast(s._mm512_shuffle_f64x2::<EVEN>(low, high));
        *h = cast(s._mm512_shuffle_f64x2::<ODD>(low, high));
    }

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }
}

#[cfg(target_arch = "aarch64")]
impl Instructions for pulp::aarch64::Neon {
    type Alignment = Align16;

    #[inline(always)]
    fn transpose(self, block: &mut [Self::f64s]) {
        let [a, b] = block else { return };
        let (x, y): ([f64; 2], [f64; 2]) = (cast(*a), cast(*b));
        (*a, *b) = (cast([x[0], y[0]]), cast([x[1], y[1]]));
    }

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }
}

/// One number of each state, as many as a register of `S` holds: f64, or f32 and then twice as many.
#[derive(Debug, Clone, Copy)]
pub struct Lanes<S: Instructions, P: Precision = f64> {
    /// Of no size; aligns the rest.
    _alignment: [S::Alignment; 0],
    simd: S,
    value: P::Register<S>,
}

impl<S: Instructions, P: Precision> Lanes<S, P> {
    #[inline(always)]
    fn new(simd: S, value: P::Register<S>) -> Self {
        Self { _alignment: [], simd, value }
    }

    /// The number nearest to `x` in every lane.
    ///
    /// # Panics
    ///
    /// Where the processor lacks the instructions: no arm that it cannot run is ever picked.
    #[inline(always)]
    #[must_use]
    pub fn splat(x: f64) -> Self {
        let simd = S::token().expect("an arm of this processor");
        Self::new(simd, P::splat(simd, x))
    }

    /// The numbers, lane by lane.
    #[inline(always)]
    pub fn lanes(&self) -> &[P] {
        cast_slice(from_ref(&self.value))
    }

    /// The numbers, lane by lane.
    #[inline(always)]
    pub fn lanes_mut(&mut self) -> &mut [P] {
        cast_slice_mut(from_mut(&mut self.value))
    }
}

/// As many lanes of f64 as any set of instructions has.
const MOST_LANES: usize = 8;

impl<S: Instructions> Lanes<S> {
    /// A slice of each lane's numbers into lanes; empty slices leave all as it is.
    #[inline(always)]
    pub(super) fn take_lanes(states: &[&[f64]], numbers: &mut [Self]) {
        let Some(simd) = numbers.first().map(|first| first.simd) else { return };
        let length = numbers.len().min(states.iter().map(|state| state.len()).min().unwrap_or(0));
        let whole = length - length % S::F64_LANES;
        let mut block = [numbers[0].value; MOST_LANES];
        let mut registers: [&[S::f64s]; MOST_LANES] = [&[]; MOST_LANES];
        for (registers, state) in registers.iter_mut().zip(states) {
            *registers = S::as_simd_f64s(&state[..whole]).0;
        }
        for (at, numbers) in numbers[..whole].chunks_exact_mut(S::F64_LANES).enumerate() {
            for (row, registers) in block.iter_mut().zip(&registers[..S::F64_LANES]) {
                *row = registers[at];
            }
            simd.transpose(&mut block[..S::F64_LANES]);
            for (number, &row) in numbers.iter_mut().zip(&block) {
                number.value = row;
            }
        }
        for (lane, state) in states.iter().enumerate() {
            for (number, &value) in numbers[whole..length].iter_mut().zip(&state[whole..length]) {
                number.lanes_mut()[lane] = value;
            }
        }
    }

    /// Each lane's numbers one after another, of as many lanes as `out` has room for.
    #[inline(always)]
    pub(super) fn put_lanes(numbers: &[Self], out: &mut [f64]) {
        let Some(simd) = numbers.first().map(|first| first.simd) else { return };
        let length = numbers.len();
        let whole = length - length % S::F64_LANES;
        let mut block = [numbers[0].value; MOST_LANES];
        for (at, numbers) in numbers[..whole].chunks_exact(S::F64_LANES).enumerate() {
            for (row, number) in block.iter_mut().zip(numbers) {
                *row = number.value;
            }
            simd.transpose(&mut block[..S::F64_LANES]);
            for (row, out) in block.iter().zip(out.chunks_exact_mut(length)) {
                S::as_mut_simd_f64s(&mut out[..whole]).0[at] = *row;
            }
        }
        for (lane, out) in out.chunks_exact_mut(length).enumerate() {
            for (value, number) in out[whole..].iter_mut().zip(&numbers[whole..]) {
                *value = number.lanes()[lane];
            }
        }
    }

    /// The same of as many numbers as `chosen` says, each by its place in `numbers`, of which number 0 is zero.
    #[inline(always)]
    pub(super) fn put_chosen(numbers: &[Self], chosen: &[u32], out: &mut [f64]) {
        let Some(zero) = numbers.first() else { return };
        let (simd, length) = (zero.simd, chosen.len());
        let whole = length - length % S::F64_LANES;
        let mut states: [&mut [S::f64s]; MOST_LANES] = Default::default();
        for (state, out) in states.iter_mut().zip(out.chunks_exact_mut(length)) {
            *state = S::as_mut_simd_f64s(&mut out[..whole]).0;
        }
        for (at, chosen) in chosen[..whole].chunks_exact(S::F64_LANES).enumerate() {
            let mut block = [zero.value; MOST_LANES];
            if chosen.iter().fold(0, |any, &at| any | at) != 0 {
                for lane in 0..S::F64_LANES {
                    block[lane] = numbers[chosen[lane] as usize].value;
                }
                simd.transpose(&mut block[..S::F64_LANES]);
            }
            for lane in 0..S::F64_LANES {
                if let Some(to) = states[lane].get_mut(at) {
                    *to = block[lane];
                }
            }
        }
        for (lane, out) in out.chunks_exact_mut(length).enumerate() {
            for (value, &at) in out[whole..].iter_mut().zip(&chosen[whole..]) {
                *value = numbers[at as usize].lanes()[lane];
            }
        }
    }
}

impl<S: Instructions, P: Precision> PartialEq for Lanes<S, P> {
    fn eq(&self, other: &Self) -> bool {
        self.lanes() == other.lanes()
    }
}

macro_rules! operator {
    ($operator:ident, $function:ident, $assigning:ident, $assign:ident) => {
        impl<S: Instructions, P: Precision> $operator for Lanes<S, P> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self::new(self.simd, P::$function(self.simd, self.value, other.value))
            }
        }

        impl<S: Instructions, P: Precision> $assigning for Lanes<S, P> {
            #[inline(always)]
            fn $assign(&mut self, other: Self) {
                self.value = P::$function(self.simd, self.value, other.value);
            }
        }
    };
}

operator!(Add, add, AddAssign, add_assign);
operator!(Sub, sub, SubAssign, sub_assign);
operator!(Mul, mul, MulAssign, mul_assign);
operator!(Div, div, DivAssign, div_assign);

impl<S: Instructions, P: Precision> Neg for Lanes<S, P> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(self.simd, P::negated(self.simd, self.value))
    }
}

impl<S: Instructions, P: Precision> Zero for Lanes<S, P> {
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }

    #[inline(always)]
    fn is_zero(&self) -> bool {
        self.lanes().iter().all(|x| x.widened() == 0.0)
    }
}

impl<S: Instructions, P: Precision> One for Lanes<S, P> {
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
}

impl<S: Instructions, P: Precision> Real for Lanes<S, P> {
    const LANES: usize = size_of::<P::Register<S>>() / size_of::<P>();

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self::splat(x)
    }

    #[inline(always)]
    fn constant(self, x: f64) -> Self {
        Self::new(self.simd, P::splat(self.simd, x))
    }

    type Parameter = P;

    #[inline(always)]
    fn parameter(x: f64) -> P {
        P::nearest(x)
    }

    #[inline(always)]
    fn everywhere(self, x: P) -> Self {
        self.constant(x.widened())
    }

    #[inline(always)]
    fn lane(self, index: usize) -> f64 {
        self.lanes()[index].widened()
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, P::mul_add(self.simd, self.value, b.value, c.value))
    }

    #[inline(always)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, P::minus_product(self.simd, b.value, c.value, self.value))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        self.constant(1.0) / self
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::new(self.simd, P::sqrt(self.simd, self.value))
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let s = self.simd;
        let rounder = self.constant(P::ROUNDER);
        let shifted = self.mul_add(self.constant(std::f64::consts::FRAC_2_PI), rounder);
        let (sine, cosine) = t::of_reduced::<P, _>(self, shifted - rounder);
        let (sine, cosine) = P::turned(s, shifted.value, sine.value, cosine.value);
        let (sine, cosine) = (Self::new(s, sine), Self::new(s, cosine));
        // Rare: each lane that the reduction is not good for, by itself, so that no lane changes another's bits.
        if !P::all_within(s, self.value, P::LARGEST) {
            // Copies, or sine and cosine would live in memory from the start.
            let (mut sine, mut cosine) = (sine, cosine);
            t::far(self.lanes(), sine.lanes_mut(), cosine.lanes_mut());
            return (sine, cosine);
        }
        (sine, cosine)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self::new(self.simd, P::absolute(self.simd, self.value))
    }

    #[inline(always)]
    fn worst(self, other: Self) -> Self {
        Self::new(self.simd, P::worst(self.simd, self.value, other.value))
    }

    #[inline(always)]
    fn one_if_zero(self) -> Self {
        Self::new(self.simd, P::one_if_zero(self.simd, self.value))
    }

    #[inline(always)]
    fn epsilon() -> Self {
        Self::splat(P::EPSILON)
    }
}
