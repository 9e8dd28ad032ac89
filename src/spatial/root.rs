//! Square-root form without square roots: symmetric 6x6 matrices P = L W L^T with L unit lower triangular and W a
//! diagonal matrix of weights.
//!
//! The columns of L times the square roots of the weights are the columns of a square root S of P. With linear rows
//! first, L = [[1, 0], [p~, `L_c`]] for a single body, and the weights are its mass and those of its central inertia.
//! The columns that a child propagates include three without a linear part. Most of a 6 x 12 stack of columns is
//! therefore zero, and the rotations that reduce it to six columns modify less than half of it.

use super::rigid_shift::RigidShift;
use super::symmetric::{Symmetric3, Symmetric6};
use super::vector::{cross_add, minus, scaled};
use crate::scalar::Real;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Row of a root (linear first) for a component of a spatial vector (angular first).
#[inline(always)]
#[must_use]
pub const fn root_row(component: usize) -> usize {
    (component + 3) % 6
}

/// L and W of P = L W L^T, with rows in the order linear x, y, z, angular x, y, z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Root6<T> {
    /// The weights, which are nonnegative.
    pub weights: [T; 6],
    /// L: entries (i, j) with j < i are used; the diagonal is one.
    pub rows: [[T; 6]; 6],
}

/// The columns phi L that a child propagates to its parent: three with both parts, three with an angular part only.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RootColumns<T> {
    /// Weights of the columns.
    pub weights: [T; 6],
    /// Rows as in [`Root6`]. The linear rows of the last three columns are zero and not used.
    pub rows: [[T; 6]; 6],
}

impl<T: Copy> RootColumns<T> {
    /// `value` in every entry.
    #[inline(always)]
    #[must_use]
    pub fn filled(value: T) -> Self {
        Self { weights: [value; 6], rows: [[value; 6]; 6] }
    }
}

/// Results of a measurement update of a root.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dropped<T> {
    /// D.
    pub pivot: T,
    /// 1 / D.
    pub pivot_inverse: T,
    /// g.
    pub gain: Vector6<T>,
    /// The predicted measurement.
    pub predicted: T,
}

/// Quantities that a measurement update accumulates over the columns.
struct Gathered<T> {
    /// P H*.
    column: [T; 6],
    /// The predicted measurement.
    predicted: T,
    /// H P H* + r.
    variance: T,
    inverse: T,
}

/// Applies a rotation of columns I and C to row R, if R is below I.
#[inline(always)]
fn rotate_row<T: Real, const I: usize, const C: usize, const R: usize>(
    root: &mut Root6<T>,
    incoming: &mut RootColumns<T>,
    (f, kept, taken): (T, T, T),
) {
    if R > I {
        let (x, y) = (root.rows[R][I], incoming.rows[R][C]);
        root.rows[R][I] = kept.mul_add(x, taken * y);
        incoming.rows[R][C] = y.minus_product(f, x);
    }
}

/// `before` and 1 / `total`, or one and one if `total`, and hence `before`, is zero.
#[inline(always)]
fn divisor<T: Real, const POSITIVE: bool>(before: T, total: T) -> (T, T) {
    if POSITIVE {
        return (before, total.recip());
    }
    let flag = total.one_if_zero();
    (before + flag, (total + flag).recip())
}

impl<T: Real> Gathered<T> {
    #[inline(always)]
    fn new(noise: T) -> Self {
        let o = noise.constant(0.0);
        // Before anything is accumulated the inverse is multiplied by zero, so that any finite value is valid.
        let inverse = (noise + noise.one_if_zero()).recip();
        Self { column: [o; 6], predicted: o, variance: noise, inverse }
    }

    #[inline(always)]
    fn dropped(self) -> Dropped<T> {
        let Self { column: g, predicted, variance, inverse } = self;
        let gain = scaled(&Vector6::new(g[3], g[4], g[5], g[0], g[1], g[2]), inverse);
        Dropped { pivot: variance, pivot_inverse: inverse, gain, predicted }
    }
}

