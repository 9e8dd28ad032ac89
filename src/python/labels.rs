//! Arguments that carry names or masks: entries are matched with joints by name, or refused; none is taken by its position alone.
//!
//! [`tables`](super::tables) finds the labels, [`masks`](super::masks) the masked entries.

use super::arrays::{as_array, fixed, from_numbers, read, spread};
use super::masks::masked_entries;
use super::refusals::described;
use super::scene::PyScene;
use super::tables::{Along, Labels};
use crate::error::Error;
use crate::scene::{JointKind, Scene};
use numpy::{PyArrayDyn, PyUntypedArray};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyFloat, PyInt, PyList, PyMapping, PyString, PyTuple};
use std::collections::HashMap;

/// Lists within lists are looked into so deep: one may hold itself.
pub(super) const DEEPEST: usize = 8;

/// What the entries along the last axis of an argument belong to.
#[derive(Clone, Copy)]
pub(super) enum Axis<'a> {
    /// So many numbers that no name of ours stands for.
    Plain(usize),
    /// Coordinates, as in q.
    Coordinates(&'a Scene),
    /// Degrees of freedom, as in qd and tau.
    Rates(&'a Scene),
    /// Movable joints.
    Joints(&'a Scene),
}

impl From<usize> for Axis<'_> {
    fn from(width: usize) -> Self {
        Self::Plain(width)
    }
}

impl<'a> Axis<'a> {
    /// How many entries.
    pub fn width(self) -> usize {
        match self {
            Self::Plain(width) => width,
            Self::Coordinates(scene) => scene.nq(),
            Self::Rates(scene) => scene.nv(),
            Self::Joints(scene) => scene.joints().len(),
        }
    }

    /// Every joint with the number of its entries, in their order; none where no joint has any.
    fn joints(self) -> Option<Vec<(&'a str, usize)>> {
        let (scene, count): (&Scene, fn(JointKind) -> usize) = match self {
            Self::Plain(_) => return None,
            Self::Coordinates(scene) => (scene, JointKind::nq),
            Self::Rates(scene) => (scene, JointKind::nv),
            Self::Joints(scene) => (scene, |_| 1),
        };
        Some(scene.joints().iter().map(|joint| (joint.name.as_str(), count(joint.kind))).collect())
    }
}

/// The argument with its entries in the order of the joints and without labels; as it is where it has none.
///
/// Masked entries are refused; what cannot be read as numbers at all is left to the conversion.
pub(super) fn resolved<'py>(name: &str, value: &Bound<'py, PyAny>, axis: Axis<'_>) -> PyResult<Bound<'py, PyAny>> {
    if is_number(value) || value.is_exact_instance_of::<PyUntypedArray>() {
        return Ok(value.clone());
    }
    if is_sequence(value) {
        check_entries(name, value, &mut Vec::new())?;
        return Ok(value.clone());
    }
    if let Some(masked) = masked_entries(value)? {
        return Err(masked.refuse(name));
    }
    if let Ok(mapping) = value.cast::<PyMapping>() {
        return by_joint(name, mapping, axis);
    }
    match Labels::of(name, value)? {
        Some(labels) => labels.matched(name, value, axis),
        None => Ok(value.clone()),
    }
}

/// Whether it is a number of Python's, or a scalar of `NumPy`'s of any kind: neither has names.
pub(super) fn is_number(value: &Bound<'_, PyAny>) -> bool {
    static SCALAR: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    value.is_exact_instance_of::<PyFloat>()
        || value.is_exact_instance_of::<PyInt>()
        || SCALAR.import(value.py(), "numpy", "generic").is_ok_and(|scalar| value.is_instance(scalar).unwrap_or(false))
}

/// Whether it is a list or a tuple, and nothing that has names beside.
pub(super) fn is_sequence(value: &Bound<'_, PyAny>) -> bool {
    value.is_exact_instance_of::<PyList>() || value.is_exact_instance_of::<PyTuple>()
}

/// Refuses names and masks within lists and tuples, which would be lost.
fn check_entries(name: &str, sequence: &Bound<'_, PyAny>, place: &mut Vec<usize>) -> PyResult<()> {
    for (at, entry) in sequence.try_iter()?.enumerate() {
        let entry = entry?;
        if is_number(&entry) || entry.is_exact_instance_of::<PyUntypedArray>() || entry.is_instance_of::<PyString>() {
            continue;
        }
        place.push(at);
        if is_sequence(&entry) {
            if place.len() < DEEPEST {
                check_entries(name, &entry, place)?;
            }
        } else {
            let label = || place.iter().fold(name.to_owned(), |label, at| format!("{label}[{at}]"));
            if let Some(masked) = masked_entries(&entry)? {
                return Err(masked.refuse(&label()));
            }
            let has_labels = |labels: Labels| !matches!(labels.along, Along::Default);
            if entry.is_instance_of::<PyMapping>() || Labels::of(name, &entry)?.is_some_and(has_labels) {
                let expected = "numbers: names within a list are not matched; stack the states in one array, or in one table with a column a joint";
                return Err(Error::argument(label(), described(&entry)?, expected).into());
            }
        }
        place.pop();
    }
    Ok(())
}

/// The entries of a mapping whose keys are strings.
pub(super) fn items<'py>(name: &str, mapping: &Bound<'py, PyMapping>) -> PyResult<Vec<(String, Bound<'py, PyAny>)>> {
    let mut items = Vec::with_capacity(mapping.len()?);
    for item in mapping.items()? {
        let (key, value): (Bound<'py, PyAny>, Bound<'py, PyAny>) = item.extract()?;
        let Ok(key) = key.extract::<String>() else {
            return Err(Error::argument(name, format!("the key {}", key.repr()?), "names of joints").into());
        };
        items.push((key, value));
    }
    Ok(items)
}

