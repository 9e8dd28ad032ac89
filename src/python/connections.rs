//! Closed loops: the methods of `SceneBuilder` that add connections, and the properties of `Scene.loops`.

use super::builder::{Added, PySceneBuilder, frame_of, optional_triple};
use super::errors::refuse;
use super::groups::PyLoops;
use super::input;
use super::object::Object;
use super::output::Names;
use super::scene::{PyScene, slice};
use crate::error::Error;
use crate::scene::{Connection, ConnectionKind, Polynomial};
use pyo3::prelude::*;
use pyo3::types::{PySlice, PyTuple};

typed_methods! {
    in PySceneBuilder;

    /// Close a kinematic loop: connect a frame on a link with a frame on another link or on the base.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the connection.
    /// kind : {"point", "axis", "weld", "distance", "rod"}
    ///     "point": the origins coincide (3 rows). "axis": a hinge: the origins and the direction `axis` coincide (5
    ///     rows). "weld": the frames coincide (6 rows). "distance" or "rod": the origins are `length` apart (1 row).
    /// link : str
    ///     Name of the first link, which may be added later.
    /// other : str, optional
    ///     Name of the second link. None: the base.
    /// xyz : (3,) array_like, default (0, 0, 0)
    ///     Origin of the first frame in `link`, m.
    /// rpy : (3,) array_like, optional
    ///     Orientation of the first frame in `link`, rad, as in joint.
    /// rotation : (3, 3) array_like, optional
    ///     The same as a matrix, instead of rpy.
    /// other_xyz : (3,) array_like, optional
    ///     Origin of the second frame in `other`, m.
    /// other_rpy : (3,) array_like, optional
    ///     Orientation of the second frame in `other`, rad.
    /// other_rotation : (3, 3) array_like, optional
    ///     The same as a matrix. None of the three: the second frame is where the first one is in the neutral
    ///     configuration.
    /// axis : (3,) array_like, optional
    ///     Direction in both frames, for "axis"; z by default.
    /// length : float, optional
    ///     Length, m, for "distance" and "rod"; by default that in the neutral configuration.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// SceneError
    ///     An unknown kind, or an axis or a length that the kind does not have.
    /// ShapeError, ArgumentError
    ///     Invalid arrays. The message names the connection; build() checks the rest.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().connect("pin", "point", "link2", xyz=(0, 0, 0.3)).build()
    /// >>> scene.loops.names, scene.loops.jacobian([0.3, 0.2, 0.1]).shape
    /// (('pin',), (3, 3))
    fn connect[slf: PyRefMut<'py, Self>](
        name: String, kind: &str, link: String, other: Option<String> = None;
        xyz: Option<&Object<'py>> = None => "(0, 0, 0)", rpy: Option<&Object<'py>> = None,
        rotation: Option<&Object<'py>> = None, other_xyz: Option<&Object<'py>> = None,
        other_rpy: Option<&Object<'py>> = None, other_rotation: Option<&Object<'py>> = None,
        axis: Option<&Object<'py>> = None, length: Option<f64> = None
    ) -> Added<'py> {
        let first = |argument: &str| format!("{argument} of connection {name:?}");
        let second = |argument: &str| format!("other_{argument} of connection {name:?}");
        let direction = axis.map(|_| optional_triple(&first("axis"), axis, [0.0; 3])).transpose()?;
        let kind = ConnectionKind::named(&name, kind, direction.map(Into::into), length)?;
        let is_open = other_xyz.is_none() && other_rpy.is_none() && other_rotation.is_none();
        let own = frame_of(&first, xyz, rpy, rotation)?;
        let other_frame = if is_open { None } else { Some(frame_of(&second, other_xyz, other_rpy, other_rotation)?) };
        let connection = Connection { name, kind, link, other, frame: own, other_frame };
        Ok(Self::with(slf, |builder| builder.connect(connection)))
    }

    /// Couple two joints by a constraint force (1 row): a coordinate is a polynomial of the other, linear by default.
    ///
    /// Linear: coordinate = multiplier * other coordinate + offset.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the connection.
    /// joint : str
    ///     Name of a joint with one axis, which may be added later.
    /// other : str, optional
    ///     Name of the other joint with one axis. None: the coordinate equals offset.
    /// multiplier : float, default 1
    ///     Factor of the coordinate of the other joint.
    /// offset : float, default 0
    ///     Offset, rad or m.
    /// polynomial : array_like, optional
    ///     One to five coefficients (a0, a1, ..., a4) instead of multiplier and offset, in powers of rad or m:
    ///     coordinate = a0 + a1 x + a2 x^2 + a3 x^3 + a4 x^4 with the coordinate x of the other joint.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// SceneError
    ///     A polynomial without another joint, or with a multiplier or an offset.
    /// ShapeError
    ///     A wrong number of coefficients.
    #[doc = section!(Notes)]
    /// build() raises SceneError for unknown joints, joints with several axes and non-finite numbers. The constraint
    /// force acts along (1, -P'(x)) on the two joints, where P is the polynomial.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1", multiplier=-2.0).build()
    /// >>> scene.loops.error([0.0, 0.1, 0.0]).round(3)
    /// array([0.2])
    /// >>> cam = phipsi.scenes.chain(3).to_builder().couple("cam", "j2", "j0", polynomial=(0.1, 0.0, 2.0)).build()
    /// >>> cam.loops.jacobian([0.5, 0.0, 0.6])
    /// array([[-2.,  0.,  1.]])
    fn couple[slf: PyRefMut<'py, Self>](
        name: String, joint: String, other: Option<&str> = None; multiplier: Option<f64> = None => "1.0",
        offset: Option<f64> = None => "0.0", polynomial: Option<&Object<'py>> = None
    ) -> Added<'py> {
        let polynomial = match polynomial {
            None => Polynomial::linear(multiplier.unwrap_or(1.0), offset.unwrap_or(0.0)),
            Some(given) => {
                let is_alone = other.is_some() && multiplier.is_none() && offset.is_none();
                polynomial_of(&name, given, is_alone)?
            }
        };
        let kind = ConnectionKind::Joint(polynomial);
        Ok(Self::with(slf, |builder| builder.connect(Connection::new(name, kind, joint, other))))
    }
}

