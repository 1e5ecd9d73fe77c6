"""Compares two reports of one kind and lists regressions. For information only: machines and their load differ."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim_bench.reports.render import table

TOLERANCE = 0.15
"""Relative difference that is attributed to noise."""


@dataclass(frozen=True, slots=True)
class FigureChange:
    """A figure that both reports have."""

    name: str
    unit: str
    before: float
    after: float
    gain: float
    """Factor of improvement; below 1 = regression, whether more or less is better."""

    def verdict(self, tolerance: float) -> str:
        """Returns ``SLOWER``, ``faster`` or an empty text."""
        if self.gain < 1.0 - tolerance:
            return "SLOWER"
        return "faster" if self.gain > 1.0 / (1.0 - tolerance) else ""


def read_report(path: Path) -> dict[str, Any]:
    """Returns a report that ``--json`` wrote.

    Raises:
        ConfigError: the file cannot be read, or holds no figures.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read as JSON: {error}") from error
    if not isinstance(found, dict) or not isinstance(found.get("figures"), list):
        raise ConfigError(f"{path}: holds no figures; give a file that `gibson-sim bench ... --json` wrote")
    return found


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[FigureChange]:
    """Returns the changes of the figures that both reports have, the worst first."""
    old = {figure["name"]: figure for figure in before["figures"]}
    found = []
    for figure in after["figures"]:
        first = old.get(figure["name"])
        if first is None or not first["value"] or not figure["value"]:
            continue
        a, b = float(first["value"]), float(figure["value"])
        found.append(FigureChange(figure["name"], figure["unit"], a, b, b / a if figure["better"] == "more" else a / b))
    return sorted(found, key=lambda change: change.gain)


def compare_text(
    before: Mapping[str, Any], after: Mapping[str, Any], tolerance: float = TOLERANCE, *, markdown: bool = False
) -> str:
    """Returns date, version and machine of both reports, all figures that both have, and those that only one has."""
    found = changes(before, after)
    names = [{figure["name"] for figure in report["figures"]} for report in (before, after)]
    lines = [f"{which}: {_origin(report)}" for which, report in (("before", before), ("after", after))]
    if _facts(before, "machine") != _facts(after, "machine"):
        lines.append("The reports are from different machines: ratios do not compare versions of the program.")
    slower = [change for change in found if change.verdict(tolerance) == "SLOWER"]
    mean = math.exp(sum(math.log(change.gain) for change in found) / len(found)) if found else math.nan
    lines.append(
        f"{len(found)} figures in both, {len(slower)} slower by more than {100 * tolerance:.0f} %; geometric mean {mean:.2f} times."
    )
    lines += [
        f"Only {which}: {name}"
        for which, only in (("before", names[0] - names[1]), ("after", names[1] - names[0]))
        for name in sorted(only)
    ]
    rows = [(c.name, f"{c.before:.4g}", f"{c.after:.4g}", c.unit, f"{c.gain:.2f}", c.verdict(tolerance)) for c in found]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    if rows:
        parts.append(table(("figure", "before", "after", "unit", "improvement", ""), rows, markdown, left=(0, 3, 5)))
    return "\n\n".join(parts)


def _facts(report: Mapping[str, Any], name: str) -> Any:
    """Returns a fact of the machine, which is in ``facts`` or at the top level of a report."""
    return report.get("facts", report).get(name)


def _origin(report: Mapping[str, Any]) -> str:
    names = ("date", "version", "machine", "load", "gpu")
    return ", ".join(f"{name} {_facts(report, name)}" for name in names if _facts(report, name) not in (None, ""))
