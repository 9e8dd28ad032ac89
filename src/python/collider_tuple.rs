//! Colliders as plain tuples of numbers and names, for pickling, and shapes from Python.

use super::connection_tuple::{FrameTuple, frame_from, frame_tuple};
use super::errors::refuse;
use super::object::{Object, imported};
use crate::error::Error;
use crate::scene::{Collider, ColliderPair, Solid};
use pyo3::prelude::*;

/// A shape as numbers: its kind, its lengths, and the points of a hull or the heights of a field.
type SolidTuple = (String, Vec<f64>, Vec<[f64; 3]>);

/// A collider as numbers and names: name, link, frame, shape, friction, restitution, groups and mask.
pub(super) type ColliderTuple = (String, Option<String>, FrameTuple, SolidTuple, f64, f64, u32, u32);

/// The colliders, the pairs with their values, the excluded pairs of links, and whether parents touch children.
pub(super) type CollisionTuple =
    (Vec<ColliderTuple>, Vec<([String; 2], Option<f64>, Option<f64>, f64)>, Vec<[Option<String>; 2]>, bool);

fn solid_tuple(solid: &Solid) -> SolidTuple {
    let (numbers, points) = match solid {
        Solid::Sphere { radius } => (vec![*radius], Vec::new()),
        Solid::Capsule { radius, length } | Solid::Cylinder { radius, length } => (vec![*radius, *length], Vec::new()),
        Solid::Box { size } => (size.as_slice().to_vec(), Vec::new()),
        Solid::Hull { points } => (Vec::new(), points.iter().map(|&x| x.into()).collect()),
        Solid::Heights { heights, columns, size } => {
            #[allow(clippy::cast_precision_loss)] // number of columns of a grid
            let numbers = [*columns as f64, size[0], size[1]].into_iter().chain(heights.iter().copied());
            (numbers.collect(), Vec::new())
        }
        _ => (Vec::new(), Vec::new()),
    };
    (solid.name().to_owned(), numbers, points)
}

fn solid_of((kind, numbers, points): SolidTuple) -> Result<Solid, Error> {
    Ok(match (kind.as_str(), &numbers[..]) {
        ("half space", _) => Solid::HalfSpace,
        ("sphere", &[radius]) => Solid::Sphere { radius },
        ("capsule", &[radius, length]) => Solid::Capsule { radius, length },
        ("cylinder", &[radius, length]) => Solid::Cylinder { radius, length },
        ("box", &[x, y, z]) => Solid::Box { size: [x, y, z].into() },
        ("hull", _) => Solid::Hull { points: points.into_iter().map(Into::into).collect() },
        ("height field", [columns, x, y, heights @ ..]) => {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a count
            let columns = *columns as usize;
            Solid::Heights { heights: heights.into(), columns, size: [*x, *y] }
        }
        _ => return Err(Error::argument("shape", format!("{kind:?} with {} numbers", numbers.len()), "a shape")),
    })
}

/// The complete description of the colliders of a builder.
pub(super) fn collision_tuple(source: &crate::scene::SceneBuilder) -> CollisionTuple {
    let of = |of: &Collider| {
        let Collider { name, link, frame, solid, friction, restitution, groups, mask } = of;
        (name.clone(), link.clone(), frame_tuple(frame), solid_tuple(solid), *friction, *restitution, *groups, *mask)
    };
    let (pairs, excluded, with_parents) = source.collision_rules();
    let pairs = pairs.iter().map(|of| (of.colliders.clone(), of.friction, of.restitution, of.margin)).collect();
    (source.colliders().iter().map(of).collect(), pairs, excluded.to_vec(), with_parents)
}

fn collider_of(tuple: ColliderTuple) -> Result<Collider, Error> {
    let (name, link, frame, solid, friction, restitution, groups, mask) = tuple;
    let made = Collider::new(name, solid_of(solid)?).with_link(link).with_frame(frame_from(frame));
    Ok(made.with_friction(friction).with_restitution(restitution).with_groups(groups).with_mask(mask))
}

/// Adds the colliders of a tuple.
pub(super) fn with_collisions(
    mut builder: crate::scene::SceneBuilder,
    (colliders, pairs, excluded, with_parents): CollisionTuple,
) -> Result<crate::scene::SceneBuilder, Error> {
    for collider in colliders {
        builder = builder.collider(collider_of(collider)?);
    }
    for ([first, second], friction, restitution, margin) in pairs {
        let pair = ColliderPair::new(first, second).with_friction(friction).with_restitution(restitution);
        builder = builder.collider_pair(pair.with_margin(margin));
    }
    for links in excluded {
        builder = builder.exclude(links);
    }
    Ok(builder.collisions_with_parents(with_parents))
}

/// Reads a shape of phipsi.shapes: its frame and its numbers.
pub(super) fn read_shape(subject: &str, shape: &Object<'_>) -> PyResult<(FrameTuple, Solid)> {
    let read = imported!(shape.py(), "phipsi.shapes", "solid_of")?.call1((subject, shape))?;
    let (frame, solid): (FrameTuple, SolidTuple) = read.extract()?;
    Ok((frame, solid_of(solid)?))
}

/// The colliders of the shapes of a link.
pub(super) fn colliders_of_link(link: &str, shape: Option<&Object<'_>>, friction: f64) -> PyResult<Vec<Collider>> {
    let Some(shape) = shape else {
        return refuse(format!("collide of link {link:?}"), "no shape", "a shape: collide says that it touches others");
    };
    let all: Vec<Object<'_>> = imported!(shape.py(), "phipsi.shapes", "listed")?.call1((shape,))?.extract()?;
    let several = all.len() > 1;
    let named = |at: usize| if several { format!("{link}/{at}") } else { link.to_owned() };
    let made = all.iter().enumerate().map(|(at, shape)| {
        let (frame, solid) = read_shape(&format!("link {link:?}"), shape)?;
        let made = Collider::new(named(at), solid).with_link(Some(link.to_owned())).with_frame(frame_from(frame));
        Ok(made.with_friction(friction))
    });
    made.collect()
}
