"""What ``gibson-sim bench ros`` measures, and the statistics of it. Pure: ROS is in the processes that ``gibson_sim_bench.cli.ros`` starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

PARTS = ("state", "transport", "clock", "pipeline")
"""What can be measured alone."""


@dataclass(frozen=True, slots=True)
class Size:
    """Size of an image, pixels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"


@dataclass(frozen=True, slots=True)
class Way:
    """One way to wait and to publish."""

    executor: str
    """standard, events or wait set."""
    form: str
    """message or bytes (serialised by the node itself)."""


WAYS = (
    Way("standard", "message"),
    Way("events", "message"),
    Way("wait set", "message"),
    Way("standard", "bytes"),
    Way("events", "bytes"),
    Way("wait set", "bytes"),
)


@dataclass(frozen=True, slots=True)
class Listener:
    """A node that does nothing of its own."""

    executor: str
    """standard or events; ``polled``: it is not woken, and takes the newest /clock when it wants to know the time."""
    use_sim_time: bool
    """For ``polled``: whether it subscribes to /clock."""
    parameter_services: bool = True
    """Whether others can see and set its parameters: six services that the standard executor waits for as well."""


LISTENERS = (
    Listener("standard", False),
    Listener("standard", True),
    Listener("standard", True, parameter_services=False),
    Listener("events", False),
    Listener("events", True),
    Listener("polled", True),
)


@dataclass(frozen=True, slots=True)
class Plan:
    """How much to measure."""

    parts: tuple[str, ...] = PARTS
    bodies: int = 100
    """Of the state that goes to and fro."""
    round_trips: int = 3000
    """Counted for each way; a tenth as many go before."""
    ways: tuple[Way, ...] = WAYS
    transport_size: Size = Size(640, 480)
    transport_hz: float = 60.0
    transport_images: int = 600
    clock_hz: float = 100.0
    clock_s: float = 20.0
    listeners: tuple[Listener, ...] = LISTENERS
    pipeline_sizes: tuple[Size, ...] = (Size(256, 256), Size(640, 480), Size(1280, 720))
    pipeline_hz: tuple[float, ...] = (30.0, 60.0)
    pipeline_s: float = 10.0
    """Wall time for each size and rate."""
    scene: str = "flat"

    @classmethod
    def quick(cls, parts: tuple[str, ...] = PARTS) -> Plan:
        """Returns a plan that takes about four minutes."""
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
    """Median, and what one in twenty and one in a hundred exceed. NaN = nothing was measured."""

    median: float
    p95: float
    p99: float


def spread(values: Sequence[float]) -> Spread:
    """Returns median, p95 and p99."""
    if not len(values):
        return Spread(math.nan, math.nan, math.nan)
    return Spread(*(round(float(np.percentile(values, p)), 4) for p in (50, 95, 99)))


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """A state from one process to another and back."""

    executor: str
    form: str
    bodies: int
    count: int
    us: Spread

    @property
    def per_s(self) -> float:
        """Round trips in a second, from the median."""
        return 1e6 / self.us.median


@dataclass(frozen=True, slots=True)
class Transport:
    """Images from one process to another, and nothing else."""

    executor: str
    size: Size
    hz: float
    sent: int
    received: int
    ms: Spread
    """From before the message was made to the callback that got it."""

    @property
    def lost(self) -> int:
        """How many did not arrive."""
        return self.sent - self.received


@dataclass(frozen=True, slots=True)
class ClockCost:
    """What an idle node takes of a processor."""

    executor: str
    use_sim_time: bool
    parameter_services: bool
    seconds: float
    cpu_percent: float
    """Of one core, all threads of the process."""
    clock_s: float
    """How far the node's own clock got; 0 without use_sim_time."""


@dataclass(frozen=True, slots=True)
class Pipeline:
    """The running simulation, seen by a subscriber to the images of its camera."""

    size: Size
    hz: float
    """Asked for, in simulation time."""
    due: int
    """Images due while it listened."""
    received: int
    """Pairs of RGB and depth of which both arrived."""
    seconds: float
    """Wall time listened."""
    real_time_factor: float
    to_published_ms: Spread
    """From the publication of the state to that of its RGB image."""
    to_received_ms: Spread
    """From the publication of the state to the callback that got its RGB image."""

    @property
    def lost(self) -> int:
        """Due, but not received: not drawn in time, or lost on the way."""
        return self.due - self.received

    @property
    def per_s(self) -> float:
        """Pairs received in a second of wall time."""
        return self.received / self.seconds if self.seconds else 0.0


