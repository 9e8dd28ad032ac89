//! Methods of `Scene`: motion through connections.

use super::call::Call;
use super::choice::{names, read_judged, read_judged_factor};
use super::cost::Cost;
use super::errors::warn_as;
use super::evaluate::Keywords;
use super::input::{Input, in_python};
use super::object::{Object, imported};
use super::output::{Array, Output};
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::algorithm::Algorithm;
use crate::error::Error;
use crate::filter::Form;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice};

/// Rough times in one state, ns (see `Call::new`).
mod cost {
    /// Of one body: two forward dynamics, a factor, some more right sides.
    pub const BODY: usize = 600;
    /// Of one row on its way through one body.
    pub const ROW: usize = 60;
    /// Of the eigenvalues of m x m, over m^3.
    pub const CUBE: usize = 20;
    /// Of forward dynamics alone, by the compiled kernels: of one body, of one row on its way through it, and of a Cholesky factor.
    pub const FAST_BODY: usize = 250;
    pub const FAST_ROW: usize = 15;
    pub const FAST_CUBE: usize = 1;
}

#[pymethods]
impl PyScene {
    /// How far each row of the connections is from holding, (..., m): the rows of one connection are those of connection_rows.
    ///
    /// q: (..., nq). errors: as in forward_dynamics. Origins in m, in the first frame's axes; rotations as 2 sin(t/2) about their axis, t the angle,
    /// which is t where it is small; of an axis the two directions across it: the first frame's x and y, turned with it the short way from z to the
    /// axis; angular rows before linear ones. A distance less its length, m; the coordinate of a joint less what it should be.
    ///
    /// Raises ConstraintError for a rod whose ends coincide; ShapeError, NotFiniteError, ArgumentError, naming the state.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn constraint_error<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> Array<'py> {
        let m = self.scene.constraint_rows();
        let call = self.call([self.configuration("q", q)?], self.cost_of_rows(), errors)?;
        call.array(py, &[m], |scene, _, [q], out| scene.constraint_error(q, out))
    }

    /// The Jacobian of the connections, (..., m, nv): J qd is the rate of constraint_error, exactly and at every q.
    ///
    /// q: (..., nq). errors: as in forward_dynamics. O(m depth), beside the zeros.
    ///
    /// Raises as constraint_error.
    #[pyo3(signature = (q, *, errors="raise"))]
    fn constraint_jacobian<'py>(&self, py: Python<'py>, q: &Object<'py>, errors: &str) -> Array<'py> {
        let (m, nv) = (self.scene.constraint_rows(), self.scene.nv());
        let call = self.call([self.configuration("q", q)?], self.cost_of_rows(), errors)?;
        call.array(py, &[m, nv], |scene, scratch, [q], out| {
            let (workspace, rows, _) = scratch.through_connections(scene, Form::Auto);
            scene.constraint_jacobian(workspace, rows, q, out)
        })
    }

    /// J' qd of the connections, (..., m): the second derivative of constraint_error where no joint accelerates.
    ///
    /// q: (..., nq); qd: (..., nv). errors: as in forward_dynamics. O(m depth).
    ///
    /// Raises as constraint_error.
    #[pyo3(signature = (q, qd, *, errors="raise"))]
    fn constraint_bias<'py>(&self, py: Python<'py>, q: &Object<'py>, qd: &Object<'py>, errors: &str) -> Array<'py> {
        let m = self.scene.constraint_rows();
        let call = self.call(self.inputs([("q", q), ("qd", qd)])?, self.cost_of_rows(), errors)?;
        call.array(py, &[m], |scene, _, [q, qd], out| scene.constraint_bias(q, qd, out))
    }

    /// Joint accelerations through the connections, and the forces of these: M qdd + bias = tau + J^T forces with J qdd + J' qd = 0.
    ///
    /// q: (..., nq); qd, tau: (..., nv). form, tolerance, wrenches, errors: as in forward_dynamics, the error being that of the tree's factor. Unit forces along the rows run inward through the tree's
    /// filter; their Gram matrix is J M^-1 J^T. O(N + m^2 depth + m^3) for m rows.
    ///
    /// compliance: how much each row gives way, (m/s^2)/N or (rad/s^2)/(N m), zero or above: one number, or (..., m) in the order of connection_rows. The rows are J qdd + J' qd =
    /// -compliance forces then, measurements with that noise: rows that contradict each other get a compromise, and rows that depend on each other share their force by it.
    ///
    /// Returns a phipsi.ConstrainedDynamics: qdd (..., nv); forces, a dict from names of connections to (..., rows); rank (...) and residual (...). A
    /// force is what the connection does to its link, (moment, force) as far as it has rows of them, at the origin of its first frame and in that
    /// frame's axes; the other link gets the opposite. That of a rod is positive where it pushes, that of a coupling acts along its joint. Where rows
    /// depend on each other, qdd is unique and the forces are those of least sum (J M^-1 J^T)_ii forces_i^2.
    ///
    /// Raises ConstraintError, with .connections, .residual and .state, where no forces meet all rows: connections that contradict each other; and
    /// where positions or velocities are further than 1e-3 from the connections (m or rad; m/s or rad/s, relative to the fastest joint where that is faster than 1; see project), unless compliance
    /// is given. Otherwise as forward_dynamics.
    #[pyo3(signature = (q, qd, tau, *, compliance=None, form="auto", tolerance=None, wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn constrained_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: &Object<'py>,
        compliance: Option<&Object<'py>>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        self.scene.check_independent()?;
        let (algorithm, tolerance) = read_judged(&self.scene, (form, tolerance), Algorithm::ConstrainedDynamics)?;
        let keywords = Keywords { wrenches, out: None, dtype: None, errors, tolerance, info: false };
        let given = [("q", q), ("qd", qd), ("tau", tau)];
        let results = match compliance {
            None => self.evaluate(py, algorithm, self.cost_through_connections(), given, &keywords)?,
            Some(compliance) => self.through_compliant_connections(py, algorithm, given, (compliance, &keywords))?,
        };
        let nv = self.scene.nv();
        self.warn_of_linkage(py)?;
        imported!(py, "phipsi._results", "constrained_dynamics")?.call1((results, nv, self.rows_by_name(py)?))
    }

    /// The configuration nearest to q that meets the connections, and the velocities nearest to qd that keep them so.
    ///
    /// q: (..., nq); qd: (..., nv) or None. errors: as in forward_dynamics. Newton steps -M^-1 J^T (J M^-1 J^T)^+ error, each of least kinetic
    /// energy, and no longer than 0.5 rad or m at any joint; velocities less M^-1 J^T (J M^-1 J^T)^+ J qd, as by an impact without rebound.
    ///
    /// compliance: how much each row gives way, as in constrained_dynamics: one number, or (..., m). The result is then where half the squared distance from q, by kinetic energy, plus
    /// the sum of error^2/(2 compliance) is least.
    ///
    /// Combinations of rows that move joints by less than Scene.tolerance, where the linkage that is meant has a rank that is lower by as many, count as dependent: a linkage that is drawn with
    /// few digits keeps its mobility. Their errors stay, at most 10 times the tolerance, and constraint_error gives them.
    ///
    /// Returns a phipsi.Projection: q, qd (None without one), and rank (...), how many rows are independent there: fewer than elsewhere where the
    /// mechanism is singular.
    ///
    /// Warns LinkageWarning, once for a scene, where rows count as dependent that are not to within rounding, and where axes of a loop miss being parallel by little more than the tolerance.
    ///
    /// Raises ConstraintError, with .connections, .residual and .state, where an error stays: no small moves from there meet the connections;
    /// SingularJointError, ShapeError, NotFiniteError, ArgumentError, naming the state.
    #[pyo3(signature = (q, qd=None, *, compliance=None, errors="raise"))]
    fn project<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: Option<&Object<'py>>,
        compliance: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (nq, nv) = (self.scene.nq(), self.scene.nv());
        let mut inputs = vec![self.configuration("q", q)?];
        inputs.extend(qd.map(|qd| self.rate("qd", qd)).transpose()?);
        let is_moving = qd.is_some();
        let given_way = inputs.len();
        inputs.extend(compliance.map(|compliance| self.compliance(compliance)).transpose()?);
        let is_compliant = compliance.is_some();
        let width = nq + if is_moving { nv } else { 0 };
        let call = self.call(inputs, 5 * self.cost_of_rows(), errors)?;
        let mut output = call.output(py, &[width + 1], None, super::output::Output::new)?;
        call.each_state(py, output.numbers()?, |scene, scratch, of, out| {
            let (workspace, rows, _) = scratch.through_connections(scene, Form::Auto);
            let (state, rank) = out.split_at_mut(width);
            let (own_q, own_qd) = state.split_at_mut(nq);
            own_q.copy_from_slice(of(0));
            if is_moving {
                own_qd.copy_from_slice(of(1));
            }
            let compliance = if is_compliant { of(given_way) } else { &[] };
            let found = scene.project_compliant(workspace, rows, own_q, is_moving.then_some(own_qd), compliance)?;
            #[allow(clippy::cast_precision_loss)] // a count
            rank.fill(found.rank as f64);
            Ok(())
        })?;
        self.warn_of_linkage(py)?;
        imported!(py, "phipsi._results", "projection")?.call1((output.finish(), nq, is_moving))
    }

    /// Joint torques, and forces of the connections, that give the accelerations: tau + J^T forces = M qdd + bias.
    ///
    /// q: (..., nq); qd, qdd: (..., nv). actuated: names of joints with motors, or a boolean array (nv,); None: all. tau is zero at the others. Where
    /// that leaves a choice, tau has the least tau^T M^-1 tau: torques that do not load the connections. wrenches, form, tolerance, errors: as in
    /// forward_dynamics.
    ///
    /// Returns a phipsi.ConstrainedInverseDynamics: tau (..., nv); forces, rank as in constrained_dynamics; residual (...), the largest entry of J
    /// qdd + J' qd: where it is not rounding, no torques give these accelerations.
    ///
    /// Raises ArgumentError, named actuated, where a joint without a motor would need a torque; otherwise as inverse_dynamics.
    #[pyo3(signature = (q, qd, qdd, *, actuated=None, form="auto", tolerance=None, wrenches=None, errors="raise"))]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn constrained_inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        qdd: &Object<'py>,
        actuated: Option<&Object<'py>>,
        form: &str,
        tolerance: Option<f64>,
        wrenches: Option<&Object<'py>>,
        errors: &str,
    ) -> PyResult<Object<'py>> {
        let (form, tolerance) = read_judged_factor(&self.scene, form, tolerance)?;
        let nv = self.scene.nv();
        let motors = actuated.map(|actuated| self.motors(actuated)).transpose()?.unwrap_or_default();
        let call = self.through_connections([("q", q), ("qd", qd), ("qdd", qdd)], wrenches, (form, errors))?;
        let call = call.accepting(tolerance);
        let results =
            call.array(py, &[nv + self.scene.constraint_rows() + 2], |scene, scratch, [q, qd, qdd], out| {
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
        self.warn_of_linkage(py)?;
        imported!(py, "phipsi._results", "constrained_inverse_dynamics")?.call1((results, nv, self.rows_by_name(py)?))
    }

    /// How torques accelerate the joints through the connections, (..., nv, nv): M^-1 - M^-1 J^T (J M^-1 J^T)^+ J M^-1, symmetric and of lower rank.
    ///
    /// q: (..., nq). form, tolerance, errors: as in forward_dynamics. A Gram matrix: nothing is subtracted, and no eigenvalue is negative beyond rounding. O(nv^3).
    ///
    /// Raises ArgumentError above 4000 degrees of freedom; otherwise as mass_matrix_inverse and constraint_error.
    #[pyo3(signature = (q, *, form="auto", tolerance=None, errors="raise"))]
    fn constrained_mass_matrix_inverse<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        form: &str,
        tolerance: Option<f64>,
        errors: &str,
    ) -> Array<'py> {
        let (form, tolerance) = read_judged_factor(&self.scene, form, tolerance)?;
        self.check_dense("constrained_mass_matrix_inverse", "constrained_dynamics, which multiplies by it")?;
        let nv = self.scene.nv();
        let cost = self.cost_of_rows().saturating_add(nv.saturating_pow(3));
        let call = self.call([self.configuration("q", q)?], cost, errors)?.with(self.errors(errors, Some(form))?);
        call.accepting(tolerance).array(py, &[nv, nv], |scene, scratch, [q], out| {
            let (workspace, rows, _) = scratch.through_connections(scene, form);
            scene.constrained_mass_matrix_inverse(workspace, rows, q, out)
        })
    }
}

