use super::{ContactScratch, LimitRow};
use crate::dynamics::contact_kernel::ContactKernel;
use crate::dynamics::forward::factorise;
use crate::dynamics::sweeps::{SweepModel, SweepScratch, general};
use crate::scalar::{DoubleDouble, Dual, Real, Traced};
use crate::scene::{Contact, Scene, SceneBuilder, Surface};
use nalgebra::{DMatrix, DVector};

/// Four chains of three bodies on the same base, with contacts in mixed order: one with two contacts, one with one,
/// and two that a pair couples, if there is one.
fn scene(with_pair: bool) -> Scene {
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
    builder = builder.contact(point("0link2", [0.1, 0.0, 0.2]));
    if with_pair {
        builder = builder.contact(pair.with_surface(Surface::Box { size: [0.1, 0.2, 0.3].into() }));
    }
    builder
        .contact(point("2link1", [0.0, 0.1, 0.3]))
        .contact(point("0link1", [0.2, 0.1, 0.0]))
        .contact(point("1link2", [0.0, 0.2, 0.1]))
        .build()
        .unwrap()
}

fn configuration(nv: usize) -> Vec<f64> {
    (0..nv).map(|i| 0.3 + 0.17 * f64::from(u8::try_from(i * 7 % 11).unwrap())).collect()
}

/// G of all contacts in a scalar, by the kernels' model or the general one, rounded to f64.
fn gram_in<T: Real>(scene: &Scene, is_general: bool) -> DMatrix<f64> {
    let (model, q) = (scene.model().cast::<T>(), configuration(scene.nv()));
    let sweeps = if is_general { SweepModel::general(&model) } else { SweepModel::new(scene.model()) };
    let mut scratch = SweepScratch::new(&model, &sweeps);
    let q: Vec<T> = q.into_iter().map(T::from_f64).collect();
    general::factor((&model, &sweeps), &mut scratch, &q);
    let m = 3 * scene.contact_points().len();
    let mut gram = vec![T::from_f64(f64::NAN); m * m];
    ContactKernel::new((&model, &sweeps), scene.contact_points()).gram_at((&model, &sweeps), &scratch, &mut gram);
    DMatrix::from_row_iterator(m, m, gram.into_iter().map(|entry| entry.lane(T::LANES - 1)))
}

/// Steps of one state, kernels for one state or several, the reference and code generation have the same G.
#[test]
fn the_gram_matrix_is_the_same_in_every_scalar() {
    let scene = scene(false);
    let (model, points) = (scene.model(), scene.contact_points());
    let (mut rows, mut workspace) = (ContactScratch::new(model, points, Vec::new()), scene.workspace());
    let q = configuration(scene.nv());
    rows.place(model, points, &q);
    factorise(model, &mut workspace, &q);
    let mut found = DMatrix::zeros(3 * points.len(), 3 * points.len());
    for (members, block) in rows.gram(model, points, &workspace, &mut vec![0, 1, 2, 3]) {
        for (a, &i) in members.iter().enumerate() {
            for (b, &k) in members.iter().enumerate() {
                found.view_mut((3 * i, 3 * k), (3, 3)).copy_from(&block.dense().view((3 * a, 3 * b), (3, 3)));
            }
        }
    }
    let exact = gram_in::<DoubleDouble>(&scene, true);
    let near = |gram: &DMatrix<f64>| assert!((gram - &exact).amax() <= 1e-13 * exact.amax(), "{gram} {exact}");
    near(&found);
    near(&gram_in::<f64>(&scene, true));
    near(&gram_in::<f64>(&scene, false));
    near(&gram_in::<Dual<f64>>(&scene, true));
    // With constants, a trace is evaluated.
    near(&gram_in::<Traced>(&scene, false));
    #[cfg(all(target_arch = "x86_64", feature = "lanes"))]
    if pulp::x86::V3::try_new().is_some() {
        near(&gram_in::<crate::scalar::Lanes<pulp::x86::V3>>(&scene, false));
    }
}

/// The blocks of G, and zeros between the groups, are J M^-1 J* by dense algebra with M and J by columns.
#[test]
fn blocks_of_independent_trees_are_those_of_dense_algebra() {
    let scene = scene(true);
    let (model, points, nv) = (scene.model(), scene.contact_points(), scene.nv());
    let q = configuration(nv);
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
                    gram.view_mut((3 * near[i], 3 * near[k]), (3, 3))
                        .copy_from(&block.dense().view((3 * a, 3 * b), (3, 3)));
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
        rows.respond(model, &mut workspace, &impulses);
        let mut all = DVector::zeros(21);
        for (at, &i) in near.iter().enumerate() {
            all.fixed_rows_mut::<3>(3 * i).copy_from(&impulses.fixed_rows::<3>(3 * at));
        }
        let response = &j * DVector::from_column_slice(&rows.response);
        assert!((response - &expected * all).amax() <= 1e-11 * expected.amax());
    }
}