impl<T: Real> Root6<T> {
    /// The root of zero.
    #[must_use]
    pub fn zero() -> Self {
        Self::filled(T::zero())
    }

    /// `value` in every entry, for workspaces, which start as NaN.
    #[must_use]
    pub fn filled(value: T) -> Self {
        Self { weights: [value; 6], rows: [[value; 6]; 6] }
    }

    /// Entry (i, j) of L.
    #[inline(always)]
    fn entry(&self, i: usize, j: usize) -> T {
        match i.cmp(&j) {
            std::cmp::Ordering::Less => T::zero(),
            std::cmp::Ordering::Equal => T::one(),
            std::cmp::Ordering::Greater => self.rows[i][j],
        }
    }

    /// A square root S = L sqrt(W) with rows in the usual order, angular first.
    pub fn to_matrix(&self) -> Matrix6<T> {
        Matrix6::from_fn(|i, j| self.entry(root_row(i), j) * self.weights[j].sqrt())
    }

    /// P = L W L^T.
    pub fn to_symmetric(&self) -> Symmetric6<T> {
        let entry = |i: usize, j: usize| {
            let (i, j) = (root_row(i), root_row(j));
            (0..=i.min(j)).fold(T::zero(), |sum, k| sum + self.entry(i, k) * self.weights[k] * self.entry(j, k))
        };
        let block = |o: usize| {
            Symmetric3::new([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(i, j)| entry(i + o, j + o)))
        };
        Symmetric6 { angular: block(0), coupling: Matrix3::from_fn(|i, j| entry(i, j + 3)), linear: block(3) }
    }

    /// The diagonal of P, in the order of the rows of the root.
    #[inline(always)]
    #[must_use]
    pub fn diagonal(&self) -> [T; 6] {
        let mut diagonal = self.weights;
        for (i, sum) in diagonal.iter_mut().enumerate() {
            for k in 0..i {
                *sum = (self.rows[i][k] * self.rows[i][k]).mul_add(self.weights[k], *sum);
            }
        }
        diagonal
    }

