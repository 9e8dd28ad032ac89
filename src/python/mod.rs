//! The Python module `phipsi._core`: `NumPy` in, `NumPy` out, over the same checked algorithms as the crate.
//!
//! [`arrays`] reads arguments and makes results, for every method in one place; [`evaluate`] runs a kernel over the
//! states of a call, [`single`] over one state by a shorter way; [`errors`] maps each error of the crate to its Python class; the
//! other files are the methods by subject. Nothing outside this folder names pyo3 or numpy.

#![allow(clippy::doc_markdown)] // the comments of classes and methods are Python's docstrings

mod accuracy;
mod arrays;
mod bad_states;
mod builder;
mod changes;
mod choice;
mod configuration;
mod cost;
mod counts;
mod description;
mod dynamics;
mod errors;
mod estimation;
mod evaluate;
mod factor;
mod geometry;
mod interrupts;
mod kept;
mod labels;
mod masks;
mod motion;
mod operational;
mod parts;
mod plan;
mod refusals;
mod report;
mod scene;
mod scenes;
mod single;
mod stability;
mod stochastic;
mod tables;
mod threads;
mod wrenches;

/// Articulated-body dynamics as Kalman filtering: the compiled half of `phipsi`.
#[pyo3::pymodule(name = "_core")]
mod core_module {
    use pyo3::prelude::*;
    use pyo3::types::PyTuple;

    #[pymodule_export]
    use super::builder::PySceneBuilder;
    #[pymodule_export]
    use super::description::{rebuild_builder, rebuild_scene};
    #[pymodule_export]
    use super::factor::{PyFactor, rebuild_factor};
    #[pymodule_export]
    use super::kept::{get_kept_memory, set_kept_memory};
    #[pymodule_export]
    use super::labels::numbers;
    #[pymodule_export]
    use super::plan::{PyOmission, PyPlan, rebuild_omission, rebuild_plan};
    #[pymodule_export]
    use super::report::{
        PyReference, call_of_method, growth_of, measure_method, operator_growth_of, reference_of, residuals_at,
    };
    #[pymodule_export]
    use super::scene::PyScene;
    #[pymodule_export]
    use super::scenes::{chain_of, extreme_case, extreme_names};
    #[pymodule_export]
    use super::stability::PyExact;
    #[pymodule_export]
    use super::stochastic::{PyRandomModel, emergence_of, rebuild_random_model};
    #[pymodule_export]
    use super::threads::{get_num_threads, set_num_threads};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("BUNDLED_ARM", crate::scenes::BUNDLED_ARM)?;
        let routes = crate::report::emergence::ROUTES.map(|(name, _)| name);
        module.add("ROUTES", PyTuple::new(module.py(), routes)?)?;
        module.add("FORMS", PyTuple::new(module.py(), super::stability::forms())?)?;
        module.add("QUANTITIES", PyTuple::new(module.py(), super::stability::quantities())?)?;
        let methods = crate::report::accuracy::METHODS.map(|(name, _)| name);
        module.add("METHODS", PyTuple::new(module.py(), methods)?)
    }
}
