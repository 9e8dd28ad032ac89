//! The method `Scene.optimize`, and the compiled part of `phipsi.control`: an optimizer with its memory.

use super::errors::refuse;
use super::interrupts::detached;
use super::inverse_kinematics::all_aimed;
use super::object::{Object, imported};
use super::output::from_numbers;
use super::scene::PyScene;
use super::threads::free;
use crate::batch::broadcast_axes;
use crate::control::{Cost, Optimizer, Problem, Residual, Start, Term};
use crate::error::Error;
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

methods_in_python! {
    /// Motion of least cost with its feedback law: iterative LQR with limits of effort and other inequalities.
    #[doc = section!(Parameters)]
    /// q0 : (nq,) array_like
    ///     Initial configuration.
    /// qd0 : (nv,) array_like, optional
    ///     Initial joint velocities; None: at rest.
    /// dt : float
    ///     Time step, s.
    /// steps : int
    ///     Number of steps.
    /// costs : term or list of terms
    ///     Terms of phipsi.control (State, Effort, EffortRate, Function) and tasks of phipsi.tasks: half the squares of
    ///     errors divided by their standard deviations, times dt, at the knots before each step. Terminal(term) acts at
    ///     the end and is not multiplied by dt, During(term, first, last) at some knots. A leading axis of the target
    ///     of a task is that of its knots. NotPositive(function) is an inequality instead of a cost.
    /// tau : (nv,) or (steps, nv) array_like, optional
    ///     First joint torques; None: those that hold q0 against gravity.
    /// start : MotionPlan or tuple of array_like, optional
    ///     First q (steps, nq) and qd (steps, nv) of the knots after q0, which the torques need not lead to (multiple
    ///     shooting), as from MotionPlan.shift; None: the motion of the first torques.
    /// effort : bool or array_like, default True
    ///     Limits of the torques: True: those of the joints; None: no limits; numbers, (nv,) or (2, nv) with smallest and
    ///     largest torques. A joint with the limit 0 has no control, nor has a floating base.
    /// limits : bool, default True
    ///     If true, positions and speeds stay within the limits of the joints, at the knots after the start.
    /// iterations : int, default 100
    ///     Largest number of iterations; 0: only the feedback law about the start.
    /// tolerance : float, default 1e-6
    ///     The search ends when the model has a decrease of at most this share of the cost.
    /// limit_tolerance : float, default 1e-6
    ///     Largest violation of an inequality, in its unit.
    /// friction_speed : float, default 0.2
    ///     Speed below which friction is viscous, rad/s or m/s; smaller values are nearer to dry friction and need more
    ///     iterations.
    /// smoothing : float, default 0
    ///     Length by which contacts are relaxed, m, as in Scene.simulate, so that a search finds contacts that the first
    ///     motion does not have; 0: contacts do not act.
    /// uncertainty : phipsi.estimation.MotionUncertainty or covariance, optional
    ///     Uncertainty of the start, the parameters and the torques, as of MotionPlan.expected: the plan has the least
    ///     expected cost under its law, instead of the least cost of the motion. None: no uncertainty.
    #[doc = section!(Returns)]
    /// plan : phipsi.control.MotionPlan
    ///     q, qd, tau, gains, cost, converged, reason and history, with policy, shift, resume, show and save.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     Friction curves, and friction of joints that others follow; terms and limits that do not fit; smoothing with
    ///     connections, with joints that follow others, and with contacts that rebound.
    /// ConstraintError
    ///     A start that violates the connections.
    #[doc = entries!(arguments)]
    #[doc = section!(Warns)]
    /// PlanWarning
    ///     A contact or two shapes that touch along the plan, which is made without contacts: points that stay in contact
    ///     are connections, and smoothing lets contacts act. Connections that the steps of the plan leave by more than 1 mm.
    #[doc = section!(Notes)]
    /// A step is v' = v + dt a, q' = integrate(q, dt v'), that of simulate(method="implicit-euler"): springs, damping and
    /// friction act at its end (those of joints that others follow at its start, as of simulate with
    /// "semi-implicit-euler"), and accelerations satisfy the connections. With limits=False joints pass their stops.
    ///
    /// With smoothing, v' is the velocity after a step of simulate(smoothing=...) with method="contact", and its derivatives
    /// are adjoints of that step, one for each joint velocity.
    ///
    /// The Riccati recursion of the linear-quadratic model about the motion is the Kalman filter of the dynamics, run
    /// from the end of the time to its start; the second derivatives are those of Gauss and Newton. Stages in which it
    /// cancels are computed again in array form. Step lengths are tried in lanes. O(steps nv^3) per iteration. Inequalities
    /// are an augmented Lagrangian. Results have the same bits on any number of threads.
    ///
    /// With an uncertainty, the plan of least cost is moved along the gradient of the expected cost, of which the change
    /// of the law is a part, until it has no further decrease: each change is a search.
    #[doc = section!(Examples)]
    /// >>> from phipsi import control
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> goal = control.Terminal(phipsi.tasks.Position("link6", (0.5, 0.1, 0.4)))
    /// >>> plan = scene.optimize([0.1] * 6, dt=0.02, steps=50, costs=[control.Effort(10.0), goal])
    /// >>> plan.converged, bool(abs(scene.placement(plan.q[-1], "link6")[:3, 3] - [0.5, 0.1, 0.4]).max() < 1e-3)
    /// (True, True)
    #[pyo3(text_signature = "($self, q0, qd0=None, *, dt, steps, costs, tau=None, start=None, effort=True, limits=True, \
                             iterations=100, tolerance=1e-6, limit_tolerance=1e-6, friction_speed=0.2, \
                             smoothing=0.0, uncertainty=None)")]
    fn optimize(q0, qd0 = None) = "phipsi.control._plan", "optimize";
}

