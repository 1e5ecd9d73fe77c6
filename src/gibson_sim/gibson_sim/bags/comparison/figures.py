"""Formats a comparison as plain values for JSON, and as lines of text. Pure."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from gibson_sim.bags.comparison.compare import Comparison
from gibson_sim.bags.comparison.page import number
from gibson_sim.bags.comparison.robot_file import rounded


def figures(comparison: Comparison) -> dict[str, Any]:
    """Returns all metrics as values for JSON; NaN and infinity become null."""
    return {
        "real": str(comparison.real.recording.path),
        "sim": str(comparison.sim.recording.path),
        "alignment": comparison.alignment,
        "figures": [
            {**_plain(dataclasses.asdict(row)), "difference": _plain(row.difference), "weight": _plain(row.weight)}
            for row in comparison.rows
        ],
        "parameters": [
            {
                **_plain(dataclasses.asdict(one)),
                "name": one.name,
                "uncertainty": _plain(one.uncertainty),
                "changes": one.changes,
                "written": rounded(one),
            }
            for one in comparison.parameters
        ],
        "topics": {
            side: {topic: _plain(dataclasses.asdict(timing)) for topic, timing in (one.timing or {}).items()}
            for side, one in (("real", comparison.real), ("sim", comparison.sim))
        },
        "notes": list(comparison.notes),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def text_table(comparison: Comparison, most: int = 12) -> str:
    """Returns the largest differences with the parameters to change, as text."""
    lines = [["what differs most", "real", "simulated", "change in robot.yaml"]]
    lines += [
        [f"{row.group}: {row.name}", number(row.real, row.unit), number(row.sim, row.unit), row.change]
        for row in comparison.differing[:most]
    ]
    if len(lines) == 1:
        return "no notable differences"
    widths = [max(len(line[i]) for line in lines) for i in range(3)]
    return "\n".join(
        "  ".join([*(word.ljust(width) for word, width in zip(line, widths, strict=False)), line[3]]).rstrip() for line in lines
    )
