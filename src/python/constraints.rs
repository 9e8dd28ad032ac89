//! Methods of `Scene.loops`: constrained dynamics.

use super::call::BatchCall;
use super::choice::read_judged;
use super::cost::Cost;
use super::errors::{refuse, warn_as};
use super::groups::PyLoops;
use super::input::Input;
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::output::Output;
use super::scene::{PyScene, slice};
use super::wrenches::Wrench;
use crate::algorithm::Algorithm;
use crate::filter::Form;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Approximate times per state, ns (see `BatchCall::new`).
mod cost {
    /// Per body: two forward dynamics, a factor, some more right-hand sides.
    pub const BODY: usize = 600;
    /// Per row and body on its path to the base.
    pub const ROW: usize = 60;
    /// Eigenvalues of an m x m matrix, divided by m^3.
    pub const CUBE: usize = 20;
    /// Forward dynamics in the compiled kernels: per body, per row and body, and of a Cholesky factorization.
    pub const FAST_BODY: usize = 250;
    pub const FAST_ROW: usize = 15;
    pub const FAST_CUBE: usize = 1;
}

methods! {
    in PyLoops;

    /// Constraint error of each row of the connections; zero if the connections are closed.
    #[doc = parameters!(q errors)]
    #[doc = section!(Returns)]
    /// error : (..., m) ndarray
    ///     Errors, rad or m; rows has the rows of each connection, angular rows first.
    #[doc = section!(Raises)]
    /// ConstraintError
    ///     A rod of length zero.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// Origins: m, in the axes of the first frame. Rotations: 2 sin(t/2) about the axis, with the angle t. Direction of
    /// an axis: the two components across it. Distance: current length minus `length`. Coupling: coordinate minus its
    /// nominal value.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> scene.loops.error([0.0, 0.1, 0.3]).round(3)
    /// array([0.2])
    fn error(q; errors) |scene, py| {
        let (shape, cost) = ([scene.scene.constraint_rows()], scene.cost_of_rows());
        scene.each(py, [("q", q)], &shape, cost, errors, |scene, _, [q], out| scene.constraint_error(q, out))
    }

    /// Constraint Jacobian J of the connections: J qd is the time derivative of error, at every q.
    #[doc = parameters!(q errors)]
    #[doc = section!(Returns)]
    /// J : (..., m, nv) ndarray
    ///     Jacobian, SI units.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(m depth) operations.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> scene.loops.jacobian([0.0, 0.1, 0.3])
    /// array([[ 0., -1.,  1.]])
    fn jacobian(q; errors) |scene, py| {
        let shape = [scene.scene.constraint_rows(), scene.scene.nv()];
        scene.each(py, [("q", q)], &shape, scene.cost_of_rows(), errors, |scene, scratch, [q], out| {
            let (workspace, rows, _) = scratch.through_connections(scene, Form::Auto);
            scene.constraint_jacobian(workspace, rows, q, out)
        })
    }

    /// Constraint bias J' qd: the second time derivative of error at zero joint accelerations.
    #[doc = parameters!(q qd errors)]
    #[doc = section!(Returns)]
    /// bias : (..., m) ndarray
    ///     Acceleration of each row, rad/s^2 or m/s^2.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N + m depth) operations.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().connect("pin", "point", "link2").build()
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> ahead, behind = (scene.loops.jacobian(q + h * qd) @ qd for h in (1e-6, -1e-6))
    /// >>> np.allclose(scene.loops.bias(q, qd), (ahead - behind) / 2e-6)
    /// True
    fn bias(q, qd; errors) |scene, py| {
        let (shape, given) = ([scene.scene.constraint_rows()], [("q", q), ("qd", qd)]);
        scene.each(py, given, &shape, scene.cost_of_rows(), errors, |scene, scratch, [q, qd], out| {
            let (workspace, rows, _) = scratch.through_connections(scene, Form::Auto);
            scene.constraint_bias(workspace, rows, q, qd, out)
        })
    }

    /// Joint accelerations and constraint forces with connections: M qdd + bias = tau + J^T f, J qdd + J' qd = 0.
    #[doc = parameters!(q qd tau compliance form tolerance wrenches models errors)]
    #[doc = section!(Returns)]
    /// dynamics : ConstrainedDynamics
    ///     Named tuple: qdd (..., nv); forces, a dict from connection names to (..., rows); rank (...) and residual
    ///     (...).
    #[doc = section!(Raises)]
    /// ConstraintError
    ///     No forces satisfy all rows (contradicting connections), or positions or velocities violate the connections
    ///     by more than 1e-3 (m or rad; relative to the fastest joint velocity above 1) without compliance. Attributes:
    ///     .connections, .residual and .state. project closes the connections.
    #[doc = entries!(singular arguments)]
    #[doc = section!(Notes)]
    /// O(N + m^2 depth + m^3) for m rows: unit forces along the rows run inward through the filter of the tree, and
    /// their Gram matrix is J M^-1 J^T. With compliance, the rows are measurements with that noise, J qdd + J' qd =
    /// -compliance f: contradicting rows compromise, and dependent rows share their force.
    ///
    /// A force acts from the connection on `link`, (moment, force) in the rows that it has, at the origin and in the
    /// axes of its first frame; the other link receives the opposite. The force of a rod is positive in compression;
    /// that of a coupling acts along its joint. If rows are dependent, qdd is unique and the forces have the least sum
    /// (J M^-1 J^T)_ii f_i^2.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> dynamics = scene.loops.dynamics([0.0, 0.1, 0.1], np.zeros(3), [0.0, 0.1, 0.0])
    /// >>> np.allclose(dynamics.qdd[1], dynamics.qdd[2]), dynamics.forces["gear"].shape
    /// (True, (1,))
    fn dynamics(q, qd, tau; compliance, form, tolerance, wrenches, inertias, armature,
        errors) |scene, py, keywords| {
        scene.scene.check_independent()?;
        let results = match keywords.compliance {
            None => scene.evaluate(py, Algorithm::ConstrainedDynamics, [q, qd, tau], keywords)?,
            Some(compliance) => scene.through_compliant_connections(py, [q, qd, tau], (compliance, keywords))?,
        };
        let nv = scene.scene.nv();
        scene.warn_of_linkage(py)?;
        imported!(py, "phipsi._results", "constrained_dynamics")?.call1((results, nv, scene.rows_by_name(py)?))
    }

    /// Joint torques and constraint forces for given joint accelerations: tau + J^T f = M qdd + bias.
    #[doc = parameters!(q qd qdd)]
    /// actuated : iterable of str or (nv,) array_like of bool, optional
    ///     Names of the actuated joints, or a mask; the torque of all others is zero. None: all joints.
    #[doc = entries!(form tolerance wrenches models errors)]
    #[doc = section!(Returns)]
    /// dynamics : ConstrainedInverseDynamics
    ///     Named tuple: tau (..., nv); forces and rank as in dynamics; residual (...), the largest entry of
    ///     J qdd + J' qd, which is not rounding if no torques cause these accelerations.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     A joint outside of `actuated` needs a torque, or an invalid argument.
    #[doc = entries!(singular arguments)]
    #[doc = section!(Notes)]
    /// If there is a choice, tau minimizes tau^T M^-1 tau: torques that do not load the connections.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> q, qd, qdd = [0.0, 0.1, 0.1], np.zeros(3), np.ones(3)
    /// >>> dynamics = scene.loops.inverse_dynamics(q, qd, qdd, actuated=["j0", "j1"])
    /// >>> float(dynamics.tau[2])
    /// 0.0
    fn inverse_dynamics(q, qd, qdd; actuated, form, tolerance, wrenches, inertias, armature,
        errors) |scene, py, keywords| {
        let form = read_judged(&scene.scene, (form, tolerance), Algorithm::MassMatrixInverse)?;
        let nv = scene.scene.nv();
        let motors = keywords.actuated.map(|actuated| scene.joint_mask("actuated", actuated)).transpose()?;
        let motors = motors.unwrap_or_default();
        let call = scene.call_by(scene.inputs([("q", q), ("qd", qd), ("qdd", qdd)])?, scene.cost_of_rows(), keywords)?;
        let call = call.with(scene.errors(errors, Some(form))?);
        let results =
            call.array(py, &[nv + scene.scene.constraint_rows() + 2], |scene, scratch, [q, qd, qdd], out| {
                let (workspace, rows, forces) = scratch.through_connections(scene, form);
                let (tau, rest) = out.split_at_mut(nv);
                let (of_rows, told) = rest.split_at_mut(scene.constraint_rows());
                let results = (tau, of_rows);
                let found =
                    scene.constrained_inverse_dynamics(workspace, rows, q, qd, qdd, forces, &motors, results)?;
                #[allow(clippy::cast_precision_loss)] // a count
                told.copy_from_slice(&[found.rank as f64, found.residual]);
                Ok(())
            })?;
        scene.warn_of_linkage(py)?;
        imported!(py, "phipsi._results", "constrained_inverse_dynamics")?.call1((results, nv, scene.rows_by_name(py)?))
    }

    /// Inverse mass matrix through the connections: M^-1 - M^-1 J^T (J M^-1 J^T)^+ J M^-1.
    #[doc = parameters!(q form tolerance models errors)]
    #[doc = section!(Returns)]
    /// inverse : (..., nv, nv) ndarray
    ///     Change of the joint accelerations per joint torque, SI units; symmetric, of rank nv minus that of J.
    #[doc = raises!(singular dense arguments)]
    #[doc = section!(Notes)]
    /// O(nv^3), as a Gram matrix without a subtraction: no eigenvalue is negative beyond rounding.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> inverse = scene.loops.mass_matrix_inverse([0.0, 0.1, 0.1])
    /// >>> np.allclose(scene.loops.jacobian([0.0, 0.1, 0.1]) @ inverse, 0.0)
    /// True
    fn mass_matrix_inverse(q; form, tolerance, inertias, armature, errors) |scene, py, keywords| {
        let form = read_judged(&scene.scene, (form, tolerance), Algorithm::MassMatrixInverse)?;
        scene.check_dense("loops.mass_matrix_inverse", "loops.dynamics, which multiplies by it")?;
        let nv = scene.scene.nv();
        let cost = scene.cost_of_rows().saturating_add(nv.saturating_pow(3));
        let call = scene.call_by([scene.configuration("q", q)?], cost, keywords)?;
        call.with(scene.errors(errors, Some(form))?).array(py, &[nv, nv], |scene, scratch, [q], out| {
            let (workspace, rows, _) = scratch.through_connections(scene, form);
            scene.constrained_mass_matrix_inverse(workspace, rows, q, out)
        }).map(Bound::into_any)
    }
}

