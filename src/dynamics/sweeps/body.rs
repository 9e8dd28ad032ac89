//! The constants of a scene as these sweeps read them: one number for all lanes, in [frames](super::frames) of their own.

use super::axial_rotation::Renaming;
use super::carrier::Carrier;
use super::lever::Lever;
use super::slots::Places;

/// One body.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SweepBody<N> {
    pub carrier: Carrier,
    /// Of what slides by constant angles, its place among those.
    pub slide: Option<usize>,
    /// Of a revolute joint, 1, or -1 where its z points the other way: rate, acceleration and torque are those about z, times this.
    pub sense: N,
    /// To its frame here from its frame in the model.
    pub frame: Renaming<N>,
    /// Its index, and that of the body inward.
    pub index: usize,
    pub parent: Option<usize>,
    /// Its first row.
    pub row: usize,
    /// Of a revolute joint, from the parent's origin to the body's, in the joint's frame: the body's at its zero angle, or the parent's where it is tilted.
    pub lever: Lever<N>,
    /// The lever's square.
    pub lever_square: N,
    /// Mass, first moment, rotational inertia about the origin.
    pub mass: N,
    pub first_moment: [N; 3],
    pub rotational: [N; 6],
    /// The bounds on the terms of M(k).
    pub scale: [N; 2],
    /// The terms of its diagonal.
    pub terms: [N; 6],
    /// Twice the squares of its entries.
    pub lever_squares: [N; 3],
    /// Whether its one row is a turn about z, and whether it is a [free joint](super::free_joint) on the base.
    pub is_about_z: bool,
    pub is_free_joint: bool,
    /// Whether the weights of its root are positive, and of its parent's.
    pub is_definite: bool,
    pub hangs_on_definite: bool,
    pub places: Places,
    /// Whether anything hangs on it.
    pub is_leaf: bool,
    /// How many rows there are from the base to its own.
    pub depth: usize,
    /// One past the last row of what hangs on it.
    pub end_row: usize,
}

/// A body with all outboard of it, held still against each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CompositeBody<N> {
    pub mass: N,
    /// The mass times the lever.
    pub lever: [N; 3],
    /// Twice the body's lever; and entry by entry the lever times the above.
    pub twice_lever: [N; 3],
    pub lever_moment: [N; 3],
}

impl<N> CompositeBody<N> {
    pub fn new(mass: f64, lever: [f64; 3], number: impl Fn(f64) -> N) -> Self {
        Self {
            mass: number(mass),
            lever: lever.map(|l| number(mass * l)),
            twice_lever: lever.map(|l| number(2.0 * l)),
            lever_moment: lever.map(|l| number(mass * l * l)),
        }
    }
}

/// What the angle of a revolute joint is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turning<N> {
    /// The joint's coordinate.
    pub q: usize,
    /// The body's place in the order of the sweeps.
    pub place: usize,
    /// 1, or -1 where the turn's z points the other way.
    pub sense: N,
    /// Sine and cosine where the joint's angle is zero, where they are not those of none.
    pub offset: Option<[N; 2]>,
}
