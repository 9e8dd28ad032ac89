//! The constants and array indices that differ between the calls of a part.

/// A constant or an index: the value if it is the same for all calls, otherwise a row of the table.
pub(in crate::codegen) enum Entry<T> {
    Same(T),
    Row(usize),
}

/// One row for each value that differs, with one entry per call.
#[derive(Default)]
pub(in crate::codegen) struct Tables {
    constants: Vec<Vec<u64>>,
    places: Vec<Vec<usize>>,
}

/// The value if all calls have the same one, otherwise its row in the table.
fn entry<T: Copy + PartialEq>(rows: &mut Vec<Vec<T>>, of_calls: &[T]) -> Entry<T> {
    if of_calls.iter().all(|value| *value == of_calls[0]) {
        return Entry::Same(of_calls[0]);
    }
    Entry::Row(rows.iter().position(|row| row == of_calls).unwrap_or_else(|| {
        rows.push(of_calls.to_vec());
        rows.len() - 1
    }))
}

/// The entries call by call.
fn by_calls<T: Copy>(rows: &[Vec<T>]) -> Vec<Vec<T>> {
    let calls = rows.first().map_or(0, Vec::len);
    (0..calls).map(|call| rows.iter().map(|row| row[call]).collect()).collect()
}

impl Tables {
    pub fn place(&mut self, of_calls: &[usize]) -> Entry<usize> {
        entry(&mut self.places, of_calls)
    }

    /// A constant, by its bits.
    pub fn constant(&mut self, of_calls: &[u64]) -> Entry<u64> {
        entry(&mut self.constants, of_calls)
    }

    /// Number of entries of the table of places.
    pub fn places(&self) -> usize {
        self.places.len()
    }

    /// The tables that are not empty: the name of each, and its number of values per call.
    pub fn widths(&self) -> impl Iterator<Item = (&'static str, usize)> {
        [("c", self.constants.len()), ("at", self.places.len())].into_iter().filter(|&(_, width)| width > 0)
    }

    /// Constants for each call.
    pub fn constants_by_calls(&self) -> Vec<Vec<f64>> {
        by_calls(&self.constants).into_iter().map(|bits| bits.into_iter().map(f64::from_bits).collect()).collect()
    }

    /// Indices for each call.
    pub fn places_by_calls(&self) -> Vec<Vec<usize>> {
        by_calls(&self.places)
    }
}
