//! Sensitivity: the change of the exact result for a change of the model parameters or the state by one unit in the
//! last place.
//!
//! It is a lower bound for the error of any float64 program. A method with a much larger error is inaccurate; a large
//! sensitivity means that the problem is ill-conditioned. Exact results are computed in double-double arithmetic,
//! forward dynamics in square-root form.

use crate::dynamics;
use crate::dynamics::derivatives::{DerivativeScratch, forward_dynamics_derivatives};
use crate::error::{Error, named};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::{Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::workspace::Workspace;
use crate::{interrupt, memory};

named! {
    /// The computed quantity.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    #[non_exhaustive]
    enum Quantity;
    /// All quantities with their Python names.
    const QUANTITIES {
        /// Joint accelerations from torques, (nv,).
        ForwardDynamics = "forward dynamics",
        /// Joint torques from accelerations, (nv,).
        InverseDynamics = "inverse dynamics",
        /// The bias torque H phi b, (nv,).
        BiasTorque = "bias torque",
        /// The mass matrix, (nv x nv).
        MassMatrix = "mass matrix",
        /// The derivative of the accelerations by the tangent of q, (nv x nv).
        AccelerationDerivative = "derivative of forward dynamics",
    }
}

impl Quantity {
    /// Number of entries for a scene.
    pub(super) fn count(self, nv: usize) -> usize {
        nv.saturating_mul(if matches!(self, Self::MassMatrix | Self::AccelerationDerivative) { nv } else { 1 })
    }
}

/// One state.
#[derive(Debug, Clone, Copy)]
pub struct State<'a, T = f64> {
    /// Configuration, (nq,).
    pub q: &'a [T],
    /// Joint velocities, (nv,).
    pub qd: &'a [T],
    /// Torques, (nv,), or accelerations for inverse dynamics.
    pub u: &'a [T],
}

named! {
    /// The values that are perturbed together.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    #[non_exhaustive]
    enum Moved;
    /// All kinds with their Python names; the first is the state, the others are model parameters.
    const MOVED {
        /// All entries of q, qd and tau.
        State = "state",
        /// The masses of the links.
        Masses = "masses",
        /// The centers of mass of the links, in link frames.
        Centers = "centers of mass",
        /// The central inertias of the links, entry by entry.
        Inertias = "central inertias",
        /// The origins of the joint frames on their parents.
        Levers = "levers",
        /// The directions of the joint axes, component by component.
        Axes = "axes",
        /// The armatures.
        Armatures = "armatures",
    }
}

/// The relative difference from the exact result, in two norms.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Largest difference relative to the largest entry of the exact result.
    pub norm: f64,
    /// Relative difference of each entry; zero if both entries are zero.
    pub components: Vec<f64>,
}

impl Difference {
    /// The largest relative difference of an entry; NaN if one is NaN.
    #[must_use]
    pub fn component(&self) -> f64 {
        self.components.iter().fold(0.0, |worst, &x| larger(worst, x))
    }

    /// Zero difference of `count` entries.
    fn none(count: usize) -> Self {
        Self { norm: 0.0, components: vec![0.0; count] }
    }

    /// Replaces each value by the larger of the two.
    fn widen(&mut self, other: &Self) {
        self.norm = larger(self.norm, other.norm);
        for (a, &b) in self.components.iter_mut().zip(&other.components) {
            *a = larger(*a, b);
        }
    }
}

/// The larger of the two; NaN if either is NaN.
fn larger(a: f64, b: f64) -> f64 {
    if b <= a || a.is_nan() { a } else { b }
}

/// A result in double-double arithmetic, about 31 digits.
#[derive(Debug, Clone, PartialEq)]
pub struct Exact {
    /// The entries, row-major.
    pub values: Vec<DoubleDouble>,
}

impl Exact {
    /// The exact result for one state: O(N), with forward dynamics in square-root form; O(N depth) for the mass matrix.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::SingularJoint`] if a pivot of forward dynamics is not
    /// positive also in this arithmetic.
    pub fn new(scene: &Scene, quantity: Quantity, state: State<'_>) -> Result<Self, Error> {
        scene.check_configuration("q", state.q)?;
        scene.check_rates("qd", state.qd)?;
        scene.check_rates(if quantity == Quantity::InverseDynamics { "qdd" } else { "tau" }, state.u)?;
        let model: Model<DoubleDouble> = scene.model().cast();
        let (q, qd, u) =
            (DoubleDouble::each_of(state.q), DoubleDouble::each_of(state.qd), DoubleDouble::each_of(state.u));
        let mut workspace = Workspace::new(&model);
        let mut values = memory::filled("scene", quantity.count(scene.nv()), DoubleDouble::from_f64(f64::NAN))?;
        let state = State { q: &q, qd: &qd, u: &u };
        let sound = evaluate(&model, &mut workspace, quantity, state, &mut values);
        if sound { Ok(Self { values }) } else { Err(singular(scene, &workspace)) }
    }

    /// The difference of `found` from the exact result; NaN if an entry is not finite.
    #[must_use]
    pub fn difference(&self, found: &[DoubleDouble]) -> Difference {
        let size = |x: DoubleDouble| x.lane(0).abs();
        let largest = self.values.iter().fold(0.0, |m: f64, &x| m.max(size(x)));
        let mut all = Difference::none(0);
        for (&x, &exact) in found.iter().zip(&self.values) {
            let off = size(x - exact);
            let relative = |scale: f64| if off == 0.0 { 0.0 } else { off / scale };
            all.norm = larger(all.norm, relative(largest));
            all.components.push(relative(size(exact)));
        }
        all
    }
}

