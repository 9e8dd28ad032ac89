//! Scenes with coupled joints: conversion to and from the tree of independent joints, in which simulations run.

use super::input::Input;
use super::object::Object;
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use crate::motion::Properties;
use crate::scene::Coupling;
use pyo3::prelude::*;

/// Conversion of the values of one state of the scene to those of the tree.
pub(super) type Expand = fn(&Coupling, &[f64]) -> Vec<f64>;

impl PyScene {
    /// Converts an argument to the tree; the identity without coupled joints.
    pub(super) fn on_tree<'py>(&self, py: Python<'py>, input: Input<'py>, expand: Expand) -> PyResult<Input<'py>> {
        match self.scene.coupling() {
            None => Ok(input),
            Some(coupling) => input.mapped(py, |state| expand(coupling, state)),
        }
    }

    /// Converts the values of one state of the scene to the tree.
    pub(super) fn expanded(&self, numbers: Vec<f64>, expand: Expand) -> Vec<f64> {
        match self.scene.coupling() {
            None => numbers,
            Some(coupling) => expand(coupling, &numbers),
        }
    }

    /// Converts configurations or joint velocities of the tree, (..., nq) or (..., nv), to the scene.
    pub(super) fn of_scene<'py>(&self, array: Object<'py>, rates: bool) -> PyResult<Object<'py>> {
        let Some(coupling) = self.scene.coupling() else { return Ok(array) };
        let kept = if rates { coupling.independent_rows() } else { coupling.independent_coordinates_at() };
        array.call_method1("take", (kept.to_vec(), -1))
    }

    /// Configurations or joint velocities of the states of a simulation, with the given leading axes.
    pub(super) fn of_states<'a, 'py>(
        &self,
        py: Python<'py>,
        axes: &[usize],
        states: impl Iterator<Item = (&'a [f64], &'a [f64])>,
        is_rate: bool,
    ) -> PyResult<Object<'py>> {
        let width = if is_rate { self.scene.tree().nv() } else { self.scene.tree().nq() };
        let mut rows = states.map(|(q, qd)| if is_rate { qd } else { q });
        if axes.is_empty()
            && let Some(row) = rows.next()
        {
            return self.of_scene(from_numbers(py, row, &[width])?, is_rate);
        }
        let mut output = Output::new(py, &[axes, &[width]].concat())?;
        output.gather(py, width, rows)?;
        self.of_scene(output.finish().into_any(), is_rate)
    }

    /// The joint properties of the scene.
    pub(super) fn properties(&self) -> Properties {
        self.properties_of_scene(&Properties::of(&self.scene))
    }

    /// Converts joint properties of the tree to the coordinates of the scene.
    pub(super) fn properties_of_scene(&self, of: &Properties) -> Properties {
        let Some(coupling) = self.scene.coupling() else { return of.clone() };
        let nv = self.scene.tree().nv().max(1);
        // Of all states, or one after another.
        let each = |values: &[f64], reduce: &dyn Fn(&[f64]) -> Vec<f64>| values.chunks(nv).flat_map(reduce).collect();
        let squares = |values: &[f64]| each(values, &|of| coupling.reduce_squares(of));
        Properties {
            armature: squares(&of.armature),
            damping: squares(&of.damping),
            stiffness: squares(&of.stiffness),
            friction: each(&of.friction, &|of| coupling.reduce_friction(of)),
            inertias: of.inertias.clone(),
            contact_friction: of.contact_friction.clone(),
            contact_restitution: of.contact_restitution.clone(),
            rest: coupling.reduce_rest(&of.stiffness, &of.rest),
            curves: coupling.independent_rows().iter().filter_map(|&row| of.curves.get(row).copied()).collect(),
            friction_speed: of.friction_speed,
        }
    }
}
