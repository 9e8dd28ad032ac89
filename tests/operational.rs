//! The operational-space inertia compared with J M^-1 J^T from the definitions, in about 31 digits; and cases in
//! which it is undefined.

use crate::common::oracle::{D, Instant, Oracle, d, ds, solve};
use crate::common::tolerance::{self, assert_near, conditioning, size, to_f64};
use crate::common::{KINDS_WITH_FIXED, Random, Tree, random_inertial, random_state};
use nalgebra::{DMatrix, Vector3};
use phipsi::TaskFrame;
use phipsi::dynamics::{self, OperationalScratch};
use phipsi::kinematics::Frame;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::RigidShift;
use phipsi::{Error, Scene, Workspace};

/// Chains and trees with all types of joints, fixed and floating bases, with and without armature, one joint to
/// eight.
fn trees(n: u64) -> impl Iterator<Item = (u64, SceneBuilder)> {
    (0..n).map(|seed| {
        let bodies = 1 + usize::try_from(seed).unwrap() % 8;
        let armature = if seed % 3 == 0 { 0.0 } else { 0.3 };
        let branching = if seed % 4 == 0 { 0.0 } else { 0.6 };
        let tree = Tree { seed, bodies, kinds: &KINDS_WITH_FIXED, branching, armature, floating: seed % 5 == 1 };
        // Another arm on the base, independent of the first if that is fixed.
        let mut shoulder = JointDescription::new("shoulder", JointKind::Revolute, "base", "other");
        shoulder.origin.lever = Vector3::new(0.1, 0.2, 0.3);
        let inertial = Some(random_inertial(&mut Random::new(8000 + seed)));
        (seed, tree.builder().link(LinkDescription { name: "other".into(), inertial }).joint(shoulder))
    })
}

fn inverse_inertia(scene: &Scene, q: &[f64], frames: &[TaskFrame<'_>]) -> Vec<f64> {
    let mut out = vec![f64::NAN; 36 * frames.len() * frames.len()];
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    scene.operational_inverse_inertia(&mut workspace, &mut scratch, q, frames, &mut out).unwrap();
    out
}

fn inertia(scene: &Scene, q: &[f64], frames: &[TaskFrame<'_>], s: Option<&[f64]>) -> Result<Vec<f64>, Error> {
    let k = s.map_or(6 * frames.len(), |s| s.len() / (6 * frames.len()));
    let mut out = vec![f64::NAN; k * k];
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    scene.operational_inertia(&mut workspace, &mut scratch, q, frames, s, &mut out)?;
    Ok(out)
}

/// Stacked Jacobians of task frames: w' = R^T w and v' = R^T (v + w x l), for each link.
fn jacobian(instant: &Instant<'_>, nv: usize, frames: &[TaskFrame<'_>]) -> DMatrix<D> {
    let mut stacked = DMatrix::from_element(6 * frames.len(), nv, d(0.0));
    for (at, frame) in frames.iter().enumerate() {
        let of_link = instant.jacobian(frame.link);
        let back = frame.offset.rotation.map(d).transpose();
        let l = frame.offset.lever.map(d);
        for column in 0..nv {
            let (w, v) = (of_link.fixed_view::<3, 1>(0, column), of_link.fixed_view::<3, 1>(3, column));
            let moved = Vector3::new(
                v[0] + w[1] * l[2] - w[2] * l[1],
                v[1] + w[2] * l[0] - w[0] * l[2],
                v[2] + w[0] * l[1] - w[1] * l[0],
            );
            stacked.fixed_view_mut::<3, 1>(6 * at, column).copy_from(&(back * w));
            stacked.fixed_view_mut::<3, 1>(6 * at + 3, column).copy_from(&(back * moved));
        }
    }
    stacked
}

/// J M^-1 J^T by rows, and the bound of the error in f64.
fn dense(source: &SceneBuilder, q: &[f64], frames: &[TaskFrame<'_>]) -> (Vec<f64>, f64) {
    let oracle = Oracle::new(source);
    let (nv, wide) = (oracle.nv(), 6 * frames.len());
    let instant = oracle.at_rest(&ds(q));
    let (mass, j) = (instant.mass_matrix(), jacobian(&instant, nv, frames));
    let columns: Vec<Vec<D>> =
        (0..wide).map(|column| solve(&mass, &(0..nv).map(|row| j[(column, row)]).collect::<Vec<_>>())).collect();
    let entry = |row: usize, column: usize| (0..nv).fold(d(0.0), |sum, k| sum + j[(row, k)] * columns[column][k]);
    let omega = (0..wide * wide).map(|at| to_f64(entry(at / wide, at % wide))).collect();
    let rows: Vec<f64> = mass.iter().map(|&x| to_f64(x)).collect();
    let conditioning = conditioning(nv, &rows);
    let reach = j.iter().map(|&x| to_f64(x * x)).sum::<f64>();
    (omega, tolerance::inverse(conditioning.number, conditioning.inverse_norm * reach.max(1.0)))
}

/// A frame on a random link, half of them off its origin.
fn random_frame<'s>(scene: &'s Scene, random: &mut Random) -> TaskFrame<'s> {
    let link = scene.links()[random.below(scene.links().len())].name.as_str();
    let offset = if random.below(2) == 0 {
        RigidShift::identity()
    } else {
        RigidShift { rotation: random.rotation(), lever: random.vector() }
    };
    TaskFrame { link, offset }
}

