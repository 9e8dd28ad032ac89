//! The parts of the Rust code that are the same for every robot.

/// Words that no crate can be called by.
#[rustfmt::skip]
pub(super) const RESERVED: [&str; 57] = [
    "Self", "_", "abstract", "alloc", "as", "async", "await", "become", "box", "break", "const", "continue",
    "core", "crate", "do", "dyn", "else", "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl",
    "in", "let", "loop", "macro", "match", "mod", "move", "mut", "override", "priv", "proc_macro", "pub", "ref",
    "return", "self", "static", "std", "struct", "super", "test", "trait", "true", "try", "type", "typeof",
    "unsafe", "unsized", "use", "virtual", "where", "while",
];

pub(super) const LIBRARY: &str = "//! The dynamics of one robot: straight lines of operations that need `core` alone. Written by phipsi; do not edit.

#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = \"std\")]
extern crate std;

mod dynamics;
mod lanes;
#[cfg(feature = \"std\")]
mod numbers;

pub use dynamics::*;
pub use lanes::*;
";

/// The trait that all functions are generic over.
pub(super) const NUMBER: &str = "
use core::ops::{Add, Div, Mul, Neg, Sub};

/// What the functions compute with: one number, or several of as many states.
///
/// f64 and f32 are numbers by the standard library (numbers.rs). Without it, a type of your own is one, whose sines come from libm for instance.
pub trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self> {
    /// A constant.
    #[must_use]
    fn constant(x: f64) -> Self;

    /// The square root.
    #[must_use]
    fn sqrt(self) -> Self;

    /// Sine and cosine, of radians.
    #[must_use]
    fn sin_cos(self) -> (Self, Self);

    /// The absolute value.
    #[must_use]
    fn abs(self) -> Self;

    /// The smaller of the two, NaN where either is.
    #[must_use]
    fn smaller(self, other: Self) -> Self;

    /// One where it is zero, else zero.
    #[must_use]
    fn one_if_zero(self) -> Self;

    /// self b + c, rounded once where the processor can.
    #[must_use]
    #[inline(always)]
    fn product_sum(self, b: Self, c: Self) -> Self {
        self * b + c
    }

    /// c - self b, rounded once where the processor can.
    #[must_use]
    #[inline(always)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        c - self * b
    }
}
";

/// f64 and f32 by the standard library.
pub(super) const NUMBERS: &str = "// Written by phipsi; do not edit. f64 and f32 as numbers, by the standard library.

use super::Number;

/// Whether a product with its sum is one instruction.
const IS_FUSED: bool = cfg!(any(target_feature = \"fma\", target_arch = \"aarch64\"));

macro_rules! number {
    ($number:ident) => {
        impl Number for $number {
            #[inline(always)]
            #[allow(clippy::cast_possible_truncation)]
            fn constant(x: f64) -> Self {
                x as $number
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                $number::sqrt(self)
            }

            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                $number::sin_cos(self)
            }

            #[inline(always)]
            fn abs(self) -> Self {
                $number::abs(self)
            }

            #[inline(always)]
            fn smaller(self, other: Self) -> Self {
                if self.is_nan() || self < other {
                    self
                } else {
                    other
                }
            }

            #[inline(always)]
            fn one_if_zero(self) -> Self {
                if self == 0.0 {
                    1.0
                } else {
                    0.0
                }
            }

            #[inline(always)]
            fn product_sum(self, b: Self, c: Self) -> Self {
                if IS_FUSED {
                    self.mul_add(b, c)
                } else {
                    self * b + c
                }
            }

            #[inline(always)]
            fn minus_product(self, b: Self, c: Self) -> Self {
                if IS_FUSED {
                    (-self).mul_add(b, c)
                } else {
                    c - self * b
                }
            }
        }
    };
}

number!(f64);
number!(f32);
";

/// Lanes of scalars.
pub(super) const LANES: &str =
    "// Written by phipsi; do not edit. Many states at once, in arrays that the compiler keeps in vector registers.

use super::Number;
use core::array::from_fn;
use core::ops::{Add, Div, Mul, Neg, Sub};

/// One number of each of N states.
///
/// N as the registers of the processor hold, or twice that: with AVX2 4 or 8 of f64.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lanes<T, const N: usize>(pub [T; N]);

/// What one lane holds.
pub trait Lane: Copy {
    /// Whether near_sin_cos is good for it.
    fn is_near(self) -> bool;

    /// Sine and cosine without a branch, which the compiler does for several at once.
    fn near_sin_cos(self) -> (Self, Self);
}

macro_rules! operator {
    ($operator:ident, $operate:ident, $sign:tt) => {
        impl<T: Copy + $operator<Output = T>, const N: usize> $operator for Lanes<T, N> {
            type Output = Self;

            #[inline]
            fn $operate(self, other: Self) -> Self {
                Lanes(from_fn(|i| self.0[i] $sign other.0[i]))
            }
        }
    };
}

operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

impl<T: Copy + Neg<Output = T>, const N: usize> Neg for Lanes<T, N> {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Lanes(from_fn(|i| -self.0[i]))
    }
}

