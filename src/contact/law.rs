//! The contact law as a function that vanishes for solutions, and the projection onto friction cones.

use super::gram::Gram;
use super::report::TOLERANCE;
use nalgebra::{DVector, Vector3};

/// A contact sticks if its slip, relative to the scale of the velocities, is below this. Impulses with errors within
/// the tolerance change the slip of a contact at its friction bound by a few times the tolerance.
const STICKS: f64 = 10.0 * TOLERANCE;

/// The Delassus matrix G of some contacts, and their coefficients of friction.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cone {
    /// J M^-1 J*, (3n x 3n).
    pub g: Gram,
    /// Coefficient of friction mu >= 0 of each contact.
    pub friction: Vec<f64>,
    /// r = 3 / trace `G_ii` of each contact, which converts velocities to impulses.
    pub lengths: Vec<f64>,
    /// Unit of the compliance of springs, the geometric mean of 1/r. It is the same for all rows, so that redundant
    /// contacts share their impulses as equal springs do.
    pub spring: f64,
}

/// Data of a problem in addition to its free velocities.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Limits {
    /// Lower bound of the normal impulse of each contact, N s.
    pub least: Vec<f64>,
    /// Velocity to which residuals are relative, m/s.
    pub scale: f64,
}

impl Limits {
    /// Nonnegative normal impulses, and residuals relative to the largest of these velocities.
    pub fn beside(c: &DVector<f64>) -> Self {
        let largest = c.amax();
        Self { least: vec![0.0; c.len() / 3], scale: if largest > 0.0 { largest } else { 1.0 } }
    }

    /// The limits of a step in which contacts have the velocities `free` without impulses: only c has to be removed,
    /// but the rounding errors are those of the larger velocities.
    pub fn of_step(c: &DVector<f64>, free: &DVector<f64>) -> Self {
        let beside = Self::beside(c);
        Self { scale: beside.scale.max(free.amax()), ..beside }
    }
}

/// State of a contact in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ContactState {
    /// No contact force.
    Open,
    /// Contact force, and a slip below 1e-9 of the velocity of the fastest contact.
    Sticking,
    /// Contact force with slip and friction at its bound; without friction, regardless of slip.
    Sliding,
}

impl ContactState {
    /// The number in recorded rows: 0 open, 1 sticking, 2 sliding.
    #[must_use]
    pub fn number(self) -> f64 {
        match self {
            Self::Open => 0.0,
            Self::Sticking => 1.0,
            Self::Sliding => 2.0,
        }
    }

    /// The state of a contact with a force: it sticks if its slip is small relative to the scale of the velocities.
    pub(crate) fn of_slip(slip: f64, scale: f64, friction: f64) -> Self {
        if friction > 0.0 && slip <= STICKS * scale { Self::Sticking } else { Self::Sliding }
    }

    /// The state for a number in a recorded row; `None` for any other number.
    #[must_use]
    pub fn of(number: f64) -> Option<Self> {
        [Self::Open, Self::Sticking, Self::Sliding]
            .into_iter()
            .find(|state| state.number().to_bits() == number.to_bits())
    }
}

impl Cone {
    /// A problem of contacts, each of which can move.
    pub fn new(g: impl Into<Gram>, friction: Vec<f64>) -> Self {
        let g = g.into();
        let lengths = (0..friction.len()).map(|i| 3.0 / g.diagonal(i).sum()).collect();
        Self::with_lengths(g, friction, lengths)
    }

    /// A problem of contacts with known r.
    pub fn with_lengths(g: Gram, friction: Vec<f64>, lengths: Vec<f64>) -> Self {
        #[allow(clippy::cast_precision_loss)] // a few contacts
        let mean = lengths.iter().map(|r| r.ln()).sum::<f64>() / lengths.len().max(1) as f64;
        Self { g, friction, lengths, spring: (-mean).exp() }
    }

    /// Number of contacts.
    pub fn len(&self) -> usize {
        self.friction.len()
    }

    /// The same contacts on equal springs, whose compliance is `part` of the unit.
    pub fn on_springs(&self, part: f64) -> Self {
        let g = self.g.softer(part * self.spring);
        Self { g, friction: self.friction.clone(), lengths: self.lengths.clone(), spring: self.spring }
    }

    /// Contact velocities G p + c.
    pub fn velocities(&self, p: &DVector<f64>, c: &DVector<f64>) -> DVector<f64> {
        self.g.times(p) + c
    }

    /// p - r u of every contact.
    pub fn targets(&self, p: &DVector<f64>, c: &DVector<f64>) -> DVector<f64> {
        let mut x = self.velocities(p, c);
        for (i, x) in x.iter_mut().enumerate() {
            *x = p[i] - self.lengths[i / 3] * *x;
        }
        x
    }

