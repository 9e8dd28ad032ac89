//! The paper's matrices twice over, by sweeps and from definitions, on random chains and trees; and what its tests assert.
//!
//! `case.f` holds what the product computes, an operator applied to the columns of the identity; `case.d` holds the same from
//! E, H, Q and the Riccati recursion on full matrices. Rows run from base to tip, so that what the paper prints lower
//! triangular is upper triangular here.

use super::tolerance::{self, PRINTED_FORM_MARGIN};
use super::{ALL_KINDS, Random, Tree, random_state};
use nalgebra::{DMatrix, DVector, Vector6};
use phipsi::Scene;
use phipsi::filter::pivots::Scale;
use phipsi::filter::riccati::{self, Covariances, Measured};
use phipsi::kinematics::joint_shift;
use phipsi::operators::dense::Composite;
use phipsi::operators::{Factor, Kind, Operator};
use phipsi::scene::JointKind;
use phipsi::spatial::{RigidShift, Symmetric6, cross_force, cross_motion, spatial};
use std::sync::OnceLock;

pub type Matrix = DMatrix<f64>;
pub type Vector = DVector<f64>;

/// The composite matrices of one scene at one configuration, by the names they have in Python.
pub struct Matrices {
    pub e: Matrix,
    pub phi: Matrix,
    pub phi_strict: Matrix,
    pub psi: Matrix,
    pub a: Matrix,
    pub psi_a: Matrix,
    pub a_psi: Matrix,
    pub h: Matrix,
    pub q: Matrix,
    pub r: Matrix,
    pub p: Matrix,
    pub p_plus: Matrix,
    pub d: Matrix,
    pub d_inv: Matrix,
    pub g: Matrix,
    pub batch_gain: Matrix,
    pub lambda: Matrix,
    pub lambda_plus: Matrix,
    pub s: Matrix,
    pub k: Matrix,
    pub l: Matrix,
    pub m: Matrix,
    pub m_inv: Matrix,
}

/// An operator as a matrix: its sweep, applied to the columns of the identity.
pub fn swept(operator: &impl Operator<f64>) -> Matrix {
    let columns = operator.shape().1;
    apply(operator, &Matrix::identity(columns, columns))
}

/// An operator's sweep on each column.
pub fn apply(operator: &impl Operator<f64>, x: &Matrix) -> Matrix {
    let mut y = Matrix::from_element(operator.shape().0, x.ncols(), f64::NAN);
    for (x, mut y) in x.column_iter().zip(y.column_iter_mut()) {
        operator.apply(x.as_slice(), y.as_mut_slice());
    }
    y
}

/// The inverse by LU.
pub fn inverse(m: &Matrix) -> Matrix {
    m.clone().try_inverse().expect("a matrix with an inverse")
}

/// The 6x6 blocks on the diagonal alone.
pub fn block_diagonal(m: &Matrix) -> Matrix {
    Matrix::from_fn(m.nrows(), m.ncols(), |i, j| if i / 6 == j / 6 { m[(i, j)] } else { 0.0 })
}

/// Block (i, j).
pub fn block(m: &Matrix, i: usize, j: usize) -> Matrix {
    m.view((6 * i, 6 * j), (6, 6)).into_owned()
}

impl Matrices {
    fn swept(factor: &Factor<f64>) -> Self {
        let of = |kind| swept(&factor.operator(kind));
        Self {
            e: of(Kind::Shifts),
            phi: of(Kind::Phi),
            phi_strict: of(Kind::PhiStrict),
            psi: of(Kind::Psi),
            a: of(Kind::ClosedLoop),
            psi_a: of(Kind::PsiA),
            a_psi: of(Kind::APsi),
            h: of(Kind::H),
            q: of(Kind::Q),
            r: of(Kind::R),
            p: of(Kind::P),
            p_plus: of(Kind::PFiltered),
            d: of(Kind::D),
            d_inv: Matrix::from_diagonal(&Vector::from_iterator(factor.nv(), factor.pivots().map(f64::recip))),
            g: of(Kind::Gain),
            batch_gain: of(Kind::BatchGain),
            lambda: of(Kind::Lambda),
            lambda_plus: of(Kind::LambdaPlus),
            s: of(Kind::S),
            k: of(Kind::K),
            l: of(Kind::L),
            m: of(Kind::Mass),
            m_inv: of(Kind::MassInverse),
        }
    }

