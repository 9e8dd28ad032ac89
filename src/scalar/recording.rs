//! The program that a thread records, its operations and its values.

use super::counting::{self, Operations};
use std::cell::RefCell;
use std::collections::HashMap;

/// An operation of a program; operands are indices of preceding operations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Operation {
    /// The f64 with these bits.
    Constant(u64),
    /// An argument, by index.
    Argument(u32),
    /// a + b.
    Sum(u32, u32),
    /// a - b.
    Difference(u32, u32),
    /// a b.
    Product(u32, u32),
    /// a b + c.
    ProductSum(u32, u32, u32),
    /// c - a b.
    MinusProduct(u32, u32, u32),
    /// a / b.
    Quotient(u32, u32),
    /// -a.
    Negative(u32),
    /// The square root.
    Root(u32),
    /// The sine, a in radians.
    Sine(u32),
    /// The cosine.
    Cosine(u32),
    /// The absolute value.
    Absolute(u32),
    /// The smaller of the two; NaN if either is NaN.
    Smaller(u32, u32),
    /// 1 if a is zero, else 0.
    OneIfZero(u32),
}

use Operation as O;

/// The operations recorded so far, without duplicates.
#[derive(Debug, Default)]
struct Tape {
    operations: Vec<Operation>,
    known: HashMap<Operation, u32>,
}

thread_local! {
    static TAPE: RefCell<Tape> = RefCell::default();
}

/// A value of the program that this thread records. Outside of [`Traced::during`] the program is discarded.
///
/// Operations on constants are evaluated immediately in f64. Sums with zero, differences of equal operands, and
/// products by zero, one and minus one are simplified; for finite values the result equals that of f64 except for the
/// sign of zeros. Repeated operations are recorded once. [`Traced::counted`] also counts operations that are
/// simplified: with constants only, all operations are evaluated with the bits of f64, and no program is recorded.
///
/// Nothing is inlined, because the kernels are long and tracing does not need to be fast.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
pub struct Traced(
    /// A constant, or a NaN that arithmetic never produces, whose payload is the index in the program. This makes the
    /// type as small as an f64, and so the kernels.
    f64,
);

/// The bits of a NaN that holds an index.
const PLACED: u64 = 0x7ffc_0000_0000_0000;

impl PartialEq for Traced {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits() || self.0 == other.0
    }
}

impl Traced {
    /// The result of `work`, and the operations that it recorded, in order.
    pub fn during<R>(work: impl FnOnce() -> R) -> (R, Vec<Operation>) {
        let before = TAPE.take();
        let result = work();
        (result, TAPE.replace(before).operations)
    }

    /// The result of `work`, and the operations that it requested on this thread, including simplified ones.
    pub fn counted<R>(work: impl FnOnce() -> R) -> (R, Operations) {
        counting::during(work)
    }

    /// An argument of the program.
    #[must_use]
    pub fn argument(index: u32) -> Self {
        push(O::Argument(index))
    }

    /// The index in the program; a constant is recorded when an operation reads it.
    #[must_use]
    pub fn place(self) -> u32 {
        self.placed().unwrap_or_else(|| {
            // Both zeros are recorded as one.
            let bits = if self.0 == 0.0 { 0 } else { self.0.to_bits() };
            push(O::Constant(bits)).placed().unwrap_or_default()
        })
    }

    /// The index of a value that is not a constant.
    fn placed(self) -> Option<u32> {
        let bits = self.0.to_bits();
        #[allow(clippy::cast_possible_truncation)] // the lower half
        (bits & !u64::from(u32::MAX) == PLACED).then_some(bits as u32)
    }

    fn at(place: u32) -> Self {
        Self(f64::from_bits(PLACED | u64::from(place)))
    }

    /// A constant.
    pub(super) fn constant(x: f64) -> Self {
        Self(x)
    }

    pub(super) fn value(self) -> Option<f64> {
        if self.placed().is_none() { Some(self.0) } else { None }
    }

    /// The value whose negative this is; `None` for a constant.
    pub(super) fn negated(self) -> Option<Self> {
        let place = self.placed()?;
        match TAPE.with_borrow(|tape| tape.operations[place as usize]) {
            O::Negative(of) => Some(Self::at(of)),
            _ => None,
        }
    }

    #[allow(clippy::float_cmp)] // exactly that value
    pub(super) fn is(self, x: f64) -> bool {
        self.0 == x
    }
}

pub(super) fn push(operation: Operation) -> Traced {
    TAPE.with_borrow_mut(|tape| {
        let Tape { operations, known } = tape;
        Traced::at(*known.entry(operation).or_insert_with(|| {
            operations.push(operation);
            u32::try_from(operations.len() - 1).unwrap_or(u32::MAX)
        }))
    })
}
