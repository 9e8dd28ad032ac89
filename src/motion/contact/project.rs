//! Projection of positions out of the surfaces of contacts.

use super::super::manifold::advance;
use super::closed::positions_onto_connections;
use super::faults::factorised;
use super::moves::{Move, Push};
use crate::contact::{Cones, Effort, Gram, Limits};
use crate::decompositions::eigenvalues;
use crate::dynamics::contacts::ContactScratch;
use crate::error::Error;
use crate::model::Model;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector};

/// Penetrations up to this depth are ignored, m.
pub(super) const TOUCHES: f64 = 1e-10;

/// Largest number of Newton steps.
const STEPS: usize = 5;

/// Effort of one solve; further Newton steps correct its residual.
const ROUGH: Effort = Effort { tolerance: 1e-6, attempts: usize::MAX, iterations: usize::MAX };

/// Effort for shapes, which can be in places where no displacement separates them, such as a peg in a narrower hole.
const BOUNDED: Effort = Effort { attempts: 1, ..ROUGH };

/// Largest residual of a displacement of such shapes, and its largest size relative to the penetration.
const MEETS: f64 = 1e-3;
const FARTHEST: f64 = 20.0;

/// The factor by which a Newton step for such shapes has to reduce the penetration.
const LESS: f64 = 0.9;

/// Displaces `q` with the least kinetic energy until the contacts `touching` have no gap, in a few Newton steps, each
/// followed by a projection onto the connections.
pub(super) fn onto_surfaces(
    (scene, model): (&Scene, &Model<f64>),
    workspace: &mut Workspace<f64>,
    rows: &mut ContactScratch,
    (q, next): (&mut [f64], &mut [f64]),
    touching: &[usize],
) -> Result<(), (String, Error)> {
    /// Gaps of rounding, m. The velocity with which a short step closes a gap is an error.
    const CLOSED: f64 = 1e-14;
    for _ in 0..STEPS {
        positions_onto_connections(scene, (model, workspace), rows, q, None)?;
        rows.place(model, scene.contact_points(), q);
        if !touching.iter().any(|&i| rows.gaps[i].abs() > CLOSED) {
            break;
        }
        let gaps = rows.gaps.clone();
        cancel((scene, model), workspace, rows, (q, touching), |i| gaps[i])?;
        advance(model, q, &rows.response, next);
        q.copy_from_slice(next);
    }
    Ok(())
}

/// Changes `v` with the least kinetic energy until the contacts `touching` do not approach their surfaces, nor leave
/// them unless some rebound.
pub(super) fn along_surfaces(
    (scene, model): (&Scene, &Model<f64>),
    workspace: &mut Workspace<f64>,
    rows: &mut ContactScratch,
    (q, v): (&[f64], &mut [f64]),
    (touching, rebounds): (&[usize], bool),
) -> Result<(), (String, Error)> {
    rows.place(model, scene.contact_points(), q);
    let u = rows.velocities(model, scene.contact_points(), v);
    let near: Vec<usize> = touching.iter().copied().filter(|i| !rebounds || u[3 * i + 2] < 0.0).collect();
    if !near.is_empty() {
        cancel((scene, model), workspace, rows, (q, &near), |i| u[3 * i + 2])?;
        v.iter_mut().zip(&rows.response).for_each(|(v, change)| *v += change);
    }
    Ok(())
}

/// The response to normal impulses of the contacts `which`, placed at `q`, that reduces their normal velocities by c;
/// impulses of dependent contacts are those of least norm.
fn cancel(
    (scene, model): (&Scene, &Model<f64>),
    workspace: &mut Workspace<f64>,
    rows: &mut ContactScratch,
    (q, which): (&[f64], &[usize]),
    c: impl Fn(usize) -> f64,
) -> Result<(), (String, Error)> {
    /// Smallest eigenvalue of G of independent contacts, relative to the largest.
    const DEPENDENT: f64 = 1e-10;
    let (points, mut near) = (scene.contact_points(), which.to_vec());
    factorised(scene, (model, q), workspace)?;
    if let Some(closed) = &mut rows.closed {
        closed.factorize(model, workspace, q).map_err(|at| (String::new(), scene.row_fault(at)))?;
    }
    let blocks = rows.gram(model, points, workspace, &mut near);
    let whole = Cones::new(blocks, &vec![0.0; near.len()]).whole();
    let g = whole.g.dense();
    let normal = DMatrix::from_fn(near.len(), near.len(), |i, j| g[(3 * i + 2, 3 * j + 2)]);
    let Some(normal) = eigenvalues(normal) else {
        rows.response.fill(0.0);
        return Ok(());
    };
    let mut along = normal.eigenvectors.tr_mul(&DVector::from_fn(near.len(), |at, _| c(near[at])));
    let least = DEPENDENT * normal.eigenvalues.amax();
    along.zip_apply(&normal.eigenvalues, |x, value| *x = if value > least { -*x / value } else { 0.0 });
    let push = normal.eigenvectors * along;
    let push = DVector::from_fn(3 * near.len(), |i, _| if i % 3 == 2 { push[i / 3] } else { 0.0 });
    rows.respond(model, workspace, &push);
    Ok(())
}

