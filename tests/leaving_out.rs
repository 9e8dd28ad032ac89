//! Every simplification of [`Simplifications`]: the results are equal up to rounding with and without it, and it has an
//! effect on the computation.

use crate::common::oracle::{Oracle, ds};
use crate::common::tolerance::{self, Conditioning, assert_near, conditioning, size};
use crate::common::{ALL_KINDS, KINDS_WITH_FIXED, Random, Tree, random_inertial, random_state};
use nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use phipsi::filter::Form;
use phipsi::kinematics::{AccelerationKind, ReferenceFrame};
use phipsi::operators::{Factor, KINDS, Operator};
use phipsi::report::operations::{Task, count, of_factor};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder, Simplifications};
use phipsi::spatial::{SpatialVector, Symmetric3};
use phipsi::{Algorithm, Arguments, Derivatives};
use phipsi::{Error, Scene};

/// A link on a joint with a general frame.
fn attached(
    builder: SceneBuilder,
    random: &mut Random,
    name: &str,
    (kind, parent): (JointKind, &str),
    has_mass: bool,
) -> SceneBuilder {
    let inertial = has_mass.then(|| random_inertial(random));
    let mut joint = JointDescription::new(format!("to {name}"), kind, parent, name);
    joint.origin.rotation = random.rotation();
    joint.origin.lever = random.vector() * 0.5;
    joint.axis = random.vector();
    builder.link(LinkDescription { name: name.to_owned(), inertial }).joint(joint)
}

/// A random mixed tree on a base that has mass and a second link, with a link and a prismatic joint without
/// mass, and with a fixed joint after a movable one.
fn builder(seed: u64) -> SceneBuilder {
    let odd = seed % 2 == 1;
    let tree = Tree {
        seed,
        bodies: 2 + usize::try_from(seed % 5).unwrap(),
        kinds: if odd { &KINDS_WITH_FIXED } else { &ALL_KINDS },
        branching: 0.5,
        armature: if seed.is_multiple_of(3) { 0.0 } else { 0.2 },
        floating: seed % 4 == 1,
    };
    let source = tree.builder();
    let mut random = Random::new(1000 + seed);
    let mut builder = SceneBuilder::new().gravity(source.gravity_vector()).floating_base(tree.floating);
    for link in source.links() {
        let inertial = link.inertial.or_else(|| Some(random_inertial(&mut random)));
        builder = builder.link(LinkDescription { name: link.name.clone(), inertial });
    }
    for joint in source.joints() {
        builder = builder.joint(joint.clone());
    }
    let mut add = |builder: SceneBuilder, name: &str, kind: JointKind, parent: &str, has_mass: bool| {
        attached(builder, &mut random, name, (kind, parent), has_mass)
    };
    builder = add(builder, "column", JointKind::Fixed, "base", true);
    builder = add(builder, "slide", JointKind::Prismatic, "column", false);
    builder = add(builder, "carried", JointKind::Revolute, "slide", true);
    builder = add(builder, "welded", JointKind::Fixed, "carried", true);
    builder = add(builder, "frame", JointKind::Fixed, "welded", false);
    builder = add(builder, "turned", JointKind::Continuous, "welded", true);
    // A wrist: axes parallel to those of the parent, with a common origin.
    for (parent, name, axis) in [("turned", "pitched", Vector3::y()), ("pitched", "rolled", -Vector3::x())] {
        let mut joint = JointDescription::new(format!("to {name}"), JointKind::Revolute, parent, name);
        joint.axis = axis;
        // The second is also rotated about its own axis.
        joint.origin.rotation = *Rotation3::new(Vector3::x() * axis.x * 0.7).matrix();
        let inertial = Some(random_inertial(&mut random));
        builder = builder.link(LinkDescription { name: name.to_owned(), inertial }).joint(joint);
    }
    // The last body has no row if fixed joints are kept.
    attached(builder, &mut random, "tool", (JointKind::Fixed, "turned"), true)
}

