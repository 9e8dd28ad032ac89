//! One valid scene and one valid call; then one broken argument per test. Messages name the subject, what was
//! found and what was expected.

use crate::common::arm::{assembled, link, parts};
use nalgebra::{Matrix3, Vector3, Vector6};
use phipsi::kinematics::ReferenceFrame;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, Mimic, SceneBuilder, SceneWarning};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene};

fn valid() -> Scene {
    assembled(parts()).build().unwrap()
}

/// Breaks one part; the error must name `subject`, with these words in what was found and expected.
#[track_caller]
fn refused(
    broken: impl FnOnce(&mut Vec<LinkDescription>, &mut Vec<JointDescription>),
    (subject, found, expected): (&str, &str, &str),
) {
    let (mut links, mut joints) = parts();
    broken(&mut links, &mut joints);
    assert_scene_error(assembled((links, joints)).build(), (subject, found, expected));
}

#[track_caller]
fn assert_scene_error(result: Result<Scene, Error>, words: (&str, &str, &str)) {
    let error = result.map(|_| ()).expect_err("a broken scene is refused");
    let Error::Scene { subject, found, expected } = &error else { panic!("not a scene error: {error}") };
    assert_eq!(subject, words.0, "{error}");
    assert!(found.contains(words.1), "{error}");
    assert!(expected.contains(words.2), "{error}");
    assert_eq!(error.to_string(), format!("{subject}: found {found}; expected {expected}"));
}

#[test]
fn the_parts_are_valid_and_say_nothing() {
    let scene = assembled(parts()).strict(true).build().unwrap();
    assert!(scene.warnings().is_empty());
    assert_eq!((scene.nq(), scene.nv()), (5, 4));
}

#[test]
fn no_link() {
    assert_scene_error(SceneBuilder::new().build(), ("scene", "no link", "at least one link"));
}

#[test]
fn a_cycle_beside_the_root() {
    refused(
        |links, joints| {
            links.extend([link("a", None), link("b", None)]);
            joints.push(JointDescription::new("ab", JointKind::Revolute, "a", "b"));
            joints.push(JointDescription::new("ba", JointKind::Revolute, "b", "a"));
        },
        ("link \"a\"", "a cycle: no path from it to the root link \"base\"", "a tree"),
    );
}

#[test]
fn a_cycle_of_everything() {
    refused(
        |_, joints| joints.push(JointDescription::new("loop", JointKind::Fixed, "hand", "base")),
        ("link \"base\"", "a cycle", "one root link"),
    );
}

#[test]
fn a_joint_from_a_link_to_itself() {
    refused(
        |links, joints| {
            links.push(link("ring", None));
            joints.push(JointDescription::new("self", JointKind::Revolute, "ring", "ring"));
        },
        ("link \"ring\"", "a cycle", "a tree"),
    );
}

#[test]
fn two_roots() {
    refused(
        |links, _| links.push(link("island", None)),
        ("link \"island\"", "a second root beside \"base\"", "one root"),
    );
}

#[test]
fn an_unknown_parent() {
    let words = ("joint \"wrist\"", "parent link \"leg\", which is not there", "\"base\", \"arm\", \"hand\"");
    refused(|_, joints| joints[1].parent = "leg".into(), words);
}

#[test]
fn an_unknown_child() {
    let words = ("joint \"wrist\"", "child link \"foot\", which is not there", "\"hand\"");
    refused(|_, joints| joints[1].child = "foot".into(), words);
}

#[test]
fn two_parents() {
    refused(
        |_, joints| joints.push(JointDescription::new("strut", JointKind::Fixed, "base", "hand")),
        ("link \"hand\"", "\"wrist\" and \"strut\"", "one parent joint"),
    );
}

#[test]
fn the_same_link_name_twice() {
    refused(|links, _| links.push(link("arm", None)), ("link \"arm\"", "the name twice", "unique link names"));
}

#[test]
fn the_same_joint_name_twice() {
    refused(
        |_, joints| joints[1].name = "shoulder".into(),
        ("joint \"shoulder\"", "the name twice", "unique joint names"),
    );
}

#[test]
fn a_joint_with_the_name_of_the_floating_base() {
    let (links, mut joints) = parts();
    joints[0].name = "root_joint".into();
    assert!(assembled((links.clone(), joints.clone())).build().is_ok());
    let floating = assembled((links, joints)).floating_base(true).build().unwrap();
    assert_eq!(floating.joints()[0].name, "root_joint_");
    assert_eq!(floating.joints()[1].name, "root_joint");
}

