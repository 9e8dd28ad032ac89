//! Changes of targets and wrenches, and checks of initial states: joints beyond their limits, which the stops move
//! back, contacts below their surface, and violated connections.

use super::contact;
use super::properties::Gains;
#[cfg(feature = "python")]
use super::properties::joint_of_row;
use super::rollout::Rollout;
use super::simulator::Simulator;
use super::wrenches::{LinkWrenches, Wrenches};
use crate::error::{Error, in_language};
use crate::scene::Scene;
use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Largest accepted violation of the connections by an initial state, m or rad, and m/s or rad/s, and largest depth of
/// a contact without a warning, m.
const AT_START: f64 = 1e-6;

impl<S: Borrow<Scene>> Rollout<S> {
    /// Checks that an initial state satisfies the connections; omitted if rows have compliance.
    pub(super) fn check_connections(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        let is_soft = self.settings.given.compliance.iter().any(|&compliance| compliance > 0.0);
        if is_soft { Ok(()) } else { self.scene().check_on_connections(q, qd, AT_START) }
    }

    /// Warning about joints of the given states that are beyond limits with active stops, which move them back at 1
    /// rad/s or m/s at most. Call it before the first step and after a reset.
    ///
    /// # Panics
    ///
    /// If an index is not below [`Rollout::states`].
    pub fn limit_warning(&self, states: impl IntoIterator<Item = usize>) -> Option<String> {
        if !self.has_stops() {
            return None;
        }
        let states: Vec<usize> = states.into_iter().collect();
        let mut outside = Vec::new();
        for joint in self.scene().joints().iter().filter(|joint| joint.q.len() == 1 && joint.v.len() == 1) {
            let (lower, upper) = (joint.limits.lower, joint.limits.upper);
            let mut starts = states.iter().map(|&state| self.state(state).0[joint.q.start]);
            if let Some(q) = starts.find(|q| !(lower..=upper).contains(q)) {
                let (limit, bound) = if q < lower { ("lower", lower) } else { ("upper", upper) };
                outside.push(format!("joint {:?} at {q} beyond its {limit} limit {bound}", joint.name));
            }
        }
        let first = outside.first()?;
        let more = if outside.len() > 1 { format!(" and {} more", outside.len() - 1) } else { String::new() };
        Some(format!(
            "q: found {first}{more}; the stops move them back at up to 1 rad/s or m/s; \
             {} disables the stops",
            in_language("Limits::Report", "limits=\"report\"")
        ))
    }

    /// Warning about contacts of the given states that are below their surface: the first step moves them out at once,
    /// and smoothed contacts move out over many steps. Call it before the first step and after a reset.
    ///
    /// # Panics
    ///
    /// As [`Rollout::limit_warning`].
    pub fn contact_warning(&self, states: impl IntoIterator<Item = usize>) -> Option<String> {
        let (scene, mut shapes) = (self.scene(), contact::Shapes::new(self.scene()));
        let points = scene.contact_points();
        let mut depths = vec![0.0_f64; points.len()];
        let mut of_shapes = BTreeMap::new();
        for state in states.into_iter().take_while(|_| scene.touches()) {
            let (q, v) = self.state(state);
            for (point, depth) in points.iter().zip(&mut depths) {
                *depth = depth.max(-point.touch_at(scene.model(), q).gap);
            }
            for (pair, depth) in shapes.iter_mut().flat_map(|shapes| shapes.depths(scene, (q, v))) {
                let deepest: &mut f64 = of_shapes.entry(pair).or_insert(0.0);
                *deepest = deepest.max(depth);
            }
        }
        let named = points.iter().zip(depths).map(|(point, depth)| (format!("contact {:?}", point.name), depth));
        let pairs = of_shapes.into_iter().map(|([i, j], depth)| {
            let [first, second] = [i, j].map(|at: usize| &scene.colliders()[at].name);
            (format!("colliders {first:?} and {second:?}"), depth)
        });
        let deep = named.chain(pairs).filter(|(_, depth)| *depth > AT_START);
        penetration(deep.collect(), self.settings.smoothing.is_some())
    }

