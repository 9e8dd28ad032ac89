//! Gradients of functions of trajectories: equal with every instruction set and from any checkpoints, and refused
//! arguments. Their correctness is tested in
//! `src/motion/backward/tests.rs`, by comparison with dual numbers in double-double arithmetic, and in
//! `tests/python/test_rollout_gradients.py`.

use crate::common::{ALL_KINDS, Random, Tree, random_state, tolerance};
use phipsi::batch::Broadcast;
use phipsi::batch::{INSTRUCTION_SETS, InstructionSet};
use phipsi::filter::Form;
use phipsi::motion::{METHODS, Method, RecordedRows, Records, Rollout, RolloutGradients, Settings, Torque};
use phipsi::{Error, Scene};

const STATES: usize = 11;
const STEPS: usize = 4;

fn tree(seed: u64, floating: bool) -> Scene {
    Tree { seed, bodies: 4, kinds: &ALL_KINDS, branching: 0.4, armature: 0.2, floating }.scene()
}

/// A simulation of several states with torques in every step, and gradients of a scalar function of its rows.
struct Run {
    scene: Scene,
    settings: Settings,
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
    by: Vec<f64>,
}

impl Run {
    fn new(seed: u64, floating: bool, method: Method) -> Self {
        let (scene, mut random) = (tree(seed, floating), Random::new(seed));
        let states: Vec<_> = (0..STATES).map(|_| random_state(&scene, &mut random)).collect();
        let mut settings = Settings::new(&scene, 1e-2);
        settings.method = method;
        for (numbers, size) in [
            (&mut settings.properties.damping, 0.5),
            (&mut settings.properties.stiffness, 3.0),
            (&mut settings.properties.friction, 0.3),
        ] {
            *numbers = random.array(scene.nv(), size).iter().map(|x| x.abs()).collect();
        }
        settings.properties.friction_speed = 0.5;
        let (tau, by) = (random.array(STATES * STEPS * scene.nv(), 2.0), random.array(STATES * scene.nv(), 1.0));
        let q = states.iter().flat_map(|state| state.0.clone()).collect();
        let qd = states.iter().flat_map(|state| state.1.clone()).collect();
        Self { scene, settings, q, qd, tau, by }
    }

    /// For the last row, with respect to its configuration and its velocities.
    fn gradients(&self, every: usize) -> RolloutGradients {
        let (nq, nv) = (self.scene.nq(), self.scene.nv());
        let (rows, batch) = (STEPS / every + 1, [STATES]);
        let torque = Broadcast::new("tau", &self.tau, STEPS * nv, &batch, &batch).unwrap();
        let torque = Torque::Steps { torque, first: 0 };
        let mut rollout = Rollout::new(&self.scene, self.settings.clone(), &self.q, &self.qd).unwrap();
        let (mut q, mut qd) = (vec![f64::NAN; STATES * rows * nq], vec![f64::NAN; STATES * rows * nv]);
        rollout.advance(STEPS, &torque, Some(&mut Records::new(&mut q, &mut qd).with_every(every))).unwrap();
        let mut by = vec![0.0; qd.len()];
        for (rows, own) in by.chunks_exact_mut(rows * nv).zip(self.by.chunks_exact(nv)) {
            let last = rows.len() - nv;
            rows[last..].copy_from_slice(own);
        }
        let recorded = RecordedRows { q: &q, qd: &qd, every, by_q: &by, by_qd: &by };
        rollout.gradients(&torque, STEPS, &recorded, true).unwrap()
    }
}

fn all(found: &RolloutGradients) -> [&[f64]; 8] {
    let RolloutGradients { q, qd, torque, armature, damping, stiffness, friction, parameters, .. } = found;
    [q, qd, torque, armature, damping, stiffness, friction, parameters.as_flattened()]
}

fn arms() -> impl Iterator<Item = InstructionSet> {
    INSTRUCTION_SETS.iter().map(|&(_, arm)| arm).filter(|arm| arm.available())
}

/// Without optimization the lane kernels need more stack than a thread has by default.
fn on_a_large_stack(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(256 << 20).spawn(work).unwrap().join().unwrap();
}

#[test]
fn every_arm_and_any_checkpoints_give_the_same() {
    on_a_large_stack(|| {
        #[cfg(feature = "parallel")]
        phipsi::batch::set_threads(1).unwrap(); // others have a smaller stack
        for (seed, floating) in [(1, false), (2, true)] {
            for &(name, method) in METHODS {
                let mut run = Run::new(seed, floating, method);
                let mut plain: Option<RolloutGradients> = None;
                for arm in arms() {
                    for form in [Form::Auto, Form::Covariance] {
                        (run.settings.arm, run.settings.form) = (arm, form);
                        let found = run.gradients(1);
                        assert_eq!(found, run.gradients(2), "{name}, {arm:?}");
                        assert_eq!(found, run.gradients(4), "{name}, {arm:?}");
                        let plain = plain.get_or_insert_with(|| found.clone());
                        for (ours, theirs) in all(&found).into_iter().zip(all(plain)) {
                            let bound = tolerance::inverse(1e3, tolerance::size(theirs).max(1.0));
                            tolerance::assert_near(&format!("{name}, {arm:?}"), ours, theirs, bound);
                            assert!(theirs.iter().any(|&x| x != 0.0));
                        }
                    }
                }
            }
        }
    });
}

#[test]
fn rows_of_another_length_are_refused_by_name() {
    let scene = tree(1, false);
    let q = scene.neutral();
    let rollout = Rollout::new(&scene, Settings::new(&scene, 1e-3), &q, &vec![0.0; scene.nv()]).unwrap();
    let (qd, short) = (vec![0.0; scene.nv()], vec![0.0; scene.nv() - 1]);
    let rows = RecordedRows { q: &q, qd: &qd, every: 1, by_q: &qd, by_qd: &qd };
    assert!(rollout.gradients(&Torque::Zero, 0, &rows, false).is_ok());
    let rows = RecordedRows { by_q: &short, ..rows };
    let fault = rollout.gradients(&Torque::Zero, 0, &rows, false).unwrap_err();
    assert!(matches!(&fault.error, Error::Shape { argument, .. } if argument == "by_q"), "{fault:?}");
}

#[test]
fn torques_that_begin_later_are_refused_by_name() {
    let run = Run::new(1, false, Method::RungeKutta4);
    let nv = run.scene.nv();
    let mut rollout = Rollout::new(&run.scene, run.settings.clone(), &run.q, &run.qd).unwrap();
    let torque = Broadcast::new("tau", &run.tau, STEPS * nv, &[STATES], &[STATES]).unwrap();
    let fault = rollout.advance(2, &Torque::Steps { torque, first: 1 }, None).unwrap_err();
    assert!(fault.error.to_string().starts_with("torque.first: found 1; expected at most 0"), "{fault:?}");
}
