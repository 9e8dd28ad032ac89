//! Distances of colliders at one state.

use crate::collision::distance;
use crate::error::{Error, check_length};
use crate::kinematics::{Frame, local_jacobian, placements_base_to_tip, placements_on_base};
use crate::scene::Scene;
use crate::scene::collider_pairs::{Colliders, Placed};
use crate::spatial::{RigidShift, angular, linear};
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// The distance of two colliders, and their nearest points in the base frame.
///
/// The nearest points of colliders that overlap are those of the least translation that separates them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ColliderDistance {
    /// Distance, m; negative for penetration, infinite beyond the limit.
    pub distance: f64,
    /// Nearest point of the first collider, m; NaN beyond the limit.
    pub first: Vector3<f64>,
    /// Nearest point of the second collider, m; NaN beyond the limit.
    pub second: Vector3<f64>,
    /// Unit normal from the first collider to the second; NaN beyond the limit. It is that of the surfaces if the
    /// colliders touch or overlap: second - first = distance * normal.
    pub normal: Vector3<f64>,
}

impl Default for ColliderDistance {
    /// A pair beyond the limit.
    fn default() -> Self {
        let nowhere = Vector3::repeat(f64::NAN);
        Self { distance: f64::INFINITY, first: nowhere, second: nowhere, normal: nowhere }
    }
}

