//! Methods of `Scene`: products with the Jacobians of the dynamics, without the matrices.

use super::axis::Axis;
use super::call::BatchCall;
use super::choice::{items, read_judged};
use super::cost::Cost;
use super::description::body_names;
use super::input::Input;
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::output::{Output, three_parts};
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::algorithm::{Algorithm, Arguments, Products};
use crate::batch::Broadcast;
use crate::dynamics::derivatives::{ConstantParts, GradientParts, Parameters, of_body, of_link};
use crate::error::{Error, check_finite};
use crate::filter::Form;
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple};

/// Approximate time of a product with a Hessian per body and state, on dual numbers, ns (see [`Cost`]).
const HESSIAN: usize = 2500;

/// Place of a link: the moving body that carries it, and its pose on that body.
pub(super) type Place = (Option<usize>, RigidShift<f64>);

/// Gradients with respect to the parameters of links, each in the link frame, from those of the bodies that carry them.
pub(super) fn parameters_of(links: &[Place], bodies: &[Parameters<f64>]) -> impl Iterator<Item = Parameters<f64>> {
    const NONE: Parameters<f64> = [0.0; 10];
    let moved =
        |placement, of_body: &Parameters<f64>| if *of_body == NONE { NONE } else { of_link(placement, of_body) };
    links.iter().map(move |(body, placement)| body.map_or(NONE, |body| moved(placement, &bodies[body])))
}

/// Places of these links.
pub(super) fn places_of_links(scene: &Scene) -> Vec<Place> {
    scene.links_of_joints().map(|(body, placement)| (Some(body), placement)).collect()
}

