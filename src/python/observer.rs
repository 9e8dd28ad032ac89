//! The compiled part of `phipsi.estimation.Observer`: a filter of one robot or a batch.

use super::cost::WORTH_RELEASING;
use super::errors::{fault, of_batch, refuse};
use super::interrupts::detached;
use super::object::Object;
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use super::simulator::Held;
use super::threads::free;
use crate::error::Error;
use crate::estimation::observer::{SensorRows, WINDOW};
use crate::estimation::{ExternalWrench, Mount, Observer, ObserverSettings, Quantity, Sensor};
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard};

/// A link with a position and axes.
type MountTuple = (String, [f64; 3], [[f64; 3]; 3]);

/// A sensor: kind, name, joints, mount, standard deviations, delay, bias with its growth, gate, and covariance.
type SensorTuple =
    (String, String, Option<Vec<String>>, Option<MountTuple>, Vec<f64>, usize, (f64, f64), f64, Option<[[f64; 6]; 6]>);

/// A wrench: link, density, correlation time, initial standard deviation.
type WrenchTuple = (String, [f64; 6], f64, Option<[f64; 6]>);

fn sensor(
    (kind, name, joints, mount, noise, delay, (bias, bias_walk), gate, covariance): SensorTuple,
) -> Result<Sensor, Error> {
    let unknown =
        |found: &str| Error::argument("sensors", format!("the kind {found:?}"), "a sensor of phipsi.estimation");
    let mount = mount.map(|(link, xyz, axes)| {
        let rotation = Matrix3::from_fn(|i, j| axes[i][j]);
        Mount { link, offset: RigidShift { rotation, lever: Vector3::from(xyz) } }
    });
    let quantity = match (kind.as_str(), mount) {
        ("encoder", None) => Quantity::Encoder(joints),
        ("torque", None) => Quantity::JointTorque(joints),
        ("gyro", Some(mount)) => Quantity::Gyro(mount),
        ("accelerometer", Some(mount)) => Quantity::Accelerometer(mount),
        ("contact", Some(mount)) => Quantity::Contact(mount),
        ("pose", Some(mount)) => {
            Quantity::Pose(mount, Box::new(covariance.ok_or_else(|| unknown("pose without covariance"))?))
        }
        (other, _) => return Err(unknown(other)),
    };
    Ok(Sensor { name, quantity, noise, delay, bias, bias_walk, gate })
}

/// Filter of the robots of an observer, in the order of their batch.
#[pyclass(frozen, name = "_Observer", module = "phipsi._core")]
pub(crate) struct PyObserver {
    batch: Vec<usize>,
    sizes: [usize; 4],
    filter: Mutex<Observer<Held>>,
}

#[pymethods]
impl PyObserver {
    /// Create a filter from checked arrays; q (robots, nq) and qd (robots, nv).
    #[new]
    fn new(
        scene: Py<PyScene>,
        dt: f64,
        sensors: Vec<SensorTuple>,
        torque_noise: Vec<f64>,
        wrenches: Vec<WrenchTuple>,
        initial: Vec<f64>,
        history: usize,
        state: (PyReadonlyArray2<'_, f64>, PyReadonlyArray2<'_, f64>),
        batch: Vec<usize>,
    ) -> PyResult<Self> {
        let sensors = sensors.into_iter().map(sensor).collect::<Result<Vec<_>, _>>()?;
        let wrenches = wrenches.into_iter().map(|(link, density, correlation_time, deviation)| ExternalWrench {
            link,
            density,
            correlation_time,
            deviation,
        });
        let wrenches = wrenches.collect();
        let settings = ObserverSettings { dt, sensors, torque_noise, wrenches, initial, history };
        let own = &scene.get().scene;
        let (nq, nv) = (own.nq(), own.nv());
        let filter = Observer::new(Held(scene), &settings, state.0.as_slice()?, state.1.as_slice()?)?;
        let (n, rest) = filter.sizes();
        Ok(Self { batch, sizes: [nq, nv, rest, n], filter: Mutex::new(filter) })
    }

