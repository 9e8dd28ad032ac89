//! Contact data that a rollout stores per state in addition to q and qd.

use crate::contact::ContactState;

/// Values per contact in a recorded row: gap, slip velocity (3), force on the first link (3), impulse of impacts (3),
/// state.
pub(in crate::motion) const RECORD: usize = 11;

/// Number of values of a report.
const REPORT: usize = 11;

/// Number of values stored per state: persistent impulses, impulses of impacts, contact states, and the report.
pub(in crate::motion) fn width(contacts: usize) -> usize {
    7 * contacts + REPORT
}

/// Initializes the values at the start of a run.
pub(in crate::motion) fn begin(kept: &mut [f64]) {
    kept.fill(0.0);
    if let Some((_, report)) = kept.split_last_chunk_mut::<REPORT>() {
        *report = ContactReport::default().values();
    }
}

/// The first blocks of the values of a state.
const BLOCKS: [usize; 3] = [3, 3, 1];

/// Copies the values of a state with `named` contacts into those with `all`.
pub(super) fn widen(kept: &[f64], named: usize, all: usize, to: &mut Vec<f64>) {
    to.clear();
    let mut from = 0;
    for block in BLOCKS {
        to.extend_from_slice(&kept[from..from + block * named]);
        to.resize(to.len() + block * (all - named), ContactState::Open.number());
        from += block * named;
    }
    to.extend_from_slice(&kept[from..]);
}

/// Copies the values of a state with `all` contacts into those with `named`.
pub(super) fn narrow(kept: &[f64], all: usize, named: usize, to: &mut [f64]) {
    let (mut from, mut at) = (0, 0);
    for block in BLOCKS {
        to[at..at + block * named].copy_from_slice(&kept[from..from + block * named]);
        (from, at) = (from + block * all, at + block * named);
    }
    to[at..].copy_from_slice(&kept[from..]);
}

/// True if a contact acted in the last step.
pub(super) fn acts(kept: &[f64], contacts: usize, contact: usize) -> bool {
    kept[6 * contacts + contact].to_bits() != ContactState::Open.number().to_bits()
}

/// The indices of the energies dissipated in impacts and by friction in `len` values of a state.
pub(super) fn dissipated(len: usize) -> std::ops::Range<usize> {
    len - REPORT + 3..len - REPORT + 5
}

/// The first contact that acted in the last step.
pub(super) fn acting(kept: &[f64], contacts: usize) -> Option<usize> {
    (0..contacts).find(|&contact| acts(kept, contacts, contact))
}

/// Diagnostics of the contacts of one state, accumulated since it began.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ContactReport {
    /// Largest residual of a step: a velocity relative to the largest free velocity of the contacts.
    pub residual: f64,
    /// True if every step reached the tolerance of 1e-10, or the rounding error of its
    /// values.
    pub converged: bool,
    /// Number of iterations of all solves.
    pub iterations: f64,
    /// Kinetic energy dissipated in impacts, J: in rebounds, in landings of contacts that do not rest at the start of
    /// the step, and in jams whose impulse accelerates the slip. With smoothing, the work against normal forces, which
    /// can be negative.
    pub lost_in_impacts: f64,
    /// Energy dissipated by friction, J; not negative.
    pub lost_in_friction: f64,
    /// Smallest factor applied to a rebound so that an impact does not increase the kinetic energy; 1 if none was
    /// reduced. Between impacts the integrator has an error of its own.
    pub expansion_kept: f64,
    /// Smallest factor applied to an impulse so that an impact does not increase the kinetic energy; below 1 only if a
    /// solve did not converge.
    pub impulse_kept: f64,
    /// Largest penetration of a surface that was corrected at the end of a step, m.
    pub depth: f64,
    /// With smoothing, the largest residual of the exact law in a step, as `residual`; zero without.
    pub bias: f64,
    /// With smoothing, the largest gap at the end of a step of a contact that carries at least its equal share of the
    /// weight of its tree, m; zero without.
    pub hover: f64,
    /// With smoothing, the largest slip velocity at the end of a step of a contact that is reported as sticking, m/s;
    /// zero without.
    pub creep: f64,
}

/// The values at the start, and the function that adds a value of a step.
type Accumulated = (f64, fn(f64, f64) -> f64);
const SUM: Accumulated = (0.0, |sum, more| sum + more);
const MOST: Accumulated = (0.0, f64::max);
const LEAST: Accumulated = (1.0, f64::min);

/// The same of all values, in the order of the fields. A flag is 0 or 1.
const ACCUMULATED: [Accumulated; REPORT] = [MOST, LEAST, SUM, SUM, SUM, LEAST, LEAST, MOST, MOST, MOST, MOST];

impl Default for ContactReport {
    /// The report of a state without steps.
    fn default() -> Self {
        Self::read(&ACCUMULATED.map(|(start, _)| start))
    }
}

impl ContactReport {
    fn values(&self) -> [f64; REPORT] {
        [
            self.residual,
            f64::from(u8::from(self.converged)),
            self.iterations,
            self.lost_in_impacts,
            self.lost_in_friction,
            self.expansion_kept,
            self.impulse_kept,
            self.depth,
            self.bias,
            self.hover,
            self.creep,
        ]
    }

    fn read(
        &[residual, converged, iterations, impacts, friction, expansion_kept, impulse_kept, rest @ ..]: &[f64; REPORT],
    ) -> Self {
        let [depth, bias, hover, creep] = rest;
        Self {
            residual,
            converged: converged > 0.5,
            iterations,
            lost_in_impacts: impacts,
            lost_in_friction: friction,
            expansion_kept,
            impulse_kept,
            depth,
            bias,
            hover,
            creep,
        }
    }

    /// Reads the report from the stored values of a state.
    pub(in crate::motion) fn of(kept: &[f64]) -> Option<Self> {
        kept.last_chunk().map(Self::read)
    }

    /// Adds the report of a step.
    pub(super) fn add(kept: &mut [f64], step: &Self) {
        let Some(report) = kept.last_chunk_mut::<REPORT>() else { return };
        for ((all, (_, add)), value) in report.iter_mut().zip(ACCUMULATED).zip(step.values()) {
            *all = add(*all, value);
        }
    }
}
