//! The keywords that many methods of `Scene` share.

use super::object::Object;
use super::own_models::Models;
use crate::scene::Scene;
use pyo3::prelude::*;

/// The keywords of the methods of `Scene`, and the link of those that have one; those that a method does not take have
/// the values of [`Keywords::none`].
#[derive(Default)]
pub(super) struct Keywords<'a, 'py> {
    pub errors: &'a str,
    pub form: &'a str,
    pub frame: &'a str,
    pub kind: &'a str,
    pub link: &'a str,
    /// Largest accepted error estimate; None: the default.
    pub tolerance: Option<f64>,
    pub parameters: bool,
    pub springs_and_damping: bool,
    /// True if forward dynamics returns its accuracy.
    pub return_info: bool,
    pub wrenches: Option<&'a Object<'py>>,
    pub out: Option<&'a Object<'py>>,
    pub dtype: Option<&'a Object<'py>>,
    pub inertias: Option<&'a Object<'py>>,
    pub armature: Option<&'a Object<'py>>,
    pub at: Option<&'a Object<'py>>,
    pub rotation: Option<&'a Object<'py>>,
    pub directions: Option<&'a Object<'py>>,
    pub xyz: Option<&'a Object<'py>>,
    pub compliance: Option<&'a Object<'py>>,
    pub actuated: Option<&'a Object<'py>>,
    pub dwrenches: Option<&'a Object<'py>>,
    pub dparameters: Option<&'a Object<'py>>,
    pub darmature: Option<&'a Object<'py>>,
    pub dgravity: Option<&'a Object<'py>>,
}

impl<'py> Keywords<'_, 'py> {
    /// The models of the states.
    pub fn models(&self, scene: &Scene) -> PyResult<Models<'py>> {
        Models::read(scene, self.inertias, self.armature)
    }

    /// True if the states have their own models.
    pub fn has_models(&self) -> bool {
        self.inertias.is_some() || self.armature.is_some()
    }

    pub fn none() -> Self {
        Self { errors: "raise", form: "auto", kind: "spatial", ..Self::default() }
    }
}
