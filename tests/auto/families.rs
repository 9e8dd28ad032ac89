//! Families of random scenes and states, from ordinary to extreme; each case is determined by its number.

use crate::common::{ALL_KINDS, Random, Tree, random_state};
use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};
use phipsi::Scene;
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::{RigidShift, Symmetric3, spatial};
use phipsi::{dynamics, kinematics};

/// Names of the families; a case belongs to family `number % FAMILIES.len()`.
pub const FAMILIES: [&str; 22] = [
    "ordinary trees",
    "ordinary large trees",
    "equal chains",
    "log-uniform masses, chains",
    "log-uniform masses, trees",
    "heavy tip",
    "growing masses",
    "alternating masses",
    "needle inertias",
    "log-uniform lengths",
    "alternating lengths",
    "prismatic chains",
    "heavy leaves",
    "fast spin",
    "at rest, uneven torques",
    "large wrenches",
    "near-parallel axes",
    "near-massless middles",
    "armature 1e-9 to 1e9",
    "far offsets",
    "heavy on free joints",
    "everything at once",
];

/// Typical states in addition to random ones: passive ones have zero torques, those in static equilibrium have
/// the torques for zero accelerations.
pub const STATES: [&str; 8] = [
    "falling",
    "falling, with rates",
    "falling, one joint moving",
    "held",
    "held, and pushed by 1e-9",
    "held, with rates",
    "held, one joint moving",
    "held by nine tenths",
];

/// A scene with one of its states.
#[derive(Clone)]
pub struct Case {
    pub builder: SceneBuilder,
    pub scene: Scene,
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    pub tau: Vec<f64>,
    pub wrenches: Vec<Vector6<f64>>,
    /// Forces on bodies that are too small to be added to `wrenches`; empty if there are none.
    pub pushes: Vec<Vector6<f64>>,
}

/// One link with its joint.
#[derive(Clone, Copy)]
struct Part {
    parent: Option<usize>,
    kind: JointKind,
    axis: Vector3<f64>,
    turned: Matrix3<f64>,
    /// From the origin of the parent to this joint, m.
    lever: Vector3<f64>,
    mass: f64,
    /// Size of the body, m.
    length: f64,
    /// Center of mass, relative to the size.
    center: Vector3<f64>,
    /// Principal inertias divided by m l^2, before needles.
    principal: Vector3<f64>,
    armature: f64,
}

fn part(random: &mut Random, k: usize, branching: f64, kinds: &[JointKind]) -> Part {
    let parent = if k == 0 {
        None
    } else if random.uniform(0.0, 1.0) < branching {
        Some(random.below(k))
    } else {
        Some(k - 1)
    };
    let (a, b, c) = (random.uniform(0.1, 0.5), random.uniform(0.1, 0.5), random.uniform(0.1, 0.5));
    Part {
        parent,
        kind: kinds[random.below(kinds.len())],
        axis: random.vector(),
        turned: random.rotation(),
        lever: random.vector() * 0.5,
        mass: random.uniform(0.5, 2.0),
        length: 0.3,
        center: random.vector(),
        principal: Vector3::new(b + c, a + c, a + b),
        armature: 0.0,
    }
}

fn build(parts: &[Part], random: &mut Random, gravity: bool) -> SceneBuilder {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    if !gravity {
        builder = builder.gravity([0.0; 3]);
    }
    for (k, p) in parts.iter().enumerate() {
        let name = |k: Option<usize>| k.map_or("base".to_owned(), |k| format!("link{k}"));
        let mut joint = JointDescription::new(format!("joint{k}"), p.kind, name(p.parent), name(Some(k)));
        joint.origin = RigidShift { rotation: p.turned, lever: p.lever };
        joint.axis = p.axis;
        joint.armature = p.armature;
        let axes = if random.below(2) == 0 { random.rotation() } else { Matrix3::identity() };
        let central = axes * Matrix3::from_diagonal(&(p.principal * (p.mass * p.length * p.length))) * axes.transpose();
        let inertial = (p.mass > 0.0).then(|| Inertial {
            mass: p.mass,
            center: p.center * p.length,
            central: Symmetric3::from_upper(&central),
        });
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
    }
    builder
}

/// 10 to a power from a range.
fn decades(random: &mut Random, low: f64, high: f64) -> f64 {
    10f64.powf(random.uniform(low, high))
}

fn power(base: f64, k: usize) -> f64 {
    base.powi(i32::try_from(k).expect("few links"))
}

