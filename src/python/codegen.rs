//! Methods of `Scene`: code generation.

use super::choice::names;
use super::errors::refuse;
use super::links::read_frame;
use super::object::{Object, imported};
use super::scene::PyScene;
use crate::codegen::{FUNCTIONS, Function, Sources, WATCHED, Width, cuda_sources, rust_sources, sources_accepting};
use crate::error::{Error, number};
use crate::kinematics::ReferenceFrame;
use crate::scene::Scene;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyString};

typed_methods! {
    in PyScene;

    /// Generate C99 code for the dynamics of this robot, which depends on libm only.
    #[doc = parameters!(directory)]
    /// name : str, default "robot"
    ///     Prefix of files and functions, a C identifier.
    /// functions : str, or iterable of str or tuple, optional
    ///     "forward_dynamics", "inverse_dynamics", "bias_torque", "mass_matrix", "mass_matrix_inverse",
    ///     "forward_dynamics_derivatives", "inverse_dynamics_derivatives", "forward_dynamics_jvp",
    ///     "forward_dynamics_vjp", "inverse_dynamics_jvp", "inverse_dynamics_vjp" and "placements"; with connections
    ///     also "constrained_dynamics", but no derivatives and products of forward dynamics; with contacts also
    ///     "contact_gaps", "contact_velocities" and, without connections and mimic joints, "contact_gram". The names of
    ///     functions that have a form, except "contact_gram", followed by "_watched" also return a margin per state,
    ///     negative if precision may be lost; "factor_watched" is the margin of the factor of M alone. Functions of one
    ///     link are ("placement", link), ("jacobian", link) and ("jacobian", link, frame). None: all without a margin
    ///     that are not of one link.
    /// dtype : {"float64", "float32"}, default "float64"
    ///     Scalar type of the code.
    /// batches : bool, default False
    ///     If true, add functions for batches, such as NAME_forward_dynamics_batch(count, ...), vectorized over
    ///     states with the vector extensions of GCC and Clang.
    /// tolerance : float, optional
    ///     Error to which the margins refer, as in forward_dynamics; infinity: the margins of functions with
    ///     connections do not include an error estimate.
    #[doc = section!(Returns)]
    /// files : dict of str to str
    ///     File names and contents: NAME.c, NAME.h, test_NAME.c and a Makefile.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An invalid name, unknown functions or links, links with equal names in C, functions without code for the
    ///     connections, contacts or mimic joints of the scene, and chains of more than 300 joints for the inverse mass
    ///     matrix and the forward derivatives.
    /// OSError
    ///     Files that cannot be written.
    #[doc = section!(Notes)]
    /// Each function, for instance NAME_forward_dynamics(q, qd, tau, qdd), is a sequence of operations for one state
    /// without allocations: constants are folded, and operations that this robot does not need are omitted. Several
    /// results are consecutive arguments: NAME_forward_dynamics_derivatives(q, qd, tau, dqdd_dq, dqdd_dqd, Minv).
    /// Functions of one link contain its name, as NAME_jacobian_tool0_world(q, jacobian), with _ for characters that C
    /// does not allow. The order of q and qd is that of the scene. Results equal those of form "covariance" to
    /// rounding, without an error estimate. Wrenches and changed parameters are not supported. `make test` in the
    /// directory compares the code with the scene at one state.
    ///
    /// With connections, forward_dynamics and constrained_dynamics (whose fourth argument is the compliance of each
    /// row, zero for rigid rows) factor the rows in a fixed order. Only the functions with a margin report states for
    /// which this is not valid, because rows depend on each other or the state violates the connections.
    #[doc = section!(Examples)]
    /// >>> files = phipsi.scenes.chain(3).to_c(name="arm", functions=["forward_dynamics"])
    /// >>> sorted(files)
    /// ['Makefile', 'arm.c', 'arm.h', 'test_arm.c']
    fn to_c[&self, py: Python<'py>](
        directory: Option<&Object<'py>> = None; name: &str = "robot", functions: Option<&Object<'py>> = None,
        dtype: &str = "float64", batches: bool = false, tolerance: Option<f64> = None
    ) -> PyResult<Bound<'py, PyDict>> {
        let (width, functions) = (read_width(dtype)?, read_functions(&self.scene, functions)?);
        if tolerance.is_some() && !functions.iter().any(|function| WATCHED.contains(function)) {
            let found = format!("{} for functions without a margin", number(tolerance.unwrap_or_default()));
            return refuse("tolerance", found, "one of the functions that end in _watched, or no tolerance");
        }
        written(py, directory, sources_accepting(&self.scene, name, &functions, (width, batches), tolerance)?)
    }

    /// Generate a Rust crate for the dynamics of this robot, which depends on `core` only.
    #[doc = parameters!(directory)]
    /// name : str, default "robot"
    ///     Name of the crate.
    #[doc = entries!(functions)]
    #[doc = section!(Returns)]
    /// files : dict of str to str
    ///     File names and contents: Cargo.toml, src/lib.rs, src/dynamics.rs, src/lanes.rs, src/numbers.rs,
    ///     tests/reference.rs.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An invalid name, and as to_c.
    /// OSError
    ///     Files that cannot be written.
    #[doc = section!(Notes)]
    /// Each function, for instance forward_dynamics(&q, &qd, &tau) -> [T; NV], is a sequence of operations in safe code
    /// without allocations, for any type with the trait Number of src/dynamics.rs: f64 and f32 (feature "std", enabled
    /// by default), Lanes<T, N> of src/lanes.rs for N states at once, or your own type. Functions such as
    /// forward_dynamics_batch take slices of states. Results equal those of form "covariance" to rounding, without an
    /// error estimate. `cargo test` compares the crate with the scene at one state.
    #[doc = section!(Examples)]
    /// >>> files = phipsi.scenes.chain(3).to_rust(functions=["mass_matrix"])
    /// >>> "pub fn mass_matrix" in files["src/dynamics.rs"]
    /// True
    fn to_rust[&self, py: Python<'py>](
        directory: Option<&Object<'py>> = None; name: &str = "robot", functions: Option<&Object<'py>> = None
    ) -> PyResult<Bound<'py, PyDict>> {
        written(py, directory, rust_sources(&self.scene, name, &read_functions(&self.scene, functions)?)?)
    }

    /// Generate CUDA kernels for the dynamics of this robot.
    #[doc = parameters!(directory)]
    /// name : str, default "robot"
    ///     Prefix of files and kernels.
    #[doc = entries!(functions)]
    /// dtype : {"float64", "float32"}, default "float64"
    ///     Scalar type of the code.
    #[doc = section!(Returns)]
    /// files : dict of str to str
    ///     File names and contents: NAME.cu, one_thread.h, test_NAME.cu and a Makefile.
    #[doc = raises!(as_to_c)]
    #[doc = section!(Notes)]
    /// Each kernel, for instance extern "C" NAME_forward_dynamics(count, q, qd, tau, qdd) with an unsigned long long
    /// count, computes one state per thread. Entry i of the q of state s is q[i * count + s]. NAME.cu has no includes:
    /// NVRTC compiles it at run time (phipsi.compile(device="cuda")), or nvcc does. Results equal those of form
    /// "covariance" to rounding, without an error estimate. `make test` compares the kernels with the scene at one
    /// state on a GPU; `make test-c` does so with the C compiler.
    #[doc = section!(Examples)]
    /// >>> files = phipsi.scenes.chain(3).to_cuda(functions=["forward_dynamics"])
    /// >>> "robot.cu" in files
    /// True
    fn to_cuda[&self, py: Python<'py>](
        directory: Option<&Object<'py>> = None; name: &str = "robot", functions: Option<&Object<'py>> = None,
        dtype: &str = "float64"
    ) -> PyResult<Bound<'py, PyDict>> {
        let functions = read_functions(&self.scene, functions)?;
        written(py, directory, cuda_sources(&self.scene, name, &functions, read_width(dtype)?)?)
    }
}

