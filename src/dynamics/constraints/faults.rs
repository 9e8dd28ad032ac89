//! Error messages for connections.

use super::geometry::relaxed_at;
use super::projection::worst;
use super::rows::ConnectionRows;
use super::{Outcome, RowFault};
use crate::error::{ConstraintViolation, Error, in_language};
use crate::scene::Scene;
use crate::workspace::Workspace;

/// The largest error of the connections that a call accepts, m or rad, and m/s or rad/s. Measurements, finite
/// differences and the drift of an integrator stay below it.
pub(super) const IN_CALLS: f64 = 1e-3;

impl Scene {
    /// Rows that do not exist at a state.
    pub(crate) fn row_fault(&self, at: RowFault) -> Error {
        let name = match at {
            RowFault::NoDirection(index) => self.constraints().all.get(index).map(|constraint| constraint.name.clone()),
            RowFault::NotFinite(row, value) => {
                let argument = format!("rows of connection {:?}", self.constraints().name_of(row));
                return Error::NotFinite { argument, index: row, value, state: None };
            }
        };
        ConstraintViolation {
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

    /// An error if rows contradict each other.
    pub(crate) fn check_agreement(&self, outcome: &Outcome) -> Result<(), Error> {
        if outcome.contradicted.is_empty() {
            return Ok(());
        }
        Err(ConstraintViolation {
            connections: self.connections_of(&outcome.contradicted),
            found: format!(
                "accelerations that no forces take away, {:.1e} m/s^2 or rad/s^2 (rank {} of {} rows)",
                outcome.residual,
                outcome.rank,
                self.constraint_rows()
            ),
            expected: format!(
                "connections that agree with each other, at positions and velocities that meet them ({} gives such)",
                in_language("Scene::project", "scene.loops.project")
            ),
            residual: outcome.residual,
        }
        .into())
    }

    /// Checks that a state meets the connections: errors within `slack`, m or rad, and their time derivatives within
    /// `slack`, m/s or rad/s, or relative to the fastest joint velocity if that exceeds 1. Combinations of rows that
    /// count as dependent may have errors up to the tolerance of the scene.
    pub(crate) fn check_on_connections(&self, q: &[f64], qd: &[f64], slack: f64) -> Result<(), Error> {
        if self.constraints().is_empty() {
            return Ok(());
        }
        let mut workspace = Workspace::new(self.model());
        let mut rows = ConnectionRows::new((self.model(), &workspace.sweeps), self.constraints());
        rows.place(self.model(), &mut workspace, (q, qd)).map_err(|at| self.row_fault(at))?;
        self.check_rows(&rows, (q, qd), slack)
    }

    /// The same check with the rows at the state.
    fn check_rows(&self, at: &ConnectionRows<f64>, (q, qd): (&[f64], &[f64]), slack: f64) -> Result<(), Error> {
        if at.all.is_empty() {
            return Ok(());
        }
        let remedy = format!(
            "a state that meets the connections to within {slack}{}",
            in_language(", for instance that of Scene::project", ": q, qd, rank = scene.loops.project(q, qd)")
        );
        let mut rest = vec![0.0; self.constraints().rows];
        let fastest = qd.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
        let mut relaxed = None;
        for (argument, unit, speed) in [("q", "m or rad", 1.0), ("qd", "m/s or rad/s", fastest)] {
            let mut rows: Vec<f64> =
                at.all.iter().map(|row| if argument == "q" { row.error } else { row.rate }).collect();
            let mut row = worst(&rows);
            if rows[row].abs() <= slack * speed {
                continue;
            }
            let relaxed = match &mut relaxed {
                Some(relaxed) => &*relaxed,
                none => none.insert(relaxed_at(self, q)?),
            };
            relaxed.split(&mut rows, &mut rest);
            row = worst(&rows);
            if rows[row].abs() <= slack * speed && relaxed.beyond(&rest, speed).is_none() {
                continue;
            }
            return Err(self.open_at(argument, row, rows[row].abs(), unit, &remedy));
        }
        Ok(())
    }

    /// Checks that the initial state of a plan, whose dynamics accept all others, meets the connections.
    #[cfg(feature = "control")]
    pub(crate) fn check_start(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        self.check_on_connections(q, qd, IN_CALLS)
    }

    /// Checks that the state of a call meets the connections.
    pub(crate) fn check_closed(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        self.check_on_connections(q, qd, IN_CALLS + self.constraints().allowance)
    }

    /// The same with the rows at the state.
    pub(crate) fn check_closed_rows(&self, rows: &ConnectionRows<f64>, state: (&[f64], &[f64])) -> Result<(), Error> {
        self.check_rows(rows, state, IN_CALLS + self.constraints().allowance)
    }

    /// The error message for a state that violates the connections, with the argument, the row, the error and its unit.
    pub(crate) fn open_at(&self, argument: &str, row: usize, left: f64, unit: &str, remedy: &str) -> Error {
        ConstraintViolation {
            connections: self.connections_of(&[row]),
            found: format!("an error of {left:.1e} {unit} at {argument}"),
            expected: remedy.to_owned(),
            residual: left,
        }
        .into()
    }
}
