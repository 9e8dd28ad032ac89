//! What programs compute: one table of names, arguments, results with their shapes, how each is traced, and what the scene's method gives.

use super::tracing::Place;
use super::{reference, tracing};
use crate::error::Error;
use crate::kinematics::{Frame, ReferenceFrame};
use crate::scene::Scene;
use crate::spatial::RigidShift;

/// What a program can compute, named as the method of scenes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Function {
    /// qdd of (q, qd, tau), in covariance form.
    ForwardDynamics,
    /// The same, and by how much it stays clear of losing digits: below zero, or NaN, of a state in doubt, which the scene's methods in form auto do by other means.
    ForwardDynamicsWatched,
    /// tau of (q, qd, qdd).
    InverseDynamics,
    /// The torque of the bias, of (q, qd).
    BiasTorque,
    /// M of q, row by row.
    MassMatrix,
    /// M^-1 of q, row by row, in covariance form.
    MassMatrixInverse,
    /// The same, watched likewise.
    MassMatrixInverseWatched,
    /// The margin of q alone: of the factor of M, through which derivatives and products of forward dynamics go.
    FactorWatched,
    /// dqdd/dq, dqdd/dqd and M^-1 of (q, qd, tau), each row by row, by q in its tangent space; in covariance form.
    ForwardDynamicsDerivatives,
    /// dtau/dq, dtau/dqd and M of (q, qd, qdd), likewise.
    InverseDynamicsDerivatives,
    /// dqdd of (q, qd, tau) along (dq, dqd, dtau), in covariance form.
    ForwardDynamicsJvp,
    /// The gradients of c . qdd by q, qd and tau, of (q, qd, tau) and c; in covariance form.
    ForwardDynamicsVjp,
    /// dtau of (q, qd, qdd) along (dq, dqd, dqdd).
    InverseDynamicsJvp,
    /// The gradients of x . tau by q, qd and qdd, of (q, qd, qdd) and x.
    InverseDynamicsVjp,
    /// Where every link is, of q: a homogeneous matrix each, in the order of [`Scene::links`].
    Placements,
    /// Where the link of this name is, of q: a homogeneous matrix.
    Placement(String),
    /// The Jacobian of the link of this name, of q, (6 x nv), its velocity written in this frame.
    Jacobian(String, ReferenceFrame),
}

/// All of them that are of no one link, without those that are watched.
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

/// Those that say of each state whether it may have lost digits.
pub const WATCHED: [Function; 3] =
    [Function::ForwardDynamicsWatched, Function::MassMatrixInverseWatched, Function::FactorWatched];

/// An argument or a result of a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Array {
    /// Its name.
    pub name: &'static str,
    /// Its axes; numbers lie row by row.
    pub shape: Vec<usize>,
}

impl Array {
    /// How many numbers a state has in it.
    #[must_use]
    pub fn width(&self) -> usize {
        self.shape.iter().product()
    }

    /// Names of arrays, with how many numbers a state has in each.
    pub(super) fn sized(all: &[Self]) -> Vec<(&'static str, usize)> {
        all.iter().map(|array| (array.name, array.width())).collect()
    }
}

/// What an array of the table has a number for.
#[derive(Debug, Clone, Copy)]
enum Of {
    /// Coordinates: (nq).
    Coordinates,
    /// Degrees of freedom: (nv).
    Rates,
    /// One number: (1).
    One,
    /// Pairs of them: (nv, nv).
    Pairs,
    /// A homogeneous matrix: (4, 4).
    Place,
    /// One a link: (links, 4, 4).
    Places,
    /// (angular, linear) of each degree of freedom: (6, nv).
    Motions,
}

impl Of {
    fn shape(self, scene: &Scene) -> Vec<usize> {
        let nv = scene.nv();
        match self {
            Self::Coordinates => vec![scene.nq()],
            Self::Rates => vec![nv],
            Self::One => vec![1],
            Self::Pairs => vec![nv, nv],
            Self::Place => vec![4, 4],
            Self::Places => vec![scene.links().len(), 4, 4],
            Self::Motions => vec![6, nv],
        }
    }
}

/// A line of the table.
struct Line {
    name: &'static str,
    meaning: &'static str,
    arguments: &'static [(&'static str, Of)],
    results: &'static [(&'static str, Of)],
    trace: tracing::Trace,
    by_scene: reference::ByScene,
}

const STATE: [(&str, Of); 2] = [("q", Of::Coordinates), ("qd", Of::Rates)];
const WITH_TAU: [(&str, Of); 3] = [STATE[0], STATE[1], ("tau", Of::Rates)];
const WITH_QDD: [(&str, Of); 3] = [STATE[0], STATE[1], ("qdd", Of::Rates)];
const DIRECTION: [(&str, Of); 2] = [("dq", Of::Rates), ("dqd", Of::Rates)];
const COTANGENT: (&str, Of) = ("cotangent", Of::Rates);
const GRADIENT: [(&str, Of); 2] = [("gradient_q", Of::Rates), ("gradient_qd", Of::Rates)];