/// Simplifications: all, all except one, none.
fn choices() -> Vec<(String, Simplifications)> {
    let but = Simplifications::SWITCHES
        .iter()
        .map(|&(name, switch)| (format!("all but {name}"), Simplifications::all_but(switch)));
    but.into_iter().chain([("nothing".to_owned(), Simplifications::none())]).collect()
}

struct State {
    q: Vec<f64>,
    qd: Vec<f64>,
    u: Vec<f64>,
    wrenches: Vec<(String, SpatialVector<f64>)>,
}

/// A moving state, and one at rest; with and without wrenches.
fn states(scene: &Scene, seed: u64) -> Vec<State> {
    let mut random = Random::new(seed);
    let mut all = Vec::new();
    for (moving, pushed) in [(true, false), (true, true), (false, false), (false, true)] {
        let (q, mut qd, u) = random_state(scene, &mut random);
        if !moving {
            qd.fill(0.0);
        }
        let mut wrench = |link: &str| (link.to_owned(), SpatialVector::from_fn(|_, _| random.uniform(-3.0, 3.0)));
        let wrenches = if pushed { vec![wrench("base"), wrench("welded"), wrench("link0")] } else { Vec::new() };
        all.push(State { q, qd, u, wrenches });
    }
    all
}

/// Results of a scene in a state, by name.
fn results(scene: &Scene, state: &State) -> Vec<(String, Vec<f64>)> {
    let State { q, qd, u, wrenches } = state;
    let nv = scene.nv();
    let mut workspace = scene.workspace();
    let mut scratch = scene.inverse_scratch();
    let forces = scene.body_wrenches(wrenches.iter().map(|(link, wrench)| (link.as_str(), *wrench))).unwrap();
    let forces = if wrenches.is_empty() { Vec::new() } else { forces };
    let mut all = Vec::new();
    let mut keep = |what: &str, values: &[f64]| all.push((what.to_owned(), values.to_vec()));
    let mut wide = vec![f64::NAN; nv * nv];
    let mut vector = vec![f64::NAN; nv];
    scene.mass_matrix(&mut workspace, q, &mut wide).unwrap();
    keep("M", &wide);
    scene.bias_torque(&mut workspace, q, qd, &mut vector).unwrap();
    keep("torque: bias", &vector);
    scene.inverse_dynamics(&mut workspace, q, qd, u, &forces, &mut vector).unwrap();
    keep("torque: inverse dynamics", &vector);
    for &(name, form) in phipsi::filter::FORMS {
        workspace.form = form;
        scene.forward_dynamics(&mut workspace, q, qd, u, &forces, &mut vector).unwrap();
        keep(&format!("acceleration: {name}"), &vector);
        scene.mass_matrix_inverse(&mut workspace, &mut scratch, q, &mut wide).unwrap();
        keep(&format!("inverse: {name}"), &wide);
    }
    let mut evaluator = scene.evaluator();
    let one = Arguments { q, qd, u, wrenches: &forces, ..Arguments::default() };
    let many = 2 * evaluator.lanes() + 1;
    for (what, algorithm) in [
        ("acceleration: in lanes", Algorithm::ForwardDynamics(Form::Auto)),
        ("acceleration: in lanes, covariance", Algorithm::ForwardDynamics(Form::Covariance)),
        ("acceleration: in lanes, square-root", Algorithm::ForwardDynamics(Form::SquareRoot)),
        ("torque: inverse dynamics in lanes", Algorithm::InverseDynamics),
        ("torque: bias in lanes", Algorithm::BiasTorque),
        ("M: in lanes", Algorithm::MassMatrix),
        ("inverse: in lanes, auto", Algorithm::MassMatrixInverse(Form::Auto)),
        ("inverse: in lanes, covariance", Algorithm::MassMatrixInverse(Form::Covariance)),
        ("derivatives: of torques", Algorithm::Derivatives(Derivatives::InverseDynamics)),
        ("derivatives: of accelerations", Algorithm::Derivatives(Derivatives::ForwardDynamics(Form::Auto))),
    ] {
        let given = one.read_by(algorithm);
        let width = scene.width(algorithm);
        // A single state, which has separate code, and enough states for every lane.
        for count in [1, many] {
            let mut out = vec![f64::NAN; width * count];
            scene.evaluate(&mut evaluator, algorithm, &vec![given; count], &mut out).unwrap();
            for out in out.chunks(width) {
                keep(what, out);
            }
        }
    }
    let energy = scene.energy(&mut workspace, q, qd).unwrap();
    let neutral = scene.energy(&mut workspace, &scene.neutral(), qd).unwrap();
    keep("kinetic energy", &[energy.kinetic]);
    keep("potential energy", &[energy.potential - neutral.potential]);
    keep("momentum", scene.momentum(&mut workspace, q, qd).unwrap().as_slice());
    keep("mass", &[scene.total_mass()]);
    keep("mass center", scene.center_of_mass(&mut workspace, q).unwrap().as_slice());
    let mut of_momentum = vec![f64::NAN; 6 * nv];
    scene.centroidal_momentum_matrix(&mut workspace, q, &mut of_momentum).unwrap();
    keep("centroidal momentum matrix", &of_momentum);
    scene.centroidal_momentum_matrix_rate(&mut workspace, q, qd, &mut of_momentum).unwrap();
    keep("its rate", &of_momentum);
    for (link, placement) in scene.links().iter().zip(scene.placements(q).unwrap()) {
        keep(&format!("where {} is", link.name), placement.to_matrix().as_slice());
        let mut jacobian = vec![f64::NAN; 6 * nv];
        scene.jacobian(q, &link.name, ReferenceFrame::Local, &mut jacobian).unwrap();
        keep(&format!("jacobian of {}", link.name), &jacobian);
        let acceleration = scene.acceleration(q, qd, u, &link.name, ReferenceFrame::World, AccelerationKind::Spatial);
        keep(&format!("how {} accelerates", link.name), acceleration.unwrap().as_slice());
    }
    all
}

