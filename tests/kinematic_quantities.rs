//! Single links, the center of mass and the momentum about it, compared with definitions in about 31 digits
//! (`common/oracle.rs`): derivatives are central differences along q (+) h qd.

use crate::common::oracle::{D, Instant, Oracle, d, ds};
use crate::common::tolerance::{self, STEP, assert_close, assert_near, size, to_f64};
use crate::common::{ALL_KINDS, KINDS_WITH_FIXED, Random, Tree, random_state};
use nalgebra::{DMatrix, Matrix3, Vector3};
use phipsi::TaskFrame;
use phipsi::kinematics::{AccelerationKind, Frame, ReferenceFrame};
use phipsi::scene::SceneBuilder;
use phipsi::spatial::RigidShift;
use phipsi::{Error, Scene, scenes};

const REFERENCES: [ReferenceFrame; 3] =
    [ReferenceFrame::Local, ReferenceFrame::World, ReferenceFrame::LocalWorldAligned];

type V = Vector3<D>;

fn cross(a: &V, b: &V) -> V {
    V::new(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
}

/// A scene in one state, and the oracle in this state and slightly before and after it.
struct Case {
    source: SceneBuilder,
    scene: Scene,
    oracle: Oracle,
    q: Vec<f64>,
    qd: Vec<f64>,
    qdd: Vec<f64>,
}

impl Case {
    /// Random mixed trees: fixed and floating bases, with and without armature, one joint to eight.
    fn new(seed: u64) -> Self {
        let bodies = 1 + usize::try_from(seed).unwrap() % 8;
        let kinds = if seed.is_multiple_of(2) { &ALL_KINDS[..] } else { &KINDS_WITH_FIXED[..] };
        let armature = if seed.is_multiple_of(3) { 0.0 } else { 0.3 };
        let source = Tree { seed, bodies, kinds, branching: 0.5, armature, floating: seed % 5 == 1 }.builder();
        let scene = source.clone().build().unwrap();
        let (q, qd, qdd) = random_state(&scene, &mut Random::new(7000 + seed));
        Self { oracle: Oracle::new(&source), source, scene, q, qd, qdd }
    }

    /// A function of q, and its derivative along qd.
    fn with_rate(&self, quantity: impl Fn(&Instant<'_>) -> DMatrix<D>) -> [DMatrix<D>; 2] {
        let (q, qd) = (ds(&self.q), ds(&self.qd));
        let at = |h: f64| quantity(&self.oracle.at(&self.oracle.moved(&q, &qd, d(h)), &qd));
        let difference = at(STEP) - at(-STEP);
        [quantity(&self.oracle.at(&q, &qd)), difference * d(0.5 / STEP)]
    }

    fn nv(&self) -> usize {
        self.scene.nv()
    }
}

/// J of a frame on a link, from that of the origin of the link in its own frame.
fn jacobian(instant: &Instant<'_>, nv: usize, frame: &TaskFrame<'_>, reference: ReferenceFrame) -> DMatrix<D> {
    let (own, placement) = (instant.jacobian(frame.link), instant.placement(frame.link));
    let lever = placement.rotation * frame.offset.lever.map(d);
    let axes: Matrix3<D> = match reference {
        ReferenceFrame::Local => (placement.rotation * frame.offset.rotation.map(d)).transpose(),
        _ => Matrix3::identity(),
    };
    let mut out = DMatrix::from_element(6, nv, d(0.0));
    for column in 0..nv {
        let part = |first: usize| placement.rotation * V::from_fn(|i, _| own[(first + i, column)]);
        let (w, v) = (part(0), part(3));
        let v = match reference {
            ReferenceFrame::World => v + cross(&placement.lever, &w),
            _ => v + cross(&w, &lever),
        };
        out.fixed_view_mut::<3, 1>(0, column).copy_from(&(axes * w));
        out.fixed_view_mut::<3, 1>(3, column).copy_from(&(axes * v));
    }
    out
}

fn rows(matrix: &DMatrix<D>) -> Vec<f64> {
    matrix.transpose().iter().map(|&x| to_f64(x)).collect()
}

fn times(matrix: &DMatrix<D>, x: &[f64]) -> Vec<f64> {
    matrix.row_iter().map(|row| to_f64(row.iter().zip(x).fold(d(0.0), |sum, (&a, &x)| sum + a * d(x)))).collect()
}

fn plus(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// A link by its name, or a frame on it that is rotated and off its origin.
fn frames<'s>(scene: &'s Scene, random: &mut Random) -> Vec<TaskFrame<'s>> {
    let frame = |name: &'s String, random: &mut Random| {
        let offset = RigidShift { rotation: random.rotation(), lever: random.vector() };
        if random.below(2) == 0 { TaskFrame::from(name.as_str()) } else { TaskFrame { link: name, offset } }
    };
    scene.links().iter().map(|link| frame(&link.name, random)).collect()
}

