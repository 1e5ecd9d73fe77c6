"""The folder of a table: its plan, its paths, and a line for each run, so that a call that was interrupted goes on where it ended."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.jobs.units import Backend, Unit, UnitResult, run_units
from gibson_sim.reading import is_file, read_file
from gibson_sim.writing import cannot_write, write_file
from gibson_sim_bench.path_following.plan import RunKey, Table2Plan, cases_of, keys_of, parts_of
from gibson_sim_bench.path_following.runs import UNIT, RunResult, case_of, goggles_digest, policy_digest, result_of
from gibson_sim_learn.path_following.cases import PathCase

PLAN, LINES = "plan.json", "runs"
_MAX_BYTES = 500_000_000
"""Largest file that is read."""


class Store:
    """A folder of runs.

    Args:
        folder: is made if it is not there.
        plan: what is to be run.

    Raises:
        GibsonSimError: the folder holds runs that cannot be compared with these, or cannot be written.
    """

    def __init__(self, folder: Path, plan: Table2Plan) -> None:
        self.folder, self.plan = folder, plan
        parts = {part for method in plan.methods for part in parts_of(method)}
        self.policy = policy_digest(plan.model) if "learned" in parts else ""
        """Digest of the network of ``learned``; empty = it is not in the plan."""
        self.goggles = goggles_digest(plan.goggles) if "goggles" in parts else ""
        """Digest of the Goggles; empty = they are not in the plan."""
        file = folder / PLAN
        if is_file(file):
            self.cases = _read_cases(file, plan)
        else:
            self.cases = ()
        missing = [length for length in plan.lengths if not any(case.length == length for case in self.cases)]
        if missing:
            drawn = [case for case in cases_of(plan) if case.length in missing]
            self.cases = (*self.cases, *drawn)
            try:
                (folder / LINES).mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise cannot_write(folder, error) from error
            write_file(file, json.dumps({**plan.identity(), "cases": [asdict(case) for case in self.cases]}, indent=1) + "\n")

    def results(self) -> dict[RunKey, RunResult]:
        """Returns the results of all runs of the plan that are there."""
        wanted = {key for keys in self._keys().values() for key in keys}
        found: dict[RunKey, RunResult] = {}
        for file in sorted((self.folder / LINES).glob("*.jsonl")):
            for line in read_file(file, _MAX_BYTES).decode("utf-8").split("\n"):
                values = _parsed(line)
                if values is not None:
                    result = result_of(values)
                    if result.key in wanted:
                        found[result.key] = result
        return found

    def case(self, key: RunKey) -> PathCase:
        """Returns the path of a run."""
        return next(c for c in self.cases if (c.scene, c.length, c.number) == (key.scene, key.length, key.path))

    def missing(self) -> dict[PathCase, list[RunKey]]:
        """Returns the runs that are not there yet, by their paths."""
        there = self.results()
        left = {case: [key for key in keys if key not in there] for case, keys in self._keys().items()}
        return {case: keys for case, keys in left.items() if keys}

    def run(self, backend: Backend, tell: Callable[[str], None] = lambda line: None) -> list[str]:
        """Makes the runs that are missing; returns one line for each path that failed.

        Raises:
            KeyboardInterrupt: Ctrl-C; what has been run is kept.
        """
        left = self.missing()
        total = sum(map(len, left.values()))
        done = 0

        def on_progress(_: str, text: str) -> None:
            nonlocal done
            done += 1
            if done % 10 == 0 or done == total:
                tell(f"{done} of {total} runs: {text}")

        errors: list[str] = []

        def on_result(result: UnitResult) -> None:
            if result.error:
                errors.append(f"{result.id}: {result.error}")

        # Only the lines stay: the folders of units are of no use afterwards.
        work = Path(tempfile.mkdtemp(prefix="gibson-sim-table2-"))
        try:
            run_units(
                [self._unit(case, keys) for case, keys in left.items()],
                backend,
                output=work,
                on_result=on_result,
                on_progress=on_progress,
            )
        finally:
            shutil.rmtree(work, ignore_errors=True)
        return errors

    def _unit(self, case: PathCase, keys: Sequence[RunKey]) -> Unit:
        name = f"{Path(case.scene).name}_{case.length:g}m_{case.number}"
        file = (self.folder / LINES / f"{name}.jsonl").absolute()
        _end_line(file)
        arguments = {
            "seed": self.plan.seed,
            "camera": self.plan.camera,
            "model": self.plan.model,
            "goggles": self.plan.goggles,
            "case": asdict(case),
            "keys": [asdict(key) for key in keys],
            "file": str(file),
        }
        return Unit(name, UNIT, arguments)

    def _keys(self) -> dict[PathCase, list[RunKey]]:
        return keys_of(self.plan, [case for case in self.cases if case.length in self.plan.lengths], self.policy, self.goggles)


def _end_line(file: Path) -> None:
    """Ends a line that broke off, so that the next one begins anew."""
    if not is_file(file):
        return
    try:
        with file.open("rb+") as lines:
            if lines.seek(0, 2) and (lines.seek(-1, 2), lines.read(1))[1] != b"\n":
                lines.write(b"\n")
    except OSError as error:
        raise cannot_write(file, error) from error


def _parsed(line: str) -> Any:
    """Returns the values of a line of JSON; None = it is empty, or broke off."""
    try:
        return json.loads(line)
    except ValueError:
        return None


def _read_cases(file: Path, plan: Table2Plan) -> tuple[PathCase, ...]:
    try:
        values = json.loads(read_file(file))
        cases = tuple(case_of(case) for case in values.pop("cases"))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{file}: is no plan of a table: {error}; choose another folder") from error
    for key, wanted in plan.identity().items():
        if values.get(key) != wanted:
            raise ConfigError(
                f"{file}: {key} is {values.get(key)!r} in this folder, and {wanted!r} is asked for; choose another folder"
            )
    return cases
