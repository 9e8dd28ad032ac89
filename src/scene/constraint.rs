//! Connections as the sweeps read them: frames on bodies and coordinates of joints, by index.

use crate::kinematics::pair::{Pair, pair_rows};
use crate::kinematics::{Frame, placement};
use crate::model::Model;
use nalgebra::Vector6;
use std::ops::Range;

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
    /// The bodies that its forces run through on their way to the base, the outermost first.
    pub path: Vec<usize>,
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
                let place = placement(model, q, d).inverse().compose(&placement(model, q, c));
                let rows = pair_rows(*pair, &place, &Vector6::zeros())?;
                out.copy_from_slice(&rows.error[..rows.count]);
            }
            Tie::Coordinates { first, second, multiplier, offset } => {
                out[0] = q[first.q] - second.map_or(0.0, |second| multiplier * q[second.q]) - offset;
            }
        }
        Some(())
    }
}

/// The connections of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Constraints {
    pub all: Vec<Constraint>,
    /// The number of their rows.
    pub rows: usize,
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
