//! The Python module `phipsi._core`: `NumPy` in, `NumPy` out, over the same checked algorithms as the crate.
//!
//! Every call takes the same path: [`input`] reads the arguments; [`call`] checks that they broadcast and evaluates the
//! states of the batch without the GIL; [`output`] creates the result. [`evaluate`] does this for algorithms with
//! vectorized kernels and [`each`] for all others; [`single`] is the short path for one plain state. [`errors`] maps
//! each error of the crate to its Python class, and [`docstrings`] has the entries that docstrings share. The other
//! files are the methods by subject. No two files use each other, and no file outside of this folder uses pyo3 or
//! numpy.

// The doc comments of classes and methods are docstrings of Python, not Markdown.
#![allow(clippy::doc_markdown, clippy::doc_link_with_quotes, clippy::doc_lazy_continuation)]
// The arguments of a method are its keywords in Python, and PyO3 hands arrays and lists over by value.
#![allow(clippy::too_many_arguments, clippy::needless_pass_by_value)]

#[macro_use]
mod docstrings;
mod dtype;
#[macro_use]
mod methods;
#[macro_use]
mod stepping;

mod accuracy;
mod actuators;
mod axis;
mod bad_states;
mod builder;
mod call;
mod centroidal;
mod changes;
mod choice;
mod codegen;
mod collider_tuple;
mod colliders;
mod configuration;
mod connection_tuple;
mod connections;
mod constraints;
mod contact_tuple;
mod contacts;
mod control;
mod cost;
mod counts;
mod coupling;
mod derivatives;
mod description;
mod dynamics;
mod each;
mod errors;
mod estimation;
mod evaluate;
mod factor;
mod fresh;
mod function_table;
mod geometry;
mod groups;
mod identification;
mod input;
mod interrupts;
mod inverse_kinematics;
mod keywords;
mod links;
mod motion;
mod object;
mod observer;
mod operational;
mod optimize;
mod output;
mod own_models;
mod panics;
mod parts;
mod pickled_simulator;
mod plan;
mod products;
mod report;
mod rollout_gradients;
mod scene;
mod scenes;
mod scratch;
mod simulator;
mod single;
mod stability;
mod start;
mod stochastic;
mod threads;
mod uncertainty;
mod wrenches;

/// Articulated-body dynamics as Kalman filtering: the compiled half of `phipsi`.
#[pyo3::pymodule(name = "_core")]
mod core_module {
    use pyo3::prelude::*;
    use pyo3::types::PyTuple;

    #[pymodule_export]
    use super::builder::{PySceneBuilder, rebuild_builder};
    #[pymodule_export]
    use super::factor::{PyFactor, rebuild_factor};
    #[pymodule_export]
    use super::fresh::unwritten_numbers;
    #[pymodule_export]
    use super::function_table::function_table;
    #[pymodule_export]
    use super::groups::{PyContacts, PyLoops};
    #[pymodule_export]
    use super::identification::{log_likelihood, rotate_chosen, rotate_rows, smooth_log};
    #[pymodule_export]
    use super::observer::PyObserver;
    #[pymodule_export]
    use super::optimize::PyOptimizer;
    #[pymodule_export]
    use super::panics::{panic_for_tests, panic_place};
    #[pymodule_export]
    use super::pickled_simulator::rebuild_simulator;
    #[pymodule_export]
    use super::report::{
        PyReference, call_of_method, growth_of, measure_method, operator_growth_of, reference_of, residuals_at,
    };
    #[pymodule_export]
    use super::scene::{PyScene, numbers, rebuild_scene};
    #[pymodule_export]
    use super::scenes::{chain_of, extreme_case, extreme_names};
    #[pymodule_export]
    use super::simulator::PySimulator;
    #[pymodule_export]
    use super::stability::PyExact;
    #[pymodule_export]
    use super::stochastic::{PyRandomModel, emergence_of, rebuild_random_model};
    #[pymodule_export]
    use super::threads::{get_num_threads, set_num_threads};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::panics::adopt(module.py())?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("BUNDLED_ARM", crate::scenes::BUNDLED_ARM)?;
        let routes = crate::report::emergence::ROUTES.iter().map(|&(name, _)| name);
        module.add("ROUTES", PyTuple::new(module.py(), routes)?)?;
        let forms = crate::report::stability::FORMS.iter().map(|&(name, _)| name);
        module.add("FORMS", PyTuple::new(module.py(), forms)?)?;
        let quantities = crate::report::sensitivity::QUANTITIES.iter().map(|&(name, _)| name);
        module.add("QUANTITIES", PyTuple::new(module.py(), quantities)?)?;
        let methods = crate::report::accuracy::METHODS.iter().map(|&(name, _)| name);
        module.add("METHODS", PyTuple::new(module.py(), methods)?)
    }
}
