//! Access to the store of the general model: the covariance of each body before and after its measurements, and forces.
//!
//! The passes do not write P to memory. P^-(k) is the inertia of the body plus the sum over its children (3.6), which
//! the store holds, and the rows of the joint give P^+(k) from it, with the same bits as in the pass. In square-root
//! form the store holds the root of P^+(k).

use super::body::SweepBody;
use super::scratch::{Accumulated, SweepScratch};
use crate::filter::pivots::Scale;
use crate::filter::riccati::{self, Measured};
use crate::filter::{Stage, System};
use crate::scalar::Real;
use crate::spatial::transform::unpacked;
use crate::spatial::{BodyInertia, Symmetric6, scaled};
use nalgebra::Vector6;

impl<T: Real> Accumulated<T> {
    /// P^+ of a body with this inertia, on the inboard side of its joint, and the rest as in
    /// [`SweepScratch::filtered_covariance`].
    pub(crate) fn measured(
        &self,
        (system, k): (&System<T>, usize),
        inertia: &BodyInertia<T>,
        measured: &mut [Measured<T>],
        seen: impl FnMut(usize, &Symmetric6<T>),
    ) -> Symmetric6<T> {
        let mut p = unpacked(&self.p).add(&inertia.to_symmetric());
        riccati::measure_stage(system, k, &mut p, measured, seen);
        p
    }
}

/// P^+ of a stage, from the root of P; `seen` is called with the P^- of each row.
pub(crate) fn covariances_of_root<T: Real>(
    stage: &Stage<T>,
    filtered: &Symmetric6<T>,
    measured: &[Measured<T>],
    mut seen: impl FnMut(usize, &Symmetric6<T>),
) -> Symmetric6<T> {
    // P^- = P^+ + g D g* row by row: nothing is subtracted.
    let mut p = *filtered;
    for (i, m) in measured[stage.first_row..][..stage.rows.count()].iter().enumerate() {
        p = p.add_rank_one(&scaled(&m.gain, m.pivot), &m.gain);
        seen(stage.first_row + i, &p);
    }
    *filtered
}

impl<T: Real> SweepScratch<T> {
    /// P^+ of a body, on the inboard side of its joint. `seen` is called with the P^- of each row. `measured` receives
    /// D and g of the rows; in square-root form they are read from it.
    pub(in crate::dynamics) fn filtered_covariance(
        &self,
        (system, body): (&System<T>, &SweepBody<T::Parameter>),
        measured: &mut [Measured<T>],
        of_roots: bool,
        seen: impl FnMut(usize, &Symmetric6<T>),
    ) -> Symmetric6<T> {
        let at = body.places.inward;
        if of_roots {
            let filtered = self.rooted[at].root.to_symmetric();
            return covariances_of_root(&system.stages[body.index], &filtered, measured, seen);
        }
        let inertia = body.inertia(self.accumulated[at].p[0]);
        self.accumulated[at].measured((system, body.index), &inertia, measured, seen)
    }

    /// In square-root form P^+ of every body, on the inboard side of its joint.
    pub(crate) fn filtered_roots(&self) -> Vec<Symmetric6<T>> {
        self.rooted[1..].iter().map(|rooted| rooted.root.to_symmetric()).collect()
    }

    /// The bound on the terms of P^- of a body.
    pub(in crate::dynamics) fn scale(&self, body: &SweepBody<T::Parameter>, of_roots: bool) -> Scale<T> {
        if of_roots {
            return self.rooted[body.places.inward].scale;
        }
        let arrived = &self.accumulated[body.places.inward];
        arrived.scale.sum(&body.scale_of_noise(arrived.p[0]))
    }

    /// The sums over the children of each body: P^- without its own inertia, and the bound on the terms.
    pub(crate) fn covariances(&self) -> &[Accumulated<T>] {
        &self.accumulated[1..]
    }

    /// See [`SweepScratch::covariances`].
    pub(crate) fn covariances_mut(&mut self) -> &mut [Accumulated<T>] {
        &mut self.accumulated[1..]
    }

    /// The force of each body.
    pub(crate) fn forces(&self) -> impl Iterator<Item = Vector6<T>> + '_ {
        self.own.iter().map(|own| own.force.into())
    }

    /// Sets the force of each body: the right-hand side of the next filter.
    pub(crate) fn set_forces(&mut self, forces: impl IntoIterator<Item = Vector6<T>>) {
        for (own, force) in self.own.iter_mut().zip(forces) {
            own.force = force.into();
        }
    }
}
