//! Tip to base, the square-root form: the filter of [`square_root`] where a joint is a turn, of its commonest row and without what nobody reads
//! later.
//!
//! What hangs on a body is joined to its root before its own measurements: first comes the body itself, then its children one after
//! another.

use super::axial_rotation::{AxialRotation, Axis, about, to_parent};
use super::body::SweepBody;
use super::carrier::Carrier;
use super::carry::in_joint_frame;
use super::constant_rotation::JointAxis;
use super::free_joint;
use super::model::SweepModel;
use super::rotation::{ObliqueRotation, Rotates, rotated};
use super::scratch::{BodyState, Rooted, SweepScratch};
use crate::filter::HingeMap;
use crate::filter::pivots::Scale;
use crate::filter::rounding::RootMonitor;
use crate::filter::square_root::{self, StageMean};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{Root6, RootColumns};
use nalgebra::Vector6;

/// What a body sends to its parent.
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
    /// Becomes a body alone. Number by number: a copy of the whole would be a call.
    #[inline(always)]
    fn begin(&mut self, sweeps: &SweepModel<T>, own: &[BodyState<T>], added: &[[T; 6]], place: usize) {
        let (body, of_body, y, t) = (&sweeps.swept()[place], &sweeps.roots[place], &own[place].force, &added[place]);
        let like = y[0];
        let o = like.constant(0.0);
        for i in 0..6 {
            (self.y[i], self.t[i]) = (y[i], t[i]);
        }
        let [angular, linear] = body.scale;
        self.scale = Scale { angular: like.splat(angular), linear: like.splat(linear) };
        let Root6 { weights, rows } = &mut self.root;
        let m = like.splat(of_body.mass);
        (weights[0], weights[1], weights[2]) = (m, m, m);
        for i in 0..3 {
            weights[i + 3] = like.splat(of_body.weights[i]);
        }
        let (p, c) = (&of_body.centre, &of_body.central);
        let (x, y, z) = (like.splat(p[0]), like.splat(p[1]), like.splat(p[2]));
        (rows[1][0], rows[2][0], rows[2][1]) = (o, o, o);
        (rows[3][0], rows[3][1], rows[3][2]) = (o, -z, y);
        (rows[4][0], rows[4][1], rows[4][2]) = (z, o, -x);
        (rows[5][0], rows[5][1], rows[5][2]) = (-y, x, o);
        rows[4][3] = like.splat(c[(1, 0)]);
        (rows[5][3], rows[5][4]) = (like.splat(c[(2, 0)]), like.splat(c[(2, 1)]));
    }

    /// Takes in a child, as [`Root6::join`] does.
    #[inline(always)]
    fn join<const FREE: usize, const POSITIVE: bool>(&mut self, sent: &mut Sent<T>) {
        self.root.join::<FREE, POSITIVE>(&mut sent.columns, Some((&mut self.y, &mut sent.y)));
        for (to, &t) in self.t.iter_mut().zip(&sent.t) {
            *to += t;
        }
        self.scale = self.scale.sum(&sent.scale);
    }
}

