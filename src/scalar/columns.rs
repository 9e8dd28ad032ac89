//! Several columns of one state side by side.

use super::transposed::MOST_LANES;
use super::{Fused, Instructions, Lanes, Real};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use std::fmt::Debug;

/// A scalar that holds several numbers of kind `T` side by side: the columns of a matrix, for one state.
pub trait ColumnsOf<T: Real>: Real {
    /// How many.
    const COLUMNS: usize;

    /// One number in memory, where many are kept in order.
    type Entry: Copy + Debug;

    /// A number as it is kept.
    fn kept(x: T) -> Self::Entry;

    /// A number that was kept.
    fn taken(entry: Self::Entry) -> T;

    /// All columns, one after another, into as many entries.
    fn store(&self, to: &mut [Self::Entry]);

    /// As many entries as there are columns; `self` says only of which kind.
    #[must_use]
    fn load(self, from: &[Self::Entry]) -> Self;

    /// As many as there are columns: what was number j of the one at i becomes number i of the one at j.
    fn transpose(block: &mut [Self]);

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

/// As many columns as a register holds.
impl<S: Instructions> ColumnsOf<Fused> for Lanes<S> {
    const COLUMNS: usize = <Self as Real>::LANES;

    type Entry = f64;

    #[inline(always)]
    fn kept(x: Fused) -> f64 {
        x.0
    }

    #[inline(always)]
    fn taken(entry: f64) -> Fused {
        Fused(entry)
    }

    #[inline(always)]
    fn store(&self, to: &mut [f64]) {
        cast_slice_mut(&mut to[..<Self as Real>::LANES])[0] = self.value;
    }

    #[inline(always)]
    fn load(mut self, from: &[f64]) -> Self {
        self.value = cast_slice(&from[..<Self as Real>::LANES])[0];
        self
    }

    #[inline(always)]
    fn transpose(block: &mut [Self]) {
        let Some(&Self { simd, value, .. }) = block.first() else { return };
        let mut registers = [value; MOST_LANES];
        for lane in 0..<Self as Real>::LANES {
            registers[lane] = block[lane].value;
        }
        simd.transpose(&mut registers[..<Self as Real>::LANES]);
        for lane in 0..<Self as Real>::LANES {
            block[lane].value = registers[lane];
        }
    }

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
