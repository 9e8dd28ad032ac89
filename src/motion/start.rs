//! Where states begin: beyond joint limits, from which the stops move them back.

use super::rollout::Rollout;
use super::simulator::Simulator;
use crate::scene::Scene;
use std::borrow::Borrow;

impl<S: Borrow<Scene>> Rollout<S> {
    /// A warning if joints of some states are beyond limits that are stops: they are moved back, at 1 rad/s or m/s at most. To be asked before the first
    /// step, and after a state began anew.
    ///
    /// # Panics
    ///
    /// If there is no such state: see [`Rollout::states`].
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
            "q: found {first}{more}; the stops move them back, at 1 rad/s or m/s at most; limits=\"report\" switches the stops off"
        ))
    }
}

impl<S: Borrow<Scene>> Simulator<S> {
    /// As [`Rollout::limit_warning`].
    ///
    /// # Panics
    ///
    /// As there.
    pub fn limit_warning(&self, states: impl IntoIterator<Item = usize>) -> Option<String> {
        self.rollout.limit_warning(states)
    }
}
