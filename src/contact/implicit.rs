//! The contact law in the mode of a solution: its equations, their derivatives, and Newton's method in fixed modes.
//!
//! In a mode, the impulse p and the velocity u = G p + c of a contact satisfy three smooth equations F(p, u) = 0, here
//! in N s, with r as in [`Cone::lengths`], x = p - r u, and the direction d = `x_t` / |`x_t`|, which is that of -`u_t`:
//!
//! ```text
//! open                  p = 0
//! normal, pressed       r u_n = 0
//! normal, at its bound  p_n - a = 0
//! tangent, sticking     r u_t = 0
//! tangent, sliding      p_t - mu p_n d = 0
//! ```
//!
//! The derivatives of p follow from (A + B G) dp = -(B dc + `F_mu` dmu + `F_a` da) with A = dF/dp and B = dF/du (the
//! implicit function theorem). If G is singular, only J* p is unique; p is then that of equal springs at the contacts,
//! the limit for eps to 0 of A + B (G + eps s), which is regular, with one compliance s. In this limit
//!
//! ```text
//! (A + B G + eps B s)^-T = P/eps + D + ...,     p = p0 + eps p1 + ...,     (A + B G) p1 = -B s p0
//! ```
//!
//! so that a change of G has the term (P `p_bar`)* B dG p1 in addition to those at p0: the null space of G turns, and p
//! with it ([`Turning`]). The rows of P are those of velocities that vanish, with constant A and B.
//!
//! On springs, a contact that sticks at the boundary of its cone slides by a velocity of the size eps: A and B of order
//! zero can fail to determine the limit then. The derivatives are those of sliding, and if that is singular too, those
//! on springs with a small eps ([`Cone::at_boundary`]).

use super::gram::add_rows;
use super::held::Held;
use super::law::{Cone, Limits};
use super::newton::PROXIMAL;
use nalgebra::{DMatrix, DVector, Dyn, LU, Matrix2, Matrix3, Vector2, Vector3};

/// Largest number of Newton steps in fixed modes, and the factor by which each must reduce the residual.
const STEPS: usize = 6;
const FALLS: f64 = 0.5;

/// Compliance of the springs eps, relative to its unit, and the number of corrections that remove their error from a
/// solution or from P.
const SPRINGS: f64 = 1e-6;
const CORRECTIONS: usize = 3;

/// Compliance of the springs for contacts at the boundary of another mode, and the distance from it relative to the
/// largest free velocity.
const STIFF: f64 = 1e-7;
const AT_BOUNDARY: f64 = 1e-9;

/// A contact that sticks is at the boundary at this distance from it, relative to its friction.
const BESIDE: f64 = 1e-8;

/// Largest number of Newton steps on these springs.
const STIFF_STEPS: usize = 30;

/// A projection P below this fraction of the cotangent is rounding: the impulses are unique.
const UNIQUE: f64 = 1e-10;

/// The normal equation of a contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Normal {
    /// No contact force.
    Open,
    /// The normal velocity is zero.
    Pressed,
    /// The normal impulse is at its lower bound a > 0, in the expansion phase of an impact.
    AtBound,
}

/// The case of the law in which a contact is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Mode {
    pub normal: Normal,
    /// True if the contact slides, or has no friction.
    pub slides: bool,
}

/// The linearized equations of all contacts.
#[derive(Debug, Clone)]
pub(crate) struct Linearization {
    /// B: blocks of dF/du.
    pub(super) by_velocity: Vec<Matrix3<f64>>,
    /// dF/dmu of each contact.
    pub(super) by_friction: Vec<Vector3<f64>>,
    /// dF/da of each contact, an entry of its normal equation.
    pub(super) by_least: Vec<f64>,
    /// dF by a relative change of the energies of each contact, in the relaxed law.
    pub(super) by_energy: Vec<Vector3<f64>>,
    /// A + B G.
    pub(super) matrix: DMatrix<f64>,
    /// The compliance s and the impulses.
    pub(super) spring: f64,
    pub(super) impulses: DVector<f64>,
}

/// The change of redundant impulses by the null space of G that turns, the bilinear form z* dG s.
#[derive(Debug, Clone)]
pub(crate) struct Turning {
    /// Cotangents of velocities in the null space, J* z = 0.
    pub z: DVector<f64>,
    /// The impulses p1, N s.
    pub s: DVector<f64>,
}

