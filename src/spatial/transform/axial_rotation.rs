//! The rotation about z by a joint's angle.

use crate::scalar::Real;

/// Sine and cosine of a joint's angle, in its sense and with its offset.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxialRotation<T> {
    pub s: T,
    pub c: T,
}

impl<T: Real> AxialRotation<T> {
    /// By a constant angle, in every lane.
    #[inline(always)]
    pub fn splat(like: T, [s, c]: [T::Parameter; 2]) -> Self {
        Self { s: like.splat(s), c: like.splat(c) }
    }

    /// A turn by another angle after this one, given by its sine and cosine.
    #[inline(always)]
    pub fn and(self, [s, c]: [T; 2]) -> Self {
        Self { s: self.s.mul_add(c, self.c * s), c: (self.c * c).minus_product(self.s, s) }
    }

    /// The turn the other way.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        Self { s: -self.s, c: self.c }
    }

    /// The two entries that a rotation about z mixes.
    #[inline(always)]
    pub fn pair(self, x: T, y: T) -> (T, T) {
        let Self { s, c } = self;
        ((c * x).minus_product(s, y), s.mul_add(x, c * y))
    }

    /// c^2, s^2, s c: what the turn of a matrix is made of, ready before the matrix is.
    #[inline(always)]
    fn products(self) -> [T; 3] {
        let Self { s, c } = self;
        [c * c, s * s, s * c]
    }

    /// Rz X Rz^T of [[a, b], [b, d]].
    #[inline(always)]
    pub fn plane(self, (a, b, d): (T, T, T)) -> (T, T, T) {
        let [cc, ss, sc] = self.products();
        let twice = sc + sc;
        (
            cc.mul_add(a, ss * d).minus_product(twice, b),
            sc.mul_add(a - d, (cc - ss) * b),
            twice.mul_add(b, ss.mul_add(a, cc * d)),
        )
    }

    /// Rz X Rz^T of [[a, b], [e, d]], row by row.
    #[inline(always)]
    pub fn square(self, [a, b, e, d]: [T; 4]) -> [T; 4] {
        let [cc, ss, sc] = self.products();
        let (across, along) = (b + e, a - d);
        // What is made of two comes in last, to be waited for least.
        [
            cc.mul_add(a, ss * d).minus_product(sc, across),
            sc.mul_add(along, (cc * b).minus_product(ss, e)),
            sc.mul_add(along, (cc * e).minus_product(ss, b)),
            sc.mul_add(across, ss.mul_add(a, cc * d)),
        ]
    }
}
