//! The width of the scalars in generated code.

/// The width of the scalars in generated code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Width {
    /// double.
    #[default]
    Double,
    /// float.
    Single,
}

impl Width {
    pub(super) fn of_c(self) -> &'static str {
        if self == Self::Double { "double" } else { "float" }
    }

    /// The suffix of functions and constants.
    pub(super) fn suffix(self) -> &'static str {
        if self == Self::Double { "" } else { "f" }
    }

    /// True if the constant, rounded to this width, is finite.
    pub(super) fn holds(self, x: f64) -> bool {
        #[allow(clippy::cast_possible_truncation)] // rounded, as asked
        match self {
            Self::Double => x.is_finite(),
            Self::Single => (x as f32).is_finite(),
        }
    }

    pub(super) fn constant(self, x: f64) -> String {
        match self {
            // The shortest text that is parsed as the same value.
            Self::Double => format!("{x:?}"),
            #[allow(clippy::cast_possible_truncation)] // rounded, as asked
            Self::Single => format!("{:?}f", x as f32),
        }
    }
}
