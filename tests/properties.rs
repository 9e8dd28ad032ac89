//! Identities of mechanics on random mixed trees, drawn and shrunk by proptest: fixed and floating bases, branches,
//! joints with several degrees of freedom, armature and velocity together.

use crate::common::oracle::{D, Oracle, d, ds};
use crate::common::tolerance::{self, assert_close, assert_near, assert_near_double, conditioning, size, to_f64};
use crate::common::{ALL_KINDS, Random, Tree, random_state};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};
use phipsi::kinematics::ReferenceFrame;
use phipsi::scene::{Model, ROOT_JOINT};
use phipsi::{Scene, Workspace, dynamics, kinematics};
use proptest::prelude::{ProptestConfig, Strategy, any, proptest};
use proptest::test_runner::RngSeed;

/// Seed of all cases below, so that a failure is reproducible.
const SEED: u64 = 0x00B0_D1E5;

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, rng_seed: RngSeed::Fixed(SEED), failure_persistence: None, ..ProptestConfig::default() }
}

/// A tree with up to `most` joints; shrinks toward few bodies, a chain, no armature, a fixed base.
fn tree(most: usize) -> impl Strategy<Value = Tree<'static>> {
    (any::<u32>(), 1..=most, 0..3_u8, any::<bool>(), any::<bool>()).prop_map(
        |(seed, bodies, branching, geared, floating)| Tree {
            seed: u64::from(seed),
            bodies,
            kinds: &ALL_KINDS,
            branching: f64::from(branching) / 2.0,
            armature: if geared { 0.4 } else { 0.0 },
            floating,
        },
    )
}

/// A scene with a state, wrenches on its bodies, and magnitudes for the bounds.
struct Case {
    scene: Scene,
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
    wrenches: Vec<Vector6<f64>>,
    random: Random,
    n: usize,
}

impl Case {
    fn new(tree: Tree<'_>) -> Self {
        let scene = tree.scene();
        let mut random = Random::new(tree.seed ^ SEED);
        let (q, qd, tau) = random_state(&scene, &mut random);
        let wrenches =
            scene.model().bodies.iter().map(|_| Vector6::from_fn(|_, _| random.uniform(-3.0, 3.0))).collect();
        let n = scene.links().len();
        Self { scene, q, qd, tau, wrenches, random, n }
    }

    fn nv(&self) -> usize {
        self.scene.nv()
    }

    fn mass_matrix(&self) -> DMatrix<f64> {
        let mut m = vec![f64::NAN; self.nv() * self.nv()];
        self.scene.mass_matrix(&mut self.scene.workspace(), &self.q, &mut m).unwrap();
        DMatrix::from_row_slice(self.nv(), self.nv(), &m)
    }

    fn inverse_dynamics(&self, scene: &Scene, qd: &[f64], qdd: &[f64], wrenches: &[Vector6<f64>]) -> Vec<f64> {
        let mut tau = vec![f64::NAN; self.nv()];
        scene.inverse_dynamics(&mut scene.workspace(), &self.q, qd, qdd, wrenches, &mut tau).unwrap();
        tau
    }

    fn forward_dynamics(&self, tau: &[f64], wrenches: &[Vector6<f64>]) -> Vec<f64> {
        let mut qdd = vec![f64::NAN; self.nv()];
        let mut workspace = self.scene.workspace();
        self.scene.forward_dynamics(&mut workspace, &self.q, &self.qd, tau, wrenches, &mut qdd).unwrap();
        qdd
    }

    /// Magnitude of the terms of torques, at the accelerations `qdd`: the bias force of each link and the
    /// wrench on each body, each with its offset, and M qdd.
    fn terms(&self, qdd: &[f64]) -> f64 {
        let (_, bias) = Oracle::new(self.scene.source()).at(&ds(&self.q), &ds(&self.qd)).bias(&[]);
        let placements = self.scene.placements(&self.q).unwrap();
        let levers = placements.iter().map(|placement| 1.0 + 2.0 * placement.lever.norm()).sum::<f64>();
        let wrench = self.wrenches.iter().map(nalgebra::Matrix::amax).fold(0.0, f64::max);
        bias + self.mass_matrix().amax() * qdd.iter().map(|x| x.abs()).sum::<f64>() + wrench * levers
    }
}