/// Bound of each result.
struct Bounds {
    n: usize,
    terms: f64,
    matrix: Conditioning,
    mass: f64,
}

impl Bounds {
    fn new(scene: &Scene, state: &State, found: &[(String, Vec<f64>)]) -> Self {
        let (_, terms) = Oracle::new(scene.source()).at(&ds(&state.q), &ds(&state.qd)).bias(&[]);
        let mass = &found[0].1;
        let pushes: f64 = state.wrenches.iter().map(|(_, wrench)| 10.0 * wrench.amax()).sum();
        // All terms of a torque: bias, wrenches at offsets of meters, M times accelerations.
        let terms = terms + pushes + size(mass) * size(&state.u) * tolerance::count(scene.nv());
        Self { n: scene.links().len(), terms, matrix: conditioning(scene.nv(), mass), mass: size(mass) }
    }

    fn of(&self, what: &str, values: &[f64]) -> f64 {
        match what.split(':').next().unwrap() {
            "M" => tolerance::product(self.n, self.mass),
            "torque" => tolerance::product(self.n, self.terms),
            "acceleration" => tolerance::solution(&self.matrix, size(values), self.terms),
            "inverse" => tolerance::inverse(self.matrix.number, self.matrix.inverse_norm),
            "derivatives" => tolerance::inverse(self.matrix.number, size(values).max(self.matrix.inverse_norm)),
            // Heights of meters, times gravity.
            "potential energy" => tolerance::product(self.n, 100.0 * self.mass),
            _ => tolerance::product(self.n, size(values).max(10.0)),
        }
    }
}

#[test]
fn results_are_the_same_with_every_switch_on_and_off() {
    for seed in 0..12 {
        for gravity in [[0.3, -0.5, -9.6], [0.0; 3]] {
            let source = builder(seed).gravity(gravity);
            let scene = source.clone().build().unwrap();
            for (i, state) in states(&scene, seed).iter().enumerate() {
                let expected = results(&scene, state);
                let bounds = Bounds::new(&scene, state, &expected);
                for (left_out, simplifications) in choices() {
                    let found = results(&source.clone().simplifications(simplifications).build().unwrap(), state);
                    assert_eq!(found.len(), expected.len());
                    for ((what, found), (_, expected)) in found.iter().zip(&expected) {
                        let say = format!("seed {seed}, state {i}, left out {left_out}: {what}");
                        assert_near(&say, found, expected, bounds.of(what, expected));
                    }
                }
            }
        }
    }
}

