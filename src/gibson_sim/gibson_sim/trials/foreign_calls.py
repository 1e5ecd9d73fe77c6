"""Finds foreign calls: what moved, reset, paused, re-rated or otherwise changed the world during a run, and was not the trial itself.

The simulation journals every such request, on ``inputs`` or, if it changes only how time passes, on ``time_control``. The requests of the trial
follow from the planned run, so that all others are foreign, whoever sent them.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from gibson_sim.config import PhysicsConfig
from gibson_sim.quoting import quoted
from gibson_sim.standard.requests import CONTROLS, EPOCH_REQUESTS
from gibson_sim.trials.execution.walking import person_pose
from gibson_sim.trials.records import Outcome, Person, PlanarPose, RunSpec
from gibson_sim.trials.scenario.spec import Scenario
from gibson_sim.types import NS_PER_S, WORLD_FRAME

TIME_CONTROL = "time_control"
"""Last part of the name of the topic with the requests that change how time passes."""
LATE_S = 10.0
"""Simulation time by which a person may be moved late in a run in real time, on a busy machine, s."""
_SAME = 1e-6
"""Greatest difference of two equal coordinates, m, and components of unit quaternions."""
_STATES = ("stop", "play", "pause", "quit")
_PLAY = 1
_MAX_CALLERS = 3
"""Largest number of nodes that are named as callers."""
_MAX_TEXT = 1 << 16
"""Largest length of a text of a request that is read, bytes."""


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """A request or command that the simulation has executed."""

    stamp_ns: int
    """Simulation time, ns."""
    step: int
    """Number of steps since the last reset."""
    name: str
    """Resolved name of the service, action or topic."""
    data: bytes
    """CDR bytes of the request or the message."""

    @property
    def kind(self) -> str:
        """Last part of the name, one of ``CONTROLS`` if the entry changes the world or how its time passes."""
        return self.name.rpartition("/")[2]

    @property
    def description(self) -> str:
        """Name of the service, and what was requested, such as ``/set_entity_state of 'box'``."""
        try:
            about = _about(self.kind, _Cdr(self.data))
        except (struct.error, ValueError):
            about = ""
        return f"{quoted(self.name).strip(chr(39))}{about}"


@dataclass(frozen=True, slots=True)
class ForeignCalls:
    """Requests that neither the trial made nor the scenario allows, at least one."""

    time: float
    """Time of the first one, s since the goal; negative = before it."""
    what: str
    """The requests as a clause with a subject, in the past tense: who called what, and how often."""


def foreign_calls(scenario: Scenario, run: RunSpec, outcome: Outcome, entries: Collection[JournalEntry]) -> ForeignCalls | None:
    """Returns the requests in the journal of a run that the trial did not make and the scenario does not allow; None = there are none."""
    allowed = scenario.stack.allowed_calls
    reported = (JournalEntry(stamp, step, name, bytes.fromhex(data)) for stamp, step, name, data in outcome.time_calls)
    in_order = sorted([*entries, *(entry for entry in reported if entry not in entries)], key=lambda entry: entry.stamp_ns)
    # After a reset that the scenario allows, time begins anew, and people walk the same way again.
    own = _OwnRequests(run, in_order=not any(entry.kind in EPOCH_REQUESTS and entry.kind in allowed for entry in in_order))
    found = [entry for entry in in_order if entry.kind in CONTROLS and not own.has(entry) and entry.kind not in allowed]
    if not found:
        return None
    first = found[0]
    callers = outcome.callers.get(first.kind, ())
    who = " or ".join(f"node {quoted(name)}" for name in callers[:_MAX_CALLERS]) or "a node other than the trial's"
    counts = Counter(entry.name for entry in found[1:])
    more = ", ".join(f"{quoted(name).strip(chr(39))} {count} time{'s' if count > 1 else ''}" for name, count in counts.items())
    kinds = ", ".join(dict.fromkeys(entry.kind for entry in found))
    what = f"foreign call: {who} called {first.description}{f', and later {more}' if more else ''}"
    text = f"{what}; the scenario does not allow it (key stack.allowed_calls: [{kinds}])"
    return ForeignCalls((first.stamp_ns - max(outcome.goal_ns, 0)) / NS_PER_S, text)


class _OwnRequests:
    """The requests that the trial makes in a run."""

    def __init__(self, run: RunSpec, *, in_order: bool) -> None:
        """``in_order``: whether people never move back on their ways through time."""
        self._people = {person.name: person for person in run.people}
        self._spawned = {thing.name for thing in run.things} | set(self._people)
        """Entities that the trial has not spawned yet."""
        self._doors = set(run.closed_doors)
        """Bodies whose doors the trial has not closed yet."""
        self._is_playing = False
        self._in_order = in_order
        self._placed: dict[str, int] = {}
        """Person -> tick of the plan at which the newest of its requests places it."""
        self._tick_s = 1.0 / float(run.physics.get("publish_hz", PhysicsConfig().time.publish_hz))

    def has(self, entry: JournalEntry) -> bool:
        """Returns whether an entry is a request of the trial; each of those that it makes once counts once."""
        try:
            return self._has(entry, _Cdr(entry.data))
        except (struct.error, ValueError):  # not what the trial sends
            return False

    def _has(self, entry: JournalEntry, request: _Cdr) -> bool:
        if entry.kind == "set_entity_state":
            person = self._people.get(request.text())
            return person is not None and self._is_walking(person, entry.stamp_ns / NS_PER_S, request)
        if entry.kind == "spawn_entity" and not entry.step:
            name = request.text()
            is_own = name in self._spawned
            self._spawned.discard(name)
            return is_own
        if entry.kind == "set_simulation_state" and not entry.step:
            is_own = request.number("B") == _PLAY and not self._is_playing
            self._is_playing |= is_own
            return is_own
        if entry.kind == "object_joint_command":
            request.frame()
            bodies = {name.rpartition("/")[0] for name in request.texts()}
            is_own = bodies <= self._doors and bool(self._doors)
            self._doors -= self._doors if is_own else set()
            return is_own
        return False

    def _is_walking(self, person: Person, stamp_s: float, request: _Cdr) -> bool:
        """Returns whether a request places a person as planned at a tick up to a stamp, s, at most ``LATE_S`` before it.

        Each tick counts once, and only after those before it: the trial may be late, but never sends a person back or anywhere twice. It
        sends no velocities.
        """
        frame, pose, motion = request.frame(), request.doubles(7), request.doubles(12)
        if frame != WORLD_FRAME or any(motion):
            return False
        last = math.floor(stamp_s / self._tick_s + 0.5)
        first = max(0, last - math.ceil(LATE_S / self._tick_s) + 1)
        if self._in_order:
            first = max(first, self._placed.get(person.name, -1) + 1)
        # The earliest tick: on a way to and fro, a person is at a place several times, and later requests need the later ticks.
        ticks = range(first, last + 1)
        tick = next((tick for tick in ticks if _is_at(pose, person_pose(person, tick * self._tick_s))), None)
        if tick is not None:
            self._placed[person.name] = tick
        return tick is not None


def _is_at(pose: tuple[float, ...], expected: PlanarPose) -> bool:
    """Returns whether a pose (position x, y, z, m, and quaternion x, y, z, w) on the floor is the expected one, up to rounding."""
    x, y, yaw = expected
    values = (x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))
    return all(abs(a - b) <= _SAME for a, b in zip(pose, values, strict=True))


def _about(kind: str, request: _Cdr) -> str:
    if kind in ("set_entity_state", "spawn_entity", "delete_entity", "load_world"):
        text = request.text()
        return f" of {quoted(text)}" if text else ""
    if kind == "spawn_entities":
        return f" of {request.number('I')} entities"
    if kind == "set_simulation_state":
        state = request.number("B")
        return f" ({_STATES[state]})" if state < len(_STATES) else ""
    if kind in ("step_simulation", "simulate_steps"):
        return f" ({request.number('Q')} steps)"
    if kind == "set_parameters":
        request.number("I")
        name = request.text()
        request.number("B")  # type
        request.number("B")  # bool
        request.number("q")
        return f" ({quoted(name).strip(chr(39))} {request.number('d'):g})"
    if kind == "object_joint_command":
        request.frame()
        names = request.texts()
        return f" of {quoted(names[0])}" + (f" and {len(names) - 1} more" if len(names) > 1 else "") if names else ""
    return ""


class _Cdr:
    """Reads values from CDR bytes one after the other; raises ``struct.error`` at their end, ``ValueError`` for a text that is too long."""

    def __init__(self, data: bytes) -> None:
        self._data, self._order = data, "<" if data[1:2] == b"\x01" else ">"
        self._at = 4

    def number(self, code: str) -> Any:
        """Returns the next number, of a type of ``struct``."""
        return self._unpack(code, 1)[0]

    def doubles(self, count: int) -> tuple[float, ...]:
        """Returns the next float64 values."""
        return self._unpack("d", count)

    def text(self) -> str:
        """Returns the next string."""
        (length,) = self._unpack("I", 1)
        if length > min(_MAX_TEXT, len(self._data) - self._at):
            raise ValueError("the text is too long")
        text = self._data[self._at : self._at + length].rstrip(b"\0").decode(errors="replace")
        self._at += length
        return text

    def texts(self) -> list[str]:
        """Returns the next sequence of strings."""
        (count,) = self._unpack("I", 1)
        if count > len(self._data):
            raise ValueError("there are too many texts")
        return [self.text() for _ in range(count)]

    def frame(self) -> str:
        """Returns the frame of the std_msgs/Header that is next."""
        self._unpack("I", 2)
        return self.text()

    def _unpack(self, code: str, count: int) -> tuple[Any, ...]:
        size = struct.calcsize(code)
        self._at += -(self._at - 4) % size
        values = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._at)
        self._at += count * size
        return values
