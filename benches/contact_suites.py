"""Contacts in the public suites SimBenchmark and ContactBench, compared with MuJoCo, as a Markdown page.

    python benches/contact_suites.py [--quick] [--markdown FILE]

`make contact-suites` writes docs/measured/contact-suites.md. It needs the packages of the tests (mujoco, and pin with
its example-robot-data), click and rich, and takes some minutes on one thread; `--quick` takes less than one.
"""

from __future__ import annotations

import sys
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path

import click
import phipsi
from phipsi.report import machine
from rich.console import Console
from rich.progress import Progress
from studies.contacts.criteria import CONTACT_BENCH, SIM_BENCHMARK, TIMED, Row
from studies.contacts.programs import DEFAULT, hard, scene_of, times

CRITERIA = """## Criteria

- **Signorini** (ContactBench): the largest product of normal impulse and normal velocity of a contact at the end of a step, J; zero if contacts neither pull nor press on a surface that they leave.
- **Maximal dissipation** (ContactBench): the largest power times the step that friction could dissipate in addition within its cone, mu p_n |v_t| + p_t v_t, J; zero if friction opposes the slip with its full force, or the contact sticks.
- **Penetration** (rigidity, ContactBench): the largest depth of a shape below the floor, m.
- **Distance to the stop**: the difference from v^2 / (2 mu g); a method of order 1 has an error of up to v dt / 2.
- **Velocity at the end** of the dragged cube: the difference from the integral of the force minus the friction bound, for the forces as they are held over the steps.
- **Largest rise of the energy**: of a passive body, from any row to a later one, J.
- **Mean squared error of the velocities** (SimBenchmark, rolling): of the box and of one ball, from the exact solution.
- **Root mean squared error of the energy** (SimBenchmark, bouncing): relative to the initial energy.
- **Mean sum of squared penetrations** (SimBenchmark, thousand balls and piles, also called 666): over all contacts, mean over time.
- **Horizontal momentum** (piles): its largest component; zero, because there is no friction.
- **Height and slip** (SimBenchmark, ANYmal PD control): SimBenchmark reports only that the robot keeps its stance; here the height of the trunk and the displacement of the feet are measured.
- **Mean squared error of the energy** (SimBenchmark, ANYmal energy): in free flight with moving joints, with integrators of equal order.
- **Momentum minus contact impulses** (SimBenchmark, ANYmal momentum): the linear momentum of the robot changes by the contact impulses only; the largest norm of the difference, until 0.1 s after the first impact and until the legs have folded at up to 60 rad/s, where the error is that of the integrators.
"""
MODELS = """## Models

Both programs have the same MJCF model: `Scene.from_mujoco(contacts="plane")` reads its geoms as colliders, and all energies, momenta and depths are computed by phipsi from the states of either program. The scenes of bouncing and falling balls and of piles name their contacts, because MuJoCo has no coefficient of restitution and piles are a test of many named contacts. All contacts have elliptic cones.

- *Default*: MuJoCo's `solref`, `solimp`, `impratio` 1, at most 100 iterations of Newton's method, tolerance 1e-8.
- *Hard*: `solref` with a time constant of twice the step, the shortest that MuJoCo allows, `solimp` 0.99 0.9999 1e-4, `impratio` 100, at most 300 iterations, tolerance 1e-12. Longer time constants reduce the bounces of sliding bodies, and increase the penetration of impacts.
- *Bouncing*: in the column *hard*, `solref` is a spring without damping whose contact lasts ten steps, because MuJoCo has no coefficient of restitution.

MuJoCo integrates by its semi-implicit Euler method, with implicit joint damping, except for the energy of order 4. phipsi uses its only method for contacts, of order 1.

Differences from the original suites:

- Rolling: the 25 balls are on the ground instead of on the box, and gravity is inclined such that all bodies are pushed by 15 N per kg along the direction of the original force.
- Thousand balls: balls do not collide with each other. phipsi simulates a batch of 1,000 states of one ball, MuJoCo one model with 1,000 balls.
- Piles: 3 x 3 x 3 and 6 x 6 x 6 balls without friction and restitution, which fall from 5 cm; the larger pile with steps of 4 ms only. phipsi searches no pairs here: the scene names one contact per pair of balls (23,220 for 216 balls), and each costs time in every step. Contacts that are coupled are solved as one dense system, so a pile takes time cubic in the number of active contacts.
- ANYmal: the model is ANYmal B of example-robot-data with the spheres of its feet. The controller of the standing robot is a spring and a damper per joint, with the original gains. For the energy, the robot is thrown with moving joints instead of lifted by a force; for the momentum, it collides with a frictionless plane instead of a ball.
"""
LIMITS = """## Limitations

Meshes, and the Atlas and Kapla scenarios of SimBenchmark are not covered. Signorini's criterion is defined on velocities, and is therefore not met by a soft contact that is compressed. Times are for one thread, as the minimum of interleaved timings from the initial state.
"""


