//! Tip to base in square-root form: roots of P (3.6), and the filter (4.2, 4.4, 4.5).
//!
//! The children of a body are joined to its root one after another, before the measurements of its joint.

use super::joint::{self, with_joint, with_rows};
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::{BodyState, Rooted, SweepScratch};
use crate::filter::pivots::Scale;
use crate::filter::rounding::RootMonitor;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use crate::spatial::{Root6, RootColumns};
use nalgebra::Vector6;

/// The contribution of a body to its parent.
struct Sent<T> {
    columns: RootColumns<T>,
    y: [T; 6],
    t: [T; 6],
    scale: Scale<T>,
}

impl<T: Real> Sent<T> {
    #[inline(always)]
    fn filled(x: T) -> Self {
        Self { columns: RootColumns::filled(x), y: [x; 6], t: [x; 6], scale: Scale::filled(x) }
    }
}

impl<T: Real> Rooted<T> {
    /// Becomes the root of a body without its children. Entry by entry: a copy of the whole would be a function call.
    #[inline(always)]
    fn begin(&mut self, sweeps: &SweepModel<T>, own: &[BodyState<T>], added: &[[T; 6]], place: usize) {
        let (body, of_body, y, t) = (&sweeps.swept()[place], &sweeps.roots[place], &own[place].force, &added[place]);
        let like = y[0];
        let o = like.constant(0.0);
        for i in 0..6 {
            (self.y[i], self.t[i]) = (y[i], t[i]);
        }
        self.scale = sweeps.load(body).scale;
        let Root6 { weights, rows } = &mut self.root;
        let m = like.splat(of_body.mass);
        (weights[0], weights[1], weights[2]) = (m, m, m);
        for i in 0..3 {
            weights[i + 3] = like.splat(of_body.weights[i]);
        }
        let (p, c) = (&of_body.center, &of_body.central);
        let (x, y, z) = (like.splat(p[0]), like.splat(p[1]), like.splat(p[2]));
        (rows[1][0], rows[2][0], rows[2][1]) = (o, o, o);
        (rows[3][0], rows[3][1], rows[3][2]) = (o, -z, y);
        (rows[4][0], rows[4][1], rows[4][2]) = (z, o, -x);
        (rows[5][0], rows[5][1], rows[5][2]) = (-y, x, o);
        rows[4][3] = like.splat(c[(1, 0)]);
        (rows[5][3], rows[5][4]) = (like.splat(c[(2, 0)]), like.splat(c[(2, 1)]));
    }

    /// Joins a child, see [`Root6::join`].
    #[inline(always)]
    fn join<const FREE: usize, const POSITIVE: bool>(&mut self, sent: &mut Sent<T>) {
        self.root.join::<FREE, POSITIVE>(&mut sent.columns, Some((&mut self.y, &mut sent.y)));
        for (to, &t) in self.t.iter_mut().zip(&sent.t) {
            *to += t;
        }
        self.scale = self.scale.sum(&sent.scale);
    }
}

/// The measurements of every joint (3.6, 4.2, 4.5) and the propagation to its parent; `innovations` receives e^-. D, g
/// and e^- of a revolute joint are those about its z. With `KEEP` t after the measurements is stored.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const KEEP: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> RootMonitor<T> {
    let SweepScratch { own, added, rooted, shifts, measured, .. } = scratch;
    let (own, added) = (&**own, &**added);
    let mut monitor = RootMonitor::new();
    for (place, body) in sweeps.swept().iter().enumerate().rev() {
        let here = &mut rooted[body.places.inward];
        if body.is_leaf {
            here.begin(sweeps, own, added, place);
        }
        let diagonal = here.root.diagonal();
        monitor.observe_root(&here.root, &diagonal);
        let scale = here.scale;
        let mut t = Vector6::new(here.t[0], here.t[1], here.t[2], here.t[3], here.t[4], here.t[5]);
        let (root, mean) = ((&mut here.root, &scale, body.is_definite), (&mut here.y, &mut t));
        let two_are_free = with_rows!(body, model, rows, {
            rows.measure_root(root, mean, (tau, innovations), measured, &mut monitor)
        });
        if KEEP {
            here.t = t.into();
        }
        if body.parent.is_none() {
            continue;
        }
        let mut sent = Sent::filled(t[0]);
        with_joint!(body, own[place].turn, (model, sweeps, shifts), transform, _rows, {
            transform.root_to_parent(&here.root, &mut sent.columns);
            transform.send_force(&[t[0], t[1], t[2], t[3], t[4], t[5]], true, &mut sent.t);
            sent.scale = Scale::sent_by_root(&diagonal, transform.offset_square());
        });
        for (sent, &y) in sent.y.iter_mut().zip(&here.y) {
            *sent = y;
        }
        let to = &mut rooted[body.places.parent_inward];
        if body.places.accumulates_first {
            to.begin(sweeps, own, added, body.places.parent - 1);
        }
        match (two_are_free, body.hangs_on_definite) {
            (true, true) => to.join::<2, true>(&mut sent),
            (false, true) => to.join::<3, true>(&mut sent),
            (true, false) => to.join::<2, false>(&mut sent),
            (false, false) => to.join::<3, false>(&mut sent),
        }
    }
    monitor
}