/// x, -y and z; and axes that are tilted in a coordinate plane of their parent, and in none.
const STRAIGHT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
const TILTED: [[f64; 3]; 3] = [[0.6, 0.0, -0.8], [0.0, -1.0, 0.0], [0.48, 0.6, 0.64]];

/// A chain of revolute joints about these axes, each with offsets along none, one, two and all axes; two tips on the
/// last link but two.
fn along_some_axes(armature: f64, axes: [[f64; 3]; 3]) -> SceneBuilder {
    let mut random = Random::new(7);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for k in 0..24_usize {
        let parent = if k == 0 { "base".to_owned() } else { format!("{}", k.min(22) - 1) };
        let mut joint = JointDescription::new(format!("to {k}"), JointKind::Revolute, parent, format!("{k}"));
        joint.axis = axes[k % 3].into();
        joint.armature = armature;
        let all = random.vector() * 0.5;
        joint.origin.lever = Vector3::from_fn(|i, _| if (k % 8) >> i & 1 == 1 { all[i] } else { 0.0 });
        let inertial = Some(random_inertial(&mut random));
        builder = builder.link(LinkDescription { name: format!("{k}"), inertial }).joint(joint);
    }
    builder
}

/// Offsets along some axes only, on axes parallel and perpendicular to those of the parent.
#[test]
fn offsets_along_some_axes_lose_no_digit() {
    for (armature, axes) in [(0.0, STRAIGHT), (0.2, STRAIGHT), (0.0, TILTED), (0.2, TILTED)] {
        let source = along_some_axes(armature, axes);
        let scene = source.clone().build().unwrap();
        let off = |switch| source.clone().simplifications(Simplifications::all_but(switch)).build().unwrap();
        let none = source.clone().simplifications(Simplifications::none()).build().unwrap();
        let untilted = off(|of| &mut of.oblique_axes);
        let (q, qd, u) = random_state(&scene, &mut Random::new(3));
        let state = State { q, qd, u, wrenches: Vec::new() };
        let expected = results(&scene, &state);
        let bounds = Bounds::new(&scene, &state, &expected);
        let others = [untilted, none].map(|scene| results(&scene, &state));
        for (i, (what, expected)) in expected.iter().enumerate() {
            let [untilted, none] = others.each_ref().map(|results| &results[i].1[..]);
            let say = format!("armature {armature}, axes {axes:?}: {what}");
            assert_near(&say, untilted, expected, bounds.of(what, expected));
            assert_near(&say, none, expected, bounds.of(what, expected));
        }
    }
}

#[test]
fn a_wrench_of_zero_is_none() {
    for seed in 0..12 {
        let scene = builder(seed).build().unwrap();
        let (q, qd, tau) = random_state(&scene, &mut Random::new(seed));
        let mut workspace = scene.workspace();
        let (mut with, mut without) = (vec![f64::NAN; scene.nv()], vec![f64::NAN; scene.nv()]);
        let zeros = vec![SpatialVector::zeros(); scene.model().bodies.len()];
        scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &zeros, &mut with).unwrap();
        scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &[], &mut without).unwrap();
        assert_near("accelerations", &with, &without, 0.0);
    }
}

