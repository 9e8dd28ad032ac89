//! The same system in different descriptions: invariant results are equal, others change as predicted.

use crate::common::oracle::{Oracle, ds};
use crate::common::tolerance::{self, assert_near, conditioning, size};
use crate::common::{ALL_KINDS, KINDS_WITH_FIXED, Random, Tree, random_inertial, random_state};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use phipsi::Scene;
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, ROOT_JOINT, SceneBuilder};
use phipsi::spatial::{RigidShift, Symmetric3};

/// Results of the scene in a state.
struct Results {
    mass: DMatrix<f64>,
    bias: DVector<f64>,
    acceleration: DVector<f64>,
}

fn results(scene: &Scene, q: &[f64], qd: &[f64], tau: &[f64]) -> Results {
    let (nv, mut workspace) = (scene.nv(), scene.workspace());
    let (mut mass, mut bias, mut acceleration) = (vec![f64::NAN; nv * nv], vec![f64::NAN; nv], vec![f64::NAN; nv]);
    scene.mass_matrix(&mut workspace, q, &mut mass).unwrap();
    scene.bias_torque(&mut workspace, q, qd, &mut bias).unwrap();
    scene.forward_dynamics(&mut workspace, q, qd, tau, &[], &mut acceleration).unwrap();
    Results {
        mass: DMatrix::from_row_slice(nv, nv, &mass),
        bias: DVector::from_vec(bias),
        acceleration: DVector::from_vec(acceleration),
    }
}

/// Magnitudes for the bounds: of the terms of a torque, and of the amplification of errors by M.
struct Bounds {
    n: usize,
    terms: f64,
    mass: f64,
    conditioning: tolerance::Conditioning,
}

impl Bounds {
    fn new(scene: &Scene, q: &[f64], qd: &[f64], at: &Results) -> Self {
        let (_, terms) = Oracle::new(scene.source()).at(&ds(q), &ds(qd)).bias(&[]);
        let conditioning = conditioning(scene.nv(), at.mass.as_slice());
        Self { n: scene.links().len(), terms, mass: if scene.nv() > 0 { at.mass.amax() } else { 0.0 }, conditioning }
    }

    #[track_caller]
    fn assert_same(&self, what: &str, found: &Results, expected: &Results, tau: &[f64]) {
        let say = |part: &str| format!("{what}: {part}");
        assert_near(&say("M"), found.mass.as_slice(), expected.mass.as_slice(), tolerance::product(self.n, self.mass));
        assert_near(
            &say("bias"),
            found.bias.as_slice(),
            expected.bias.as_slice(),
            tolerance::product(self.n, self.terms),
        );
        let x = size(expected.acceleration.as_slice());
        let bound = tolerance::solution(&self.conditioning, x, self.terms.max(size(tau)));
        assert_near(&say("qdd"), found.acceleration.as_slice(), expected.acceleration.as_slice(), bound);
    }
}

/// Random mixed trees, seeds 0..20, of two to eight joints.
fn trees() -> impl Iterator<Item = Tree<'static>> {
    (0..20).map(|seed| Tree {
        seed,
        bodies: 2 + usize::try_from(seed).unwrap() % 7,
        kinds: if seed % 2 == 0 { &ALL_KINDS } else { &KINDS_WITH_FIXED },
        branching: 0.6,
        armature: if seed % 3 == 0 { 0.0 } else { 0.2 },
        floating: seed % 4 == 1,
    })
}

/// The same builder with its links and joints reordered or replaced.
fn rebuilt(source: &SceneBuilder, links: Vec<LinkDescription>, joints: Vec<JointDescription>) -> SceneBuilder {
    let mut builder = SceneBuilder::new().gravity(source.gravity_vector()).floating_base(source.is_floating());
    for link in links {
        builder = builder.link(link);
    }
    for joint in joints {
        builder = builder.joint(joint);
    }
    builder
}

fn link(name: &str, inertial: Option<Inertial>) -> LinkDescription {
    LinkDescription { name: name.into(), inertial }
}

