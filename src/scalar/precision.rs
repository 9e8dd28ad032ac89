//! The types of values that a state can have: f64 and f32.

use super::trigonometry::Circle;
use std::borrow::Cow;
use std::fmt::Debug;

/// A type of values: f64 or f32.
pub trait Precision: Circle + Default + PartialEq + Debug + Send + Sync {
    /// Name of the type: "float64", "float32".
    const NAME: &'static str;

    /// True if the square-root form is compiled for it.
    const RARE_KERNELS: bool;

    /// The spacing of values at 1.
    const EPSILON: f64;

    /// The value nearest to `x`; infinite beyond the largest.
    fn nearest(x: f64) -> Self;

    /// The value as f64.
    fn widened(self) -> f64;

    /// All `numbers` as f64; f64 values are not copied.
    fn all_widened(numbers: &[Self]) -> Cow<'_, [f64]>;

    /// Destination for f64 results of `numbers`: in place for f64, else `room`, resized to the same length.
    fn in_f64<'a>(numbers: &'a mut [Self], room: &'a mut Vec<f64>) -> &'a mut [f64];

    /// Sine and cosine by the standard library.
    fn exact_sin_cos(self) -> (Self, Self);
}

impl Precision for f64 {
    const NAME: &'static str = "float64";
    const RARE_KERNELS: bool = true;
    const EPSILON: f64 = Self::EPSILON;

    #[inline(always)]
    fn nearest(x: f64) -> Self {
        x
    }

    #[inline(always)]
    fn widened(self) -> f64 {
        self
    }

    fn all_widened(numbers: &[Self]) -> Cow<'_, [f64]> {
        Cow::Borrowed(numbers)
    }

    fn in_f64<'a>(numbers: &'a mut [Self], _room: &'a mut Vec<f64>) -> &'a mut [f64] {
        numbers
    }

    #[inline(always)]
    fn exact_sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }
}

impl Precision for f32 {
    const NAME: &'static str = "float32";
    const RARE_KERNELS: bool = false;
    const EPSILON: f64 = Self::EPSILON as f64;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // rounding is the purpose
    fn nearest(x: f64) -> Self {
        x as Self
    }

    #[inline(always)]
    fn widened(self) -> f64 {
        f64::from(self)
    }

    fn all_widened(numbers: &[Self]) -> Cow<'_, [f64]> {
        numbers.iter().map(|&x| f64::from(x)).collect()
    }

    fn in_f64<'a>(numbers: &'a mut [Self], room: &'a mut Vec<f64>) -> &'a mut [f64] {
        room.clear();
        room.resize(numbers.len(), f64::NAN);
        room
    }

    #[inline(always)]
    fn exact_sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }
}
