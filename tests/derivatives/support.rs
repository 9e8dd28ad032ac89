//! Random states of random trees, and their derivatives in any scalar type: analytic, and by central differences in
//! about 31 digits.

use crate::common::oracle::{D, d};
use crate::common::{Random, Tree, random_state, tolerance};
use nalgebra::{Matrix3, Vector6};
use phipsi::dynamics;
use phipsi::dynamics::derivatives::{self, DerivativeScratch};
use phipsi::filter::LostPivot;
use phipsi::scalar::Real;
use phipsi::scene::{JointKind, Model};
use phipsi::{Error, Form, Scene, Workspace};

/// All types of joints, with those that one-axis scenes do not contain twice.
pub const KINDS: [JointKind; 10] = [
    JointKind::Revolute,
    JointKind::Prismatic,
    JointKind::Continuous,
    JointKind::Screw { pitch: 0.2 },
    JointKind::Planar,
    JointKind::Universal,
    JointKind::Spherical,
    JointKind::Spherical,
    JointKind::Floating,
    JointKind::Fixed,
];

/// Random mixed trees, seeds 0..n: fixed and floating bases, with and without armature, one joint to eight.
pub fn trees(n: u64) -> impl Iterator<Item = Tree<'static>> {
    (0..n).map(|seed| Tree {
        seed,
        bodies: 1 + usize::try_from(seed).unwrap() % 8,
        kinds: &KINDS,
        branching: 0.4,
        armature: if seed % 3 == 0 { 0.0 } else { 0.3 },
        floating: seed % 4 == 1,
    })
}

/// The constants of a scene in about 31 digits, with each rotation matrix orthonormalized to that precision:
/// otherwise quantities in the frames of joints would differ by the rounding of f64.
pub fn widened(scene: &Scene) -> Model<D> {
    let mut model: Model<D> = scene.model().cast();
    for body in &mut model.bodies {
        let rotation = &mut body.tree.rotation;
        for _ in 0..3 {
            *rotation = *rotation * (Matrix3::identity() * d(3.0) - rotation.transpose() * *rotation) * d(0.5);
        }
    }
    model
}

/// One state of a scene: u is a torque or an acceleration.
#[derive(Clone)]
pub struct State<T> {
    pub q: Vec<T>,
    pub qd: Vec<T>,
    pub u: Vec<T>,
    pub wrenches: Vec<Vector6<T>>,
}

impl State<f64> {
    /// All contributions, with wrenches on all bodies.
    pub fn random(scene: &Scene, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let (q, qd, u) = random_state(scene, &mut random);
        let wrenches = scene.model().bodies.iter().map(|_| Vector6::from_fn(|_, _| random.uniform(-3.0, 3.0)));
        Self { q, qd, u, wrenches: wrenches.collect() }
    }

    /// The same in another scalar type.
    pub fn cast<T: Real>(&self) -> State<T> {
        let of = |x: &[f64]| x.iter().map(|&x| T::from_f64(x)).collect();
        let wrenches = self.wrenches.iter().map(|w| w.map(T::from_f64)).collect();
        State { q: of(&self.q), qd: of(&self.qd), u: of(&self.u), wrenches }
    }
}

/// With respect to q and qd, and M or its inverse; (nv x nv), by rows.
pub type Three<T> = [Vec<T>; 3];

fn split<T: Real>(model: &Model<T>, all: &[T]) -> Three<T> {
    let size = model.nv() * model.nv();
    [0, 1, 2].map(|i| all[i * size..(i + 1) * size].to_vec())
}

fn room<T: Real>(model: &Model<T>) -> Vec<T> {
    vec![T::from_f64(f64::NAN); 3 * model.nv() * model.nv()]
}

/// dtau/dq, dtau/dqd, M by the recursion, in any scalar type.
pub fn of_torques<T: Real<Parameter = T>>(model: &Model<T>, state: &State<T>) -> Three<T> {
    let State { q, qd, u, wrenches } = state;
    let mut out = room(model);
    let (mut workspace, mut scratch) = (Workspace::new(model), DerivativeScratch::new(model));
    derivatives::inverse_dynamics_derivatives(model, &mut workspace, &mut scratch, (q, qd, u), wrenches, &mut out);
    split(model, &out)
}