methods! {
    /// Directional derivative of the joint torques, in O(N): dtau_dq dq + dtau_dqd dqd + M dqdd.
    #[doc = parameters!(q qd qdd dq dqd dqdd wrenches constants models errors)]
    #[doc = section!(Returns)]
    /// dtau : (..., nv) ndarray
    ///     Change of the joint torques, N m or N.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// Wrenches are constant in the frames of their links, apart from dwrenches. Armature is part of M.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, qdd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
    /// >>> dq, zero = [1.0, 0.0, -1.0], np.zeros(3)
    /// >>> product = scene.inverse_dynamics_jvp(q, qd, qdd, dq, zero, zero)
    /// >>> np.allclose(product, scene.inverse_dynamics_derivatives(q, qd, qdd).dtau_dq @ dq)
    /// True
    fn inverse_dynamics_jvp(q, qd, qdd, dq, dqd, dqdd; wrenches, dwrenches, dparameters, darmature, dgravity,
        inertias, armature, errors) => along(false);

    /// Gradients of cotangent . tau, in O(N): cotangent dtau_dq, cotangent dtau_dqd and M cotangent.
    #[doc = parameters!(q qd qdd)]
    /// cotangent : (..., nv) array_like
    ///     Gradient of a scalar function with respect to tau.
    #[doc = entries!(wrenches parameters models errors)]
    #[doc = section!(Returns)]
    /// gradients : InverseDynamicsGradients
    ///     Named tuple (q, qd, qdd, wrenches, parameters, armature, gravity); what is not requested is None. The
    ///     gradient with respect to q is in its tangent space, (..., nv).
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, qdd, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0], [1.0, 2.0, 3.0]
    /// >>> gradients = scene.inverse_dynamics_vjp(q, qd, qdd, c)
    /// >>> np.allclose(gradients.q, c @ scene.inverse_dynamics_derivatives(q, qd, qdd).dtau_dq)
    /// True
    fn inverse_dynamics_vjp(q, qd, qdd, cotangent; wrenches, parameters, inertias, armature,
        errors) => gradients(false);

    /// Directional derivative of the joint accelerations, in O(N): dqdd_dq dq + dqdd_dqd dqd + M^-1 dtau.
    #[doc = parameters!(q qd tau dq dqd dtau form tolerance_of_derivatives wrenches constants models errors)]
    #[doc = section!(Returns)]
    /// dqdd : (..., nv) ndarray
    ///     Change of the joint accelerations, rad/s^2 or m/s^2.
    #[doc = raises!(singular arguments)]
    #[doc = section!(Notes)]
    /// One more right-hand side of the filter, with the gains of the state. In form "auto", a state is recomputed in
    /// double-double arithmetic if the error estimate of the factor of M or of the product exceeds the tolerance.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0]
    /// >>> dtau, zero = [1.0, 0.0, -1.0], np.zeros(3)
    /// >>> product = scene.forward_dynamics_jvp(q, qd, tau, zero, zero, dtau)
    /// >>> np.allclose(product, scene.mass_matrix_inverse(q) @ dtau)
    /// True
    fn forward_dynamics_jvp(q, qd, tau, dq, dqd, dtau; form, tolerance, wrenches, dwrenches, dparameters, darmature,
        dgravity, inertias, armature, errors) => along(true);

    /// Gradients of cotangent . qdd, in O(N): cotangent dqdd_dq, cotangent dqdd_dqd and M^-1 cotangent.
    #[doc = parameters!(q qd tau)]
    /// cotangent : (..., nv) array_like
    ///     Gradient of a scalar function with respect to qdd.
    #[doc = entries!(form tolerance_of_derivatives wrenches parameters models errors)]
    #[doc = section!(Returns)]
    /// gradients : ForwardDynamicsGradients
    ///     Named tuple (q, qd, tau, wrenches, parameters, armature, gravity); what is not requested is None. The
    ///     gradient with respect to q is in its tangent space, (..., nv).
    #[doc = raises!(singular arguments)]
    #[doc = section!(Notes)]
    /// x = M^-1 cotangent is one more filter and smoother; the other gradients are those of inverse_dynamics_vjp at the
    /// accelerations of the state, with the cotangent -x.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, tau, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]
    /// >>> gradients = scene.forward_dynamics_vjp(q, qd, tau, c)
    /// >>> np.allclose(gradients.q, c @ scene.forward_dynamics_derivatives(q, qd, tau).dqdd_dq)
    /// True
    fn forward_dynamics_vjp(q, qd, tau, cotangent; form, tolerance, wrenches, parameters, inertias, armature,
        errors) => gradients(true);

    /// Hessian of cotangent . tau times a direction, in O(N): change of the gradients of inverse_dynamics_vjp.
    #[doc = parameters!(q qd qdd)]
    /// cotangent : (..., nv) array_like
    ///     Gradient of a scalar function with respect to tau.
    #[doc = entries!(dq dqd dqdd wrenches inertias errors)]
    #[doc = section!(Returns)]
    /// product : InverseDynamicsGradients
    ///     Changes of the gradients with respect to q, qd and qdd, each (..., nv); the other fields are None.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// Evaluated on dual numbers, one state at a time. The gradient with respect to q is that in the tangent space of
    /// the moving q, so the Hessian of spherical and free joints is not symmetric.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, qdd, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0], [1.0, 2.0, 3.0]
    /// >>> dq, zero = np.array([1.0, 0.0, -1.0]), np.zeros(3)
    /// >>> product = scene.inverse_dynamics_hvp(q, qd, qdd, c, dq, zero, zero)
    /// >>> ahead, behind = (scene.inverse_dynamics_vjp(q + h * dq, qd, qdd, c).q for h in (1e-6, -1e-6))
    /// >>> np.allclose(product.q, (ahead - behind) / 2e-6)
    /// True
    fn inverse_dynamics_hvp(q, qd, qdd, cotangent, dq, dqd, dqdd; wrenches, inertias, errors) => hessian(false);

    /// Hessian of cotangent . qdd times a direction, in O(N): change of the gradients of forward_dynamics_vjp.
    #[doc = parameters!(q qd tau)]
    /// cotangent : (..., nv) array_like
    ///     Gradient of a scalar function with respect to qdd.
    #[doc = entries!(dq dqd dtau form tolerance_of_derivatives wrenches models errors)]
    #[doc = section!(Returns)]
    /// product : ForwardDynamicsGradients
    ///     Changes of the gradients with respect to q, qd and tau, each (..., nv); the other fields are None.
    #[doc = raises!(singular arguments)]
    #[doc = section!(Notes)]
    /// One factor and four right-hand sides, then dual numbers; otherwise as inverse_dynamics_hvp. Includes the
    /// connections of the scene.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, tau, c = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0]
    /// >>> dtau, zero = [1.0, 0.0, -1.0], np.zeros(3)
    /// >>> product = scene.forward_dynamics_hvp(q, qd, tau, c, zero, zero, dtau)
    /// >>> np.allclose(product.tau, 0.0)     # qdd is linear in tau
    /// True
    fn forward_dynamics_hvp(q, qd, tau, cotangent, dq, dqd, dtau; form, tolerance, wrenches, inertias, armature,
        errors) => hessian(true);
}