/// Relation of two links, as the recursion distinguishes it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pair {
    OnTheBase,
    SameBody,
    OnePath,
    Branches,
    Apart,
}

fn relation(scene: &Scene, frames: &[TaskFrame<'_>]) -> Pair {
    let body = |at: usize| scene.link(frames[at].link).unwrap().body;
    let (Some(i), Some(j)) = (body(0), body(1)) else { return Pair::OnTheBase };
    let path = |k: usize| std::iter::successors(Some(k), |&k| scene.model().system.stages[k].parent);
    if i == j {
        Pair::SameBody
    } else if path(i).any(|k| k == j) || path(j).any(|k| k == i) {
        Pair::OnePath
    } else if path(i).any(|k| path(j).any(|other| other == k)) {
        Pair::Branches
    } else {
        Pair::Apart
    }
}

#[test]
fn any_pair_of_frames_matches_the_dense_route() {
    let mut seen = Vec::new();
    for (seed, source) in trees(60) {
        let scene = source.clone().build().unwrap();
        let mut random = Random::new(9000 + seed);
        let (q, ..) = random_state(&scene, &mut random);
        for _ in 0..3 {
            let frames = [random_frame(&scene, &mut random), random_frame(&scene, &mut random)];
            let found = inverse_inertia(&scene, &q, &frames);
            let (exact, bound) = dense(&source, &q, &frames);
            let kind = relation(&scene, &frames);
            assert_near(&format!("{kind:?}, seed {seed}"), &found, &exact, bound);
            let off_diagonal: Vec<f64> = (0..36).map(|at| found[12 * (at / 6) + 6 + at % 6]).collect();
            let still = matches!(kind, Pair::OnTheBase | Pair::Apart);
            assert!(!still || off_diagonal.iter().all(|&x| x == 0.0), "{kind:?}");
            // A joint with six degrees of freedom on the path decouples: not every block is nonzero.
            if still || size(&off_diagonal) > 1e-3 * size(&found) {
                seen.push(kind);
            }
        }
    }
    for kind in [Pair::OnTheBase, Pair::SameBody, Pair::OnePath, Pair::Branches, Pair::Apart] {
        let times = seen.iter().filter(|&&other| other == kind).count();
        assert!(times >= 4, "{kind:?}: live {times} times");
    }
}

/// All links at once: many frames, and the block of each is bitwise equal to that of the single frame.
#[test]
fn all_links_at_once_are_exactly_symmetric_and_the_blocks_are_those_of_pairs() {
    for (seed, source) in trees(16) {
        let scene = source.clone().build().unwrap();
        let (q, ..) = random_state(&scene, &mut Random::new(9100 + seed));
        let frames: Vec<TaskFrame<'_>> = scene.links().iter().map(|link| link.name.as_str().into()).collect();
        let found = inverse_inertia(&scene, &q, &frames);
        let wide = 6 * frames.len();
        for i in 0..wide {
            for j in 0..wide {
                assert_eq!(found[i * wide + j].to_bits(), found[j * wide + i].to_bits(), "({i}, {j})");
            }
        }
        let (exact, bound) = dense(&source, &q, &frames);
        assert_near("all links", &found, &exact, bound);
        for (i, first) in frames.iter().enumerate() {
            for (j, second) in frames.iter().enumerate().skip(i + 1) {
                let pair = inverse_inertia(&scene, &q, &[*first, *second]);
                for at in 0..36 {
                    let (row, column) = (at / 6, at % 6);
                    let one = found[(6 * i + row) * wide + 6 * j + column];
                    assert_eq!(pair[12 * row + 6 + column].to_bits(), one.to_bits());
                }
            }
        }
    }
}

#[test]
fn the_same_link_twice_repeats_its_block() {
    for (seed, source) in trees(16) {
        let scene = source.build().unwrap();
        let mut random = Random::new(9200 + seed);
        let (q, ..) = random_state(&scene, &mut random);
        let frame = random_frame(&scene, &mut random);
        let (once, twice) = (inverse_inertia(&scene, &q, &[frame]), inverse_inertia(&scene, &q, &[frame, frame]));
        let scale = size(&once);
        let tiled: Vec<f64> = (0..144).map(|at| once[6 * (at / 12 % 6) + at % 12 % 6]).collect();
        assert_near("blocks", &twice, &tiled, tolerance::product(6, scale));
        // Twelve directions, of which six depend on the others.
        let Err(Error::SingularTask { rank, directions, .. }) = inertia(&scene, &q, &[frame, frame], None) else {
            panic!("repeated directions have no inverse")
        };
        assert!(rank <= 6 && directions == 12);
    }
}

/// Lambda^- of a single body is its block of cov(lambda^-), in any scalar type: f64 agrees with double-double
/// arithmetic.
#[test]
fn double_double_agrees() {
    for (seed, source) in trees(16) {
        let scene = source.clone().build().unwrap();
        let mut random = Random::new(9300 + seed);
        let (q, ..) = random_state(&scene, &mut random);
        let frames = [random_frame(&scene, &mut random), random_frame(&scene, &mut random)];
        let model = scene.model().cast::<D>();
        let on_bodies = frames.map(|frame| {
            let link = scene.link(frame.link).unwrap();
            let placement = link.placement.compose(&frame.offset);
            let placement = RigidShift { rotation: placement.rotation.map(d), lever: placement.lever.map(d) };
            Frame { body: link.body, placement }
        });
        let mut exact = vec![d(f64::NAN); 144];
        let (mut workspace, mut scratch) = (Workspace::new(&model), OperationalScratch::new(&model));
        let q_wide = ds(&q);
        dynamics::operational_inverse_inertia(&model, &mut workspace, &mut scratch, &q_wide, &on_bodies, &mut exact);
        let exact: Vec<f64> = exact.into_iter().map(to_f64).collect();
        let (_, bound) = dense(&source, &q, &frames);
        assert_near("double-double", &inverse_inertia(&scene, &q, &frames), &exact, bound);
    }
}

/// An arm of `joints` parallel hinges, a meter apart, in a randomly rotated plane: no entry is zero by alignment.
fn planar_arm(joints: usize, seed: u64) -> Scene {
    let mut random = Random::new(seed);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for k in 0..joints {
        let parent = if k == 0 { "base".to_owned() } else { format!("link{}", k - 1) };
        let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, format!("link{k}"));
        joint.axis = Vector3::z();
        if k == 0 {
            joint.origin.rotation = random.rotation();
        } else {
            joint.origin.lever = Vector3::x();
        }
        let inertial = Some(random_inertial(&mut random));
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
    }
    builder.build().unwrap()
}