/// Case `number`, reproducible.
#[allow(clippy::too_many_lines)] // one arm per family
pub fn case(number: usize) -> Case {
    let family = number % FAMILIES.len();
    let random = &mut Random::new(0x00A0_7000 + number as u64);
    let seed = random.bits();
    if family < 2 {
        let bodies = if family == 0 { 1 + random.below(30) } else { 1 + random.below(200) };
        let armature = if random.below(2) == 0 { 0.0 } else { 0.2 };
        let branching = random.uniform(0.0, 0.8);
        let kinds: &[JointKind] = if random.below(3) == 0 { &[JointKind::Revolute] } else { &ALL_KINDS };
        let tree = Tree { seed, bodies, kinds, branching, armature, floating: random.below(3) == 0 };
        return finish(tree.builder(), random, (1.0, 1.0, false));
    }
    let turns = [JointKind::Revolute];
    let slides = [JointKind::Prismatic];
    let turns_and_slides = [JointKind::Revolute, JointKind::Prismatic, JointKind::Screw { pitch: 0.2 }];
    let any = random.below(2) == 0;
    let kinds: &[JointKind] = match (family, any) {
        (11, true) => &slides,
        (11, false) => &turns_and_slides,
        (20, true) => &[JointKind::Spherical, JointKind::Floating, JointKind::Planar, JointKind::Revolute],
        (_, true) => &turns,
        _ => &ALL_KINDS,
    };
    let n = match family {
        2 => 1 + random.below(64),
        3 | 4 => 2 + random.below(40),
        _ => 2 + random.below(20),
    };
    let branching = if matches!(family, 4 | 12 | 20 | 21) || random.below(4) == 0 { 0.5 } else { 0.0 };
    let mut parts: Vec<Part> = (0..n).map(|k| part(random, k, branching, kinds)).collect();
    let straight = random.below(2) == 0;
    if straight {
        // A typical chain: axes and offsets along coordinate axes, similar bodies.
        let (axis_step, mut model) = (1 + random.below(2), parts[0]);
        model.lever = Vector3::new(0.5, 0.0, 0.0);
        let tilt = if random.below(2) == 0 { 0.0 } else { 0.3 };
        model.turned = *Rotation3::new(Vector3::new(tilt, 0.7 * tilt, -tilt)).matrix();
        model.center = Vector3::new(0.5, 0.1, 0.0);
        for (k, p) in parts.iter_mut().enumerate() {
            let (parent, kind) = (p.parent, p.kind);
            *p = Part { parent, kind, axis: Vector3::ith((k * axis_step + 2) % 3, 1.0), ..model };
        }
    }
    let (mut speed, mut torque, mut gravity, mut wrench) = (1.0, 1.0, true, 0.0);
    if random.below(4) == 0 {
        for p in &mut parts {
            p.armature = random.uniform(0.0, 0.1);
        }
    }
    match family {
        2 => {
            let model = Part { parent: None, ..parts[0] };
            let apart = random.below(2) == 0;
            for p in &mut parts {
                let (parent, axis) = (p.parent, if apart { p.axis } else { model.axis });
                *p = Part { parent, axis, ..model };
            }
        }
        3 | 4 | 11 => {
            let span = random.uniform(0.0, 12.0);
            for p in &mut parts {
                p.mass = decades(random, -span, span);
            }
        }
        5 => {
            let heavier = decades(random, 0.0, 15.0);
            let from = n - 1 - random.below(2.min(n));
            for p in &mut parts[from..] {
                p.mass *= heavier;
            }
        }
        6 => {
            let factor = decades(random, -3.0, 3.0);
            for (k, p) in parts.iter_mut().enumerate() {
                p.mass *= power(factor, k.min(12));
            }
        }
        7 => {
            let ratio = decades(random, -12.0, 0.0);
            for p in parts.iter_mut().skip(random.below(2)).step_by(2) {
                p.mass *= ratio;
            }
        }
        8 => {
            for p in &mut parts {
                let (thin, which) = (decades(random, -12.0, 0.0), random.below(4));
                if which < 3 {
                    p.principal[which] *= thin;
                } else {
                    p.principal *= thin;
                }
            }
        }
        9 => {
            let span = random.uniform(0.0, 6.0);
            for p in &mut parts {
                let factor = decades(random, -span, span);
                p.lever *= factor;
                p.length *= if random.below(2) == 0 { factor } else { decades(random, -span, span) };
                if random.below(2) == 0 {
                    p.mass = decades(random, -2.0, 2.0);
                }
            }
        }
        10 => {
            let factor = decades(random, -6.0, 0.0);
            for p in parts.iter_mut().step_by(2) {
                p.lever *= factor;
                p.length *= factor;
            }
        }
        12 => {
            let heavier = decades(random, 0.0, 12.0);
            let inner: Vec<Option<usize>> = parts.iter().map(|p| p.parent).collect();
            for (k, p) in parts.iter_mut().enumerate() {
                if !inner.contains(&Some(k)) {
                    p.mass *= heavier;
                }
            }
        }
        13 => speed = decades(random, 0.0, 6.0),
        14 => {
            (speed, gravity) = (0.0, false);
            torque = 0.0;
        }
        15 => wrench = decades(random, 0.0, 9.0),
        16 => {
            let angle = decades(random, -9.0, 0.0);
            let apart = if random.below(2) == 0 { decades(random, -9.0, 0.0) } else { 1.0 };
            for k in 1..n {
                let axis = parts[0].axis;
                parts[k].turned = *Rotation3::new(random.vector() * angle).matrix();
                parts[k].axis = axis;
                parts[k].lever *= apart;
            }
        }
        17 => {
            let light = if random.below(4) == 0 { 0.0 } else { decades(random, -15.0, -3.0) };
            for p in parts.iter_mut().take(n - 1) {
                if random.below(3) == 0 {
                    p.mass *= light;
                }
            }
            gravity = random.below(2) == 0;
        }
        18 => {
            for p in &mut parts {
                p.armature = if random.below(3) == 0 { 0.0 } else { decades(random, -9.0, 9.0) };
                p.mass *= decades(random, -3.0, 3.0);
            }
        }
        19 => {
            let far = decades(random, 0.0, 6.0);
            let way = random.vector();
            match random.below(3) {
                0 => parts[0].lever += way * far,
                1 => {
                    let k = random.below(n);
                    parts[k].lever += way * far;
                }
                _ => {
                    // An offset and its opposite: the center of mass is far from the frame in which it is given.
                    let k = random.below(n);
                    let p = &mut parts[k];
                    p.lever += p.turned * (way * far);
                    p.center -= way * (far / p.length);
                }
            }
        }
        20 => {
            for p in &mut parts {
                p.mass *= decades(random, -6.0, 6.0);
            }
        }
        21 => {
            let span = random.uniform(0.0, 6.0);
            for p in &mut parts {
                p.mass = decades(random, -span, span);
                p.lever *= decades(random, -span / 3.0, span / 3.0);
                p.length *= decades(random, -span / 3.0, span / 3.0);
                p.principal[0] *= decades(random, -span, 0.0);
                p.armature = if random.below(2) == 0 { 0.0 } else { decades(random, -span, span) };
            }
            speed = decades(random, -3.0, span / 2.0);
            torque = decades(random, -span, span);
            wrench = if random.below(2) == 0 { 0.0 } else { decades(random, -span, span) };
        }
        _ => {}
    }
    let builder = build(&parts, random, gravity);
    let mut case = finish(builder, random, (speed, torque, wrench > 0.0));
    for w in &mut case.wrenches {
        *w *= wrench;
    }
    if family == 14 {
        for t in &mut case.tau {
            *t = random.uniform(-1.0, 1.0) * decades(random, -12.0, 3.0);
        }
    }
    case
}

