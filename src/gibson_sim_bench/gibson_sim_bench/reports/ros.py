"""Report on ROS: messages between processes, and the cost of idle nodes. Plain text for the terminal, or Markdown."""

from __future__ import annotations

from gibson_sim_bench.reports.render import table
from gibson_sim_bench.ros import RosReport, Spread, targets


def report_text(report: RosReport, *, markdown: bool = False) -> str:
    """Returns the whole report, plain for the terminal or as Markdown."""
    parts = ["\n".join(_header(report, markdown))]
    for title, head, rows, left in (_trips(report), _transports(report), _clocks(report), _pipelines(report)):
        if rows:
            parts += [title, table(head, rows, markdown, left=left)]
    reached = [(t.what, t.wanted, t.measured, t.how, "met" if t.met else "MISSED") for t in targets(report)]
    if reached:
        parts += [
            "Targets for two cores:",
            table(("measurement", "target", "measured", "configuration", ""), reached, markdown, left=(0, 1, 3, 4)),
        ]
    return "\n\n".join(parts)


_Table = tuple[str, tuple[str, ...], list[tuple[str, ...]], tuple[int, ...]]
"""Title, column headings, rows, and indices of left-aligned columns."""


def _trips(report: RosReport) -> _Table:
    bodies = report.round_trips[0].bodies if report.round_trips else 0
    rows = [(r.executor, r.form, f"{r.per_s:,.0f}", *_numbers(r.us, 0)) for r in report.round_trips]
    title = f"State of {bodies} bodies (gibson_msgs/SceneState) to another process and back:"
    return title, ("executor", "form", "round trips/s", "median us", "p95", "p99"), [*rows], (0, 1)


def _transports(report: RosReport) -> _Table:
    rows = [
        (t.executor, f"{t.size} RGB", f"{t.hz:g} Hz", str(t.sent), str(t.lost), *_numbers(t.ms, 2)) for t in report.transports
    ]
    title = "Images to another process, from before serialization to the callback:"
    return title, ("executor", "image", "rate", "sent", "lost", "median ms", "p95", "p99"), [*rows], (0, 1)


def _clocks(report: RosReport) -> _Table:
    rows = [
        (c.executor, _yes(c.use_sim_time), _yes(c.parameter_services), f"{c.cpu_percent:.2f}", f"{c.clock_s:.1f} s")
        for c in report.clocks
    ]
    head = ("executor", "use_sim_time", "parameter services", "% of a core", "node clock advanced")
    return "An idle node while /clock is published:", head, [*rows], (0, 1, 2)


def _pipelines(report: RosReport) -> _Table:
    rows = [
        (
            *(str(p.size), f"{p.hz:g} Hz", str(p.due), str(p.received), str(p.lost), f"{p.per_s:.1f}"),
            *(f"{p.real_time_factor:.2f}", f"{p.to_published_ms.median:.1f}", *_numbers(p.to_received_ms, 1)),
        )
        for p in report.pipelines
    ]
    title = "The running simulation, RGB + depth; latency from the publication of a state to that of its image, and to the subscriber:"
    head = ("image", "rate", "due", "received", "lost", "per s", "real time", "published ms", "received ms", "p95", "p99")
    return title, head, [*rows], (0,)


def _header(report: RosReport, markdown: bool) -> list[str]:
    lines = [
        f"{report.machine}; {report.cores} cores usable, load {report.load:g}; Gibson Sim {report.version}; {report.date[:10]}.",
        ", ".join(f"{name} {version}" for name, version in report.software.items()),
    ]
    lines += [f"Left out: {line}" for line in report.left_out]
    return [f"- {line}" for line in lines if line] if markdown else [line for line in lines if line]


def _numbers(values: Spread, digits: int) -> tuple[str, str, str]:
    return f"{values.median:,.{digits}f}", f"{values.p95:,.{digits}f}", f"{values.p99:,.{digits}f}"


def _yes(value: bool) -> str:
    return "yes" if value else "no"