def pipeline_of(size: Size, hz: float, heard: dict[str, Any]) -> Pipeline:
    """Returns a row from what the listening process heard.

    Args:
        size: Of the images.
        hz: Asked for.
        heard: ``seconds``; ``states``, rows of (stamp, published, cameras due); ``images``, by topic, rows of (stamp, published,
            received). Nanoseconds: stamps of simulation time, others of the system's clock. The first topic is RGB.
    """
    states = heard["states"]
    published = {stamp: at for stamp, at, _ in states}
    due = [stamp for stamp, _, cameras in states if cameras]
    topics = [{stamp: (out, got) for stamp, out, got in rows} for rows in heard["images"].values()]
    whole = [stamp for stamp in due if all(stamp in topic for topic in topics)]
    first = topics[0] if topics else {}
    factor = 0.0
    if len(states) > 1 and states[-1][1] > states[0][1]:
        factor = (states[-1][0] - states[0][0]) / (states[-1][1] - states[0][1])
    return Pipeline(
        size=size,
        hz=hz,
        due=len(due),
        received=len(whole),
        seconds=round(heard["seconds"], 3),
        real_time_factor=round(factor, 3),
        to_published_ms=spread([(first[stamp][0] - published[stamp]) / 1e6 for stamp in whole]),
        to_received_ms=spread([(first[stamp][1] - published[stamp]) / 1e6 for stamp in whole]),
    )


@dataclass(frozen=True, slots=True)
class Report:
    """What was measured, where and when."""

    date: str
    version: str
    machine: str
    cores: int
    load: float
    """Average over the minute before."""
    software: dict[str, str]
    round_trips: tuple[RoundTrip, ...] = ()
    transports: tuple[Transport, ...] = ()
    clocks: tuple[ClockCost, ...] = ()
    pipelines: tuple[Pipeline, ...] = ()
    left_out: tuple[str, ...] = ()
    """What could not be measured, and why."""

    def as_json(self) -> dict[str, Any]:
        """Returns it as values for JSON, with the targets; NaN becomes null."""
        found: dict[str, Any] = without_nan(asdict(self))
        found["targets"] = [asdict(target) for target in targets(self)]
        return found


@dataclass(frozen=True, slots=True)
class Target:
    """What ought to be reached on a machine of two cores, and the best that was."""

    what: str
    wanted: str
    measured: str
    how: str
    """Which row it is; empty = the only one."""
    met: bool


STATE_PER_S, TRANSPORT_MS, CLOCK_PERCENT = 3000.0, 3.0, 2.0


def targets(report: Report) -> list[Target]:
    """Returns the targets that the report says something about."""
    found = []
    if report.round_trips:
        trip = min(report.round_trips, key=lambda r: r.us.median)
        how = f"{trip.executor}, {trip.form}"
        found.append(
            Target("round trips of a state", f"> {STATE_PER_S:,.0f}/s", f"{trip.per_s:,.0f}/s", how, trip.per_s > STATE_PER_S)
        )
    if report.transports:
        sent = min(report.transports, key=lambda t: (t.lost, t.ms.median))
        what = f"transport of {sent.size} RGB at {sent.hz:g} Hz"
        met = sent.ms.median < TRANSPORT_MS and sent.lost == 0
        measured = f"{sent.ms.median:.2f} ms, {sent.lost} lost"
        found.append(Target(what, f"< {TRANSPORT_MS:g} ms, none lost", measured, sent.executor, met))
    # Who polls is not woken, and needs other code.
    listening = [c for c in report.clocks if c.use_sim_time and c.executor != "polled"]
    if listening:
        cost = min(listening, key=lambda c: c.cpu_percent)
        met = cost.cpu_percent < CLOCK_PERCENT
        found.append(
            Target("a node that listens to /clock", f"< {CLOCK_PERCENT:g} %", f"{cost.cpu_percent:.2f} %", cost.executor, met)
        )
    return found


def without_nan(value: Any) -> Any:
    """Returns values for JSON: NaN becomes null, a tuple a list."""
    if isinstance(value, dict):
        return {key: without_nan(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value
