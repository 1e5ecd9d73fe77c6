"""Formats the output of ``gibson-sim top``. Pure: no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from gibson_sim.types import NS_PER_S

LEVELS = ("OK", "WARN", "ERROR", "STALE")
"""Names of the levels of diagnostic_msgs/DiagnosticStatus, by number."""
_COLORS = ("32", "33", "31", "35")
"""ANSI colours of the levels."""
STALE_AFTER_S = 3.5
"""Age after which a status is stale, s of wall time: nodes report once a second."""
_GAP = "   "


@dataclass(frozen=True, slots=True)
class Status:
    """One status of /diagnostics."""

    name: str
    level: int
    """Index into ``LEVELS``."""
    message: str
    values: tuple[tuple[str, str], ...]
    """Pairs of key and value, as published."""
    age_s: float
    """Time since it arrived, s of wall time."""


@dataclass(frozen=True, slots=True)
class TopicRate:
    """Number and size of the messages on one topic in the last period."""

    name: str
    kind: str
    messages: int
    size: int
    """Size of all messages, bytes."""
    subscribers: int
    """Number of subscribers, without the top node itself."""


@dataclass(frozen=True, slots=True)
class Overview:
    """The contents of one screen."""

    domain_id: int
    stamp_ns: int | None
    """Simulation time, ns; None = no /clock yet."""
    wall_s: float
    """Measuring period of the rates, s of wall time."""
    sim_s: float
    """Measuring period of the rates, s of simulation time."""
    nodes: int
    statuses: tuple[Status, ...] = ()
    topics: tuple[TopicRate, ...] | None = None
    """Rates of all topics; None = not requested."""
    notes: tuple[str, ...] = field(default=())


def render(overview: Overview, *, width: int = 100, color: bool = False) -> str:
    """Returns the text of an overview, with columns that fit ``width`` if possible, and with ANSI colours if requested."""
    lines = [_bold(_head(overview), color)]
    for note in overview.notes:
        lines.append(_colored(note, 1, color))
    for status in sorted(overview.statuses, key=lambda s: s.name):
        lines += ["", *_status_lines(status, width, color)]
    if not overview.statuses:
        lines += ["", "no node has reported on /diagnostics yet"]
    if overview.topics is not None:
        lines += ["", *_topic_lines(overview, color)]
    return "\n".join(lines)


def _head(overview: Overview) -> str:
    if overview.stamp_ns is None:
        return f"ROS domain {overview.domain_id}: /clock has a publisher but no messages: is the simulation loading or paused?"
    factor = "-" if overview.wall_s <= 0.0 else f"{overview.sim_s / overview.wall_s:.3f}"
    nodes = f"{overview.nodes} node{'' if overview.nodes == 1 else 's'}"
    return f"ROS domain {overview.domain_id}: simulation time {overview.stamp_ns / NS_PER_S:.2f} s, real-time factor {factor}, {nodes}"


def _status_lines(status: Status, width: int, color: bool) -> list[str]:
    level = status.level if status.age_s <= STALE_AFTER_S else LEVELS.index("STALE")
    message = status.message if status.age_s <= STALE_AFTER_S else f"no report for {status.age_s:.0f} s"
    head = (
        f"{_bold(status.name, color)}  {_colored(LEVELS[level] if level < len(LEVELS) else str(level), level, color)}  {message}"
    )
    return [head.rstrip(), *_columns([f"{key} {value}" for key, value in status.values], width)]


def _columns(cells: Sequence[str], width: int) -> list[str]:
    """Returns the lines of a table of cells, in as many equal columns as fit, filled row by row."""
    if not cells:
        return []
    cell = max(map(len, cells)) + len(_GAP)
    per_row = max(1, (width - 2) // cell)
    rows = [cells[i : i + per_row] for i in range(0, len(cells), per_row)]
    return ["  " + "".join(text.ljust(cell) for text in row).rstrip() for row in rows]


def _topic_lines(overview: Overview, color: bool) -> list[str]:
    assert overview.topics is not None
    head = ("topic", "per s", "per sim s", "kB/s", "subscribers", "type")
    rows = [
        (
            *(topic.name, _rate(topic.messages, overview.wall_s), _rate(topic.messages, overview.sim_s)),
            *(_rate(topic.size / 1000.0, overview.wall_s), str(topic.subscribers), topic.kind),
        )
        for topic in sorted(overview.topics, key=lambda t: t.name)
    ]
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = [
        "  ".join(
            text.ljust(w) if k in (0, 5) else text.rjust(w) for k, (text, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (head, *rows)
    ]
    return [_bold(lines[0], color), *lines[1:]]


def _rate(count: float, seconds: float) -> str:
    return "-" if seconds <= 0.0 else f"{count / seconds:,.1f}"


def _bold(text: str, color: bool) -> str:
    return f"\x1b[1m{text}\x1b[0m" if color else text


def _colored(text: str, level: int, color: bool) -> str:
    return f"\x1b[{_COLORS[min(level, len(_COLORS) - 1)]}m{text}\x1b[0m" if color else text
