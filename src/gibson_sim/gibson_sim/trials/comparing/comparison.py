"""Pairs the runs of two trials, and tells in sentences what differs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gibson_sim.trials.comparing.statistics import LEVEL, Shift, least_differing, shift_of, two_sided_binomial
from gibson_sim.trials.records import RunResult, RunSpec

MEASURES = (("time", "s", 0.1), ("length", "m", 0.05))
"""Measures that are compared where both runs passed, with their units, and the difference up to which two values count as equal: a run whose
stack tells that it has arrived ends a tick sooner or later, also where all else is equal to the bit."""
_NOUNS = {"time": ("faster", "slower"), "length": ("shorter", "longer")}


@dataclass(frozen=True, slots=True)
class Pair:
    """The same run in two trials."""

    before: RunResult
    after: RunResult

    @property
    def is_worse(self) -> bool:
        """Whether it passed, and now fails."""
        return self.before.passed and not self.after.passed

    @property
    def is_better(self) -> bool:
        """Whether it failed, and now passes."""
        return self.after.passed and not self.before.passed

    @property
    def is_equal(self) -> bool:
        """Whether physics repeated to the bit."""
        return bool(self.before.digest) and self.before.digest == self.after.digest


@dataclass(frozen=True, slots=True)
class VerdictShift:
    """How often one verdict differs between the runs of two trials: a stack may reach more goals and hit more things."""

    name: str
    worse: int
    better: int
    p: float
    """Of the exact McNemar test, times the number of verdicts that it could tell apart (Bonferroni): more tests find more by chance."""

    @property
    def is_chance(self) -> bool:
        """Whether it can be chance."""
        return self.p >= LEVEL

    @property
    def is_decline(self) -> bool:
        """Whether more runs got worse than better, by more than chance."""
        return self.worse > self.better and not self.is_chance

    def line(self) -> str:
        """Returns the sentence about it."""
        kind = "can be chance" if self.is_chance else "is more than chance"
        return f"{self.name}: {runs_text(self.worse)} got worse, {self.better} got better: that {kind} ({percent(self.p)})"


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two trials, run by run."""

    pairs: tuple[Pair, ...]
    unpaired_before: int
    """Runs that only the first trial has."""
    unpaired_after: int
    p: float
    """Of the exact McNemar test: probability that chance alone makes such a difference, or a greater one."""
    shifts: tuple[Shift, ...]
    """Of the runs that passed in both."""
    verdicts: tuple[VerdictShift, ...] = ()
    """Those that differ in any pair."""

    @property
    def worse(self) -> tuple[Pair, ...]:
        """Runs that passed, and now fail."""
        return tuple(pair for pair in self.pairs if pair.is_worse)

    @property
    def better(self) -> tuple[Pair, ...]:
        """Runs that failed, and now pass."""
        return tuple(pair for pair in self.pairs if pair.is_better)

    @property
    def is_decline(self) -> bool:
        """Whether more runs got worse than better by more than chance, as a whole or by one verdict."""
        whole = len(self.worse) > len(self.better) and self.p < LEVEL
        return whole or any(verdict.is_decline for verdict in self.verdicts)

    def lines(self) -> list[str]:
        """Returns the findings, one sentence each, the most important first."""
        if not self.pairs:
            return [
                "no run of one trial is in the other: compare trials of the same scenario, with the same seed and number of runs",
                *self._unpaired(),
            ]
        both = sum(pair.before.passed and pair.after.passed for pair in self.pairs)
        neither = sum(not (pair.before.passed or pair.after.passed) for pair in self.pairs)
        found = [self.verdict(), f"of {len(self.pairs)} pairs {both} passed in both, {neither} failed in both"]
        found += [verdict.line() for verdict in self.verdicts]
        found += [shift_line(shift) for shift in self.shifts]
        equal = sum(pair.is_equal for pair in self.pairs)
        if equal:
            found.append(f"{equal} of {len(self.pairs)} pairs are equal to the bit")
        return found + self._unpaired()

    def verdict(self) -> str:
        """Returns the sentence that tells whether the stacks differ."""
        worse, better = len(self.worse), len(self.better)
        telling = ", ".join(verdict.name for verdict in self.verdicts if not verdict.is_chance)
        if not worse and not better:
            if telling:
                return f"no run got better or worse as a whole, but the stacks differ by more than chance in: {telling}"
            return "no run got better or worse: nothing tells the stacks apart by what passes"
        told = f"{runs_text(worse)} got worse, {better} got better"
        chance = f"by chance alone such a difference or a greater one would come about in {percent(self.p)} of cases"
        if self.p < LEVEL:
            return f"{told}; {chance}: the stacks differ, and the {'first' if worse > better else 'second'} is better"
        if telling:
            return f"{told}; {chance}; but the stacks differ by more than chance in: {telling}"
        least = least_differing()
        hint = f" (fewer than {least} runs that differ never can be; plan more runs)" if worse + better < least else ""
        return f"{told}; {chance}: that is no evidence that the stacks differ{hint}"

    def _unpaired(self) -> list[str]:
        counts = ((self.unpaired_before, "first"), (self.unpaired_after, "second"))
        told = [f"{runs_text(count)} only in the {which} trial" for count, which in counts if count]
        return [f"left out, without a partner: {', '.join(told)}"] if told else []

    def to_json(self) -> dict[str, Any]:
        """Returns it as values of JSON."""
        return {
            "pairs": len(self.pairs),
            "worse": [pair.after.run.number for pair in self.worse],
            "better": [pair.after.run.number for pair in self.better],
            "unpaired_before": self.unpaired_before,
            "unpaired_after": self.unpaired_after,
            "equal_to_the_bit": sum(pair.is_equal for pair in self.pairs),
            "p": self.p,
            "decline": self.is_decline,
            "verdicts": {one.name: {"worse": one.worse, "better": one.better, "p": one.p} for one in self.verdicts},
            "shifts": {shift.name: {"median": shift.median, "p": shift.p, "pairs": shift.pairs} for shift in self.shifts},
            "text": self.lines(),
        }


