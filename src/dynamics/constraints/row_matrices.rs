//! J, and the derivatives of the rows of the connections and of their forces ([`loops`](super::loops)), as matrices.

use super::RowFault;
use super::loops::Loop;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, larger};
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;

/// The matrices at one motion; initialized with NaN, and with zeros where they have no entries.
#[derive(Debug)]
pub(crate) struct RowMatrices<T: Real> {
    loops: Vec<Loop<T>>,
    /// J, and the derivatives of J qdd + J' qd by q, in its tangent space, and by qd: (m x nv), row by row.
    jacobian: Vec<T>,
    pub by_q: Vec<T>,
    pub by_qd: Vec<T>,
    /// d(J* lambda)/dq, (nv x nv), row by row.
    of_forces: Vec<T>,
    solutions: RowSolutions<T>,
    unit: Vec<T>,
    nv: usize,
}

/// J M^-1 and G^-1 J M^-1, (m x nv), row by row.
#[derive(Debug)]
pub(crate) struct RowSolutions<T> {
    pub response: Vec<T>,
    pub solved: Vec<T>,
}

impl<T: Real> RowMatrices<T> {
    pub fn new((model, constraints): (&Model<T>, &Constraints)) -> Self {
        let (nan, zero, m, nv) = (T::from_f64(f64::NAN), T::zero(), constraints.rows, model.nv());
        let matrix = || vec![zero; m * nv];
        Self {
            loops: Loop::all((model, constraints)),
            jacobian: matrix(),
            by_q: matrix(),
            by_qd: matrix(),
            of_forces: vec![zero; nv * nv],
            solutions: RowSolutions { response: vec![nan; m * nv], solved: vec![nan; m * nv] },
            unit: vec![zero; m],
            nv,
        }
    }

    /// Computes J, its changes and those of J* `forces` at the motion (q, qd, qdd), with phi of every body at q.
    #[inline(always)]
    pub fn compute(
        &mut self,
        model: &Model<T>,
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        forces: &[T],
    ) -> Result<(), RowFault> {
        let Self { loops, jacobian, by_q, by_qd, of_forces, unit, nv, .. } = self;
        let (zero, one) = (model.gravity[0].constant(0.0), model.gravity[0].constant(1.0));
        of_forces.fill(zero);
        for of in loops {
            of.follow(shifts, state);
            for i in of.rows.clone() {
                let row = i * *nv..(i + 1) * *nv;
                let [jacobian, by_q, by_qd] = [&mut *jacobian, by_q, by_qd].map(|matrix| &mut matrix[row.clone()]);
                for &column in &of.columns {
                    (jacobian[column], by_q[column], by_qd[column]) = (zero, zero, zero);
                }
                unit[i] = one;
                let done = of.add_row(state, &unit[of.rows.clone()], [by_q, by_qd], Some(jacobian));
                unit[i] = zero;
                done?;
            }
            of.add_forces(state.0, &forces[of.rows.clone()], *nv, of_forces)?;
        }
        Ok(())
    }

    /// Subtracts d(J* lambda)/dq from a matrix (nv x nv).
    #[inline(always)]
    pub fn subtract_forces<C: ColumnsOf<T>>(&self, by_q: &mut [C::Entry]) {
        for (entry, &of_forces) in by_q.iter_mut().zip(&self.of_forces) {
            *entry = C::kept(C::taken(*entry) - of_forces);
        }
    }

    /// Computes J M^-1 from M^-1, and writes the largest entry of each row of M^-1 to `largest`. The caller computes
    /// G^-1 J M^-1.
    #[inline(always)]
    pub fn respond<C: ColumnsOf<T>>(&mut self, inverse: &[C::Entry], largest: &mut [T]) -> &mut RowSolutions<T> {
        let Self { loops, jacobian, solutions, nv, .. } = self;
        let response = &mut solutions.response;
        let nv = *nv;
        for (largest, row) in largest.iter_mut().zip(inverse.chunks_exact(nv.max(1))) {
            *largest = C::taken(row[0]).abs();
            for &entry in &row[1..] {
                *largest = larger(*largest, C::taken(entry).abs());
            }
        }
        for Loop { rows, columns, .. } in loops {
            for i in rows.clone() {
                let (row, to) = (&jacobian[i * nv..][..nv], &mut response[i * nv..][..nv]);
                for (at, &k) in columns.iter().enumerate() {
                    for (to, &entry) in to.iter_mut().zip(&inverse[k * nv..][..nv]) {
                        let before = if at == 0 { to.constant(0.0) } else { *to };
                        *to = row[k].mul_add(C::taken(entry), before);
                    }
                }
            }
        }
        solutions
    }

    /// Replaces M^-1 by Mc = M^-1 - (J M^-1)* G^-1 J M^-1.
    #[inline(always)]
    pub fn reduce<C: ColumnsOf<T>>(&self, inverse: &mut [C::Entry]) {
        let Self { solutions: RowSolutions { response, solved }, nv, .. } = self;
        for (i, row) in inverse.chunks_exact_mut((*nv).max(1)).enumerate() {
            for (of, solved) in response.chunks_exact((*nv).max(1)).zip(solved.chunks_exact((*nv).max(1))) {
                for (entry, &solved) in row.iter_mut().zip(solved) {
                    *entry = C::kept(C::taken(*entry).minus_product(of[i], solved));
                }
            }
        }
    }

    /// Subtracts N times the changes of the rows from the matrices by q and by qd, (nv x nv) each.
    #[inline(always)]
    pub fn subtract_changes<C: ColumnsOf<T>>(&self, both: &mut [C::Entry]) {
        let Self { loops, by_q, by_qd, solutions: RowSolutions { solved, .. }, nv, .. } = self;
        let (of_q, of_qd) = both.split_at_mut(nv * nv);
        for (matrix, changes) in [(of_q, by_q), (of_qd, by_qd)] {
            for (i, row) in matrix.chunks_exact_mut((*nv).max(1)).enumerate() {
                for Loop { rows, columns, .. } in loops {
                    for r in rows.clone() {
                        let (factor, changes) = (solved[r * nv + i], &changes[r * nv..][..*nv]);
                        for &column in columns {
                            row[column] = C::kept(C::taken(row[column]).minus_product(factor, changes[column]));
                        }
                    }
                }
            }
        }
    }
}
