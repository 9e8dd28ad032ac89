//! Renamings of axes, and the rotation about z.

use crate::scalar::Real;
use nalgebra::{Matrix3, Vector6};

/// The row of a revolute joint.
pub(super) const ABOUT_Z: usize = 2;

/// Where each entry of a packed 3x3 symmetric matrix is.
pub(super) const PACKED: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// Does `$do` with constants for the axes of the parent's frame that x, y and z of a revolute joint's are: the compiler knows every index.
macro_rules! about {
    ($axis:expr, $x:ident, $y:ident, $z:ident, $do:expr) => {
        match $axis {
            Axis::X => about!(@ 1, 2, 0, $x, $y, $z, $do),
            Axis::Y => about!(@ 2, 0, 1, $x, $y, $z, $do),
            Axis::Z => about!(@ 0, 1, 2, $x, $y, $z, $do),
        }
    };
    (@ $a:literal, $b:literal, $c:literal, $x:ident, $y:ident, $z:ident, $do:expr) => {{
        const $x: usize = $a;
        const $y: usize = $b;
        const $z: usize = $c;
        $do
    }};
}
pub(super) use about;

/// The axis of its parent's frame that a turn is about. The axes of its own frame, x, y and z, are the two of the parent's that follow
/// it in their cycle, and itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    /// The one of this index, 0 to 2.
    pub fn new(index: usize) -> Self {
        [Self::X, Self::Y, Self::Z][index]
    }

    /// The rotation from the joint's frame to its parent's.
    pub fn rotation(self) -> Matrix3<f64> {
        let mut rotation = Matrix3::zeros();
        for (own, there) in about!(self, X, Y, Z, [X, Y, Z]).into_iter().enumerate() {
            rotation[(there, own)] = 1.0;
        }
        rotation
    }
}

/// A motion or a force from the parent's frame to the turn's.
#[inline(always)]
pub(super) fn to_turn<T: Copy, const X: usize, const Y: usize, const Z: usize>(v: &[T; 6]) -> [T; 6] {
    [v[X], v[Y], v[Z], v[3 + X], v[3 + Y], v[3 + Z]]
}

/// A motion or a force from the joint's frame to its parent's.
#[inline(always)]
pub(super) fn to_parent<T: Copy, const X: usize, const Y: usize, const Z: usize>(v: &[T; 6]) -> [T; 6] {
    let mut there = *v;
    (there[X], there[Y], there[Z]) = (v[0], v[1], v[2]);
    (there[3 + X], there[3 + Y], there[3 + Z]) = (v[3], v[4], v[5]);
    there
}

/// A symmetric matrix from the joint's frame to its parent's.
#[inline(always)]
pub(super) fn symmetric_to_parent<T: Copy, const X: usize, const Y: usize, const Z: usize>(a: &[T; 6]) -> [T; 6] {
    let mut there = *a;
    (there[PACKED[X][X]], there[PACKED[X][Y]], there[PACKED[X][Z]]) = (a[0], a[1], a[2]);
    (there[PACKED[Y][Y]], there[PACKED[Y][Z]], there[PACKED[Z][Z]]) = (a[3], a[4], a[5]);
    there
}

/// A packed matrix from the joint's frame to its parent's: 6 + 9 + 6 numbers (angular, coupling by rows, linear).
#[inline(always)]
pub(super) fn packed_to_parent<T: Copy, const X: usize, const Y: usize, const Z: usize>(p: &[T; 21]) -> [T; 21] {
    let mut there = *p;
    for block in [0, 15] {
        there[block + PACKED[X][X]] = p[block];
        there[block + PACKED[X][Y]] = p[block + 1];
        there[block + PACKED[X][Z]] = p[block + 2];
        there[block + PACKED[Y][Y]] = p[block + 3];
        there[block + PACKED[Y][Z]] = p[block + 4];
        there[block + PACKED[Z][Z]] = p[block + 5];
    }
    for (own, row) in [X, Y, Z].into_iter().enumerate() {
        there[6 + 3 * row + X] = p[6 + 3 * own];
        there[6 + 3 * row + Y] = p[6 + 3 * own + 1];
        there[6 + 3 * row + Z] = p[6 + 3 * own + 2];
    }
    there
}

/// A renaming of axes, from a body's frame in the model to the one that these sweeps have it in, as a table: which entry each becomes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Renaming<N> {
    /// Entry i here is `sign[i]` times entry `from[i]` in the model.
    pub from: [u8; 3],
    pub sign: [N; 3],
}

impl<N: Copy> Renaming<N> {
    /// Of a rotation whose entries are zeros and, one in each row and column, 1 or -1.
    #[allow(clippy::cast_possible_truncation)] // below three
    pub fn of(rotation: &Matrix3<f64>, number: impl Fn(f64) -> N) -> Self {
        Self {
            from: [0, 1, 2].map(|i| rotation.row(i).iter().position(|&x| x != 0.0).unwrap_or(i) as u8),
            sign: [0, 1, 2].map(|i| number(rotation.row(i).sum())),
        }
    }

    /// A motion or a force from the model's frame.
    #[inline(always)]
    pub fn apply<T: Real<Parameter = N>>(&self, v: &Vector6<T>) -> [T; 6] {
        let mut here: [T; 6] = (*v).into();
        for (i, here) in here.iter_mut().enumerate() {
            let from = v[usize::from(self.from[i % 3]) + i / 3 * 3];
            *here = from * from.splat(self.sign[i % 3]);
        }
        here
    }

    /// A motion or a force to the model's frame.
    #[inline(always)]
    pub fn undo<T: Real<Parameter = N>>(&self, v: &[T; 6]) -> Vector6<T> {
        let mut there = Vector6::from(*v);
        for (i, &v) in v.iter().enumerate() {
            there[usize::from(self.from[i % 3]) + i / 3 * 3] = v * v.splat(self.sign[i % 3]);
        }
        there
    }

    /// Bounds along the axes, of angular and linear parts, to the model's frame: no sign matters.
    #[inline(always)]
    pub fn undo_on_sizes<T: Real<Parameter = N>>(&self, v: &[T; 6]) -> Vector6<T> {
        let mut there = Vector6::from(*v);
        for (i, &v) in v.iter().enumerate() {
            there[usize::from(self.from[i % 3]) + i / 3 * 3] = v;
        }
        there
    }
}

/// Sine and cosine of a joint's angle, in its sense and with its offset.
#[derive(Debug, Clone, Copy)]
pub(super) struct AxialRotation<T> {
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
