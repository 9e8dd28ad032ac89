//! Cross products with a row of H*: it has one entry that is 1 (a screw has two), so that most of them only change places.

use crate::filter::HingeMap;
use crate::joints::vectors::plus;
use crate::scalar::Real;
use crate::spatial::{angular, linear, spatial};
use nalgebra::{Vector3, Vector6};

/// w x `e_i`.
#[inline(always)]
pub(super) fn cross_axis<T: Real>(w: &Vector3<T>, i: usize) -> Vector3<T> {
    let o = w[0].constant(0.0);
    match i {
        0 => Vector3::new(o, w[2], -w[1]),
        1 => Vector3::new(-w[2], o, w[0]),
        _ => Vector3::new(w[1], -w[0], o),
    }
}

/// -a.
#[inline(always)]
pub(super) fn minus<T: Real>(a: &Vector3<T>) -> Vector3<T> {
    Vector3::new(-a[0], -a[1], -a[2])
}

/// v x S of a motion v, S the row as a column.
#[inline(always)]
pub(super) fn motion_cross_hinge<T: Real>(v: &Vector6<T>, hinge: &HingeMap<T>) -> Vector6<T> {
    let (w, u) = (angular(v), linear(v));
    match *hinge {
        HingeMap::Axis(i) if i < 3 => spatial(&cross_axis(&w, i), &cross_axis(&u, i)),
        HingeMap::Axis(i) => {
            let o = w[0].constant(0.0);
            spatial(&Vector3::new(o, o, o), &cross_axis(&w, i - 3))
        }
        HingeMap::Screw(pitch) => {
            let turn = cross_axis(&w, 2);
            spatial(&turn, &plus(&cross_axis(&u, 2), pitch, &turn))
        }
    }
}

/// S x* f of a force f.
#[inline(always)]
pub(super) fn hinge_cross_force<T: Real>(hinge: &HingeMap<T>, f: &Vector6<T>) -> Vector6<T> {
    let (n, p) = (angular(f), linear(f));
    match *hinge {
        HingeMap::Axis(i) if i < 3 => spatial(&minus(&cross_axis(&n, i)), &minus(&cross_axis(&p, i))),
        HingeMap::Axis(i) => {
            let o = n[0].constant(0.0);
            spatial(&minus(&cross_axis(&p, i - 3)), &Vector3::new(o, o, o))
        }
        HingeMap::Screw(pitch) => {
            let push = cross_axis(&p, 2);
            spatial(&minus(&plus(&cross_axis(&n, 2), pitch, &push)), &minus(&push))
        }
    }
}
