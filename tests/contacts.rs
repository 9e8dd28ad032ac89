//! Contacts with friction compared with closed forms: sliding, sticking, bouncing, rolling, resting, and energy that
//! does not increase.

use crate::common::lanes::{arms, on_a_large_stack};
use crate::common::tolerance;
use nalgebra::Vector3;
use phipsi::batch::InstructionSet;
use phipsi::motion::{ContactState, Method, RecordedRows, Records, Rollout, Settings, Simulator, Torque};
use phipsi::scene::{
    Connection, ConnectionKind, Contact, Inertial, JointDescription, JointKind, LinkDescription, Polynomial, Surface,
};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene, SceneBuilder};

const G: f64 = 9.81;

/// A solid floating box with these edges, m.
fn body(mass: f64, [a, b, c]: [f64; 3]) -> SceneBuilder {
    let central =
        Symmetric3::new([b * b + c * c, 0.0, 0.0, a * a + c * c, 0.0, a * a + b * b].map(|x| mass * x / 12.0));
    let inertial = Some(Inertial { mass, center: Vector3::zeros(), central });
    SceneBuilder::new().link(LinkDescription { name: "box".into(), inertial }).floating_base(true)
}

/// Its eight corners above z = 0.
fn corners(mut builder: SceneBuilder, edges: [f64; 3], friction: f64, restitution: f64) -> SceneBuilder {
    for i in 0..8_u32 {
        let side = |bit: u32, edge: f64| if i >> bit & 1 == 0 { -edge / 2.0 } else { edge / 2.0 };
        let mut contact = Contact::new(format!("corner{i}"), "box");
        contact.point = [side(0, edges[0]), side(1, edges[1]), side(2, edges[2])].into();
        contact.friction = friction;
        contact.restitution = restitution;
        builder = builder.contact(contact);
    }
    builder
}

const EDGES: [f64; 3] = [0.4, 0.3, 0.2];

fn block(friction: f64, restitution: f64) -> Scene {
    corners(body(2.0, EDGES), EDGES, friction, restitution).build().unwrap()
}

fn ball(friction: f64, restitution: f64) -> Scene {
    let inertia = 0.4 * 0.5 * 0.1 * 0.1;
    let central = Symmetric3::new([inertia, 0.0, 0.0, inertia, 0.0, inertia]);
    let inertial = Some(Inertial { mass: 0.5, center: Vector3::zeros(), central });
    let mut contact = Contact::new("ground", "ball");
    contact.radius = 0.1;
    contact.friction = friction;
    contact.restitution = restitution;
    let link = LinkDescription { name: "ball".into(), inertial };
    SceneBuilder::new().link(link).floating_base(true).contact(contact).build().unwrap()
}

fn at(scene: &Scene, xyz: [f64; 3]) -> Vec<f64> {
    let mut q = scene.neutral();
    q[..3].copy_from_slice(&xyz);
    q
}

fn energy(scene: &Scene, (q, qd): (&[f64], &[f64])) -> f64 {
    let energy = scene.energy(&mut scene.workspace(), q, qd).unwrap();
    energy.kinetic + energy.potential
}

fn moving<'a>(scene: &'a Scene, dt: f64, q: &[f64], qd: &[f64]) -> Simulator<&'a Scene> {
    Simulator::new(scene, Settings::new(scene, dt), q, qd).unwrap()
}

/// The same in steps of contacts, also if none can act.
fn touching<'a>(scene: &'a Scene, dt: f64, q: &[f64], qd: &[f64]) -> Simulator<&'a Scene> {
    Simulator::new(scene, Settings::new(scene, dt).with_method(Method::Contact), q, qd).unwrap()
}

fn go(simulator: &mut Simulator<&Scene>, steps: usize) {
    simulator.step(&Torque::Zero, steps).map_err(|fault| fault.error).unwrap();
}

/// State of each contact of one state.
fn states(simulator: &Simulator<&Scene>) -> Vec<ContactState> {
    simulator.contacts_now(0).chunks(11).map(|of| ContactState::of(of[10]).unwrap()).collect()
}

