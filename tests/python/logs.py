"""Logs of a small arm with residuals of a stated spectrum, for the tests of identification and for benches/estimation.py."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

import phipsi

__all__ = [
    "COM", "ENCODER", "FIT", "INERTIA", "LINK", "MASS", "NOISES", "ROBOTS", "Motion", "arm_of_four", "arm_of_three", "fourier", "gross_faults", "loaded_arm", "motion", "recorded", "residuals", "stribeck",
]  # fmt: skip

Array = np.ndarray
Motion = tuple[Array, Array, Array]

#: Step of the logs, s.
STEP = 0.005
#: Joint parameters that are fitted to the logs of `recorded`, and standard deviation of encoders, rad.
FIT, ENCODER = ("damping", "friction"), 1e-4
#: A load of a link: mass, kg, center of mass, m, and inertia about it, kg m^2.
LINK, MASS, COM = "link3", 1.6, np.array([0.03, -0.02, 0.09])
INERTIA = np.array([[6e-3, 5e-4, 0.0], [5e-4, 8e-3, 1e-3], [0.0, 1e-3, 5e-3]])


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


def loaded_arm() -> tuple[phipsi.Scene, Callable[[Motion, bool], Array]]:
    """The arm, and the torques of one whose links are off by 20 % and 3 cm, without and with the load, by Pinocchio's recursion."""
    import pinocchio as pin

    scene, draw = arm_of_three().with_properties(armature=0.0), np.random.default_rng(4)
    models = [pin.buildModelFromXML(scene.to_urdf()) for _ in range(2)]
    for at in range(1, models[0].njoints):
        own = models[0].inertias[at]
        built = pin.Inertia(own.mass * draw.uniform(0.8, 1.2), own.lever + draw.uniform(-0.03, 0.03, 3), own.inertia * draw.uniform(0.8, 1.2))
        for model in models:
            model.inertias[at] = built
    models[1].inertias[3] += pin.Inertia(MASS, COM, INERTIA)
    assert list(models[0].names[1:]) == list(scene.joint_names)

    def torques(motion: Motion, loaded: bool) -> Array:
        model, data, (q, qd, qdd) = models[loaded], models[loaded].createData(), motion
        # A continuous joint is (cos, sin).
        turned = np.stack([np.cos(q), np.sin(q)], axis=-1).reshape(len(q), -1)
        return np.array([pin.rnea(model, data, *state) for state in zip(turned, qd, qdd, strict=True)])

    return scene, torques


def stribeck(qd: Array) -> Array:
    """Friction that damping and friction do not explain, of another size in either direction."""
    return 2.0 * qd + np.tanh(qd / 0.02) * (3.0 + 4.0 * np.exp(-((qd / 0.3) ** 2)) + 0.5 * np.sign(qd))


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


def arm_of_four() -> phipsi.Scene:
    """Another arm: a slide and three rotations, with other losses."""
    builder = phipsi.SceneBuilder().link("base")
    joints = (("lift", "prismatic", (0, 0, 1)), ("shoulder", "revolute", (0, 1, 0)), ("elbow", "revolute", (0, 1, 0.2)), ("wrist", "revolute", (1, 0, 0)))
    for at, (name, kind, axis) in enumerate(joints):
        builder.link(f"{name}_link", 4.0 - at, (0.1, 0.05, 0.12), np.diag([0.03, 0.04, 0.02]))
        rest = {"lower": -1.5, "upper": 1.5, "velocity": 5.0, "effort": 500.0}
        builder.joint(name, kind, "base" if at == 0 else f"{joints[at - 1][0]}_link", f"{name}_link", xyz=(0.3, 0, 0.1), axis=axis, damping=0.8, friction=1.5 - 0.3 * at, armature=0.1, **rest)
    return builder.build()


ROBOTS: dict[str, Callable[[], phipsi.Scene]] = {"three": arm_of_three, "four": arm_of_four, "arm": lambda: phipsi.Scene.from_urdf(phipsi.BUNDLED_ARM)}