/// A direction in the frame of the tip, (angular, linear), expressed in a task frame on it.
fn direction(frame: &TaskFrame<'_>, angular: Vector3<f64>, linear: Vector3<f64>) -> [f64; 6] {
    let back = frame.offset.rotation.transpose();
    // The velocity at the task frame is R^T (v + w x l): these are rows for v and w at the tip, transformed to that
    // frame.
    let (w, v) = (back * angular, back * linear);
    [w[0], w[1], w[2], v[0], v[1], v[2]]
}

/// A stretched planar arm cannot move its tip along itself; a bent one can. Omega is defined in both cases.
#[test]
fn a_stretched_arm_has_an_inverse_inertia_and_no_inertia() {
    for seed in 0..12 {
        let scene = planar_arm(4, seed);
        let mut random = Random::new(9400 + seed);
        let offset = RigidShift { rotation: random.rotation(), lever: Vector3::new(1.0, 0.0, 0.0) };
        let frame = TaskFrame { link: "link3", offset };
        let (z, along, across) = (Vector3::z(), Vector3::x(), Vector3::y());
        let none = Vector3::zeros();
        let turn = direction(&frame, z, none);
        let (slide, swing) = (direction(&frame, none, along), direction(&frame, none, across));
        let in_plane = [turn, slide, swing].concat();
        let stretched = [0.7, 0.0, 0.0, 0.0];
        let bent = [0.7, 0.4, -0.9, 0.3];

        for (q, rank) in [(stretched, 2), (bent, 3)] {
            let (exact, bound) = dense(scene.source(), &q, &[frame]);
            assert_near("planar arm", &inverse_inertia(&scene, &q, &[frame]), &exact, bound);
            // All six directions: three are out of the plane, zero up to rounding in this frame.
            let error = inertia(&scene, &q, &[frame], None).unwrap_err();
            let expected = Error::SingularTask { links: vec!["link3".into()], rank, directions: 6, state: None };
            assert_eq!(error, expected, "seed {seed}");
        }
        let error = inertia(&scene, &stretched, &[frame], Some(&in_plane)).unwrap_err();
        let expected = Error::SingularTask { links: vec!["link3".into()], rank: 2, directions: 3, state: None };
        assert_eq!(error, expected, "seed {seed}");
        let message = error.in_state(5).to_string();
        assert!(message.contains("task of link \"link3\" in state 5: found an inverse inertia of rank 2"), "{message}");
        assert!(message.contains("operational_inverse_inertia") && message.contains("remove directions"), "{message}");

        // Fewer directions for the stretched arm, all of the plane for the bent one.
        for (q, s) in [(stretched, [turn, swing].concat()), (bent, in_plane)] {
            let found = inertia(&scene, &q, &[frame], Some(&s)).unwrap();
            assert_inverse(&found, &inverse_inertia(&scene, &q, &[frame]), &s);
        }
    }
}

