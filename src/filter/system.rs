//! The linear system on a tree: stages, measurement rows, noise (eqs. 1.1 to 1.4).
//!
//! ```
//! use phipsi::filter::{HingeMap, Rows, Stage, System};
//!
//! // Two stages, each measured once without noise: component 2 of its state.
//! let stage = |parent, first_row| Stage { parent, rows: Rows::One(HingeMap::Axis(2)), first_row };
//! let system = System { stages: vec![stage(None, 0), stage(Some(0), 1)], noise: vec![0.0; 2] };
//! assert_eq!(system.rows(), 2);
//! assert!(system.is_noise_free(0) && system.is_measured(1));
//! // H x of the first row.
//! let x = nalgebra::Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0);
//! assert_eq!(system.stages[0].rows.row(0).project(&x), 3.0);
//! ```

use crate::scalar::Real;
use crate::spatial::{Symmetric6, absolute};
use nalgebra::Vector6;

/// One row of the state-to-output map H: it selects a component of the state, or combines the two components along z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HingeMap<T> {
    /// H = `e_i^T`, i from 0 to 5, angular first.
    Axis(usize),
    /// H = `e_2^T` + pitch `e_5^T`: rotation about z that advances along z, pitch in m/rad.
    Screw(T),
}

impl<T: Real> HingeMap<T> {
    /// H x.
    #[inline(always)]
    pub fn project(&self, x: &Vector6<T>) -> T {
        match *self {
            Self::Axis(i) => x[i],
            Self::Screw(pitch) => pitch.mul_add(x[5], x[2]),
        }
    }

    /// x + H^T s.
    #[inline(always)]
    #[must_use]
    pub(crate) fn spread_onto(&self, x: &Vector6<T>, s: T) -> Vector6<T> {
        let mut y = *x;
        match *self {
            Self::Axis(i) => y[i] += s,
            Self::Screw(pitch) => {
                y[2] += s;
                y[5] += pitch * s;
            }
        }
        y
    }

    /// H^T as a column.
    #[inline(always)]
    pub fn to_column(&self) -> Vector6<T> {
        self.spread_onto(&crate::spatial::zero(), T::one())
    }

    /// P H^T.
    #[inline(always)]
    #[doc(hidden)]
    pub fn covariance_column(&self, p: &Symmetric6<T>) -> Vector6<T> {
        match *self {
            Self::Axis(i) => p.column(i),
            Self::Screw(pitch) => p.column(2) + p.column(5) * pitch,
        }
    }
}

/// The measurement rows of one stage, in the order of the outputs: the first is nearest the root.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rows<T> {
    /// One row.
    One(HingeMap<T>),
    /// The three angular components.
    Angular,
    /// The three linear components, then the three angular ones.
    Six,
    /// No row: a stage without measurements.
    None,
}

impl<T: Real> Rows<T> {
    /// Number of scalar measurements.
    #[inline(always)]
    pub fn count(&self) -> usize {
        match self {
            Self::One(_) => 1,
            Self::Angular => 3,
            Self::Six => 6,
            Self::None => 0,
        }
    }

    /// Row `index` of the stage.
    #[inline(always)]
    pub fn row(&self, index: usize) -> HingeMap<T> {
        match *self {
            Self::One(hinge) => hinge,
            Self::Angular => HingeMap::Axis(index),
            // Not called for stages without rows.
            Self::Six | Self::None => HingeMap::Axis((index + 3) % 6),
        }
    }
}

/// One stage: its parent and its measurement rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage<T> {
    /// The next stage inward; None at the root. The index of a parent is smaller than those of its children.
    pub parent: Option<usize>,
    /// The measurement rows.
    pub rows: Rows<T>,
    /// Index of the first row among all rows.
    pub first_row: usize,
}

impl<T: Real> Stage<T> {
    /// The terms of the diagonal that is propagated to the parent, as the scale of its rounding: those of P^+, or those
    /// of P^- if the row combines components, because H P^+ = 0 then holds to rounding only.
    #[inline(always)]
    #[must_use]
    pub(crate) fn terms_left(&self, before: [T; 6], after: [T; 6]) -> [T; 6] {
        let mixes = matches!(self.rows, Rows::One(HingeMap::Screw(_)));
        absolute(&if mixes { before } else { after }.into()).into()
    }
}

/// The system's structure: stages from the root outward, and the variance of each measurement's noise.
#[derive(Debug, Clone, PartialEq)]
pub struct System<T> {
    /// Stages, parents before children.
    pub stages: Vec<Stage<T>>,
    /// Measurement noise r of each row, zero or positive; infinite if the row is not measured.
    pub noise: Vec<T>,
}

impl<T: Real> System<T> {
    /// Number of measurement rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.noise.len()
    }

    /// True if a row is measured without noise; equal in all lanes.
    #[inline(always)]
    #[must_use]
    pub fn is_noise_free(&self, row: usize) -> bool {
        self.noise[row].lane(0) == 0.0
    }

    /// True if a row is measured at all.
    #[inline(always)]
    #[must_use]
    pub fn is_measured(&self, row: usize) -> bool {
        self.noise[row].lane(0) < f64::INFINITY
    }
}
