//! Estimation (section 2): the sequential solution compared with the batch solution, exact zeros, and valid
//! arguments.

use crate::common::arm::{assembled, link, parts};
use crate::common::{ALL_KINDS, Random, Tree, random_state, tolerance};
use nalgebra::Vector6;
use phipsi::dynamics::{Estimate, EstimateCovariance, EstimateScratch, Measurements, co_state_covariances};
use phipsi::filter::smoothed::remaining;
use phipsi::filter::{HingeMap, covariance};
use phipsi::scene::{JointDescription, JointKind};
use phipsi::spatial::Symmetric6;
use phipsi::{Error, Scene, Workspace};

/// One state of a scene, torques measured with zero, finite and infinite noise, and memory for every result.
struct Case {
    scene: Scene,
    q: Vec<f64>,
    qd: Vec<f64>,
    torque: Vec<f64>,
    noise: Vec<f64>,
    prior: Option<Vec<f64>>,
    s: f64,
    wrenches: Vec<Vector6<f64>>,
}

/// All results of `Scene::estimate`.
struct Room {
    workspace: Workspace<f64>,
    scratch: EstimateScratch<f64>,
    estimate: Estimate<f64>,
    covariance: EstimateCovariance<f64>,
}

impl Room {
    fn new(scene: &Scene) -> Self {
        let model = scene.model();
        Self {
            workspace: scene.workspace(),
            scratch: scene.estimate_scratch(),
            estimate: Estimate::new(model),
            covariance: EstimateCovariance::new(model),
        }
    }
}

impl Case {
    fn new(seed: u64) -> Self {
        let armature = if seed.is_multiple_of(2) { 0.0 } else { 0.3 };
        let tree = Tree { seed, bodies: 6, kinds: &ALL_KINDS, branching: 0.5, armature, floating: seed % 4 == 3 };
        let scene = tree.scene();
        let mut random = Random::new(seed);
        let (q, qd, torque) = random_state(&scene, &mut random);
        let noise = (0..scene.nv()).map(|_| [0.0, 0.5, 20.0, f64::INFINITY][random.below(4)]).collect();
        let prior = (!seed.is_multiple_of(3)).then(|| random.array(scene.nv(), 3.0));
        let s = random.uniform(0.2, 30.0);
        let bodies = if seed.is_multiple_of(2) { 0 } else { scene.model().bodies.len() };
        let wrenches = (0..bodies).map(|_| Vector6::from_fn(|_, _| random.uniform(-3.0, 3.0))).collect();
        Self { scene, q, qd, torque, noise, prior, s, wrenches }
    }

    fn measurements(&self) -> Measurements<'_, f64> {
        Measurements {
            torque: &self.torque,
            noise: &self.noise,
            prior_acceleration: self.prior.as_deref(),
            acceleration_variance: self.s,
        }
    }

    fn estimate(&self, room: &mut Room) -> Result<(), Error> {
        let Room { workspace, scratch, estimate, covariance } = room;
        let measurements = self.measurements();
        self.scene.estimate(
            workspace,
            scratch,
            &self.q,
            &self.qd,
            &measurements,
            &self.wrenches,
            estimate,
            Some(covariance),
        )
    }

    fn solved(&self) -> Room {
        let mut room = Room::new(&self.scene);
        self.estimate(&mut room).expect("a valid call");
        room
    }

    /// (body, row, hinge, whether the inertia of the body is added there) of every row.
    fn rows(&self) -> Vec<(usize, usize, HingeMap<f64>, bool)> {
        let stages = &self.scene.model().system.stages;
        let of_stage = |(k, stage): (usize, &phipsi::filter::Stage<f64>)| {
            let stage = *stage;
            let count = stage.rows.count();
            (0..count).map(move |i| (k, stage.first_row + i, stage.rows.row(i), i + 1 == count))
        };
        stages.iter().enumerate().flat_map(of_stage).collect()
    }
}

