//! The law of contacts as a function that is zero where it holds, and the nearest point of its cones.

use nalgebra::{DMatrix, DVector, Vector3};

/// G of some contacts and their coefficients of friction.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cone {
    /// J M^-1 J*, (3n x 3n).
    pub g: DMatrix<f64>,
    /// mu >= 0 of each contact.
    pub friction: Vec<f64>,
    /// r = 3 / trace `G_ii` of each: turns its velocity into an impulse.
    pub lengths: Vec<f64>,
}

/// What a problem has beside its free velocities.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Limits {
    /// The least normal impulse of each contact, N s.
    pub least: Vec<f64>,
    /// The velocity that residuals are solved beside, m/s.
    pub scale: f64,
}

impl Limits {
    /// Impulses from zero up, residuals beside the largest of these velocities.
    pub fn beside(c: &DVector<f64>) -> Self {
        let largest = c.amax();
        Self { least: vec![0.0; c.len() / 3], scale: if largest > 0.0 { largest } else { 1.0 } }
    }
}

/// What a contact does in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContactState {
    /// Nothing presses on it.
    Open,
    /// It is pressed, and the friction that holds it is below its bound.
    Sticking,
    /// It is pressed and slips, with friction at its bound; without friction, whether it slips or not.
    Sliding,
}

impl ContactState {
    /// What stands for it in recorded rows: 0 open, 1 sticking, 2 sliding.
    #[must_use]
    pub fn number(self) -> f64 {
        match self {
            Self::Open => 0.0,
            Self::Sticking => 1.0,
            Self::Sliding => 2.0,
        }
    }

    /// Of a number in a recorded row, if it stands for one.
    #[must_use]
    pub fn of(number: f64) -> Option<Self> {
        [Self::Open, Self::Sticking, Self::Sliding]
            .into_iter()
            .find(|state| state.number().to_bits() == number.to_bits())
    }
}

impl Cone {
    /// A problem of contacts that can all move.
    pub fn new(g: DMatrix<f64>, friction: Vec<f64>) -> Self {
        let trace = |i: usize| g[(3 * i, 3 * i)] + g[(3 * i + 1, 3 * i + 1)] + g[(3 * i + 2, 3 * i + 2)];
        let lengths = (0..friction.len()).map(|i| 3.0 / trace(i)).collect();
        Self { g, friction, lengths }
    }

    /// How many contacts.
    pub fn len(&self) -> usize {
        self.friction.len()
    }

    /// The same contacts on springs: `part` of 1/r more on the diagonal.
    pub fn on_springs(&self, part: f64) -> Self {
        let mut springs = self.clone();
        for i in 0..springs.g.nrows() {
            springs.g[(i, i)] += part / self.lengths[i / 3];
        }
        springs
    }

    /// G p + c.
    pub fn velocities(&self, p: &DVector<f64>, c: &DVector<f64>) -> DVector<f64> {
        &self.g * p + c
    }

    /// p - r u of every contact.
    pub fn targets(&self, p: &DVector<f64>, c: &DVector<f64>) -> DVector<f64> {
        let mut x = self.velocities(p, c);
        for (i, x) in x.iter_mut().enumerate() {
            *x = p[i] - self.lengths[i / 3] * *x;
        }
        x
    }

    /// Alart and Curnier's F, N s, zero where the law holds and nowhere else: `F_n` = `p_n` - max(a, `x_n`), `F_t` = `p_t` - (`x_t` cut to the disc
    /// of radius mu max(a, `x_n`)), x = p - r u.
    pub fn defect(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        let x = self.targets(p, c);
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

    /// What each contact does: which part of F its target x is in.
    pub fn states(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Vec<ContactState> {
        let x = self.targets(p, c);
        let of = |i: usize| {
            let bound = self.friction[i] * x[3 * i + 2].max(limits.least[i]);
            if x[3 * i + 2] <= 0.0 && limits.least[i] == 0.0 {
                ContactState::Open
            } else if x[3 * i].hypot(x[3 * i + 1]) < bound {
                ContactState::Sticking
            } else {
                ContactState::Sliding
            }
        };
        (0..self.len()).map(of).collect()
    }

    /// The largest |`F_i`| / `r_i` over the scale.
    pub fn residual(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> f64 {
        let defect = self.defect(p, c, limits);
        let of = |i: usize| defect.fixed_rows::<3>(3 * i).norm() / self.lengths[i] / limits.scale;
        (0..self.len()).map(of).fold(0.0, |worst, of| if of > worst || of.is_nan() { of } else { worst })
    }

    /// What rounding of G p + c alone leaves of the residual. Where a contact slides, friction follows the normal impulse: mu times as much of its
    /// normal velocity.
    pub fn floor(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> f64 {
        let terms = self.g.abs() * p.abs() + c.abs();
        let x = self.targets(p, c);
        let of = |i: usize| {
            let (at, mu) = (3 * i, self.friction[i]);
            let slides = x[at].hypot(x[at + 1]) > mu * x[at + 2].max(limits.least[i]);
            let factor = if slides { mu.max(1.0) } else { 1.0 };
            terms[at].max(terms[at + 1]).max(factor * terms[at + 2])
        };
        let largest = (0..self.len()).map(of).fold(0.0, f64::max);
        4.0 * f64::EPSILON * largest / limits.scale
    }

    /// Every contact's impulse to the nearest point of its cone.
    pub fn project(&self, p: &mut DVector<f64>, least: &[f64]) {
        for (i, (&mu, &least)) in self.friction.iter().zip(least).enumerate() {
            let nearest = nearest(&p.fixed_rows::<3>(3 * i).into(), mu, least);
            p.fixed_rows_mut::<3>(3 * i).copy_from(&nearest);
        }
    }
}

/// How much of a vector of some length is within a radius.
fn cut(radius: f64, length: f64) -> f64 {
    if length > radius { radius / length } else { 1.0 }
}

/// The nearest point of {|`x_t`| <= mu `x_n`, `x_n` >= a}, a >= 0; where a cuts the cone off, the nearest at that height.
pub(super) fn nearest(x: &Vector3<f64>, mu: f64, least: f64) -> Vector3<f64> {
    let length = x[0].hypot(x[1]);
    let inside = length <= mu * x[2];
    let normal = if inside { x[2] } else { ((mu * length + x[2]) / (1.0 + mu * mu)).max(0.0) };
    let normal = normal.max(least);
    let mut kept = cut(mu * normal, length);
    // The last rounding must not leave the cone.
    while kept > 0.0 && kept < 1.0 && (kept * x[0]).hypot(kept * x[1]) > mu * normal {
        kept *= 1.0 - f64::EPSILON;
    }
    Vector3::new(kept * x[0], kept * x[1], normal)
}
