//! The errors of the crate, and the argument checks that return them.
//!
//! Every message names the argument, link or joint, what was found and what was expected, and suggests a fix if there
//! is one. Each check takes the name of the argument, so that the text of a message exists once.

use std::borrow::Cow;
use std::fmt::Display;

use thiserror::Error as ThisError;

/// An error of the crate, with the name of the argument, link, joint or connection that caused it.
#[derive(Debug, Clone, PartialEq, ThisError)]
#[non_exhaustive]
pub enum Error {
    /// A scene that cannot be built: cycle, unknown parent, negative mass, malformed XML.
    #[error("{subject}: found {}; expected {}", shortened(found), shortened(expected))]
    Scene {
        /// The link, joint, element or file that caused the error, for instance `joint "elbow"`.
        subject: String,
        /// The value or structure that was found.
        found: String,
        /// The values or structures that are accepted.
        expected: String,
    },
    /// An array whose shape does not match the scene.
    #[error("{argument}: found shape {found}; expected {expected}")]
    Shape {
        /// Name of the argument.
        argument: String,
        /// The shape found.
        found: String,
        /// The shape expected.
        expected: String,
    },
    /// A NaN or an infinity in an argument, or a result that overflows.
    #[error("{argument}: found {value} at index {index}{}; expected finite numbers", in_state(*state))]
    NotFinite {
        /// Name of the argument (or result).
        argument: String,
        /// Index of the entry within its state.
        index: usize,
        /// The value found.
        value: f64,
        /// Index of the state in the batch; `None` for a single state.
        state: Option<usize>,
    },
    /// An argument of the right shape with an invalid value.
    #[error("{argument}: found {}; expected {}", shortened(found), shortened(expected))]
    Argument {
        /// Name of the argument.
        argument: String,
        /// The value found.
        found: String,
        /// The values accepted.
        expected: String,
    },
    /// A joint with no significant inertia about its axis: the pivot D(k) of (3.6) is below the rounding error of its
    /// terms.
    #[error(
        "joint {joint:?} (of link {link:?}){}: the inertia along its axis is {}; add inertia about the axis \
         (scene.with_payload), or give the joint armature, for instance scene.with_properties({})",
        in_state(*state),
        lost(*pivot, *terms),
        in_language(format!("[({joint:?}, Property::Armature, 1e-3)]"), format!("armature={{{joint:?}: 1e-3}}"))
    )]
    SingularJoint {
        /// Name of the joint.
        joint: String,
        /// Name of the link that the joint moves (its child link).
        link: String,
        /// Index of the state in the batch; `None` for a single state.
        state: Option<usize>,
        /// The pivot found, kg m^2 (revolute) or kg (prismatic).
        pivot: f64,
        /// Sum of the absolute values of the terms that form the pivot, in the unit of the pivot.
        terms: f64,
    },
    /// Task directions for which the operational-space inertia does not exist: the scene cannot move in all of them
    /// independently.
    #[error(
        "task of {}{}: found an inverse inertia of rank {rank} in {directions} directions, which has no inverse; use \
         operational_inverse_inertia, which is defined there, or remove directions until at most {rank} independent \
         ones remain",
        counted("link", links),
        in_state(*state)
    )]
    SingularTask {
        /// Names of the links, in the order of the call.
        links: Vec<String>,
        /// Number of independent directions.
        rank: usize,
        /// Number of directions of the task.
        directions: usize,
        /// Index of the state in the batch; `None` for a single state.
        state: Option<usize>,
    },
    /// Connections that cannot be satisfied: they contradict each other, or the state violates them.
    #[error(
        "{}{}: found {}; expected {}",
        counted("connection", &violation.connections),
        in_state(*state),
        shortened(&violation.found),
        shortened(&violation.expected)
    )]
    Constraint {
        /// The connections and the violation.
        violation: Box<ConstraintViolation>,
        /// Index of the state in the batch; `None` for a single state.
        state: Option<usize>,
    },
    /// An allocation that exceeds the available memory.
    #[error("{argument}: no room for {request}; expected a size that there is room for")]
    Memory {
        /// Name of the argument that determines the size.
        argument: String,
        /// The size requested and the memory available.
        request: Box<MemoryRequest>,
    },
    /// A step of a simulation that failed.
    #[error("{}: {error}", of_step(*step, *state, joint))]
    Step {
        /// Index of the step, from zero.
        step: usize,
        /// Index of the state in the batch.
        state: usize,
        /// The joint that caused the fault; empty if it is not one joint.
        joint: String,
        /// The error of the step.
        error: Box<Error>,
    },
    /// The caller stopped the work: see [`interrupt`](crate::interrupt).
    #[error("interrupted")]
    Interrupted,
}