#[cfg(feature = "dense")]
#[test]
fn sequential_is_batch() {
    for seed in 0..24 {
        let case = Case::new(seed);
        let (scene, n) = (&case.scene, case.scene.nv());
        let room = case.solved();
        let batch = scene
            .estimate_batch(&mut scene.workspace(), &case.q, &case.qd, &case.measurements(), &case.wrenches, true)
            .unwrap();
        let whole = batch.covariance.as_ref().unwrap();
        let mut m = vec![f64::NAN; n * n];
        scene.mass_matrix(&mut scene.workspace(), &case.q, &mut m).unwrap();
        let conditioning = tolerance::conditioning(n, &m);
        let cond = conditioning.number;
        // Accelerations follow from torques through M^-1, forces from both.
        let torques = tolerance::size(&batch.torque) + tolerance::size(&case.torque) + tolerance::size(&batch.force);
        let of_a = tolerance::inverse(cond, tolerance::size(&batch.acceleration))
            + tolerance::inverse(1.0, conditioning.inverse_norm * torques);
        tolerance::assert_near("a", &room.estimate.acceleration, &batch.acceleration, of_a);
        let of_t = tolerance::inverse(cond, torques);
        tolerance::assert_near("T", &room.estimate.torque, &batch.torque, of_t);
        for (k, row, _, enters) in case.rows() {
            let block = 6 * row..6 * row + 6;
            tolerance::assert_near("X", room.estimate.force[k].as_slice(), &batch.force[block.clone()], of_t);
            let own = if enters { room.estimate.process[k] } else { Vector6::zeros() };
            tolerance::assert_near("W", own.as_slice(), &batch.process[block], of_t);
        }
        let density = batch.log_likelihood;
        tolerance::assert_close(
            "density",
            room.estimate.log_likelihood,
            density,
            tolerance::inverse(cond, 1.0 + density.abs()),
        );

        let found = &room.covariance;
        let prior = case.s * (conditioning.norm + largest_of_r(scene, &case.q));
        for (k, row, _, enters) in case.rows() {
            let of_force = tolerance::inverse(cond, prior);
            tolerance::assert_close("var T", found.torque[row], whole.torque[(row, row)], of_force);
            let of_a = tolerance::inverse(cond, case.s * conditioning.inverse_norm);
            tolerance::assert_close("var a", found.acceleration[row], whole.acceleration[(row, row)], of_a);
            let own = if enters { found.process[k] } else { Symmetric6::zero() };
            for (name, block, all) in [("cov X", found.force[k], &whole.force), ("cov W", own, &whole.process)] {
                for (i, j) in (0..36).map(|at| (at / 6, at % 6)) {
                    let expected = all[(6 * row + i, 6 * row + j)];
                    tolerance::assert_close(name, block.to_matrix()[(i, j)], expected, of_force);
                }
            }
        }
    }
}

/// Largest entry of R.
#[cfg(feature = "dense")]
fn largest_of_r(scene: &Scene, q: &[f64]) -> f64 {
    let r = scene.composite(q).unwrap().matrix(phipsi::operators::Kind::R).unwrap();
    (0..r.nrows()).map(|i| r[(i, i)].abs()).fold(0.0, f64::max)
}

#[test]
fn all_measured_without_noise_is_forward_dynamics_to_the_bit() {
    for seed in 0..8 {
        let mut case = Case::new(seed);
        case.noise.fill(0.0);
        case.prior = None;
        let room = case.solved();
        let mut qdd = vec![f64::NAN; case.scene.nv()];
        // Form of the estimate.
        let mut workspace = case.scene.workspace().in_form(phipsi::filter::Form::Covariance);
        let (q, qd, tau, wrenches) = (&case.q, &case.qd, &case.torque, &case.wrenches);
        phipsi::dynamics::forward_dynamics(case.scene.model(), &mut workspace, q, qd, tau, wrenches, &mut qdd);
        assert_eq!(room.estimate.acceleration, qdd);
        assert!(room.covariance.acceleration.iter().chain(&room.covariance.torque).all(|&x| x == 0.0));
        assert!(room.covariance.force.iter().any(|block| block.to_matrix().amax() > 0.0));
    }
}

/// H P = 0, the remark after 2.6; not with noise.
#[test]
fn forces_are_known_exactly_along_exact_measurements() {
    let (mut zero, mut other) = (0, 0);
    for seed in (0..16).step_by(2) {
        let case = Case::new(seed);
        let room = case.solved();
        for (k, row, hinge, _) in case.rows() {
            let along = hinge.covariance_column(&room.covariance.force[k]);
            if case.noise[row] > 0.0 {
                assert!(along.amax() > 0.0, "row {row}");
                other += 1;
            } else if matches!(hinge, HingeMap::Axis(_)) {
                assert_eq!(along, Vector6::zeros(), "row {row}");
                assert_eq!(room.covariance.torque[row].to_bits(), 0, "row {row}");
                zero += 1;
            }
        }
    }
    assert!(zero > 10 && other > 10);
}

