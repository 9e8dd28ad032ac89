//! Groups of methods of a scene: classes that hold the scene.

use super::object::Object;
use super::scene::PyScene;
use pyo3::prelude::*;

/// Declares a group: its class, the property of the scene, and the end of its repr from the scene.
macro_rules! group {
    ($(#[$meta:meta])* $class:ident, $name:literal, $property:ident, |$scene:ident| $about:expr) => {
        $(#[$meta])*
        #[pyclass(frozen, name = $name, module = "phipsi")]
        pub(crate) struct $class(Py<PyScene>);

        impl $class {
            pub(super) fn as_scene(&self) -> &PyScene {
                self.0.get()
            }
        }

        #[pymethods]
        impl $class {
            fn __repr__(&self) -> String {
                let $scene = &self.as_scene().scene;
                format!("<phipsi.{}: {}>", $name, $about)
            }

            fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Object<'py>, (Py<PyScene>, &'static str))> {
                Ok((py.import("builtins")?.getattr("getattr")?, (self.0.clone_ref(py), stringify!($property))))
            }
        }

        #[pymethods]
        impl PyScene {
            $(#[$meta])*
            #[getter]
            fn $property(slf: Py<Self>) -> $class {
                $class(slf)
            }
        }
    };
}

group!(
    /// The connections of a scene, which close kinematic loops and couple joints.
    PyLoops, "Loops", loops, |scene| {
        format!("connections: {}, rows: {}", scene.connections().len(), scene.constraint_rows())
    }
);

group!(
    /// The contacts of a scene that have names: points and spheres on planes, spheres and boxes.
    PyContacts, "Contacts", contacts, |scene| scene.contacts().len()
);
