//! -M^-1 times dtau/dq and dtau/dqd, both at once, without the zeros between branches.

use crate::dynamics::sweeps::SweepModel;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, larger};

/// Rows of the result that are computed together.
const ROWS: usize = 4;

/// Scratch of the product; allocated when it is first needed.
#[derive(Debug)]
pub(crate) struct Product<T: Real, C: ColumnsOf<T>> {
    /// For each block of columns, the rows that have entries, and the end of its entries among the packed ones.
    blocks: Vec<(Vec<u32>, usize)>,
    /// For each block, row by row: dtau/dq and dtau/dqd.
    packed: Vec<[C; 2]>,
    /// The largest entry of each row of M^-1.
    largest: Vec<T>,
    /// M^-1 has entries between all branches: it is that through connections.
    is_dense: bool,
}

impl<T: Real, C: ColumnsOf<T>> Product<T, C> {
    /// Empty scratch.
    pub fn new(is_dense: bool) -> Self {
        Self { blocks: Vec::new(), packed: Vec::new(), largest: Vec::new(), is_dense }
    }

    /// For an M^-1 that is a difference: the largest term of each row, which the caller sets before the product.
    #[inline(always)]
    pub fn terms_of_inverse(&mut self, scene: (&Model<T>, &SweepModel<T>)) -> &mut [T] {
        if self.blocks.is_empty() {
            self.make(scene.0, scene.1);
        }
        &mut self.largest
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        let nv = model.nv();
        self.largest = vec![T::from_f64(f64::NAN); nv];
        let mut holds = vec![vec![self.is_dense; nv]; nv.div_ceil(C::COLUMNS)];
        sweeps.each_pair(model, |row, column| {
            holds[column / C::COLUMNS][row] = true;
            holds[row / C::COLUMNS][column] = true;
        });
        let mut end = 0;
        for holds in holds {
            let rows: Vec<u32> = (0..).zip(holds).filter(|(_, holds)| *holds).map(|(row, _)| row).collect();
            end += rows.len();
            self.blocks.push((rows, end));
        }
        self.packed = vec![[C::zero(); 2]; end];
    }

    /// -M^-1 times both, in place: `out` holds dtau/dq, dtau/dqd and M^-1, one after another. Returns the margin of the
    /// precision: negative or NaN where eps times the terms of the largest column exceeds `accepted`, in eps of the
    /// largest entry.
    #[inline(always)]
    pub fn in_place(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        (like, accepted): (C, T),
        out: &mut [C::Entry],
    ) -> T {
        let nv = scene.0.nv();
        self.terms_of_inverse(scene);
        let terms = self.pack(nv, like, out);
        let (both, inverse) = out.split_at_mut(2 * nv * nv);
        let (of_q, of_qd) = both.split_at_mut(nv * nv);
        let Self { blocks, packed, .. } = self;
        let mut size = [like; 2];
        for row in (0..nv).step_by(ROWS) {
            let count = ROWS.min(nv - row);
            let of_row = |r: usize| &inverse[(row + r.min(count - 1)) * nv..][..nv];
            let of_rows = [of_row(0), of_row(1), of_row(2), of_row(3)];
            let mut begin = 0;
            for (at, &(ref rows, end)) in blocks.iter().enumerate() {
                let mut sums = [[like; 2]; ROWS];
                for (&i, entries) in rows.iter().zip(&packed[begin..end]) {
                    for (sums, of_row) in sums.iter_mut().zip(of_rows) {
                        let factor = like.spread(C::taken(of_row[i as usize]));
                        sums[0] = sums[0].minus_product(factor, entries[0]);
                        sums[1] = sums[1].minus_product(factor, entries[1]);
                    }
                }
                begin = end;
                let first = at * C::COLUMNS;
                let width = C::COLUMNS.min(nv - first);
                for (r, &[by_q, by_qd]) in sums[..count].iter().enumerate() {
                    size[0] = larger(size[0], only(like, by_q, width).abs());
                    size[1] = larger(size[1], only(like, by_qd, width).abs());
                    let to = (row + r) * nv + first;
                    put::<T, C>(by_q, &mut of_q[to..to + width]);
                    put::<T, C>(by_qd, &mut of_qd[to..to + width]);
                }
            }
        }
        margin(terms, size, accepted)
    }

