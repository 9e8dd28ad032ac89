//! What is known of the joint accelerations of one state: the form that they come from, and their estimated error.

use crate::filter::Form;

/// The form that gave the joint accelerations of a state, and their estimated error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// The form: where `auto` was asked for, the one that it chose.
    pub form: Form,
    /// Whether the square-root form was run in double-double arithmetic, and its result rounded.
    pub doubled: bool,
    /// The estimated error of the largest acceleration, in its unit (rad/s^2 or m/s^2), or NaN where there is no estimate: in Joseph's
    /// form, and where a pivot is lost.
    ///
    /// An estimate, by one or two more right sides: as a rule five to ten times the true error; [`ESTIMATE_SPREAD`] says how far it may be below. What is
    /// rounded before the sweeps, in phi and in b, is the same in every form and not in it.
    pub error: f64,
}

/// How many times the estimated error the true one may be: more than was seen in 400,000 random cases, ordinary and extreme, in all states that robots
/// are in, but for what is rounded before the sweeps; of 10,000 of them one was off by more than 20 times. One right side sees most errors, but may miss one.
pub const ESTIMATE_SPREAD: f64 = 1000.0;

impl Accuracy {
    /// Of a form without an estimate.
    pub(crate) fn unknown(form: Form) -> Self {
        Self { form, doubled: false, error: f64::NAN }
    }

    /// The name of the form, as Python has it: that of [`FORMS`](crate::filter::FORMS), or "double-double".
    #[must_use]
    pub fn name(&self) -> &'static str {
        if self.doubled {
            return "double-double";
        }
        crate::filter::FORMS.iter().find(|(_, form)| *form == self.form).map_or("", |(name, _)| name)
    }
}
