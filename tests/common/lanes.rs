//! States in lanes: instruction sets of this machine, scenes and states, and the plain implementation for comparison.

use super::{ALL_KINDS, Random, Tree, random_inertial, random_state};
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use phipsi::batch::{Evaluator, INSTRUCTION_SETS, InstructionSet};
use phipsi::filter::Form;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, Simplifications};
use phipsi::spatial::SpatialVector;
use phipsi::{Algorithm, Arguments, Derivatives, Products};
use phipsi::{Scene, SceneBuilder};
use std::f64::consts::{FRAC_PI_2, PI};

/// Everything that runs in lanes, or one state at a time for comparison.
pub const ALGORITHMS: [Algorithm; 24] = [
    Algorithm::ForwardDynamics(Form::Auto),
    Algorithm::ForwardDynamics(Form::Covariance),
    Algorithm::ForwardDynamics(Form::SquareRoot),
    Algorithm::InverseDynamics,
    Algorithm::BiasTorque,
    Algorithm::MassMatrix,
    Algorithm::MassMatrixInverse(Form::Auto),
    Algorithm::MassMatrixInverse(Form::Covariance),
    Algorithm::Derivatives(Derivatives::InverseDynamics),
    Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Auto)),
    Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Covariance)),
    Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::SquareRoot)),
    Algorithm::Derivatives(Derivatives::CoriolisMatrix),
    Algorithm::Derivatives(Derivatives::MassMatrix),
    Algorithm::Products(Products::tangent(None)),
    Algorithm::Products(Products::gradient(None)),
    Algorithm::Products(Products::tangent(Some(Form::Auto))),
    Algorithm::Products(Products::tangent(Some(Form::Covariance))),
    Algorithm::Products(Products::gradient(Some(Form::Auto))),
    Algorithm::Products(Products::gradient(Some(Form::Covariance))),
    Algorithm::Products(Products::gradient(Some(Form::SquareRoot))),
    Algorithm::Products(Products::gradient(None).with_constants()),
    Algorithm::Products(Products::gradient(Some(Form::Auto)).with_constants()),
    Algorithm::Products(Products::gradient(Some(Form::SquareRoot)).with_constants()),
];

/// Instruction sets of this machine; the baseline is always available.
pub fn arms() -> impl Iterator<Item = InstructionSet> {
    INSTRUCTION_SETS.iter().map(|&(_, arm)| arm).filter(|arm| arm.available())
}

/// Without optimization the lane kernels need more stack than a thread has by default.
pub fn on_a_large_stack(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(256 << 20).spawn(work).unwrap().join().unwrap();
}

/// q, qd, u.
pub type State = (Vec<f64>, Vec<f64>, Vec<f64>);

/// States from seeds.
pub fn states(scene: &Scene, count: u64) -> Vec<State> {
    (0..count).map(|seed| random_state(scene, &mut Random::new(seed))).collect()
}

/// The arguments of an algorithm.
pub fn arguments<'a>(algorithm: Algorithm, (q, qd, u): &'a State, wrenches: &'a [SpatialVector<f64>]) -> Arguments<'a> {
    Arguments { q, qd, u, wrenches, seed: [qd, u, qd], ..Arguments::default() }.read_by(algorithm)
}

