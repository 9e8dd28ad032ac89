//! Every algorithm for a scene with mimic joints, q = G q' + o, from those of its tree with one row per joint that
//! follows another.
//!
//! Inverse dynamics, M and their derivatives are those of the tree at (q, G qd', G qdd'), multiplied by G and G^T.
//! Accelerations and their derivatives are those [through the rows](super::constraints), for torques at the heaviest
//! joint of each group, whose entries of qdd, over its multiplier, are qdd'. At rest and without gravity they are
//! (G^T M G)^-1 tau'.

use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments};
use crate::error::{Error, Fault, check_length};
use crate::filter::Form;
use crate::model::StateModel;
use crate::scene::{Coupling, Scene, mirror};

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
    /// Runs one algorithm on some states of a scene with mimic joints. Writes the results one after another, also those
    /// before a state that fails. `ask` runs an algorithm of the tree with its rows.
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
        let mut valid = states.iter().enumerate();
        let checked =
            valid.try_for_each(|(i, state)| self.check_coupled(algorithm, &state.read_by(algorithm)).map_err(at(i)));
        let states = checked.as_ref().map_or_else(|fault| &states[..fault.state], |()| states);
        if states.is_empty() {
            return checked;
        }
        let (mut call, mut all) = (Call { coupling, ask }, Vec::new());
        let done = match algorithm {
            Algorithm::MassMatrixInverse(form) => call.inverses(form, states, &mut all),
            // There are no connections: no rows, and rank and residual are zero.
            Algorithm::ConstrainedDynamics(form) => {
                call.reduced(false, Algorithm::ForwardDynamics(form), states, (found, &mut all))
            }
            _ => call.reduced(false, algorithm, states, (found, &mut all)),
        };
        let own = if matches!(algorithm, Algorithm::ConstrainedDynamics(_)) { width - 2 } else { width };
        for (i, (from, to)) in all.chunks_exact(own.max(1)).zip(out.chunks_exact_mut(width.max(1))).enumerate() {
            to[..own].copy_from_slice(from);
            to[own..].fill(0.0);
            self.check_result("result", to).map_err(at(i))?;
        }
        done.and(checked)
    }

    /// Checks the arguments of one state that the algorithm takes.
    fn check_coupled(&self, algorithm: Algorithm, state: &Arguments<'_>) -> Result<(), Error> {
        if !state.model.armature.is_empty() {
            self.check_armature(state.model.armature)?;
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
        self.check_seed(algorithm, state.seed)
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
    /// Appends the results of an algorithm of the tree for all states, reduced, up to one that fails.
    fn reduced(
        &mut self,
        is_weightless: bool,
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        (found, out): (&mut Found<'_>, &mut Vec<f64>),
    ) -> Result<(), Fault> {
        let (coupling, entry, tied) = (self.coupling, algorithm.entry(), self.coupling.tied());
        let (acts, nv) = (algorithm.goes_through_connections(), coupling.sizes().1);
        let states: Vec<_> = states.iter().map(|state| state.read_by(algorithm)).collect();
        let expand = |state: &Arguments<'_>| -> [Vec<f64>; 7] {
            let [first, second, third] = state.seed;
            let given = [state.q, state.qd, state.u, first, second, third];
            let name = |i: usize| entry.arguments.get(i).map_or("", |&(name, _)| name);
            let mut expanded = std::array::from_fn(|i| match given.get(i) {
                Some(given) => coupling.expanded(name(i), acts, given),
                None if state.model.armature.is_empty() => Vec::new(),
                None => coupling.armature(state.model.armature),
            });
            if algorithm.takes_constants() {
                let (armature, others) = third[nv..].split_at(nv);
                expanded[5].append(&mut coupling.armature(armature));
                expanded[5].extend_from_slice(others);
            }
            expanded
        };
        let expanded: Vec<_> = states.iter().map(expand).collect();
        let mut asked: Vec<Arguments<'_>> = Vec::with_capacity(states.len());
        for (state, [q, qd, u, first, second, third, armature]) in states.iter().zip(&expanded) {
            let (seed, model) = ([&first[..], second, third], StateModel { armature, ..state.model });
            asked.push(Arguments { q, qd, u, seed, model, ..*state });
        }
        let (width, sizes) = (tied.width(algorithm), tied.sizes());
        let mut results = vec![f64::NAN; states.len() * width];
        let done = (self.ask)(is_weightless, algorithm, &asked, &mut results, found);
        let count = done.as_ref().map_or_else(|fault| fault.state, |()| states.len());
        for of_state in results.chunks_exact(width.max(1)).take(count) {
            let rest = coupling.reduced_all(entry.results, (&sizes, acts), of_state, out);
            if algorithm.gives_constants() {
                let (armature, others) = rest.split_at(sizes.nv);
                out.extend(coupling.by_armature(armature));
                out.extend_from_slice(others);
            }
        }
        done
    }

    /// Appends (G^T M G)^-1 of each state up to one that fails, from its columns: accelerations at rest and without
    /// gravity; exactly symmetric.
    fn inverses(&mut self, form: Form, states: &[Arguments<'_>], out: &mut Vec<f64>) -> Result<(), Fault> {
        let (_, nv) = self.coupling.sizes();
        let (rest, mut units) = (vec![0.0; nv], vec![0.0; nv * nv]);
        units.iter_mut().step_by(nv + 1).for_each(|diagonal| *diagonal = 1.0);
        for (i, state) in states.iter().enumerate() {
            let of = |u| Arguments { q: state.q, qd: &rest, u, model: state.model, ..Arguments::default() };
            let columns: Vec<_> = units.chunks_exact(nv.max(1)).map(of).collect();
            let mut inverse = Vec::with_capacity(nv * nv);
            self.reduced(true, Algorithm::ForwardDynamics(form), &columns, (&mut |_, _| {}, &mut inverse))
                .map_err(|fault| Fault { state: i, ..fault })?;
            mirror(nv, &mut inverse);
            out.append(&mut inverse);
        }
        Ok(())
    }
}
