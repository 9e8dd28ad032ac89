//! Methods of `Scene`: products with the Jacobians of the dynamics, without the matrices.

use super::axis::Axis;
use super::call::Call;
use super::choice::{items, read_form};
use super::cost::Cost;
use super::errors::asked_by;
use super::input::Input;
use super::object::{Object, imported};
use super::output::{Output, part};
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::algorithm::{Algorithm, Arguments, Products};
use crate::batch::Broadcast;
use crate::dynamics::derivatives::{ConstantParts, GradientParts, Parameters, of_body, of_link};
use crate::error::{Error, check_finite};
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple};

/// Rough times of one body in one state, ns (see [`Cost`]).
mod cost {
    /// Of torques, in lanes.
    pub const INVERSE: usize = 120;
    /// With the factor of M.
    pub const FORWARD: usize = 250;
    /// On dual numbers.
    pub const HESSIAN: usize = 2500;
}

/// Where a link is: the moving body that carries it, and its placement there.
pub(super) type Place = (Option<usize>, RigidShift<f64>);

/// Gradients by the parameters of links, each in its own frame, from those of the bodies that carry them.
pub(super) fn parameters_of(links: &[Place], bodies: &[Parameters<f64>]) -> impl Iterator<Item = Parameters<f64>> {
    links.iter().map(|(body, placement)| body.map_or([0.0; 10], |body| of_link(placement, &bodies[body])))
}

/// Where every link is that a joint carries, in the order of the joints.
pub(super) fn places_of_links(scene: &Scene) -> Result<Vec<Place>, Error> {
    scene.joints().iter().map(|joint| scene.link(&joint.child).map(|link| (link.body, link.placement))).collect()
}

