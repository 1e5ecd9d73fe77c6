"""Rules by which a client holds a tick of lockstep until a program that knows nothing of lockstep has answered it. Pure."""

from __future__ import annotations

from collections.abc import Collection

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.standard.lockstep import ParticipantRule, parse_participants
from gibson_sim.types import NS_PER_S


def parse_rule(text: str) -> ParticipantRule:
    """Returns the rule in a text such as ``cmd_vel after scan`` or ``cmd_vel every 0.05``.

    Raises:
        ConfigError: it is none.
    """
    try:
        rules = parse_participants(f"program={text}")
    except ConfigError:
        rules = ()
    if len(rules) != 1:
        raise ConfigError(
            f"answers is {quoted(text)}, must be such as `cmd_vel after scan` or `cmd_vel every 0.05`, topics of the program"
        )
    return rules[0]


class AnswerRule:
    """Whether a program has answered the present tick, by the messages that it publishes on one topic."""

    def __init__(self, rule: ParticipantRule) -> None:
        self.topic, self._after, self._every_ns = rule.answer.lstrip("/"), rule.after.lstrip("/"), round(rule.every_s * NS_PER_S)
        self._next_ns = 0
        self._is_due = False
        self.received = 0
        """Messages since the last tick ended."""
        self.has_answered = False
        """Whether it ever did."""

    def begin_tick(self, stamp_ns: int, topics: Collection[str]) -> None:
        """Notes whether a tick asks for an answer; the answer may be here already. ``topics`` were published at it, without leading slashes."""
        if self._every_ns:
            self._is_due = stamp_ns >= self._next_ns
            if self._is_due:
                self._next_ns = (stamp_ns // self._every_ns + 1) * self._every_ns
        else:
            self._is_due = not self._after or self._after in topics

    def receive(self) -> None:
        """Notes a message."""
        self.received += 1
        self.has_answered = True

    @property
    def is_answered(self) -> bool:
        """Whether the present tick need not wait for it."""
        return not self._is_due or bool(self.received)

    def end_tick(self) -> int:
        """Ends the tick; returns how many messages belong to it."""
        count, self.received, self._is_due = self.received, 0, False
        return count

    def reset(self) -> None:
        """Forgets the present tick: time begins anew."""
        self.end_tick()
        self._next_ns = 0