/// `values` of one scene in the order of another scene with the same joints: coordinates (`q`) or velocities.
fn reordered(from: &Scene, to: &Scene, values: &[f64], coordinates: bool) -> Vec<f64> {
    let range = |joint: &phipsi::scene::Joint| if coordinates { joint.q.clone() } else { joint.v.clone() };
    to.joints().iter().flat_map(|joint| values[range(from.joint(&joint.name).unwrap())].to_vec()).collect()
}

#[test]
fn order_of_the_description_only_permutes_the_results() {
    let mut permuted = 0;
    for tree in trees() {
        let source = tree.builder();
        let scene = source.clone().build().unwrap();
        let mut random = Random::new(100 + tree.seed);
        let (mut links, mut joints) = (source.links().to_vec(), source.joints().to_vec());
        for i in (1..joints.len()).rev() {
            joints.swap(i, random.below(i + 1));
        }
        for i in (1..links.len()).rev() {
            links.swap(i, random.below(i + 1));
        }
        let shuffled = rebuilt(&source, links, joints).build().unwrap();
        let (q, qd, tau) = random_state(&scene, &mut random);
        let turn = |v: &[f64]| reordered(&scene, &shuffled, v, false);
        let found = results(&shuffled, &reordered(&scene, &shuffled, &q, true), &turn(&qd), &turn(&tau));
        let original = results(&scene, &q, &qd, &tau);
        #[allow(clippy::cast_precision_loss)] // a few dozen
        let index: Vec<f64> = (0..scene.nv()).map(|i| i as f64).collect();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // they were indices above
        let index: Vec<usize> = turn(&index).iter().map(|&i| i as usize).collect();
        permuted += usize::from(!index.is_sorted());
        let nv = scene.nv();
        let expected = Results {
            mass: DMatrix::from_fn(nv, nv, |i, j| original.mass[(index[i], index[j])]),
            bias: DVector::from_fn(nv, |i, _| original.bias[index[i]]),
            acceleration: DVector::from_fn(nv, |i, _| original.acceleration[index[i]]),
        };
        Bounds::new(&scene, &q, &qd, &original).assert_same("shuffled", &found, &expected, &tau);
    }
    assert!(permuted >= 5, "some of the trees have siblings: {permuted}");
}

#[test]
fn a_base_that_stands_elsewhere_changes_nothing() {
    for mut tree in trees() {
        tree.floating = false;
        let source = tree.builder();
        let scene = source.clone().build().unwrap();
        let mut random = Random::new(200 + tree.seed);
        let (q, qd, tau) = random_state(&scene, &mut random);
        // On a rotated ground with the same gravity in the base frame.
        let origin = RigidShift { rotation: random.rotation(), lever: random.vector() };
        let gravity = origin.rotation * Vector3::from(source.gravity_vector());
        let mut ground = JointDescription::new("bolts", JointKind::Fixed, "ground", "base");
        ground.origin = origin;
        let moved = source.clone().link(link("ground", None)).joint(ground).gravity(gravity.into()).build().unwrap();
        let original = results(&scene, &q, &qd, &tau);
        let bounds = Bounds::new(&scene, &q, &qd, &original);
        bounds.assert_same("moved base", &results(&moved, &q, &qd, &tau), &original, &tau);
    }
}

#[test]
fn a_body_in_two_pieces_is_the_same_body() {
    for tree in trees() {
        let source = tree.builder();
        let mut random = Random::new(300 + tree.seed);
        let name = format!("link{}", random.below(tree.bodies));
        let (first, second) = (random_inertial(&mut random), random_inertial(&mut random));
        let mut weld = JointDescription::new("weld", JointKind::Fixed, name.clone(), "piece");
        weld.origin = RigidShift { rotation: random.rotation(), lever: random.vector() };

        let with = |inertial: Inertial| {
            let mut links = source.links().to_vec();
            links.iter_mut().find(|link| link.name == name).unwrap().inertial = Some(inertial);
            rebuilt(&source, links, source.joints().to_vec())
        };
        let split = with(first).link(link("piece", Some(second))).joint(weld.clone()).build().unwrap();
        let whole = with(welded(&first, &second, &weld.origin)).build().unwrap();
        let (q, qd, tau) = random_state(&whole, &mut random);
        let original = results(&whole, &q, &qd, &tau);
        let bounds = Bounds::new(&whole, &q, &qd, &original);
        bounds.assert_same("welded", &results(&split, &q, &qd, &tau), &original, &tau);
    }
}

