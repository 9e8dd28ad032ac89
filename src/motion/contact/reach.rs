//! The test whether contacts can act during a step that was made without them.
//!
//! A contact acts in a step if its gap closes at some time between the start and the end. The test uses both ends: with
//! the gaps g0 and g1, and bounds a and b of the speeds at which the gap decreases after the start and increases before
//! the end, the gap is at least g0 - a t and at least g1 - b (h - t). It stays positive if
//!
//! ```text
//! g0 / a + g1 / b > h
//! ```
//!
//! For a body that approaches without turning back, b = 0, and the test is g1 > 0: the last step before the contact is
//! found exactly. A test with the state at the start alone (gap > h |rate| + h^2 bound) needs a bound of accelerations
//! and would exclude more steps. Testing only the gaps at the end, or at the stages of the method, would miss the tip
//! of a link that rotates through a surface and returns within the step.
//!
//! The bounds follow from those of the joints, base to tip: a joint moves at most at the largest of its velocities at
//! both ends and its mean velocity (displacement / h) plus their largest difference. For each body, with parent p, the
//! distance l of their origins, w and u the bounds of the angular and the linear velocity of the joint, and dw and du
//! those of their changes:
//!
//! ```text
//! W = W_p + w     V = V_p + W_p l + u                           angular velocity, velocity of the origin
//! D = D_p + dw + h W w                                          change of the angular velocity in the step
//! E = E_p + D_p l + h W_p (W_p l + u) + du + h W u              change of the velocity of the origin
//! X = X_p + min(h W_p, 2) l + h u                               displacement of the origin
//! ```
//!
//! A surface beyond the displacement of a point is out of its reach at any speed.
//!
//! A point at the distance r from the origin moves at most at V + W r, and its velocity changes by at most E + D r + h
//! W^2 r. a is the smaller of this speed and of the velocity at the start plus the change, and so is b. Surfaces are
//! planes, spheres and boxes; the distance from them is a convex function of the position outside of them, so that it
//! is at least that from the tangent plane at either end. Divided steps are tested substep by substep.
//!
//! The velocity of a joint within a step is known at its ends only; twice the largest difference of the three
//! velocities bounds its change for motion that the step resolves.

use super::gap::{ROUNDING, touching_gap};
use super::shapes::{Range, Shapes};
use crate::dynamics::contacts::ContactScratch;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::{angular, linear};
use nalgebra::Vector6;

/// Contacts of one state.
struct Placed {
    rows: ContactScratch,
    q: Vec<f64>,
    v: Vec<f64>,
    /// Rates of the gaps, m/s.
    rates: Vec<f64>,
}

impl Placed {
    fn new(model: &Model<f64>, points: &[ContactPoint]) -> Self {
        Self {
            rows: ContactScratch::new(model, points, Vec::new()),
            q: vec![f64::NAN; model.nq],
            v: vec![f64::NAN; model.nv()],
            rates: vec![f64::NAN; points.len()],
        }
    }

    fn set(&mut self, model: &Model<f64>, points: &[ContactPoint], (q, v): (&[f64], &[f64])) {
        if self.q == q && self.v == v {
            return;
        }
        self.q.copy_from_slice(q);
        self.v.copy_from_slice(v);
        self.rows.place(model, points, q);
        self.rows.rates(model, points, v, &mut self.rates);
    }
}

/// A lever rotates its end by at most this number of its lengths.
const CHORD: f64 = 2.0;

/// Bounds of the motion of a body in a step, or of a point: W, V, D, E and X.
#[derive(Debug, Clone, Copy, Default)]
struct Bounds {
    turning: f64,
    moving: f64,
    turning_change: f64,
    moving_change: f64,
    displacement: f64,
}

impl Bounds {
    /// The bounds of a point at a distance from the origin of the body.
    fn of_point(&self, distance: f64, h: f64) -> Self {
        let turned = self.turning_change + h * self.turning * self.turning;
        Self {
            moving: self.moving + self.turning * distance,
            moving_change: self.moving_change + turned * distance,
            displacement: self.displacement + (h * self.turning).min(CHORD) * distance,
            ..*self
        }
    }
}

/// Scratch memory for one state: its contacts at the start and at the end of a step.
pub(super) struct Reach {
    start: Placed,
    end: Placed,
    bounds: Vec<Bounds>,
    pub shapes: Option<Box<Shapes>>,
}

impl Reach {
    pub fn new(scene: &Scene) -> Self {
        let (model, points) = (scene.model(), scene.contact_points());
        let placed = || Placed::new(model, points);
        Self {
            start: placed(),
            end: placed(),
            bounds: vec![Bounds::default(); model.bodies.len()],
            shapes: Shapes::new(scene).map(Box::new),
        }
    }

    /// True if a contact touches at this state, for steps of `h`. `last` is a contact that acted in the step before,
    /// which is tested first.
    pub fn touches(&mut self, scene: &Scene, h: f64, (q, v): (&[f64], &[f64]), last: Option<usize>) -> bool {
        let (model, points) = (scene.model(), scene.contact_points());
        let least = touching_gap(model, h);
        // Two spheres whose centers coincide have the gap NaN.
        let is_near = |gap: f64| !(gap > least);
        if last.and_then(|i| points.get(i)).is_some_and(|point| is_near(point.touch_at(model, q).gap)) {
            return true;
        }
        self.start.set(model, points, (q, v));
        if self.start.rows.gaps.iter().any(|&gap| is_near(gap)) {
            return true;
        }
        let Some(shapes) = &mut self.shapes else { return false };
        shapes.find(scene, h, (q, v));
        is_near(shapes.least)
    }

