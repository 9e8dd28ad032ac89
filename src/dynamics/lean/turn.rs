//! An exact renaming of axes, and the rotation about z.

use crate::scalar::Real;
use nalgebra::Matrix3;

/// A rotation whose entries are all exactly 0, 1 or -1, joint's frame to parent's: which axis each becomes, and its sign.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Renaming<N> {
    order: Order,
    /// The same as indices, and those of the way back: entry i in the joint's frame is entry `from_back[i]` in the parent's, signed.
    from: [u8; 3],
    from_back: [u8; 3],
    /// Entry i of a vector in the parent's frame is `sign[i]` times entry `from[i]` of it in the joint's.
    sign: [N; 3],
    /// The sign of the product of entries yz, zx and xy.
    signs: [N; 3],
}

/// Where each entry of a packed 3x3 symmetric matrix is.
pub(super) const PACKED: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// `from` of a renaming, spelt out: in the kernels the compiler knows every index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    Xyz,
    Yzx,
    Zxy,
    Xzy,
    Zyx,
    Yxz,
}

/// Adds vectors by a table of indices instead of by a branch for each order.
pub(super) const TABLE: bool = true;
/// By a branch.
pub(super) const BRANCH: bool = false;

/// Does `$do` with the order's indices as constants.
macro_rules! in_order {
    ($order:expr, $x:ident, $y:ident, $z:ident, $do:expr) => {
        match $order {
            Order::Xyz => in_order!(@ 0, 1, 2, $x, $y, $z, $do),
            Order::Yzx => in_order!(@ 1, 2, 0, $x, $y, $z, $do),
            Order::Zxy => in_order!(@ 2, 0, 1, $x, $y, $z, $do),
            Order::Xzy => in_order!(@ 0, 2, 1, $x, $y, $z, $do),
            Order::Zyx => in_order!(@ 2, 1, 0, $x, $y, $z, $do),
            Order::Yxz => in_order!(@ 1, 0, 2, $x, $y, $z, $do),
        }
    };
    (@ $a:literal, $b:literal, $c:literal, $x:ident, $y:ident, $z:ident, $do:expr) => {{
        const $x: usize = $a;
        const $y: usize = $b;
        const $z: usize = $c;
        $do
    }};
}

impl<N: Copy> Renaming<N> {
    /// Of a rotation, if it is one.
    pub fn of(rotation: &Matrix3<f64>, number: impl Fn(f64) -> N) -> Option<Self> {
        #[allow(clippy::float_cmp)] // exactly: what is near is not renamed
        if !rotation.iter().all(|&x| x == 0.0 || x.abs() == 1.0) {
            return None;
        }
        let from: [Option<usize>; 3] = [0, 1, 2].map(|i| rotation.row(i).iter().position(|&x| x != 0.0));
        let order = match from {
            [Some(0), Some(1), Some(2)] => Order::Xyz,
            [Some(1), Some(2), Some(0)] => Order::Yzx,
            [Some(2), Some(0), Some(1)] => Order::Zxy,
            [Some(0), Some(2), Some(1)] => Order::Xzy,
            [Some(2), Some(1), Some(0)] => Order::Zyx,
            [Some(1), Some(0), Some(2)] => Order::Yxz,
            _ => return None,
        };
        let [x, y, z] = [0, 1, 2].map(|i| rotation.row(i).sum());
        let [a, b, c] = from.map(Option::unwrap_or_default);
        let mut from_back = [0; 3];
        (from_back[a], from_back[b], from_back[c]) = (0, 1, 2);
        #[allow(clippy::cast_possible_truncation)] // below three
        let from = [a as u8, b as u8, c as u8];
        Some(Self { order, from, from_back, sign: [x, y, z].map(&number), signs: [y * z, z * x, x * y].map(number) })
    }
}

impl<N: Copy> Renaming<N> {
    /// A vector from the parent's frame to the joint's; of `v` the last number is not read.
    #[inline(always)]
    pub fn back<T: Real<Parameter = N>>(&self, v: &[T; 4]) -> [T; 3] {
        let [x, y, z] = self.sign;
        let signed = [v[0] * v[0].everywhere(x), v[1] * v[0].everywhere(y), v[2] * v[0].everywhere(z)];
        let mut turned = signed;
        in_order!(self.order, X, Y, Z, (turned[X], turned[Y], turned[Z]) = (signed[0], signed[1], signed[2]));
        turned
    }

    /// Which entry of a vector in the parent's frame each one in the joint's is, and its sign.
    #[inline(always)]
    pub fn entries_back(&self) -> ([usize; 3], [N; 3]) {
        // Never more than two: said so that no index has to be looked at.
        let [a, b, c] = self.from_back;
        let [a, b, c] = [usize::from(a).min(2), usize::from(b).min(2), usize::from(c).min(2)];
        ([a, b, c], [self.sign[a], self.sign[b], self.sign[c]])
    }

    /// Adds a vector in the joint's frame to one in the parent's.
    ///
    /// By a branch for each order, or by a [`TABLE`] of indices: a branch costs less in one sweep over the bodies, and far more where
    /// sweeps over some of them follow each other so fast that no branch is foreseen.
    #[inline(always)]
    pub fn add<T: Real<Parameter = N>, const TABLE: bool>(&self, v: [T; 3], to: &mut [T]) {
        let [x, y, z] = self.sign;
        let [p, q, r] = if TABLE {
            // Four, so that no index is out of bounds.
            let [a, b, c] = self.from;
            let padded = [v[0], v[1], v[2], v[0]];
            [padded[usize::from(a & 3)], padded[usize::from(b & 3)], padded[usize::from(c & 3)]]
        } else {
            in_order!(self.order, X, Y, Z, [v[X], v[Y], v[Z]])
        };
        to[0] = p.mul_add(p.everywhere(x), to[0]);
        to[1] = q.mul_add(p.everywhere(y), to[1]);
        to[2] = r.mul_add(p.everywhere(z), to[2]);
    }

