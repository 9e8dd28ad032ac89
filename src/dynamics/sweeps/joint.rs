//! The joint of a body: its transform and its measurement rows.

use crate::spatial::transform::Axis;

// The names that the macros use, as `joint::...`.
pub(in crate::dynamics) use super::rows::{AboutZ, AlongZ, AnyRows, Six};
pub(in crate::dynamics) use crate::spatial::transform::{
    Axial, Base, ObliqueRotation, Order, PARENT_FRAME, Prismatic, about,
};

/// The axis of a revolute joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) enum JointAxis {
    /// An axis of its parent's frame.
    Aligned(Axis),
    /// Any other: the index of its constant rotation.
    Oblique(usize),
}

impl JointAxis {
    /// The axis of the parent's frame that is the joint's z, after the constant rotation if there is one.
    pub fn axis(self) -> Axis {
        match self {
            Self::Aligned(axis) => axis,
            Self::Oblique(_) => Axis::Z,
        }
    }
}

/// Which [`Transform`](crate::spatial::transform::Transform) a joint has; numbers are indices among those of its kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) enum Joint {
    /// A revolute joint.
    Axial(JointAxis),
    /// A prismatic joint whose rotation is constant angles: its index among shifts, and among slides.
    Prismatic(usize, usize),
    /// All six degrees of freedom on the base.
    Free(usize),
    /// Any other joint.
    General(usize),
}

// Other modules refer to this module as `joint`.

/// Evaluates `$do` with the transform of a revolute joint about this axis, with this rotation and offset. With `copies`
/// it is compiled for each order of axes, which saves a tenth of the time of inverse dynamics of one state, and nothing
/// elsewhere.
macro_rules! with_axial {
    (copies, $axis:expr, $turn:expr, $sweeps:expr, $offset:expr, $transform:ident, $do:expr) => {
        match $axis {
            joint::JointAxis::Aligned(axis) => joint::about!(axis, X, Y, Z, {
                let $transform = &joint::Axial::new($turn, joint::Order::<X, Y, Z>, &$offset);
                $do
            }),
            oblique => joint::with_axial!(oblique, $turn, $sweeps, $offset, $transform, $do),
        }
    };
    ($axis:expr, $turn:expr, $sweeps:expr, $offset:expr, $transform:ident, $do:expr) => {
        match $axis {
            joint::JointAxis::Aligned(axis) => {
                let $transform = &joint::Axial::new($turn, axis, &$offset);
                $do
            }
            joint::JointAxis::Oblique(at) => {
                let rotation = joint::ObliqueRotation::new($turn, &$sweeps.constant_rotations[at]);
                let $transform = &joint::Axial::new(rotation, joint::PARENT_FRAME, &$offset);
                $do
            }
        }
    };
}
pub(in crate::dynamics) use with_axial;

/// Evaluates `$do` with the transform and the rows of the joint of a body. `T` is the scalar of the caller: with
/// [`Real::GENERAL_JOINTS`](crate::scalar::Real) only the arm of the general joint is compiled.
macro_rules! with_joint {
    ($body:expr, $turn:expr, ($model:expr, $sweeps:expr, $shifts:expr), $transform:ident, $rows:ident, $do:expr) => {
        if T::GENERAL_JOINTS {
            let $rows = &joint::AnyRows(&$model.system, $body.index);
            let $transform = &$shifts[$body.index];
            $do
        } else {
            match $body.joint {
                joint::Joint::Axial(axis) => {
                    let $rows = &joint::AboutZ::new(($body.row, $body.sense), &$model.system, $body.index);
                    joint::with_axial!(axis, $turn, $sweeps, $body.offset, $transform, $do)
                }
                joint::Joint::Prismatic(at, slide) => {
                    let $rows = &joint::AlongZ(&$model.system, $body.index);
                    let $transform = &joint::Prismatic { shift: &$shifts[at], rotation: &$sweeps.slides[slide] };
                    $do
                }
                joint::Joint::Free(_) if joint::Six::is_noise_free($body.row, &$model.system) => {
                    let $rows = &joint::Six::new(&$model.system, $body.index);
                    let $transform = &joint::Base($model.gravity[0]);
                    $do
                }
                joint::Joint::Free(at) | joint::Joint::General(at) => {
                    let $rows = &joint::AnyRows(&$model.system, $body.index);
                    let $transform = &$shifts[at];
                    $do
                }
            }
        }
    };
}
pub(in crate::dynamics) use with_joint;

/// Evaluates `$do` with the rows of the joint of a body.
macro_rules! with_rows {
    ($body:expr, $model:expr, $rows:ident, $do:expr) => {
        if T::GENERAL_JOINTS {
            let $rows = &joint::AnyRows(&$model.system, $body.index);
            $do
        } else {
            match $body.joint {
                joint::Joint::Axial(_) => {
                    let $rows = &joint::AboutZ::new(($body.row, $body.sense), &$model.system, $body.index);
                    $do
                }
                joint::Joint::Free(_) if joint::Six::is_noise_free($body.row, &$model.system) => {
                    let $rows = &joint::Six::new(&$model.system, $body.index);
                    $do
                }
                _ => {
                    let $rows = &joint::AnyRows(&$model.system, $body.index);
                    $do
                }
            }
        }
    };
}
pub(in crate::dynamics) use with_rows;