    /// The function F of Alart and Curnier, N s, which vanishes exactly for solutions of the law: `F_n` = `p_n` -
    /// max(a, `x_n`) and `F_t` = `p_t` - (`x_t` projected onto the disc of radius mu max(a, `x_n`)), for the targets x.
    pub fn defect(&self, p: &DVector<f64>, x: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        let mut defect = p.clone();
        for i in 0..self.len() {
            let normal = x[3 * i + 2].max(limits.least[i]);
            let length = x[3 * i].hypot(x[3 * i + 1]);
            let kept = cut(self.friction[i] * normal, length);
            defect[3 * i] -= kept * x[3 * i];
            defect[3 * i + 1] -= kept * x[3 * i + 1];
            defect[3 * i + 2] -= normal;
        }
        defect
    }

    /// State of each contact: open if its target x is below its plane; otherwise by its slip, because at the boundary
    /// of the cone the case of F in which x is depends on rounding.
    pub fn states(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Vec<ContactState> {
        let u = self.velocities(p, c);
        let of = |i: usize| {
            if p[3 * i + 2] - self.lengths[i] * u[3 * i + 2] <= 0.0 && limits.least[i] == 0.0 {
                return ContactState::Open;
            }
            ContactState::of_slip(u[3 * i].hypot(u[3 * i + 1]), limits.scale, self.friction[i])
        };
        (0..self.len()).map(of).collect()
    }

    /// The largest |`F_i`| / `r_i`, relative to the scale.
    pub fn residual(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> f64 {
        self.residual_at(p, &self.targets(p, c), limits)
    }

    /// As [`Cone::residual`], from the targets.
    pub fn residual_at(&self, p: &DVector<f64>, x: &DVector<f64>, limits: &Limits) -> f64 {
        let of = |i: usize| {
            let normal = x[3 * i + 2].max(limits.least[i]);
            let kept = cut(self.friction[i] * normal, x[3 * i].hypot(x[3 * i + 1]));
            let defect = [p[3 * i] - kept * x[3 * i], p[3 * i + 1] - kept * x[3 * i + 1], p[3 * i + 2] - normal];
            Vector3::from(defect).norm() / self.lengths[i] / limits.scale
        };
        (0..self.len()).map(of).fold(0.0, |worst, of| if of > worst || of.is_nan() { of } else { worst })
    }

    /// The residual caused by rounding errors of G p + c alone. For a sliding contact, friction adds mu times the error
    /// of the normal velocity.
    pub fn floor(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> f64 {
        self.floor_at(p, (c, &self.targets(p, c)), limits)
    }

    /// As [`Cone::floor`], from the targets.
    pub fn floor_at(&self, p: &DVector<f64>, (c, x): (&DVector<f64>, &DVector<f64>), limits: &Limits) -> f64 {
        let mut terms = c.abs();
        self.g.add_sizes(p, &mut terms);
        let of = |i: usize| {
            let (at, mu) = (3 * i, self.friction[i]);
            let slides = x[at].hypot(x[at + 1]) > mu * x[at + 2].max(limits.least[i]);
            let factor = if slides { mu.max(1.0) } else { 1.0 };
            terms[at].max(terms[at + 1]).max(factor * terms[at + 2])
        };
        let largest = (0..self.len()).map(of).fold(0.0, f64::max);
        4.0 * f64::EPSILON * largest / limits.scale
    }

    /// Projects the impulse of every contact onto its cone.
    pub fn project(&self, p: &mut DVector<f64>, least: &[f64]) {
        for (i, (&mu, &least)) in self.friction.iter().zip(least).enumerate() {
            let nearest = nearest(&p.fixed_rows::<3>(3 * i).into(), mu, least);
            p.fixed_rows_mut::<3>(3 * i).copy_from(&nearest);
        }
    }
}

/// The factor that shortens a vector of the given length to the radius.
fn cut(radius: f64, length: f64) -> f64 {
    if length > radius { radius / length } else { 1.0 }
}

/// The nearest point of the cone {|`x_t`| <= mu `x_n`, `x_n` >= a} with a >= 0. If the bound a is active, the nearest
/// point at that height.
pub(super) fn nearest(x: &Vector3<f64>, mu: f64, least: f64) -> Vector3<f64> {
    let length = x[0].hypot(x[1]);
    let inside = length <= mu * x[2];
    let normal = if inside { x[2] } else { ((mu * length + x[2]) / (1.0 + mu * mu)).max(0.0) };
    let normal = normal.max(least);
    let mut kept = cut(mu * normal, length);
    // Rounding must not leave the cone.
    while kept > 0.0 && kept < 1.0 && (kept * x[0]).hypot(kept * x[1]) > mu * normal {
        // A subnormal fraction equals its product with 1 - eps.
        kept = (kept * (1.0 - f64::EPSILON)).min(kept.next_down());
    }
    Vector3::new(kept * x[0], kept * x[1], normal)
}
