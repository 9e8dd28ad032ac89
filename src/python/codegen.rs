//! Methods of `Scene`: the robot as code.

use super::choice::names;
use super::links::read_frame;
use super::object::{Object, imported};
use super::scene::PyScene;
use crate::codegen::{FUNCTIONS, Function, Sources, WATCHED, Width, cuda_sources, rust_sources, sources_accepting};
use crate::error::{Error, number};
use crate::kinematics::ReferenceFrame;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyString};

#[pymethods]
impl PyScene {
    /// Generates C99 code for the dynamics of this robot, which depends on libm only: a dict from file names to their contents, NAME.c, NAME.h, test_NAME.c and a Makefile.
    ///
    /// directory: the directory to which the files are also written, created if necessary; None: no files are written. name: prefix of files and functions. functions: names among "forward_dynamics",
    /// "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse", "forward_dynamics_derivatives", "inverse_dynamics_derivatives", "forward_dynamics_jvp",
    /// "forward_dynamics_vjp", "inverse_dynamics_jvp", "inverse_dynamics_vjp", "placements", "forward_dynamics_watched", "mass_matrix_inverse_watched" and "factor_watched", which also return a margin for each
    /// state, negative if precision may be lost; and functions of one link, ("placement", link), ("jacobian", link) and ("jacobian", link, frame), with frame as in jacobian. None: all functions without a margin that are
    /// not for one link. dtype: "float64" or "float32", the type of the code. batches: True to add functions for batches, such as NAME_forward_dynamics_batch(count, ...), vectorized over states with the vector
    /// extensions of GCC and Clang. tolerance: the error to which the margins refer, as in forward_dynamics.
    ///
    /// Each function, for instance NAME_forward_dynamics(q, qd, tau, qdd), is a sequence of operations for one state, without allocations: constants are folded, and operations that this robot does not
    /// need are omitted. Several results are consecutive arguments, as in NAME_forward_dynamics_derivatives(q, qd, tau, dqdd_dq, dqdd_dqd, Minv). Functions of one link have its name in theirs, as in
    /// NAME_jacobian_tool0_world(q, jacobian), with _ for characters that C does not allow. The order of q and qd is that of the scene; SI units, radians. The results equal those of form "covariance" to rounding,
    /// without an error estimate. Wrenches and changed parameters are not supported. `make test` in the directory compiles the code and compares it with the scene at one state.
    ///
    /// Raises ArgumentError for a name that is not a C identifier, unknown functions and links, and links whose functions would have the same name in C; for dynamics of a scene with connections, for a scene with
    /// coupled joints (mimic="couple"), and for the inverse mass matrix and the derivatives of forward dynamics of chains of more than 300 joints; OSError if files cannot be written.
    #[pyo3(signature = (directory=None, *, name="robot", functions=None, dtype="float64", batches=false, tolerance=None))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn to_c<'py>(
        &self,
        py: Python<'py>,
        directory: Option<&Object<'py>>,
        name: &str,
        functions: Option<&Object<'py>>,
        dtype: &str,
        batches: bool,
        tolerance: Option<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (width, functions) = (read_width(dtype)?, read_functions(functions)?);
        if tolerance.is_some() && !functions.iter().any(|function| WATCHED.contains(function)) {
            let found = format!("{} for functions without a margin", number(tolerance.unwrap_or_default()));
            return Err(Error::argument(
                "tolerance",
                found,
                "one of the functions that end in _watched, or no tolerance",
            )
            .into());
        }
        written(py, directory, sources_accepting(&self.scene, name, &functions, (width, batches), tolerance)?)
    }

    /// The dynamics of this robot as a Rust crate that needs `core` alone, a dict from names of files to their texts: Cargo.toml, src/lib.rs, src/dynamics.rs, src/lanes.rs, src/numbers.rs and tests/reference.rs.
    ///
    /// directory: where to write them too, made where it is not there; None: nowhere. name: of the crate. functions: as of to_c.
    ///
    /// Each function is one straight line of operations in safe code, forward_dynamics(&q, &qd, &tau) -> [T; NV] for instance, without allocations, for any T of the trait Number that src/dynamics.rs defines: f64 and f32 by
    /// the standard library (feature "std", on unless switched off), Lanes<T, N> of src/lanes.rs for N states at once, or a type of yours; forward_dynamics_batch and its like take slices of states. Order of q
    /// and qd as in the scene; SI units, radians. Results are those of form "covariance" to rounding: digits that it loses are not noticed. `cargo test` in the directory compares with the scene at one state.
    ///
    /// Raises ArgumentError for a name that no crate can have, and as to_c; OSError where files cannot be written.
    #[pyo3(signature = (directory=None, *, name="robot", functions=None))]
    fn to_rust<'py>(
        &self,
        py: Python<'py>,
        directory: Option<&Object<'py>>,
        name: &str,
        functions: Option<&Object<'py>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        written(py, directory, rust_sources(&self.scene, name, &read_functions(functions)?)?)
    }

    /// The dynamics of this robot as CUDA kernels, a dict from names of files to their texts: NAME.cu, one_thread.h, test_NAME.cu and a Makefile.
    ///
    /// directory: where to write them too, made where it is not there; None: nowhere. name: what files and kernels begin with. functions: as of to_c. dtype: "float64" or "float32", the numbers of the code.
    ///
    /// Each kernel takes many states, one a thread: NAME_forward_dynamics(count, q, qd, tau, qdd) for instance, extern "C", with `count` an unsigned long long. Number i of the q of state s is q[i * count + s]. NAME.cu includes nothing: NVRTC
    /// compiles it at run time, as phipsi.compile(device="cuda") does, or nvcc. Order of q and qd as in the scene; SI units, radians. Results are those of form "covariance" to rounding: digits that it loses are not
    /// noticed. `make test` in the directory compares with the scene at one state on a GPU; `make test-c` does so by the C compiler, where threads are a loop.
    ///
    /// Raises ArgumentError as to_c; OSError where files cannot be written.
    #[pyo3(signature = (directory=None, *, name="robot", functions=None, dtype="float64"))]
    fn to_cuda<'py>(
        &self,
        py: Python<'py>,
        directory: Option<&Object<'py>>,
        name: &str,
        functions: Option<&Object<'py>>,
        dtype: &str,
    ) -> PyResult<Bound<'py, PyDict>> {
        written(py, directory, cuda_sources(&self.scene, name, &read_functions(functions)?, read_width(dtype)?)?)
    }
}