/// A term of phipsi.control: kind, first and last knot, whether it is an inequality, and its arguments.
type GivenTerm<'py> = (String, usize, usize, bool, Object<'py>);

/// The first exception that a function of the caller raised.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// A function of the caller: (q, qd, tau) to the residuals and their derivatives.
struct Function {
    call: Py<PyAny>,
    count: usize,
    sizes: [usize; 2],
    raised: Raised,
}

impl Residual for Function {
    fn count(&self) -> usize {
        self.count
    }

    fn evaluate(
        &self,
        [q, qd, tau]: [&[f64]; 3],
        residuals: &mut [f64],
        derivatives: [&mut [f64]; 3],
    ) -> Result<(), Error> {
        let [nq, nv] = self.sizes;
        let knots = qd.len() / nv.max(1);
        let called = Python::attach(|py| -> PyResult<()> {
            let arrays = [(q, nq), (qd, nv), (tau, nv)].map(|(all, width)| from_numbers(py, all, &[knots, width]));
            let [q, qd, tau] = arrays;
            let found = self.call.bind(py).call1((q?, qd?, tau?))?;
            let (found, by) = found.extract::<(PyReadonlyArray2<'_, f64>, [PyReadonlyArray3<'_, f64>; 3])>()?;
            residuals.copy_from_slice(found.as_slice()?);
            for (to, by) in derivatives.into_iter().zip(&by) {
                to.copy_from_slice(by.as_slice()?);
            }
            Ok(())
        });
        called.map_err(|raised| {
            self.raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(raised);
            Error::argument("costs", "a function that raised", "one that returns residuals and their derivatives")
        })
    }
}

/// An optimizer of one problem; phipsi.control.MotionPlan holds it.
#[pyclass(frozen, name = "_Optimizer", module = "phipsi._core")]
pub(crate) struct PyOptimizer {
    scene: Py<PyScene>,
    steps: usize,
    terms: usize,
    raised: Raised,
    has_functions: bool,
    optimizer: Mutex<Optimizer>,
}

