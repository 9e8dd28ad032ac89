//! The class `Factor`: K, L and D at one configuration or at a batch of them, and the operators they are made of.

use super::arrays::{self, Input, Output};
use super::dynamics::read_form;
use super::errors::fault;
use super::evaluate::Scratch;
use super::scene::PyScene;
use crate::batch::{Batch, Broadcast, Fault, Pool, broadcast_axes, shape_text};
use crate::error::{Error, check_finite};
use crate::filter::{FORMS, Form};
use crate::operators::dense::Composite;
use crate::operators::{Factor, KINDS, Kind, Operator};
use crate::scene::{Model, Scene};
use crate::workspace::Workspace;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyTuple;
use std::sync::{PoisonError, RwLock, RwLockReadGuard};

/// What a factor is made of anew: scene, configurations, name of the form.
type Remade<'py> = (Py<PyScene>, Bound<'py, PyAny>, &'static str);

/// The compiled half of `phipsi.operators.Factor`: applies operators by name.
#[pyclass(frozen, name = "RawFactor", module = "phipsi._core")]
pub(crate) struct PyFactor {
    scene: Py<PyScene>,
    batch: Vec<usize>,
    form: Form,
    pool: Pool<()>,
    /// Never waited for by a thread that another waits for with the GIL in hand: who holds it takes no GIL.
    state: RwLock<State>,
}

/// What an update changes.
#[derive(Clone)]
struct State {
    factors: Vec<Factor<f64>>,
    configurations: Vec<f64>,
}

impl PyFactor {
    fn model(&self) -> &Model<f64> {
        self.scene.get().scene.model()
    }

    /// Factors every configuration of q.
    fn new(scene: &Bound<'_, PyScene>, q: &Bound<'_, PyAny>, form: Form) -> PyResult<Self> {
        let (py, own) = (scene.py(), scene.get());
        let input = Input::new("q", q, own.coordinates())?;
        let batch = input.leading().to_vec();
        let factors = own.factors(py, &input, form)?.map_err(|error| fault(py, error, &batch))?;
        let state = RwLock::new(State { factors, configurations: input.data()?.to_vec() });
        Ok(Self { scene: scene.clone().unbind(), batch, form, pool: Pool::default(), state })
    }

    /// The factors and configurations; a panic cannot have left them half written that this hides, for updates are undone or whole.
    fn read(&self) -> RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Every factor to its configuration in `q`, or none of them.
    fn update(&mut self, scene: &Scene, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<usize, Fault> {
        let nq = scene.nq();
        let mut bodies = 0;
        for i in 0..self.factors.len() {
            match scene.update_factor(workspace, &mut self.factors[i], &q[i * nq..(i + 1) * nq]) {
                Ok(count) => bodies += count,
                Err(error) => {
                    // Those before it go back; where they were they had no fault.
                    for (factor, q) in self.factors.iter_mut().zip(self.configurations.chunks(nq.max(1))).take(i) {
                        let _ = scene.update_factor(workspace, factor, q);
                    }
                    return Err(Fault { state: i, error });
                }
            }
        }
        self.configurations.copy_from_slice(q);
        Ok(bodies)
    }
}

impl PyScene {
    /// The factor of every configuration of a batch, the GIL released.
    fn factors(&self, py: Python<'_>, input: &Input<'_>, form: Form) -> PyResult<Result<Vec<Factor<f64>>, Fault>> {
        let scene = &self.scene;
        let states: usize = input.leading().iter().product();
        let q = input.over(input.leading())?;
        let one = |scratch: &mut Scratch, state: usize| {
            scratch.workspace.form = form;
            scene.factor(&mut scratch.workspace, q.state(state)).map_err(|error| Fault { state, error })
        };
        let all = |scratch: &mut Scratch| (0..states).map(|state| one(scratch, state)).collect();
        Ok(py.detach(|| self.pool.with(|| Scratch::new(scene), all)))
    }
}

#[pymethods]
impl PyScene {
    /// M = (1 + K) D (1 + K*) at q by one sweep (3.1, 3.6), and the operators phi, Psi, K, L, D, P it is made of.
    ///
    /// q: (..., nq); the factor is batched where q is. form: as in `forward_dynamics`. Returns a phipsi.Factor: solve(tau) and mul(a) are O(N), and its
    /// operators compose as the paper's equations do.
    ///
    /// Raises `SingularJointError`, naming joint and state; `ShapeError`, `NotFiniteError` or `ArgumentError` for a bad q.
    #[pyo3(signature = (q, *, form="auto"))]
    fn factor<'py>(slf: &Bound<'py, Self>, q: &Bound<'py, PyAny>, form: &str) -> PyResult<Bound<'py, PyAny>> {
        static FACTOR: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
        FACTOR.import(slf.py(), "phipsi.operators", "Factor")?.call1((PyFactor::new(slf, q, read_form(form)?)?,))
    }
}

#[pymethods]
impl PyFactor {
    /// Scene, configurations and form: a factor is made of them to the same bits, updated or not.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Remade<'py>)> {
        let rebuild = py.import("phipsi._core")?.getattr("_rebuild_factor")?;
        let shape = [&self.batch[..], &[self.model().nq]].concat();
        let q = arrays::from_numbers(py, &self.read().configurations, &shape)?;
        Ok((rebuild, (self.scene.clone_ref(py), q, name_of(self.form))))
    }

    /// A factor that is updated by itself.
    fn __copy__(&self, py: Python<'_>) -> Self {
        let (scene, batch, state) = (self.scene.clone_ref(py), self.batch.clone(), self.read().clone());
        Self { scene, batch, form: self.form, pool: Pool::default(), state: RwLock::new(state) }
    }

