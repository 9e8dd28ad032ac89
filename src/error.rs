//! The errors of the crate, and the checks that raise them.
//!
//! Every message names the argument, link or joint, what was found, what was expected, and the remedy where there is
//! one. The checks take the name of the argument, so no message is written twice.

use std::borrow::Cow;

use thiserror::Error as ThisError;

/// What went wrong, with the name of the thing that was at fault.
#[derive(Debug, Clone, PartialEq, ThisError)]
#[non_exhaustive]
pub enum Error {
    /// A scene that cannot be built: cycle, unknown parent, negative mass, malformed XML.
    #[error("{subject}: found {}; expected {}", shortened(found), shortened(expected))]
    Scene {
        /// The link, joint, element or file at fault, for instance `joint "elbow"`.
        subject: String,
        /// What was found there.
        found: String,
        /// What would have been accepted.
        expected: String,
    },
    /// An array whose shape does not fit the scene.
    #[error("{argument}: found shape {found}; expected {expected}")]
    Shape {
        /// Name of the argument.
        argument: String,
        /// Its shape as found.
        found: String,
        /// The shape that fits.
        expected: String,
    },
    /// A NaN or an infinity in an argument, or a result that overflowed.
    #[error("{argument}: found {value} at index {index}{}; expected finite numbers", in_state(*state))]
    NotFinite {
        /// Name of the argument (or result).
        argument: String,
        /// Index of the entry within one state.
        index: usize,
        /// The value found.
        value: f64,
        /// Index of the state in a batch, if there is one.
        state: Option<usize>,
    },
    /// An argument of the right shape whose value cannot be used.
    #[error("{argument}: found {}; expected {}", shortened(found), shortened(expected))]
    Argument {
        /// Name of the argument.
        argument: String,
        /// What was found.
        found: String,
        /// What would have been accepted.
        expected: String,
    },
    /// A joint about whose axis nothing is left to move: the pivot D(k) of eq. 3.6 is lost in rounding.
    #[error(
        "joint {joint:?} (of link {link:?}){}: the inertia along its axis is {}; add inertia about the axis (scene.with_payload), or give the joint armature, for instance scene.with_properties(armature={{{joint:?}: 1e-3}})",
        in_state(*state),
        lost(*pivot, *terms)
    )]
    SingularJoint {
        /// Name of the joint.
        joint: String,
        /// Name of the link that the joint carries.
        link: String,
        /// Index of the state in a batch, if there is one.
        state: Option<usize>,
        /// The pivot found, in kg m^2 (rotation) or kg (translation).
        pivot: f64,
        /// Absolute sum of the terms that form the pivot, same unit.
        terms: f64,
    },
    /// Task directions without an operational-space inertia: the scene cannot move in all of them independently.
    #[error(
        "task of {}{}: found an inverse inertia of rank {rank} in {directions} directions, which has no inverse; it is itself defined \
         there (operational_inverse_inertia): use that, or leave out directions so that at most {rank} independent ones remain",
        quoted(links),
        in_state(*state)
    )]
    SingularTask {
        /// Names of the links, in the order of the call.
        links: Vec<String>,
        /// How many of the directions are independent.
        rank: usize,
        /// How many directions the task has.
        directions: usize,
        /// Index of the state in a batch, if there is one.
        state: Option<usize>,
    },
    /// Connections that cannot hold: they contradict each other, or a state does not meet them.
    #[error("{}{}: found {}; expected {}", of_connections(&violation.connections), in_state(*state), shortened(&violation.found), shortened(&violation.expected))]
    Constraint {
        /// Which, and what is wrong with them.
        violation: Box<ConstraintViolation>,
        /// Index of the state in a batch, if there is one.
        state: Option<usize>,
    },
    /// A size that there is no memory for.
    #[error("{argument}: no room for {request}; expected a size that there is room for")]
    Memory {
        /// Name of the argument that says how large.
        argument: String,
        /// How much that is.
        request: Box<MemoryRequest>,
    },
    /// Work that was told to stop: see [`interrupt`](crate::interrupt).
    #[error("interrupted")]
    Interrupted,
}