/// The same scene in double-double arithmetic, with orthonormal rotations: those of f64 have errors of 1e-16,
/// which would dominate these identities.
struct Double {
    model: Model<D>,
    workspace: Workspace<D>,
}

impl Double {
    fn new(scene: &Scene) -> Self {
        let mut model: Model<D> = scene.model().cast();
        for body in &mut model.bodies {
            // One Newton step squares the error.
            let r = body.tree.rotation;
            body.tree.rotation = r * (Matrix3::identity() * d(3.0) - r.transpose() * r) * d(0.5);
        }
        let workspace = Workspace::new(&model);
        Self { model, workspace }
    }

    /// q after the time `h` (to first order) along `v`.
    fn moved(&self, q: &[D], v: &[D], h: f64) -> Vec<D> {
        let mut rates = vec![d(f64::NAN); q.len()];
        kinematics::coordinate_rates(&self.model, q, v, &mut rates);
        q.iter().zip(&rates).map(|(&q, &rate)| q + rate * d(h)).collect()
    }

    /// Derivative of `f(q, v)` along `v` with acceleration `a`, by a central difference.
    fn rate<const N: usize>(
        &mut self,
        (q, v, a): (&[D], &[D], &[D]),
        f: impl Fn(&Model<D>, &mut Workspace<D>, &[D], &[D]) -> [D; N],
    ) -> [D; N] {
        let mut at = |h: f64| {
            let later: Vec<D> = v.iter().zip(a).map(|(&v, &a)| v + a * d(h)).collect();
            let moved = self.moved(q, v, h);
            f(&self.model, &mut self.workspace, &moved, &later)
        };
        let (ahead, back) = (at(tolerance::STEP), at(-tolerance::STEP));
        std::array::from_fn(|i| (ahead[i] - back[i]) * d(0.5 / tolerance::STEP))
    }

    fn forward_dynamics(&mut self, q: &[D], qd: &[D], tau: &[D], wrenches: &[Vector6<D>]) -> Vec<D> {
        let mut qdd = vec![d(f64::NAN); qd.len()];
        let monitor = dynamics::forward_dynamics(&self.model, &mut self.workspace, q, qd, tau, wrenches, &mut qdd);
        assert!(monitor.clear(0));
        qdd
    }
}

fn inner(a: &[D], b: &[D]) -> D {
    a.iter().zip(b).fold(d(0.0), |sum, (&x, &y)| sum + x * y)
}

fn rounded(values: &[D]) -> Vec<f64> {
    values.iter().map(|&x| to_f64(x)).collect()
}

