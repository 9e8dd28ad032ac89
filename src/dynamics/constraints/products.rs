//! Gradients of the rows of the connections with respect to the configuration and the velocities
//! ([`loops`](super::loops)), in O(depth) per connection. At rest, with qdd = w, the function is r* J(q) w.

use super::RowFault;
use super::loops::Loop;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;

/// Scratch of the gradients.
#[derive(Debug, Clone)]
pub(crate) struct RowGradients<T: Real = f64> {
    loops: Vec<Loop<T>>,
    /// Joint velocities of zero, and gradients by the velocities that are not needed.
    rest: Vec<T>,
    unused: Vec<T>,
}

impl<T: Real> RowGradients<T> {
    pub fn new(system: (&Model<T>, &Constraints)) -> Self {
        let zeros = || vec![T::zero(); system.0.nv()];
        Self { loops: Loop::all(system), rest: zeros(), unused: zeros() }
    }

    /// Adds the gradient of multipliers* J(q) w by q, in its tangent space, to `out`, (nv), for the rows of all
    /// connections. `shifts`: phi of every body at `q`.
    #[inline(always)]
    pub fn add_row_gradient(
        &mut self,
        shifts: &[RigidShift<T>],
        (q, w): (&[T], &[T]),
        multipliers: &[T],
        out: &mut [T],
    ) -> Result<(), RowFault> {
        let (rest, mut unused) = (std::mem::take(&mut self.rest), std::mem::take(&mut self.unused));
        let added = self.add_acceleration_gradient(shifts, (q, &rest, w), multipliers, [out, &mut unused]);
        (self.rest, self.unused) = (rest, unused);
        added
    }

    /// Adds the gradients of multipliers* (J qdd + J' qd) by q, in its tangent space, and by qd to `by_q` and `by_qd`,
    /// (nv) each, for the rows of all connections. `shifts`: phi of every body at `q`.
    #[inline(always)]
    pub fn add_acceleration_gradient(
        &mut self,
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        multipliers: &[T],
        [by_q, by_qd]: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        for of in &mut self.loops {
            let multipliers = &multipliers[of.rows.clone()];
            if multipliers.iter().any(|r| *r != r.constant(0.0)) {
                of.follow(shifts, state);
                of.add_row(state, multipliers, [&mut *by_q, &mut *by_qd], None)?;
            }
        }
        Ok(())
    }

    /// Writes the derivatives along (dq, dqd) of J qdd + J' qd, (m), and of J* multipliers, (nv). O(m depth + N).
    ///
    /// J* multipliers is linear in J, and multipliers* J'(q, v) v is a quadratic form in v: its gradient by v is the
    /// derivative of J* multipliers along v plus the gradient of multipliers* J v by q.
    #[inline(always)]
    pub fn along(
        &mut self,
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        ([dq, dqd], multipliers): ([&[T]; 2], &[T]),
        [of_rows, of_torques]: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        let zeros = vec![T::zero(); dq.len()];
        let (mut by_q, mut by_qd, mut unit) = (zeros.clone(), zeros.clone(), vec![T::zero(); of_rows.len()]);
        of_rows.fill(T::zero());
        for of in &mut self.loops {
            of.follow(shifts, state);
            for row in of.rows.clone() {
                unit[row] = T::one();
                of.add_row(state, &unit[of.rows.clone()], [&mut by_q, &mut by_qd], None)?;
                unit[row] = T::zero();
                for &i in &of.columns {
                    of_rows[row] += by_q[i] * dq[i] + by_qd[i] * dqd[i];
                    (by_q[i], by_qd[i]) = (T::zero(), T::zero());
                }
            }
        }
        of_torques.fill(T::zero());
        self.add_acceleration_gradient(shifts, (state.0, dq, &zeros), multipliers, [&mut by_qd, of_torques])?;
        self.add_row_gradient(shifts, (state.0, dq), multipliers, &mut by_q)?;
        for (sum, &more) in of_torques.iter_mut().zip(&by_q) {
            *sum -= more;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