/// What is wrong with connections.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstraintViolation {
    /// Their names.
    pub connections: Vec<String>,
    /// What was found.
    pub found: String,
    /// What would have been accepted.
    pub expected: String,
    /// The largest error, or what is left of its rate or of its second derivative: rad or m, by s or by s^2.
    pub residual: f64,
}

impl From<ConstraintViolation> for Error {
    fn from(violation: ConstraintViolation) -> Self {
        Self::Constraint { violation: Box::new(violation), state: None }
    }
}

/// What memory had no room for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MemoryRequest {
    /// What the bytes are for, where that needs to be explained.
    pub what: String,
    /// What it would take.
    pub bytes: u128,
    /// What is free, where that is known and was the reason.
    pub free: Option<u128>,
}

impl std::fmt::Display for MemoryRequest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { what, bytes, free } = self;
        let comma = if what.is_empty() { "" } else { ", " };
        write!(f, "{what}{comma}{bytes} bytes{}", in_units(*bytes))?;
        free.map_or(Ok(()), |free| write!(f, ", of which {free} bytes{} are free", in_units(free)))
    }
}

/// Many bytes in a unit that can be read at a glance; nothing for few.
fn in_units(bytes: u128) -> String {
    const UNITS: [&str; 6] = ["MB", "GB", "TB", "PB", "EB", "ZB"];
    #[allow(clippy::cast_precision_loss)] // two digits are shown
    let (mut size, mut unit) = (bytes as f64 / 1e6, 0);
    while size >= 1e3 && unit + 1 < UNITS.len() {
        (size, unit) = (size / 1e3, unit + 1);
    }
    if size < 1.0 { String::new() } else { format!(" ({size:.3} {})", UNITS[unit]) }
}

/// The words for one link or several.
fn quoted(links: &[String]) -> String {
    let names: Vec<String> = links.iter().map(|name| format!("{name:?}")).collect();
    format!("{} {}", if names.len() == 1 { "link" } else { "links" }, names.join(", "))
}

/// The words for one connection or several.
fn of_connections(connections: &[String]) -> String {
    let names: Vec<String> = connections.iter().map(|name| format!("{name:?}")).collect();
    format!("{} {}", if names.len() == 1 { "connection" } else { "connections" }, names.join(", "))
}

/// The words for a pivot that means nothing.
fn lost(pivot: f64, terms: f64) -> String {
    if pivot == 0.0 {
        return "zero".to_owned();
    }
    format!("{pivot:.3e}, lost in the rounding of the terms that form it ({terms:.3e})")
}

/// The words that name one state of a batch.
fn in_state(state: Option<usize>) -> String {
    state.map_or_else(String::new, |index| format!(" in state {index}"))
}

/// The lowest state of a batch that failed.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// Its index.
    pub state: usize,
    /// What was wrong with it.
    pub error: Error,
}

impl From<Fault> for Error {
    fn from(fault: Fault) -> Self {
        fault.error.in_state(fault.state)
    }
}

impl Error {
    /// The same error, said of state `index` of a batch.
    #[must_use]
    pub fn in_state(mut self, index: usize) -> Self {
        if let Self::NotFinite { state, .. }
        | Self::SingularJoint { state, .. }
        | Self::SingularTask { state, .. }
        | Self::Constraint { state, .. } = &mut self
        {
            *state = Some(index);
        } else if let Self::Argument { found, .. } = &mut self {
            *found = format!("{found} in state {index}");
        }
        self
    }

    /// The same error; one about memory said of the argument that chose the size.
    #[must_use]
    pub(crate) fn asked_by(mut self, name: &str) -> Self {
        if let Self::Memory { argument, .. } = &mut self {
            name.clone_into(argument);
        }
        self
    }

    /// The same error, said of another argument: of the one that the caller gave.
    #[must_use]
    pub(crate) fn of_argument(mut self, name: &str) -> Self {
        if let Self::Argument { argument, .. } = &mut self {
            name.clone_into(argument);
        }
        self
    }

