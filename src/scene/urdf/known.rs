//! What the reader knows of URDF: which elements and attributes are read where, and which are passed over without a word.

/// An element that is read: its attributes, those that mean nothing for the dynamics, and the elements in it.
pub(super) struct Known {
    pub tag: &'static str,
    pub attributes: &'static [&'static str],
    pub passed_over: &'static [&'static str],
    pub children: &'static [Known],
    /// Whether there may be several of it side by side; of all others the first is read.
    pub many: bool,
}

impl Known {
    const fn leaf(tag: &'static str, attributes: &'static [&'static str]) -> Self {
        Self { tag, attributes, passed_over: &[], children: &[], many: false }
    }
}

/// `quat_xyzw` is known and refused where it is read.
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

/// `type` is in files of the PR2's time and never meant anything.
const LINK: Known =
    Known { tag: "link", attributes: &["name"], passed_over: &["type"], children: &[INERTIAL], many: true };

/// `dont_collapse` asks importers not to merge a fixed joint; what is merged here keeps its names.
const JOINT: Known = Known {
    tag: "joint",
    attributes: &["name", "type"],
    passed_over: &["dont_collapse"],
    children: &[
        ORIGIN,
        Known::leaf("parent", &["link"]),
        Known::leaf("child", &["link"]),
        Known::leaf("axis", &["xyz"]),
        Known::leaf("limit", &["lower", "upper", "effort", "velocity"]),
        Known::leaf("dynamics", &["damping", "friction", "armature", "stiffness", "rest"]),
        Known::leaf("mimic", &["joint", "multiplier", "offset"]),
    ],
    many: true,
};

/// The root.
pub(super) const ROBOT: Known = Known {
    tag: "robot",
    attributes: &["name"],
    passed_over: &["version", "verbose"],
    children: &[LINK, JOINT],
    many: false,
};

/// Elements that say nothing about the dynamics, wherever they are: shapes and looks, control, sensors, other programs'
/// settings.
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

/// Elements of Drake that join bodies: foreign, and yet they change the dynamics.
pub(super) const OF_DRAKE: [&str; 7] = [
    "joint",
    "linear_bushing_rpy",
    "linear_spring_damper",
    "ball_constraint",
    "distance_constraint",
    "tendon_constraint",
    "mimic",
];

/// The name among `known` that is most like `name`, if one is: at most two letters off, and less than half of a short one.
pub(super) fn like<'k>(name: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    let close = known.into_iter().map(|other| (distance(name, other), other));
    let close = close.filter(|&(far, other)| far <= other.len().div_ceil(2).min(2));
    // Of two as far, the one that begins alike.
    close.min_by_key(|&(far, other)| (far, other.chars().next() != name.chars().next())).map(|(_, other)| other)
}

/// Whether two names differ by one letter put in, left out or changed.
pub(super) fn one_off(name: &str, other: &str) -> bool {
    distance(name, other) == 1
}

/// How many letters have to be put in, left out or changed; capitals are letters too. Long names are like none.
fn distance(a: &str, b: &str) -> usize {
    if a.len() > 40 {
        return usize::MAX / 4;
    }
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, &to) in b.iter().enumerate() {
            let next = (diagonal + usize::from(from != to)).min(row[j] + 1).min(row[j + 1] + 1);
            diagonal = std::mem::replace(&mut row[j + 1], next);
        }
    }
    row[b.len()]
}
