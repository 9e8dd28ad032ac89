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
    fn step(
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

    /// The forces of shapes that touched in the last step, of length h, which ended at `q`.
    pub fn forces<'a>(
        &'a self,
        (q, h): (&'a [f64], f64),
        (state, step): (usize, usize),
    ) -> impl Iterator<Item = ShapeContact> + 'a {
        let (points, model) = (&self.scene.contact_points, self.scene.model());
        self.shapes.pairs.iter().zip(self.named..).filter_map(move |(pair, i)| {
            let (point, colliders) = (&points[i], pair.colliders);
            let sign = if pair.on_second { -1.0 } else { 1.0 };
            let of =
                |from: usize| point.axes.tr_mul(&Vector3::from_column_slice(&self.kept[from + 3 * i..][..3])) * sign;
            let (force, impulse) = (of(0) / h, of(3 * points.len()));
            if force == Vector3::zeros() && impulse == Vector3::zeros() {
                return None;
            }
            let touch = point.touch_at(model, q);
            let (normal, gap) = (touch.normal() * sign, touch.gap);
            Some(ShapeContact { state, step, colliders, point: touch.at, normal, gap, force, impulse })
        })
    }
}

/// One step, with the contacts of shapes that it can reach. Returns the joint and the error if it fails.
pub(super) fn step(
    shaped: Option<&mut Shaped>,
    touching: &mut ContactStep,
    (scene, settings): (&Scene, &StepSettings),
    s: &mut Scratch<f64>,
    kept: &mut [f64],
) -> Result<(), (String, Error)> {
    match shaped {
        Some(shaped) => shaped.step(touching, settings, s, kept),
        None => touching.step(scene, settings, s, kept),
    }
}
