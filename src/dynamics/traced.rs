//! The sweeps on numbers that trace and count, each compiled once: the code is long, and who traces and who counts need the same.

use super::auto::{self, Watched};
use super::sweeps::{self, InverseColumns, Look, MassColumns, SweepModel, SweepScratch};
use crate::model::Model;
use crate::scalar::Traced;
use nalgebra::Vector6;

type State<'a> = (&'a [Traced], &'a [Traced], &'a [Traced]);

/// A scene as the sweeps read it, and their scratch.
pub(crate) struct TracedSweeps {
    pub model: Model<Traced>,
    pub sweeps: SweepModel<Traced>,
    pub scratch: SweepScratch<Traced>,
}

impl TracedSweeps {
    pub fn new(model: &Model<f64>) -> Self {
        Self::accepting(model, None)
    }

    /// The same with another tolerance than the usual one.
    pub fn accepting(model: &Model<f64>, tolerance: Option<f64>) -> Self {
        let (sweeps, model) = (SweepModel::new(model), model.cast());
        let scratch = SweepScratch::new(&model, &sweeps).accepting(tolerance);
        Self { model, sweeps, scratch }
    }

    /// As [`sweeps::forward_dynamics`].
    #[inline(never)]
    pub fn forward_dynamics(&mut self, state: State<'_>, wrenches: &[Vector6<Traced>], qdd: &mut [Traced]) {
        let Self { model, sweeps, scratch } = self;
        sweeps::forward_dynamics::<Traced, Traced>((model, sweeps), scratch, state, wrenches, qdd);
    }

    /// As [`sweeps::forward_dynamics_watched`].
    #[inline(never)]
    fn look(&mut self, state: State<'_>, wrenches: &[Vector6<Traced>], qdd: &mut [Traced]) -> Look<Traced> {
        let Self { model, sweeps, scratch } = self;
        sweeps::forward_dynamics_watched::<Traced, Traced>((model, sweeps), scratch, state, wrenches, qdd)
    }

    /// The same, and [`Watched::margin`] of a single look.
    pub fn forward_dynamics_and_margin(&mut self, state: State<'_>, qdd: &mut [Traced]) -> Traced {
        Watched::once(self.look(state, &[], qdd), self.scratch.accepted_square).margin()
    }

    /// As [`auto::watched_in_sweeps`]; whether the digits were kept.
    pub fn forward_dynamics_watched(
        &mut self,
        state: State<'_>,
        wrenches: &[Vector6<Traced>],
        qdd: &mut [Traced],
    ) -> bool {
        let first = Watched::once(self.look(state, wrenches, qdd), self.scratch.accepted_square);
        if first.kept(0) {
            return true;
        }
        self.scratch.exchange_probes();
        let second = self.look(state, wrenches, qdd);
        self.scratch.exchange_probes();
        first.and(&second).kept(0)
    }

    /// As [`sweeps::forward_dynamics_by_roots`]; whether its pivots are clear of rounding.
    #[inline(never)]
    pub fn forward_dynamics_by_roots(
        &mut self,
        state: State<'_>,
        wrenches: &[Vector6<Traced>],
        qdd: &mut [Traced],
    ) -> bool {
        let Self { model, sweeps, scratch } = self;
        let (pivots, reach) =
            sweeps::forward_dynamics_by_roots::<Traced, Traced>((model, sweeps), scratch, state, wrenches, qdd);
        pivots.clear(0) && reach.clear(0)
    }

    /// As [`sweeps::inverse_dynamics`].
    #[inline(never)]
    pub fn inverse_dynamics(
        &mut self,
        state: (&[Traced], &[Traced], Option<&[Traced]>),
        wrenches: &[Vector6<Traced>],
        tau: &mut [Traced],
    ) {
        let Self { model, sweeps, scratch } = self;
        sweeps::inverse_dynamics::<Traced, Traced>((model, sweeps), scratch, state, wrenches, tau);
    }

    /// As [`sweeps::mass_matrix`].
    #[inline(never)]
    pub fn mass_matrix(&mut self, q: &[Traced], out: &mut [Traced]) {
        let Self { model, sweeps, scratch } = self;
        let mut columns: MassColumns<Traced, Traced> = MassColumns::new();
        columns.prepare(model, sweeps);
        sweeps::mass_matrix::<Traced, Traced, false>((model, sweeps), (scratch, &mut columns), q, out);
    }

    /// As [`sweeps::factor`]; whether its pivots are clear of rounding.
    #[inline(never)]
    pub fn factor(&mut self, q: &[Traced]) -> bool {
        let Self { model, sweeps, scratch } = self;
        sweeps::factor::<Traced, Traced>((model, sweeps), scratch, q).clear(0)
    }

    /// As [`auto::factor_watched_in_sweeps`].
    #[inline(never)]
    pub fn factor_watched(&mut self, q: &[Traced], estimates: &mut [Traced]) -> Watched<Traced> {
        let Self { model, sweeps, scratch } = self;
        auto::factor_watched_in_sweeps::<Traced, Traced>((model, sweeps), scratch, q, estimates)
    }

    /// M^-1 of the factor in the scratch, as [`sweeps::multiplied_out`].
    #[inline(never)]
    pub fn multiplied_out(&self, out: &mut [Traced]) {
        let Self { model, sweeps, scratch } = self;
        let mut columns: InverseColumns<Traced, Traced> = InverseColumns::new();
        columns.prepare(model, sweeps);
        sweeps::multiplied_out::<Traced, Traced, false>((model, sweeps), scratch, &mut columns, out);
    }

    /// M^-1 tau with the factor in the scratch, as [`sweeps::solve`].
    #[inline(never)]
    pub fn solve(&mut self, tau: &[Traced], estimates: &mut [Traced]) {
        let Self { model, sweeps, scratch } = self;
        sweeps::solve((model, sweeps), scratch, tau, estimates);
    }

    /// The innovations with the factor in the scratch, as [`sweeps::innovations_of_factor`].
    #[inline(never)]
    pub fn innovations_of_factor(
        &mut self,
        state: State<'_>,
        wrenches: &[Vector6<Traced>],
        innovations: &mut [Traced],
    ) {
        let Self { model, sweeps, scratch } = self;
        sweeps::innovations_of_factor::<Traced, Traced>((model, sweeps), scratch, state, wrenches, innovations);
    }

    /// The smoother with the factor in the scratch, as [`sweeps::smooth`].
    #[inline(never)]
    pub fn smooth(&mut self, estimates: &mut [Traced]) {
        let Self { model, sweeps, scratch } = self;
        sweeps::smooth((model, sweeps), scratch, estimates);
    }
}
