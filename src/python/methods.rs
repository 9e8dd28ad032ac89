//! The declarations of methods whose arguments are arrays of a state and the keywords that many methods share.

/// Methods of `Scene` for Python: `fn name(arrays; keywords) |scene, py| body`. Arrays are positional; the keywords
/// have the types and defaults of the rules `@typed`. `link` among the arrays is a str.
macro_rules! methods {
    ($(
        $(#[$meta:meta])*
        fn $name:ident($($array:ident),*; $($keyword:ident),*) |$scene:ident, $py:ident| $body:block
    )*) => {
        $(methods!(@next [$(#[$meta])*] $name [] [] [$($array)*] [$($keyword)*] |$scene, $py| $body);)*
    };
    // The next argument, once as the token that the rules match and once as the name that the body knows.
    (@next $docs:tt $name:ident $typed:tt $names:tt [$array:ident $($rest:ident)*] $($more:tt)*) => {
        methods!(@array ($array $array) $docs $name $typed $names [$($rest)*] $($more)*);
    };
    (@array (link $a:ident) $docs:tt $name:ident [$($typed:tt)*] [$($names:tt)*] $($more:tt)*) => {
        methods!(@next $docs $name [$($typed)* $a: &str,] [$($names)* $a,] $($more)*);
    };
    (@array ($other:ident $a:ident) $docs:tt $name:ident [$($typed:tt)*] [$($names:tt)*] $($more:tt)*) => {
        methods!(@next $docs $name [$($typed)* $a: &Object<'py>,] [$($names)* $a,] $($more)*);
    };
    (@next $docs:tt $name:ident $typed:tt [$($names:tt)*] [] [$($keyword:ident)*] $($more:tt)*) => {
        methods!(@keyword $docs $name $typed [$($names)* *,] [$($keyword)*] $($more)*);
    };
    (@keyword $docs:tt $name:ident $typed:tt $names:tt [$keyword:ident $($rest:ident)*] $($more:tt)*) => {
        methods!(@typed ($keyword $keyword) $docs $name $typed $names [$($rest)*] $($more)*);
    };
    (@typed (errors $k:ident) $($more:tt)*) => { methods!(@add ($k: &str = "raise") $($more)*); };
    (@typed (form $k:ident) $($more:tt)*) => { methods!(@add ($k: &str = "auto") $($more)*); };
    (@typed (frame $k:ident) $($more:tt)*) => { methods!(@add ($k: &str = "local") $($more)*); };
    (@typed (kind $k:ident) $($more:tt)*) => { methods!(@add ($k: &str = "spatial") $($more)*); };
    (@typed (tolerance $k:ident) $($more:tt)*) => { methods!(@add ($k: Option<f64> = None) $($more)*); };
    (@typed (parameters $k:ident) $($more:tt)*) => { methods!(@add ($k: bool = false) $($more)*); };
    (@typed (springs_and_damping $k:ident) $($more:tt)*) => { methods!(@add ($k: bool = true) $($more)*); };
    (@typed (return_info $k:ident) $($more:tt)*) => { methods!(@add ($k: bool = false) $($more)*); };
    (@typed ($other:ident $k:ident) $($more:tt)*) => { methods!(@add ($k: Option<&Object<'py>> = None) $($more)*); };
    (@add ($k:ident: $kind:ty = $default:tt) $docs:tt $name:ident [$($typed:tt)*] [$($names:tt)*] $($more:tt)*) => {
        methods!(@keyword $docs $name [$($typed)* $k: $kind,] [$($names)* $k = $default,] $($more)*);
    };
    (@keyword [$(#[$meta:meta])*] $name:ident [$($typed:tt)*] [$($names:tt)*] []
        |$scene:ident, $py:ident| $body:block) => {
        #[pymethods]
        impl PyScene {
            $(#[$meta])*
            #[pyo3(signature = ($($names)*))]
            #[allow(clippy::too_many_arguments)] // keywords, in Python
            fn $name<'py>(&self, py: Python<'py>, $($typed)*) -> PyResult<Object<'py>> {
                let ($scene, $py) = (self, py);
                $body
            }
        }
    };
}

/// Methods of `Scene` that are functions of a module of Python: `fn name(arguments) = module, function;`. The function
/// receives the scene, the positional arguments, and the keywords, which it checks.
macro_rules! methods_in_python {
    ($(
        $(#[$meta:meta])*
        fn $name:ident($($argument:ident $(= $default:tt)?),*) = $module:literal, $function:literal;
    )*) => {
        #[pymethods]
        impl PyScene {
            $(
                $(#[$meta])*
                #[pyo3(signature = ($($argument $(= $default)?,)* **how))]
                fn $name<'py>(
                    slf: &Bound<'py, Self>,
                    $($argument: Option<&Object<'py>>,)*
                    how: Option<&Bound<'py, PyDict>>,
                ) -> PyResult<Object<'py>> {
                    imported!(slf.py(), $module, $function)?.call((slf, $($argument,)*), how)
                }
            )*
        }
    };
}