/// Two bodies as one, by the parallel-axis theorem about the common center of mass.
fn welded(first: &Inertial, second: &Inertial, placement: &RigidShift<f64>) -> Inertial {
    let r = placement.rotation;
    let parts = [
        (first.mass, first.centre, first.central.to_matrix()),
        (second.mass, r * second.centre + placement.lever, r * second.central.to_matrix() * r.transpose()),
    ];
    let mass = parts[0].0 + parts[1].0;
    let centre = (parts[0].1 * parts[0].0 + parts[1].1 * parts[1].0) / mass;
    let mut central = Matrix3::zeros();
    for (m, c, inertia) in parts {
        let arm = c - centre;
        central += inertia + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * m;
    }
    Inertial { mass, centre, central: Symmetric3::from_upper(&central) }
}

#[test]
fn accelerations_do_not_know_the_unit_of_mass() {
    for tree in trees() {
        let source = tree.builder();
        let scene = source.clone().build().unwrap();
        let (q, qd, tau) = random_state(&scene, &mut Random::new(400 + tree.seed));
        let original = results(&scene, &q, &qd, &tau);
        let scaled_by = |s: f64| {
            let mut links = source.links().to_vec();
            for inertial in links.iter_mut().filter_map(|link| link.inertial.as_mut()) {
                inertial.mass *= s;
                inertial.central = Symmetric3::new(inertial.central.entries.map(|x| x * s));
            }
            let mut joints = source.joints().to_vec();
            for joint in &mut joints {
                joint.armature *= s;
            }
            let heavier = rebuilt(&source, links, joints).build().unwrap();
            let tau: Vec<f64> = tau.iter().map(|x| x * s).collect();
            results(&heavier, &q, &qd, &tau)
        };
        // Multiplication by a power of two causes no rounding.
        let found = scaled_by(1024.0);
        assert_eq!(found.mass, &original.mass * 1024.0);
        assert_eq!(found.bias, &original.bias * 1024.0);
        assert_eq!(found.acceleration, original.acceleration);
        let found = scaled_by(3.7);
        let found = Results { mass: found.mass / 3.7, bias: found.bias / 3.7, ..found };
        Bounds::new(&scene, &q, &qd, &original).assert_same("scaled", &found, &original, &tau);
    }
}

/// A tree whose joint "knee" is `middle`, between a random chain and a random hand; one coordinate order throughout.
fn with_knee(seed: u64, middle: &[JointDescription]) -> SceneBuilder {
    let mut random = Random::new(seed);
    let mut joint = |name: &str, kind, parent: &str, child: &str, armature| {
        let mut joint = JointDescription::new(name, kind, parent, child);
        joint.origin = RigidShift { rotation: random.rotation(), lever: random.vector() };
        joint.axis = random.vector();
        joint.armature = armature;
        joint
    };
    let shoulder = joint("shoulder", JointKind::Revolute, "base", "thigh", 0.1);
    let wrist = joint("wrist", JointKind::Revolute, "shin", "hand", 0.0);
    let finger = joint("finger", JointKind::Prismatic, "hand", "tip", 0.0);
    let mut builder = SceneBuilder::new().link(link("base", None)).joint(shoulder);
    for name in ["thigh", "shin", "hand", "tip"] {
        builder = builder.link(link(name, Some(random_inertial(&mut random))));
    }
    for joint in middle {
        if builder.links().iter().all(|link| link.name != joint.child) {
            builder = builder.link(link(&joint.child, None));
        }
        builder = builder.joint(joint.clone());
    }
    builder.joint(wrist).joint(finger)
}

