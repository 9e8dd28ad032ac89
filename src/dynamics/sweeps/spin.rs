//! The accelerations of the points of a body relative to its origin, and the force that this motion needs.

use super::load::Load;
use crate::dynamics::forces::Needed;
use crate::scalar::Real;
use crate::spatial::BodyRoot;
use crate::spatial::transform::Offset;

/// Each value in every lane.
macro_rules! splat {
    ($like:expr, $($number:expr),+) => { [$($like.splat($number)),+] };
}

/// The derivative of the acceleration with respect to the position in the body: U = dw~ + w~ w~.
pub(in crate::dynamics) struct Spin<T> {
    /// The entries yz, zx, xy, and zy, xz, yx of U.
    after: [T; 3],
    before: [T; 3],
    /// The subtracted diagonal: `w_y`^2 + `w_z`^2, and so on. Without velocities this and the fields below are zero and
    /// unused.
    pull: [T; 3],
    dw: [T; 3],
    /// The squares of w, and its products of y and z, z and x, x and y.
    squares: [T; 3],
    products: [T; 3],
    has_velocity: bool,
}

impl<T: Real> Spin<T> {
    #[inline(always)]
    pub fn of([x, y, z]: [T; 3], dw: [T; 3], needed: Needed) -> Self {
        let [dx, dy, dz] = dw;
        if !needed.velocity {
            let none = [x.constant(0.0); 3];
            let after = [-dx, -dy, -dz];
            return Self { after, before: dw, pull: none, dw, squares: none, products: none, has_velocity: false };
        }
        let (squares, products) = ([x * x, y * y, z * z], [y * z, z * x, x * y]);
        let ([xx, yy, zz], [yz, zx, xy]) = (squares, products);
        let (after, before) = ([yz - dx, zx - dy, xy - dz], [yz + dx, zx + dy, xy + dz]);
        Self { after, before, pull: [yy + zz, zz + xx, xx + yy], dw, squares, products, has_velocity: true }
    }

    /// U k.
    #[inline(always)]
    pub fn times(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        let ([yz, zx, xy], [zy, xz, yx]) = (self.after, self.before);
        let mut sums = [xy * y, yz * z, zx * x];
        if self.has_velocity {
            let [pull_x, pull_y, pull_z] = self.pull;
            sums =
                [sums[0].minus_product(pull_x, x), sums[1].minus_product(pull_y, y), sums[2].minus_product(pull_z, z)];
        }
        [xz.mul_add(z, sums[0]), yx.mul_add(x, sums[1]), zy.mul_add(y, sums[2])]
    }

    /// The acceleration of the point at this offset, `a` being that of the origin.
    #[inline(always)]
    pub fn at(&self, offset: &Offset<T::Parameter>, mut a: [T; 3]) -> [T; 3] {
        let [x, y, z] = splat!(a[0], offset.entries[0], offset.entries[1], offset.entries[2]);
        let ([yz, zx, xy], [zy, xz, yx]) = (self.after, self.before);
        if self.has_velocity {
            let [pull_x, pull_y, pull_z] = self.pull;
            a = [a[0].minus_product(pull_x, x), a[1].minus_product(pull_y, y), a[2].minus_product(pull_z, z)];
        }
        a = [
            xz.mul_add(z, xy.mul_add(y, a[0])),
            yx.mul_add(x, yz.mul_add(z, a[1])),
            zy.mul_add(y, zx.mul_add(x, a[2])),
        ];
        a
    }

    /// Adds the moment of the velocity that the root does not contain, for inertias that no rigid body can have.
    #[inline(always)]
    pub fn add_rest(&self, root: &BodyRoot<T::Parameter>, force: &mut [T; 6]) {
        if self.has_velocity {
            let ([xx, yy, zz], [yz, zx, xy]) = (self.squares, self.products);
            for (i, moment) in force[..3].iter_mut().enumerate() {
                for (j, product) in [xx, yy, zz, xy, zx, yz].into_iter().enumerate() {
                    *moment = product.splat(root.rest[(i, j)]).mul_add(product, *moment);
                }
            }
        }
    }