/// Displaces `q` with the least kinetic energy until no contact is below its surface: min d M d/2 subject to gap +
/// `J_n` d >= 0, and `J_k` d = 0 for connections, in a few Newton steps, each followed by a projection onto the
/// connections. No joint moves beyond its limit, or further beyond it. Velocities are unchanged. Returns the initial
/// penetration, m, and the number of iterations; records the Newton steps in `moves`. Contacts that the step passes are
/// left where they are.
pub(super) fn out_of_planes(
    (scene, model): (&Scene, &Model<f64>),
    workspace: &mut Workspace<f64>,
    rows: &mut ContactScratch,
    (q, next): (&mut [f64], &mut [f64]),
    (mut moves, passing): (Option<&mut Vec<Move>>, &[usize]),
) -> Result<(f64, usize), (String, Error)> {
    let points = scene.contact_points();
    let (mut depth, mut iterations) = (0.0, 0);
    // No displacement corrects contacts that no joint moves along their normal.
    let mut held_still: Vec<usize> = Vec::new();
    let mut before = f64::NEG_INFINITY;
    let has_shapes = points.iter().any(|point| point.found);
    for k in 0..=STEPS {
        positions_onto_connections(scene, (model, workspace), rows, q, moves.as_deref_mut())?;
        rows.place(model, points, q);
        for &i in passing.iter().chain(&held_still) {
            rows.gaps[i] = f64::INFINITY;
        }
        let lowest = rows.gaps[..points.len()].iter().fold(0.0_f64, |lowest, &gap| lowest.min(gap));
        if k == 0 {
            depth = -lowest;
        }
        let is_stuck = lowest < LESS * before && has_shapes;
        if !(lowest < -TOUCHES) || k == STEPS || is_stuck {
            break;
        }
        before = lowest;
        // The displacement can push contacts under the surface whose gap is below the largest penetration.
        let mut near: Vec<usize> = (0..rows.gaps.len()).filter(|&i| rows.gaps[i] < depth).collect();
        factorised(scene, (model, q), workspace)?;
        if let Some(closed) = &mut rows.closed {
            closed.factorize(model, workspace, q).map_err(|at| (String::new(), scene.row_fault(at)))?;
        }
        let cone = loop {
            let blocks = rows.gram(model, points, workspace, &mut near);
            let held = held_along_normals(&blocks, near.len());
            let cone = Cones::new(blocks, &vec![0.0; near.len()]);
            let Some(at) = held.filter(|&at| near[at] < points.len()) else { break cone };
            held_still.push(near.remove(at));
        };
        let gap = |i: usize| if i < points.len() { rows.gaps[i] } else { rows.gaps[i].max(0.0) };
        let c = DVector::from_fn(3 * near.len(), |i, _| if i % 3 == 2 { gap(near[i / 3]) } else { 0.0 });
        if cone.lengths().iter().any(|r| !r.is_finite()) {
            break;
        }
        let (push, solved) = cone.solve(&c, &Limits::beside(&c), if has_shapes { BOUNDED } else { ROUGH });
        iterations += solved.iterations;
        rows.respond(model, workspace, &push);
        if has_shapes {
            // Surfaces that contradict each other would separate far away, or nowhere.
            let displacement = rows.response.clone();
            let moved = rows.velocities(model, points, &displacement);
            if !(solved.residual <= MEETS && moved.rows(0, 3 * points.len()).amax() <= FARTHEST * depth) {
                break;
            }
        }
        if let Some(moves) = &mut moves {
            let (q, cone, moved) = (q.to_vec(), cone.whole(), rows.response.clone());
            moves.push(Move::Push(Push { q, near, gaps: c, cone, impulses: push, moved }));
        }
        advance(model, q, &rows.response, next);
        q.copy_from_slice(next);
    }
    Ok((depth, iterations))
}

/// The first row whose normal no joint moves, in blocks of G.
fn held_along_normals(blocks: &[(Vec<usize>, Gram)], rows: usize) -> Option<usize> {
    /// An entry of G below this, relative to those of the tangents, is the square of rounding.
    const STILL: f64 = 1e-24;
    let held = |g: &Gram, i: usize| {
        let own = g.diagonal(i);
        own[2] <= STILL * (own[0] + own[1])
    };
    let each = blocks.iter().flat_map(|(members, g)| members.iter().enumerate().map(move |(i, &at)| (at, g, i)));
    each.filter(|&(at, g, i)| at < rows && held(g, i)).map(|(at, ..)| at).min()
}
