"""Formats a comparison: as an HTML page, one self-contained file, as plain values for JSON, and as lines of text. Pure."""

from __future__ import annotations

import base64
import dataclasses
import html
import math
from collections.abc import Iterable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison.compare import Comparison, Row
from gibson_sim.bags.comparison.parameters import Parameter
from gibson_sim.bags.comparison.plots import Plot
from gibson_sim.bags.comparison.robot_file import rounded
from gibson_sim.bags.plots.style import PAGE_STYLE

_MOST_ROWS, _MOST_PAIRS = 15, 4
_STYLE = (
    PAGE_STYLE
    + """
body { max-width: 1120px; }
p.caption { color: #4b5563; margin: .2em 0 .6em; }
th, td { vertical-align: top; }
tr.group td { background: #f3f4f6; font-weight: 600; }
td.much { font-weight: 600; } .real { color: #c2410c; } .sim { color: #1d4ed8; }
code { background: #f3f4f6; padding: .05em .3em; border-radius: 3px; white-space: nowrap; }
.pairs { display: grid; grid-template-columns: repeat(auto-fill, minmax(240px, 1fr)); gap: 1em; }
.pairs figure { margin: 0; } .pairs img { width: 100%; display: block; }
.bar { display: inline-block; height: .7em; background: #f59e0b; border-radius: 2px; }
"""
)


def page(comparison: Comparison, plots: Sequence[Plot], robot: str, created: str = "") -> str:
    """Returns the page.

    Args:
        comparison: The comparison.
        plots: Plots in the order of the page.
        robot: Name or file of the simulated robot.
        created: Line that names the program and the time.
    """
    real, sim = comparison.real.recording, comparison.sim.recording
    head = (
        f'<h1>Real and simulated</h1><p class="quiet"><span class="real">real</span> <code>{_text(str(real.path))}</code>, '
        f'{real.duration:.1f} s · <span class="sim">simulated</span> <code>{_text(str(sim.path))}</code>, {sim.duration:.1f} s · '
        f"robot <code>{_text(robot)}</code> · {_text(comparison.alignment)}</p>"
    )
    parts = [head, _differing(comparison), _parameters(comparison.parameters), *(_drawing(plot) for plot in plots)]
    parts += [_pairs(comparison), _all(comparison.rows), _topics(comparison), _notes(comparison.notes)]
    footer = f'<p class="quiet">{_text(created)}</p>' if created else ""
    title = f"{real.path.name} and {sim.path.name}"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{_text(title)}</title><style>{_STYLE}</style></head>'
        f"<body>{''.join(parts)}{footer}</body></html>\n"
    )


def number(value: float, unit: str = "") -> str:
    """Formats a number with at most four digits; a dash for NaN and infinity."""
    if not math.isfinite(value):
        return "–"
    digits = f"{value:.3g}" if 1e-3 <= abs(value) < 1e4 or value == 0.0 else f"{value:.2e}"
    if 1.0 <= abs(value) < 1e4:
        digits = f"{value:.{max(0, 3 - int(math.log10(abs(value))))}f}" if abs(value) < 1000 else f"{value:.0f}"
    if "." in digits and "e" not in digits:
        digits = digits.rstrip("0").rstrip(".")
    return f"{digits} {unit}".strip()


def _text(value: str) -> str:
    return html.escape(value)


def _table(columns: Sequence[tuple[str, bool]], lines: Iterable[str]) -> str:
    heads = "".join(f'<th class="number">{name}</th>' if right else f"<th>{name}</th>" for name, right in columns)
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


_VALUES = (("real", True), ("simulated", True), ("difference", True))


def _values(row: Row) -> str:
    numbers = ((row.real, "real"), (row.sim, "sim"), (row.difference, ""))
    return "".join(f'<td class="number {colour}">{number(value, row.unit)}</td>' for value, colour in numbers)


def _differing(comparison: Comparison) -> str:
    rows = comparison.differing
    if not rows:
        return "<h2>What differs most</h2><p>No notable differences.</p>"
    lines = []
    for row in rows[:_MOST_ROWS]:
        width = 0.4 + 4.6 * math.log(row.weight + 1.0) / math.log(rows[0].weight + 1.0)
        change = _text(row.change) if row.change else '<span class="quiet">–</span>'
        lines.append(
            f"<tr><td>{_text(row.group)}: {_text(row.name)}</td>{_values(row)}"
            f'<td><span class="bar" style="width:{width:.1f}em" title="{row.weight:.1f} times what is notable"></span></td><td>{change}</td></tr>'
        )
    more = f'<p class="quiet">{len(rows) - _MOST_ROWS} more below.</p>' if len(rows) > _MOST_ROWS else ""
    columns = [("figure", False), *_VALUES, ("weight", False), ("change in robot.yaml", False)]
    caption = '<p class="caption">Sorted by the difference relative to the smallest notable one of that metric.</p>'
    return f"<h2>What differs most</h2>{caption}{_table(columns, lines)}{more}"


