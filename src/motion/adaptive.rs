//! Adaptive integration to a tolerance with the solvers of diffsol, in tangent coordinates about a center
//! configuration.
//!
//! With a center q0, a configuration has coordinates x (nv). A joint of one axis adds its coordinate. A spherical joint
//! rotates by the rotation vector w, R = R0 exp(w). A free joint has the position p0 + R0 a and the same rotation. For
//! the body velocity (b, u), linear and angular,
//!
//! ```text
//! da/dt = exp(w) b,    dw/dt = u + w x u/2 + c w x (w x u),    c = (1 - (t/2) cot(t/2))/t^2,  t = |w|
//! ```
//!
//! Hence (x, v) is a vector, and the solver controls the error on the manifold. The chart is valid for |w| < 2 pi.
//! After a step that ends beyond 1 rad, the center moves to the current configuration and the solver restarts.

use super::manifold::advance;
use super::method::Method;
use super::properties::{FRICTION_SPEED, Gains, Properties, joint_of_row};
use super::scratch::Scratch;
use super::solver::Checked;
use super::step::accelerations;
use super::step_settings::StepSettings;
use crate::error::Error;
use crate::filter::Form;
use crate::interrupt;
use crate::joints::quaternion::quaternion_rotation;
use crate::scene::Scene;
use crate::setters::setters;
use diffsol::error::OdeSolverError;
use diffsol::{
    DiffsolError, NalgebraLU, NalgebraMat, NalgebraVec, OdeBuilder, OdeEquations, OdeSolverMethod, OdeSolverStopReason,
    Vector,
};
use nalgebra::{UnitQuaternion, Vector3};
use std::cell::RefCell;

/// Rotation from the center, rad, beyond which the center moves.
const TURNED: f64 = 1.0;

/// Half the distance of the two states of a central difference, relative to the larger of 1 and the largest entry: the
/// cube root of eps, which balances truncation and rounding errors.
const DIFFERENCE: f64 = 6.055_454_452_393_343e-6;

/// The solver, which selects the steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Solver {
    /// Explicit, order 5 with an error estimate of order 4 (Tsitouras 2011), for smooth motion.
    #[default]
    Tsit45,
    /// Backward differentiation formulas of order 1 to 5, for stiff springs with damping and for tight tolerances.
    Bdf,
    /// Implicit, order 2, L-stable (Hosea and Shampine 1996): for undamped stiff springs at loose tolerances.
    TrBdf2,
    /// Implicit, order 3, L-stable (Jorgensen and others 2018): for undamped stiff springs.
    Esdirk34,
}

/// The applied torque as a function (t, q, qd, torque) that writes `torque` (nv), which is zero before the call.
pub type TorqueLaw<'a> = &'a dyn Fn(f64, &[f64], &[f64], &mut [f64]);

/// An initial value problem and its tolerances.
///
/// ```
/// use phipsi::motion::{Adaptive, Solver};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(2)?;
/// let problem = Adaptive::new(&scene).with_solver(Solver::Bdf);
/// let path = problem.solve(&[0.3; 2], &[0.0; 2], &[0.0, 0.5, 1.0], &|_t, _q, qd, torque| torque[0] = -0.1 * qd[0])?;
/// assert_eq!(path.q.len(), 3 * 2);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Adaptive<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The solver.
    pub solver: Solver,
    /// Bound on the error of a step in (x, v), relative to each entry.
    pub rtol: f64,
    /// Absolute bound on the error of a step: rad, m, rad/s, m/s.
    pub atol: f64,
    /// Armature, damping, springs and friction of the joints.
    pub properties: Properties,
    /// The control law, if any.
    pub gains: Option<Gains>,
    /// Largest number of steps of a solution.
    pub most_steps: usize,
}

