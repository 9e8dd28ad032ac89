//! Arguments that carry names or masks: entries are matched with joints by name, or refused; none is taken by its position alone.
//!
//! Told by what their classes have, not by their modules: whatever looks like a Series or DataFrame of pandas (modin, cuDF, polars), a
//! DataArray of xarray or a Table of Arrow is one, and none of them is imported.

use crate::error::Error;
use crate::scene::{JointKind, Scene};
use numpy::PyUntypedArray;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyFloat, PyInt, PyList, PyMapping, PyString, PyTuple};
use std::collections::HashMap;

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

fn is_number(value: &Bound<'_, PyAny>) -> bool {
    value.is_exact_instance_of::<PyFloat>() || value.is_exact_instance_of::<PyInt>()
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
            // NumPy has at most 64 axes.
            if place.len() <= 64 {
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

/// Type and module of an object, in words.
pub(super) fn described(value: &Bound<'_, PyAny>) -> PyResult<String> {
    if value.is_none() {
        return Ok("None".to_owned());
    }
    let class = value.get_type();
    let (module, name) = (class.module()?.to_string(), class.qualname()?.to_string());
    Ok(if module == "builtins" {
        format!("an object of type {name}")
    } else {
        format!("an object of type {module}.{name}")
    })
}

/// Masked entries of an array: how many, of how many, and where the first is.
pub(super) struct Masked {
    count: usize,
    total: usize,
    first: usize,
}

impl Masked {
    fn refuse(&self, name: &str) -> PyErr {
        let Self { count, total, first } = self;
        let found =
            format!("a masked array with {count} of {total} entries masked, the first at index {first} (flattened)");
        let expected = "numbers for all entries (only the torque and noise of estimate may be masked: not measured); \
                        .filled(value) puts a number in their place";
        Error::argument(name, found, expected).into()
    }
}

/// The masked array of `NumPy` that it is, if it is one.
fn as_masked<'a, 'py>(value: &'a Bound<'py, PyAny>) -> PyResult<Option<&'a Bound<'py, PyAny>>> {
    static MASKED: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let is_subclass = value.is_instance_of::<PyUntypedArray>() && !value.is_exact_instance_of::<PyUntypedArray>();
    if !is_subclass {
        return Ok(None);
    }
    let class = MASKED.import(value.py(), "numpy.ma", "MaskedArray")?;
    Ok(value.is_instance(class)?.then_some(value))
}

/// Whether it is a masked array, of which even the empty mask would not follow what is written.
pub(super) fn is_masked(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(as_masked(value)?.is_some())
}

/// The masked entries of a masked array that has any.
fn masked_entries(value: &Bound<'_, PyAny>) -> PyResult<Option<Masked>> {
    let Some(mask) = mask_of(value)? else { return Ok(None) };
    let flat = mask.call_method0("ravel")?;
    let count: usize = flat.call_method0("sum")?.extract()?;
    let (total, first) = (flat.len()?, flat.call_method0("argmax")?.extract()?);
    Ok(Some(Masked { count, total, first }))
}

/// The mask of a masked array, of its shape, where any entry is masked.
pub(super) fn mask_of<'py>(value: &Bound<'py, PyAny>) -> PyResult<Option<Bound<'py, PyAny>>> {
    static MASK: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let Some(array) = as_masked(value)? else { return Ok(None) };
    let mask = MASK.import(value.py(), "numpy.ma", "getmaskarray")?.call1((array,))?;
    // Of a record each field has its own; such are refused for their dtype.
    if mask.getattr("dtype")?.getattr("kind")?.extract::<String>()? != "b" {
        return Ok(None);
    }
    Ok(mask.call_method0("any")?.is_truthy()?.then_some(mask))
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
            super::arrays::spread(&of_joint, value, Axis::Plain(1))?
        } else {
            super::arrays::fixed(&of_joint, value, &[count])?
        });
    }
    super::arrays::from_numbers(mapping.py(), &numbers, &[numbers.len()])
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

/// The labels of the entries along the last axis of a value.
struct Labels {
    /// What carries them.
    what: String,
    /// What gives the numbers alone.
    remedy: &'static str,
    along: Along,
}

