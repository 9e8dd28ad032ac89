//! Random chains and trees with the matrices of the paper computed twice, by sweeps and from definitions, and
//! assertions for the tests.

use super::filter;
use super::matrices::{Matrices, Matrix, Vector, block};
use super::tolerance::{self, PRINTED_FORM_MARGIN};
use super::{ALL_KINDS, Random, Tree, random_state};
use nalgebra::Vector6;
use phipsi::Scene;
use phipsi::filter::riccati::Measured;
use phipsi::kinematics::joint_shift;
use phipsi::operators::Factor;
use phipsi::scene::JointKind;
use phipsi::spatial::{RigidShift, Symmetric6, cross_force, cross_motion, spatial};
use std::sync::OnceLock;

/// Results of one Riccati sweep.
pub struct Swept {
    /// phi of each stage to its parent.
    pub shift: Vec<RigidShift<f64>>,
    /// D and g of each row.
    pub measured: Vec<Measured<f64>>,
    /// P^- of each row.
    pub p_minus: Vec<Symmetric6<f64>>,
    /// P^+ of each stage after all its rows are measured.
    pub p_plus: Vec<Symmetric6<f64>>,
}

/// One random scene in one random state.
pub struct Case {
    pub name: String,
    pub scene: Scene,
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    pub tau: Vector,
    pub factor: Factor<f64>,
    /// Computed by the crate.
    pub f: Matrices,
    /// From definitions.
    pub d: Matrices,
    pub sweep: Swept,
    /// diag(armature), the covariance of the measurement noise.
    pub noise: Matrix,
    pub condition: f64,
    /// Next inboard row of each row.
    pub inward: Vec<Option<usize>>,
}

impl Case {
    fn new(name: &str, tree: Tree<'_>) -> Self {
        let scene = tree.scene();
        let (q, qd, tau) = random_state(&scene, &mut Random::new(tree.seed));
        let model = scene.model();
        let factor = scene.factor(&mut scene.workspace(), &q).expect("a regular scene");
        let noise = Matrix::from_diagonal(&Vector::from_column_slice(&model.system.noise));
        let d = Matrices::defined(&scene.composite(&q).expect("a small scene"), &noise);
        let condition = tolerance::conditioning(scene.nv(), d.m.as_slice()).number;
        let stages = &model.system.stages;
        let inward = stages
            .iter()
            .flat_map(|stage| {
                (0..stage.rows.count()).map(move |i| match (i, stage.parent) {
                    (0, parent) => parent.map(|parent| stages[parent].first_row + stages[parent].rows.count() - 1),
                    _ => Some(stage.first_row + i - 1),
                })
            })
            .collect();
        let sweep = riccati_sweep(&scene, &q);
        let f = Matrices::swept(&factor);
        let tau = Vector::from_vec(tau);
        Self {
            name: format!("{name}, seed {}", tree.seed),
            scene,
            q,
            qd,
            tau,
            factor,
            f,
            d,
            sweep,
            noise,
            condition,
            inward,
        }
    }

    pub fn nv(&self) -> usize {
        self.scene.nv()
    }

    /// Identity of the states, 6nv x 6nv.
    pub fn one(&self) -> Matrix {
        Matrix::identity(6 * self.nv(), 6 * self.nv())
    }

    /// Identity of the joints, nv x nv.
    pub fn unit(&self) -> Matrix {
        Matrix::identity(self.nv(), self.nv())
    }

    pub fn has_armature(&self) -> bool {
        self.noise.iter().any(|&r| r > 0.0)
    }

    /// True if rows i and j are on different branches.
    pub fn apart(&self, i: usize, j: usize) -> bool {
        !self.path(i).contains(&j) && !self.path(j).contains(&i)
    }

    /// Row i and all rows inboard of it.
    fn path(&self, i: usize) -> Vec<usize> {
        std::iter::successors(Some(i), |&row| self.inward[row]).collect()
    }

    /// Nearest common ancestor of two rows, if there is one.
    pub fn meet(&self, i: usize, j: usize) -> Option<usize> {
        let other = self.path(j);
        self.path(i).into_iter().find(|row| other.contains(row))
    }

    /// True if some rows are on different branches.
    pub fn branches(&self) -> bool {
        (0..self.nv()).any(|i| (0..self.nv()).any(|j| self.apart(i, j)))
    }

