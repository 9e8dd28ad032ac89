//! A scalar that records operations: running generic code on it once produces a program and operation counts.

use super::Real;
use super::counting::{self, Operations};
use super::folding::{difference, minus_product, product, product_sum, quotient, sorted, sum};
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

super::operators! {
    impl [] for Traced, ;
    #[inline(never)] a + b => {
        counting::note(|asked| asked.additions += 1);
        sum(a, b)
    }
    #[inline(never)] a - b => {
        counting::note(|asked| asked.additions += 1);
        difference(a, b)
    }
    #[inline(never)] a * b => {
        counting::note(|asked| asked.multiplications += 1);
        product(a, b)
    }
    #[inline(never)] a / b => {
        counting::note(|asked| asked.divisions += 1);
        quotient(a, b)
    }
    #[inline(never)] -a => {
        match (a.value(), a.negated()) {
            (Some(a), _) => Self(-a),
            (_, Some(a)) => a,
            _ => push(O::Negative(a.place())),
        }
    }
    0 => Self(0.0); a == 0 => a.is(0.0); 1 => Self(1.0)
}

impl Real for Traced {
    const LANES: usize = 1;
    const IS_KNOWN: bool = false;

    fn from_f64(x: f64) -> Self {
        // Replaces NaN constants, so that their payload is not read as an index.
        Self(if x.is_nan() { f64::NAN } else { x })
    }

    super::its_own_parameter!();

    /// NaN for a value that is not a constant, because it is unknown.
    fn lane(self, _index: usize) -> f64 {
        self.value().unwrap_or(f64::NAN)
    }

    #[inline(never)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        counting::note(|asked| asked.fused += 1);
        product_sum(self, b, c)
    }

    #[inline(never)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        counting::note(|asked| asked.fused += 1);
        minus_product(self, b, c)
    }

    #[inline(never)]
    fn recip(self) -> Self {
        counting::note(|asked| asked.divisions += 1);
        match self.value() {
            Some(x) => Self(Real::recip(x)),
            None => quotient(Self(1.0), self),
        }
    }

    #[inline(never)]
    fn sqrt(self) -> Self {
        counting::note(|asked| asked.roots += 1);
        self.value().map_or_else(|| push(O::Root(self.place())), |x| Self(Real::sqrt(x)))
    }

    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        counting::note(|asked| asked.sines += 1);
        if let Some(x) = self.value() {
            let (s, c) = Real::sin_cos(x);
            return (Self(s), Self(c));
        }
        (push(O::Sine(self.place())), push(O::Cosine(self.place())))
    }

    #[inline(never)]
    fn abs(self) -> Self {
        let inside = self.negated().unwrap_or(self);
        inside.value().map_or_else(|| push(O::Absolute(inside.place())), |x| Self(Real::abs(x)))
    }

    #[inline(never)]
    fn worst(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => Self(Real::worst(a, b)),
            _ if self == other => self,
            _ => {
                let (a, b) = sorted(self, other);
                push(O::Smaller(a, b))
            }
        }
    }

    #[inline(never)]
    fn one_if_zero(self) -> Self {
        self.value().map_or_else(|| push(O::OneIfZero(self.place())), |x| Self(Real::one_if_zero(x)))
    }

    fn epsilon() -> Self {
        Self(f64::EPSILON)
    }
}

#[cfg(test)]
mod tests {
    use super::{Operation, Traced};
    use crate::scalar::Real;

    fn number(x: f64) -> Traced {
        Traced::from_f64(x)
    }

    /// The operations of a program with two arguments, without arguments and constants.
    fn operations(work: impl FnOnce(Traced, Traced) -> Traced) -> (Operation, usize) {
        let (place, all) = Traced::during(|| work(Traced::argument(0), Traced::argument(1)).place());
        let counted = |o: &&Operation| !matches!(o, Operation::Argument(_) | Operation::Constant(_));
        (all[place as usize], all.iter().filter(counted).count())
    }

    #[test]
    fn what_changes_nothing_goes() {
        let one = number(1.0);
        assert_eq!(operations(|a, _| a * number(1.0) + number(0.0)), (Operation::Argument(0), 0));
        assert_eq!(operations(|a, b| (a * number(0.0)).mul_add(b, b)), (Operation::Argument(1), 0));
        assert_eq!(operations(|a, _| -(-a) * number(-1.0) * number(-1.0)).0, Operation::Argument(0));
        assert_eq!(
            operations(|_, _| number(0.5).mul_add(number(4.0), number(1.0))).0,
            Operation::Constant(3f64.to_bits())
        );
        assert_eq!(operations(|_, _| number(2.0).sqrt() - number(2.0).sqrt()).0, Operation::Constant(0));
        assert_eq!(one, one);
    }

    #[test]
    fn what_is_computed_twice_is_one_number() {
        assert_eq!(operations(|a, b| (a * b + b * a) / (a * b)).1, 3);
        // The cosine is recorded also, although it is not used.
        assert_eq!(operations(|a, b| a.sin_cos().0 * b + a.sin_cos().0).1, 4);
    }

    #[test]
    fn signs_go_into_sums() {
        assert!(matches!(operations(|a, b| a + -b).0, Operation::Difference(..)));
        assert!(matches!(operations(|a, b| (-a).mul_add(b, b)).0, Operation::MinusProduct(..)));
        assert!(matches!(operations(|a, b| a.minus_product(-a, b)).0, Operation::ProductSum(..)));
    }

    #[test]
    fn a_number_that_is_no_constant_is_not_known() {
        assert!(operations(|a, _| if a.lane(0).is_nan() { a } else { number(1.0) }).0 == Operation::Argument(0));
        assert_eq!(number(0.25).lane(0).to_bits(), 0.25_f64.to_bits());
    }
}
