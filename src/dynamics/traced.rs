//! The passes on scalars that record or count operations, on the kernels' model of a scene: what codegen writes and the
//! reports count.

use super::auto::{self, ErrorEstimate};
use super::forces::Motion;
use super::sweeps::{self, InverseColumns, MassColumns, SweepModel, SweepScratch, general};
use crate::model::Model;
use crate::scalar::Traced;
use nalgebra::Vector6;

type State<'a> = (&'a [Traced], &'a [Traced], &'a [Traced]);

/// A scene as the sweeps read it, and its scratch.
pub(crate) struct TracedSweeps {
    pub model: Model<Traced>,
    pub sweeps: SweepModel<Traced>,
    pub scratch: SweepScratch<Traced>,
}

impl TracedSweeps {
    pub fn new(model: &Model<f64>) -> Self {
        Self::accepting(model, None)
    }

    /// With a tolerance other than the default.
    pub fn accepting(model: &Model<f64>, tolerance: Option<f64>) -> Self {
        let (sweeps, model) = (SweepModel::new(model), model.cast());
        let scratch = SweepScratch::new(&model, &sweeps).accepting(tolerance);
        Self { model, sweeps, scratch }
    }

    fn passes(&mut self) -> ((&Model<Traced>, &SweepModel<Traced>), &mut SweepScratch<Traced>) {
        ((&self.model, &self.sweeps), &mut self.scratch)
    }

    /// As [`general::forward_dynamics`].
    pub fn forward_dynamics(&mut self, state: State<'_>, wrenches: &[Vector6<Traced>], qdd: &mut [Traced]) {
        let (scene, scratch) = self.passes();
        general::forward_dynamics(scene, scratch, state, wrenches, qdd);
    }

    /// Forward dynamics, and [`ErrorEstimate::margin`] of the first test vector.
    pub fn forward_dynamics_and_margin(&mut self, state: State<'_>, qdd: &mut [Traced]) -> Traced {
        let (scene, scratch) = self.passes();
        let terms = general::forward_dynamics_with_estimate(scene, scratch, state, &[], qdd);
        ErrorEstimate::of_one_vector(terms, scratch.accepted_square).margin()
    }

    /// As [`auto::estimated`]. Returns whether the error estimate meets the
    /// tolerance.
    pub fn forward_dynamics_with_estimate(
        &mut self,
        state: State<'_>,
        wrenches: &[Vector6<Traced>],
        qdd: &mut [Traced],
    ) -> bool {
        let (scene, scratch) = self.passes();
        auto::estimated(scene, scratch, state, wrenches, qdd).is_accepted(0)
    }

    /// As [`general::forward_dynamics_by_roots`]. Returns whether its pivots are clear of rounding.
    pub fn forward_dynamics_by_roots(
        &mut self,
        state: State<'_>,
        wrenches: &[Vector6<Traced>],
        qdd: &mut [Traced],
    ) -> bool {
        let (scene, scratch) = self.passes();
        let (pivots, reach) = general::forward_dynamics_by_roots(scene, scratch, state, wrenches, qdd);
        pivots.clear(0) && reach.clear(0)
    }

    /// As [`general::inverse_dynamics`].
    pub fn inverse_dynamics(
        &mut self,
        (q, qd, qdd): (&[Traced], &[Traced], Option<&[Traced]>),
        wrenches: &[Vector6<Traced>],
        tau: &mut [Traced],
    ) {
        let (scene, scratch) = self.passes();
        general::inverse_dynamics(scene, scratch, Motion { q, qd, qdd, wrenches }, tau);
    }

    /// As [`general::mass_matrix`].
    pub fn mass_matrix(&mut self, q: &[Traced], out: &mut [Traced]) {
        let (scene, scratch) = self.passes();
        general::mass_matrix(scene, (scratch, &mut MassColumns::new()), q, out);
    }

    /// As [`general::factor`]. Returns whether its pivots are clear of rounding.
    pub fn factor(&mut self, q: &[Traced]) -> bool {
        let (scene, scratch) = self.passes();
        general::factor(scene, scratch, q).clear(0)
    }

    /// As [`general::factor_with_estimate`].
    pub fn factor_with_estimate(&mut self, q: &[Traced], estimates: &mut [Traced]) -> ErrorEstimate<Traced> {
        let (scene, scratch) = self.passes();
        auto::estimated_factor(scene, scratch, q, estimates)
    }

    /// M^-1 of the factor in the scratch, as [`sweeps::multiplied_out`].
    #[inline(never)]
    pub fn multiplied_out(&self, out: &mut [Traced]) {
        let Self { model, sweeps, scratch } = self;
        let mut columns: InverseColumns<Traced, Traced> = InverseColumns::new();
        columns.prepare(model, sweeps);
        sweeps::multiplied_out::<Traced, Traced, false>((model, sweeps), scratch, &mut columns, out);
    }

    /// The innovations of a state with the factor in the scratch (4.2).
    pub fn innovations_of_factor(
        &mut self,
        (q, qd, tau): State<'_>,
        wrenches: &[Vector6<Traced>],
        innovations: &mut [Traced],
    ) {
        let (scene, scratch) = self.passes();
        general::forces::<_, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches });
        general::innovations::<_, true>(scene, scratch, tau, innovations);
    }

    /// As [`general::smooth`].
    pub fn smooth(&mut self, estimates: &mut [Traced]) {
        let (scene, scratch) = self.passes();
        general::smooth(scene, scratch, estimates);
    }
}