/// Evaluates a quantity. Returns false if a pivot of forward dynamics (square-root form) is not positive.
fn evaluate(
    model: &Model<DoubleDouble>,
    workspace: &mut Workspace<DoubleDouble>,
    quantity: Quantity,
    state: State<'_, DoubleDouble>,
    out: &mut [DoubleDouble],
) -> bool {
    let State { q, qd, u } = state;
    match quantity {
        Quantity::ForwardDynamics => {
            workspace.form = Form::SquareRoot;
            let monitor = dynamics::forward_dynamics(model, workspace, q, qd, u, &[], out);
            return monitor.clear(0) || workspace.pivots_are_positive();
        }
        Quantity::InverseDynamics => dynamics::inverse_dynamics(model, workspace, q, qd, u, &[], out),
        Quantity::BiasTorque => dynamics::bias_torque(model, workspace, q, qd, &[], out),
        Quantity::MassMatrix => dynamics::mass_matrix(model, workspace, q, out),
        Quantity::AccelerationDerivative => {
            workspace.form = Form::SquareRoot;
            let mut all = vec![DoubleDouble::from_f64(f64::NAN); 3 * out.len()];
            let scratch = &mut DerivativeScratch::new(model);
            let found = forward_dynamics_derivatives(model, workspace, scratch, (q, qd, u), &[], &mut all);
            out.copy_from_slice(&all[..out.len()]);
            return found.is_ok() || workspace.pivots_are_positive();
        }
    }
    true
}

/// The error for the outermost joint whose pivot is not positive.
pub(super) fn singular<T: Real>(scene: &Scene, workspace: &Workspace<T>) -> Error {
    let stages = &scene.model().system.stages;
    let lost = stages.iter().enumerate().rev().find_map(|(k, stage)| {
        let rows = stage.first_row..stage.first_row + stage.rows.count();
        let pivots = rows.map(|row| workspace.store.measured[row].pivot.lane(0));
        pivots.into_iter().find(|&pivot| !(pivot > 0.0 && pivot.is_finite())).map(|pivot| (k, pivot))
    });
    let (k, pivot) = lost.unwrap_or((0, f64::NAN));
    let (joint, link) =
        scene.joint_of_body(k).map_or_else(Default::default, |joint| (joint.name.clone(), joint.child.clone()));
    Error::SingularJoint { joint, link, state: None, pivot, terms: f64::NAN }
}

/// Change of the exact result for perturbations of every value of one kind by one unit in the last place, up or down:
/// the largest over `draws` random draws. Zeros are not perturbed. One entry per kind of [`MOVED`]; infinite if a draw
/// makes the problem singular.
///
/// # Errors
///
/// Those of [`Exact::new`].
pub fn sensitivity(
    scene: &Scene,
    quantity: Quantity,
    state: State<'_>,
    draws: usize,
    seed: u64,
) -> Result<Vec<(&'static str, Difference)>, Error> {
    let exact = Exact::new(scene, quantity, state)?;
    let mut draw = Draw::new(seed);
    let mut all = Vec::with_capacity(MOVED.len());
    for &(name, moved) in MOVED {
        let mut worst = Difference::none(exact.values.len());
        for _ in 0..draws {
            interrupt::check()?;
            let found = match moved {
                Moved::State => {
                    let (q, qd, u) =
                        (nudged(state.q, &mut draw), nudged(state.qd, &mut draw), nudged(state.u, &mut draw));
                    Exact::new(scene, quantity, State { q: &q, qd: &qd, u: &u })
                }
                _ => other(scene, moved, &mut draw).and_then(|scene| Exact::new(&scene, quantity, state)),
            };
            worst.widen(&match found {
                Ok(found) => exact.difference(&found.values),
                Err(error @ (Error::Interrupted | Error::Memory { .. })) => return Err(error),
                Err(_) => Difference { norm: f64::INFINITY, components: vec![f64::INFINITY; exact.values.len()] },
            });
        }
        all.push((name, worst));
    }
    Ok(all)
}

/// Moves a value by one unit in the last place, up or down.
fn nudge(x: &mut f64, draw: &mut Draw) {
    if *x != 0.0 {
        *x = if draw.coin() { x.next_up() } else { x.next_down() };
    }
}

fn nudged(values: &[f64], draw: &mut Draw) -> Vec<f64> {
    let mut values = values.to_vec();
    for x in &mut values {
        nudge(x, draw);
    }
    values
}

/// The scene with one kind of its parameters perturbed.
fn other(scene: &Scene, moved: Moved, draw: &mut Draw) -> Result<Scene, Error> {
    let source = scene.source();
    let mut builder = SceneBuilder::new().gravity(source.gravity_vector()).floating_base(source.is_floating());
    for link in source.links() {
        let mut link = link.clone();
        if let Some(inertial) = &mut link.inertial {
            match moved {
                Moved::Masses => nudge(&mut inertial.mass, draw),
                Moved::Centers => inertial.center.iter_mut().for_each(|x| nudge(x, draw)),
                Moved::Inertias => inertial.central.entries.iter_mut().for_each(|x| nudge(x, draw)),
                _ => {}
            }
        }
        builder = builder.link(link);
    }
    for joint in source.joints() {
        let mut joint = joint.clone();
        match moved {
            Moved::Levers => joint.origin.lever.iter_mut().for_each(|x| nudge(x, draw)),
            Moved::Axes => joint.axis.iter_mut().for_each(|x| nudge(x, draw)),
            Moved::Armatures => nudge(&mut joint.armature, draw),
            _ => {}
        }
        builder = builder.joint(joint);
    }
    builder.build()
}