impl Function {
    #[allow(clippy::too_many_lines)] // a table
    fn line(&self) -> Line {
        match self {
            Self::ForwardDynamics => Line {
                name: "forward_dynamics",
                meaning: "Joint accelerations from torques",
                arguments: &WITH_TAU,
                results: &[("qdd", Of::Rates)],
                trace: tracing::forward_dynamics,
                by_scene: reference::forward_dynamics,
            },
            Self::ForwardDynamicsWatched => Line {
                name: "forward_dynamics_watched",
                meaning: "Joint accelerations from torques; digits may be lost where the margin is below zero",
                arguments: &WITH_TAU,
                results: &[("qdd", Of::Rates), ("margin", Of::One)],
                trace: tracing::forward_dynamics_watched,
                by_scene: reference::forward_dynamics_watched,
            },
            Self::InverseDynamics => Line {
                name: "inverse_dynamics",
                meaning: "Torques from joint accelerations",
                arguments: &WITH_QDD,
                results: &[("tau", Of::Rates)],
                trace: tracing::inverse_dynamics,
                by_scene: reference::inverse_dynamics,
            },
            Self::BiasTorque => Line {
                name: "bias_torque",
                meaning: "Torques that let no joint accelerate",
                arguments: &STATE,
                results: &[("tau", Of::Rates)],
                trace: tracing::inverse_dynamics,
                by_scene: reference::bias_torque,
            },
            Self::MassMatrix => Line {
                name: "mass_matrix",
                meaning: "The mass matrix, row by row",
                arguments: &STATE[..1],
                results: &[("mass", Of::Pairs)],
                trace: tracing::mass_matrix,
                by_scene: reference::mass_matrix,
            },
            Self::MassMatrixInverse => Line {
                name: "mass_matrix_inverse",
                meaning: "Its inverse, row by row",
                arguments: &STATE[..1],
                results: &[("inverse", Of::Pairs)],
                trace: tracing::mass_matrix_inverse,
                by_scene: reference::mass_matrix_inverse,
            },
            Self::MassMatrixInverseWatched => Line {
                name: "mass_matrix_inverse_watched",
                meaning: "The inverse mass matrix, row by row; digits may be lost where the margin is below zero",
                arguments: &STATE[..1],
                results: &[("inverse", Of::Pairs), ("margin", Of::One)],
                trace: tracing::mass_matrix_inverse_watched,
                by_scene: reference::mass_matrix_inverse_watched,
            },
            Self::FactorWatched => Line {
                name: "factor_watched",
                meaning: "The margin of the factor of the mass matrix; digits may be lost where it is below zero",
                arguments: &STATE[..1],
                results: &[("margin", Of::One)],
                trace: tracing::factor_watched,
                by_scene: reference::factor_watched,
            },
            Self::ForwardDynamicsDerivatives => Line {
                name: "forward_dynamics_derivatives",
                meaning: "Joint accelerations by the tangent of q, by qd and by tau, each row by row",
                arguments: &WITH_TAU,
                results: &[("dqdd_dq", Of::Pairs), ("dqdd_dqd", Of::Pairs), ("Minv", Of::Pairs)],
                trace: tracing::forward_dynamics_derivatives,
                by_scene: reference::forward_dynamics_derivatives,
            },
            Self::InverseDynamicsDerivatives => Line {
                name: "inverse_dynamics_derivatives",
                meaning: "Torques by the tangent of q, by qd and by qdd, each row by row",
                arguments: &WITH_QDD,
                results: &[("dtau_dq", Of::Pairs), ("dtau_dqd", Of::Pairs), ("M", Of::Pairs)],
                trace: tracing::inverse_dynamics_derivatives,
                by_scene: reference::inverse_dynamics_derivatives,
            },
            Self::ForwardDynamicsJvp => Line {
                name: "forward_dynamics_jvp",
                meaning: "The change of joint accelerations along a direction",
                arguments: &[WITH_TAU[0], WITH_TAU[1], WITH_TAU[2], DIRECTION[0], DIRECTION[1], ("dtau", Of::Rates)],
                results: &[("dqdd", Of::Rates)],
                trace: tracing::forward_dynamics_jvp,
                by_scene: reference::forward_dynamics_jvp,
            },
            Self::ForwardDynamicsVjp => Line {
                name: "forward_dynamics_vjp",
                meaning: "Gradients of cotangent . qdd by the tangent of q, by qd and by tau",
                arguments: &[WITH_TAU[0], WITH_TAU[1], WITH_TAU[2], COTANGENT],
                results: &[GRADIENT[0], GRADIENT[1], ("gradient_tau", Of::Rates)],
                trace: tracing::forward_dynamics_vjp,
                by_scene: reference::forward_dynamics_vjp,
            },
            Self::InverseDynamicsJvp => Line {
                name: "inverse_dynamics_jvp",
                meaning: "The change of torques along a direction",
                arguments: &[WITH_QDD[0], WITH_QDD[1], WITH_QDD[2], DIRECTION[0], DIRECTION[1], ("dqdd", Of::Rates)],
                results: &[("dtau", Of::Rates)],
                trace: tracing::inverse_dynamics_jvp,
                by_scene: reference::inverse_dynamics_jvp,
            },
            Self::InverseDynamicsVjp => Line {
                name: "inverse_dynamics_vjp",
                meaning: "Gradients of cotangent . tau by the tangent of q, by qd and by qdd",
                arguments: &[WITH_QDD[0], WITH_QDD[1], WITH_QDD[2], COTANGENT],
                results: &[GRADIENT[0], GRADIENT[1], ("gradient_qdd", Of::Rates)],
                trace: tracing::inverse_dynamics_vjp,
                by_scene: reference::inverse_dynamics_vjp,
            },
            Self::Placements => Line {
                name: "placements",
                meaning: "Where links are: homogeneous matrices, link to base, row by row",
                arguments: &STATE[..1],
                results: &[("placements", Of::Places)],
                trace: tracing::placements,
                by_scene: reference::placements,
            },
            Self::Placement(_) => Line {
                name: "placement",
                meaning: "Where the link is: a homogeneous matrix, link to base, row by row",
                arguments: &STATE[..1],
                results: &[("placement", Of::Place)],
                trace: tracing::placement,
                by_scene: reference::placement,
            },
            Self::Jacobian(..) => Line {
                name: "jacobian",
                meaning: "The Jacobian of the link, row by row: its velocity (angular, linear) is J qd",
                arguments: &STATE[..1],
                results: &[("jacobian", Of::Motions)],
                trace: tracing::jacobian,
                by_scene: reference::jacobian,
            },
        }
    }

