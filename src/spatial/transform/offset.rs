//! The offset of a joint, from the parent origin to the body origin.

use crate::scalar::{ColumnsOf, Real};

/// A constant offset l, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Offset<N> {
    pub entries: [N; 3],
    /// l . l
    pub square: N,
}

impl<N: Copy> Offset<N> {
    pub fn new([x, y, z]: [f64; 3], number: impl Fn(f64) -> N) -> Self {
        Self { square: number(x * x + y * y + z * z), entries: [number(x), number(y), number(z)] }
    }

    /// The same offset in every lane.
    #[inline(always)]
    pub fn splat<T: Real<Parameter = N>>(&self, like: T) -> Offset<T> {
        let [x, y, z] = self.entries;
        Offset { entries: [like.splat(x), like.splat(y), like.splat(z)], square: like.splat(self.square) }
    }
}

impl<T: Real> Offset<T> {
    /// The same offset in every column.
    #[inline(always)]
    pub fn spread<C: ColumnsOf<T>>(&self, like: C) -> Offset<C> {
        let [x, y, z] = self.entries;
        Offset { entries: [like.spread(x), like.spread(y), like.spread(z)], square: like.spread(self.square) }
    }

    /// n + l x f: the moment about the parent origin.
    #[inline(always)]
    pub fn moment(&self, [fx, fy, fz]: [T; 3], [nx, ny, nz]: [T; 3]) -> [T; 3] {
        let [x, y, z] = self.entries;
        [
            y.mul_add(fz, nx.minus_product(z, fy)),
            z.mul_add(fx, ny.minus_product(x, fz)),
            x.mul_add(fy, nz.minus_product(y, fx)),
        ]
    }

    /// v + w x l: the velocity of the body origin.
    #[inline(always)]
    pub fn velocity(&self, [wx, wy, wz]: [T; 3], [vx, vy, vz]: [T; 3]) -> [T; 3] {
        let [x, y, z] = self.entries;
        [
            z.mul_add(wy, vx.minus_product(y, wz)),
            x.mul_add(wz, vy.minus_product(z, wx)),
            y.mul_add(wx, vz.minus_product(x, wy)),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::Offset;
    use nalgebra::Vector3;

    #[test]
    fn products_with_an_offset_are_cross_products() {
        let (l, f, n) = (Vector3::new(0.3, -0.5, 0.2), Vector3::new(0.7, -1.3, 2.1), Vector3::new(-0.4, 0.9, 0.2));
        let offset = Offset::new(l.into(), |x| x);
        let is_near = |found: [f64; 3], expected: Vector3<f64>| (Vector3::from(found) - expected).amax() <= 1e-15;
        assert!((offset.square - l.norm_squared()).abs() <= 1e-15);
        assert!(is_near(offset.moment(f.into(), n.into()), n + l.cross(&f)));
        assert!(is_near(offset.velocity(f.into(), n.into()), n + f.cross(&l)));
    }
}