/// P^- - P^- Lambda^- P^- = P^+ - P^+ Lambda^+ P^+: the effect of a measurement is the same on both sides.
#[test]
fn the_smoothed_block_is_the_same_on_both_sides_of_a_measurement() {
    for seed in 0..8 {
        let case = Case::new(seed);
        let (scene, mut workspace) = (&case.scene, case.scene.workspace());
        let n = scene.nv();
        let mut lambdas = vec![Symmetric6::filled(f64::NAN); scene.model().bodies.len()];
        let (factor, _) = phipsi::operators::Factor::new(scene.model(), &mut workspace, &case.q);
        let mut p_minus = vec![Symmetric6::filled(f64::NAN); n];
        let mut p_plus = p_minus.clone();
        let shift: Vec<_> =
            scene.model().bodies.iter().map(|body| phipsi::kinematics::joint_shift(body, &case.q)).collect();
        let mut measured = vec![phipsi::filter::riccati::Measured::filled(f64::NAN); n];
        let system = &scene.model().system;
        let mut p: Vec<_> = scene.model().bodies.iter().map(|body| body.inertia.to_symmetric()).collect();
        for (k, stage) in system.stages.iter().enumerate().rev() {
            for i in (0..stage.rows.count()).rev() {
                let row = stage.first_row + i;
                p_minus[row] = p[k];
                measured[row] =
                    phipsi::filter::riccati::measurement_update(&mut p[k], &stage.rows.row(i), system.noise[row]);
                p_plus[row] = p[k];
            }
            if let Some(parent) = stage.parent {
                p[parent] = p[parent].add(&shift[k].inertia_to_parent(&p[k]));
            }
        }
        let pivots: Vec<f64> = factor.pivots().collect();
        let largest = tolerance::size(&pivots);
        let mut seen = 0;
        co_state_covariances(system, (&shift, &measured), &mut lambdas, |(_, row), plus, _| {
            let (_, _, hinge, _) = case.rows()[row];
            let (minus, _) = covariance::row_update(plus, &hinge, &measured[row]);
            let outside = remaining(&p_minus[row], &minus).to_matrix();
            let inside = remaining(&p_plus[row], plus).to_matrix();
            let size = p_minus[row].to_matrix().amax();
            let bound = tolerance::inverse(1.0 + largest / pivots[row] + minus.to_matrix().amax() * size, size);
            tolerance::assert_near("both sides", outside.as_slice(), inside.as_slice(), bound);
            seen += 1;
        });
        assert_eq!(seen, n);
    }
}

#[test]
fn estimation_allocates_nothing() {
    for seed in 0..4 {
        let case = Case::new(seed);
        let mut room = Room::new(&case.scene);
        let seen = allocation_counter::measure(|| case.estimate(&mut room).unwrap());
        assert_eq!(seen.count_total, 0, "{seen:?}");
    }
}

/// After a state with other noise and torques, bitwise equal to results with memory filled with NaN.
#[test]
fn estimation_uses_nothing_stale() {
    for seed in 0..4 {
        let mut case = Case::new(seed);
        let fresh = case.solved();
        let mut room = Room::new(&case.scene);
        let (noise, torque) = (case.noise.clone(), case.torque.clone());
        case.noise = noise.iter().map(|&x| if x == 0.0 { f64::INFINITY } else { 0.0 }).collect();
        case.torque.fill(1e6);
        case.estimate(&mut room).unwrap();
        assert_ne!(room.estimate, fresh.estimate);
        (case.noise, case.torque) = (noise, torque);
        // Values that are not measured are ignored.
        for (torque, noise) in case.torque.iter_mut().zip(&case.noise) {
            *torque = if noise.is_finite() { *torque } else { f64::NAN };
        }
        case.estimate(&mut room).unwrap();
        assert_eq!(room.estimate, fresh.estimate);
        assert_eq!(room.covariance, fresh.covariance);
    }
}

