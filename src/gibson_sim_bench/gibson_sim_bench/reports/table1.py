"""Text of the paper's table: plain for the terminal, or Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim_bench.reports.paper import GENERAL, HOUSE_NOTE, MODES, V1_HARDWARE, V2_HARDWARE
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.rows import ENOUGH, FREE, HOST, IN_PROCESS, LOCKSTEP, TENSOR, Table1, Table1Row, paper_of, targets

_STAGES = ("step", "convert", "draw", "fill", "read back", "encode", "publish", "transport")


def report_text(report: Table1, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    lines = [report.facts.text, f"Robot {report.robot}; tensors on {report.tensors_on}.", *GENERAL]
    lines += [f"Left out: {line}" for line in report.left_out]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    for title, head, rows, left in (_physics(report), _houses(report), _bounds(report), _stages(report)):
        if rows:
            parts += [title, table(head, rows, markdown, left=left)]
    parts += ["\n".join(f"- {line}" if markdown else line for line in _notes(report))]
    reached = [(t.what, t.wanted, t.measured, "met" if t.met else "MISSED") for t in targets(report.rows)]
    if reached:
        parts += [
            "Targets for two cores without a GPU:",
            table(("what", "wanted", "measured", ""), reached, markdown, left=(0, 1, 3)),
        ]
    return "\n\n".join(parts)


_Table = tuple[str, tuple[str, ...], list[tuple[str, ...]], tuple[int, ...]]
"""Title, column headings, rows, and indices of left-aligned columns."""


def _physics(report: Table1) -> _Table:
    """Returns the upper table: modes by configuration, one row for each number of substeps."""
    head = ("row", "substeps", "in process", "tensors", "lockstep", "free-running", "skipped", "V2", "V1")
    found: dict[tuple[str, int], dict[str, Table1Row]] = {}
    for row in report.rows:
        if row.substeps:
            found.setdefault((row.mode, row.substeps), {})[TENSOR if row.to == TENSOR else row.way] = row
    rows: list[tuple[str, ...]] = []
    for mode in MODES:
        here = sorted(((k, ways) for (name, k), ways in found.items() if name == mode.name), key=lambda pair: -pair[0])
        paper = (_rate(mode.v2), _rate(mode.v1))
        for substeps, ways in here:
            fps = (_rate(ways[way].fps) if way in ways else "" for way in (IN_PROCESS, TENSOR, LOCKSTEP, FREE))
            lost = f"{100 * ways[FREE].lost:.0f} %" if FREE in ways else ""
            rows.append((mode.name, str(substeps), *fps, lost, *paper))
    first = next((row for row in report.rows if row.substeps), None)
    where = f"{first.scene}, {first.triangles:,} triangles, {first.width}x{first.height}" if first else ""
    title = f"Frames a second with full physics ({where}); V2: {V2_HARDWARE}; V1: {V1_HARDWARE}:"
    return title, head, rows, (0,)


def _houses(report: Table1) -> _Table:
    rows = [
        (row.scene, f"{row.triangles:,}", row.mode, row.to, _rate(row.fps), _rate(row.p5), _rate(row.p95),
         *(_rate(paper_of(row)[who]) for who in ("v2", "habitat")))
        for row in report.rows
        if not row.substeps
    ]  # fmt: skip
    title = f"Drawing only, 640x480, no physics; the paper's best house, V2 and Habitat-sim, both {V2_HARDWARE}:"
    head = ("house", "triangles", "outputs", "to", "frames/s", "p5", "p95", "V2", "Habitat-sim")
    return title, head, rows, (0, 2, 3)


def _bounds(report: Table1) -> _Table:
    rows: list[tuple[str, ...]] = [
        (
            *_of(row),
            _rate(row.fps),
            ", ".join(f"{name.removesuffix(' alone')} {ms:.2f}" for name, ms in row.bounds.items()),
            row.bound_by,
            _rate(row.bound_fps),
            f"{100 * row.share:.0f} %",
            next((f"{name} {ms:.2f}" for name, ms in row.between.items()), ""),
        )
        for row in report.rows
        if row.bounds and row.to == HOST
    ]
    head = ("way", "row", "substeps", "frames/s", "alone, ms", "bound by", "limit/s", "reached", "most between, ms")
    return "What bounds each row: its parts measured alone, and the rate if nothing else took time:", head, rows, (0, 1, 4, 5, 8)


def _stages(report: Table1) -> _Table:
    rows: list[tuple[str, ...]] = [
        (*_of(row), *(f"{row.stages[name]:.2f}" if name in row.stages else "" for name in _STAGES), f"{1e3 / row.fps:.2f}")
        for row in report.rows
        if row.stages and row.to == HOST and row.way != FREE
    ]
    head = ("way", "row", "substeps", *_STAGES, "frame")
    return (
        "Stages, milliseconds, medians, each measured apart and waited for; beside them the whole frame as it comes:",
        head,
        rows,
        (0, 1),
    )


def _of(row: Table1Row) -> tuple[str, str, str]:
    return row.way, row.mode if row.substeps else f"{row.mode}, {row.scene}", str(row.substeps) if row.substeps else "none"


def _notes(report: Table1) -> list[str]:
    """Returns what is not comparable, row by row, and how many rows are below their limit."""
    present = {row.mode for row in report.rows}
    found = [f"{mode.name}: {mode.note}." for mode in MODES if mode.note and mode.name in present]
    if any(not row.substeps for row in report.rows):
        found.append(f"Houses: {HOUSE_NOTE}.")
    low = [row for row in report.rows if row.to == HOST and row.share < ENOUGH]
    found += [
        f"{way}: {sum(row.way == way for row in low)} rows below {100 * ENOUGH:.0f} % of their limit." for way in _ways(low)
    ]
    return found


def _ways(rows: Sequence[Table1Row]) -> list[str]:
    return list(dict.fromkeys(row.way for row in rows))


def _rate(fps: float | None) -> str:
    if fps is None or math.isnan(fps):
        return ""
    return f"{fps:,.0f}" if fps >= 100 else f"{fps:.1f}"