#[test]
fn switches_that_are_off_keep_what_they_name() {
    let bodies = |simplifications| builder(0).simplifications(simplifications).build().unwrap().model().bodies.len();
    let all = bodies(Simplifications::all());
    // "welded", "frame" and "tool"; the column is on the base.
    assert_eq!(bodies(Simplifications { fixed_joints: false, ..Simplifications::all() }), all + 3);
    assert_eq!(bodies(Simplifications { base_links: false, ..Simplifications::all() }), all + 1);
    assert_eq!(bodies(Simplifications::none()), all + 5);
    let scene = builder(0).simplifications(Simplifications::none()).build().unwrap();
    assert!(scene.plan().items.iter().all(|item| item.switch.is_none()));
    assert_eq!(scene.source().left_out(), Simplifications::none());
    assert_eq!(scene.lock(&["to slide"], &scene.neutral()).unwrap().source().left_out(), Simplifications::none());
}

#[test]
fn the_plan_names_every_switch_and_what_it_saves() {
    let plan = builder(0).gravity([0.0; 3]).build().unwrap().plan();
    for &(name, _) in Simplifications::SWITCHES {
        let item = plan.items.iter().find(|item| item.switch == Some(name));
        let item = item.unwrap_or_else(|| panic!("no item for {name}"));
        assert!(item.count > 0 && item.operations > 0, "{name}: {item:?}");
    }
    // With gravity there is no zero bias.
    let plan = builder(0).build().unwrap().plan();
    assert!(plan.items.iter().all(|item| item.switch != Some("zero_gravity")));
}

#[test]
fn operators_and_estimation_refuse_bodies_that_cannot_move() {
    for simplifications in [
        Simplifications { fixed_joints: false, ..Simplifications::all() },
        Simplifications { base_links: false, ..Simplifications::all() },
    ] {
        let scene = builder(0).simplifications(simplifications).build().unwrap();
        let found = scene.factor(&mut scene.workspace(), &scene.neutral());
        assert!(matches!(found, Err(Error::Argument { .. })), "{:?}", found.err());
    }
}

/// Entries of a matrix, or of a vector, for some rows.
fn kept(matrix: &[f64], nv: usize, rows: &[usize]) -> Vec<f64> {
    rows.iter().flat_map(|&i| rows.iter().map(move |&j| matrix[i * nv + j])).collect()
}

#[test]
fn locked_joints_are_rows_removed() {
    for seed in 0..12 {
        let scene = builder(seed).build().unwrap();
        // Every second joint; with all outboard joints, if its children are locked too.
        let locked: Vec<&str> = scene.joints().iter().skip(1).step_by(2).map(|joint| joint.name.as_str()).collect();
        let (q, mut qd, tau) = random_state(&scene, &mut Random::new(seed));
        let (mut rows, mut coordinates) = (Vec::new(), Vec::new());
        for joint in scene.joints() {
            if locked.contains(&joint.name.as_str()) {
                qd[joint.v.clone()].fill(0.0);
            } else {
                rows.extend(joint.v.clone());
                coordinates.extend(joint.q.clone());
            }
        }
        let nv = scene.nv();
        let (mut workspace, mut mass, mut bias) = (scene.workspace(), vec![f64::NAN; nv * nv], vec![f64::NAN; nv]);
        scene.mass_matrix(&mut workspace, &q, &mut mass).unwrap();
        scene.bias_torque(&mut workspace, &q, &qd, &mut bias).unwrap();
        let pick = |values: &[f64], at: &[usize]| at.iter().map(|&i| values[i]).collect::<Vec<f64>>();
        let mass = kept(&mass, nv, &rows);
        let (bias, tau, qd_kept) = (pick(&bias, &rows), pick(&tau, &rows), pick(&qd, &rows));
        let state = State { q: pick(&q, &coordinates), qd: qd_kept, u: tau.clone(), wrenches: Vec::new() };
        let smaller = scene.lock(&locked, &q).unwrap();
        assert_eq!(smaller.nv(), rows.len());
        let found = results(&smaller, &state);
        let bounds = Bounds::new(&smaller, &state, &found);
        let matrix = DMatrix::from_row_slice(rows.len(), rows.len(), &mass);
        let right = DVector::from_vec(tau) - DVector::from_column_slice(&bias);
        let acceleration = matrix.cholesky().unwrap().solve(&right);
        for (what, found) in &found {
            let expected = match what.as_str() {
                "M" => &mass[..],
                "torque: bias" => &bias[..],
                what if what.starts_with("acceleration") => acceleration.as_slice(),
                _ => continue,
            };
            assert_near(&format!("seed {seed}: {what}"), found, expected, bounds.of(what, expected));
        }
    }
}