/// The knee as one joint of a type, at a random pose.
fn knee(seed: u64, kind: JointKind) -> JointDescription {
    let mut random = Random::new(1 + seed);
    let mut joint = JointDescription::new("knee", kind, "thigh", "shin");
    joint.origin = RigidShift { rotation: random.rotation(), lever: random.vector() };
    joint
}

/// The knee as a chain of one-axis joints with massless links.
fn knee_chain(seed: u64, parts: &[(JointKind, Vector3<f64>)]) -> Vec<JointDescription> {
    let between = |i: usize| format!("knee{i}");
    let name = |i: usize| match i {
        0 => "thigh".to_owned(),
        i if i == parts.len() => "shin".to_owned(),
        i => between(i - 1),
    };
    (0..parts.len())
        .map(|i| {
            let mut joint = JointDescription::new(format!("knee{i}"), parts[i].0, name(i), name(i + 1));
            if i == 0 {
                joint.origin = knee(seed, JointKind::Fixed).origin;
            }
            joint.axis = parts[i].1;
            joint
        })
        .collect()
}

#[test]
fn a_planar_joint_is_two_slides_and_a_hinge() {
    for seed in 500..510 {
        let slides = [
            (JointKind::Prismatic, Vector3::x()),
            (JointKind::Prismatic, Vector3::y()),
            (JointKind::Revolute, Vector3::z()),
        ];
        let planar = with_knee(seed, &[knee(seed, JointKind::Planar)]).build().unwrap();
        let chain = with_knee(seed, &knee_chain(seed, &slides)).build().unwrap();
        let (q, qd, tau) = random_state(&planar, &mut Random::new(seed));
        let original = results(&chain, &q, &qd, &tau);
        let bounds = Bounds::new(&chain, &q, &qd, &original);
        bounds.assert_same("planar", &results(&planar, &q, &qd, &tau), &original, &tau);
    }
}

#[test]
fn a_universal_joint_is_two_hinges() {
    for seed in 540..550 {
        let hinges = [(JointKind::Revolute, Vector3::x()), (JointKind::Revolute, Vector3::y())];
        let universal = with_knee(seed, &[knee(seed, JointKind::Universal)]).build().unwrap();
        let chain = with_knee(seed, &knee_chain(seed, &hinges)).build().unwrap();
        let (q, qd, tau) = random_state(&universal, &mut Random::new(seed));
        let original = results(&chain, &q, &qd, &tau);
        let bounds = Bounds::new(&chain, &q, &qd, &original);
        bounds.assert_same("universal", &results(&universal, &q, &qd, &tau), &original, &tau);
    }
}

#[test]
fn a_screw_without_pitch_is_a_hinge() {
    for seed in 520..530 {
        let screw = with_knee(seed, &[knee(seed, JointKind::Screw { pitch: 0.0 })]).build().unwrap();
        let hinge = with_knee(seed, &[knee(seed, JointKind::Revolute)]).build().unwrap();
        let free = with_knee(seed, &[knee(seed, JointKind::Continuous)]).build().unwrap();
        let (q, qd, tau) = random_state(&hinge, &mut Random::new(seed));
        let original = results(&hinge, &q, &qd, &tau);
        let bounds = Bounds::new(&hinge, &q, &qd, &original);
        bounds.assert_same("screw", &results(&screw, &q, &qd, &tau), &original, &tau);
        let continuous = results(&free, &q, &qd, &tau);
        assert_eq!(continuous.acceleration, original.acceleration, "continuous is revolute");
    }
}

