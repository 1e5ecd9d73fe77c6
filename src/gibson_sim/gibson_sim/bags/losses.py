"""Counts messages that a publisher sent and that never came, by the numbers that the publisher's middleware gives them."""

from __future__ import annotations


class Losses:
    """Gaps in the sequence numbers of topics that have one publisher.

    A publisher numbers all it sends, whoever listens. Where several publish on a topic their numbers cannot be told apart, so
    nothing is known of it from then on.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._mixed: set[str] = set()

    def note(self, topic: str, number: int | None) -> None:
        """Takes the number of a message that came; None = this middleware has none."""
        if number is None or topic in self._mixed:
            return
        last = self._last.get(topic)
        self._last[topic] = number
        self._lost.setdefault(topic, 0)
        # A lower number is one of a new publisher, which began anew.
        if last is not None and number > last + 1:
            self._lost[topic] += number - last - 1

    def note_publishers(self, topic: str, count: int) -> None:
        """Takes how many publish on a topic now."""
        if count > 1 and topic not in self._mixed:
            self._mixed.add(topic)
            self._lost.pop(topic, None)

    def counts(self) -> dict[str, int]:
        """Returns the lost messages of each topic of which that is known."""
        return dict(sorted(self._lost.items()))
