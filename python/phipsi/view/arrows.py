"""Forces as arrows to scale, and a reference arrow on the ground with its value in newtons."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._forces import Forces
from .shapes import TOWARD

_Array = NDArray[np.float64]

COLOR = (0, 105, 60)
#: Length of the arrow of the reference force, relative to the size of the robot; the reference is that percentile of the largest force per frame.
LENGTH, COMMON = 0.5, 97.0
#: Smallest length of an arrow, relative to the size of the robot.
LEAST = 0.01
#: Radius of shaft and head, and length of the head, relative to the size of the robot.
SHAFT, HEAD, TIP = 0.006, 0.016, 0.045
#: Distance of the reference arrow toward the camera, and largest distance below the center of the robot, relative to the size of the robot.
NEAR, BELOW = 0.6, 0.5
#: Text of the label.
NAMES = {"contact": "contact forces", "connection": "forces of connections", "given": "forces"}


class Arrows:
    """Arrows for the frames of a motion."""

    def __init__(self, server: Any, forces: Forces, usual: float, size: float, middle: _Array, floor: float) -> None:
        self._at, self._least, self._tip = forces.at, LEAST * size, TIP * size
        self._along = forces.force * (LENGTH * size / usual)
        self._is_on = True
        shape = {"shaft_radius": SHAFT * size, "head_radius": HEAD * size, "head_length": TIP * size}
        # One frame per arrow: it moves like a link, and the arrow is replaced only if the force changes.
        names = [f"/forces/{i}" for i in range(forces.at.shape[1])]
        self._frames = [server.scene.add_frame(name, show_axes=False, visible=False) for name in names]
        self._drawn = [server.scene.add_arrows(f"{name}/arrow", np.zeros((1, 2, 3)), COLOR, **shape) for name in names]
        value = below(usual)
        way = np.cross([0.0, 0.0, 1.0], TOWARD)
        way *= LENGTH * size * value / usual / np.linalg.norm(way)
        near = np.array(middle) + NEAR * size * np.append(TOWARD[:2], 0.0) / np.linalg.norm(TOWARD[:2])
        near[2] = max(floor, near[2] - BELOW * size)
        self._key = [
            server.scene.add_arrows("/newtons", np.array([[near - way / 2, near + way / 2]]), COLOR, **shape),
            server.scene.add_label("/newtons/label", f"{NAMES[forces.what]}: {value:g} N", position=near + 0.09 * size * np.append(TOWARD[:2], 0.0), anchor="top-center"),
        ]
        self.show(0)

    @classmethod
    def of(cls, server: Any, forces: Forces | None, size: float, middle: _Array, floor: float) -> Arrows | None:
        """Arrows of forces, if any is nonzero; middle: center of the robot in the base frame; floor: height of the
        ground.
        """
        usual = usual_force(forces)
        return None if usual is None or forces is None else cls(server, forces, usual, size, middle, floor)

    def show(self, frame: int) -> None:
        """Show the forces of a frame, without NaN and arrows that are too short to be visible."""
        for place, arrow, at, along in zip(self._frames, self._drawn, self._at[frame], self._along[frame], strict=True):
            # False for NaN.
            place.visible = self._is_on and bool(np.linalg.norm(along) >= self._least)
            if place.visible:
                place.position = tuple(at)
                points = np.array([[np.zeros(3), along]], np.float32)
                if not np.array_equal(points, arrow.points):
                    arrow.points = points
                    # The length of an arrow is to scale, so that a short arrow needs a short head.
                    arrow.head_length = min(self._tip, 0.5 * float(np.linalg.norm(along)))

    def turn(self, is_on: bool, frame: int) -> None:
        """Show or hide all arrows."""
        self._is_on = is_on
        for part in self._key:
            part.visible = is_on
        self.show(frame)


def usual_force(forces: Forces | None) -> float | None:
    """Force, N, whose arrow has the length LENGTH; None if all forces are zero."""
    if forces is None or not forces.force.size:
        return None
    largest = np.linalg.norm(np.nan_to_num(forces.force), axis=-1).max(axis=-1)
    return float(np.percentile(largest[largest > 0.0], COMMON)) if np.any(largest > 0.0) else None


def below(value: float) -> float:
    """Largest of 1, 2 or 5 times a power of ten that does not exceed the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value))