def number(value: float | None) -> str:
    if value is None or value == 0.0:
        return "" if value is None else "0"
    return f"{value:.3f}" if 0.01 <= abs(value) < 1000 else f"{value:.1e}"


def table(head: list[str], lines: list[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in [head, ["---", "---"] + ["---:"] * (len(head) - 2), *lines])


def results(rows: list[Row]) -> str:
    names = ["scenario", "criterion", "phipsi", "MuJoCo, default", "MuJoCo, hard"]
    return table(names, [[row.scenario, f"{row.criterion}, {row.unit}".removesuffix(", "), *map(number, row.values)] for row in rows])


def timings(quick: bool, steps: list[float], progress: Progress) -> str:
    lines = []
    task = progress.add_task("times", total=len(TIMED) * len(steps))
    for name, (make, count) in TIMED.items():
        for dt in steps:
            scenario = make()
            scene = scene_of(scenario)
            found = times(scenario, scene, dt, (DEFAULT, hard(dt)), max(count // 10, 1) if quick else count, 1 if quick else 5)
            lines.append([name, f"{1e3 * dt:g} ms", *(f"{each:.1f}" for each in found)])
            progress.advance(task)
    return table(["scenario", "step", "phipsi, us", "MuJoCo, default, us", "MuJoCo, hard, us"], lines)


def head(quick: bool) -> str:
    known = machine.describe()
    built = "" if "site-packages" in phipsi.__file__ else "\n\n**phipsi was a development build without optimization: its times are not representative.** `make contact-suites` measures the release build."
    trial = "\n\n**A trial (`--quick`).**" if quick else ""
    return (
        "# Contacts in public suites\n\nThe scenarios of [SimBenchmark](https://leggedrobotics.github.io/SimBenchmark/) (ETH Zurich) and the criteria of "
        "[ContactBench](https://github.com/Simple-Robotics/ContactBench) (Q. Le Lidec and others, Contact Models in Robotics: a Comparative Analysis, 2023), as far as [contacts](../how-to/contacts.md) "
        f"can represent them. Written by `make contact-suites` (benches/contact_suites.py): phipsi {phipsi.__version__}, MuJoCo {version('mujoco')}, {known['cpu']}, one thread, "
        f"{datetime.now(timezone.utc).date()}.{built}{trial}"
    )


@click.command(help=__doc__)
@click.option("--quick", is_flag=True, help="Steps of 4 ms only, few runs and turns.")
@click.option("--markdown", type=click.Path(path_type=Path), metavar="FILE", help="Write the page to this file.")
def main(quick: bool, markdown: Path | None) -> None:
    phipsi.set_num_threads(1)
    steps = [4e-3] if quick else [1e-3, 4e-3]
    parts = [head(quick)]
    with Progress(console=Console(stderr=True)) as progress:
        for title, suite in (("ContactBench", CONTACT_BENCH), ("SimBenchmark", SIM_BENCHMARK)):
            for dt in steps:
                task, rows = progress.add_task(f"{title}, {1e3 * dt:g} ms", total=len(suite)), []
                for criteria in suite.values():
                    rows += criteria(dt, quick)
                    progress.advance(task)
                parts.append(f"## {title}, steps of {1e3 * dt:g} ms\n\n{results(rows)}")
        parts.append(f"## Time per step\n\n{timings(quick, steps, progress)}")
    page = "\n\n".join([*parts, CRITERIA.strip(), MODELS.strip(), LIMITS.strip()]) + "\n"
    if markdown is None:
        sys.stdout.write(page)
    else:
        markdown.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
