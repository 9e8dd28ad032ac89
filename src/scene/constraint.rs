//! Connections as the sweeps read them: frames on bodies and coordinates of joints, by index.

use crate::kinematics::Frame;
use crate::kinematics::pair::{Pair, pair_rows, place_between};
use crate::kinematics::relative::placements_from;
use crate::model::Model;
use nalgebra::Vector6;
use std::ops::Range;
use std::sync::OnceLock;

/// The coordinate of a joint of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coordinate {
    /// Its index in q.
    pub q: usize,
    /// Its index in qd.
    pub v: usize,
    /// The body that it moves.
    pub body: usize,
}

/// What is tied, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Tie {
    /// Two frames, C on the connection's link and D on the other.
    Frames { pair: Pair, frames: [Frame<f64>; 2] },
    /// first = multiplier * second + offset; the offset alone without a second.
    Coordinates { first: Coordinate, second: Option<Coordinate>, multiplier: f64, offset: f64 },
}

impl Tie {
    /// The bodies at its ends; none on the base.
    pub fn bodies(&self) -> [Option<usize>; 2] {
        match self {
            Self::Frames { frames: [first, second], .. } => [first.body, second.body],
            Self::Coordinates { first, second, .. } => [Some(first.body), second.map(|second| second.body)],
        }
    }
}

/// One connection.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Constraint {
    /// Its name.
    pub name: String,
    pub tie: Tie,
    /// Its first row among all.
    pub first_row: usize,
    /// The bodies between its ends and the base, the outermost first: the innovations of its forces are nonzero on all of them.
    pub path: Vec<usize>,
    /// The bodies of the loop: those of the path that only one of its ends is on. The joints of the others move both ends alike, so that J is
    /// zero there.
    pub branches: Vec<usize>,
    /// The body where the two branches meet, against which both ends are placed; none: the base.
    pub junction: Option<usize>,
}

impl Constraint {
    /// Its rows among all.
    pub fn rows(&self) -> Range<usize> {
        let count = match self.tie {
            Tie::Frames { pair, .. } => pair.rows(),
            Tie::Coordinates { .. } => 1,
        };
        self.first_row..self.first_row + count
    }

    /// How far its rows are from holding at `q`, into `out`, one number a row, m or rad; none where a rod has no direction.
    pub fn error(&self, model: &Model<f64>, q: &[f64], out: &mut [f64]) -> Option<()> {
        match &self.tie {
            Tie::Frames { pair, frames: [c, d] } => {
                let [c, d] = placements_from(model, q, [c, d], self.junction);
                let rows = pair_rows(*pair, &place_between(&c, &d), &Vector6::zeros())?;
                out.copy_from_slice(&rows.error[..rows.count]);
            }
            Tie::Coordinates { first, second, multiplier, offset } => {
                out[0] = q[first.q] - second.map_or(0.0, |second| multiplier * q[second.q]) - offset;
            }
        }
        Some(())
    }
}

/// Rows that depend on each other but for less than the tolerance: a linkage that is drawn with few digits.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Near {
    /// The row that has most of the combination.
    pub row: usize,
    /// Its singular value, an angle in rad or a length over the reach of the loop.
    pub value: f64,
    /// Where that was found: a configuration that meets the connections of the row.
    pub q: Vec<f64>,
}

/// How many rows of each group that shares joints are independent, away from singular positions.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Mobility {
    /// None where no closed position was found.
    pub ranks: Vec<Option<usize>>,
    /// The largest combination of rows that counts as dependent though it is no rounding.
    pub near: Option<Near>,
}

/// The connections of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Constraints {
    pub all: Vec<Constraint>,
    /// The number of their rows.
    pub rows: usize,
    /// Rows that depend on each other to within this angle, or length over the reach of the loop, count as dependent; zero: to within rounding.
    pub tolerance: f64,
    /// The neutral configuration, where closed positions are looked for.
    pub neutral: Vec<f64>,
    /// Found when it is first needed.
    pub mobility: OnceLock<Mobility>,
    /// Set when the user was warned of a linkage that is drawn with few digits.
    pub is_warned: OnceLock<()>,
    /// Set when the axes of the loops were looked at.
    pub is_looked_at: OnceLock<()>,
}

impl Constraints {
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The name of the connection that a row belongs to.
    pub fn name_of(&self, row: usize) -> &str {
        self.all.iter().find(|constraint| constraint.rows().contains(&row)).map_or("", |constraint| &constraint.name)
    }
}
