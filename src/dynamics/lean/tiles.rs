//! 1 - L and M^-1 in tiles of four rows and four columns.
//!
//! A tile of M^-1 needs the joints inward of one of its rows and of one of its columns; in the others its factors are zero.

use super::body::LeanModel;
use super::columns::units;
use super::entries::Entries;
use crate::filter::riccati::Measured;
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;
use std::ops::Range;

/// Rows and columns of a tile.
pub(super) const TILE: usize = 4;

/// Of each row its blocks, and room for the most that there are.
pub(super) type Tile<C> = [[C; TILE]; TILE];

/// A four of rows and as many fours of columns as are multiplied at once, the first of them no further out than the rows.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    pub side: usize,
    pub other: usize,
    /// Those in [`Tiles::inward`] that both have something of: joints further out than the columns have nothing there.
    pub joints: Range<usize>,
}

/// Scratch of the product.
#[derive(Debug)]
pub(crate) struct Tiles<T: Real, C: ColumnsOf<T>> {
    /// 1 - L by rows, in blocks of columns; zero where the column's joint is not outward of the row's. Behind all of it one place for what means nothing.
    pub(super) factors: Vec<C>,
    /// The same over D.
    pub(super) over_pivots: Vec<C>,
    /// By rows those that are not zero.
    held: Vec<Range<usize>>,
    /// Where [`put_factors`] puts them, in the order of the sweep.
    pub(super) targets: Vec<usize>,
    /// One in one lane, zero in the others.
    pub(super) units: Vec<C>,
    /// What is multiplied, in order.
    pub(super) pairs: Vec<Pair>,
    /// By fours of rows: where the factors begin of each joint inward of one of them.
    pub(super) inward: Vec<usize>,
    pub(super) entries: Entries<T, C>,
    pub(super) nv: usize,
    /// Of a row.
    pub(super) blocks: usize,
}

impl<T: Real, C: ColumnsOf<T>> Tiles<T, C> {
    /// Blocks side by side in a tile.
    pub(super) const ACROSS: usize = TILE / C::COLUMNS;

    /// Tiles side by side that are multiplied at once: more would not fit the registers.
    pub(super) const AT_ONCE: usize = if C::COLUMNS == 1 { 1 } else { 2 };

    /// None yet.
    pub(super) fn new() -> Self {
        Self {
            factors: Vec::new(),
            over_pivots: Vec::new(),
            held: Vec::new(),
            targets: Vec::new(),
            units: Vec::new(),
            pairs: Vec::new(),
            inward: Vec::new(),
            entries: Entries::new(),
            nv: 0,
            blocks: 0,
        }
    }

    /// Makes them for a scene.
    pub(super) fn prepare(&mut self, model: &Model<T>, lean: &LeanModel<T>) {
        const { assert!(TILE.is_multiple_of(C::COLUMNS), "a tile is some blocks across") }
        let nv = model.nv();
        let across = nv.div_ceil(TILE);
        let blocks = (across + Self::AT_ONCE - 1) * Self::ACROSS;
        (self.nv, self.blocks) = (nv, blocks);
        self.factors = vec![C::zero(); nv * blocks + 1];
        self.units = units::<T, C>();
        let rows = |k: usize| lean.bodies[k].row..lean.bodies[k].row + model.system.stages[k].rows.count();
        let mut sides = vec![Vec::new(); across];
        for (k, body) in lean.bodies.iter().enumerate() {
            let mut path: Vec<usize> = std::iter::successors(body.parent, |&parent| lean.bodies[parent].parent)
                .flat_map(|inward| rows(inward).rev())
                .collect();
            path.reverse();
            for columns in path.chunks(C::COLUMNS) {
                for row in rows(k) {
                    let target =
                        |lane| columns.get(lane).map_or(nv * blocks, |joint| joint * blocks + row / C::COLUMNS);
                    self.targets.extend((0..C::COLUMNS).map(target));
                }
            }
            for row in rows(k) {
                self.held.push(row * blocks + row / C::COLUMNS..row * blocks + body.end_row.div_ceil(C::COLUMNS));
                self.factors[row * blocks + row / C::COLUMNS].set_column(row % C::COLUMNS, T::one());
                sides[row / TILE].extend(path.iter().copied().chain(body.row..=row));
            }
        }
        self.over_pivots = self.factors.clone();
        // Of tiles that no joint is inward of there is none in the pairs.
        let mut has_gaps = false;
        for (side, mut joints) in sides.into_iter().enumerate() {
            joints.sort_unstable();
            joints.dedup();
            let (first, nearest) = (self.inward.len(), joints.first().map_or(side, |joint| joint / TILE));
            has_gaps |= nearest != 0;
            for other in (nearest..=side).step_by(Self::AT_ONCE) {
                let common = joints.partition_point(|joint| joint / TILE < other + Self::AT_ONCE);
                self.pairs.push(Pair { side, other, joints: first..first + common });
            }
            self.inward.extend(joints.iter().map(|joint| joint * blocks));
        }
        let pairs = &self.pairs;
        self.entries.make(has_gaps, || {
            let (mut chosen, mut next) = (vec![0; nv * nv], 1);
            for Pair { side, other, .. } in pairs {
                for row in side * TILE..(side + 1) * TILE {
                    for column in other * TILE..(other + 1) * TILE {
                        if column <= row && row < nv {
                            (chosen[row * nv + column], chosen[column * nv + row]) = (next, next);
                        }
                        next += 1;
                    }
                }
            }
            (next, chosen)
        });
    }

