"""Contacts that errors of a simulation can bring into another mode: open, sticking or sliding.

In a mode the end of a step is a smooth function of its start. The margin of a contact is the change of its velocity
after which it has another mode. For an open contact, the error of that velocity is that of the gap divided by the step.
For a contact with forces it is that of the velocity without them: of the gap at the end of a step that contacts do not
affect, divided by the step, and of the velocity along the surface, if there is friction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._motion_parts import of_rows
from .._trajectory_files import OF_CONTACTS
from ..errors import UncertaintyWarning, warn

if TYPE_CHECKING:
    from .._core import Scene
    from .._motion import Trajectory

__all__ = ["ModeMargins", "contact_velocities"]

_Array = NDArray[np.float64]

#: Number of standard deviations that count as an error: 95 %.
DEVIATIONS = 1.96
#: Step of the differences of gaps, rad or m.
STEP = 1e-6
#: Functions of the state per contact: its gap divided by the step, and its velocity along the surface.
PER_CONTACT = 4


def contact_velocities(scene: Scene, q: _Array, dt: float, friction: ArrayLike | None = None) -> _Array:
    """Linear functions of (q in its tangent space, qd), (..., PER_CONTACT contacts, 2 nv), m/s.

    Of each contact, the gap divided by the step, and the velocity along the surface, which is zero without friction.
    `friction`: the coefficients of all states, or of each; None: those of the scene.
    """
    nv, names = scene.nv, scene.contacts.names
    moved = [scene.contacts.gaps(scene.integrate(q[..., None, :], by * np.eye(nv))) for by in (STEP, -STEP)]
    gaps = np.swapaxes(moved[0] - moved[1], -1, -2) / (2.0 * STEP)
    along = np.moveaxis(scene.contacts.velocities(q[..., None, :], np.eye(nv)), -3, -1)
    normal = np.einsum("...in,...n->...i", np.linalg.pinv(np.swapaxes(along, -1, -2)), gaps)
    square = np.sum(normal**2, axis=-1, keepdims=True)
    normal = np.divide(normal, np.sqrt(square), where=square > 0.0, out=np.zeros_like(normal))
    along = along - normal[..., None] * np.einsum("...i,...in->...n", normal, along)[..., None, :]
    found = np.zeros((*q.shape[:-1], len(names), PER_CONTACT, 2 * nv))
    found[..., 0, :nv] = gaps / dt
    of_contacts = [contact[6] for contact in scene._contacts()] if friction is None else friction
    rough = of_rows(np.atleast_1d(np.asarray(of_contacts)))[..., : len(names), None, None] > 0.0
    found[..., 1:, nv:] = along * rough
    return found.reshape(*q.shape[:-1], len(names) * PER_CONTACT, 2 * nv)


class ModeMargins:
    """The first contact whose margin is less than the error of its velocity."""

    def __init__(self, path: Trajectory) -> None:
        self.path, self.names = path, path.scene.contacts.names
        self.found: tuple[int, str] | None = None

    def closed(self, row: int | NDArray[np.int_]) -> NDArray[np.bool_]:
        """Return True for each contact that has forces in the step that ends at rows, (..., rows, contacts)."""
        assert self.path.contacts is not None
        return np.stack([self.path.contacts.state[name][..., row] != 0 for name in self.names], axis=-1)

    def note(self, row: int, margins: _Array, root: _Array, free: _Array | None) -> None:
        """Compare the margins, (..., contacts), in the step that ends at a row with standard deviations.

        `root` is that of the covariance of the state at the end of the step, (..., 2 nv, columns), and `free` that of
        contact_velocities at the end of the step that contacts do not affect; None if they are all open.
        """
        if self.found is not None:
            return
        at_end = contact_velocities(self.path.scene, self.path.q[..., row, :], self.path.dt)[..., ::PER_CONTACT, :]
        sizes = np.linalg.norm(at_end @ root, axis=-1)
        if free is not None:
            each = np.linalg.norm(free, axis=-1).reshape(*free.shape[:-2], len(self.names), PER_CONTACT)
            sizes = np.where(self.closed(row), np.linalg.norm(each, axis=-1), sizes)
        crossed = np.any((DEVIATIONS * sizes > margins).reshape(-1, len(self.names)), axis=0)
        if crossed.any():
            self.found = row, self.names[int(np.argmax(crossed))]

    def warn(self) -> None:
        """Issue the warning if there is such a contact."""
        if self.found is None:
            return
        row, name = self.found
        warn(
            f"covariance: found contact {name!r} that errors of 95 % bring into another mode (open, sticking, sliding)"
            f" at t = {row * self.path.dt:.6g} s, so that the bands from there on are those of the modes of this"
            ' simulation; compare with check="monte-carlo", or use smoothing',
            UncertaintyWarning,
        )


def free_arguments(given: dict[str, Any]) -> dict[str, Any]:
    """Arguments of steps that contacts do not affect, by the method of steps with contacts."""
    own = {name: value for name, value in given.items() if name not in ("smoothing", "restitution", *OF_CONTACTS)}
    return own | {"method": "semi-implicit-euler", "limits": "report"}