    #[pyo3(signature = (memo, /))]
    fn __deepcopy__(&self, py: Python<'_>, memo: &Bound<'_, PyAny>) -> Self {
        let _ = memo;
        self.__copy__(py)
    }

    /// Number of degrees of freedom.
    #[getter]
    fn nv(&self) -> usize {
        self.model().nv()
    }

    /// Leading axes of the configurations.
    #[getter]
    fn batch<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.batch)
    }

    /// log det M of every configuration, shape of the batch.
    fn log_det<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let values: Vec<f64> = self.read().factors.iter().map(Factor::log_det).collect();
        arrays::from_numbers(py, &values, &self.batch)
    }

    /// D of every configuration, (..., nv).
    fn pivots<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let values: Vec<f64> = self.read().factors.iter().flat_map(Factor::pivots).collect();
        let mut shape = self.batch.clone();
        shape.push(self.model().nv());
        arrays::from_numbers(py, &values, &shape)
    }

    /// (rows, columns) of the operator of that name.
    #[pyo3(signature = (kind, /))]
    fn shape(&self, kind: &str) -> PyResult<(usize, usize)> {
        Ok(find(kind)?.shape(self.model().nv()))
    }

    /// The operator of that name times x, (..., columns), by a sweep; its transpose's if so said.
    #[pyo3(signature = (kind, transpose, x, /))]
    fn apply<'py>(
        &self,
        py: Python<'py>,
        kind: &str,
        transpose: bool,
        x: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let kind = find(kind)?;
        let (rows, columns) = kind.shape(self.model().nv());
        let (from, to) = if transpose { (rows, columns) } else { (columns, rows) };
        let rates = self.scene.get().rates();
        let x = Input::new("x", x, if from == rates.width() { rates } else { from.into() })?;
        let batch = broadcast_axes([("the factor", &self.batch[..]), ("x", x.leading())])?;
        // Which factor belongs to a state: broadcast over their indices.
        #[allow(clippy::cast_precision_loss)] // an index far below 2^53
        let indices: Vec<f64> = (0..self.batch.iter().product()).map(|i: usize| i as f64).collect();
        let which = Broadcast::new("the factor", &indices, 1, &self.batch, &batch)?;
        let vectors = x.over(&batch)?;
        let mut shape = batch.clone();
        shape.push(to);
        let mut output = Output::new(py, &shape)?;
        let results = output.numbers()?;
        let states = batch.iter().product();
        let run = || {
            let state = self.read();
            let factors = &state.factors;
            let batch = Batch { states, cost: 500 * self.model().nv().max(1), pool: &self.pool, make: || () };
            batch.run(results, |(), i, y| {
                let x = vectors.state(i);
                check_finite("x", x)?;
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // it was an index above
                let operator = factors[which.state(i)[0] as usize].operator(kind);
                if transpose {
                    operator.apply_transpose(x, y);
                } else {
                    operator.apply(x, y);
                }
                Ok(())
            })
        };
        py.detach(run).map_err(|error| fault(py, error, &batch))?;
        Ok(output.finish())
    }

    /// Moves every factor to its configuration in q, the shape that the factor was made with; how many bodies were computed anew, in all.
    #[pyo3(signature = (q, /))]
    fn update(&self, py: Python<'_>, q: &Bound<'_, PyAny>) -> PyResult<usize> {
        let PyScene { scene, pool, .. } = self.scene.get();
        let mut shape = self.batch.clone();
        shape.push(scene.nq());
        let (found, q) = arrays::shaped("q", q, self.scene.get().coordinates())?;
        if found != shape {
            return Err(arrays::wrong_shape("q", &found, shape_text(&shape)));
        }
        let update = |scratch: &mut Scratch| {
            self.state.write().unwrap_or_else(PoisonError::into_inner).update(scene, &mut scratch.workspace, &q)
        };
        py.detach(|| pool.with(|| Scratch::new(scene), update)).map_err(|error| fault(py, error, &self.batch))
    }

    /// The operator of that name as a matrix, (..., rows, columns), built from its definition and not by a sweep.
    #[pyo3(signature = (kind, /))]
    fn dense<'py>(&self, py: Python<'py>, kind: &str) -> PyResult<Bound<'py, PyAny>> {
        let kind = find(kind)?;
        let (rows, columns) = kind.shape(self.model().nv());
        let nq = self.model().nq;
        let mut values = Vec::with_capacity(rows * columns);
        let configurations = self.read().configurations.clone();
        for state in 0..self.batch.iter().product() {
            let q = &configurations[state * nq..(state + 1) * nq];
            let matrix = py.detach(|| Composite::new(self.model(), q).map(|composite| composite.matrix(kind)))?;
            values.extend((0..rows).flat_map(|i| (0..columns).map(move |j| (i, j))).map(|at| matrix[at]));
        }
        let mut shape = self.batch.clone();
        shape.extend([rows, columns]);
        arrays::from_numbers(py, &values, &shape)
    }
}

/// The factor of what `RawFactor.__reduce__` gave.
#[pyfunction]
#[pyo3(name = "_rebuild_factor", signature = (scene, q, form, /))]
pub(super) fn rebuild_factor(scene: &Bound<'_, PyScene>, q: &Bound<'_, PyAny>, form: &str) -> PyResult<PyFactor> {
    PyFactor::new(scene, q, read_form(form)?)
}

fn name_of(form: Form) -> &'static str {
    FORMS.iter().find(|(_, known)| *known == form).map_or("auto", |(name, _)| name)
}

fn find(name: &str) -> Result<Kind, Error> {
    Kind::from_name(name).ok_or_else(|| {
        let names: Vec<&str> = KINDS.iter().map(|(name, _)| *name).collect();
        Error::argument("kind", format!("{name:?}"), format!("one of {}", names.join(", ")))
    })
}