#[test]
fn a_sliding_block_slows_by_mu_g_and_stops() {
    let (mu, v0, dt) = (0.5, 2.0, 1e-3);
    let scene = block(mu, 0.0);
    let mut simulator = moving(&scene, dt, &at(&scene, [0.0, 0.0, 0.1]), &[v0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(states(&simulator), [ContactState::Open; 8]);
    go(&mut simulator, 100);
    assert!((simulator.state(0).1[0] - (v0 - mu * G * 0.1)).abs() < 1e-9, "{:?}", simulator.state(0));
    let above = [ContactState::Open; 4];
    assert_eq!(states(&simulator), [[ContactState::Sliding; 4], above].concat());
    go(&mut simulator, 500);
    assert_eq!(states(&simulator), [[ContactState::Sticking; 4], above].concat());
    let (q, qd) = simulator.state(0);
    assert!(qd.iter().all(|v| v.abs() < 1e-9), "{qd:?}");
    // Of the step: smaller by dt v0/2.
    assert!((q[0] - (v0 * v0 / (2.0 * mu * G) - dt * v0 / 2.0)).abs() < 1e-5, "{q:?}");
    let told = simulator.contact_report(0).unwrap();
    assert!(told.converged && told.residual <= 1e-10, "{told:?}");
    assert!((told.lost_in_friction - 0.5 * 2.0 * v0 * v0).abs() < 2e-2 && told.lost_in_impacts == 0.0, "{told:?}");
    let stayed = q[0];
    go(&mut simulator, 1000);
    assert!((simulator.state(0).0[0] - stayed).abs() < 1e-9);
}

/// A slower rebound would last less than two steps.
#[test]
fn a_contact_rebounds_above_the_speed_that_gravity_adds_in_a_step() {
    let (dt, restitution) = (1e-3, 0.5);
    let scene = ball(0.0, restitution);
    for (speed, rebounds) in [(0.7, false), (0.99, false), (1.01, true), (2.0, true)] {
        let fall = [0.0, 0.0, -speed * G * dt, 0.0, 0.0, 0.0];
        let mut simulator = touching(&scene, dt, &at(&scene, [0.0, 0.0, 0.1]), &fall);
        go(&mut simulator, 1);
        let (found, lost) = (simulator.state(0).1[2], simulator.contact_report(0).unwrap().lost_in_impacts);
        // The impact acts on the mean of the velocities with and without gravity.
        let free = -(speed + 1.0) * G * dt;
        let expected = if rebounds { free + (1.0 + restitution) * (speed + 0.5) * G * dt } else { 0.0 };
        assert!((found - expected).abs() < 1e-12, "{speed}: {found} instead of {expected}");
        assert!(if rebounds { lost > 0.0 } else { lost == 0.0 }, "{speed}: {lost}");
    }
}

/// The velocity that a contact has to remove in a step can be much smaller than the speed of the robot, whose rounding
/// errors decide whether a slip is one.
#[test]
fn a_slip_is_one_relative_to_the_speed_of_the_robot() {
    let (dt, down, scene) = (1e-3, 1.0, ball(1e-3, 0.0));
    for (slip, state) in [(3e-10, ContactState::Sticking), (3e-8, ContactState::Sliding)] {
        // Without the contact, the step ends 1e-11 m below the surface.
        let height = 0.1 + dt * (down + G * dt - 1e-8);
        let mut simulator = touching(&scene, dt, &at(&scene, [0.0, 0.0, height]), &[slip, 0.0, -down, 0.0, 0.0, 0.0]);
        go(&mut simulator, 1);
        let (q, qd) = simulator.state(0);
        assert!((q[2] - 0.1).abs() < 1e-13 && qd[0] > 0.9 * slip, "{q:?} {qd:?}");
        assert_eq!(states(&simulator), [state], "{slip}");
    }
}

/// On every instruction set, a state of a batch has the same bits as alone, also if some states of a register need the
/// checked step, as those of a ball that rebounds; and instruction sets agree.
#[test]
fn states_in_lanes_step_as_alone() {
    on_a_large_stack(|| {
        for (scene, height) in [(block(0.5, 0.0), 0.1), (ball(0.3, 0.7), 0.1005)] {
            let mut draw = Draw(7);
            let q: Vec<f64> =
                (0..11_u32).flat_map(|i| at(&scene, [0.0, 0.0, height + 1e-4 * f64::from(i % 3)])).collect();
            let qd: Vec<f64> = (0..66).map(|_| draw.next()).collect();
            let run = |arm, states: std::ops::Range<usize>| {
                let settings = Settings::new(&scene, 1e-3).with_arm(arm);
                let (q, qd) = (&q[7 * states.start..7 * states.end], &qd[6 * states.start..6 * states.end]);
                let mut simulator = Simulator::new(&scene, settings, q, qd).unwrap();
                go(&mut simulator, 10);
                go(&mut simulator, 10);
                let each = (0..states.len()).map(|i| {
                    let ((q, qd), now) = (simulator.state(i), simulator.contacts_now(i));
                    [q, qd, &now].concat()
                });
                each.collect::<Vec<_>>()
            };
            let expected = run(InstructionSet::Baseline, 0..11);
            assert!(expected.iter().flatten().any(|x| x.abs() > 1e-3));
            for arm in arms() {
                let all = run(arm, 0..11);
                for (i, (own, expected)) in all.iter().zip(&expected).enumerate() {
                    assert_eq!(run(arm, i..i + 1)[0], *own, "{arm}: state {i}");
                    // Positions and velocities.
                    let apart: Vec<f64> = own.iter().zip(expected).take(13).map(|(a, b)| a - b).collect();
                    assert!(tolerance::size(&apart) <= tolerance::SAME_CONTACTS, "{arm}: state {i}: {apart:?}");
                }
            }
        }
    });
}

#[test]
fn a_block_sticks_on_an_incline_exactly_up_to_the_friction_angle() {
    let (mu, dt) = (0.5, 1e-3);
    for (tan, slides) in [(0.3, false), (0.4999, false), (0.5001, true), (0.7, true)] {
        let (sin, cos) = f64::sin_cos(f64::atan(tan));
        // The incline is horizontal and gravity is tilted.
        let builder = corners(body(2.0, EDGES), EDGES, mu, 0.0).gravity([G * sin, 0.0, -G * cos]);
        let scene = builder.build().unwrap();
        let mut simulator = moving(&scene, dt, &at(&scene, [0.0, 0.0, 0.1]), &[0.0; 6]);
        go(&mut simulator, 500);
        let expected = if slides { G * (sin - mu * cos) * 0.5 } else { 0.0 };
        let speed = simulator.state(0).1[0];
        assert!((speed - expected).abs() < 1e-9, "tan {tan}: {speed} for {expected}");
    }
}

#[test]
fn a_tilted_plane_is_the_same_as_tilted_gravity() {
    let angle = 0.3_f64;
    let mut contact = Contact::new("ground", "ball");
    contact.normal = [-angle.sin(), 0.0, angle.cos()].into();
    contact.normal *= 7.0;
    contact.offset = 0.2;
    contact.radius = 0.1;
    contact.friction = 0.8;
    let mut source = ball(0.0, 0.0).without_contacts().unwrap().source().clone();
    source = source.contact(contact);
    let scene = source.build().unwrap();
    let normal = Vector3::new(-angle.sin(), 0.0, angle.cos());
    let start = normal * 0.3;
    let mut simulator = moving(&scene, 1e-3, &at(&scene, start.into()), &[0.0; 6]);
    go(&mut simulator, 400);
    let (q, _) = simulator.state(0);
    // Rolling: 5/7 g sin a. Downhill is along (-cos, 0, -sin).
    let along = Vector3::new(-angle.cos(), 0.0, -angle.sin()).dot(&(Vector3::new(q[0], q[1], q[2]) - start));
    let expected = 0.5 * 5.0 / 7.0 * G * angle.sin() * 0.4 * 0.401;
    assert!((along - expected).abs() < 1e-9, "{along} for {expected}");
    let mut gap = [f64::NAN];
    scene.contact_gaps(q, &mut gap).unwrap();
    assert!(gap[0].abs() < 1e-9, "{gap:?}");
}

#[test]
fn a_ball_bounces_to_e_squared_of_its_height() {
    let (e, dt, height) = (0.8, 2e-4, 1.0);
    let scene = ball(0.0, e);
    let mut simulator = moving(&scene, dt, &at(&scene, [0.0, 0.0, 0.1 + height]), &[0.0; 6]);
    let (mut peaks, mut before) = (Vec::new(), 0.0);
    for _ in 0..10_000 {
        go(&mut simulator, 1);
        let (q, qd) = simulator.state(0);
        if before > 0.0 && qd[2] <= 0.0 {
            peaks.push(q[2] - 0.1);
        }
        before = qd[2];
    }
    for (k, expected) in [e.powi(2), e.powi(4), e.powi(6)].into_iter().enumerate() {
        assert!((peaks[k] - expected * height).abs() < 2e-3, "{peaks:?}");
    }
    let told = simulator.contact_report(0).unwrap();
    assert!(told.lost_in_impacts > 0.5 * 0.5 * G * height && told.expansion_kept >= 1.0, "{told:?}");
}

#[test]
fn a_bouncing_ball_is_open_but_where_it_touches() {
    for (mu, touching) in [(0.3, ContactState::Sticking), (0.0, ContactState::Sliding)] {
        let scene = ball(mu, 0.8);
        let mut simulator = moving(&scene, 1e-3, &at(&scene, [0.0, 0.0, 0.4]), &[0.0; 6]);
        let (mut bounces, mut before) = (0, 0.0);
        for _ in 0..1000 {
            go(&mut simulator, 1);
            let struck = simulator.contacts_now(0)[9];
            let expected = if struck > before { touching } else { ContactState::Open };
            assert_eq!(states(&simulator), [expected]);
            bounces += u32::from(struck > before);
            before = struck;
        }
        assert!(bounces > 2, "{bounces}");
    }
    assert_eq!(ContactState::of(f64::NAN), None);
}

#[test]
fn an_elastic_ball_keeps_its_energy_through_many_bounces() {
    let dt = 1e-3;
    let scene = ball(0.0, 1.0);
    let mut simulator = moving(&scene, dt, &at(&scene, [0.0, 0.0, 0.4]), &[0.0; 6]);
    let kept = |simulator: &Simulator<&Scene>| {
        let (q, qd) = simulator.state(0);
        0.5 * qd[2] * qd[2] + G * q[2]
    };
    let start = kept(&simulator);
    go(&mut simulator, 50_000);
    assert!((kept(&simulator) - start).abs() < 1e-6 * start, "{} for {start}", kept(&simulator));
}

#[test]
fn a_sliding_ball_ends_up_rolling_at_five_sevenths_of_its_speed() {
    for dt in [1e-3, 4e-3] {
        let scene = ball(0.3, 0.0);
        let v0 = 2.0;
        let mut simulator = moving(&scene, dt, &at(&scene, [0.0, 0.0, 0.1]), &[v0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        go(&mut simulator, (6.0 / dt) as usize);
        let (q, qd) = simulator.state(0);
        let mut velocity = [f64::NAN; 3];
        scene.contact_velocities(q, qd, &mut velocity).unwrap();
        let speed = qd[..3].iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((speed - 5.0 / 7.0 * v0).abs() < 1e-9, "dt {dt}: {speed}");
        assert!(velocity.iter().all(|v| v.abs() < 1e-9) && (q[2] - 0.1).abs() < 1e-9, "{velocity:?}, {q:?}");
    }
}

#[test]
fn a_dropped_box_loses_energy_in_every_step_and_comes_to_rest() {
    for e in [0.0, 0.4] {
        let scene = block(0.6, e);
        let q = at(&scene, [0.0, 0.0, 0.5]);
        let mut simulator = moving(&scene, 1e-3, &q, &[0.3, -0.2, 0.0, 1.5, 2.0, 0.7]);
        let mut before = energy(&scene, simulator.state(0));
        for n in 0..4_000 {
            go(&mut simulator, 1);
            let now = energy(&scene, simulator.state(0));
            assert!(now <= before + 1e-9, "e {e}, step {n}: {before} to {now}");
            before = now;
        }
        let (q, qd) = simulator.state(0);
        assert!(qd.iter().all(|v| v.abs() < 1e-7), "e {e}: {qd:?}");
        assert!([0.1, 0.15, 0.2].iter().any(|height| (q[2] - height).abs() < 1e-7), "{q:?}");
        let force: f64 = simulator.contacts_now(0).chunks(11).map(|of| of[6]).sum();
        assert!((force - 2.0 * G).abs() < 1e-6, "{force}");
        let told = simulator.contact_report(0).unwrap();
        assert!(told.converged && told.depth < 1e-3, "{told:?}");
        let resting = states(&simulator);
        assert_eq!(resting.iter().filter(|&&of| of == ContactState::Sticking).count(), 4, "{resting:?}");
        assert_eq!(resting.iter().filter(|&&of| of == ContactState::Open).count(), 4, "{resting:?}");
    }
}

/// A trunk with two legs with hip, knee and ankle about y, and four points per foot.
fn biped(friction: f64, restitution: f64) -> Scene {
    let rod = |mass: f64, length: f64| {
        let side = mass * length * length / 12.0 + mass * 1e-3;
        let central = Symmetric3::new([side, 0.0, 0.0, side, 0.0, mass * 2e-3]);
        Some(Inertial { mass, center: Vector3::new(0.0, 0.0, -length / 2.0), central })
    };
    let trunk = Inertial {
        mass: 15.0,
        center: Vector3::new(0.0, 0.0, 0.2),
        central: Symmetric3::new([0.5, 0.0, 0.0, 0.4, 0.0, 0.2]),
    };
    let mut builder =
        SceneBuilder::new().floating_base(true).link(LinkDescription { name: "trunk".into(), inertial: Some(trunk) });
    for (side, y) in [("left", 0.1), ("right", -0.1)] {
        let mut parent = "trunk".to_owned();
        for (part, mass, length, down, lateral) in
            [("thigh", 5.0, 0.4, 0.0, y), ("shank", 3.0, 0.4, -0.4, 0.0), ("foot", 1.0, 0.1, -0.4, 0.0)]
        {
            let name = format!("{side}_{part}");
            builder = builder.link(LinkDescription { name: name.clone(), inertial: rod(mass, length) });
            for (axis, direction) in [("y", Vector3::y()), ("x", Vector3::x())] {
                if axis == "x" && part == "shank" {
                    continue;
                }
                let mut joint =
                    JointDescription::new(format!("{name}_{axis}"), JointKind::Revolute, parent.clone(), name.clone());
                joint.axis = direction;
                if axis == "y" {
                    joint.origin.lever = Vector3::new(0.0, lateral, down);
                    if part != "shank" {
                        let between = format!("{name}_between");
                        builder = builder.link(LinkDescription { name: between.clone(), inertial: rod(0.1, 0.05) });
                        joint.child.clone_from(&between);
                        parent = between;
                    }
                }
                builder = builder.joint(joint);
            }
            parent.clone_from(&name);
        }
        for i in 0..4_u32 {
            let mut contact = Contact::new(format!("{side}{i}"), format!("{side}_foot"));
            contact.point = [if i & 1 == 0 { -0.08 } else { 0.14 }, if i & 2 == 0 { -0.04 } else { 0.04 }, -0.1].into();
            (contact.friction, contact.restitution) = (friction, restitution);
            builder = builder.contact(contact);
        }
    }
    builder.build().unwrap()
}

#[test]
fn a_biped_stands_on_24_redundant_rows_and_its_forces_are_its_weight() {
    let scene = biped(0.7, 0.0);
    let nv = scene.nv();
    let mut settings = Settings::new(&scene, 1e-3);
    let mut gains = vec![0.0; nv];
    gains[6..].fill(2_000.0);
    let q = at(&scene, [0.0, 0.0, 0.9]);
    settings.gains =
        Some(phipsi::motion::Gains::new(gains.clone(), gains.iter().map(|k| k / 20.0).collect::<Vec<_>>(), q.clone()));
    let mut simulator = Simulator::new(&scene, settings, &q, &vec![0.0; nv]).unwrap();
    go(&mut simulator, 3_000);
    let (q, qd) = simulator.state(0);
    assert!(qd.iter().all(|v| v.abs() < 1e-5) && q[2] > 0.85, "{q:?} {qd:?}");
    let now = simulator.contacts_now(0);
    let force = now.chunks(11).fold(Vector3::zeros(), |sum, of| sum + Vector3::new(of[4], of[5], of[6]));
    let weight = total_mass(&scene) * G;
    assert!((force - Vector3::new(0.0, 0.0, weight)).norm() < 1e-3 * weight, "{force} for {weight}");
    let told = simulator.contact_report(0).unwrap();
    assert!(told.converged, "{told:?}");
}

fn total_mass(scene: &Scene) -> f64 {
    scene.source().links().iter().filter_map(|link| link.inertial).map(|of| of.mass).sum()
}

/// Pseudo-random values from -1 to 1.
struct Draw(u64);

impl Draw {
    #[allow(clippy::cast_precision_loss)] // 53 bits
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1_u64 << 53) as f64) * 2.0 - 1.0
    }
}

/// Two rods in a plane with a contact at the tip: Kane's example, in which Newton's restitution with friction
/// increases the energy.
fn double_pendulum(friction: f64, restitution: f64, offset: f64) -> Scene {
    let rod = Inertial {
        mass: 1.0,
        center: Vector3::new(0.0, 0.0, -0.5),
        central: Symmetric3::new([1.0 / 12.0, 0.0, 0.0, 1.0 / 12.0, 0.0, 1e-4]),
    };
    let mut tip = Contact::new("tip", "lower");
    tip.point = [0.0, 0.0, -1.0].into();
    (tip.friction, tip.restitution, tip.offset) = (friction, restitution, offset);
    let mut shoulder = JointDescription::new("shoulder", JointKind::Revolute, "base", "upper");
    let mut elbow = JointDescription::new("elbow", JointKind::Revolute, "upper", "lower");
    (shoulder.axis, elbow.axis) = (Vector3::y(), Vector3::y());
    elbow.origin.lever = Vector3::new(0.0, 0.0, -1.0);
    SceneBuilder::new()
        .gravity([0.0; 3])
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "upper".into(), inertial: Some(rod) })
        .link(LinkDescription { name: "lower".into(), inertial: Some(rod) })
        .joint(shoulder)
        .joint(elbow)
        .contact(tip)
        .build()
        .unwrap()
}

