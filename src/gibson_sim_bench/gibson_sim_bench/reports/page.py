"""Writes the benchmark page from the JSON files in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.writing import write_file
from gibson_sim_bench import scaling, soak
from gibson_sim_bench.render import RenderReport, RenderRow
from gibson_sim_bench.reports import plots
from gibson_sim_bench.reports.compare import read_report
from gibson_sim_bench.reports.paper import SENSOR_ONLY
from gibson_sim_bench.reports.render import report_text as render_text
from gibson_sim_bench.reports.table1 import report_text as table1_text
from gibson_sim_bench.rows import ENOUGH, FREE, HOST, IN_PROCESS, LOCKSTEP, Table1, Table1Row, table_of
from gibson_sim_bench.scaling import report_text as scaling_text
from gibson_sim_bench.soak import report_text as soak_text

_TITLES = {
    "table1": "The paper's table",
    "peers": "Third-party renderers",
    "scaling": "Scaling",
    "soak": "Long runs",
}
"""Headings by kind of report, in the order of the page."""
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"
"""Lines of the page between which text is generated; text outside them is kept."""


def write_page(data: Path, output: Path, images: Path) -> list[str]:
    """Writes the reports into the page, and the plots; returns one line for each file, whether used or left out.

    Args:
        data: folder of JSON files.
        output: the page; the text between ``BEGIN`` and ``END`` is replaced.
        images: folder of the plots.

    Raises:
        ConfigError: the folder has no report, the page lacks these lines, or matplotlib is missing.
    """
    plots.require_matplotlib()
    reports: dict[str, list[tuple[str, dict[str, Any]]]] = {kind: [] for kind in _TITLES}
    messages: list[str] = []
    for path in sorted(data.glob("*.json")):
        try:
            read = read_report(path)
        except ConfigError:
            messages.append(f"{path.name}: has no figures, left out")
            continue
        if read.get("kind") in reports:
            reports[read["kind"]].append((path.stem, read))
            messages.append(f"{path.name}: {read['kind']}")
        else:
            messages.append(f"{path.name}: kind {read.get('kind')}, left out")
    if not any(reports.values()):
        raise ConfigError(
            f"{data}: holds no report of {', '.join(_TITLES)}; run `gibson-sim bench table1 --json {data}/table1_cpu.json`"
        )
    before, after = _around(output)
    images.mkdir(parents=True, exist_ok=True)
    links = Path(os.path.relpath(images, output.parent)).as_posix(), Path(os.path.relpath(data, output.parent)).as_posix()
    parts = summary([table_of(read) for _, read in reports["table1"]])
    for kind, title in _TITLES.items():
        if reports[kind]:
            parts.append(f"## {title}")
            for name, read in reports[kind]:
                parts.append(f"### {name.replace('_', ' ')}\n\n[Data]({links[1]}/{name}.json).")
                parts += _SECTIONS[kind](name, read, images, links[0])
    write_file(output, f"{before}{BEGIN}\n\n{joined(parts)}\n\n{END}{after}")
    return [*messages, f"written: {output}"]


def joined(parts: list[str]) -> str:
    """Returns paragraphs separated by blank lines."""
    return "\n\n".join(part.strip() for part in parts)


def _around(page: Path) -> tuple[str, str]:
    """Returns the text before and after the generated part of a page; a heading and an empty line for a new page."""
    if not page.is_file():
        return "# Benchmarks\n\n", "\n"
    text = page.read_text(encoding="utf-8")
    before, begun, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not (begun and ended):
        raise ConfigError(f"{page}: has no lines {BEGIN} and {END}; put them around the generated part, or name another file")
    return before, after


def _table1(name: str, read: Mapping[str, Any], images: Path, link: str) -> list[str]:
    report = table_of(read)
    plots.plot_table1(report, images / f"bench_{name}.png")
    return [
        f"![Frames per second by mode, configuration and substeps]({link}/bench_{name}.png)",
        table1_text(report, markdown=True),
    ]


def _peers(name: str, read: Mapping[str, Any], images: Path, link: str) -> list[str]:
    fields = {key: read[key] for key in ("date", "version", "machine", "cores", "load", "contestants", "fov_y_deg", "frames")}
    rows = tuple(RenderRow(**{**row, "outputs": tuple(row["outputs"])}) for row in read["rows"])
    return [render_text(RenderReport(**fields, rows=rows, left_out=tuple(read["left_out"])), markdown=True)]


def _scaling(name: str, read: Mapping[str, Any], images: Path, link: str) -> list[str]:
    report = scaling.report_of(dict(read))
    plots.plot_scaling(report, images / f"bench_{name}.png")
    return [f"![Time and memory by problem size]({link}/bench_{name}.png)", scaling_text(report, markdown=True)]


def _soak(name: str, read: Mapping[str, Any], images: Path, link: str) -> list[str]:
    report = soak.report_of(dict(read))
    plots.plot_soak(report, images / f"bench_{name}.png")
    return [f"![Memory and rates over time]({link}/bench_{name}.png)", soak_text(report, markdown=True)]


_SECTIONS: dict[str, Callable[[str, Mapping[str, Any], Path, str], list[str]]] = {
    "table1": _table1,
    "peers": _peers,
    "scaling": _scaling,
    "soak": _soak,
}


def summary(tables: list[Table1]) -> list[str]:
    """Returns a summary for each machine: which rows reach their limit, and their bottlenecks."""
    found = []
    for report in tables:
        rows = [row for row in report.rows if row.to == HOST and row.bounds]
        if not rows:
            continue
        lines = [f"## Summary: {report.facts.gpu or 'no rendering'}, {report.facts.cores} cores", report.facts.text + "."]
        near, far = [r for r in rows if r.share >= ENOUGH], [r for r in rows if r.share < ENOUGH]
        lines.append(
            f"- {len(near)} of {len(rows)} rows reach {100 * ENOUGH:.0f} % or more of the limit measured with them, {len(far)} do not."
        )
        lines += [
            _sentence(name, [row for row in rows if row.way == name and row.substeps]) for name in (IN_PROCESS, LOCKSTEP, FREE)
        ]
        found.append("\n".join((lines[0], "", lines[1], "", *lines[2:])))
    return found


def _sentence(configuration: str, rows: list[Table1Row]) -> str:
    """Returns the best and the worst rows of a configuration."""
    if not rows:
        return f"- {configuration.capitalize()}: not measured."
    with_images = [row for row in rows if row.mode != SENSOR_ONLY]
    counts: dict[str, int] = {}
    for row in rows:
        counts[row.bound_by] = counts.get(row.bound_by, 0) + 1
    bounds = ", ".join(
        f"{name.removesuffix(' alone')} in {count}" for name, count in sorted(counts.items(), key=lambda pair: -pair[1])
    )
    fastest, slowest = max(rows, key=lambda r: r.fps), min(rows, key=lambda r: r.fps)
    worst = min(rows, key=lambda r: r.share)
    rest = (
        f" With images {min(r.fps for r in with_images):,.0f} to {max(r.fps for r in with_images):,.0f} frames/s."
        if with_images
        else ""
    )
    return (
        f"- {configuration.capitalize()}: from {slowest.fps:,.0f} frames/s ({slowest.mode}, {_substeps(slowest)}) to {fastest.fps:,.0f} "
        f"({fastest.mode}, {fastest.substeps}).{rest} Bottleneck: {bounds} rows; farthest from its limit: {worst.mode} with {_substeps(worst)}, "
        f"{100 * worst.share:.0f} %."
    )


def _substeps(row: Table1Row) -> str:
    return f"{row.substeps} substep{'' if row.substeps == 1 else 's'}"
