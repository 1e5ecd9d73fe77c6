"""Lockstep: a tick begins only when every participant has done the last one. Pure.

The node's loop::

    if lockstep.is_open: make the steps of the next tick, publish it, then lockstep.begin_tick(stamp_ns, topics)
    at a TickDone:       lockstep.join / tick_done / leave
    at a command, or at a message on a topic of ``received_topics``: lockstep.receive(topic)

A participant either announces itself (``join``, then ``tick_done`` for every tick), or is declared by a rule on its output: with
``follow=cmd_vel after odom``, the first message on ``cmd_vel`` after a tick at which ``odom`` was published is the sign that the tick is done.
With ``nav=cmd_vel every 0.05``, a tick waits if the last message on ``cmd_vel`` came 0.05 s of simulation time before it, or earlier. This needs
no knowledge of when the node wakes: a message that comes between two such ticks moves the next of them. With ``from goal_pose`` a rule counts
from a message on ``goal_pose`` on, until its participant rests: a node without a goal cannot be told from a slow one but by waiting.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S

CAMERAS = "cameras"
"""Stands for a topic in ``after``: ticks at which any camera is due, which renderers draw."""
_TOPIC = r"(/?[A-Za-z_]\w*(?:/[A-Za-z_]\w*)*)"
_RULE = re.compile(
    rf"\s*([\w./-]+)\s*(?:=\s*{_TOPIC}\s+(?:after\s+{_TOPIC}|every\s+(\d+(?:\.\d*)?|\.\d+)\s*s?)(?:\s+from\s+{_TOPIC})?)?\s*",
    re.ASCII,
)
_ALLOWED = "`render`, `follow=cmd_vel after odom` or `nav=cmd_vel every 0.05 from goal_pose`, separated by `;`; a period is 0.001 to 3600 s"


@dataclass(frozen=True, slots=True)
class ParticipantRule:
    """A participant that must be there before time starts, as the setting ``participants`` declares it."""

    name: str
    answer: str = ""
    """Topic of the messages that count as its answer; empty = it joins and reports each tick itself."""
    after: str = ""
    """Topic that it answers to; empty = every tick, or as ``every_s`` says."""
    every_s: float = 0.0
    """Longest time between two answers, seconds of simulation time; 0 = none."""
    begins: str = ""
    """Topic of the messages from which on it answers; empty = always."""

    def resolved(self, resolve: Callable[[str], str]) -> ParticipantRule:
        """Returns the rule with the full names of its topics."""
        answer, after, begins = (
            name and (name if name == CAMERAS else resolve(name)) for name in (self.answer, self.after, self.begins)
        )
        return replace(self, answer=answer, after=after, begins=begins)


def parse_participants(text: str) -> tuple[ParticipantRule, ...]:
    """Returns the participants that a setting lists.

    Raises:
        ConfigError: the setting is not of the form that the message shows.
    """
    found: list[ParticipantRule] = []
    for part in filter(str.strip, text.split(";")):
        match = _RULE.fullmatch(part)
        name, answer, after, every, begins = match.groups(default="") if match else ("",) * 5
        every_s = float(every or 0.0)
        if match is None or (every and not 0.001 <= every_s <= 3600.0):
            raise ConfigError(f"setting 'participants' has {quoted(part.strip())}, must be {_ALLOWED}")
        if any(name == other.name for other in found):
            raise ConfigError(f"setting 'participants' names {quoted(name)} twice; each needs a name of its own")
        found.append(ParticipantRule(name, answer, after, every_s, begins))
    return tuple(found)


@dataclass(slots=True)
class Participant:
    """A node that time waits for, and how long the ticks waited for it."""

    name: str
    answer: str = ""
    """See ``ParticipantRule``."""
    after: str = ""
    every_ns: int = 0
    begins: str = ""
    rests: bool = False
    """Whether no tick waits for it: a message on ``begins`` has not come, or it has been silent for long since."""
    pending: bool = False
    """Whether the present tick still waits for it."""
    in_flight: dict[str, int] = field(default_factory=dict)
    """Commands that it sent and that have not arrived, by topic."""
    arrived: set[str] = field(default_factory=set)
    """Topics on which a command that it sent has arrived."""
    answered: bool = False
    ticks: int = 0
    """Ticks that it has done."""
    waited_ns: int = 0
    """Wall time that those ticks waited for it, and the longest of them."""
    longest_ns: int = 0
    missed: int = 0
    """Ticks that went on without it."""
    last_ns: int | None = None
    """Stamp of the tick at which it answered last, or began; None = not yet. For a rule with a period."""


class Lockstep:
    """Keeps track of which participants the present tick waits for. Times are of any steady clock, nanoseconds."""

    def __init__(self, rules: Sequence[ParticipantRule] = ()) -> None:
        self._missing = {rule.name for rule in rules if not rule.answer}
        self._participants = {rule.name: _participant_of(rule) for rule in rules if rule.answer}
        self._received: dict[str, int] = {}
        self._newest_ns: int | None = None
        """Stamp of the tick that began last."""
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
    def any_rests(self) -> bool:
        """Whether there is a participant that no tick waits for, until there is a message on the topic with which it begins."""
        return any(p.rests for p in self._participants.values())

    @property
    def topics(self) -> frozenset[str]:
        """Topics whose presence at a tick matters to ``begin_tick``."""
        return frozenset(p.after for p in self._participants.values() if p.after)

    @property
    def received_topics(self) -> frozenset[str]:
        """Topics whose messages ``receive`` must be told of."""
        return frozenset(t for p in self._participants.values() for t in (p.answer, p.begins) if t)

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
            old.arrived.clear()
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
        self._stamp_ns = self._newest_ns = stamp_ns
        self._opened_ns = now_ns
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

    def receive(self, topic: str, now_ns: int) -> tuple[str, ...]:
        """Handles the arrival of a command or of another message that rules name.

        Returns:
            Names of the participants that rested and no longer do, though only an answer of theirs has come: they were slow, not idle.
        """
        resumed = []
        for participant in self._participants.values():
            if topic not in (participant.answer, participant.begins):
                continue
            if participant.rests:
                participant.rests, participant.last_ns = False, self._newest_ns
                if topic != participant.begins:
                    resumed.append(participant.name)
            if topic == participant.answer:
                participant.answered |= participant.pending
                participant.last_ns = self._newest_ns
        self._received[topic] = self._received.get(topic, 0) + 1
        self._match_commands()
        self._update(now_ns)
        return tuple(resumed)

    def rest_silent(self, now_ns: int, silent_ns: int) -> tuple[str, ...]:
        """Lets participants rest that may, and that the present tick has waited for since ``silent_ns``; returns their names.

        One that has never answered has twice the time: its node may still be starting.
        """
        waited_ns = self.waited_ns(now_ns)
        idle = [
            p
            for p in self._participants.values()
            if p.begins and p.pending and waited_ns > (silent_ns if p.ticks else 2 * silent_ns)
        ]
        for participant in idle:
            participant.rests, participant.pending = True, False
        self._update(now_ns)
        return tuple(p.name for p in idle)

    def skip_late(self, now_ns: int) -> tuple[str, ...]:
        """Ends the present tick without its pending participants; returns their names."""
        late = [p for p in self._participants.values() if p.pending]
        for participant in late:
            participant.missed += 1
            participant.pending, participant.in_flight = False, {}
            participant.last_ns = self._stamp_ns
        self._update(now_ns)
        return tuple(p.name for p in late)

    def lose_first_commands(self, now_ns: int, after_ns: int) -> tuple[tuple[str, str], ...]:
        """Gives up commands that were sent before their publisher was discovered, and will never arrive; returns (participant, topic) of each.

        Args:
            now_ns: now.
            after_ns: how long the present tick must have waited, ns. Only a topic on which none of the participant's commands has arrived yet
                counts.
        """
        if self.waited_ns(now_ns) <= after_ns:
            return ()
        lost = [(p, topic) for p in self._participants.values() if p.pending and p.answered for topic in p.in_flight]
        lost = [(participant, topic) for participant, topic in lost if topic not in participant.arrived]
        for participant, topic in lost:
            del participant.in_flight[topic]
        self._update(now_ns)
        return tuple((participant.name, topic) for participant, topic in lost)

    def reset(self) -> None:
        """Forgets the present tick: the simulation was reset."""
        self._stamp_ns = self._newest_ns = None
        self._received.clear()
        for participant in self._participants.values():
            participant.pending, participant.answered, participant.last_ns = False, False, None
            participant.in_flight = {}

    def _match_commands(self) -> None:
        """Sets off commands that arrived against those that participants reported as sent."""
        for participant in self._participants.values():
            for topic in list(participant.in_flight):
                arrived = min(participant.in_flight[topic], self._received.get(topic, 0))
                if arrived:
                    participant.arrived.add(topic)
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
    return Participant(
        rule.name, rule.answer, rule.after, round(rule.every_s * NS_PER_S), begins=rule.begins, rests=bool(rule.begins)
    )


def _is_concerned(participant: Participant, stamp_ns: int, topics: Collection[str]) -> bool:
    """Returns whether a tick waits for an answer of a participant."""
    if participant.rests:
        return False
    if participant.every_ns:
        if participant.last_ns is None:
            # As if it had answered at the last whole period before: timers that began at time 0 wake at whole periods.
            participant.last_ns = (stamp_ns - 1) // participant.every_ns * participant.every_ns
        return stamp_ns - participant.last_ns >= participant.every_ns
    return not participant.after or participant.after in topics
