//! Operation counts, which [`Traced`](super::Traced) accumulates while generic code runs on it.

use std::cell::Cell;
use std::ops::Add;

/// Numbers of operations. Sign changes, absolute values and comparisons are not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Operations {
    /// Sums and differences.
    pub additions: u64,
    /// Products that are not part of a fused multiply-add.
    pub multiplications: u64,
    /// Fused multiply-adds: one instruction on processors that support it.
    pub fused: u64,
    /// Divisions and reciprocals.
    pub divisions: u64,
    /// Square roots.
    pub roots: u64,
    /// Evaluations of sine and cosine of one angle, counted together.
    pub sines: u64,
}

impl Operations {
    /// Zero counts.
    pub const NONE: Self = Self { additions: 0, multiplications: 0, fused: 0, divisions: 0, roots: 0, sines: 0 };

    /// Floating-point operations of a sine with its cosine, in the polynomials for instruction sets with fused
    /// multiply-adds.
    pub const OF_SINES: u64 = 52;

    /// Floating-point operations: one each, two for a fused multiply-add, [`Operations::OF_SINES`] for a sine with its
    /// cosine.
    #[must_use]
    pub fn flops(&self) -> u64 {
        self.additions
            + self.multiplications
            + 2 * self.fused
            + self.divisions
            + self.roots
            + Self::OF_SINES * self.sines
    }

    /// The counts with their names, in the order of the fields.
    #[must_use]
    pub fn named(&self) -> [(&'static str, u64); 6] {
        [
            ("additions", self.additions),
            ("multiplications", self.multiplications),
            ("fused", self.fused),
            ("divisions", self.divisions),
            ("roots", self.roots),
            ("sines", self.sines),
        ]
    }
}

impl Add for Operations {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            additions: self.additions + other.additions,
            multiplications: self.multiplications + other.multiplications,
            fused: self.fused + other.fused,
            divisions: self.divisions + other.divisions,
            roots: self.roots + other.roots,
            sines: self.sines + other.sines,
        }
    }
}

thread_local! {
    static DONE: Cell<Operations> = const { Cell::new(Operations::NONE) };
}

/// Counts one operation of this thread.
pub(super) fn note(change: impl FnOnce(&mut Operations)) {
    let mut operations = DONE.get();
    change(&mut operations);
    DONE.set(operations);
}

/// The result of `work`, and the operations that it performed on this thread.
pub(super) fn during<R>(work: impl FnOnce() -> R) -> (R, Operations) {
    let before = DONE.replace(Operations::NONE);
    let result = work();
    (result, DONE.replace(before))
}
