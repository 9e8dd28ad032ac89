//! Faults of steps with contacts.

use super::super::faults::pivot_fault;
use crate::contact::SolveReport;
use crate::dynamics::contacts::LimitRow;
use crate::dynamics::forward::factorise;
use crate::error::Error;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;
use crate::workspace::Workspace;

/// A residual above this is an error; a residual between the tolerance and this value is accepted.
pub(super) const REFUSED: f64 = 1e-5;

/// Returns an error for a solve with a large residual.
pub(super) fn check(rows: (&Scene, &[LimitRow]), near: &[usize], solved: &SolveReport) -> Result<(), (String, Error)> {
    if solved.residual <= REFUSED {
        return Ok(());
    }
    let found = format!("a residual of {:.1e} after {} iterations", solved.residual, solved.iterations);
    let expected =
        "impulses with a residual of at most 1e-5 of the fastest contact velocity: take a smaller dt, or less friction";
    Err((String::new(), Error::argument(named(rows, near), found, expected)))
}

/// Returns an error for a contact that no joint can move, for r of each contact.
pub(super) fn check_movable(
    rows: (&Scene, &[LimitRow]),
    near: &[usize],
    lengths: &[f64],
) -> Result<(), (String, Error)> {
    let Some(at) = lengths.iter().position(|r| !r.is_finite()) else { return Ok(()) };
    let found = "a point that the joints and connections cannot move in this configuration";
    let error = Error::argument(named(rows, &near[at..=at]), found, "contacts that joints can move");
    Err((String::new(), error))
}

/// The first contact of shapes that joints and connections cannot move, which the step omits.
pub(super) fn held_still(points: &[ContactPoint], near: &[usize], lengths: &[f64]) -> Option<usize> {
    (0..near.len()).find(|&at| !lengths[at].is_finite() && points.get(near[at]).is_some_and(|point| point.found))
}

/// Text that names some contacts and the joints of some limits, whose rows follow those of the contacts.
pub(super) fn named((scene, limits): (&Scene, &[LimitRow]), which: &[usize]) -> String {
    let points = scene.contact_points();
    let contacts = which.iter().filter_map(|&i| Some(&*points.get(i)?.name));
    let reached = which.iter().filter_map(|&i| limits.get(i.checked_sub(points.len())?));
    let joints = reached.filter_map(|limit| Some(scene.joint_of_body(limit.body)?.name.as_str()));
    let lists = [listed(["contact", "contacts"], contacts), listed(["limit of joint", "limits of joints"], joints)];
    lists.into_iter().flatten().collect::<Vec<_>>().join(" and ")
}

/// A noun, singular or plural, and at most eight names; `None` without names.
fn listed<'a>(nouns: [&str; 2], names: impl Iterator<Item = &'a str>) -> Option<String> {
    const MOST: usize = 8;
    let names: Vec<String> = names.map(|name| format!("{name:?}")).collect();
    let (noun, more) = (nouns[usize::from(names.len() > 1)], if names.len() > MOST { ", ..." } else { "" });
    (!names.is_empty()).then(|| format!("{noun} {}{more}", names[..names.len().min(MOST)].join(", ")))
}

/// Factorizes M at `q`; the error of a singular pivot names its joint.
pub(super) fn factorised(
    scene: &Scene,
    (model, q): (&Model<f64>, &[f64]),
    workspace: &mut Workspace<f64>,
) -> Result<(), (String, Error)> {
    let pivots = factorise(model, workspace, q);
    let lost = workspace.lost_pivot(model, &pivots);
    lost.map_or(Ok(()), |lost| Err(pivot_fault(scene, lost)))
}

/// Returns an error for two spheres without a normal.
pub(super) fn check_normals(scene: &Scene, gaps: &[f64]) -> Result<(), (String, Error)> {
    let Some(at) = gaps.iter().position(|gap| gap.is_nan()) else { return Ok(()) };
    let expected = "spheres whose centers are apart: take a smaller dt";
    Err((String::new(), Error::argument(named((scene, &[]), &[at]), "two spheres whose centers coincide", expected)))
}

#[cfg(test)]
mod tests {
    use super::super::super::limit_rows::limit_rows;
    use super::{LimitRow, named};
    use crate::scene::{Contact, Scene};

    #[test]
    fn names_are_those_of_contacts_and_of_joints_at_their_limits() {
        let mut builder = crate::scenes::chain(3).unwrap().source().clone();
        for (name, link) in [("heel", "link1"), ("toe", "link2")] {
            builder = builder.contact(Contact::new(name, link).with_point([0.1, 0.0, 0.3]));
        }
        let scene: Scene = builder.build().unwrap();
        let limit = |body: usize| LimitRow { body, row: body, coordinate: body, upper: true, bound: 1.0 };
        let limits = [limit(0), limit(2)];
        let joint = |body: usize| scene.joint_of_body(body).unwrap().name.clone();
        let of = |which: &[usize]| named((&scene, &limits), which);
        assert_eq!(of(&[0]), "contact \"heel\"");
        assert_eq!(of(&[0, 1]), "contacts \"heel\", \"toe\"");
        assert_eq!(of(&[1, 3]), format!("contact \"toe\" and limit of joint {:?}", joint(2)));
        assert_eq!(of(&[2, 3]), format!("limits of joints {:?}, {:?}", joint(0), joint(2)));
        assert_eq!(named((&scene, &limit_rows(&scene)), &[0]), "contact \"heel\"");
    }
}
