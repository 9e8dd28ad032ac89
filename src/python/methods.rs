//! The declarations of methods and properties in Python. An argument stands once: what PyO3 reads, and the signature
//! that Python shows, are made from it.

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

/// The name of an argument in Python.
#[rustfmt::skip]
macro_rules! name_of {
    (r#type) => { "type" };
    ($name:ident) => { stringify!($name) };
}

/// A default as `inspect.signature` shows it.
#[rustfmt::skip]
macro_rules! shown {
    (true) => { "True" };
    (false) => { "False" };
    ($usual:tt) => { stringify!($usual) };
    ($usual:tt, $shown:literal) => { $shown };
}

/// Arguments in parentheses and the end of the signature in a docstring: first `$self`, if any.
#[rustfmt::skip]
macro_rules! listed {
    ([$($this:tt)?] $($part:tt)*) => { listed!($($this)? $($part)*) };
    (($($first:tt)*) $(($($other:tt)*))*) => { concat!("(", $($first)* $(, ", ", $($other)*)*, ")\n--\n") };
}

/// Methods of a class whose arguments stand once: `fn name[receiver](positional; keywords) -> Result { body }`, each
/// argument as `name: Type = default`. `=>`: the default as signatures show it; `**name`: other keywords, which they do
/// not show. Python takes the signature from the first line of the docstring. `static in`: methods without an object.
macro_rules! typed_methods {
    (in $class:ident; $($methods:tt)*) => { typed_methods!(@ [("$self")] $class; $($methods)*); };
    (static in $class:ident; $($methods:tt)*) => { typed_methods!(@ [] $class; $($methods)*); };
    (@ $this:tt $class:ident; $(
        $(#[$meta:meta])*
        fn $name:ident[$($receiver:tt)*](
            $($first:ident: $kind:ty $(= $usual:tt $(=> $shown:literal)?)?),*
            $(; $($keyword:ident: $type:ty $(= $value:tt $(=> $text:literal)?)?),*)?
            $(, **$rest:ident)?
        ) -> $result:ty $body:block
    )*) => {
        #[pymethods]
        #[allow(clippy::elidable_lifetime_names, clippy::extra_unused_lifetimes)] // of some types
        impl $class {
            $(
                #[doc = concat!(stringify!($name), listed!(
                    $this $((name_of!($first) $(, "=", shown!($usual $(, $shown)?))?))*
                    $(("*") $((stringify!($keyword) $(, "=", shown!($value $(, $text)?))?))*)?
                ))]
                $(#[$meta])*
                #[pyo3(
                    signature = ($($first $(= $usual)?,)* $(*, $($keyword $(= $value)?,)*)? $(**$rest)?),
                    text_signature = None
                )]
                fn $name<'py>(
                    $($receiver)*, $($first: $kind,)* $($($keyword: $type,)*)? $($rest: Option<&Bound<'py, PyDict>>)?
                ) -> $result $body
            )*
        }
    };
}

/// Copies of an immutable object of a class in Python.
macro_rules! copied_as_itself {
    ($class:ident) => {
        #[pymethods]
        impl $class {
            /// The object itself, because it is immutable.
            fn __copy__(slf: Py<Self>) -> Py<Self> {
                slf
            }

            /// The object itself, because it is immutable.
            #[pyo3(signature = (memo, /))]
            fn __deepcopy__(slf: Py<Self>, memo: &Object<'_>) -> Py<Self> {
                let _ = memo;
                slf
            }
        }
    };
}

/// Properties of a class in Python: `name: Type = |object, py| value;`.
macro_rules! getters {
    (in $class:ident; $(
        $(#[$meta:meta])*
        $visible:vis $name:ident: $kind:ty = |$of:ident, $py:pat_param| $value:expr;
    )*) => {
        #[pymethods]
        #[allow(clippy::elidable_lifetime_names)] // the lifetime is that of some types
        impl $class {
            $(
                $(#[$meta])*
                #[getter]
                $visible fn $name<'py>(&self, py: Python<'py>) -> $kind {
                    let ($of, $py) = (self, py);
                    $value
                }
            )*
        }
    };
}