/// Three hinges about z, y, x: the same M through their Jacobian, and the same motion for the same power.
#[test]
fn a_spherical_joint_is_three_hinges() {
    for seed in 540..550 {
        let hinges = [
            (JointKind::Revolute, Vector3::z()),
            (JointKind::Revolute, Vector3::y()),
            (JointKind::Revolute, Vector3::x()),
        ];
        let ball = with_knee(seed, &[knee(seed, JointKind::Spherical)]).build().unwrap();
        let chain = with_knee(seed, &knee_chain(seed, &hinges)).build().unwrap();
        let (q, qd, tau) = random_state(&chain, &mut Random::new(seed));
        let (yaw, pitch, roll) = (q[1], q[2], q[3]);
        let turned = nalgebra::UnitQuaternion::from_euler_angles(roll, pitch, yaw).coords;
        let ball_q = [&q[..1], turned.as_slice(), &q[4..]].concat();

        // Angular velocity in the child frame = columns . (yaw, pitch, roll) velocities, and the derivatives of the
        // columns.
        let roll_back = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), -roll);
        let pitch_back = nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), -pitch);
        let about_pitch = roll_back * Vector3::y();
        let about_yaw = roll_back * (pitch_back * Vector3::z());
        let columns = Matrix3::from_columns(&[about_yaw, about_pitch, Vector3::x()]);
        let rolling = Vector3::x() * qd[3];
        let drift = about_pitch.cross(&rolling) * qd[2] + about_yaw.cross(&(rolling + about_pitch * qd[2])) * qd[1];
        let mut jacobian = DMatrix::<f64>::identity(6, 6);
        jacobian.fixed_view_mut::<3, 3>(1, 1).copy_from(&columns);
        let mut drifted = DVector::zeros(6);
        drifted.fixed_rows_mut::<3>(1).copy_from(&drift);

        let ball_qd = &jacobian * DVector::from_column_slice(&qd);
        let ball_tau = jacobian.transpose().lu().solve(&DVector::from_column_slice(&tau)).unwrap();
        let expected = results(&chain, &q, &qd, &tau);
        let ball = results(&ball, &ball_q, ball_qd.as_slice(), ball_tau.as_slice());
        let found = Results {
            mass: jacobian.transpose() * &ball.mass * &jacobian,
            bias: jacobian.transpose() * (&ball.bias + &ball.mass * &drifted),
            acceleration: jacobian.clone().lu().solve(&(&ball.acceleration - &drifted)).unwrap(),
        };
        let mut bounds = Bounds::new(&chain, &q, &qd, &expected);
        // The angles themselves have the condition number of their Jacobian.
        let angles = conditioning(6, jacobian.as_slice()).number;
        bounds.terms = (bounds.terms + bounds.mass * drift.norm()) * angles;
        bounds.mass *= angles;
        bounds.conditioning.number *= angles;
        bounds.assert_same("spherical", &found, &expected, &tau);
    }
}

#[test]
fn a_floating_base_that_is_locked_is_a_fixed_base() {
    for mut tree in trees() {
        tree.floating = true;
        let floating = tree.scene();
        let fixed = rebuilt(floating.source(), floating.source().links().to_vec(), floating.source().joints().to_vec())
            .floating_base(false);
        let (q, qd, tau) = random_state(&floating, &mut Random::new(600 + tree.seed));
        let locked = floating.lock(&[ROOT_JOINT], &q).unwrap();
        assert_eq!((locked.nq() + 7, locked.nv() + 6), (floating.nq(), floating.nv()));
        // The base is rotated, so that gravity of a fixed base is expressed in that frame.
        let placement = floating.placements(&q).unwrap()[0];
        let gravity = placement.rotate_back(&Vector3::from(floating.source().gravity_vector()));
        let fixed = fixed.gravity(gravity.into()).build().unwrap();
        let original = results(&fixed, &q[7..], &qd[6..], &tau[6..]);
        let bounds = Bounds::new(&fixed, &q[7..], &qd[6..], &original);
        let found = results(&locked, &q[7..], &qd[6..], &tau[6..]);
        bounds.assert_same("locked base", &found, &original, &tau[6..]);
        let link = format!("link{}", tree.bodies - 1);
        let (at, before) = (locked.placements(&q[7..]).unwrap(), floating.placements(&q).unwrap());
        let place = |scene: &Scene, all: &[RigidShift<f64>]| {
            all[scene.links().iter().position(|l| l.name == link).unwrap()].lever
        };
        let (found, expected) = (place(&locked, &at), place(&floating, &before));
        let bound = tolerance::product(tree.bodies, 1.0 + expected.amax());
        assert_near("locked base: place of the last link", found.as_slice(), expected.as_slice(), bound);
    }
}

