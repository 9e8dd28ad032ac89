//! Permutations of axes between a joint frame and its parent frame.
//!
//! Most joints of robots rotate about an axis of their parent frame. The axes of the joint frame are then permuted such
//! that its constant rotation to the parent is a permutation of axes, which is free if the compiler knows it.

use super::accumulate;
use crate::scalar::Real;
use nalgebra::Matrix3;

/// Index of each entry in a packed symmetric 3x3 matrix.
pub(crate) const PACKED: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];

/// Evaluates `$do` with constants for the parent axes that correspond to x, y and z of a joint, so that the compiler
/// knows every index.
macro_rules! about {
    ($axis:expr, $x:ident, $y:ident, $z:ident, $do:expr) => {
        match $axis {
            $crate::spatial::transform::Axis::X => $crate::spatial::transform::about!(@ 1, 2, 0, $x, $y, $z, $do),
            $crate::spatial::transform::Axis::Y => $crate::spatial::transform::about!(@ 2, 0, 1, $x, $y, $z, $do),
            $crate::spatial::transform::Axis::Z => $crate::spatial::transform::about!(@ 0, 1, 2, $x, $y, $z, $do),
        }
    };
    (@ $a:literal, $b:literal, $c:literal, $x:ident, $y:ident, $z:ident, $do:expr) => {{
        const $x: usize = $a;
        const $y: usize = $b;
        const $z: usize = $c;
        $do
    }};
}
pub(crate) use about;

/// The axis of the parent frame along z of the joint frame. x and y of the joint are the two cyclically following axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    /// The axis with the given index, 0 to 2.
    pub fn new(index: usize) -> Self {
        [Self::X, Self::Y, Self::Z][index]
    }

    /// The rotation from the joint frame to the parent frame.
    pub fn rotation(self) -> Matrix3<f64> {
        let mut rotation = Matrix3::zeros();
        for (own, there) in about!(self, X, Y, Z, [X, Y, Z]).into_iter().enumerate() {
            rotation[(there, own)] = 1.0;
        }
        rotation
    }
}

/// A permutation of axes: known at compile time ([`Order`]) or looked up ([`Axis`]).
pub(crate) trait Axes: Copy {
    /// A motion or force from the parent frame to the joint frame.
    fn to_joint<T: Copy>(self, v: &[T; 6]) -> [T; 6];

    /// Free vectors from the parent frame to the joint frame.
    fn free_to_joint<T: Copy, const N: usize>(self, vectors: [[T; 3]; N]) -> [[T; 3]; N];

    /// Adds a motion or force of the joint frame to a sum in the parent frame; sets the sum if `begins`.
    fn send_vector<T: Real>(self, v: &[T; 6], begins: bool, sum: &mut [T; 6]);

    /// As `send_vector` for a covariance in 6 + 9 + 6 entries (angular, coupling by rows, linear).
    fn send_covariance<T: Real>(self, p: &[T; 21], begins: bool, sum: &mut [T; 21]);

    /// A free vector from the joint frame to the parent frame.
    fn vector<T: Copy>(self, v: [T; 3]) -> [T; 3];

    /// A symmetric matrix from the joint frame to the parent frame.
    fn symmetric<T: Copy>(self, a: &[T; 6]) -> [T; 6];

    /// Writes columns of the joint frame: the first three have force and moment, the others a moment only.
    fn put_columns<T: Copy>(self, rows: &mut [[T; 6]; 6], forces: &[[T; 3]; 3], moments: &[[T; 3]; 6]);
}

/// The identity permutation, after a constant rotation.
pub(crate) const PARENT_FRAME: Order<0, 1, 2> = Order;

/// The parent axes that correspond to x, y and z of the joint frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Order<const X: usize, const Y: usize, const Z: usize>;

impl<const X: usize, const Y: usize, const Z: usize> Order<X, Y, Z> {
    /// A free vector from the parent frame to the joint frame.
    #[inline(always)]
    pub fn vector_to_joint<T: Copy>(v: [T; 3]) -> [T; 3] {
        [v[X], v[Y], v[Z]]
    }

