//! The factor of the mass matrix at one configuration: K, L and D, and the quantities from which they are computed.

use super::{Applied, Kind};
use crate::dynamics::sweeps::{Accumulated, covariances_of_root};
use crate::dynamics::{self, factorise};
use crate::error::Error;
use crate::filter::pivots::PivotMonitor;
use crate::filter::riccati::Measured;
use crate::filter::{Form, HingeMap, Stage, System, innovations, smoother};
use crate::kinematics::propagation::{base_to_tip, tip_to_base};
use crate::memory;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Scene;
use crate::spatial::{BodyInertia, RigidShift, Symmetric6};
use crate::workspace::Workspace;
use nalgebra::Vector6;
use std::sync::OnceLock;

/// M = (1 + K) D (1 + K*) at one configuration (3.1), with the phi, P, D and g of K and L.
///
/// It owns its data: it can be stored, moved to other threads, and used for many right-hand sides.
#[derive(Debug, Clone)]
pub struct Factor<T: Real> {
    pub(super) system: System<T>,
    pub(super) shift: Vec<RigidShift<T>>,
    pub(super) inertia: Vec<BodyInertia<T>>,
    pub(super) measured: Vec<Measured<T>>,
    /// H of each row.
    pub(super) hinges: Vec<HingeMap<T>>,
    /// The data that [`update`](super::update) needs.
    pub(super) sweep: Sweep<T>,
    /// Computed on first use: most uses of a factor do not need it.
    pub(super) forces: OnceLock<Covariances<T>>,
    /// The same.
    pub(super) co_states: OnceLock<Covariances<T>>,
}

/// The results of the pass that the operators do not use.
#[derive(Debug, Clone)]
pub(super) struct Sweep<T: Real> {
    pub form: Form,
    /// Identity of the model.
    pub identity: u64,
    pub tolerance: Option<f64>,
    /// The configuration.
    pub q: Vec<T>,
    /// The sum over the children of each body: P^- without its own inertia, and the bound on its terms.
    pub arrived: Vec<Accumulated<T>>,
    /// In square-root form P^+ of each body, inboard of its joint; else empty.
    pub filtered: Vec<Symmetric6<T>>,
}

/// P (3.6) or Lambda (5.6, 5.7) of each row, on both sides.
#[derive(Debug, Clone)]
pub(super) struct Covariances<T: Real> {
    /// P^- or Lambda^-, outboard.
    pub minus: Vec<Symmetric6<T>>,
    /// P^+ or Lambda^+, inboard.
    pub plus: Vec<Symmetric6<T>>,
}

impl<T: Real> Factor<T> {
    /// The factor at `q`, by one tip-to-base sweep (3.6). The workspace then holds the data for error messages.
    pub fn new(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> (Self, PivotMonitor<T>) {
        let monitor = factorise(model, workspace, q);
        let factor = Self {
            system: model.system.clone(),
            shift: workspace.store.shifts.clone(),
            inertia: model.bodies.iter().map(|body| body.inertia).collect(),
            measured: workspace.store.measured.clone(),
            hinges: model
                .system
                .stages
                .iter()
                .flat_map(|stage| (0..stage.rows.count()).map(|i| stage.rows.row(i)))
                .collect(),
            sweep: Sweep {
                form: workspace.form,
                identity: model.identity(),
                tolerance: workspace.tolerance,
                q: q.to_vec(),
                arrived: workspace.store.covariances().to_vec(),
                filtered: if monitor.of_roots { workspace.store.filtered_roots() } else { Vec::new() },
            },
            forces: OnceLock::new(),
            co_states: OnceLock::new(),
        };
        (factor, monitor)
    }

    /// P on both sides of every row, from that of each body and its measurements, at the first call.
    pub(super) fn force_covariances(&self) -> &Covariances<T> {
        self.forces.get_or_init(|| {
            let Self { system, inertia, sweep, .. } = self;
            let unset = vec![Symmetric6::filled(T::from_f64(f64::NAN)); self.nv()];
            let (mut minus, mut plus, mut measured) = (unset.clone(), unset, self.measured.clone());
            for (k, stage) in system.stages.iter().enumerate() {
                let seen = |row: usize, p: &Symmetric6<T>| minus[row] = *p;
                let inboard = match sweep.filtered.get(k) {
                    Some(filtered) => covariances_of_root(stage, filtered, &measured, seen),
                    None => sweep.arrived[k].measured((system, k), &inertia[k], &mut measured, seen),
                };
                // P^+ of a row is P^- of the next one inward.
                for row in (stage.first_row..stage.first_row + stage.rows.count()).rev() {
                    plus[row] = if row == stage.first_row { inboard } else { minus[row - 1] };
                }
            }
            Covariances { minus, plus }
        })
    }

    /// Approximate number of bytes of the factors of this number of states.
    #[must_use]
    pub fn bytes(model: &Model<T>, states: usize) -> u128 {
        /// Number of vectors in a factor, and the overhead of the allocator for each.
        const VECTORS: usize = 10;
        const ADDED: usize = 32;
        let body = size_of::<Stage<T>>()
            + size_of::<RigidShift<T>>()
            + size_of::<BodyInertia<T>>()
            + size_of::<Accumulated<T>>()
            + size_of::<Symmetric6<T>>();
        let row = 2 * size_of::<T>() + size_of::<Measured<T>>() + size_of::<HingeMap<T>>();
        let one = size_of::<Self>() + VECTORS * ADDED + body * model.bodies.len() + row * model.nv() + 8 * model.nq;
        memory::bytes_of::<u8>(&[one, states])
    }

    /// Approximate number of additional bytes for operators that need P or Lambda, for the factors of this number of
    /// states.
    #[must_use]
    #[doc(hidden)]
    pub fn bytes_of_covariances(model: &Model<T>, states: usize) -> u128 {
        memory::bytes_of::<[Symmetric6<T>; 2]>(&[states, model.nv() + 1])
    }

    /// Number of degrees of freedom.
    #[must_use]
    pub fn nv(&self) -> usize {
        self.system.rows()
    }

    /// One of its operators.
    #[must_use]
    pub fn operator(&self, kind: Kind) -> Applied<'_, T> {
        Applied { factor: self, kind }
    }

