"""Report on long runs: plain text for the terminal, or Markdown."""

from __future__ import annotations

from collections.abc import Iterable

from gibson_sim_bench.memory import drift, growth
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.soak import Samples, SoakReport


def report_text(report: SoakReport, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    lines = [
        report.facts.text,
        f"{report.steps:,} environment steps in {report.episodes:,} episodes; {report.seconds:,.0f} s free-running, "
        f"{report.images:,} sets of images received.",
        "Growth and drift: the last third relative to the first, after a quarter of warm-up.",
        "Above the limit: " + "; ".join(report.problems) + "."
        if report.problems
        else "No value grew or drifted above its limit.",
    ]
    head = ("quantity", "first sample", "last sample", "growth", "drift")
    rows = [*_rows(report.environment), *_rows(report.running)]
    return "\n".join(f"- {line}" if markdown else line for line in lines) + "\n\n" + table(head, rows, markdown)


def _rows(samples: Samples) -> Iterable[tuple[str, ...]]:
    for name, values in samples.values.items():
        rate = name.endswith("/s")
        grown = "" if rate else f"{growth(values):+.1f}"
        drifted = f"{100 * (drift(values) - 1.0):+.1f} %" if rate else ""
        yield name, f"{values[0]:,.1f}", f"{values[-1]:,.1f}", grown, drifted