def _parameters(parameters: Sequence[Parameter]) -> str:
    if not parameters:
        return ""
    lines = []
    for one in sorted(parameters, key=lambda parameter: not parameter.changes):
        spread = f" ± {number(one.uncertainty)}" if math.isfinite(one.deviation) and one.deviation > 0 else ""
        new = f"{rounded(one):g}" if one.changes else '<span class="quiet">stays</span>'
        kind = "much" if one.changes else "quiet"
        lines.append(
            f'<tr><td><code>{_text(one.name)}</code></td><td class="number">{number(one.old)}</td>'
            f'<td class="number {kind}">{new}</td><td class="number quiet">{spread}</td><td>{_text(one.unit)}</td>'
            f'<td class="quiet">{_text(one.because)}</td></tr>'
        )
    columns = [("parameter", False), ("now", True), ("fitted", True), ("", True), ("unit", False), ("from", False)]
    caption = (
        '<p class="caption">What would bring the simulated robot closer; <code>--fit</code> writes it to a file. '
        "A value stays that the recordings do not determine, or that differs by less than its uncertainty, ±.</p>"
    )
    return f"<h2>Parameters of robot.yaml</h2>{caption}{_table(columns, lines)}"


def _drawing(plot: Plot) -> str:
    return f'<h2>{_text(plot.title)}</h2><p class="caption">{_text(plot.caption)}</p>{plot.svg}'


def _pairs(comparison: Comparison) -> str:
    matched, real, sim = comparison.pictures, comparison.real.recording.pictures, comparison.sim.recording.pictures
    if matched is None or real is None or sim is None or not real.thumbnails or not sim.thumbnails:
        return ""
    shown = matched.pairs[np.unique(np.linspace(0, len(matched.pairs) - 1, _MOST_PAIRS).astype(int))]
    figures = "".join(
        f'<figure><img alt="real" src="{_image(real.thumbnails[i])}"><img alt="simulated" src="{_image(sim.thumbnails[j])}">'
        f'<figcaption class="quiet">real {real.t[i]:.1f} s, simulated {sim.t[j]:.1f} s</figcaption></figure>'
        for i, j in shown
    )
    return (
        f'<h2>Images at the same poses</h2><p class="caption">Real above, simulated below.</p><div class="pairs">{figures}</div>'
    )


def _image(rgb: NDArray[np.uint8]) -> str:
    _, data = cv2.imencode(".jpg", rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    return f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"


def _all(rows: Sequence[Row]) -> str:
    lines, group = [], ""
    for row in rows:
        if row.group != group:
            group = row.group
            lines.append(f'<tr class="group"><td colspan="4">{_text(group)}</td></tr>')
        lines.append(f"<tr><td>{_text(row.name)}</td>{_values(row)}</tr>")
    return f"<h2>All metrics</h2>{_table([('metric', False), *_VALUES], lines)}" if lines else ""


def _topics(comparison: Comparison) -> str:
    sides = [(one.recording, one.timing or {}) for one in (comparison.real, comparison.sim)]
    lines = []
    for side, (_, timing) in zip(("real", "sim"), sides, strict=True):
        for topic, one in sorted(timing.items()):
            values = (one.rate_hz, one.jitter_ms, float(one.missing), one.latency_ms, one.latency_99_ms)
            cells = "".join(f'<td class="number">{number(value)}</td>' for value in values)
            name = {"real": "real", "sim": "simulated"}[side]
            lines.append(
                f'<tr><td class="{side}">{name}</td><td><code>{_text(topic)}</code></td><td class="number">{one.count}</td>{cells}</tr>'
            )
    columns = [("bag", False), ("topic", False), ("messages", True), ("rate, Hz", True), ("jitter, ms", True), ("missing", True)]
    columns += [("latency, ms", True), ("99 %, ms", True)]
    caption = (
        '<p class="caption">Latency is log time minus stamp. On a real robot both are wall time; in a bag recorded here both are '
        "simulation time, which only passes in ticks; where they are of different clocks there is none.</p>"
    )
    return f"<h2>Topics</h2>{caption}{_table(columns, lines)}"


def _notes(notes: Sequence[str]) -> str:
    items = "".join(f"<li>{_text(note)}</li>" for note in notes)
    return f"<h2>Omissions and assumptions</h2><ul>{items}</ul>" if items else ""


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