    /// Number of substeps of all states in which connections or contacts prevented a stop from acting, since the states
    /// began.
    #[cfg(feature = "python")]
    pub(crate) fn dropped(&self) -> f64 {
        let (scene, states) = (self.scene(), self.states());
        let states = if scene.constraints().is_empty() && !scene.touches() { 0 } else { states };
        (0..states).map(|state| self.totals(state).dropped).sum()
    }

    /// Text of a warning for the substeps that [`Rollout::dropped`] counts.
    #[cfg(feature = "python")]
    pub(crate) fn dropped_warning(&self) -> String {
        let of = (0..self.states()).map(|state| self.totals(state)).find(|of| of.dropped > 0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // index of a joint
        let joint = joint_of_row(self.scene(), of.map_or(0, |of| of.dropped_row as usize));
        format!(
            "limits: found joint {joint:?} at a stop that the connections or contacts prevent from acting in {} \
             substeps of {} steps, as at a dead center; expected limits that the mechanism can meet: the stop is \
             omitted in such substeps; {} lists the rows outside of limits",
            of.map_or(0.0, |of| of.dropped),
            self.steps(),
            in_language("the motion", "path.violations()")
        )
    }
}

/// Text of a warning for parts that penetrate each other, with their names and depths, m, the deepest first.
fn penetration(mut found: Vec<(String, f64)>, is_smoothed: bool) -> Option<String> {
    found.sort_by(|(_, one), (_, other)| other.total_cmp(one));
    let (name, depth) = found.first()?;
    let more = if found.len() > 1 { format!(" and {} more", found.len() - 1) } else { String::new() };
    let outcome = if is_smoothed {
        "the steps move them out slowly"
    } else {
        "the first step moves them out at once, as far as the joints can"
    };
    Some(format!(
        "q: found {name} {depth:.6} m deep{more}; {outcome}; expected a start without \
         penetration, such as {} if the file has one",
        in_language("Scene::initial", "scene.initial()")
    ))
}

impl<S: Borrow<Scene>> Rollout<S> {
    /// Changes the targets of the control law from the next step on, given as in [`Gains`]; `None` leaves them.
    ///
    /// # Errors
    ///
    /// A rollout without a control law; targets of a wrong size, or that are not configurations. The targets are then
    /// unchanged.
    pub fn aim(&mut self, target: Option<&[f64]>, target_rate: Option<&[f64]>) -> Result<(), Error> {
        let Some(gains) = &self.settings.gains else {
            let expected =
                in_language("a rollout with Settings::gains", "a simulator that was created with pd=PD(kp, kd)");
            return Err(Error::argument("target", "targets without a control law", expected));
        };
        let mut gains = Gains::clone(gains);
        for (to, from) in [(&mut gains.target, target), (&mut gains.target_rate, target_rate)] {
            if let Some(from) = from {
                from.clone_into(to);
            }
        }
        gains.check(self.scene(), self.states())?;
        let gains = Some(Arc::new(gains));
        self.change(|of| of.gains.clone_from(&gains));
        Ok(())
    }

    /// Changes the wrenches on links from the next step on; `None` removes them.
    ///
    /// # Errors
    ///
    /// An unknown link, a wrong number of values, and values that are not finite. The wrenches are then unchanged.
    pub fn push(&mut self, wrenches: Option<Wrenches>) -> Result<(), Error> {
        let given = wrenches.map(|given| LinkWrenches::new(given, self.scene(), self.states()));
        let given = given.transpose()?.map(Arc::new);
        self.change(|of| of.wrenches.clone_from(&given));
        Ok(())
    }

    /// True if wrenches act on links.
    #[cfg(feature = "python")]
    pub(crate) fn is_pushed(&self) -> bool {
        self.settings.wrenches.is_some()
    }
}

impl<S: Borrow<Scene>> Simulator<S> {
    /// As [`Rollout::push`].
    ///
    /// # Errors
    ///
    /// As [`Rollout::push`].
    pub fn push(&mut self, wrenches: Option<Wrenches>) -> Result<(), Error> {
        self.rollout.push(wrenches)
    }

    /// As [`Rollout::aim`].
    ///
    /// # Errors
    ///
    /// As [`Rollout::aim`].
    pub fn aim(&mut self, target: Option<&[f64]>, target_rate: Option<&[f64]>) -> Result<(), Error> {
        self.rollout.aim(target, target_rate)
    }
}
