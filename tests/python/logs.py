"""Logs of a small arm with residuals of a stated spectrum, for the tests of identification and for benches/estimation.py."""

from __future__ import annotations

import numpy as np

import phipsi

__all__ = ["NOISES", "arm_of_three", "fourier", "residuals"]

#: Step of the logs, s.
STEP = 0.005


def arm_of_three() -> phipsi.Scene:
    """A generic arm of three joints with losses."""
    draw = np.random.default_rng(11)
    builder = phipsi.SceneBuilder().link("base")
    for at in range(1, 4):
        axes, _ = np.linalg.qr(draw.standard_normal((3, 3)))
        builder.link(f"link{at}", draw.uniform(1, 3), draw.uniform(-0.15, 0.15, 3), axes @ np.diag(draw.uniform(0.02, 0.03, 3)) @ axes.T)
        place = {"xyz": draw.uniform(-0.3, 0.3, 3), "rpy": draw.uniform(-1, 1, 3), "axis": draw.standard_normal(3)}
        builder.joint(f"joint{at}", "continuous", "base" if at == 1 else f"link{at - 1}", f"link{at}", **place, damping=0.4, friction=0.5, armature=0.05)
    return builder.build()


def fourier(time: np.ndarray, joints: int = 3, seed: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, qd, qdd of five harmonics of 0.1 Hz: 10 s is a period."""
    draw = np.random.default_rng(seed)
    q, qd, qdd = np.zeros((3, len(time), joints))
    for harmonic in range(1, 6):
        w = 2 * np.pi * 0.1 * harmonic
        a, b = draw.uniform(-1, 1, (2, joints)) / np.sqrt(harmonic)
        s, c = np.sin(w * time)[:, None], np.cos(w * time)[:, None]
        q, qd, qdd = q + a * s + b * c, qd + w * (a * c - b * s), qdd - w * w * (a * s + b * c)
    return q, qd, qdd


def residuals(kind: str, count: int, joints: int, draw: np.random.Generator) -> np.ndarray:
    """Residuals of unit variance, (count, joints), stationary from the start."""
    white = draw.standard_normal((count, joints))
    if kind == "white":
        return white
    if kind == "AR(1) 0.25 s":
        return first_order(white, 0.25)
    if kind == "low pass 10 Hz":
        return low_pass(draw, count, joints, 10.0)
    assert kind == "drift of 1 s", kind
    return np.sqrt(0.5) * white + np.sqrt(0.5) * first_order(draw.standard_normal((count, joints)), 1.0)


def first_order(white: np.ndarray, correlation: float) -> np.ndarray:
    """An autoregression of first order with this correlation time, s, and unit variance."""
    keep = np.exp(-STEP / correlation)
    found = white.copy()
    for k in range(1, len(white)):
        found[k] = keep * found[k - 1] + np.sqrt(1 - keep**2) * white[k]
    return found


def low_pass(draw: np.random.Generator, count: int, joints: int, hertz: float) -> np.ndarray:
    """White noise below a frequency: a filter of second order, of unit variance."""
    lead = 400
    white = draw.standard_normal((count + lead, joints))
    a = np.exp(-2 * np.pi * hertz * STEP)
    found = np.zeros_like(white)
    once = np.zeros(joints)
    for k in range(len(white)):
        once = a * once + (1 - a) * white[k]
        found[k] = a * (found[k - 1] if k else 0.0) + (1 - a) * once
    # The variance of the cascade: the sum of squares of its impulse response (1 - a)^2 (n + 1) a^n.
    variance = (1 - a) ** 4 * (1 + a**2) / (1 - a**2) ** 3
    return found[lead:] / np.sqrt(variance)


NOISES = ("white", "AR(1) 0.25 s", "low pass 10 Hz", "drift of 1 s")