/// A singular pivot inboard of joints that are not measured: those have no measurement update, and the error names
/// the singular joint.
#[test]
fn a_lost_pivot_beside_unmeasured_joints_is_named() {
    let (mut links, mut joints) = parts();
    links.extend([link("ring", None), link("stone", None)]);
    joints.push(JointDescription::new("spin", JointKind::Revolute, "base", "ring"));
    joints.push(JointDescription::new("ball", JointKind::Spherical, "ring", "stone"));
    let scene = assembled((links, joints)).build().unwrap();
    let n = scene.nv();
    let mut case = Case {
        q: scene.neutral(),
        qd: vec![0.0; n],
        torque: vec![0.0; n],
        noise: vec![0.0; n],
        prior: None,
        s: 1.0,
        wrenches: Vec::new(),
        scene,
    };
    case.noise[case.scene.joint("ball").unwrap().v.clone()].fill(f64::INFINITY);
    let error = case.estimate(&mut Room::new(&case.scene)).expect_err("spin has no inertia");
    assert!(matches!(&error, Error::SingularJoint { joint, .. } if joint == "spin"), "{error}");
    // If it is not measured it has no effect, but its acceleration has no variance.
    case.noise[case.scene.joint("spin").unwrap().v.start] = f64::INFINITY;
    let mut room = Room::new(&case.scene);
    let error = case.estimate(&mut room).expect_err("M is singular");
    assert!(matches!(&error, Error::SingularJoint { .. }), "{error}");
    assert!(room.estimate.acceleration.iter().all(|a| a.is_finite()));
}

/// One valid call, then one broken argument each.
#[test]
fn broken_arguments_are_named() {
    type Breakage = (&'static str, fn(&mut Case), &'static str);
    let breakages: [Breakage; 10] = [
        ("q", |case| case.q.push(0.0), "q: found shape"),
        ("qd", |case| case.qd[1] = f64::NAN, "qd: found NaN at index 1"),
        ("torque length", |case| case.torque.truncate(2), "torque: found shape (2,)"),
        ("torque", |case| case.torque[2] = f64::INFINITY, "torque: found inf at index 2"),
        ("noise length", |case| case.noise.clear(), "noise: found shape (0,)"),
        ("noise", |case| case.noise[1] = -0.5, "noise: found -0.5 for joint \"joint1\""),
        ("noise NaN", |case| case.noise[1] = f64::NAN, "noise: found NaN for joint \"joint1\""),
        ("variance", |case| case.s = 0.0, "acceleration_variance: found 0"),
        ("prior", |case| case.prior = Some(vec![0.0]), "prior_acceleration: found shape (1,)"),
        ("wrenches", |case| case.wrenches.truncate(1), "wrenches: found shape (1,)"),
    ];
    let make = || {
        let kinds = [JointKind::Revolute];
        let tree = Tree { seed: 1, bodies: 4, kinds: &kinds, branching: 0.0, armature: 0.1, floating: false };
        let scene = tree.scene();
        let (q, qd, torque) = random_state(&scene, &mut Random::new(1));
        let wrenches = vec![Vector6::zeros(); 4];
        Case { scene, q, qd, torque, noise: vec![0.5; 4], prior: Some(vec![0.1; 4]), s: 2.0, wrenches }
    };
    make().solved();
    for (name, breakage, message) in breakages {
        let mut case = make();
        breakage(&mut case);
        let error = case.estimate(&mut Room::new(&case.scene)).expect_err(name).to_string();
        assert!(error.contains(message), "{name}: {error}");
        #[cfg(feature = "dense")]
        {
            let mut workspace = case.scene.workspace();
            let measurements = case.measurements();
            let batch =
                case.scene.estimate_batch(&mut workspace, &case.q, &case.qd, &measurements, &case.wrenches, false);
            assert!(batch.expect_err(name).to_string().contains(message), "{name}");
        }
    }
    let case = make();
    let other = phipsi::scenes::chain(3).unwrap();
    let mut room = Room::new(&case.scene);
    room.estimate = Estimate::new(other.model());
    assert!(
        case.estimate(&mut room)
            .expect_err("too small")
            .to_string()
            .contains("estimate.acceleration: found shape (3,)")
    );
}