/// One state, from a mapping of every joint's name to its number or numbers.
fn by_joint<'py>(name: &str, mapping: &Bound<'py, PyMapping>, axis: Axis<'_>) -> PyResult<Bound<'py, PyAny>> {
    let Some(joints) = axis.joints() else {
        let expected = format!("an array of shape (..., {}): no names of joints belong to its entries", axis.width());
        return Err(Error::argument(name, described(mapping)?, expected).into());
    };
    let items = items(name, mapping)?;
    let keys: Vec<Option<String>> = items.iter().map(|(key, _)| Some(key.clone())).collect();
    let order = order(name, &described(mapping)?, &keys, &joints)?;
    let mut numbers = Vec::with_capacity(axis.width());
    for (&at, &(joint, count)) in order.iter().zip(&joints) {
        let of_joint = format!("{name}[{joint:?}]");
        let value = &items[at].1;
        numbers.extend(if count == 1 {
            spread(&of_joint, value, Axis::Plain(1))?
        } else {
            fixed(&of_joint, value, &[count])?
        });
    }
    from_numbers(mapping.py(), &numbers, &[numbers.len()])
}

/// For each joint where its label is; every joint must have one, and every label a joint.
fn order(name: &str, what: &str, labels: &[Option<String>], joints: &[(&str, usize)]) -> Result<Vec<usize>, Error> {
    let mut places: HashMap<&str, usize> = HashMap::new();
    let (mut twice, mut unknown) = (Vec::new(), Vec::new());
    let known: HashMap<&str, usize> = joints.iter().copied().collect();
    for (at, label) in labels.iter().enumerate() {
        match label.as_deref() {
            Some(label) if known.contains_key(label) => {
                if places.insert(label, at).is_some() {
                    twice.push(label);
                }
            }
            Some(label) => unknown.push(label),
            None => unknown.push("a label that is no string"),
        }
    }
    let missing: Vec<&str> =
        joints.iter().map(|&(joint, _)| joint).filter(|joint| !places.contains_key(joint)).collect();
    if twice.is_empty() && unknown.is_empty() && missing.is_empty() {
        return Ok(joints.iter().map(|(joint, _)| places[joint]).collect());
    }
    let faults: Vec<String> =
        [("without", missing), ("with what is no movable joint,", unknown), ("with twice", twice)]
            .into_iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(how, names)| format!("{how} {}", listed(&names)))
            .collect();
    let names: Vec<&str> = joints.iter().map(|&(joint, _)| joint).collect();
    Err(Error::argument(
        name,
        format!("{what} {}", faults.join(" and ")),
        format!("every joint once: {}", listed(&names)),
    ))
}

/// Names in quotes, not too many.
fn listed(names: &[&str]) -> String {
    const MOST: usize = 12;
    let quoted: Vec<String> = names.iter().take(MOST).map(|name| format!("{name:?}")).collect();
    let more = if names.len() > MOST { format!(", ... ({} in all)", names.len()) } else { String::new() };
    quoted.join(", ") + &more
}

impl Labels {
    /// The numbers of the value in the order of the joints.
    fn matched<'py>(self, name: &str, value: &Bound<'py, PyAny>, axis: Axis<'_>) -> PyResult<Bound<'py, PyAny>> {
        let Self { what, remedy, along } = self;
        let refuse = |why: String| {
            let expected = match axis.joints() {
                None => format!("numbers without labels: {name}{remedy}"),
                Some(joints) => {
                    let names: Vec<&str> = joints.iter().map(|&(joint, _)| joint).collect();
                    format!(
                        "labels that are the names of the joints ({}), or numbers alone in their order: {name}{remedy}",
                        listed(&names)
                    )
                }
            };
            PyErr::from(Error::argument(name, format!("{what}: {why}"), expected))
        };
        let labels = match along {
            Along::Default => return Ok(value.clone()),
            Along::Fields(_) if matches!(axis, Axis::Plain(_)) => return Ok(value.clone()),
            Along::Elsewhere => {
                return Err(refuse("the names are on another axis than the last; transpose it".to_owned()));
            }
            Along::Never(why) => return Err(refuse(why.to_owned())),
            Along::Names(labels) | Along::Fields(labels) => labels,
        };
        let Some(joints) = axis.joints() else {
            return Err(refuse("it has labels, which nothing here is matched by".to_owned()));
        };
        if let Some((joint, count)) = joints.iter().find(|&&(_, count)| count != 1) {
            return Err(refuse(format!(
                "joint {joint:?} has {count} entries here, which one label does not tell apart (a dict from names to arrays does)"
            )));
        }
        if labels.iter().all(Option::is_none) {
            return Err(refuse("its labels are no names".to_owned()));
        }
        let order = order(name, &what, &labels, &joints)?;
        let array = as_array(value)?;
        let is_along = array.getattr("shape")?.extract::<Vec<usize>>()?.last() == Some(&labels.len());
        if !is_along {
            return Err(refuse("its labels are not those of its last axis".to_owned()));
        }
        array.call_method1("take", (order, -1))
    }
}

/// An argument of a method written in Python as float64, of any shape: its last axis of q's entries or qd's where a scene is given.
#[pyfunction]
#[pyo3(name = "_numbers", signature = (name, value, scene=None, coordinates=false, /))]
pub(super) fn numbers<'py>(
    name: &str,
    value: &Bound<'py, PyAny>,
    scene: Option<&PyScene>,
    coordinates: bool,
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let axis = match scene {
        None => Axis::Plain(0),
        Some(scene) if coordinates => scene.coordinates(),
        Some(scene) => scene.rates(),
    };
    read(name, value, axis)
}
