//! What closes loops: methods of `SceneBuilder` that connect, and of `Scene` that tell of connections.

use super::builder::{PySceneBuilder, optional_triple, orientation};
use super::connection_tuple::kind_of;
use super::cost::WORTH_DETACHING;
use super::interrupts::detached_checked;
use super::object::Object;
use super::scene::PyScene;
use crate::error::Error;
use crate::scene::{Connection, ConnectionKind};
use crate::spatial::RigidShift;
use pyo3::prelude::*;
use pyo3::types::{PySlice, PyTuple};

#[pymethods]
impl PySceneBuilder {
    /// Closes a loop: connects a frame on a link with a frame on another, or on the world.
    ///
    /// kind: "point" (the origins coincide: 3 rows), "axis" (the origins coincide, and the direction axis, (3,), in both frames, None: z: a hinge, 5
    /// rows), "weld" (the frames coincide: 6 rows), "distance" or "rod" (the origins are length apart, m; None: as in the neutral configuration: 1
    /// row). link, other: names of links, which may come later; None: the world, the base's frame. xyz: (3,), m, and rpy: (3,), rad, or rotation: (3,
    /// 3): the first frame seen from link, as in joint. other_xyz, other_rpy, other_rotation: the second seen from other; none of them: where the
    /// first frame is in the neutral configuration.
    ///
    /// Raises SceneError for an unknown kind, and an axis or a length that the kind has not; ShapeError or ArgumentError for arrays, naming the
    /// connection; build() checks the rest.
    #[pyo3(signature = (name, kind, link, other=None, *, xyz=None, rpy=None, rotation=None, other_xyz=None, other_rpy=None, other_rotation=None, axis=None, length=None),
           text_signature = "($self, name, kind, link, other=None, *, xyz=(0, 0, 0), rpy=None, rotation=None, other_xyz=None, other_rpy=None, other_rotation=None, axis=None, length=None)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn connect<'py>(
        mut slf: PyRefMut<'py, Self>,
        name: String,
        kind: &str,
        link: String,
        other: Option<String>,
        xyz: Option<&Object<'py>>,
        rpy: Option<&Object<'py>>,
        rotation: Option<&Object<'py>>,
        other_xyz: Option<&Object<'py>>,
        other_rpy: Option<&Object<'py>>,
        other_rotation: Option<&Object<'py>>,
        axis: Option<&Object<'py>>,
        length: Option<f64>,
    ) -> PyResult<PyRefMut<'py, Self>> {
        let first = |argument: &str| format!("{argument} of connection {name:?}");
        let second = |argument: &str| format!("other_{argument} of connection {name:?}");
        let frame = |of: &dyn Fn(&str) -> String, xyz, rpy, rotation| -> PyResult<RigidShift<f64>> {
            let lever = optional_triple(&of("xyz"), xyz, [0.0; 3])?.into();
            Ok(RigidShift { rotation: orientation(of, rpy, rotation)?, lever })
        };
        let direction = axis.map(|_| optional_triple(&first("axis"), axis, [0.0; 3])).transpose()?;
        let kind = kind_of(&name, kind, direction, length)?;
        let is_open = other_xyz.is_none() && other_rpy.is_none() && other_rotation.is_none();
        let own = frame(&first, xyz, rpy, rotation)?;
        let other_frame = if is_open { None } else { Some(frame(&second, other_xyz, other_rpy, other_rotation)?) };
        let connection = Connection { name, kind, link, other, frame: own, other_frame };
        slf.change(|builder| builder.connect(connection));
        Ok(slf)
    }

    /// Couples a joint to another: its coordinate is multiplier times that one's, plus offset (rad or m), kept by a force: 1 row.
    ///
    /// name: of the connection. joint, other: names of joints of one axis, which may come later; other None: the coordinate is offset.
    ///
    /// build() raises SceneError for joints that are not there or have several axes, and for numbers that are not finite.
    #[pyo3(signature = (name, joint, other=None, *, multiplier=1.0, offset=0.0))]
    fn couple<'py>(
        mut slf: PyRefMut<'py, Self>,
        name: String,
        joint: String,
        other: Option<&str>,
        multiplier: f64,
        offset: f64,
    ) -> PyRefMut<'py, Self> {
        let kind = ConnectionKind::Joint { multiplier, offset };
        slf.change(|builder| builder.connect(Connection::new(name, kind, joint, other)));
        slf
    }
}

#[pymethods]
impl PyScene {
    /// Names of the connections that close loops, in the order they were made: the keys of the forces of constrained_dynamics.
    #[getter]
    fn connection_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.scene.connections().iter().map(|connection| &connection.name).collect::<Vec<_>>())
    }

    /// Geometric tolerance of linkages, an angle in rad or a length over the reach of the loop: see SceneBuilder.build. Zero with strict=True.
    #[getter]
    fn tolerance(&self) -> f64 {
        self.scene.tolerance()
    }

    /// Where a connection is among the rows of constraint_error, constraint_bias and constraint_jacobian, a slice.
    ///
    /// Raises ArgumentError, with the names that there are, for an unknown connection.
    #[pyo3(signature = (connection, /))]
    fn connection_rows<'py>(&self, py: Python<'py>, connection: &str) -> PyResult<Bound<'py, PySlice>> {
        let Some((_, rows)) = self.scene.rows_of_connections().find(|(name, _)| *name == connection) else {
            let names: Vec<String> = self.scene.connections().iter().map(|of| format!("{:?}", of.name)).collect();
            let expected = if names.is_empty() {
                "no name: there are no connections".to_owned()
            } else {
                format!("one of {}", names.join(", "))
            };
            return Err(Error::argument("connection", format!("{connection:?}"), expected).into());
        };
        Ok(PySlice::new(py, isize::try_from(rows.start)?, isize::try_from(rows.end)?, 1))
    }

    /// The same tree without the connections, for what knows trees only.
    #[pyo3(signature = ())]
    fn without_connections(&self, py: Python<'_>) -> PyResult<Self> {
        let make = || self.scene.without_connections();
        Ok(Self::new(if self.size() < WORTH_DETACHING { make()? } else { detached_checked(py, make)? }))
    }
}
