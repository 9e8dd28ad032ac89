//! Arguments that are one of some names.

use crate::error::Error;

/// The thing of that name; the error lists the names that there are.
pub(super) fn choose<T: Copy>(argument: &str, name: &str, known: &[(&'static str, T)]) -> Result<T, Error> {
    known.iter().find(|(known, _)| *known == name).map(|&(_, thing)| thing).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("{name:?}")).collect();
        Error::argument(argument, format!("{name:?}"), format!("one of {}", names.join(", ")))
    })
}