#[test]
fn impacts_of_a_double_pendulum_never_raise_its_energy() {
    let mut draw = Draw(1);
    let (mut struck, dt) = (0, 1e-6);
    for _ in 0..3_000 {
        let (mu, e) = (draw.next().abs() * 1.2, draw.next().abs());
        let q = [draw.next() * 1.4, draw.next() * 1.4];
        let qd = [draw.next() * 3.0, draw.next() * 3.0];
        // The plane is just below the tip.
        let tip = -q[0].cos() - (q[0] + q[1]).cos();
        let scene = double_pendulum(mu, e, tip - 1e-9);
        let mut simulator = moving(&scene, dt, &q, &qd);
        let before = energy(&scene, simulator.state(0));
        go(&mut simulator, 1);
        let after = energy(&scene, simulator.state(0));
        assert!(after <= before * (1.0 + 1e-9), "mu {mu}, e {e}, q {q:?}, qd {qd:?}: {before} to {after}");
        struck += usize::from(simulator.contact_report(0).unwrap().lost_in_impacts > 0.0);
    }
    assert!(struck > 1_000, "{struck}");
}

#[test]
fn impacts_of_a_tumbling_biped_never_raise_its_energy() {
    let mut draw = Draw(5);
    for trial in 0..150 {
        let scene = biped(0.8, 0.5);
        let mut q = at(&scene, [0.0, 0.0, 0.9 + 1e-9]);
        for angle in &mut q[7..] {
            *angle = 0.2 * draw.next();
        }
        let mut gaps = [f64::NAN; 8];
        scene.contact_gaps(&q, &mut gaps).unwrap();
        q[2] -= gaps.iter().fold(f64::INFINITY, |lowest, &gap| lowest.min(gap)) - 1e-9;
        let qd: Vec<f64> = (0..scene.nv()).map(|_| draw.next()).collect();
        let still = scene.source().clone().gravity([0.0; 3]).build().unwrap();
        let mut simulator = moving(&still, 1e-6, &q, &qd);
        let before = energy(&still, simulator.state(0));
        go(&mut simulator, 1);
        let after = energy(&still, simulator.state(0));
        assert!(after <= before * (1.0 + 1e-8), "{trial}: {before} to {after}");
    }
}