enum Along {
    /// The numbers from 0 on, which say no more than the position.
    Default,
    /// A label each; none for what is no string.
    Names(Vec<Option<String>>),
    /// The names are on another axis.
    Elsewhere,
    /// Nothing that could be matched, and why not.
    Never(&'static str),
    /// Names of fields, which say something where joints are expected only.
    Fields(Vec<Option<String>>),
}

impl Labels {
    /// Those of a value that has such.
    fn of(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Option<Self>> {
        Self::read(value).map_err(|error| {
            let found = format!("{} with labels that cannot be read ({error})", value.get_type());
            Error::argument(name, found, "an array of numbers").into()
        })
    }

    fn read(value: &Bound<'_, PyAny>) -> PyResult<Option<Self>> {
        let class = value.get_type();
        // Of the class: a Series finds its labels among its own attributes.
        let has = |attribute: &str| class.hasattr(attribute);
        let (remedy, along) = if value.is_instance_of::<PyTuple>() && has("_fields")? {
            ("list(..)", Along::Fields(names(&value.getattr("_fields")?)?))
        } else if has("column_names")? {
            (".to_pandas().to_numpy()", Along::Names(names(&value.getattr("column_names")?)?))
        } else if has("columns")? && has("collect")? {
            (".collect().to_numpy()", Along::Never("its columns are not known before collect()"))
        } else if has("columns")? {
            (".to_numpy()", of_table(value, has("index")?)?)
        } else if has("iloc")? && has("index")? {
            (".to_numpy()", of_index(&value.getattr("index")?)?)
        } else if has("dims")? && has("coords")? {
            (".to_numpy()", of_dimensions(value)?)
        } else if (has("unit")? && has("to_value")?) || (has("units")? && has("magnitude")?) {
            (" in SI units and radians, as a plain array", Along::Never("units are not converted"))
        } else {
            return Ok(None);
        };
        Ok(Some(Self { what: described(value)?, remedy, along }))
    }

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
        let array = super::arrays::as_array(value)?;
        let is_along = array.getattr("shape")?.extract::<Vec<usize>>()?.last() == Some(&labels.len());
        if !is_along {
            return Err(refuse("its labels are not those of its last axis".to_owned()));
        }
        array.call_method1("take", (order, -1))
    }
}

/// Labels as strings.
fn names(labels: &Bound<'_, PyAny>) -> PyResult<Vec<Option<String>>> {
    labels.try_iter()?.map(|label| Ok(label?.extract::<String>().ok())).collect()
}

/// Those of an index of pandas.
fn of_index(index: &Bound<'_, PyAny>) -> PyResult<Along> {
    if index.get_type().name()? == "RangeIndex" {
        let is = |part: &str, number: i64| -> PyResult<bool> { Ok(index.getattr(part)?.extract::<i64>()? == number) };
        if is("start", 0)? && is("step", 1)? {
            return Ok(Along::Default);
        }
    }
    Ok(Along::Names(names(index)?))
}

/// Those of the columns of a table; with rows that have labels too.
fn of_table(table: &Bound<'_, PyAny>, has_rows: bool) -> PyResult<Along> {
    let columns = table.getattr("columns")?;
    let along = of_index(&columns)?;
    if matches!(along, Along::Default) && has_rows {
        let rows = table.getattr("index")?;
        // A time is a label of a state, a name is one of a joint.
        if !rows.is_callable()
            && !matches!(of_index(&rows)?, Along::Default)
            && names(&rows)?.iter().any(Option::is_some)
        {
            return Ok(Along::Elsewhere);
        }
    }
    Ok(along)
}

/// Those of the last dimension of an array of xarray.
fn of_dimensions(array: &Bound<'_, PyAny>) -> PyResult<Along> {
    if array.get_type().hasattr("data_vars")? {
        return Ok(Along::Never("it has several arrays"));
    }
    let dimensions: Vec<Bound<'_, PyAny>> = array.getattr("dims")?.try_iter()?.collect::<PyResult<_>>()?;
    let coordinates = array.getattr("coords")?;
    let labels = |dimension: &Bound<'_, PyAny>| -> PyResult<Option<Vec<Option<String>>>> {
        if !coordinates.contains(dimension)? {
            return Ok(None);
        }
        names(&coordinates.get_item(dimension)?.getattr("values")?.call_method0("tolist")?).map(Some)
    };
    let Some((last, others)) = dimensions.split_last() else { return Ok(Along::Default) };
    if let Some(labels) = labels(last)? {
        return Ok(Along::Names(labels));
    }
    for dimension in others {
        if labels(dimension)?.is_some_and(|labels| labels.iter().any(Option::is_some)) {
            return Ok(Along::Elsewhere);
        }
    }
    Ok(Along::Default)
}

/// The first entry of a sequence, however deep, that is no real number; nothing where that is not to be told.
pub(super) fn culprit(sequence: &Bound<'_, PyAny>) -> PyResult<String> {
    for (at, entry) in sequence.try_iter()?.enumerate() {
        let entry = entry?;
        if is_sequence(&entry) {
            let within = culprit(&entry)?;
            if !within.is_empty() {
                return Ok(within);
            }
        } else if !is_number(&entry) && !entry.is_instance_of::<PyUntypedArray>() {
            return Ok(format!(" (entry {at} is {})", described(&entry)?));
        }
    }
    Ok(String::new())
}

/// What to do with an object that is no array of numbers.
pub(super) fn remedy(value: &Bound<'_, PyAny>) -> Option<&'static str> {
    let class = value.get_type();
    let has = |attribute: &str| class.hasattr(attribute).unwrap_or(false);
    if value.is_instance_of::<PyString>() {
        return None;
    }
    if has("toarray") {
        return Some(".toarray() gives one");
    }
    if has("__next__") || has("__iter__") {
        return Some("list(..) or numpy.fromiter gives one, where it has an order");
    }
    None
}
