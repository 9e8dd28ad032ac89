//! Every algorithm for a scene with mimic joints, q = G q' + o, from the algorithms of the tree and G.
//!
//! Inverse dynamics, M and their derivatives are those of the tree at (q, G qd', G qdd'), multiplied by G and G^T.
//! Accelerations and M^-1 are not: their measurements are sums of measurements of the tree, which the filter of
//! [`summed`](crate::filter::summed) computes.

mod accelerations;

pub(crate) use accelerations::{CoupledAccelerations, CoupledSolver};

use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments, Derivatives, Products};
use crate::error::{Error, Fault, check_length};
use crate::filter::Form;
use crate::scalar::Real;
use crate::scene::{Coupling, Scene};

/// Scratch for one thread.
#[derive(Debug, Clone)]
pub(crate) struct CoupledScratch {
    accelerations: CoupledAccelerations,
    results: Vec<f64>,
}

impl CoupledScratch {
    pub fn new(coupling: &Coupling) -> Self {
        let model = coupling.tree().model();
        Self { accelerations: CoupledAccelerations::new(model, coupling.sums()), results: Vec::new() }
    }
}

/// Runs an algorithm of the tree on some states.
pub(crate) type Ask<'a> = dyn FnMut(Algorithm, &[Arguments<'_>], &mut [f64]) -> Result<(), Fault> + 'a;

/// One state during evaluation.
struct Call<'a, 'b> {
    coupling: &'a Coupling,
    scratch: &'a mut CoupledScratch,
    ask: &'a mut Ask<'b>,
}

/// q, qd and u of the tree.
type Expanded = [Vec<f64>; 3];

