"""Read a xacro with an argument: robots/snake.xacro, a chain with a given number of links (needs xacro)."""

from pathlib import Path

import numpy as np
import phipsi

FILE = Path(__file__).parent / "robots" / "snake.xacro"
scene = phipsi.load(FILE, xacro_arguments={"links": "10"})
print(f"{scene.nv} joints: {', '.join(scene.joint_names[:3])}, ...")

path = scene.simulate(np.linspace(0.6, 0.1, scene.nv), np.zeros(scene.nv), dt=1e-3, duration=2.0)
audit = path.energy_audit()
print(f"energy audit: {abs(float(audit.remainder)):.1e} J of {abs(float(audit.change)):.1f} J is not explained")
assert scene.nv == 10 and phipsi.load(FILE, xacro_arguments={"links": "4"}).nv == 4

if __name__ == "__main__":
    print("written:", scene.show(path, to="xacro_snake.html"))
