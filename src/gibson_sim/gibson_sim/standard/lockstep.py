"""Lockstep: a tick begins only when every participant has finished the previous one. Pure.

The node's loop::

    if lockstep.is_open: execute the steps of the next tick, publish it, then lockstep.begin_tick(stamp_ns, topics)
    at a TickDone:       lockstep.join / tick_done / leave
    at a command, or at a message on a topic of ``received_topics``: lockstep.receive(topic)

A participant either announces itself (``join``, then ``tick_done`` for every tick), or is declared by a rule on its output. With
``follow=cmd_vel after odom``, the first message on ``cmd_vel`` after a tick at which ``odom`` was published reports that the tick is done.
With ``nav=cmd_vel every 0.05``, a tick waits if the last message on ``cmd_vel`` arrived at least 0.05 s of simulation time before it. This
does not depend on the phase of the node's timer: a message between two such ticks delays the next of them. With ``from goal_pose``, a rule
is in force from a message on ``goal_pose`` until its participant becomes idle: only waiting distinguishes a node without a goal from a slow
one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S

CAMERAS = "cameras"
"""Placeholder for a topic in ``after``: ticks at which any camera is due, which renderers draw."""
_TOPIC = r"(/?[A-Za-z_]\w*(?:/[A-Za-z_]\w*)*)"
_RULE = re.compile(
    rf"\s*([\w./-]+)\s*(?:=\s*{_TOPIC}\s+(?:after\s+{_TOPIC}|every\s+(\d+(?:\.\d*)?|\.\d+)\s*s?)(?:\s+from\s+{_TOPIC})?)?\s*",
    re.ASCII,
)
_ALLOWED = "`render`, `follow=cmd_vel after odom` or `nav=cmd_vel every 0.05 from goal_pose`, separated by `;`; a period is 0.001 to 3600 s"


@dataclass(frozen=True, slots=True)
class ParticipantRule:
    """A participant that the setting ``participants`` declares; one without ``answer`` must join before time starts."""

    name: str
    answer: str = ""
    """Topic of the messages that count as its answer; empty = it joins and reports each tick itself."""
    after: str = ""
    """Topic that it answers; empty = every tick, or every ``every_s``."""
    every_s: float = 0.0
    """Maximum simulation time between two answers, s; 0 = no limit."""
    activation: str = ""
    """Topic of the message that activates it; empty = always active."""

    def resolved(self, resolve: Callable[[str], str]) -> ParticipantRule:
        """Returns the rule with the full names of its topics, which ``resolve`` returns."""
        answer, after, activation = (
            name and (name if name == CAMERAS else resolve(name)) for name in (self.answer, self.after, self.activation)
        )
        return replace(self, answer=answer, after=after, activation=activation)


def parse_participants(text: str) -> tuple[ParticipantRule, ...]:
    """Returns the participants that a setting lists.

    Raises:
        ConfigError: the setting does not match the syntax.
    """
    rules: list[ParticipantRule] = []
    for part in filter(str.strip, text.split(";")):
        match = _RULE.fullmatch(part)
        name, answer, after, every, activation = match.groups(default="") if match else ("",) * 5
        every_s = float(every or 0.0)
        if match is None or (every and not 0.001 <= every_s <= 3600.0):
            raise ConfigError(f"setting 'participants' has {quoted(part.strip())}, must be {_ALLOWED}")
        if any(name == other.name for other in rules):
            raise ConfigError(f"setting 'participants' names {quoted(name)} twice; each needs a name of its own")
        rules.append(ParticipantRule(name, answer, after, every_s, activation))
    return tuple(rules)


@dataclass(slots=True)
class Participant:
    """A node that time waits for, and the wall time that ticks waited for it."""

    name: str
    answer: str = ""
    """See ``ParticipantRule``."""
    after: str = ""
    every_ns: int = 0
    activation: str = ""
    idle: bool = False
    """Whether no tick waits for it: no message on ``activation`` has arrived, or it has been silent for too long since."""
    pending: bool = False
    """Whether the present tick still waits for it."""
    in_flight: dict[str, int] = field(default_factory=dict)
    """Topic -> number of commands that it has sent and that have not arrived."""
    arrived: set[str] = field(default_factory=set)
    """Topics on which a command that it sent has arrived."""
    answered: bool = False
    """Whether it has answered the present tick."""
    ticks: int = 0
    """Number of ticks that it has finished."""
    waited_ns: int = 0
    """Total wall time that those ticks waited for it, ns."""
    longest_ns: int = 0
    """Longest wall time that one of them waited, ns."""
    missed: int = 0
    """Number of ticks that ended without it."""
    last_ns: int | None = None
    """Stamp of the tick at which it last answered, or was activated, ns; None = not yet. For a rule with a period."""


class Lockstep:
    """Keeps track of the participants that the present tick waits for. ``now_ns`` is of any monotonic clock, ns."""

    def __init__(self, rules: Sequence[ParticipantRule] = ()) -> None:
        self._missing = {rule.name for rule in rules if not rule.answer}
        self._participants = {rule.name: _participant_of(rule) for rule in rules if rule.answer}
        self._received: dict[str, int] = {}
        self._newest_ns: int | None = None
        """Stamp of the newest tick, ns."""
        self._stamp_ns: int | None = None
        self._opened_ns = 0

    @property
    def participants(self) -> tuple[Participant, ...]:
        """Participants that have joined or have a rule on their output."""
        return tuple(self._participants.values())

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the declared participants that have not joined; time must not start without them."""
        return tuple(sorted(self._missing))

    @property
    def is_open(self) -> bool:
        """Whether the next tick may begin."""
        return self._stamp_ns is None and not self._missing

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the unfinished tick, ns; None = there is none."""
        return self._stamp_ns

    @property
    def waits_for(self) -> tuple[str, ...]:
        """Names of the participants that have not joined, then of those that have not finished the present tick."""
        return (*self.missing, *(p.name for p in self._participants.values() if p.pending))

    @property
    def any_idle(self) -> bool:
        """Whether any participant is idle, so that no tick waits for it until it is activated."""
        return any(p.idle for p in self._participants.values())

    @property
    def topics(self) -> frozenset[str]:
        """Topics of which ``begin_tick`` must know whether they were published at the tick."""
        return frozenset(p.after for p in self._participants.values() if p.after)

    @property
    def received_topics(self) -> frozenset[str]:
        """Topics whose messages must be reported to ``receive``."""
        return frozenset(t for p in self._participants.values() for t in (p.answer, p.activation) if t)

    def waited_ns(self, now_ns: int) -> int:
        """Returns the wall time that the present tick has waited, ns."""
        return 0 if self._stamp_ns is None else now_ns - self._opened_ns

    def join(self, name: str, after: str = "") -> bool:
        """Adds a participant from the next tick on. If the present tick waits for one of the same name, it still does.

        Returns:
            Whether it replaces a pending participant, so that the present tick must be sent to it again.
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
        """Begins to wait for all participants that must answer a published tick.

        Args:
            stamp_ns: stamp of the tick, simulation time, ns.
            topics: the subset of ``topics`` that was published at it.
            now_ns: now, ns.
        """
        self._stamp_ns = self._newest_ns = stamp_ns
        self._opened_ns = now_ns
        self._received.clear()
        for participant in self._participants.values():
            participant.pending = _must_answer(participant, stamp_ns, topics)
            participant.answered = False
        self._update(now_ns)

    def tick_done(self, name: str, stamp_ns: int, sent: Iterable[str], now_ns: int) -> bool:
        """Handles a participant's report that it has finished a tick.

        Args:
            name: name of the participant.
            stamp_ns: stamp of the tick, ns.
            sent: topic of each command that it sent; the commands may still be in flight.
            now_ns: now, ns.

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
        """Handles the arrival of a command or of a message on one of ``received_topics``.

        Returns:
            Names of the idle participants that an answer, not an activation, makes active again: they were slow, not idle.
        """
        resumed = []
        for participant in self._participants.values():
            if topic not in (participant.answer, participant.activation):
                continue
            if participant.idle:
                participant.idle, participant.last_ns = False, self._newest_ns
                if topic != participant.activation:
                    resumed.append(participant.name)
            if topic == participant.answer:
                participant.answered |= participant.pending
                participant.last_ns = self._newest_ns
        self._received[topic] = self._received.get(topic, 0) + 1
        self._match_commands()
        self._update(now_ns)
        return tuple(resumed)

    def idle_silent(self, now_ns: int, silent_ns: int) -> tuple[str, ...]:
        """Marks participants with an activation topic as idle if the present tick has waited longer than ``silent_ns``; returns their names.

        A participant that has never answered gets twice the time: its node may still be starting.
        """
        waited_ns = self.waited_ns(now_ns)
        silent = [
            p
            for p in self._participants.values()
            if p.activation and p.pending and waited_ns > (silent_ns if p.ticks else 2 * silent_ns)
        ]
        for participant in silent:
            participant.idle, participant.pending = True, False
        self._update(now_ns)
        return tuple(p.name for p in silent)

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
        """Drops commands that were sent before discovery and will never arrive; returns (participant, topic) of each.

        Only topics on which none of the participant's commands has arrived yet are affected.

        Args:
            now_ns: now, ns.
            after_ns: minimum time that the present tick must have waited, ns.
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
        """Discards the present tick: the simulation was reset."""
        self._stamp_ns = self._newest_ns = None
        self._received.clear()
        for participant in self._participants.values():
            participant.pending, participant.answered, participant.last_ns = False, False, None
            participant.in_flight = {}

    def _match_commands(self) -> None:
        """Matches commands that arrived with those that participants reported as sent."""
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
        """Ends the present tick if all participants have finished it."""
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
        rule.name, rule.answer, rule.after, round(rule.every_s * NS_PER_S), activation=rule.activation, idle=bool(rule.activation)
    )


def _must_answer(participant: Participant, stamp_ns: int, topics: Collection[str]) -> bool:
    """Returns whether a tick waits for an answer of a participant."""
    if participant.idle:
        return False
    if participant.every_ns:
        if participant.last_ns is None:
            # As if it had answered at the previous multiple of its period: timers that started at time 0 fire at multiples.
            participant.last_ns = (stamp_ns - 1) // participant.every_ns * participant.every_ns
        return stamp_ns - participant.last_ns >= participant.every_ns
    return not participant.after or participant.after in topics