fn finish(builder: SceneBuilder, random: &mut Random, (speed, torque, pushed): (f64, f64, bool)) -> Case {
    let scene = builder.clone().build().expect("a random scene is valid");
    let (q, mut qd, mut tau) = random_state(&scene, random);
    for x in &mut qd {
        *x *= speed;
    }
    for x in &mut tau {
        *x *= torque;
    }
    let wrenches = if pushed {
        scene.model().bodies.iter().map(|_| Vector6::from_fn(|_, _| random.uniform(-1.0, 1.0))).collect()
    } else {
        Vec::new()
    };
    Case { builder, scene, q, qd, tau, wrenches, pushes: Vec::new() }
}

impl Case {
    /// The same robot in one of the [`STATES`]; none if nothing moves.
    pub fn in_state(&self, state: &str) -> Option<Case> {
        let nv = self.scene.nv();
        let last = nv.checked_sub(1)?;
        let (still, mut one) = (vec![0.0; nv], vec![0.0; nv]);
        one[nv / 2] = 1.0;
        let holding = |qd: &[f64]| {
            let (mut workspace, mut tau) = (self.scene.workspace(), vec![f64::NAN; nv]);
            dynamics::inverse_dynamics(self.scene.model(), &mut workspace, &self.q, qd, &still, &[], &mut tau);
            tau
        };
        let held = holding(&still);
        let (qd, tau) = match state {
            "falling" => (still.clone(), still),
            "falling, with rates" => (self.qd.clone(), still),
            "falling, one joint moving" => (one, still),
            "held" => (still, held),
            "held, and pushed by 1e-9" => {
                let mut tau = held;
                tau[last] += 1e-9;
                (still, tau)
            }
            "held, with rates" => (self.qd.clone(), holding(&self.qd)),
            "held, one joint moving" => (one, held),
            "held by nine tenths" => (still, held.iter().map(|x| 0.9 * x).collect()),
            _ => panic!("no such state: {state}"),
        };
        Some(Case { qd, tau, wrenches: Vec::new(), ..self.clone() })
    }