#[test]
fn links_match_first_principles() {
    for seed in 0..40 {
        let case = Case::new(seed);
        let (scene, nv, n) = (&case.scene, case.nv(), case.scene.links().len());
        let Case { q, qd, qdd, .. } = &case;
        for frame in frames(scene, &mut Random::new(seed)) {
            for reference in REFERENCES {
                let [exact, rate] = case.with_rate(|instant| jacobian(instant, nv, &frame, reference));
                let (wanted, wanted_rate) = (rows(&exact), rows(&rate));
                let scale = 1.0_f64.max(size(&wanted)).max(size(&wanted_rate)) * 1.0_f64.max(size(qd)).max(size(qdd));
                let bound = tolerance::product(n, scale * tolerance::count(nv));
                let mut found = vec![f64::NAN; 6 * nv];
                scene.jacobian(q, frame, reference, &mut found).unwrap();
                assert_near("J", &found, &wanted, bound);
                scene.jacobian_rate(q, qd, frame, reference, &mut found).unwrap();
                assert_near("J'", &found, &wanted_rate, bound);
                let velocity = scene.velocity(q, qd, frame, reference).unwrap();
                assert_near("J qd", velocity.as_slice(), &times(&exact, qd), bound);
                let product = scene.jacobian_rate_product(q, qd, frame, reference).unwrap();
                assert_near("J' qd", product.as_slice(), &times(&rate, qd), bound);
                // Accelerations whose frame and point are fixed are the spatial ones.
                let kind = match reference {
                    ReferenceFrame::LocalWorldAligned => AccelerationKind::Classical,
                    _ => AccelerationKind::Spatial,
                };
                let acceleration = scene.acceleration(q, qd, qdd, frame, reference, kind).unwrap();
                let exact = plus(&times(&exact, qdd), &times(&rate, qd));
                assert_near("J qdd + J' qd", acceleration.as_slice(), &exact, bound);
            }
        }
    }
}

#[test]
fn the_two_accelerations_are_one_vector_in_three_frames() {
    for seed in 0..20 {
        let case = Case::new(seed);
        let (scene, n) = (&case.scene, case.scene.links().len());
        let Case { q, qd, qdd, .. } = &case;
        for frame in frames(scene, &mut Random::new(seed)) {
            let placement = scene.placement(q, frame).unwrap();
            let of = |reference, kind| scene.acceleration(q, qd, qdd, frame, reference, kind).unwrap();
            for kind in [AccelerationKind::Spatial, AccelerationKind::Classical] {
                let (local, aligned) = (of(ReferenceFrame::Local, kind), of(ReferenceFrame::LocalWorldAligned, kind));
                let turned = ReferenceFrame::LocalWorldAligned.express(&placement, &local);
                let bound = tolerance::product(n, 1.0_f64.max(size(local.as_slice())));
                assert_near("turned", turned.as_slice(), aligned.as_slice(), bound);
            }
            let velocity = scene.velocity(q, qd, frame, ReferenceFrame::Local).unwrap();
            let (w, v) = (velocity.fixed_rows::<3>(0).into_owned(), velocity.fixed_rows::<3>(3).into_owned());
            let local = ReferenceFrame::Local;
            let apart = of(local, AccelerationKind::Classical) - of(local, AccelerationKind::Spatial);
            let bound = tolerance::product(n, 1.0_f64.max(size(of(local, AccelerationKind::Classical).as_slice())));
            assert_near("w x v", apart.fixed_rows::<3>(3).as_slice(), w.cross(&v).as_slice(), bound);
            assert_near("angular", apart.fixed_rows::<3>(0).as_slice(), &[0.0; 3], 0.0);
        }
    }
}