/// The polynomial of a coupling. `is_alone`: with another joint, and without a multiplier and an offset.
fn polynomial_of(connection: &str, given: &Object<'_>, is_alone: bool) -> PyResult<Polynomial> {
    let refused = |found: String, expected: &str| Error::scene(format!("connection {connection:?}"), found, expected);
    if !is_alone {
        let found = "a polynomial without another joint, or with a multiplier or an offset".to_owned();
        return Err(refused(found, "another joint, and either a polynomial or a multiplier and an offset").into());
    }
    let name = format!("polynomial of connection {connection:?}");
    let mut coefficients = [0.0; 5];
    let (shape, given) = input::shaped(&name, given, coefficients.len())?;
    if !matches!(shape[..], [1..=5]) {
        return Err(input::wrong_shape(&name, &shape, "(k,), k from 1 to 5".to_owned()));
    }
    coefficients[..given.len()].copy_from_slice(&given);
    Ok(Polynomial::new(coefficients))
}

#[pymethods]
impl PyLoops {
    /// Slice of the rows of a connection in error, bias and jacobian.
    #[doc = section!(Parameters)]
    /// connection : str
    ///     Name of the connection.
    #[doc = section!(Returns)]
    /// slice
    ///     Position of the rows.
    #[doc = raises!(unknown)]
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.scenes.chain(3).to_builder().connect("pin", "point", "link2")
    /// >>> builder.couple("gear", "j2", "j1").build().loops.rows("gear")
    /// slice(3, 4, 1)
    #[pyo3(signature = (connection, /))]
    fn rows<'py>(&self, py: Python<'py>, connection: &str) -> PyResult<Bound<'py, PySlice>> {
        let scene = &self.as_scene().scene;
        let Some((_, rows)) = scene.rows_of_connections().find(|(name, _)| *name == connection) else {
            let names: Vec<String> = scene.connections().iter().map(|of| format!("{:?}", of.name)).collect();
            let expected = if names.is_empty() {
                "no name: there are no connections".to_owned()
            } else {
                format!("one of {}", names.join(", "))
            };
            return refuse("connection", format!("{connection:?}"), expected);
        };
        slice(py, &rows)
    }
}

getters! {
    in PyLoops;

    /// Names of the connections in the order of their creation: the keys of the forces of dynamics.
    names: Names<'py> =
        |of, py| PyTuple::new(py, of.as_scene().scene.connections().iter().map(|connection| &connection.name));

    /// Geometric tolerance of linkages, an angle in rad or a relative length; see SceneBuilder.build.
    tolerance: f64 = |of, _| of.as_scene().scene.tolerance();
}

#[pymethods]
impl PyScene {
    /// Create the scene of the same kinematic tree without the connections, for methods that support trees only.
    #[doc = section!(Returns)]
    /// scene : Scene
    ///     The tree.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().couple("gear", "j2", "j1").build()
    /// >>> scene.without_constraints().loops.names
    /// ()
    fn without_constraints(&self, py: Python<'_>) -> PyResult<Self> {
        self.derived(py, || self.scene.without_constraints())
    }
}
