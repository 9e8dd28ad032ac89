"""What the figures do not show, for every report the same."""

from __future__ import annotations

LIMITS = """\
Every time is that of a public call, and it says of which. "What a call takes" and "Left out" are calls from Python, on one thread:
checks, conversion and the array of the result are in them. "Error against run time" and "Growth with size" are
calls of Scene::evaluate in Rust, one state a call: the cost of calling from Python is not in them, and nothing is allocated in the timed part, but where M emerges: there each call
makes its model and its matrix. Several threads are not used and would change the picture.
The dense methods form M and the bias by the same calls and then factor with faer, in
place and with scratch made beforehand; faer is made for large matrices, and a small-matrix kernel would be faster
on small robots. The machine is what it is: other programs may share it, clocks vary, and medians hide only part of
that; differences of ten per cent mean nothing. The reference is the same recursion in double-double arithmetic
(about 31 digits): it shows rounding, not mistakes of the recursion, which the residuals and the tests against other
programs are for. The drawn states are rounded to float32, so both precisions start from the same numbers, but in
float32 the robot's own constants are rounded too, and that is part of its error; a state that is in doubt there is done in float64
and rounded, as the square-root and Joseph's forms always are, and takes the time of both. Errors are in the max-norm: the
largest error over the largest acceleration. A joint that accelerates little may have fewer good digits than that.
The robot is what its file says; how well the file describes the machine is not measured here.
"""