impl Scene {
    /// The pairs of colliders that can touch, as indices into [`Scene::colliders`], the lower one first.
    #[must_use]
    pub fn collider_pairs(&self) -> Vec<[usize; 2]> {
        let Some(of) = self.tree().shapes() else { return Vec::new() };
        let n = of.all.len();
        let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j]));
        pairs.filter(|&[i, j]| of.can_touch(i, j)).collect()
    }

    /// Signed distances of pairs of colliders at `q` (nq), written to `out` (pairs). The pairs are indices into
    /// [`Scene::colliders`], of any two of them: also of those that cannot touch.
    ///
    /// A pair beyond `limit` (m, or infinite) has the [default](ColliderDistance::default) result, and costs little.
    /// O(N), and one search for nearest points per pair.
    ///
    /// ```
    /// use phipsi::scene::{Collider, JointDescription, JointKind, LinkDescription, SceneBuilder, Solid};
    /// # fn main() -> Result<(), phipsi::Error> {
    /// # #[cfg(feature = "collision")] {
    /// let ball = |name: &str| Collider::new(name, Solid::Sphere { radius: 0.1 });
    /// let scene = SceneBuilder::new()
    ///     .link(LinkDescription { name: "rail".into(), inertial: None })
    ///     .link(LinkDescription { name: "slide".into(), inertial: None })
    ///     .joint(JointDescription::new("x", JointKind::Prismatic, "rail", "slide"))
    ///     .collider(ball("fixed"))
    ///     .collider(ball("moving").with_link("slide".to_owned()))
    ///     .build()?;
    /// let pairs = scene.collider_pairs();
    /// let (mut workspace, mut found) = (scene.workspace(), vec![Default::default(); pairs.len()]);
    /// scene.collider_distances(&mut workspace, &[0.5], &pairs, f64::INFINITY, &mut found)?;
    /// assert!((found[0].distance - 0.3).abs() < 1e-15);
    /// let mut gradient = [f64::NAN];
    /// scene.collider_distance_gradients(&[0.5], &pairs, &found, &mut gradient)?;
    /// assert!((gradient[0] - 1.0).abs() < 1e-15);
    /// # }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for indices that do not exist, a collider with itself, two colliders that are half spaces or
    /// height fields, a limit that is NaN, or a workspace of another scene; [`Error::Shape`] and [`Error::NotFinite`].
    pub fn collider_distances(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        pairs: &[[usize; 2]],
        limit: f64,
        out: &mut [ColliderDistance],
    ) -> Result<(), Error> {
        let q = &*self.tree_configuration("q", q)?;
        self.check_workspace(workspace)?;
        check_length("out", out.len(), pairs.len())?;
        self.check_distances(pairs, limit)?;
        let Some(colliders) = self.tree().placed_colliders() else { return Ok(()) };
        let bodies = &mut workspace.store.shifts;
        self.place_bodies(q, bodies);
        for (out, &pair) in out.iter_mut().zip(pairs) {
            *out = self.distance_of_pair(colliders, bodies, pair, limit)?;
        }
        Ok(())
    }

    /// Derivatives of distances in the tangent space of `q` (nq), written to `out` (pairs x nv), row-major: n . (J2 -
    /// J1) for the Jacobians of the nearest points. Zero for a pair beyond the limit.
    ///
    /// They are exact where the distance is differentiable: it is not where the nearest points of shapes that overlap
    /// change to another face. O(nv) per pair.
    ///
    /// # Errors
    ///
    /// As [`Scene::collider_distances`].
    pub fn collider_distance_gradients(
        &self,
        q: &[f64],
        pairs: &[[usize; 2]],
        distances: &[ColliderDistance],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let q = &*self.tree_configuration("q", q)?;
        check_length("distances", distances.len(), pairs.len())?;
        check_length("out", out.len(), pairs.len() * self.nv())?;
        pairs.iter().try_for_each(|&pair| self.check_collider_pair("pairs", pair))?;
        let mut columns = Vec::new();
        for ((out, &pair), found) in out.chunks_exact_mut(self.nv().max(1)).zip(pairs).zip(distances) {
            self.distance_gradient(q, pair, found, &mut columns, out);
        }
        self.check_result("gradients of distances", out)
    }

    /// Checks the pairs and the limit.
    pub(crate) fn check_distances(&self, pairs: &[[usize; 2]], limit: f64) -> Result<(), Error> {
        if limit.is_nan() {
            return Err(Error::argument("limit", "NaN", "a distance, m, or infinity"));
        }
        pairs.iter().try_for_each(|&pair| self.check_collider_pair("pairs", pair))
    }

    /// Checks that two colliders exist and have a distance.
    pub(crate) fn check_collider_pair(&self, argument: &str, pair: [usize; 2]) -> Result<(), Error> {
        let colliders = self.colliders();
        let [Some(first), Some(second)] = pair.map(|at| colliders.get(at)) else {
            let expected = format!("indices below the number of colliders, {}", colliders.len());
            return Err(Error::argument(argument, format!("the pair {pair:?}"), expected));
        };
        if pair[0] == pair[1] {
            let found = format!("collider {:?} twice in a pair", first.name);
            return Err(Error::argument(argument, found, "two different colliders"));
        }
        if first.solid.is_ground() && second.solid.is_ground() {
            let kinds = [first, second].map(|of| of.solid.name());
            let found = format!("{:?} and {:?}, a {} and a {}", first.name, second.name, kinds[0], kinds[1]);
            return Err(Error::argument(argument, found, "pairs with at most one half space or height field"));
        }
        Ok(())
    }

    /// Poses of all bodies in the base frame, for a configuration of the tree.
    pub(crate) fn place_bodies(&self, q: &[f64], bodies: &mut [RigidShift<f64>]) {
        placements_base_to_tip(self.model(), q, bodies);
        placements_on_base(self.model(), 0..bodies.len(), bodies);
    }

    /// The distance of a pair that was checked, for the poses of the bodies.
    pub(crate) fn distance_of_pair(
        &self,
        colliders: &Colliders,
        bodies: &[RigidShift<f64>],
        pair: [usize; 2],
        limit: f64,
    ) -> Result<ColliderDistance, Error> {
        let [a, b] = pair.map(|at| &colliders.all[at]);
        let place = |of: &Placed| of.body.map_or(of.frame, |k| bodies[k].compose(&of.frame));
        let (place_a, place_b) = (place(a), place(b));
        // The boxes about the shapes are farther apart than the limit.
        let (box_a, box_b) = (a.geometry.bounds(&place_a), b.geometry.bounds(&place_b));
        if ((box_a.0 - box_b.0).abs() - box_a.1 - box_b.1).max() > limit {
            return Ok(ColliderDistance::default());
        }
        let relative = place_a.inverse().compose(&place_b);
        let Some(found) = distance(&a.geometry, &b.geometry, &relative, limit) else {
            // Every pair is within an infinite limit.
            let lost = if limit == f64::INFINITY { f64::NAN } else { 0.0 };
            return self
                .check_result(&format!("distance of {:?} and {:?}", a.name, b.name), &[lost])
                .map(|()| ColliderDistance::default());
        };
        let on_base = |x: &Vector3<f64>| place_a.rotate(x) + place_a.lever;
        Ok(ColliderDistance {
            distance: found.distance,
            first: on_base(&found.on_a),
            second: on_base(&found.on_b),
            normal: place_a.rotate(&found.normal),
        })
    }

    /// Writes the derivative of a distance in the tangent space of the scene to `out` (nv), for a configuration of the
    /// tree. `columns` is scratch memory.
    pub(crate) fn distance_gradient(
        &self,
        q: &[f64],
        pair: [usize; 2],
        found: &ColliderDistance,
        columns: &mut Vec<f64>,
        out: &mut [f64],
    ) {
        out.fill(0.0);
        let Some(colliders) = self.tree().placed_colliders().filter(|_| found.distance < f64::INFINITY) else { return };
        let (model, nv) = (self.model(), self.model().nv());
        columns.resize(7 * nv, f64::NAN);
        let (six, row) = columns.split_at_mut(6 * nv);
        row.fill(0.0);
        for (at, point, sign) in [(pair[0], found.first, -1.0), (pair[1], found.second, 1.0)] {
            let Some(body) = colliders.all[at].body else { continue };
            let place = local_jacobian(model, q, &Frame { body: Some(body), placement: RigidShift::identity() }, six);
            // n . v of the point, for the velocity of the body at its origin and in its axes.
            let along = place.rotate_back(&found.normal) * sign;
            let moment = place.rotate_back(&(point - place.lever)).cross(&along);
            for (j, row) in row.iter_mut().enumerate() {
                let column = Vector6::from_fn(|i, _| six[i * nv + j]);
                *row += moment.dot(&angular(&column)) + along.dot(&linear(&column));
            }
        }
        match self.coupling() {
            Some(coupling) => coupling.reduce(row, out),
            None => out.copy_from_slice(row),
        }
    }
}
