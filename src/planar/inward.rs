//! Tip to base in the plane: the Riccati recursion (3.6, 3.10) and the filter (4.4 to 4.6) beside it.

use super::model::PlanarModel;
use super::outward::force_to_parent;
use super::scratch::Of;
use crate::filter::HingeMap;
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::scalar::Real;

/// M(k) as the covariance of (moment, x, y): J, -`h_y`, `h_x`, m, 0, m; with the bound on its terms.
#[inline(always)]
fn take_noise<T: Real>(model: &PlanarModel<T>, of: &mut [Of<T>]) {
    for (body, of) in model.bodies.iter().zip(of) {
        let ([x, y], m) = (body.first_moment, body.mass);
        of.p = [body.inertia, -y, x, m, m.constant(0.0), m];
        of.scale = body.scale;
    }
}

/// D, g and, where `SOLVES`, the filter for `torques`; `scaled` receives e^+ = e^- / D, along the normal.
#[inline(always)]
pub(super) fn sweep<T: Real, const SOLVES: bool>(
    model: &PlanarModel<T>,
    of: &mut [Of<T>],
    torques: &[T],
    scaled: &mut [T],
) -> PivotMonitor<T> {
    take_noise(model, of);
    let mut monitor = PivotMonitor::new();
    for (k, body) in model.bodies.iter().enumerate().rev() {
        let Of { turn, lever, p, scale, mut force, .. } = of[k];
        let [j, jx, jy, xx, xy, yy] = p;
        let noise = body.armature;
        let one = noise.constant(1.0);
        let exact = body.is_noise_free;
        // What a torque e moves is g; past it P^+ H* = r g, exactly.
        let (inverse, gain, carried) = if body.turns() {
            let pivot = if exact { j } else { j + noise };
            monitor.observe(pivot, &HingeMap::Axis(2), &scale);
            let inverse = pivot.recip();
            let gain = [if exact { one } else { j * inverse }, jx * inverse, jy * inverse];
            let block = [xx.minus_product(jx, gain[1]), xy.minus_product(jx, gain[2]), yy.minus_product(jy, gain[2])];
            let carried = if exact {
                forces_to_parent(turn, lever, block)
            } else {
                to_parent(turn, lever, noise * gain[0], [noise * gain[1], noise * gain[2]], block)
            };
            (inverse, gain, carried)
        } else {
            let pivot = if exact { xx } else { xx + noise };
            monitor.observe(pivot, &HingeMap::Axis(5), &scale);
            let inverse = pivot.recip();
            let gain = [jx * inverse, if exact { one } else { xx * inverse }, xy * inverse];
            let (j, jy, yy) =
                (j.minus_product(jx, gain[0]), jy.minus_product(jx, gain[2]), yy.minus_product(xy, gain[2]));
            let carried = if exact {
                past_slide_to_parent(turn, lever, [j, jy, yy])
            } else {
                to_parent(turn, lever, j, [noise * gain[0], jy], [noise * gain[1], noise * gain[2], yy])
            };
            (inverse, gain, carried)
        };
        (of[k].gain, of[k].pivot_inverse) = (gain, inverse);
        if SOLVES {
            let torque = body.along(torques[k]);
            let measured = usize::from(!body.turns());
            let e = torque - force[measured];
            scaled[k] = e * inverse;
            for (i, force) in force.iter_mut().enumerate() {
                // Past a measurement without noise the component is what was measured.
                *force = if exact && i == measured { torque } else { gain[i].mul_add(e, *force) };
            }
        }
        if let Some(parent) = body.parent {
            let sent = sent_by(j, xx + yy, lever);
            let at = &mut of[parent];
            at.scale = at.scale.sum(&sent);
            for (p, carried) in at.p.iter_mut().zip(carried) {
                *p += carried;
            }
            if SOLVES {
                let carried = force_to_parent(turn, lever, force);
                for (force, carried) in at.force.iter_mut().zip(carried) {
                    *force += carried;
                }
            }
        }
    }
    monitor
}

/// The bound on what P^- with this moment entry and this trace of forces brings to its parent's diagonal (see
/// [`Scale::sent_by`](crate::filter::pivots::Scale::sent_by)).
#[inline(always)]
fn sent_by<T: Real>(j: T, trace: T, [x, y]: [T; 2]) -> Scale<T> {
    let linear = j.constant(4.0) * trace;
    let square = x.mul_add(x, y * y);
    Scale { angular: square.mul_add(linear, j.constant(4.0) * j), linear }
}

/// R B R* for a symmetric block; every sum is of squares but for the mixed term, so that a small entry beside a large one is kept
/// where the turn is a quarter.
#[inline(always)]
fn congruence<T: Real>([c, s]: [T; 2], [xx, xy, yy]: [T; 3]) -> [T; 3] {
    let (cc, ss, cs) = (c * c, s * s, c * s);
    let mixed = (cs + cs) * xy;
    [cc.mul_add(xx, ss.mul_add(yy, -mixed)), cs.mul_add(xx - yy, (cc - ss) * xy), ss.mul_add(xx, cc.mul_add(yy, mixed))]
}

/// phi P phi* where P has no moment entries, as past a turn without armature.
#[inline(always)]
fn forces_to_parent<T: Real>(turn: [T; 2], [lx, ly]: [T; 2], block: [T; 3]) -> [T; 6] {
    let [xx, xy, yy] = congruence(turn, block);
    let (jx, jy) = ((xy * lx).minus_product(xx, ly), (yy * lx).minus_product(xy, ly));
    [(jy * lx).minus_product(jx, ly), jx, jy, xx, xy, yy]
}

/// phi P phi* where P has no entries along x, as past a slide without armature: moment, moment with y, yy.
#[inline(always)]
fn past_slide_to_parent<T: Real>([c, s]: [T; 2], lever: [T; 2], [j, jy, yy]: [T; 3]) -> [T; 6] {
    let across = s * yy;
    with_lever(lever, j, [-(s * jy), c * jy], [s * across, -(c * across), c * (c * yy)])
}

/// phi P phi*.
#[inline(always)]
fn to_parent<T: Real>(turn: [T; 2], lever: [T; 2], j: T, coupling: [T; 2], block: [T; 3]) -> [T; 6] {
    with_lever(lever, j, super::outward::turned(turn, coupling), congruence(turn, block))
}

/// The lever's terms, P already turned: with v = e x l, c' = c + B v and j' = j + v c + v c'.
#[inline(always)]
fn with_lever<T: Real>([lx, ly]: [T; 2], j: T, [jx, jy]: [T; 2], [xx, xy, yy]: [T; 3]) -> [T; 6] {
    let x = xy.mul_add(lx, jx.minus_product(xx, ly));
    let y = yy.mul_add(lx, jy.minus_product(xy, ly));
    [(jy + y).mul_add(lx, j.minus_product(jx + x, ly)), x, y, xx, xy, yy]
}