/// Cotangents of the data of a problem, for a cotangent of its impulses.
#[derive(Debug, Clone)]
pub(crate) struct LawCotangents {
    /// Of the velocities u at fixed impulses.
    pub velocities: DVector<f64>,
    /// Of the coefficient of friction of each contact.
    pub friction: Vec<f64>,
    /// Of the lower bound a of each normal impulse.
    pub least: Vec<f64>,
    /// Of a relative change of the energies of each contact, in the relaxed law.
    pub energy: Vec<f64>,
    /// `None` if the impulses are unique.
    pub turning: Option<Turning>,
}

impl Cone {
    /// The mode of each contact in which its target x is.
    pub fn modes(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Vec<Mode> {
        self.modes_beside(p, c, limits, 0.0)
    }

    /// As [`Cone::modes`], where contacts slide that stick at this distance from the boundary, relative to the
    /// friction.
    fn modes_beside(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits, distance: f64) -> Vec<Mode> {
        let x = self.targets(p, c);
        let of = |i: usize| {
            let least = limits.least[i];
            let normal = match x[3 * i + 2] {
                pressed if pressed > least => Normal::Pressed,
                _ if least > 0.0 => Normal::AtBound,
                _ => Normal::Open,
            };
            let bound = self.friction[i] * x[3 * i + 2].max(least);
            Mode { normal, slides: !(x[3 * i].hypot(x[3 * i + 1]) < bound * (1.0 - distance)) }
        };
        (0..self.len()).map(of).collect()
    }

    /// Distance of each contact from another mode, m/s: of its target x to the nearest boundary of its case, over r.
    pub fn margins(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Vec<f64> {
        let x = self.targets(p, c);
        let of = |i: usize| {
            let (least, normal) = (limits.least[i], x[3 * i + 2]);
            let bound = self.friction[i] * normal.max(least);
            let to_normal = (normal - least).abs();
            let to_tangent = (x[3 * i].hypot(x[3 * i + 1]) - bound).abs();
            let slips = self.friction[i] > 0.0 && normal.max(least) > 0.0;
            (if slips { to_normal.min(to_tangent) } else { to_normal }) / self.lengths[i]
        };
        (0..self.len()).map(of).collect()
    }

    /// The same contacts on stiff springs, with the impulses that Newton's method finds from `p`; `None` if it does not
    /// converge.
    pub(super) fn on_stiff_springs(
        &self,
        p: &DVector<f64>,
        c: &DVector<f64>,
        limits: &Limits,
    ) -> Option<(Self, DVector<f64>)> {
        let (springs, mut found) = (self.on_springs(STIFF), p.clone());
        // Rounding decides whether a contact sticks at the boundary; on springs it slides.
        let mut modes = springs.modes_beside(&found, c, limits, BESIDE);
        for _ in 0..STIFF_STEPS {
            if springs.residual(&found, c, limits) <= springs.floor(&found, c, limits) {
                return Some((springs, found));
            }
            // Not [`Cone::newton`], which projects onto the cones and then does not converge for some contacts.
            let defect = springs.defect_in(&modes, &found, c, limits);
            found -= springs.linearized(&modes, &found, c).matrix.lu().solve(&defect)?;
            modes = springs.modes(&found, c, limits);
        }
        None
    }

    /// As [`Cone::on_stiff_springs`] if the impulses are redundant and a contact with an impulse is at the boundary of
    /// another mode; else `None`.
    pub fn at_boundary(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Option<(Self, DVector<f64>)> {
        let margins = self.margins(p, c, limits);
        let near = (0..self.len()).any(|i| p[3 * i + 2] > 0.0 && margins[i] <= AT_BOUNDARY * c.amax());
        if near && Held::of(self).is_none() { self.on_stiff_springs(p, c, limits) } else { None }
    }

    /// F in the given modes, N s.
    fn defect_in(&self, modes: &[Mode], p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> DVector<f64> {
        let (u, x) = (self.velocities(p, c), self.targets(p, c));
        let mut defect = p.clone();
        for (i, mode) in modes.iter().enumerate().filter(|(_, mode)| mode.normal != Normal::Open) {
            let (at, r) = (3 * i, self.lengths[i]);
            match mode.normal {
                Normal::Pressed => defect[at + 2] = r * u[at + 2],
                _ => defect[at + 2] -= limits.least[i],
            }
            if mode.slides {
                let pull = direction(&x, i) * (self.friction[i] * p[at + 2]);
                defect[at] -= pull[0];
                defect[at + 1] -= pull[1];
            } else {
                defect[at] = r * u[at];
                defect[at + 1] = r * u[at + 1];
            }
        }
        defect
    }

    /// The equations in the given modes, linearized at impulses `p`.
    pub fn linearized(&self, modes: &[Mode], p: &DVector<f64>, c: &DVector<f64>) -> Linearization {
        let (m, x) = (3 * self.len(), self.targets(p, c));
        let mut by_velocity = vec![Matrix3::zeros(); self.len()];
        let mut by_friction = vec![Vector3::zeros(); self.len()];
        let by_least = modes.iter().map(|mode| if mode.normal == Normal::AtBound { -1.0 } else { 0.0 }).collect();
        let (mut matrix, g) = (DMatrix::zeros(m, m), self.g.dense());
        for (i, mode) in modes.iter().enumerate() {
            let (at, r, mu) = (3 * i, self.lengths[i], self.friction[i]);
            let (mut a, b) = (Matrix3::identity(), &mut by_velocity[i]);
            if mode.normal == Normal::Pressed {
                a[(2, 2)] = 0.0;
                b[(2, 2)] = r;
            }
            if mode.normal != Normal::Open && !mode.slides {
                (a[(0, 0)], a[(1, 1)]) = (0.0, 0.0);
                (b[(0, 0)], b[(1, 1)]) = (r, r);
            } else if mode.normal != Normal::Open && mu > 0.0 {
                let d = direction(&x, i);
                let length = x[at].hypot(x[at + 1]);
                // The change of d is that of x across it, over |x|.
                let across = (Matrix2::identity() - d * d.transpose()) * (mu * p[at + 2] / length);
                for row in 0..2 {
                    a[(row, 2)] = -mu * d[row];
                    for column in 0..2 {
                        a[(row, column)] -= across[(row, column)];
                        b[(row, column)] = r * across[(row, column)];
                    }
                }
                by_friction[i] = Vector3::new(-d[0], -d[1], 0.0) * p[at + 2];
            }
            add_rows(&g, i, (&a, b), &mut matrix);
        }
        let by_energy = vec![Vector3::zeros(); self.len()];
        let (spring, impulses) = (self.spring, p.clone());
        Linearization { by_velocity, by_friction, by_least, by_energy, matrix, spring, impulses }
    }

    /// Newton's method in the modes of `p`, until the residual no longer decreases; returns the impulses and their
    /// residual. `None` if the matrix is singular, or if the result is in other modes or has a larger residual.
    pub fn polished(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits) -> Option<(DVector<f64>, f64)> {
        let modes = self.modes(p, c, limits);
        let (best, residual) = self.polished_in(&modes, PROXIMAL, (p, c, limits))?;
        (self.modes(&best, c, limits) == modes).then_some((best, residual))
    }

    /// Newton's method in the given modes from `p`, until the residual no longer decreases; returns the impulses and
    /// their residual. `None` if the matrix is singular.
    fn polished_in(
        &self,
        modes: &[Mode],
        proximal: f64,
        (p, c, limits): (&DVector<f64>, &DVector<f64>, &Limits),
    ) -> Option<(DVector<f64>, f64)> {
        let (mut best, mut residual) = (p.clone(), self.residual(p, c, limits));
        for _ in 0..STEPS {
            if residual <= self.floor(&best, c, limits) {
                break;
            }
            let step = self.linearized(modes, &best, c).on_springs(proximal).lu();
            let next = &best - step.solve(&self.defect_in(modes, &best, c, limits))?;
            let left = self.residual(&next, c, limits);
            if !(left < residual) {
                break;
            }
            let slow = left > FALLS * residual;
            (best, residual) = (next, left);
            if slow {
                break;
            }
        }
        Some((best, residual))
    }

    /// The impulses on stiff springs, moved to those without springs; `None` if Newton's method does not converge.
    pub(super) fn shared_at_boundary(
        &self,
        p: &DVector<f64>,
        c: &DVector<f64>,
        limits: &Limits,
    ) -> Option<DVector<f64>> {
        let (springs, shared) = self.on_stiff_springs(p, c, limits)?;
        self.polished_in(&springs.modes(&shared, c, limits), STIFF, (&shared, c, limits)).map(|(p, _)| p)
    }
}

impl Linearization {
    /// A + B (G + eps s) for eps = `part`.
    fn on_springs(&self, part: f64) -> DMatrix<f64> {
        let mut matrix = self.matrix.clone();
        for (i, b) in self.by_velocity.iter().enumerate() {
            let mut own = matrix.fixed_view_mut::<3, 3>(3 * i, 3 * i);
            own += b * (part * self.spring);
        }
        matrix
    }

    /// True if the equations determine the impulses.
    pub fn is_regular(&self) -> bool {
        let ones = DVector::from_element(self.impulses.len(), 1.0);
        self.cotangents(&ones).is_some_and(|of| of.turning.is_none())
    }

    /// As [`Linearization::cotangents`] if the impulses are unique.
    pub fn cotangents_of_unique(&self, p_bar: &DVector<f64>) -> Option<LawCotangents> {
        let x = self.matrix.transpose().lu().solve(p_bar)?;
        x.iter().all(|x| x.is_finite()).then(|| self.of_solution(&-x, None))
    }

    /// Cotangents of the data for a cotangent `p_bar` of the impulses; `None` if the matrix is singular.
    ///
    /// With x = -D* `p_bar`, they are B* x, `F_mu`* x, `F_a`* x and so on.
    pub fn cotangents(&self, p_bar: &DVector<f64>) -> Option<LawCotangents> {
        let factor = self.on_springs(SPRINGS).transpose().lu();
        // P* p_bar is an eigenvector: each solve divides the other parts by their distance from the null space.
        let mut null = factor.solve(p_bar)? * SPRINGS;
        for _ in 0..CORRECTIONS {
            null = factor.solve(&(self.by_velocities(&null) * self.spring))? * SPRINGS;
        }
        let along = self.by_velocities(&null);
        let redundant = along.amax() * self.spring > UNIQUE * p_bar.amax();
        let turning = if redundant { Some(Turning { z: -&along, s: self.beside_springs()? }) } else { None };
        let right = if redundant { p_bar - along * self.spring } else { p_bar.clone() };
        let x = -corrected(&factor, &self.matrix.transpose(), &right)?;
        Some(self.of_solution(&x, turning))
    }

    fn of_solution(&self, x: &DVector<f64>, turning: Option<Turning>) -> LawCotangents {
        let velocities = self.by_velocities(x);
        let along = |by: &[Vector3<f64>]| -> Vec<f64> {
            by.iter().enumerate().map(|(i, by)| by.dot(&x.fixed_rows::<3>(3 * i))).collect()
        };
        let least = self.by_least.iter().enumerate().map(|(i, by)| by * x[3 * i + 2]).collect();
        let (friction, energy) = (along(&self.by_friction), along(&self.by_energy));
        LawCotangents { velocities, friction, least, energy, turning }
    }

    /// B* x.
    fn by_velocities(&self, x: &DVector<f64>) -> DVector<f64> {
        let mut product = DVector::zeros(x.len());
        for (i, b) in self.by_velocity.iter().enumerate() {
            product.fixed_rows_mut::<3>(3 * i).copy_from(&b.tr_mul(&x.fixed_rows::<3>(3 * i)));
        }
        product
    }

    /// p1, by which the impulses on springs differ from those without; `None` if the matrix is singular.
    fn beside_springs(&self) -> Option<DVector<f64>> {
        let mut right = self.impulses.clone();
        for (i, b) in self.by_velocity.iter().enumerate() {
            let rows = b * right.fixed_rows::<3>(3 * i) * -self.spring;
            right.fixed_rows_mut::<3>(3 * i).copy_from(&rows);
        }
        corrected(&self.on_springs(SPRINGS).lu(), &self.matrix, &right)
    }

    /// Changes of the impulses for changes of the velocities at fixed impulses; `None` if the matrix is singular.
    #[cfg(test)]
    pub fn tangent(&self, dc: &DVector<f64>) -> Option<DVector<f64>> {
        let mut right = DVector::zeros(dc.len());
        for (i, b) in self.by_velocity.iter().enumerate() {
            right.fixed_rows_mut::<3>(3 * i).copy_from(&(-b * dc.fixed_rows::<3>(3 * i)));
        }
        corrected(&self.on_springs(SPRINGS).lu(), &self.matrix, &right)
    }
}

/// The unit direction of the tangential target of contact `i`; zero if it has none.
fn direction(x: &DVector<f64>, i: usize) -> Vector2<f64> {
    let tangent = Vector2::new(x[3 * i], x[3 * i + 1]);
    tangent.try_normalize(0.0).unwrap_or_else(Vector2::zeros)
}

/// The solution of the equations with springs, corrected by residuals of those without springs.
fn corrected(factor: &LU<f64, Dyn, Dyn>, matrix: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let mut x = factor.solve(right)?;
    for _ in 0..CORRECTIONS {
        x += factor.solve(&(right - matrix * &x))?;
    }
    x.iter().all(|x| x.is_finite()).then_some(x)
}

#[cfg(test)]
mod tests;
