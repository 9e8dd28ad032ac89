//! Warnings about linkages whose dimensions have few digits.

use super::Scene;
use super::constraint::{Constraint, Near, Tie};
use crate::error::in_language;
use crate::filter::HingeMap;
use crate::kinematics::pair::Pair;
use crate::kinematics::{placements_base_to_tip, placements_on_base};
use crate::spatial::RigidShift;
use nalgebra::Vector3;

/// An axis of a loop in base axes, with the name of its joint or connection.
struct LoopAxis {
    name: String,
    /// The body that the joint moves.
    body: Option<usize>,
    direction: Vector3<f64>,
    /// True for a prismatic joint.
    translates: bool,
}

/// Deviation of two axes of a loop from parallel or perpendicular.
struct AxisDeviation {
    angle: f64,
    /// Both axes belong to one link, so that its description contains the deviation.
    is_of_link: bool,
    text: String,
}

/// Axes within this angle of parallel are candidates for axes that are intended to be parallel.
const NEARLY: f64 = 5e-3;

/// Angles below this are rounding errors.
const ROUNDING: f64 = 1e-11;

impl Scene {
    /// Warning texts, each returned once per scene: about rows that count as dependent, as far as calls on this scene
    /// have computed them, and about axes that deviate from parallel by more than the tolerance.
    #[must_use]
    pub fn new_linkage_warnings(&self) -> Vec<String> {
        let constraints = self.constraints();
        let mut texts = Vec::new();
        if constraints.is_empty() {
            return texts;
        }
        if constraints.axes_checked.set(()).is_ok() && constraints.tolerance > 0.0 {
            texts.extend(self.near_miss());
        }
        texts.extend(self.dependent_rows());
        texts
    }

    /// Warns about adjacent axes of a loop that are nearly parallel, but not within the tolerance. A linkage that would
    /// move if they were parallel is then rigid.
    fn near_miss(&self) -> Option<String> {
        let stages = &self.model().system.stages;
        let neutral = &self.constraints().neutral;
        self.constraints().all.iter().find_map(|constraint| {
            let axes = self.axes_of_loop(constraint, neutral);
            let of_body = |k: usize| axes.iter().find(|axis| axis.body == Some(k));
            axes.iter().find_map(|axis| {
                let inner = of_body(stages[axis.body?].parent?)?;
                let angle = axis.direction.cross(&inner.direction).norm();
                let is_near = angle > self.tolerance() && angle <= NEARLY && !axis.translates && !inner.translates;
                is_near.then(|| {
                    format!(
                        "connection {:?}: the axes of {} and {} differ by {angle:.1e} rad, \
                         more than the tolerance {:.1e}, and count as not parallel, so that a planar linkage is rigid; \
                         {} treats them as parallel, and {} uses the angles as given, without this warning",
                        constraint.name,
                        inner.name,
                        axis.name,
                        self.tolerance(),
                        in_language(
                            format!("SceneBuilder::tolerance(Some({:.0e}))", 3.0 * angle),
                            format!("SceneBuilder.build(tolerance={:.0e})", 3.0 * angle)
                        ),
                        in_language("strict(true)", "strict=True"),
                    )
                })
            })
        })
    }

    /// The warning about dependent rows, once; `None` if rows are independent, or dependent to within rounding.
    fn dependent_rows(&self) -> Option<String> {
        let near = self.constraints().mobility.get()?.near.as_ref()?;
        self.constraints().is_warned.set(()).ok()?;
        let constraint = self.constraints().all.iter().find(|constraint| constraint.rows().contains(&near.row))?;
        let row = near.row - constraint.first_row;
        let about = self.axis_deviation(constraint, near).map_or_else(
            || {
                format!(
                    "lengths and angles of the loop agree to within {:.1e} (rad, or relative to the reach of the loop)",
                    near.value
                )
            },
            |deviation| deviation.text,
        );
        Some(format!(
            "connection {:?}, row {row} ({}): {about}, and the row counts as dependent on others (tolerance {:.1e}); \
             {} uses the dimensions as given",
            constraint.name,
            constraint.row_names()[row],
            self.tolerance(),
            in_language("SceneBuilder::strict(true)", "SceneBuilder.build(strict=True)"),
        ))
    }

    /// The two axes of the loop with the largest deviation from parallel or perpendicular, up to ten times the
    /// tolerance.
    fn axis_deviation(&self, constraint: &Constraint, near: &Near) -> Option<AxisDeviation> {
        let axes = self.axes_of_loop(constraint, &near.q);
        let mut largest: Option<AxisDeviation> = None;
        for (i, first) in axes.iter().enumerate() {
            for second in &axes[i + 1..] {
                let parallel = first.direction.cross(&second.direction).norm();
                let perpendicular = first.direction.dot(&second.direction).abs();
                let (angle, meant) = if parallel <= perpendicular {
                    (parallel, "differ by {} and are treated as parallel")
                } else {
                    (perpendicular, "are perpendicular to within {} and are treated as perpendicular")
                };
                // Perpendicular axes of two revolute joints are not necessarily intended to be perpendicular.
                let counts = parallel <= perpendicular || first.translates != second.translates;
                let is_small = angle > ROUNDING && angle <= 10.0 * self.tolerance();
                let parent = |axis: &LoopAxis| axis.body.and_then(|k| self.model().system.stages[k].parent);
                let is_of_link = first.body.is_some()
                    && second.body.is_some()
                    && (parent(first) == second.body || parent(second) == first.body);
                let is_larger = |known: &AxisDeviation| {
                    angle > 1.01 * known.angle || is_of_link && !known.is_of_link && angle > 0.99 * known.angle
                };
                if counts && is_small && largest.as_ref().is_none_or(is_larger) {
                    let text = meant.replace("{}", &format!("{angle:.1e} rad"));
                    let text = format!("the axes of {} and {} {text}", first.name, second.name);
                    largest = Some(AxisDeviation { angle, is_of_link, text });
                }
            }
        }
        largest
    }

    /// The axes of the joints of a loop and of the connection that closes it.
    fn axes_of_loop(&self, constraint: &Constraint, q: &[f64]) -> Vec<LoopAxis> {
        let model = self.model();
        let mut placements = vec![RigidShift::identity(); model.bodies.len()];
        placements_base_to_tip(model, q, &mut placements);
        placements_on_base(model, 0..model.bodies.len(), &mut placements);
        let mut axes = Vec::new();
        for &k in &constraint.branches {
            let (stage, Some(joint)) = (&model.system.stages[k], self.joint_of_body(k)) else { continue };
            if stage.rows.count() != 1 {
                continue;
            }
            let (axis, translates) = match stage.rows.row(0) {
                HingeMap::Axis(axis) => (axis % 3, axis >= 3),
                HingeMap::Screw(_) => (2, false),
            };
            let direction = placements[k].rotation.column(axis).into_owned();
            axes.push(LoopAxis { name: format!("joint {:?}", joint.name), body: Some(k), direction, translates });
        }
        if let Tie::Frames { pair: Pair::Axis, frames } = &constraint.tie {
            for (frame, which) in frames.iter().zip(["link", "other link"]) {
                let on = frame.body.map_or_else(RigidShift::identity, |k| placements[k]);
                let direction = on.compose(&frame.placement).rotation.column(2).into_owned();
                let name = format!("connection {:?} on its {which}", constraint.name);
                axes.push(LoopAxis { name, body: None, direction, translates: false });
            }
        }
        axes
    }
}
