//! Matrices whose entries are near the diagonal: an order of the unknowns for which they are, and LU with row
//! exchanges.

use std::collections::VecDeque;

/// A square matrix with `width` entries on each side of the diagonal. Row exchanges of the factorization extend it to
/// 2 `width` entries after the diagonal.
#[derive(Debug, Clone)]
pub(super) struct Band {
    size: usize,
    width: usize,
    /// Entry (i, j) at i (3 width + 1) + j - i + width.
    entries: Vec<f64>,
    /// The row that was exchanged with each row.
    exchanged: Vec<usize>,
}

impl Band {
    pub fn identity(size: usize, band: usize) -> Self {
        let mut matrix =
            Self { size, width: band, entries: vec![0.0; size * (3 * band + 1)], exchanged: vec![0; size] };
        for i in 0..size {
            matrix.add(i, i, 1.0);
        }
        matrix
    }

    const fn at(&self, i: usize, j: usize) -> usize {
        i * (3 * self.width + 1) + j + self.width - i
    }

    /// Adds to an entry within the band.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        let at = self.at(i, j);
        self.entries[at] += value;
    }

    /// Replaces the matrix by its factor; returns false if it is singular.
    pub fn factorize(&mut self) -> bool {
        for k in 0..self.size {
            let below = (k + self.width).min(self.size - 1);
            let last = (k + 2 * self.width).min(self.size - 1);
            let largest = |best: usize, i: usize| {
                if self.entries[self.at(i, k)].abs() > self.entries[self.at(best, k)].abs() { i } else { best }
            };
            let pivot = (k + 1..=below).fold(k, largest);
            self.exchanged[k] = pivot;
            if pivot != k {
                for j in k..=last {
                    let (a, b) = (self.at(k, j), self.at(pivot, j));
                    self.entries.swap(a, b);
                }
            }
            let (from, to) = (self.at(k, k), self.at(k, last));
            if !(self.entries[from].abs() > 0.0) {
                return false;
            }
            for i in k + 1..=below {
                let own = self.at(i, k);
                let (above, rest) = self.entries.split_at_mut(own);
                let row = &above[from..=to];
                let factor = rest[0] / row[0];
                rest[0] = factor;
                if factor != 0.0 {
                    for (entry, above) in rest[1..].iter_mut().zip(&row[1..]) {
                        *entry -= factor * above;
                    }
                }
            }
        }
        true
    }

    /// Replaces a right-hand side by the solution, after [`Band::factorize`].
    pub fn solve(&self, x: &mut [f64]) {
        for k in 0..self.size {
            x.swap(k, self.exchanged[k]);
            for i in k + 1..=(k + self.width).min(self.size - 1) {
                x[i] -= self.entries[self.at(i, k)] * x[k];
            }
        }
        for k in (0..self.size).rev() {
            let last = (k + 2 * self.width).min(self.size - 1);
            let (row, above) = (&self.entries[self.at(k, k)..=self.at(k, last)], &x[k..=last]);
            let products = row[1..].iter().zip(&above[1..]).map(|(entry, x)| entry * x);
            x[k] = (x[k] - products.sum::<f64>()) / row[0];
        }
    }
}

/// The new number of each unknown, and the width of a matrix whose unknowns are coupled in groups: in the order in
/// which a search from an unknown at an end reaches them.
// E. Cuthill and J. McKee, Proceedings of the 24th ACM National Conference, 1969.
pub(super) fn narrow<'a>(groups: impl Iterator<Item = &'a [usize]> + Clone, unknowns: usize) -> (Vec<usize>, usize) {
    let mut beside: Vec<Vec<usize>> = vec![Vec::new(); unknowns];
    let mut all: Vec<&[usize]> = groups.collect();
    all.sort_unstable();
    all.dedup();
    for (at, group) in all.iter().enumerate() {
        group.iter().for_each(|&i| beside[i].push(at));
    }
    // Groups, in the order in which a search from an unknown reaches them; and the unknowns.
    let reach = |from: usize, number: &mut [Option<usize>], next: &mut usize| {
        let (mut waiting, mut seen) = (VecDeque::from([from]), vec![false; all.len()]);
        let mut last = from;
        number[from] = Some(*next);
        *next += 1;
        while let Some(i) = waiting.pop_front() {
            last = i;
            let mut groups: Vec<usize> = beside[i].iter().copied().filter(|&at| !seen[at]).collect();
            groups.sort_by_key(|&at| all[at].len());
            for at in groups {
                seen[at] = true;
                for &j in all[at] {
                    if number[j].is_none() {
                        number[j] = Some(*next);
                        *next += 1;
                        waiting.push_back(j);
                    }
                }
            }
        }
        last
    };
    let (mut number, mut next) = (vec![None; unknowns], 0);
    for i in 0..unknowns {
        if number[i].is_none() {
            let end = reach(i, &mut number.clone(), &mut next.clone());
            reach(end, &mut number, &mut next);
        }
    }
    let order: Vec<usize> = number.into_iter().map(Option::unwrap_or_default).collect();
    let band = |group: &&[usize]| {
        let each = || group.iter().map(|&i| order[i]);
        each().max().unwrap_or_default() - each().min().unwrap_or_default()
    };
    let band = all.iter().map(band).max().unwrap_or_default();
    (order, band)
}