/// Files as a dict, and in a directory where one is given.
fn written<'py>(py: Python<'py>, directory: Option<&Object<'py>>, sources: Sources) -> PyResult<Bound<'py, PyDict>> {
    let files = PyDict::new(py);
    for (file, text) in sources {
        files.set_item(file, text)?;
    }
    if let Some(directory) = directory {
        imported!(py, "phipsi._files", "write")?.call1((directory, &files))?;
    }
    Ok(files)
}

fn read_width(dtype: &str) -> PyResult<Width> {
    match dtype {
        "float64" => Ok(Width::Double),
        "float32" => Ok(Width::Single),
        _ => Err(Error::argument("dtype", format!("{dtype:?}"), "\"float64\" or \"float32\"").into()),
    }
}

/// Functions by their names, or of one link as (name, link) and (name, link, frame), each once; of None all that are of no one link and not watched.
fn read_functions(given: Option<&Object<'_>>) -> PyResult<Vec<Function>> {
    let Some(given) = given else {
        return Ok(FUNCTIONS.to_vec());
    };
    let expected = "names of functions";
    if given.is_instance_of::<PyString>() || given.is_instance_of::<PyMapping>() {
        return Err(Error::argument("functions", given.repr()?.to_string(), expected).into());
    }
    let mut functions = Vec::new();
    let Ok(all) = given.try_iter() else {
        return Err(Error::argument("functions", given.repr()?.to_string(), expected).into());
    };
    for item in all {
        let function = read_function(&item?)?;
        if !functions.contains(&function) {
            functions.push(function);
        }
    }
    Ok(functions)
}

fn read_function(item: &Object<'_>) -> PyResult<Function> {
    let parts = if let Ok(name) = item.extract::<String>() { vec![name] } else { names("functions", item, OF_ONE)? };
    let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
    Ok(match parts[..] {
        ["placement", link] => Function::Placement(link.to_owned()),
        ["jacobian", link] => Function::Jacobian(link.to_owned(), ReferenceFrame::Local),
        ["jacobian", link, frame] => Function::Jacobian(link.to_owned(), read_frame(frame)?),
        [name] => {
            FUNCTIONS.into_iter().chain(WATCHED).find(|known| known.name() == name).ok_or_else(|| unknown(item))?
        }
        _ => return Err(unknown(item)),
    })
}

const OF_ONE: &str = "(\"placement\", link), (\"jacobian\", link) or (\"jacobian\", link, frame)";

fn unknown(item: &Object<'_>) -> PyErr {
    let found = item.repr().map_or_else(|_| "an object".to_owned(), |said| said.to_string());
    let known: Vec<&str> = FUNCTIONS.iter().chain(&WATCHED).map(Function::name).collect();
    let known = known.join(", ");
    Error::argument("functions", found, format!("one of {known}, {OF_ONE}")).into()
}
