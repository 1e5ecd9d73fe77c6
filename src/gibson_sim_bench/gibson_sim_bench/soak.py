"""Long runs: environment steps in this process, and a free-running simulation. Memory, rates and the number of files must stay constant.

Pure except for ``environment_steps``; ``gibson_sim_bench.cli.soak`` starts the free-running simulation. The report is plain text or Markdown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from gibson_sim.tasks.controls import Controls
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import CONTROL_HZ, TaskRun
from gibson_sim_bench.memory import drift, growth, open_files, resident_mb
from gibson_sim_bench.reports.render import table
from gibson_sim_bench.ros import without_nan
from gibson_sim_bench.timing import Facts

TASK = "point-goal"
ALLOWED_GROWTH_MB, ALLOWED_DRIFT, ALLOWED_FILES = 16.0, 0.1, 4
"""Limits of the change from the first to the last third after the warm-up: memory of a process, MB; rate, fraction; number of files."""


@dataclass(slots=True)
class Samples:
    """Time series of a running process."""

    seconds: list[float] = field(default_factory=list)
    """Wall time of each sample since the start, seconds."""
    values: dict[str, list[float]] = field(default_factory=dict)
    """Values by name; the names end with ``MB``, ``files`` or ``/s``."""

    def add(self, seconds: float, **values: float) -> None:
        """Adds a sample; every call has the same names, with ``_`` instead of spaces."""
        self.seconds.append(round(seconds, 2))
        for name, value in values.items():
            self.append(name.replace("_", " "), value)

    def append(self, name: str, value: float) -> None:
        """Appends one value."""
        self.values.setdefault(name, []).append(round(value, 3))

    def problems(self) -> list[str]:
        """Returns one line for each value that grew or drifted above its limit."""
        found = []
        for name, values in self.values.items():
            if name.endswith("MB") and growth(values) > ALLOWED_GROWTH_MB:
                found.append(f"{name}: {growth(values):+.1f}")
            if name.endswith("files") and growth(values) > ALLOWED_FILES:
                found.append(f"{name}: {growth(values):+.1f}")
            if name.endswith("/s") and abs(drift(values) - 1.0) > ALLOWED_DRIFT:
                found.append(f"{name}: {100 * (drift(values) - 1.0):+.0f} %")
        return found


@dataclass(frozen=True, slots=True)
class SoakReport:
    """The samples, with the machine."""

    facts: Facts
    steps: int
    """Environment steps in this process."""
    episodes: int
    environment: Samples
    seconds: float
    """Wall time of the free-running simulation, seconds."""
    images: int
    """Sets of RGB and depth that its subscriber received."""
    running: Samples

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types; NaN becomes null."""
        figures = []
        for part, samples in (("environment", self.environment), ("running", self.running)):
            for name, values in samples.values.items():
                unit = name.rpartition(" ")[2]
                better = "more" if unit == "/s" else "less"
                middle = float(np.median(values)) if values else 0.0
                figures.append({"name": f"{part}: {name}", "value": middle, "unit": unit, "better": better})
        found: dict[str, Any] = without_nan({"kind": "soak", **asdict(self), "problems": self.problems, "figures": figures})
        return found

    @property
    def problems(self) -> list[str]:
        """One line for each value that grew or drifted above its limit."""
        return [*self.environment.problems(), *self.running.problems()]


def report_of(read: dict[str, Any]) -> SoakReport:
    """Returns a report from its JSON."""
    names = ("steps", "episodes", "seconds", "images")
    return SoakReport(
        Facts(**read["facts"]),
        environment=Samples(**read["environment"]),
        running=Samples(**read["running"]),
        **{name: read[name] for name in names},
    )


def environment_steps(
    count: int, samples: int = 50, task: str = TASK, progress: Callable[[str], None] = lambda line: None
) -> tuple[Samples, int]:
    """Makes environment steps with random actions; returns the samples and the number of episodes.

    Args:
        count: number of steps, each 0.1 s of simulation time.
        samples: number of samples.
        task: name of the task.
        progress: called with one line of progress.
    """
    found, episodes = Samples(), 1
    rng = np.random.default_rng(0)
    began = time.perf_counter()
    with TaskRun(task_of(task)) as run:
        controls = Controls(run.robot, 1.0 / CONTROL_HZ)
        controls.begin(run.reset(0))
        block = max(1, count // samples)
        for first in range(0, count, block):
            steps, passed = min(block, count - first), 0.0
            for _ in range(steps):
                if run.over:
                    controls.begin(run.reset(episodes))
                    episodes += 1
                action = controls.action(rng.uniform(-1.0, 1.0, controls.size), run.observation)
                step_began = time.perf_counter()
                run.step(action)
                passed += time.perf_counter() - step_began
            values = {"environment_MB": resident_mb(), "open_files": open_files(), "environment_steps_/s": steps / passed}
            found.add(time.perf_counter() - began, **values)
            progress(f"{first + steps:,} steps, {values['environment_steps_/s']:,.0f}/s, {values['environment_MB']:.0f} MB")
    return found, episodes


def report_text(report: SoakReport, *, markdown: bool = False) -> str:
    """Returns the whole report."""
    lines = [
        report.facts.text,
        f"{report.steps:,} environment steps in {report.episodes:,} episodes; {report.seconds:,.0f} s free-running, "
        f"{report.images:,} sets of images received.",
        "Growth and drift: the last third relative to the first, after a quarter of warm-up.",
        "Above the limit: " + "; ".join(report.problems) + "."
        if report.problems
        else "No value grew or drifted above its limit.",
    ]
    head = ("quantity", "first sample", "last sample", "growth", "drift")
    rows = [*_rows(report.environment), *_rows(report.running)]
    return "\n".join(f"- {line}" if markdown else line for line in lines) + "\n\n" + table(head, rows, markdown)


def _rows(samples: Samples) -> Iterable[tuple[str, ...]]:
    for name, values in samples.values.items():
        rate = name.endswith("/s")
        grown = "" if rate else f"{growth(values):+.1f}"
        drifted = f"{100 * (drift(values) - 1.0):+.1f} %" if rate else ""
        yield name, f"{values[0]:,.1f}", f"{values[-1]:,.1f}", grown, drifted