/// A frame that long offsets bring back onto the axis of the only hinge: its zero velocity is accurate to the
/// rounding of the terms of the offsets, not of their difference.
#[test]
fn a_direction_lost_in_the_rounding_of_levers_is_singular() {
    for seed in 0..12 {
        let mut random = Random::new(9600 + seed);
        let (axis, rotation) = (random.vector().normalize(), random.rotation());
        let lever = axis.cross(&random.vector()).normalize() * 1e4;
        let mut hinge = JointDescription::new("hinge", JointKind::Revolute, "base", "light");
        hinge.axis = axis;
        let mut slide = JointDescription::new("slide", JointKind::Prismatic, "light", "far");
        slide.origin = RigidShift { rotation, lever };
        slide.axis = rotation.transpose() * axis;
        slide.armature = 1.0;
        let mut back = JointDescription::new("back", JointKind::Prismatic, "far", "near");
        back.origin.lever = -(rotation.transpose() * lever);
        back.axis = slide.axis;
        back.armature = 1.0;
        let scene = SceneBuilder::new()
            .link(LinkDescription { name: "base".into(), inertial: None })
            .link(LinkDescription { name: "light".into(), inertial: Some(random_inertial(&mut random)) })
            .link(LinkDescription { name: "far".into(), inertial: None })
            .link(LinkDescription { name: "near".into(), inertial: None })
            .joint(hinge)
            .joint(slide)
            .joint(back)
            .build()
            .unwrap();
        let turned = RigidShift { rotation: random.rotation(), lever: Vector3::zeros() };
        let offset = RigidShift { lever: -(rotation.transpose() * lever), ..turned };
        let far = TaskFrame { link: "far", offset };
        let near = TaskFrame { link: "near", offset: turned };
        let (along, none) = (rotation.transpose() * axis, Vector3::zeros());
        let across = rotation.transpose() * lever.normalize();
        let swing = along.cross(&across);
        let q = [0.4, 0.3, -0.2];
        for frame in [far, near] {
            let (turn, rise) = (direction(&frame, along, none), direction(&frame, none, along));
            let possible = [turn, rise].concat();
            let found = inertia(&scene, &q, &[frame], Some(&possible)).unwrap();
            assert_inverse(&found, &inverse_inertia(&scene, &q, &[frame]), &possible);
            for lost in [swing, across] {
                let s = [turn, rise, direction(&frame, none, lost)].concat();
                let error = inertia(&scene, &q, &[frame], Some(&s)).unwrap_err();
                assert!(matches!(error, Error::SingularTask { rank: 2, directions: 3, .. }), "seed {seed}: {error}");
            }
        }
    }
}

