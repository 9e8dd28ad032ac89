"""Texts of the page; names in braces are replaced by results."""

from __future__ import annotations

NO_INVARIANTS = "No method keeps energy or momentum by construction; they drift by an amount that falls with the order."

PINOCCHIO_TIME = """\
Pinocchio's time is not shown: its integrators are a loop in Python here. Its aba in C++ is timed by make bench.
"""

HORIZON = """\
The double pendulum is chaotic. Two references, DOP853 at a tolerance of 1e-13 and extrapolated rk4, agree to {agreed} rad up to
{horizon:g} s: no error can be told from the reference's own much beyond. The diagrams below end at {end:g} s, where they agree to
{there} rad.
"""

HORIZON_CAPTION = """\
First panel: the largest of {directions} changes of the start by {moved:.0e}, position and rate together, and the difference of the
references, which grows alike. Second: every method at one step, until it is 3 rad off. The horizon is of this start; another start
has another.
"""

SMOOTH = """\
First panel, error against step: what a method does. The others, error against run time: what it costs. Time is that of a step, the
least of some turns, times the number of steps, on one thread: scene.simulate, called from Python once for all steps, with its
default form. DOP853 and Radau are SciPy's, through scene.ode: their time is mostly Python's, and measured run by run. Not shown:
threads, larger batches, float32. Without springs and damping implicit-euler is semi-implicit-euler: their curves lie on each other.
"""

SMOOTH_PEERS = """\
MuJoCo's time is that of mj_step in its own compiled loop, without constraints or contacts; it takes states one by one, so that its
points are the same in both panels of time. Pinocchio is in the first panel only: its integrators are a loop in Python here, whose
time would say nothing of it. Without damping MuJoCo's implicitfast is its Euler; one integrator in several programs has one curve.
"""

STIFF = """\
All stiff scenes but two start on the slow manifold: the springs are loaded as the slow motion will have them, so that nothing
rings. There the implicit methods are right to their order at any step, for what they damp is not there. The struck springs start
unloaded, and ring; the dampers start at rest.
"""

SPRINGS_CAPTION = """\
A pendulum of three rods, two of its joints with springs. The implicit methods have the same errors whatever the spring. Crosses
above the line are runs that failed: they diverged, or ended more than 1 rad away. Errors are of all joints; the stiff ones move
little, so that what is seen is the slow joint's.
"""

OTHERS_CAPTION = """\
Springs that ring, dampers, masses over six decades, armatures from 100 kg m² to none.
"""

MUJOCO_DAMPERS = "MuJoCo takes dampers implicitly with Euler and implicitfast, springs never."

LARGEST_STEP = """\
The largest step at which no run fails, of those tried, from 4 ms down by halves (2 ms where springs ring); peers in Python are not
tried as far down:
"""

SMOOTH_ORDERS = "Slopes of log error against log step over the three finest steps whose error is known. On smooth scenes:"

STIFF_ORDERS = """\
On stiff scenes, between 1 ms and 0.5 ms, and after the stroke over the three finest steps. A dash: not as many known errors there,
most often because they fall below what the reference knows as soon as the run does not fail. Configurations:
"""

RATE_ORDERS = """\
Rates, where orders reduce for the Rosenbrock methods: the stiff joints' own rates are tiny, and what the method leaves in them
falls slowly or not at all. That the Euler steps have order 2 here is owed to the start at rest.
"""

STIFFNESS_CAPTION = """\
How far the spring turns in a step of 1 ms is h ω. On the slow manifold the order of the configuration, which is that of the slow
joint, holds at every stiffness. The order of the rates does not: for rosenbrock-3 it is no clear number from h ω of about 0.3 to
30 and 0 beyond, for rosenbrock-2 it dips between 10 and 100; their errors there are below 1e-6 and 3e-6 rad/s. Where the spring
rings, orders hold up to h ω of about 0.5; from about 3 on the Rosenbrock methods have order 0, for their error is the ringing that
they damp; between, a single number may be anything, of either sign, since the error changes its sign there. Points beyond the axis
are left out. Errors within {far:.0f} times the reference's are not shown either: rk4 passes from failing to less than that within a
factor of two in the step. Springs beyond {most} N m/rad are not shown ringing, since a reference would take too long.
"""

DRIFT_CAPTION = """\
The largest change over eleven instants of a run, over the largest kinetic energy or over the momentum's size. It is not shown over
long times.
"""

DRIFT_ORDERS = "Slopes of log drift against log step over the three finest steps where rounding has no part:"

TIMES = "A state alone, and after the stroke a state of a batch of {batch}."

REFERENCES = """\
An error is the largest component of the difference of configurations on the manifold: joint angles, and for a free joint the vector
and the rotation vector that move one body to the other; never components of quaternions. Rates are not in it, but where it is said.
The reference's own error is taken to be its difference from a solution of another kind, eps times the largest coordinate at least;
an error is shown if it is {far:.0f} times that or more. Both solutions rest on the same accelerations: that these are right, tests
against other programs and arithmetic show.
"""

REFERENCES_PEERS = "The peers compute accelerations of their own, and their errors fall to the same references."