/// States at the requested times.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct Solution {
    /// Times, (rows), s.
    pub t: Vec<f64>,
    /// Configurations, (rows, nq).
    pub q: Vec<f64>,
    /// Joint velocities, (rows, nv).
    pub qd: Vec<f64>,
    /// Number of steps.
    pub steps: usize,
    /// Number of evaluations of the right-hand side, including those for Jacobians.
    pub evaluations: usize,
    /// Number of centers.
    pub centers: usize,
}

/// An integration that failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("after {} steps, at t = {time} s: {error}", solution.steps)]
#[non_exhaustive]
pub struct Failure {
    /// The rows computed before the failure.
    pub solution: Box<Solution>,
    /// Time of the failure, s.
    pub time: f64,
    /// The error.
    pub error: Box<Error>,
}

impl From<Failure> for Error {
    fn from(failure: Failure) -> Self {
        *failure.error
    }
}

setters!(Adaptive<'a> {
    with_scene: scene: &'a Scene,
    with_solver: solver: Solver,
    with_rtol: rtol: f64,
    with_atol: atol: f64,
    with_properties: properties: Properties,
    with_gains: gains => Option<Gains>,
    with_most_steps: most_steps: usize,
});

impl<'a> Adaptive<'a> {
    /// The explicit solver with tolerances of 1e-9 and the joint properties of the scene.
    #[must_use]
    pub fn new(scene: &'a Scene) -> Self {
        Self {
            scene,
            solver: Solver::default(),
            rtol: 1e-9,
            atol: 1e-9,
            properties: Properties { friction_speed: FRICTION_SPEED, ..Properties::of(scene) },
            gains: None,
            most_steps: 10_000_000,
        }
    }

    /// Integrates from (`q`, `qd`) at the first of `times`, which must increase; `torque` is evaluated at every stage.
    /// The solver interpolates states at times between steps.
    ///
    /// One evaluation of the right-hand side is O(N). The implicit solvers need 4 nv evaluations per Jacobian (central
    /// differences) and O(nv^3) for its factorization.
    ///
    /// # Errors
    ///
    /// [`Failure`], with the rows computed so far, for invalid tolerances or times, wrong lengths, values that are not
    /// finite, negative properties, quaternions that are not of unit norm, a joint without inertia, torques that are
    /// not finite, a solver that fails, and more steps than `most_steps`.
    pub fn solve(&self, q: &[f64], qd: &[f64], times: &[f64], torque: TorqueLaw<'_>) -> Result<Solution, Failure> {
        let time = times.first().copied().unwrap_or(0.0);
        let refuse = |error| Failure { solution: Box::default(), time, error: Box::new(error) };
        self.check(q, qd, times).map_err(refuse)?;
        let field = RefCell::new(Field::new(self, torque));
        let mut course = Integration { adaptive: self, field: &field, times, solution: Solution::default() };
        course.row(time, q, qd);
        let outcome = course.run((time, q.to_vec(), qd.to_vec()));
        let mut solution = course.solution;
        solution.evaluations = field.borrow().evaluations;
        match outcome {
            Ok(()) => Ok(solution),
            Err((time, error)) => Err(Failure { solution: Box::new(solution), time, error: Box::new(error) }),
        }
    }

    fn check(&self, q: &[f64], qd: &[f64], times: &[f64]) -> Result<(), Error> {
        for (name, value) in [("rtol", self.rtol), ("atol", self.atol)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::argument(name, format!("{value}"), "a tolerance, finite and positive"));
            }
        }
        if times.is_empty() || !times.iter().all(|t| t.is_finite()) || !times.windows(2).all(|pair| pair[0] < pair[1]) {
            let found = match times.windows(2).find(|pair| !(pair[0] < pair[1])) {
                Some(pair) => format!("{} after {}", pair[1], pair[0]),
                None => format!("{times:?}"),
            };
            return Err(Error::argument("times", found, "finite increasing times, the first of which is the start"));
        }
        self.scene.check_no_connections("adaptive steps")?;
        self.scene.check_no_contacts("adaptive steps")?;
        self.properties.check(self.scene)?;
        if self.properties.friction_speed == 0.0 {
            let expected = "a positive speed, because the solvers need regularized friction";
            return Err(Error::argument("friction_speed", "0", expected));
        }
        if let Some(gains) = &self.gains {
            gains.check(self.scene, 1)?;
        }
        self.scene.check_configuration("q", q)?;
        self.scene.check_rates("qd", qd)
    }
}