typed_methods! {
    in PyLoops;

    /// Nearest configuration that closes the connections, and nearest joint velocities that keep them closed.
    #[doc = parameters!(q)]
    /// qd : (..., nv) array_like, optional
    ///     Joint velocities, rad/s or m/s.
    #[doc = entries!(compliance models errors)]
    #[doc = section!(Returns)]
    /// projection : Projection
    ///     Named tuple: q; qd, or None; rank (...), the number of independent rows, lower in a singular configuration.
    #[doc = section!(Raises)]
    /// ConstraintError
    ///     An error remains: no small displacement closes the connections. Attributes: .connections, .residual and
    ///     .state.
    #[doc = entries!(singular arguments)]
    #[doc = section!(Warns)]
    /// LinkageWarning
    ///     Once per scene: rows count as dependent that are not dependent within rounding, or axes of a loop are nearly
    ///     parallel.
    #[doc = section!(Notes)]
    /// Newton steps -M^-1 J^T (J M^-1 J^T)^+ error, each of least kinetic energy and at most 0.5 rad or m per joint;
    /// velocities minus M^-1 J^T (J M^-1 J^T)^+ J qd, as by an inelastic impact. With compliance, the result minimizes
    /// half the squared distance from q in the kinetic-energy metric plus the sum of error^2 / (2 compliance).
    ///
    /// Combinations of rows that move joints by less than tolerance count as dependent if the rank of the
    /// intended linkage is lower by as many: a linkage drawn with few digits keeps its mobility. Their errors remain,
    /// at most 10 times the tolerance; error has them.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> closed = scene.loops.project([0.0, 0.1, 0.3])
    /// >>> np.allclose(scene.loops.error(closed.q), 0.0)
    /// True
    fn project[&self, py: Python<'py>](
        q: &Object<'py>, qd: Option<&Object<'py>> = None; compliance: Option<&Object<'py>> = None,
        inertias: Option<&Object<'py>> = None, armature: Option<&Object<'py>> = None, errors: &str = "raise"
    ) -> PyResult<Object<'py>> {
        let of = self.as_scene();
        let (nq, nv) = (of.scene.nq(), of.scene.nv());
        let mut inputs = vec![of.configuration("q", q)?];
        inputs.extend(qd.map(|qd| of.rate("qd", qd)).transpose()?);
        let is_moving = qd.is_some();
        let given_way = inputs.len();
        inputs.extend(compliance.map(|compliance| of.compliance(compliance)).transpose()?);
        let is_compliant = compliance.is_some();
        let width = nq + if is_moving { nv } else { 0 };
        let keywords = Keywords { errors, inertias, armature, ..Keywords::none() };
        let call = of.call_by(inputs, 5 * of.cost_of_rows(), &keywords)?;
        let mut output = call.output(py, &[width + 1], None, Output::new)?;
        call.each_state(py, output.numbers()?, |scene, scratch, given, out| {
            let (workspace, rows, _) = scratch.through_connections(scene, Form::Auto);
            let (state, rank) = out.split_at_mut(width);
            let (own_q, own_qd) = state.split_at_mut(nq);
            own_q.copy_from_slice(given(0));
            if is_moving {
                own_qd.copy_from_slice(given(1));
            }
            let compliance = if is_compliant { given(given_way) } else { &[] };
            let found = scene.project_compliant(workspace, rows, own_q, is_moving.then_some(own_qd), compliance)?;
            #[allow(clippy::cast_precision_loss)] // a count
            rank.fill(found.rank as f64);
            Ok(())
        })?;
        of.warn_of_linkage(py)?;
        imported!(py, "phipsi._results", "projection")?.call1((output.finish(), nq, is_moving))
    }
}