/// `found` (S Omega S^T) = 1, and `found` is symmetric with a positive diagonal.
#[track_caller]
fn assert_inverse(found: &[f64], omega: &[f64], s: &[f64]) {
    let wide = omega.len().isqrt();
    let k = s.len() / wide;
    let s = DMatrix::from_row_slice(k, wide, s);
    let product = &s * DMatrix::from_row_slice(wide, wide, omega) * s.transpose();
    let inverse = DMatrix::from_row_slice(k, k, found);
    assert_eq!(inverse, inverse.transpose());
    assert!(inverse.diagonal().iter().all(|&x| x > 0.0));
    let cond = conditioning(k, product.as_slice()).number;
    let identity = DMatrix::<f64>::identity(k, k);
    assert_near("inertia", (&inverse * &product).as_slice(), identity.as_slice(), tolerance::inverse(cond, 1.0));
}

/// A link that moves freely in all directions has an inertia: on a floating base it is that of the base and its
/// outboard links.
#[test]
fn free_links_have_an_inertia() {
    let kinds = [JointKind::Floating, JointKind::Spherical];
    for seed in 0..8 {
        let scene = Tree { seed, bodies: 4, kinds: &kinds, branching: 0.5, armature: 0.0, floating: true }.scene();
        let mut random = Random::new(9500 + seed);
        let (q, ..) = random_state(&scene, &mut random);
        let frame = random_frame(&scene, &mut random);
        let found = inertia(&scene, &q, &[frame], None).unwrap();
        let identity: Vec<f64> = DMatrix::<f64>::identity(6, 6).iter().copied().collect();
        assert_inverse(&found, &inverse_inertia(&scene, &q, &[frame]), &identity);
    }
    // A single body: its own inertia, rotational part and mass.
    let body = random_inertial(&mut Random::new(1));
    let mut builder = SceneBuilder::new().floating_base(true);
    builder = builder.link(LinkDescription { name: "body".into(), inertial: Some(body) });
    let scene = builder.build().unwrap();
    let at_center = TaskFrame { link: "body", offset: RigidShift { lever: body.center, ..RigidShift::identity() } };
    let found = inertia(&scene, &scene.neutral(), &[at_center], None).unwrap();
    let central = body.central.to_matrix();
    for (at, value) in found.iter().enumerate() {
        let (i, j) = (at / 6, at % 6);
        let exact = match (i < 3, j < 3) {
            (true, true) => central[(i, j)],
            (false, false) if i == j => body.mass,
            _ => 0.0,
        };
        // Condition number in these units.
        let cond = body.mass / central.symmetric_eigenvalues().min();
        tolerance::assert_close("rigid body", *value, exact, tolerance::inverse(cond, body.mass));
    }
}

#[test]
fn frames_on_the_base_do_not_move() {
    let scene = planar_arm(2, 0);
    let q = [0.3, 0.4];
    let base = ["base".into()];
    assert!(inverse_inertia(&scene, &q, &base).iter().all(|&x| x == 0.0));
    let error = inertia(&scene, &q, &base, None).unwrap_err();
    assert_eq!(error, Error::SingularTask { links: vec!["base".into()], rank: 0, directions: 6, state: None });
    // Also if no joint moves.
    let welded = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None }).build().unwrap();
    assert!(inverse_inertia(&welded, &[], &base).iter().all(|&x| x == 0.0));
}

#[test]
fn armature_makes_a_massless_tip_defined_and_its_absence_is_told() {
    let mut builder = planar_arm(2, 3).source().clone();
    let mut joint = JointDescription::new("wrist", JointKind::Revolute, "link1", "needle");
    joint.armature = 0.1;
    builder = builder.link(LinkDescription { name: "needle".into(), inertial: None });
    let driven = builder.clone().joint(joint.clone()).build().unwrap();
    let q = [0.3, 0.4, 0.5];
    let (exact, bound) = dense(driven.source(), &q, &["needle".into()]);
    assert_near("driven needle", &inverse_inertia(&driven, &q, &["needle".into()]), &exact, bound);
    joint.armature = 0.0;
    let loose = builder.joint(joint).build().unwrap();
    let (mut workspace, mut scratch) = (loose.workspace(), loose.operational_scratch());
    let mut out = [f64::NAN; 36];
    let error = loose.operational_inverse_inertia(&mut workspace, &mut scratch, &q, &["needle"], &mut out).unwrap_err();
    assert!(matches!(&error, Error::SingularJoint { joint, .. } if joint == "wrist"), "{error}");
}

