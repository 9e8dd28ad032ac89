//! Every algorithm for a scene with mimic joints, q = G q' + o, from the algorithms of the tree and G.
//!
//! Inverse dynamics, M and their derivatives are those of the tree at (q, G qd', G qdd'), multiplied by G and G^T.
//! Accelerations and M^-1 are not: their measurements are sums of measurements of the tree, which the filter of
//! [`summed`](crate::filter::summed) computes.

mod accelerations;
#[cfg(feature = "derivatives")]
mod derivatives;

pub(crate) use accelerations::{CoupledAccelerations, CoupledSolver};
#[cfg(feature = "derivatives")]
pub(crate) use derivatives::minus_product;

use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments};
use crate::error::{Error, Fault, check_length};
use crate::filter::Form;
use crate::scene::{Coupling, MimicJoints, Scene};

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
        if algorithm.takes_constants() || algorithm.gives_constants() {
            let expected = format!(
                "products with (q, qd, u) alone, or a scene with {} for those with parameters, armature, gravity and wrenches",
                MimicJoints::Free.text()
            );
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
        if entry.has_form || !algorithm.seeds().is_empty() {
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
            #[cfg(feature = "derivatives")]
            Algorithm::Derivatives(which) => {
                let form = algorithm.form().unwrap_or_default();
                debug_assert_eq!(which, crate::algorithm::Derivatives::ForwardDynamics(form));
                self.forward_derivatives(form, &at, state.u, out)?;
            }
            #[cfg(feature = "derivatives")]
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
}
