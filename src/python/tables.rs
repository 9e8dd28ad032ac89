//! The labels of tables and labelled arrays, told by what their classes have, not by their modules.
//!
//! Whatever looks like a Series or DataFrame of pandas (modin, cuDF, polars), a DataArray of xarray or a Table of Arrow is one; none of them
//! is imported.

use super::refusals::described;
use crate::error::Error;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// The labels of the entries along the last axis of a value.
pub(super) struct Labels {
    /// What carries them.
    pub what: String,
    /// What gives the numbers alone.
    pub remedy: &'static str,
    /// What they are.
    pub along: Along,
}

/// What labels there are.
pub(super) enum Along {
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
    pub fn of(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Option<Self>> {
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