/// A rotating hub on the base, with three arms of three joints each; some joints have several degrees of freedom.
fn arms(seed: u64) -> Scene {
    let mut random = Random::new(seed);
    let base = LinkDescription { name: "base".into(), inertial: None };
    let hub = LinkDescription { name: "hub".into(), inertial: Some(random_inertial(&mut random)) };
    let turn = JointDescription::new("turn", JointKind::Revolute, "base", "hub");
    let mut builder = SceneBuilder::new().link(base).link(hub).joint(turn);
    for arm in ["a", "b", "c"] {
        let mut parent = "hub".to_owned();
        for k in 0..3 {
            let name = format!("{arm}{k}");
            let kind = ALL_KINDS[random.below(ALL_KINDS.len())];
            let mut joint = JointDescription::new(format!("to {name}"), kind, parent, name.clone());
            joint.origin.rotation = random.rotation();
            joint.origin.lever = random.vector() * 0.5;
            joint.axis = random.vector();
            joint.armature = if seed.is_multiple_of(2) { 0.1 } else { 0.0 };
            let inertial = Some(random_inertial(&mut random));
            builder = builder.link(LinkDescription { name: name.clone(), inertial }).joint(joint);
            parent = name;
        }
    }
    builder.build().unwrap()
}

/// All values of a factor as bits: pivots, and all operators on some vectors.
fn bits(factor: &Factor<f64>) -> Vec<u64> {
    let mut all: Vec<u64> = factor.pivots().map(f64::to_bits).collect();
    let mut random = Random::new(1);
    for &(_, kind) in KINDS {
        let (rows, columns) = kind.shape(factor.nv());
        let (mut y, mut x) = (vec![f64::NAN; rows], random.array(columns, 1.0));
        factor.operator(kind).apply(&x, &mut y);
        all.extend(y.iter().map(|y| y.to_bits()));
        (y, x) = (vec![f64::NAN; columns], random.array(rows, 1.0));
        factor.operator(kind).apply_transpose(&x, &mut y);
        all.extend(y.iter().map(|y| y.to_bits()));
    }
    all
}

#[test]
fn an_updated_factor_has_the_bits_of_a_new_one() {
    for seed in 0..8 {
        let scene = arms(seed);
        let mut random = Random::new(seed);
        for &(_, form) in phipsi::filter::FORMS {
            let mut workspace = scene.workspace().in_form(form);
            let (mut q, ..) = random_state(&scene, &mut random);
            let mut factor = scene.factor(&mut workspace, &q).unwrap();
            let all = scene.model().bodies.len();
            // None, one joint of one arm, the hub, two arms, all.
            for moved in [&[][..], &["to b2"], &["to c0"], &["turn"], &["to a1", "to c2"], &["turn", "to a2", "to b2"]]
            {
                let (other, ..) = random_state(&scene, &mut random);
                for joint in scene.joints().iter().filter(|joint| moved.contains(&joint.name.as_str())) {
                    q[joint.q.clone()].copy_from_slice(&other[joint.q.clone()]);
                }
                // Lambda is computed on request and must be recomputed.
                let _ = bits(&factor);
                let bodies = scene.update_factor(&mut workspace, &mut factor, &q).unwrap();
                let say = format!("seed {seed}, {form:?}, moved {moved:?}");
                assert_eq!(bits(&factor), bits(&scene.factor(&mut workspace, &q).unwrap()), "{say}");
                if form == Form::Covariance {
                    // A planar joint is three bodies, of which only those whose coordinate changed, and the bodies
                    // inboard of them, change.
                    assert!(bodies < all && (bodies > 0) != moved.is_empty(), "{say}: {bodies} of {all}");
                    assert!(moved != ["turn"] || bodies == 1, "{say}: {bodies}");
                } else {
                    assert_eq!(bodies, all, "{say}");
                }
            }
        }
    }
}