#[pymethods]
impl PyOptimizer {
    /// Create an optimizer from arguments that phipsi.control has checked; effort (2, nv).
    #[new]
    fn new(
        scene: Py<PyScene>,
        times: (f64, usize),
        terms: Vec<GivenTerm<'_>>,
        effort: Option<[Vec<f64>; 2]>,
        has_limits: bool,
        settings: (f64, f64, f64, f64),
    ) -> PyResult<Self> {
        let (raised, (dt, steps), own) = (Raised::default(), times, scene.get());
        let mut problem = Problem::new(&own.scene, dt, steps);
        problem.costs = own.terms(&terms, &raised)?;
        if has_limits {
            problem.costs.extend(Problem::limits_of(&own.scene, steps));
        }
        if let Some(effort) = effort {
            problem.effort = effort;
        }
        (problem.tolerance, problem.limit_tolerance, problem.friction_speed, problem.smoothing) = settings;
        let has_functions = terms.iter().any(|given| given.0 == "function");
        let optimizer = Optimizer::new(&own.scene, problem)?;
        Ok(Self { scene, steps, terms: terms.len(), raised, has_functions, optimizer: Mutex::new(optimizer) })
    }

    /// Replace the targets of terms, which are as many and of the same kinds.
    fn retarget(&self, terms: Vec<GivenTerm<'_>>) -> PyResult<()> {
        if terms.len() != self.terms {
            let (found, expected) = (format!("{} terms", terms.len()), format!("{}, as before", self.terms));
            return refuse("costs", found, expected);
        }
        let new = self.scene.get().terms(&terms, &self.raised)?;
        Ok(self.optimizer()?.set_costs(new)?)
    }

    /// Search from q0 (nq,) and qd0 (nv,), first efforts (steps, nv) and states (steps, nq) and (steps, nv).
    ///
    /// Returns q, qd, tau, gains (steps, nv, n), whether it converged, the cost, the reason, and the history (k, 7).
    fn solve<'py>(
        &self,
        py: Python<'py>,
        state: (PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, f64>),
        tau: Option<PyReadonlyArray2<'py, f64>>,
        states: Option<(PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>)>,
        iterations: usize,
    ) -> PyResult<([Object<'py>; 4], bool, f64, &'static str, Object<'py>)> {
        let mut guard = self.optimizer()?;
        let optimizer = &mut *guard;
        optimizer.set_iterations(iterations);
        let tau = tau.as_ref().map(|tau| tau.as_slice()).transpose()?;
        let states = states.as_ref().map(|(q, qd)| Ok::<_, PyErr>([q.as_slice()?, qd.as_slice()?])).transpose()?;
        let start = Start { q: state.0.as_slice()?, qd: state.1.as_slice()?, tau: tau.unwrap_or_default(), states };
        let done = if self.has_functions { optimizer.solve(&start) } else { detached(py, || optimizer.solve(&start))? };
        let raised = self.raised.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(raised) = raised {
            return Err(raised);
        }
        let outcome = done?;
        let scene = &self.scene.get().scene;
        let (nq, nv, steps, n) = (scene.nq(), scene.nv(), self.steps, optimizer.state_width());
        let (gains, driven) = optimizer.gains();
        let m = driven.len();
        let mut all = vec![0.0; steps * nv * n];
        for step in 0..steps {
            for (control, row) in driven.iter().enumerate() {
                all[(step * nv + row) * n..][..n].copy_from_slice(&gains[(step * m + control) * n..][..n]);
            }
        }
        let motion = optimizer.motion();
        let history: Vec<f64> = outcome.history.iter().flat_map(numbers_of).collect();
        let arrays = [
            from_numbers(py, &motion.q, &[steps + 1, nq])?,
            from_numbers(py, &motion.qd, &[steps + 1, nv])?,
            from_numbers(py, &motion.tau, &[steps, nv])?,
            from_numbers(py, &all, &[steps, nv, n])?,
        ];
        let history = from_numbers(py, &history, &[outcome.history.len(), WIDTH])?;
        Ok((arrays, outcome.converged, outcome.cost, outcome.reason, history))
    }

    /// A (steps, n, n), B (steps, n, m), the derivatives of (q, qd) by torques (steps, 2 nv, nv) and the second
    /// derivatives of the cost by (x, u) (steps + 1, n + m, n + m) about the last motion, and the degrees of freedom
    /// with a control.
    fn linearization<'py>(&self, py: Python<'py>) -> PyResult<([Object<'py>; 4], Vec<usize>)> {
        let mut optimizer = self.optimizer()?;
        let found = optimizer.linearization()?;
        let (n, driven) = (optimizer.state_width(), optimizer.gains().1.to_vec());
        let (m, steps, nv) = (driven.len(), self.steps, self.scene.get().scene.nv());
        let arrays = [
            from_numbers(py, &found.a, &[steps, n, n])?,
            from_numbers(py, &found.b, &[steps, n, m])?,
            from_numbers(py, &found.by_torque, &[steps, 2 * nv, nv])?,
            from_numbers(py, &found.hessian, &[steps + 1, n + m, n + m])?,
        ];
        Ok((arrays, driven))
    }
}

