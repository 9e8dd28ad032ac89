use super::{ContactScratch, LimitRow};
use crate::dynamics::forward::factorise;
use crate::scene::{Contact, Scene, SceneBuilder, Surface};
use nalgebra::{DMatrix, DVector};

/// Four chains of three bodies on the same base, with contacts in mixed order: one with two contacts, one with one,
/// and two that a pair couples.
fn scene() -> Scene {
    let chain = crate::scenes::chain(3).unwrap().source().clone();
    let is_child = |name: &str| chain.joints().iter().any(|joint| joint.child == name);
    let mut builder = SceneBuilder::new();
    for link in chain.links().iter().filter(|link| !is_child(&link.name)) {
        builder = builder.link(link.clone());
    }
    for copy in 0..4 {
        for link in chain.links().iter().filter(|link| is_child(&link.name)) {
            let mut link = link.clone();
            link.name = format!("{copy}{}", link.name);
            builder = builder.link(link);
        }
        for joint in chain.joints() {
            let mut joint = joint.clone();
            joint.name = format!("{copy}{}", joint.name);
            if is_child(&joint.parent) {
                joint.parent = format!("{copy}{}", joint.parent);
            }
            joint.child = format!("{copy}{}", joint.child);
            builder = builder.joint(joint);
        }
    }
    let point = |name: &str, at: [f64; 3]| Contact::new(format!("on {name}"), name).with_point(at);
    let pair = Contact::new("pair", "3link2").with_radius(0.1).with_other("1link1".to_owned());
    builder
        .contact(point("0link2", [0.1, 0.0, 0.2]))
        .contact(pair.with_surface(Surface::Box { size: [0.1, 0.2, 0.3].into() }))
        .contact(point("2link1", [0.0, 0.1, 0.3]))
        .contact(point("0link1", [0.2, 0.1, 0.0]))
        .contact(point("1link2", [0.0, 0.2, 0.1]))
        .build()
        .unwrap()
}

/// The blocks of G, and zeros between the groups, are J M^-1 J* by dense algebra with M and J by columns.
#[test]
fn blocks_of_independent_trees_are_those_of_dense_algebra() {
    let scene = scene();
    let (model, points, nv) = (scene.model(), scene.contact_points(), scene.nv());
    let q: Vec<f64> = (0..nv).map(|i| 0.3 + 0.17 * f64::from(u8::try_from(i * 7 % 11).unwrap())).collect();
    let mut workspace = scene.workspace();
    let mut m = DMatrix::zeros(nv, nv);
    scene.mass_matrix(&mut workspace, &q, m.as_mut_slice()).unwrap();
    // The limit of the last joint of the chain with two contacts, and of the first joint of that with one.
    let limit = |name: &str, upper: bool| {
        let joint = scene.joints().iter().find(|joint| joint.name.starts_with(name)).unwrap();
        let row = joint.v.start;
        let body = model.system.stages.iter().position(|stage| stage.first_row == row).unwrap();
        LimitRow { body, row, coordinate: joint.q.start, upper, bound: 0.0 }
    };
    let limits = vec![limit("2", false), limit("0", true)];
    let mut rows = ContactScratch::new(model, points, limits);
    rows.place(model, points, &q);
    let mut j = DMatrix::zeros(21, nv);
    for i in 0..nv {
        let mut unit = vec![0.0; nv];
        unit[i] = 1.0;
        j.set_column(i, &rows.velocities(model, points, &unit));
    }
    let expected = &j * m.try_inverse().unwrap() * j.transpose();
    factorise(model, &mut workspace, &q);
    for near in [vec![0, 1, 2, 3, 4, 5, 6], vec![0, 2, 3, 4, 6], vec![1, 5], vec![4], vec![]] {
        let blocks = rows.gram(model, points, &workspace, &mut near.clone());
        let mut gram = DMatrix::zeros(21, 21);
        for (members, block) in &blocks {
            for (a, &i) in members.iter().enumerate() {
                for (b, &k) in members.iter().enumerate() {
                    gram.view_mut((3 * near[i], 3 * near[k]), (3, 3)).copy_from(&block.view((3 * a, 3 * b), (3, 3)));
                }
            }
        }
        let of = |at: usize| near.contains(&(at / 3));
        let error = DMatrix::from_fn(21, 21, |i, k| if of(i) && of(k) { gram[(i, k)] - expected[(i, k)] } else { 0.0 });
        assert!(error.amax() <= 1e-12 * expected.amax(), "{near:?}: {error}");
        let members: Vec<Vec<usize>> =
            blocks.into_iter().map(|(members, _)| members.into_iter().map(|at| near[at]).collect()).collect();
        let mut groups: Vec<Vec<usize>> = [vec![0, 3, 6], vec![1, 4], vec![2, 5]]
            .into_iter()
            .map(|group| group.into_iter().filter(|i| near.contains(i)).collect::<Vec<_>>())
            .filter(|group| !group.is_empty())
            .collect();
        // Groups are in the order of their first contacts.
        groups.sort_unstable();
        assert_eq!(members, groups);
        let impulses = DVector::from_fn(3 * near.len(), |i, _| if near[i / 3] < 5 || i % 3 == 2 { 0.5 } else { 0.0 });
        rows.respond(model, points, &mut workspace, &near, &impulses);
        let mut all = DVector::zeros(21);
        for (at, &i) in near.iter().enumerate() {
            all.fixed_rows_mut::<3>(3 * i).copy_from(&impulses.fixed_rows::<3>(3 * at));
        }
        let response = &j * DVector::from_column_slice(&rows.response);
        assert!((response - &expected * all).amax() <= 1e-11 * expected.amax());
    }
}
