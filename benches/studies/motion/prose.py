"""Texts of the page; names in braces are replaced by results."""

from __future__ import annotations

NO_INVARIANTS = "No method conserves energy or momentum by construction; the drift decreases with the order of the method."

PINOCCHIO_TIME = """\
Pinocchio's time is omitted, because its integrators are a loop in Python here. make bench times its aba in C++.
"""

HORIZON = """\
The double pendulum is chaotic. Two references, DOP853 with a tolerance of 1e-13 and extrapolated rk4, agree to {agreed} rad until
{horizon:g} s; beyond that time the error of a method cannot be separated from that of the reference. The diagrams below end at {end:g} s, where the
references agree to {there} rad.
"""

HORIZON_CAPTION = """\
First panel: the largest change of the solution for {directions} perturbations of the initial state by {moved:.0e} (position and velocity), and the difference of the
references, which grows at the same rate. Second panel: every method at one step, until its error is 3 rad. The horizon depends on the initial
state.
"""

SMOOTH = """\
First panel: error against step. Other panels: error against run time. The run time is that of a step, the
minimum of several timings, times the number of steps, on one thread: scene.simulate, called once from Python for all steps, with the
default form. DOP853 and Radau are SciPy's methods, through scene.ode; their time is mostly that of Python, and is measured for each run. Not shown:
threads, larger batches. Without springs and damping, implicit-euler is identical to semi-implicit-euler, and their curves coincide.
"""

SMOOTH_PEERS = """\
MuJoCo's time is that of mj_step in its own compiled loop, without constraints or contacts. It computes states one by one, so that its
points are the same in both panels of run time. Pinocchio is in the first panel only, because its integrators are a loop in Python here.
Without damping, MuJoCo's implicitfast is identical to its Euler method; one integrator in several programs has one curve.
"""

STIFF = """\
All stiff scenes except two start on the slow manifold: the springs have the deflections of the slow motion and do not
oscillate. There the implicit methods have their nominal order at any step, because the damped modes are not excited. The springs of one other scene start
unloaded and oscillate; the dampers of the other start at rest.
"""

SPRINGS_CAPTION = """\
A pendulum of three rods with springs at two joints. The errors of the implicit methods do not depend on the stiffness. Crosses
above the line mark failed runs: they diverged, or their final error exceeds 1 rad. Errors are those of all joints; the stiff ones move
little, so that the error of the slow joint dominates.
"""

OTHERS_CAPTION = """\
Oscillating springs, dampers, masses over six decades, armatures from 100 kg m² to zero.
"""

MUJOCO_DAMPERS = "MuJoCo's Euler and implicitfast treat dampers implicitly, but not springs."

LARGEST_STEP = """\
Largest step without failures among the tested ones, from 4 ms downward by factors of two (2 ms for oscillating springs); the range of steps is smaller for peers in
Python:
"""

SMOOTH_ORDERS = "Slopes of log error against log step over the three finest steps with a known error. On smooth scenes:"

STIFF_ORDERS = """\
On stiff scenes, between 1 ms and 0.5 ms, and after the slash over the three finest steps. A dash: too few known errors,
usually because the error is below that of the reference as soon as the run does not fail. Configurations:
"""

RATE_ORDERS = """\
Joint velocities, for which the Rosenbrock methods have order reduction: the velocities of the stiff joints are tiny, and their errors
decrease slowly or not at all. The Euler methods have order 2 here because the initial state is at rest.
"""

STIFFNESS_CAPTION = """\
h ω is the angle of the spring oscillation in a step of 1 ms. On the slow manifold the order of the configuration, which is that of the slow
joint, does not depend on the stiffness. The order of the velocities does: for rosenbrock-3 it is not well defined for h ω from about 0.3 to
30 and is 0 beyond, for rosenbrock-2 it decreases between 10 and 100; the errors there are below 1e-6 and 3e-6 rad/s. For an oscillating
spring, the nominal orders hold up to h ω of about 0.5; from about 3 on the Rosenbrock methods have order 0, because their error is the oscillation that
they damp; in between, the computed order can have any value, because the error changes its sign. Points beyond the axis
are omitted. Errors within {far:.0f} times that of the reference are omitted too: the error of rk4 changes from failure to less than that within a
factor of two in the step. Oscillations of springs above {most} N m/rad are omitted, because a reference would take too long.
"""

DRIFT_CAPTION = """\
Largest change over eleven times of a run, relative to the largest kinetic energy or to the momentum. Long runs are not
shown.
"""

DRIFT_ORDERS = "Slopes of log drift against log step over the three finest steps above the rounding error:"

TIMES = "Time for a single state, and after the slash per state in a batch of {batch}."

REFERENCES = """\
The error is the largest component of the difference of configurations on the manifold: joint angles, and for a free joint the translation
and the rotation vector between the two poses, never components of quaternions. It does not include velocities unless stated.
The error of the reference is estimated by its difference from a solution with a different method, and is at least eps times the largest coordinate;
an error is shown if it is at least {far:.0f} times larger. Both solutions use the same accelerations, which are tested
against other programs and higher precision.
"""

REFERENCES_PEERS = "The peers compute their own accelerations, and their errors converge to the same references."