    /// The same robot on a free base with inertia; none if it has a free base already.
    pub fn on_a_free_base(&self, seed: u64) -> Option<Case> {
        if self.builder.is_floating() {
            return None;
        }
        let mut builder = SceneBuilder::new().floating_base(true).gravity(self.builder.gravity_vector());
        for (k, link) in self.builder.links().iter().enumerate() {
            let mut link = link.clone();
            if k == 0 {
                let central = Symmetric3::new([0.01, 0.0, 0.001, 0.02, 0.0, 0.015]);
                link.inertial = Some(Inertial { mass: 1.0, center: Vector3::new(0.02, -0.05, 0.1), central });
            }
            builder = builder.link(link);
        }
        for joint in self.builder.joints() {
            builder = builder.joint(joint.clone());
        }
        Some(finish(builder, &mut Random::new(seed), (1.0, 1.0, false)))
    }

    /// The terms of b(k) of every body, in its frame: due to its acceleration without joint accelerations, due to its
    /// velocity, and the wrench.
    fn terms_of_bias(&self) -> Vec<[Vector6<f64>; 3]> {
        let model = self.scene.model();
        let base = spatial(&Vector3::zeros(), &-model.gravity);
        let mut motions: Vec<[Vector6<f64>; 2]> = Vec::new();
        let mut forces = Vec::new();
        for (k, body) in model.bodies.iter().enumerate() {
            let stage = &model.system.stages[k];
            let shift = kinematics::joint_shift(body, &self.q);
            let [v, a] = stage.parent.map_or([Vector6::zeros(), base], |parent| motions[parent]);
            let seen = (shift.motion_to_child(&v), shift.motion_to_child(&a));
            let (v, a) = kinematics::motion_past_joint(body, stage.first_row, &seen, &self.qd);
            let of_acceleration = body.inertia.mul_motion(&a);
            let of_velocity = body.inertia.bias_force(&v, &a) - of_acceleration;
            let wrench = self.wrenches.get(k).copied().unwrap_or_else(Vector6::zeros);
            motions.push([v, a]);
            forces.push([of_acceleration, of_velocity, wrench]);
        }
        forces
    }

    /// The same case with an additional force on every body: one unit in the last place of each component of the
    /// terms of its b(k), with random signs.
    pub fn with_bias_jiggled(&self, seed: u64) -> Case {
        let mut random = Random::new(seed);
        let mut ulp = |x: f64| x * if random.below(2) == 0 { f64::EPSILON } else { -f64::EPSILON };
        let pushed = |terms: &[Vector6<f64>; 3]| terms.iter().map(|term| term.map(&mut ulp)).sum();
        let pushes = self.terms_of_bias().iter().map(pushed).collect();
        Case { pushes, ..self.clone() }
    }

    /// The same case with every constant of the scene and every entry of the state changed by one unit in the last
    /// place, with random signs.
    pub fn jiggled(&self, seed: u64) -> Case {
        let mut random = Random::new(seed);
        let mut ulp = |x: f64| x * (1.0 + if random.below(2) == 0 { f64::EPSILON } else { -f64::EPSILON });
        let gravity = self.scene.model().gravity.norm();
        let mut builder = SceneBuilder::new()
            // Its direction too: if an axis is along gravity, a component that is zero changes by one unit.
            .gravity(self.builder.gravity_vector().map(|x| x + ulp(gravity) - gravity))
            .floating_base(self.builder.is_floating());
        for link in self.builder.links() {
            let inertial = link.inertial.map(|i| Inertial {
                mass: ulp(i.mass),
                center: i.center.map(&mut ulp),
                central: Symmetric3::new(i.central.entries.map(&mut ulp)),
            });
            builder = builder.link(LinkDescription { name: link.name.clone(), inertial });
        }
        for joint in self.builder.joints() {
            let mut joint = joint.clone();
            joint.origin.lever = joint.origin.lever.map(&mut ulp);
            joint.origin.rotation = joint.origin.rotation.map(&mut ulp);
            joint.axis = joint.axis.map(&mut ulp);
            joint.armature = ulp(joint.armature);
            builder = builder.joint(joint);
        }
        let scene = builder.clone().build().expect("still valid");
        let [q, qd, tau] = [&self.q, &self.qd, &self.tau].map(|x| x.iter().map(|&x| ulp(x)).collect());
        let wrenches = self.wrenches.iter().map(|w| w.map(&mut ulp)).collect();
        Case { builder, scene, q, qd, tau, wrenches, pushes: Vec::new() }
    }
}
