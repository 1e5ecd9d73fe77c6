"""Rules by which a client holds a lockstep tick until a program without lockstep support has answered it. Pure."""

from __future__ import annotations

from collections.abc import Collection

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.standard.lockstep import ParticipantRule, parse_participants
from gibson_sim.types import NS_PER_S


def parse_rule(text: str) -> ParticipantRule:
    """Returns the rule in a text such as ``cmd_vel after scan`` or ``cmd_vel every 0.05``.

    Raises:
        ConfigError: the text is not a rule.
    """
    try:
        rules = parse_participants(f"program={text}")
    except ConfigError:
        rules = ()
    if len(rules) != 1:
        raise ConfigError(
            f"answers is {quoted(text)}, must be a rule such as `cmd_vel after scan` or `cmd_vel every 0.05`, with topics of the program"
        )
    return rules[0]


class AnswerRule:
    """Keeps track of whether a program has answered the present tick, by its messages on one topic."""

    def __init__(self, rule: ParticipantRule) -> None:
        self.topic, self._after, self._every_ns = rule.answer.lstrip("/"), rule.after.lstrip("/"), round(rule.every_s * NS_PER_S)
        self._next_ns = 0
        self._is_due = False
        self.received = 0
        """Number of messages since the last tick ended."""
        self.has_answered = False
        """Whether any message has arrived yet."""

    def begin_tick(self, stamp_ns: int, topics: Collection[str]) -> None:
        """Begins a tick, whose answer may have arrived already.

        Args:
            stamp_ns: stamp of the tick, simulation time, ns.
            topics: topics that were published at it, without leading slashes.
        """
        if self._every_ns:
            self._is_due = stamp_ns >= self._next_ns
            if self._is_due:
                self._next_ns = (stamp_ns // self._every_ns + 1) * self._every_ns
        else:
            self._is_due = not self._after or self._after in topics

    def receive(self) -> None:
        """Counts a message of the program."""
        self.received += 1
        self.has_answered = True

    @property
    def is_answered(self) -> bool:
        """Whether the present tick has its answer, or needs none."""
        return not self._is_due or bool(self.received)

    def end_tick(self) -> int:
        """Ends the tick; returns the number of messages that belong to it."""
        count, self.received, self._is_due = self.received, 0, False
        return count

    def reset(self) -> None:
        """Discards the present tick: time restarted."""
        self.end_tick()
        self._next_ns = 0