impl Scene {
    /// Runs one algorithm on some states of a scene with mimic joints. Writes the results one after another. `ask` runs
    /// an algorithm of the tree; `found` is called with the index of each state and its accuracy.
    pub(crate) fn evaluate_coupled(
        &self,
        coupling: &Coupling,
        (scratch, ask): (&mut CoupledScratch, &mut Ask<'_>),
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
        found: &mut dyn FnMut(usize, Accuracy),
    ) -> Result<(), Fault> {
        let width = self.width(algorithm);
        let at = |state: usize| move |error: Error| Fault { state, error };
        check_length("out", out.len(), width * states.len()).map_err(at(0))?;
        let mut expanded: Vec<Expanded> = Vec::with_capacity(states.len());
        for (i, state) in states.iter().enumerate() {
            let state = state.read_by(algorithm);
            self.check_coupled(algorithm, &state).map_err(at(i))?;
            let rates = |x: &[f64]| if x.is_empty() { Vec::new() } else { coupling.rates(x) };
            let u = if algorithm.form().is_some() { Vec::new() } else { rates(state.u) };
            expanded.push([coupling.configuration(state.q), rates(state.qd), u]);
        }
        let mut call = Call { coupling, scratch, ask };
        if call.of_tree(algorithm, states, &expanded, out)? {
            for (i, out) in out.chunks_exact(width.max(1)).enumerate() {
                self.check_result("result", out).map_err(at(i))?;
            }
            return Ok(());
        }
        for (i, (state, of_tree)) in states.iter().zip(&expanded).enumerate() {
            let out = &mut out[i * width..(i + 1) * width];
            call.run(algorithm, &state.read_by(algorithm), of_tree, out).map_err(at(i))?;
            self.check_result("result", out).map_err(at(i))?;
            let doubled = call.scratch.accelerations.is_wide;
            found(i, Accuracy { doubled, ..Accuracy::unknown(algorithm.form().unwrap_or(Form::Covariance)) });
        }
        Ok(())
    }

    /// Checks the arguments of one state that the algorithm takes.
    fn check_coupled(&self, algorithm: Algorithm, state: &Arguments<'_>) -> Result<(), Error> {
        if let Algorithm::Products(which) = algorithm
            && (which.takes_constants() || which.gives_constants())
        {
            let expected = "products with (q, qd, u) alone, or a scene with mimic=\"free\" for those with parameters, armature, gravity and wrenches";
            return Err(Error::argument("scene", "joints that follow others (mimic)", expected));
        }
        let (reads_rates, third) = algorithm.reads();
        self.check_coordinates("q", state.q)?;
        if reads_rates {
            self.check_rates("qd", state.qd)?;
        }
        if let Some(name) = third {
            self.check_rates(name, state.u)?;
            self.tree().check_wrenches(state.wrenches)?;
        }
        if matches!(algorithm, Algorithm::ConstrainedDynamics(_)) {
            return self.check_compliance(state.seed[0]);
        }
        for (&(name, _), seed) in algorithm.seeds().iter().zip(state.seed) {
            self.check_rates(name, seed)?;
        }
        Ok(())
    }

    /// A (2nv x 2nv) and B (2nv x nv) of the linearized dynamics, from dqdd/dq, dqdd/dqd and M^-1 of forward dynamics
    /// at velocities `qd`.
    pub(crate) fn linear_system(&self, qd: &[f64], three: &[f64], (a, b): (&mut [f64], &mut [f64])) {
        use super::derivatives::linear_system;
        let Some(coupling) = self.coupling() else { return linear_system(self.model(), qd, three, (a, b)) };
        // ad(qd) of the tree: zero except for free and spherical joints, which are independent.
        let (full, nv) = (coupling.tree().nv(), self.nv());
        let (mut all, mut rest) = (vec![0.0; 4 * full * full], vec![0.0; 2 * full * full]);
        linear_system(coupling.tree().model(), &coupling.rates(qd), &vec![0.0; 3 * full * full], (&mut all, &mut rest));
        a.fill(0.0);
        b.fill(0.0);
        let rows = coupling.independent_rows();
        for i in 0..nv {
            for j in 0..nv {
                a[i * 2 * nv + j] = all[rows[i] * 2 * full + rows[j]];
                a[(nv + i) * 2 * nv + j] = three[i * nv + j];
                a[(nv + i) * 2 * nv + nv + j] = three[nv * nv + i * nv + j];
                b[(nv + i) * nv + j] = three[2 * nv * nv + i * nv + j];
            }
            a[i * 2 * nv + nv + i] = 1.0;
        }
    }
}

impl Call<'_, '_> {
    /// Algorithms that are those of the tree, multiplied by G: all states at once. Returns false for others.
    fn of_tree(
        &mut self,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        expanded: &[Expanded],
        out: &mut [f64],
    ) -> Result<bool, Fault> {
        let coupling = self.coupling;
        let (full, (_, nv)) = (coupling.tree().nv(), coupling.sizes());
        let entry = algorithm.entry();
        if entry.has_form || matches!(algorithm, Algorithm::Products(_)) {
            return Ok(false);
        }
        // A vector, or this number of matrices.
        let matrices = if entry.results[0].1.len() == 1 { 0 } else { entry.results.len() };
        let asked: Vec<Arguments<'_>> = states
            .iter()
            .zip(expanded)
            .map(|(state, [q, qd, u])| {
                Arguments { q, qd, u, wrenches: state.wrenches, ..Arguments::default() }.read_by(algorithm)
            })
            .collect();
        let (piece, of_tree) = if matrices == 0 { (nv, full) } else { (nv * nv, full * full) };
        let mut results = std::mem::take(&mut self.scratch.results);
        results.resize(states.len() * matrices.max(1) * of_tree, 0.0);
        let done = (self.ask)(algorithm, &asked, &mut results);
        if done.is_ok() {
            for (from, to) in results.chunks_exact(of_tree.max(1)).zip(out.chunks_exact_mut(piece.max(1))) {
                if matrices == 0 { coupling.reduce(from, to) } else { coupling.reduce_matrix(from, to) }
            }
        }
        self.scratch.results = results;
        done.map(|()| true)
    }

