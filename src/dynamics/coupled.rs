//! Every algorithm for a scene with mimic joints, q = G q' + o, from those of its tree with one row per joint that
//! follows another.
//!
//! Inverse dynamics, M and their derivatives are those of the tree at (q, G qd', G qdd'), multiplied by G and G^T.
//! Accelerations are those [through the rows](super::constraints), for torques at the independent joints, whose entries
//! of qdd are qdd'. (G^T M G)^-1 are their entries of M^-1 - M^-1 J* G^+ J M^-1.

use crate::accuracy::Accuracy;
#[cfg(feature = "derivatives")]
use crate::algorithm::Derivatives;
use crate::algorithm::{Algorithm, Arguments, table};
use crate::error::{Error, Fault, check_length};
#[cfg(feature = "derivatives")]
use crate::filter::Form;
use crate::scalar::Real;
use crate::scene::{Coupling, MimicJoints, Scene};

/// Receives the index of each state and its accuracy.
pub(crate) type Found<'a> = dyn FnMut(usize, Accuracy) + 'a;

/// Runs an algorithm of the tree with its rows on some states.
pub(crate) type Ask<'a> = dyn FnMut(Algorithm, &[Arguments<'_>], &mut [f64], &mut Found<'_>) -> Result<(), Fault> + 'a;

/// The arguments of one state of the tree: q, qd, u, and the vectors of the seed.
type Expanded = [Vec<f64>; 6];

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
        match algorithm {
            #[cfg(feature = "derivatives")]
            Algorithm::Derivatives(Derivatives::ForwardDynamics(form)) => {
                forward_derivatives(coupling, ask, form, states, out)?;
            }
            Algorithm::ConstrainedDynamics(form) => {
                // There are no connections: no rows, and rank and residual are zero.
                let qdd = reduced(coupling, ask, Algorithm::ForwardDynamics(form), states, found)?;
                let nv = width - 2;
                for (i, to) in out.chunks_exact_mut(width).enumerate() {
                    to[..nv].copy_from_slice(&qdd[i * nv..(i + 1) * nv]);
                    to[nv..].fill(0.0);
                }
            }
            _ => out.copy_from_slice(&reduced(coupling, ask, algorithm, states, found)?),
        }
        let mut results = out.chunks_exact(width.max(1)).enumerate();
        results.try_for_each(|(i, out)| self.check_result("result", out).map_err(at(i)))
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

/// The results of an algorithm of the tree for all states, reduced.
fn reduced(
    coupling: &Coupling,
    ask: &mut Ask<'_>,
    algorithm: Algorithm,
    states: &[Arguments<'_>],
    found: &mut Found<'_>,
) -> Result<Vec<f64>, Fault> {
    let (entry, acts, tied) = (algorithm.entry(), algorithm.form().is_some(), coupling.tied());
    let name = |i: usize| entry.arguments.get(i).map_or("", |&(name, _)| name);
    let states: Vec<_> = states.iter().map(|state| state.read_by(algorithm)).collect();
    let expand = |state: &Arguments<'_>| -> Expanded {
        let [first, second, third] = state.seed;
        let given = [state.q, state.qd, state.u, first, second, third];
        std::array::from_fn(|i| coupling.expanded(name(i), acts, given[i]))
    };
    let expanded: Vec<Expanded> = states.iter().map(expand).collect();
    let mut asked: Vec<Arguments<'_>> = Vec::with_capacity(states.len());
    for (&Arguments { wrenches, tolerance, .. }, [q, qd, u, first, second, third]) in states.iter().zip(&expanded) {
        asked.push(Arguments { q, qd, u, wrenches, seed: [first, second, third], tolerance });
    }
    let (width, sizes) = (tied.width(algorithm), tied.sizes());
    let mut results = vec![f64::NAN; states.len() * width];
    ask(algorithm, &asked, &mut results, found)?;
    let mut out = Vec::new();
    for mut rest in results.chunks_exact(width.max(1)) {
        for &(name, axes) in entry.results {
            let (of_tree, others) = rest.split_at(table::width((name, axes), &sizes));
            coupling.reduced((name, axes), acts, of_tree, &mut out);
            rest = others;
        }
    }
    Ok(out)
}

/// -M^-1 dtau/dq, -M^-1 dtau/dqd at the accelerations of each state, and M^-1.
#[cfg(feature = "derivatives")]
fn forward_derivatives(
    coupling: &Coupling,
    ask: &mut Ask<'_>,
    form: Form,
    states: &[Arguments<'_>],
    out: &mut [f64],
) -> Result<(), Fault> {
    let (_, nv) = coupling.sizes();
    let ignore: &mut Found<'_> = &mut |_, _| {};
    let qdd = reduced(coupling, ask, Algorithm::ForwardDynamics(form), states, ignore)?;
    let inverses = reduced(coupling, ask, Algorithm::MassMatrixInverse(form), states, ignore)?;
    let accelerated = states.iter().zip(qdd.chunks_exact(nv.max(1)));
    let accelerated: Vec<_> = accelerated.map(|(state, qdd)| Arguments { u: qdd, tolerance: None, ..*state }).collect();
    let of_torques = Algorithm::Derivatives(Derivatives::InverseDynamics);
    let three = reduced(coupling, ask, of_torques, &accelerated, ignore)?;
    let square = (nv * nv).max(1);
    let each = out.chunks_exact_mut(3 * square).zip(three.chunks_exact(3 * square)).zip(inverses.chunks_exact(square));
    for ((out, three), inverse) in each {
        for (of, out) in three.chunks_exact(square).take(2).zip(out.chunks_exact_mut(square)) {
            minus_product(nv, inverse, of, out);
        }
        out[2 * square..].copy_from_slice(inverse);
    }
    Ok(())
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
