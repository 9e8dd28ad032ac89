//! The declarations of methods whose arguments are arrays of a state and the keywords that many methods share.

/// Methods of `Scene` for Python: `fn name(arrays; keywords) => function(what);` calls a function of the scene with
/// `what`, the arrays and the [`Keywords`](super::keywords::Keywords); `|scene, py, keywords| body` has its own body.
/// Arrays are positional; the keywords have the types and defaults of the rules `@typed`. `link` among the arrays is a
/// str. `in PyLoops;` before them: methods of a group of the scene.
macro_rules! methods {
    (in $class:ident; $(
        $(#[$meta:meta])*
        fn $name:ident($($array:ident),*; $($keyword:ident),*)
        $(|$scene:ident, $py:ident $(, $keywords:ident)?| $body:block)? $(=> $run:ident($($what:tt)*);)?
    )*) => {
        $(methods!(@next [$class $(#[$meta])*] $name [] [] [] [] [$($array)*] [$($keyword)*]
            $(|$scene, $py $(, $keywords)?| $body)? $(=> $run($($what)*))?);)*
    };
    (# $($methods:tt)*) => { methods!(in PyScene; # $($methods)*); };
    // The next argument, once as the token that the rules match and once as the name that the body knows.
    (@next $docs:tt $name:ident $typed:tt $names:tt $given:tt $set:tt [$array:ident $($rest:ident)*] $($more:tt)*) => {
        methods!(@array ($array $array) $docs $name $typed $names $given $set [$($rest)*] $($more)*);
    };
    (@array (link $a:ident) $docs:tt $name:ident [$($typed:tt)*] [$($names:tt)*] $given:tt [$($set:ident)*]
        $($more:tt)*) => {
        methods!(@next $docs $name [$($typed)* $a: &str,] [$($names)* $a,] $given [$($set)* $a] $($more)*);
    };
    (@array ($other:ident $a:ident) $docs:tt $name:ident [$($typed:tt)*] [$($names:tt)*] [$($given:tt)*]
        $($more:tt)*) => {
        methods!(@next $docs $name [$($typed)* $a: &Object<'py>,] [$($names)* $a,] [$($given)* $a,] $($more)*);
    };
    (@next $docs:tt $name:ident $typed:tt [$($names:tt)*] $given:tt $set:tt [] [$($keyword:ident)*] $($more:tt)*) => {
        methods!(@keyword $docs $name $typed [$($names)* *,] $given $set [$($keyword)*] $($more)*);
    };
    (@keyword $docs:tt $name:ident $typed:tt $names:tt $given:tt $set:tt [$keyword:ident $($rest:ident)*]
        $($more:tt)*) => {
        methods!(@typed ($keyword $keyword) $docs $name $typed $names $given $set [$($rest)*] $($more)*);
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
    (@add ($k:ident: $kind:ty = $default:tt) $docs:tt $name:ident [$($typed:tt)*] [$($names:tt)*] $given:tt
        [$($set:ident)*] $($more:tt)*) => {
        methods!(@keyword $docs $name
            [$($typed)* $k: $kind,] [$($names)* $k = $default,] $given [$($set)* $k] $($more)*);
    };
    (@keyword [$class:ident $(#[$meta:meta])*] $name:ident [$($typed:tt)*] [$($names:tt)*] $given:tt $set:tt [] $($run:tt)*) => {
        #[pymethods]
        impl $class {
            $(#[$meta])*
            #[pyo3(signature = ($($names)*))]
            fn $name<'py>(&self, py: Python<'py>, $($typed)*) -> PyResult<Object<'py>> {
                methods!(@run self py $given $set $($run)*)
            }
        }
    };
    (@run $this:ident $of:ident $given:tt $set:tt |$scene:ident, $py:ident $(, $keywords:ident)?| $body:block) => {{
        let ($scene, $py) = ($this.as_scene(), $of);
        $(let $keywords = &methods!(@keywords $set);)?
        $body
    }};
    (@run $this:ident $py:ident [$($given:tt)*] $set:tt => $run:ident($($what:tt)*)) => {
        $this.$run($py, $($what)*, [$($given)*], &methods!(@keywords $set))
    };
    (@keywords [$($set:ident)*]) => {{
        let mut keywords = Keywords::none();
        $(keywords.$set = $set;)*
        keywords
    }};
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
                    let py = slf.py();
                    imported!(py, $module, $function)?.call((slf, $($argument,)*), how).map_err(|error| {
                        crate::python::choice::of_unknown(py, concat!("Scene.", stringify!($name)), how, error)
                    })
                }
            )*
        }
    };
}