impl PyScene {
    /// The number of rows that the argument compliance is for; an error where there are none.
    pub(super) fn compliant_rows(&self) -> PyResult<usize> {
        let rows = self.scene.constraint_rows();
        if rows == 0 {
            let found = "a value for a scene without connections";
            return Err(Error::argument("compliance", found, "none, or connections (SceneBuilder.connect)").into());
        }
        Ok(rows)
    }

    /// The argument compliance, (..., rows).
    fn compliance<'py>(&self, compliance: &Object<'py>) -> PyResult<Input<'py>> {
        Input::spread("compliance", compliance, self.compliant_rows()?.into())
    }

    /// Warns, once for a scene, of a linkage that is drawn with few digits.
    pub(super) fn warn_of_linkage(&self, py: Python<'_>) -> PyResult<()> {
        let texts = self.scene.new_linkage_warnings();
        texts.iter().try_for_each(|text| warn_as(py, "LinkageWarning", text))
    }

    /// Of one body in forward dynamics through connections, ns.
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

    /// Forward dynamics where rows give way.
    fn through_compliant_connections<'py>(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        given: [(&'static str, &Object<'py>); 3],
        (compliance, keywords): (&Object<'py>, &Keywords<'_, 'py>),
    ) -> PyResult<Object<'py>> {
        let mut inputs = self.inputs(given)?;
        inputs.push(self.compliance(compliance)?);
        let width = self.scene.width(algorithm);
        let cost = Cost { arithmetic: self.cost_through_connections() * self.size(), results: width };
        let call = Call::new(self, inputs, Wrench::read(&self.scene, keywords.wrenches)?, cost)?;
        let call = call.with(self.errors(keywords.errors, algorithm.form())?).accepting(keywords.tolerance);
        let mut output = call.output(py, &[width], None, Output::unwritten)?;
        call.in_chunks(py, algorithm, output.numbers()?, None)?;
        Ok(output.finish().into_any())
    }

    /// A call with a state and wrenches.
    fn through_connections<'a, 'py, const N: usize>(
        &'a self,
        given: [(&'static str, &Object<'py>); N],
        wrenches: Option<&Object<'py>>,
        (form, errors): (Form, &str),
    ) -> PyResult<Call<'a, 'py>> {
        let wrenches = Wrench::read(&self.scene, wrenches)?;
        let call = Call::new(self, self.inputs(given)?, wrenches, Cost::of(self.cost_of_rows()))?;
        Ok(call.with(self.errors(errors, Some(form))?))
    }

    /// A dict from names of connections to their rows, slices.
    fn rows_by_name<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let all = PyDict::new(py);
        for (name, rows) in self.scene.rows_of_connections() {
            all.set_item(name, PySlice::new(py, isize::try_from(rows.start)?, isize::try_from(rows.end)?, 1))?;
        }
        Ok(all)
    }

    /// Which degrees of freedom have a motor.
    fn motors(&self, actuated: &Object<'_>) -> PyResult<Vec<bool>> {
        let flags = imported!(actuated.py(), "phipsi._arguments", "flags")?;
        if let Some(mask) = in_python(flags, "actuated", actuated, self.rates())?.extract()? {
            return Ok(mask);
        }
        let mut mask = vec![false; self.scene.nv()];
        for joint in names("actuated", actuated, "names of joints, or a boolean array (nv,)")? {
            mask[self.scene.joint(&joint).map_err(|error| error.of_argument("actuated"))?.v.clone()].fill(true);
        }
        Ok(mask)
    }
}
