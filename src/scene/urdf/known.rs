//! The URDF elements and attributes that the reader reads, and those that it ignores without a warning.

use crate::error::edits;

/// An element that is read: its attributes, the attributes that do not affect the dynamics, and its child elements.
pub(super) struct Known {
    pub tag: &'static str,
    pub attributes: &'static [&'static str],
    pub passed_over: &'static [&'static str],
    pub children: &'static [Known],
    /// True if the element can occur several times in its parent; of all others the first is read.
    pub many: bool,
}

impl Known {
    const fn leaf(tag: &'static str, attributes: &'static [&'static str]) -> Self {
        Self { tag, attributes, passed_over: &[], children: &[], many: false }
    }
}

/// `quat_xyzw` is for URDF 1.1 and later.
const ORIGIN: Known = Known::leaf("origin", &["xyz", "rpy", "quat_xyzw"]);

const INERTIAL: Known = Known {
    tag: "inertial",
    attributes: &[],
    passed_over: &[],
    children: &[
        ORIGIN,
        Known::leaf("mass", &["value"]),
        Known::leaf("inertia", &["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]),
    ],
    many: false,
};

/// `type` occurs in old files (PR2) and has no meaning.
const LINK: Known =
    Known { tag: "link", attributes: &["name"], passed_over: &["type"], children: &[INERTIAL], many: true };

/// `dont_collapse` asks importers not to merge a fixed joint; merged links keep their names here.
const JOINT: Known = Known {
    tag: "joint",
    attributes: &["name", "type"],
    passed_over: &["dont_collapse"],
    children: &[
        ORIGIN,
        Known::leaf("parent", &["link"]),
        Known::leaf("child", &["link"]),
        Known::leaf("axis", &["xyz"]),
        Known::leaf("limit", &["lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"]),
        Known::leaf(
            "dynamics",
            &[
                "damping",
                "friction",
                "armature",
                "stiffness",
                "rest",
                "friction_offset",
                "stribeck",
                "stribeck_speed",
                "load_friction",
            ],
        ),
        Known::leaf("mimic", &["joint", "multiplier", "offset"]),
    ],
    many: true,
};

/// The root element.
pub(super) const ROBOT: Known = Known {
    tag: "robot",
    attributes: &["name", "version"],
    passed_over: &["verbose"],
    children: &[LINK, JOINT],
    many: false,
};

/// Elements that do not affect the dynamics, at any position: geometry, materials, control, sensors, and settings of
/// other programs.
pub(super) const QUIET: [&str; 14] = [
    "visual",
    "collision",
    "material",
    "gazebo",
    "transmission",
    "ros2_control",
    "sensor",
    "safety_controller",
    "calibration",
    "contact",
    "collision_checking",
    "self_collision_checking",
    "self_filter",
    "mujoco",
];

/// Elements of QUIET elements that affect the dynamics nevertheless: their parent, their name, and the value, true or
/// false, with which they do; `None`: any.
pub(super) const ACTING: [(&str, &str, Option<bool>); 8] = [
    // Bullet scales the inertia by this value.
    ("contact", "inertia_scaling", None),
    ("gazebo", "turnGravityOff", Some(true)),
    ("gazebo", "gravity", Some(false)),
    ("gazebo", "kinematic", Some(true)),
    ("gazebo", "static", Some(true)),
    ("gazebo", "springStiffness", Some(true)),
    ("gazebo", "dampingFactor", Some(true)),
    // A joint in the notation of SDF, such as one that closes a loop.
    ("gazebo", "joint", None),
];

/// Elements of Drake that connect bodies. They are reported although they are foreign, because they affect the
/// dynamics.
pub(super) const OF_DRAKE: [&str; 7] = [
    "joint",
    "linear_bushing_rpy",
    "linear_spring_damper",
    "ball_constraint",
    "distance_constraint",
    "tendon_constraint",
    "mimic",
];

/// The name in `known` most similar to `name`: at most two letters differ, and less than half of a short name.
pub(super) fn like<'k>(name: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    let close = known.into_iter().map(|other| (distance(name, other), other));
    let close = close.filter(|&(far, other)| far <= other.len().div_ceil(2).min(2));
    // Of two equally similar names, the one with the same first letter.
    close.min_by_key(|&(far, other)| (far, other.chars().next() != name.chars().next())).map(|(_, other)| other)
}

/// True if two names differ by one inserted, deleted or replaced letter.
pub(super) fn one_off(name: &str, other: &str) -> bool {
    distance(name, other) == 1
}

/// Levenshtein distance of two names, case-sensitive; very large for long names.
fn distance(a: &str, b: &str) -> usize {
    if a.len() > 40 { usize::MAX / 4 } else { edits(a, b) }
}