/// The named tuple of the gradients of forward or inverse dynamics.
fn class_of_gradients(py: Python<'_>, is_solved: bool) -> PyResult<&Object<'_>> {
    if is_solved {
        imported!(py, "phipsi._results", "ForwardDynamicsGradients")
    } else {
        imported!(py, "phipsi._results", "InverseDynamicsGradients")
    }
}

impl PyScene {
    /// The form of a product of forward dynamics; None for those of inverse dynamics.
    fn form_of_product(&self, is_solved: bool, keywords: &Keywords<'_, '_>) -> Result<Option<Form>, Error> {
        let algorithm = |form| Algorithm::Products(Products::tangent(Some(form)));
        let form = read_judged(&self.scene, (keywords.form, keywords.tolerance), algorithm);
        is_solved.then_some(form).transpose()
    }

    /// Creates a call with these arguments, of `body` ns per body.
    fn product_call<'a, 'py>(
        &'a self,
        which: Products,
        given: &[&Object<'py>],
        others: Vec<Input<'py>>,
        (keywords, body): (&Keywords<'_, 'py>, usize),
    ) -> PyResult<BatchCall<'a, 'py>> {
        let errors = self.errors(keywords.errors, which.form())?;
        // Of a Hessian the direction follows the cotangent.
        let direction = Products::tangent(which.form()).entry().seeds();
        let names = which.entry().arguments.iter().chain(direction).map(|&(name, _)| name);
        let mut inputs = self.inputs(names.zip(given.iter().copied()))?;
        inputs.extend(others);
        let through = if which.form().is_some() && !self.scene.connections().is_empty() {
            self.cost_through_connections()
        } else {
            0
        };
        let cost =
            Cost { arithmetic: (body + through) * self.size(), results: which.entry().results.len() * self.scene.nv() };
        let models = keywords.models(&self.scene)?;
        let call = BatchCall::of_models(self, inputs, Wrench::read(&self.scene, keywords.wrenches)?, models, cost)?;
        Ok(call.with(errors).accepting(keywords.tolerance))
    }

    /// Directional derivative, including changes of constants.
    fn along<'py>(
        &self,
        py: Python<'py>,
        is_solved: bool,
        given: [&Object<'py>; 6],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let first = given.len();
        let (inputs, constants): (Vec<_>, Vec<_>) = Constant::read(&self.scene, keywords)?.into_iter().unzip();
        let which = Products::tangent(self.form_of_product(is_solved, keywords)?);
        let call = self.product_call(which, &given, inputs, (keywords, which.entry().cost[0]))?;
        let mut output = call.output(py, &[self.scene.nv()], None, Output::unwritten)?;
        if constants.is_empty() {
            call.in_chunks(py, Algorithm::Products(which), output.numbers()?, None)?;
            return Ok(output.finish().into_any());
        }
        let (algorithm, links) = (Algorithm::Products(which.with_constants()), places_of_links(&self.scene));
        let (nv, width) = (self.scene.nv(), self.scene.seed_width(algorithm, 2));
        let third = |arguments: &[Broadcast<'_>], state: usize, third: &mut Vec<f64>| {
            third.clear();
            third.resize(width, 0.0);
            third[..nv].copy_from_slice(arguments[5].state(state));
            let mut changes = ConstantParts::of(&mut third[nv..], nv, self.scene.model().bodies.len());
            for (k, constant) in constants.iter().enumerate() {
                constant.change(arguments[first + k].state(state), &mut changes, &links)?;
            }
            Ok(())
        };
        call.seeded_in_chunks(py, algorithm, &third, output.numbers()?)?;
        Ok(output.finish().into_any())
    }

    /// Gradients; those with respect to constants of links follow from those of the bodies that carry them.
    fn gradients<'py>(
        &self,
        py: Python<'py>,
        is_solved: bool,
        given: [&Object<'py>; 4],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let (scene, nv, parameters) = (&self.scene, self.scene.nv(), keywords.parameters);
        let which = Products::gradient(self.form_of_product(is_solved, keywords)?);
        let class = class_of_gradients(py, is_solved)?;
        let names = match keywords.wrenches.map(|wrenches| wrenches.cast::<PyMapping>()) {
            Some(Ok(mapping)) => {
                items("wrenches", mapping, "names of links")?.into_iter().map(|(name, _)| name).collect()
            }
            // Invalid shapes are reported with the other arguments.
            _ => Vec::new(),
        };
        let call = self.product_call(which, &given, Vec::new(), (keywords, which.entry().cost[0]))?;
        if !parameters && names.is_empty() {
            let mut output = call.output::<f64>(py, &[3, nv], None, Output::unwritten)?;
            call.in_chunks(py, Algorithm::Products(which), output.numbers()?, None)?;
            let all = output.finish().into_any();
            return class.call1(three_parts(&all, 1)?);
        }
        let place = |name: &str| scene.link(name).map(|link| (link.body, link.placement));
        let wrenched = names.iter().map(|name| place(name)).collect::<Result<Vec<Place>, Error>>()?;
        let moving = if parameters { places_of_links(scene) } else { Vec::new() };
        let algorithm = Algorithm::Products(which.with_constants());
        let mut of_bodies = call.scratch_results(py, scene.width(algorithm))?;
        call.in_chunks(py, algorithm, of_bodies.numbers()?, None)?;
        let mut shapes = vec![vec![nv]; 3];
        shapes.extend(names.iter().map(|_| vec![6]));
        if parameters {
            shapes.extend([vec![moving.len(), 10], vec![nv], vec![3]]);
        }
        let width = shapes.iter().map(|shape| shape.iter().product::<usize>()).sum();
        let mut results = call.scratch_results(py, width)?;
        let links = Links { wrenched: &wrenched, moving: &moving, parameters };
        let bodies = &mut *of_bodies.numbers()?;
        let each = bodies.chunks_exact_mut(scene.width(algorithm).max(1));
        for (of_bodies, out) in each.zip(results.numbers()?.chunks_exact_mut(width.max(1))) {
            links.gradients(&GradientParts::of(of_bodies, nv, scene.model().bodies.len()), out);
        }
        call.parts((py, class), results.numbers()?, &shapes, &names)
    }

    /// Hessian times a direction, one state at a time.
    fn hessian<'py>(
        &self,
        py: Python<'py>,
        is_solved: bool,
        given: [&Object<'py>; 7],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let nv = self.scene.nv();
        let which = Products::gradient(self.form_of_product(is_solved, keywords)?);
        let call = self.product_call(which, &given, Vec::new(), (keywords, HESSIAN))?;
        let mut results = call.scratch_results(py, 3 * nv)?;
        call.numbers(py, results.numbers()?, |scene, scratch, [q, qd, u, cotangent, dq, dqd, du], out| {
            let (workspace, hessian, wrenches) = scratch.for_hessians(scene);
            let state = Arguments { q, qd, u, wrenches, seed: [cotangent, &[], &[]], ..Arguments::default() };
            match which.form() {
                Some(form) => {
                    workspace.form = form;
                    scene.forward_dynamics_hvp(workspace, hessian, &state, [dq, dqd, du], out)
                }
                None => scene.inverse_dynamics_hvp(hessian, &state, [dq, dqd, du], out),
            }
        })?;
        call.parts((py, class_of_gradients(py, is_solved)?), results.numbers()?, &vec![vec![nv]; 3], &[])
    }
}

/// Constant of the scene or the call that changes along a direction.
enum Constant {
    /// Wrench on a link.
    Wrench(Place),
    /// Inertial parameters of all links.
    Parameters,
    Armature,
    Gravity,
}

impl Constant {
    /// Reads the changes that are given.
    fn read<'py>(scene: &Scene, keywords: &Keywords<'_, 'py>) -> PyResult<Vec<(Input<'py>, Self)>> {
        let mut read = Vec::new();
        for wrench in Wrench::named("dwrenches", scene, keywords.dwrenches)? {
            let (input, place) = wrench.apart();
            read.push((input, Self::Wrench(place)));
        }
        if let Some(value) = keywords.dparameters {
            read.push((Input::table("dparameters", value, body_names(scene).len(), 10)?, Self::Parameters));
        }
        if let Some(value) = keywords.darmature {
            read.push((Input::new("darmature", value, Axis::Rates(scene))?, Self::Armature));
        }
        if let Some(value) = keywords.dgravity {
            read.push((Input::new("dgravity", value, 3)?, Self::Gravity));
        }
        Ok(read)
    }

    /// Adds a change to the changes of bodies.
    fn change(&self, numbers: &[f64], changes: &mut ConstantParts<'_, f64>, links: &[Place]) -> Result<(), Error> {
        match self {
            Self::Wrench((body, placement)) => {
                check_finite("dwrenches", numbers)?;
                let Some(body) = *body else { return Ok(()) };
                let force = placement.force_to_parent(&SpatialVector::from_column_slice(numbers));
                for (sum, more) in changes.wrenches[body].iter_mut().zip(&force) {
                    *sum += more;
                }
            }
            Self::Parameters => {
                check_finite("dparameters", numbers)?;
                for ((body, placement), own) in links.iter().zip(numbers.as_chunks::<10>().0) {
                    let Some(body) = *body else { continue };
                    for (sum, more) in changes.parameters[body].iter_mut().zip(of_body(placement, own)) {
                        *sum += more;
                    }
                }
            }
            Self::Armature => changes.armature.copy_from_slice(numbers),
            Self::Gravity => changes.gravity.copy_from_slice(numbers),
        }
        Ok(())
    }
}

/// Links of the requested gradients, and whether those of parameters, armature and gravity are requested.
struct Links<'a> {
    wrenched: &'a [Place],
    moving: &'a [Place],
    parameters: bool,
}

