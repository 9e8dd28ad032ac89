//! Wrenches on links in a simulation, as joint torques of the stages, and their adjoint.
//!
//! A wrench F = (moment, force) acts on a link at the origin of its frame, constant in the axes of the link or of the
//! base during a step. In a stage at q it adds the joint torques J(q)^T F, which one sweep over the loaded bodies and
//! their ancestors computes, tip to base: f(k) = sum of phi f(child) + F, u(k) = H f(k). All methods, connections and
//! contacts then act as for other joint torques.
//!
//! The adjoint, for the cotangent l of the joint torques, differentiates p = l^T J(q)^T F = sum F(b) . V(b), with the
//! velocities V of the bodies at joint velocities l. The gradient by F is V of the link. Perturb joint k by the twist s
//! in its body frame. Relative to the bodies at and beyond k the base moves by -s, so that their V changes by
//! -s x `V_p`, with the velocity `V_p` of the parent; the twist also rotates the link beneath a wrench F = (n, f) on
//! the axes of the base, whose components change by -s x n and -s x f. With all in the body frame,
//!
//! ```text
//! dp/ds = -V_p x* f(k) + t(k),    t(k) = sum over the links at and beyond k of the couple -(n x w + f x v)
//! ```
//!
//! with V = (w, v) of the link, and t only for wrenches on the axes of the base.

use super::method::Scheme;
use super::properties::of_state;
use crate::batch::instruction_set::{Vectorized, take_states};
use crate::error::{Error, by_name, check_finite, check_length, in_language, named};
use crate::kinematics::{Frame, ReferenceFrame, joint_motion, joint_shift};
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Scene;
use crate::setters::setters;
use crate::spatial::{RigidShift, angular, cross, cross_force, linear, product, spatial, sum, zero};
use nalgebra::{Matrix3, Vector3, Vector6};

named! {
    /// The axes in which the wrenches of a simulation are given. Both act at the origin of the link frame.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    #[non_exhaustive]
    enum WrenchFrame;
    /// The axes with their names in Python.
    const WRENCH_FRAMES {
        /// The axes of the link, with which the wrench rotates.
        #[default]
        Link = "link",
        /// The axes of the base: the direction is constant.
        World = "world",
    }
}

by_name!(WrenchFrame, "frame", WRENCH_FRAMES);

/// Wrenches (moment, force) on links in a simulation, N m and N, constant during each step; each acts at the origin of
/// the frame of its link. On a link of the base it has no effect.
///
/// ```
/// use phipsi::motion::{Settings, Simulator, Torque, Wrenches};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(2)?;
/// let tip = scene.links().last().map(|link| link.name.clone()).unwrap_or_default();
/// let mut settings = Settings::new(&scene, 1e-3);
/// settings.wrenches = Some(Wrenches::new([tip], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]));
/// let mut simulator = Simulator::new(&scene, settings, &[0.0; 2], &[0.0; 2])?;
/// simulator.step(&Torque::Zero, 10)?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Wrenches {
    /// Names of the links.
    pub links: Vec<String>,
    /// The wrenches, (links, 6), or (steps, links, 6), for all states or one after another for each.
    pub values: Vec<f64>,
    /// The number of steps of the run if each has its own wrenches.
    pub steps: Option<usize>,
    /// The axes of all wrenches.
    pub frame: WrenchFrame,
}

impl Wrenches {
    /// Wrenches on links, (links, 6), in their axes, the same in every step of every state.
    #[must_use]
    pub fn new(links: impl Into<Vec<String>>, values: impl Into<Vec<f64>>) -> Self {
        Self { links: links.into(), values: values.into(), steps: None, frame: WrenchFrame::default() }
    }
}

setters!(Wrenches {
    with_links: links => Vec<String>,
    with_values: values => Vec<f64>,
    with_steps: steps => Option<usize>,
    with_frame: frame: WrenchFrame,
});

/// Wrenches on the links of a scene.
#[derive(Debug, Clone)]
pub(super) struct LinkWrenches {
    pub given: Wrenches,
    links: Vec<Frame<f64>>,
    /// The loaded bodies and their ancestors, base to tip.
    bodies: Vec<usize>,
}

impl LinkWrenches {
    /// Checks the wrenches on links of a scene in a simulation of `states` states.
    pub fn new(given: Wrenches, scene: &Scene, states: usize) -> Result<Self, Error> {
        let [links, values] = in_language(["wrenches.links", "wrenches.values"], ["wrenches"; 2]);
        let frame_of = |name: &String| {
            let link = scene.link(name).map_err(|error| error.of_argument(links))?;
            Ok(Frame::from(link))
        };
        let frames = given.links.iter().map(frame_of).collect::<Result<Vec<_>, Error>>()?;
        let width = 6 * frames.len() * given.steps.unwrap_or(1);
        if given.values.len() != width {
            check_length(values, given.values.len(), width * states)?;
        }
        check_finite(values, &given.values)?;
        let stages = &scene.model().system.stages;
        let mut is_loaded = vec![false; stages.len()];
        frames.iter().filter_map(|frame| frame.body).for_each(|body| is_loaded[body] = true);
        for (k, stage) in stages.iter().enumerate().rev() {
            if let Some(parent) = stage.parent {
                is_loaded[parent] |= is_loaded[k];
            }
        }
        let bodies = (0..stages.len()).filter(|&k| is_loaded[k]).collect();
        Ok(Self { given, links: frames, bodies })
    }

