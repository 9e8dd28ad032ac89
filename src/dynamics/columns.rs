//! Columns of M^-1, vectorized (SIMD) over a block of columns.
//!
//! A block has one adjacent column per lane of `C`. Each block has one vector per body. A lane whose column has no
//! entry at a body holds zeros there, so that columns of different branches are processed in one sweep.

use crate::filter::HingeMap;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::{RigidShift, Symmetric3, Symmetric6, zero};
use nalgebra::{Matrix3, Vector3, Vector6};
use std::ops::Range;

/// Scratch for one block: one vector per body, and flags of the bodies that have one.
#[derive(Debug, Clone)]
pub struct Columns<C: Real> {
    /// One vector per body.
    pub(super) at: Vec<Vector6<C>>,
    /// True if a column of the block has an entry at the body.
    pub(super) active: Vec<bool>,
}

impl<C: Real> Columns<C> {
    /// Scratch for `bodies` bodies.
    #[must_use]
    pub fn new(bodies: usize) -> Self {
        Self { at: vec![Vector6::from_element(C::from_f64(f64::NAN)); bodies], active: vec![false; bodies] }
    }

    /// Clears bodies 0 to `last`.
    #[inline(always)]
    pub(super) fn clear(&mut self, last: usize) {
        self.at[..=last].fill(zero());
        self.active[..=last].fill(false);
    }

    /// Writes one column's vector at a body.
    #[inline(always)]
    pub(super) fn insert<T: Real>(&mut self, body: usize, lane: usize, x: &Vector6<T>)
    where
        C: ColumnsOf<T>,
    {
        for (entry, &x) in self.at[body].iter_mut().zip(x.iter()) {
            entry.set_column(lane, x);
        }
        self.active[body] = true;
    }

    /// Adds to the vector of a body.
    #[inline(always)]
    pub(super) fn add(&mut self, body: usize, x: &Vector6<C>) {
        self.at[body] = crate::spatial::sum(&self.at[body], x);
        self.active[body] = true;
    }
}

/// phi for every column; `like` determines only the type, here and below.
#[inline(always)]
pub(super) fn spread_shift<T: Real, C: ColumnsOf<T>>(like: C, shift: &RigidShift<T>) -> RigidShift<C> {
    let l = &shift.lever;
    RigidShift {
        rotation: spread_matrix(like, &shift.rotation),
        lever: Vector3::new(like.spread(l[0]), like.spread(l[1]), like.spread(l[2])),
    }
}

#[inline(always)]
fn spread_matrix<T: Real, C: ColumnsOf<T>>(like: C, m: &Matrix3<T>) -> Matrix3<C> {
    Matrix3::new(
        like.spread(m[(0, 0)]),
        like.spread(m[(0, 1)]),
        like.spread(m[(0, 2)]),
        like.spread(m[(1, 0)]),
        like.spread(m[(1, 1)]),
        like.spread(m[(1, 2)]),
        like.spread(m[(2, 0)]),
        like.spread(m[(2, 1)]),
        like.spread(m[(2, 2)]),
    )
}

/// The same vector for every column.
#[inline(always)]
pub(super) fn spread_vector<T: Real, C: ColumnsOf<T>>(like: C, x: &Vector6<T>) -> Vector6<C> {
    Vector6::new(
        like.spread(x[0]),
        like.spread(x[1]),
        like.spread(x[2]),
        like.spread(x[3]),
        like.spread(x[4]),
        like.spread(x[5]),
    )
}

/// The same symmetric matrix for every column.
#[inline(always)]
pub(super) fn spread_symmetric<T: Real, C: ColumnsOf<T>>(like: C, m: &Symmetric6<T>) -> Symmetric6<C> {
    Symmetric6 {
        angular: Symmetric3::new(spread_six(like, &m.angular.entries)),
        coupling: spread_matrix(like, &m.coupling),
        linear: Symmetric3::new(spread_six(like, &m.linear.entries)),
    }
}

#[inline(always)]
fn spread_six<T: Real, C: ColumnsOf<T>>(like: C, x: &[T; 6]) -> [C; 6] {
    [like.spread(x[0]), like.spread(x[1]), like.spread(x[2]), like.spread(x[3]), like.spread(x[4]), like.spread(x[5])]
}

/// The hinge map for every column.
#[inline(always)]
pub(super) fn spread_hinge<T: Real, C: ColumnsOf<T>>(like: C, hinge: HingeMap<T>) -> HingeMap<C> {
    match hinge {
        HingeMap::Axis(i) => HingeMap::Axis(i),
        HingeMap::Screw(pitch) => HingeMap::Screw(like.spread(pitch)),
    }
}

/// Adjacent columns that are computed together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block {
    /// The first column.
    pub first: usize,
    /// One past the last.
    pub end: usize,
}

impl Block {
    /// The block after those that end at `first`, at most `width` columns of `all`.
    #[inline(always)]
    pub fn from(first: usize, width: usize, all: usize) -> Self {
        Self { first, end: (first + width).min(all) }
    }

    /// Its columns from `from` to before `to`.
    #[inline(always)]
    pub fn between(&self, from: usize, to: usize) -> Range<usize> {
        let from = from.max(self.first);
        from..to.min(self.end).max(from)
    }
}

/// The body whose joint has this row.
#[inline(always)]
pub(super) fn body_of_row<T: Real>(model: &Model<T>, row: usize) -> usize {
    model.system.stages.partition_point(|stage| stage.first_row <= row) - 1
}

/// Writes the entries of some columns of a block in one row, with their mirror images.
#[inline(always)]
pub(super) fn put_row<T: Real, C: ColumnsOf<T>>(
    out: &mut [T],
    nv: usize,
    row: usize,
    (block, columns): (Block, Range<usize>),
    entry: &C,
) {
    for column in columns {
        put(out, nv, (row, column), entry.column(column - block.first));
    }
}

/// One entry and its mirror image.
#[inline(always)]
pub(super) fn put<T: Real>(out: &mut [T], nv: usize, (row, column): (usize, usize), value: T) {
    out[row * nv + column] = value;
    out[column * nv + row] = value;
}
