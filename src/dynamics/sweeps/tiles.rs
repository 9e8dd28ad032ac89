//! D^-1/2 (1 - L) and M^-1 in tiles of four rows and four columns.
//!
//! A tile of M^-1 needs the joints inward of one of its rows and of one of its columns; the factors of all other joints
//! are zero.

use super::model::SweepModel;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use std::ops::Range;

/// Rows and columns of a tile.
pub(super) const TILE: usize = 4;

/// For each row its blocks, with room for the largest number of blocks.
pub(super) type Tile<C> = [[C; TILE]; TILE];

/// Four rows and one or more groups of four columns that are multiplied together. The first group of columns is not
/// further out than the rows.
#[derive(Debug, Clone)]
pub(super) struct Pair {
    pub side: usize,
    pub other: usize,
    /// The range in [`Tiles::inward`] of joints that contribute to both; joints further out than the columns contribute
    /// zero.
    pub joints: Range<usize>,
}

/// One in one lane and zero in the others, for each lane.
pub(super) fn units<T: Real, C: ColumnsOf<T>>() -> Vec<C> {
    let unit = |lane| {
        let mut unit = C::zero();
        unit.set_column(lane, T::one());
        unit
    };
    (0..C::COLUMNS).map(unit).collect()
}

/// Scratch of the product.
#[derive(Debug)]
pub(crate) struct Tiles<T: Real, C: ColumnsOf<T>> {
    /// D^-1/2 (1 - L) by rows, in blocks of columns; zero if the joint of the column is not outward of that of the row.
    /// The last element is a dummy for unused writes.
    pub(super) factors: Vec<C>,
    /// The indices to which [`put_factors`] writes, in the order of the sweep; only the first `C::COLUMNS` of each are
    /// used.
    pub(super) targets: Vec<[usize; TILE]>,
    /// One in one lane, zero in the others.
    pub(super) units: Vec<C>,
    /// The pairs of rows and columns, in order.
    pub(super) pairs: Vec<Pair>,
    /// For each group of four rows: the first factor of each joint inward of one of them.
    pub(super) inward: Vec<usize>,
    pub(super) entries: Entries<T, C>,
    pub(super) nv: usize,
    /// Number of blocks per row.
    pub(super) blocks: usize,
}

impl<T: Real, C: ColumnsOf<T>> Tiles<T, C> {
    /// Number of blocks in a tile.
    pub(super) const ACROSS: usize = TILE / C::COLUMNS;

    /// Number of tiles that are multiplied at once: more would not fit into the registers.
    pub(super) const AT_ONCE: usize = if C::COLUMNS == 1 { 1 } else { 2 };

    /// Empty scratch.
    pub(super) fn new() -> Self {
        Self {
            factors: Vec::new(),
            targets: Vec::new(),
            units: Vec::new(),
            pairs: Vec::new(),
            inward: Vec::new(),
            entries: Entries::new(),
            nv: 0,
            blocks: 0,
        }
    }

