//! The derivative of the force of a body with respect to its ten inertial parameters.
//!
//! The cotangent of an off-diagonal entry of I is the sum for both entries of the matrix.
//!
//! The constants of a motion are laid out as armature (nv), gravity (3), wrenches (bodies x 6) and inertial parameters
//! (bodies x 10).

use crate::dynamics::sweeps::body::SweepBody;
use crate::scalar::Real;
use crate::spatial::inertial_parameters::{ENTRIES, Parameters, inertia, parameters, place};
use crate::spatial::{RigidShift, angular, cross, cross_add, linear, minus, rotate_block, sum3};
use nalgebra::{Matrix3, Vector3, Vector6};

/// Y* u, the cotangents of a body's parameters: Y is the regressor, f = Y pi the force that the body needs at velocity
/// V and acceleration A, gravity included, and u the cotangent of f.
#[inline(always)]
pub(super) fn of_force<T: Real>([velocity, acceleration, co_state]: &[Vector6<T>; 3]) -> Parameters<T> {
    let (w, v, turned) = (angular(velocity), linear(velocity), angular(acceleration));
    let (u, pushed) = (angular(co_state), linear(co_state));
    // The acceleration of the origin, a point.
    let a = cross_add(&w, &v, &linear(acceleration));
    let mass = sum3(a.into(), pushed.into());
    let swung = cross(&w, &cross(&w, &pushed));
    // a x u - alpha x f + w x (w x f).
    let moment = cross_add(&a, &u, &cross_add(&pushed, &turned, &swung));
    let across = cross(&u, &w);
    let product = |i: usize, j: usize| {
        let both = turned[i].mul_add(u[j], w[i] * across[j]);
        if i == j { both } else { both + turned[j].mul_add(u[i], w[j] * across[i]) }
    };
    let [xx, xy, yy, xz, yz, zz] = ENTRIES.map(|[i, j]| product(i, j));
    [mass, moment[0], moment[1], moment[2], xx, xy, yy, xz, yz, zz]
}

/// Converts cotangents of parameters from the frame in the sweeps to the frame in the model.
#[inline(always)]
pub(super) fn from_sweeps<T: Real>(body: &SweepBody<T::Parameter>, here: &Parameters<T>) -> Parameters<T> {
    let like = here[0];
    let o = like.constant(0.0);
    let first = body.frame.back(&[here[1], here[2], here[3], o, o, o]);
    let mut there = *here;
    there[1..4].copy_from_slice(&[first[0], first[1], first[2]]);
    for (&value, [i, j]) in here[4..].iter().zip(ENTRIES) {
        let (to, sign) = body.frame.entry(like, i, j);
        there[place(to)] = sign * value;
    }
    there
}

/// Cotangents of a link's parameters, in the link's frame, from those of its body. The link is part of the body, with
/// the pose `placed`.
pub fn of_link<T: Real>(placed: &RigidShift<T>, of_body: &Parameters<T>) -> Parameters<T> {
    let half = T::from_f64(0.5);
    let l = &placed.lever;
    let mut matrix = Matrix3::from_element(T::zero());
    for (&value, [i, j]) in of_body[4..].iter().zip(ENTRIES) {
        let entry = if i == j { value } else { half * value };
        (matrix[(i, j)], matrix[(j, i)]) = (entry, entry);
    }
    let first = Vector3::new(of_body[1], of_body[2], of_body[3]);
    let trace = matrix[(0, 0)] + matrix[(1, 1)] + matrix[(2, 2)];
    // tr l - Ibar l.
    let across =
        Vector3::from([0, 1, 2].map(|i| {
            minus(trace, l[i], T::one(), sum3([matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]], (*l).into()))
        }));
    let two = T::from_f64(2.0);
    let moved = Vector3::new(
        two.mul_add(across[0], first[0]),
        two.mul_add(across[1], first[1]),
        two.mul_add(across[2], first[2]),
    );
    let mass = of_body[0] + sum3(first.into(), (*l).into()) + sum3(across.into(), (*l).into());
    let turned = placed.rotate_back(&moved);
    let matrix = rotate_block(&placed.rotation.transpose(), &matrix);
    let [xx, xy, yy, xz, yz, zz] =
        ENTRIES.map(|[i, j]| if i == j { matrix[(i, j)] } else { matrix[(i, j)] + matrix[(j, i)] });
    [mass, turned[0], turned[1], turned[2], xx, xy, yy, xz, yz, zz]
}

/// Changes of a body's parameters from those of a link on it, in the link's frame.
pub fn of_body<T: Real>(placed: &RigidShift<T>, of_link: &Parameters<T>) -> Parameters<T> {
    parameters(&inertia(of_link).to_parent(placed))
}

/// Splits constants into armature, gravity, wrenches and parameters.
pub(crate) fn constants_of<T>(all: &[T], nv: usize, bodies: usize) -> [&[T]; 4] {
    let (armature, rest) = all.split_at(nv);
    let (gravity, rest) = rest.split_at(3);
    let (wrenches, parameters) = rest.split_at(6 * bodies);
    [armature, gravity, wrenches, parameters]
}

/// Mutable parts: changes of the constants, or gradients with respect to them.
pub(crate) struct ConstantParts<'a, T> {
    pub armature: &'a mut [T],
    pub gravity: &'a mut [T],
    pub wrenches: &'a mut [[T; 6]],
    pub parameters: &'a mut [Parameters<T>],
}

impl<'a, T> ConstantParts<'a, T> {
    pub fn of(all: &'a mut [T], nv: usize, bodies: usize) -> Self {
        let (armature, rest) = all.split_at_mut(nv);
        let (gravity, rest) = rest.split_at_mut(3);
        let (wrenches, parameters) = rest.split_at_mut(6 * bodies);
        Self { armature, gravity, wrenches: wrenches.as_chunks_mut().0, parameters: parameters.as_chunks_mut().0 }
    }
}

/// All gradients of one state, one after another: by q, qd and the third argument, (3 x nv), then by the constants.
pub(crate) struct GradientParts<'a, T> {
    pub state: &'a mut [T],
    pub constants: ConstantParts<'a, T>,
}

impl<'a, T> GradientParts<'a, T> {
    pub fn of(all: &'a mut [T], nv: usize, bodies: usize) -> Self {
        let (state, rest) = all.split_at_mut(3 * nv);
        Self { state, constants: ConstantParts::of(rest, nv, bodies) }
    }
}