    /// From E, H, Q, r and the Riccati recursion on full matrices; everything else by products and LU.
    fn defined(composite: &Composite, noise: &Matrix) -> Self {
        let nv = composite.d.len();
        let copy = |m: &faer::Mat<f64>| Matrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)]);
        let (one, unit) = (Matrix::identity(6 * nv, 6 * nv), Matrix::identity(nv, nv));
        let (e, h, q, g) = (copy(&composite.shifts), copy(&composite.h), copy(&composite.q), copy(&composite.gain));
        let (p, p_plus) = (copy(&composite.p), copy(&composite.p_plus));
        let d = Matrix::from_diagonal(&Vector::from_column_slice(&composite.d));
        let d_inv = Matrix::from_diagonal(&d.diagonal().map(f64::recip));
        let phi = inverse(&(&one - &e));
        let phi_strict = &phi - &one;
        let a = &one - &g * &h;
        let psi = inverse(&(&one - &e * &a)) * &e;
        let r = &phi * &q * phi.transpose();
        let m = &h * &r * h.transpose() + noise;
        let m_inv = inverse(&m);
        let (h_phi, h_phi_strict) = (&h * &phi, &h * &phi_strict);
        let k = &h_phi_strict * &g;
        let l = &unit - inverse(&(&unit + &k));
        let co_state_plus = h_phi_strict.transpose() * &m_inv * &h_phi_strict;
        let psi_p = &psi * &p;
        Self {
            psi_a: &psi * &a,
            a_psi: &a * &psi,
            batch_gain: &r * h.transpose() * &m_inv,
            lambda: block_diagonal(&(h_phi.transpose() * &m_inv * &h_phi)),
            lambda_plus: block_diagonal(&co_state_plus),
            s: &p - &psi_p - psi_p.transpose() + &p * co_state_plus * &p,
            e,
            phi,
            phi_strict,
            psi,
            a,
            h,
            q,
            r,
            p,
            p_plus,
            d,
            d_inv,
            g,
            k,
            l,
            m,
            m_inv,
        }
    }
}

/// What one Riccati sweep leaves.
pub struct Swept {
    /// phi of each stage to its parent.
    pub shift: Vec<RigidShift<f64>>,
    /// D and g of each row.
    pub measured: Vec<Measured<f64>>,
    /// P^- of each row.
    pub p_minus: Vec<Symmetric6<f64>>,
    /// P^+ of each stage, all its rows measured.
    pub p_plus: Vec<Symmetric6<f64>>,
}

/// One random scene at one random state.
pub struct Case {
    pub name: String,
    pub scene: Scene,
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    pub tau: Vector,
    pub factor: Factor<f64>,
    /// As the product computes it.
    pub f: Matrices,
    /// From definitions.
    pub d: Matrices,
    pub sweep: Swept,
    /// diag(armature), the covariance of the measurements' noise.
    pub noise: Matrix,
    pub condition: f64,
    /// The next row inward of each row.
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

    /// The identity of the states, 6nv x 6nv.
    pub fn one(&self) -> Matrix {
        Matrix::identity(6 * self.nv(), 6 * self.nv())
    }

    /// The identity of the joints, nv x nv.
    pub fn unit(&self) -> Matrix {
        Matrix::identity(self.nv(), self.nv())
    }

    pub fn has_armature(&self) -> bool {
        self.noise.iter().any(|&r| r > 0.0)
    }

    /// Rows i and j lie on different branches.
    pub fn apart(&self, i: usize, j: usize) -> bool {
        !self.path(i).contains(&j) && !self.path(j).contains(&i)
    }

    /// Row i and everything inward of it.
    fn path(&self, i: usize) -> Vec<usize> {
        std::iter::successors(Some(i), |&row| self.inward[row]).collect()
    }

    /// The nearest common ancestor of two rows, where they have one.
    pub fn meet(&self, i: usize, j: usize) -> Option<usize> {
        let other = self.path(j);
        self.path(i).into_iter().find(|row| other.contains(row))
    }

    /// Whether some rows lie on different branches.
    pub fn branches(&self) -> bool {
        (0..self.nv()).any(|i| (0..self.nv()).any(|j| self.apart(i, j)))
    }

    /// What branches add to 5.5, 6.1 and 6.2: t(c,i)* Lambda^-(c) t(c,j) for rows i, j on different branches that meet at c.
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

    /// One vector a body, as the stacked vector that has it at the body's outermost row.
    pub fn stacked(&self, bodies: &[Vector6<f64>]) -> Vector {
        let mut x = Vector::zeros(6 * self.nv());
        for (stage, value) in self.scene.model().system.stages.iter().zip(bodies) {
            let row = stage.first_row + stage.rows.count() - 1;
            x.rows_mut(6 * row, 6).copy_from(value);
        }
        x
    }

    /// The blocks of a stacked vector at the outermost row of each body.
    pub fn outermost(&self, x: &Vector) -> Vec<Vector6<f64>> {
        let stages = &self.scene.model().system.stages;
        stages.iter().map(|stage| six(x, stage.first_row + stage.rows.count() - 1)).collect()
    }

    /// The blocks of a stacked vector at the innermost row of each body.
    pub fn innermost(&self, x: &Vector) -> Vec<Vector6<f64>> {
        self.scene.model().system.stages.iter().map(|stage| six(x, stage.first_row)).collect()
    }

