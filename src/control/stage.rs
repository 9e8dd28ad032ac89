//! One stage of the filter through time, in covariance form (D97, D100 to D102 of the notes on optimal control).
//!
//! The deviation of the state is x = (dq, dv, p), in the tangent space of q, with the change p of the effort of the
//! step before where its rate has a cost; u is the change of the efforts. A step is
//!
//! ```text
//! dv' = F x + G u,    dq' = T dq + h J dv',    p' = u
//! ```
//!
//! so that with E = [h J; 1; 0] the value of the next state enters through E* P' and Z = E* P' E alone.

use super::array::ArrayForm;
use super::knot::{Law, Sizes, Step, Value};
use super::matrices::{Read, add_product, add_times, fused, mirror, solve_lower, solve_upper};
use super::rows::Rows;
use crate::batch::instruction_set::within_widest;
use crate::inverse_kinematics::BoxStep;

/// Bounds of the change of the controls, (controls) each, within which is zero.
#[derive(Debug, Clone, Copy)]
pub struct Bounds<'a> {
    pub lower: &'a [f64],
    pub upper: &'a [f64],
}

/// The change of the quadratic model along the offsets k: its slope and its curvature.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Model {
    pub slope: f64,
    pub curvature: f64,
}

impl Model {
    /// The decrease of the model for a step length.
    pub fn decrease(&self, length: f64) -> f64 {
        -length * (self.slope + 0.5 * length * self.curvature)
    }
}

/// Scratch of a stage.
#[derive(Debug, Default)]
pub struct Scratch {
    sizes: Sizes,
    /// E* P', Z, and Z F + E* P' T.
    carried: Vec<f64>,
    z: Vec<f64>,
    w: Vec<f64>,
    zg: Vec<f64>,
    /// E* P' T, (nv x nv).
    turned: Vec<f64>,
    pub(super) q_xx: Vec<f64>,
    pub(super) q_ux: Vec<f64>,
    q_uu: Vec<f64>,
    q_x: Vec<f64>,
    q_u: Vec<f64>,
    /// The diagonal of `q_xx` before the gain of information is subtracted.
    before: Vec<f64>,
    ahead: Vec<f64>,
    along: Vec<f64>,
    /// P'_pq T, (controls x nv), and G* of E* P'_p, (controls x controls), with a cost of rates.
    by_q: Vec<f64>,
    cross: Vec<f64>,
    /// L^-1 times the free rows of `q_ux`, and then the gains of these.
    y: Vec<f64>,
    boxed: BoxStep,
    array: ArrayForm,
}

impl Scratch {
    pub fn new(sizes: Sizes) -> Self {
        let (nv, n, m) = (sizes.nv, sizes.state(), sizes.controls);
        let nan = |length: usize| vec![f64::NAN; length];
        Self {
            sizes,
            carried: nan(nv * n),
            z: nan(nv * nv),
            w: nan(nv * 2 * nv),
            zg: nan(nv * m),
            turned: nan(nv * nv),
            q_xx: nan(n * n),
            q_ux: nan(m * n),
            q_uu: nan(m * m),
            q_x: nan(n),
            q_u: nan(m),
            before: nan(n),
            ahead: nan(n),
            along: nan(nv),
            by_q: nan(if sizes.has_rate { m * nv } else { 0 }),
            cross: nan(if sizes.has_rate { m * m } else { 0 }),
            y: nan(m * n),
            boxed: BoxStep::new(m),
            array: ArrayForm::default(),
        }
    }
}

/// Rounding of a stage relative to its result, beyond which the array form computes it again.
const ACCEPTED: f64 = 1e-12;

