//! The buffer of entries from which M and M^-1 of states in lanes are gathered for the caller.

use crate::scalar::{ColumnsOf, Real};

/// Entries of a symmetric matrix.
#[derive(Debug, Clone)]
pub(crate) struct Entries<T: Real, C: ColumnsOf<T>> {
    /// In lanes: one zero, followed by the entries of one triangle that are not zero by structure, or by the tiles that
    /// contain them. Empty for one state, whose entries are written directly to the result.
    pub numbers: Vec<C::Entry>,
    /// In lanes: the index in `numbers` of each entry of the matrix.
    chosen: Vec<u32>,
    pub(in crate::dynamics) is_made: bool,
    /// True if the matrix has entries that are never written.
    has_gaps: bool,
    /// Zero if every checked entry is finite, otherwise NaN.
    pub(in crate::dynamics) fault: C,
}

impl<T: Real, C: ColumnsOf<T>> Entries<T, C> {
    /// An empty buffer.
    pub(in crate::dynamics) fn new() -> Self {
        Self { numbers: Vec::new(), chosen: Vec::new(), is_made: false, has_gaps: false, fault: C::zero() }
    }

    /// Allocates the buffer with zeros, from the number of values and the indices that `choices` returns.
    pub(in crate::dynamics) fn make(&mut self, has_gaps: bool, choices: impl FnOnce() -> (u32, Vec<u32>)) {
        (self.is_made, self.has_gaps) = (true, has_gaps);
        if T::LANES > 1 {
            let (count, chosen) = choices();
            (self.numbers, self.chosen) = (vec![C::kept(T::zero()); count as usize], chosen);
        }
    }

    /// Prepares for a state: resets the check, and for one state sets the entries of `out` to zero that are never
    /// written.
    #[inline(always)]
    pub(in crate::dynamics) fn begin(&mut self, out: &mut [C::Entry]) {
        self.fault = self.zero();
        if T::LANES == 1 && self.has_gaps {
            out.fill(C::kept(T::zero()));
        }
    }

    /// A zero of this type; other ways to create one query the processor's features at each call.
    #[inline(always)]
    pub(in crate::dynamics) fn zero(&self) -> C {
        self.fault.constant(0.0)
    }

    /// In lanes: the index in the buffer of each entry of the matrix.
    #[inline(always)]
    pub fn chosen(&self) -> &[u32] {
        &self.chosen
    }

    /// Zero if every checked entry is finite, otherwise NaN.
    #[inline(always)]
    pub fn fault(&self) -> T {
        let mut fault = self.fault.column(0);
        for column in 1..C::COLUMNS {
            fault += self.fault.column(column);
        }
        fault
    }
}
