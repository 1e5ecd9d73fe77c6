"""What ``gibson-sim top`` shows, as text. Pure: no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from gibson_sim.types import NS_PER_S

LEVELS = ("OK", "WARN", "ERROR", "STALE")
"""By their numbers in diagnostic_msgs/DiagnosticStatus."""
_COLORS = ("32", "33", "31", "35")
STALE_AFTER_S = 3.5
"""A status that was not repeated for so long is stale: nodes report once a second."""
_GAP = "   "


@dataclass(frozen=True, slots=True)
class Status:
    """One status of /diagnostics."""

    name: str
    level: int
    """Index into ``LEVELS``."""
    message: str
    values: tuple[tuple[str, str], ...]
    """Key and value, as the node wrote them."""
    age_s: float
    """Wall time since it came."""


@dataclass(frozen=True, slots=True)
class TopicRate:
    """What came on one topic in the last period."""

    name: str
    kind: str
    messages: int
    size: int
    """Bytes of all of them."""
    subscribers: int
    """Others than us."""


@dataclass(frozen=True, slots=True)
class View:
    """All that is shown at once."""

    domain_id: int
    stamp_ns: int | None
    """Simulation time; None = no /clock yet."""
    wall_s: float
    """Length of the period that the rates are about."""
    sim_s: float
    """The same in simulation time."""
    nodes: int
    statuses: tuple[Status, ...] = ()
    topics: tuple[TopicRate, ...] | None = None
    """None = not asked for."""
    notes: tuple[str, ...] = field(default=())


def render(view: View, *, width: int = 100, color: bool = False) -> str:
    """Returns the text of a view, lines at most ``width`` wide where words allow, with ANSI colours if asked for."""
    lines = [_bold(_head(view), color)]
    for note in view.notes:
        lines.append(_colored(note, 1, color))
    for status in sorted(view.statuses, key=lambda s: s.name):
        lines += ["", *_status_lines(status, width, color)]
    if not view.statuses:
        lines += ["", "no node has reported on /diagnostics yet"]
    if view.topics is not None:
        lines += ["", *_topic_lines(view, color)]
    return "\n".join(lines)


def _head(view: View) -> str:
    if view.stamp_ns is None:
        return (
            f"ROS domain {view.domain_id}: /clock has a publisher, but nothing came on it: is the simulation loading or paused?"
        )
    factor = "-" if view.wall_s <= 0.0 else f"{view.sim_s / view.wall_s:.3f}"
    nodes = f"{view.nodes} node{'' if view.nodes == 1 else 's'}"
    return f"ROS domain {view.domain_id}: simulation time {view.stamp_ns / NS_PER_S:.2f} s, real-time factor {factor}, {nodes}"


def _status_lines(status: Status, width: int, color: bool) -> list[str]:
    level = status.level if status.age_s <= STALE_AFTER_S else LEVELS.index("STALE")
    message = status.message if status.age_s <= STALE_AFTER_S else f"no report for {status.age_s:.0f} s"
    head = (
        f"{_bold(status.name, color)}  {_colored(LEVELS[level] if level < len(LEVELS) else str(level), level, color)}  {message}"
    )
    return [head.rstrip(), *_columns([f"{key} {value}" for key, value in status.values], width)]


def _columns(cells: Sequence[str], width: int) -> list[str]:
    """Returns cells in as many equal columns as fit, filled by rows."""
    if not cells:
        return []
    cell = max(map(len, cells)) + len(_GAP)
    per_row = max(1, (width - 2) // cell)
    rows = [cells[i : i + per_row] for i in range(0, len(cells), per_row)]
    return ["  " + "".join(text.ljust(cell) for text in row).rstrip() for row in rows]


def _topic_lines(view: View, color: bool) -> list[str]:
    assert view.topics is not None
    head = ("topic", "per s", "per sim s", "kB/s", "subscribers", "type")
    rows = [
        (
            *(topic.name, _rate(topic.messages, view.wall_s), _rate(topic.messages, view.sim_s)),
            *(_rate(topic.size / 1000.0, view.wall_s), str(topic.subscribers), topic.kind),
        )
        for topic in sorted(view.topics, key=lambda t: t.name)
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