impl<T: Number + Lane, const N: usize> Number for Lanes<T, N> {
    #[inline]
    fn constant(x: f64) -> Self {
        Lanes([T::constant(x); N])
    }

    #[inline]
    fn sqrt(self) -> Self {
        Lanes(from_fn(|i| self.0[i].sqrt()))
    }

    /// A function of its own: its loop over the lanes is one over registers.
    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        let (mut sine, mut cosine) = (self, self);
        for i in 0..N {
            (sine.0[i], cosine.0[i]) = self.0[i].near_sin_cos();
        }
        for i in 0..N {
            if !self.0[i].is_near() {
                (sine.0[i], cosine.0[i]) = Number::sin_cos(self.0[i]);
            }
        }
        (sine, cosine)
    }

    #[inline]
    fn abs(self) -> Self {
        Lanes(from_fn(|i| self.0[i].abs()))
    }

    #[inline]
    fn smaller(self, other: Self) -> Self {
        Lanes(from_fn(|i| self.0[i].smaller(other.0[i])))
    }

    #[inline]
    fn one_if_zero(self) -> Self {
        Lanes(from_fn(|i| self.0[i].one_if_zero()))
    }

    #[inline]
    fn product_sum(self, b: Self, c: Self) -> Self {
        Lanes(from_fn(|i| self.0[i].product_sum(b.0[i], c.0[i])))
    }

    #[inline]
    fn minus_product(self, b: Self, c: Self) -> Self {
        Lanes(from_fn(|i| self.0[i].minus_product(b.0[i], c.0[i])))
    }
}

/// Lanes beyond the last state repeat it.
#[inline]
fn gather<T: Copy, const WIDTH: usize, const N: usize>(states: &[[T; WIDTH]]) -> [Lanes<T, N>; WIDTH] {
    from_fn(|i| Lanes(from_fn(|lane| states[lane.min(states.len() - 1)][i])))
}

#[inline]
fn scatter<T: Copy, const WIDTH: usize, const N: usize>(found: &[Lanes<T, N>; WIDTH], states: &mut [[T; WIDTH]]) {
    for (lane, state) in states.iter_mut().enumerate() {
        for (to, from) in state.iter_mut().zip(found) {
            *to = from.0[lane];
        }
    }
}
";

/// The functions that all tests use.
pub(super) const TEST: &str = "//! Written by phipsi; do not edit. One state of the robot, and what phipsi's own methods give there.

#![allow(non_snake_case, clippy::approx_constant, clippy::cast_possible_truncation, clippy::similar_names, clippy::too_many_lines, clippy::type_complexity, clippy::unreadable_literal)]

/// Without optimisation every number has room of its own on the stack.
fn on_a_large_stack(work: fn()) {
    std::thread::Builder::new().stack_size(256 << 20).spawn(work).unwrap().join().unwrap();
}

/// The bounds leave room for the condition of the mass matrix.
fn check(what: &str, found: &[f64], expected: &[f64], bound: f64) {
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= bound, \"{what}[{i}]: found {found}, expected {expected}\");
    }
}

fn single<const WIDTH: usize>(values: &[f64; WIDTH]) -> [f32; WIDTH] {
    values.map(|x| x as f32)
}

#[allow(dead_code)]
fn smaller<const WIDTH: usize>(values: [f64; WIDTH]) -> [[f64; WIDTH]; 11] {
    core::array::from_fn(|i| values.map(|x| x * (1.0 - 0.05 * i as f64)))
}
";
