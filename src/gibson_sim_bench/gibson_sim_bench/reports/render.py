"""Text of a report on rendering: plain for the terminal, or Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from gibson_sim_bench.render import RenderReport, growth, peer_ratios

_SHORT = {"rgb": "rgb", "depth": "depth", "semantic": "sem", "instance": "inst", "normal": "normal"}


def outputs_text(outputs: Sequence[str]) -> str:
    """Returns ``rgb+depth+sem``."""
    return "+".join(_SHORT.get(name, name) for name in outputs)


def report_text(report: RenderReport, *, markdown: bool = False, show_growth: bool = False) -> str:
    """Returns the whole report."""
    parts = ["\n".join(_header(report, markdown))]
    head = ("scene", "triangles", "size", "renderer", "outputs", "fps", "p5", "p95", "drawn triangles")
    body = [
        (
            *(r.scene, f"{r.triangles:,}", r.size, r.contestant, outputs_text(r.outputs)),
            *(f"{r.fps:.1f}", f"{r.p5:.1f}", f"{r.p95:.1f}", f"{r.drawn:,}" if r.drawn else "-"),
        )
        for r in report.rows
    ]
    parts.append(table(head, body, markdown, left=(0, 3, 4)))
    ratios = peer_ratios(report.rows)
    if ratios:
        lines = [(a.scene, f"{a.width}x{a.height}", a.contestant, a.peer, f"{a.ratio:.2f}") for a in ratios]
        parts.append("Speed of Gibson Sim with five outputs relative to the fastest third-party renderer with RGB and depth:")
        parts.append(table(("scene", "size", "Gibson Sim", "fastest third party", "ratio"), lines, markdown, left=(0, 2, 3)))
    grown = growth(report.rows) if show_growth else []
    if grown:
        smallest = min((r for r in report.rows if r.scene.startswith("rooms:")), key=lambda r: r.triangles)
        title = f"Time per image in {grown[0][0].scene} relative to {smallest.scene}:"
        grown_lines = [(row.size, row.contestant, outputs_text(row.outputs), f"{ratio:.2f}") for row, ratio in grown]
        parts.append(title)
        parts.append(table(("size", "renderer", "outputs", "ratio"), grown_lines, markdown, left=(1, 2)))
    return "\n\n".join(parts)


def _header(report: RenderReport, markdown: bool) -> list[str]:
    lines = [
        f"{report.machine}; {report.cores} cores usable, load {report.load:g}; Gibson Sim {report.version}; {report.date[:10]}.",
        f"{report.frames} images each, vertical field of view {report.fov_y_deg:g} degrees. fps = 1 / median time per image.",
    ]
    for name, info in report.contestants.items():
        lines.append(f"{name}: {', '.join(f'{key} {value}' for key, value in info.items())}")
    lines += [f"Left out: {line}" for line in report.left_out]
    return [f"- {line}" for line in lines] if markdown else lines


def table(head: Sequence[str], body: Sequence[Sequence[str]], markdown: bool, left: Sequence[int] = (0,)) -> str:
    """Returns a table; columns with an index in ``left`` are left-aligned, all others right-aligned."""
    if markdown:
        rule = ["---" if k in left else "---:" for k in range(len(head))]
        return "\n".join("| " + " | ".join(row) + " |" for row in (head, rule, *body))
    widths = [max(len(row[k]) for row in (head, *body)) for k in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if k in left else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (head, *body)
    )
