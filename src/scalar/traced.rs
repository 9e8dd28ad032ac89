//! A number that remembers what it was computed from: the generic code, run on it once, leaves a program.

use super::Real;
use num_traits::{One, Zero};
use std::cell::RefCell;
use std::collections::HashMap;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// How one number of a program comes of others, which are before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Operation {
    /// The f64 of these bits.
    Constant(u64),
    /// An argument, by its index among all.
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
    /// The smaller of the two, NaN where either is.
    Smaller(u32, u32),
    /// One where a is zero, else zero.
    OneIfZero(u32),
}

use Operation as O;

/// What was done so far, each operation once.
#[derive(Debug, Default)]
struct Tape {
    operations: Vec<Operation>,
    known: HashMap<Operation, u32>,
}

thread_local! {
    static TAPE: RefCell<Tape> = RefCell::default();
}

/// A number of the program that this thread is writing; outside of [`Traced::during`] of one that nobody reads.
///
/// What both numbers of an operation are constants is computed here, in f64. Sums with zero, differences of a number and itself, products by zero, one and minus one go: the result is that of f64 for numbers that are
/// finite, but for the sign of a zero. What is computed twice is one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Traced(u32);

impl Traced {
    /// What `work` gives, and the operations that it wrote, in order.
    pub fn during<R>(work: impl FnOnce() -> R) -> (R, Vec<Operation>) {
        let before = TAPE.take();
        let result = work();
        (result, TAPE.replace(before).operations)
    }

    /// An argument of the program.
    #[must_use]
    pub fn argument(index: u32) -> Self {
        push(O::Argument(index))
    }

    /// Its place in the program.
    #[must_use]
    pub fn place(self) -> u32 {
        self.0
    }

    fn constant_of(x: f64) -> Self {
        // One zero.
        push(O::Constant(if x == 0.0 { 0 } else { x.to_bits() }))
    }

    fn operation(self) -> Operation {
        TAPE.with_borrow(|tape| tape.operations[self.0 as usize])
    }

    fn value(self) -> Option<f64> {
        if let O::Constant(bits) = self.operation() { Some(f64::from_bits(bits)) } else { None }
    }

    /// The number that this is the negative of.
    fn negated(self) -> Option<Self> {
        if let O::Negative(a) = self.operation() { Some(Self(a)) } else { None }
    }

    #[allow(clippy::float_cmp)] // that number and no other
    fn is(self, x: f64) -> bool {
        self.value() == Some(x)
    }
}

fn push(operation: Operation) -> Traced {
    TAPE.with_borrow_mut(|tape| {
        let Tape { operations, known } = tape;
        Traced(*known.entry(operation).or_insert_with(|| {
            operations.push(operation);
            u32::try_from(operations.len() - 1).unwrap_or(u32::MAX)
        }))
    })
}

/// In order where the order says nothing.
fn sorted(a: Traced, b: Traced) -> (u32, u32) {
    (a.0.min(b.0), a.0.max(b.0))
}

impl Add for Traced {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => return Self::constant_of(a + b),
            (Some(0.0), _) => return other,
            (_, Some(0.0)) => return self,
            _ => {}
        }
        if let Some(b) = other.negated() {
            return self - b;
        }
        if let Some(a) = self.negated() {
            return other - a;
        }
        let (a, b) = sorted(self, other);
        push(O::Sum(a, b))
    }
}

impl Sub for Traced {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => return Self::constant_of(a - b),
            (Some(0.0), _) => return -other,
            (_, Some(0.0)) => return self,
            _ if self == other => return Self::constant_of(0.0),
            _ => {}
        }
        match other.negated() {
            Some(b) => self + b,
            None => push(O::Difference(self.0, other.0)),
        }
    }
}

impl Mul for Traced {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => return Self::constant_of(a * b),
            (Some(0.0), _) | (_, Some(0.0)) => return Self::constant_of(0.0),
            (Some(1.0), _) => return other,
            (_, Some(1.0)) => return self,
            (Some(-1.0), _) => return -other,
            (_, Some(-1.0)) => return -self,
            _ => {}
        }
        match (self.negated(), other.negated()) {
            (Some(a), Some(b)) => a * b,
            (Some(a), None) => -(a * other),
            (None, Some(b)) => -(self * b),
            (None, None) => {
                let (a, b) = sorted(self, other);
                push(O::Product(a, b))
            }
        }
    }
}

impl Div for Traced {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => Self::constant_of(a / b),
            (_, Some(1.0)) => self,
            _ => push(O::Quotient(self.0, other.0)),
        }
    }
}

impl Neg for Traced {
    type Output = Self;

    fn neg(self) -> Self {
        match (self.value(), self.negated()) {
            (Some(a), _) => Self::constant_of(-a),
            (_, Some(a)) => a,
            _ => push(O::Negative(self.0)),
        }
    }
}