    /// The state as numbers, which resume() of a filter with the same arguments reads.
    fn numbers<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let numbers = self.filter()?.numbers()?;
        from_numbers(py, &numbers, &[numbers.len()])
    }

    /// Replace the state.
    fn resume(&self, numbers: PyReadonlyArray1<'_, f64>) -> PyResult<()> {
        Ok(self.filter()?.resume(numbers.as_slice()?)?)
    }

    /// Factor of wrenches and biases per step, and standard deviation of their growth, (rest,) each.
    fn process<'py>(&self, py: Python<'py>) -> PyResult<[Object<'py>; 2]> {
        let filter = self.filter()?;
        let (decay, walk) = filter.process();
        Ok([from_numbers(py, decay, &[decay.len()])?, from_numbers(py, walk, &[walk.len()])?])
    }

    /// Process readings (robots, m) and advance by dt under tau (robots, nv).
    ///
    /// Returns q, qd, wrenches and biases, covariance, NIS and its number of readings, the rejected readings, and
    /// true if a window of innovations is complete.
    fn step<'py>(
        &self,
        py: Python<'py>,
        tau: PyReadonlyArray1<'py, f64>,
        readings: PyReadonlyArray1<'py, f64>,
        dt: f64,
        acting: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<([Object<'py>; 7], bool)> {
        let mut guard = self.filter()?;
        let filter = &mut *guard;
        let (tau, readings, acting) = (tau.as_slice()?, readings.as_slice()?, acting.as_slice()?);
        let done = if filter.cost() < WORTH_RELEASING {
            filter.step_over(dt, tau, readings, acting)
        } else {
            detached(py, || filter.step_over(dt, tau, readings, acting))?
        };
        done.map_err(|found| fault(py, found, &self.batch))?;
        let [nq, nv, rest, n] = self.sizes;
        let filter = &*filter;
        let each = || (0..filter.robots()).filter_map(|robot| filter.estimate(robot));
        let shaped = |own: &[usize]| Output::<f64>::new(py, &[&self.batch[..], own].concat());
        let width = filter.readings();
        let mut outputs = [
            shaped(&[nq])?,
            shaped(&[nv])?,
            shaped(&[rest])?,
            shaped(&[n, n])?,
            shaped(&[])?,
            shaped(&[])?,
            shaped(&[width])?,
        ];
        let [q, qd, others, covariance, nis, count, rejected] = &mut outputs;
        q.gather(py, nq, each().map(|own| own.q()))?;
        qd.gather(py, nv, each().map(|own| own.qd()))?;
        others.gather(py, rest, each().map(|own| own.wrenches_and_biases()))?;
        for (to, own) in covariance.numbers()?.chunks_exact_mut(n * n).zip(each()) {
            own.covariance(to)?;
        }
        for (robot, (nis, count)) in nis.numbers()?.iter_mut().zip(count.numbers()?).enumerate() {
            let (value, readings) = filter.innovation(robot).unwrap_or((f64::NAN, 0));
            *nis = value;
            *count = f64::from(u32::try_from(readings).unwrap_or(u32::MAX));
        }
        if width > 0 {
            for (robot, to) in rejected.numbers()?.chunks_exact_mut(width).enumerate() {
                match filter.rejected(robot) {
                    Some(own) => to.copy_from_slice(own),
                    None => to.fill(0.0),
                }
            }
        }
        let is_complete = filter.innovation(0).is_some() && filter.window(0).0 == WINDOW;
        Ok((outputs.map(|output| output.finish().into_any()), is_complete))
    }

    /// Smoothed q, qd, wrenches and biases, and covariances, (steps, ...), and times, (steps,).
    fn smooth<'py>(&self, py: Python<'py>) -> PyResult<([Object<'py>; 4], Object<'py>)> {
        let guard = self.filter()?;
        let filter = &*guard;
        let [nq, nv, rest, n] = self.sizes;
        let robots = filter.robots();
        let found = detached(py, || (0..robots).map(|robot| filter.smooth(robot)).collect::<Result<Vec<_>, _>>())?;
        let found = found.map_err(|error| of_batch(py, &error, &self.batch))?;
        let steps = found.first().map_or(0, |own| own.qd.len() / nv);
        let gathered = |width: &[usize], of: fn(&crate::estimation::SmoothedMotion) -> &[f64]| {
            let mut output = Output::<f64>::new(py, &[&[steps], &self.batch[..], width].concat())?;
            let width = width.iter().product::<usize>();
            let rows =
                (0..steps).flat_map(|step| found.iter().map(move |own| &of(own)[step * width..(step + 1) * width]));
            output.gather(py, width, rows)?;
            PyResult::Ok(output.finish().into_any())
        };
        let arrays = [
            gathered(&[nq], |own| &own.q)?,
            gathered(&[nv], |own| &own.qd)?,
            gathered(&[rest], |own| &own.rest)?,
            gathered(&[n, n], |own| &own.covariance)?,
        ];
        let times = found.first().map_or(&[][..], |own| &own.time);
        Ok((arrays, from_numbers(py, times, &[times.len()])?))
    }

    /// The estimate before the readings of the next step: q, qd, wrenches and biases, and a root of the covariance.
    fn prior<'py>(&self, py: Python<'py>) -> PyResult<[Object<'py>; 4]> {
        let filter = self.filter()?;
        let [nq, nv, rest, n] = self.sizes;
        let shaped = |own: &[usize]| Output::<f64>::new(py, &[&self.batch[..], own].concat());
        let mut outputs = [shaped(&[nq])?, shaped(&[nv])?, shaped(&[rest])?, shaped(&[n, n])?];
        for robot in 0..filter.robots() {
            let root = &mut outputs[3].numbers()?[robot * n * n..(robot + 1) * n * n];
            let Some(prior) = filter.prior(robot, root) else { continue };
            for (output, own) in outputs.iter_mut().zip([&prior.q, &prior.qd, &prior.rest]) {
                output.numbers()?[robot * own.len()..(robot + 1) * own.len()].copy_from_slice(own);
            }
        }
        Ok(outputs.map(|output| output.finish().into_any()))
    }

    /// For each robot and sensor, the sum of the normalized innovations squared of the window, and its readings.
    fn window(&self) -> Result<Vec<Vec<(f64, usize)>>, Error> {
        let filter = self.filter()?;
        Ok((0..filter.robots()).map(|robot| filter.window(robot).1.to_vec()).collect())
    }

    /// The same of one robot in a filter without one sensor.
    fn window_without(&self, py: Python<'_>, robot: usize, sensor: usize) -> PyResult<Vec<(f64, usize)>> {
        let guard = self.filter()?;
        let filter = &*guard;
        Ok(detached(py, || filter.window_without(robot, sensor))??)
    }

    /// The next state of a step (q, qd, wrenches and biases), [F B], the accelerations and their derivatives.
    fn transition<'py>(
        &self,
        py: Python<'py>,
        q: PyReadonlyArray1<'py, f64>,
        qd: PyReadonlyArray1<'py, f64>,
        rest: PyReadonlyArray1<'py, f64>,
        tau: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<[Object<'py>; 6]> {
        let [nq, nv, others, n] = self.sizes;
        let (state, tau) = ((q.as_slice()?, qd.as_slice()?, rest.as_slice()?), tau.as_slice()?);
        for (name, found, expected) in
            [("q", state.0, nq), ("qd", state.1, nv), ("rest", state.2, others), ("tau", tau, nv)]
        {
            crate::error::check_length(name, found.len(), expected)?;
        }
        let found = self.filter()?.transition(state, tau)?;
        Ok([
            from_numbers(py, &found.q, &[nq])?,
            from_numbers(py, &found.qd, &[nv])?,
            from_numbers(py, &found.rest, &[others])?,
            from_numbers(py, &found.matrix, &[n, n + nv])?,
            from_numbers(py, &found.qdd, &[nv])?,
            from_numbers(py, &found.by_error, &[nv, n + nv])?,
        ])
    }
}

