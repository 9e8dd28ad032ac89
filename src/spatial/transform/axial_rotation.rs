//! The rotation about z by a joint angle.

use crate::scalar::Real;

/// Sine and cosine of a joint angle, including sign and constant offset.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxialRotation<T> {
    pub s: T,
    pub c: T,
}

impl<T: Real> AxialRotation<T> {
    /// A constant angle, in every lane.
    #[inline(always)]
    pub fn splat(like: T, [s, c]: [T::Parameter; 2]) -> Self {
        Self { s: like.splat(s), c: like.splat(c) }
    }

    /// This rotation followed by another, given by sine and cosine.
    #[inline(always)]
    pub fn and(self, [s, c]: [T; 2]) -> Self {
        Self { s: self.s.mul_add(c, self.c * s), c: (self.c * c).minus_product(self.s, s) }
    }

    /// The inverse rotation.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        Self { s: -self.s, c: self.c }
    }

    /// Rotates the two components in the xy plane.
    #[inline(always)]
    pub fn pair(self, x: T, y: T) -> (T, T) {
        let Self { s, c } = self;
        ((c * x).minus_product(s, y), s.mul_add(x, c * y))
    }

    /// c^2, s^2, s c, which can be computed before the matrix is available.
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
        // The terms that depend on two previous results are added last, to reduce latency.
        [
            cc.mul_add(a, ss * d).minus_product(sc, across),
            sc.mul_add(along, (cc * b).minus_product(ss, e)),
            sc.mul_add(along, (cc * e).minus_product(ss, b)),
            sc.mul_add(across, ss.mul_add(a, cc * d)),
        ]
    }
}