/// The connections that a state or a command violates, and by how much.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ConstraintViolation {
    /// Names of the connections.
    pub connections: Vec<String>,
    /// The state or value found.
    pub found: String,
    /// The states or values accepted.
    pub expected: String,
    /// Largest constraint error (rad or m), or largest remaining constraint velocity (per s) or acceleration (per s^2).
    pub residual: f64,
}

impl From<ConstraintViolation> for Error {
    fn from(violation: ConstraintViolation) -> Self {
        Self::Constraint { violation: Box::new(violation), state: None }
    }
}

/// An allocation that was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct MemoryRequest {
    /// Purpose of the memory, or empty if the argument explains it.
    pub what: String,
    /// Number of bytes requested.
    pub bytes: u128,
    /// Number of bytes available, if it is known and too small.
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

/// The size in MB or a larger unit, in parentheses; empty below 1 MB.
fn in_units(bytes: u128) -> String {
    const UNITS: [&str; 6] = ["MB", "GB", "TB", "PB", "EB", "ZB"];
    #[allow(clippy::cast_precision_loss)] // three decimals are printed
    let (mut size, mut unit) = (bytes as f64 / 1e6, 0);
    while size >= 1e3 && unit + 1 < UNITS.len() {
        (size, unit) = (size / 1e3, unit + 1);
    }
    if size < 1.0 { String::new() } else { format!(" ({size:.3} {})", UNITS[unit]) }
}

/// A noun, in the plural for several names, and the names.
fn counted(noun: &str, names: &[String]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("{name:?}")).collect();
    format!("{noun}{} {}", if names.len() == 1 { "" } else { "s" }, quoted.join(", "))
}

/// Text for a pivot without significant digits.
fn lost(pivot: f64, terms: f64) -> String {
    if pivot == 0.0 {
        return "zero".to_owned();
    }
    format!("{pivot:.3e}, lost in the rounding of the terms that form it ({terms:.3e})")
}

/// Text that names one state of a batch; empty for a single state.
fn in_state(state: Option<usize>) -> String {
    state.map_or_else(String::new, |index| format!(" in state {index}"))
}

/// Text that names a step, its state and its joint, if there is one.
pub(crate) fn of_step(step: usize, state: usize, joint: &str) -> String {
    let joint = if joint.is_empty() { String::new() } else { format!(", joint {joint:?}") };
    format!("step {step}, state {state}{joint}")
}

/// The failed state of lowest index in a batch. `?` converts it to an [`Error`] that names the state.
#[derive(Debug, Clone, PartialEq, ThisError)]
#[error("state {state}: {error}")]
#[non_exhaustive]
pub struct Fault {
    /// Index of the state.
    pub state: usize,
    /// The error of that state.
    pub error: Error,
}

impl From<Fault> for Error {
    fn from(fault: Fault) -> Self {
        fault.error.in_state(fault.state)
    }
}

impl Error {
    /// The same error, attributed to state `index` of a batch.
    #[must_use]
    pub fn in_state(mut self, index: usize) -> Self {
        if let Self::NotFinite { state, .. }
        | Self::SingularJoint { state, .. }
        | Self::SingularTask { state, .. }
        | Self::Constraint { state, .. } = &mut self
        {
            *state = Some(index);
        } else if let Self::Step { state, .. } = &mut self {
            *state = index;
        } else if let Self::Argument { found, .. } = &mut self {
            *found = format!("{found} in state {index}");
        }
        self
    }

    /// The same error; a memory error is attributed to the argument `name`, which determines the size.
    #[must_use]
    #[cfg_attr(not(feature = "dense"), allow(dead_code))]
    pub(crate) fn asked_by(mut self, name: &str) -> Self {
        if let Self::Memory { argument, .. } = &mut self {
            name.clone_into(argument);
        }
        self
    }

    /// The same error, attributed to the argument `name` of the public call.
    #[must_use]
    pub(crate) fn of_argument(mut self, name: &str) -> Self {
        if let Self::Argument { argument, .. } = &mut self {
            name.clone_into(argument);
        }
        self
    }

    /// A memory error without a stated purpose.
    pub(crate) fn memory(argument: &str, bytes: u128, free: Option<u128>) -> Self {
        let request = Box::new(MemoryRequest { what: String::new(), bytes, free });
        Self::Memory { argument: argument.to_owned(), request }
    }

    /// A scene error from its three parts.
    pub(crate) fn scene(subject: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Scene { subject: subject.into(), found: found.into(), expected: expected.into() }
    }

    /// A shape error from its three parts.
    pub(crate) fn shape(argument: &str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Shape { argument: argument.to_owned(), found: found.into(), expected: expected.into() }
    }

    /// An argument error from its three parts.
    pub(crate) fn argument(argument: impl Into<String>, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Argument { argument: argument.into(), found: found.into(), expected: expected.into() }
    }
}

