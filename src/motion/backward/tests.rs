//! Compares adjoint steps with steps on dual numbers in double-double arithmetic, along every direction: state,
//! torques, joint properties, inertias.

use super::*;
use crate::batch::instruction_set::Baseline;
use crate::motion::solver::Solver;
use crate::motion::step::step;
use crate::motion::step_settings::StepSettings;
use crate::motion::{Gains, METHODS, Method, Properties, Settings};
use crate::scalar::{DoubleDouble, Dual};
use crate::scene::{Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::spatial::Symmetric3;
use nalgebra::Vector3;

type Number = Dual<DoubleDouble>;

fn plain(value: DoubleDouble) -> Number {
    Dual::constant_of(value)
}

fn number(value: f64) -> Number {
    Number::from_f64(value)
}

/// The unit vector i of six.
fn unit(i: usize) -> [f64; 6] {
    std::array::from_fn(|j| f64::from(u8::from(i == j)))
}

/// Uniform values between -size and size.
fn many(draw: &mut Draw, count: usize, size: f64) -> Vec<f64> {
    (0..count).map(|_| draw.uniform(-size, size)).collect()
}

/// Positive values of about the given size.
fn positive(draw: &mut Draw, count: usize, size: f64) -> Vec<f64> {
    (0..count).map(|_| draw.uniform(0.1 * size, 1.1 * size)).collect()
}

/// A floating, branched robot with every kind of joint.
fn scene() -> Scene {
    let mut random = Draw::new(7);
    let inertial = |random: &mut Draw| Inertial {
        mass: 1.0 + 0.3 * random.uniform(-1.0, 1.0),
        center: Vector3::from_fn(|_, _| 0.2 * random.uniform(-1.0, 1.0)),
        central: Symmetric3::new([0.04, 0.005, -0.003, 0.05, 0.002, 0.03]),
    };
    let kinds = [
        JointKind::Spherical,
        JointKind::Revolute,
        JointKind::Prismatic,
        JointKind::Screw { pitch: 0.2 },
        JointKind::Floating,
        JointKind::Revolute,
    ];
    let mut builder = SceneBuilder::new()
        .gravity([0.3, -0.5, -9.6])
        .floating_base(true)
        .link(LinkDescription { name: "base".into(), inertial: Some(inertial(&mut random)) });
    for (k, kind) in kinds.into_iter().enumerate() {
        let parent = if k < 2 { "base".to_owned() } else { format!("l{}", k - 2) };
        let mut joint = JointDescription::new(format!("j{k}"), kind, parent, format!("l{k}"));
        joint.origin.lever = Vector3::from_fn(|_, _| 0.4 * random.uniform(-1.0, 1.0));
        joint.axis = Vector3::from_fn(|_, _| random.uniform(-1.0, 1.0));
        joint.armature = 0.1;
        let inertial = Some(inertial(&mut random));
        builder = builder.link(LinkDescription { name: format!("l{k}"), inertial }).joint(joint);
    }
    builder.build().expect("a scene")
}

/// Step settings with all torques active, an initial state, and the gradients at the end of the step.
struct Case {
    scene: Scene,
    settings: StepSettings,
    q: Vec<f64>,
    v: Vec<f64>,
    torque: Vec<f64>,
    end: [Vec<f64>; 2],
}

impl Case {
    fn new(method: Method, step: f64) -> Self {
        let (scene, mut random) = (scene(), Draw::new(3));
        let nv = scene.nv();
        let mut near = |size: f64| {
            let mut q = scene.neutral();
            scene.integrate(&scene.neutral(), &many(&mut random, nv, size), &mut q).expect("a configuration");
            q
        };
        let (q, rest, target) = (near(1.0), near(1.0), near(1.0));
        let properties = Properties {
            armature: positive(&mut random, nv, 0.2),
            damping: positive(&mut random, nv, 0.5),
            stiffness: positive(&mut random, nv, 3.0),
            rest,
            friction: positive(&mut random, nv, 0.3),
            curves: Vec::new(),
            friction_speed: 0.5,
            inertias: Vec::new(),
            contact_friction: Vec::new(),
            contact_restitution: Vec::new(),
        };
        let (kp, kd) = (positive(&mut random, nv, 3.0), positive(&mut random, nv, 0.5));
        let gains = Gains::new(kp, kd, target).with_target_rate(many(&mut random, nv, 0.3));
        let settings =
            StepSettings::new(scene.model(), Arc::new(Settings::new(&scene, step)), method, (properties, Some(gains)))
                .backward();
        let (v, torque, end) = (
            many(&mut random, nv, 1.0),
            many(&mut random, nv, 5.0),
            [many(&mut random, nv, 1.0), many(&mut random, nv, 1.0)],
        );
        Self { scene, settings, q, v, torque, end }
    }

    fn scratch<T: Real>(&self) -> Scratch<T> {
        let mut s = Scratch::<T>::new(self.scene.model(), &self.settings);
        let gains = self.settings.gains.as_ref().expect("gains");
        for (to, from) in [
            (&mut s.q, &self.q),
            (&mut s.v, &self.v),
            (&mut s.torque, &self.torque),
            (&mut s.target, &gains.target),
            (&mut s.target_rate, &gains.target_rate),
        ] {
            to.iter_mut().zip(from).for_each(|(to, &from)| *to = T::from_f64(from));
        }
        s
    }

    /// Gradients from the kernels, and from the checked solver.
    fn backward(&self) -> [StepGradients<f64>; 2] {
        let mut s = self.scratch::<f64>();
        let mut both = [(); 2].map(|()| StepGradients::new(&s.model, &self.settings, true));
        for to in &mut both {
            to.end.clone_from(&self.end);
        }
        let mut solver = VectorizedBackward::new(Baseline, Form::Auto, (&s.model, &s.constants));
        let fallback =
            backward(Baseline, (&self.settings, &self.settings.scheme), &mut s, &mut both[0], &mut solver, None);
        assert_eq!(fallback, 0, "{:?}: {:?}, {:?}", self.settings.method, s.consistent, s.short_enough);
        let mut checked = CheckedBackward::new(&s.model, None, Form::Auto, None);
        backward(Baseline, (&self.settings, &self.settings.scheme), &mut s, &mut both[1], &mut checked, None);
        assert!(checked.solver.lost.is_none());
        both
    }

    /// Derivative of the scalar along the tangents that `set` assigns to the values of a step.
    fn along(&self, set: impl FnOnce(&mut Scratch<Number>)) -> f64 {
        let mut s = self.scratch::<Number>();
        set(&mut s);
        let mut solver = General(Workspace::new(&s.model));
        step(Baseline, (&self.settings, &self.settings.scheme), &mut s, &mut solver);
        let mut sum = DoubleDouble::from_f64(0.0);
        for (k, body) in s.model.bodies.iter().enumerate() {
            let row = s.model.system.stages[k].first_row;
            let q = &s.q_next[body.q..];
            let here: Vec<Number> = q.iter().map(|x| plain(x.value)).collect();
            for i in 0..s.model.system.stages[k].rows.count() {
                // The joint velocity that corresponds to the tangents of the coordinates; the columns are orthogonal.
                let rates = unit(i).map(number);
                let mut column = vec![number(0.0); body.motion.nq()];
                body.motion.coordinate_rates(&here, &rates, &mut column);
                let zero = DoubleDouble::from_f64(0.0);
                let (inner, square) = column.iter().zip(q).fold((zero, zero), |(inner, square), (c, x)| {
                    (inner + c.value * x.tangent, square + c.value * c.value)
                });
                sum += DoubleDouble::from_f64(self.end[0][row + i]) * inner / square;
            }
        }
        for (&bar, v) in self.end[1].iter().zip(&s.v_next) {
            sum += DoubleDouble::from_f64(bar) * v.tangent;
        }
        sum.lane(0)
    }
}

/// Forward dynamics by the general recursion, in any scalar type.
struct General(Workspace<Number>);

impl Solver<Number> for General {
    fn solve(&mut self, _estimates: bool, call: KernelArguments<'_, Number>) -> u64 {
        let KernelArguments { scene: (model, _), state: (q, v, u), qdd, .. } = call;
        dynamics::forward_dynamics(model, &mut self.0, q, v, u, &[], qdd);
        0
    }
}

fn near(found: f64, expected: f64, what: &str) {
    // The values are sums of a few hundred terms of magnitude up to a hundred.
    assert!((found - expected).abs() <= 1e-11 * (1.0 + expected.abs()), "{what}: {found} and {expected}");
}

fn each_method(check: impl Fn(&str, &Case, &StepGradients<f64>)) {
    for &(name, method) in METHODS {
        for h in [0.01, 0.3] {
            if method == Method::DormandPrince5 && h > 0.1 {
                // Its large coefficients make stages of stiff joints diverge within the step.
                continue;
            }
            let case = Case::new(method, h);
            for (gradients, how) in case.backward().iter().zip(["kernels", "checked"]) {
                check(&format!("{name}, h = {h}, {how}"), &case, gradients);
            }
        }
    }
}

#[test]
fn gradients_by_the_state() {
    each_method(|name, case, gradients| {
        for (k, body) in case.scene.model().bodies.iter().enumerate() {
            let row = case.scene.model().system.stages[k].first_row;
            let motion = &case.scratch::<Number>().model.bodies[k].motion;
            for i in 0..case.scene.model().system.stages[k].rows.count() {
                let by_q = case.along(|s| {
                    let mut rates = vec![number(0.0); motion.nq()];
                    let q: Vec<Number> = s.q[body.q..].to_vec();
                    motion.coordinate_rates(&q, &unit(i).map(number), &mut rates);
                    s.q[body.q..].iter_mut().zip(&rates).for_each(|(q, rate)| q.tangent = rate.value);
                });
                near(gradients.start[0][row + i], by_q, &format!("{name}: q, row {}", row + i));
                let by_target = case.along(|s| {
                    let mut rates = vec![number(0.0); motion.nq()];
                    let q: Vec<Number> = s.target[body.q..].to_vec();
                    motion.coordinate_rates(&q, &unit(i).map(number), &mut rates);
                    s.target[body.q..].iter_mut().zip(&rates).for_each(|(q, rate)| q.tangent = rate.value);
                });
                near(gradients.acting[TARGET][row + i], by_target, &format!("{name}: target, row {}", row + i));
                let by_v = case.along(|s| s.v[row + i].tangent = DoubleDouble::from_f64(1.0));
                near(gradients.start[1][row + i], by_v, &format!("{name}: v, row {}", row + i));
            }
        }
    });
}

#[test]
fn gradients_by_what_acts_at_the_joints() {
    each_method(|name, case, gradients| {
        let hg = if case.settings.scheme.implicit { case.settings.scheme.tableau.gamma[0][0] } else { 0.0 };
        for row in 0..case.scene.nv() {
            let found = |kind: usize| gradients.acting[kind][row];
            near(
                found(TORQUE),
                case.along(|s| s.torque[row].tangent = DoubleDouble::from_f64(1.0)),
                &format!("{name}: torque {row}"),
            );
            let by_rate = case.along(|s| s.target_rate[row].tangent = DoubleDouble::from_f64(1.0));
            near(found(RATE), by_rate, &format!("{name}: target velocity {row}"));
            let by_noise = |change: f64| {
                move |s: &mut Scratch<Number>| {
                    s.rows[row].noise.tangent = DoubleDouble::from_f64(change);
                    s.model.system.noise[row].tangent = DoubleDouble::from_f64(change);
                }
            };
            near(found(ARMATURE), case.along(by_noise(1.0)), &format!("{name}: armature {row}"));
            let by_damping = case.along(|s| {
                by_noise(hg)(s);
                s.rows[row].damping.tangent = DoubleDouble::from_f64(1.0);
            });
            near(found(DAMPING), by_damping, &format!("{name}: damping {row}"));
            let by_stiffness = case.along(|s| {
                by_noise(hg * hg)(s);
                s.rows[row].stiffness.tangent = DoubleDouble::from_f64(1.0);
            });
            near(found(STIFFNESS), by_stiffness, &format!("{name}: stiffness {row}"));
            let by_friction = case.along(|s| s.rows[row].friction.tangent = DoubleDouble::from_f64(1.0));
            near(found(FRICTION), by_friction, &format!("{name}: friction {row}"));
        }
    });
}

#[test]
fn gradients_by_inertias() {
    each_method(|name, case, gradients| {
        for body in 0..case.scene.model().bodies.len() {
            for entry in 0..10 {
                let expected = case.along(|s| {
                    let inertia = &mut s.model.bodies[body].inertia;
                    let [xx, xy, xz, yy, yz, zz] = &mut inertia.rotational.entries;
                    let [x, y, z] = inertia.first_moment.as_mut_slice() else { unreachable!() };
                    let all = [&mut inertia.mass, x, y, z, xx, xy, yy, xz, yz, zz];
                    all[entry].tangent = DoubleDouble::from_f64(1.0);
                });
                near(gradients.parameters[body][entry], expected, &format!("{name}: body {body}, parameter {entry}"));
            }
        }
    });
}