#[test]
fn contacts_brought_down_by_others_join_within_the_step() {
    // A falling box that is almost parallel to the ground: two corners touch first, the others within the same step.
    let scene = block(0.5, 0.0);
    let mut q = at(&scene, [0.0, 0.0, 0.1 + 4e-4]);
    (q[3], q[6]) = ((1e-3_f64).sin(), (1e-3_f64).cos());
    let mut simulator = moving(&scene, 1e-2, &q, &[0.0, 0.0, -1.0, 0.0, 0.0, 0.0]);
    go(&mut simulator, 100);
    let (q, qd) = simulator.state(0);
    assert!((q[2] - 0.1).abs() < 1e-6 && qd.iter().all(|v| v.abs() < 1e-6), "{q:?} {qd:?}");
    assert!(simulator.contact_report(0).unwrap().depth < 1e-5);
}

#[test]
fn stiff_springs_are_taken_implicitly() {
    // A mass on a spring a thousand times faster than the step, above a plane where the spring is not at rest.
    let mass = Inertial { mass: 1.0, center: Vector3::zeros(), central: Symmetric3::zero() };
    let mut slide = JointDescription::new("slide", JointKind::Prismatic, "base", "weight");
    (slide.spring.stiffness, slide.damping) = (1e9, 10.0);
    slide.spring.rest = vec![-0.01];
    let scene = SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "weight".into(), inertial: Some(mass) })
        .joint(slide)
        .contact(Contact::new("table", "weight"))
        .build()
        .unwrap();
    let mut simulator = moving(&scene, 1e-2, &[0.0], &[0.0]);
    go(&mut simulator, 100);
    let force = simulator.contacts_now(0)[6];
    assert!(simulator.state(0).0[0].abs() < 1e-9, "{:?}", simulator.state(0));
    assert!((force - (1e9 * 0.01 + G)).abs() < 1e-3, "{force}");
}

