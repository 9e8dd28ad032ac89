"""The page of a comparison: both robots, and their differences from the base outward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._compare import Comparison, Difference, text_of
from . import embed
from .page import Block, Table
from .pipeline import Findings, Layout, Section, collect, html, provenance
from .progress import Reporter, Silent
from .text import plural, scientific


@dataclass
class ComparisonReport(Findings):
    """A comparison, and names of the robots."""

    name: str
    names: tuple[str, str]
    found: Comparison

    @property
    def count(self) -> int:
        """Number of differences."""
        return sum(len(part) for part in (self.found.properties, self.found.poses, self.found.dynamics))


def _first(report: ComparisonReport) -> Sequence[Block]:
    found = report.found
    if found.same:
        return ["The robots are the same within the tolerance."]
    blocks: list[Block] = [found.note] if found.note else []
    if found.first is not None:
        blocks += [_table(report, [found.first]), "Differences are in the order of links from the base outward, so that the first one is often the cause of the others."]
    return blocks


def _robots(report: ComparisonReport, _: Reporter) -> list[tuple[str, dict[str, Any]]]:
    for scene in report.found.scenes:
        embed.check(scene)
    return [(name, embed.robot(scene, scene.initial()[None], np.zeros(1))) for name, scene in zip(report.names, report.found.scenes, strict=True)]


def _sizes(report: ComparisonReport) -> Sequence[Block]:
    columns = [(f"{scene.total_mass:.6g}", str(scene.nv), str(len(scene.joint_names)), str(len(scene.link_names))) for scene in report.found.scenes]
    names = ("total mass, kg", "degrees of freedom", "movable joints", "links")
    return [Table(("", *report.names), list(zip(names, *columns, strict=True)))]


def _properties(report: ComparisonReport) -> Sequence[Block]:
    return [_table(report, report.found.properties)]


def _poses(report: ComparisonReport) -> Sequence[Block]:
    return [*_locked(report), _table(report, report.found.poses)]


def _dynamics(report: ComparisonReport) -> Sequence[Block]:
    text = "The entry with the largest difference of each joint, at random states within the limits of the first robot. Differences are relative to the larger of both values."
    return [text, _table(report, report.found.dynamics)]


def _locked(report: ComparisonReport) -> list[Block]:
    locked = report.found.locked
    return [f"{plural(len(locked), 'joint')} of one robot only, locked at neutral here and for the dynamics: {', '.join(locked)}."] if locked else []


def _table(report: ComparisonReport, found: Sequence[Difference]) -> Table:
    rows = [(one.where, one.quantity.replace("^2", "²"), text_of(one.first), text_of(one.second), scientific(one.relative) if np.isfinite(one.relative) else "") for one in found]
    return Table(("where", "quantity", *report.names, "relative difference"), rows, 2)


REPORT: Layout[ComparisonReport] = Layout(
    "comparison",
    "",
    (
        Section("first", "The first difference", blocks=_first),
        Section("robots", "The robots", collect=_robots),
        Section("sizes", "Sizes", blocks=_sizes),
        Section("properties", "Joints, links and limits", blocks=_properties),
        Section("poses", "Poses at random configurations", blocks=_poses),
        Section("dynamics", "Dynamics at random states", blocks=_dynamics),
        provenance(),
    ),
)


def write_page(file: Path, names: tuple[str, str], found: Comparison) -> Path:
    """Write the page as one file; robots without the packages of the viewer are not drawn."""
    report = ComparisonReport(False, " and ".join(dict.fromkeys(names)), names, found)
    file.write_text(html(REPORT, collect(REPORT, report, Silent())), encoding="utf-8")
    return file
