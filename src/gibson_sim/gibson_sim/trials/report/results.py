"""The results of a whole trial: ``results.json``."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.tasks.metrics import wilson
from gibson_sim.trials.json_values import json_text
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.words import reason, robot_name, scene_name
from gibson_sim.trials.run_folder import RESULTS
from gibson_sim.types import NS_PER_S
from gibson_sim.writing import write_file

_FORMAT = 1
_MAX_BYTES = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Rate:
    """Pass rate: number of passed runs out of a number of runs."""

    passed: int
    count: int

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the rate (Wilson)."""
        return wilson(self.passed, self.count)

    def text(self) -> str:
        """Returns the rate with its interval as text."""
        if not self.count:
            return "no runs"
        low, high = self.interval
        return f"{self.passed} of {self.count} passed ({100 * self.passed / self.count:.0f} %; 95 % interval {100 * low:.0f} to {100 * high:.0f} %)"


@dataclass(frozen=True, slots=True)
class TrialResults:
    """Results of a trial."""

    name: str
    file: str
    """Scenario file as given."""
    results: tuple[RunResult, ...]
    """Results in the order of run numbers."""
    planned: int
    """Number of planned runs."""
    scenario: dict[str, Any] = field(default_factory=dict)
    """The scenario as JSON values."""
    versions: dict[str, str] = field(default_factory=dict)
    machine: dict[str, Any] = field(default_factory=dict)
    started: str = ""
    """Start time, ISO 8601, UTC."""
    wall_time: float = 0.0
    """Wall time of the trial, seconds."""
    workers: str = "1"
    """Number of worker processes, or the address of a cluster."""
    comparison: dict[str, Any] | None = None
    """Comparison with an earlier trial, see ``Comparison.to_json``; None = not compared."""
    source: str = field(default="", compare=False)
    """The file or folder that ``read_results`` read, as given; empty = none."""
    folder: Path | None = field(default=None, compare=False)
    """Folder of the trial, with the page, and the files of each run in ``runs``; None = the results are in no file."""

    @property
    def rate(self) -> Rate:
        """Pass rate of all runs."""
        return Rate(sum(result.passed for result in self.results), len(self.results))

    @property
    def failed(self) -> tuple[RunResult, ...]:
        """Runs that did not pass."""
        return tuple(result for result in self.results if not result.passed)

    @property
    def mode(self) -> str:
        """``lockstep``, ``real time``, or both."""
        is_lockstep = {result.outcome.lockstep for result in self.results}
        return " and ".join(name for name, value in (("lockstep", True), ("real time", False)) if value in is_lockstep)

    @property
    def is_complete(self) -> bool:
        """Whether all planned runs were executed."""
        return len(self.results) >= self.planned

    def to_rows(self) -> list[dict[str, Any]]:
        """Returns one flat mapping for each run, for a table such as ``pandas.DataFrame``: plan, verdict, cause, sampled values, measures.

        ``cause`` is the kind of the cause and ``reason`` a sentence; both are empty if the run passed. A measure that a run lacks is missing in
        its row. Metres, radians, seconds of simulation time.
        """
        return [
            {
                "run": result.run.number,
                "scene": scene_name(result.run.scene),
                "robot": robot_name(result.run.robot),
                "seed": result.run.seed,
                **{f"start_{axis}": value for axis, value in zip(("x", "y", "yaw"), result.run.start, strict=True)},
                **{f"goal_{axis}": value for axis, value in zip(("x", "y", "yaw"), result.run.goal, strict=True)},
                "shortest": result.run.shortest,
                "passed": result.passed,
                "end": result.outcome.end,
                "cause": result.cause.kind if result.cause else "",
                "reason": "" if result.passed else reason(result),
                **result.run.drawn,
                **result.measures,
            }
            for result in self.results
        ]

    def by(self, key: Callable[[RunResult], str]) -> dict[str, Rate]:
        """Returns the pass rates of groups of runs by key, in the order of their first run."""
        counts: Counter[str] = Counter(key(result) for result in self.results)
        passed: Counter[str] = Counter(key(result) for result in self.results if result.passed)
        return {name: Rate(passed[name], count) for name, count in counts.items()}

    def verdicts(self) -> dict[str, Rate]:
        """Returns the pass rate of each verdict over the runs judged by it."""
        by_name: dict[str, list[bool]] = {}
        for result in self.results:
            for verdict in result.verdicts:
                by_name.setdefault(verdict.name, []).append(verdict.passed)
        return {name: Rate(sum(passed), len(passed)) for name, passed in by_name.items()}

    def causes(self) -> dict[str, list[int]]:
        """Returns the numbers of the failed runs by kind of cause, the most frequent first."""
        by_kind: dict[str, list[int]] = {}
        for result in self.failed:
            by_kind.setdefault(result.cause.kind if result.cause else "unknown", []).append(result.run.number)
        return dict(sorted(by_kind.items(), key=lambda item: -len(item[1])))

    def totals(self) -> dict[str, Any]:
        """Returns a summary of the trial as JSON values."""
        rate, outcomes = self.rate, [result.outcome for result in self.results]
        low, high = rate.interval
        return {
            "planned": self.planned,
            "runs": rate.count,
            "passed": rate.passed,
            "failed": rate.count - rate.passed,
            "rate": rate.passed / rate.count if rate.count else None,
            "low": low,
            "high": high,
            "simulated_s": sum(max(outcome.end_ns, 0) for outcome in outcomes) / NS_PER_S,
            "start_up_s": sum(outcome.start_up_s for outcome in outcomes),
            "running_s": sum(outcome.running_s for outcome in outcomes),
            "ending_s": sum(outcome.ending_s for outcome in outcomes),
            "verdicts": {name: asdict(rate) for name, rate in self.verdicts().items()},
            "causes": self.causes(),
        }

    def to_json(self) -> dict[str, Any]:
        """Returns the results as JSON values."""
        return {
            "format": _FORMAT,
            "name": self.name,
            "file": self.file,
            "started": self.started,
            "wall_time": self.wall_time,
            "workers": self.workers,
            "complete": self.is_complete,
            "mode": self.mode,
            "totals": self.totals(),
            "comparison": self.comparison,
            "versions": self.versions,
            "machine": self.machine,
            "scenario": self.scenario,
            "results": [result.to_json() for result in self.results],
        }