#[test]
fn placements_match_first_principles() {
    for seed in 0..40 {
        let case = Case::new(seed);
        let (scene, n) = (&case.scene, case.scene.links().len());
        let instant = case.oracle.at_rest(&ds(&case.q));
        let mut random = Random::new(seed);
        let all = frames(scene, &mut random);
        // Some of them, in another order and repeated.
        let some: Vec<TaskFrame<'_>> = (0..3).map(|_| all[random.below(all.len())]).collect();
        let mut together = vec![RigidShift::filled(f64::NAN); some.len()];
        scene.placements_of(&mut scene.workspace(), &case.q, &some, &mut together).unwrap();
        for (frame, found) in
            some.iter().zip(together).chain(all.iter().map(|f| (f, scene.placement(&case.q, *f).unwrap())))
        {
            let link = instant.placement(frame.link);
            let rotation = (link.rotation * frame.offset.rotation.map(d)).map(to_f64);
            let lever = (link.lever + link.rotation * frame.offset.lever.map(d)).map(to_f64);
            assert_near("rotation", found.rotation.as_slice(), rotation.as_slice(), tolerance::product(n, 1.0));
            let reach = tolerance::count(n) * (1.0 + size(&case.q));
            assert_near("position", found.lever.as_slice(), lever.as_slice(), tolerance::product(n, reach));
        }
    }
}

/// Masses and centers of mass of the moving links.
fn masses(case: &Case, instant: &Instant<'_>) -> Vec<(D, V)> {
    let moves = |link: &str| instant.jacobian(link).iter().any(|&x| to_f64(x) != 0.0);
    let links = case.source.links().iter().filter(|link| moves(&link.name));
    links
        .filter_map(|link| {
            let (inertial, placement) = (link.inertial?, instant.placement(&link.name));
            Some((d(inertial.mass), placement.lever + placement.rotation * inertial.center.map(d)))
        })
        .collect()
}

fn center_of_mass(case: &Case, instant: &Instant<'_>) -> V {
    let masses = masses(case, instant);
    let total = masses.iter().fold(d(0.0), |sum, (mass, _)| sum + *mass);
    masses.iter().fold(V::from_element(d(0.0)), |sum, (mass, center)| sum + center * *mass) * (d(1.0) / total)
}

/// A, by columns: momenta of unit velocities, moments about the center of mass.
fn centroidal(case: &Case, q: &[D]) -> DMatrix<D> {
    let nv = case.nv();
    let mut out = DMatrix::from_element(6, nv, d(0.0));
    for column in 0..nv {
        let unit: Vec<D> = (0..nv).map(|j| d(if j == column { 1.0 } else { 0.0 })).collect();
        let instant = case.oracle.at(q, &unit);
        let momentum = instant.momentum();
        let part = |first: usize| V::from_fn(|i, _| momentum[first + i]);
        let about = part(0) - cross(&center_of_mass(case, &instant), &part(3));
        out.fixed_view_mut::<3, 1>(0, column).copy_from(&about);
        out.fixed_view_mut::<3, 1>(3, column).copy_from(&part(3));
    }
    out
}