    /// The factors over D.
    #[inline(always)]
    pub(super) fn divide(&mut self, measured: &[Measured<T>]) {
        let Self { factors, over_pivots, held, entries, .. } = self;
        let none = entries.zero();
        for (held, m) in held.iter().zip(measured) {
            let inverse = none.spread(m.pivot_inverse);
            for (over_pivot, &factor) in over_pivots[held.clone()].iter_mut().zip(&factors[held.clone()]) {
                *over_pivot = factor * inverse;
            }
        }
    }
}

/// w of as many joints as a block holds in a row outward of them.
#[inline(always)]
pub(super) fn put_factors<T: Real, C: ColumnsOf<T>>(factors: &mut [C], targets: &[usize], row: usize, w: &C) {
    for (lane, &target) in targets[..C::COLUMNS].iter().enumerate() {
        factors[target].set_column(row % C::COLUMNS, w.column(lane));
    }
}

/// Writes one tile of the lower triangle, the tile WHICH of those side by side: in lanes the `number`th, of one state where it belongs, and its
/// mirror image.
#[inline(always)]
pub(super) fn put<T: Real, C: ColumnsOf<T>, const WHICH: usize>(
    numbers: &mut [C::Entry],
    nv: usize,
    (side, other): (usize, usize),
    number: usize,
    sums: &Tile<C>,
) {
    let across = TILE / C::COLUMNS;
    let block = |i: usize, j: usize| sums[i][WHICH * across + j];
    if T::LANES > 1 {
        let to = &mut numbers[1 + number * TILE * TILE..][..TILE * TILE];
        for i in 0..TILE {
            for j in 0..across {
                block(i, j).store(&mut to[i * TILE + j * C::COLUMNS..][..C::COLUMNS]);
            }
        }
        return;
    }
    // Behind the last row there is nothing.
    let numbers = &mut numbers[..nv * nv];
    let (row, column) = (side * TILE, other * TILE);
    let entry = |i: usize, j: usize| C::kept(block(i, j / C::COLUMNS).column(j % C::COLUMNS));
    if side == other {
        for i in 0..TILE {
            for j in 0..=i {
                if let Some(to) = numbers.get_mut((row + i) * nv + row + j) {
                    *to = entry(i, j);
                    numbers[(row + j) * nv + row + i] = entry(i, j);
                }
            }
        }
        return;
    }
    for i in 0..TILE {
        if let Some(to) = numbers.get_mut((row + i) * nv + column..(row + i) * nv + column + TILE) {
            for j in 0..across {
                block(i, j).store(&mut to[j * C::COLUMNS..(j + 1) * C::COLUMNS]);
            }
        }
    }
    let mirrored = &mut numbers[column * nv..];
    if row + TILE <= nv {
        for down in 0..across {
            for j in 0..across {
                let mut square = [sums[0][0]; TILE];
                let square = &mut square[..C::COLUMNS];
                for (i, to) in square.iter_mut().enumerate() {
                    *to = block(down * C::COLUMNS + i, j);
                }
                C::transpose(square);
                for (i, from) in square.iter().enumerate() {
                    let at = (j * C::COLUMNS + i) * nv + row + down * C::COLUMNS;
                    from.store(&mut mirrored[at..at + C::COLUMNS]);
                }
            }
        }
    } else {
        for i in 0..TILE {
            for j in 0..TILE {
                if row + i < nv {
                    mirrored[j * nv + row + i] = entry(i, j);
                }
            }
        }
    }
}
