//! A scene as the passes read it.

use super::body::{SweepBody, Turning, link_children};
use super::frames::AxisPermutation;
use super::frames::Framed;
use super::joint::Joint;
use super::load::Load;
use super::slots::{Ordered, SlotCounts, interleaved, last_children};
use crate::model::{Body, Model};
use crate::scalar::Real;
use crate::spatial::transform::{ConstantRotation, ConstantSlide, Offset};
use crate::spatial::{BodyInertia, BodyRoot};
use nalgebra::{Matrix3, Vector6};

/// The largest number of joints inward of both of two joints, averaged over all pairs, for which M^-1 is the product of
/// its factors: chains of up to 300. For deeper trees (6.1) takes fewer operations.
const SHALLOW: usize = 100;

/// For each body its own value joined with those of all bodies outboard of it.
fn with_all_outboard<V: Copy>(parents: &[Option<usize>], mut values: Vec<V>, join: impl Fn(V, V) -> V) -> Vec<V> {
    for (k, parent) in parents.iter().enumerate().rev() {
        if let Some(parent) = *parent {
            values[parent] = join(values[parent], values[k]);
        }
    }
    values
}

/// Sets the number of rows inward of each body, in the order of the rows. Returns the number of steps that M^-1 by its
/// rows takes, and the number of rows on the longest path from the base.
fn measure_paths<N, T: Real>(model: &Model<T>, bodies: &mut [SweepBody<N>]) -> (usize, usize) {
    let (mut steps, mut longest_path) = (0, 0);
    for k in 0..bodies.len() {
        let count = |k: usize| model.system.stages[k].rows.count();
        let parent = bodies[k].parent;
        bodies[k].depth = parent.map_or(0, |parent| bodies[parent].depth + count(parent));
        longest_path = longest_path.max(bodies[k].depth + count(k));
        steps += count(k) * (bodies[k].end_row - bodies[k].row).pow(2);
    }
    (steps, longest_path)
}

/// A root in the frame that the passes use for a body; NaN if there is none, or if its spin needs a force outside of
/// it, which depends on the frame.
fn root_in(frame: &Matrix3<f64>, root: Option<&BodyRoot<f64>>) -> BodyRoot<f64> {
    match root.map(|root| root.turned(frame)) {
        Some(root) if root.rest.iter().all(|&x| x == 0.0) => root,
        _ => BodyRoot::<f64>::zero().map(|_| f64::NAN),
    }
}

/// The bodies of a scene.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SweepModel<T: Real> {
    pub(in crate::dynamics) bodies: Vec<SweepBody<T::Parameter>>,
    /// Their inertias, in their own order.
    loads: Vec<Load<T>>,
    /// The bodies in the order of the passes; empty if that is their own order.
    pub(in crate::dynamics) reordered: Vec<SweepBody<T::Parameter>>,
    /// The constant rotations of oblique axes, and those of prismatic joints.
    pub(in crate::dynamics) constant_rotations: Vec<ConstantRotation<T::Parameter>>,
    pub(in crate::dynamics) slides: Vec<ConstantSlide<T::Parameter>>,
    /// The roots of the bodies, in the order of the passes: NaN for a body that has no root.
    pub(in crate::dynamics) roots: Vec<BodyRoot<T::Parameter>>,
    /// True if the passes compute the force that the spin of a body needs outside of its root; otherwise such roots are
    /// NaN.
    pub(in crate::dynamics) has_rests: bool,
    /// The bodies that are not on a revolute joint. Their frames are those of the model except for prismatic joints;
    /// those of their parents may differ.
    pub(in crate::dynamics) shifting: Vec<Body<T>>,
    /// The rotations of revolute joints, in the order of the passes.
    pub(in crate::dynamics) turning: Vec<Turning<T::Parameter>>,
    /// The numbers of slots.
    pub(in crate::dynamics) swept_slots: SlotCounts,
    /// True if M^-1 is the product of its factors.
    pub(in crate::dynamics) is_shallow: bool,
    /// Number of rows on the longest path from the base.
    pub(in crate::dynamics) longest_path: usize,
}