/// q, qd and the third with its name, then a direction or a cotangent.
type Given<'a, 'py> = Vec<(&'static str, &'a Object<'py>)>;

/// What a call may have been given beside these.
struct Keywords<'a, 'py> {
    wrenches: Option<&'a Object<'py>>,
    errors: &'a str,
    tolerance: Option<f64>,
}

#[pymethods]
impl PyScene {
    /// The change of joint torques along a direction, in O(N) and without any matrix: dtau_dq dq + dtau_dqd dqd + M dqdd.
    ///
    /// q: (..., nq); qd, qdd: (..., nv); dq, dqd, dqdd: (..., nv), dq in the tangent space of q; SI units, radians; leading axes broadcast. wrenches and errors: as
    /// in forward_dynamics; wrenches stay as they are in their link's frame.
    ///
    /// dq is a change as integrate(q, dq) adds it: an angle or a length for joints of one axis, a rotation in the child's frame for spherical joints,
    /// (linear, angular) in the child's frame for free joints. Armature is in M.
    ///
    /// What is constant may change too, as inverse_dynamics_vjp has it: dwrenches, a dict from link names to (..., 6); dparameters, (..., bodies, 10); darmature, (..., nv);
    /// dgravity, (..., 3).
    ///
    /// Returns dtau, (..., nv), N m or N.
    ///
    /// Raises ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, qdd, dq, dqd, dqdd, *, wrenches=None, dwrenches=None, dparameters=None, darmature=None, dgravity=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics_jvp<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        dq: &Object<'py>,
        dqd: &Object<'py>,
        dqdd: &Object<'py>,
        wrenches: Option<&Object<'py>>,
        dwrenches: Option<&Object<'py>>,
        dparameters: Option<&Object<'py>>,
        darmature: Option<&Object<'py>>,
        dgravity: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let given = vec![("q", q), ("qd", qd), ("qdd", qdd), ("dq", dq), ("dqd", dqd), ("dqdd", dqdd)];
        let constants = Constant::read(&self.scene, (dwrenches, dparameters, darmature, dgravity))?;
        self.along(py, Products::InverseTangent, given, (&Keywords { wrenches, errors, tolerance: None }, constants))
    }

    /// The gradients of cotangent . tau, in O(N) and without any matrix: cotangent dtau_dq, cotangent dtau_dqd and M cotangent.
    ///
    /// q: (..., nq); qd, qdd, cotangent: (..., nv); SI units, radians; leading axes broadcast. wrenches and errors: as in forward_dynamics. parameters: whether to
    /// give the gradients by inertias, armature and gravity too.
    ///
    /// The gradient by q is in its tangent space, (..., nv), as dq in inverse_dynamics_jvp.
    ///
    /// Returns a phipsi.InverseDynamicsGradients (q, qd, qdd, wrenches, parameters, armature, gravity); what is not asked for is None.
    ///
    /// Raises as inverse_dynamics_jvp.
    #[pyo3(signature = (q, qd, qdd, cotangent, *, wrenches=None, parameters=false, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics_vjp<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        cotangent: &Object<'py>,
        wrenches: Option<&Object<'py>>,
        parameters: bool,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let given = vec![("q", q), ("qd", qd), ("qdd", qdd), ("cotangent", cotangent)];
        let class = imported!(py, "phipsi._results", "InverseDynamicsGradients")?;
        self.gradients(
            (py, class),
            Products::InverseGradient,
            given,
            (&Keywords { wrenches, errors, tolerance: None }, parameters),
        )
    }

    /// The change of joint accelerations along a direction, in O(N) and without any matrix: dqdd_dq dq + dqdd_dqd dqd + M^-1 dtau.
    ///
    /// q: (..., nq); qd, tau: (..., nv); dq, dqd, dtau: (..., nv), dq in the tangent space of q, as in inverse_dynamics_jvp; SI units, radians; leading axes
    /// broadcast. form, wrenches and errors: as in forward_dynamics; wrenches stay as they are in their link's frame. tolerance: as in
    /// forward_dynamics_derivatives.
    ///
    /// dwrenches, dparameters, darmature, dgravity: as in inverse_dynamics_jvp.
    ///
    /// One more right side of the filter, with the gains of the state. In form "auto" a state is recomputed in double-double arithmetic where the estimated error of the
    /// factor of M or of the product exceeds the tolerance.
    ///
    /// Returns dqdd, (..., nv), rad/s^2 or m/s^2.
    ///
    /// Raises SingularJointError where a joint has no inertia along its axis; ArgumentError for the square-root form of an inertia that no body can have;
    /// ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, tau, dq, dqd, dtau, *, form="auto", tolerance=None, wrenches=None, dwrenches=None, dparameters=None, darmature=None, dgravity=None,
                        errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics_jvp<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        dq: &Object<'py>,
        dqd: &Object<'py>,
        dtau: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        dwrenches: Option<&Object<'py>>,
        dparameters: Option<&Object<'py>>,
        darmature: Option<&Object<'py>>,
        dgravity: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let given = vec![("q", q), ("qd", qd), ("tau", tau), ("dq", dq), ("dqd", dqd), ("dtau", dtau)];
        let constants = Constant::read(&self.scene, (dwrenches, dparameters, darmature, dgravity))?;
        let which = Products::ForwardTangent(read_form(form)?);
        self.scene.check_tolerance(Algorithm::Products(which), tolerance)?;
        self.along(py, which, given, (&Keywords { wrenches, errors, tolerance }, constants))
    }

    /// The gradients of cotangent . qdd, in O(N) and without any matrix: cotangent dqdd_dq, cotangent dqdd_dqd and M^-1 cotangent.
    ///
    /// q: (..., nq); qd, tau, cotangent: (..., nv); SI units, radians; leading axes broadcast. form, tolerance, wrenches and errors: as in forward_dynamics_jvp. parameters: whether
    /// to give the gradients by inertias, armature and gravity too.
    ///
    /// The gradient by q is in its tangent space, (..., nv), as dq in inverse_dynamics_jvp. x = M^-1 cotangent is filter and smoother once more; all other
    /// gradients are those of inverse_dynamics_vjp at the accelerations of the state, of -x.
    ///
    /// Returns a phipsi.ForwardDynamicsGradients (q, qd, tau, wrenches, parameters, armature, gravity); what is not asked for is None.
    ///
    /// Raises as forward_dynamics_jvp.
    #[pyo3(signature = (q, qd, tau, cotangent, *, form="auto", tolerance=None, wrenches=None, parameters=false, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics_vjp<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        cotangent: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        parameters: bool,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let given = vec![("q", q), ("qd", qd), ("tau", tau), ("cotangent", cotangent)];
        let class = imported!(py, "phipsi._results", "ForwardDynamicsGradients")?;
        let which = Products::ForwardGradient(read_form(form)?);
        self.scene.check_tolerance(Algorithm::Products(which), tolerance)?;
        self.gradients((py, class), which, given, (&Keywords { wrenches, errors, tolerance }, parameters))
    }

    /// The Hessian of cotangent . tau times a direction, in O(N): how the gradients of inverse_dynamics_vjp change along (dq, dqd, dqdd).
    ///
    /// q: (..., nq); qd, qdd, cotangent, dq, dqd, dqdd: (..., nv); SI units, radians; leading axes broadcast. wrenches and errors: as in forward_dynamics.
    ///
    /// The gradient by q is that in the tangent space at q, which moves along: on spherical and free joints that Hessian is not symmetric. One state at a time,
    /// on dual numbers.
    ///
    /// Returns a phipsi.InverseDynamicsGradients (q, qd, qdd), the others None.
    ///
    /// Raises as inverse_dynamics_jvp.
    #[pyo3(signature = (q, qd, qdd, cotangent, dq, dqd, dqdd, *, wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn inverse_dynamics_hvp<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        cotangent: &Object<'py>,
        dq: &Object<'py>,
        dqd: &Object<'py>,
        dqdd: &Object<'py>,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let mut given = vec![("q", q), ("qd", qd), ("qdd", qdd), ("cotangent", cotangent)];
        given.extend([("dq", dq), ("dqd", dqd), ("dqdd", dqdd)]);
        let class = imported!(py, "phipsi._results", "InverseDynamicsGradients")?;
        self.hessian((py, class), Products::InverseGradient, given, &Keywords { wrenches, errors, tolerance: None })
    }

    /// The Hessian of cotangent . qdd times a direction, in O(N): how the gradients of forward_dynamics_vjp change along (dq, dqd, dtau).
    ///
    /// q: (..., nq); qd, tau, cotangent, dq, dqd, dtau: (..., nv); SI units, radians; leading axes broadcast. form, tolerance, wrenches and errors: as
    /// in forward_dynamics_jvp.
    ///
    /// One factor and four right sides; otherwise as inverse_dynamics_hvp.
    ///
    /// Returns a phipsi.ForwardDynamicsGradients (q, qd, tau), the others None.
    ///
    /// Raises as forward_dynamics_jvp.
    #[pyo3(signature = (q, qd, tau, cotangent, dq, dqd, dtau, *, form="auto", tolerance=None, wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn forward_dynamics_hvp<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        cotangent: &Object<'py>,
        dq: &Object<'py>,
        dqd: &Object<'py>,
        dtau: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let mut given = vec![("q", q), ("qd", qd), ("tau", tau), ("cotangent", cotangent)];
        given.extend([("dq", dq), ("dqd", dqd), ("dtau", dtau)]);
        let class = imported!(py, "phipsi._results", "ForwardDynamicsGradients")?;
        let which = Products::ForwardGradient(read_form(form)?);
        self.scene.check_tolerance(Algorithm::Products(which), tolerance)?;
        self.hessian((py, class), which, given, &Keywords { wrenches, errors, tolerance })
    }
}

