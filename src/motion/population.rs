//! A model per state: the scenes and the settings of the states of a rollout whose models differ.
//!
//! The settings of the rollout have the largest number of every property, so that a term which acts in some state is
//! part of every step. Trees load the numbers of each state into lanes; a step that needs the set-valued law, and every
//! step of other scenes, is that of the state's own scene.

use super::choice::settings_of_state;
use super::contact::Smoothing;
use super::properties::Properties;
use super::scratch::Scratch;
use super::step_settings::StepSettings;
use crate::batch::instruction_set::Vectorized;
use crate::batch::own_model::{InertiaPlaces, OwnInertias};
use crate::error::Error;
use crate::model::StateModel;
use crate::scene::Scene;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// The models of all states.
#[derive(Debug, Clone)]
pub(super) struct Population {
    /// Each model once where it is that of consecutive states.
    members: Vec<Member>,
    /// The index of the model of each state.
    of_states: Vec<usize>,
    /// Present for trees with other inertias that lanes load.
    pub places: Option<InertiaPlaces>,
    /// True if the steps load the numbers into lanes.
    pub in_lanes: bool,
}

/// The model of some consecutive states.
#[derive(Debug, Clone)]
pub(super) struct Member {
    pub settings: StepSettings,
    /// (joints, 10); empty for those of the scene.
    inertias: Vec<f64>,
    /// Coefficients of friction and restitution of its contacts; empty for those of the scene.
    contacts: [Vec<f64>; 2],
    /// Its scene, made at first use.
    scene: Arc<Mutex<Option<Arc<Scene>>>>,
}

impl Population {
    /// The models of `states` states of a scene, whose settings are those of all states together.
    pub fn new(scene: &Scene, all: &StepSettings, properties: &Properties, states: usize) -> Self {
        let member = |mut own: Properties| {
            let inertias = std::mem::take(&mut own.inertias);
            let contacts = [std::mem::take(&mut own.contact_friction), std::mem::take(&mut own.contact_restitution)];
            let settings = settings_of_state(scene.tree(), all, own);
            Member { settings, inertias, contacts, scene: Arc::default() }
        };
        let in_lanes = all.is_vectorized() && !all.connected && !scene.tree().touches();
        let places = (in_lanes && !properties.inertias.is_empty()).then(|| InertiaPlaces::new(scene));
        let (mut members, mut of_states, mut last) = (Vec::new(), Vec::with_capacity(states), None);
        for state in 0..states {
            let own = properties.of_state((scene.tree().nv(), states), state);
            if last.as_ref() != Some(&own) {
                members.push(member(own.clone()));
                last = Some(own);
            }
            of_states.push(members.len() - 1);
        }
        Self { members, of_states, places, in_lanes }
    }

    /// The model of a state.
    pub fn of(&self, state: usize) -> &Member {
        &self.members[self.of_states[state]]
    }

    /// The settings of every model.
    pub fn settings(&mut self) -> impl Iterator<Item = &mut StepSettings> {
        self.members.iter_mut().map(|member| &mut member.settings)
    }

    /// The end of those of consecutive states that have the model of the first.
    pub fn alike(&self, states: Range<usize>) -> usize {
        let of = &self.of_states[states.clone()];
        states.start + of.partition_point(|member| *member == of[0])
    }

    /// Checks the inertias of every state, and makes the scenes and the contact laws of those that need them.
    pub fn check(&mut self, scene: &Scene) -> Result<(), Error> {
        let states = self.of_states.len();
        for (at, member) in self.members.iter_mut().enumerate() {
            crate::interrupt::check_at(at, 256)?;
            let checked = if self.in_lanes { scene.check_inertias(&member.inertias) } else { member.prepare(scene) };
            let first = || self.of_states.partition_point(|&of| of < at);
            checked.map_err(|error| if states > 1 { error.in_state(first()) } else { error })?;
        }
        Ok(())
    }
}

impl Member {
    /// Makes the scene of this state, and its relaxed contact law, whose forces are shares of its weight.
    fn prepare(&mut self, scene: &Scene) -> Result<(), Error> {
        let own = self.scene(scene)?;
        if let Some(Smoothing { length, .. }) = self.settings.smoothing {
            self.settings.smoothing = Smoothing::new(own.tree(), length, false)?;
        }
        Ok(())
    }

    /// The scene of this state, for whose scene `scene` is.
    pub fn scene(&self, scene: &Scene) -> Result<Arc<Scene>, Error> {
        let mut own = self.scene.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = &*own {
            return Ok(Arc::clone(own));
        }
        let mut made = scene.with_state_model(&StateModel { inertias: &self.inertias, armature: &[] })?;
        let [friction, restitution] = &self.contacts;
        if !(friction.is_empty() && restitution.is_empty()) {
            made = made.with_contact_coefficients(friction, restitution)?;
        }
        Ok(Arc::clone(own.insert(Arc::new(made))))
    }
}

impl<T: Vectorized> Scratch<T> {
    /// Loads the models of the states of a job, the state of each lane by `at`.
    #[inline(always)]
    pub fn take_models(
        &mut self,
        (population, own_inertias): (&Population, &mut Option<Box<OwnInertias<T>>>),
        settings: &StepSettings,
        count: usize,
        at: impl Fn(usize) -> usize,
    ) {
        if let Some(places) = &population.places {
            let inertias =
                own_inertias.get_or_insert_with(|| Box::new(OwnInertias::new(places, Some(&self.constants))));
            // Rollouts check them.
            let _ = inertias.load(
                |lane| &population.of(at(lane.min(count - 1))).inertias,
                |body, inertia| self.constants.set_inertia(body, &inertia),
            );
        }
        for lane in 0..T::LANES {
            let Properties { armature, damping, stiffness, friction, .. } =
                &population.of(at(lane.min(count - 1))).settings.properties;
            for (row, of) in self.rows.iter_mut().enumerate() {
                of.armature.lanes_mut()[lane] = armature[row];
                of.damping.lanes_mut()[lane] = damping[row];
                of.stiffness.lanes_mut()[lane] = stiffness[row];
                of.friction.lanes_mut()[lane] = friction[row];
            }
        }
        if settings.properties.friction_speed == 0.0 {
            for mode in &mut self.modes {
                mode.friction = self.rows[mode.row].friction;
            }
        }
        self.drive_all(settings, settings.scheme.implicit_step());
    }
}