/// The inertias of the bodies in these frames.
fn loads<T: Real>(framed: &Model<T>) -> Vec<Load<T>> {
    framed.bodies.iter().map(|body| Load::of(&body.inertia, &body.inertia_terms)).collect()
}

/// The bodies that are not on revolute joints, and the rotations of those that are, by their places in the passes.
fn by_kind<T: Real>(framed: &Framed, whole: &Model<T>, at: &[usize]) -> (Vec<Body<T>>, Vec<Turning<T::Parameter>>) {
    let of_kind = |turns: bool| {
        let joints = framed.joints.iter().enumerate();
        joints.filter(move |(_, joint)| matches!(joint, Joint::Axial(_)) == turns).map(|(k, _)| k)
    };
    let shifting = of_kind(false).map(|k| whole.bodies[k]).collect();
    let turning_of = |k: usize| Turning {
        q: whole.bodies[k].q,
        place: at[k],
        sense: T::parameter(framed.from_model[k][(2, 2)]),
        offset: framed.angle_offsets[k].map(|offset| offset.map(T::parameter)),
    };
    let mut turning: Vec<_> = of_kind(true).map(turning_of).collect();
    turning.sort_by_key(|turning| turning.place);
    (shifting, turning)
}

/// The bodies, each with the general joint in the frame of the model.
fn general_bodies<M: Real, T: Real>(model: &Model<M>, swept: &Ordered) -> Vec<SweepBody<T::Parameter>> {
    let stages = &model.system.stages;
    let parents: Vec<_> = stages.iter().map(|stage| stage.parent).collect();
    let end_rows = stages.iter().map(|stage| stage.first_row + stage.rows.count()).collect();
    let end_row = with_all_outboard(&parents, end_rows, usize::max);
    let last_child = last_children(&parents);
    let (zero, one) = (T::parameter(0.0), T::parameter(1.0));
    let none = Offset { entries: [zero; 3], square: zero };
    let bodies = stages.iter().enumerate().map(|(k, stage)| SweepBody {
        joint: Joint::General(k),
        sense: one,
        frame: AxisPermutation::identity(one),
        index: k,
        parent: stage.parent,
        row: stage.first_row,
        offset: none,
        offset_at_parent: none,
        is_definite: false,
        hangs_on_definite: false,
        places: swept.places[k],
        is_leaf: last_child[k].is_none(),
        first_axial: 0,
        next_axial: 0,
        carries_others: false,
        depth: 0,
        end_row: end_row[k],
    });
    bodies.collect()
}

impl<T: Real> SweepModel<T> {
    /// The bodies in the order and the frames of the model, each with the general joint and its own slot: for any
    /// scalar, and for callers that read the results of every body.
    pub fn general(model: &Model<T>) -> Self {
        let parents: Vec<_> = model.system.stages.iter().map(|stage| stage.parent).collect();
        let swept = Ordered::keeping_all(&parents);
        let mut bodies = general_bodies::<T, T>(model, &swept);
        let (steps, longest_path) = measure_paths(model, &mut bodies);
        link_children(&mut bodies);
        let root = |root: &Option<BodyRoot<T>>| match root {
            Some(root) => root.map(Real::to_parameter),
            None => BodyRoot::<f64>::zero().map(|_| T::parameter(f64::NAN)),
        };
        Self {
            loads: loads(model),
            bodies,
            reordered: Vec::new(),
            constant_rotations: Vec::new(),
            slides: Vec::new(),
            roots: model.inertia_roots.iter().map(root).collect(),
            has_rests: true,
            shifting: model.bodies.clone(),
            turning: Vec::new(),
            swept_slots: swept.slots,
            is_shallow: steps <= SHALLOW * model.nv().pow(2),
            longest_path,
        }
    }

