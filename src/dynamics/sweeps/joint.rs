//! The joint of a body: what carries what crosses it, and what is measured there.

use crate::spatial::transform::Axis;

/// What a revolute joint turns about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum JointAxis {
    /// An axis of its parent's frame.
    Aligned(Axis),
    /// Another: the place of its constant rotation among all.
    Oblique(usize),
}

impl JointAxis {
    /// The axis of the parent's frame that the joint's z is: its own where a constant rotation goes all the way.
    pub fn axis(self) -> Axis {
        match self {
            Self::Aligned(axis) => axis,
            Self::Oblique(_) => Axis::Z,
        }
    }
}

/// Which [`Transform`](crate::spatial::transform::Transform) a joint has; numbers are places among those of its kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Joint {
    /// A revolute joint.
    Axial(JointAxis),
    /// A prismatic joint whose rotation is constant angles: its place among shifts, and among slides.
    Prismatic(usize, usize),
    /// All six degrees of freedom on the base.
    Free(usize),
    /// Any other, and what is left of those.
    General(usize),
}

/// Does `$do` with the transform of a revolute joint, the axes of its parent's frame known to the compiler as X, Y and Z.
macro_rules! with_axial {
    ($axis:expr, $turn:expr, $sweeps:expr, ($x:ident, $y:ident, $z:ident), $offset:expr, $transform:ident, $do:expr) => {
        match $axis {
            JointAxis::Aligned(axis) => about!(axis, $x, $y, $z, {
                let $transform = &Axial::new($turn, Order::<$x, $y, $z>, &$offset);
                $do
            }),
            JointAxis::Oblique(at) => about!(@ 0, 1, 2, $x, $y, $z, {
                let rotation = ObliqueRotation::new($turn, &$sweeps.constant_rotations[at]);
                let $transform = &Axial::new(rotation, Order::<$x, $y, $z>, &$offset);
                $do
            }),
        }
    };
}
pub(super) use with_axial;

/// Does `$do` with the transform and the rows of the joint of a body or a segment; the axes of a revolute joint are known as X, Y and Z where they are given, else looked up.
macro_rules! with_joint {
    ($body:expr, $turn:expr, ($model:expr, $sweeps:expr, $shifts:expr), ($x:ident, $y:ident, $z:ident), $offset:expr, $transform:ident, $rows:ident, $do:expr) => {
        match $body.joint {
            Joint::Axial(axis) => {
                let $rows = &AboutZ::new(($body.row, $body.sense), &$model.system, $body.index);
                with_axial!(axis, $turn, $sweeps, ($x, $y, $z), $offset, $transform, $do)
            }
            other => with_joint!(@ other, $body, ($model, $sweeps, $shifts), $transform, $rows, $do),
        }
    };
    ($body:expr, $turn:expr, ($model:expr, $sweeps:expr, $shifts:expr), $transform:ident, $rows:ident, $do:expr) => {
        match $body.joint {
            Joint::Axial(JointAxis::Aligned(axis)) => {
                let $rows = &AboutZ::new(($body.row, $body.sense), &$model.system, $body.index);
                let $transform = &Axial::new($turn, axis, &$body.offset);
                $do
            }
            Joint::Axial(JointAxis::Oblique(at)) => {
                let $rows = &AboutZ::new(($body.row, $body.sense), &$model.system, $body.index);
                let rotation = ObliqueRotation::new($turn, &$sweeps.constant_rotations[at]);
                let $transform = &Axial::new(rotation, Order::<0, 1, 2>, &$body.offset);
                $do
            }
            other => with_joint!(@ other, $body, ($model, $sweeps, $shifts), $transform, $rows, $do),
        }
    };
    (@ $joint:expr, $body:expr, ($model:expr, $sweeps:expr, $shifts:expr), $transform:ident, $rows:ident, $do:expr) => {
        match $joint {
            Joint::Prismatic(at, slide) => {
                let $rows = &AlongZ(&$model.system, $body.index);
                let $transform = &Prismatic { shift: &$shifts[at], rotation: &$sweeps.slides[slide] };
                $do
            }
            Joint::Free(_) if Six::is_noise_free($body.row, &$model.system) => {
                let $rows = &Six::new(&$model.system, $body.index);
                let $transform = &Base($model.gravity[0]);
                $do
            }
            Joint::Free(at) | Joint::General(at) => {
                let $rows = &AnyRows(&$model.system, $body.index);
                let $transform = &$shifts[at];
                $do
            }
            Joint::Axial(_) => {}
        }
    };
}
pub(super) use with_joint;

/// Does `$do` with the rows of the joint of a body.
macro_rules! with_rows {
    ($body:expr, $model:expr, $rows:ident, $do:expr) => {
        match $body.joint {
            Joint::Axial(_) => {
                let $rows = &AboutZ::new(($body.row, $body.sense), &$model.system, $body.index);
                $do
            }
            Joint::Free(_) if Six::is_noise_free($body.row, &$model.system) => {
                let $rows = &Six::new(&$model.system, $body.index);
                $do
            }
            _ => {
                let $rows = &AnyRows(&$model.system, $body.index);
                $do
            }
        }
    };
}
pub(super) use with_rows;
