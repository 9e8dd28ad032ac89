//! Accelerations of mimic joints, qdd = G a, from rows that are measured together, in O(N) plus the cost of partial
//! sums.

use crate::dynamics::forces::Motion;
use crate::dynamics::inverse::forces_base_to_tip;
use crate::filter::Form;
use crate::filter::pivots::{LostPivot, Scale};
use crate::filter::summed::{Seen, SummedFactor, Sums};
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::spatial::zero;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// The factor of G^T M G in one scalar, with its scratch.
#[derive(Debug, Clone)]
pub(crate) struct CoupledSolver<T: Real> {
    model: Model<T>,
    workspace: Workspace<T>,
    factor: SummedFactor<T>,
}

impl<T: Real> CoupledSolver<T> {
    pub fn new(model: Model<T>, sums: &Sums) -> Self {
        let (workspace, factor) = (Workspace::new(&model), SummedFactor::new(&model.system, sums));
        Self { model, workspace, factor }
    }

    /// The factor at `q`; with velocities also the bias forces, in the workspace's z.
    pub fn factorise(&mut self, sums: &Sums, q: &[T], bias: Option<(&[T], &[Vector6<T>])>) -> Seen<T> {
        let Self { model, workspace, factor } = self;
        if let Some((qd, wrenches)) = bias {
            forces_base_to_tip(model, workspace, Motion { q, qd, qdd: None, wrenches });
        } else {
            placements_base_to_tip(model, q, &mut workspace.store.shifts);
            workspace.z.fill(zero());
        }
        let (p, scale) = factor.noise();
        for ((p, scale), body) in p.iter_mut().zip(scale).zip(&model.bodies) {
            *p = body.inertia.to_symmetric();
            *scale = Scale::of_noise(&body.inertia_terms);
        }
        factor.factorise(&model.system, sums, &workspace.store.shifts)
    }

    /// The accelerations for these torques and the bias forces in z, which are overwritten.
    pub fn solve(&mut self, sums: &Sums, tau: &[T], qdd: &mut [T]) {
        let Self { model, workspace, factor } = self;
        factor.solve(&model.system, sums, &workspace.store.shifts, tau, &mut workspace.z, qdd);
    }

    /// Prepares the factor for a right-hand side without bias.
    pub fn without_bias(&mut self) {
        self.workspace.z.fill(zero());
    }

    fn lost(&self, sums: &Sums, seen: &Seen<T>) -> Option<LostPivot> {
        let noise = |k: usize| self.model.bodies[k].inertia_terms;
        self.factor.lost_pivot(&self.model.system, sums, &self.workspace.store.shifts, seen, noise)
    }
}

/// Accelerations of a tree with mimic joints, in f64, and in double-double arithmetic if a pivot in f64 is inaccurate.
#[derive(Debug, Clone)]
pub(crate) struct CoupledAccelerations {
    narrow: CoupledSolver<f64>,
    /// Allocated when it is first needed.
    wide: Option<Box<CoupledSolver<DoubleDouble>>>,
    /// True if the last factor is the wide one.
    pub(crate) is_wide: bool,
}

fn widened(numbers: &[f64]) -> Vec<DoubleDouble> {
    numbers.iter().map(|&x| DoubleDouble::from_f64(x)).collect()
}

impl CoupledAccelerations {
    pub fn new(model: &Model<f64>, sums: &Sums) -> Self {
        Self { narrow: CoupledSolver::new(model.clone(), sums), wide: None, is_wide: false }
    }

    /// Sets measurement noise other than the armature: the terms that a step treats implicitly.
    pub fn set_noise(&mut self, noise: &[f64]) {
        self.narrow.model.system.noise.copy_from_slice(noise);
        if let Some(wide) = &mut self.wide {
            wide.model.system.noise = widened(noise);
        }
    }

    /// The factor at `q`, and with velocities (and forces on bodies) the bias. In form `auto` it uses double-double
    /// arithmetic if a pivot has lost more than five digits; in square-root form always.
    ///
    /// Returns the lost pivot, if any.
    pub fn factorise(
        &mut self,
        sums: &Sums,
        form: Form,
        q: &[f64],
        bias: Option<(&[f64], &[Vector6<f64>])>,
    ) -> Option<LostPivot> {
        self.is_wide = form == Form::SquareRoot;
        if !self.is_wide {
            let seen = self.narrow.factorise(sums, q, bias);
            self.is_wide = form == Form::Auto && !seen.doubt.clear(0);
            if !self.is_wide {
                return self.narrow.lost(sums, &seen);
            }
        }
        let wide = self.wide.get_or_insert_with(|| Box::new(CoupledSolver::new(self.narrow.model.cast(), sums)));
        let bias: Option<(Vec<_>, Vec<_>)> =
            bias.map(|(qd, wrenches)| (widened(qd), wrenches.iter().map(|w| w.map(DoubleDouble::from_f64)).collect()));
        let seen = wide.factorise(sums, &widened(q), bias.as_ref().map(|(qd, wrenches)| (&qd[..], &wrenches[..])));
        wide.lost(sums, &seen)
    }

    /// The accelerations of all joints, (nv of the tree), with the existing factor, for the bias of the previous call
    /// or without bias.
    pub fn solve(&mut self, sums: &Sums, tau: &[f64], qdd: &mut [f64]) {
        match &mut self.wide {
            Some(wide) if self.is_wide => {
                let mut all = widened(qdd);
                wide.solve(sums, &widened(tau), &mut all);
                for (to, from) in qdd.iter_mut().zip(all) {
                    *to = from.lane(0);
                }
            }
            _ => self.narrow.solve(sums, tau, qdd),
        }
    }

    /// Prepares the factor for a right-hand side without bias.
    pub fn without_bias(&mut self) {
        self.narrow.without_bias();
        if let Some(wide) = &mut self.wide {
            wide.without_bias();
        }
    }
}