macro_rules! assigning {
    ($assigning:ident, $assign:ident, $operator:tt) => {
        impl $assigning for Traced {
            fn $assign(&mut self, other: Self) {
                *self = *self $operator other;
            }
        }
    };
}

assigning!(AddAssign, add_assign, +);
assigning!(SubAssign, sub_assign, -);
assigning!(MulAssign, mul_assign, *);
assigning!(DivAssign, div_assign, /);

impl Zero for Traced {
    fn zero() -> Self {
        Self::constant_of(0.0)
    }

    fn is_zero(&self) -> bool {
        self.is(0.0)
    }
}

impl One for Traced {
    fn one() -> Self {
        Self::constant_of(1.0)
    }
}

impl Real for Traced {
    const LANES: usize = 1;

    fn from_f64(x: f64) -> Self {
        Self::constant_of(x)
    }

    super::its_own_parameter!();

    /// NaN of what is no constant: whoever asks takes it for a number of which nothing is known.
    fn lane(self, _index: usize) -> f64 {
        self.value().unwrap_or(f64::NAN)
    }

    fn mul_add(self, b: Self, c: Self) -> Self {
        if c.is(0.0) {
            return self * b;
        }
        let is_product = |x: Self| x.is(0.0) || x.is(1.0) || x.is(-1.0);
        if is_product(self) || is_product(b) || (self.value().is_some() && b.value().is_some()) {
            return self * b + c;
        }
        match (self.negated(), b.negated()) {
            (Some(a), Some(b)) => a.mul_add(b, c),
            (Some(a), None) => c.minus_product(a, b),
            (None, Some(b)) => c.minus_product(self, b),
            (None, None) => {
                let (a, b) = sorted(self, b);
                push(O::ProductSum(a, b, c.0))
            }
        }
    }

    fn minus_product(self, b: Self, c: Self) -> Self {
        if self.is(0.0) {
            return -(b * c);
        }
        let is_product = |x: Self| x.is(0.0) || x.is(1.0) || x.is(-1.0);
        if is_product(b) || is_product(c) || (b.value().is_some() && c.value().is_some()) {
            return self - b * c;
        }
        match (b.negated(), c.negated()) {
            (Some(b), Some(c)) => self.minus_product(b, c),
            (Some(b), None) => b.mul_add(c, self),
            (None, Some(c)) => b.mul_add(c, self),
            (None, None) => {
                let (b, c) = sorted(b, c);
                push(O::MinusProduct(b, c, self.0))
            }
        }
    }

    fn recip(self) -> Self {
        Self::constant_of(1.0) / self
    }

    fn sqrt(self) -> Self {
        self.value().map_or_else(|| push(O::Root(self.0)), |x| Self::constant_of(x.sqrt()))
    }

    fn sin_cos(self) -> (Self, Self) {
        match self.value() {
            Some(x) => (Self::constant_of(x.sin()), Self::constant_of(x.cos())),
            None => (push(O::Sine(self.0)), push(O::Cosine(self.0))),
        }
    }

    fn abs(self) -> Self {
        let inside = self.negated().unwrap_or(self);
        inside.value().map_or_else(|| push(O::Absolute(inside.0)), |x| Self::constant_of(x.abs()))
    }

    fn worst(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => Self::constant_of(Real::worst(a, b)),
            _ if self == other => self,
            _ => {
                let (a, b) = sorted(self, other);
                push(O::Smaller(a, b))
            }
        }
    }

    fn one_if_zero(self) -> Self {
        self.value().map_or_else(|| push(O::OneIfZero(self.0)), |x| Self::constant_of(Real::one_if_zero(x)))
    }

    fn epsilon() -> Self {
        Self::constant_of(f64::EPSILON)
    }
}

#[cfg(test)]
mod tests {
    use super::{Operation, Traced};
    use crate::scalar::Real;

    fn number(x: f64) -> Traced {
        Traced::from_f64(x)
    }

    /// The operations of a program in two arguments beside the arguments and constants.
    fn operations(work: impl FnOnce(Traced, Traced) -> Traced) -> (Operation, usize) {
        let (result, all) = Traced::during(|| work(Traced::argument(0), Traced::argument(1)));
        let counted = |o: &&Operation| !matches!(o, Operation::Argument(_) | Operation::Constant(_));
        (all[result.place() as usize], all.iter().filter(counted).count())
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
        assert_eq!(operations(|a, b| a * b - b * a).0, Operation::Constant(0));
        assert_eq!(one, one);
    }

    #[test]
    fn what_is_computed_twice_is_one_number() {
        assert_eq!(operations(|a, b| (a * b + b * a) / (a * b)).1, 3);
        // The cosine too, which nothing reads.
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
