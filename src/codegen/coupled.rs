//! Traces for scenes with mimic joints, q = G q' + o.
//!
//! Functions are those of the tree for expanded arguments, with reduced results: accelerations through one row per
//! joint that follows another. Products with M^-1 are further right-hand sides with the factors of M and of these rows.

use super::functions::Function;
use super::tracing::{Tracer, factor_of_mimic_joints, solve_mimic_joints};
use crate::scalar::{Real, Traced};
use crate::scene::Coupling;

/// The trace of one function for the arguments of the scene, q first.
pub(super) fn trace(
    coupling: &Coupling,
    function: &Function,
    tracer: &mut Tracer<'_>,
    given: &[Vec<Traced>],
    out: &mut [Traced],
) {
    let mut coupled = Coupled { coupling, margin: Traced::from_f64(f64::NAN), tracer };
    let (nv, square) = (coupling.sizes().1, coupling.sizes().1.pow(2));
    match function.plain() {
        Function::ForwardDynamics => {
            let qdd = coupled.accelerations(given);
            out[..nv].copy_from_slice(&coupling.independent_rates(&qdd));
            out[nv..].fill(coupled.margin);
        }
        Function::MassMatrixInverse => {
            coupled.factorise(&given[0]);
            coupled.inverse(&mut out[..square]);
            out[square..].fill(coupled.margin);
        }
        Function::FactorWatched => {
            coupled.factorise(&given[0]);
            out.fill(coupled.margin);
        }
        Function::ForwardDynamicsDerivatives => {
            coupled.forward_derivatives(given, &mut out[..3 * square]);
            out[3 * square..].fill(coupled.margin);
        }
        Function::ForwardDynamicsJvp => {
            // M dqdd = dtau - the change of inverse dynamics at the accelerations of the state.
            let qdd = coupled.accelerations(given);
            let seed = [coupling.rates(&given[3]), coupling.rates(&given[4]), vec![Traced::from_f64(0.0); qdd.len()]];
            let changed = coupled.of_tree(&Function::InverseDynamicsJvp, given, qdd, &seed);
            let right: Vec<Traced> = given[5].iter().zip(changed).map(|(&dtau, changed)| dtau - changed).collect();
            out[..nv].copy_from_slice(&coupled.solve(&right));
            out[nv..].fill(coupled.margin);
        }
        Function::ForwardDynamicsVjp => {
            let qdd = coupled.accelerations(given);
            let x = coupled.solve(&given[3]);
            let gradients = coupled.of_tree(&Function::InverseDynamicsVjp, given, qdd, &[coupling.rates(&x)]);
            for (out, gradient) in out.iter_mut().zip(gradients) {
                *out = -gradient;
            }
            out[2 * nv..3 * nv].copy_from_slice(&x);
            out[3 * nv..].fill(coupled.margin);
        }
        _ => {
            let arguments = function.arguments(coupling.tree());
            let of_tree = given.iter().zip(&arguments).map(|(x, array)| coupling.expanded(array.name, false, x));
            out.copy_from_slice(&coupled.reduced(function, &of_tree.collect::<Vec<_>>()));
        }
    }
}

struct Coupled<'a, 'b> {
    coupling: &'a Coupling,
    tracer: &'a mut Tracer<'b>,
    /// That of the last factors.
    margin: Traced,
}

impl Coupled<'_, '_> {
    /// The factors at `q` of the scene.
    fn factorise(&mut self, q: &[Traced]) {
        let rest = vec![Traced::from_f64(0.0); self.coupling.tree().nv()];
        self.margin = factor_of_mimic_joints(self.tracer, (&self.coupling.configuration(q), &rest));
    }

    /// The accelerations of all joints of the tree for (q, qd, tau) of the scene.
    fn accelerations(&mut self, given: &[Vec<Traced>]) -> Vec<Traced> {
        self.factorise(&given[0]);
        let (q, qd) = (self.coupling.configuration(&given[0]), self.coupling.rates(&given[1]));
        let qdd = self.solved(Some((&q, &qd)), &given[2]);
        self.coupling.rates(&qdd)
    }

    /// The accelerations for torques, with the factors.
    fn solved(&mut self, biased: Option<(&[Traced], &[Traced])>, tau: &[Traced]) -> Vec<Traced> {
        let mut qdd = vec![Traced::from_f64(f64::NAN); self.coupling.tree().nv()];
        solve_mimic_joints(self.tracer, biased, (&self.coupling.acting(tau), &mut qdd));
        self.coupling.accelerations(&qdd)
    }

    /// (G^T M G)^-1 tau with the factors.
    fn solve(&mut self, tau: &[Traced]) -> Vec<Traced> {
        self.solved(None, tau)
    }

    /// (G^T M G)^-1 with the factor, row by row.
    fn inverse(&mut self, out: &mut [Traced]) {
        let nv = self.coupling.sizes().1;
        let mut unit = vec![Traced::from_f64(0.0); nv];
        for column in 0..nv {
            unit.fill(Traced::from_f64(0.0));
            unit[column] = Traced::from_f64(1.0);
            for (row, value) in self.solve(&unit).into_iter().enumerate().skip(column) {
                out[row * nv + column] = value;
                out[column * nv + row] = value;
            }
        }
    }

    /// dqdd/dq, dqdd/dqd and M^-1.
    fn forward_derivatives(&mut self, given: &[Vec<Traced>], out: &mut [Traced]) {
        let square = self.coupling.sizes().1.pow(2);
        let qdd = self.accelerations(given);
        let three = self.of_tree(&Function::InverseDynamicsDerivatives, given, qdd, &[]);
        let (products, inverse) = out.split_at_mut(2 * square);
        self.inverse(inverse);
        for (of, out) in three.chunks_exact(square.max(1)).zip(products.chunks_exact_mut(square.max(1))) {
            minus_product(self.coupling.sizes().1, inverse, of, out);
        }
    }

    /// A function of inverse dynamics at the state of `given`, with accelerations `qdd` and `seed` of the tree.
    fn of_tree(
        &mut self,
        function: &Function,
        given: &[Vec<Traced>],
        qdd: Vec<Traced>,
        seed: &[Vec<Traced>],
    ) -> Vec<Traced> {
        let mut arguments = vec![self.coupling.configuration(&given[0]), self.coupling.rates(&given[1]), qdd];
        arguments.extend_from_slice(seed);
        self.reduced(function, &arguments)
    }

    /// The results of a function for arguments of the tree, as [`Coupling::reduced`].
    fn reduced(&mut self, function: &Function, arguments: &[Vec<Traced>]) -> Vec<Traced> {
        let (coupling, tree) = (self.coupling, self.coupling.tree());
        let mut results = vec![Traced::from_f64(f64::NAN); function.width(tree)];
        function.trace()(self.tracer, arguments, &mut results);
        let mut all = Vec::new();
        coupling.reduced_all(function.table_results(), (&tree.sizes(), false), &results, &mut all);
        all
    }
}

/// -A B into `out`, (n x n) each, row by row.
fn minus_product(n: usize, a: &[Traced], b: &[Traced], out: &mut [Traced]) {
    out.fill(Traced::from_f64(0.0));
    for (a, out) in a.chunks_exact(n.max(1)).zip(out.chunks_exact_mut(n.max(1))) {
        for (&a, b) in a.iter().zip(b.chunks_exact(n)) {
            for (out, &b) in out.iter_mut().zip(b) {
                *out -= a * b;
            }
        }
    }
}