def built_like(scene: phipsi.Scene, draw: np.random.Generator) -> phipsi.Scene:
    """A robot whose bodies are up to 15 % and 1 cm off those of the model."""
    return scene.with_inertias(
        {
            name: (link.mass * draw.uniform(0.85, 1.15), link.com + draw.uniform(-0.01, 0.01, 3), link.inertia * draw.uniform(0.85, 1.15))
            for name, link in scene.links.items()
            if link.mass and name in scene.body_names
        }
    )


def motion(joints: int, time: Array, seed: int) -> tuple[Array, Array, Array]:
    """Five harmonics of 0.1 Hz, within 1 rad or m."""
    amplitudes = np.random.default_rng(seed).uniform(-1, 1, (5, joints)) * np.exp(1j * np.random.default_rng(seed + 1).uniform(0, 6, (5, joints)))
    amplitudes /= np.sum(np.abs(amplitudes), axis=0)
    w = 2j * np.pi * 0.1 * np.arange(1, 6)
    q, qd, qdd = ((np.exp(np.outer(time, w)) * w**order @ amplitudes).real for order in range(3))
    return q, qd, qdd


def recorded(scene: phipsi.Scene, seed: int, *, kind: str = "white", noise: float = 0.02, delay: float = 0.0, stribeck: float = 0.0, seconds: float = 20.0) -> dict[str, Array]:
    """A log of a robot that is built like the model, with noise relative to each torque."""
    time = np.arange(round(100 * seconds)) * 0.01
    draw = np.random.default_rng(seed)
    built = built_like(scene, draw)
    q, qd, qdd = motion(scene.nv, time - delay, seed)
    friction = scene.friction * (1.0 + stribeck * np.exp(-((qd / 0.08) ** 2)))
    exact = built.inverse_dynamics(q, qd, qdd) + scene.damping * qd + friction * qd / np.sqrt(qd**2 + 0.01**2)
    tau = exact + noise * np.sqrt(np.mean(exact**2, axis=0)) * residuals(kind, len(time), scene.nv, draw)
    return dict(zip(("q", "qd", "qdd"), motion(scene.nv, time, seed), strict=True)) | {"tau": tau, "time": time}


def gross_faults(scene: phipsi.Scene, seed: int) -> Iterator[tuple[str, phipsi.Scene, dict[str, Array], tuple[str, ...]]]:
    """Ten faults of a log: name, model, log, and joint parameters to fit."""
    draw = np.random.default_rng(seed)
    log, one = recorded(scene, seed), int(draw.integers(scene.nv))
    other = (one + 1 + int(draw.integers(scene.nv - 1))) % scene.nv
    tau, time = log["tau"], log["time"]
    yield "torques twice as large", scene, log | {"tau": 2.2 * tau}, FIT
    yield "currents", scene, log | {"tau": 0.02 * tau}, FIT
    yield "opposite sign", scene, log | {"tau": -tau}, FIT
    yield "opposite sign of one joint", scene, log | {"tau": np.where(np.arange(scene.nv) == one, -tau, tau)}, FIT
    exchanged = tau.copy()
    exchanged[:, [one, other]] = tau[:, [other, one]]
    yield "two joints exchanged", scene, log | {"tau": exchanged}, FIT
    yield "gravity left out", scene, log | {"tau": tau - scene.gravity_torque(log["q"])}, FIT
    yield "300 ms late", scene, recorded(scene, seed, delay=0.3), FIT
    q = log["q"] + ENCODER * draw.standard_normal(tau.shape)
    qd = np.gradient(q, time, axis=0)
    yield "accelerations by differences", scene, log | {"q": q, "qd": qd, "qdd": np.gradient(qd, time, axis=0)}, FIT
    yield "Stribeck friction", scene, recorded(scene, seed, stribeck=0.8), FIT
    yield "half of the dry friction", scene.with_properties(friction=0.5 * scene.friction), log, ()
