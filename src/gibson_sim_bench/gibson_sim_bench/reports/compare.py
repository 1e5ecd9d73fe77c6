"""Two reports of one kind side by side: what got slower. For information: machines differ, and so do hours."""

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
"""Changes up to this part are what one run differs from the next."""


@dataclass(frozen=True, slots=True)
class Change:
    """One figure in both reports."""

    name: str
    unit: str
    before: float
    after: float
    gain: float
    """How many times as good as before; below 1 = worse, whether more of it is better or less."""

    def verdict(self, tolerance: float) -> str:
        """Returns ``slower``, ``faster`` or nothing."""
        if self.gain < 1.0 - tolerance:
            return "SLOWER"
        return "faster" if self.gain > 1.0 / (1.0 - tolerance) else ""


def read_report(path: Path) -> dict[str, Any]:
    """Returns a report that ``--json`` wrote.

    Raises:
        ConfigError: it cannot be read, or holds no figures.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read as JSON: {error}") from error
    if not isinstance(found, dict) or not isinstance(found.get("figures"), list):
        raise ConfigError(f"{path}: holds no figures; give a file that `gibson-sim bench ... --json` wrote")
    return found


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Change]:
    """Returns the figures that both reports have, the worst first."""
    old = {figure["name"]: figure for figure in before["figures"]}
    found = []
    for figure in after["figures"]:
        first = old.get(figure["name"])
        if first is None or not first["value"] or not figure["value"]:
            continue
        a, b = float(first["value"]), float(figure["value"])
        found.append(Change(figure["name"], figure["unit"], a, b, b / a if figure["better"] == "more" else a / b))
    return sorted(found, key=lambda change: change.gain)


def compare_text(
    before: Mapping[str, Any], after: Mapping[str, Any], tolerance: float = TOLERANCE, *, markdown: bool = False
) -> str:
    """Returns where the two come from, every figure that both have, and what only one has."""
    found = changes(before, after)
    names = [{figure["name"] for figure in report["figures"]} for report in (before, after)]
    lines = [f"{which}: {_origin(report)}" for which, report in (("before", before), ("after", after))]
    if _facts(before, "machine") != _facts(after, "machine"):
        lines.append("These are two machines: ratios say nothing about the program.")
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
        parts.append(table(("figure", "before", "after", "unit", "times as good", ""), rows, markdown, left=(0, 3, 5)))
    return "\n\n".join(parts)


def _facts(report: Mapping[str, Any], name: str) -> Any:
    """Returns a fact of the machine, which reports keep in ``facts`` or at the top."""
    return report.get("facts", report).get(name)


def _origin(report: Mapping[str, Any]) -> str:
    names = ("date", "version", "machine", "load", "gpu")
    return ", ".join(f"{name} {_facts(report, name)}" for name in names if _facts(report, name) not in (None, ""))
