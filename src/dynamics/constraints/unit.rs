//! A unit force along one row.

use nalgebra::Vector6;

/// J* of one row: the forces on bodies, each in its body's frame, and the torques at joints of a unit force along it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct UnitRow {
    pub forces: [Option<(usize, Vector6<f64>)>; 2],
    /// Sizes of the terms that their moments are the sum of.
    pub moments: [f64; 2],
    pub torques: [Option<(usize, f64)>; 2],
}
