//! Dual numbers: a value with its derivative along one direction.

use super::Real;

/// value + tangent e with e^2 = 0. Code that runs on dual numbers computes its derivative along the tangents of its
/// inputs.
///
/// Comparisons and [`Real::lane`] use the value only. Code must not branch on a value that has a tangent; the sweeps do
/// not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual<T> {
    /// The value.
    pub value: T,
    /// The derivative.
    pub tangent: T,
}

impl<T: Real> Dual<T> {
    /// A constant.
    pub fn constant_of(value: T) -> Self {
        Self { value, tangent: T::zero() }
    }
}

super::operators! {
    impl [T: Real] for Dual<T>, #[inline];
    #[inline] a + b => { Self { value: a.value + b.value, tangent: a.tangent + b.tangent } }
    #[inline] a - b => { Self { value: a.value - b.value, tangent: a.tangent - b.tangent } }
    #[inline] a * b => {
        Self { value: a.value * b.value, tangent: a.value.mul_add(b.tangent, a.tangent * b.value) }
    }
    #[inline] a / b => {
        let value = a.value / b.value;
        Self { value, tangent: a.tangent.minus_product(value, b.tangent) / b.value }
    }
    #[inline] -a => { Self { value: -a.value, tangent: -a.tangent } }
    0 => Self::constant_of(T::zero()); a == 0 => a.value.is_zero() && a.tangent.is_zero(); 1 => Self::constant_of(T::one())
}

impl<T: Real<Parameter = T>> Real for Dual<T> {
    const LANES: usize = T::LANES;

    const GENERAL_JOINTS: bool = true;

    fn from_f64(x: f64) -> Self {
        Self::constant_of(T::from_f64(x))
    }

    super::its_own_parameter!();

    fn lane(self, index: usize) -> f64 {
        self.value.lane(index)
    }

    #[inline]
    fn mul_add(self, b: Self, c: Self) -> Self {
        let tangent = self.value.mul_add(b.tangent, self.tangent.mul_add(b.value, c.tangent));
        Self { value: self.value.mul_add(b.value, c.value), tangent }
    }

    fn recip(self) -> Self {
        let value = self.value.recip();
        Self { value, tangent: -(value * value * self.tangent) }
    }

    fn sqrt(self) -> Self {
        let value = self.value.sqrt();
        Self { value, tangent: self.tangent / (value + value) }
    }

    fn sin_cos(self) -> (Self, Self) {
        let (sine, cosine) = self.value.sin_cos();
        (Self { value: sine, tangent: cosine * self.tangent }, Self { value: cosine, tangent: -(sine * self.tangent) })
    }

    fn abs(self) -> Self {
        if self.value.lane(0).is_sign_negative() { -self } else { self }
    }

    fn worst(self, other: Self) -> Self {
        let value = self.value.worst(other.value);
        let tangent = if value == other.value { other.tangent } else { self.tangent };
        Self { value, tangent }
    }

    fn one_if_zero(self) -> Self {
        Self::constant_of(self.value.one_if_zero())
    }

    fn epsilon() -> Self {
        Self::constant_of(T::epsilon())
    }
}

#[cfg(test)]
mod tests {
    use super::Dual;
    use crate::scalar::Real;

    /// Compared with analytic derivatives at 0.7.
    #[test]
    fn derivatives_of_the_functions() {
        let x = Dual { value: 0.7_f64, tangent: 1.0 };
        let (sine, cosine) = x.sin_cos();
        let three = Dual::constant_of(3.0);
        let near = |found: Dual<f64>, value: f64, tangent: f64| {
            assert!((found.value - value).abs() < 1e-15 && (found.tangent - tangent).abs() < 1e-14, "{found:?}");
        };
        near(sine, 0.7_f64.sin(), 0.7_f64.cos());
        near(cosine, 0.7_f64.cos(), -0.7_f64.sin());
        near(x * x * x - three / x, 0.343 - 3.0 / 0.7, 3.0 * 0.49 + 3.0 / 0.49);
        near(x.recip(), 1.0 / 0.7, -1.0 / 0.49);
        near(Real::sqrt(x), 0.7_f64.sqrt(), 0.5 / 0.7_f64.sqrt());
        near(x.mul_add(x, three), 3.49, 1.4);
        near(three.minus_product(x, x), 2.51, -1.4);
        near(Real::abs(-x), 0.7, 1.0);
    }
}