impl Links<'_> {
    /// Writes all gradients of one state from those of bodies: state, wrenches in their link frames, parameters of the
    /// links, armature and gravity.
    fn gradients(&self, bodies: &GradientParts<'_, f64>, out: &mut [f64]) {
        let (of_state, rest) = out.split_at_mut(bodies.state.len());
        let (of_wrenches, rest) = rest.split_at_mut(6 * self.wrenched.len());
        of_state.copy_from_slice(bodies.state);
        for (to, (body, placement)) in of_wrenches.chunks_exact_mut(6).zip(self.wrenched) {
            let on_body = body.map_or([0.0; 6], |body| bodies.constants.wrenches[body]);
            to.copy_from_slice(placement.motion_to_child(&on_body.into()).as_slice());
        }
        if !self.parameters {
            return;
        }
        let (of_links, rest) = rest.split_at_mut(10 * self.moving.len());
        let (armature, gravity) = rest.split_at_mut(bodies.constants.armature.len());
        for (to, own) in of_links.chunks_exact_mut(10).zip(parameters_of(self.moving, bodies.constants.parameters)) {
            to.copy_from_slice(&own);
        }
        armature.copy_from_slice(bodies.constants.armature);
        gravity.copy_from_slice(bodies.constants.gravity);
    }
}

impl<'py> BatchCall<'_, 'py> {
    /// Creates the named tuple of gradients: three of the state, a dict of those of the wrenches, then the others; None
    /// for those not requested.
    fn parts(
        &self,
        (py, class): (Python<'py>, &Object<'py>),
        results: &[f64],
        shapes: &[Vec<usize>],
        wrenches: &[String],
    ) -> PyResult<Object<'py>> {
        let mut made = self.pieces(py, results, shapes)?;
        let mut rest = made.split_off(3);
        let last = rest.split_off(wrenches.len());
        if !wrenches.is_empty() {
            let of_wrenches = PyDict::new(py);
            for (name, gradient) in wrenches.iter().zip(rest) {
                of_wrenches.set_item(name, gradient)?;
            }
            made.push(of_wrenches.into_any());
        } else if !last.is_empty() {
            made.push(py.None().into_bound(py));
        }
        made.extend(last);
        class.call1(PyTuple::new(py, made)?)
    }
}
