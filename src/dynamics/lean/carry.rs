//! P of one body in 21 numbers: P^- of what arrived, past the body's turn, and on the way to its parent.

use super::body::LeanBody;
use super::filter::ABOUT_Z;
use super::lever::Lever;
use super::rotation::{Rotates, tilts};
use super::row::Noise;
use super::turn::Turn;
use crate::filter::riccati::Measured;
use crate::scalar::Real;
use crate::spatial::{Symmetric3, Symmetric6};
use nalgebra::Matrix3;

/// M(k), of which six entries are zero, and what arrived.
#[inline(always)]
pub(super) fn with_noise<T: Real>(body: &LeanBody<T::Parameter>, arrived: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *arrived;
    let [xx, xy, xz, yy, yz, zz] = body.rotational;
    let [x, y, z] = body.first_moment;
    let (x, y, z, m) = (a0.everywhere(x), a0.everywhere(y), a0.everywhere(z), a0.everywhere(body.mass));
    [
        a0 + a0.everywhere(xx),
        a1 + a0.everywhere(xy),
        a2 + a0.everywhere(xz),
        a3 + a0.everywhere(yy),
        a4 + a0.everywhere(yz),
        a5 + a0.everywhere(zz),
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
pub(super) fn pivot_column<T: Real>(body: &LeanBody<T::Parameter>, arrived: &[T; 21]) -> [T; 6] {
    let [_, _, xz, _, yz, zz] = body.rotational;
    let (like, [x, y, _]) = (arrived[5], body.first_moment);
    [
        arrived[2] + like.everywhere(xz),
        arrived[4] + like.everywhere(yz),
        arrived[5] + like.everywhere(zz),
        arrived[12] - like.everywhere(y),
        arrived[13] + like.everywhere(x),
        arrived[14],
    ]
}

/// And the diagonal.
#[inline(always)]
pub(super) fn diagonal<T: Real>(body: &LeanBody<T::Parameter>, arrived: &[T; 21]) -> [T; 6] {
    let [xx, _, _, yy, _, zz] = body.rotational;
    let like = arrived[0];
    let m = like.everywhere(body.mass);
    [
        arrived[0] + like.everywhere(xx),
        arrived[3] + like.everywhere(yy),
        arrived[5] + like.everywhere(zz),
        arrived[15] + m,
        arrived[18] + m,
        arrived[20] + m,
    ]
}

/// P^+ = P^- - g H P^- past a turn about z (3.6): the five rows that H does not pick. Row and column 2 are zero, or where `NOISY` r g, by which
/// they are given.
#[inline(always)]
pub(super) fn kept<T: Real, const NOISY: bool>(
    p: &[T; 21],
    [ph0, ph1, ph3, ph4, ph5]: &[T; 5],
    (m, r): (&Measured<T>, T),
) -> [T; 21] {
    let g = &m.gain;
    let [a0, a1, _, a3, _, _, c0, c1, c2, c3, c4, c5, _, _, _, b0, b1, b2, b3, b4, b5] = *p;
    let o = ph0.constant(0.0);
    let [a2, a4, a5, c6, c7, c8] =
        if NOISY { [r * g[0], r * g[1], r * g[2], r * g[3], r * g[4], r * g[5]] } else { [o; 6] };
    [
        a0.minus_product(g[0], *ph0),
        a1.minus_product(g[0], *ph1),
        a2,
        a3.minus_product(g[1], *ph1),
        a4,
        a5,
        c0.minus_product(g[0], *ph3),
        c1.minus_product(g[0], *ph4),
        c2.minus_product(g[0], *ph5),
        c3.minus_product(g[1], *ph3),
        c4.minus_product(g[1], *ph4),
        c5.minus_product(g[1], *ph5),
        c6,
        c7,
        c8,
        b0.minus_product(g[3], *ph3),
        b1.minus_product(g[3], *ph4),
        b2.minus_product(g[3], *ph5),
        b3.minus_product(g[4], *ph4),
        b4.minus_product(g[4], *ph5),
        b5.minus_product(g[5], *ph5),
    ]
}

/// [`kept`] of a turn, in the joint's frame and along the lever.
#[inline(always)]
pub(super) fn carried<T: Real, const NOISY: bool>(
    body: &LeanBody<T::Parameter>,
    rotation: &impl Rotates<T>,
    p: &[T; 21],
    column: &[T; 5],
    (m, noise): (&Measured<T>, Noise<T>),
) -> [T; 21] {
    let p = if NOISY && !noise.skips_zeros {
        rotation.covariance(&kept::<T, true>(p, column, (m, noise.variance)))
    } else {
        rotation.covariance_past_z(&kept::<T, false>(p, column, (m, noise.variance)))
    };
    let Lever { entries: [x, y, z], along } = body.lever;
    let like = p[15];
    let lever = Lever { entries: [like.everywhere(x), like.everywhere(y), like.everywhere(z)], along };
    along_lever(&lever, &p, NOISY || tilts(rotation))
}

/// Along z, x and y of the lever, one after another: C' = C + l~ B, A' = A + l~ C^T + C' l~^T. Where it is not `full` row and column 2 are zero, and not added to.
#[inline(always)]
pub(super) fn along_lever<T: Real>(lever: &Lever<T>, p: &[T; 21], full: bool) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    let (mut a0, mut a1, mut a2, mut a3, mut a4, mut a5) = (a0, a1, a2, a3, a4, a5);
    let (mut c0, mut c1, mut c2, mut c3, mut c4, mut c5, mut c6, mut c7, mut c8) = (c0, c1, c2, c3, c4, c5, c6, c7, c8);
    let Lever { entries: [x, y, z], along: [along_x, along_y, along_z] } = *lever;
    if along_z {
        let (s0, s1, s2) = (c0.minus_product(z, b1), c1.minus_product(z, b3), c2.minus_product(z, b4));
        let (s3, s4, s5) = (z.mul_add(b0, c3), z.mul_add(b1, c4), z.mul_add(b2, c5));
        a0 = a0.minus_product(z, s1 + c1);
        a1 = z.mul_add(s0 - c4, a1);
        a3 = z.mul_add(s3 + c3, a3);
        if full {
            a2 = a2.minus_product(z, c7);
            a4 = z.mul_add(c6, a4);
        }
        (c0, c1, c2, c3, c4, c5) = (s0, s1, s2, s3, s4, s5);
    }
    if along_x {
        let (s3, s4, s5) = (c3.minus_product(x, b2), c4.minus_product(x, b4), c5.minus_product(x, b5));
        let (s6, s7, s8) = (x.mul_add(b1, c6), x.mul_add(b3, c7), x.mul_add(b4, c8));
        a1 = a1.minus_product(x, c2);
        a2 = x.mul_add(c1, a2);
        a3 = a3.minus_product(x, s5 + c5);
        a4 = if full { x.mul_add(s4 - c8, a4) } else { x.mul_add(s4, a4) };
        a5 = if full { x.mul_add(s7 + c7, a5) } else { x.mul_add(s7, a5) };
        (c3, c4, c5, c6, c7, c8) = (s3, s4, s5, s6, s7, s8);
    }
    if along_y {
        let (s0, s1, s2) = (y.mul_add(b2, c0), y.mul_add(b4, c1), y.mul_add(b5, c2));
        let (s6, s7, s8) = (c6.minus_product(y, b0), c7.minus_product(y, b1), c8.minus_product(y, b2));
        a0 = y.mul_add(s2 + c2, a0);
        a1 = y.mul_add(c5, a1);
        a2 = y.mul_add(c8 - s0, a2);
        a4 = a4.minus_product(y, c3);
        a5 = a5.minus_product(y, s6 + c6);
        (c0, c1, c2, c6, c7, c8) = (s0, s1, s2, s6, s7, s8);
    }
    [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5]
}

/// The motion here of a body on a turn that a unit rate of its parent's turn, about z there, gives it: phi* H* of a parent on the base.
#[inline(always)]
pub(super) fn of_first_turn<T: Real, const X: usize, const Y: usize, const Z: usize>(
    lever: &Lever<T::Parameter>,
    rotation: &impl Rotates<T>,
) -> [T; 6] {
    let Turn { s, c } = rotation.turn();
    let (o, [x, y, z]) = (s.constant(0.0), lever.entries);
    let (x, y, z) = (s.everywhere(x), s.everywhere(y), s.everywhere(z));
    // The parent's z in the joint's frame, e, and e x l.
    if tilts(rotation) {
        // Of a tilted one that is the parent's own frame.
        let ([a, b, c], [d, e, f]) = (rotation.rotate_back([o, o, c.constant(1.0)]), rotation.rotate_back([-y, x, o]));
        return [a, b, c, d, e, f];
    }
    let ([a, b, c], v) = if X == ABOUT_Z {
        ([c, -s, o], [o, -z, y])
    } else if Y == ABOUT_Z {
        ([s, c, o], [z, o, -x])
    } else {
        ([o, o, c.constant(1.0)], [-y, x, o])
    };
    let [d, e, f] = rotation.rotate_back(v);
    [a, b, c, d, e, f]
}

/// w* P^+ w past a turn; where `NOISY` with row and column 2, which else are zero.
#[inline(always)]
pub(super) fn variance_along<T: Real, const NOISY: bool>(p: &[T; 21], w: &[T; 6]) -> T {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    let [w0, w1, w2, w3, w4, w5] = *w;
    let (t0, t1, t3, t4, t5) = (w0 + w0, w1 + w1, w3 + w3, w4 + w4, w5 + w5);
    let r0 = c2.mul_add(t5, c1.mul_add(t4, c0.mul_add(t3, a1.mul_add(t1, a0 * w0))));
    let r1 = c5.mul_add(t5, c4.mul_add(t4, c3.mul_add(t3, a3 * w1)));
    let r3 = b2.mul_add(t5, b1.mul_add(t4, b0 * w3));
    let r4 = b4.mul_add(t5, b3 * w4);
    let of_five = r0.mul_add(w0, r1 * w1) + r3.mul_add(w3, r4.mul_add(w4, b5 * w5 * w5));
    if !NOISY {
        return of_five;
    }
    let r2 = c8.mul_add(t5, c7.mul_add(t4, c6.mul_add(t3, a4.mul_add(t1, a2.mul_add(t0, a5 * w2)))));
    r2.mul_add(w2, of_five)
}

/// A force in the joint's frame, about the parent's origin: at the end of this lever.
#[inline(always)]
pub(super) fn in_joint_frame<T: Real>(lever: &Lever<T::Parameter>, rotation: &impl Rotates<T>, z: &[T; 6]) -> [T; 6] {
    let force = rotation.rotate([z[3], z[4], z[5]]);
    let moment = rotation.rotate([z[0], z[1], z[2]]);
    let [a, b, c] = lever.moment(force, moment);
    [a, b, c, force[0], force[1], force[2]]
}

/// As the general stages take it.
#[inline(always)]
pub(super) fn unpacked<T: Real>(p: &[T; 21]) -> Symmetric6<T> {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *p;
    Symmetric6 {
        angular: Symmetric3::new([a0, a1, a2, a3, a4, a5]),
        coupling: Matrix3::new(c0, c1, c2, c3, c4, c5, c6, c7, c8),
        linear: Symmetric3::new([b0, b1, b2, b3, b4, b5]),
    }
}

/// As these sweeps take it.
#[inline(always)]
pub(super) fn packed<T: Real>(p: &Symmetric6<T>) -> [T; 21] {
    let ([a0, a1, a2, a3, a4, a5], [b0, b1, b2, b3, b4, b5], c) = (p.angular.entries, p.linear.entries, &p.coupling);
    [
        a0,
        a1,
        a2,
        a3,
        a4,
        a5,
        c[(0, 0)],
        c[(0, 1)],
        c[(0, 2)],
        c[(1, 0)],
        c[(1, 1)],
        c[(1, 2)],
        c[(2, 0)],
        c[(2, 1)],
        c[(2, 2)],
        b0,
        b1,
        b2,
        b3,
        b4,
        b5,
    ]
}

#[cfg(test)]
mod tests {
    use super::{carried, in_joint_frame, kept, of_first_turn, variance_along};
    use crate::dynamics::lean::LeanModel;
    use crate::dynamics::lean::accelerations::along;
    use crate::dynamics::lean::body::Carrier;
    use crate::dynamics::lean::filter::ABOUT_Z;
    use crate::dynamics::lean::rotation::{TiltedTurn, rotated};
    use crate::dynamics::lean::row::Noise;
    use crate::dynamics::lean::tilt::Axle;
    use crate::dynamics::lean::turn::{Axis, PACKED, Turn, about, packed_to_parent, to_parent};
    use crate::filter::riccati::Measured;
    use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
    use crate::spatial::Symmetric3;
    use nalgebra::{Vector3, Vector6};

    /// A body on a turn about this axis of one that turns on the base.
    fn two(axis: Vector3<f64>, lever: Vector3<f64>) -> LeanModel<f64> {
        let central = Symmetric3::new([0.3, 0.02, -0.01, 0.2, 0.03, 0.25]);
        let inertial = Some(Inertial { mass: 2.0, centre: [0.1, -0.2, 0.3].into(), central });
        let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
        for (parent, name, axis) in [("base", "first", Vector3::z()), ("first", "second", axis)] {
            let mut joint = JointDescription::new(format!("to {name}"), JointKind::Revolute, parent, name);
            (joint.axis, joint.origin.lever) = (axis, lever);
            builder = builder.link(LinkDescription { name: name.into(), inertial }).joint(joint);
        }
        LeanModel::new(builder.build().expect("two turns").model())
    }

    fn check<const FULL: bool>(lean: &LeanModel<f64>) {
        let body = &lean.bodies[1];
        let wave = |i: usize| (1.7 * f64::from(u8::try_from(i).expect("small")) + 0.3).sin();
        let (p, column): ([f64; 21], _) = (std::array::from_fn(wave), [0.3, -0.2, 0.5, 0.1, -0.4]);
        let gain = Vector6::from_fn(|i, _| wave(i + 30));
        let m = Measured { pivot: 1.0, pivot_inverse: 1.0, gain };
        let turn = Turn { s: 0.6, c: 0.8 };
        let (force, noise) = (std::array::from_fn(|i| wave(i + 40)), 0.7);
        let Carrier::Turn(axle) = body.carrier else { panic!("a turn") };
        rotated!(axle, turn, lean.tilts, rotation, X, Y, Z, {
            let w = of_first_turn::<f64, X, Y, Z>(&body.lever, &rotation);
            let sent =
                carried::<f64, FULL>(body, &rotation, &p, &column, (&m, Noise { variance: noise, skips_zeros: !FULL }));
            let one = variance_along::<f64, FULL>(&kept::<f64, FULL>(&p, &column, (&m, noise)), &w);
            let expected = packed_to_parent::<f64, X, Y, Z>(&sent)[PACKED[ABOUT_Z][ABOUT_Z]];
            assert!((one - expected).abs() <= 64.0 * f64::EPSILON, "{axle:?} {FULL}: {one} {expected}");
            let expected = to_parent::<f64, X, Y, Z>(&in_joint_frame(&body.lever, &rotation, &force))[ABOUT_Z];
            assert!((along(&w, &force) - expected).abs() <= 64.0 * f64::EPSILON, "{axle:?}: {expected}");
        });
    }

    /// What a turn on the base asks of the next body is an entry of what would be carried there.
    #[test]
    fn the_first_turn_gets_what_it_picks() {
        let tilted = [Vector3::new(0.0, 0.6, 0.8), Vector3::new(-0.6, 0.0, 0.8), Vector3::new(0.48, 0.6, -0.64)];
        for axis in [Vector3::x(), -Vector3::y(), Vector3::z()].into_iter().chain(tilted) {
            for lever in [Vector3::zeros(), Vector3::new(0.2, -0.3, 0.5), Vector3::new(0.0, 0.4, 0.0)] {
                let lean = two(axis, lever);
                assert!(lean.bodies[1].hangs_on_first);
                check::<true>(&lean);
                check::<false>(&lean);
            }
        }
    }
}