/// The value of a knot from that of the next, and the law between them. `rows` are the terms of the cost; `damping` is
/// the share of each control's curvature that is added to it. Returns the model's change along k, and whether the array
/// form was used; `None` if the curvature of the controls is not positive.
pub fn stage(
    s: &mut Scratch,
    step: &Step<'_>,
    rows: (&[Rows], usize),
    (damping, bounds): (f64, Option<Bounds<'_>>),
    value: &mut Value,
    law: &mut Law<'_>,
) -> Option<(Model, bool)> {
    let mut model = Model::default();
    let mut margin = f64::NAN;
    let both = (&mut *law.gain, &mut *law.offset);
    in_covariance_form(s, step, rows, (damping, bounds), (&*value, both), (&mut model, &mut margin));
    if !(margin > 0.0) {
        return None;
    }
    let is_array = margin * ACCEPTED < f64::EPSILON;
    if is_array {
        let mut array = std::mem::take(&mut s.array);
        array.stage((s.sizes, s.boxed.free(), &s.q_uu), step, rows, damping, value, law);
        s.array = array;
    } else {
        std::mem::swap(&mut value.hessian, &mut s.q_xx);
        std::mem::swap(&mut value.gradient, &mut s.q_x);
        value.root.clear();
    }
    Some((model, is_array))
}

within_widest! {
    fn in_covariance_form<'a>(
        s: &'a mut Scratch,
        step: &'a Step<'a>,
        rows: (&'a [Rows], usize),
        law: (f64, Option<Bounds<'a>>),
        value: (&'a Value, (&'a mut [f64], &'a mut [f64])),
        found: (&'a mut Model, &'a mut f64),
    ) {
        quadratic_model(s, step, rows, law.0, value.0);
        minimize(s, law.1, value.1, found);
    }
}

/// Columns of a matrix with `width` columns times the block of a joint: column j of the result is the sum of columns i
/// times `block[i][j]`.
#[inline(always)]
fn turn_columns(m: &mut [f64], width: usize, (first, count): (usize, usize), block: &[f64; 36]) {
    for row in m.chunks_exact_mut(width) {
        let mut old = [0.0; 6];
        old[..count].copy_from_slice(&row[first..first + count]);
        for j in 0..count {
            row[first + j] = (0..count).map(|i| old[i] * block[i * count + j]).sum();
        }
    }
}

/// Rows of a matrix from the transposed block of a joint: row j of the result is the sum of rows i times
/// `block[i][j]`.
#[inline(always)]
fn turn_rows(m: &mut [f64], width: usize, (first, count): (usize, usize), block: &[f64; 36]) {
    for column in 0..width {
        let mut old = [0.0; 6];
        for i in 0..count {
            old[i] = m[(first + i) * width + column];
        }
        for j in 0..count {
            m[(first + j) * width + column] = (0..count).map(|i| old[i] * block[i * count + j]).sum();
        }
    }
}

/// The quadratic model of a stage: second derivatives and gradient by x and u.
#[inline(always)]
fn quadratic_model(s: &mut Scratch, step: &Step<'_>, (rows, knot): (&[Rows], usize), damping: f64, value: &Value) {
    let Sizes { nv, controls: m, has_rate } = s.sizes;
    let (n, nx, h) = (s.sizes.state(), 2 * nv, step.h);
    let (f, g, next) = (step.by_state, step.by_control, &value.hessian);
    // E* P': J* applies to the first nv rows of P', h to these, and the rows of the velocities are added.
    s.carried.copy_from_slice(&next[..nv * n]);
    for turn in step.turns {
        turn_rows(&mut s.carried, n, (turn.first, turn.count), &turn.jacobian);
    }
    for (to, of_rate) in s.carried.iter_mut().zip(&next[nv * n..]) {
        *to = fused(h, *to, *of_rate);
    }
    // Z = E* P' E, and E* P' T.
    for i in 0..nv {
        let row = &s.carried[i * n..][..n];
        s.turned[i * nv..][..nv].copy_from_slice(&row[..nv]);
        s.z[i * nv..][..nv].copy_from_slice(&row[..nv]);
    }
    for turn in step.turns {
        turn_columns(&mut s.z, nv, (turn.first, turn.count), &turn.jacobian);
        turn_columns(&mut s.turned, nv, (turn.first, turn.count), &turn.transport);
    }
    for i in 0..nv {
        for (z, of_rate) in s.z[i * nv..][..nv].iter_mut().zip(&s.carried[i * n + nv..]) {
            *z = fused(h, *z, *of_rate);
        }
    }
    // W = Z F + [E* P' T, 0].
    s.w.fill(0.0);
    for i in 0..nv {
        s.w[i * nx..][..nv].copy_from_slice(&s.turned[i * nv..][..nv]);
    }
    add_product(&mut s.w, (Read::rows(&s.z, nv), f), (nv, nv, nx), (nx, nx), (1.0, false));
    // Q_xx = F* W + [T* (E* P')*, 0]* F + T* P' T, above the diagonal.
    s.q_xx.fill(0.0);
    for i in 0..nv {
        s.q_xx[i * n..][..nv].copy_from_slice(&next[i * n..][..nv]);
    }
    for turn in step.turns {
        turn_rows(&mut s.q_xx[..nv * n], n, (turn.first, turn.count), &turn.transport);
        turn_columns(&mut s.q_xx[..nv * n], n, (turn.first, turn.count), &turn.transport);
    }
    add_product(&mut s.q_xx, (Read::transposed(f, nx), &s.w), (nx, nv, nx), (nx, n), (1.0, true));
    add_product(&mut s.q_xx, (Read::transposed(&s.turned, nv), f), (nv, nv, nx), (nx, n), (1.0, true));
    // Q_ux = G* W, Q_uu = G* Z G; with rates, u is also the last part of the next state.
    s.q_ux.fill(0.0);
    add_product(&mut s.q_ux, (Read::transposed(g, m), &s.w), (m, nv, nx), (nx, n), (1.0, false));
    s.zg.fill(0.0);
    add_product(&mut s.zg, (Read::rows(&s.z, nv), g), (nv, nv, m), (m, m), (1.0, false));
    s.q_uu.fill(0.0);
    add_product(&mut s.q_uu, (Read::transposed(g, m), &s.zg), (m, nv, m), (m, m), (1.0, false));
    if has_rate {
        add_rates(s, step, next);
    }
    linear_model(s, step, value);
    add_costs(s, rows, knot);
    for i in 0..m {
        s.q_uu[i * m + i] *= 1.0 + damping;
    }
}

/// Adds the part of u in the next state, whose effort it is, to `q_ux` and `q_uu`.
#[inline(always)]
fn add_rates(s: &mut Scratch, step: &Step<'_>, next: &[f64]) {
    let Sizes { nv, controls: m, .. } = s.sizes;
    let (n, nx, f, g) = (s.sizes.state(), 2 * nv, step.by_state, step.by_control);
    let of_effort = Read { numbers: &s.carried[nx..], row: 1, column: n };
    add_product(&mut s.q_ux, (of_effort, f), (m, nv, nx), (nx, n), (1.0, false));
    // P'_pq T.
    let by_q = &mut s.by_q;
    for i in 0..m {
        by_q[i * nv..][..nv].copy_from_slice(&next[(nx + i) * n..][..nv]);
    }
    for turn in step.turns {
        turn_columns(by_q, nv, (turn.first, turn.count), &turn.transport);
    }
    for i in 0..m {
        for (to, more) in s.q_ux[i * n..][..nv].iter_mut().zip(&by_q[i * nv..]) {
            *to += more;
        }
    }
    let cross = &mut s.cross;
    cross.fill(0.0);
    add_product(cross, (of_effort, g), (m, nv, m), (m, m), (1.0, false));
    for i in 0..m {
        for j in 0..m {
            s.q_uu[i * m + j] += cross[i * m + j] + cross[j * m + i] + next[(nx + i) * n + nx + j];
        }
    }
}

/// The gradient of the model.
#[inline(always)]
fn linear_model(s: &mut Scratch, step: &Step<'_>, value: &Value) {
    let Sizes { nv, controls: m, has_rate } = s.sizes;
    let (n, nx, h, next) = (s.sizes.state(), 2 * nv, step.h, &value.hessian);
    let (f, g) = (step.by_state, step.by_control);
    // P' c + p', and its products with E*, F* and G*.
    s.ahead.copy_from_slice(&value.gradient);
    if !step.defect.is_empty() {
        add_times(&mut s.ahead, Read::rows(next, n), step.defect, 1.0);
    }
    s.along.copy_from_slice(&s.ahead[..nv]);
    for turn in step.turns {
        turn_rows(&mut s.along, 1, (turn.first, turn.count), &turn.jacobian);
    }
    for (along, of_rate) in s.along.iter_mut().zip(&s.ahead[nv..]) {
        *along = fused(h, *along, *of_rate);
    }
    s.q_x.fill(0.0);
    s.q_x[..nv].copy_from_slice(&s.ahead[..nv]);
    for turn in step.turns {
        turn_rows(&mut s.q_x[..nv], 1, (turn.first, turn.count), &turn.transport);
    }
    add_times(&mut s.q_x[..nx], Read::transposed(f, nx), &s.along, 1.0);
    s.q_u.fill(0.0);
    add_times(&mut s.q_u, Read::transposed(g, m), &s.along, 1.0);
    if has_rate {
        for (to, of_effort) in s.q_u.iter_mut().zip(&s.ahead[nx..]) {
            *to += of_effort;
        }
    }
}

/// Adds the costs of the knot.
#[inline(always)]
fn add_costs(s: &mut Scratch, rows: &[Rows], knot: usize) {
    let (n, m) = (s.sizes.state(), s.sizes.controls);
    for rows in rows {
        for (error, start, values) in rows.of_knot(knot) {
            for (i, &a) in values.iter().enumerate() {
                let row = start + i;
                let same = values[i..].iter().map(|b| a * b);
                if row < n {
                    s.q_x[row] += a * error;
                    let within = (n - row).min(values.len() - i);
                    for (to, more) in s.q_xx[row * n + row..][..within].iter_mut().zip(same) {
                        *to += more;
                    }
                    continue;
                }
                let row = row - n;
                s.q_u[row] += a * error;
                for (j, &b) in values.iter().enumerate() {
                    let column = start + j;
                    if column < n {
                        s.q_ux[row * n + column] += a * b;
                    } else {
                        s.q_uu[row * m + column - n] += a * b;
                    }
                }
            }
        }
    }
}

/// The law that minimizes the model, and the value that it leaves, in `q_xx` and `q_x`. The margin is the smallest
/// share that remains in a subtraction.
#[inline(always)]
fn minimize(
    s: &mut Scratch,
    bounds: Option<Bounds<'_>>,
    (gain, offset): (&mut [f64], &mut [f64]),
    (model, margin): (&mut Model, &mut f64),
) {
    let (n, m) = (s.sizes.state(), s.sizes.controls);
    let within = |i: usize| bounds.map_or((f64::NEG_INFINITY, f64::INFINITY), |of| (of.lower[i], of.upper[i]));
    *margin = f64::NEG_INFINITY;
    if !s.boxed.minimize(&s.q_uu, &s.q_u, within, offset) {
        return;
    }
    let (free, factor) = (s.boxed.free(), s.boxed.factor());
    let count = free.len();
    *margin = f64::INFINITY;
    for (a, &i) in free.iter().enumerate() {
        // The share of a pivot in its entry of the diagonal.
        let root = factor[a * m + a];
        *margin = margin.min(root * root / s.q_uu[i * m + i]);
    }
    let y = &mut s.y[..count * n];
    for (row, &i) in y.chunks_exact_mut(n.max(1)).zip(free) {
        row.copy_from_slice(&s.q_ux[i * n..][..n]);
    }
    solve_lower((factor, m), count, y, n);
    let mut largest: f64 = 0.0;
    for i in 0..n {
        s.before[i] = s.q_xx[i * n + i];
        largest = largest.max(s.before[i]);
    }
    add_product(&mut s.q_xx, (Read::transposed(y, n), y), (n, count, n), (n, n), (-1.0, true));
    let mut remaining = f64::INFINITY;
    for i in 0..n {
        if s.before[i] > largest * f64::EPSILON {
            remaining = remaining.min(s.q_xx[i * n + i] / s.before[i]);
        }
    }
    *margin = margin.min(remaining.max(f64::MIN_POSITIVE));
    mirror(&mut s.q_xx, n);
    add_times(&mut s.q_x, Read::transposed(&s.q_ux, n), &*offset, 1.0);
    solve_upper((factor, m), count, y, n);
    gain.fill(0.0);
    for (row, &i) in y.chunks_exact(n.max(1)).zip(free) {
        gain[i * n..][..n].copy_from_slice(row);
    }
    model.slope = offset.iter().zip(&s.q_u).map(|(k, q)| k * q).sum();
    model.curvature = (0..m).map(|i| offset[i] * (0..m).map(|j| s.q_uu[i * m + j] * offset[j]).sum::<f64>()).sum();
}
