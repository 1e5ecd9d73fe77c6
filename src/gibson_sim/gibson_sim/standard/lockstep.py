"""Lockstep: a tick begins only when every participant has done the last one. Pure.

The node's loop::

    if lockstep.is_open: make the steps of the next tick, publish it, then lockstep.begin_tick(stamp_ns, topics)
    at a TickDone:       lockstep.join / tick_done / leave
    at a command:        lockstep.receive_command(topic)

A participant either announces itself (``join``, then ``tick_done`` for every tick), or is declared by a rule on its output: with
``follow=cmd_vel after odom``, the first command on ``cmd_vel`` after a tick at which ``odom`` was published is the sign that the tick is done.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S

CAMERAS = "cameras"
"""Stands for a topic in ``after``: ticks at which any camera is due, which renderers draw."""
_RULE = re.compile(r"\s*([\w./-]+)\s*(?:=\s*([\w./-]+)\s+(after\s+([\w./-]+)|every\s+([\d.]+)\s*s?))?\s*")
_ALLOWED = "`render`, `follow=cmd_vel after odom` or `nav=cmd_vel every 0.05`, separated by `;`"


@dataclass(frozen=True, slots=True)
class ParticipantRule:
    """A participant that must be there before time starts, as the setting ``participants`` declares it."""

    name: str
    answer: str = ""
    """Topic of the commands that count as its answer; empty = it joins and reports each tick itself."""
    after: str = ""
    """Topic that it answers to; empty = every tick, or as ``every_s`` says."""
    every_s: float = 0.0
    """Period in which it answers once, seconds of simulation time; 0 = none."""


def parse_participants(text: str) -> tuple[ParticipantRule, ...]:
    """Returns the participants that a setting lists.

    Raises:
        ConfigError: the setting is not of the form that the message shows.
    """
    found: list[ParticipantRule] = []
    for part in filter(str.strip, text.split(";")):
        match = _RULE.fullmatch(part)
        every = float(match[5]) if match and match[5] and match[5].count(".") < 2 else 0.0
        if match is None or (match[5] and not every > 0.0):
            raise ConfigError(f"setting 'participants' has {quoted(part.strip())}, must be {_ALLOWED}")
        if any(match[1] == other.name for other in found):
            raise ConfigError(f"setting 'participants' names {quoted(match[1])} twice; each needs a name of its own")
        found.append(ParticipantRule(match[1], (match[2] or "").lstrip("/"), (match[4] or "").lstrip("/"), every))
    return tuple(found)


@dataclass(slots=True)
class Participant:
    """A node that time waits for, and how long the ticks waited for it."""

    name: str
    answer: str = ""
    """See ``ParticipantRule``."""
    after: str = ""
    every_ns: int = 0
    pending: bool = False
    """Whether the present tick still waits for it."""
    in_flight: dict[str, int] = field(default_factory=dict)
    """Commands that it sent and that have not arrived, by topic."""
    answered: bool = False
    ticks: int = 0
    """Ticks that it has done."""
    waited_ns: int = 0
    """Wall time that those ticks waited for it, and the longest of them."""
    longest_ns: int = 0
    missed: int = 0
    """Ticks that went on without it."""
    next_ns: int = 0
    """Simulation time of its next answer; for a rule with a period."""


class Lockstep:
    """Keeps track of which participants the present tick waits for. Times are of any steady clock, nanoseconds."""

    def __init__(self, rules: Sequence[ParticipantRule] = ()) -> None:
        self._missing = {rule.name for rule in rules if not rule.answer}
        self._participants = {rule.name: _participant_of(rule) for rule in rules if rule.answer}
        self._received: dict[str, int] = {}
        self._stamp_ns: int | None = None
        self._opened_ns = 0

    @property
    def participants(self) -> tuple[Participant, ...]:
        """All present participants."""
        return tuple(self._participants.values())

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the declared participants that have not joined: time must not start without them."""
        return tuple(sorted(self._missing))

    @property
    def is_open(self) -> bool:
        """Whether the next tick may begin."""
        return self._stamp_ns is None and not self._missing

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the tick that is not done; None = it is."""
        return self._stamp_ns

    @property
    def waits_for(self) -> tuple[str, ...]:
        """Names of the participants that have not joined, then of those that have not done the present tick."""
        return (*self.missing, *(p.name for p in self._participants.values() if p.pending))

    @property
    def topics(self) -> frozenset[str]:
        """Topics whose presence at a tick matters to ``begin_tick``."""
        return frozenset(p.after for p in self._participants.values() if p.after)

    def waited_ns(self, now_ns: int) -> int:
        """Returns how long the present tick has waited."""
        return 0 if self._stamp_ns is None else now_ns - self._opened_ns

    def join(self, name: str, after: str = "") -> bool:
        """Adds a participant from the next tick on. If the present tick waits for one of the same name, it goes on waiting.

        Returns:
            Whether it replaces a pending participant, so that it must be given the present tick again.
        """
        self._missing.discard(name)
        old = self._participants.get(name)
        if old is not None and not old.answer:
            old.after, old.in_flight, old.answered = after, {}, False
            return old.pending
        self._participants[name] = Participant(name, after=after)
        return False

    def leave(self, name: str, now_ns: int) -> None:
        """Removes a participant; the present tick no longer waits for it."""
        if self._participants.pop(name, None) is not None:
            self._update(now_ns)

    def begin_tick(self, stamp_ns: int, topics: Collection[str], now_ns: int) -> None:
        """Begins to wait for all participants that a published tick concerns.

        Args:
            stamp_ns: of the tick, simulation time.
            topics: those of ``topics`` that were published at it.
            now_ns: now.
        """
        self._stamp_ns, self._opened_ns = stamp_ns, now_ns
        self._received.clear()
        for participant in self._participants.values():
            participant.pending = _is_concerned(participant, stamp_ns, topics)
            participant.answered = False
        self._update(now_ns)

    def tick_done(self, name: str, stamp_ns: int, sent: Iterable[str], now_ns: int) -> bool:
        """Handles the report of a participant that it has done a tick.

        Args:
            name: of the participant.
            stamp_ns: of the tick.
            sent: topics of the commands that it sent, once for each; they may still be on their way.
            now_ns: now.

        Returns:
            Whether the present tick was waiting for this report; if not, it is ignored.
        """
        participant = self._participants.get(name)
        if participant is None or stamp_ns != self._stamp_ns or not participant.pending:
            return False
        participant.answered = True
        for topic in sent:
            participant.in_flight[topic] = participant.in_flight.get(topic, 0) + 1
        self._match_commands()
        self._update(now_ns)
        return True

    def receive_command(self, topic: str, now_ns: int) -> None:
        """Handles the arrival of a command."""
        for participant in self._participants.values():
            if participant.answer == topic and participant.pending:
                participant.answered = True
        self._received[topic] = self._received.get(topic, 0) + 1
        self._match_commands()
        self._update(now_ns)

    def skip_late(self, now_ns: int) -> tuple[str, ...]:
        """Ends the present tick without its pending participants; returns their names."""
        late = [p for p in self._participants.values() if p.pending]
        for participant in late:
            participant.missed += 1
            participant.pending, participant.in_flight = False, {}
        self._update(now_ns)
        return tuple(p.name for p in late)

    def reset(self) -> None:
        """Forgets the present tick: the simulation was reset."""
        self._stamp_ns = None
        self._received.clear()
        for participant in self._participants.values():
            participant.pending, participant.answered, participant.next_ns = False, False, 0
            participant.in_flight = {}

    def _match_commands(self) -> None:
        """Sets off commands that arrived against those that participants reported as sent."""
        for participant in self._participants.values():
            for topic in list(participant.in_flight):
                arrived = min(participant.in_flight[topic], self._received.get(topic, 0))
                if arrived:
                    participant.in_flight[topic] -= arrived
                    self._received[topic] -= arrived
                if not participant.in_flight[topic]:
                    del participant.in_flight[topic]

    def _update(self, now_ns: int) -> None:
        """Ends the present tick if all participants have done it."""
        if self._stamp_ns is None:
            return
        for participant in self._participants.values():
            if participant.pending and participant.answered and not participant.in_flight:
                participant.pending = False
                participant.ticks += 1
                waited = now_ns - self._opened_ns
                participant.waited_ns += waited
                participant.longest_ns = max(participant.longest_ns, waited)
        if not any(p.pending for p in self._participants.values()):
            self._stamp_ns = None


def _participant_of(rule: ParticipantRule) -> Participant:
    return Participant(rule.name, rule.answer, rule.after, round(rule.every_s * NS_PER_S))


def _is_concerned(participant: Participant, stamp_ns: int, topics: Collection[str]) -> bool:
    """Returns whether a tick waits for an answer of a participant."""
    if participant.every_ns:
        if stamp_ns < participant.next_ns:
            return False
        participant.next_ns = (stamp_ns // participant.every_ns + 1) * participant.every_ns
        return True
    return not participant.after or participant.after in topics