    /// Sizes along the axes of the joint's frame, of angular and linear parts, along those of the parent's: no sign matters.
    #[inline(always)]
    pub fn sizes<T: Real<Parameter = N>>(&self, v: &[T; 6]) -> [T; 6] {
        in_order!(self.order, X, Y, Z, [v[X], v[Y], v[Z], v[3 + X], v[3 + Y], v[3 + Z]])
    }

    /// Adds a packed matrix in the joint's frame to one in the parent's: 6 + 9 + 6 numbers (angular, coupling by rows, linear).
    #[inline(always)]
    pub fn add_packed<T: Real<Parameter = N>>(&self, p: &[T; 21], to: &mut [T; 21]) {
        in_order!(self.order, X, Y, Z, self.add_in_order::<T, X, Y, Z>(p, to));
    }

    /// A packed 6x6 matrix from the parent's frame to the joint's.
    #[inline(always)]
    pub fn packed_back<T: Real<Parameter = N>>(&self, p: &[T; 21]) -> [T; 21] {
        let like = p[0];
        let [yz, zx, xy] = self.signs;
        let (yz, zx, xy) = (like.everywhere(yz), like.everywhere(zx), like.everywhere(xy));
        let mut signed = *p;
        for (at, sign) in [(1, xy), (2, zx), (4, yz), (7, xy), (8, zx), (9, xy), (11, yz), (12, zx), (13, yz)] {
            signed[at] = p[at] * sign;
        }
        for (at, sign) in [(16, xy), (17, zx), (19, yz)] {
            signed[at] = p[at] * sign;
        }
        let mut back = signed;
        in_order!(self.order, X, Y, Z, {
            for (i, a) in [X, Y, Z].into_iter().enumerate() {
                for (j, b) in [X, Y, Z].into_iter().enumerate() {
                    back[PACKED[a][b]] = signed[PACKED[i][j]];
                    back[6 + 3 * a + b] = signed[6 + 3 * i + j];
                    back[15 + PACKED[a][b]] = signed[15 + PACKED[i][j]];
                }
            }
        });
        back
    }

    #[inline(always)]
    fn add_in_order<T: Real<Parameter = N>, const X: usize, const Y: usize, const Z: usize>(
        &self,
        p: &[T; 21],
        to: &mut [T; 21],
    ) {
        let like = p[0];
        let [yz, zx, xy] = self.signs;
        let (yz, zx, xy) = (like.everywhere(yz), like.everywhere(zx), like.everywhere(xy));
        to[0] += p[PACKED[X][X]];
        to[1] = p[PACKED[X][Y]].mul_add(xy, to[1]);
        to[2] = p[PACKED[X][Z]].mul_add(zx, to[2]);
        to[3] += p[PACKED[Y][Y]];
        to[4] = p[PACKED[Y][Z]].mul_add(yz, to[4]);
        to[5] += p[PACKED[Z][Z]];
        to[6] += p[6 + 3 * X + X];
        to[7] = p[6 + 3 * X + Y].mul_add(xy, to[7]);
        to[8] = p[6 + 3 * X + Z].mul_add(zx, to[8]);
        to[9] = p[6 + 3 * Y + X].mul_add(xy, to[9]);
        to[10] += p[6 + 3 * Y + Y];
        to[11] = p[6 + 3 * Y + Z].mul_add(yz, to[11]);
        to[12] = p[6 + 3 * Z + X].mul_add(zx, to[12]);
        to[13] = p[6 + 3 * Z + Y].mul_add(yz, to[13]);
        to[14] += p[6 + 3 * Z + Z];
        to[15] += p[15 + PACKED[X][X]];
        to[16] = p[15 + PACKED[X][Y]].mul_add(xy, to[16]);
        to[17] = p[15 + PACKED[X][Z]].mul_add(zx, to[17]);
        to[18] += p[15 + PACKED[Y][Y]];
        to[19] = p[15 + PACKED[Y][Z]].mul_add(yz, to[19]);
        to[20] += p[15 + PACKED[Z][Z]];
    }
}

/// Sine and cosine of a joint's angle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turn<T> {
    pub s: T,
    pub c: T,
}

impl<T: Real> Turn<T> {
    /// The turn the other way.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        Self { s: -self.s, c: self.c }
    }

    /// Rz v, body's frame to joint's.
    #[inline(always)]
    pub fn rotate(self, v: [T; 3]) -> [T; 3] {
        let (x, y) = self.pair(v[0], v[1]);
        [x, y, v[2]]
    }

    /// Rz^T v, joint's frame to body's.
    #[inline(always)]
    pub fn rotate_back(self, v: [T; 3]) -> [T; 3] {
        let Self { s, c } = self;
        [c.mul_add(v[0], s * v[1]), (c * v[1]).minus_product(s, v[0]), v[2]]
    }

    /// The two entries that a rotation about z mixes.
    #[inline(always)]
    pub fn pair(self, x: T, y: T) -> (T, T) {
        let Self { s, c } = self;
        ((c * x).minus_product(s, y), s.mul_add(x, c * y))
    }

    /// Rz X Rz^T of [[a, b], [b, d]].
    #[inline(always)]
    pub fn symmetric(self, (a, b, d): (T, T, T)) -> (T, T, T) {
        let (t00, t10) = self.pair(a, b);
        let (t01, t11) = self.pair(b, d);
        let Self { s, c } = self;
        ((c * t00).minus_product(s, t01), s.mul_add(t00, c * t01), s.mul_add(t10, c * t11))
    }
}
