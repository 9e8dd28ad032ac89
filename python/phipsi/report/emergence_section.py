"""The part of the page on M from the random model."""

from __future__ import annotations

import math

from .collect import Report
from .emergence import COVERAGE_SAMPLES, PLAIN, RECURSION, SAMPLED, SIGMA, SOBOL, Emergence, Point
from .emergence_plots import INKS, NAMES, THEORY
from .measure import EPS
from .sections import figure, heads, note, numbers
from .text import count, escape, minus, plural, power, scientific, significant, time

#: What may be missing here while the rest is not, and what the page calls it.
PARTS = {"sampling": "Samples", SOBOL: "Sobol points", PLAIN: "Plain Monte Carlo", "dense product": "Dense product"}


def emergence(report: Report, by_time: str | None, by_samples: str | None) -> str:
    """Plots and tables of M from the random model."""
    found = report.emergence
    if found is None:
        return note(report.missing.get("emergence", ""))
    intro = (
        "<p>Forces act on the bodies at random, each with the inertia of its body as covariance; nobody puts in an equation"
        " of motion. The joint torques that they cause have the mass matrix as their covariance (5.1), so it can be"
        " measured: from independent samples, from scrambled Sobol points, and from sigma points, which are exact. Beside"
        " them, the recursion (3.5) and the dense product of (5.1). All at the first state.</p>"
    )
    absent = "".join(
        f'<p class="note">{title} not here: {escape(report.missing[part])}</p>'
        for part, title in {**PARTS, "samples a second": "Samples a second"}.items()
        if part in report.missing
    )
    plots = _plots(found, by_time, by_samples)
    return f"{intro}{absent}{plots}{_ways(found)}{_reach(found)}{_coverage(found)}{_rates(found)}"


def _plots(found: Emergence, by_time: str | None, by_samples: str | None) -> str:
    if by_time is None or by_samples is None:
        return ""
    time_caption = (
        f"Error of M (Frobenius norm, relative, against double-double) and time from q to M on one thread; curves: root of"
        f" the mean square over {plural(found.seeds, 'seed')}, median time. The slopes are measured below; as straight lines"
        " through the last point they show where the setup bends the curves. Left and low is better."
    )
    samples_caption = (
        "The same errors against the number of samples, and the lines of least squares through their logarithms, with the"
        " standard errors of their slopes. Sobol points come to theirs the later, the more random numbers a sample takes"
        f" (here {found.dimension})."
    )
    if found.unit_error is not None:
        samples_caption += (
            f" The dashed line is what theory expects of independent samples: {significant(found.unit_error)} / √samples,"
            " from M alone."
        )
    return figure(by_time, time_caption) + figure(by_samples, samples_caption)


def _ways(found: Emergence) -> str:
    """A row a way: at its largest number of samples where it takes one."""
    titles = ("samples", "median time", "against recursion", "error", "slope measured", "slope in theory")
    rows = [f"<tr><th>way to M</th>{heads(*titles)}</tr>"]
    (recursion,) = found.of(RECURSION)
    for route, ink in INKS.items():
        points = found.of(route)
        if points:
            swatch = f'<span class="swatch" style="background:{ink}"></span>'
            rows.append(f"<tr><td>{swatch}{NAMES[route]}</td>{_way(found, points[-1], recursion)}</tr>")
    return f"<table>{''.join(rows)}</table>"


def _way(found: Emergence, point: Point, recursion: Point) -> str:
    samples = count(point.samples) if point.samples else ""
    if point.route == SIGMA and found.dimension is not None:
        samples = f"{count(2 * found.dimension)} points"
    line = found.slopes.get(point.route)
    slope = minus(f"{line.measured:.3f} ± {line.standard_error:.3f}") if line else ""
    theory = THEORY[point.route] if point.route in SAMPLED else "exact"
    ratio = f"{significant(point.ns / recursion.ns, 3 if point.ns < 1000 * recursion.ns else 2)} ×"
    return numbers(samples, time(point.ns), ratio, scientific(point.error), slope, theory)


def _reach(found: Emergence) -> str:
    """What the slopes mean for who wants all digits."""
    if found.unit_error is None or not found.of(SIGMA):
        return ""
    needed = (found.unit_error / EPS["float64"]) ** 2
    return (
        f"<p>Sampling shows what M is; it is no way to compute it. Independent samples would reach one unit of rounding after"
        f" about {power(round(math.log10(needed)))} of them, and sigma points are there with {count(2 * (found.dimension or 0))},"
        " because M is a second moment and they have all second moments right.</p>"
    )


def _coverage(found: Emergence) -> str:
    if not found.coverage:
        return ""

    def share(pair: tuple[float, float] | None) -> str:
        return f"{100 * pair[0]:.1f} % ± {100 * pair[1]:.1f} %" if pair else "no such entry"

    rows = "".join(
        f"<tr><td>{100 * row.confidence:g} %</td>{numbers(share(row.diagonal), share(row.off_diagonal))}</tr>"
        for row in found.coverage
    )
    head = f"<tr><th>stated confidence</th>{heads('held on the diagonal', 'held off the diagonal')}</tr>"
    text = (
        f"<p>Every entry of a sampled M has a confidence interval. Of {plural(found.coverage_seeds, 'estimate')} from"
        f" {COVERAGE_SAMPLES} samples each, the intervals held the true entry this often (± one standard error):</p>"
    )
    return f"<h3>Do the confidence intervals hold?</h3>{text}<table>{head}{rows}</table>"


def _rates(found: Emergence) -> str:
    if not found.rates:
        return ""
    one = found.rates[0]
    rows = "".join(
        f"<tr><td>{plural(rate.threads, 'thread')}</td>"
        f"{numbers(scientific(rate.per_second, 2), f'{rate.per_second / one.per_second:.2f} ×')}</tr>"
        for rate in found.rates
    )
    alone = " There is one core, so there is one row." if len(found.rates) == 1 else ""
    text = (
        f"<p>Plain Monte Carlo of {count(one.samples)} samples, {found.dimension} normal numbers each, from q to the estimate of"
        " M and its intervals. One process after the other, each with its number of threads; they share the machine with"
        f" whatever else runs on it.{alone}</p>"
    )
    return f"<h3>Samples a second</h3>{text}<table><tr><th></th>{heads('samples a second', 'against one')}</tr>{rows}</table>"
