//! Starts and keyframes: the method of `SceneBuilder` that adds them, and the methods of `Scene` that return them.

use super::builder::{Added, PySceneBuilder};
use super::choice::items;
use super::errors::refuse;
use super::input;
use super::object::Object;
use super::output::{Names, from_numbers};
use super::scene::PyScene;
use crate::scene::Start;
use pyo3::prelude::*;
use pyo3::types::{PyMapping, PyTuple};
use std::collections::BTreeMap;

typed_methods! {
    in PySceneBuilder;

    /// Set the start, from which motions begin by default, or add a keyframe. Replaces the one with the same name.
    #[doc = section!(Parameters)]
    /// q : dict of str to float or array_like, optional
    ///     Joint positions by joint name, rad or m. The joints may be added later.
    /// qd : dict of str to float or array_like, optional
    ///     Joint velocities by joint name, rad/s or m/s.
    /// keyframe : str, optional
    ///     Name of the keyframe. None: the start.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     Arguments that are not dicts, or invalid values. The message names the joint; build() checks the rest.
    #[doc = section!(Notes)]
    /// Joints that the start does not name are neutral and at rest; those that a keyframe does not name are as in the
    /// start. build() raises ArgumentError for unknown joints, quaternions that are not of unit norm, and joints that
    /// follow others (mimic) and are elsewhere; SceneError for a wrong number of values.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.scenes.chain(3).to_builder().start({"j1": 0.5})
    /// >>> scene = builder.start({"j2": -1.0}, {"j0": 0.1}, keyframe="kick").build()
    /// >>> scene.initial(), scene.initial("kick"), scene.initial_velocity("kick")
    /// (array([0. , 0.5, 0. ]), array([ 0. ,  0.5, -1. ]), array([0.1, 0. , 0. ]))
    fn start[slf: PyRefMut<'py, Self>](
        q: Option<&Object<'py>> = None, qd: Option<&Object<'py>> = None; keyframe: Option<&str> = None
    ) -> Added<'py> {
        let start = Start::new(keyframe).with_q(by_joint("q", q)?).with_qd(by_joint("qd", qd)?);
        Ok(Self::with(slf, |builder| builder.start(start)))
    }
}

getters! {
    in PyScene;

    /// Names of the keyframes, in the order of the file; unnamed ones are called "key0" and so on.
    keyframes: Names<'py> = |of, py| PyTuple::new(py, of.scene.keyframes().collect::<Vec<_>>());
}

typed_methods! {
    in PyScene;

    /// Configuration from which motions begin: that of the file (MJCF: qpos0), or of a keyframe.
    #[doc = section!(Parameters)]
    /// keyframe : str or int, optional
    ///     Name or index of a keyframe. None: the start.
    #[doc = section!(Returns)]
    /// q : (nq,) ndarray
    ///     Joint positions, rad or m. The neutral ones, unless an MJCF file or SceneBuilder.start defines others.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An unknown keyframe. The message lists the names.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3).to_builder().start({"j1": 0.5}, keyframe="bent").build()
    /// >>> scene.keyframes, scene.initial("bent")
    /// (('bent',), array([0. , 0.5, 0. ]))
    fn initial[&self, py: Python<'py>](keyframe: Option<&Object<'py>> = None) -> PyResult<Object<'py>> {
        let q = self.scene.initial(self.keyframe(keyframe)?.as_deref())?;
        from_numbers(py, &q, &[self.scene.nq()])
    }

    /// Joint velocities of the start or of a keyframe (MJCF: qvel), with which motions begin.
    #[doc = section!(Parameters)]
    /// keyframe : str or int, optional
    ///     Name or index of a keyframe. None: the start.
    #[doc = section!(Returns)]
    /// qd : (nv,) ndarray
    ///     Joint velocities, rad/s or m/s. Zero, unless an MJCF file or SceneBuilder.start defines others.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An unknown keyframe. The message lists the names.
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).initial_velocity()
    /// array([0., 0., 0.])
    fn initial_velocity[&self, py: Python<'py>](keyframe: Option<&Object<'py>> = None) -> PyResult<Object<'py>> {
        let qd = self.scene.initial_velocity(self.keyframe(keyframe)?.as_deref())?;
        from_numbers(py, &qd, &[self.scene.nv()])
    }
}

impl PyScene {
    /// The name of a keyframe that is given by name or index.
    fn keyframe(&self, given: Option<&Object<'_>>) -> PyResult<Option<String>> {
        let Some(given) = given else { return Ok(None) };
        let index = given.extract::<usize>().ok();
        let name = index.map_or_else(|| given.extract().ok(), |at| self.scene.keyframes().nth(at).map(str::to_owned));
        match name {
            Some(name) => Ok(Some(name)),
            None => Err(self.scene.unknown_keyframe(given.repr()?.to_string()).into()),
        }
    }
}

/// Reads values by joint name.
fn by_joint(argument: &str, given: Option<&Object<'_>>) -> PyResult<BTreeMap<String, Vec<f64>>> {
    let Some(given) = given else { return Ok(BTreeMap::new()) };
    let Ok(mapping) = given.cast::<PyMapping>() else {
        return refuse(argument, given.repr()?.to_string(), "a dict from names of joints to coordinates");
    };
    let each = items(argument, mapping, "names of joints")?.into_iter().map(|(joint, value)| {
        let name = format!("{argument}[{joint:?}]");
        let (shape, numbers) = input::shaped(&name, &value, 0)?;
        if shape.len() > 1 {
            return Err(input::wrong_shape(&name, &shape, "() or (k,)".to_owned()));
        }
        Ok((joint, numbers))
    });
    each.collect()
}
