//! What is wrong with connections, in words.

use super::scratch::NoDirection;
use super::solution::Outcome;
use crate::error::{ConstraintFault, Error};
use crate::scene::Scene;

impl Scene {
    /// A rod whose ends coincide.
    pub(crate) fn no_direction(&self, at: NoDirection) -> Error {
        let name = self.constraints().all.get(at.0).map(|constraint| constraint.name.clone());
        ConstraintFault {
            connections: name.into_iter().collect(),
            found: "a distance of zero, which has no direction".to_owned(),
            expected: "a configuration where the two points are apart".to_owned(),
            residual: 0.0,
        }
        .into()
    }

    /// The names of the connections of rows, each once.
    fn connections_of(&self, rows: &[usize]) -> Vec<String> {
        let mut names: Vec<String> = rows.iter().map(|&row| self.constraints().name_of(row).to_owned()).collect();
        names.dedup();
        names
    }

    /// An error where rows contradict each other.
    pub(crate) fn check_agreement(&self, outcome: &Outcome) -> Result<(), Error> {
        if outcome.contradicted.is_empty() {
            return Ok(());
        }
        Err(ConstraintFault {
            connections: self.connections_of(&outcome.contradicted),
            found: format!(
                "accelerations that no forces take away, {:.1e} m/s^2 or rad/s^2 (rank {} of {} rows)",
                outcome.residual,
                outcome.rank,
                self.constraint_rows()
            ),
            expected: "connections that agree with each other, at positions and velocities that meet them (scene.project gives such)"
                .to_owned(),
            residual: outcome.residual,
        }
        .into())
    }

    /// The error of a state that is not on the connections: what it is of, the row, how much, and its unit.
    pub(crate) fn open_at(&self, argument: &str, row: usize, left: f64, unit: &str, remedy: &str) -> Error {
        ConstraintFault {
            connections: self.connections_of(&[row]),
            found: format!("an error of {left:.1e} {unit} at {argument}"),
            expected: remedy.to_owned(),
            residual: left,
        }
        .into()
    }
}