    /// M^-1 tau by filter and smoother (4.1), O(N).
    ///
    /// # Panics
    ///
    /// If the length of `tau` or `out` is not [`Factor::nv`].
    pub fn solve(&self, tau: &[T], out: &mut [T]) {
        super::assert_lengths((self.nv(), self.nv()), (out.len(), tau.len()));
        let (stages, measured) = (&self.system.stages, &self.measured);
        let mut states = vec![Vector6::from_element(T::zero()); stages.len()];
        tip_to_base(stages, &self.shift, (0..stages.len()).rev(), &mut states, |k, force| {
            innovations::through_stage((&self.system, k), measured, tau, force, out);
        });
        base_to_tip(stages, &self.shift, &mut states, |k, co_state| {
            smoother::through_stage(&stages[k], measured, co_state, out);
        });
    }

    /// Lambda on both sides of every row, by one base-to-tip sweep at the first call.
    pub(super) fn co_state_covariances(&self) -> &Covariances<T> {
        self.co_states.get_or_init(|| {
            let unset = Symmetric6::filled(T::from_f64(f64::NAN));
            let mut outboard = vec![unset; self.shift.len()];
            let mut plus = vec![unset; self.nv()];
            let factor = (&self.shift[..], &self.measured[..]);
            dynamics::co_state_covariances(&self.system, factor, &mut outboard, |(_, row), lambda, _| {
                plus[row] = *lambda;
            });
            let mut minus = plus.clone();
            for (stage, outboard) in self.system.stages.iter().zip(outboard) {
                // Lambda^- of a row is Lambda^+ of the next one outward in its joint.
                let rows = stage.first_row..stage.first_row + stage.rows.count();
                minus[rows.clone()].rotate_left(1);
                minus[rows.end - 1] = outboard;
            }
            Covariances { minus, plus }
        })
    }

    /// D of each row, kg m^2 or kg (3.6).
    pub fn pivots(&self) -> impl Iterator<Item = T> + '_ {
        self.measured.iter().map(|m| m.pivot)
    }

    /// log det M = sum of log D(k).
    #[must_use]
    pub fn log_det(&self) -> f64 {
        self.pivots().map(|pivot| pivot.lane(0).ln()).sum()
    }
}

impl Scene {
    /// The factor of the mass matrix at `q`, with argument checks: see [`Factor`]. About 490 operations per joint with
    /// one axis in covariance form, at least 490 more in `auto`.
    ///
    /// # Errors
    ///
    /// An invalid configuration, and [`Error::SingularJoint`].
    pub fn factor(&self, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<Factor<f64>, Error> {
        self.model().simplifications.check_every_body_moves("scene")?;
        self.check_configuration("q", q)?;
        self.check_workspace(workspace)?;
        self.check_form(workspace)?;
        let (factor, monitor) = Factor::new(self.model(), workspace, q);
        self.check_pivots(workspace, monitor)?;
        Ok(factor)
    }
}