/// The right-hand side in the coordinates about a center.
struct Field<'a> {
    scene: &'a Scene,
    settings: StepSettings,
    scratch: Scratch<f64>,
    solver: Checked,
    torque: TorqueLaw<'a>,
    center: Vec<f64>,
    /// The error of the last evaluation that failed, until it is taken.
    error: Option<Error>,
    evaluations: usize,
}

impl<'a> Field<'a> {
    fn new(of: &Adaptive<'a>, torque: TorqueLaw<'a>) -> Self {
        // Of the method only its explicitness matters, so that the mass matrix has no additional noise.
        let laws = (of.properties.clone(), of.gains.clone());
        let settings = StepSettings::new(of.scene.model(), 1.0, Method::RungeKutta4, laws, Vec::new());
        let mut scratch = Scratch::new(of.scene.model(), &settings);
        let solver = Checked::new(of.scene.model(), None, Form::Auto);
        if let Some(gains) = &of.gains {
            scratch.target.copy_from_slice(&gains.target);
            scratch.target_rate.copy_from_slice(&gains.target_rate);
        }
        Self { scene: of.scene, settings, scratch, solver, torque, center: Vec::new(), error: None, evaluations: 0 }
    }

    /// The configuration with the coordinates `x`.
    fn configuration(&self, x: &[f64], q: &mut [f64]) {
        let model = self.scene.model();
        advance(model, &self.center, x, q);
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            if body.motion.is_free() {
                let (at, row) = (body.q, stage.first_row);
                let moved =
                    quaternion_rotation(&self.center[at + 3..at + 7]) * Vector3::from_column_slice(&x[row..row + 3]);
                for i in 0..3 {
                    q[at + i] = self.center[at + i] + moved[i];
                }
            }
        }
    }

    /// dy/dt of y = (x, v); NaN if the evaluation fails.
    fn rate(&mut self, t: f64, y: &[f64], out: &mut [f64]) {
        self.evaluations += 1;
        let (x, v) = y.split_at(y.len() / 2);
        let (rates, qdd) = out.split_at_mut(y.len() / 2);
        let mut q = vec![0.0; self.scene.nq()];
        self.configuration(x, &mut q);
        let s = &mut self.scratch;
        s.torque.fill(0.0);
        (self.torque)(t, &q, v, &mut s.torque);
        let pushed = s.torque.iter().position(|u| !u.is_finite());
        s.set_stage(&q, v);
        accelerations(&self.settings, s, &mut self.solver);
        let lost = self.solver.lost.take();
        qdd.copy_from_slice(&s.m[0]);
        rates.copy_from_slice(v);
        let model = self.scene.model();
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            let row = stage.first_row;
            let triple = |of: &[f64], at: usize| Vector3::from_column_slice(&of[at..at + 3]);
            let Some((_, place)) = body.motion.quaternion() else { continue };
            let turning = row + place;
            if body.motion.is_free() {
                let turn = UnitQuaternion::from_scaled_axis(triple(x, turning));
                rates[row..row + 3].copy_from_slice((turn * triple(v, row)).as_slice());
            }
            let carried = rotation_vector_rate(&triple(x, turning), &triple(v, turning));
            rates[turning..turning + 3].copy_from_slice(carried.as_slice());
        }
        if let Some(row) = pushed {
            let found = format!("{} for joint {:?} at t = {t} s", s.torque[row], joint_of_row(self.scene, row));
            self.error = Some(Error::argument("torque", found, "torques that are finite"));
        } else if let Some(lost) = lost {
            self.error = Some(self.scene.singular(lost));
        } else {
            return;
        }
        out.fill(f64::NAN);
    }

    /// Directional derivative of dy/dt along `direction`, by a central difference.
    fn rate_along(&mut self, t: f64, y: &[f64], direction: &[f64], out: &mut [f64]) {
        let size = |x: &[f64]| x.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let long = size(direction);
        if long == 0.0 {
            out.fill(0.0);
            return;
        }
        let step = DIFFERENCE * size(y).max(1.0) / long;
        let moved = |step: f64| -> Vec<f64> { y.iter().zip(direction).map(|(y, d)| step.mul_add(*d, *y)).collect() };
        let mut behind = vec![0.0; y.len()];
        self.rate(t, &moved(step), out);
        self.rate(t, &moved(-step), &mut behind);
        for (out, behind) in out.iter_mut().zip(&behind) {
            *out = (*out - behind) / (2.0 * step);
        }
    }

    /// Largest rotation from the center, rad.
    fn rotated(&self, x: &[f64]) -> f64 {
        let model = self.scene.model();
        let angles = model.bodies.iter().zip(&model.system.stages).filter_map(|(body, stage)| {
            let at = stage.first_row + body.motion.quaternion()?.1;
            Some(Vector3::from_column_slice(&x[at..at + 3]).norm())
        });
        angles.fold(0.0, f64::max)
    }
}

