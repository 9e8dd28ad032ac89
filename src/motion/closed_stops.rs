//! Joint stops of scenes with connections. A step that would end beyond a limit is repeated with impulses at the active
//! limits, as in the first-order time stepping of J. J. Moreau.
//!
//! ```text
//! v_free: velocities at the end without stops, on the connections
//! W: columns P M^-1 e_j, with P the projection onto the connections of least kinetic energy
//! 0 <= u + gap/h perpendicular to p >= 0, u = e_j (v_free + W p)    q' = q exp(h (v_free + W p)), on the connections
//! 0 <= u - e max(-u_start, 0) perpendicular to p >= 0               v' = v_free + W p, on the connections
//! ```

use super::constrained::{Constrained, Failure};
use super::limit_rows::{least_velocity, rebounds, settle_at};
use super::manifold::advance;
use super::scratch::Scratch;
use super::step_settings::StepSettings;
use super::substeps::StopImpact;
use super::totals::STOPS;
use crate::contact::{Cone, Effort, Limits, SolveReport, expansion_kept};
use crate::dynamics::contacts::LimitRow;
use crate::dynamics::{factorise, solve};
use crate::error::{Error, in_language};
use nalgebra::{DMatrix, DVector};

/// A limit that was inactive becomes active if the step ends further outside than this, rad or m.
const LATE: f64 = 1e-12;

/// A joint that the projection onto the connections moves further beyond its limit than this, rad or m, is corrected,
/// at most this number of times.
const CURVED: f64 = 1e-9;
const CORRECTIONS: usize = 3;

/// A residual above this is an error.
const REFUSED: f64 = 1e-5;

/// True if a step ends beyond a limit, or begins there, so that its stop acts.
pub(super) fn is_past(limit: &LimitRow, s: &Scratch<f64>) -> bool {
    !(limit.gap(&s.q_next) >= -LATE) || limit.gap(&s.q) < 0.0
}

/// The active limits of a step.
struct Acting {
    near: Vec<usize>,
    /// P M^-1 `e_j` of each active limit, directed away from the limit.
    columns: Vec<Vec<f64>>,
    cone: Cone,
}

