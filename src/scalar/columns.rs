//! Scalars that hold several columns of one state.

use super::Real;
use std::fmt::Debug;

/// A scalar that holds several values of type `T`: columns of a matrix, for one state.
pub trait ColumnsOf<T: Real>: Real {
    /// Number of columns.
    const COLUMNS: usize;

    /// Type of one value in a contiguous array.
    type Entry: Copy + Debug;

    /// Converts a value to an entry.
    fn kept(x: T) -> Self::Entry;

    /// Converts an entry to a value.
    fn taken(entry: Self::Entry) -> T;

    /// Stores all columns into `to`, one after another.
    fn store(&self, to: &mut [Self::Entry]);

    /// Loads all columns from `from`; `self` determines only the type.
    #[must_use]
    fn load(self, from: &[Self::Entry]) -> Self;

    /// Transposes a square block: entry j of value i becomes entry i of value j.
    fn transpose(block: &mut [Self]);

    /// The same value in every column; `self` determines only the type.
    #[must_use]
    fn spread(self, x: T) -> Self;

    /// The value in one column.
    fn column(&self, index: usize) -> T;

    /// Sets the value in one column.
    fn set_column(&mut self, index: usize, x: T);
}

/// One column at a time, for scalars whose lanes are states.
impl<T: Real> ColumnsOf<T> for T {
    const COLUMNS: usize = 1;

    type Entry = T;

    #[inline(always)]
    fn kept(x: T) -> T {
        x
    }

    #[inline(always)]
    fn taken(entry: T) -> T {
        entry
    }

    #[inline(always)]
    fn store(&self, to: &mut [T]) {
        to[0] = *self;
    }

    #[inline(always)]
    fn load(self, from: &[T]) -> Self {
        from[0]
    }

    #[inline(always)]
    fn transpose(_block: &mut [Self]) {}

    #[inline(always)]
    fn spread(self, x: T) -> Self {
        x
    }

    #[inline(always)]
    fn column(&self, _index: usize) -> T {
        *self
    }

    #[inline(always)]
    fn set_column(&mut self, _index: usize, x: T) {
        *self = x;
    }
}
