//! Operation counts. `PHIPSI_SHOW_RATIOS=1 ... -- --nocapture cost` prints them with those of the dynamics.

use super::support::{KINDS, State, of_accelerations, of_torques};
use crate::common::Tree;
use phipsi::report::operations::{Task, count_recursion};
use phipsi::scalar::Traced;
use phipsi::scene::JointKind;
use phipsi::{Algorithm, Arguments, Form, Scene, scenes};

/// Floating-point operations of dtau/dq, dtau/dqd and M, and of dqdd/dq, dqdd/dqd and M^-1 in covariance form.
fn counted(scene: &Scene) -> [u64; 2] {
    let (model, state) = (scene.model().cast(), State::random(scene, 1).cast::<Traced>());
    let (_, inverse) = Traced::counted(|| of_torques(&model, &state));
    let (found, forward) = Traced::counted(|| of_accelerations(&model, Form::Covariance, &state));
    assert!(found.is_ok());
    [inverse, forward].map(|operations| operations.flops())
}

fn of_task(scene: &Scene, algorithm: Algorithm) -> u64 {
    let State { q, qd, u, wrenches } = State::random(scene, 1);
    let state = Arguments { q: &q, qd: &qd, u: &u, wrenches: &wrenches, ..Arguments::default() };
    count_recursion(scene, Task::Algorithm(algorithm), &state).operations.flops()
}

#[test]
fn operations() {
    let branched = |kinds| Tree { seed: 6, bodies: 30, kinds, branching: 0.5, armature: 0.1, floating: true }.scene();
    let mut shown = vec![
        ("30 revolute joints, branched, floating".to_owned(), branched(&[JointKind::Revolute])),
        ("30 joints of all kinds, branched, floating".to_owned(), branched(&KINDS)),
    ];
    for n in [7, 20, 50, 100] {
        shown.push((format!("chain({n})"), scenes::chain(n).unwrap()));
    }
    for (name, scene) in shown {
        let [inverse, forward] = counted(&scene);
        let auto = {
            let (model, state) = (scene.model().cast(), State::random(&scene, 1).cast::<Traced>());
            Traced::counted(|| of_accelerations(&model, Form::Auto, &state)).1.flops()
        };
        let of_id = of_task(&scene, Algorithm::InverseDynamics);
        let of_fd = of_task(&scene, Algorithm::ForwardDynamics(Form::Covariance));
        let of_inverse = of_task(&scene, Algorithm::MassMatrixInverse(Form::Covariance));
        if std::env::var_os("PHIPSI_SHOW_RATIOS").is_some() {
            eprintln!(
                "{name}, nv = {}: ID {of_id}, dID {inverse}; FD {of_fd}, M^-1 {of_inverse}, dFD {forward} (auto {auto})",
                scene.nv()
            );
        }
        assert!(inverse > of_id && forward > of_fd + of_inverse);
    }
}

/// O(N depth): with legs of equal depth, twice as many cost twice as much.
#[test]
fn linear_in_the_number_of_equal_branches() {
    let star = |legs: usize| {
        use phipsi::scene::{JointDescription, LinkDescription, SceneBuilder};
        let mut random = crate::common::Random::new(1);
        let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
        for k in 0..3 * legs {
            let parent = if k % 3 == 0 { "base".to_owned() } else { format!("link{}", k - 1) };
            let mut joint = JointDescription::new(format!("j{k}"), JointKind::Revolute, parent, format!("link{k}"));
            joint.axis = random.vector();
            joint.origin.lever = random.vector();
            let inertial = Some(crate::common::random_inertial(&mut random));
            builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
        }
        builder.build().unwrap()
    };
    let [two, four, eight] = [2, 4, 8].map(|legs| counted(&star(legs))[0]);
    assert_eq!(eight - four, 2 * (four - two));
}
