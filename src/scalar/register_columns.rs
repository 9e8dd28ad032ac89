//! Columns of a matrix of one state, one per lane of a register.

use super::{ColumnsOf, Fused, Instructions, Lanes, MOST_LANES, Real};
use pulp::bytemuck::{cast_slice, cast_slice_mut};

/// One column per lane of a register.
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
