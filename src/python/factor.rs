//! The class `Factor`: K, L and D at one configuration or a batch of them, and the operators of the paper.

use super::call::run;
use super::choice::{choose, name_of, read_judged, refuse_unknown};
use super::errors::{asked_by, fault};
use super::input::{self, Input};
use super::interrupts::{detached, detached_checked, drop_elsewhere};
use super::object::{Object, imported};
use super::output::{Array, Names, Output, from_numbers};
use super::scene::PyScene;
use super::scratch::Scratch;
use crate::algorithm::Algorithm;
use crate::batch::{Batch, Broadcast, Fault, Pool, broadcast_axes, shape_text};
use crate::error::{Error, check_finite};
use crate::filter::Form;
use crate::interrupt;
use crate::memory;
use crate::operators::dense::Composite;
use crate::operators::{Factor, KINDS, Operator};
use crate::scene::{Model, Scene};
use crate::workspace::Workspace;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::sync::{Arc, PoisonError, RwLock};

/// The arguments from which pickle rebuilds a factor: scene, configurations, name of the form, tolerance.
type Remade<'py> = (Py<PyScene>, Object<'py>, &'static str, Option<f64>);

/// Compiled part of phipsi.operators.Factor: applies operators by name.
#[pyclass(frozen, name = "RawFactor", module = "phipsi._core")]
pub(crate) struct PyFactor {
    scene: Py<PyScene>,
    batch: Vec<usize>,
    form: Form,
    tolerance: Option<f64>,
    pool: Pool<()>,
    /// Locked only to read or replace the reference, or for a short update; the holder never waits, in particular not
    /// for the GIL.
    state: RwLock<Arc<State>>,
}

/// An update with a longer estimated time (ns) works on a copy, so that it can be interrupted and blocks no other
/// thread.
const IN_PLACE: usize = 1_000_000;

/// Approximate time per body and state, ns.
const COST: usize = 500;

/// The part that an update changes.
#[derive(Clone)]
struct State {
    factors: Vec<Factor<f64>>,
    configurations: Vec<f64>,
}

impl PyFactor {
    fn model(&self) -> &Model<f64> {
        self.scene.get().scene.model()
    }

