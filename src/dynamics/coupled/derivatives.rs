//! Derivatives for a scene with mimic joints, from those of inverse dynamics of the tree.

use super::Call;
use crate::algorithm::{Algorithm, Arguments, Derivatives, Products};
use crate::dynamics::derivatives::linear_system;
use crate::error::Error;
use crate::filter::Form;
use crate::scalar::Real;
use crate::scene::Scene;

impl Scene {
    /// A (2nv x 2nv) and B (2nv x nv) of the linearized dynamics, from dqdd/dq, dqdd/dqd and M^-1 of forward dynamics
    /// at velocities `qd`.
    pub(crate) fn linear_system(&self, qd: &[f64], three: &[f64], (a, b): (&mut [f64], &mut [f64])) {
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
    /// Results of the algorithm of the tree for one state.
    fn asked(&mut self, algorithm: Algorithm, state: &Arguments<'_>, width: usize) -> Result<Vec<f64>, Error> {
        let mut results = vec![f64::NAN; width];
        let state = [state.read_by(algorithm)];
        (self.ask)(algorithm, &state, &mut results).map_err(|fault| fault.error)?;
        Ok(results)
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
    pub(super) fn forward_derivatives(
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
    pub(super) fn product(
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