proptest! {
    #![proptest_config(config(96))]

    #[test]
    fn forward_and_inverse_dynamics_undo_each_other(tree in tree(7)) {
        let mut case = Case::new(tree);
        let m = case.mass_matrix();
        let conditioning = conditioning(case.nv(), m.as_slice());
        let qdd = case.forward_dynamics(&case.tau, &case.wrenches);
        let tau = case.inverse_dynamics(&case.scene, &case.qd, &qdd, &case.wrenches);
        // Backward error of M qdd, and rounding of qdd itself.
        let terms = case.terms(&qdd);
        assert_near("inverse of forward", &tau, &case.tau, tolerance::product(case.n, terms));

        let qdd = case.random.array(case.nv(), 3.0);
        let tau = case.inverse_dynamics(&case.scene, &case.qd, &qdd, &case.wrenches);
        let back = case.forward_dynamics(&tau, &case.wrenches);
        let bound = tolerance::solution(&conditioning, size(&qdd), size(&tau).max(case.terms(&qdd)));
        assert_near("forward of inverse", &back, &qdd, bound);
    }

    #[test]
    fn mass_matrix_is_symmetric_positive_definite_and_has_its_inverse(tree in tree(7)) {
        let case = Case::new(tree);
        let (nv, mut workspace) = (case.nv(), case.scene.workspace());
        let m = case.mass_matrix();
        assert_eq!(m, m.transpose(), "M is symmetric to the last bit");
        let eigenvalues = m.clone().symmetric_eigen().eigenvalues;
        assert!(eigenvalues.min() > 0.0, "{eigenvalues}");
        let conditioning = conditioning(nv, m.as_slice());

        let mut inverse = vec![f64::NAN; nv * nv];
        let mut scratch = case.scene.inverse_scratch();
        case.scene.mass_matrix_inverse(&mut workspace, &mut scratch, &case.q, &mut inverse).unwrap();
        let inverse = DMatrix::from_row_slice(nv, nv, &inverse);
        assert_eq!(inverse, inverse.transpose(), "M^-1 is symmetric to the last bit");
        let identity = DMatrix::<f64>::identity(nv, nv);
        let bound = tolerance::inverse(conditioning.number, 1.0);
        assert_near("M M^-1", (&m * &inverse).as_slice(), identity.as_slice(), bound);

        // The factor: its determinant, its solution, and M applied without being formed.
        dynamics::factorise(case.scene.model(), &mut workspace, &case.q);
        let log_det: f64 = eigenvalues.iter().map(|x| x.ln()).sum();
        let bound = tolerance::inverse(conditioning.number, tolerance::count(nv));
        assert_close("log det M", dynamics::log_det_mass_matrix(&workspace), log_det, bound);
        let mut solution = vec![f64::NAN; nv];
        dynamics::solve(case.scene.model(), &mut workspace, &case.tau, &mut solution);
        let closed = &inverse * DVector::from_column_slice(&case.tau);
        let bound = tolerance::solution(&conditioning, closed.amax(), size(&case.tau) * tolerance::count(nv));
        assert_near("factor against closed form", &solution, closed.as_slice(), bound);
        let mut product = vec![f64::NAN; nv];
        dynamics::mul_mass(case.scene.model(), &mut workspace, &case.qd, &mut product);
        let formed = &m * DVector::from_column_slice(&case.qd);
        assert_near("M applied", &product, formed.as_slice(), tolerance::product(case.n + nv, m.amax() * tolerance::count(nv)));
    }

    #[test]
    fn kinetic_energy_is_half_v_m_v(tree in tree(7)) {
        let case = Case::new(tree);
        let v = DVector::from_column_slice(&case.qd);
        let exact = 0.5 * (v.transpose() * case.mass_matrix() * &v)[(0, 0)];
        let energy = case.scene.energy(&mut case.scene.workspace(), &case.q, &case.qd).unwrap();
        assert!(exact > 0.0);
        let terms = case.mass_matrix().amax() * v.abs().sum().powi(2);
        assert_close("kinetic energy", energy.kinetic, exact, tolerance::product(case.n, terms));
    }

    #[test]
    fn inverse_dynamics_is_affine_in_accelerations_and_gravity(tree in tree(7)) {
        let mut case = Case::new(tree);
        let nv = case.nv();
        let (a, b) = (case.random.array(nv, 3.0), case.random.array(nv, 3.0));
        let zero = vec![0.0; nv];
        let at = |qdd: &[f64]| DVector::from_vec(case.inverse_dynamics(&case.scene, &case.qd, qdd, &case.wrenches));
        let (alpha, beta) = (0.75, -1.5);
        let mixed: Vec<f64> = a.iter().zip(&b).map(|(x, y)| alpha * x + beta * y).collect();
        let expected = at(&a) * alpha + at(&b) * beta + at(&zero) * (1.0 - alpha - beta);
        let bound = tolerance::product(case.n, case.terms(&mixed) + case.terms(&a) + case.terms(&b));
        assert_near("affine in qdd", at(&mixed).as_slice(), expected.as_slice(), bound);

        // Accelerations have an effect through M alone.
        let moved = case.mass_matrix() * DVector::from_column_slice(&a) + at(&zero);
        assert_near("M qdd + bias", at(&a).as_slice(), moved.as_slice(), bound);

        let under = |gravity: [f64; 3]| {
            let scene = case.scene.source().clone().gravity(gravity).build().unwrap();
            DVector::from_vec(case.inverse_dynamics(&scene, &case.qd, &a, &case.wrenches))
        };
        let (g, h): ([f64; 3], [f64; 3]) = ([1.0, -4.0, 8.0], [6.0, 2.5, -3.0]);
        let mixed = std::array::from_fn(|i| alpha * g[i] + beta * h[i]);
        let expected = under(g) * alpha + under(h) * beta + under([0.0; 3]) * (1.0 - alpha - beta);
        assert_near("affine in gravity", under(mixed).as_slice(), expected.as_slice(), bound * 2.0);
    }

    #[test]
    fn velocity_torque_is_quadratic_and_even(tree in tree(7)) {
        let mut case = Case::new(tree);
        let scene = case.scene.source().clone().gravity([0.0; 3]).build().unwrap();
        let nv = case.nv();
        let (zero, other) = (vec![0.0; nv], case.random.array(nv, 1.0));
        let torque = |qd: &[f64]| DVector::from_vec(case.inverse_dynamics(&scene, qd, &zero, &[]));
        let scaled = |factor: f64| -> Vec<f64> { case.qd.iter().map(|x| factor * x).collect() };
        // Powers of two and signs cause no rounding.
        assert_eq!(torque(&scaled(2.0)), torque(&case.qd) * 4.0);
        assert_eq!(torque(&scaled(-1.0)), torque(&case.qd));
        assert_eq!(torque(&zero), DVector::zeros(nv));
        // Parallelogram law: the interaction of two motions changes sign with one of them.
        let plus: Vec<f64> = case.qd.iter().zip(&other).map(|(x, y)| x + y).collect();
        let minus: Vec<f64> = case.qd.iter().zip(&other).map(|(x, y)| x - y).collect();
        let sum = torque(&plus) + torque(&minus);
        let expected = (torque(&case.qd) + torque(&other)) * 2.0;
        assert_near("parallelogram", sum.as_slice(), expected.as_slice(), tolerance::product(case.n, 8.0 * case.terms(&zero)));
    }

    #[test]
    fn wrench_gives_minus_its_jacobian_transposed(tree in tree(7)) {
        let mut case = Case::new(tree);
        let nv = case.nv();
        let link = case.scene.links()[case.random.below(case.n)].name.clone();
        let wrench = Vector6::from_fn(|_, _| case.random.uniform(-5.0, 5.0));
        let on_bodies = case.scene.body_wrenches([(link.as_str(), wrench)]).unwrap();
        let zero = vec![0.0; nv];
        let mut jacobian = vec![f64::NAN; 6 * nv];
        case.scene.jacobian(&case.q, &link, ReferenceFrame::Local, &mut jacobian).unwrap();
        let expected = DMatrix::from_row_slice(6, nv, &jacobian).transpose() * wrench;
        let with = case.inverse_dynamics(&case.scene, &case.qd, &zero, &on_bodies);
        let without = case.inverse_dynamics(&case.scene, &case.qd, &zero, &[]);
        let found: Vec<f64> = without.iter().zip(&with).map(|(a, b)| a - b).collect();
        assert_near("J^T w", &found, expected.as_slice(), tolerance::product(case.n, case.terms(&zero)));
    }

    #[test]
    fn steps_and_differences_undo_each_other(tree in tree(7)) {
        let mut case = Case::new(tree);
        let (nv, scene) = (case.nv(), &case.scene);
        // Rotations of less than half a turn, for which the shortest path is unique.
        let step: Vec<f64> = case.random.array(nv, 1.0);
        let (mut moved, mut back) = (vec![f64::NAN; scene.nq()], vec![f64::NAN; nv]);
        scene.integrate(&case.q, &step, &mut moved).unwrap();
        scene.difference(&case.q, &moved, &mut back).unwrap();
        assert_near("difference of a step", &back, &step, tolerance::product(8, 1.0 + size(&case.q)));
        let mut again = vec![f64::NAN; scene.nq()];
        scene.integrate(&case.q, &back, &mut again).unwrap();
        assert_near("step by a difference", &again, &moved, tolerance::product(8, 1.0 + size(&moved)));
    }

    /// Two half steps of a constant velocity are one whole step, for small and large steps: holds only for the
    /// exponential map.
    #[test]
    fn half_steps_make_whole_steps(tree in tree(7), decade in -6..1_i32) {
        let mut case = Case::new(tree);
        let scene = &case.scene;
        let step = case.random.array(scene.nv(), 3.0 * 10.0_f64.powi(decade));
        let half: Vec<f64> = step.iter().map(|x| 0.5 * x).collect();
        let (mut middle, mut end, mut whole) =
            (vec![f64::NAN; scene.nq()], vec![f64::NAN; scene.nq()], vec![f64::NAN; scene.nq()]);
        scene.integrate(&case.q, &half, &mut middle).unwrap();
        scene.integrate(&middle, &half, &mut end).unwrap();
        scene.integrate(&case.q, &step, &mut whole).unwrap();
        assert_near("two half steps", &end, &whole, tolerance::product(8, 1.0 + size(&whole)));
        // And its initial velocity is that of the coordinates.
        if decade == -6 {
            let model = scene.model();
            let mut rates = vec![f64::NAN; scene.nq()];
            kinematics::coordinate_rates(model, &case.q, &step, &mut rates);
            let first: Vec<f64> = case.q.iter().zip(&rates).map(|(q, rate)| q + rate).collect();
            let second_order = size(&step).powi(2) * 4.0 * (1.0 + size(&case.q));
            assert_near("first order", &whole, &first, second_order);
        }
    }
}

