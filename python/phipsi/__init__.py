"""Robot dynamics from a URDF, MJCF or code: accelerations, torques, mass matrix, derivatives, simulation with contacts,
inverse kinematics, identification.

`phipsi.load` reads a robot as a `Scene`, whose methods take one state or a batch of states. `help(phipsi.Scene)` lists
the methods, and `python -m phipsi.examples` lists robots in motion.

>>> import phipsi
>>> scene = (
...     phipsi.SceneBuilder()
...     .link("base")
...     .link("rod", mass=1.0, com=(0, 0, -0.5), inertia=[[0.08, 0, 0], [0, 0.08, 0], [0, 0, 0.001]])
...     .joint("hinge", "revolute", "base", "rod", axis=(0, 1, 0))
...     .build()
... )
>>> scene.forward_dynamics([0.1], [0.0], [0.0]).round(3)
array([-1.484])

Units are SI units and radians. Spatial vectors are angular first. Leading axes of arrays are batch axes, which
broadcast.

The algorithms are those of Kalman filtering: joint torques are measurements, forces between bodies are the state, and
body inertias are process noise covariances. Forward dynamics is a filter from tip to base followed by a smoother from
base to tip; the mass matrix is the covariance of the measurements.
"""

from . import _glossary, control, errors, estimation, scenes, shapes, tasks
from ._actuators import Actuator, Actuators
from ._compare import Comparison, Difference, compare
from ._compile import Compiled, compile
from ._core import (
    BUNDLED_ARM,
    Contacts,
    Loops,
    RandomModel,
    Scene,
    SceneBuilder,
    Simulator,
    __version__,
    get_num_threads,
    set_num_threads,
)
from ._cuda import CompiledForCuda
from ._load import load
from ._motion import (
    PD,
    ContactGradients,
    ContactMotion,
    ContactState,
    EnergyAudit,
    ModeChange,
    MotionEnergy,
    ShapeContacts,
    StopImpact,
    Trajectory,
    Violation,
)
from ._ode import Ode
from ._pose import pose
from ._results import (
    Accuracy,
    ConstrainedDynamics,
    ConstrainedInverseDynamics,
    Distances,
    Energy,
    Estimate,
    ForwardDynamicsDerivatives,
    ForwardDynamicsGradients,
    InverseDynamicsDerivatives,
    InverseDynamicsGradients,
    Joint,
    Limits,
    LinearSystem,
    Link,
    MassEstimate,
    Mimic,
    Simplification,
    Plan,
    Projection,
    RolloutGradients,
    Samples,
)
from .estimation._identification import Identification
from .estimation._smooth import smooth
from .operators import Factor, Operator

_glossary.teach(Scene)
# Type checkers would accept every name.
globals()["__getattr__"] = _glossary.missing

#: `compile` is missing, because `from phipsi import *` would shadow the builtin.
__all__ = [
    "Accuracy",
    "Actuator",
    "Actuators",
    "BUNDLED_ARM",
    "Compiled",
    "CompiledForCuda",
    "Comparison",
    "ConstrainedDynamics",
    "ConstrainedInverseDynamics",
    "ContactGradients",
    "ContactMotion",
    "ContactState",
    "Contacts",
    "Difference",
    "Distances",
    "Energy",
    "EnergyAudit",
    "Estimate",
    "Factor",
    "ForwardDynamicsDerivatives",
    "ForwardDynamicsGradients",
    "Identification",
    "InverseDynamicsDerivatives",
    "InverseDynamicsGradients",
    "Joint",
    "Limits",
    "LinearSystem",
    "Link",
    "Loops",
    "MassEstimate",
    "Mimic",
    "ModeChange",
    "MotionEnergy",
    "Ode",
    "Simplification",
    "Operator",
    "PD",
    "Plan",
    "Projection",
    "RandomModel",
    "RolloutGradients",
    "Samples",
    "Scene",
    "SceneBuilder",
    "Simulator",
    "ShapeContacts",
    "StopImpact",
    "Trajectory",
    "Violation",
    "__version__",
    "compare",
    "control",
    "errors",
    "estimation",
    "get_num_threads",
    "load",
    "pose",
    "scenes",
    "set_num_threads",
    "shapes",
    "smooth",
    "tasks",
]
