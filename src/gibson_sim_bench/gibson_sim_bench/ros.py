"""Cases, rows, statistics and report of ``gibson-sim bench ros``. Pure: the nodes that ``gibson_sim_bench.cli.ros`` starts use ROS.

It measures messages between processes, and the cost of idle nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gibson_sim_bench.reports.render import table

PARTS = ("state", "transport", "clock", "pipeline")
"""Parts that can be measured separately."""


@dataclass(frozen=True, slots=True)
class Size:
    """Size of an image, pixels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True, slots=True)
class RoundTripMethod:
    """Executor and message form of a node."""

    executor: str
    """``standard``, ``events`` or ``wait set``."""
    form: str
    """``message``, or ``bytes``, which the node serializes itself."""


ROUND_TRIP_METHODS = (
    RoundTripMethod("standard", "message"),
    RoundTripMethod("events", "message"),
    RoundTripMethod("wait set", "message"),
    RoundTripMethod("standard", "bytes"),
    RoundTripMethod("events", "bytes"),
    RoundTripMethod("wait set", "bytes"),
)


@dataclass(frozen=True, slots=True)
class IdleNode:
    """A node that only spins."""

    executor: str
    """``standard`` or ``events``; ``polled``: messages do not wake the node, it takes the newest /clock on demand."""
    use_sim_time: bool
    """Whether the node subscribes to /clock."""
    parameter_services: bool = True
    """Whether the node has parameter services: six services in the wait set of the standard executor."""


IDLE_NODES = (
    IdleNode("standard", False),
    IdleNode("standard", True),
    IdleNode("standard", True, parameter_services=False),
    IdleNode("events", False),
    IdleNode("events", True),
    IdleNode("polled", True),
)


@dataclass(frozen=True, slots=True)
class RosPlan:
    """Parts, scene and number of measurements."""

    parts: tuple[str, ...] = PARTS
    bodies: int = 100
    """Bodies of the scene state in a round trip."""
    round_trips: int = 3000
    """Round trips of each method that count, after a tenth as many of warm-up."""
    methods: tuple[RoundTripMethod, ...] = ROUND_TRIP_METHODS
    transport_size: Size = Size(640, 480)
    transport_hz: float = 60.0
    transport_images: int = 600
    clock_hz: float = 100.0
    clock_s: float = 20.0
    idle_nodes: tuple[IdleNode, ...] = IDLE_NODES
    pipeline_sizes: tuple[Size, ...] = (Size(256, 256), Size(640, 480), Size(1280, 720))
    pipeline_hz: tuple[float, ...] = (30.0, 60.0)
    pipeline_s: float = 10.0
    """Wall time for each size and rate, seconds."""
    scene: str = "flat"

    @classmethod
    def quick(cls, parts: tuple[str, ...] = PARTS) -> RosPlan:
        """Returns a plan of about four minutes."""
        return cls(
            parts=parts,
            round_trips=500,
            transport_images=120,
            clock_s=4.0,
            pipeline_sizes=(Size(256, 256), Size(640, 480)),
            pipeline_hz=(30.0,),
            pipeline_s=3.0,
        )


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, 95th and 99th percentile; NaN = nothing was measured."""

    median: float
    p95: float
    p99: float


def spread(values: Sequence[float]) -> Spread:
    """Returns median, 95th and 99th percentile."""
    if not len(values):
        return Spread(math.nan, math.nan, math.nan)
    return Spread(*(round(float(np.percentile(values, p)), 4) for p in (50, 95, 99)))


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """Round trips of a state to another process and back."""

    executor: str
    form: str
    bodies: int
    count: int
    us: Spread
    """Microseconds."""

    @property
    def per_s(self) -> float:
        """Round trips per second, from the median."""
        return 1e6 / self.us.median


@dataclass(frozen=True, slots=True)
class Transport:
    """Transport of images to another process."""

    executor: str
    size: Size
    hz: float
    sent: int
    received: int
    ms: Spread
    """Latency from before serialization to the callback, milliseconds."""

    @property
    def lost(self) -> int:
        """Images that did not arrive."""
        return self.sent - self.received


@dataclass(frozen=True, slots=True)
class ClockCost:
    """Processor time of an idle node."""

    executor: str
    use_sim_time: bool
    parameter_services: bool
    seconds: float
    cpu_percent: float
    """Processor time of all threads of the process, % of one core."""
    clock_s: float
    """Advance of the node's own clock, seconds; 0 without use_sim_time."""


