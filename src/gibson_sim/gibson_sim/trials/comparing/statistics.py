"""Exact significance tests of paired results, without approximation and thus valid for any number of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from statistics import median

SIGNIFICANCE_LEVEL = 0.05
"""Significance level."""


def two_sided_binomial(fewer: int, more: int) -> float:
    """Returns the two-sided p-value of ``fewer`` and ``more`` outcomes under equal odds; 1 without outcomes.

    This is the exact McNemar test if the outcomes are the pairs that differ, and the exact sign test.
    """
    count, least = fewer + more, min(fewer, more)
    if not count:
        return 1.0
    tail = sum(comb(count, k) for k in range(least + 1))
    return min(1.0, float(2 * tail / 2**count))


def least_significant_count() -> int:
    """Returns the least number of differing pairs, all in one direction, that is significant."""
    count = 1
    while two_sided_binomial(0, count) >= SIGNIFICANCE_LEVEL:
        count += 1
    return count


@dataclass(frozen=True, slots=True)
class Shift:
    """Difference of a measure between the same runs of two trials."""

    name: str
    """Name of the measure."""
    unit: str
    pairs: int
    smaller: int
    """Pairs in which the second trial has the smaller value."""
    larger: int
    """Pairs in which the second trial has the larger value."""
    median: float
    """Median difference, second value minus first, in ``unit``."""
    share: float
    """Median relative difference, as a fraction of the first value."""
    p: float
    """p-value of the exact sign test."""

    @property
    def is_chance(self) -> bool:
        """Whether the difference is not significant."""
        return self.p >= SIGNIFICANCE_LEVEL


def find_shift(name: str, unit: str, pairs: Sequence[tuple[float, float]], resolution: float = 0.0) -> Shift | None:
    """Returns the shift of a measure; None without pairs.

    Args:
        name: name of the measure.
        unit: unit of the measure.
        pairs: values in the first and in the second trial.
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
