//! A scalar that records operations: running generic code on it once produces a program and operation counts.

use super::Real;
use super::counting;
use super::folding::{difference, minus_product, negative, product, product_sum, quotient, sorted, sum};
use super::recording::{Operation as O, Traced, push};

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
        negative(a)
    }
    0 => Self::constant(0.0); a == 0 => a.is(0.0); 1 => Self::constant(1.0)
}

impl Real for Traced {
    const LANES: usize = 1;
    const IS_KNOWN: bool = false;

    fn from_f64(x: f64) -> Self {
        // Replaces NaN constants, so that their payload is not read as an index.
        Self::constant(if x.is_nan() { f64::NAN } else { x })
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
            Some(x) => Self::constant(Real::recip(x)),
            None => quotient(Self::constant(1.0), self),
        }
    }

    #[inline(never)]
    fn sqrt(self) -> Self {
        counting::note(|asked| asked.roots += 1);
        self.value().map_or_else(|| push(O::Root(self.place())), |x| Self::constant(Real::sqrt(x)))
    }

    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        counting::note(|asked| asked.sines += 1);
        if let Some(x) = self.value() {
            let (s, c) = Real::sin_cos(x);
            return (Self::constant(s), Self::constant(c));
        }
        (push(O::Sine(self.place())), push(O::Cosine(self.place())))
    }

    #[inline(never)]
    fn abs(self) -> Self {
        let inside = self.negated().unwrap_or(self);
        inside.value().map_or_else(|| push(O::Absolute(inside.place())), |x| Self::constant(Real::abs(x)))
    }

    #[inline(never)]
    fn worst(self, other: Self) -> Self {
        match (self.value(), other.value()) {
            (Some(a), Some(b)) => Self::constant(Real::worst(a, b)),
            _ if self == other => self,
            _ => {
                let (a, b) = sorted(self, other);
                push(O::Smaller(a, b))
            }
        }
    }

    #[inline(never)]
    fn one_if_zero(self) -> Self {
        self.value().map_or_else(|| push(O::OneIfZero(self.place())), |x| Self::constant(Real::one_if_zero(x)))
    }

    fn epsilon() -> Self {
        Self::constant(f64::EPSILON)
    }
}

#[cfg(test)]
mod tests {
    use crate::scalar::Real;
    use crate::scalar::recording::{Operation, Traced};

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
