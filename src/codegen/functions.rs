//! Functions of generated programs: their rows in the table ([`algorithm`](crate::algorithm)), their traces, and the
//! results of the scene's methods.

use super::tracing::Place;
use super::{reference, tracing};
use crate::algorithm::table::{self, FunctionEntry};
use crate::algorithm::{
    Algorithm, BIAS_TORQUE, Derivatives, FACTOR_WATCHED, FORWARD_DYNAMICS, FORWARD_DYNAMICS_DERIVATIVES,
    FORWARD_DYNAMICS_JVP, FORWARD_DYNAMICS_VJP, FORWARD_DYNAMICS_WATCHED, INVERSE_DYNAMICS,
    INVERSE_DYNAMICS_DERIVATIVES, INVERSE_DYNAMICS_JVP, INVERSE_DYNAMICS_VJP, JACOBIAN, MASS_MATRIX,
    MASS_MATRIX_INVERSE, MASS_MATRIX_INVERSE_WATCHED, PLACEMENT, PLACEMENTS, Products,
};
use crate::error::Error;
use crate::filter::Form;
use crate::kinematics::{Frame, ReferenceFrame};
use crate::scene::Scene;
use crate::spatial::RigidShift;

/// A function of a program, named like the method of scenes.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Function {
    /// qdd of (q, qd, tau), in covariance form.
    ForwardDynamics,
    /// As `ForwardDynamics`, with the margin of its error estimate: negative or NaN for a state that the methods of the
    /// scene recompute in form auto.
    ForwardDynamicsWatched,
    /// tau of (q, qd, qdd).
    InverseDynamics,
    /// The torque of the bias, of (q, qd).
    BiasTorque,
    /// M of q, row by row.
    MassMatrix,
    /// M^-1 of q, row by row, in covariance form.
    MassMatrixInverse,
    /// As `MassMatrixInverse`, with the margin of its error estimate.
    MassMatrixInverseWatched,
    /// The margin for q only: of the factor of M, which derivatives and products of forward dynamics use.
    FactorWatched,
    /// dqdd/dq, dqdd/dqd and M^-1 of (q, qd, tau), each row by row, by q in its tangent space; in covariance form.
    ForwardDynamicsDerivatives,
    /// dtau/dq, dtau/dqd and M of (q, qd, qdd), each row by row, by q in its tangent space.
    InverseDynamicsDerivatives,
    /// dqdd of (q, qd, tau) along (dq, dqd, dtau), in covariance form.
    ForwardDynamicsJvp,
    /// The gradients of c . qdd by q, qd and tau, of (q, qd, tau) and c; in covariance form.
    ForwardDynamicsVjp,
    /// dtau of (q, qd, qdd) along (dq, dqd, dqdd).
    InverseDynamicsJvp,
    /// The gradients of x . tau by q, qd and qdd, of (q, qd, qdd) and x.
    InverseDynamicsVjp,
    /// The pose of every link, of q: one homogeneous matrix each, in the order of [`Scene::links`].
    Placements,
    /// The pose of the link of this name, of q: a homogeneous matrix.
    Placement(String),
    /// The Jacobian of the link of this name, of q, (6 x nv), with the velocity expressed in this frame.
    Jacobian(String, ReferenceFrame),
}

/// All functions that do not depend on a link, without those that return a margin.
pub const FUNCTIONS: [Function; 12] = [
    Function::ForwardDynamics,
    Function::InverseDynamics,
    Function::BiasTorque,
    Function::MassMatrix,
    Function::MassMatrixInverse,
    Function::ForwardDynamicsDerivatives,
    Function::InverseDynamicsDerivatives,
    Function::ForwardDynamicsJvp,
    Function::ForwardDynamicsVjp,
    Function::InverseDynamicsJvp,
    Function::InverseDynamicsVjp,
    Function::Placements,
];

