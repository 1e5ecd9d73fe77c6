"""Report of the paper's table: plain text for the terminal, or Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim_bench.reports.paper import GENERAL, MODES, SCAN_NOTE, V1_HARDWARE, V2_HARDWARE
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.rows import ENOUGH, FREE, HOST, IN_PROCESS, LOCKSTEP, TENSOR, Table1, Table1Row, paper_of, targets

_STAGES = {
    "step": "step",
    "convert": "convert",
    "draw": "render",
    "fill": "fill holes",
    "read back": "readback",
    "encode": "encode",
    "publish": "publish",
    "transport": "transport",
}
"""Column headings by stage."""


def report_text(report: Table1, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    lines = [report.facts.text, f"Robot {report.robot}; tensors on {report.tensors_on}.", *GENERAL]
    lines += [f"Left out: {line}" for line in report.left_out]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    for title, head, rows, left in (_physics(report), _rendering(report), _bounds(report), _stages(report)):
        if rows:
            parts += [title, table(head, rows, markdown, left=left)]
    parts += ["\n".join(f"- {line}" if markdown else line for line in _notes(report))]
    reached = [(t.what, t.wanted, t.measured, "met" if t.met else "MISSED") for t in targets(report.rows)]
    if reached:
        parts += [
            "Targets for two cores without a GPU:",
            table(("measurement", "target", "measured", ""), reached, markdown, left=(0, 1, 3)),
        ]
    return "\n\n".join(parts)


_Table = tuple[str, tuple[str, ...], list[tuple[str, ...]], tuple[int, ...]]
"""Title, column headings, rows, and indices of left-aligned columns."""


def _physics(report: Table1) -> _Table:
    """Returns the table with physics: rates by configuration, one row for each mode and number of substeps."""
    head = ("mode", "substeps", "in process", "tensors", "lockstep", "free-running", "skipped", "V2", "V1")
    found: dict[tuple[str, int], dict[str, Table1Row]] = {}
    for row in report.rows:
        if row.substeps:
            found.setdefault((row.mode, row.substeps), {})[TENSOR if row.to == TENSOR else row.way] = row
    rows: list[tuple[str, ...]] = []
    for mode in MODES:
        of_mode = sorted(
            ((k, by_column) for (name, k), by_column in found.items() if name == mode.name), key=lambda pair: -pair[0]
        )
        paper = (_rate(mode.v2), _rate(mode.v1))
        for substeps, by_column in of_mode:
            fps = (_rate(by_column[column].fps) if column in by_column else "" for column in (IN_PROCESS, TENSOR, LOCKSTEP, FREE))
            lost = f"{100 * by_column[FREE].lost:.0f} %" if FREE in by_column else ""
            rows.append((mode.name, str(substeps), *fps, lost, *paper))
    first = next((row for row in report.rows if row.substeps), None)
    where = f"{first.scene}, {first.triangles:,} triangles, {first.width}x{first.height}" if first else ""
    title = f"Frames per second with full physics ({where}); V2: {V2_HARDWARE}; V1: {V1_HARDWARE}:"
    return title, head, rows, (0,)


def _rendering(report: Table1) -> _Table:
    rows = [
        (row.scene, f"{row.triangles:,}", row.mode, row.to, _rate(row.fps), _rate(row.p5), _rate(row.p95),
         *(_rate(paper_of(row)[who]) for who in ("v2", "habitat")))
        for row in report.rows
        if not row.substeps
    ]  # fmt: skip
    title = f"Rendering only, 640x480, no physics; V2 and Habitat-sim in the paper's fastest scene, both {V2_HARDWARE}:"
    head = ("scene", "triangles", "outputs", "to", "frames/s", "p5", "p95", "V2", "Habitat-sim")
    return title, head, rows, (0, 2, 3)


def _bounds(report: Table1) -> _Table:
    rows: list[tuple[str, ...]] = [
        (
            *_configuration(row),
            _rate(row.fps),
            ", ".join(f"{name.removesuffix(' alone')} {ms:.2f}" for name, ms in row.bounds.items()),
            row.bound_by,
            _rate(row.bound_fps),
            f"{100 * row.share:.0f} %",
            next((f"{name} {ms:.2f}" for name, ms in row.overhead_ms.items()), ""),
        )
        for row in report.rows
        if row.bounds and row.to == HOST
    ]
    head = (
        "configuration",
        "mode",
        "substeps",
        "frames/s",
        "alone, ms",
        "bound by",
        "limit/s",
        "reached",
        "largest overhead, ms",
    )
    return (
        "Bottleneck of each row: its parts measured alone, and the limit if nothing else took time:",
        head,
        rows,
        (0, 1, 4, 5, 8),
    )


def _stages(report: Table1) -> _Table:
    rows: list[tuple[str, ...]] = [
        (
            *_configuration(row),
            *(f"{row.stages[name]:.2f}" if name in row.stages else "" for name in _STAGES),
            f"{1e3 / row.fps:.2f}",
        )
        for row in report.rows
        if row.stages and row.to == HOST and row.way != FREE
    ]
    head = ("configuration", "mode", "substeps", *_STAGES.values(), "frame")
    return (
        "Stages, median milliseconds, each synchronized and measured in separate frames; last column: the frame without synchronization:",
        head,
        rows,
        (0, 1),
    )


def _configuration(row: Table1Row) -> tuple[str, str, str]:
    return row.way, row.mode if row.substeps else f"{row.mode}, {row.scene}", str(row.substeps) if row.substeps else "none"


def _notes(report: Table1) -> list[str]:
    """Returns what is not comparable, mode by mode, and how many rows are below their limit."""
    present = {row.mode for row in report.rows}
    found = [f"{mode.name}: {mode.note}." for mode in MODES if mode.note and mode.name in present]
    if any(not row.substeps for row in report.rows):
        found.append(f"Rendering only: {SCAN_NOTE}.")
    below = [row for row in report.rows if row.to == HOST and row.share < ENOUGH]
    found += [
        f"{name}: {sum(row.way == name for row in below)} rows below {100 * ENOUGH:.0f} % of their limit."
        for name in _configurations(below)
    ]
    return found


def _configurations(rows: Sequence[Table1Row]) -> list[str]:
    return list(dict.fromkeys(row.way for row in rows))


def _rate(fps: float | None) -> str:
    if fps is None or math.isnan(fps):
        return ""
    return f"{fps:,.0f}" if fps >= 100 else f"{fps:.1f}"