    /// The number of links.
    pub fn links(&self) -> usize {
        self.links.len()
    }

    /// The wrenches on all links of one state in step `n` of the run.
    fn of_step(&self, state: usize, n: usize) -> &[f64] {
        let (width, steps) = (6 * self.links.len(), self.given.steps.unwrap_or(1));
        let own = of_state(&self.given.values, width * steps, state);
        let at = if self.given.steps.is_some() { n * width } else { 0 };
        &own[at..at + width]
    }
}

/// The wrenches of a step, and the arrays of the sweeps; empty without wrenches.
#[derive(Debug)]
pub(super) struct WrenchScratch<T> {
    /// (moment, force) of each link, one after another.
    pub given: Vec<T>,
    /// Their joint torques in a stage, and the mean of those of all stages.
    pub torque: Vec<T>,
    mean: Vec<T>,
    /// Their work in the step, J, less that of the mean for the displacement by the stages.
    surplus: T,
    /// Per body: phi, the rotation to the base, the force of the wrenches at and beyond it, its couple, the velocity of
    /// its parent and its own, in its frame.
    shift: Vec<RigidShift<T>>,
    rotation: Vec<Matrix3<T>>,
    force: Vec<Vector6<T>>,
    couple: Vec<Vector3<T>>,
    carried: Vec<Vector6<T>>,
    velocity: Vec<Vector6<T>>,
}

impl<T: Real> Default for WrenchScratch<T> {
    fn default() -> Self {
        Self {
            given: Vec::new(),
            torque: Vec::new(),
            mean: Vec::new(),
            surplus: T::zero(),
            shift: Vec::new(),
            rotation: Vec::new(),
            force: Vec::new(),
            couple: Vec::new(),
            carried: Vec::new(),
            velocity: Vec::new(),
        }
    }
}

impl<T: Real> WrenchScratch<T> {
    /// Makes room for the wrenches on `links` links.
    pub fn prepare(&mut self, model: &Model<T>, links: usize) {
        let (bodies, nan) = (model.bodies.len(), T::from_f64(f64::NAN));
        self.given.resize(6 * links, nan);
        self.torque.resize(model.nv(), T::zero());
        self.mean.resize(model.nv(), T::zero());
        self.shift.resize(bodies, RigidShift::filled(nan));
        self.rotation.resize(bodies, Matrix3::from_element(nan));
        self.couple.resize(bodies, Vector3::from_element(nan));
        for vectors in [&mut self.force, &mut self.carried, &mut self.velocity] {
            vectors.resize(bodies, Vector6::from_element(nan));
        }
    }

    /// Base to tip: phi of every body at `q`, and its rotation for wrenches on the axes of the base; and the forces of
    /// the wrenches on it.
    #[inline(always)]
    fn place(&mut self, model: &Model<T>, of: &LinkWrenches, q: &[T]) {
        for &k in &of.bodies {
            let shift = joint_shift(&model.bodies[k], q);
            if of.given.frame == WrenchFrame::World {
                self.rotation[k] = match model.system.stages[k].parent {
                    Some(parent) => product(&self.rotation[parent], &shift.rotation),
                    None => shift.rotation,
                };
            }
            self.shift[k] = shift;
            self.force[k] = zero();
        }
        for (i, link) in of.links.iter().enumerate() {
            let Some(body) = link.body else { continue };
            let placement = link.placement.cast();
            let wrench = self.in_link(of, (i, body), &placement);
            self.force[body] = sum(&self.force[body], &placement.force_to_parent(&wrench));
        }
    }

    /// The pose of a link with the rotation to the base.
    #[inline(always)]
    fn axes(&self, body: usize, placement: &RigidShift<T>) -> RigidShift<T> {
        RigidShift { rotation: product(&self.rotation[body], &placement.rotation), lever: placement.lever }
    }

    /// The wrench on link `i` of a body in the axes of the link.
    #[inline(always)]
    fn in_link(&self, of: &LinkWrenches, (i, body): (usize, usize), placement: &RigidShift<T>) -> Vector6<T> {
        let wrench = Vector6::from_column_slice(&self.given[6 * i..6 * i + 6]);
        match of.given.frame {
            WrenchFrame::Link => wrench,
            WrenchFrame::World => {
                let axes = self.axes(body, placement);
                spatial(&axes.rotate_back(&angular(&wrench)), &axes.rotate_back(&linear(&wrench)))
            }
        }
    }

    /// Before the first stage of a step.
    #[inline(always)]
    pub fn begin(&mut self) {
        self.torque.fill(T::zero());
        self.mean.fill(T::zero());
        self.surplus = T::zero();
    }

