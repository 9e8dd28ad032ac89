//! Convex polygons in space: clipping, and the choice of a few points that span the same area.

use nalgebra::Vector3;

/// The largest number of points of contact of a pair.
pub(crate) const MOST: usize = 8;

/// Of more points, first the extremes along some axes are chosen.
const MANY: usize = 24;
const AXES: usize = 8;

/// Points up to this distance beyond a side belong to a polygon, relative to its size: its rim belongs to it.
const RIM: f64 = 1e-9;

/// The part of a polygon, line or point within the sides of a face with this normal.
pub(crate) fn clip(mut points: Vec<Vector3<f64>>, face: &[Vector3<f64>], normal: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let size = face.iter().fold(0.0_f64, |size, x| size.max((x - face[0]).norm()));
    for (i, a) in face.iter().enumerate() {
        let b = face[(i + 1) % face.len()];
        let outward = (b - a).cross(normal);
        let length = outward.norm();
        if !(length > 0.0) {
            continue;
        }
        let outward = outward / length;
        let beyond = |x: &Vector3<f64>| outward.dot(&(x - a)) - RIM * size;
        let count = points.len();
        let mut kept = Vec::with_capacity(count + 1);
        for (j, x) in points.iter().enumerate() {
            let out = beyond(x);
            if out <= 0.0 {
                kept.push(*x);
            }
            // A line has one side.
            if count < 2 || (count == 2 && j == 1) {
                continue;
            }
            let y = points[(j + 1) % count];
            let next = beyond(&y);
            if (out <= 0.0) != (next <= 0.0) {
                // Onto the side itself.
                let (out, next) = (out + RIM * size, next + RIM * size);
                let at = (out / (out - next)).clamp(0.0, 1.0);
                kept.push(x + (y - x) * at);
            }
        }
        points = kept;
    }
    points
}

/// The points farthest in some directions across a normal, and the lowest one.
fn extremes(points: &[Vector3<f64>], lowest: usize, normal: &Vector3<f64>) -> Vec<usize> {
    let mut axis = Vector3::zeros();
    axis[normal.iamin()] = 1.0;
    let first = normal.cross(&axis).normalize();
    let second = normal.cross(&first);
    #[allow(clippy::cast_precision_loss)] // a small count
    let axes: [(f64, f64); AXES] = std::array::from_fn(|i| (std::f64::consts::PI * i as f64 / AXES as f64).sin_cos());
    // The farthest point along each axis, and that in the opposite direction.
    let mut farthest = [[(f64::NEG_INFINITY, 0); AXES]; 2];
    for (i, x) in points.iter().enumerate() {
        let (across, along) = (x.dot(&second), x.dot(&first));
        for (k, (sin, cos)) in axes.iter().enumerate() {
            let far = along * cos + across * sin;
            for (of, far) in farthest.iter_mut().zip([far, -far]) {
                if far > of[k].0 {
                    of[k] = (far, i);
                }
            }
        }
    }
    let mut found = vec![lowest];
    for (_, i) in farthest.into_iter().flatten() {
        if !found.contains(&i) {
            found.push(i);
        }
    }
    found
}

/// At most [`MOST`] indices of points: the lowest, the one farthest from it, and those that enlarge the area most, seen
/// along a normal.
pub(crate) fn spanning(points: &[Vector3<f64>], gaps: &[f64], normal: &Vector3<f64>) -> Vec<usize> {
    if points.len() <= MOST {
        return (0..points.len()).collect();
    }
    let lowest = (0..points.len()).min_by(|&i, &j| gaps[i].total_cmp(&gaps[j])).unwrap_or_default();
    if points.len() > MANY {
        let some = extremes(points, lowest, normal);
        let picked = |i: &usize| (points[*i], gaps[*i]);
        let (few, of_few): (Vec<_>, Vec<_>) = some.iter().map(picked).unzip();
        return spanning(&few, &of_few, normal).into_iter().map(|i| some[i]).collect();
    }
    let flat = |x: &Vector3<f64>| x - normal * normal.dot(x);
    let points: Vec<_> = points.iter().map(flat).collect();
    let mut chosen = vec![lowest];
    let far = |i: usize| (points[i] - points[lowest]).norm();
    if let Some(farthest) = (0..points.len()).max_by(|&i, &j| far(i).total_cmp(&far(j))) {
        chosen.push(farthest);
    }
    while chosen.len() < MOST {
        // The polygon of the chosen points is in order; a point adds the triangle on the side that it is beyond.
        let mut best = (0.0, 0, 0);
        for (i, x) in points.iter().enumerate() {
            for side in 0..chosen.len() {
                let (a, b) = (points[chosen[side]], points[chosen[(side + 1) % chosen.len()]]);
                let area = (b - a).cross(&(x - a)).dot(normal);
                // Outside of a counterclockwise polygon; of two points, on both sides.
                let outside = if chosen.len() == 2 { area.abs() } else { -area };
                if outside > best.0 {
                    best = (outside, i, if chosen.len() == 2 && area > 0.0 { usize::MAX } else { side });
                }
            }
        }
        let (area, at, side) = best;
        if !(area > 0.0) {
            break;
        }
        if side == usize::MAX {
            chosen.push(at);
        } else if chosen.len() == 2 {
            chosen.insert(1, at);
        } else {
            chosen.insert(side + 1, at);
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::{MOST, clip, spanning};
    use nalgebra::Vector3;

    fn square(half: f64) -> Vec<Vector3<f64>> {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| Vector3::new(x * half, y * half, 0.0)).into()
    }

    fn area(points: &[Vector3<f64>]) -> f64 {
        (1..points.len() - 1).map(|i| 0.5 * (points[i] - points[0]).cross(&(points[i + 1] - points[0])).z).sum()
    }

    #[test]
    fn clipped_polygons_have_the_common_area() {
        let turned: Vec<_> =
            square(1.0).iter().map(|x| Vector3::new(x.x - x.y, x.x + x.y, 0.3) * 0.5_f64.sqrt()).collect();
        let clipped = clip(turned, &square(1.0), &Vector3::z());
        // A regular octagon with an inscribed circle of radius 1.
        let expected = 8.0 * (std::f64::consts::PI / 8.0).tan();
        assert!(clipped.len() == 8 && (area(&clipped) - expected).abs() <= 1e-12, "{clipped:?}");
        let line = clip(vec![Vector3::new(-3.0, 0.5, 0.1), Vector3::new(3.0, 0.5, 0.1)], &square(1.0), &Vector3::z());
        assert!(line.len() == 2 && (line[0].x + 1.0).abs() <= 1e-12 && (line[1].x - 1.0).abs() <= 1e-12);
        let rim = clip(square(1.0), &square(1.0), &Vector3::z());
        assert!(rim == square(1.0));
        assert!(clip(vec![Vector3::new(1.1, 0.0, 0.0)], &square(1.0), &Vector3::z()).is_empty());
    }

    #[test]
    fn a_few_points_span_the_area_of_many() {
        let circle: Vec<_> = (0..200)
            .map(|i| {
                let angle = f64::from(i) * 0.031_415_926_535;
                Vector3::new(angle.cos(), angle.sin(), 0.0)
            })
            .chain(square(0.2))
            .collect();
        let mut gaps = vec![0.0; circle.len()];
        gaps[17] = -1e-3;
        let chosen = spanning(&circle, &gaps, &Vector3::z());
        assert!(chosen.len() == MOST && chosen.contains(&17));
        let spanned: Vec<_> = chosen.iter().map(|&i| circle[i]).collect();
        assert!(area(&spanned).abs() >= 0.85 * std::f64::consts::PI, "{}", area(&spanned));
    }
}
