"""A cart-pole for reinforcement learning: one as a gymnasium.Env, and a batch as a VectorEnv (needs gymnasium).

Run it with phipsi, numpy and gymnasium:

    python -m phipsi.examples gymnasium_cart_pole

Scene.simulator stores states and intermediate results between steps. A batch is one simulator, too: its states are
vectorized and run on threads, with bitwise the results of single states, and completed episodes restart by reset(...,
states=mask) while the others continue. For another robot, replace the scene, observation, reward and end of the
episode.
"""

import argparse
import time
from typing import Any

import gymnasium
import numpy as np
import phipsi
from gymnasium.spaces import Box

DT, HELD, LIMIT = 0.005, 4, 500
"""Steps of 5 ms, each action for four steps, at most 500 actions per episode."""
FORCE, FAR, TILTED = 20.0, 2.4, 0.5
"""Force of the largest action, N; end of the track, m; and angle of a fallen rod, rad."""


def cart_pole() -> phipsi.Scene:
    """A cart on a rail, and a rod that is hinged on it, upright at zero."""
    builder = phipsi.SceneBuilder().link("rail").link("cart", mass=1.0).link("rod", 0.1, (0, 0, 0.5), np.diag([0.0083, 0.0083, 1e-5]))
    builder.joint("slide", "prismatic", "rail", "cart", axis=(1, 0, 0), damping=0.1)
    return builder.joint("hinge", "revolute", "cart", "rod", axis=(0, 1, 0), damping=0.001).build()


def observed(simulator: phipsi.Simulator) -> np.ndarray:
    """Position, angle and their velocities, (..., 4)."""
    return np.concatenate([simulator.q, simulator.qd], axis=-1)


def torque(action: np.ndarray) -> np.ndarray:
    """An action, (..., 1), as joint torques, (..., 2): a force on the cart and zero at the hinge."""
    force = FORCE * np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
    return np.concatenate([force, np.zeros_like(force)], axis=-1)


def judged(state: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reward and end of the episode, (...) each: 1 for upright, less for the angle, the distance from the center, and
    force.
    """
    x, angle = state[..., 0], state[..., 1]
    reward = 1.0 - 2.0 * angle**2 - 0.05 * x**2 - 0.01 * np.asarray(action)[..., 0] ** 2
    return reward, (np.abs(x) > FAR) | (np.abs(angle) > TILTED)


MOST = np.array([2 * FAR, 4 * TILTED, 50.0, 50.0])
"""Bounds that states do not reach in the step that ends an episode."""
OBSERVATION = Box(-MOST, MOST, dtype=np.float64)
ACTION = Box(-1.0, 1.0, (1,), np.float64)


class CartPole(gymnasium.Env):
    """One cart-pole."""

    observation_space, action_space = OBSERVATION, ACTION
    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self) -> None:
        scene = cart_pole()
        self._simulator = scene.simulator(scene.neutral(), dt=DT)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._simulator.reset(*self.np_random.uniform(-0.05, 0.05, (2, 2)))
        return observed(self._simulator), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self._simulator.step(torque(action), HELD)
        state = observed(self._simulator)
        reward, ended = judged(state, action)
        return state, float(reward), bool(ended), bool(self._simulator.t > (LIMIT - 0.5) * HELD * DT), {}


class CartPoles(gymnasium.vector.VectorEnv):
    """Many cart-poles in one simulator; a completed episode restarts with the next step."""

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int) -> None:
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = OBSERVATION, ACTION
        self.observation_space = gymnasium.vector.utils.batch_space(OBSERVATION, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(ACTION, num_envs)
        scene = cart_pole()
        self._simulator = scene.simulator(np.tile(scene.neutral(), (num_envs, 1)), dt=DT)
        self._over = np.zeros(num_envs, dtype=bool)

    def _begin(self, which: np.ndarray) -> None:
        self._simulator.reset(*self.np_random.uniform(-0.05, 0.05, (2, which.sum(), 2)), states=which)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        self._begin(np.ones(self.num_envs, dtype=bool))
        self._over[:] = False
        return observed(self._simulator), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        began = self._over
        self._simulator.step(torque(actions), HELD)
        if began.any():
            self._begin(began)
        state = observed(self._simulator)
        reward, ended = judged(state, actions)
        cut = self._simulator.t > (LIMIT - 0.5) * HELD * DT
        self._over = (ended | cut) & ~began
        return state, np.where(began, 0.0, reward), ended & ~began, cut & ~began, {}


def balancing(state: np.ndarray) -> np.ndarray:
    """A linear feedback that balances the rod."""
    return np.clip(state @ [0.1, 2.2, 0.17, 0.55], -1.0, 1.0)[..., None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--envs", type=int, default=1024, help="cart-poles of the batch")
    parser.add_argument("--actions", type=int, default=200, help="actions that each of them takes")
    given = parser.parse_args()

    env = CartPole()
    state, _ = env.reset(seed=1)
    total, over = 0.0, False
    while not over:
        state, reward, ended, cut, _ = env.step(balancing(state))
        total, over = total + reward, ended or cut
    print(f"one: return {total:.1f} of {LIMIT}, ended at ({state[0]:.3f} m, {state[1]:.4f} rad)")

    many = CartPoles(given.envs)
    for name, policy in (("balancing", balancing), ("random", lambda state: many.action_space.sample())):
        state, _ = many.reset(seed=1)
        total, episodes, began = 0.0, 0, time.perf_counter()
        for _ in range(given.actions):
            state, reward, ended, cut, _ = many.step(policy(state))
            total, episodes = total + reward.mean(), episodes + int(ended.sum())
        seconds = time.perf_counter() - began
        pace = given.actions * many.num_envs / seconds / 1e6
        print(f"{many.num_envs} {name}: mean reward {total / given.actions:.3f}, {episodes} fell, {pace:.2f} million actions a second")


if __name__ == "__main__":
    main()
