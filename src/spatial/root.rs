//! Symmetric 6x6 matrices as P = L W L^T, L unit lower triangular, W a diagonal of weights: square-root form without square roots.
//!
//! The columns of L times the roots of the weights are the columns of a square root S of P. With the linear rows first, L = [[1, 0],
//! [p~, `L_c`]] for a body from the start, its weights its mass and what its central inertia has; what a child sends has
//! three columns free of any linear part. So most of a 6 x 12 stack of columns is zero, and the rotations that bring it back to
//! six touch less than half of it.

use super::rigid_shift::RigidShift;
use super::symmetric::{Symmetric3, Symmetric6};
use super::vector::{cross_add, minus, scaled};
use crate::scalar::Real;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Where a row of a spatial vector (angular first) is in a root (linear first).
#[inline(always)]
#[must_use]
pub const fn root_row(component: usize) -> usize {
    (component + 3) % 6
}

/// L and W of P = L W L^T: rows in the order linear x, y, z, angular x, y, z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Root6<T> {
    /// The weights, zero or positive.
    pub weights: [T; 6],
    /// L: entry (i, j) is used for j < i only; the diagonal is one.
    pub rows: [[T; 6]; 6],
}

/// What a child sends, phi L: three columns with both parts, three with an angular part only.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RootColumns<T> {
    /// The weights of the columns.
    pub weights: [T; 6],
    /// Row by row as in [`Root6`], all entries, but of the last three columns, which are zero in linear rows, those are not used.
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

/// What a measurement takes out of a root.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dropped<T> {
    /// D.
    pub pivot: T,
    /// 1 / D.
    pub pivot_inverse: T,
    /// g.
    pub gain: Vector6<T>,
    /// The measurement that the mean predicts.
    pub predicted: T,
}

/// What a measurement has gathered from some of the columns.
struct Gathered<T> {
    /// P H*.
    column: [T; 6],
    /// What the mean predicts.
    predicted: T,
    /// H P H* + r.
    variance: T,
    inverse: T,
}

/// What a rotation of columns I and C does to row R, if that is below row I.
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

/// `before` and 1 / `total`; where `total`, and so `before`, is zero, one and one.
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
        // Where nothing has been gathered yet there is nothing to share: any inverse will do.
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

    /// `value` in every entry; workspaces start as NaN.
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

    /// The diagonal of P, in the order of the root's rows.
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

    /// Takes in more columns: P becomes P + C W' C^T. Of the last three columns `FREE` (2 or 3) are used. `POSITIVE` where every weight of
    /// P is, and no division needs to be looked after.
    ///
    /// Rotations between one column of L and one of C, scaled so that none needs a square root. Every number is a sum of two
    /// products: errors are relative to each row's length, and to each column's where columns differ in size. `mean` is the
    /// coordinates y and y' of a force L y + C y', turned along. What came in is used up. About 250 products, 24 divisions.
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

    /// Turns the first N incoming entries of row I into its weight. Laid out flat by hand: as loops they are too long for the compiler, and
    /// what is found by a counter stays in memory.
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

    /// Turns the entry of row I in column C into the weight of column I.
    #[inline(always)]
    fn rotate<const I: usize, const C: usize, const POSITIVE: bool>(
        &mut self,
        incoming: &mut RootColumns<T>,
        mean: &mut Option<(&mut [T; 6], &mut [T; 6])>,
    ) {
        let (f, weight) = (incoming.rows[I][C], incoming.weights[C]);
        let weighted = f * weight;
        let total = f.mul_add(weighted, self.weights[I]);
        // Two columns without weight are left as they are: kept is one then.
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

    /// The measurement `h` = H L of the columns 0 to `last` with noise r: P becomes P^+; gives D and g (3.6, 3.10).
    ///
    /// From the last column to the first, what they have along h is gathered in one column, P H*, and taken from the others: Bierman's
    /// update. Without noise it takes a whole column's weight: no covariance is subtracted. `mean` is turned along, and what
    /// leaves with the gathered column is given. About 80 products, 6 divisions.
    #[inline(always)]
    pub fn measure(&mut self, h: &[T; 6], last: usize, noise: T, mut mean: Option<&mut [T; 6]>) -> Dropped<T> {
        let mut gathered = Gathered::new(noise);
        for j in (0..=last).rev() {
            self.give::<6, false>(j, h[j], &mut gathered, &mut mean);
        }
        gathered.dropped()
    }

    /// The same of the last row, angular z, laid out flat: what most joints measure. `POSITIVE` as for [`Root6::join`].
    #[inline(always)]
    pub(crate) fn measure_turn<const POSITIVE: bool>(&mut self, noise: T, mean: Option<&mut [T; 6]>) -> Dropped<T> {
        self.measure_last::<6, POSITIVE>(noise, mean)
    }

    /// The same of the last of the first `ROWS` rows, where those after it are zero.
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

    /// Column `j`, which has `h` along a measurement, gives what it has there to the gathered one; of `ROWS` rows.
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
        // Slices: to skip in both at once is a function that the compiler now and then leaves for itself.
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

    /// Writes exact zeros into the row of one component: what a measurement without noise leaves there.
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
    /// phi L: the columns of a child's root, at its parent. About 60 products.
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