def compare(before: Sequence[RunResult], after: Sequence[RunResult]) -> Comparison:
    """Pairs runs with the same number, scene, robot, start, goal and seed, and tests what differs.

    Args:
        before: results of the first trial.
        after: results of the second trial.
    """
    known = {_key(result.run): result for result in before}
    pairs = tuple(Pair(known[_key(result.run)], result) for result in after if _key(result.run) in known)
    worse, better = sum(pair.is_worse for pair in pairs), sum(pair.is_better for pair in pairs)
    passed = [pair for pair in pairs if pair.before.passed and pair.after.passed]
    shifts = (
        shift_of(
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
    # Tests that can never tell do not count (Tarone 1990).
    tests = max(1, sum(worse + better >= least_differing() for worse, better in counts.values()))
    return tuple(
        VerdictShift(name, worse, better, min(1.0, tests * two_sided_binomial(worse, better)))
        for name, (worse, better) in counts.items()
    )


def shift_line(shift: Shift) -> str:
    """Returns the sentence about a measure of the runs that passed in both trials."""
    less, more = _NOUNS[shift.name]
    where = f"of {runs_text(shift.pairs)} that passed in both"
    if not shift.smaller and not shift.larger:
        return f"{where}, every one has the same {shift.name}"
    told = f"{where}, {shift.larger} got {more} and {shift.smaller} {less} (median {shift.median:+.2f} {shift.unit}, {100 * shift.share:+.1f} %)"
    verdict = "can be chance" if shift.is_chance else "is more than chance"
    return f"{told}: that {verdict} ({percent(shift.p)})"


def percent(p: float) -> str:
    """Returns a probability in percent, with one digit where it is small."""
    value = 100.0 * p
    return "less than 0.1 %" if value < 0.1 else f"{value:.1f} %" if value < 10.0 else f"{value:.0f} %"


def runs_text(count: int) -> str:
    """Returns a number of runs in words."""
    return "1 run" if count == 1 else f"{count} runs"


def _both_have(pair: Pair, name: str) -> bool:
    return name in pair.before.measures and name in pair.after.measures


def _key(run: RunSpec) -> tuple[Any, ...]:
    return run.number, run.scene, run.robot, run.start, run.goal, run.seed