/// Code in a message: that for Rust, or that for Python in a build of the Python module.
pub(crate) fn in_language<T>(rust: T, python: T) -> T {
    if cfg!(feature = "python") { python } else { rust }
}

/// Finds a name in `known`; the error lists all names.
pub(crate) fn choose<T: Copy>(argument: &str, name: &str, known: &[(&'static str, T)]) -> Result<T, Error> {
    known.iter().find(|(known, _)| *known == name).map(|&(_, thing)| thing).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("{name:?}")).collect();
        Error::argument(argument, format!("{name:?}"), format!("one of {}", names.join(", ")))
    })
}

/// The name of a value in `known`; empty if it has none.
pub(crate) fn name_in<T: PartialEq>(value: &T, known: &[(&'static str, T)]) -> &'static str {
    known.iter().find(|(_, known)| known == value).map_or("", |(name, _)| name)
}

/// An enum and the table of the names of its variants.
macro_rules! named {
    (
        $(#[$meta:meta])* enum $type:ident;
        $(#[$of_table:meta])* const $table:ident { $($(#[$of:meta])* $variant:ident = $name:literal,)* }
    ) => {
        $(#[$meta])*
        pub enum $type { $($(#[$of])* $variant,)* }

        $(#[$of_table])*
        pub const $table: &[(&str, $type)] = &[$(($name, $type::$variant)),*];
    };
}
pub(crate) use named;

/// Implements `Display` and `FromStr` by a table of names; `argument` is the name in messages.
macro_rules! by_name {
    ($type:ty, $argument:literal, $table:expr) => {
        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad($crate::error::name_in(self, &$table))
            }
        }

        impl std::str::FromStr for $type {
            type Err = $crate::error::Error;

            fn from_str(name: &str) -> Result<Self, Self::Err> {
                $crate::error::choose($argument, name, &$table)
            }
        }
    };
}
pub(crate) use by_name;

/// Formats a number for a message, with an exponent if its magnitude is below 1e-4 or at least 1e7.
pub(crate) fn number(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-4..1e7).contains(&size) || !value.is_finite() {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// Numbers longer than this many characters are reformatted with an exponent in messages.
const LONGEST_NUMBER: usize = 24;

/// Rewrites numbers that `Display` prints in full, such as 1e70 with 71 digits, with an exponent. Quoted names are left
/// unchanged.
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

/// True if a byte can be part of a word or a number.
fn is_in_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'.' || byte == b'_' || byte >= 0x80
}

/// Checks the length of a slice that holds one state.
pub(crate) fn check_length(argument: &str, found: usize, expected: usize) -> Result<(), Error> {
    if found == expected {
        return Ok(());
    }
    Err(Error::shape(argument, format!("({found},)"), format!("({expected},)")))
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

/// Checks that a number is finite and above zero.
pub(crate) fn check_positive(argument: impl Display, value: f64) -> Result<(), Error> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(Error::argument(argument.to_string(), number(value), "a finite number above zero"))
}

/// A short list of existing names for the message about an unknown one, the closest match first.
pub(crate) fn known_names<'a>(wanted: &str, known: impl Iterator<Item = &'a str>, most: usize) -> String {
    let mut names: Vec<&str> = known.collect();
    let far = |at: usize| edits(&wanted.to_lowercase(), &names[at].to_lowercase());
    let closest = (0..names.len()).map(|at| (far(at), at)).min();
    if let Some((far, at)) = closest
        && 2 * far <= wanted.chars().count().max(names[at].chars().count())
    {
        names[..=at].rotate_right(1);
    }
    let listed: Vec<String> = names.iter().take(most).map(|name| format!("{name:?}")).collect();
    let more = if names.len() > most { format!(", ... ({} in all)", names.len()) } else { String::new() };
    format!("{}{more}", listed.join(", "))
}

/// Levenshtein distance of two names.
pub(crate) fn edits(one: &str, other: &str) -> usize {
    let other: Vec<char> = other.chars().collect();
    let mut row: Vec<usize> = (0..=other.len()).collect();
    for (i, a) in one.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, b) in other.iter().enumerate() {
            let replaced = diagonal + usize::from(a != *b);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[other.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closest_name_is_first() {
        let known = || ["base", "upper_arm", "forearm", "hand"].into_iter();
        assert_eq!(known_names("fore_arm", known(), 2), "\"forearm\", \"base\", ... (4 in all)");
        assert_eq!(known_names("HAND", known(), 4), "\"hand\", \"base\", \"upper_arm\", \"forearm\"");
        // Without a similar name the order is that of the scene.
        assert_eq!(known_names("x", known(), 4), "\"base\", \"upper_arm\", \"forearm\", \"hand\"");
        assert_eq!(known_names("x", [].into_iter(), 4), "");
        assert_eq!(["kitten", "", "same"].map(|one| edits(one, "sitting")), [3, 7, 6]);
    }

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
