//! The types of the table of functions. Its rows are in the module [`algorithm`](super).

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
    /// Contacts of the scene.
    Contacts,
    /// A constant, equal for all scenes.
    Fixed(usize),
}

/// The lengths of axes in a scene.
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
    /// Contacts.
    pub contacts: usize,
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
            Self::Contacts => sizes.contacts,
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

/// The scenes for which there is code of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CompiledFor {
    /// All scenes.
    Every,
    /// Scenes without connections.
    Trees,
    /// Scenes with connections.
    Loops,
    /// Scenes with contacts.
    Contacts,
    /// Scenes with contacts, without connections and mimic joints.
    TreesWithContacts,
}

/// The availability of a function in code for one robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Compiled {
    /// Below this number of states, the method of the scene takes less time than compiled code, because its call from
    /// Python is 3 to 6 us shorter: measured on arms with six and seven joints and on a humanoid.
    pub few: usize,
    /// The function that also returns the margin of its error estimate, if there is one.
    pub watched: Option<&'static str>,
    /// The scenes for which there is code.
    pub scenes: CompiledFor,
}

impl Compiled {
    /// The same for some scenes only.
    pub(super) const fn of(self, scenes: CompiledFor) -> Self {
        Self { scenes, ..self }
    }
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
    /// The number of arguments that form the state.
    pub state: usize,
    /// Its results, stored one after another for each state.
    pub results: &'static [Array],
    /// The function of which it is the derivative.
    pub derivative_of: Option<&'static str>,
    /// Approximate time of one state, ns: per body, and per body and degree of freedom. It determines the number of
    /// threads, not the results.
    pub cost: [usize; 2],
    /// True if it is computed in a [`Form`](crate::Form).
    pub has_form: bool,
    /// True if it takes the argument dtype.
    pub has_dtype: bool,
    /// True if it is a function of a frame on a link.
    pub of_link: bool,
    /// True if it needs mass on a moving link.
    pub needs_mass: bool,
    /// For a function whose results are matrices (nv, nv): what a scene that is too large for them can use.
    pub instead: Option<&'static str>,
    /// The availability in code for one robot; None if no code is generated.
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

    /// The shape of the results of one state as one array, into `room`: results with equal axes are stacked along a new
    /// axis, others are concatenated.
    #[must_use]
    #[inline]
    pub fn shape<'r>(&self, sizes: &Sizes, room: &'r mut [usize; 4]) -> &'r [usize] {
        let (_, first) = self.results[0];
        if self.results[1..].iter().any(|(_, axes)| *axes != first) {
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

/// The number of leading arguments that form the state. The following arguments are named after a change of them (dq),
/// a cotangent or the compliance.
pub(super) const fn arrays_of_state(arguments: &[Array]) -> usize {
    let mut count = 0;
    while count < arguments.len() && !matches!(arguments[count].0.as_bytes()[0], b'd' | b'c') {
        count += 1;
    }
    count
}

/// A row in which only the names are set.
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
    instead: None,
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