/// The kernel allocates nothing, a call by names allocates nothing after the first one; neither reads values of a
/// previous call.
#[test]
fn nothing_is_allocated_and_nothing_is_stale() {
    let scene = planar_arm(5, 1);
    let q = [0.3, -0.4, 0.5, 0.6, 0.7];
    let links = ["link1", "link4", "base"];
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    let mut fresh = vec![f64::NAN; 36 * 9];
    scene.operational_inverse_inertia(&mut workspace, &mut scratch, &q, &links, &mut fresh).unwrap();
    let mut again = vec![f64::NAN; 36 * 9];
    let mut other = vec![f64::NAN; 36];
    scene.operational_inverse_inertia(&mut workspace, &mut scratch, &[1.0; 5], &["link2"], &mut other).unwrap();
    let seen = allocation_counter::measure(|| {
        scene.operational_inverse_inertia(&mut workspace, &mut scratch, &q, &links, &mut again).unwrap();
    });
    assert_eq!(seen.count_total, 0);
    assert_eq!(fresh, again);
    let frames = [Frame { body: Some(4), placement: RigidShift::identity() }];
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    let seen = allocation_counter::measure(|| {
        dynamics::operational_inverse_inertia(scene.model(), &mut workspace, &mut scratch, &q, &frames, &mut other);
    });
    assert_eq!(seen.count_total, 0);
}

/// One broken argument of both methods; the message begins as given.
#[track_caller]
fn refused(q: &[f64], frames: &[TaskFrame<'_>], s: Option<&[f64]>, message: &str) {
    let scene = planar_arm(3, 2);
    let error = inertia(&scene, q, frames, s).unwrap_err().to_string();
    assert!(error.starts_with(message), "{error}");
}

const Q: [f64; 3] = [0.1, 0.2, 0.3];

#[test]
fn the_call_that_the_others_break_is_valid() {
    let s = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    assert_eq!(inertia(&planar_arm(3, 2), &Q, &["link2".into()], Some(&s)).map(|out| out.len()), Ok(1));
}

#[test]
fn an_unknown_link() {
    refused(&Q, &["hand".into()], None, "link: found \"hand\"; expected one of \"base\"");
}

#[test]
fn no_link() {
    let scene = planar_arm(3, 2);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    let none: [&str; 0] = [];
    let error = scene.operational_inverse_inertia(&mut workspace, &mut scratch, &Q, &none, &mut []).unwrap_err();
    assert_eq!(error.to_string(), "links: found none; expected at least one link");
}

#[test]
fn a_short_configuration() {
    refused(&[0.1, 0.2], &["link2".into()], None, "q: found shape (2,); expected (3,)");
}

#[test]
fn a_configuration_that_is_not_finite() {
    refused(&[0.1, f64::NAN, 0.2], &["link2".into()], None, "q: found NaN at index 1");
}

#[test]
fn a_frame_that_is_no_rotation() {
    let mut offset = RigidShift::identity();
    offset.rotation[(0, 0)] = 1.001;
    let frame = TaskFrame { link: "link2", offset };
    refused(
        &Q,
        &[frame],
        None,
        "rotation of the task frame on link \"link2\": found a matrix R for which R^T R differs from the identity",
    );
}

#[test]
fn a_frame_that_is_a_reflection() {
    let offset = RigidShift { rotation: -nalgebra::Matrix3::identity(), lever: Vector3::zeros() };
    let frame = TaskFrame { link: "link2", offset };
    refused(&Q, &[frame], None, "rotation of the task frame on link \"link2\": found a reflection");
}

#[test]
fn a_frame_that_is_not_finite() {
    let offset = RigidShift { lever: Vector3::new(0.0, f64::INFINITY, 0.0), ..RigidShift::identity() };
    refused(
        &Q,
        &[TaskFrame { link: "link2", offset }],
        None,
        "xyz of the task frame on link \"link2\": found inf at index 1",
    );
}

#[test]
fn directions_of_another_width() {
    let scene = planar_arm(3, 2);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    for s in [&[1.0; 5][..], &[]] {
        let error =
            scene.operational_inertia(&mut workspace, &mut scratch, &Q, &["link2"], Some(s), &mut [0.0]).unwrap_err();
        assert!(error.to_string().starts_with(&format!("directions: found shape ({},); expected (k * 6,)", s.len())));
    }
}

#[test]
fn directions_that_are_not_finite() {
    let s = [0.0, 0.0, 1.0, f64::NAN, 0.0, 0.0];
    refused(&Q, &["link2".into()], Some(&s), "directions: found NaN at index 3");
}

#[test]
fn room_for_another_result() {
    let scene = planar_arm(3, 2);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    let error =
        scene.operational_inverse_inertia(&mut workspace, &mut scratch, &Q, &["link2"], &mut [0.0; 35]).unwrap_err();
    assert_eq!(error.to_string(), "out: found shape (35,); expected (36,)");
}