/// dqdd/dq, dqdd/dqd, M^-1, likewise.
pub fn of_accelerations<T: Real<Parameter = T>>(
    model: &Model<T>,
    form: Form,
    state: &State<T>,
) -> Result<Three<T>, LostPivot> {
    let State { q, qd, u, wrenches } = state;
    let (mut workspace, mut scratch) = (Workspace::new(model).in_form(form), DerivativeScratch::new(model));
    let mut out = room(model);
    let state = (&q[..], &qd[..], &u[..]);
    derivatives::forward_dynamics_derivatives(model, &mut workspace, &mut scratch, state, wrenches, &mut out)?;
    Ok(split(model, &out))
}

/// dtau/dq, dtau/dqd, M by the method of the scene, which uses compiled kernels.
pub fn of_torques_by_method(scene: &Scene, state: &State<f64>) -> Three<f64> {
    let State { q, qd, u, wrenches } = state;
    let mut out = room(scene.model());
    scene.inverse_dynamics_derivatives(&mut scene.workspace(), q, qd, u, wrenches, &mut out).unwrap();
    split(scene.model(), &out)
}

/// dqdd/dq, dqdd/dqd, M^-1, likewise.
pub fn of_accelerations_by_method(scene: &Scene, form: Form, state: &State<f64>) -> Result<Three<f64>, Error> {
    let State { q, qd, u, wrenches } = state;
    let mut out = room(scene.model());
    let mut workspace = scene.workspace().in_form(form);
    scene.forward_dynamics_derivatives(&mut workspace, q, qd, u, wrenches, &mut out)?;
    Ok(split(scene.model(), &out))
}

pub fn torque(model: &Model<D>, state: &State<D>) -> Vec<D> {
    let State { q, qd, u, wrenches } = state;
    let mut out = vec![d(f64::NAN); model.nv()];
    dynamics::inverse_dynamics(model, &mut Workspace::new(model), q, qd, u, wrenches, &mut out);
    out
}

pub fn acceleration(model: &Model<D>, state: &State<D>) -> Vec<D> {
    let State { q, qd, u, wrenches } = state;
    let mut out = vec![d(f64::NAN); model.nv()];
    assert!(dynamics::forward_dynamics(model, &mut Workspace::new(model), q, qd, u, wrenches, &mut out).clear(0));
    out
}

/// q (+) h e of one degree of freedom.
pub fn moved(model: &Model<D>, q: &[D], row: usize, h: D) -> Vec<D> {
    let (mut v, mut out) = (vec![d(0.0); model.nv()], q.to_vec());
    v[row] = h;
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.advance(&q[body.q..], &v[stage.first_row..], &mut out[body.q..]);
    }
    out
}

/// Central differences of a function of a state with respect to q, qd and u, (nv x nv), by rows.
pub fn differences(model: &Model<D>, state: &State<D>, f: impl Fn(&Model<D>, &State<D>) -> Vec<D>) -> Three<D> {
    let nv = model.nv();
    let mut out = split(model, &room(model));
    let at = |which: usize, row: usize, h: f64| {
        let mut state = state.clone();
        match which {
            0 => state.q = moved(model, &state.q, row, d(h)),
            1 => state.qd[row] += d(h),
            _ => state.u[row] += d(h),
        }
        f(model, &state)
    };
    for (which, matrix) in out.iter_mut().enumerate() {
        for column in 0..nv {
            let (ahead, back) = (at(which, column, tolerance::STEP), at(which, column, -tolerance::STEP));
            for row in 0..nv {
                matrix[row * nv + column] = (ahead[row] - back[row]) * d(0.5 / tolerance::STEP);
            }
        }
    }
    out
}

pub const NAMES: [&str; 3] = ["by q", "by qd", "by the third"];

pub fn round(values: &[D]) -> Vec<f64> {
    values.iter().map(|&x| tolerance::to_f64(x)).collect()
}
