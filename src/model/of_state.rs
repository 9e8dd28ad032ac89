//! A model per state: the numbers in which the states of a batch differ.

/// The numbers of the model that one state has instead of the scene. Those that are empty are the scene's.
///
/// A population of models is one scene and these numbers for each of its members: the kernels load them into lanes.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StateModel<'a> {
    /// Inertial parameters (m, m c, I about the origin) of each link that a joint carries with the links fixed to it,
    /// in its frame, (joints, 10), as [`Scene::inertial_parameters`](crate::Scene::inertial_parameters) writes them.
    pub inertias: &'a [f64],
    /// Armature, (nv), kg m^2 or kg.
    pub armature: &'a [f64],
}

impl StateModel<'_> {
    /// True if the model is that of the scene.
    #[inline]
    #[must_use]
    pub fn is_of_scene(&self) -> bool {
        self.inertias.is_empty() && self.armature.is_empty()
    }
}