def write_results(trial: TrialResults, folder: Path) -> Path:
    """Writes ``results.json`` into a folder; returns its path.

    Raises:
        WriteError: the file cannot be written.
    """
    path = folder / RESULTS
    write_file(path, json_text(trial.to_json()))
    return path


def read_results(path: Path) -> TrialResults:
    """Returns the results of an earlier trial.

    Args:
        path: the file, or the folder of the trial.

    Raises:
        ConfigError: the file cannot be read or does not hold results.
    """
    file = path / RESULTS if path.is_dir() else path
    try:
        values = json.loads(read_file(file, _MAX_BYTES))
        results = tuple(RunResult.from_json(item) for item in values["results"])
        return TrialResults(
            name=str(values["name"]),
            file=str(values["file"]),
            results=results,
            planned=int(values["totals"]["planned"]),
            scenario=dict(values["scenario"]),
            versions=dict(values["versions"]),
            machine=dict(values["machine"]),
            started=str(values["started"]),
            wall_time=float(values["wall_time"]),
            workers=str(values["workers"]),
            comparison=values["comparison"],
            source=str(path),
            folder=file.parent,
        )
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}; give the {RESULTS} of a trial, or its folder") from error
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise ConfigError(
            f"{file}: is not the {RESULTS} of a trial: {quoted(str(error) or type(error).__name__)}; give the file that "
            "`gibson-sim trial` wrote"
        ) from error