    /// Terms of branches in 5.5, 6.1 and 6.2: t(c,i)* Lambda^-(c) t(c,j) for rows i, j on different branches that
    /// meet at c.
    pub fn across_branches(&self, transition: &Matrix, lambda: &Matrix) -> Matrix {
        let mut sum = Matrix::zeros(6 * self.nv(), 6 * self.nv());
        for i in 0..self.nv() {
            for j in 0..self.nv() {
                if let (true, Some(c)) = (self.apart(i, j), self.meet(i, j)) {
                    let term = block(transition, c, i).transpose() * block(lambda, c, c) * block(transition, c, j);
                    sum.view_mut((6 * i, 6 * j), (6, 6)).copy_from(&term);
                }
            }
        }
        sum
    }

    /// One vector per body, as the stacked vector with this vector at the outermost row of the body.
    pub fn stacked(&self, bodies: &[Vector6<f64>]) -> Vector {
        let mut x = Vector::zeros(6 * self.nv());
        for (stage, value) in self.scene.model().system.stages.iter().zip(bodies) {
            let row = stage.first_row + stage.rows.count() - 1;
            x.rows_mut(6 * row, 6).copy_from(value);
        }
        x
    }

    /// Blocks of a stacked vector at the outermost row of each body.
    pub fn outermost(&self, x: &Vector) -> Vec<Vector6<f64>> {
        let stages = &self.scene.model().system.stages;
        stages.iter().map(|stage| six(x, stage.first_row + stage.rows.count() - 1)).collect()
    }

    /// Blocks of a stacked vector at the innermost row of each body.
    pub fn innermost(&self, x: &Vector) -> Vec<Vector6<f64>> {
        self.scene.model().system.stages.iter().map(|stage| six(x, stage.first_row)).collect()
    }

    /// b, stacked, by composite matrices: M(k) alpha0(k) + v x* (M(k) v).
    pub fn bias(&self) -> Vector {
        let model = self.scene.model();
        let joint = self.d.h.transpose() * Vector::from_column_slice(&self.qd);
        let velocity = self.outermost(&(self.d.phi.transpose() * &joint));
        // phi* of the contribution of each joint: its velocity product, and for the root the acceleration of the
        // base.
        let mut added = Vector::zeros(6 * self.nv());
        let base = spatial(&nalgebra::Vector3::zeros(), &-model.gravity);
        for (k, (stage, body)) in model.system.stages.iter().zip(&model.bodies).enumerate() {
            let rows = stage.first_row..stage.first_row + stage.rows.count();
            let own: Vector6<f64> = rows.clone().map(|row| six(&joint, row)).sum();
            let mut at = added.rows_mut(6 * (rows.end - 1), 6);
            at += cross_motion(&velocity[k], &own);
            if stage.parent.is_none() {
                let mut at = added.rows_mut(6 * stage.first_row, 6);
                at += joint_shift(body, &self.q).to_matrix().transpose() * base;
            }
        }
        let acceleration = self.d.phi.transpose() * added;
        let gyroscopic: Vec<Vector6<f64>> = velocity
            .iter()
            .zip(&model.bodies)
            .map(|(v, body)| cross_force(v, &(body.inertia.to_symmetric().to_matrix() * v)))
            .collect();
        &self.d.q * acceleration + self.stacked(&gyroscopic)
    }

    /// Joint accelerations of forward dynamics in this state.
    pub fn forward_dynamics(&self) -> Vector {
        let mut qdd = vec![f64::NAN; self.nv()];
        let (scene, tau) = (&self.scene, self.tau.as_slice());
        scene.forward_dynamics(&mut scene.workspace(), &self.q, &self.qd, tau, &[], &mut qdd).unwrap();
        Vector::from_vec(qdd)
    }

    /// Asserts that two results agree up to rounding, through an inverse or a factorization of M.
    #[track_caller]
    pub fn holds(&self, what: &str, found: &Matrix, expected: &Matrix) {
        self.holds_among(what, found, expected, &[]);
    }

    /// The same if both sides are sums of larger terms that cancel, whose rounding counts.
    #[track_caller]
    pub fn holds_among(&self, what: &str, found: &Matrix, expected: &Matrix, terms: &[&Matrix]) {
        let size = |m: &Matrix| tolerance::size(m.as_slice());
        let scale = terms.iter().map(|m| size(m)).fold(size(found).max(size(expected)), f64::max);
        self.near(what, found, expected, tolerance::identity(self.condition, scale));
    }

