//! Convex polyhedra by their faces.

use nalgebra::Vector3;

/// A polyhedron with more corners than this is searched along its edges.
const MANY: usize = 32;

/// Polyhedra with more faces are not searched face by face.
pub(super) const FEW_FACES: usize = 64;

/// A convex polyhedron.
#[derive(Debug, Clone)]
pub(crate) struct Polyhedron {
    pub corners: Vec<Vector3<f64>>,
    pub faces: Vec<Face>,
    /// The corners at the other ends of the edges of each corner, for a polyhedron with many.
    next: Vec<Vec<usize>>,
    /// Its corners that are farthest in some directions, from which a search begins.
    outer: Vec<usize>,
}

/// A face, with its corners counterclockwise seen from outside.
#[derive(Debug, Clone)]
pub(crate) struct Face {
    pub normal: Vector3<f64>,
    pub corners: Vec<usize>,
}

impl Polyhedron {
    pub fn new(corners: Vec<Vector3<f64>>, faces: Vec<Face>) -> Self {
        let mut next = Vec::new();
        if corners.len() > MANY {
            next.resize(corners.len(), Vec::new());
            for face in &faces {
                for (at, &i) in face.corners.iter().enumerate() {
                    next[i].push(face.corners[(at + 1) % face.corners.len()]);
                    next[face.corners[(at + 1) % face.corners.len()]].push(i);
                }
            }
            for list in &mut next {
                list.sort_unstable();
                list.dedup();
            }
        }
        let mut made = Self { corners, faces, next, outer: vec![0] };
        if !made.next.is_empty() {
            let axis = |k: usize| [-1.0, 0.0, 1.0][k % 3];
            let toward = (0..27).map(|k| Vector3::new(axis(k), axis(k / 3), axis(k / 9)));
            let mut outer: Vec<usize> = toward.map(|toward| made.farthest_index(&toward)).collect();
            outer.sort_unstable();
            outer.dedup();
            made.outer = outer;
        }
        made
    }

    pub fn of_box(half: &Vector3<f64>) -> Self {
        let sign = |bit: usize, i: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let corners =
            (0..8).map(|i| Vector3::new(sign(0, i) * half[0], sign(1, i) * half[1], sign(2, i) * half[2])).collect();
        let faces = [
            (-Vector3::x(), [0, 4, 6, 2]),
            (Vector3::x(), [1, 3, 7, 5]),
            (-Vector3::y(), [0, 1, 5, 4]),
            (Vector3::y(), [2, 6, 7, 3]),
            (-Vector3::z(), [0, 2, 3, 1]),
            (Vector3::z(), [4, 5, 7, 6]),
        ];
        let faces = faces.into_iter().map(|(normal, corners)| Face { normal, corners: corners.to_vec() }).collect();
        Self::new(corners, faces)
    }

    /// A triangle with both of its sides.
    pub fn of_triangle(corners: &[Vector3<f64>; 3]) -> Self {
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).normalize();
        let faces =
            [(normal, vec![0, 1, 2]), (-normal, vec![0, 2, 1])].map(|(normal, corners)| Face { normal, corners });
        Self::new(corners.to_vec(), faces.into())
    }

    /// The corner farthest in a direction.
    pub fn farthest(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.corners[self.farthest_index(direction)]
    }

    fn farthest_index(&self, direction: &Vector3<f64>) -> usize {
        // A loop, because a maximum by comparisons computes each height twice.
        let higher = |indices: &mut dyn Iterator<Item = usize>, mut best: (f64, usize)| {
            for i in indices {
                let height = self.corners[i].dot(direction);
                if height > best.0 {
                    best = (height, i);
                }
            }
            best
        };
        let nothing = (f64::NEG_INFINITY, 0);
        if self.next.is_empty() {
            return higher(&mut (0..self.corners.len()), nothing).1;
        }
        let mut best = higher(&mut self.outer.iter().copied(), nothing);
        loop {
            let next = higher(&mut self.next[best.1].iter().copied(), best);
            if next.1 == best.1 {
                return best.1;
            }
            best = next;
        }
    }

    /// The corners below a height along a normal: those that edges below it join with the lowest one.
    pub fn below(&self, normal: &Vector3<f64>, height: f64) -> Vec<Vector3<f64>> {
        let is_below = |i: usize| self.corners[i].dot(normal) <= height;
        if self.next.is_empty() {
            return (0..self.corners.len()).filter(|&i| is_below(i)).map(|i| self.corners[i]).collect();
        }
        let lowest = self.farthest_index(&-normal);
        let mut found = if is_below(lowest) { vec![lowest] } else { Vec::new() };
        let mut known = vec![false; if found.is_empty() { 0 } else { self.corners.len() }];
        known.iter_mut().skip(lowest).take(1).for_each(|known| *known = true);
        let mut at = 0;
        while at < found.len() {
            for &i in &self.next[found[at]] {
                if !known[i] && is_below(i) {
                    found.push(i);
                }
                known[i] = true;
            }
            at += 1;
        }
        found.into_iter().map(|i| self.corners[i]).collect()
    }

    /// The face whose normal is nearest to a direction.
    pub fn face_toward(&self, direction: &Vector3<f64>) -> Option<&Face> {
        self.faces.iter().max_by(|a, b| a.normal.dot(direction).total_cmp(&b.normal.dot(direction)))
    }

    /// The corners of a face.
    pub fn polygon(&self, face: &Face) -> Vec<Vector3<f64>> {
        face.corners.iter().map(|&i| self.corners[i]).collect()
    }
}
