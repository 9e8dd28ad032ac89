//! Convex hulls by parry3d.

use super::polyhedron::{Face, Polyhedron};
use nalgebra::Vector3;
use parry3d_f64::math::Vector;
use parry3d_f64::shape::ConvexPolyhedron;
use parry3d_f64::transformation::try_convex_hull;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

pub(super) fn to_parry(x: &Vector3<f64>) -> Vector {
    Vector::new(x[0], x[1], x[2])
}

pub(super) fn from_parry(x: Vector) -> Vector3<f64> {
    Vector3::new(x.x, x.y, x.z)
}

/// Largest number of points of the hulls that are stored.
const STORED: usize = 1 << 18;

/// Points and their hull.
type Known = (Arc<[Vector3<f64>]>, Arc<Polyhedron>);

/// The last hulls and their points: readers of files check each shape before they build a scene.
static LAST: Mutex<VecDeque<Known>> = Mutex::new(VecDeque::new());

/// The convex hull of points, which is computed once for equal points.
pub(super) fn hull(points: &Arc<[Vector3<f64>]>) -> Result<Arc<Polyhedron>, (String, &'static str)> {
    let last = || LAST.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, known)) = last().iter().find(|(of, _)| of == points) {
        return Ok(Arc::clone(known));
    }
    let made = Arc::new(computed(points)?);
    let mut stored = last();
    stored.push_back((Arc::clone(points), Arc::clone(&made)));
    while stored.iter().map(|(of, _)| of.len()).sum::<usize>() > STORED {
        stored.pop_front();
    }
    Ok(made)
}

fn computed(points: &[Vector3<f64>]) -> Result<Polyhedron, (String, &'static str)> {
    let expected = "at least four points that are not in one plane";
    let flat = || ("whose points have no volume".to_owned(), expected);
    let first = points.first().ok_or_else(flat)?;
    let size = points.iter().fold(0.0_f64, |size, x| size.max((x - first).amax()));
    if !(size > 0.0) {
        return Err(flat());
    }
    // At a scale of one: tolerances of parry3d are absolute.
    let scaled: Vec<Vector> = points.iter().map(|x| to_parry(&((x - first) / size))).collect();
    let (corners, triangles) = try_convex_hull(&scaled).map_err(|_| flat())?;
    let made = ConvexPolyhedron::from_convex_mesh(corners, &triangles).ok_or_else(flat)?;
    let corners: Vec<Vector3<f64>> = made.points().iter().map(|&x| from_parry(x) * size + first).collect();
    let faces = made.faces().iter().map(|face| {
        let range =
            face.first_vertex_or_edge as usize..(face.first_vertex_or_edge + face.num_vertices_or_edges) as usize;
        let corners = made.vertices_adj_to_face()[range].iter().map(|&i| i as usize).collect();
        Face { normal: from_parry(face.normal).normalize(), corners }
    });
    let faces: Vec<Face> = faces.filter(|face| face.normal.iter().all(|x| x.is_finite())).collect();
    if faces.len() < 4 { Err(flat()) } else { Ok(Polyhedron::new(corners, faces)) }
}
