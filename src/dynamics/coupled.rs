//! Every algorithm for a scene with mimic joints, q = G q' + o, from those of its tree with one row per joint that
//! follows another.
//!
//! Inverse dynamics, M and their derivatives are those of the tree at (q, G qd', G qdd'), multiplied by G and G^T.
//! Accelerations are those [through the rows](super::constraints), for torques at the heaviest
//! joint of each group, whose entries of qdd, over its multiplier, are qdd'. At rest and without gravity they are (G^T M G)^-1 tau'.

use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments, table};
#[cfg(feature = "derivatives")]
use crate::algorithm::{Derivatives, Products};
use crate::error::{Error, Fault, check_length};
use crate::filter::Form;
#[cfg(feature = "derivatives")]
use crate::scalar::Real;
use crate::scene::{Coupling, MimicJoints, Scene};

/// Receives the index of each state and its accuracy.
pub(crate) type Found<'a> = dyn FnMut(usize, Accuracy) + 'a;

/// Runs an algorithm on some states of the tree with its rows, or without gravity if the first argument is true.
pub(crate) type Ask<'a> =
    dyn FnMut(bool, Algorithm, &[Arguments<'_>], &mut [f64], &mut Found<'_>) -> Result<(), Fault> + 'a;

/// Calls of algorithms of the tree.
struct Call<'a, 'b> {
    coupling: &'a Coupling,
    ask: &'a mut Ask<'b>,
}

impl Scene {
    /// Runs one algorithm on some states of a scene with mimic joints. Writes the results one after another. `ask` runs
    /// an algorithm of the tree with its rows.
    pub(crate) fn evaluate_coupled(
        &self,
        coupling: &Coupling,
        ask: &mut Ask<'_>,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
        found: &mut Found<'_>,
    ) -> Result<(), Fault> {
        let width = self.width(algorithm);
        let at = |state: usize| move |error: Error| Fault { state, error };
        check_length("out", out.len(), width * states.len()).map_err(at(0))?;
        for (i, state) in states.iter().enumerate() {
            self.check_coupled(algorithm, &state.read_by(algorithm)).map_err(at(i))?;
        }
        let mut call = Call { coupling, ask };
        match algorithm {
            Algorithm::MassMatrixInverse(form) => out.copy_from_slice(&call.inverses(form, states)?),
            #[cfg(feature = "derivatives")]
            Algorithm::Derivatives(Derivatives::ForwardDynamics(form)) => {
                call.forward_derivatives(form, states, out)?;
            }
            #[cfg(feature = "derivatives")]
            Algorithm::Products(which) if which.form().is_some() => {
                out.copy_from_slice(&call.product(which, states)?);
            }
            Algorithm::ConstrainedDynamics(form) => {
                // There are no connections: no rows, and rank and residual are zero.
                let qdd = call.reduced(false, Algorithm::ForwardDynamics(form), states, found)?;
                let nv = width - 2;
                for (i, to) in out.chunks_exact_mut(width).enumerate() {
                    to[..nv].copy_from_slice(&qdd[i * nv..(i + 1) * nv]);
                    to[nv..].fill(0.0);
                }
            }
            _ => out.copy_from_slice(&call.reduced(false, algorithm, states, found)?),
        }
        let mut results = out.chunks_exact(width.max(1)).enumerate();
        results.try_for_each(|(i, out)| self.check_result("result", out).map_err(at(i)))
    }

    /// Checks the arguments of one state that the algorithm takes.
    fn check_coupled(&self, algorithm: Algorithm, state: &Arguments<'_>) -> Result<(), Error> {
        state.check_of_scene("a scene whose joints follow others (mimic)")?;
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

    /// A (2nv x 2nv) and B (2nv x nv) of the linearized dynamics, from dqdd/dq, dqdd/dqd and M^-1 of forward dynamics
    /// at velocities `qd`.
    #[cfg(feature = "derivatives")]
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
    /// The results of an algorithm of the tree for all states, reduced.
    fn reduced(
        &mut self,
        is_weightless: bool,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        found: &mut Found<'_>,
    ) -> Result<Vec<f64>, Fault> {
        let (coupling, entry, tied) = (self.coupling, algorithm.entry(), self.coupling.tied());
        let acts = matches!(algorithm, Algorithm::ForwardDynamics(_));
        let name = |i: usize| entry.arguments.get(i).map_or("", |&(name, _)| name);
        let states: Vec<_> = states.iter().map(|state| state.read_by(algorithm)).collect();
        let expand = |state: &Arguments<'_>| -> [Vec<f64>; 6] {
            let [first, second, third] = state.seed;
            let given = [state.q, state.qd, state.u, first, second, third];
            std::array::from_fn(|i| coupling.expanded(name(i), acts, given[i]))
        };
        let expanded: Vec<_> = states.iter().map(expand).collect();
        let mut asked: Vec<Arguments<'_>> = Vec::with_capacity(states.len());
        for (&Arguments { wrenches, tolerance, .. }, [q, qd, u, first, second, third]) in states.iter().zip(&expanded) {
            let seed = [&first[..], second, third];
            asked.push(Arguments { q, qd, u, wrenches, seed, tolerance, ..Arguments::default() });
        }
        let (width, sizes) = (tied.width(algorithm), tied.sizes());
        let mut results = vec![f64::NAN; states.len() * width];
        (self.ask)(is_weightless, algorithm, &asked, &mut results, found)?;
        let mut out = Vec::new();
        for mut rest in results.chunks_exact(width.max(1)) {
            for &(name, axes) in entry.results {
                let (of_tree, others) = rest.split_at(table::width((name, axes), &sizes));
                coupling.reduced(axes, acts, of_tree, &mut out);
                rest = others;
            }
        }
        Ok(out)
    }

    /// The same, without its accuracy.
    #[cfg(feature = "derivatives")]
    fn results(&mut self, algorithm: Algorithm, states: &[Arguments<'_>]) -> Result<Vec<f64>, Fault> {
        self.reduced(false, algorithm, states, &mut |_, _| {})
    }

    /// (G^T M G)^-1 times the right-hand sides, (nv) each.
    fn solved(&mut self, form: Form, states: &[Arguments<'_>], rights: &[f64]) -> Result<Vec<f64>, Fault> {
        let rest = vec![0.0; self.coupling.sizes().1];
        let rights = rights.chunks_exact(rest.len().max(1));
        let at_rest = states.iter().zip(rights).map(|(&Arguments { q, .. }, u)| Arguments {
            q,
            qd: &rest,
            u,
            ..Arguments::default()
        });
        self.reduced(true, Algorithm::ForwardDynamics(form), &at_rest.collect::<Vec<_>>(), &mut |_, _| {})
    }

    /// (G^T M G)^-1 of each state, from its columns; exactly symmetric.
    fn inverses(&mut self, form: Form, states: &[Arguments<'_>]) -> Result<Vec<f64>, Fault> {
        let (_, nv) = self.coupling.sizes();
        let mut units = vec![0.0; nv * nv];
        units.iter_mut().step_by(nv + 1).for_each(|diagonal| *diagonal = 1.0);
        let mut out = Vec::with_capacity(states.len() * nv * nv);
        for (i, &state) in states.iter().enumerate() {
            let mut inverse =
                self.solved(form, &vec![state; nv], &units).map_err(|fault| Fault { state: i, ..fault })?;
            for row in 0..nv {
                for column in 0..row {
                    inverse[row * nv + column] = inverse[column * nv + row];
                }
            }
            out.append(&mut inverse);
        }
        Ok(out)
    }

    /// -M^-1 dtau/dq, -M^-1 dtau/dqd at the accelerations of each state, and M^-1.
    #[cfg(feature = "derivatives")]
    fn forward_derivatives(&mut self, form: Form, states: &[Arguments<'_>], out: &mut [f64]) -> Result<(), Fault> {
        let (_, nv) = self.coupling.sizes();
        let qdd = self.results(Algorithm::ForwardDynamics(form), states)?;
        let accelerated = at_accelerations(states, &qdd);
        let three = self.results(Algorithm::Derivatives(Derivatives::InverseDynamics), &accelerated)?;
        let inverses = self.inverses(form, states)?;
        let square = (nv * nv).max(1);
        let each = three.chunks_exact(3 * square).zip(inverses.chunks_exact(square));
        for (out, (three, inverse)) in out.chunks_exact_mut(3 * square).zip(each) {
            let (products, last) = out.split_at_mut(2 * square);
            for (of, out) in three.chunks_exact(square).zip(products.chunks_exact_mut(square)) {
                minus_product(nv, inverse, of, out);
            }
            last.copy_from_slice(inverse);
        }
        Ok(())
    }

    /// Products with the Jacobians of forward dynamics, by those of inverse dynamics.
    #[cfg(feature = "derivatives")]
    fn product(&mut self, which: Products, states: &[Arguments<'_>]) -> Result<Vec<f64>, Fault> {
        let (nv, form) = (self.coupling.sizes().1.max(1), which.form().unwrap_or_default());
        let qdd = self.results(Algorithm::ForwardDynamics(form), states)?;
        let mut accelerated = at_accelerations(states, &qdd);
        if which.is_gradient() {
            let cotangents: Vec<f64> = states.iter().flat_map(|state| state.seed[0]).copied().collect();
            let x = self.solved(form, states, &cotangents)?;
            for (state, x) in accelerated.iter_mut().zip(x.chunks_exact(nv)) {
                state.seed = [x, &[], &[]];
            }
            let mut out = self.results(Algorithm::Products(Products::gradient(None)), &accelerated)?;
            for (out, x) in out.chunks_exact_mut(3 * nv).zip(x.chunks_exact(nv)) {
                out[..2 * nv].iter_mut().for_each(|cotangent| *cotangent = -*cotangent);
                out[2 * nv..].copy_from_slice(x);
            }
            return Ok(out);
        }
        // M dqdd = dtau - the change of inverse dynamics at the accelerations of the state.
        let rest = vec![0.0; nv];
        for state in &mut accelerated {
            state.seed[2] = &rest;
        }
        let mut right = self.results(Algorithm::Products(Products::tangent(None)), &accelerated)?;
        for (right, dtau) in right.iter_mut().zip(states.iter().flat_map(|state| state.seed[2])) {
            *right = dtau - *right;
        }
        self.solved(form, states, &right)
    }
}

/// The states with these accelerations in place of the torques.
#[cfg(feature = "derivatives")]
fn at_accelerations<'a>(states: &[Arguments<'a>], qdd: &'a [f64]) -> Vec<Arguments<'a>> {
    let each = states.iter().zip(qdd.chunks_exact((qdd.len() / states.len().max(1)).max(1)));
    each.map(|(state, u)| Arguments { u, tolerance: None, ..*state }).collect()
}

/// -A B into `out`, (n x n) each, row by row.
#[cfg(feature = "derivatives")]
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