    /// Tip to base: adds the torques J(q)^T F to `u`, and to their mean with the `weight` of the stage.
    #[inline(always)]
    pub fn add_torques(&mut self, model: &Model<T>, of: &LinkWrenches, q: &[T], (u, weight): (&mut [T], f64)) {
        self.place(model, of, q);
        for &k in of.bodies.iter().rev() {
            let stage = &model.system.stages[k];
            for i in 0..stage.rows.count() {
                let (row, torque) = (stage.first_row + i, stage.rows.row(i).project(&self.force[k]));
                u[row] += torque;
                self.torque[row] = torque;
                self.mean[row] = torque.mul_add(torque.constant(weight), self.mean[row]);
            }
            if let Some(parent) = stage.parent {
                self.force[parent] = sum(&self.force[parent], &self.shift[k].force_to_parent(&self.force[k]));
            }
        }
    }

    /// Adds the gradients by q, in its tangent space, and by the wrenches of `by_u` . J(q)^T F.
    #[inline(always)]
    pub fn add_gradients(
        &mut self,
        model: &Model<T>,
        of: &LinkWrenches,
        q: &[T],
        by_u: &[T],
        (by_q, by_wrenches): (&mut [T], &mut [T]),
    ) {
        self.place(model, of, q);
        for &k in &of.bodies {
            let stage = &model.system.stages[k];
            self.carried[k] = match stage.parent {
                Some(parent) => self.shift[k].motion_to_child(&self.velocity[parent]),
                None => zero(),
            };
            self.velocity[k] = sum(&self.carried[k], &joint_motion(&model.bodies[k], stage.first_row, by_u));
            self.couple[k] = angular(&zero());
        }
        for (i, link) in of.links.iter().enumerate() {
            let Some(body) = link.body else { continue };
            let placement = link.placement.cast();
            let velocity = placement.motion_to_child(&self.velocity[body]);
            let (w, v) = (angular(&velocity), linear(&velocity));
            let gradient = match of.given.frame {
                WrenchFrame::Link => velocity,
                WrenchFrame::World => {
                    let wrench = self.in_link(of, (i, body), &placement);
                    let couple = cross(&angular(&wrench), &w) + cross(&linear(&wrench), &v);
                    self.couple[body] -= placement.rotate(&couple);
                    ReferenceFrame::LocalWorldAligned.express(&self.axes(body, &placement), &velocity)
                }
            };
            by_wrenches[6 * i..6 * i + 6].iter_mut().zip(&gradient).for_each(|(sum, &more)| *sum += more);
        }
        for &k in of.bodies.iter().rev() {
            let stage = &model.system.stages[k];
            let (shift, force, couple) = (&self.shift[k], self.force[k], self.couple[k]);
            let gradient = spatial(&couple, &linear(&zero())) - cross_force(&self.carried[k], &force);
            for i in 0..stage.rows.count() {
                by_q[stage.first_row + i] += stage.rows.row(i).project(&gradient);
            }
            if let Some(parent) = stage.parent {
                self.force[parent] = sum(&self.force[parent], &shift.force_to_parent(&force));
                self.couple[parent] += shift.rotate(&couple);
            }
        }
    }

    /// Adds the work of the wrenches in stage `i`: that of its torques at the joint velocities with which it moves.
    #[inline(always)]
    pub fn add_work_of_stage(&mut self, scheme: &Scheme, i: usize, (v_stage, m): (&[T], &[Vec<T>])) {
        let t = &scheme.tableau;
        for (row, &torque) in self.torque.iter().enumerate() {
            let mut v = v_stage[row];
            for (m, &gamma) in m.iter().zip(&t.gamma[i][..=i]) {
                v = m[row].mul_add(v.constant(gamma), v);
            }
            self.surplus = (torque * v).mul_add(v.constant(t.weights[i]), self.surplus);
        }
    }

    /// Subtracts the work of the mean torques for the displacement `x` of all stages. That for the displacement of the
    /// step, in which contacts, connections and stops act too, is part of [`WrenchScratch::work`].
    #[inline(always)]
    pub fn end_work_of_stages(&mut self, x: &[T]) {
        for (&mean, &x) in self.mean.iter().zip(x) {
            self.surplus = self.surplus.minus_product(mean, x);
        }
    }

    /// The work of the wrenches in a step with displacement `x`, J.
    #[inline(always)]
    pub fn work(&self, x: &[T]) -> T {
        self.mean.iter().zip(x).fold(self.surplus, |sum, (&mean, &x)| mean.mul_add(x, sum))
    }
}

impl<T: Vectorized> WrenchScratch<T> {
    /// Takes the wrenches of the state of each lane in step `n`.
    #[inline(always)]
    pub fn take(
        &mut self,
        model: &Model<T>,
        of: &LinkWrenches,
        (n, count): (usize, usize),
        state: impl Fn(usize) -> usize,
    ) {
        self.prepare(model, of.links());
        take_states(&mut self.given, count, |lane| of.of_step(state(lane), n));
    }
}
