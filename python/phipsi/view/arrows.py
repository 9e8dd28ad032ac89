"""Forces as arrows, to scale, and one on the ground that says how many newtons it is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._forces import Forces

_Array = NDArray[np.float64]

COLOUR = (0, 105, 60)
#: Of the largest force of the common frame, which 97 of 100 frames stay below: its arrow, of the size of the robot.
LENGTH, COMMON = 0.5, 97.0
#: The least length that is drawn, of the size of the robot.
LEAST = 0.01
#: Half the width of a shaft and of a head, and the length of a head, of the size of the robot.
SHAFT, HEAD, TIP = 0.006, 0.016, 0.045
#: From where the camera begins to look, seen from the robot; the arrow on the ground lies across that.
TOWARDS = np.array([1.15, 0.85, 0.6])
#: How far towards the camera, and at the most how far below the middle of the robot, that arrow is, of the size of the robot.
NEAR, BELOW = 0.6, 0.5
#: What the label says.
NAMES = {"contact": "contact forces", "connection": "forces of connections", "given": "forces"}


class Arrows:
    """The arrows of the frames of a motion."""

    def __init__(self, server: Any, forces: Forces, usual: float, size: float, middle: _Array, floor: float) -> None:
        self._at, self._least, self._tip = forces.at, LEAST * size, TIP * size
        self._along = forces.force * (LENGTH * size / usual)
        self._is_on = True
        shape = {"shaft_radius": SHAFT * size, "head_radius": HEAD * size, "head_length": TIP * size}
        # A frame each, so that they move as the links do, and are made anew only where a force changes.
        names = [f"/forces/{i}" for i in range(forces.at.shape[1])]
        self._frames = [server.scene.add_frame(name, show_axes=False, visible=False) for name in names]
        self._drawn = [server.scene.add_arrows(f"{name}/arrow", np.zeros((1, 2, 3)), COLOUR, **shape) for name in names]
        value = below(usual)
        way = np.cross([0.0, 0.0, 1.0], TOWARDS)
        way *= LENGTH * size * value / usual / np.linalg.norm(way)
        near = np.array(middle) + NEAR * size * np.append(TOWARDS[:2], 0.0) / np.linalg.norm(TOWARDS[:2])
        near[2] = max(floor, near[2] - BELOW * size)
        self._key = [
            server.scene.add_arrows("/newtons", np.array([[near - way / 2, near + way / 2]]), COLOUR, **shape),
            server.scene.add_label("/newtons/label", f"{NAMES[forces.what]}: {value:g} N", position=near + 0.06 * size * np.append(TOWARDS[:2], 0.0), anchor="top-center"),
        ]
        self.show(0)

    @classmethod
    def of(cls, server: Any, forces: Forces | None, size: float, middle: _Array, floor: float) -> Arrows | None:
        """Those of forces, if any of them is not zero; middle: of the robot, in the base frame; floor: the height of the ground."""
        if forces is None or not forces.force.size:
            return None
        largest = np.linalg.norm(np.nan_to_num(forces.force), axis=-1).max(axis=-1)
        if not np.any(largest > 0.0):
            return None
        return cls(server, forces, float(np.percentile(largest[largest > 0.0], COMMON)), size, middle, floor)

    def show(self, frame: int) -> None:
        """Shows the forces of a frame; what is too short to be seen, and NaN, is left out."""
        for place, arrow, at, along in zip(self._frames, self._drawn, self._at[frame], self._along[frame], strict=True):
            # False for NaN.
            place.visible = self._is_on and bool(np.linalg.norm(along) >= self._least)
            if place.visible:
                place.position = tuple(at)
                points = np.array([[np.zeros(3), along]], np.float32)
                if not np.array_equal(points, arrow.points):
                    arrow.points = points
                    # A short arrow has a short head: its length is what is to scale.
                    arrow.head_length = min(self._tip, 0.5 * float(np.linalg.norm(along)))

    def turn(self, is_on: bool, frame: int) -> None:
        """Shows all of them, or none."""
        self._is_on = is_on
        for part in self._key:
            part.visible = is_on
        self.show(frame)


def below(value: float) -> float:
    """The power of ten, twice or five times it, that is nearest below."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value))
