//! The sweeps on numbers that trace and count, each compiled once: the code is long, and who traces and who counts need the same.

use super::auto::{self, Watched};
use super::sweeps::{self, InverseColumns, Look, MassColumns, SweepModel, SweepScratch};
use crate::model::Model;
use crate::scalar::Traced;
use nalgebra::Vector6;

/// What the sweeps read.
pub(crate) type Scene<'a> = (&'a Model<Traced>, &'a SweepModel<Traced>);

type State<'a> = (&'a [Traced], &'a [Traced], &'a [Traced]);

/// As [`sweeps::forward_dynamics`].
#[inline(never)]
pub(crate) fn forward_dynamics(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: State<'_>,
    wrenches: &[Vector6<Traced>],
    qdd: &mut [Traced],
) {
    sweeps::forward_dynamics::<Traced, Traced>(scene, scratch, state, wrenches, qdd);
}

/// As [`sweeps::forward_dynamics_watched`].
#[inline(never)]
fn look(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: State<'_>,
    wrenches: &[Vector6<Traced>],
    qdd: &mut [Traced],
) -> Look<Traced> {
    sweeps::forward_dynamics_watched::<Traced, Traced>(scene, scratch, state, wrenches, qdd)
}

/// The same, and [`Watched::margin`] of a single look.
pub(crate) fn forward_dynamics_and_margin(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: State<'_>,
    qdd: &mut [Traced],
) -> Traced {
    Watched::once(look(scene, scratch, state, &[], qdd)).margin()
}

/// As [`auto::watched_in_sweeps`]; whether the digits were kept.
pub(crate) fn forward_dynamics_watched(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: State<'_>,
    wrenches: &[Vector6<Traced>],
    qdd: &mut [Traced],
) -> bool {
    let first = Watched::once(look(scene, scratch, state, wrenches, qdd));
    if first.kept(0) {
        return true;
    }
    scratch.exchange_probes();
    let second = look(scene, scratch, state, wrenches, qdd);
    scratch.exchange_probes();
    first.and(&second).kept(0)
}

/// As [`sweeps::forward_dynamics_by_roots`]; whether its pivots are clear of rounding.
#[inline(never)]
pub(crate) fn forward_dynamics_by_roots(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: State<'_>,
    wrenches: &[Vector6<Traced>],
    qdd: &mut [Traced],
) -> bool {
    let (pivots, reach) = sweeps::forward_dynamics_by_roots::<Traced, Traced>(scene, scratch, state, wrenches, qdd);
    pivots.clear(0) && reach.clear(0)
}

/// As [`sweeps::inverse_dynamics`].
#[inline(never)]
pub(crate) fn inverse_dynamics(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: (&[Traced], &[Traced], Option<&[Traced]>),
    wrenches: &[Vector6<Traced>],
    tau: &mut [Traced],
) {
    sweeps::inverse_dynamics::<Traced, Traced>(scene, scratch, state, wrenches, tau);
}

/// As [`sweeps::mass_matrix`].
#[inline(never)]
pub(crate) fn mass_matrix(scene: Scene<'_>, scratch: &mut SweepScratch<Traced>, q: &[Traced], out: &mut [Traced]) {
    let mut columns: MassColumns<Traced, Traced> = MassColumns::new();
    columns.prepare(scene.0, scene.1);
    sweeps::mass_matrix::<Traced, Traced, false>(scene, (scratch, &mut columns), q, out);
}

/// As [`sweeps::factor`]; whether its pivots are clear of rounding.
#[inline(never)]
pub(crate) fn factor(scene: Scene<'_>, scratch: &mut SweepScratch<Traced>, q: &[Traced]) -> bool {
    sweeps::factor::<Traced, Traced>(scene, scratch, q).clear(0)
}

/// As [`auto::factor_watched_in_sweeps`].
#[inline(never)]
pub(crate) fn factor_watched(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    q: &[Traced],
    estimates: &mut [Traced],
) -> Watched<Traced> {
    auto::factor_watched_in_sweeps::<Traced, Traced>(scene, scratch, q, estimates)
}

/// M^-1 of the factor in the scratch, as [`sweeps::multiplied_out`].
#[inline(never)]
pub(crate) fn multiplied_out(scene: Scene<'_>, scratch: &SweepScratch<Traced>, out: &mut [Traced]) {
    let mut columns: InverseColumns<Traced, Traced> = InverseColumns::new();
    columns.prepare(scene.0, scene.1);
    sweeps::multiplied_out::<Traced, Traced, false>(scene, scratch, &mut columns, out);
}

/// The innovations with the factor in the scratch, as [`sweeps::innovations_of_factor`].
#[inline(never)]
pub(crate) fn innovations_of_factor(
    scene: Scene<'_>,
    scratch: &mut SweepScratch<Traced>,
    state: State<'_>,
    wrenches: &[Vector6<Traced>],
    innovations: &mut [Traced],
) {
    sweeps::innovations_of_factor::<Traced, Traced>(scene, scratch, state, wrenches, innovations);
}

/// The smoother with the factor in the scratch, as [`sweeps::smooth`].
#[inline(never)]
pub(crate) fn smooth(scene: Scene<'_>, scratch: &mut SweepScratch<Traced>, estimates: &mut [Traced]) {
    sweeps::smooth(scene, scratch, estimates);
}