    /// Asserts that two results agree up to the rounding of products and sums, without inverses.
    #[track_caller]
    pub fn holds_directly(&self, what: &str, found: &Matrix, expected: &Matrix) {
        let scale = tolerance::size(expected.as_slice());
        self.near(what, found, expected, tolerance::product(self.nv(), scale));
    }

    #[track_caller]
    fn near(&self, what: &str, found: &Matrix, expected: &Matrix, bound: f64) {
        let what = format!("{what} ({})", self.name);
        assert_eq!(found.shape(), expected.shape(), "{what}: shapes");
        tolerance::assert_near(&what, found.as_slice(), expected.as_slice(), bound);
    }

    /// Asserts that a printed form is wrong by a clear margin.
    #[track_caller]
    pub fn fails(&self, what: &str, printed: &Matrix, expected: &Matrix) {
        let residual = relative(printed, expected);
        assert!(residual > PRINTED_FORM_MARGIN, "{what} ({}): printed form off by {residual:e} only", self.name);
    }
}

/// Largest difference relative to the largest expected entry.
pub fn relative(found: &Matrix, expected: &Matrix) -> f64 {
    assert_eq!(found.shape(), expected.shape());
    tolerance::size((found - expected).as_slice()) / tolerance::size(expected.as_slice())
}

/// A vector as a matrix with one column.
pub fn column(x: &Vector) -> Matrix {
    Matrix::from_column_slice(x.len(), 1, x.as_slice())
}

/// Block `row` of a stacked vector.
pub fn six(x: &Vector, row: usize) -> Vector6<f64> {
    x.fixed_rows::<6>(6 * row).into_owned()
}

/// The Riccati recursion on the inertias of the scene.
fn riccati_sweep(scene: &Scene, q: &[f64]) -> Swept {
    let model = scene.model();
    let shift: Vec<_> = model.bodies.iter().map(|body| joint_shift(body, q)).collect();
    let noise = model.bodies.iter().map(|body| body.inertia.to_symmetric()).collect();
    let (measured, p_minus, p_plus) = filter::riccati(&model.system, &shift, noise);
    Swept { shift, measured, p_minus, p_plus }
}

const ONE_AXIS: [JointKind; 4] =
    [JointKind::Revolute, JointKind::Prismatic, JointKind::Continuous, JointKind::Screw { pitch: 0.2 }];
const SEVERAL_AXES: [JointKind; 3] = [JointKind::Revolute, JointKind::Spherical, JointKind::Planar];
const WITH_FIXED: [JointKind; 3] = [JointKind::Fixed, JointKind::Revolute, JointKind::Prismatic];

/// Chains and trees, with and without armature, with all types of joints; created once.
pub fn cases() -> &'static [Case] {
    static CASES: OnceLock<Vec<Case>> = OnceLock::new();
    CASES.get_or_init(|| {
        let chain = Tree { seed: 11, bodies: 5, kinds: &ONE_AXIS, branching: 0.0, armature: 0.0, floating: false };
        let several = Tree { seed: 4, bodies: 3, kinds: &SEVERAL_AXES, ..chain };
        let armed = Tree { seed: 13, bodies: 4, kinds: &ALL_KINDS, armature: 0.4, ..chain };
        let tree = Tree { seed: 24, bodies: 6, branching: 0.8, ..chain };
        vec![
            Case::new("chain", chain),
            Case::new("chain of joints of several axes", several),
            Case::new("chain with armature", armed),
            Case::new("chain on a floating base", Tree { seed: 24, bodies: 3, floating: true, ..chain }),
            Case::new("tree", tree),
            Case::new("tree of joints of several axes", Tree { seed: 20, bodies: 4, branching: 0.8, ..several }),
            Case::new("tree with armature", Tree { seed: 19, branching: 0.8, ..armed }),
            Case::new("branches from the base", Tree { seed: 13, kinds: &WITH_FIXED, ..tree }),
        ]
    })
}

/// Cases without branches, for which 5.5, 6.1 and 6.2 need no branch terms.
pub fn chains() -> impl Iterator<Item = &'static Case> {
    cases().iter().filter(|case| !case.branches())
}

/// Cases with branches.
pub fn trees() -> impl Iterator<Item = &'static Case> {
    cases().iter().filter(|case| case.branches())
}

/// Cases without noise.
pub fn noise_free() -> impl Iterator<Item = &'static Case> {
    cases().iter().filter(|case| !case.has_armature())
}