    /// An error about memory, of which nothing more is known.
    pub(crate) fn memory(argument: &str, bytes: u128, free: Option<u128>) -> Self {
        let request = Box::new(MemoryRequest { what: String::new(), bytes, free });
        Self::Memory { argument: argument.to_owned(), request }
    }

    /// A scene error from its three parts.
    pub(crate) fn scene(subject: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Scene { subject: subject.into(), found: found.into(), expected: expected.into() }
    }

    /// An argument error from its three parts.
    pub(crate) fn argument(argument: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Argument { argument: argument.into(), found: found.into(), expected: expected.into() }
    }
}

/// A number for a message, as short as it is exact: with an exponent where the digits would be many.
pub(crate) fn number(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-4..1e7).contains(&size) || !value.is_finite() {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// A number of more characters than this is written with an exponent in messages; shorter ones have all digits of their `f64`.
const LONGEST_NUMBER: usize = 24;

/// A message whose long numbers, as `Display` writes 1e70, have exponents. Names, which are quoted, stay.
fn shortened(text: &str) -> Cow<'_, str> {
    if text.len() <= LONGEST_NUMBER {
        return Cow::Borrowed(text);
    }
    let (mut found, mut copied, mut quoted, mut at) = (String::new(), 0, false, 0);
    let bytes = text.as_bytes();
    while at < bytes.len() {
        if bytes[at] == b'\\' {
            at += 2;
        } else if bytes[at] == b'"' {
            quoted = !quoted;
            at += 1;
        } else if quoted || !is_in_word(bytes[at]) {
            at += 1;
        } else {
            let end = at + bytes[at..].iter().take_while(|&&byte| is_in_word(byte)).count();
            let word = text.get(at..end).unwrap_or_default().trim_end_matches('.');
            let is_number = word.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
            if let (true, true, Ok(value)) = (word.len() > LONGEST_NUMBER, is_number, word.parse::<f64>()) {
                found.push_str(&text[copied..at]);
                found.push_str(&number(value));
                copied = at + word.len();
            }
            at = end;
        }
    }
    if copied == 0 {
        return Cow::Borrowed(text);
    }
    found.push_str(&text[copied..]);
    Cow::Owned(found)
}

/// True for the bytes of words and of digits.
fn is_in_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'.' || byte == b'_' || byte >= 0x80
}

/// Checks the length of a slice that must hold one state.
pub(crate) fn check_length(argument: &str, found: usize, expected: usize) -> Result<(), Error> {
    if found == expected {
        return Ok(());
    }
    Err(Error::Shape {
        argument: argument.to_owned(),
        found: format!("({found},)"),
        expected: format!("({expected},)"),
    })
}

/// Checks that every entry is finite.
pub(crate) fn check_finite(argument: &str, values: &[f64]) -> Result<(), Error> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => {
            Err(Error::NotFinite { argument: argument.to_owned(), index, value: values[index], state: None })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_have_exponents() {
        for (given, expected) in [
            (
                format!("{} after a step of {} s, from {}", 1e70, 1e-3, -2.5e200),
                "1e70 after a step of 0.001 s, from -2.5e200",
            ),
            (format!("{}; then {}.", 1e-30, f64::MAX), "1e-30; then 1.7976931348623157e308."),
            (
                "-1.2345678901234567, 123456789012345.67 and NaN, all short".to_owned(),
                "-1.2345678901234567, 123456789012345.67 and NaN, all short",
            ),
            (format!("joint \"a\\\"{0}\" and j{0}", 1e40), &format!("joint \"a\\\"{0}\" and j{0}", 1e40)),
            (
                "ein Gelenk mit Ümlauten in ünendlich vielen Wörtern".to_owned(),
                "ein Gelenk mit Ümlauten in ünendlich vielen Wörtern",
            ),
            ("ends in an escape of many characters \\".to_owned(), "ends in an escape of many characters \\"),
        ] {
            assert_eq!(shortened(&given), expected);
        }
        let error = Error::argument("dt", format!("{}", -1e70), "a step in s, finite and positive");
        assert_eq!(error.to_string(), "dt: found -1e70; expected a step in s, finite and positive");
    }
}
