"""Input and report of the trial node, as JSON in the job's folder: the run, the interface of its stack and its limits; the run's end."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from gibson_sim.trials.records import RunSpec
from gibson_sim.trials.scenario_spec import GoalInterface, InitialPose, Limits, Reached, Ready, Scenario, Status
from gibson_sim.types import NS_PER_S

PLAN, REPORT, PROGRESS, CLOCK, IMAGES = "plan.json", "trial.json", "progress", "clock", "images"
"""Files in the folder of the job: input of the trial node; its report; progress of the run as text; latest stamp, ns; empty file that exists
if images have subscribers."""
MARKER = "GIBSON_SIM_TRIAL"
"""Environment variable that identifies a stack and its child processes: a text unique to the run."""
KEPT_NS = NS_PER_S // 2
"""Simulation time for a stack kept from an earlier run to detect the jump back in time, ns."""
TASK_GOAL = "task/goal"
"""Topic of the goal for ``task``."""


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """Input of the trial node from scenario and run."""

    run: RunSpec
    ready: Ready
    initial_pose: InitialPose
    goal: GoalInterface
    status: Status
    limits: Limits
    reached: Reached | None
    lockstep: bool
    allowed_calls: tuple[str, ...]
    """See ``StackSpec.allowed_calls``."""
    answers: tuple[str, ...]
    """Topics of the lockstep rules, on which the stack answers."""
    marker: str = ""
    """Value of the variable ``MARKER`` of the stack's processes; empty = none."""
    goal_from_ns: int = 0
    """Stamp before which neither initial pose nor goal is sent, ns."""

    @classmethod
    def of(cls, scenario: Scenario, run: RunSpec, marker: str = "", *, kept: bool = False) -> TrialPlan:
        """Returns the plan of a run; a stack ``kept`` from an earlier run has no conditions to become ready."""
        stack = scenario.stack
        answers = tuple(rule.partition("=")[2].split()[0] if "=" in rule else rule.split()[0] for rule in stack.lockstep)
        return cls(
            run,
            Ready(within=stack.ready.within) if kept else stack.ready,
            stack.initial_pose,
            stack.goal,
            stack.status,
            scenario.limits,
            scenario.verdicts.reached,
            bool(stack.lockstep),
            stack.allowed_calls,
            answers,
            marker,
            KEPT_NS if kept else 0,
        )

    def to_json(self) -> str:
        """Returns the plan as JSON text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> TrialPlan:
        """Restores a plan from the text that ``to_json`` returned."""
        values = json.loads(text)
        return cls(
            RunSpec.from_json(values["run"]),
            Ready(**values["ready"]),
            InitialPose(**values["initial_pose"]),
            GoalInterface(**values["goal"]),
            Status(**values["status"]),
            Limits(**values["limits"]),
            Reached(**values["reached"]) if values["reached"] else None,
            values["lockstep"],
            tuple(values["allowed_calls"]),
            tuple(values["answers"]),
            values["marker"],
            values["goal_from_ns"],
        )

    @property
    def goal_topic(self) -> str:
        """Topic of the goal; empty = the goal is sent by an action or a service."""
        return {"topic": self.goal.name, "task": TASK_GOAL}.get(self.goal.kind, "")

    @property
    def stack_reports(self) -> bool:
        """Whether the stack reports its status; otherwise the true pose alone decides."""
        return bool(self.status.topic) or self.goal.kind == "action"


@dataclass(slots=True)
class TrialReport:
    """Report of the trial node; ``_s`` times are CLOCK_MONOTONIC, seconds, shared by all processes."""

    end: str = ""
    """End of the run, see ``records.End``; empty = the node was ended."""
    detail: str = ""
    goal_ns: int = -1
    decided_ns: int = -1
    end_ns: int = -1
    status: str = ""
    callers: dict[str, list[str]] = field(default_factory=dict)
    """See ``records.Outcome.callers``."""
    time_calls: list[list[Any]] = field(default_factory=list)
    """See ``records.Outcome.time_calls``."""
    began_s: float = 0.0
    """Time of arrival of the first tick; 0 = none."""
    ended_s: float = 0.0
    """Time of arrival of the last tick."""

    def to_json(self) -> dict[str, Any]:
        """Returns the report as JSON values."""
        return asdict(self)