    /// Algorithms with the factor of G^T M G.
    fn run(
        &mut self,
        algorithm: Algorithm,
        state: &Arguments<'_>,
        [q, qd, u]: &Expanded,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let coupling = self.coupling;
        let at = Arguments { q, qd, u, wrenches: state.wrenches, ..Arguments::default() };
        match algorithm {
            Algorithm::ForwardDynamics(form) => {
                let qdd = self.accelerations(form, &at, state.u)?;
                out.copy_from_slice(&coupling.independent_rates(&qdd));
            }
            Algorithm::MassMatrixInverse(form) => {
                self.factorise(form, &at, false)?;
                self.inverse(out);
            }
            Algorithm::Derivatives(which) => {
                let form = algorithm.form().unwrap_or_default();
                debug_assert_eq!(which, Derivatives::ForwardDynamics(form));
                self.forward_derivatives(form, &at, state.u, out)?;
            }
            Algorithm::Products(which) => self.product(which, &at, state, out)?,
            Algorithm::ConstrainedDynamics(form) => {
                // Scenes with mimic joints have no connections: no rows, and rank and residual are zero.
                let qdd = coupling.independent_rates(&self.accelerations(form, &at, state.u)?);
                let (to, told) = out.split_at_mut(qdd.len());
                to.copy_from_slice(&qdd);
                told.fill(0.0);
            }
            // These are computed by the tree.
            Algorithm::InverseDynamics | Algorithm::BiasTorque | Algorithm::MassMatrix => {}
        }
        Ok(())
    }

    /// Results of the algorithm of the tree for one state.
    fn asked(&mut self, algorithm: Algorithm, state: &Arguments<'_>, width: usize) -> Result<Vec<f64>, Error> {
        let mut results = vec![f64::NAN; width];
        let state = [state.read_by(algorithm)];
        (self.ask)(algorithm, &state, &mut results).map_err(|fault| fault.error)?;
        Ok(results)
    }

    fn factorise(&mut self, form: Form, at: &Arguments<'_>, with_bias: bool) -> Result<(), Error> {
        let tree = self.coupling.tree();
        tree.check_roots(form)?;
        let bias = with_bias.then_some((at.qd, at.wrenches));
        let lost = self.scratch.accelerations.factorise(self.coupling.sums(), form, at.q, bias);
        lost.map_or(Ok(()), |lost| Err(tree.singular(lost)))
    }

    /// Accelerations of all joints of the tree for torques on the independent joints; keeps the factor.
    fn accelerations(&mut self, form: Form, at: &Arguments<'_>, tau: &[f64]) -> Result<Vec<f64>, Error> {
        self.factorise(form, at, true)?;
        Ok(self.solved(tau))
    }

    /// The solution with the factor for torques on the independent joints, and for the bias if there is one.
    fn solved(&mut self, tau: &[f64]) -> Vec<f64> {
        let mut qdd = vec![f64::NAN; self.coupling.tree().nv()];
        self.scratch.accelerations.solve(self.coupling.sums(), &self.coupling.torques(tau), &mut qdd);
        qdd
    }

    /// (G^T M G)^-1 tau with the existing factor.
    fn solve(&mut self, tau: &[f64]) -> Vec<f64> {
        self.scratch.accelerations.without_bias();
        let qdd = self.solved(tau);
        self.coupling.independent_rates(&qdd)
    }

    /// (G^T M G)^-1 with the existing factor, column by column; exactly symmetric.
    fn inverse(&mut self, out: &mut [f64]) {
        let (_, nv) = self.coupling.sizes();
        let mut unit = vec![0.0; nv];
        for column in 0..nv {
            unit.fill(0.0);
            unit[column] = 1.0;
            let solved = self.solve(&unit);
            for (row, value) in solved.into_iter().enumerate().skip(column) {
                out[row * nv + column] = value;
                out[column * nv + row] = value;
            }
        }
    }

    /// G^T X G of dtau/dq, dtau/dqd and M of the tree.
    fn inverse_derivatives(&mut self, at: &Arguments<'_>, out: &mut [f64]) -> Result<(), Error> {
        let (full, (_, nv)) = (self.coupling.tree().nv(), self.coupling.sizes());
        let three = self.asked(Algorithm::Derivatives(Derivatives::InverseDynamics), at, 3 * full * full)?;
        for (matrix, out) in three.chunks_exact((full * full).max(1)).zip(out.chunks_exact_mut((nv * nv).max(1))) {
            self.coupling.reduce_matrix(matrix, out);
        }
        Ok(())
    }