    /// True if a contact touches at this state and does not leave its surface faster than `speed`.
    pub fn rests(&mut self, scene: &Scene, speed: f64, state: (&[f64], &[f64])) -> bool {
        self.start.set(scene.model(), scene.contact_points(), state);
        self.start.rows.gaps.iter().zip(&self.start.rates).any(|(&gap, &rate)| !(gap > ROUNDING) && !(rate > speed))
    }

    /// The rates of the gaps at the state of [`Reach::rests`], m/s.
    pub fn rates(&self) -> &[f64] {
        &self.start.rates
    }

    /// True if no contact can act in a step of `h`, or in a substep, from the state of [`Reach::touches`] to this one,
    /// which is then the start of the next one.
    pub fn passes(&mut self, scene: &Scene, h: f64, end: (&[f64], &[f64])) -> bool {
        self.end.set(scene.model(), scene.contact_points(), end);
        let passes = self.stays_open(scene, h);
        if passes {
            std::mem::swap(&mut self.start, &mut self.end);
        }
        passes
    }

    /// True if the contacts are out of reach at the velocities of the start.
    pub fn is_far(&mut self, scene: &Scene, h: f64, (q, v): (&[f64], &[f64])) -> bool {
        self.start.set(scene.model(), scene.contact_points(), (q, v));
        self.end.set(scene.model(), scene.contact_points(), (q, v));
        self.stays_open(scene, h)
    }

    fn stays_open(&mut self, scene: &Scene, h: f64) -> bool {
        self.bound(scene.model(), h);
        if let Some(shapes) = &mut self.shapes {
            let bounds = &self.bounds;
            let range = |body: usize, radius: f64| {
                let of: Bounds = bounds[body].of_point(radius, h);
                Range { displacement: of.displacement, change: of.moving_change }
            };
            shapes.find_within(scene, h, (&self.start.q, &self.start.v), range);
            if !shapes.points.is_empty() {
                return false;
            }
        }
        let each = scene.contact_points().iter().enumerate();
        each.into_iter().all(|(i, point)| {
            let Self { start, end, bounds, .. } = &*self;
            let radius = point.center.norm();
            let own = bounds[point.body].of_point(radius, h);
            let (mut speed, mut change, mut moved) = (own.moving, own.moving_change, own.displacement);
            if let Some(k) = point.other_body() {
                let body = bounds[k];
                let apart = |at: &Placed| (at.rows.places[point.body].lever - at.rows.places[k].lever).norm();
                let distance = apart(start).max(apart(end)) + radius + moved + body.displacement;
                let other = body.of_point(distance, h);
                // In the axes of the other body, which rotate.
                change += other.moving_change + 2.0 * h * body.turning * (speed + body.moving);
                speed += other.moving;
                moved += other.displacement;
            }
            let [before, after] = [start, end].map(|at| (at.rows.gaps[i], at.rates[i]));
            let closing = (change - before.1).max(0.0).min(speed);
            let opening = (change + after.1).max(0.0).min(speed);
            // Without motion, a positive gap divided by zero is infinite.
            let is_open = before.0.max(after.0) > moved || before.0 / closing + after.0 / opening > h;
            is_open && before.0 > 0.0 && after.0 > 0.0 && (speed + change + before.1 + after.1).is_finite()
        })
    }

    /// The bounds of all bodies in a step of `h`.
    fn bound(&mut self, model: &Model<f64>, h: f64) {
        let Self { start, end, bounds, .. } = self;
        for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
            let (row, count, coordinates) = (stage.first_row, stage.rows.count(), body.q..body.q + body.motion.nq());
            let mut mean = [0.0; 6];
            body.motion.displacement(&start.q[coordinates.clone()], &end.q[coordinates], &mut mean[..count]);
            for x in &mut mean {
                *x /= h;
            }
            let velocity = |u: &[f64]| body.motion.velocity(u, 0.0);
            let of =
                [velocity(&start.v[row..row + count]), velocity(&end.v[row..row + count]), velocity(&mean[..count])];
            let (turning, turning_change) = range(of.map(|u: Vector6<f64>| angular(&u).into()));
            let (sliding, sliding_change) = range(of.map(|u: Vector6<f64>| linear(&u).into()));
            let parent = stage.parent.map_or_else(Bounds::default, |parent| bounds[parent]);
            let [before, after] = [&*start, &*end].map(|at| at.rows.shift[k].lever.norm());
            let distance = before.max(after) + h * sliding;
            let carried = parent.turning * distance;
            let whole = parent.turning + turning;
            let displacement = parent.displacement + (h * parent.turning).min(CHORD) * distance + h * sliding;
            bounds[k] = Bounds {
                turning: whole,
                moving: parent.moving + carried + sliding,
                turning_change: parent.turning_change + turning_change + h * whole * turning,
                moving_change: parent.moving_change
                    + parent.turning_change * distance
                    + h * parent.turning * (carried + sliding)
                    + sliding_change
                    + h * whole * sliding,
                displacement,
            };
        }
    }
}

/// Bounds of the norm of a velocity, and of its change, from its values at both ends of a step and its mean.
fn range([start, end, mean]: [[f64; 3]; 3]) -> (f64, f64) {
    let norm = |x: [f64; 3]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    let apart = |x: [f64; 3], y: [f64; 3]| norm([x[0] - y[0], x[1] - y[1], x[2] - y[2]]);
    let difference = apart(start, end).max(apart(start, mean)).max(apart(end, mean));
    (norm(start).max(norm(end)).max(norm(mean)) + difference, 2.0 * difference)
}
