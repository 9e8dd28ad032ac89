//! Newton's method on the function of Alart and Curnier.

use super::gram::{Blocks, Factor};
use super::law::{Cone, Limits};
use nalgebra::{DVector, Matrix2, Matrix3, Vector2};

/// Compliance of the springs that are added to G in the matrix only, which make it regular for redundant rows.
pub(super) const PROXIMAL: f64 = 1e-8;

/// The factor of the last Newton step with a matrix G on given springs, which a step with the same blocks A and B uses
/// again: contacts that stick or are open have the same ones in each step.
#[derive(Default)]
pub(super) struct Known(Vec<Blocks>, Option<Factor>);

impl Cone {
    /// The blocks A and B of each contact in dF/dp = A + B G: X = 1 - r G, where each contact is open (no
    /// contribution), sticking (X in n and t) or sliding. From the targets x.
    fn slope(&self, x: &DVector<f64>, limits: &Limits) -> Vec<Blocks> {
        let of = |i: usize| {
            let (at, mu, r) = (3 * i, self.friction[i], self.lengths[i]);
            let (mut a, mut b) = (Matrix3::identity(), Matrix3::zeros());
            let pressed = x[at + 2] > limits.least[i];
            let normal = if pressed { x[at + 2] } else { limits.least[i] };
            if pressed {
                (a[(2, 2)], b[(2, 2)]) = (0.0, r);
            }
            let tangent = Vector2::new(x[at], x[at + 1]);
            let length = tangent[0].hypot(tangent[1]);
            if length <= mu * normal {
                if normal > 0.0 {
                    (a[(0, 0)], a[(1, 1)], b[(0, 0)], b[(1, 1)]) = (0.0, 0.0, r, r);
                }
            } else {
                let d = tangent / length;
                let across = (Matrix2::identity() - d * d.transpose()) * (mu * normal / length);
                for row in 0..2 {
                    for column in 0..2 {
                        a[(row, column)] -= across[(row, column)];
                        b[(row, column)] = r * across[(row, column)];
                    }
                    if pressed {
                        (a[(row, 2)], b[(row, 2)]) = (-mu * d[row], r * mu * d[row]);
                    }
                }
            }
            (a, b)
        };
        (0..self.len()).map(of).collect()
    }

    /// The Newton step from p with the targets x, on springs of the compliance `proximal`; `None` if the matrix is
    /// singular.
    fn newton_step(
        &self,
        (p, x): (&DVector<f64>, &DVector<f64>),
        limits: &Limits,
        (proximal, known): (f64, &mut Known),
    ) -> Option<DVector<f64>> {
        let (blocks, Known(before, factor)) = (self.slope(x, limits), known);
        if *before != blocks {
            *factor = self.g.factor(&blocks, proximal * self.spring);
            *before = blocks;
        }
        factor.as_ref()?.solve(&self.defect(p, x, limits))
    }

    /// One Newton step, projected onto the cones; `None` if the matrix is singular.
    pub(super) fn newton(
        &self,
        p: &DVector<f64>,
        c: &DVector<f64>,
        limits: &Limits,
        (proximal, known): (f64, &mut Known),
    ) -> Option<DVector<f64>> {
        let step = self.newton_step((p, &self.targets(p, c)), limits, (proximal, known))?;
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
        let x = self.targets(p, c);
        let step = -self.newton_step((p, &x), limits, (proximal, &mut Known::default()))?;
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