#[test]
fn steps_are_the_same_in_batches_in_pieces_and_with_records() {
    let scene = block(0.5, 0.3);
    let starts: Vec<f64> = (0..5).flat_map(|i| at(&scene, [0.0, 0.0, 0.3 + 0.05 * f64::from(i)])).collect();
    let rates: Vec<f64> = (0..5).flat_map(|i| [0.2, 0.1 * f64::from(i), 0.0, 1.0, 0.5, 0.0]).collect();
    let mut all = Rollout::new(&scene, Settings::new(&scene, 2e-3), &starts, &rates).unwrap();
    let (mut q, mut qd, mut contacts) = (vec![0.0; 5 * 11 * 7], vec![0.0; 5 * 11 * 6], vec![f64::NAN; 5 * 11 * 88]);
    let mut records = Records::new(&mut q, &mut qd).with_contacts(&mut contacts).with_every(40);
    all.advance(400, &Torque::Zero, Some(&mut records)).map_err(|fault| fault.error).unwrap();
    assert!(contacts.iter().all(|x| x.is_finite()));
    for state in 0..5 {
        let (own_q, own_qd) = (&starts[state * 7..(state + 1) * 7], &rates[state * 6..(state + 1) * 6]);
        let mut one = moving(&scene, 2e-3, own_q, own_qd);
        for _ in 0..50 {
            go(&mut one, 8);
        }
        assert_eq!(one.state(0), all.state(state));
        assert_eq!(one.state(0).0, &q[(state * 11 + 10) * 7..(state * 11 + 11) * 7]);
        // Impulses were reported with the rows; the rest is the same.
        let (now, row) = (one.contacts_now(0), &contacts[(state * 11 + 10) * 88..(state * 11 + 11) * 88]);
        assert!((0..8).all(|i| now[11 * i..11 * i + 7] == row[11 * i..11 * i + 7]
            && now[11 * i + 10..11 * i + 11] == row[11 * i + 10..11 * i + 11]));
        let sum = |i: usize| (0..11).map(|row| contacts[(state * 11 + row) * 88 + 11 * i + 9]).sum::<f64>();
        assert!((0..8).all(|i| (now[11 * i + 9] - sum(i)).abs() < 1e-12));
    }
}