    /// b, stacked, by composite matrices: M(k) alpha0(k) + v x* (M(k) v).
    pub fn bias(&self) -> Vector {
        let model = self.scene.model();
        let joint = self.d.h.transpose() * Vector::from_column_slice(&self.qd);
        let velocity = self.outermost(&(self.d.phi.transpose() * &joint));
        // phi* of what each joint adds: its velocity product, and at the root the base's acceleration.
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

    /// The joint accelerations of forward dynamics at this state.
    pub fn forward_dynamics(&self) -> Vector {
        let mut qdd = vec![f64::NAN; self.nv()];
        let (scene, tau) = (&self.scene, self.tau.as_slice());
        scene.forward_dynamics(&mut scene.workspace(), &self.q, &self.qd, tau, &[], &mut qdd).unwrap();
        Vector::from_vec(qdd)
    }

    /// Asserts that two routes agree to rounding, through an inverse or a factorisation of M.
    #[track_caller]
    pub fn holds(&self, what: &str, found: &Matrix, expected: &Matrix) {
        self.holds_among(what, found, expected, &[]);
    }

    /// The same where the sides are sums of larger terms that cancel: rounding is theirs.
    #[track_caller]
    pub fn holds_among(&self, what: &str, found: &Matrix, expected: &Matrix, terms: &[&Matrix]) {
        let size = |m: &Matrix| tolerance::size(m.as_slice());
        let scale = terms.iter().map(|m| size(m)).fold(size(found).max(size(expected)), f64::max);
        self.near(what, found, expected, tolerance::inverse(self.condition, scale));
    }

    /// Asserts that two routes agree to the rounding of products and sums: nothing is inverted on either side.
    #[track_caller]
    pub fn holds_directly(&self, what: &str, found: &Matrix, expected: &Matrix) {
        let scale = tolerance::size(expected.as_slice());
        self.near(what, found, expected, tolerance::product(6 * self.nv(), scale));
    }

    #[track_caller]
    fn near(&self, what: &str, found: &Matrix, expected: &Matrix, bound: f64) {
        let what = format!("{what} ({})", self.name);
        assert_eq!(found.shape(), expected.shape(), "{what}: shapes");
        tolerance::assert_near(&what, found.as_slice(), expected.as_slice(), bound);
    }

    /// Asserts that a printed form does not hold, by a clear margin.
    #[track_caller]
    pub fn fails(&self, what: &str, printed: &Matrix, expected: &Matrix) {
        let residual = relative(printed, expected);
        assert!(residual > PRINTED_FORM_MARGIN, "{what} ({}): printed form off by {residual:e} only", self.name);
    }
}

/// Largest difference over the largest entry of what is expected.
pub fn relative(found: &Matrix, expected: &Matrix) -> f64 {
    assert_eq!(found.shape(), expected.shape());
    tolerance::size((found - expected).as_slice()) / tolerance::size(expected.as_slice())
}

/// A vector as a matrix of one column.
pub fn column(x: &Vector) -> Matrix {
    Matrix::from_column_slice(x.len(), 1, x.as_slice())
}

/// Block `row` of a stacked vector.
pub fn six(x: &Vector, row: usize) -> Vector6<f64> {
    x.fixed_rows::<6>(6 * row).into_owned()
}

/// `filter::riccati::sweep` on the scene's inertias.
fn riccati_sweep(scene: &Scene, q: &[f64]) -> Swept {
    let model = scene.model();
    let shift: Vec<_> = model.bodies.iter().map(|body| joint_shift(body, q)).collect();
    let mut p: Vec<_> = model.bodies.iter().map(|body| body.inertia.to_symmetric()).collect();
    let mut scale: Vec<_> = model.bodies.iter().map(|body| Scale::of_noise(&body.inertia_terms)).collect();
    let mut measured = vec![Measured::filled(f64::NAN); scene.nv()];
    let mut p_minus = vec![Symmetric6::filled(f64::NAN); scene.nv()];
    let mut covariances = Covariances { shift: &shift, p: &mut p, scale: &mut scale, measured: &mut measured };
    riccati::sweep(&model.system, &mut covariances, |row, p| p_minus[row] = *p);
    Swept { shift, measured, p_minus, p_plus: p }
}

const ONE_AXIS: [JointKind; 4] =
    [JointKind::Revolute, JointKind::Prismatic, JointKind::Continuous, JointKind::Screw { pitch: 0.2 }];
const SEVERAL_AXES: [JointKind; 3] = [JointKind::Revolute, JointKind::Spherical, JointKind::Planar];
const WITH_FIXED: [JointKind; 3] = [JointKind::Fixed, JointKind::Revolute, JointKind::Prismatic];

/// Chains and trees, with and without armature, of all joint kinds; made once.
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

/// Those without branches, where 5.5, 6.1 and 6.2 need no term across branches.
pub fn chains() -> impl Iterator<Item = &'static Case> {
    cases().iter().filter(|case| !case.branches())
}

/// Those with branches.
pub fn trees() -> impl Iterator<Item = &'static Case> {
    cases().iter().filter(|case| case.branches())
}

/// The noise-free ones.
pub fn noise_free() -> impl Iterator<Item = &'static Case> {
    cases().iter().filter(|case| !case.has_armature())
}