    /// Current factors and configurations. Ignoring a poisoned lock is safe, because updates are complete or
    /// undone.
    fn read(&self) -> Arc<State> {
        Arc::clone(&self.state.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Updates every factor to its configuration in `q`, or none of them; returns the number of recomputed bodies.
    fn update_all(&self, scratch: &mut Scratch, q: &[f64]) -> Result<usize, Fault> {
        let scene = &self.scene.get().scene;
        let states: usize = self.batch.iter().product();
        if states.saturating_mul(COST).saturating_mul(scene.model().bodies.len()) < IN_PLACE {
            let mut held = self.state.write().unwrap_or_else(PoisonError::into_inner);
            if let Some(state) = Arc::get_mut(&mut held) {
                return state.update(scene, &mut scratch.workspace, q);
            }
        }
        let before = self.read();
        let whole = |error| Fault { state: 0, error };
        memory::room("q", Factor::bytes(scene.model(), states)).map_err(whole)?;
        let mut factors = memory::with_capacity("q", states).map_err(whole)?;
        let configurations = memory::copied("q", &before.configurations).map_err(whole)?;
        let copied = before.factors.iter().enumerate().try_for_each(|(i, factor)| {
            interrupt::check_at(i, 64)?;
            factors.push(factor.clone());
            Ok(())
        });
        let mut state = State { factors, configurations };
        match copied.map_err(whole).and_then(|()| state.update(scene, &mut scratch.workspace, q)) {
            Ok(bodies) => {
                *self.state.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(state);
                Ok(bodies)
            }
            Err(fault) => {
                drop_elsewhere(state);
                Err(fault)
            }
        }
    }
}

impl State {
    /// Updates every factor to its configuration in `q`, or none of them.
    fn update(&mut self, scene: &Scene, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<usize, Fault> {
        let nq = scene.nq();
        let mut bodies = 0;
        for i in 0..self.factors.len() {
            let go_on = interrupt::check_at(i + 1, 64);
            match go_on.and_then(|()| scene.update_factor(workspace, &mut self.factors[i], &q[i * nq..(i + 1) * nq])) {
                Ok(count) => bodies += count,
                // An interrupted update works on a copy, which is dropped.
                Err(error @ Error::Interrupted) => return Err(Fault { state: 0, error }),
                Err(error) => {
                    // The factors before it return to their previous configurations, which had no fault.
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
    /// Computes the factor of every configuration of a batch.
    fn factors(
        &self,
        py: Python<'_>,
        input: &Input<'_>,
        (form, tolerance): (Form, Option<f64>),
    ) -> PyResult<Vec<Factor<f64>>> {
        let Self { scene, pool } = self;
        let states: usize = input.leading().iter().product();
        let q = input.over(input.leading())?;
        // Twice the outer part of each factor, which is moved at the end, and q.
        let outer = memory::bytes_of::<Factor<f64>>(&[states]) + memory::bytes_of::<f64>(&[states, scene.nq()]);
        memory::room("q", Factor::bytes(scene.model(), states).saturating_add(outer))?;
        self.check_scratch(states)?;
        let mut made: Vec<Option<Factor<f64>>> = memory::with_capacity("q", states)?;
        made.resize_with(states, || None);
        let batch = Batch { states, cost: COST * self.size(), pool, make: || Scratch::new(scene) };
        let outcome = run(py, input.leading(), batch, |batch| {
            batch.run_pieces(1, &mut made, |scratch, states, made| {
                (scratch.workspace.form, scratch.workspace.tolerance) = (form, tolerance);
                for (state, made) in states.zip(made) {
                    let factor = scene.factor(&mut scratch.workspace, q.state(state));
                    *made = Some(factor.map_err(|error| Fault { state, error })?);
                }
                Ok(())
            })
        });
        if let Err(error) = outcome {
            drop_elsewhere(made);
            return Err(error);
        }
        detached_checked(py, || {
            let mut factors = memory::with_capacity("q", states)?;
            factors.extend(made.into_iter().flatten());
            Ok::<_, Error>(factors)
        })
    }
}

typed_methods! {
    in PyScene;

    /// Factorize the mass matrix at q, to solve and multiply with it, and for the operators of the paper (3.1, 3.6).
    #[doc = parameters!(q form tolerance)]
    #[doc = section!(Returns)]
    /// factor : Factor
    ///     solve(tau) and mul(a) are O(N); its operators compose as the equations of the paper do. Batched if q is.
    #[doc = raises!(singular arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> factor = scene.factor([0.3, 0.2, 0.1])
    /// >>> np.allclose(factor.mul(factor.solve([1.0, 2.0, 3.0])), [1.0, 2.0, 3.0])
    /// True
    fn factor[slf: &Bound<'py, Self>](
        q: &Object<'py>; form: &str = "auto", tolerance: Option<f64> = None, **unknown
    ) -> PyResult<Object<'py>> {
        refuse_unknown(slf.py(), "Scene.factor", unknown)?;
        imported!(slf.py(), "phipsi.operators", "Factor")?.call1((rebuild_factor(slf, q, form, tolerance)?,))
    }
}

#[pymethods]
impl PyFactor {
    /// Scene, configurations, form and tolerance: they determine all bits of a factor, updated or not.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Object<'py>, Remade<'py>)> {
        let rebuild = py.import("phipsi._core")?.getattr("_rebuild_factor")?;
        let shape = [&self.batch[..], &[self.model().nq]].concat();
        let q = from_numbers(py, &self.read().configurations, &shape)?;
        Ok((rebuild, (self.scene.clone_ref(py), q, name_of(self.form), self.tolerance)))
    }

    /// A factor that is updated independently.
    fn __copy__(&self, py: Python<'_>) -> Self {
        // The state is shared until either is updated.
        let (scene, batch, state) = (self.scene.clone_ref(py), self.batch.clone(), self.read());
        let (form, tolerance) = (self.form, self.tolerance);
        Self { scene, batch, form, tolerance, pool: Pool::default(), state: RwLock::new(state) }
    }

    #[pyo3(signature = (memo, /))]
    fn __deepcopy__(&self, py: Python<'_>, memo: &Object<'_>) -> Self {
        let _ = memo;
        self.__copy__(py)
    }

    /// log det M of every configuration, with the shape of the batch.
    fn log_det<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let mut output = asked_by(py, "q", Output::new(py, &self.batch))?;
        for (value, factor) in output.numbers()?.iter_mut().zip(&self.read().factors) {
            *value = factor.log_det();
        }
        output.finish_or_scalar()
    }

    /// Pivots D of every configuration, (..., nv).
    fn pivots<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let mut output = asked_by(py, "q", Output::new(py, &[&self.batch[..], &[self.model().nv()]].concat()))?;
        let state = self.read();
        for (value, pivot) in output.numbers()?.iter_mut().zip(state.factors.iter().flat_map(Factor::pivots)) {
            *value = pivot;
        }
        output.finish_or_scalar()
    }

    /// Shape (rows, columns) of an operator.
    #[pyo3(signature = (kind, /))]
    fn shape(&self, kind: &str) -> PyResult<(usize, usize)> {
        Ok(choose("kind", kind, KINDS)?.shape(self.model().nv()))
    }

    /// Product of an operator, or of its transpose, with x, (..., columns), by a sweep.
    #[pyo3(signature = (kind, transpose, x, /))]
    fn apply<'py>(&self, py: Python<'py>, kind: &str, transpose: bool, x: &Object<'py>) -> Array<'py> {
        let what = format!("product with {kind}");
        let kind = choose("kind", kind, KINDS)?;
        let (rows, columns) = kind.shape(self.model().nv());
        let (from, to) = if transpose { (rows, columns) } else { (columns, rows) };
        let rates = self.scene.get().rates();
        let x = Input::new("x", x, if from == rates.width() { rates } else { from.into() })?;
        let batch = broadcast_axes([("the factor", &self.batch[..]), ("x", x.leading())])?;
        let state = self.read();
        let factors = Broadcast::new("the factor", &state.factors, 1, &self.batch, &batch)?;
        let vectors = x.over(&batch)?;
        let mut output = asked_by(py, "x", Output::new(py, &[&batch[..], &[to]].concat()))?;
        let results = output.numbers()?;
        let states = batch.iter().product();
        if kind.needs_covariances() {
            memory::room("q", Factor::bytes_of_covariances(self.model(), state.factors.len()))?;
        }
        let scene = &self.scene.get().scene;
        let factor = Batch { states, cost: COST * self.model().nv().max(1), pool: &self.pool, make: || () };
        run(py, &batch, factor, |factor| {
            factor.run(results, |(), i, y| {
                let x = vectors.state(i);
                check_finite("x", x)?;
                let operator = factors.state(i)[0].operator(kind);
                if transpose {
                    operator.apply_transpose(x, y);
                } else {
                    operator.apply(x, y);
                }
                scene.check_result(&what, y)
            })
        })?;
        Ok(output.finish())
    }

    /// Update the factors to the configurations q, of the same shape; returns the number of recomputed bodies.
    #[pyo3(signature = (q, /))]
    fn update(&self, py: Python<'_>, q: &Object<'_>) -> PyResult<usize> {
        let PyScene { scene, pool } = self.scene.get();
        let shape = [&self.batch[..], &[scene.nq()]].concat();
        let (found, q) = input::shaped("q", q, self.scene.get().coordinates())?;
        if found != shape {
            return Err(input::wrong_shape("q", &found, shape_text(&shape)));
        }
        let update = |scratch: &mut Scratch| self.update_all(scratch, &q);
        detached(py, || pool.with(|| Scratch::new(scene), update))?.map_err(|error| fault(py, error, &self.batch))
    }

    /// Operator as a matrix, (..., rows, columns), from its definition and not by a sweep.
    #[pyo3(signature = (kind, /))]
    fn dense<'py>(&self, py: Python<'py>, kind: &str) -> PyResult<Object<'py>> {
        let kind = choose("kind", kind, KINDS)?;
        let (rows, columns) = kind.shape(self.model().nv());
        let nq = self.model().nq;
        let mut output = asked_by(py, "q", Output::new(py, &[&self.batch[..], &[rows, columns]].concat()))?;
        let numbers = output.numbers()?;
        let state = self.read();
        detached_checked(py, || {
            for (i, numbers) in numbers.chunks_exact_mut((rows * columns).max(1)).enumerate() {
                interrupt::check()?;
                let q = &state.configurations[i * nq..(i + 1) * nq];
                let matrix = Composite::new(self.model(), q)?.matrix(kind)?;
                for (at, number) in numbers.iter_mut().enumerate() {
                    *number = matrix[(at / columns, at % columns)];
                }
            }
            Ok::<_, Error>(())
        })?;
        output.finish_or_scalar()
    }
}

getters! {
    in PyFactor;

    /// Number of degrees of freedom.
    nv: usize = |of, _| of.model().nv();

    /// Leading axes of the configurations.
    batch: Names<'py> = |of, py| PyTuple::new(py, &of.batch);
}

/// Factors every configuration of q, for Scene.factor and from the result of RawFactor.__reduce__.
#[pyfunction]
#[pyo3(name = "_rebuild_factor", signature = (scene, q, form, tolerance=None, /))]
pub(super) fn rebuild_factor(
    scene: &Bound<'_, PyScene>,
    q: &Object<'_>,
    form: &str,
    tolerance: Option<f64>,
) -> PyResult<PyFactor> {
    let (py, own) = (scene.py(), scene.get());
    let form = read_judged(&own.scene, (form, tolerance), Algorithm::MassMatrixInverse)?;
    let input = own.configuration("q", q)?;
    let factors = own.factors(py, &input, (form, tolerance))?;
    let state = State { factors, configurations: memory::copied("q", input.data()?)? };
    let (batch, state) = (input.leading().to_vec(), RwLock::new(Arc::new(state)));
    Ok(PyFactor { scene: scene.clone().unbind(), batch, form, tolerance, pool: Pool::default(), state })
}