#[test]
fn momentum_is_what_forces_and_impulses_give() {
    let scene = block(0.5, 0.5);
    let steps = 300;
    let dt = 2e-3;
    let mut all = Rollout::new(&scene, Settings::new(&scene, dt), &at(&scene, [0.0, 0.0, 0.3]), &[0.5; 6]).unwrap();
    let rows = steps + 1;
    let (mut q, mut qd, mut contacts) = (vec![0.0; rows * 7], vec![0.0; rows * 6], vec![0.0; rows * 88]);
    let before = momentum(&scene, all.state(0));
    let mut records = Records::new(&mut q, &mut qd).with_contacts(&mut contacts);
    all.advance(steps, &Torque::Zero, Some(&mut records)).map_err(|fault| fault.error).unwrap();
    let mut given = Vector3::new(0.0, 0.0, -2.0 * G * dt * 300.0);
    for of in contacts.chunks(11) {
        given += Vector3::new(of[4], of[5], of[6]) * dt + Vector3::new(of[7], of[8], of[9]);
    }
    assert!((momentum(&scene, all.state(0)) - before - given).norm() < 1e-9);
}

fn momentum(scene: &Scene, (q, qd): (&[f64], &[f64])) -> Vector3<f64> {
    let place = scene.placement(q, "box").unwrap();
    place.rotation * Vector3::new(qd[0], qd[1], qd[2]) * 2.0
}

#[test]
fn boxes_tumble_without_an_end_before_their_time() {
    let scene = block(1.0, 0.3);
    let mut draw = Draw(2);
    for _ in 0..8 {
        let qd: Vec<f64> = (0..6).map(|_| 2.0 * draw.next()).collect();
        let mut simulator = moving(&scene, 1e-3, &at(&scene, [0.0, 0.0, 0.5]), &qd);
        go(&mut simulator, 1_000);
        let told = simulator.contact_report(0).unwrap();
        assert!(told.residual < 1e-5 && told.impulse_kept > 0.999, "{told:?}");
    }
}

#[test]
fn friction_of_three_to_a_thousand_ends_no_run_and_raises_no_energy() {
    let mut draw = Draw(2);
    for mu in [3.0, 10.0, 1000.0] {
        let scene = block(mu, 0.3);
        for _ in 0..4 {
            let qd: Vec<f64> = (0..6).map(|_| 2.0 * draw.next()).collect();
            let mut simulator = moving(&scene, 1e-3, &at(&scene, [0.0, 0.0, 0.4]), &qd);
            let mut before = energy(&scene, simulator.state(0));
            for n in 0..600 {
                go(&mut simulator, 1);
                let now = energy(&scene, simulator.state(0));
                assert!(now <= before + 1e-8, "mu {mu}, step {n}: {before} to {now}");
                before = now;
            }
            let told = simulator.contact_report(0).unwrap();
            assert!(told.residual < 1e-5 && told.impulse_kept > 0.999 && told.iterations < 2e4, "mu {mu}: {told:?}");
        }
    }
}

#[test]
fn a_biped_slips_with_friction_of_a_thousand_only_where_the_ground_would_have_to_pull() {
    let scene = biped(1000.0, 0.0);
    let mut draw = Draw(3);
    for _ in 0..4 {
        let qd: Vec<f64> = (0..scene.nv()).map(|_| draw.next()).collect();
        let mut simulator = moving(&scene, 1e-3, &at(&scene, [0.0, 0.0, 0.95]), &qd);
        go(&mut simulator, 300);
        let told = simulator.contact_report(0).unwrap();
        assert!(told.residual < 1e-5 && told.impulse_kept > 0.999, "{told:?}");
        let mut down = 0;
        for of in simulator.contacts_now(0).chunks(11) {
            // The contact law was satisfied at the beginning of the step: the link has rotated by dt since.
            assert!(of[6] < 0.1 || of[1].hypot(of[2]) < 1e-2, "{of:?}");
            down += u32::from(of[6] > 0.0);
        }
        assert!(down > 0);
    }
}