impl PyObserver {
    /// Locks the filter for one call. The lock never blocks: another thread may hold it while it waits for the GIL.
    fn filter(&self) -> Result<MutexGuard<'_, Observer<Held>>, Error> {
        free(&self.filter, "observer", "one call at a time; create an observer for each thread")
    }
}

#[pymethods]
impl PyScene {
    /// Predicted readings of a sensor, (states, m), and their derivatives by q, qd, qdd and torque noise, (states, m,
    /// nv), at states (states, nq) and (states, nv).
    #[pyo3(name = "_sensor_prediction")]
    fn sensor_prediction<'py>(
        &self,
        py: Python<'py>,
        given: SensorTuple,
        state: [PyReadonlyArray2<'py, f64>; 3],
        tau: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<([Object<'py>; 5], [bool; 2])> {
        let (scene, sensor) = (&self.scene, sensor(given)?);
        let [q, qd, qdd] = &state;
        let arrays = [q.as_array(), qd.as_array(), qdd.as_array(), tau.as_array()];
        let count = arrays[0].nrows();
        if arrays.iter().any(|array| array.nrows() != count) {
            return refuse("state", "arrays of different lengths", "one row per state");
        }
        let states = (0..count).map(|i| arrays.each_ref().map(|array| array.row(i).to_vec()));
        let (nv, mut found, mut size, mut depends) = (scene.nv(), [const { Vec::new() }; 5], 0, [false; 2]);
        SensorRows::predict(scene, &sensor, states, |rows| {
            (size, depends) = (rows.size, [rows.has_qdd, rows.has_noise]);
            found[0].extend_from_slice(&rows.value[..size]);
            let matrices = [&rows.by_q, &rows.by_qd, &rows.by_qdd, &rows.by_noise];
            for (to, matrix) in found[1..].iter_mut().zip(matrices) {
                to.extend((0..size).flat_map(|i| (0..nv).map(move |k| matrix[k * size + i])));
            }
        })?;
        let [value, by_q, by_qd, by_qdd, by_noise] = found;
        let matrix = |numbers: &[f64]| from_numbers(py, numbers, &[count, size, nv]);
        let value = from_numbers(py, &value, &[count, size])?;
        Ok(([value, matrix(&by_q)?, matrix(&by_qd)?, matrix(&by_qdd)?, matrix(&by_noise)?], depends))
    }
}