/// Time derivative of the rotation vector `w` of a body with the angular velocity `u` in body axes.
fn rotation_vector_rate(w: &Vector3<f64>, u: &Vector3<f64>) -> Vector3<f64> {
    let t = w.norm();
    let square = t * t;
    // At t = 0.05 the series has a relative error of 1e-13, as large as the cancellation in 1 - (t/2) cot(t/2).
    let c = if t < 0.05 {
        1.0 / 12.0 + square * (1.0 / 720.0 + square / 30240.0)
    } else {
        (1.0 - 0.5 * t / (0.5 * t).tan()) / square
    };
    let once = w.cross(u);
    u + once * 0.5 + w.cross(&once) * c
}

/// The state of an integration.
struct Integration<'a, 'f> {
    adaptive: &'a Adaptive<'a>,
    field: &'f RefCell<Field<'a>>,
    times: &'a [f64],
    solution: Solution,
}

/// Time, configuration and joint velocities.
type State = (f64, Vec<f64>, Vec<f64>);

impl Integration<'_, '_> {
    fn row(&mut self, t: f64, q: &[f64], v: &[f64]) {
        self.solution.t.push(t);
        self.solution.q.extend_from_slice(q);
        self.solution.qd.extend_from_slice(v);
    }

    /// Integrates all segments, each with its own center.
    fn run(&mut self, mut state: State) -> Result<(), (f64, Error)> {
        let width = 2 * self.adaptive.scene.nv();
        while self.solution.t.len() < self.times.len() {
            let (t, q, v) = state;
            if width == 0 {
                // A scene without degrees of freedom.
                let next = self.times[self.solution.t.len()];
                self.row(next, &q, &v);
                state = (next, q, v);
                continue;
            }
            self.solution.centers += 1;
            let start = [vec![0.0; v.len()], v].concat();
            let mut rate = vec![0.0; width];
            {
                let mut field = self.field.borrow_mut();
                field.center = q;
                field.rate(t, &start, &mut rate);
            }
            if !rate.iter().all(|x| x.is_finite()) {
                return Err((t, self.cause("a time derivative that is not finite")));
            }
            state = self.segment(t, &start)?;
        }
        Ok(())
    }