    /// -M^-1 dtau/dq, -M^-1 dtau/dqd at the accelerations of the state, and M^-1.
    fn forward_derivatives(
        &mut self,
        form: Form,
        at: &Arguments<'_>,
        tau: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (_, nv) = self.coupling.sizes();
        let qdd = self.accelerations(form, at, tau)?;
        let mut three = std::mem::take(&mut self.scratch.results);
        three.resize(3 * nv * nv, 0.0);
        let done = self.inverse_derivatives(&Arguments { u: &qdd, ..*at }, &mut three);
        if done.is_ok() {
            let (products, inverse) = out.split_at_mut(2 * nv * nv);
            self.inverse(inverse);
            for (of, out) in three.chunks_exact((nv * nv).max(1)).zip(products.chunks_exact_mut((nv * nv).max(1))) {
                if !self.scratch.accelerations.is_wide {
                    minus_product(nv, inverse, of, out);
                    continue;
                }
                for column in 0..nv {
                    let right: Vec<f64> = (0..nv).map(|row| -of[row * nv + column]).collect();
                    for (row, value) in self.solve(&right).into_iter().enumerate() {
                        out[row * nv + column] = value;
                    }
                }
            }
        }
        self.scratch.results = three;
        done
    }

    /// Products with the Jacobians, by those of inverse dynamics of the tree.
    fn product(
        &mut self,
        which: Products,
        at: &Arguments<'_>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let coupling = self.coupling;
        let (full, (_, nv)) = (coupling.tree().nv(), coupling.sizes());
        let [first, second, third] = state.seed;
        match which {
            Products::InverseTangent | Products::InverseTangents => {
                let seed = [first, second, third].map(|x| coupling.rates(x));
                let seed = [&seed[0][..], &seed[1], &seed[2]];
                let tangent = Algorithm::Products(Products::InverseTangent);
                let dtau = self.asked(tangent, &Arguments { seed, ..*at }, full)?;
                coupling.reduce(&dtau, out);
            }
            Products::InverseGradient | Products::InverseGradients => {
                self.inverse_gradient(at, at.u, &coupling.rates(first), out)?;
            }
            Products::ForwardTangent(form) | Products::ForwardTangents(form) => {
                // M dqdd = dtau - the change of inverse dynamics at the accelerations of the state.
                let qdd = self.accelerations(form, at, state.u)?;
                let (dq, dqd) = (coupling.rates(first), coupling.rates(second));
                let seed = [&dq[..], &dqd, &vec![0.0; full]];
                let tangent = Algorithm::Products(Products::InverseTangent);
                let changed = self.asked(tangent, &Arguments { u: &qdd, seed, ..*at }, full)?;
                let mut right = vec![0.0; nv];
                coupling.reduce(&changed, &mut right);
                for (right, dtau) in right.iter_mut().zip(third) {
                    *right = dtau - *right;
                }
                out.copy_from_slice(&self.solve(&right));
            }
            Products::ForwardGradient(form) | Products::ForwardGradients(form) => {
                let qdd = self.accelerations(form, at, state.u)?;
                let x = self.solve(first);
                self.inverse_gradient(at, &qdd, &coupling.rates(&x), out)?;
                for cotangent in &mut out[..2 * nv] {
                    *cotangent = -*cotangent;
                }
                out[2 * nv..].copy_from_slice(&x);
            }
        }
        Ok(())
    }

    /// G^T times the cotangents of q, qd and qdd for a cotangent of the torques of the tree.
    fn inverse_gradient(
        &mut self,
        at: &Arguments<'_>,
        qdd: &[f64],
        cotangent: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (full, (_, nv)) = (self.coupling.tree().nv(), self.coupling.sizes());
        let seed = [cotangent, &[][..], &[][..]];
        let gradient = Algorithm::Products(Products::InverseGradient);
        let three = self.asked(gradient, &Arguments { u: qdd, seed, ..*at }, 3 * full)?;
        for (of, out) in three.chunks_exact(full.max(1)).zip(out.chunks_exact_mut(nv.max(1))) {
            self.coupling.reduce(of, out);
        }
        Ok(())
    }
}

/// -A B into `out`, (n x n) each, row by row.
pub(crate) fn minus_product<T: Real>(n: usize, a: &[T], b: &[T], out: &mut [T]) {
    out.fill(T::zero());
    for (a, out) in a.chunks_exact(n.max(1)).zip(out.chunks_exact_mut(n.max(1))) {
        for (&a, b) in a.iter().zip(b.chunks_exact(n)) {
            for (out, &b) in out.iter_mut().zip(b) {
                *out -= a * b;
            }
        }
    }
}