    /// H L for one component of the state.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, component: usize) -> [T; 6] {
        let i = root_row(component);
        let mut row = self.rows[i];
        for (j, entry) in row.iter_mut().enumerate().skip(i) {
            *entry = entry.constant(if i == j { 1.0 } else { 0.0 });
        }
        row
    }

    /// Adds columns: P becomes P + C W' C^T. `FREE` (2 or 3) of the last three columns are used. `POSITIVE` if all
    /// weights of P are positive, so that divisions need no test for zero.
    ///
    /// Applies scaled rotations, which need no square roots, between columns of L and of C. Every entry is a sum of two
    /// products; errors are relative to the norm of each row, and to that of each column if columns differ in size.
    /// `mean` has the coordinates y and y' of a force L y + C y', which are rotated also. The added columns are
    /// overwritten. About 250 products, 24 divisions.
    #[inline(always)]
    pub fn join<const FREE: usize, const POSITIVE: bool>(
        &mut self,
        incoming: &mut RootColumns<T>,
        mut mean: Option<(&mut [T; 6], &mut [T; 6])>,
    ) {
        self.gather::<0, 3, POSITIVE>(incoming, &mut mean);
        self.gather::<1, 3, POSITIVE>(incoming, &mut mean);
        self.gather::<2, 3, POSITIVE>(incoming, &mut mean);
        if FREE == 2 {
            self.gather::<3, 5, POSITIVE>(incoming, &mut mean);
            self.gather::<4, 5, POSITIVE>(incoming, &mut mean);
            self.gather::<5, 5, POSITIVE>(incoming, &mut mean);
        } else {
            self.gather::<3, 6, POSITIVE>(incoming, &mut mean);
            self.gather::<4, 6, POSITIVE>(incoming, &mut mean);
            self.gather::<5, 6, POSITIVE>(incoming, &mut mean);
        }
    }

    /// Rotates the first N added entries of row I into its weight. Unrolled by hand: the compiler does not unroll such
    /// long loops, and data indexed by a loop counter stay in memory.
    #[inline(always)]
    fn gather<const I: usize, const N: usize, const POSITIVE: bool>(
        &mut self,
        incoming: &mut RootColumns<T>,
        mean: &mut Option<(&mut [T; 6], &mut [T; 6])>,
    ) {
        self.rotate::<I, 0, POSITIVE>(incoming, mean);
        self.rotate::<I, 1, POSITIVE>(incoming, mean);
        self.rotate::<I, 2, POSITIVE>(incoming, mean);
        if N > 3 {
            self.rotate::<I, 3, POSITIVE>(incoming, mean);
            self.rotate::<I, 4, POSITIVE>(incoming, mean);
        }
        if N > 5 {
            self.rotate::<I, 5, POSITIVE>(incoming, mean);
        }
    }

    /// Rotates the entry of row I in column C into the weight of column I.
    #[inline(always)]
    fn rotate<const I: usize, const C: usize, const POSITIVE: bool>(
        &mut self,
        incoming: &mut RootColumns<T>,
        mean: &mut Option<(&mut [T; 6], &mut [T; 6])>,
    ) {
        let (f, weight) = (incoming.rows[I][C], incoming.weights[C]);
        let weighted = f * weight;
        let total = f.mul_add(weighted, self.weights[I]);
        // Two columns of weight zero remain unchanged; `kept` is then one.
        let (before, inverse) = divisor::<T, POSITIVE>(self.weights[I], total);
        let (kept, taken) = (before * inverse, weighted * inverse);
        self.weights[I] = total;
        incoming.weights[C] = weight * kept;
        rotate_row::<T, I, C, 1>(self, incoming, (f, kept, taken));
        rotate_row::<T, I, C, 2>(self, incoming, (f, kept, taken));
        rotate_row::<T, I, C, 3>(self, incoming, (f, kept, taken));
        rotate_row::<T, I, C, 4>(self, incoming, (f, kept, taken));
        rotate_row::<T, I, C, 5>(self, incoming, (f, kept, taken));
        if let Some((along, other)) = mean {
            let (x, y) = (along[I], other[C]);
            along[I] = f.mul_add(y, x);
            other[C] = minus(kept, y, taken, x);
        }
    }

    /// Measurement update for `h` = H L with nonzero entries in the columns 0 to `last` and noise r: P becomes P^+;
    /// returns D and g (3.6, 3.10).
    ///
    /// Bierman's update: from the last column to the first, the part along h is accumulated in one column, P H*, and
    /// removed from the others. No covariance is subtracted; without noise the update removes the weight of a whole
    /// column. `mean` is rotated also, and the part that belongs to the removed column is returned. About 80 products,
    /// 6 divisions.
    #[inline(always)]
    pub fn measure(&mut self, h: &[T; 6], last: usize, noise: T, mut mean: Option<&mut [T; 6]>) -> Dropped<T> {
        let mut gathered = Gathered::new(noise);
        for j in (0..=last).rev() {
            self.give::<6, false>(j, h[j], &mut gathered, &mut mean);
        }
        gathered.dropped()
    }

    /// As [`Root6::measure`] for the last row, angular z, which most joints measure; unrolled. `POSITIVE` as for
    /// [`Root6::join`].
    #[inline(always)]
    pub(crate) fn measure_turn<const POSITIVE: bool>(&mut self, noise: T, mean: Option<&mut [T; 6]>) -> Dropped<T> {
        self.measure_last::<6, POSITIVE>(noise, mean)
    }

    /// As [`Root6::measure`] for the last of the first `ROWS` rows, if the rows after it are zero.
    #[inline(always)]
    pub(crate) fn measure_last<const ROWS: usize, const POSITIVE: bool>(
        &mut self,
        noise: T,
        mut mean: Option<&mut [T; 6]>,
    ) -> Dropped<T> {
        let mut gathered = Gathered::new(noise);
        let [h0, h1, h2, h3, h4, _] = self.rows[ROWS - 1];
        self.give::<ROWS, POSITIVE>(ROWS - 1, noise.constant(1.0), &mut gathered, &mut mean);
        if ROWS > 5 {
            self.give::<ROWS, POSITIVE>(4, h4, &mut gathered, &mut mean);
        }
        if ROWS > 4 {
            self.give::<ROWS, POSITIVE>(3, h3, &mut gathered, &mut mean);
        }
        if ROWS > 3 {
            self.give::<ROWS, POSITIVE>(2, h2, &mut gathered, &mut mean);
        }
        if ROWS > 2 {
            self.give::<ROWS, POSITIVE>(1, h1, &mut gathered, &mut mean);
        }
        if ROWS > 1 {
            self.give::<ROWS, POSITIVE>(0, h0, &mut gathered, &mut mean);
        }
        gathered.dropped()
    }

    /// Moves the part of column `j` along the measurement, `h`, to the accumulated column, for the first `ROWS` rows.
    #[inline(always)]
    fn give<const ROWS: usize, const POSITIVE: bool>(
        &mut self,
        j: usize,
        h: T,
        to: &mut Gathered<T>,
        mean: &mut Option<&mut [T; 6]>,
    ) {
        let weighted = h * self.weights[j];
        let total = h.mul_add(weighted, to.variance);
        let (before, inverse) = divisor::<T, POSITIVE>(to.variance, total);
        let kept = before * inverse;
        let share = h * to.inverse;
        self.weights[j] *= kept;
        // Slices instead of iterators with `skip`, which the compiler does not always inline.
        for (row, gathered) in self.rows[j + 1..ROWS].iter_mut().zip(&mut to.column[j + 1..ROWS]) {
            let x = row[j];
            row[j] = x.minus_product(share, *gathered);
            *gathered = weighted.mul_add(x, *gathered);
        }
        to.column[j] = weighted;
        if let Some(y) = mean {
            let along = y[j];
            y[j] = minus(kept, along, weighted * inverse, to.predicted);
            to.predicted = h.mul_add(along, to.predicted);
        }
        to.variance = total;
        to.inverse = inverse;
    }

    /// Sets the row of one component to exact zeros, the result of a measurement without noise.
    #[inline(always)]
    pub fn clear(&mut self, component: usize) {
        let row = root_row(component);
        for entry in &mut self.rows[row][..row] {
            *entry = entry.constant(0.0);
        }
        self.weights[row] = self.weights[row].constant(0.0);
    }
}