    /// A covariance from the joint frame to the parent frame.
    #[inline(always)]
    pub fn covariance<T: Copy>(p: &[T; 21]) -> [T; 21] {
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
}

impl<const X: usize, const Y: usize, const Z: usize> Axes for Order<X, Y, Z> {
    #[inline(always)]
    fn to_joint<T: Copy>(self, v: &[T; 6]) -> [T; 6] {
        [v[X], v[Y], v[Z], v[3 + X], v[3 + Y], v[3 + Z]]
    }

    #[inline(always)]
    fn free_to_joint<T: Copy, const N: usize>(self, mut vectors: [[T; 3]; N]) -> [[T; 3]; N] {
        for v in &mut vectors {
            *v = Self::vector_to_joint(*v);
        }
        vectors
    }

    #[inline(always)]
    fn send_vector<T: Real>(self, v: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        let mut there = *v;
        (there[X], there[Y], there[Z]) = (v[0], v[1], v[2]);
        (there[3 + X], there[3 + Y], there[3 + Z]) = (v[3], v[4], v[5]);
        accumulate(&there, begins, sum);
    }

    #[inline(always)]
    fn send_covariance<T: Real>(self, p: &[T; 21], begins: bool, sum: &mut [T; 21]) {
        accumulate(&Self::covariance(p), begins, sum);
    }

    #[inline(always)]
    fn vector<T: Copy>(self, v: [T; 3]) -> [T; 3] {
        let mut there = v;
        (there[X], there[Y], there[Z]) = (v[0], v[1], v[2]);
        there
    }

    #[inline(always)]
    fn symmetric<T: Copy>(self, a: &[T; 6]) -> [T; 6] {
        let mut there = *a;
        (there[PACKED[X][X]], there[PACKED[X][Y]], there[PACKED[X][Z]]) = (a[0], a[1], a[2]);
        (there[PACKED[Y][Y]], there[PACKED[Y][Z]], there[PACKED[Z][Z]]) = (a[3], a[4], a[5]);
        there
    }

    #[inline(always)]
    fn put_columns<T: Copy>(self, rows: &mut [[T; 6]; 6], forces: &[[T; 3]; 3], moments: &[[T; 3]; 6]) {
        for (j, &[x, y, z]) in forces.iter().enumerate() {
            (rows[X][j], rows[Y][j], rows[Z][j]) = (x, y, z);
        }
        for (j, &[x, y, z]) in moments.iter().enumerate() {
            (rows[3 + X][j], rows[3 + Y][j], rows[3 + Z][j]) = (x, y, z);
        }
    }
}

impl Axes for Axis {
    #[inline(always)]
    fn to_joint<T: Copy>(self, v: &[T; 6]) -> [T; 6] {
        about!(self, X, Y, Z, Order::<X, Y, Z>.to_joint(v))
    }

    #[inline(always)]
    fn free_to_joint<T: Copy, const N: usize>(self, vectors: [[T; 3]; N]) -> [[T; 3]; N] {
        about!(self, X, Y, Z, Order::<X, Y, Z>.free_to_joint(vectors))
    }

    #[inline(always)]
    fn send_vector<T: Real>(self, v: &[T; 6], begins: bool, sum: &mut [T; 6]) {
        about!(self, X, Y, Z, Order::<X, Y, Z>.send_vector(v, begins, sum));
    }

    #[inline(always)]
    fn send_covariance<T: Real>(self, p: &[T; 21], begins: bool, sum: &mut [T; 21]) {
        about!(self, X, Y, Z, Order::<X, Y, Z>.send_covariance(p, begins, sum));
    }

    #[inline(always)]
    fn vector<T: Copy>(self, v: [T; 3]) -> [T; 3] {
        about!(self, X, Y, Z, Order::<X, Y, Z>.vector(v))
    }

    #[inline(always)]
    fn symmetric<T: Copy>(self, a: &[T; 6]) -> [T; 6] {
        about!(self, X, Y, Z, Order::<X, Y, Z>.symmetric(a))
    }

    #[inline(always)]
    fn put_columns<T: Copy>(self, rows: &mut [[T; 6]; 6], forces: &[[T; 3]; 3], moments: &[[T; 3]; 6]) {
        about!(self, X, Y, Z, Order::<X, Y, Z>.put_columns(rows, forces, moments));
    }
}
