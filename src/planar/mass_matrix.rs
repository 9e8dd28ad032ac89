//! The mass matrix in the plane, from composite inertias (3.4, 3.5), in the base's frame: nothing is turned on the way inward.

use super::model::{Direction, PlanarModel};
use super::outward::{cross, placements, turned};
use super::scratch::{Of, OnBase, PlanarScratch};
use crate::scalar::Real;

/// Base to tip: the turn of every body against the base, and its lever in the base's frame, with the placements done.
#[inline(always)]
pub(super) fn onto_base<T: Real>(model: &PlanarModel<T>, of: &[Of<T>], on_base: &mut [OnBase<T>]) {
    for (k, body) in model.bodies.iter().enumerate() {
        let Of { turn, lever, .. } = of[k];
        let (turn, lever) = match body.parent {
            Some(parent) => {
                let carrier = on_base[parent].turn;
                (turned(carrier, turn), turned(carrier, lever))
            }
            None => (turn, lever),
        };
        (on_base[k].turn, on_base[k].lever) = (turn, lever);
    }
}

/// M at `q` into `out`, (nv x nv) row by row, as [`dynamics::mass_matrix`](crate::dynamics::mass_matrix()) gives it.
///
/// O(N depth), 4 or 7 operations for each pair of joints of which one carries the other.
#[inline(always)]
pub fn mass_matrix<T: Real, C: Real>(
    model: &PlanarModel<T>,
    scratch: &mut PlanarScratch<T, C>,
    q: &[T],
    out: &mut [T],
) {
    let (of, on_base) = (&mut scratch.of[..], &mut scratch.on_base[..]);
    placements(model, of, q);
    onto_base(model, of, on_base);
    for (body, own) in model.bodies.iter().zip(&mut *on_base) {
        let [hx, hy] = turned(own.turn, body.first_moment);
        own.composite = [body.mass, hx, hy, body.inertia];
    }
    for (k, body) in model.bodies.iter().enumerate().rev() {
        let Some(parent) = body.parent else { continue };
        let OnBase { lever: [lx, ly], composite: [m, x, y, j], .. } = on_base[k];
        // h' = h + m l, and J' = J + l (h + h').
        let (moved_x, moved_y) = (m.mul_add(lx, x), m.mul_add(ly, y));
        let moved = (x + moved_x).mul_add(lx, (y + moved_y).mul_add(ly, j));
        for (sum, term) in on_base[parent].composite.iter_mut().zip([m, moved_x, moved_y, moved]) {
            *sum += term;
        }
    }
    let nv = model.bodies.len();
    if let Some(body) = model.bodies.first() {
        out.fill(body.mass.constant(0.0));
    }
    for (k, body) in model.bodies.iter().enumerate() {
        let OnBase { turn: [c, s], composite: [m, x, y, j], .. } = on_base[k];
        // The force that a unit acceleration of the joint needs: moment about the body's origin, and force.
        let (mut moment, force, own) = match body.direction {
            Direction::Turns { .. } => (body.along(j), [-body.along(y), body.along(x)], j),
            Direction::Slides { .. } => (cross([x, y], [c, s]), [m * c, m * s], m),
        };
        out[k * nv + k] = own + body.armature;
        let mut child = k;
        while let Some(parent) = model.bodies[child].parent {
            let [lx, ly] = on_base[child].lever;
            moment = lx.mul_add(force[1], moment.minus_product(ly, force[0]));
            let carrier = &model.bodies[parent];
            let entry = match carrier.direction {
                Direction::Turns { .. } => carrier.along(moment),
                Direction::Slides { .. } => {
                    let [c, s] = on_base[parent].turn;
                    c.mul_add(force[0], s * force[1])
                }
            };
            (out[k * nv + parent], out[parent * nv + k]) = (entry, entry);
            child = parent;
        }
    }
}