impl Constrained<'_> {
    /// Keeps joints within their limits: repeats the step with stops if `q_next` is beyond a limit, and returns the
    /// impacts.
    pub(super) fn stop(
        &mut self,
        settings: &StepSettings,
        limits: &[LimitRow],
        s: &mut Scratch<f64>,
    ) -> Result<Vec<StopImpact>, Failure> {
        let is_finite = s.q_next.iter().chain(&s.v_next).all(|x| x.is_finite());
        if !is_finite || !limits.iter().any(|limit| is_past(limit, s)) {
            return Ok(Vec::new());
        }
        let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
        let outcome = self.stopped(settings, limits, s);
        s.model.system.noise = noise;
        outcome
    }

    fn stopped(
        &mut self,
        settings: &StepSettings,
        limits: &[LimitRow],
        s: &mut Scratch<f64>,
    ) -> Result<Vec<StopImpact>, Failure> {
        let h = settings.step;
        let mut free = s.v_next.clone();
        self.velocities_onto_connections(&s.model, &s.q, &mut free)?;
        let start: Vec<f64> = limits.iter().map(|limit| limit.velocity(&s.v)).collect();
        let least: Vec<f64> =
            limits.iter().zip(&start).map(|(limit, &u)| least_velocity(limit.gap(&s.q), u, h)).collect();
        let mut acting =
            Acting { near: Vec::new(), columns: Vec::new(), cone: Cone::new(DMatrix::zeros(0, 0), vec![]) };
        let mut bent = vec![0.0; limits.len()];
        for correction in 0..=CORRECTIONS {
            let mut next = free.clone();
            for _ in 0..=limits.len() {
                let wanted = |i: usize| least[i] - bent[i];
                if !acting.near.is_empty() {
                    let impulses = self.solved(&acting, &free, wanted, limits)?;
                    next = acting.moved(&free, &impulses);
                }
                let ends = |i: usize| h * (limits[i].velocity(&next) - wanted(i));
                let late = |&i: &usize| !acting.near.contains(&i) && ends(i) < -LATE;
                let late: Vec<usize> = (0..limits.len()).filter(late).collect();
                if late.is_empty() {
                    break;
                }
                self.join(&mut acting, &late, limits, s)?;
            }
            for (x, v) in s.x.iter_mut().zip(&next) {
                *x = h * v;
            }
            advance(&s.model, &s.q, &s.x, &mut s.q_next);
            self.positions_onto_connections(&s.model, &mut s.q_next, None)?;
            // The projection moves joints because of the curvature of the connections.
            let mut worst = 0.0_f64;
            for (i, limit) in limits.iter().enumerate() {
                let straight = limit.gap(&s.q) + h * limit.velocity(&next);
                let gap = limit.gap(&s.q_next);
                bent[i] = (gap - straight) / h;
                worst = worst.max(straight.min(0.0) - gap);
            }
            if worst <= CURVED || correction == CORRECTIONS {
                break;
            }
        }
        // Velocities at the end: zero at the stops, or rebound velocities limited so that the kinetic energy does not
        // increase.
        let u = acting.rows(|i| limits[i].velocity(&free));
        let returning = |i: usize| if limits[i].gap(&s.q) < 0.0 { least[i] } else { 0.0 };
        let rest = self.solved(&acting, &free, returning, limits)?;
        let back = |i: usize| {
            let speed = limits[i].velocity(&free);
            if rebounds(start[i], speed, settings.restitution) {
                -settings.restitution * start[i]
            } else {
                returning(i)
            }
        };
        let mut all = rest.clone();
        let elastic = acting.near.iter().any(|&i| back(i) > returning(i));
        if elastic {
            let bounced = self.solved(&acting, &free, back, limits)?;
            let more = bounced - &rest;
            all += &more * expansion_kept(&acting.cone, &u, &rest, &more);
        }
        s.v_next = acting.moved(&free, &all);
        self.velocities_onto_connections(&s.model, &s.q_next, &mut s.v_next)?;
        let mut impacts = Vec::new();
        for (at, &i) in acting.near.iter().enumerate() {
            let (limit, impulse) = (&limits[i], all[3 * at + 2]);
            let rests = (!elastic && impulse > 0.0).then(|| returning(i));
            impacts.extend(settle_at(limit, (h, start[i]), (impulse, rests), (&mut s.q_next, &mut s.v_next)));
            s.totals[STOPS] += 0.5 * impulse * limit.sign() * (s.v[limit.row] + s.v_next[limit.row]);
        }
        Ok(impacts)
    }

    /// Adds limits to the active set.
    fn join(
        &mut self,
        acting: &mut Acting,
        late: &[usize],
        limits: &[LimitRow],
        s: &Scratch<f64>,
    ) -> Result<(), Failure> {
        // Factors M at q for the projections below; a singular pivot has ended the step before.
        factorise(&s.model, &mut self.scratch.workspace, &s.q);
        for &i in late {
            let (mut torque, mut column) = (vec![0.0; s.v.len()], vec![0.0; s.v.len()]);
            torque[limits[i].row] = limits[i].sign();
            solve(&s.model, &mut self.scratch.workspace, &torque, &mut column);
            self.velocities_onto_connections(&s.model, &s.q, &mut column)?;
            acting.near.push(i);
            acting.columns.push(column);
        }
        let n = acting.near.len();
        let mut g = DMatrix::zeros(3 * n, 3 * n);
        for (a, &i) in acting.near.iter().enumerate() {
            for (b, column) in acting.columns.iter().enumerate() {
                g[(3 * a + 2, 3 * b + 2)] = limits[i].velocity(column);
            }
        }
        let symmetric = 0.5 * (&g + g.transpose());
        acting.cone = Cone::new(symmetric, vec![0.0; n]);
        Ok(())
    }

    /// Impulses for which the velocities `free` become at least `least`. If the connections prevent joints from
    /// returning or rebounding that fast, the condition is weakened to not moving further outside, which has a
    /// solution.
    fn solved(
        &self,
        acting: &Acting,
        free: &[f64],
        least: impl Fn(usize) -> f64,
        limits: &[LimitRow],
    ) -> Result<DVector<f64>, Failure> {
        let mut residual = f64::NAN;
        for most in [f64::INFINITY, 0.0] {
            let c = acting.rows(|i| limits[i].velocity(free) - least(i).min(most));
            // Contradictory rows are detected early; the weakened problem has a solution.
            let attempts = if most > 0.0 { 1 } else { usize::MAX };
            let effort = Effort { attempts, ..Effort::default() };
            let (impulses, solved): (_, SolveReport) = acting.cone.impulses(&c, None, &Limits::beside(&c), effort);
            if solved.residual <= REFUSED {
                return Ok(impulses);
            }
            residual = solved.residual;
        }
        let names = acting.near.iter().filter_map(|&i| {
            let row = limits[i].row;
            self.scene.joints().iter().find(|joint| joint.v.start == row).map(|joint| format!("{:?}", joint.name))
        });
        let argument = format!("limits of joints {}", names.collect::<Vec<_>>().join(", "));
        let found = format!("stops that contradict the connections, with a residual of {residual:.1e}");
        let expected = format!("a smaller dt, or {}", in_language("Limits::Report", "limits=\"report\""));
        Err((None, Some(Error::argument(argument, found, expected))))
    }
}

impl Acting {
    /// A vector with `of` in the normal rows of the active limits.
    fn rows(&self, of: impl Fn(usize) -> f64) -> DVector<f64> {
        DVector::from_fn(3 * self.near.len(), |row, _| if row % 3 == 2 { of(self.near[row / 3]) } else { 0.0 })
    }

    /// Velocities after the impulses.
    fn moved(&self, v: &[f64], impulses: &DVector<f64>) -> Vec<f64> {
        let mut moved = v.to_vec();
        for (at, column) in self.columns.iter().enumerate() {
            for (v, change) in moved.iter_mut().zip(column) {
                *v += change * impulses[3 * at + 2];
            }
        }
        moved
    }
}
