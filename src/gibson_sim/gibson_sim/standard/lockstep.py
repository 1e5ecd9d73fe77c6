"""Lockstep: a tick begins only when everybody who takes part has done what the last one asked of them. Pure.

The node's loop::

    if lockstep.is_open: make the steps of the next tick, publish it, then lockstep.publish_tick(stamp_ns, topics)
    at a TickDone:       lockstep.join / done / leave
    at a command:        lockstep.receive(topic)

Who takes part either says so itself (``join``, then ``done`` for every tick), or is a stranger known by a rule: ``follow=cmd_vel after
odom`` takes the first command on ``cmd_vel`` after a tick at which ``odom`` was published as the sign that the tick is done.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S

CAMERAS = "cameras"
"""What renderers wait for: ticks at which any camera is due."""
_RULE = re.compile(r"\s*([\w./-]+)\s*(?:=\s*([\w./-]+)\s+(after\s+([\w./-]+)|every\s+([\d.]+)\s*s?))?\s*")
_ALLOWED = "`render`, `follow=cmd_vel after odom` or `nav=cmd_vel every 0.05`, separated by `;`"


@dataclass(frozen=True, slots=True)
class Expected:
    """A participant that must be there before time begins."""

    name: str
    answer: str = ""
    """Topic of the commands that count as its answer; empty = it says itself what it has done."""
    after: str = ""
    """Topic that it answers to; empty = every tick, or as ``every_s`` says."""
    every_s: float = 0.0
    """It answers once in so much simulation time."""


def parse_participants(text: str) -> tuple[Expected, ...]:
    """Returns the participants that a setting lists.

    Raises:
        ConfigError: it is not of the form that the message shows.
    """
    found: list[Expected] = []
    for part in filter(str.strip, text.split(";")):
        match = _RULE.fullmatch(part)
        every = float(match[5]) if match and match[5] and match[5].count(".") < 2 else 0.0
        if match is None or (match[5] and not every > 0.0):
            raise ConfigError(f"setting 'participants' has {quoted(part.strip())}, must be {_ALLOWED}")
        if any(match[1] == other.name for other in found):
            raise ConfigError(f"setting 'participants' names {quoted(match[1])} twice; each needs a name of its own")
        found.append(Expected(match[1], (match[2] or "").lstrip("/"), (match[4] or "").lstrip("/"), every))
    return tuple(found)


@dataclass(slots=True)
class Participant:
    """Somebody who takes part, and how long everybody waited for them."""

    name: str
    answer: str = ""
    after: str = ""
    every_ns: int = 0
    waits_for_it: bool = False
    """Whether the present tick is not done for it."""
    owes: dict[str, int] = field(default_factory=dict)
    """Commands that it sent and that have not arrived, by topic."""
    answered: bool = False
    ticks: int = 0
    waited_ns: int = 0
    longest_ns: int = 0
    missed: int = 0
    next_ns: int = 0
    """Of a rule with a period: simulation time at which it answers next."""


class Lockstep:
    """Knows for whom the present tick waits. Times are of any steady clock, nanoseconds."""

    def __init__(self, expected: Sequence[Expected] = ()) -> None:
        self._absent = {e.name for e in expected if not e.answer}
        self._participants = {e.name: _stranger(e) for e in expected if e.answer}
        self._received: dict[str, int] = {}
        self._stamp_ns: int | None = None
        self._opened_ns = 0

    @property
    def participants(self) -> tuple[Participant, ...]:
        """Everybody who takes part now."""
        return tuple(self._participants.values())

    @property
    def absent(self) -> tuple[str, ...]:
        """Those who were announced and have not joined yet: time must not begin."""
        return tuple(sorted(self._absent))

    @property
    def is_open(self) -> bool:
        """Whether the next tick may begin."""
        return self._stamp_ns is None and not self._absent

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the tick that is not done; None = it is."""
        return self._stamp_ns

    @property
    def waits_for(self) -> tuple[str, ...]:
        """Names of those who have not done the present tick, and of those who have not joined."""
        return (*self.absent, *(p.name for p in self._participants.values() if p.waits_for_it))

    @property
    def topics(self) -> frozenset[str]:
        """Topics whose presence at a tick matters to ``publish_tick``."""
        return frozenset(p.after for p in self._participants.values() if p.after)

    def waited_ns(self, now_ns: int) -> int:
        """Returns for how long the present tick has waited."""
        return 0 if self._stamp_ns is None else now_ns - self._opened_ns

    def join(self, name: str, after: str = "") -> bool:
        """Takes a participant in, from the next tick on; one of the same name that a tick waits for is waited for still.

        Returns:
            Whether it takes the place of one that was there: it must be given the present tick again.
        """
        self._absent.discard(name)
        old = self._participants.get(name)
        if old is not None and not old.answer:
            old.after, old.owes, old.answered = after, {}, False
            return old.waits_for_it
        self._participants[name] = Participant(name, after=after)
        return False

    def leave(self, name: str, now_ns: int) -> None:
        """Lets a participant go; the present tick no longer waits for it."""
        if self._participants.pop(name, None) is not None:
            self._look(now_ns)

    def publish_tick(self, stamp_ns: int, topics: Collection[str], now_ns: int) -> None:
        """Takes note that a tick was published.

        Args:
            stamp_ns: of the tick, simulation time.
            topics: those of ``topics`` that were published at it.
            now_ns: now.
        """
        self._stamp_ns, self._opened_ns = stamp_ns, now_ns
        self._received.clear()
        for participant in self._participants.values():
            participant.waits_for_it = _is_asked(participant, stamp_ns, topics)
            participant.answered = False
        self._look(now_ns)

    def done(self, name: str, stamp_ns: int, sent: Iterable[str], now_ns: int) -> bool:
        """Takes that a participant has done a tick and sent commands on topics, which may still be on their way.

        Returns:
            Whether it is one, and this the present tick; else nothing happens.
        """
        participant = self._participants.get(name)
        if participant is None or stamp_ns != self._stamp_ns or not participant.waits_for_it:
            return False
        participant.answered = True
        for topic in sent:
            participant.owes[topic] = participant.owes.get(topic, 0) + 1
        self._settle()
        self._look(now_ns)
        return True

    def receive(self, topic: str, now_ns: int) -> None:
        """Takes that a command arrived."""
        for participant in self._participants.values():
            if participant.answer == topic and participant.waits_for_it:
                participant.answered = True
        self._received[topic] = self._received.get(topic, 0) + 1
        self._settle()
        self._look(now_ns)

    def give_up(self, now_ns: int) -> tuple[str, ...]:
        """Ends the present tick without those it waits for; returns their names."""
        late = [p for p in self._participants.values() if p.waits_for_it]
        for participant in late:
            participant.missed += 1
            participant.waits_for_it, participant.owes = False, {}
        self._look(now_ns)
        return tuple(p.name for p in late)

    def restart(self) -> None:
        """Forgets the present tick: the simulation was reset."""
        self._stamp_ns = None
        self._received.clear()
        for participant in self._participants.values():
            participant.waits_for_it, participant.answered, participant.next_ns = False, False, 0
            participant.owes = {}

    def _settle(self) -> None:
        """Sets off commands that arrived against those that somebody says to have sent; what nobody announced is dropped."""
        for participant in self._participants.values():
            for topic in list(participant.owes):
                arrived = min(participant.owes[topic], self._received.get(topic, 0))
                if arrived:
                    participant.owes[topic] -= arrived
                    self._received[topic] -= arrived
                if not participant.owes[topic]:
                    del participant.owes[topic]

    def _look(self, now_ns: int) -> None:
        """Looks whether the present tick is done."""
        if self._stamp_ns is None:
            return
        for participant in self._participants.values():
            if participant.waits_for_it and participant.answered and not participant.owes:
                participant.waits_for_it = False
                participant.ticks += 1
                waited = now_ns - self._opened_ns
                participant.waited_ns += waited
                participant.longest_ns = max(participant.longest_ns, waited)
        if not any(p.waits_for_it for p in self._participants.values()):
            self._stamp_ns = None


def _stranger(expected: Expected) -> Participant:
    return Participant(expected.name, expected.answer, expected.after, round(expected.every_s * NS_PER_S))


def _is_asked(participant: Participant, stamp_ns: int, topics: Collection[str]) -> bool:
    """Returns whether a tick asks for an answer of a participant."""
    if participant.every_ns:
        if stamp_ns < participant.next_ns:
            return False
        participant.next_ns = (stamp_ns // participant.every_ns + 1) * participant.every_ns
        return True
    return not participant.after or participant.after in topics