#[test]
fn masses_that_are_none() {
    for (mass, found) in [(-1.0, "mass -1"), (f64::NAN, "mass NaN"), (f64::INFINITY, "mass inf")] {
        refused(
            |links, _| links[1].inertial.as_mut().unwrap().mass = mass,
            ("link \"arm\"", found, "a finite mass, zero or positive"),
        );
    }
}

#[test]
fn numbers_of_a_link_that_are_not_finite() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for i in 0..3 {
            refused(
                |links, _| links[2].inertial.as_mut().unwrap().centre[i] = bad,
                ("link \"hand\"", &format!("mass centre with {bad}"), "finite"),
            );
        }
        for i in 0..6 {
            refused(
                |links, _| links[2].inertial.as_mut().unwrap().central.entries[i] = bad,
                ("link \"hand\"", &format!("inertia with {bad}"), "finite"),
            );
        }
    }
}

#[test]
fn numbers_of_a_joint_that_are_not_finite() {
    for bad in [f64::NAN, f64::INFINITY] {
        for i in 0..9 {
            refused(
                |_, joints| joints[1].origin.rotation[i] = bad,
                ("joint \"wrist\"", &format!("{bad} in its origin"), "finite"),
            );
        }
        for i in 0..3 {
            refused(
                |_, joints| joints[1].origin.lever[i] = bad,
                ("joint \"wrist\"", &format!("{bad} in its origin"), "finite"),
            );
            refused(|_, joints| joints[0].axis[i] = bad, ("joint \"shoulder\"", "axis (", "an axis with a direction"));
        }
        refused(
            |_, joints| joints[0].kind = JointKind::Screw { pitch: bad },
            ("joint \"shoulder\"", &format!("pitch {bad}"), "finite"),
        );
    }
}

#[test]
fn gravity_that_is_not_finite() {
    for i in 0..3 {
        let mut gravity = [0.0, 0.0, -9.81];
        gravity[i] = f64::NAN;
        let result = assembled(parts()).gravity(gravity).build();
        assert_scene_error(result, ("gravity", "NaN", "finite numbers"));
    }
}

#[test]
fn an_axis_of_no_direction() {
    for kind in [
        JointKind::Revolute,
        JointKind::Continuous,
        JointKind::Prismatic,
        JointKind::Planar,
        JointKind::Screw { pitch: 1.0 },
    ] {
        refused(
            |_, joints| {
                joints[0].kind = kind;
                joints[0].axis = Vector3::zeros();
            },
            ("joint \"shoulder\"", "axis (0, 0, 0)", "an axis with a direction"),
        );
    }
    // If the axis is not used, it is not checked.
    let (links, mut joints) = parts();
    joints[1].axis = Vector3::zeros();
    assert!(assembled((links, joints)).build().is_ok());
}

#[test]
fn an_axis_of_any_length_will_do() {
    let (links, mut joints) = parts();
    joints[0].axis *= 1e-9;
    assert_eq!(assembled((links, joints)).build().unwrap().model(), valid().model());
}

#[test]
fn joint_parameters_below_zero() {
    for bad in [-0.5, f64::NAN, f64::INFINITY] {
        let words = |name: &str| format!("{name} {bad}");
        let expected = "a finite number, zero or positive";
        refused(|_, joints| joints[0].armature = bad, ("joint \"shoulder\"", &words("armature"), expected));
        refused(|_, joints| joints[0].damping = bad, ("joint \"shoulder\"", &words("damping"), expected));
        refused(|_, joints| joints[0].friction = bad, ("joint \"shoulder\"", &words("friction"), expected));
        refused(|_, joints| joints[0].spring.stiffness = bad, ("joint \"shoulder\"", &words("stiffness"), expected));
    }
}

#[test]
fn rests_that_are_no_configurations() {
    let shoulder = "joint \"shoulder\"";
    refused(
        |_, joints| joints[0].spring.rest = vec![0.1, 0.2],
        (shoulder, "2 coordinates of rest", "1 coordinates, as a revolute joint has"),
    );
    refused(|_, joints| joints[0].spring.rest = vec![f64::NAN], (shoulder, "rest NaN", "finite numbers"));
    refused(
        |_, joints| {
            joints[0].kind = JointKind::Spherical;
            joints[0].spring.rest = vec![0.0, 0.0, 0.0, 2.0];
        },
        (shoulder, "a quaternion of norm 2 at rest", "unit norm"),
    );
}