/// Every stage's measurements (3.6, 4.2, 4.5) and the way to its parent; `innovations` receives e^-. Of a revolute joint D, g and e^- are those about
/// its z.
#[inline(always)]
pub(super) fn tip_to_base<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) -> RootMonitor<T> {
    let SweepScratch { own, added, rooted, shifts, measured, .. } = scratch;
    let (own, added) = (&**own, &**added);
    let (bodies, system) = (sweeps.swept(), &model.system);
    let mut monitor = RootMonitor::new();
    for (place, body) in bodies.iter().enumerate().rev() {
        let here = &mut rooted[body.places.inward];
        if body.is_leaf {
            here.begin(sweeps, own, added, place);
        }
        let diagonal = here.root.diagonal();
        monitor.observe_root(&here.root, &diagonal);
        let scale = here.scale;
        let mut t = Vector6::new(here.t[0], here.t[1], here.t[2], here.t[3], here.t[4], here.t[5]);
        let two_are_free = if body.is_about_z {
            let (row, hinge) = (body.row, HingeMap::Axis(2));
            let mean = (&mut here.y, &mut t, tau[row] * tau[row].splat(body.sense));
            let at_row = (&hinge, system.noise[row]);
            let (m, e) = if body.is_definite {
                square_root::measure_row::<T, true>(at_row, &mut here.root, Some(mean))
            } else {
                square_root::measure_row::<T, false>(at_row, &mut here.root, Some(mean))
            };
            monitor.observe(&m, &hinge, &scale);
            (measured[row], innovations[row]) = (m, e);
            system.is_noise_free(row)
        } else if free_joint::is_noise_free(body.is_free_joint, body.row, system) {
            let rows = free_joint::rows(body.row);
            let (measured, innovations) = (&mut measured[rows.clone()], &mut innovations[rows.clone()]);
            free_joint::measure_root(&mut here.root, (&mut here.y, &mut t), &tau[rows], measured, innovations);
            for (i, m) in measured.iter().enumerate() {
                monitor.observe(m, &HingeMap::Axis(free_joint::PICKED[i]), &scale);
            }
            false
        } else {
            let mut mean: Option<StageMean<'_, T>> = Some((&mut here.y, &mut t, tau, &mut *innovations));
            let (at_stage, root) = ((system, body.index), (&mut here.root, &scale));
            square_root::through_stage(at_stage, root, &mut mean, measured, &mut monitor, |_, _| {})
        };
        if body.parent.is_none() {
            continue;
        }
        let mut sent = Sent::filled(t[0]);
        let lever_square = match body.carrier {
            Carrier::Axial(axle) => {
                rotated!(axle, own[place].turn, sweeps.tilts, rotation, {
                    let t = in_joint_frame(&body.lever, &rotation, &[t[0], t[1], t[2], t[3], t[4], t[5]]);
                    about!(axle.axis(), X, Y, Z, {
                        columns_to_parent::<T, _, X, Y, Z>(body, &rotation, &here.root, &mut sent.columns);
                        sent.t = to_parent::<T, X, Y, Z>(&t);
                    });
                });
                t[0].splat(body.lever_square)
            }
            Carrier::Shift(at) => {
                shifts[at].root_to_parent(&here.root, &mut sent.columns);
                sent.t = shifts[at].force_to_parent(&t).into();
                shifts[at].lever_square()
            }
        };
        sent.scale = Scale::sent_by_root(&diagonal, lever_square);
        for (sent, &y) in sent.y.iter_mut().zip(&here.y) {
            *sent = y;
        }
        let to = &mut rooted[body.places.parent_inward];
        if body.places.arrives_first {
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

/// phi L across a revolute joint: about z, where it is tilted by that, along the lever, and to the parent's axes.
#[inline(always)]
fn columns_to_parent<T: Real, R: Rotates<T>, const X: usize, const Y: usize, const Z: usize>(
    body: &SweepBody<T::Parameter>,
    rotation: &R,
    root: &Root6<T>,
    columns: &mut RootColumns<T>,
) {
    let turn = rotation.turn();
    let AxialRotation { s, c } = turn;
    let (o, one) = (s.constant(0.0), s.constant(1.0));
    let RootColumns { weights, rows } = columns;
    for (weight, &of_root) in weights.iter_mut().zip(&root.weights) {
        *weight = of_root;
    }
    let r = &root.rows;
    // The linear parts (1, a, b), (0, 1, d) and (0, 0, 1).
    let (fx, fy) = (c.minus_product(s, r[1][0]), c.mul_add(r[1][0], s));
    let forces = [[fx, fy, r[2][0]], [-s, c, r[2][1]], [o, o, one]];
    for j in 0..3 {
        let [fx, fy, fz] = forces[j];
        let (mut mx, mut my) = turn.pair(r[3][j], r[4][j]);
        let mut mz = r[5][j];
        if R::TILTS {
            let (force, moment) = (rotation.tilt([fx, fy, fz]), rotation.tilt([mx, my, mz]));
            let moment = body.lever.moment(force, moment);
            for i in 0..3 {
                (rows[i][j], rows[3 + i][j]) = (force[i], moment[i]);
            }
            continue;
        }
        if j < 2 {
            [mx, my, mz] = body.lever.moment([fx, fy, fz], [mx, my, mz]);
        } else if body.lever.is_there() {
            let [lx, ly, _] = body.lever.entries;
            (mx, my) = (mx + s.splat(ly), my - s.splat(lx));
        }
        (rows[X][j], rows[Y][j], rows[Z][j]) = (fx, fy, fz);
        (rows[3 + X][j], rows[3 + Y][j], rows[3 + Z][j]) = (mx, my, mz);
    }
    let (x, y) = (c.minus_product(s, r[4][3]), c.mul_add(r[4][3], s));
    (rows[3 + X][3], rows[3 + Y][3], rows[3 + Z][3]) = (x, y, r[5][3]);
    (rows[3 + X][4], rows[3 + Y][4], rows[3 + Z][4]) = (-s, c, r[5][4]);
    (rows[3 + X][5], rows[3 + Y][5], rows[3 + Z][5]) = (o, o, one);
    if R::TILTS {
        let [_, _, _, x, y, z] = rows;
        for j in 3..6 {
            [x[j], y[j], z[j]] = rotation.tilt([x[j], y[j], z[j]]);
        }
    }
}