@dataclass(frozen=True, slots=True)
class Pipeline:
    """Images of the running simulation at a subscriber."""

    size: Size
    hz: float
    """Requested rate in simulation time, Hz."""
    due: int
    """Images due during the measurement."""
    received: int
    """Pairs of RGB and depth that arrived."""
    seconds: float
    """Wall time of the measurement, seconds."""
    real_time_factor: float
    to_published_ms: Spread
    """Latency from the publication of the state to that of its RGB image, milliseconds."""
    to_received_ms: Spread
    """Latency from the publication of the state to the callback with its RGB image, milliseconds."""

    @property
    def lost(self) -> int:
        """Images due but not received: not rendered in time, or lost in transport."""
        return self.due - self.received

    @property
    def per_s(self) -> float:
        """Pairs received per second of wall time."""
        return self.received / self.seconds if self.seconds else 0.0


def pipeline_of(size: Size, hz: float, received: dict[str, Any]) -> Pipeline:
    """Returns a row from the result of ``pipeline_sink``.

    Args:
        size: size of the images.
        hz: requested rate in simulation time.
        received: ``seconds``; ``states``, rows of (stamp, published, cameras due); ``images``, by topic, rows of (stamp, published,
            received). All are nanoseconds, stamps of simulation time, the others of the system clock. The first topic is RGB.
    """
    states = received["states"]
    published = {stamp: published_ns for stamp, published_ns, _ in states}
    due = [stamp for stamp, _, cameras in states if cameras]
    topics = [
        {stamp: (published_ns, received_ns) for stamp, published_ns, received_ns in rows} for rows in received["images"].values()
    ]
    complete = [stamp for stamp in due if all(stamp in topic for topic in topics)]
    rgb = topics[0] if topics else {}
    factor = 0.0
    if len(states) > 1 and states[-1][1] > states[0][1]:
        factor = (states[-1][0] - states[0][0]) / (states[-1][1] - states[0][1])
    return Pipeline(
        size=size,
        hz=hz,
        due=len(due),
        received=len(complete),
        seconds=round(received["seconds"], 3),
        real_time_factor=round(factor, 3),
        to_published_ms=spread([(rgb[stamp][0] - published[stamp]) / 1e6 for stamp in complete]),
        to_received_ms=spread([(rgb[stamp][1] - published[stamp]) / 1e6 for stamp in complete]),
    )


@dataclass(frozen=True, slots=True)
class RosReport:
    """The measurements, with machine and date."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    """Load average over the last minute before the measurement."""
    software: dict[str, str]
    round_trips: tuple[RoundTrip, ...] = ()
    transports: tuple[Transport, ...] = ()
    clocks: tuple[ClockCost, ...] = ()
    pipelines: tuple[Pipeline, ...] = ()
    left_out: tuple[str, ...] = ()
    """What could not be measured, and why."""

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types, with the targets; NaN becomes null."""
        found: dict[str, Any] = without_nan(asdict(self))
        found["targets"] = [asdict(target) for target in targets(self)]
        return found


@dataclass(frozen=True, slots=True)
class PerformanceTarget:
    """A performance target for a machine with two cores, and the best measured value."""

    what: str
    """The measured quantity."""
    wanted: str
    """The threshold, such as ``> 3,000/s``."""
    measured: str
    how: str
    """Configuration of the measured value; empty = the only one."""
    met: bool


STATE_PER_S, TRANSPORT_MS, CLOCK_PERCENT = 3000.0, 3.0, 2.0
"""Targets: round trips of a state per second, transport of an image, processor time of an idle node with /clock."""


def targets(report: RosReport) -> list[PerformanceTarget]:
    """Returns the targets that the report covers."""
    found = []
    if report.round_trips:
        trip = min(report.round_trips, key=lambda r: r.us.median)
        how = f"{trip.executor}, {trip.form}"
        found.append(
            PerformanceTarget(
                "round trips of a state", f"> {STATE_PER_S:,.0f}/s", f"{trip.per_s:,.0f}/s", how, trip.per_s > STATE_PER_S
            )
        )
    if report.transports:
        sent = min(report.transports, key=lambda t: (t.lost, t.ms.median))
        what = f"transport of {sent.size} RGB at {sent.hz:g} Hz"
        met = sent.ms.median < TRANSPORT_MS and sent.lost == 0
        measured = f"{sent.ms.median:.2f} ms, {sent.lost} lost"
        found.append(PerformanceTarget(what, f"< {TRANSPORT_MS:g} ms, none lost", measured, sent.executor, met))
    # A polling node is cheaper, but needs its own code instead of callbacks.
    subscribed = [c for c in report.clocks if c.use_sim_time and c.executor != "polled"]
    if subscribed:
        cost = min(subscribed, key=lambda c: c.cpu_percent)
        met = cost.cpu_percent < CLOCK_PERCENT
        found.append(
            PerformanceTarget(
                "a node that subscribes to /clock", f"< {CLOCK_PERCENT:g} %", f"{cost.cpu_percent:.2f} %", cost.executor, met
            )
        )
    return found


def without_nan(value: Any) -> Any:
    """Returns a value for JSON: NaN becomes None, a tuple becomes a list."""
    if isinstance(value, dict):
        return {key: without_nan(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


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