#[test]
fn limits_that_are_none() {
    for (lower, upper) in [(1.0, -1.0), (f64::NAN, 1.0), (0.0, f64::NAN)] {
        refused(
            |_, joints| {
                joints[0].limits.lower = lower;
                joints[0].limits.upper = upper;
            },
            ("joint \"shoulder\"", &format!("limits from {lower} to {upper}"), "a lower limit that is not above"),
        );
    }
    for bad in [-1.0, f64::NAN] {
        let words = format!("velocity limit {bad}");
        refused(|_, joints| joints[0].limits.velocity = bad, ("joint \"shoulder\"", &words, "zero or positive"));
        let words = format!("effort limit {bad}");
        refused(|_, joints| joints[0].limits.effort = bad, ("joint \"shoulder\"", &words, "zero or positive"));
    }
}

#[test]
fn an_origin_that_is_no_rotation() {
    let reflection = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    for rotation in [Matrix3::zeros(), Matrix3::identity() * 1.001, reflection] {
        refused(
            |_, joints| joints[0].origin.rotation = rotation,
            ("joint \"shoulder\"", "an origin whose rotation is off", "a rotation matrix"),
        );
    }
}

#[test]
fn inertias_that_no_body_has() {
    let triangle = Symmetric3::new([0.01, 0.0, 0.0, 0.02, 0.0, 0.5]);
    let negative = Symmetric3::new([0.01, 0.0, 0.0, 0.02, 0.0, -0.01]);
    for (central, words) in [(triangle, "break the triangle inequality"), (negative, "one of them negative")] {
        let (mut links, joints) = parts();
        links[2].inertial.as_mut().unwrap().central = central;
        let builder = assembled((links, joints));
        let scene = builder.clone().build().unwrap();
        let [SceneWarning::Inertia { link, found }] = scene.warnings() else { panic!("{:?}", scene.warnings()) };
        assert!(link == "hand" && found.contains(words), "{found}");
        assert_scene_error(builder.strict(true).build(), ("link \"hand\"", words, "strict"));
    }
}

#[test]
fn a_mimic_joint_warns() {
    let (links, mut joints) = parts();
    joints[0].mimic = Some(Mimic::of("wrist"));
    let scene = assembled((links, joints)).build().unwrap();
    let expected = SceneWarning::Mimic { joint: "shoulder".into(), source: "wrist".into() };
    assert_eq!(scene.warnings(), [expected]);
    assert_eq!(scene.nv(), 4, "it stays a coordinate");
}

/// A call of one algorithm with possibly broken arguments.
struct Call {
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
    wrenches: Vec<Vector6<f64>>,
    out: Vec<f64>,
}

impl Call {
    fn valid() -> Self {
        let scene = valid();
        Self { q: scene.neutral(), qd: vec![0.1; 4], tau: vec![0.2; 4], wrenches: Vec::new(), out: vec![f64::NAN; 4] }
    }

    fn broken(change: impl FnOnce(&mut Self)) -> Self {
        let mut call = Self::valid();
        change(&mut call);
        call
    }

    fn forward(&mut self) -> Result<(), Error> {
        let scene = valid();
        scene.forward_dynamics(&mut scene.workspace(), &self.q, &self.qd, &self.tau, &self.wrenches, &mut self.out)
    }

    fn inverse(&mut self) -> Result<(), Error> {
        let scene = valid();
        scene.inverse_dynamics(&mut scene.workspace(), &self.q, &self.qd, &self.tau, &self.wrenches, &mut self.out)
    }
}

#[track_caller]
fn assert_message(result: Result<(), Error>, message: &str) {
    let error = result.expect_err(message);
    assert_eq!(error.to_string(), message);
}