/// The results, one state after another.
pub fn evaluate(scene: &Scene, evaluator: &mut Evaluator, algorithm: Algorithm, states: &[Arguments<'_>]) -> Vec<f64> {
    let mut out = vec![f64::NAN; scene.width(algorithm) * states.len()];
    scene.evaluate(evaluator, algorithm, states, &mut out).unwrap_or_else(|fault| panic!("{algorithm:?}: {fault:?}"));
    out
}

/// One state by the checked recursion in plain f64, which other tests compare with dense algebra and higher
/// precision.
pub fn plainly(scene: &Scene, algorithm: Algorithm, state: &Arguments<'_>) -> Vec<f64> {
    let mut out = vec![f64::NAN; scene.width(algorithm)];
    scene.recursion(&mut scene.workspace(), None, algorithm, state, &mut out).unwrap();
    out
}

/// Forces on the bodies of each state.
pub fn forces(scene: &Scene, states: usize) -> Vec<Vec<SpatialVector<f64>>> {
    let mut random = Random::new(99);
    let bodies = scene.model().bodies.len();
    (0..states)
        .map(|_| (0..bodies).map(|_| SpatialVector::from_fn(|_, _| random.uniform(-1.0, 1.0))).collect())
        .collect()
}

/// Trees with all types of joints, with and without armature.
pub fn trees() -> impl Iterator<Item = Scene> {
    [(1, 1, false), (2, 5, false), (3, 12, true), (4, 30, false)].into_iter().map(|(seed, bodies, floating)| {
        let armature = if seed % 2 == 0 { 0.1 } else { 0.0 };
        let tree = Tree { seed, bodies, kinds: &ALL_KINDS, branching: 0.4, armature, floating };
        tree.builder().build().unwrap()
    })
}

/// A rotation about an axis of length 1.
fn about(axis: Vector3<f64>, angle: f64) -> Matrix3<f64> {
    *Rotation3::from_axis_angle(&Unit::new_unchecked(axis), angle).matrix()
}

/// A tree whose joints are mostly revolute about coordinate axes of their parents, some of them on the base: its
/// frames differ only by signs and angles.
pub fn aligned(seed: u64, bodies: usize, branching: f64) -> Scene {
    let mut random = Random::new(seed);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for k in 0..bodies {
        let apart = random.uniform(0.0, 1.0) < branching;
        let parent = if apart { random.below(k + 1) } else { k };
        let parent = parent.checked_sub(1).map_or("base".to_owned(), |link| format!("link{link}"));
        let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, format!("link{k}"));
        joint.axis = Vector3::zeros();
        joint.axis[random.below(3)] = if random.uniform(0.0, 1.0) < 0.5 { 1.0 } else { -1.0 };
        // Some that do not rotate about an axis of their parent, so that aligned frames end there.
        match k % 7 {
            3 => joint.axis = random.vector(),
            4 => joint.kind = JointKind::Prismatic,
            6 => joint.kind = JointKind::Spherical,
            _ => {}
        }
        match k % 5 {
            // Rotated about the joint axis by any angle; and by one or two right angles about any axis, as
            // represented in floating point.
            2 => joint.origin.rotation = about(joint.axis.normalize(), random.uniform(-3.0, 3.0)),
            3 => joint.origin.rotation = about(Vector3::x(), FRAC_PI_2) * about(Vector3::z(), PI),
            _ => {}
        }
        joint.origin.lever = random.vector() * 0.3;
        // Every third joint has no offset: zero terms of such rows are skipped.
        joint.armature = if k % 3 == 1 { 0.0 } else { random.uniform(0.2, 1.0) };
        let inertial = Some(random_inertial(&mut random));
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
    }
    builder.build().expect("a tree")
}

