"""Report on scaling: plain text for the terminal, or Markdown."""

from __future__ import annotations

from gibson_sim_bench.reports.render import table
from gibson_sim_bench.scaling import KINDS, ScalingReport


def report_text(report: ScalingReport, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    lines = [report.facts.text, *(f"Left out: {line}" for line in report.left_out)]
    parts = ["\n".join(f"- {line}" if markdown else line for line in lines)]
    for kind in KINDS:
        rows = [(f"{r.value:,}", f"{r.ms:.3g}", f"{r.per_s:,.0f}", f"{r.mb:,.0f}") for r in report.rows if r.kind == kind.name]
        if rows:
            parts += [f"{kind.name.capitalize()}: {kind.what}.", table((kind.name, "ms", "per s", "MB"), rows, markdown, left=())]
    return "\n\n".join(parts)
