"""Compares two trials: pairs their runs, tests the differences, and describes them in sentences.

The significance tests are exact: they make no approximation and are thus valid for any number of runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from statistics import median
from typing import Any

from gibson_sim.trials.records import RunResult, RunSpec

MEASURES = (("time", "s", 0.1), ("length", "m", 0.05))
"""Measures compared where both runs passed: name, unit, and the difference up to which two values count as equal. The end of a run can shift by a
tick with the arrival of the stack's report, even if all else is equal bit for bit."""
_NOUNS = {"time": ("faster", "slower"), "length": ("shorter", "longer")}
SIGNIFICANCE_LEVEL = 0.05
"""Significance level."""


@dataclass(frozen=True, slots=True)
class Pair:
    """The same run in two trials."""

    before: RunResult
    after: RunResult

    @property
    def is_worse(self) -> bool:
        """Whether the run passed before and fails now."""
        return self.before.passed and not self.after.passed

    @property
    def is_better(self) -> bool:
        """Whether the run failed before and passes now."""
        return self.after.passed and not self.before.passed

    @property
    def is_equal(self) -> bool:
        """Whether physics was equal bit for bit."""
        return bool(self.before.digest) and self.before.digest == self.after.digest


@dataclass(frozen=True, slots=True)
class VerdictShift:
    """Difference of one verdict between the runs of two trials: a stack may reach more goals but collide more often."""

    name: str
    worse: int
    better: int
    """Numbers of runs that got worse and better."""
    p: float
    """p-value of the exact McNemar test, times the number of verdicts that can be significant (Bonferroni correction)."""

    @property
    def is_chance(self) -> bool:
        """Whether the difference is not significant."""
        return self.p >= SIGNIFICANCE_LEVEL

    @property
    def is_decline(self) -> bool:
        """Whether significantly more runs got worse than better."""
        return self.worse > self.better and not self.is_chance

    def line(self) -> str:
        """Returns a sentence about the difference."""
        kind = "can be chance" if self.is_chance else "is more than chance"
        return f"{self.name}: {runs_text(self.worse)} got worse, {self.better} got better: that {kind} ({percent(self.p)})"


@dataclass(frozen=True, slots=True)
class Comparison:
    """Paired comparison of two trials."""

    pairs: tuple[Pair, ...]
    unpaired_before: int
    """Runs that only the first trial has."""
    unpaired_after: int
    p: float
    """p-value of the exact McNemar test: probability of such a difference, or a greater one, by chance alone."""
    shifts: tuple[Shift, ...]
    """Differences of measures of the runs that passed in both."""
    verdicts: tuple[VerdictShift, ...] = ()
    """Verdicts that differ in any pair."""

    @property
    def worse(self) -> tuple[Pair, ...]:
        """Runs that passed before and fail now."""
        return tuple(pair for pair in self.pairs if pair.is_worse)

    @property
    def better(self) -> tuple[Pair, ...]:
        """Runs that failed before and pass now."""
        return tuple(pair for pair in self.pairs if pair.is_better)

    @property
    def is_decline(self) -> bool:
        """Whether significantly more runs got worse than better, as a whole or by one verdict."""
        whole = len(self.worse) > len(self.better) and self.p < SIGNIFICANCE_LEVEL
        return whole or any(verdict.is_decline for verdict in self.verdicts)

    def lines(self) -> list[str]:
        """Returns the findings as sentences, the most important first."""
        if not self.pairs:
            return [
                "the trials have no run in common: compare trials of the same scenario, with the same seed and number of runs",
                *self._unpaired(),
            ]
        both = sum(pair.before.passed and pair.after.passed for pair in self.pairs)
        neither = sum(not (pair.before.passed or pair.after.passed) for pair in self.pairs)
        lines = [self.verdict(), f"of {len(self.pairs)} pairs {both} passed in both, {neither} failed in both"]
        lines += [verdict.line() for verdict in self.verdicts]
        lines += [shift_line(shift) for shift in self.shifts]
        equal = sum(pair.is_equal for pair in self.pairs)
        if equal:
            lines.append(f"{equal} of {len(self.pairs)} pairs are equal bit for bit")
        return lines + self._unpaired()

    def verdict(self) -> str:
        """Returns a sentence on whether the stacks differ."""
        worse, better = len(self.worse), len(self.better)
        significant = ", ".join(verdict.name for verdict in self.verdicts if not verdict.is_chance)
        if not worse and not better:
            if significant:
                return f"no run got better or worse as a whole, but the stacks differ by more than chance in: {significant}"
            return "no run got better or worse: the verdicts show no difference between the stacks"
        counts = f"{runs_text(worse)} got worse, {better} got better"
        chance = f"by chance alone such a difference or a greater one would occur in {percent(self.p)} of cases"
        if self.p < SIGNIFICANCE_LEVEL:
            return f"{counts}; {chance}: the stacks differ, and the {'first' if worse > better else 'second'} is better"
        if significant:
            return f"{counts}; {chance}; but the stacks differ by more than chance in: {significant}"
        least = least_significant_count()
        hint = f" (fewer than {least} differing runs can never be; plan more runs)" if worse + better < least else ""
        return f"{counts}; {chance}: this is no evidence that the stacks differ{hint}"

    def _unpaired(self) -> list[str]:
        counts = ((self.unpaired_before, "first"), (self.unpaired_after, "second"))
        unpaired = [f"{runs_text(count)} only in the {which} trial" for count, which in counts if count]
        return [f"left out, without a partner: {', '.join(unpaired)}"] if unpaired else []

    def to_json(self) -> dict[str, Any]:
        """Returns the comparison as JSON values."""
        return {
            "pairs": len(self.pairs),
            "worse": [pair.after.run.number for pair in self.worse],
            "better": [pair.after.run.number for pair in self.better],
            "unpaired_before": self.unpaired_before,
            "unpaired_after": self.unpaired_after,
            "equal_to_the_bit": sum(pair.is_equal for pair in self.pairs),
            "p": self.p,
            "decline": self.is_decline,
            "verdicts": {v.name: {"worse": v.worse, "better": v.better, "p": v.p} for v in self.verdicts},
            "shifts": {shift.name: {"median": shift.median, "p": shift.p, "pairs": shift.pairs} for shift in self.shifts},
            "text": self.lines(),
        }