    /// Integrates from `y` with the current center until a joint has rotated too far, or to the last time.
    fn segment(&mut self, t: f64, y: &[f64]) -> Result<State, (f64, Error)> {
        let field = self.field;
        let failed = |error: DiffsolError| (t, self.cause(&error.to_string()));
        let problem = OdeBuilder::<NalgebraMat<f64>>::new()
            .t0(t)
            .rtol(self.adaptive.rtol)
            .atol(vec![self.adaptive.atol; y.len()])
            .rhs_implicit(
                |y: &[f64], _p: &[f64], t: f64, out: &mut [f64]| field.borrow_mut().rate(t, y, out),
                |y: &[f64], _p: &[f64], t: f64, along: &[f64], out: &mut [f64]| {
                    field.borrow_mut().rate_along(t, y, along, out);
                },
            )
            .init(|_p: &[f64], _t: f64, out: &mut [f64]| out.copy_from_slice(y), y.len());
        let mut problem = problem.build().map_err(failed)?;
        // diffsol counts failures over the whole solution and would stop after 50.
        problem.ode_options.max_nonlinear_solver_failures = usize::MAX;
        match self.adaptive.solver {
            Solver::Tsit45 => self.steps(problem.tsit45().map_err(failed)?),
            Solver::Bdf => self.steps(problem.bdf::<NalgebraLU<f64>>().map_err(failed)?),
            Solver::TrBdf2 => self.steps(problem.tr_bdf2::<NalgebraLU<f64>>().map_err(failed)?),
            Solver::Esdirk34 => self.steps(problem.esdirk34::<NalgebraLU<f64>>().map_err(failed)?),
        }
    }

    /// Runs one solver and stores the rows that are due.
    fn steps<'p, E, S>(&mut self, mut solver: S) -> Result<State, (f64, Error)>
    where
        E: OdeEquations<T = f64, V = NalgebraVec<f64>> + 'p,
        S: OdeSolverMethod<'p, E>,
    {
        let (end, nv) = (self.times[self.times.len() - 1], self.adaptive.scene.nv());
        let at_end = match solver.set_stop_time(end) {
            Ok(()) => false,
            Err(DiffsolError::OdeSolverError(OdeSolverError::StopTimeAtCurrentTime)) => true,
            Err(error) => return Err((solver.state().t, self.cause(&error.to_string()))),
        };
        let mut reached = at_end;
        loop {
            let before = solver.state().t;
            if !reached {
                interrupt::check().map_err(|error| (before, error))?;
                if self.solution.steps == self.adaptive.most_steps {
                    let expected = "a solver for stiff motion, looser tolerances, or more steps";
                    return Err((
                        before,
                        Error::argument("most_steps", self.adaptive.most_steps.to_string(), expected),
                    ));
                }
                self.field.borrow_mut().error = None;
                match solver.step() {
                    Ok(reason) => reached = matches!(reason, OdeSolverStopReason::TstopReached),
                    Err(error) => return Err((before, self.cause(&error.to_string()))),
                }
                self.solution.steps += 1;
            }
            let (t, y) = (solver.state().t, solver.state().y.clone_as_vec());
            if !y.iter().all(|x| x.is_finite()) {
                return Err((before, self.cause("a state that is not finite")));
            }
            let mut q = vec![0.0; self.adaptive.scene.nq()];
            while let Some(&due) = self.times.get(self.solution.t.len())
                && (due <= t || reached)
            {
                let row = if due >= t {
                    y.clone()
                } else {
                    let between = solver.interpolate(due);
                    between.map_err(|error| (before, self.cause(&error.to_string())))?.clone_as_vec()
                };
                self.field.borrow().configuration(&row[..nv], &mut q);
                self.row(due, &q, &row[nv..]);
            }
            if reached || self.field.borrow().rotated(&y[..nv]) > TURNED {
                self.field.borrow().configuration(&y[..nv], &mut q);
                return Ok((t, q, y[nv..].to_vec()));
            }
        }
    }

    /// The reason for a failed step: the error of the right-hand side if there is one, else that of the solver.
    fn cause(&self, solver: &str) -> Error {
        let known = self.field.borrow_mut().error.take();
        known.unwrap_or_else(|| {
            let found = format!("{solver} ({:?})", self.adaptive.solver);
            Error::argument("solver", found, "a motion that it can integrate: use another solver or other tolerances")
        })
    }
}