/// The functions that also return the margin of their error estimate.
pub const WATCHED: [Function; 3] =
    [Function::ForwardDynamicsWatched, Function::MassMatrixInverseWatched, Function::FactorWatched];

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
    /// Its row of the table, and its trace.
    fn line(&self) -> (&'static FunctionEntry, tracing::Trace) {
        match self {
            Self::ForwardDynamics => (&FORWARD_DYNAMICS, tracing::forward_dynamics),
            Self::ForwardDynamicsWatched => (&FORWARD_DYNAMICS_WATCHED, tracing::forward_dynamics_watched),
            Self::InverseDynamics => (&INVERSE_DYNAMICS, tracing::inverse_dynamics),
            Self::BiasTorque => (&BIAS_TORQUE, tracing::inverse_dynamics),
            Self::MassMatrix => (&MASS_MATRIX, tracing::mass_matrix),
            Self::MassMatrixInverse => (&MASS_MATRIX_INVERSE, tracing::mass_matrix_inverse),
            Self::MassMatrixInverseWatched => (&MASS_MATRIX_INVERSE_WATCHED, tracing::mass_matrix_inverse_watched),
            Self::FactorWatched => (&FACTOR_WATCHED, tracing::factor_watched),
            Self::ForwardDynamicsDerivatives => (&FORWARD_DYNAMICS_DERIVATIVES, tracing::forward_dynamics_derivatives),
            Self::InverseDynamicsDerivatives => (&INVERSE_DYNAMICS_DERIVATIVES, tracing::inverse_dynamics_derivatives),
            Self::ForwardDynamicsJvp => (&FORWARD_DYNAMICS_JVP, tracing::forward_dynamics_jvp),
            Self::ForwardDynamicsVjp => (&FORWARD_DYNAMICS_VJP, tracing::forward_dynamics_vjp),
            Self::InverseDynamicsJvp => (&INVERSE_DYNAMICS_JVP, tracing::inverse_dynamics_jvp),
            Self::InverseDynamicsVjp => (&INVERSE_DYNAMICS_VJP, tracing::inverse_dynamics_vjp),
            Self::Placements => (&PLACEMENTS, tracing::placements),
            Self::Placement(_) => (&PLACEMENT, tracing::placement),
            Self::Jacobian(..) => (&JACOBIAN, tracing::jacobian),
        }
    }

    /// The algorithm of the scene that computes it, if there is one; in covariance form if the algorithm has forms.
    fn algorithm(&self) -> Option<Algorithm> {
        let form = Form::default();
        Some(match self {
            Self::ForwardDynamics => Algorithm::ForwardDynamics(form),
            Self::InverseDynamics => Algorithm::InverseDynamics,
            Self::BiasTorque => Algorithm::BiasTorque,
            Self::MassMatrix => Algorithm::MassMatrix,
            Self::MassMatrixInverse | Self::MassMatrixInverseWatched => Algorithm::MassMatrixInverse(form),
            Self::ForwardDynamicsDerivatives => Algorithm::Derivatives(Derivatives::ForwardDynamics(form)),
            Self::InverseDynamicsDerivatives => Algorithm::Derivatives(Derivatives::InverseDynamics),
            Self::ForwardDynamicsJvp => Algorithm::Products(Products::ForwardTangent(form)),
            Self::ForwardDynamicsVjp => Algorithm::Products(Products::ForwardGradient(form)),
            Self::InverseDynamicsJvp => Algorithm::Products(Products::InverseTangent),
            Self::InverseDynamicsVjp => Algorithm::Products(Products::InverseGradient),
            _ => return None,
        })
    }

    /// Its name, as that of the scene's method.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.line().0.name
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

    /// True for forward kinematics: it does not depend on forces.
    pub(super) fn is_kinematic(&self) -> bool {
        matches!(self, Self::Placements | Self::Placement(_) | Self::Jacobian(..))
    }

    /// True if it forms M^-1.
    pub(super) fn has_inverse(&self) -> bool {
        matches!(self, Self::MassMatrixInverse | Self::MassMatrixInverseWatched | Self::ForwardDynamicsDerivatives)
    }

    /// The summary of the table, with the link.
    #[must_use]
    pub fn meaning(&self) -> String {
        let meaning = self.line().0.summary;
        match self {
            Self::Placement(link) => format!("{link:?}. {meaning}"),
            Self::Jacobian(link, reference) => format!("{link:?}, {}. {meaning}", reference.name()),
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
        arrays(scene, self.line().0.results)
    }

    /// Number of scalars of all results together.
    #[must_use]
    pub fn width(&self, scene: &Scene) -> usize {
        self.results(scene).iter().map(Array::width).sum()
    }

    pub(super) fn trace(&self) -> tracing::Trace {
        self.line().1
    }

    /// The results of the scene's method for these arguments, one after another.
    pub(super) fn by_scene(
        &self,
        scene: &Scene,
        tolerance: Option<f64>,
        arguments: &[&[f64]],
    ) -> Result<Vec<f64>, Error> {
        let mut out = vec![f64::NAN; self.width(scene)];
        let (frame, reference) = self.place(scene)?;
        match (self, self.algorithm()) {
            (Self::ForwardDynamicsWatched, _) => {
                reference::forward_dynamics_watched(scene, tolerance, arguments, &mut out);
            }
            (Self::FactorWatched, _) => out[0] = reference::margin_of_factor(scene, tolerance, arguments[0]),
            (Self::MassMatrixInverseWatched, Some(algorithm)) => {
                let (inverse, margin) = out.split_at_mut(scene.nv().pow(2));
                reference::evaluated(scene, tolerance, algorithm, arguments, inverse)?;
                margin[0] = reference::margin_of_factor(scene, tolerance, arguments[0]);
            }
            (_, Some(algorithm)) => reference::evaluated(scene, tolerance, algorithm, arguments, &mut out)?,
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