#[test]
fn an_update_to_where_a_pivot_is_lost_changes_nothing() {
    // A prismatic joint along x on another one: at q = 0 of the rotation between them, both move only the last mass.
    let point = Inertial { mass: 1.0, center: Vector3::zeros(), central: Symmetric3::zero() };
    let mut builder = SceneBuilder::new();
    for (name, inertial) in [("base", None), ("carriage", None), ("wheel", None), ("weight", Some(point))] {
        builder = builder.link(LinkDescription { name: name.into(), inertial });
    }
    let mut first = JointDescription::new("first", JointKind::Prismatic, "base", "carriage");
    let mut turn = JointDescription::new("turn", JointKind::Revolute, "carriage", "wheel");
    let mut last = JointDescription::new("last", JointKind::Prismatic, "wheel", "weight");
    (first.axis, last.axis, turn.armature) = (Vector3::x(), Vector3::x(), 0.1);
    let scene = builder.joint(first).joint(turn).joint(last).build().unwrap();
    let mut workspace = scene.workspace().in_form(Form::Covariance);
    let mut factor = scene.factor(&mut workspace, &[0.0, 1.0, 0.2]).unwrap();
    let before = bits(&factor);
    let error = scene.update_factor(&mut workspace, &mut factor, &[0.0, 0.0, 0.3]).unwrap_err();
    assert_eq!(error, scene.factor(&mut workspace, &[0.0, 0.0, 0.3]).unwrap_err());
    assert!(matches!(error, Error::SingularJoint { ref joint, .. } if joint == "first"), "{error}");
    assert_eq!(bits(&factor), before);
    let error = scene.update_factor(&mut workspace, &mut factor, &[0.0, f64::NAN, 0.3]).unwrap_err();
    assert!(matches!(error, Error::NotFinite { .. }), "{error}");
    let other = arms(0);
    let error = other.update_factor(&mut workspace, &mut factor, &other.neutral()).unwrap_err();
    assert!(matches!(error, Error::Argument { .. }), "{error}");
    assert_eq!(bits(&factor), before);
}

#[test]
fn the_plan_counts_what_calls_on_a_factor_save() {
    let scene = arms(1);
    let (q, mut moved) = (scene.neutral(), scene.neutral());
    let last = scene.joints().last().unwrap();
    let mut step = vec![0.0; scene.nv()];
    step[last.v.end - 1] = 0.1;
    scene.integrate(&q, &step, &mut moved).unwrap();
    let calls = of_factor(&scene, &q, &moved);
    // One arm of three and the hub: only these are recomputed; the results of the other two arms are added again.
    assert!(2 * calls.updated.flops() < calls.made.flops(), "{calls:?}");
    // The thresholds of two pivot monitors are products.
    assert!(of_factor(&scene, &q, &q).updated.flops() <= 2);
    let plan = scene.plan();
    let found =
        |what: &str| plan.items.iter().find(|item| item.what.contains(what)).unwrap_or_else(|| panic!("{what}"));
    let branch = found("only the last joint");
    assert_eq!(branch.count, scene.model().bodies.len() - calls.bodies);
    // The plan counts the sweeps; the factor that keeps everything takes other operations for the same numbers.
    let is_about = |found: u64, expected: u64| found.abs_diff(expected) <= expected / 4;
    let saved = calls.made.flops() - calls.updated.flops();
    assert!(is_about(branch.operations.try_into().unwrap(), saved), "{} of {saved}", branch.operations);
    let shared = found("calls that share q");
    let solved: u64 = shared.saved.split(' ').next().unwrap().parse().unwrap();
    assert!(shared.operations > 0 && is_about(solved, calls.solved.flops()), "{solved} of {:?}", calls.solved);
    assert_eq!(found("outputs").count, 4);
    assert!(found("outputs").operations > 0);
    // On a chain all bodies are inboard of the last joint.
    let chain = phipsi::scenes::chain(5).unwrap().plan();
    assert!(chain.items.iter().all(|item| !item.what.contains("only the last joint")));
}