#[test]
fn shapes_that_do_not_fit() {
    assert!(Call::valid().forward().is_ok() && Call::valid().inverse().is_ok());
    let shape = |name: &str, expected: usize| format!("{name}: found shape (3,); expected ({expected},)");
    let three = || vec![0.0; 3];
    assert_message(Call::broken(|call| call.q = three()).forward(), &shape("q", 5));
    assert_message(Call::broken(|call| call.qd = three()).forward(), &shape("qd", 4));
    assert_message(Call::broken(|call| call.tau = three()).forward(), &shape("tau", 4));
    assert_message(Call::broken(|call| call.out = three()).forward(), &shape("qdd", 4));
    assert_message(Call::broken(|call| call.wrenches = vec![Vector6::zeros(); 3]).forward(), &shape("wrenches", 2));
    assert_message(Call::broken(|call| call.q = three()).inverse(), &shape("q", 5));
    assert_message(Call::broken(|call| call.qd = three()).inverse(), &shape("qd", 4));
    assert_message(Call::broken(|call| call.tau = three()).inverse(), &shape("qdd", 4));
    assert_message(Call::broken(|call| call.out = three()).inverse(), &shape("tau", 4));

    let (scene, call) = (valid(), Call::valid());
    let (mut w, mut few) = (scene.workspace(), vec![0.0; 3]);
    assert_message(scene.bias_torque(&mut w, &call.q, &call.qd, &mut few), &shape("tau", 4));
    assert_message(scene.mass_matrix(&mut w, &call.q, &mut few), &shape("out", 16));
    let mut scratch = scene.inverse_scratch();
    assert_message(scene.mass_matrix_inverse(&mut w, &mut scratch, &call.q, &mut few), &shape("out", 16));
    assert_message(scene.energy(&mut w, &call.q, &few).map(|_| ()), &shape("qd", 4));
    assert_message(scene.momentum(&mut w, &few, &call.qd).map(|_| ()), &shape("q", 5));
    assert_message(scene.placements(&few).map(|_| ()), &shape("q", 5));
    assert_message(scene.jacobian(&call.q, "hand", ReferenceFrame::Local, &mut few), &shape("out", 24));
    assert_message(scene.integrate(&call.q, &call.qd, &mut few), &shape("out", 5));
    assert_message(scene.integrate(&call.q, &[0.0; 3], &mut [0.0; 5]), &shape("v", 4));
    assert_message(scene.difference(&call.q, &few, &mut [0.0; 4]), &shape("q1", 5));
    assert_message(scene.lock(&["wrist"], &few).map(|_| ()), &shape("q", 5));
}

#[test]
fn arguments_that_are_not_finite() {
    let words = |name: &str, value: &str, index: usize| {
        format!("{name}: found {value} at index {index}; expected finite numbers")
    };
    assert_message(Call::broken(|call| call.q[0] = f64::NAN).forward(), &words("q", "NaN", 0));
    assert_message(Call::broken(|call| call.q[4] = f64::INFINITY).forward(), &words("q", "inf", 4));
    assert_message(Call::broken(|call| call.qd[2] = f64::NAN).forward(), &words("qd", "NaN", 2));
    assert_message(Call::broken(|call| call.tau[3] = f64::NEG_INFINITY).forward(), &words("tau", "-inf", 3));
    assert_message(Call::broken(|call| call.tau[1] = f64::NAN).inverse(), &words("qdd", "NaN", 1));
    let mut wrench = Vector6::zeros();
    wrench[5] = f64::NAN;
    let broken = Call::broken(|call| call.wrenches = vec![wrench; 2]).forward();
    assert_message(broken, &words("wrenches", "NaN", 5));
    let scene = valid();
    let named = scene.body_wrenches([("hand", wrench)]).map(|_| ());
    assert_message(named, &words("wrench on \"hand\"", "NaN", 5));
    // In a batch, the state is named as well.
    let error = Call::broken(|call| call.qd[2] = f64::NAN).forward().unwrap_err().in_state(7);
    assert_eq!(error.to_string(), "qd: found NaN at index 2 in state 7; expected finite numbers");
}

#[test]
fn a_quaternion_that_is_none() {
    for factor in [0.0, 0.99, 1.01, -2.0, 1e200] {
        let mut call = Call::broken(|call| call.q[4] = factor);
        let norm = f64::abs(factor * factor).sqrt();
        let expected =
            format!("q: found a quaternion of norm {norm} for joint \"wrist\"; expected unit norm, to within 1e-3");
        assert_message(call.forward(), &expected);
    }
    assert!(Call::broken(|call| call.q[4] = 1.0009).forward().is_ok());
    assert!(Call::broken(|call| call.q[4] = -0.9991).forward().is_ok());
}

#[test]
fn names_that_are_not_there() {
    let (scene, call) = (valid(), Call::valid());
    let links = "link: found \"foot\"; expected one of \"base\", \"arm\", \"hand\"";
    assert_message(scene.jacobian(&call.q, "foot", ReferenceFrame::Local, &mut [0.0; 24]), links);
    let wrenches = links.replace("link:", "wrenches:");
    assert_message(scene.body_wrenches([("foot", Vector6::zeros())]).map(|_| ()), &wrenches);
    assert_message(scene.link("foot").map(|_| ()), links);
    let joints = "joint: found \"knee\"; expected one of \"shoulder\", \"wrist\"";
    assert_message(scene.joint("knee").map(|_| ()), joints);
    assert_message(scene.lock(&["knee"], &call.q).map(|_| ()), joints);
}
