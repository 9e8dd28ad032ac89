//! Momentum and energy of simulated trees.

use super::{State, after, settings};
use crate::common::{Random, Tree, random_state, tolerance};
use phipsi::Scene;
use phipsi::motion::{METHODS, Settings};
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};

fn momentum(scene: &Scene, q: &[f64], v: &[f64]) -> nalgebra::Vector6<f64> {
    scene.momentum(&mut scene.workspace(), q, v).unwrap()
}

/// The linear momentum of a body on prismatic joints is linear in the velocities without rotations: every method
/// conserves it.
#[test]
fn momentum_of_what_only_slides_is_kept_to_rounding() {
    let mut builder =
        Tree { seed: 4, bodies: 5, kinds: &[JointKind::Prismatic], branching: 0.5, armature: 0.0, floating: false }
            .builder();
    builder = builder.gravity([0.0; 3]);
    // Three rails instead of a base: without rotations.
    let mut rails = SceneBuilder::new().gravity([0.0; 3]);
    for name in ["world", "x", "y"] {
        rails = rails.link(LinkDescription { name: name.into(), inertial: None });
    }
    for link in builder.links() {
        let mut link = link.clone();
        if link.name == "base" {
            link.inertial = builder.links()[1].inertial;
        }
        rails = rails.link(link);
    }
    for (k, (name, parent, child)) in
        [("rail x", "world", "x"), ("rail y", "x", "y"), ("rail z", "y", "base")].into_iter().enumerate()
    {
        let mut joint = JointDescription::new(name, JointKind::Prismatic, parent, child);
        joint.axis = nalgebra::Vector3::ith(k, 1.0);
        rails = rails.joint(joint);
    }
    for joint in builder.joints() {
        rails = rails.joint(joint.clone());
    }
    let scene = rails.build().unwrap();
    let mut random = Random::new(9);
    let (q, v, u) = random_state(&scene, &mut random);
    let u: Vec<f64> = u.iter().enumerate().map(|(i, u)| if i < 3 { 0.0 } else { *u }).collect();
    let start = momentum(&scene, &q, &v);
    let settings = Settings::new(&scene, 1.0);
    for &(name, method) in METHODS {
        let settings = settings.clone().with_method(method);
        let (q, v) = after(&scene, &settings, (&q, &v, &u), 1.0, 200);
        let end = momentum(&scene, &q, &v);
        let off = (0..3).map(|i| (end[3 + i] - start[3 + i]).abs()).fold(0.0, f64::max);
        let size = v.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
        assert!(off <= tolerance::inverse(1e2, size), "{name}: {off:e}");
    }
}

/// A floating tree with revolute joints, without gravity.
fn turning_tree() -> Scene {
    let kinds = &[JointKind::Revolute, JointKind::Spherical];
    let tree = Tree { seed: 6, bodies: 4, kinds, branching: 0.4, armature: 0.0, floating: true };
    tree.builder().gravity([0.0; 3]).build().unwrap()
}

/// With rotations, momentum is not linear in the velocities: its drift decreases with the order of the method.
#[test]
fn drift_of_momentum_and_energy_falls_with_the_order() {
    let scene = turning_tree();
    let mut random = Random::new(2);
    let (q, v, _) = random_state(&scene, &mut random);
    let u = vec![0.0; scene.nv()];
    let start = momentum(&scene, &q, &v);
    let energy = |q: &[f64], v: &[f64]| scene.energy(&mut scene.workspace(), q, v).unwrap().kinetic;
    for &(name, method) in METHODS {
        let settings = Settings::new(&scene, 1.0).with_method(method);
        let steps = if method.order() >= 3 { 20 } else { 200 };
        let drift = [steps, 2 * steps].map(|steps| {
            let (q1, v1) = after(&scene, &settings, (&q, &v, &u), 0.4, steps);
            [(momentum(&scene, &q1, &v1) - start).amax(), (energy(&q1, &v1) - energy(&q, &v)).abs()]
        });
        println!(
            "{name}: momentum {:.1e} {:.1e}, energy {:.1e} {:.1e}",
            drift[0][0], drift[1][0], drift[0][1], drift[1][1]
        );
        let least = 0.8 * f64::from(method.order());
        for (coarse, fine) in drift[0].into_iter().zip(drift[1]) {
            assert!((coarse / fine).log2() >= least, "{name}: {drift:?}");
        }
    }
}

/// A tree of six bodies on a free joint; all forces act at its joints, none at the free joint.
pub(super) fn floating(kinds: &[JointKind], gravity: [f64; 3]) -> (Scene, Settings, State) {
    let tree = Tree { seed: 6, bodies: 5, kinds, branching: 0.4, armature: 0.3, floating: true };
    let scene = tree.builder().gravity(gravity).build().unwrap();
    let mut random = Random::new(2);
    let (q, v, mut u) = random_state(&scene, &mut random);
    let mut settings = settings(&scene, &q, &mut random);
    let gains = settings.gains.as_mut().unwrap();
    let p = &mut settings.properties;
    for acting in
        [&mut p.damping, &mut p.stiffness, &mut p.friction, &mut gains.proportional, &mut gains.derivative, &mut u]
    {
        acting[..6].fill(0.0);
    }
    (scene, settings, (q, v, u))
}
