//! Several columns of one state side by side.

use super::{Fused, Instructions, Lanes, Real};

/// A scalar that holds several numbers of kind `T` side by side: the columns of a matrix, for one state.
pub trait ColumnsOf<T: Real>: Real {
    /// How many.
    const COLUMNS: usize;

    /// The same number in every column; `self` says only of which kind.
    #[must_use]
    fn spread(self, x: T) -> Self;

    /// The number in one column.
    fn column(&self, index: usize) -> T;

    /// Writes the number in one column.
    fn set_column(&mut self, index: usize, x: T);
}

/// One column at a time: what a scalar does whose lanes are states.
impl<T: Real> ColumnsOf<T> for T {
    const COLUMNS: usize = 1;

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

/// As many columns as a register holds.
impl<S: Instructions> ColumnsOf<Fused> for Lanes<S> {
    const COLUMNS: usize = <Self as Real>::LANES;

    #[inline(always)]
    fn spread(self, x: Fused) -> Self {
        self.constant(x.0)
    }

    #[inline(always)]
    fn column(&self, index: usize) -> Fused {
        Fused(self.lanes()[index])
    }

    #[inline(always)]
    fn set_column(&mut self, index: usize, x: Fused) {
        self.lanes_mut()[index] = x.0;
    }
}