    /// Allocates the scratch for a scene.
    pub(super) fn prepare(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        const { assert!(TILE.is_multiple_of(C::COLUMNS), "a tile is some blocks across") }
        let nv = model.nv();
        let across = nv.div_ceil(TILE);
        let blocks = (across + Self::AT_ONCE - 1) * Self::ACROSS;
        (self.nv, self.blocks) = (nv, blocks);
        self.factors = vec![C::zero(); nv * blocks + 1];
        self.units = units::<T, C>();
        let rows = |k: usize| sweeps.bodies[k].row..sweeps.bodies[k].row + model.system.stages[k].rows.count();
        let mut sides = vec![Vec::new(); across];
        for body in sweeps.swept() {
            let k = body.index;
            let mut path: Vec<usize> = std::iter::successors(body.parent, |&parent| sweeps.bodies[parent].parent)
                .flat_map(|inward| rows(inward).rev())
                .collect();
            path.reverse();
            for columns in path.chunks(C::COLUMNS) {
                for row in rows(k) {
                    let target =
                        |lane| columns.get(lane).map_or(nv * blocks, |joint| joint * blocks + row / C::COLUMNS);
                    self.targets.push([0, 1, 2, 3].map(target));
                }
            }
            for row in rows(k) {
                sides[row / TILE].extend(path.iter().copied().chain(body.row..=row));
            }
        }
        // Tiles without a joint inward of them are not among the pairs.
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
}

/// Writes w of a block of joints in a row outward of them; `lane` is the lane of the row.
#[inline(always)]
pub(super) fn put_factors<T: Real, C: ColumnsOf<T>>(factors: &mut [C], targets: &[usize; TILE], lane: usize, w: &C) {
    for (column, &target) in targets[..C::COLUMNS].iter().enumerate() {
        factors[target].set_column(lane, w.column(column));
    }
}

/// Writes one tile of the lower triangle and its mirror image, for one state. In lanes, writes the `number`th tile to
/// the buffer. WHICH selects the tile among those that are computed together.
#[inline(always)]
pub(super) fn put<T: Real, C: ColumnsOf<T>, const WHICH: usize>(
    numbers: &mut [C::Entry],
    nv: usize,
    (side, other): (usize, usize),
    number: usize,
    sums: &Tile<C>,
) {
    let (width, across) = (C::COLUMNS, TILE / C::COLUMNS);
    let block = |i: usize, j: usize| sums[i][WHICH * across + j];
    if T::LANES > 1 {
        let to = &mut numbers[1 + number * TILE * TILE..][..TILE * TILE];
        for i in 0..TILE {
            for j in 0..across {
                block(i, j).store(&mut to[i * TILE + j * width..][..width]);
            }
        }
        return;
    }
    let (row, column) = (side * TILE, other * TILE);
    let rows = TILE.min(nv - row);
    if rows < TILE {
        put_some::<T, C>(numbers, nv, (row, column), (rows, if side == other { rows } else { TILE }), block);
        return;
    }
    // A tile on the diagonal is symmetric to the last bit.
    let mirrors = side != other;
    for down in 0..across {
        for j in 0..across {
            let mut square = [sums[0][0]; TILE];
            let square = &mut square[..width];
            for (i, to) in square.iter_mut().enumerate() {
                *to = block(down * width + i, j);
            }
            let (row, column) = (row + down * width, column + j * width);
            put_square::<T, C>(&mut numbers[row * nv + column..], nv, square);
            if mirrors {
                C::transpose(square);
                put_square::<T, C>(&mut numbers[column * nv + row..], nv, square);
            }
        }
    }
}

/// The same number, known to be below 2^32, so that the compiler can prove that products do not overflow and that one
/// check of a length covers all smaller indices.
#[inline(always)]
#[allow(clippy::cast_possible_truncation)] // a matrix of that many rows fits no memory
pub(super) fn below_overflow(nv: usize) -> usize {
    nv as u32 as usize
}

/// Writes a square block of rows from the beginning of `out`, each row below the previous one.
#[inline(always)]
fn put_square<T: Real, C: ColumnsOf<T>>(out: &mut [C::Entry], nv: usize, square: &[C]) {
    let (width, side) = (C::COLUMNS, below_overflow(nv));
    assert!(out.len() >= (width - 1) * side + width, "a square of the matrix");
    let mut at = 0;
    for row in square {
        row.store(&mut out[at..at + width]);
        at += side;
    }
}

/// Writes the first rows and columns of a tile at the end of the matrix, entry by entry, and their mirror images.
#[inline(always)]
fn put_some<T: Real, C: ColumnsOf<T>>(
    out: &mut [C::Entry],
    nv: usize,
    (row, column): (usize, usize),
    (rows, columns): (usize, usize),
    block: impl Fn(usize, usize) -> C,
) {
    for i in 0..TILE {
        for j in 0..TILE {
            if i < rows && j < columns {
                let value = C::kept(block(i, j / C::COLUMNS).column(j % C::COLUMNS));
                out[(row + i) * nv + column + j] = value;
                out[(column + j) * nv + row + i] = value;
            }
        }
    }
}

/// Entries of a symmetric matrix.
#[derive(Debug, Clone)]
pub(crate) struct Entries<T: Real, C: ColumnsOf<T>> {
    /// In lanes: one zero, followed by the entries of one triangle that are not zero by structure, or by the tiles that
    /// contain them. Empty for one state, whose entries are written directly to the result.
    pub numbers: Vec<C::Entry>,
    /// In lanes: the index in `numbers` of each entry of the matrix.
    chosen: Vec<u32>,
    pub(in crate::dynamics) is_made: bool,
    /// True if the matrix has entries that are never written.
    has_gaps: bool,
    /// Zero if every checked entry is finite, otherwise NaN.
    pub(in crate::dynamics) fault: C,
}

impl<T: Real, C: ColumnsOf<T>> Entries<T, C> {
    /// An empty buffer.
    pub(in crate::dynamics) fn new() -> Self {
        Self { numbers: Vec::new(), chosen: Vec::new(), is_made: false, has_gaps: false, fault: C::zero() }
    }

    /// Allocates the buffer with zeros, from the number of values and the indices that `choices` returns.
    pub(in crate::dynamics) fn make(&mut self, has_gaps: bool, choices: impl FnOnce() -> (u32, Vec<u32>)) {
        (self.is_made, self.has_gaps) = (true, has_gaps);
        if T::LANES > 1 {
            let (count, chosen) = choices();
            (self.numbers, self.chosen) = (vec![C::kept(T::zero()); count as usize], chosen);
        }
    }

    /// Prepares for a state: resets the check, and for one state sets the entries of `out` to zero that are never
    /// written.
    #[inline(always)]
    pub(in crate::dynamics) fn begin(&mut self, out: &mut [C::Entry]) {
        self.fault = self.zero();
        if T::LANES == 1 && self.has_gaps {
            out.fill(C::kept(T::zero()));
        }
    }

    /// A zero of this type; other ways to create one query the processor's features at each call.
    #[inline(always)]
    pub(in crate::dynamics) fn zero(&self) -> C {
        self.fault.constant(0.0)
    }

    /// In lanes: the index in the buffer of each entry of the matrix.
    #[inline(always)]
    pub fn chosen(&self) -> &[u32] {
        &self.chosen
    }

    /// Zero if every checked entry is finite, otherwise NaN.
    #[inline(always)]
    pub fn fault(&self) -> T {
        let mut fault = self.fault.column(0);
        for column in 1..C::COLUMNS {
            fault += self.fault.column(column);
        }
        fault
    }
}
