//! Bounds on the terms that form P^-, as they follow it inward.

use super::body::{Carrier, LeanBody};
use super::tilt::Axle;
use crate::filter::pivots::Scale;
use crate::filter::terms;
use crate::scalar::Real;
use nalgebra::Vector6;

/// Constant bounds, in every lane.
#[inline(always)]
pub(super) fn scale_everywhere<T: Real>([angular, linear]: [T::Parameter; 2], like: T) -> Scale<T> {
    Scale { angular: like.everywhere(angular), linear: like.everywhere(linear) }
}

/// What P^- of a stage can bring to the entries of its parent, as [`Scale::sent_by`] has it.
#[inline(always)]
pub(super) fn sent<T: Real>(body: &LeanBody<T::Parameter>, diagonal: &[T; 6]) -> Scale<T> {
    let [p0, p1, p2, p3, p4, p5] = *diagonal;
    let (like, four) = (p0, p0.constant(4.0));
    let (a, b) = (p0 + p1 + p2, p3 + p4 + p5);
    Scale { angular: four * b.mul_add(like.everywhere(body.lever_square), a), linear: four * b }
}

/// The terms of the diagonal of M(k).
#[inline(always)]
pub(super) fn terms_of_noise<T: Real>(body: &LeanBody<T::Parameter>, like: T) -> [T; 6] {
    let [a, b, c, d, e, f] = body.terms;
    [
        like.everywhere(a),
        like.everywhere(b),
        like.everywhere(c),
        like.everywhere(d),
        like.everywhere(e),
        like.everywhere(f),
    ]
}

/// As [`terms::sent`] of a stage on a turn with this diagonal of P^+, in the joint's frame: about z, each of x and y takes from both; about a tilted
/// axis each from all.
#[inline(always)]
pub(super) fn sent_terms<T: Real>(body: &LeanBody<T::Parameter>, kept: &Vector6<T>) -> [T; 6] {
    let like = kept[0];
    let four = like.constant(terms::SPREAD);
    let [x, y, z] = body.lever_squares;
    let (x, y, z) = (like.everywhere(x), like.everywhere(y), like.everywhere(z));
    let (mut across, mut along) = (four * (kept[3].abs() + kept[4].abs()), four * kept[5].abs());
    let (mut turned, mut about) = (four * (kept[0].abs() + kept[1].abs()), four * kept[2].abs());
    if let Carrier::Turn(Axle::Tilted(_)) = body.carrier {
        (across, turned) = (across + along, turned + about);
        (along, about) = (across, turned);
    }
    [
        y.mul_add(along, z.mul_add(across, turned)),
        x.mul_add(along, z.mul_add(across, turned)),
        (x + y).mul_add(across, about),
        across,
        across,
        along,
    ]
}