/// A trunk with limbs of equal structure and different constants: rotations about coordinate axes of the
/// parents, in a plane of two and about any axis, a prismatic and a spherical joint in each; two fingers each.
/// With `ragged` the second limb has one finger less, or for odd seeds the first has none; and the last ends
/// with another joint.
pub fn limbed(seed: u64, limbs: usize, length: usize, floating: bool, ragged: bool) -> Scene {
    let mut random = Random::new(seed);
    let inertial = floating.then(|| random_inertial(&mut random));
    let mut builder =
        SceneBuilder::new().floating_base(floating).link(LinkDescription { name: "base".into(), inertial });
    let mut add = |builder: SceneBuilder, parent: &str, name: &str, alike: &mut Random, other: bool| {
        let mut joint = JointDescription::new(format!("to_{name}"), JointKind::Revolute, parent, name);
        let (kind, axis, turned) = (alike.below(8), alike.below(3), alike.below(4) == 0);
        joint.kind = match kind {
            0 => JointKind::Prismatic,
            1 => JointKind::Spherical,
            _ => JointKind::Revolute,
        };
        if other {
            joint.kind = JointKind::Prismatic;
        }
        joint.axis = Vector3::zeros();
        joint.axis[axis] = if random.below(2) == 0 { 1.0 } else { -1.0 };
        if turned && alike.below(2) == 0 {
            joint.origin.rotation = random.rotation();
        } else if turned {
            let across = [Vector3::y(), Vector3::z(), Vector3::x()][axis];
            joint.origin.rotation = about(across, random.uniform(-3.0, 3.0));
        } else if alike.below(3) == 0 && random.below(4) != 0 {
            joint.origin.rotation = about(joint.axis, random.uniform(-3.0, 3.0));
        }
        joint.origin.lever = if alike.below(4) == 0 { Vector3::zeros() } else { random.vector() * 0.3 };
        joint.armature = if alike.below(2) == 0 { 0.0 } else { random.uniform(0.2, 1.0) };
        let inertial = Some(random_inertial(&mut random));
        builder.link(LinkDescription { name: name.into(), inertial }).joint(joint)
    };
    builder = add(builder, "base", "trunk", &mut Random::new(seed + 1), false);
    for limb in 0..limbs {
        let mut alike = Random::new(seed + 2);
        let mut parent = "trunk".to_owned();
        for k in 0..length {
            let name = format!("limb{limb}_{k}");
            builder = add(builder, &parent, &name, &mut alike, ragged && limb + 1 == limbs && k + 1 == length);
            parent = name;
        }
        for finger in 0..2 {
            let mut alike = Random::new(seed + 3 + finger);
            // If it is the first one, it has none: it ends where the others continue.
            let is_missing = if seed.is_multiple_of(2) { limb == 1 && finger == 1 } else { limb == 0 };
            if !(ragged && is_missing) {
                builder = add(builder, &parent, &format!("finger{limb}_{finger}"), &mut alike, false);
            }
        }
    }
    builder.build().expect("a tree")
}

/// Several floating bodies, one of them single, the others with arms; an arm on the base; and fixed
/// joints, also at tips, which are not merged with their parents.
pub fn crowd(seed: u64, floats: usize, length: usize) -> Scene {
    let mut random = Random::new(seed);
    let kept = Simplifications { fixed_joints: false, ..Simplifications::all() };
    let mut builder =
        SceneBuilder::new().simplifications(kept).link(LinkDescription { name: "base".into(), inertial: None });
    let mut add = |builder: SceneBuilder, kind: JointKind, parent: &str, name: &str| {
        let mut joint = JointDescription::new(format!("to_{name}"), kind, parent, name);
        joint.axis = Vector3::zeros();
        joint.axis[random.below(3)] = if random.below(2) == 0 { 1.0 } else { -1.0 };
        joint.origin.lever = random.vector() * 0.3;
        if random.below(3) == 0 {
            joint.origin.rotation = random.rotation();
        }
        let inertial = Some(random_inertial(&mut random));
        builder.link(LinkDescription { name: name.into(), inertial }).joint(joint)
    };
    for float in 0..=floats {
        let mut parent = "base".to_owned();
        if float < floats {
            parent = format!("float{float}");
            builder = add(builder, JointKind::Floating, "base", &parent);
        }
        if float == 1 {
            continue;
        }
        for k in 0..length {
            let (name, next) = (format!("tip{float}_{k}"), format!("link{float}_{k}"));
            builder = add(builder, JointKind::Revolute, &parent, &next);
            builder = add(builder, JointKind::Fixed, &next, &name);
            parent = if k % 2 == 0 { next } else { name };
        }
    }
    builder.build().expect("a forest")
}
