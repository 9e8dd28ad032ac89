//! The forms of the Riccati recursion: the representations of the covariance P.

use crate::error::named;

named! {
    /// The representation of the covariance P.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    #[non_exhaustive]
    enum Form;
    /// Every form with its name.
    const FORMS {
        /// The covariance form. States whose error estimate exceeds the tolerance are recomputed in square-root form,
        /// and forward dynamics in double-double arithmetic if the error estimate of the square-root form exceeds the
        /// tolerance too.
        #[default]
        Auto = "auto",
        /// P itself (3.6). The fastest form. Each measurement subtracts from P, so cancellation can occur.
        Covariance = "covariance",
        /// A square root of P. Nothing is subtracted; the loss of precision is that of the problem itself.
        SquareRoot = "square-root",
    }
}

crate::error::by_name!(Form, "form", FORMS);