impl PyScene {
    /// A call with these arguments, of so many ns a body.
    fn product_call<'a, 'py>(
        &'a self,
        which: Products,
        given: Given<'_, 'py>,
        others: Vec<Input<'py>>,
        (keywords, body): (&Keywords<'_, 'py>, usize),
    ) -> PyResult<Call<'a, 'py>> {
        let errors = self.errors(keywords.errors, which.form())?;
        let mut inputs = self.inputs(given)?;
        inputs.extend(others);
        let cost = Cost { arithmetic: body * self.size(), results: which.entry().results.len() * self.scene.nv() };
        let call = Call::new(self, inputs, Wrench::read(&self.scene, keywords.wrenches)?, cost)?;
        Ok(call.with(errors).accepting(keywords.tolerance))
    }

    /// A product along a direction, of what is constant too where any of that changes.
    fn along<'py>(
        &self,
        py: Python<'py>,
        which: Products,
        given: Given<'_, 'py>,
        (keywords, constants): (&Keywords<'_, 'py>, Vec<(Input<'py>, Constant)>),
    ) -> PyResult<Object<'py>> {
        let first = given.len();
        let body = if which.form().is_some() { cost::FORWARD } else { cost::INVERSE };
        let (inputs, constants): (Vec<_>, Vec<_>) = constants.into_iter().unzip();
        let call = self.product_call(which, given, inputs, (keywords, body))?;
        let mut output = call.output(py, &[self.scene.nv()], None, Output::unwritten)?;
        if constants.is_empty() {
            call.in_chunks(py, Algorithm::Products(which), output.numbers()?, None)?;
            return Ok(output.finish().into_any());
        }
        let which = match which.form() {
            Some(form) => Products::ForwardTangents(form),
            None => Products::InverseTangents,
        };
        let (algorithm, links) = (Algorithm::Products(which), places_of_links(&self.scene)?);
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

    /// Gradients, those by what is constant for links from those for the bodies that carry them.
    fn gradients<'py>(
        &self,
        (py, class): (Python<'py>, &Object<'py>),
        which: Products,
        given: Given<'_, 'py>,
        (keywords, parameters): (&Keywords<'_, 'py>, bool),
    ) -> PyResult<Object<'py>> {
        let (scene, nv) = (&self.scene, self.scene.nv());
        let names = match keywords.wrenches.map(|wrenches| wrenches.cast::<PyMapping>()) {
            Some(Ok(mapping)) => {
                items("wrenches", mapping, "names of links")?.into_iter().map(|(name, _)| name).collect()
            }
            // Refused with the other arguments.
            _ => Vec::new(),
        };
        let body = if which.form().is_some() { cost::FORWARD } else { cost::INVERSE };
        let call = self.product_call(which, given, Vec::new(), (keywords, body))?;
        if !parameters && names.is_empty() {
            let mut output = call.output(py, &[3, nv], None, Output::unwritten)?;
            call.in_chunks(py, Algorithm::Products(which), output.numbers()?, None)?;
            let all = output.finish().into_any();
            return class.call1((part(&all, 1, 0)?, part(&all, 1, 1)?, part(&all, 1, 2)?));
        }
        let place = |name: &str| scene.link(name).map(|link| (link.body, link.placement));
        let wrenched = names.iter().map(|name| place(name)).collect::<Result<Vec<Place>, Error>>()?;
        let moving = if parameters { places_of_links(scene)? } else { Vec::new() };
        let which = match which.form() {
            Some(form) => Products::ForwardGradients(form),
            None => Products::InverseGradients,
        };
        let algorithm = Algorithm::Products(which);
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