#[test]
fn the_center_of_mass_matches_first_principles() {
    for seed in 0..40 {
        let case = Case::new(seed);
        let (scene, nv, n) = (&case.scene, case.nv(), case.scene.links().len());
        let Case { q, qd, qdd, .. } = &case;
        let mut workspace = scene.workspace();
        if nv == 0 {
            assert_close("no mass", scene.total_mass(), 0.0, 0.0);
            continue;
        }
        let here = ds(q);
        let instant = case.oracle.at(&here, &ds(qd));
        let total = masses(&case, &instant).iter().fold(0.0, |sum, (mass, _)| sum + to_f64(*mass));
        assert_close("mass", scene.total_mass(), total, tolerance::product(n, total));

        let center = center_of_mass(&case, &instant).map(to_f64);
        let reach = tolerance::count(n) * (1.0 + size(q));
        let found = scene.center_of_mass(&mut workspace, q).unwrap();
        assert_near("center of mass", found.as_slice(), center.as_slice(), tolerance::product(n, reach));

        let at = |h: f64| centroidal(&case, &case.oracle.moved(&here, &ds(qd), d(h)));
        let (exact, rate) = (centroidal(&case, &here), (at(STEP) - at(-STEP)) * d(0.5 / STEP));
        let largest = 1.0_f64.max(size(&rows(&exact))).max(size(&rows(&rate)));
        let scale = largest * 1.0_f64.max(size(qd)).max(size(qdd)) * tolerance::count(nv);
        let bound = tolerance::product(n, scale);
        let mut found = vec![f64::NAN; 6 * nv];
        scene.centroidal_momentum_matrix(&mut workspace, q, &mut found).unwrap();
        assert_near("A", &found, &rows(&exact), bound);
        scene.centroidal_momentum_matrix_rate(&mut workspace, q, qd, &mut found).unwrap();
        assert_near("A'", &found, &rows(&rate), bound);

        let by_mass = |x: &[f64]| -> Vec<f64> { x.iter().map(|x| x / total).collect() };
        let mut found = vec![f64::NAN; 3 * nv];
        scene.center_of_mass_jacobian(&mut workspace, q, &mut found).unwrap();
        assert_near("J of the center", &found, &by_mass(&rows(&exact)[3 * nv..]), bound / total);
        let velocity = scene.center_of_mass_velocity(&mut workspace, q, qd).unwrap();
        assert_near("its velocity", velocity.as_slice(), &by_mass(&times(&exact, qd)[3..]), bound / total);
        let acceleration = scene.center_of_mass_acceleration(&mut workspace, q, qd, qdd).unwrap();
        let exact = plus(&times(&exact, qdd), &times(&rate, qd));
        assert_near("its acceleration", acceleration.as_slice(), &by_mass(&exact[3..]), bound / total);

        let energy = scene.energy(&mut workspace, q, qd).unwrap();
        assert_close("kinetic energy", scene.kinetic_energy(&mut workspace, q, qd).unwrap(), energy.kinetic, 0.0);
        let potential = scene.potential_energy(&mut workspace, q).unwrap();
        assert_close("potential energy", potential, energy.potential, 0.0);
    }
}

