//! Colliders: the methods of `SceneBuilder` that add them, and the methods of `Scene` that evaluate them.

use super::builder::{Added, PySceneBuilder};
use super::collider_tuple::{CollisionTuple, collision_tuple, read_shape};
use super::connection_tuple::frame_from;
use super::object::{Object, imported};
use super::output::Names;
use super::scene::PyScene;
use crate::api::ColliderDistance;
use crate::error::{Error, known_names};
use crate::memory;
use crate::scene::{Collider, ColliderPair};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Values per pair of distances: the distance, two points and the normal.
const OF_PAIR: usize = 10;

/// Approximate time per pair, ns.
const DISTANCE: usize = 1_000;

/// How a scene gets colliders.
const NO_COLLIDERS: &str = "a scene with colliders: SceneBuilder.collider, or phipsi.load(..., contacts=\"all\")";

typed_methods! {
    in PySceneBuilder;

    /// Add a shape that touches the other colliders in simulations.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the collider.
    /// shape : phipsi.shapes.Box, Sphere, Cylinder, Capsule, Mesh, Hull, HalfSpace or HeightField
    ///     The shape. A mesh stands for its convex hull.
    /// link : str, optional
    ///     Name of the link that carries it. It may be added later. None: the base.
    /// friction : float, default 1
    ///     Coefficient of Coulomb friction, not negative. Of two shapes that touch, the larger one counts.
    /// restitution : float, default 0
    ///     Coefficient of restitution, from 0 (no rebound) to 1 (elastic). Of two shapes, the larger one counts.
    /// groups : int, default 1
    ///     Groups that the shape belongs to, as bits.
    /// mask : int, default 1
    ///     Groups that it can touch, as bits: two shapes can touch if `groups` of one and `mask` of the other have a bit
    ///     in common.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An invalid shape. The message names the collider.
    #[doc = section!(Notes)]
    /// Shapes on links that cannot move against each other do not touch, nor do those of parent and child, unless the
    /// parent cannot move, or collisions_with_parents allows it. build() raises SceneError for duplicate names, unknown
    /// links, a half space or a height field on a link that moves, points without volume, and values out of range.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
    /// >>> builder.collider("ground", phipsi.shapes.HalfSpace()).build(floating_base=True).collider_names
    /// ('ball', 'ground')
    fn collider[slf: PyRefMut<'py, Self>](
        name: String, shape: &Object<'py>; link: Option<String> = None, friction: f64 = 1.0, restitution: f64 = 0.0,
        groups: u32 = 1, mask: u32 = 1
    ) -> Added<'py> {
        let (frame, solid) = read_shape(&format!("collider {name:?}"), shape)?;
        let made = Collider::new(name, solid).with_link(link).with_frame(frame_from(frame)).with_friction(friction);
        let made = made.with_restitution(restitution).with_groups(groups).with_mask(mask);
        Ok(Self::with(slf, |builder| builder.collider(made)))
    }

    /// Let two colliders touch in any case, with values of their own.
    #[doc = section!(Parameters)]
    /// first, second : str
    ///     Names of the colliders. They may be added later.
    /// friction : float, optional
    ///     Coefficient of Coulomb friction. None: the larger one of both.
    /// restitution : float, optional
    ///     Coefficient of restitution. None: the larger one of both.
    /// margin : float, default 0
    ///     Distance at which the contact begins to act, m.
    #[doc = returns!(builder)]
    #[doc = section!(Notes)]
    /// build() raises SceneError for names that do not exist, for shapes that cannot move against each other, and for
    /// values out of range.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
    /// >>> builder = builder.collider("ground", phipsi.shapes.HalfSpace()).collider_pair("ball", "ground", friction=0.3)
    fn collider_pair[slf: PyRefMut<'py, Self>](
        first: String, second: String; friction: Option<f64> = None, restitution: Option<f64> = None, margin: f64 = 0.0
    ) -> PyRefMut<'py, Self> {
        let pair = ColliderPair::new(first, second).with_friction(friction).with_restitution(restitution);
        Self::with(slf, |builder| builder.collider_pair(pair.with_margin(margin)))
    }

    /// Exclude the colliders of two links from touching each other.
    #[doc = section!(Parameters)]
    /// first, second : str or None
    ///     Names of the links; None: the base.
    #[doc = returns!(builder)]
    #[doc = section!(Notes)]
    /// collider_pair prevails. build() raises SceneError for an unknown link.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("a").link("b", mass=1.0).joint("hinge", "revolute", "a", "b")
    /// >>> builder.exclude("a", "b").build().nv
    /// 1
    fn exclude[slf: PyRefMut<'py, Self>](first: Option<String>, second: Option<String>) -> PyRefMut<'py, Self> {
        Self::with(slf, |builder| builder.exclude([first, second]))
    }

    /// Set whether the colliders of a link touch those of its parent.
    #[doc = section!(Parameters)]
    /// allowed : bool
    ///     True: they touch. By default they do not, unless the parent cannot move.
    #[doc = returns!(builder)]
    #[doc = section!(Examples)]
    /// >>> phipsi.SceneBuilder().link("a").collisions_with_parents(True).build().nv
    /// 0
    fn collisions_with_parents[slf: PyRefMut<'py, Self>](allowed: bool) -> PyRefMut<'py, Self> {
        Self::with(slf, |builder| builder.collisions_with_parents(allowed))
    }
}

getters! {
    in PyScene;

    /// Names of the colliders in the order of their creation.
    pub(super) collider_names: Names<'py> =
        |of, py| PyTuple::new(py, of.scene.colliders().iter().map(|collider| &collider.name));
}

#[pymethods]
impl PyScene {
    /// The pairs of colliders that can touch: names, friction, restitution and margin.
    fn _touching(&self) -> Vec<([&str; 2], f64, f64, f64)> {
        let Some(shapes) = self.scene.shapes() else { return Vec::new() };
        let named = |[i, j]: [usize; 2]| {
            let of = shapes.values(i, j);
            ([&*shapes.all[i].name, &*shapes.all[j].name], of.friction, of.restitution, of.margin)
        };
        self.scene.collider_pairs().into_iter().map(named).collect()
    }

    /// The colliders, their pairs and rules, as plain tuples.
    #[pyo3(name = "_collisions")]
    fn collisions_as_given(&self) -> CollisionTuple {
        collision_tuple(self.scene.source())
    }
}

typed_methods! {
    in PyScene;

    /// Signed distances of colliders, their nearest points, and the derivatives of the distances.
    #[doc = parameters!(q)]
    /// pairs : (str, str) or sequence of (str, str), optional
    ///     Names of two colliders, or of k pairs of them. None: all pairs that can touch.
    /// limit : float, optional
    ///     Largest distance of interest, m. Pairs beyond it cost little: their distance is infinite, their points and
    ///     normal are NaN, and their gradient is zero. None: no limit.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// distances : phipsi.Distances
    ///     pairs, distance, first, second, normal and gradient, in the order of the pairs. The normal is a unit vector
    ///     from the first collider to the second, in the base frame.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An unknown collider, a collider with itself, two colliders that are half spaces or height fields, or a limit
    ///     that is not a number.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// The distance of colliders that overlap is minus the length of the least translation that separates them. A pair
    /// of named colliders need not be able to touch. O(N), and one search for nearest points per pair.
    ///
    /// Distances of half spaces, spheres, capsules, boxes and hulls are exact to 1e-8 of their size or better, and so
    /// are gradients where the distance is differentiable. Pairs with a cylinder are iterated: to about 1e-7 of their size, and to about
    /// 1e-3 in the normal and the gradient.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("ball", mass=1.0, inertia=0.004 * np.eye(3))
    /// >>> builder = builder.collider("ball", phipsi.shapes.Sphere(0.1), link="ball")
    /// >>> scene = builder.collider("ground", phipsi.shapes.HalfSpace()).build(floating_base=True)
    /// >>> found = scene.distances([0, 0, 0.3, 0, 0, 0, 1])
    /// >>> found.pairs, found.distance.round(3), found.gradient.round(3)
    /// ((('ball', 'ground'),), array([0.2]), array([[0., 0., 1., 0., 0., 0.]]))
    fn distances[&self, py: Python<'py>](
        q: &Object<'py>; pairs: Option<&Object<'py>> = None, limit: Option<f64> = None, errors: &str = "raise"
    ) -> PyResult<Object<'py>> {
        let read = |pairs: &Object<'py>| imported!(py, "phipsi._arguments", "collider_pairs")?.call1(("pairs", pairs));
        let named: Option<Vec<[String; 2]>> = pairs.map(|pairs| read(pairs)?.extract()).transpose()?;
        let pairs = self.collider_pairs("pairs", named.as_deref())?;
        let limit = limit.unwrap_or(f64::INFINITY);
        self.scene.check_distances(&pairs, limit)?;
        let (k, nv) = (pairs.len(), self.scene.nv());
        memory::room("pairs", memory::bytes_of::<f64>(&[k, OF_PAIR + nv]))?;
        let cost = DISTANCE.saturating_mul(k).saturating_add(self.size().saturating_mul(20));
        let call = self.call([self.configuration("q", q)?], cost, errors)?;
        let all = call.array(py, &[k, OF_PAIR + nv], |scene, scratch, [q], out| {
            let mut found = vec![ColliderDistance::default(); k];
            let mut gradients = vec![f64::NAN; k * nv];
            scene.collider_distances(&mut scratch.workspace, q, &pairs, limit, &mut found)?;
            scene.collider_distance_gradients(q, &pairs, &found, &mut gradients)?;
            for (at, (out, found)) in out.chunks_exact_mut(OF_PAIR + nv).zip(&found).enumerate() {
                out[0] = found.distance;
                for (out, vector) in out[1..OF_PAIR].chunks_exact_mut(3).zip([found.first, found.second, found.normal])
                {
                    out.copy_from_slice(vector.as_slice());
                }
                out[OF_PAIR..].copy_from_slice(&gradients[at * nv..(at + 1) * nv]);
            }
            Ok(())
        })?;
        let name = |at: usize| self.scene.colliders()[at].name.as_str();
        let names: Vec<(&str, &str)> = pairs.iter().map(|&[i, j]| (name(i), name(j))).collect();
        imported!(py, "phipsi._results", "distances_of")?.call1((PyTuple::new(py, names)?, all))
    }
}

impl PyScene {
    /// The indices of pairs of colliders by name; `None`: all that can touch, at least one.
    pub(super) fn collider_pairs(&self, name: &str, pairs: Option<&[[String; 2]]>) -> Result<Vec<[usize; 2]>, Error> {
        let names = || self.scene.colliders().iter().map(|of| of.name.as_str());
        let index = |wanted: &String| {
            names().position(|known| known == wanted).ok_or_else(|| {
                let found = format!("{wanted:?}, which does not exist");
                let expected = format!("names of colliders: {}", known_names(wanted, names(), 8));
                Error::argument(name, found, if names().len() == 0 { NO_COLLIDERS.to_owned() } else { expected })
            })
        };
        let Some(pairs) = pairs else {
            let all = self.scene.collider_pairs();
            if all.is_empty() {
                return Err(Error::argument(name, "None in a scene without colliders that can touch", NO_COLLIDERS));
            }
            return Ok(all);
        };
        pairs.iter().map(|[first, second]| Ok([index(first)?, index(second)?])).collect()
    }
}
