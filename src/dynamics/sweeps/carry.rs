//! P of one body in 21 numbers: P^- of what arrived, past the body's turn, and on the way to its parent.

use super::body::SweepBody;
use super::lever::Lever;
use super::packed::{along_lever, kept};
use super::rotation::Rotates;
use super::row::Noise;
use crate::filter::riccati::Measured;
use crate::scalar::Real;

/// M(k), of which six entries are zero, and what arrived.
#[inline(always)]
pub(super) fn with_noise<T: Real>(body: &SweepBody<T::Parameter>, arrived: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *arrived;
    let [xx, xy, xz, yy, yz, zz] = body.rotational;
    let [x, y, z] = body.first_moment;
    let (x, y, z, m) = (a0.splat(x), a0.splat(y), a0.splat(z), a0.splat(body.mass));
    [
        a0 + a0.splat(xx),
        a1 + a0.splat(xy),
        a2 + a0.splat(xz),
        a3 + a0.splat(yy),
        a4 + a0.splat(yz),
        a5 + a0.splat(zz),
        c0,
        c1 - z,
        c2 + y,
        c3 + z,
        c4,
        c5 - x,
        c6 - y,
        c7 + x,
        c8,
        b0 + m,
        b1,
        b2,
        b3 + m,
        b4,
        b5 + m,
    ]
}

/// Of the same P^- column 2, which H picks.
#[inline(always)]
pub(super) fn pivot_column<T: Real>(body: &SweepBody<T::Parameter>, arrived: &[T; 21]) -> [T; 6] {
    let [_, _, xz, _, yz, zz] = body.rotational;
    let (like, [x, y, _]) = (arrived[5], body.first_moment);
    [
        arrived[2] + like.splat(xz),
        arrived[4] + like.splat(yz),
        arrived[5] + like.splat(zz),
        arrived[12] - like.splat(y),
        arrived[13] + like.splat(x),
        arrived[14],
    ]
}

/// And the diagonal.
#[inline(always)]
pub(super) fn diagonal<T: Real>(body: &SweepBody<T::Parameter>, arrived: &[T; 21]) -> [T; 6] {
    let [xx, _, _, yy, _, zz] = body.rotational;
    let like = arrived[0];
    let m = like.splat(body.mass);
    [
        arrived[0] + like.splat(xx),
        arrived[3] + like.splat(yy),
        arrived[5] + like.splat(zz),
        arrived[15] + m,
        arrived[18] + m,
        arrived[20] + m,
    ]
}

/// [`kept`] of a revolute joint, in the joint's frame and along the lever.
#[inline(always)]
pub(super) fn carried<T: Real>(
    body: &SweepBody<T::Parameter>,
    rotation: &impl Rotates<T>,
    p: &[T; 21],
    column: &[T; 5],
    (m, noise): (&Measured<T>, Noise<T>),
) -> [T; 21] {
    let p = rotation.covariance(&kept(p, column, (m, noise.variance)));
    let Lever { entries: [x, y, z], along } = body.lever;
    let like = p[15];
    let lever = Lever { entries: [like.splat(x), like.splat(y), like.splat(z)], along };
    along_lever(&lever, &p)
}

/// A force in the joint's frame, about the parent's origin: at the end of this lever.
#[inline(always)]
pub(super) fn in_joint_frame<T: Real>(lever: &Lever<T::Parameter>, rotation: &impl Rotates<T>, z: &[T; 6]) -> [T; 6] {
    let force = rotation.rotate([z[3], z[4], z[5]]);
    let moment = rotation.rotate([z[0], z[1], z[2]]);
    let [a, b, c] = lever.moment(force, moment);
    [a, b, c, force[0], force[1], force[2]]
}
