//! Columns of M^-1 of one state, or of one state per lane, in blocks.

use super::entries::Entries;
use super::model::SweepModel;
use super::tiles::Tiles;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};

/// Vectors of adjacent columns, one column per lane of `C`.
pub(super) type Block<C> = [C; 6];

/// Scratch of M^-1. A block begins at a position on the path from the base that is a multiple of its width.
#[derive(Debug)]
pub(crate) struct InverseColumns<T: Real, C: ColumnsOf<T>> {
    /// In slots, outward: c of the innovation D^-1/2 of every joint on the path; zero beyond the path.
    pub(super) slots: Vec<Vec<Block<C>>>,
    /// Scratch of the product of the factors.
    pub(super) tiles: Tiles<T, C>,
}

impl<T: Real, C: ColumnsOf<T>> InverseColumns<T, C> {
    /// Empty: allocated when M^-1 is first computed.
    pub fn new() -> Self {
        Self { slots: Vec::new(), tiles: Tiles::new() }
    }

    /// Allocates the columns if necessary. Returns the buffer of the entries of M^-1 in lanes, or None for a scene
    /// whose factors are not [multiplied](super::inverse_product).
    #[inline(always)]
    pub fn prepare(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) -> Option<&mut Entries<T, C>> {
        if !sweeps.is_shallow {
            return None;
        }
        if self.slots.is_empty() {
            self.make(model, sweeps);
        }
        Some(&mut self.tiles.entries)
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        let nan = [C::from_f64(f64::NAN); 6];
        self.slots = vec![vec![nan; sweeps.longest_path.div_ceil(C::COLUMNS)]; sweeps.swept_slots.outward];
        self.tiles.prepare(model, sweeps);
    }
}

/// Writes the vector of one column to its lane.
#[inline(always)]
pub(super) fn set_column<T: Real, C: ColumnsOf<T>>(block: &mut Block<C>, lane: usize, x: &[T; 6]) {
    for (block, &x) in block.iter_mut().zip(x) {
        block.set_column(lane, x);
    }
}