    /// I dw + w x I w.
    #[inline(always)]
    fn moment(&self, load: &Load<T>) -> [T; 3] {
        let ([u_yz, u_zx, u_xy], [u_zy, u_xz, u_yx]) = (self.after, self.before);
        let [dx, dy, dz] = self.dw;
        let [xx, xy, xz, yy, yz, zz] = load.rotational;
        // I dw, and the terms of w x I w with products of inertia, except for differences of squares.
        let mut n = [
            u_yx.mul_add(xz, dx * xx).minus_product(u_zx, xy),
            u_zy.mul_add(xy, dy * yy).minus_product(u_xy, yz),
            u_xz.mul_add(yz, dz * zz).minus_product(u_yz, xz),
        ];
        if self.has_velocity {
            let [square_x, square_y, square_z] = self.squares;
            let [around_x, around_y, around_z] = [zz - yy, xx - zz, yy - xx];
            n = [
                self.products[0].mul_add(around_x, (square_y - square_z).mul_add(yz, n[0])),
                self.products[1].mul_add(around_y, (square_z - square_x).mul_add(xz, n[1])),
                self.products[2].mul_add(around_z, (square_x - square_y).mul_add(xy, n[2])),
            ];
        }
        n
    }
}

/// (I dw + w x I w + m p x a, m a + U m p).
#[inline(always)]
pub(in crate::dynamics) fn force_of<T: Real>(load: &Load<T>, spin: &Spin<T>, a: [T; 3]) -> [T; 6] {
    let (m, moment) = (load.mass, spin.moment(load));
    let [x, y, z] = spin.times(load.first_moment);
    let force = [m.mul_add(a[0], x), m.mul_add(a[1], y), m.mul_add(a[2], z)];
    let moment = cross(load.first_moment, a, moment);
    [moment[0], moment[1], moment[2], force[0], force[1], force[2]]
}

/// y of the force L y that the motion of a body needs, as in [`BodyRoot::coordinates`]: linear entries first.
#[inline(always)]
pub(in crate::dynamics) fn coordinates_of<T: Real>(root: &BodyRoot<T::Parameter>, spin: &Spin<T>, a: [T; 3]) -> [T; 6] {
    let like = a[0];
    let o = like.constant(0.0);
    // The acceleration of the center of mass.
    let [x, y, z] = spin.times(splat!(like, root.center[0], root.center[1], root.center[2]));
    let at_center = [a[0] + x, a[1] + y, a[2] + z];
    let (mass, c, dw) = (like.splat(root.mass), &root.central, spin.dw);
    let turned = [
        like.splat(c[(2, 0)]).mul_add(dw[2], like.splat(c[(1, 0)]).mul_add(dw[1], dw[0])),
        like.splat(c[(2, 1)]).mul_add(dw[2], dw[1]),
        dw[2],
    ];
    let mut y = [mass * at_center[0], mass * at_center[1], mass * at_center[2], o, o, o];
    for i in 0..3 {
        y[3 + i] = like.splat(root.weights[i]) * turned[i];
    }
    if spin.has_velocity {
        let ([xx, yy, zz], [yz, zx, xy]) = (spin.squares, spin.products);
        for i in 0..3 {
            for (j, product) in [xx, yy, zz, xy, zx, yz].into_iter().enumerate() {
                y[3 + i] = like.splat(root.spin[(i, j)]).mul_add(product, y[3 + i]);
            }
        }
    }
    y
}

/// a x b + c.
#[inline(always)]
pub(super) fn cross<T: Real>(a: [T; 3], b: [T; 3], c: [T; 3]) -> [T; 3] {
    [
        a[1].mul_add(b[2], c[0].minus_product(a[2], b[1])),
        a[2].mul_add(b[0], c[1].minus_product(a[0], b[2])),
        a[0].mul_add(b[1], c[2].minus_product(a[1], b[0])),
    ]
}

#[cfg(test)]
mod tests {
    use super::Spin;
    use crate::dynamics::forces::Needed;
    use crate::spatial::transform::Offset;
    use nalgebra::Vector3;

    /// a + dw x l + w x (w x l), against nalgebra.
    #[test]
    fn points_of_a_body_accelerate_as_vectors_say() {
        let (w, dw) = (Vector3::new(0.7, -1.3, 2.1), Vector3::new(0.6, 1.1, -0.8));
        let (a, l) = (Vector3::new(-0.4, 0.9, 0.2), Vector3::new(0.3, -0.5, 0.2));
        for velocity in [true, false] {
            let spin = Spin::of(w.into(), dw.into(), Needed { velocity, acceleration: true });
            let pull = if velocity { w.cross(&w.cross(&l)) } else { Vector3::zeros() };
            let found = Vector3::from(spin.at(&Offset::new(l.into(), |x| x), a.into()));
            assert!((found - (a + dw.cross(&l) + pull)).amax() <= 2e-15, "{velocity}");
        }
    }
}
