//! Functions of generated programs: their rows in the table ([`algorithm`](crate::algorithm)), their traces, and the
//! results of the scene's methods.

use super::tracing::Place;
use super::{reference, tracing};
use crate::algorithm::table::{self, Compiled, CompiledFor, FunctionEntry};
use crate::algorithm::{self, Algorithm};
use crate::error::{Error, in_language};
use crate::filter::Form;
use crate::kinematics::{Frame, ReferenceFrame};
use crate::scene::Scene;
use crate::spatial::RigidShift;

/// The enum of functions with their rows of the table and their traces, and the lists of those that do not depend on a
/// link. A trace has the results of the scene's method, followed by the margin if the function has one.
macro_rules! functions {
    (
        $(#[$about:meta])* enum $name:ident;
        $(#[$about_plain:meta])* list $plain_list:ident {
            $($(#[$of_plain:meta])* $plain:ident: $row_of_plain:ident, $trace_of_plain:ident;)*
        }
        others { $($(#[$of_other:meta])* $other:ident: $row_of_other:ident, $trace_of_other:ident;)* }
        links { $($(#[$of_link:meta])* $linked:ident($($field:ty),*): $row_of_link:ident, $trace_of_link:ident;)* }
    ) => {
        $(#[$about])*
        #[derive(Debug, Clone, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum $name {
            $($(#[$of_plain])* $plain,)*
            $($(#[$of_other])* $other,)*
            $($(#[$of_link])* $linked($($field),*),)*
            /// A function that also returns the margin of its error estimate: negative or NaN for a state that the
            /// methods of the scene recompute in form auto. With connections, also where the rows are dependent, or the
            /// state violates the connections.
            Watched(&'static $name),
        }

        $(#[$about_plain])*
        pub const $plain_list: &[$name] = &[$($name::$plain),*];

        impl $name {
            /// Its row of the table, and its trace.
            fn line(&self) -> (&'static FunctionEntry, tracing::Trace) {
                match self {
                    $(Self::$plain => (&algorithm::$row_of_plain, tracing::$trace_of_plain),)*
                    $(Self::$other => (&algorithm::$row_of_other, tracing::$trace_of_other),)*
                    $(Self::$linked(..) => (&algorithm::$row_of_link, tracing::$trace_of_link),)*
                    Self::Watched(of) => of.line(),
                }
            }
        }
    };
}

functions! {
    /// A function of a program, named like the method of scenes.
    enum Function;

    /// All functions that do not depend on a link, without those that return a margin. [`Function::of`] lists those of
    /// one scene.
    list FUNCTIONS {
        /// qdd of (q, qd, tau), in covariance form, through the connections of the scene.
        ForwardDynamics: FORWARD_DYNAMICS, forward_dynamics;
        /// qdd, the forces of the connections, the rank of their rows and the largest residual, of (q, qd, tau) and the
        /// compliance of each row; in covariance form.
        ConstrainedDynamics: CONSTRAINED_DYNAMICS, constrained_dynamics;
        /// tau of (q, qd, qdd).
        InverseDynamics: INVERSE_DYNAMICS, inverse_dynamics;
        /// The torque of the bias, of (q, qd).
        BiasTorque: BIAS_TORQUE, inverse_dynamics;
        /// M of q, row by row.
        MassMatrix: MASS_MATRIX, mass_matrix;
        /// M^-1 of q, row by row, in covariance form.
        MassMatrixInverse: MASS_MATRIX_INVERSE, mass_matrix_inverse;
        /// dqdd/dq, dqdd/dqd and M^-1 of (q, qd, tau), each row by row, by q in its tangent space; in covariance form.
        ForwardDynamicsDerivatives: FORWARD_DYNAMICS_DERIVATIVES, forward_dynamics_derivatives;
        /// dtau/dq, dtau/dqd and M of (q, qd, qdd), each row by row, by q in its tangent space.
        InverseDynamicsDerivatives: INVERSE_DYNAMICS_DERIVATIVES, inverse_dynamics_derivatives;
        /// dqdd of (q, qd, tau) along (dq, dqd, dtau), in covariance form.
        ForwardDynamicsJvp: FORWARD_DYNAMICS_JVP, forward_dynamics_jvp;
        /// The gradients of c . qdd by q, qd and tau, of (q, qd, tau) and c; in covariance form.
        ForwardDynamicsVjp: FORWARD_DYNAMICS_VJP, forward_dynamics_vjp;
        /// dtau of (q, qd, qdd) along (dq, dqd, dqdd).
        InverseDynamicsJvp: INVERSE_DYNAMICS_JVP, inverse_dynamics_jvp;
        /// The gradients of x . tau by q, qd and qdd, of (q, qd, qdd) and x.
        InverseDynamicsVjp: INVERSE_DYNAMICS_VJP, inverse_dynamics_vjp;
        /// The pose of every link, of q: one homogeneous matrix each, in the order of [`Scene::links`].
        Placements: PLACEMENTS, placements;
        /// The distance of each contact from its plane, of q.
        ContactGaps: CONTACT_GAPS, contact_gaps;
        /// The velocity of the point of each contact in the base frame, of (q, qd).
        ContactVelocities: CONTACT_VELOCITIES, contact_velocities;
        /// J M^-1 J^T of these points, of q; in covariance form.
        ContactGram: CONTACT_GRAM, contact_gram;
    }

    others {
        /// The margin for q only: of the factor of M.
        FactorWatched: FACTOR_WATCHED, factor;
    }

    links {
        /// The pose of the link of this name, of q: a homogeneous matrix.
        Placement(String): PLACEMENT, placement;
        /// The Jacobian of the link of this name, of q, (6 x nv), with the velocity expressed in this frame.
        Jacobian(String, ReferenceFrame): JACOBIAN, jacobian;
    }
}

/// The functions that return the margin of an error estimate.
pub const WATCHED: &[Function] = &[
    Function::Watched(&Function::ForwardDynamics),
    Function::Watched(&Function::ConstrainedDynamics),
    Function::Watched(&Function::MassMatrixInverse),
    Function::FactorWatched,
    Function::Watched(&Function::ForwardDynamicsDerivatives),
    Function::Watched(&Function::ForwardDynamicsJvp),
    Function::Watched(&Function::ForwardDynamicsVjp),
];

/// An argument or a result of a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Array {
    /// Its name.
    pub name: &'static str,
    /// Its axes; scalars are stored row by row.
    pub shape: Vec<usize>,
}

impl Array {
    /// Number of scalars per state.
    #[must_use]
    pub fn width(&self) -> usize {
        self.shape.iter().product()
    }

    /// Names of arrays, with the number of scalars per state.
    pub(super) fn sized(all: &[Self]) -> Vec<(&'static str, usize)> {
        all.iter().map(|array| (array.name, array.width())).collect()
    }
}

impl Function {
    /// The function without the margin.
    pub(super) fn plain(&self) -> &Self {
        if let Self::Watched(of) = self { of } else { self }
    }

    /// The algorithm of the scene that computes it, if there is one; in covariance form if the algorithm has forms.
    fn algorithm(&self) -> Option<Algorithm> {
        Algorithm::all(Form::default()).find(|algorithm| algorithm.entry().name == self.line().0.name)
    }

    /// Its name, as that of the scene's method.
    #[must_use]
    pub fn name(&self) -> &'static str {
        let row = self.line().0;
        match (self, row.compiled) {
            (Self::Watched(_), Some(Compiled { watched: Some(name), .. })) => name,
            _ => row.name,
        }
    }

    /// Identifier in the generated code: the name of the function; for functions of one link also the name of the link,
    /// with _ for characters that identifiers do not allow, and the reference frame unless it is the link's.
    #[must_use]
    pub fn symbol(&self) -> String {
        let name = self.name();
        match self.link() {
            None => name.to_owned(),
            Some((link, ReferenceFrame::Local)) => format!("{name}_{}", identifier(link)),
            Some((link, reference)) => format!("{name}_{}_{}", identifier(link), identifier(reference.name())),
        }
    }

    /// Its link, and the frame in which motions are expressed.
    fn link(&self) -> Option<(&str, ReferenceFrame)> {
        match self {
            Self::Placement(link) => Some((link, ReferenceFrame::Local)),
            Self::Jacobian(link, reference) => Some((link, *reference)),
            _ => None,
        }
    }

    /// The frame of that link in `scene`; the frame of the base without a link.
    pub(super) fn place(&self, scene: &Scene) -> Result<Place, Error> {
        let Some((link, reference)) = self.link() else {
            return Ok((Frame { body: None, placement: RigidShift::identity() }, ReferenceFrame::Local));
        };
        Ok((scene.frame(&link.into())?, reference))
    }

    /// All functions with code for `scene`, without those of one link and those that return a margin.
    #[must_use]
    pub fn of(scene: &Scene) -> Vec<Self> {
        FUNCTIONS.iter().filter(|function| function.check(scene).is_ok()).cloned().collect()
    }

    /// An error if there is no code of this function for the connections, contacts or mimic joints of the scene.
    pub(super) fn check(&self, scene: &Scene) -> Result<(), Error> {
        let row = self.line().0;
        let scenes = row.compiled.map_or(CompiledFor::Every, |compiled| compiled.scenes);
        let names: Vec<String> = scene.constraints().all.iter().take(8).map(|of| format!("{:?}", of.name)).collect();
        let (of, expected) = match scenes {
            CompiledFor::Trees | CompiledFor::TreesWithContacts if !names.is_empty() => (
                format!("connections ({})", names.join(", ")),
                "functions with code for connections, such as forward_dynamics: the scene computes this one",
            ),
            CompiledFor::Loops if names.is_empty() => {
                ("a scene without connections".to_owned(), "forward_dynamics, or a scene with connections")
            }
            CompiledFor::Contacts | CompiledFor::TreesWithContacts if scene.contacts().is_empty() => {
                ("a scene without contacts".to_owned(), "other functions, or a scene with contacts")
            }
            CompiledFor::Contacts | CompiledFor::TreesWithContacts if !scene.contacts_have_planes() => (
                "contacts with spheres, boxes or other links".to_owned(),
                "other functions, or contacts with planes of the base",
            ),
            CompiledFor::TreesWithContacts if scene.coupling().is_some() => (
                "joints that follow others (mimic)".to_owned(),
                in_language("other functions, or MimicJoints::Free", "other functions, or mimic=\"free\""),
            ),
            _ => return Ok(()),
        };
        Err(Error::argument("functions", format!("{} for {of}", row.name), expected))
    }

    /// True if it is computed through the connections of a scene that has some.
    pub(super) fn has_rows(&self, scene: &Scene) -> bool {
        !scene.constraints().is_empty() && self.algorithm().is_some_and(Algorithm::goes_through_connections)
    }

    /// True if its last result is a margin.
    pub(super) fn has_margin(&self) -> bool {
        matches!(self, Self::Watched(_) | Self::FactorWatched)
    }

    /// True if it forms M^-1.
    pub(super) fn has_inverse(&self) -> bool {
        matches!(self.plain(), Self::MassMatrixInverse | Self::ForwardDynamicsDerivatives)
    }

    /// The summary of the table, with the link.
    #[must_use]
    pub fn meaning(&self) -> String {
        let meaning = self.line().0.summary;
        match self {
            Self::Placement(link) => format!("{link:?}. {meaning}"),
            Self::Jacobian(link, reference) => format!("{link:?}, {}. {meaning}", reference.name()),
            Self::Watched(_) => format!("{meaning}; precision may be lost where the margin is negative"),
            _ => meaning.to_owned(),
        }
    }

    /// Its arguments for `scene`, q first.
    #[must_use]
    pub fn arguments(&self, scene: &Scene) -> Vec<Array> {
        arrays(scene, self.line().0.arguments)
    }

    /// Its results.
    #[must_use]
    pub fn results(&self, scene: &Scene) -> Vec<Array> {
        let mut results = arrays(scene, self.line().0.results);
        results.extend(matches!(self, Self::Watched(_)).then_some(Array { name: "margin", shape: Vec::new() }));
        results
    }

    /// Its results in the table.
    pub(super) fn table_results(&self) -> &'static [table::Array] {
        self.line().0.results
    }

    /// Number of scalars of all results together.
    #[must_use]
    pub fn width(&self, scene: &Scene) -> usize {
        self.results(scene).iter().map(Array::width).sum()
    }

    pub(super) fn trace(&self) -> tracing::Trace {
        self.line().1
    }

    /// The results of the scene's method for these arguments, one after another, without the margin.
    pub(super) fn by_scene(&self, scene: &Scene, arguments: &[&[f64]]) -> Result<Vec<f64>, Error> {
        let mut out = vec![f64::NAN; self.width(scene) - usize::from(self.has_margin())];
        let (frame, reference) = self.place(scene)?;
        match (self.plain(), self.algorithm()) {
            (_, Some(algorithm)) => reference::evaluated(scene, algorithm, arguments, &mut out)?,
            (Self::FactorWatched, _) => {}
            (Self::ContactGaps, _) => scene.contact_gaps(arguments[0], &mut out)?,
            (Self::ContactVelocities, _) => scene.contact_velocities(arguments[0], arguments[1], &mut out)?,
            (Self::ContactGram, _) => {
                let mut workspace = scene.workspace();
                workspace.form = Form::default();
                scene.contact_gram(&mut workspace, arguments[0], &mut out)?;
            }
            (Self::Placement(_), _) => scene.placement(arguments[0], frame)?.homogeneous(&mut out),
            (Self::Jacobian(..), _) => scene.jacobian(arguments[0], frame, reference, &mut out)?,
            _ => {
                for (placement, out) in scene.placements(arguments[0])?.iter().zip(out.chunks_exact_mut(16)) {
                    placement.homogeneous(out);
                }
            }
        }
        Ok(out)
    }
}

fn arrays(scene: &Scene, of_table: &'static [table::Array]) -> Vec<Array> {
    let sizes = scene.sizes();
    let shape = |axes: &[table::Axis]| axes.iter().map(|axis| axis.length(&sizes)).collect();
    of_table.iter().map(|&(name, axes)| Array { name, shape: shape(axes) }).collect()
}

/// A name with all characters except letters, digits and _ replaced by _.
fn identifier(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::algorithm;

    #[test]
    fn the_list_is_that_of_the_table() {
        let table = algorithm::FUNCTIONS.iter().filter(|entry| entry.compiled.is_some() && !entry.of_link);
        let mut names: Vec<&str> = table.clone().map(|entry| entry.name).collect();
        let mut known: Vec<&str> = FUNCTIONS.iter().map(Function::name).collect();
        names.sort_unstable();
        known.sort_unstable();
        assert_eq!(names, known);
        let mut watched: Vec<&str> =
            table.filter_map(|entry| entry.compiled?.watched).chain(["factor_watched"]).collect();
        let mut known: Vec<&str> = WATCHED.iter().map(Function::name).collect();
        watched.sort_unstable();
        known.sort_unstable();
        assert_eq!(watched, known);
    }
}
