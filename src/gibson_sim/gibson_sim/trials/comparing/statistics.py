"""Exact tests of paired results. Pure arithmetic: no approximation, so that they hold for ten runs as for a thousand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from statistics import median

LEVEL = 0.05
"""Probability below which a difference does not count as chance."""


def two_sided_binomial(fewer: int, more: int) -> float:
    """Returns the probability that a fair coin, thrown ``fewer + more`` times, falls at least as unevenly, to either side; 1 for no throw.

    This is the exact McNemar test, where the throws are the pairs that differ, and the exact sign test.
    """
    count, least = fewer + more, min(fewer, more)
    if not count:
        return 1.0
    tail = sum(comb(count, k) for k in range(least + 1))
    return min(1.0, float(2 * tail / 2**count))


def least_differing() -> int:
    """Returns the number of differing pairs, all to one side, from which on the test can tell that they are no chance."""
    count = 1
    while two_sided_binomial(0, count) >= LEVEL:
        count += 1
    return count


@dataclass(frozen=True, slots=True)
class Shift:
    """How a measure of the same runs differs between two trials."""

    name: str
    """Of the measure."""
    unit: str
    pairs: int
    smaller: int
    """Pairs in which the second trial has the smaller value."""
    larger: int
    median: float
    """Of the second value minus the first, in ``unit``."""
    share: float
    """Of the difference, as a part of the first value: median."""
    p: float
    """Of the exact sign test."""

    @property
    def is_chance(self) -> bool:
        """Whether it can be chance."""
        return self.p >= LEVEL


def shift_of(name: str, unit: str, pairs: Sequence[tuple[float, float]], resolution: float = 0.0) -> Shift | None:
    """Returns the shift of a measure; None without pairs.

    Args:
        name: of the measure.
        unit: of the measure.
        pairs: its value in the first and in the second trial.
        resolution: difference up to which two values count as equal.
    """
    if not pairs:
        return None
    smaller, larger = sum(b < a - resolution for a, b in pairs), sum(b > a + resolution for a, b in pairs)
    shares = [(b - a) / a for a, b in pairs if a > 0.0]
    return Shift(
        name,
        unit,
        len(pairs),
        smaller,
        larger,
        median(b - a for a, b in pairs),
        median(shares) if shares else 0.0,
        two_sided_binomial(smaller, larger),
    )