    /// Packs the blocks. Returns, per lane, the largest sum of the terms of a column.
    #[inline(always)]
    fn pack(&mut self, nv: usize, like: C, out: &[C::Entry]) -> [C; 2] {
        let Self { blocks, packed, largest, is_dense } = self;
        for (i, largest) in largest.iter_mut().enumerate() {
            let row = &out[(2 * nv + i) * nv..][..nv];
            let mut all = if *is_dense { like.spread(*largest) } else { like };
            let whole = row.chunks_exact(C::COLUMNS);
            for &entry in whole.remainder() {
                all = larger(all, like.spread(C::taken(entry).abs()));
            }
            for block in whole {
                all = larger(all, like.load(block).abs());
            }
            *largest = all.column(0);
            for column in 1..C::COLUMNS {
                *largest = larger(*largest, all.column(column));
            }
        }
        let (mut most, mut begin) = ([like; 2], 0);
        for (at, &(ref rows, end)) in blocks.iter().enumerate() {
            let first = at * C::COLUMNS;
            let mut terms = [like; 2];
            for (&i, packed) in rows.iter().zip(&mut packed[begin..end]) {
                let i = i as usize;
                // Lanes beyond the last column read the next row, or M^-1 after both matrices; these results are not
                // used.
                *packed = [some(like, &out[i * nv + first..]), some(like, &out[(nv + i) * nv + first..])];
                let largest = like.spread(largest[i]);
                terms[0] = largest.mul_add(packed[0].abs(), terms[0]);
                terms[1] = largest.mul_add(packed[1].abs(), terms[1]);
            }
            begin = end;
            let width = C::COLUMNS.min(nv - first);
            most = [larger(most[0], only(like, terms[0], width)), larger(most[1], only(like, terms[1], width))];
        }
        most
    }
}

/// A block from the beginning of a slice. For a single joint the slice is shorter and is padded with zeros.
#[inline(always)]
fn some<T: Real, C: ColumnsOf<T>>(mut like: C, from: &[C::Entry]) -> C {
    if from.len() >= C::COLUMNS {
        return like.load(from);
    }
    for (column, &entry) in from.iter().enumerate() {
        like.set_column(column, C::taken(entry));
    }
    like
}

/// The first columns of a block, zero in the others.
#[inline(always)]
fn only<T: Real, C: ColumnsOf<T>>(like: C, mut block: C, width: usize) -> C {
    if width < C::COLUMNS {
        for column in width..C::COLUMNS {
            block.set_column(column, like.column(0));
        }
    }
    block
}

/// Writes the columns of a block that fit.
#[inline(always)]
fn put<T: Real, C: ColumnsOf<T>>(block: C, to: &mut [C::Entry]) {
    if to.len() == C::COLUMNS {
        block.store(to);
        return;
    }
    for (column, to) in to.iter_mut().enumerate() {
        *to = C::kept(block.column(column));
    }
}

/// The accepted error minus the rounding of the terms, in eps, of the matrix with less of it.
#[inline(always)]
fn margin<T: Real, C: ColumnsOf<T>>(terms: [C; 2], size: [C; 2], accepted: T) -> T {
    let [by_q, by_qd] = [0, 1].map(|matrix| {
        let (mut terms_of, mut size_of) = (terms[matrix].column(0), size[matrix].column(0));
        for column in 1..C::COLUMNS {
            terms_of = larger(terms_of, terms[matrix].column(column));
            size_of = larger(size_of, size[matrix].column(column));
        }
        size_of * accepted - terms_of
    });
    by_q.worst(by_qd)
}