proptest! {
    #![proptest_config(config(32))]

    /// d/dt (kinetic + potential) = qd . tau + the power of the wrenches.
    #[test]
    fn power_balances(tree in tree(5)) {
        let case = Case::new(tree);
        let mut double = Double::new(&case.scene);
        let (q, qd, tau) = (ds(&case.q), ds(&case.qd), ds(&case.tau));
        let wrenches: Vec<Vector6<D>> = case.wrenches.iter().map(|wrench| wrench.map(d)).collect();
        let qdd = double.forward_dynamics(&q, &qd, &tau, &wrenches);
        let [rate] = double.rate((&q, &qd, &qdd), |model, workspace, q, v| {
            let energy = dynamics::energy(model, workspace, q, v);
            [energy.kinetic + energy.potential]
        });
        // The power of a wrench, from its effect on the joint torques.
        let mut with = vec![d(f64::NAN); case.nv()];
        let mut without = with.clone();
        dynamics::bias_torque(&double.model, &mut double.workspace, &q, &qd, &wrenches, &mut with);
        dynamics::bias_torque(&double.model, &mut double.workspace, &q, &qd, &[], &mut without);
        let power = inner(&qd, &tau) + inner(&qd, &without) - inner(&qd, &with);
        let scale = case.terms(&rounded(&qdd)) * case.qd.iter().map(|x| x.abs()).sum::<f64>();
        assert_near_double("power", &[rate], &[power], tolerance::difference(case.n, scale));
        assert!(to_f64(power).abs() > 1e9 * tolerance::difference(case.n, scale), "the power is not trivial");
    }

    /// qd (Mdot - 2C) qd = 0: without gravity the power of the velocity torque is half of that of the change of M.
    #[test]
    fn velocity_torque_is_passive(tree in tree(5)) {
        let case = Case::new(tree);
        let scene = case.scene.source().clone().gravity([0.0; 3]).build().unwrap();
        let mut double = Double::new(&scene);
        let (q, qd) = (ds(&case.q), ds(&case.qd));
        let still = vec![d(0.0); case.nv()];
        // Half qd Mdot qd, with constant velocities.
        let [change] = double.rate((&q, &qd, &still), |model, workspace, q, v| {
            [dynamics::energy(model, workspace, q, v).kinetic]
        });
        let mut torque = vec![d(f64::NAN); case.nv()];
        dynamics::bias_torque(&double.model, &mut double.workspace, &q, &qd, &[], &mut torque);
        let scale = case.terms(&[]) * case.qd.iter().map(|x| x.abs()).sum::<f64>();
        let bound = tolerance::difference(case.n, scale);
        assert_near_double("passivity", &[inner(&qd, &torque)], &[change], bound);
    }

    /// A floating tree with internal torques only: its momentum changes by gravity alone.
    #[test]
    fn internal_torques_leave_momentum_alone(mut tree in tree(5), weightless in any::<bool>()) {
        tree.floating = true;
        let mut case = Case::new(tree);
        let gravity = if weightless { [0.0; 3] } else { [0.3, -0.5, -9.6] };
        let scene = case.scene.source().clone().gravity(gravity).build().unwrap();
        let root = scene.joint(ROOT_JOINT).unwrap().v.clone();
        case.tau[root].fill(0.0);
        let mut double = Double::new(&scene);
        let (q, qd, tau) = (ds(&case.q), ds(&case.qd), ds(&case.tau));
        let qdd = double.forward_dynamics(&q, &qd, &tau, &[]);
        let rate = double.rate((&q, &qd, &qdd), |model, workspace, q, v| {
            let momentum = dynamics::momentum(model, workspace, q, v);
            std::array::from_fn::<D, 6, _>(|i| momentum[i])
        });
        // Gravity force at the center of mass, from the total mass and the gradient of the potential in each
        // direction of gravity.
        let mass: f64 = scene.source().links().iter().filter_map(|link| link.inertial).map(|i| i.mass).sum();
        let moment = first_moment(&scene, &case.q);
        let g = Vector3::from(gravity);
        let (torque, force) = (moment.cross(&g), g * mass);
        let expected = [torque[0], torque[1], torque[2], force[0], force[1], force[2]];
        let scale = case.terms(&rounded(&qdd));
        if weightless {
            let nothing = [d(0.0); 6];
            assert_near_double("momentum", &rate, &nothing, tolerance::difference(case.n, scale));
        } else {
            assert_near("weight", &rounded(&rate), &expected, tolerance::product(case.n, scale));
        }
        // The state has a momentum that could change.
        let momentum = scene.momentum(&mut scene.workspace(), &case.q, &case.qd).unwrap();
        assert!(momentum.amax() > 1e-3);
    }

    /// The first six rows of M qd are the momentum, in the frame of the root body.
    #[test]
    fn root_rows_of_the_mass_matrix_give_momentum(mut tree in tree(5)) {
        tree.floating = true;
        let case = Case::new(tree);
        let of_joints = case.mass_matrix() * DVector::from_column_slice(&case.qd);
        let root = &case.scene.placements(&case.q).unwrap()[0];
        let on_root = Vector6::new(of_joints[3], of_joints[4], of_joints[5], of_joints[0], of_joints[1], of_joints[2]);
        let expected = root.force_to_parent(&on_root);
        let momentum = case.scene.momentum(&mut case.scene.workspace(), &case.q, &case.qd).unwrap();
        let bound = tolerance::product(case.n, case.terms(&case.qd));
        assert_near("momentum from M", momentum.as_slice(), expected.as_slice(), bound);
    }
}

/// Mass times center of mass, in the base frame, from the potential with gravity along each axis.
fn first_moment(scene: &Scene, q: &[f64]) -> Vector3<f64> {
    Vector3::from_fn(|i, _| {
        let mut gravity = [0.0; 3];
        gravity[i] = -1.0;
        let scene = scene.source().clone().gravity(gravity).build().unwrap();
        scene.energy(&mut scene.workspace(), q, &vec![0.0; scene.nv()]).unwrap().potential
    })
}
