//! The forms of the Riccati recursion: the representations of the covariance P.

/// The representation of the covariance P.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Form {
    /// The covariance form. States whose error estimate exceeds the tolerance are recomputed in square-root form, and
    /// forward dynamics in double-double arithmetic if the error estimate of the square-root form exceeds the tolerance
    /// too.
    #[default]
    Auto,
    /// P itself (3.6). The fastest form. Each measurement subtracts from P, so cancellation can occur.
    Covariance,
    /// A square root of P. Nothing is subtracted; the loss of precision is that of the problem itself.
    SquareRoot,
}

/// Every form with its name.
pub const FORMS: &[(&str, Form)] =
    &[("auto", Form::Auto), ("covariance", Form::Covariance), ("square-root", Form::SquareRoot)];

crate::error::by_name!(Form, "form", FORMS);