    /// A Hessian times a direction, one state at a time.
    fn hessian<'py>(
        &self,
        (py, class): (Python<'py>, &Object<'py>),
        which: Products,
        given: Given<'_, 'py>,
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let nv = self.scene.nv();
        let call = self.product_call(which, given, Vec::new(), (keywords, cost::HESSIAN))?;
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
        call.parts((py, class), results.numbers()?, &vec![vec![nv]; 3], &[])
    }
}

/// Something constant that changes along a direction.
enum Constant {
    /// A wrench on a link.
    Wrench(Place),
    /// The inertial parameters of all links.
    Parameters,
    Armature,
    Gravity,
}

/// Of wrenches, parameters, armature and gravity.
type Changes<'a, 'py> =
    (Option<&'a Object<'py>>, Option<&'a Object<'py>>, Option<&'a Object<'py>>, Option<&'a Object<'py>>);

impl Constant {
    /// What of them was given, with its numbers.
    fn read<'py>(scene: &Scene, given: Changes<'_, 'py>) -> PyResult<Vec<(Input<'py>, Self)>> {
        let (wrenches, parameters, armature, gravity) = given;
        let mut read = Vec::new();
        for wrench in Wrench::named("dwrenches", scene, wrenches)? {
            let (input, place) = wrench.apart();
            read.push((input, Self::Wrench(place)));
        }
        if let Some(value) = parameters {
            read.push((Input::table("dparameters", value, scene.joints().len(), 10)?, Self::Parameters));
        }
        if let Some(value) = armature {
            read.push((Input::new("darmature", value, Axis::Rates(scene))?, Self::Armature));
        }
        if let Some(value) = gravity {
            read.push((Input::new("dgravity", value, 3)?, Self::Gravity));
        }
        Ok(read)
    }

    /// Adds the change of these numbers to those of bodies.
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

/// The links that gradients are asked for, and whether their parameters, armature and gravity are.
struct Links<'a> {
    wrenched: &'a [Place],
    moving: &'a [Place],
    parameters: bool,
}

impl Links<'_> {
    /// All gradients of one state, from those of bodies: of the state, of wrenches in their links' frames, then of the links' parameters, armature and gravity.
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

impl<'py> Call<'_, 'py> {
    /// The named tuple of gradients: three of the state, then a dict of those of wrenches with these names, then what else there is; None for what there is not.
    fn parts(
        &self,
        (py, class): (Python<'py>, &Object<'py>),
        results: &[f64],
        shapes: &[Vec<usize>],
        wrenches: &[String],
    ) -> PyResult<Object<'py>> {
        let width: usize = shapes.iter().map(|shape| shape.iter().product::<usize>()).sum();
        let (mut at, mut made) = (0, Vec::with_capacity(shapes.len()));
        for shape in shapes {
            let size: usize = shape.iter().product();
            let gathered = Output::unwritten(py, &[&self.batch[..], shape].concat()).and_then(|mut output| {
                let states = results.chunks_exact(width.max(1));
                output.gather(py, size, states.map(|state| &state[at..at + size]))?;
                Ok(output.finish().into_any())
            });
            made.push(asked_by(py, &self.asking(), gathered)?);
            at += size;
        }
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