/// Columns of the history.
const WIDTH: usize = 7;

#[allow(clippy::cast_precision_loss)] // counts
fn numbers_of(of: &crate::control::Iteration) -> [f64; WIDTH] {
    [of.cost, of.expected, of.length, of.damping, of.defects, of.violation, of.array_stages as f64]
}

impl PyOptimizer {
    fn optimizer(&self) -> Result<MutexGuard<'_, Optimizer>, Error> {
        free(&self.optimizer, "plan", "a plan for each thread")
    }
}

impl PyScene {
    fn terms(&self, given: &[GivenTerm<'_>], raised: &Raised) -> PyResult<Vec<Cost>> {
        given.iter().enumerate().map(|(at, given)| self.term(at, given, raised)).collect()
    }

    /// A term from its arguments.
    fn term(&self, at: usize, given: &GivenTerm<'_>, raised: &Raised) -> PyResult<Cost> {
        let &(ref kind, first, last, is_limit, ref arguments) = given;
        let numbers = |at: usize| -> PyResult<Vec<f64>> {
            Ok(arguments.get_item(at)?.extract::<PyReadonlyArray1<'_, f64>>()?.as_slice()?.to_vec())
        };
        let term = match kind.as_str() {
            "tasks" => {
                let neutral = from_numbers(arguments.py(), &self.scene.neutral(), &[self.scene.nq()])?;
                let (fixed, inputs) = self.tasks(arguments, ("q0", &neutral))?;
                let batch = broadcast_axes(inputs.iter().map(|input| (&*input.name, input.leading())))?;
                if batch.len() > 1 {
                    let found = format!("{batch:?} leading axes");
                    return Err(Error::shape(&format!("target of costs[{at}]"), found, "one, the steps").into());
                }
                let over = inputs.iter().map(|input| input.over(&batch)).collect::<PyResult<Vec<_>>>()?;
                let sets = (0..batch.first().copied().unwrap_or(1))
                    .map(|state| all_aimed(&fixed, &|input| over[input].state(state)))
                    .collect::<Result<Vec<_>, _>>()?;
                Term::Tasks(sets)
            }
            "state" => Term::State { q: numbers(0)?, qd: numbers(1)?, by_q: numbers(2)?, by_qd: numbers(3)? },
            "effort" => Term::Effort { tau: numbers(0)?, by_tau: numbers(1)? },
            "rate" => Term::EffortRate { by_rate: numbers(0)?, before: numbers(1)? },
            _ => Term::Own(Box::new(Function {
                call: arguments.get_item(0)?.unbind(),
                count: arguments.get_item(1)?.extract()?,
                sizes: [self.scene.nq(), self.scene.nv()],
                raised: raised.clone(),
            })),
        };
        Ok(Cost { term, first, last, is_limit })
    }
}
