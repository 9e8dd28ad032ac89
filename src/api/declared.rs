//! The declarations of methods at one state whose arguments are arrays of a row of the table of functions.

/// Methods of `Scene` that compute an algorithm: `fn name(q, qd, tau, direction) -> qdd = algorithm of the form;`. The
/// third array of a state is followed by the wrenches, and they by a direction or a cotangent.
macro_rules! algorithms {
    ($(
        $(#[$meta:meta])*
        fn $name:ident($q:ident $(, $qd:ident $(, $u:ident $(, $seed:ident)?)?)?) -> $out:ident = $algorithm:expr;
    )*) => {
        impl Scene {
            $(
                $(#[$meta])*
                #[allow(clippy::too_many_arguments)] // a state has three arrays and forces
                pub fn $name(
                    &self,
                    workspace: &mut Workspace<f64>,
                    $q: &[f64],
                    $($qd: &[f64], $(
                        $u: &[f64],
                        wrenches: &[SpatialVector<f64>],
                        $($seed: algorithms!(@type $seed),)?
                    )?)?
                    $out: &mut [f64],
                ) -> Result<(), Error> {
                    let algorithm: fn(crate::filter::Form) -> Algorithm = $algorithm;
                    let state = Arguments {
                        q: $q,
                        $(qd: $qd, $(u: $u, wrenches, $(seed: algorithms!(@seed $seed $seed),)?)?)?
                        ..Arguments::default()
                    };
                    self.run_one(workspace, None, algorithm(workspace.form), &state, $out)
                }
            )*
        }
    };
    (@type direction) => { [&[f64]; 3] };
    (@type cotangent) => { &[f64] };
    (@seed direction $seed:ident) => { $seed };
    (@seed cotangent $seed:ident) => { [$seed, &[], &[]] };
}
pub(super) use algorithms;

/// Methods of `Scene` that compute a quantity of all bodies: `fn name(q, qd) -> type = quantity;`, or into an argument
/// `out` where the type is an underscore.
macro_rules! quantities {
    ($($(#[$meta:meta])* fn $name:ident($($given:ident),*) -> $result:tt = $what:ident;)*) => {
        impl Scene {
            $(quantities!(@method [$(#[$meta])*] $name($($given),*) $result KinematicQuantity::$what);)*
        }
    };
    (@method [$(#[$meta:meta])*] $name:ident($($given:ident),*) _ $what:expr) => {
        $(#[$meta])*
        pub fn $name(&self, workspace: &mut Workspace<f64>, $($given: &[f64],)* out: &mut [f64]) -> Result<(), Error> {
            self.quantity(Some(workspace), &$what, &[$($given),*], out)
        }
    };
    (@method [$(#[$meta:meta])*] $name:ident($($given:ident),*) $result:ident $what:expr) => {
        $(#[$meta])*
        pub fn $name(&self, workspace: &mut Workspace<f64>, $($given: &[f64]),*) -> Result<$result<f64>, Error> {
            self.numbers_of(Some(workspace), &$what, &[$($given),*]).map($result::from)
        }
    };
}
pub(super) use quantities;

/// As [`quantities`], of a frame on a link, with more arguments: `fn name(q, qd; reference: type) -> type = quantity;`.
macro_rules! quantities_of_links {
    ($(
        $(#[$meta:meta])*
        fn $name:ident($($given:ident),*; $($how:ident: $kind:ty),*) -> $result:tt = $what:ident;
    )*) => {
        impl Scene {
            $(quantities_of_links!(@method [$(#[$meta])*] $name($($given),*; $($how: $kind),*) $result $what);)*
        }
    };
    (@method [$(#[$meta:meta])*] $name:ident($($given:ident),*; $($how:ident: $kind:ty),*) _ $what:ident) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)] // a state has three arrays, and a link two more choices
        pub fn $name<'a>(
            &self,
            $($given: &[f64],)*
            link: impl Into<OnLink<'a>>,
            $($how: $kind,)*
            out: &mut [f64],
        ) -> Result<(), Error> {
            let frame = self.on_link(&link.into())?;
            self.quantity(None, &KinematicQuantity::$what(&frame, $($how),*), &[$($given),*], out)
        }
    };
    (@method [$(#[$meta:meta])*]
        $name:ident($($given:ident),*; $($how:ident: $kind:ty),*) $result:ident $what:ident) => {
        $(#[$meta])*
        pub fn $name<'a>(
            &self,
            $($given: &[f64],)*
            link: impl Into<OnLink<'a>>,
            $($how: $kind,)*
        ) -> Result<$result<f64>, Error> {
            let frame = self.on_link(&link.into())?;
            self.numbers_of(None, &KinematicQuantity::$what(&frame, $($how),*), &[$($given),*]).map($result::from)
        }
    };
}
pub(super) use quantities_of_links;