/// Returns the files as a dict, and writes them to the directory if one is given.
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
        _ => refuse("dtype", format!("{dtype:?}"), "\"float64\" or \"float32\""),
    }
}

/// Reads functions: names, (name, link) or (name, link, frame), without duplicates. None: all functions with code for
/// the scene that are not for one link and have no margin.
fn read_functions(scene: &Scene, given: Option<&Object<'_>>) -> PyResult<Vec<Function>> {
    let Some(given) = given else {
        return Ok(Function::of(scene));
    };
    if given.is_instance_of::<PyString>() {
        return Ok(vec![read_function(given)?]);
    }
    let items = if given.is_instance_of::<PyMapping>() { None } else { given.try_iter().ok() };
    let Some(items) = items else {
        return refuse("functions", given.repr()?.to_string(), "names of functions");
    };
    let mut functions = Vec::new();
    for item in items {
        let function = read_function(&item?)?;
        if !functions.contains(&function) {
            functions.push(function);
        }
    }
    Ok(functions)
}

fn read_function(item: &Object<'_>) -> PyResult<Function> {
    let parts = names("functions", item, OF_ONE)?;
    let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
    Ok(match parts[..] {
        ["placement", link] => Function::Placement(link.to_owned()),
        ["jacobian", link] => Function::Jacobian(link.to_owned(), ReferenceFrame::Local),
        ["jacobian", link, frame] => Function::Jacobian(link.to_owned(), read_frame(frame)?),
        [name] => {
            let mut known = FUNCTIONS.iter().chain(WATCHED);
            known.find(|known| known.name() == name).cloned().ok_or_else(|| unknown(item))?
        }
        _ => return Err(unknown(item)),
    })
}

const OF_ONE: &str = "(\"placement\", link), (\"jacobian\", link) or (\"jacobian\", link, frame)";

fn unknown(item: &Object<'_>) -> PyErr {
    let found = item.repr().map_or_else(|_| "an object".to_owned(), |said| said.to_string());
    let known: Vec<&str> = FUNCTIONS.iter().chain(WATCHED).map(Function::name).collect();
    let known = known.join(", ");
    Error::argument("functions", found, format!("one of {known}, {OF_ONE}")).into()
}
