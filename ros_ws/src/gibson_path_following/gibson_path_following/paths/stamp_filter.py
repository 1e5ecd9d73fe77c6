"""Drops single images and messages whose stamps are far from those before and after them, and recognises when time has gone back for good."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from gibson_path_following.localisation.motions import NS_PER_S

_STEP_NS = 1_000_000_000
"""Step of stamps, back or ahead, that needs the next stamp to be believed, ns."""
_Item = TypeVar("_Item")


@dataclass(frozen=True, slots=True)
class Passed(Generic[_Item]):
    """What a ``StampFilter`` passes on."""

    items: tuple[tuple[int, _Item], ...] = ()
    """Stamps, ns, which grow, and what they belong to."""
    is_jump: bool = False
    """Whether time has gone back before the items: a reset of the simulation, or a bag that plays again."""
    outlier_ns: int | None = None
    """How far the stamp of an item that was dropped is ahead of the next one, ns, negative = behind; None = none was dropped."""


class StampFilter(Generic[_Item]):
    """Drops a single item whose stamp is far from those before and after it; passes the others on in their order.

    An item whose stamp goes back, or ahead by more than a second and three of the last steps, is held until the next one shows whether time
    has jumped.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._step_ns = 0
        """Last step of the stamps, ns."""
        self._held: tuple[int, _Item] | None = None

    def add(self, stamp_ns: int, item: _Item) -> Passed[_Item]:
        """Adds an item; returns what is passed on."""
        held, self._held = self._held, None
        if held is None or self._last_ns is None:
            return self._add(stamp_ns, item)
        held_ns = held[0]
        if stamp_ns == held_ns:
            self._held = held
            return Passed()
        if stamp_ns > held_ns and not (held_ns < self._last_ns < stamp_ns):
            is_jump = held_ns < self._last_ns
            self._last_ns, self._step_ns = stamp_ns, stamp_ns - held_ns
            return Passed((held, (stamp_ns, item)), is_jump)
        return replace(self._add(stamp_ns, item), outlier_ns=held_ns - stamp_ns)

    def _add(self, stamp_ns: int, item: _Item) -> Passed[_Item]:
        step_ns = 0 if self._last_ns is None else stamp_ns - self._last_ns
        if abs(step_ns) > max(_STEP_NS, 3 * self._step_ns):
            self._held = (stamp_ns, item)
            return Passed()
        if step_ns <= 0 and self._last_ns is not None:  # late, or twice
            return Passed()
        self._last_ns, self._step_ns = stamp_ns, step_ns
        return Passed(((stamp_ns, item),))


def outlier_line(ahead_ns: int) -> str:
    """Returns what a warning says of a single stamp that is ahead of the next one, ns, negative = behind."""
    return (
        f"one stamp was {abs(ahead_ns) / NS_PER_S:.1f} s {'ahead of' if ahead_ns > 0 else 'behind'} the next one and is left out; "
        "correct the driver"
    )
