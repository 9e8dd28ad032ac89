//! The types of the table of functions. Its rows are in the file of the algorithms.

/// The length of an axis of an array of one state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// nq: coordinates.
    Coordinates,
    /// nv: joint velocities, one per degree of freedom.
    Velocities,
    /// Links of the scene.
    Links,
    /// Rows of the scene's connections.
    ConnectionRows,
    /// The same in every scene.
    Fixed(usize),
}

/// The lengths that a scene gives to axes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sizes {
    /// Coordinates.
    pub nq: usize,
    /// Degrees of freedom.
    pub nv: usize,
    /// Links.
    pub links: usize,
    /// Rows of connections.
    pub connection_rows: usize,
}

impl Axis {
    /// Its length in a scene of these sizes.
    #[must_use]
    #[inline]
    pub fn length(self, sizes: &Sizes) -> usize {
        match self {
            Self::Coordinates => sizes.nq,
            Self::Velocities => sizes.nv,
            Self::Links => sizes.links,
            Self::ConnectionRows => sizes.connection_rows,
            Self::Fixed(length) => length,
        }
    }
}

/// An argument or a result of one state: its name and its axes; the values are stored row by row.
pub type Array = (&'static str, &'static [Axis]);

/// The number of values of an array.
#[must_use]
#[inline]
pub fn width((_, axes): Array, sizes: &Sizes) -> usize {
    axes.iter().map(|axis| axis.length(sizes)).product()
}

/// How code for one robot has a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Compiled {
    /// Below this number of states the call of the scene takes less time than that of compiled code, because its way
    /// from Python is 3 to 6 us shorter: measured on arms of six and seven joints and on a humanoid.
    pub few: usize,
    /// The function that also returns the margin of its error estimate, where it has one.
    pub watched: Option<&'static str>,
}

/// One function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // columns of a table
pub struct FunctionEntry {
    /// The name of the method of scenes.
    pub name: &'static str,
    /// A summary of one line.
    pub summary: &'static str,
    /// Its arguments: q, then qd, then tau or qdd, then directions, a cotangent or the compliance.
    pub arguments: &'static [Array],
    /// The number of arguments that are a state.
    pub state: usize,
    /// Its results, which lie one after another for each state.
    pub results: &'static [Array],
    /// The function that it is the derivative of.
    pub derivative_of: Option<&'static str>,
    /// Rough time of one state in ns: for each body, and for each body and degree of freedom. It decides about
    /// threads, not about results.
    pub cost: [usize; 2],
    /// True if it is computed in a [`Form`](crate::Form).
    pub has_form: bool,
    /// True if it takes the argument dtype.
    pub has_dtype: bool,
    /// True if it is of a frame on a link.
    pub of_link: bool,
    /// True if it needs mass on a moving link.
    pub needs_mass: bool,
    /// How code for one robot has it.
    pub compiled: Option<Compiled>,
}

impl FunctionEntry {
    /// True if it takes velocities, and the name of the third array of its state.
    #[must_use]
    #[inline]
    pub fn reads(&self) -> (bool, Option<&'static str>) {
        (self.state > 1, if self.state > 2 { Some(self.arguments[2].0) } else { None })
    }

    /// The arguments after the state.
    #[must_use]
    #[inline]
    pub fn seeds(&self) -> &'static [Array] {
        &self.arguments[self.state..]
    }

    /// The number of values of all results of one state.
    #[must_use]
    #[inline]
    pub fn width(&self, sizes: &Sizes) -> usize {
        self.results.iter().map(|&result| width(result, sizes)).sum()
    }

    /// The shape of the results of one state as one array, into `room`: results of the same axes along an axis of
    /// their own, others one after another.
    #[must_use]
    pub fn shape<'r>(&self, sizes: &Sizes, room: &'r mut [usize; 4]) -> &'r [usize] {
        let (_, first) = self.results[0];
        if self.results.iter().any(|(_, axes)| *axes != first) {
            room[0] = self.width(sizes);
            return &room[..1];
        }
        let several = usize::from(self.results.len() > 1);
        room[0] = self.results.len();
        for (length, axis) in room[several..].iter_mut().zip(first) {
            *length = axis.length(sizes);
        }
        &room[..several + first.len()]
    }
}

/// The number of leading arguments that are a state: what follows is named after a change of them (dq), a cotangent
/// or the compliance.
pub(super) const fn arrays_of_state(arguments: &[Array]) -> usize {
    let mut count = 0;
    while count < arguments.len() && !matches!(arguments[count].0.as_bytes()[0], b'd' | b'c') {
        count += 1;
    }
    count
}

/// A row in which nothing but the names is set.
pub(super) const PLAIN: FunctionEntry = FunctionEntry {
    name: "",
    summary: "",
    arguments: &[],
    state: 0,
    results: &[],
    derivative_of: None,
    cost: [0, 0],
    has_form: false,
    has_dtype: false,
    of_link: false,
    needs_mass: false,
    compiled: None,
};

/// The rows of the table, each as a constant, and all of them as [`FUNCTIONS`](super::FUNCTIONS).
macro_rules! functions {
    ($($id:ident = $name:ident($($argument:ident: $axes:ident),*)
        -> ($($result:ident: $of_result:ident),*), $summary:literal $(, $field:ident: $value:expr)*;)*) => {
        $(
            #[doc = $summary]
            pub(crate) static $id: FunctionEntry = FunctionEntry {
                name: stringify!($name),
                summary: $summary,
                arguments: &[$((stringify!($argument), $axes)),*],
                state: table::arrays_of_state(&[$((stringify!($argument), $axes)),*]),
                results: &[$((stringify!($result), $of_result)),*],
                $($field: $value,)*
                ..table::PLAIN
            };
        )*

        /// Every function of the table.
        pub static FUNCTIONS: &[&FunctionEntry] = &[$(&$id),*];
    };
}
pub(super) use functions;