/// Refused arguments of each method, after a valid call.
#[test]
fn arguments_are_checked() {
    let scene = scenes::chain(3).unwrap();
    let (q, few, nan) = ([0.3; 3], [0.0; 2], [0.0, f64::NAN, 0.0]);
    let link = scene.links()[3].name.as_str();
    let mut workspace = scene.workspace();
    let local = ReferenceFrame::Local;
    let says = |outcome: Result<(), Error>, message: &str| {
        let error = outcome.expect_err(message).to_string();
        assert!(error.starts_with(message), "{error} against {message}");
    };

    assert!(scene.placement(&q, link).is_ok());
    says(scene.placement(&few, link).map(drop), "q: found shape (2,); expected (3,)");
    says(scene.placement(&q, "foot").map(drop), "link: found \"foot\"; expected one of");
    let at = |lever| TaskFrame { link, offset: RigidShift { rotation: Matrix3::identity(), lever } };
    assert!(scene.placement(&q, at(Vector3::new(1.0, 2.0, 3.0))).is_ok());
    says(scene.placement(&q, at(Vector3::new(1.0, f64::NAN, 0.0))).map(drop), "xyz of the task frame on link");
    says(scene.velocity(&q, &nan, link, local).map(drop), "qd: found NaN at index 1");
    let spatial = AccelerationKind::Spatial;
    says(scene.acceleration(&q, &q, &few, link, local, spatial).map(drop), "qdd: found shape (2,); expected (3,)");
    says(scene.jacobian(&q, link, local, &mut [0.0; 17]), "out: found shape (17,); expected (18,)");
    says(scene.jacobian_rate(&q, &few, link, local, &mut [0.0; 18]), "qd: found shape (2,)");
    says(scene.jacobian_rate(&q, &q, link, local, &mut [0.0; 6]), "out: found shape (6,); expected (18,)");
    says(scene.jacobian_rate_product(&nan, &q, link, local).map(drop), "q: found NaN at index 1");
    says(
        scene
            .velocity(&q, &[1e200; 3], link, local)
            .map(drop)
            .and(scene.jacobian_rate_product(&q, &[1e200; 3], link, local).map(drop)),
        "jacobian rate product (result; the arguments overflow)",
    );
    let mut one = [RigidShift::identity()];
    says(scene.placements_of(&mut workspace, &q, &[link, link], &mut one), "out: found shape (1,); expected (2,)");

    let mut other = scenes::chain(2).unwrap().workspace();
    let known = |body| Frame { body, placement: scene.link(link).unwrap().placement };
    assert_eq!(scene.placement(&q, known(Some(2))), scene.placement(&q, link));
    says(
        scene.placement(&q, known(Some(3))).map(drop),
        "body of the frame: found 3; expected an index below the number of bodies, 3, or none for the base",
    );

    assert!(scene.center_of_mass(&mut workspace, &q).is_ok());
    says(scene.center_of_mass(&mut other, &q).map(drop), "workspace: found that of another scene");
    says(scene.placements_of(&mut other, &q, &[link], &mut one), "workspace: found that of another scene");
    says(scene.center_of_mass(&mut workspace, &nan).map(drop), "q: found NaN at index 1");
    says(scene.center_of_mass_velocity(&mut workspace, &q, &few).map(drop), "qd: found shape (2,)");
    says(scene.center_of_mass_acceleration(&mut workspace, &q, &q, &nan).map(drop), "qdd: found NaN");
    says(scene.center_of_mass_jacobian(&mut workspace, &q, &mut [0.0; 3]), "out: found shape (3,); expected (9,)");
    says(scene.centroidal_momentum_matrix(&mut workspace, &q, &mut [0.0; 9]), "out: found shape (9,); expected (18,)");
    says(scene.centroidal_momentum_matrix_rate(&mut workspace, &q, &nan, &mut [0.0; 18]), "qd: found NaN");
    says(scene.kinetic_energy(&mut workspace, &q, &few).map(drop), "qd: found shape (2,)");
    says(scene.gravity_torque(&mut workspace, &nan, &mut [0.0; 3]), "q: found NaN");
    says(scene.gravity_torque(&mut workspace, &q, &mut [0.0; 2]), "tau: found shape (2,); expected (3,)");
    // A refused call leaves the workspace unchanged.
    assert!(scene.gravity_torque(&mut workspace, &q, &mut [0.0; 3]).is_ok());
}

#[test]
fn without_mass_there_is_no_center_of_mass() {
    let scene = SceneBuilder::new()
        .link(phipsi::scene::LinkDescription { name: "rock".into(), inertial: None })
        .build()
        .unwrap();
    let error = scene.center_of_mass(&mut scene.workspace(), &[]).unwrap_err();
    let expected = "scene: found moving links with a total mass of 0 kg; expected mass on at least one moving link, which the center of mass requires";
    assert_eq!(error.to_string(), expected);
}