    /// Its name, as the methods of scenes have it.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.line().name
    }

    /// What the code calls it: the name, and of one link the link's, with _ for what no identifier has, and the frame where that is not the link's own.
    #[must_use]
    pub fn symbol(&self) -> String {
        let name = self.name();
        match self.link() {
            None => name.to_owned(),
            Some((link, ReferenceFrame::Local)) => format!("{name}_{}", identifier(link)),
            Some((link, reference)) => format!("{name}_{}_{}", identifier(link), identifier(reference.name())),
        }
    }

    /// The link that it is of, and the frame that motions are written in.
    fn link(&self) -> Option<(&str, ReferenceFrame)> {
        match self {
            Self::Placement(link) => Some((link, ReferenceFrame::Local)),
            Self::Jacobian(link, reference) => Some((link, *reference)),
            _ => None,
        }
    }

    /// That link's frame in `scene`; the base's where it is of no link.
    pub(super) fn place(&self, scene: &Scene) -> Result<Place, Error> {
        let Some((link, reference)) = self.link() else {
            return Ok((Frame { body: None, placement: RigidShift::identity() }, ReferenceFrame::Local));
        };
        Ok((scene.frame(&link.into())?, reference))
    }

    /// Whether it says where links are and nothing of forces.
    pub(super) fn is_kinematic(&self) -> bool {
        matches!(self, Self::Placements | Self::Placement(_) | Self::Jacobian(..))
    }

    /// Whether it has M^-1 multiplied out.
    pub(super) fn has_inverse(&self) -> bool {
        matches!(self, Self::MassMatrixInverse | Self::MassMatrixInverseWatched | Self::ForwardDynamicsDerivatives)
    }

    /// What it gives, in a few words.
    #[must_use]
    pub fn meaning(&self) -> String {
        let meaning = self.line().meaning;
        match self {
            Self::Placement(link) => format!("{link:?}. {meaning}"),
            Self::Jacobian(link, reference) => format!("{link:?}, {}. {meaning}", reference.name()),
            _ => meaning.to_owned(),
        }
    }

    /// Its arguments for `scene`, q first.
    #[must_use]
    pub fn arguments(&self, scene: &Scene) -> Vec<Array> {
        arrays(scene, self.line().arguments)
    }

    /// Its results.
    #[must_use]
    pub fn results(&self, scene: &Scene) -> Vec<Array> {
        arrays(scene, self.line().results)
    }

    /// How many numbers it gives, all results together.
    #[must_use]
    pub fn width(&self, scene: &Scene) -> usize {
        self.results(scene).iter().map(Array::width).sum()
    }

    pub(super) fn trace(&self) -> tracing::Trace {
        self.line().trace
    }

    /// What the scene's own method gives for these arguments, all results one after another.
    pub(super) fn by_scene(
        &self,
        scene: &Scene,
        tolerance: Option<f64>,
        arguments: &[&[f64]],
    ) -> Result<Vec<f64>, Error> {
        let (mut out, mut workspace) = (vec![f64::NAN; self.width(scene)], scene.workspace());
        workspace.tolerance = tolerance;
        (self.line().by_scene)((scene, &mut workspace, self.place(scene)?), arguments, &mut out)?;
        Ok(out)
    }
}

fn arrays(scene: &Scene, of_table: &[(&'static str, Of)]) -> Vec<Array> {
    of_table.iter().map(|&(name, of)| Array { name, shape: of.shape(scene) }).collect()
}

/// Letters, digits and _ of a name, with _ for all else.
fn identifier(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect()
}