#[test]
fn a_step_without_impulses_that_meet_the_law_is_an_error_that_names_contacts() {
    // Friction beyond the precision of float64: the solver does not converge and reports it.
    let scene = block(1e12, 0.0);
    let mut simulator = moving(&scene, 1e-3, &at(&scene, [0.0, 0.0, 0.5]), &[0.3, -0.2, 0.0, 1.5, 2.0, 0.7]);
    let fault = simulator.step(&Torque::Zero, 2_000).unwrap_err();
    let text = fault.error.to_string();
    assert!(fault.step > 0 && text.contains("corner") && text.contains("residual"), "{text}");
    assert_eq!(simulator.steps(), fault.step);
}

fn refused(error: &Error, subject: &str, found: &str) {
    let text = error.to_string();
    assert!(matches!(error, Error::Scene { .. }), "{text}");
    assert!(text.contains(subject) && text.contains(found), "{text}");
}

/// Error message for a box with a modified contact.
fn fault(change: impl FnOnce(&mut Contact)) -> Error {
    let mut contact = Contact::new("foot", "box");
    change(&mut contact);
    body(1.0, EDGES).contact(contact).build().unwrap_err()
}

#[test]
fn broken_contacts_are_refused_by_name() {
    let foot = "contact \"foot\"";
    refused(&fault(|contact| contact.link = "hand".into()), foot, "\"hand\"");
    refused(&fault(|contact| contact.normal = Vector3::zeros()), foot, "normal");
    refused(&fault(|contact| contact.normal[0] = f64::NAN), foot, "normal");
    refused(&fault(|contact| contact.point[1] = f64::INFINITY), foot, "point");
    refused(&fault(|contact| contact.offset = f64::NAN), foot, "offset");
    refused(&fault(|contact| contact.radius = -0.1), foot, "radius -0.1");
    refused(&fault(|contact| contact.friction = -0.5), foot, "friction -0.5");
    refused(&fault(|contact| contact.friction = f64::INFINITY), foot, "friction");
    refused(&fault(|contact| contact.restitution = 1.1), foot, "restitution 1.1");
    refused(&fault(|contact| contact.restitution = f64::NAN), foot, "restitution");
    refused(&fault(|contact| contact.other = Some("hand".into())), foot, "\"hand\"");
    refused(&fault(|contact| contact.surface = Surface::Sphere { radius: -1.0 }), foot, "radius -1");
    refused(&fault(|contact| contact.surface = Surface::Box { size: [1.0, 0.0, 1.0].into() }), foot, "size");
    refused(&fault(|contact| contact.other_frame.rotation[0] = 2.0), foot, "rotation");
    let twice = body(1.0, EDGES).contact(Contact::new("foot", "box")).contact(Contact::new("foot", "box"));
    refused(&twice.build().unwrap_err(), foot, "duplicate name");
}

#[test]
fn what_cannot_move_has_no_contacts() {
    let chain = phipsi::scenes::chain(3).unwrap().source().clone();
    let base = chain.clone().contact(Contact::new("ground", "base")).build().unwrap_err();
    refused(&base, "contact \"ground\"", "cannot move");
    let axis = chain.clone().contact(Contact::new("axis", "link0")).build().unwrap_err();
    refused(&axis, "contact \"axis\"", "no joint moves");
    let pair =
        Contact::new("pair", "link0").with_other("link0".to_owned()).with_surface(Surface::Sphere { radius: 0.1 });
    refused(&chain.contact(pair).build().unwrap_err(), "contact \"pair\"", "rigidly attached");
}

/// A ball that falls onto a ball below it, which a rail holds from falling further: closed form of an inelastic impact.
#[test]
fn two_balls_on_one_rail_collide() {
    let rail = |name: &str, mass: f64| {
        let central = Symmetric3::new([1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3]);
        let inertial = Some(Inertial { mass, center: Vector3::zeros(), central });
        let mut joint = JointDescription::new(name, JointKind::Prismatic, "base", name);
        joint.axis = Vector3::z();
        (LinkDescription { name: name.into(), inertial }, joint)
    };
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for (link, joint) in [rail("low", 2.0), rail("high", 1.0)] {
        builder = builder.link(link).joint(joint);
    }
    let pair = Contact::new("pair", "high").with_radius(0.1).with_restitution(0.5);
    let pair = pair.with_other("low".to_owned()).with_surface(Surface::Sphere { radius: 0.1 });
    let scene = builder.contact(pair).gravity([0.0; 3]).build().unwrap();
    let mut simulator = moving(&scene, 1e-3, &[0.0, 0.2], &[0.0, -3.0]);
    go(&mut simulator, 1);
    let (_, qd) = simulator.state(0);
    assert!((qd[0] + 1.5).abs() < 1e-12 && qd[1].abs() < 1e-12, "{qd:?}");
    // The impulse is that on the first link.
    assert!((simulator.contacts_now(0)[9] - 3.0).abs() < 1e-12);
}

