"""Statistics of runs: success rates with intervals, means, kinds of failure, and paired differences. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gibson_sim.tasks.metrics import wilson
from gibson_sim_bench.path_following.plan import GOGGLES, METHODS, parts_of
from gibson_sim_bench.path_following.runs import SUCCESS, RunResult
from gibson_sim_bench.ros import without_nan
from gibson_sim_learn.path_following.domains import DOMAINS

_Z95 = 1.959964
"""Standard deviations of a normal distribution within which 95 % lie."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Runs of one case, domain and method."""

    length: float
    """Metres."""
    domain: str
    method: str
    runs: int
    successes: int
    low: float
    """Lower end of the 95 % interval of the success rate (Wilson)."""
    high: float
    coverage: float
    """Mean."""
    collisions_per_metre: float
    """Of all runs together."""
    spl: float
    """Mean."""
    deviation: float
    """Mean of the runs' mean deviation, metres."""
    duration: float
    """Mean, seconds of simulation time."""
    seconds: float
    """Mean processor time."""
    kinds: dict[str, int] = field(default_factory=dict)
    """Number of runs by kind of failure."""
    paths: tuple[tuple[int, int], ...] = ()
    """Successes and runs of each path."""
    near_places: float = math.nan
    """Share of the estimated places that are at most one node from the true ones; NaN = there are none."""

    @property
    def rate(self) -> float:
        """Share of runs that succeeded."""
        return self.successes / self.runs


@dataclass(frozen=True, slots=True)
class Difference:
    """Success rate of one method minus that of another, over pairs of runs with the same seed."""

    length: float
    """Metres; NaN = all cases together."""
    domain: str
    method: str
    other: str
    pairs: int
    better: int
    """Pairs in which only ``method`` succeeded."""
    worse: int
    """Pairs in which only ``other`` did."""
    low: float
    high: float

    @property
    def value(self) -> float:
        """The difference."""
        return (self.better - self.worse) / self.pairs


@dataclass(frozen=True, slots=True)
class Table2:
    """The table, with the machine and the plan that it comes from."""

    date: str
    version: str
    machine: str
    cores: int
    plan: dict[str, Any]
    policy: str
    cells: tuple[Cell, ...]
    differences: tuple[Difference, ...]
    planned: int
    """Runs of the plan, made or not."""
    errors: tuple[str, ...] = ()
    goggles: str = ""
    """Digest of the network of ``+goggles``; empty = it is not in the plan."""

    @property
    def runs(self) -> int:
        """Runs that were made."""
        return sum(cell.runs for cell in self.cells)

    def as_json(self) -> dict[str, Any]:
        """Returns the table as JSON types; of the files of networks only the names, since it may be published."""
        names = {key: Path(self.plan[key]).name for key in ("model", "goggles") if self.plan.get(key)}
        values = {**asdict(self), "plan": {**self.plan, **names}}
        found: dict[str, Any] = without_nan({"kind": "table2", "called": "sim-to-sim", **values})
        return found


def cells_of(results: Iterable[RunResult]) -> tuple[Cell, ...]:
    """Returns a cell for each case, domain and method that has runs, in the order of cases, domains and methods."""
    groups: dict[tuple[float, str, str], list[RunResult]] = {}
    for result in results:
        groups.setdefault((result.key.length, result.key.domain, result.key.method), []).append(result)
    return tuple(_cell(key, groups[key]) for key in sorted(groups, key=_order))


def _order(key: tuple[float, str, str]) -> tuple[float, int, int, int]:
    base, goggles = parts_of(key[2])
    return key[0], list(DOMAINS).index(key[1]), list(METHODS).index(base), ["", *GOGGLES].index(goggles)


def _cell(key: tuple[float, str, str], found: Sequence[RunResult]) -> Cell:
    successes = sum(result.success for result in found)
    paths: dict[tuple[str, int], list[bool]] = {}
    for result in found:
        paths.setdefault((result.key.scene, result.key.path), []).append(result.success)
    driven = math.fsum(result.travelled for result in found)
    places = sum(result.places for result in found)
    kinds = Counter(result.kind for result in found if result.kind != SUCCESS)
    return Cell(
        *key,
        len(found),
        successes,
        *wilson(successes, len(found)),
        coverage=_mean([result.coverage for result in found]),
        collisions_per_metre=sum(result.collisions for result in found) / driven if driven else 0.0,
        spl=_mean([result.spl for result in found]),
        deviation=_mean([result.deviation_mean for result in found]),
        duration=_mean([result.duration for result in found]),
        seconds=_mean([result.seconds for result in found]),
        kinds=dict(sorted(kinds.items())),
        paths=tuple((sum(wins), len(wins)) for _, wins in sorted(paths.items())),
        near_places=sum(result.near_places for result in found) / places if places else math.nan,
    )


def differences_of(results: Iterable[RunResult], method: str, other: str) -> tuple[Difference, ...]:
    """Returns the paired differences of two methods, by case and domain, and for each domain over all cases."""
    wins: dict[tuple[float, str], dict[tuple[str, int, int], dict[str, bool]]] = {}
    for result in results:
        if result.key.method in (method, other):
            key = result.key
            pairs = wins.setdefault((key.length, key.domain), {})
            pairs.setdefault((key.scene, key.path, key.repeat), {})[key.method] = result.success
    found: list[Difference] = []
    totals: dict[str, list[int]] = {}
    for length, domain in sorted(wins, key=lambda key: (list(DOMAINS).index(key[1]), key[0])):
        both = [pair for pair in wins[length, domain].values() if len(pair) == 2]
        if not both:
            continue
        better = sum(pair[method] and not pair[other] for pair in both)
        worse = sum(pair[other] and not pair[method] for pair in both)
        found.append(
            Difference(length, domain, method, other, len(both), better, worse, *paired_interval(better, worse, len(both)))
        )
        total = totals.setdefault(domain, [0, 0, 0])
        for k, value in enumerate((len(both), better, worse)):
            total[k] += value
    for domain, (pairs_, better, worse) in totals.items():
        found.append(Difference(math.nan, domain, method, other, pairs_, better, worse, *paired_interval(better, worse, pairs_)))
    return tuple(found)


def paired_interval(better: int, worse: int, pairs: int) -> tuple[float, float]:
    """Returns the 95 % interval of a difference of paired rates (Wald's with half a pair added to each of the four kinds, Agresti and Min 2005).

    Args:
        better: pairs in which only the first succeeded.
        worse: pairs in which only the second did.
        pairs: all pairs, 1 or more.
    """
    n = pairs + 2.0
    middle = (better - worse) / n
    spread = _Z95 * math.sqrt(max(0.0, better + worse + 1.0 - (better - worse) ** 2 / n)) / n
    return max(-1.0, middle - spread), min(1.0, middle + spread)


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