    /// The bodies in the order and the frames of the kernels, with a transform per kind of joint and reused slots. Not
    /// for scalars with [`Real::GENERAL_JOINTS`], whose passes need [`SweepModel::general`].
    pub fn new(model: &Model<f64>) -> Self {
        let framed = Framed::of(model);
        let parents: Vec<_> = model.system.stages.iter().map(|stage| stage.parent).collect();
        let order = interleaved(&parents);
        let swept = Ordered::new(&parents, &order);
        let number = T::parameter;
        let is_definite = |k: usize| model.inertia_roots[k].as_ref().is_some_and(BodyRoot::is_definite);
        let mut bodies = general_bodies::<f64, T>(model, &swept);
        for (k, body) in bodies.iter_mut().enumerate() {
            let frame = &framed.from_model[k];
            body.joint = framed.joints[k];
            (body.sense, body.frame) = (number(frame[(2, 2)]), AxisPermutation::of(frame, number));
            body.offset = Offset::new(framed.offsets_inward[k].into(), number);
            body.offset_at_parent = Offset::new(framed.bodies[k].tree.lever.into(), number);
            body.is_definite = is_definite(k);
            body.hangs_on_definite = body.parent.is_some_and(is_definite);
        }
        let (steps, longest_path) = measure_paths(model, &mut bodies);
        let root = |&k: &usize| root_in(&framed.from_model[k], model.inertia_roots[k].as_ref()).map(number);
        let whole = Model { bodies: framed.bodies.clone(), ..model.clone() }.cast::<T>();
        let (shifting, turning) = by_kind(&framed, &whole, &swept.at);
        let mut reordered: Vec<_> =
            if order.is_sorted() { Vec::new() } else { order.iter().map(|&k| bodies[k].clone()).collect() };
        link_children(if reordered.is_empty() { &mut bodies } else { &mut reordered });
        Self {
            loads: loads(&whole),
            bodies,
            constant_rotations: framed.constant_rotations.iter().map(|rotation| rotation.map(number)).collect(),
            slides: framed.slides.iter().map(|slide| slide.map(number)).collect(),
            reordered,
            roots: order.iter().map(root).collect(),
            has_rests: false,
            shifting,
            turning,
            is_shallow: steps <= SHALLOW * model.nv().pow(2),
            longest_path,
            swept_slots: swept.slots,
        }
    }

    /// Calls `each` for every pair of a row and a column outward of it, the diagonal included: row by row, and by
    /// columns.
    pub(in crate::dynamics) fn each_pair(&self, model: &Model<T>, mut each: impl FnMut(usize, usize)) {
        for (k, body) in self.bodies.iter().enumerate() {
            for row in body.row..body.row + model.system.stages[k].rows.count() {
                for column in row..body.end_row {
                    each(row, column);
                }
            }
        }
    }

    /// Sets the inertia of body `k`, in its frame in the passes, from numbers without terms that cancel.
    #[inline(always)]
    pub(crate) fn set_inertia(&mut self, k: usize, inertia: &BodyInertia<T>) {
        let ([xx, _, _, yy, _, zz], m) = (inertia.rotational.entries, inertia.mass);
        self.loads[k] = Load::of(inertia, &Vector6::new(xx, yy, zz, m, m, m));
    }

    /// From the frame of body `k` in the model to its frame in the passes.
    pub(crate) fn frame(&self, k: usize) -> &AxisPermutation<T::Parameter> {
        &self.bodies[k].frame
    }

    /// Takes the inertias of another model.
    pub(crate) fn copy_inertias(&mut self, from: &Self) {
        self.loads.clone_from_slice(&from.loads);
    }

    /// The inertia of a body.
    #[inline(always)]
    pub(in crate::dynamics) fn load(&self, body: &SweepBody<T::Parameter>) -> &Load<T> {
        &self.loads[body.index]
    }

    /// True if M^-1 is the product of its factors.
    pub fn is_shallow(&self) -> bool {
        self.is_shallow
    }

    /// The bodies in the order of the passes.
    #[inline(always)]
    pub(in crate::dynamics) fn swept(&self) -> &[SweepBody<T::Parameter>] {
        if self.reordered.is_empty() { &self.bodies } else { &self.reordered }
    }
}
