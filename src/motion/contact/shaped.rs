//! Steps of a scene whose shapes touch: the contacts that a step can reach are those of the step.

use super::super::scratch::Scratch;
use super::super::step_settings::StepSettings;
use super::super::touches::ShapeContact;
use super::report;
use super::shapes::Shapes;
use super::step::ContactStep;
use crate::error::Error;
use crate::scene::Scene;
use nalgebra::Vector3;

/// Largest number of repeats of a step whose shapes move farther than its search assumed.
const MOST_REPEATS: usize = 3;

/// The shapes of a scene, and the scene with the contacts of a step.
pub(super) struct Shaped {
    pub shapes: Box<Shapes>,
    pub scene: Scene,
    /// Number of the contacts that the scene names.
    pub named: usize,
    /// The stored values of all contacts of the step.
    kept: Vec<f64>,
}

impl Shaped {
    pub fn new(scene: &Scene) -> Option<Self> {
        let (shapes, scene) = (Box::new(Shapes::new(scene)?), scene.clone());
        Some(Self { shapes, named: scene.contact_points.len(), scene, kept: Vec::new() })
    }

    /// One step with the contacts that it can reach.
    pub fn step(
        &mut self,
        touching: &mut ContactStep,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        kept: &mut [f64],
    ) -> Result<(), (String, Error)> {
        self.shapes.find(&self.scene, settings.step, (&s.q, &s.v));
        let (start, totals) = (kept.to_vec(), s.totals);
        for repeats in (0..MOST_REPEATS).rev() {
            self.shapes.put(self.named, &mut self.scene.contact_points);
            report::widen(kept, self.named, self.scene.contact_points.len(), &mut self.kept);
            touching.rows.resize(&self.scene.contact_points);
            touching.step(&self.scene, settings, s, &mut self.kept)?;
            report::narrow(&self.kept, self.scene.contact_points.len(), self.named, kept);
            // Forces can make the step longer than its search was.
            if repeats == 0 || !self.shapes.exceeds(&self.scene, settings.step, &s.v_next) {
                break;
            }
            self.shapes.search_again(&self.scene, settings.step, &s.v);
            kept.copy_from_slice(&start);
            s.totals = totals;
        }
        Ok(())
    }

    /// The forces of shapes that touched in the last step, of length h.
    pub fn forces(&self, q: &[f64], h: f64) -> impl Iterator<Item = ShapeContact> + '_ {
        let (points, model) = (&self.scene.contact_points, self.scene.model());
        let q = q.to_vec();
        let each = self.shapes.pairs.iter().zip(self.named..);
        each.filter_map(move |(pair, i)| {
            let point = &points[i];
            let of = |from: usize| {
                let p = Vector3::from_column_slice(&self.kept[from + 3 * i..][..3]);
                point.axes.tr_mul(&p) * if pair.on_second { -1.0 } else { 1.0 }
            };
            let (held, struck) = (of(0) / h, of(3 * points.len()));
            if held == Vector3::zeros() && struck == Vector3::zeros() {
                return None;
            }
            let touch = point.touch_at(model, &q);
            let normal = touch.axes.row(2).transpose() * if pair.on_second { -1.0 } else { 1.0 };
            let (colliders, gap) = (pair.colliders, touch.gap);
            Some(ShapeContact {
                state: 0,
                step: 0,
                colliders,
                point: touch.at,
                normal,
                gap,
                force: held,
                impulse: struck,
            })
        })
    }
}