#[test]
fn a_locked_subtree_is_one_body() {
    for seed in 0..6 {
        let scene = arms(seed);
        let (q, ..) = random_state(&scene, &mut Random::new(seed));
        let arm = ["to b0", "to b1", "to b2"];
        let locked = scene.lock(&arm, &q).unwrap();
        // All four links of it are one body, that of the hub.
        let hub = locked.link("hub").unwrap().body;
        assert!(hub.is_some());
        assert!(["b0", "b1", "b2"].iter().all(|link| locked.link(link).unwrap().body == hub));
        let mass =
            |scene: &Scene, link: &str| scene.model().bodies[scene.link(link).unwrap().body.unwrap()].inertia.mass;
        let parts: f64 = ["hub", "b0", "b1", "b2"].iter().map(|link| mass(&scene, link)).sum();
        assert_near("mass", &[mass(&locked, "hub")], &[parts], tolerance::product(4, parts));
        // If the joint to the hub is locked too, the arm is part of the base.
        let fixed = scene.lock(&["turn", "to b0", "to b1", "to b2"], &q).unwrap();
        assert!(["hub", "b0", "b1", "b2"].iter().all(|link| fixed.link(link).unwrap().body.is_none()));
        // One by one, or all at once.
        let (first, rest) = (scene.lock(&arm[..1], &q).unwrap(), &arm[1..]);
        let mut kept = q.clone();
        kept.drain(scene.joint("to b0").unwrap().q.clone());
        let twice = first.lock(rest, &kept).unwrap();
        for scene in [&locked, &twice] {
            assert_eq!(scene.source().locked_joints().collect::<Vec<_>>(), arm);
            let plan = scene.plan();
            let item = plan.items.iter().find(|item| item.what.contains("locked")).unwrap();
            assert_eq!((item.count, &item.names[..]), (3, &arm.map(str::to_owned)[..]));
            // Compared with the scene where they move, by operation counts.
            let of = |scene: &Scene| {
                let ones = vec![1.0; scene.nv()];
                let state =
                    Arguments { q: &scene.neutral(), qd: &ones, u: &ones, wrenches: &[], ..Arguments::default() };
                let task = Task::Algorithm(Algorithm::ForwardDynamics(Form::Covariance));
                count(scene, task, &state).operations.flops()
            };
            assert_eq!(u64::try_from(item.operations).unwrap(), of(&arms(seed)) - of(scene));
        }
        let (before, after) = (scene.model().bodies.len(), locked.model().bodies.len());
        let noun = if before - after == 1 { "body that is" } else { "bodies that are" };
        assert!(locked.plan().items.iter().any(|item| item.saved == format!("{} {noun} not visited", before - after)));
    }
    let scene = arms(0);
    assert!(scene.plan().items.iter().all(|item| !item.what.contains("locked")));
}

#[test]
fn one_factor_serves_many_right_sides() {
    for seed in 0..12 {
        let scene = builder(seed).gravity([0.0; 3]).build().unwrap();
        let mut random = Random::new(seed);
        let (q, still) = (random_state(&scene, &mut random).0, vec![0.0; scene.nv()]);
        let mut workspace = scene.workspace();
        let factor = scene.factor(&mut workspace, &q).unwrap();
        for _ in 0..3 {
            let tau = random.array(scene.nv(), 5.0);
            let (mut once, mut again) = (vec![f64::NAN; scene.nv()], vec![f64::NAN; scene.nv()]);
            factor.solve(&tau, &mut once);
            scene.forward_dynamics(&mut workspace, &q, &still, &tau, &[], &mut again).unwrap();
            let state = State { q: q.clone(), qd: still.clone(), u: tau, wrenches: Vec::new() };
            let bounds = Bounds::new(&scene, &state, &results(&scene, &state));
            assert_near(&format!("seed {seed}"), &once, &again, bounds.of("acceleration:", &again));
        }
    }
}