#[test]
fn locking_a_joint_deletes_its_rows_and_columns() {
    let mut locked_rows = 0;
    for tree in trees() {
        let scene = tree.scene();
        let mut random = Random::new(700 + tree.seed);
        let (q, qd, _) = random_state(&scene, &mut random);
        let (mut kept, mut names) = (Vec::new(), Vec::new());
        for joint in scene.joints() {
            if random.below(2) == 0 {
                names.push(joint.name.as_str());
            } else {
                kept.push(joint);
            }
        }
        let locked = scene.lock(&names, &q).unwrap();
        let of = |coordinates: bool| -> Vec<usize> {
            kept.iter().flat_map(|joint| if coordinates { joint.q.clone() } else { joint.v.clone() }).collect()
        };
        let (rows, pick) =
            (of(false), |values: &[f64], at: &[usize]| at.iter().map(|&i| values[i]).collect::<Vec<_>>());
        locked_rows += scene.nv() - rows.len();
        assert_eq!(locked.nv(), rows.len());
        // The locked joints do not move in the complete scene either.
        let mut rates = vec![0.0; scene.nv()];
        for &row in &rows {
            rates[row] = qd[row];
        }
        let (nv, n) = (scene.nv(), rows.len());
        let all = results(&scene, &q, &rates, &vec![0.0; nv]);
        let part = results(&locked, &pick(&q, &of(true)), &pick(&rates, &rows), &vec![0.0; n]);
        let mass = DMatrix::from_fn(n, n, |i, j| all.mass[(rows[i], rows[j])]);
        let bounds = Bounds::new(&scene, &q, &rates, &all);
        let bound = tolerance::product(bounds.n, bounds.mass);
        assert_near("locked: M", part.mass.as_slice(), mass.as_slice(), bound);
        let bias = pick(all.bias.as_slice(), &rows);
        assert_near("locked: bias", part.bias.as_slice(), &bias, tolerance::product(bounds.n, bounds.terms));
    }
    assert!(locked_rows > 50, "{locked_rows}");
}

#[test]
fn a_rotation_has_two_quaternions_and_angles_have_turns() {
    for tree in trees() {
        let scene = tree.scene();
        let (q, qd, tau) = random_state(&scene, &mut Random::new(800 + tree.seed));
        let original = results(&scene, &q, &qd, &tau);
        let (mut negated, mut longer) = (q.clone(), q.clone());
        for joint in scene.joints() {
            match joint.quaternion() {
                Some(range) => {
                    negated[range.clone()].iter_mut().for_each(|x| *x = -*x);
                    longer[range].iter_mut().for_each(|x| *x *= 1.0005);
                }
                None if matches!(joint.kind, JointKind::Revolute | JointKind::Continuous) => {
                    longer[joint.q.start] += std::f64::consts::TAU;
                }
                None => {}
            }
        }
        assert_eq!(results(&scene, &negated, &qd, &tau).acceleration, original.acceleration, "-q is the same rotation");
        let bounds = Bounds::new(&scene, &q, &qd, &original);
        bounds.assert_same("longer quaternion", &results(&scene, &longer, &qd, &tau), &original, &tau);
    }
}

#[test]
fn a_scene_built_again_from_its_source_is_the_same() {
    for tree in trees() {
        let scene = tree.scene();
        let again = scene.source().clone().build().unwrap();
        assert_eq!(scene.model(), again.model());
        assert_eq!((scene.links(), scene.joints()), (again.links(), again.joints()));
    }
}
