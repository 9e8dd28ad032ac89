//! Methods of `Scene`: the robot as C code.

use super::choice::names;
use super::object::{Object, imported};
use super::scene::PyScene;
use crate::codegen::{FUNCTIONS, Function, Width, sources};
use crate::error::Error;
use pyo3::prelude::*;
use pyo3::types::PyDict;

#[pymethods]
impl PyScene {
    /// The dynamics of this robot as C99 that needs nothing but libm, a dict from names of files to their texts: NAME.c, NAME.h, test_NAME.c and a Makefile.
    ///
    /// directory: where to write them too, made where it is not there; None: nowhere. name: what files and functions begin with. functions: names among "forward_dynamics",
    /// "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse"; None: all. dtype: "float64" or "float32", the numbers of the code. batches: whether to write NAME_forward_dynamics_batch(count, ...) and its like too, which run
    /// as many states at once as the processor's registers hold, by the vector extensions of GCC and Clang; float64 only.
    ///
    /// Each function is one straight line of operations for one state, NAME_forward_dynamics(q, qd, tau, qdd) for instance, without allocations: constants are folded, and what this robot does not need is
    /// not there. Order of q and qd as in the scene; SI units, radians. Results are those of form "covariance" to rounding: digits that it loses are not noticed. `make test` in the directory
    /// compiles it and compares with the scene at one state.
    ///
    /// Raises ArgumentError for a name that C has not, unknown functions, a scene with connections or with joints that follow others (mimic="couple"), and for the inverse mass matrix of
    /// chains of more than 300 joints; OSError where files cannot be written.
    #[pyo3(signature = (directory=None, *, name="robot", functions=None, dtype="float64", batches=false))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn to_c<'py>(
        &self,
        py: Python<'py>,
        directory: Option<&Object<'py>>,
        name: &str,
        functions: Option<&Object<'py>>,
        dtype: &str,
        batches: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let width = match dtype {
            "float64" => Width::Double,
            "float32" => Width::Single,
            _ => return Err(Error::argument("dtype", format!("{dtype:?}"), "\"float64\" or \"float32\"").into()),
        };
        let functions = functions.map_or_else(|| Ok(FUNCTIONS.to_vec()), read_functions)?;
        let files = PyDict::new(py);
        for (file, text) in sources(&self.scene, name, &functions, (width, batches))? {
            files.set_item(file, text)?;
        }
        if let Some(directory) = directory {
            imported!(py, "phipsi._files", "write")?.call1((directory, &files))?;
        }
        Ok(files)
    }
}

/// Names of functions, each once.
fn read_functions(given: &Object<'_>) -> PyResult<Vec<Function>> {
    let known = FUNCTIONS.map(Function::name);
    let mut functions = Vec::new();
    for name in names("functions", given, "names of functions")? {
        let Some(at) = known.iter().position(|&known| known == name) else {
            return Err(
                Error::argument("functions", format!("{name:?}"), format!("one of {}", known.join(", "))).into()
            );
        };
        if !functions.contains(&FUNCTIONS[at]) {
            functions.push(FUNCTIONS[at]);
        }
    }
    Ok(functions)
}
