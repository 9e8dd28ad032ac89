//! The operators of scalars.

/// Implements the traits of the operators, zero and one. `a op= b` is `a = a op b`, with the attributes of the first
/// line.
macro_rules! operators {
    (
        impl [$($generics:tt)*] for $scalar:ty, $(#[$of_assigning:meta])*;
        $(#[$of_sum:meta])* $a_of_sum:ident + $b_of_sum:ident => $sum:block
        $(#[$of_difference:meta])* $a_of_difference:ident - $b_of_difference:ident => $difference:block
        $(#[$of_product:meta])* $a_of_product:ident * $b_of_product:ident => $product:block
        $(#[$of_quotient:meta])* $a_of_quotient:ident / $b_of_quotient:ident => $quotient:block
        $(#[$of_negative:meta])* -$a_of_negative:ident => $negative:block
        $(#[$of_numbers:meta])* 0 => $zero:expr; $maybe_zero:ident == 0 => $is_zero:expr; 1 => $one:expr
    ) => {
        super::operators!(@binary [$($generics)*] $scalar, Add::add, AddAssign::add_assign, [$(#[$of_assigning])*]
            [$(#[$of_sum])*] $a_of_sum $b_of_sum $sum);
        super::operators!(@binary [$($generics)*] $scalar, Sub::sub, SubAssign::sub_assign, [$(#[$of_assigning])*]
            [$(#[$of_difference])*] $a_of_difference $b_of_difference $difference);
        super::operators!(@binary [$($generics)*] $scalar, Mul::mul, MulAssign::mul_assign, [$(#[$of_assigning])*]
            [$(#[$of_product])*] $a_of_product $b_of_product $product);
        super::operators!(@binary [$($generics)*] $scalar, Div::div, DivAssign::div_assign, [$(#[$of_assigning])*]
            [$(#[$of_quotient])*] $a_of_quotient $b_of_quotient $quotient);

        impl<$($generics)*> std::ops::Neg for $scalar {
            type Output = Self;

            $(#[$of_negative])*
            fn neg(self) -> Self {
                let $a_of_negative = self;
                $negative
            }
        }

        impl<$($generics)*> num_traits::Zero for $scalar {
            $(#[$of_numbers])*
            fn zero() -> Self {
                $zero
            }

            $(#[$of_numbers])*
            fn is_zero(&self) -> bool {
                let $maybe_zero = self;
                $is_zero
            }
        }

        impl<$($generics)*> num_traits::One for $scalar {
            $(#[$of_numbers])*
            fn one() -> Self {
                $one
            }
        }
    };
    (
        @binary [$($generics:tt)*] $scalar:ty, $operator:ident::$operate:ident, $assigning:ident::$assign:ident,
        [$($of_assigning:tt)*] [$($attributes:tt)*] $a:ident $b:ident $body:block
    ) => {
        impl<$($generics)*> std::ops::$operator for $scalar {
            type Output = Self;

            $($attributes)*
            fn $operate(self, $b: Self) -> Self {
                let $a = self;
                $body
            }
        }

        impl<$($generics)*> std::ops::$assigning for $scalar {
            $($of_assigning)*
            fn $assign(&mut self, other: Self) {
                *self = std::ops::$operator::$operate(*self, other);
            }
        }
    };
}
pub(super) use operators;
