//! Check that a state meets the connections.

use super::geometry::relaxed_at;
use super::rows::{errors_of_rows, rates_of_rows};
use crate::error::Error;
use crate::scene::Scene;

/// A state may begin so far from the connections, m or rad, and m/s or rad/s.
const AT_START: f64 = 1e-6;

/// Checks that a state meets the connections, so that a motion can begin there; no check where rows have compliance.
pub(crate) fn check_start(scene: &Scene, (q, qd): (&[f64], &[f64]), compliance: &[f64]) -> Result<(), Error> {
    let constraints = scene.constraints();
    if constraints.is_empty() || compliance.iter().any(|&compliance| compliance > 0.0) {
        return Ok(());
    }
    let (model, mut rows) = (scene.model(), vec![0.0; constraints.rows]);
    let remedy = "a start that meets the connections: q, qd = scene.project(q, qd)";
    let worst = |rows: &[f64]| (0..rows.len()).max_by(|&i, &j| rows[i].abs().total_cmp(&rows[j].abs())).unwrap_or(0);
    let speed = qd.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
    let mut relaxed = None;
    for (argument, unit, speed) in [("q", "m or rad", 1.0), ("qd", "m/s or rad/s", speed)] {
        let found = match argument {
            "q" => errors_of_rows(model, constraints, q, &mut rows),
            _ => rates_of_rows(model, constraints, (q, qd), &mut rows),
        };
        found.map_err(|at| scene.no_direction(at))?;
        let mut row = worst(&rows);
        if rows[row].abs() <= AT_START * speed {
            continue;
        }
        // Rows that count as dependent may be open by the tolerance.
        if relaxed.is_none() {
            relaxed = Some(relaxed_at(scene, q)?);
        }
        if let Some(relaxed) = &relaxed {
            let mut rest = vec![0.0; rows.len()];
            relaxed.split(&mut rows, &mut rest);
            row = worst(&rows);
            if rows[row].abs() <= AT_START * speed && relaxed.beyond(&rest, speed).is_none() {
                continue;
            }
        }
        return Err(scene.open_at(argument, row, rows[row].abs(), unit, remedy));
    }
    Ok(())
}
