//! Nearest points and penetration depths by parry3d.

use super::geometry::Geometry;
use super::hull::{from_parry, to_parry};
use super::nearest::Nearest;
use super::touching::settled;
use crate::spatial::RigidShift;
use parry3d_f64::math::{Mat3, Pose, Rot3, Vector};
use parry3d_f64::query::details::contact_support_map_support_map_with_params;
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex};
use parry3d_f64::shape::SupportMap;

impl SupportMap for Geometry {
    /// The farthest point of the shape without its rounding.
    fn local_support_point(&self, direction: Vector) -> Vector {
        to_parry(&self.farthest(&from_parry(direction)))
    }
}

/// The nearest points of two shapes without their rounding, up to a distance; `b_in_a` is the pose of b in the frame of
/// a. For shapes that overlap, the points of least penetration.
pub(super) fn nearest(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, limit: f64) -> Option<Nearest> {
    let found = match search(a, b, b_in_a, limit) {
        Search::Found(found) => Some(found),
        Search::Beyond => return None,
        Search::Failed => None,
    };
    settled((a, b), b_in_a, limit, found, |pose| match search(a, b, pose, f64::INFINITY) {
        Search::Found(found) => Some(found),
        _ => None,
    })
}

/// Result of the search by parry3d.
enum Search {
    Found(Nearest),
    /// A plane separates the shapes by more than the limit.
    Beyond,
    Failed,
}

fn search(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, limit: f64) -> Search {
    let r = &b_in_a.rotation;
    let columns = [0, 1, 2].map(|i| to_parry(&r.column(i).into_owned()));
    let turn = Rot3::from_mat3(&Mat3::from_cols(columns[0], columns[1], columns[2]));
    let pose = Pose::from_parts(to_parry(&b_in_a.lever), turn);
    let mut simplex = VoronoiSimplex::new();
    match contact_support_map_support_map_with_params(&pose, a, b, limit, &mut simplex, None) {
        GJKResult::ClosestPoints(on_a, on_b, normal) => {
            let (on_a, on_b, normal) = (from_parry(on_a), from_parry(on_b), from_parry(normal));
            let distance = (on_b - on_a).dot(&normal);
            if distance.is_finite() { Search::Found(Nearest { on_a, on_b, normal, distance }) } else { Search::Failed }
        }
        // The same result also stands for a search that did not converge.
        GJKResult::NoIntersection(normal) if -normal.dot(CsoPoint::from_shapes(&pose, a, b, normal).point) > limit => {
            Search::Beyond
        }
        _ => Search::Failed,
    }
}