def compare(before: Sequence[RunResult], after: Sequence[RunResult]) -> Comparison:
    """Pairs runs with the same number, scene, robot, start, goal and seed, and tests the differences.

    Args:
        before: results of the first trial.
        after: results of the second trial.
    """
    known = {_key(result.run): result for result in before}
    pairs = tuple(Pair(known[_key(result.run)], result) for result in after if _key(result.run) in known)
    worse, better = sum(pair.is_worse for pair in pairs), sum(pair.is_better for pair in pairs)
    passed = [pair for pair in pairs if pair.before.passed and pair.after.passed]
    shifts = (
        find_shift(
            name, unit, [(p.before.measures[name], p.after.measures[name]) for p in passed if _both_have(p, name)], resolution
        )
        for name, unit, resolution in MEASURES
    )
    return Comparison(
        pairs,
        len(before) - len(pairs),
        len(after) - len(pairs),
        two_sided_binomial(worse, better),
        tuple(shift for shift in shifts if shift is not None),
        _verdicts(pairs),
    )


def _verdicts(pairs: Sequence[Pair]) -> tuple[VerdictShift, ...]:
    """Returns the verdicts that differ in any pair."""
    counts: dict[str, list[int]] = {}
    for pair in pairs:
        before = {verdict.name: verdict.passed for verdict in pair.before.verdicts}
        for verdict in pair.after.verdicts:
            if before.get(verdict.name, verdict.passed) != verdict.passed:
                counts.setdefault(verdict.name, [0, 0])[verdict.passed] += 1
    # Tests that can never be significant do not count (Tarone 1990).
    tests = max(1, sum(worse + better >= least_significant_count() for worse, better in counts.values()))
    return tuple(
        VerdictShift(name, worse, better, min(1.0, tests * two_sided_binomial(worse, better)))
        for name, (worse, better) in counts.items()
    )


def shift_line(shift: Shift) -> str:
    """Returns a sentence about a measure of the runs that passed in both trials."""
    less, more = _NOUNS[shift.name]
    where = f"of {runs_text(shift.pairs)} that passed in both"
    if not shift.smaller and not shift.larger:
        return f"{where}, every one has the same {shift.name}"
    counts = f"{where}, {shift.larger} got {more} and {shift.smaller} {less} (median {shift.median:+.2f} {shift.unit}, {100 * shift.share:+.1f} %)"
    verdict = "can be chance" if shift.is_chance else "is more than chance"
    return f"{counts}: that {verdict} ({percent(shift.p)})"


def percent(p: float) -> str:
    """Returns a probability in percent, with one decimal if it is small."""
    value = 100.0 * p
    return "less than 0.1 %" if value < 0.1 else f"{value:.1f} %" if value < 10.0 else f"{value:.0f} %"


def runs_text(count: int) -> str:
    """Returns a number of runs as text."""
    return "1 run" if count == 1 else f"{count} runs"


def _both_have(pair: Pair, name: str) -> bool:
    return name in pair.before.measures and name in pair.after.measures


def _key(run: RunSpec) -> tuple[Any, ...]:
    return run.number, run.scene, run.robot, run.start, run.goal, run.seed


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
