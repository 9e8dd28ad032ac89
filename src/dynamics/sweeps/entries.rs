//! The buffer of entries from which M and M^-1 of states in lanes are gathered for the caller.

use crate::scalar::{ColumnsOf, Real};

/// Entries of a symmetric matrix.
#[derive(Debug, Clone)]
pub(crate) struct Entries<T: Real, C: ColumnsOf<T>> {
    /// In lanes what the entries are chosen from, behind one zero: those of one triangle that are not zero by
    /// structure, or tiles that hold them. Of one state none, for it is written where it belongs.
    pub numbers: Vec<C::Entry>,
    /// In lanes: which of those stands at each place of the matrix.
    chosen: Vec<u32>,
    pub(in crate::dynamics) is_made: bool,
    /// True if there are entries that nothing is written to.
    has_gaps: bool,
    /// Zero where every entry is finite, else NaN; where they were looked at.
    pub(in crate::dynamics) fault: C,
}

impl<T: Real, C: ColumnsOf<T>> Entries<T, C> {
    /// None yet.
    pub(in crate::dynamics) fn new() -> Self {
        Self { numbers: Vec::new(), chosen: Vec::new(), is_made: false, has_gaps: false, fault: C::zero() }
    }

    /// Makes them, zeros: as many as `choices` says, and what is chosen from them.
    pub(in crate::dynamics) fn make(&mut self, has_gaps: bool, choices: impl FnOnce() -> (u32, Vec<u32>)) {
        (self.is_made, self.has_gaps) = (true, has_gaps);
        if T::LANES > 1 {
            let (count, chosen) = choices();
            (self.numbers, self.chosen) = (vec![C::kept(T::zero()); count as usize], chosen);
        }
    }

    /// Before a state: none was looked at, and of one state those are zero in `out` that nothing is written to.
    #[inline(always)]
    pub(in crate::dynamics) fn begin(&mut self, out: &mut [C::Entry]) {
        self.fault = self.zero();
        if T::LANES == 1 && self.has_gaps {
            out.fill(C::kept(T::zero()));
        }
    }

    /// Zero of their kind: any other way asks the processor each time.
    #[inline(always)]
    pub(in crate::dynamics) fn zero(&self) -> C {
        self.fault.constant(0.0)
    }

    /// In lanes: which of the numbers stands at each place of the matrix.
    #[inline(always)]
    pub fn chosen(&self) -> &[u32] {
        &self.chosen
    }

    /// Zero where every entry is finite, else NaN; where they were looked at.
    #[inline(always)]
    pub fn fault(&self) -> T {
        let mut fault = self.fault.column(0);
        for column in 1..C::COLUMNS {
            fault += self.fault.column(column);
        }
        fault
    }
}
