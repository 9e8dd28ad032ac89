//! Newton's method on the function of Alart and Curnier.

use super::law::{Cone, Limits};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// Compliance of the springs that are added to G in the matrix only, which make it regular for redundant rows.
pub(super) const PROXIMAL: f64 = 1e-8;

impl Cone {
    /// dF/dp on springs of the compliance `proximal`: X = 1 - r G', where each contact is open (no contribution), sticking
    /// (X in n and t) or sliding.
    fn slope(&self, p: &DVector<f64>, c: &DVector<f64>, limits: &Limits, proximal: f64) -> DMatrix<f64> {
        let (m, x) = (3 * self.len(), self.targets(p, c));
        let moved = DMatrix::from_fn(m, m, |i, j| {
            let (one, spring) = if i == j { (1.0, proximal * self.spring) } else { (0.0, 0.0) };
            one - self.lengths[i / 3] * (self.g[(i, j)] + spring)
        });
        let mut slope = DMatrix::identity(m, m);
        for i in 0..self.len() {
            let (at, mu) = (3 * i, self.friction[i]);
            let pressed = x[at + 2] > limits.least[i];
            let normal = if pressed { x[at + 2] } else { limits.least[i] };
            let tangent = Vector2::new(x[at], x[at + 1]);
            let length = tangent[0].hypot(tangent[1]);
            for j in 0..m {
                let dn = if pressed { moved[(at + 2, j)] } else { 0.0 };
                slope[(at + 2, j)] -= dn;
                let dt = Vector2::new(moved[(at, j)], moved[(at + 1, j)]);
                let change = if length <= mu * normal {
                    if normal > 0.0 { dt } else { Vector2::zeros() }
                } else {
                    let d = tangent / length;
                    d * (mu * dn) + (Matrix2::identity() - d * d.transpose()) * dt * (mu * normal / length)
                };
                slope[(at, j)] -= change[0];
                slope[(at + 1, j)] -= change[1];
            }
        }
        slope
    }

    /// One Newton step, projected onto the cones; `None` if the matrix is singular.
    pub(super) fn newton(
        &self,
        p: &DVector<f64>,
        c: &DVector<f64>,
        limits: &Limits,
        proximal: f64,
    ) -> Option<DVector<f64>> {
        let step = self.slope(p, c, limits, proximal).lu().solve(&self.defect(p, c, limits))?;
        let mut next = p - step;
        self.project(&mut next, &limits.least);
        next.iter().all(|x| x.is_finite()).then_some(next)
    }

    /// One Newton step, shortened to the point where the first normal impulse reaches its lower bound; returns the
    /// impulses and that contact. `None` if the matrix is singular.
    pub(super) fn newton_to_bound(
        &self,
        p: &DVector<f64>,
        c: &DVector<f64>,
        limits: &Limits,
        proximal: f64,
    ) -> Option<(DVector<f64>, Option<usize>)> {
        let step = -self.slope(p, c, limits, proximal).lu().solve(&self.defect(p, c, limits))?;
        let x = self.targets(p, c);
        let (mut part, mut first) = (1.0, None);
        for (i, &least) in limits.least.iter().enumerate().filter(|(i, least)| x[3 * i + 2] > **least) {
            let (above, change) = (p[3 * i + 2] - least, step[3 * i + 2]);
            if above > 0.0 && above + part * change < 0.0 {
                (part, first) = (-above / change, Some(i));
            }
        }
        let mut next = p + step * part;
        if let Some(i) = first {
            next[3 * i + 2] = limits.least[i];
        }
        self.project(&mut next, &limits.least);
        next.iter().all(|x| x.is_finite()).then_some((next, first))
    }
}