impl PyScene {
    /// Number of rows for the argument `compliance`; an error if there are none.
    pub(super) fn compliant_rows(&self) -> PyResult<usize> {
        let rows = self.scene.constraint_rows();
        if rows == 0 {
            let found = "a value for a scene without connections";
            return refuse("compliance", found, "no compliance, or a scene with connections (SceneBuilder.connect)");
        }
        Ok(rows)
    }

    /// Reads the argument `compliance`, (..., rows).
    fn compliance<'py>(&self, compliance: &Object<'py>) -> PyResult<Input<'py>> {
        Input::spread("compliance", compliance, self.compliant_rows()?.into())
    }

    /// Warns, once per scene, about a linkage that is drawn with few digits.
    pub(super) fn warn_of_linkage(&self, py: Python<'_>) -> PyResult<()> {
        let texts = self.scene.new_linkage_warnings();
        texts.iter().try_for_each(|text| warn_as(py, "LinkageWarning", text))
    }

    /// Approximate time per body of forward dynamics with connections, ns.
    pub(super) fn cost_through_connections(&self) -> usize {
        let m = self.scene.constraint_rows();
        let rows =
            cost::FAST_ROW.saturating_mul(m) + cost::FAST_CUBE.saturating_mul(m.saturating_pow(3)) / self.size().max(1);
        cost::FAST_BODY.saturating_add(rows)
    }

    fn cost_of_rows(&self) -> usize {
        let m = self.scene.constraint_rows();
        let bodies = (cost::BODY + cost::ROW.saturating_mul(m)).saturating_mul(self.size());
        bodies.saturating_add(cost::CUBE.saturating_mul(m.saturating_pow(3)))
    }

    /// Forward dynamics with compliant connections.
    fn through_compliant_connections<'py>(
        &self,
        py: Python<'py>,
        [q, qd, tau]: [&Object<'py>; 3],
        (compliance, keywords): (&Object<'py>, &Keywords<'_, 'py>),
    ) -> PyResult<Object<'py>> {
        let form = (keywords.form, keywords.tolerance);
        let algorithm = Algorithm::ConstrainedDynamics(read_judged(&self.scene, form, Algorithm::ConstrainedDynamics)?);
        let mut inputs = self.inputs([("q", q), ("qd", qd), ("tau", tau)])?;
        inputs.push(self.compliance(compliance)?);
        let width = self.scene.width(algorithm);
        let cost = Cost { arithmetic: self.cost_through_connections() * self.size(), results: width };
        let (wrenches, models) = (Wrench::read(&self.scene, keywords.wrenches)?, keywords.models(&self.scene)?);
        let call = BatchCall::of_models(self, inputs, wrenches, models, cost)?;
        let call = call.with(self.errors(keywords.errors, algorithm.form())?).accepting(keywords.tolerance);
        let mut output = call.output::<f64>(py, &[width], None, Output::unwritten)?;
        call.in_chunks(py, algorithm, output.numbers()?, None)?;
        Ok(output.finish().into_any())
    }

    /// Creates a dict from connection names to the slices of their rows.
    fn rows_by_name<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        for (name, rows) in self.scene.rows_of_connections() {
            all.set_item(name, slice(py, &rows)?)?;
        }
        Ok(all)
    }
}
