//! Pickles and copies of a `Simulator`: its arguments, and its current state.

use super::choice::name_of;
use super::description::body_names;
use super::errors::refuse;
use super::input::shaped;
use super::object::Object;
use super::output::from_numbers;
use super::scene::PyScene;
use super::simulator::PySimulator;
use super::stepping::{Keywords, OF_CONTACTS, OF_RATES};
use crate::memory;
use crate::motion::{Gains, Limits, Method, Properties, Settings};
use pyo3::prelude::*;
use pyo3::types::PyDict;

#[pymethods]
impl PySimulator {
    /// The arguments of Scene.simulator, and the current state.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Object<'py>, Object<'py>)> {
        let (q, qd) = (self.q(py)?, self.qd(py)?);
        let moving = self.moving()?;
        let mut settings = moving.settings();
        if self.drive.is_some() {
            settings.gains = None;
        }
        let keywords = self.keywords(py, &settings)?;
        for (name, value) in [("control", self.control(py)?), ("activation", self.activation(py)?)] {
            if let Some(value) = value {
                keywords.set_item(name, value)?;
            }
        }
        let (numbers, begun, done) = moving.numbers();
        let numbers = from_numbers(py, numbers, &[numbers.len()])?;
        let rebuild = py.import("phipsi._core")?.getattr("_rebuild_simulator")?;
        let (begun, chosen) = (memory::copied("simulator", begun)?, moving.chosen_method().name());
        let made_of = (self.scene.clone_ref(py), q, qd, keywords, numbers, begun, done, chosen);
        Ok((rebuild, made_of.into_pyobject(py)?.into_any()))
    }
}

impl PySimulator {
    /// Keywords of Scene.simulator for these settings.
    fn keywords<'py>(&self, py: Python<'py>, settings: &Settings) -> PyResult<Bound<'py, PyDict>> {
        let Settings { dt, method, form, properties, gains, compliance, .. } = settings.clone();
        let keywords = PyDict::new(py);
        keywords.set_item("dt", dt)?;
        keywords.set_item("method", method.name())?;
        keywords.set_item("form", name_of(form))?;
        Keywords::add_fields(&keywords, settings)?;
        if !compliance.is_empty() {
            keywords.set_item("compliance", from_numbers(py, &compliance, &[compliance.len()])?)?;
        }
        keywords.set_item("friction_speed", properties.friction_speed)?;
        let limits = match settings.limits {
            Limits::Stop => None,
            Limits::Report => Some("report"),
        };
        keywords.set_item("limits", limits)?;
        let own = self.scene.get();
        // The others are those of the scene: with coupled joints, which are not those of the independent joints only.
        let (mut all, mut usual) = (properties, Properties::of(&own.scene));
        let mut properties = own.properties_of_scene(&all);
        for (name, place) in OF_RATES {
            if place(&mut all) != place(&mut usual) {
                let (numbers, width) = (&*place(&mut properties), own.scene.nv());
                let of_states = if numbers.len() == width { &[][..] } else { &self.batch };
                keywords.set_item(name, from_numbers(py, numbers, &[of_states, &[width]].concat())?)?;
            }
        }
        if all.rest != usual.rest {
            let rest = own.of_scene(from_numbers(py, &all.rest, &[all.rest.len()])?, false)?;
            keywords.set_item("rest", rest)?;
        }
        if !properties.inertias.is_empty() {
            let shape = [&self.batch[..], &[body_names(&own.scene).len(), 10]].concat();
            keywords.set_item("inertias", from_numbers(py, &properties.inertias, &shape)?)?;
        }
        for (name, place) in OF_CONTACTS {
            let numbers = &*place(&mut properties);
            if !numbers.is_empty() {
                let shape = [&self.batch[..], &[own.scene.contact_coefficients()]].concat();
                keywords.set_item(name, from_numbers(py, numbers, &shape)?)?;
            }
        }
        if let Some(gains) = gains {
            let Gains {
                proportional, derivative, target, target_rate, effort_upper, stall, decline, limits_sum, ..
            } = gains;
            let each = |numbers: &[f64], is_rate: bool| {
                let width = if is_rate { own.scene.tree().nv() } else { own.scene.tree().nq() };
                let shape = if numbers.len() == width { vec![width] } else { [&self.batch[..], &[width]].concat() };
                own.of_scene(from_numbers(py, numbers, &shape)?, is_rate)
            };
            let gains = (each(&proportional, true)?, each(&derivative, true)?);
            let if_any = |numbers: &[f64]| (!numbers.is_empty()).then(|| each(numbers, true)).transpose();
            // A torque that does not decline has no such speed, also if it is zero.
            let no_load = |(stall, &decline): (&f64, &f64)| if decline > 0.0 { stall / decline } else { f64::INFINITY };
            let speed: Vec<f64> = stall.iter().zip(&decline).map(no_load).collect();
            let limits = (if_any(&effort_upper)?, if_any(&stall)?, if_any(&speed)?);
            let (target, rate) = (each(&target, false)?, each(&target_rate, true)?);
            let pd = (gains.0, gains.1, target, rate, limits.0, limits.1, limits.2);
            keywords.set_item("effort", limits_sum.then_some("clip"))?;
            keywords.set_item("pd", pd)?;
        }
        Ok(keywords)
    }
}

/// Rebuilds a simulator from the result of Simulator.__reduce__.
#[pyfunction]
#[pyo3(name = "_rebuild_simulator", signature = (scene, q, qd, keywords, numbers, begun, steps, method, /))]
pub(super) fn rebuild_simulator<'py>(
    scene: &Bound<'py, PyScene>,
    q: &Object<'py>,
    qd: &Object<'py>,
    keywords: &Bound<'py, PyDict>,
    numbers: &Object<'py>,
    begun: Vec<usize>,
    steps: usize,
    method: &str,
) -> PyResult<Bound<'py, PySimulator>> {
    let made = scene.call_method("simulator", (q, qd), Some(keywords))?.cast_into::<PySimulator>()?;
    let (_, numbers) = shaped("pickled simulator", numbers, 0)?;
    if !made.get().moving()?.resume(Method::named(method)?, (&numbers, &begun), steps) {
        return refuse("pickled simulator", "data of another size", "the data that pickle wrote");
    }
    Ok(made)
}
