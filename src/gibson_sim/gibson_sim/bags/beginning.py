"""With which message a recording begins. Knows no ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from gibson_sim.bags.stamps import stamp_ns

CLOCK = "/clock"
Message = tuple[str, bytes]
"""Topic and CDR bytes."""


class Beginning:
    """Holds messages back until it is known where the recording begins.

    A new process hears of the others one by one, which takes a second and more. Where time runs freely, all that is heard is recorded. In
    lockstep nothing is to be missing: where the simulation was there before the recorder, the bag begins with the first /clock after everybody is
    heard. Latched messages of before are in it, too.

    Args:
        is_latched: whether a topic is.
    """

    def __init__(self, is_latched: Callable[[str], bool]) -> None:
        self._is_latched = is_latched
        self._held: list[Message] = []
        self._first_ns: int | None = None
        self._leaves_out = self._waits_for_clock = False
        self.is_open = False
        """Whether it has begun: nothing is held back any more."""

    @property
    def has_clock(self) -> bool:
        """Whether /clock came."""
        return self._first_ns is not None

    @property
    def is_late(self) -> bool:
        """Whether time was running already when the first /clock came."""
        return bool(self._first_ns)

    def open(self) -> None:
        """Begins with all that was held back."""
        self.is_open = True

    def leave_out(self) -> None:
        """Leaves out what came so far, and what comes before ``begin_with_clock``."""
        self._leaves_out = True

    def begin_with_clock(self) -> None:
        """Begins with the next /clock."""
        self._leaves_out = self._waits_for_clock = True

    def let_through(self, messages: Iterable[Message]) -> list[Message]:
        """Returns what is to be recorded by now, in its order: of these messages, and of those that were held back."""
        for topic, data in messages:
            if topic == CLOCK and not self.is_open:
                self._note_clock(stamp_ns(data))
            self._held.append((topic, data))
        if self.is_open:
            released, self._held = self._held, []
            return released
        if self._leaves_out:
            self._drop()
        return []

    def _note_clock(self, now_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = now_ns
        if self._waits_for_clock:
            self._drop()
            self.is_open = True

    def _drop(self) -> None:
        self._held = [message for message in self._held if self._is_latched(message[0])]
