//! Sensitivity: by how much the exact answer changes when the numbers that describe the problem move by one unit in the last place.
//!
//! It is the least error that any float64 program can be asked for: a method whose error is far above it is a bad algorithm, and
//! where it is large itself the problem is ill-conditioned. The exact answer is that of double-double arithmetic, forward dynamics
//! in square-root form.

use crate::dynamics;
use crate::dynamics::derivatives::{DerivativeScratch, forward_dynamics_derivatives};
use crate::error::Error;
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::{Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::workspace::Workspace;
use crate::{memory, watch};

/// What is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Joint accelerations from torques, (nv,).
    ForwardDynamics,
    /// Joint torques from accelerations, (nv,).
    InverseDynamics,
    /// The bias torque H phi b, (nv,).
    BiasTorque,
    /// The mass matrix, (nv x nv).
    MassMatrix,
    /// The derivative of the accelerations by the tangent of q, (nv x nv).
    AccelerationDerivative,
}

/// Every quantity with the name it has in Python.
pub const QUANTITIES: [(&str, Quantity); 5] = [
    ("forward dynamics", Quantity::ForwardDynamics),
    ("inverse dynamics", Quantity::InverseDynamics),
    ("bias torque", Quantity::BiasTorque),
    ("mass matrix", Quantity::MassMatrix),
    ("derivative of forward dynamics", Quantity::AccelerationDerivative),
];

impl Quantity {
    /// How many numbers it is of a scene.
    pub(super) fn count(self, nv: usize) -> usize {
        nv.saturating_mul(if matches!(self, Self::MassMatrix | Self::AccelerationDerivative) { nv } else { 1 })
    }
}

/// One state.
#[derive(Debug, Clone, Copy)]
pub struct State<'a, T = f64> {
    /// Configuration, (nq,).
    pub q: &'a [T],
    /// Rates, (nv,).
    pub qd: &'a [T],
    /// Torques, (nv,); for inverse dynamics accelerations.
    pub u: &'a [T],
}

/// Which numbers move together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moved {
    /// Every number of q, qd and tau.
    State,
    /// The masses of the links.
    Masses,
    /// The mass centres of the links, in their frames.
    Centres,
    /// The central inertias of the links, entry by entry.
    Inertias,
    /// The origins of the joints on their parents.
    Levers,
    /// The directions of the axes, component by component.
    Axes,
    /// The armatures.
    Armatures,
}

/// All of them with the names they have in Python; the first is the state, the others are the model's parameters.
pub const MOVED: [(&str, Moved); 7] = [
    ("state", Moved::State),
    ("masses", Moved::Masses),
    ("mass centres", Moved::Centres),
    ("central inertias", Moved::Inertias),
    ("levers", Moved::Levers),
    ("axes", Moved::Axes),
    ("armatures", Moved::Armatures),
];

/// A difference from the exact answer, relative, in two norms.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Largest difference over the largest number of the exact answer.
    pub norm: f64,
    /// Each difference over its own number; zero where both are zero.
    pub components: Vec<f64>,
}

impl Difference {
    /// The largest of the components; NaN where one is NaN.
    #[must_use]
    pub fn component(&self) -> f64 {
        self.components.iter().fold(0.0, |worst, &x| larger(worst, x))
    }

    /// None at all, for `count` numbers.
    fn none(count: usize) -> Self {
        Self { norm: 0.0, components: vec![0.0; count] }
    }

    /// Keeps the larger of the two, number by number.
    fn widen(&mut self, other: &Self) {
        self.norm = larger(self.norm, other.norm);
        for (a, &b) in self.components.iter_mut().zip(&other.components) {
            *a = larger(*a, b);
        }
    }
}

/// The larger of the two; NaN where either is NaN.
fn larger(a: f64, b: f64) -> f64 {
    if b <= a || a.is_nan() { a } else { b }
}

/// An answer in double-double arithmetic, about 31 digits.
#[derive(Debug, Clone, PartialEq)]
pub struct Exact {
    /// The numbers, row by row.
    pub values: Vec<DoubleDouble>,
}

impl Exact {
    /// The answer for one state: O(N), forward dynamics in square-root form; O(N depth) for the mass matrix.
    ///
    /// # Errors
    ///
    /// Arguments of the wrong length or with numbers that are not finite; [`Error::SingularJoint`], naming the joint, where a
    /// pivot of forward dynamics is not positive even there.
    pub fn new(scene: &Scene, quantity: Quantity, state: State<'_>) -> Result<Self, Error> {
        scene.check_configuration("q", state.q)?;
        scene.check_rates("qd", state.qd)?;
        scene.check_rates(if quantity == Quantity::InverseDynamics { "qdd" } else { "tau" }, state.u)?;
        let model: Model<DoubleDouble> = scene.model().cast();
        let wide = |x: &[f64]| -> Vec<DoubleDouble> { x.iter().map(|&v| DoubleDouble::from_f64(v)).collect() };
        let (q, qd, u) = (wide(state.q), wide(state.qd), wide(state.u));
        let mut workspace = Workspace::new(&model);
        let mut values = memory::filled("scene", quantity.count(scene.nv()), DoubleDouble::from_f64(f64::NAN))?;
        let state = State { q: &q, qd: &qd, u: &u };
        let sound = evaluate(&model, &mut workspace, quantity, state, &mut values);
        if sound { Ok(Self { values }) } else { Err(singular(scene, &workspace)) }
    }

    /// How far numbers are from it; NaN where one of them is not finite.
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

/// One quantity; false where a pivot of forward dynamics (square-root form) is not positive.
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

/// The error of the outermost joint whose pivot is not positive.
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

/// By how much the exact answer changes: the largest of `draws` draws, in each of which every number of a kind moves by one unit
/// in its last place, up or down. Zeros stay. One entry for each of [`MOVED`]; infinite where a draw makes the problem singular.
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
    for (name, moved) in MOVED {
        let mut worst = Difference::none(exact.values.len());
        for _ in 0..draws {
            watch::check()?;
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

/// One unit in the last place up or down.
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

/// The scene with one kind of its parameters moved.
fn other(scene: &Scene, moved: Moved, draw: &mut Draw) -> Result<Scene, Error> {
    let source = scene.source();
    let mut builder = SceneBuilder::new().gravity(source.gravity_vector()).floating_base(source.is_floating());
    for link in source.links() {
        let mut link = link.clone();
        if let Some(inertial) = &mut link.inertial {
            match moved {
                Moved::Masses => nudge(&mut inertial.mass, draw),
                Moved::Centres => inertial.centre.iter_mut().for_each(|x| nudge(x, draw)),
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
