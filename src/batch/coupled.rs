//! States of a scene with mimic joints: the kernels of the tree with a row per joint that follows another.

use super::Fault;
use super::independent::Independent;
use crate::accuracy::Accuracy;
use crate::algorithm::{Algorithm, Arguments, KinematicQuantity};
use crate::dynamics::coupled::{Ask, Found};
use crate::error::{Error, check_length};
use crate::model::StateModel;
use crate::scene::{Coupling, Scene};

impl Scene {
    /// As [`Scene::evaluate`], by the kernels of the tree with its rows; those without gravity are created at first
    /// use.
    pub(super) fn evaluate_on_tied(
        &self,
        coupling: &Coupling,
        (tied, weightless): (&mut Independent, &mut Option<Box<Independent>>),
        algorithm: Algorithm,
        states: &[Arguments<'_>],
        out: &mut [f64],
        found: &mut Found<'_>,
    ) -> Result<(), Fault> {
        let ask: &mut Ask<'_> = &mut |is_weightless, algorithm, states, out, found| {
            let found = |state: usize, accuracy: &dyn Fn() -> Accuracy| found(state, accuracy());
            let (scene, evaluator) = if is_weightless {
                let scene = coupling.weightless();
                (scene, &mut **weightless.get_or_insert_with(|| Box::new(Independent::new(tied.arm, scene))))
            } else {
                (coupling.tied(), &mut *tied)
            };
            scene.evaluate_independent(evaluator, algorithm, (states, scene.width(algorithm)), out, found)
        };
        self.evaluate_coupled(coupling, ask, algorithm, states, out, found)
    }

    /// As [`Scene::evaluate_kinematic_quantity`], by the kernels of the tree.
    pub(super) fn quantity_on_tied(
        &self,
        coupling: &Coupling,
        kernels: &mut Independent,
        what: &KinematicQuantity<'_>,
        states: &[Arguments<'_>],
        out: &mut [f64],
    ) -> Result<(), Fault> {
        let at = |state: usize| move |error: Error| Fault { state, error };
        let (tied, width) = (coupling.tied(), what.width(self.nv()));
        check_length("out", out.len(), width * states.len()).map_err(at(0))?;
        let expand = |state: &Arguments<'_>| {
            self.check_coordinates("q", state.q)?;
            for (name, rates) in [("qd", state.qd), ("qdd", state.u)].iter().take(what.reads() - 1) {
                self.check_rates(name, rates)?;
            }
            let rates = |at: usize, x: &[f64]| if at < what.reads() { coupling.rates(x) } else { Vec::new() };
            let armature = match state.model.armature {
                [] => Vec::new(),
                armature => self.check_armature(armature).map(|()| coupling.armature(armature))?,
            };
            Ok([coupling.configuration(state.q), rates(1, state.qd), rates(2, state.u), armature])
        };
        // The states before an invalid one are finished.
        let mut expanded = Vec::with_capacity(states.len());
        let checked = states.iter().enumerate().try_for_each(|(i, state)| {
            expanded.push(expand(state).map_err(at(i))?);
            Ok(())
        });
        let mut asked: Vec<Arguments<'_>> = Vec::with_capacity(states.len());
        for ([q, qd, u, armature], state) in expanded.iter().zip(states) {
            let model = StateModel { armature, ..state.model };
            asked.push(Arguments { q, qd, u, model, ..Arguments::default() });
        }
        let of_tree = what.width(tied.nv());
        if of_tree == width {
            return tied.quantity_independent(kernels, what, &asked, &mut out[..width * asked.len()]).and(checked);
        }
        let mut results = vec![f64::NAN; of_tree * asked.len()];
        let done = tied.quantity_independent(kernels, what, &asked, &mut results);
        let count = done.as_ref().map_or_else(|fault| fault.state, |()| asked.len());
        for (from, to) in results.chunks_exact(of_tree.max(1)).zip(out.chunks_exact_mut(width.max(1))).take(count) {
            coupling.reduce_quantity(what, from, to);
        }
        done.and(checked)
    }
}
