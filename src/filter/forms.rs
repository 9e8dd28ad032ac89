//! The forms of the Riccati recursion: one problem, several ways to carry P.

/// How P is carried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Form {
    /// The covariance form while it keeps its digits, else the square-root form; forward dynamics with twice the digits where that
    /// is in doubt too.
    #[default]
    Auto,
    /// P itself, eq. 3.6: the fastest; what a measurement takes away is subtracted.
    Covariance,
    /// P itself, the measurement as A P A^T + g r g^T: stays symmetric and positive by its form, and loses as many digits.
    Joseph,
    /// A square root of P: nothing is subtracted, and no digit is lost that the problem does not lose itself.
    SquareRoot,
}

/// Every form with its name.
pub const FORMS: [(&str, Form); 4] = [
    ("auto", Form::Auto),
    ("covariance", Form::Covariance),
    ("joseph", Form::Joseph),
    ("square-root", Form::SquareRoot),
];