/// The tip of a chain on the ground, with two joints coupled by a connection: the coupling holds in every step.
#[test]
fn a_coupled_chain_slides_on_the_ground() {
    let gear = ConnectionKind::Joint(Polynomial::linear(-0.5, 0.0));
    let builder = phipsi::scenes::chain(4).unwrap().source().clone();
    let tip = Contact::new("tip", "link3").with_point([0.0, 0.0, 0.3]).with_friction(0.3);
    let free = builder.clone().contact(tip.clone()).build().unwrap();
    let (q, mut gap) = ([0.4, 0.3, 0.2, -0.1], [f64::NAN]);
    free.contact_gaps(&q, &mut gap).unwrap();
    let tip = tip.with_offset(gap[0]);
    let scene = builder.connect(Connection::new("gear", gear, "j3", Some("j2"))).contact(tip).build().unwrap();
    let mut simulator = moving(&scene, 1e-3, &q, &[0.0; 4]);
    for _ in 0..50 {
        go(&mut simulator, 10);
        let (q, qd) = simulator.state(0);
        assert!((q[3] + 0.5 * q[2]).abs() < 1e-12 && (qd[3] + 0.5 * qd[2]).abs() < 1e-12, "{q:?} {qd:?}");
        scene.contact_gaps(q, &mut gap).unwrap();
        assert!(gap[0] > -1e-9);
    }
    let told = simulator.contact_report(0).unwrap();
    assert!(told.converged && told.residual <= 1e-10, "{told:?}");
}

#[test]
fn methods_and_scenes_belong_together() {
    let scene = ball(0.5, 0.0);
    let start = at(&scene, [0.0, 0.0, 1.0]);
    let refused = |scene: &Scene, change: &dyn Fn(&mut Settings)| {
        let mut settings = Settings::new(scene, 1e-3);
        change(&mut settings);
        Rollout::new(scene, settings, &start, &[0.0; 6]).unwrap_err().to_string()
    };
    assert_eq!(Settings::new(&scene, 1e-3).method, Method::Auto);
    let text = refused(&scene, &|settings| (settings.method, settings.smoothing) = (Method::RungeKutta4, 1e-3));
    assert!(text.contains("method") && text.contains("smoothing"), "{text}");
    let free = scene.without_contacts().unwrap();
    let text = refused(&free, &|settings| settings.method = Method::Contact);
    assert!(text.contains("no contacts"), "{text}");
}

#[test]
fn locking_keeps_the_contacts_of_what_still_moves() {
    let mut builder = phipsi::scenes::chain(3).unwrap().source().clone();
    for (name, link) in [("elbow", "link1"), ("tip", "link2")] {
        let mut contact = Contact::new(name, link);
        contact.point = [0.1, 0.0, 0.3].into();
        builder = builder.contact(contact);
    }
    let scene = builder.build().unwrap();
    let joints: Vec<&str> = scene.joints().iter().map(|joint| joint.name.as_str()).collect();
    let q = [0.3, 0.2, 0.1];
    let locked = scene.lock(&joints[..2], &q).unwrap();
    let names: Vec<&str> = locked.contacts().iter().map(|contact| contact.name.as_str()).collect();
    assert_eq!(names, ["tip"]);
    let (mut before, mut after) = ([f64::NAN; 2], [f64::NAN]);
    scene.contact_gaps(&q, &mut before).unwrap();
    locked.contact_gaps(&q[2..], &mut after).unwrap();
    assert!((before[1] - after[0]).abs() < 1e-14);
}

#[test]
fn torques_and_records_of_other_sizes_are_refused() {
    let scene = ball(0.5, 0.0);
    let start = at(&scene, [0.0, 0.0, 1.0]);
    let mut rollout = Rollout::new(&scene, Settings::new(&scene, 1e-3), &start, &[0.0; 6]).unwrap();
    let (mut q, mut qd) = ([0.0; 14], [0.0; 12]);
    let mut few = [0.0; 7];
    let mut records = Records::new(&mut q, &mut qd).with_contacts(&mut few);
    let fault = rollout.advance(1, &Torque::Zero, Some(&mut records)).unwrap_err();
    assert!(fault.error.to_string().contains("records.contacts"), "{}", fault.error);
    let torque = [0.0, 0.0, 0.5 * G, 0.0, 0.0, 0.0];
    let lift = Torque::constant(&torque);
    rollout.advance(10, &lift, None).map_err(|fault| fault.error).unwrap();
    assert!((rollout.state(0).0[2] - 1.0).abs() < 1e-12);
}

#[test]
fn gradients_of_a_slide_are_those_of_its_closed_form() {
    let (scene, steps, h, mu) = (block(0.3, 0.0), 100, 1e-3, 0.3);
    let start = at(&scene, [0.0, 0.0, EDGES[2] / 2.0]);
    let mut rollout = Rollout::new(&scene, Settings::new(&scene, h), &start, &[2.0, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let (mut q, mut qd) = (vec![0.0; 7 * (steps + 1)], vec![0.0; 6 * (steps + 1)]);
    let mut records = Records::new(&mut q, &mut qd);
    rollout.advance(steps, &Torque::Zero, Some(&mut records)).unwrap();
    // The speed at the end, v - mu g t.
    let (by_q, mut by_qd) = (vec![0.0; qd.len()], vec![0.0; qd.len()]);
    by_qd[6 * steps] = 1.0;
    let rows = RecordedRows { q: &q, qd: &qd, every: 1, by_q: &by_q, by_qd: &by_qd };
    let found = rollout.gradients(&Torque::Zero, steps, &rows, true).unwrap();
    let t = h * f64::from(u8::try_from(steps).unwrap());
    let by_friction: f64 = found.contacts.friction.iter().sum();
    assert!((by_friction + G * t).abs() < 1e-8, "{by_friction}");
    assert!((found.qd[0] - 1.0).abs() < 1e-8 && (found.torque[0] - t / 2.0).abs() < 1e-8, "{found:?}");
    // The corners below slide, those above are open; nothing changes.
    assert!(found.mode_changes.is_empty());
    let least = found.contacts.margin.iter().fold(f64::INFINITY, |least, &margin| least.min(margin));
    assert!(least > 1e-3 && least <= 2.0 - mu * G * t, "{least}");
}
