//! Connections in the form that the sweeps read: frames on bodies and joint coordinates, by index.

use super::polynomial::Polynomial;
use crate::kinematics::Frame;
use crate::kinematics::pair::{Pair, pair_rows, place_between};
use crate::kinematics::relative::placements_from;
use crate::model::Model;
use crate::scalar::Real;
use nalgebra::Vector6;
use std::ops::Range;
use std::sync::OnceLock;

/// The coordinate of a joint with one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coordinate {
    /// Its index in q.
    pub q: usize,
    /// Its index in qd.
    pub v: usize,
    /// The body that the joint moves.
    pub body: usize,
}

/// The constrained quantities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Tie {
    /// Two frames: C on the first link of the connection and D on the other.
    Frames { pair: Pair, frames: [Frame<f64>; 2] },
    /// Coordinates of joints.
    Coordinates(Coupled),
}

/// Coupled coordinates x and y: x = P(y); x = P(0) if there is no second coordinate.
///
/// ```text
/// error x - P(y),    J = (1, -P'(y)),    gamma = -P''(y) y'^2
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coupled {
    /// x.
    pub first: Coordinate,
    /// y.
    pub second: Option<Coordinate>,
    /// P.
    pub polynomial: Polynomial,
}

impl Coupled {
    /// x - P(y).
    #[inline(always)]
    pub fn error<T: Real>(&self, q: &[T]) -> T {
        let x = q[self.first.q];
        let y = match self.second {
            Some(second) => q[second.q],
            None => x.constant(0.0),
        };
        x - self.polynomial.derivative(0, y)
    }

    /// Adds the torques of a unit force times r: r and -P'(y) r.
    #[inline(always)]
    pub fn add_torques<T: Real>(&self, q: &[T], r: T, out: &mut [T]) {
        out[self.first.v] += r;
        if let Some(Coordinate { q: at, v, .. }) = self.second {
            out[v] = out[v].minus_product(r, self.polynomial.derivative(1, q[at]));
        }
    }

    /// The index of y' and P''(y), unless P is linear.
    #[inline(always)]
    pub fn curvature<T: Real>(&self, q: &[T]) -> Option<(usize, T)> {
        let Coordinate { q: at, v, .. } = self.second.filter(|_| !self.polynomial.is_below_degree(2))?;
        Some((v, self.polynomial.derivative(2, q[at])))
    }

    /// Adds the gradients of r (x'' - P'(y) y'' - P''(y) y'^2) by (q, qd) to `by_q` and `by_qd`.
    #[inline(always)]
    pub fn add_acceleration_gradient<T: Real>(
        &self,
        (q, qd, qdd): (&[T], &[T], &[T]),
        r: T,
        [by_q, by_qd]: [&mut [T]; 2],
    ) {
        let (Some((v, second)), Some(Coordinate { q: at, .. })) = (self.curvature(q), self.second) else { return };
        let (third, speed) = (self.polynomial.derivative(3, q[at]), qd[v]);
        by_q[v] = by_q[v].minus_product(r, second.mul_add(qdd[v], third * speed * speed));
        by_qd[v] = by_qd[v].minus_product(r, (second + second) * speed);
    }
}

impl Tie {
    /// The bodies at the two ends; `None` for the base.
    pub fn bodies(&self) -> [Option<usize>; 2] {
        match self {
            Self::Frames { frames: [first, second], .. } => [first.body, second.body],
            Self::Coordinates(Coupled { first, second, .. }) => [Some(first.body), second.map(|second| second.body)],
        }
    }
}

/// One connection.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Constraint {
    /// Its name.
    pub name: String,
    pub tie: Tie,
    /// Its first row among the rows of all connections.
    pub first_row: usize,
    /// The bodies between its ends and the base, outermost first. Its constraint forces have nonzero innovations on
    /// these.
    pub path: Vec<usize>,
    /// The bodies of the loop: the part of `path` that belongs to one end only. Joints on the common part move both
    /// ends rigidly together, so that J is zero for them.
    pub branches: Vec<usize>,
    /// The body where the two branches meet, in whose frame the poses of both ends are expressed; `None` for the base.
    pub junction: Option<usize>,
}

impl Constraint {
    /// The names of its rows.
    pub fn row_names(&self) -> &'static [&'static str] {
        match self.tie {
            Tie::Frames { pair, .. } => pair.row_names(),
            Tie::Coordinates(_) => &["coordinate"],
        }
    }

    /// Its rows among the rows of all connections.
    pub fn rows(&self) -> Range<usize> {
        self.first_row..self.first_row + self.row_names().len()
    }

    /// The degrees of freedom that move its rows: J is zero in the columns of all others.
    pub fn columns<T: Real>(&self, model: &Model<T>) -> Vec<usize> {
        if let Tie::Coordinates(Coupled { first, second, .. }) = &self.tie {
            return [Some(first), second.as_ref()].into_iter().flatten().map(|of| of.v).collect();
        }
        let stages = self.branches.iter().map(|&k| &model.system.stages[k]);
        stages.flat_map(|stage| stage.first_row..stage.first_row + stage.rows.count()).collect()
    }

    /// Writes the constraint error at `q` to `out`, one entry per row, m or rad; `None` for a rod of zero length, whose
    /// direction is undefined.
    pub fn error(&self, model: &Model<f64>, q: &[f64], out: &mut [f64]) -> Option<()> {
        match &self.tie {
            Tie::Frames { pair, frames: [c, d] } => {
                let [c, d] = placements_from(model, q, [c, d], self.junction);
                let rows = pair_rows(*pair, &place_between(&c, &d), &Vector6::zeros())?;
                out.copy_from_slice(&rows.error[..rows.count]);
            }
            Tie::Coordinates(coupled) => out[0] = coupled.error(q),
        }
        Some(())
    }
}

/// A combination of rows that is linearly dependent to within the tolerance, but not to within rounding, as in a
/// linkage whose dimensions have few digits.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Near {
    /// The row with the largest coefficient in the combination.
    pub row: usize,
    /// Singular value of the combination: an angle in rad, or a length relative to the reach of the loop.
    pub value: f64,
    /// The configuration of that singular value; it satisfies the connections of the row.
    pub q: Vec<f64>,
}

/// Ranks of the groups of rows that share joints, at regular configurations.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Mobility {
    /// Rank per group; `None` if no closed configuration was found.
    pub ranks: Vec<Option<usize>>,
    /// The combination of largest singular value that counts as dependent and exceeds rounding.
    pub near: Option<Near>,
}

/// The connections of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Constraints {
    pub all: Vec<Constraint>,
    /// Total number of rows.
    pub rows: usize,
    /// Rows that are linearly dependent to within this angle (rad), or this length relative to the reach of the loop,
    /// count as dependent; zero tolerates rounding errors only.
    pub tolerance: f64,
    /// An error of a state, m or rad, that dynamics accept beyond that of a call: for steps that do not project.
    pub allowance: f64,
    /// The neutral configuration, from which the search for closed configurations starts.
    pub neutral: Vec<f64>,
    /// Computed at first use.
    pub mobility: OnceLock<Mobility>,
    /// Set once the warning about dependent rows has been returned.
    pub is_warned: OnceLock<()>,
    /// Set once the axes of the loops have been checked.
    pub axes_checked: OnceLock<()>,
}

impl Constraints {
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// Name of the connection that row `row` belongs to.
    pub fn name_of(&self, row: usize) -> &str {
        self.all.iter().find(|constraint| constraint.rows().contains(&row)).map_or("", |constraint| &constraint.name)
    }
}