impl<T: Real> RigidShift<T> {
    /// phi L: the columns of a child's root in the parent frame. About 60 products.
    #[inline(always)]
    pub(crate) fn root_to_parent(&self, s: &Root6<T>, columns: &mut RootColumns<T>) {
        let o = s.weights[0].constant(0.0);
        for (weight, &of_child) in columns.weights.iter_mut().zip(&s.weights) {
            *weight = of_child;
        }
        let r = &self.rotation;
        for j in 0..3 {
            let force = match j {
                0 => self.rotate(&Vector3::new(o.constant(1.0), s.rows[1][0], s.rows[2][0])),
                1 => Vector3::new(
                    r[(0, 2)].mul_add(s.rows[2][1], r[(0, 1)]),
                    r[(1, 2)].mul_add(s.rows[2][1], r[(1, 1)]),
                    r[(2, 2)].mul_add(s.rows[2][1], r[(2, 1)]),
                ),
                _ => Vector3::new(r[(0, 2)], r[(1, 2)], r[(2, 2)]),
            };
            let turned = self.rotate(&Vector3::new(s.rows[3][j], s.rows[4][j], s.rows[5][j]));
            let moment = cross_add(&self.lever, &force, &turned);
            for i in 0..3 {
                columns.rows[i][j] = force[i];
                columns.rows[i + 3][j] = moment[i];
            }
        }
        for i in 0..3 {
            columns.rows[i + 3][3] = r[(i, 2)].mul_add(s.rows[5][3], r[(i, 1)].mul_add(s.rows[4][3], r[(i, 0)]));
            columns.rows[i + 3][4] = r[(i, 2)].mul_add(s.rows[5][4], r[(i, 1)]);
            columns.rows[i + 3][5] = r[(i, 2)];
        }
    }
}
