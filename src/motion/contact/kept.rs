//! What a rollout keeps of the contacts of each state, beside q and qd.

/// Numbers of one contact in a recorded row: gap, slip velocity (3), force (3), impulse of impacts (3), state.
pub(in crate::motion) const RECORD: usize = 11;

/// How many numbers tell of a run.
const REPORT: usize = 8;

/// How many numbers are kept of a state with so many contacts: impulses that hold, impulses of impacts, what each does, what is report.
pub(in crate::motion) fn width(contacts: usize) -> usize {
    7 * contacts + REPORT
}

/// At the start of a run.
pub(in crate::motion) fn begin(kept: &mut [f64]) {
    kept.fill(0.0);
    if let Some((_, report)) = kept.split_last_chunk_mut::<REPORT>() {
        ContactReport::begin().write(report);
    }
}

/// What the steps of one state report of its contacts, since it began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactReport {
    /// The worst residual of a step: a velocity beside the largest free velocity of its contacts.
    pub residual: f64,
    /// Whether every step met the tolerance, 1e-10, or the rounding of its own numbers.
    pub converged: bool,
    /// Iterations of all solves.
    pub iterations: f64,
    /// Kinetic energy that impacts took, J: rebounds, and landings faster than what gravity gives in a step.
    pub lost_in_impacts: f64,
    /// What friction took, J.
    pub lost_in_friction: f64,
    /// The least part of a rebound with which the kinetic energy after the impact is at most that before it; 1 where nothing was reduced. Between impacts the
    /// integrator has an error of its own.
    pub expansion_kept: f64,
    /// The least part of an impulse with which the kinetic energy of an impact does not rise; below 1 only where a solve did not converge.
    pub impulse_kept: f64,
    /// The deepest point under a plane that a step's end was moved out of, m.
    pub depth: f64,
}

impl ContactReport {
    fn begin() -> Self {
        Self {
            residual: 0.0,
            converged: true,
            iterations: 0.0,
            lost_in_impacts: 0.0,
            lost_in_friction: 0.0,
            expansion_kept: 1.0,
            impulse_kept: 1.0,
            depth: 0.0,
        }
    }

    fn write(&self, to: &mut [f64; REPORT]) {
        *to = [
            self.residual,
            f64::from(u8::from(self.converged)),
            self.iterations,
            self.lost_in_impacts,
            self.lost_in_friction,
            self.expansion_kept,
            self.impulse_kept,
            self.depth,
        ];
    }

    fn read(
        &[residual, converged, iterations, impacts, friction, expansion_kept, impulse_kept, depth]: &[f64; REPORT],
    ) -> Self {
        Self {
            residual,
            converged: converged > 0.5,
            iterations,
            lost_in_impacts: impacts,
            lost_in_friction: friction,
            expansion_kept,
            impulse_kept,
            depth,
        }
    }

    /// Of the numbers that are kept of a state.
    pub(in crate::motion) fn of(kept: &[f64]) -> Option<Self> {
        kept.last_chunk().map(Self::read)
    }

    /// With those of a step.
    pub(super) fn add(kept: &mut [f64], step: &Self) {
        let Some(report) = kept.last_chunk_mut() else { return };
        let before = Self::read(report);
        let all = Self {
            residual: before.residual.max(step.residual),
            converged: before.converged && step.converged,
            iterations: before.iterations + step.iterations,
            lost_in_impacts: before.lost_in_impacts + step.lost_in_impacts,
            lost_in_friction: before.lost_in_friction + step.lost_in_friction,
            expansion_kept: before.expansion_kept.min(step.expansion_kept),
            impulse_kept: before.impulse_kept.min(step.impulse_kept),
            depth: before.depth.max(step.depth),
        };
        all.write(report);
    }

    /// Of a step in which nothing touched.
    pub(super) fn nothing() -> Self {
        Self::begin()
    }
}
