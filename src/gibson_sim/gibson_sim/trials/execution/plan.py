"""What the trial node is told: a run, how its stack is spoken to, and when the run ends. JSON in the job's folder, and so is its answer."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from gibson_sim.trials.records import RunSpec
from gibson_sim.trials.scenario_spec import GoalInterface, InitialPose, Limits, Reached, Ready, Scenario, Status
from gibson_sim.types import NS_PER_S

PLAN, REPORT, PROGRESS, CLOCK, IMAGES = "plan.json", "trial.json", "progress", "clock", "images"
"""Files in the folder of the job: for the trial node; its report; how far the run is, as text; its newest stamp, ns; that images have
subscribers, empty."""
MARKER = "GIBSON_SIM_TRIAL"
"""Environment variable of a stack and of all processes that it starts: a text that no other run has."""
KEPT_NS = NS_PER_S // 2
"""Simulation time in which a stack that was kept over runs notices that time began again, ns."""
TASK_GOAL = "task/goal"
"""Topic of the goal where it is given as for tasks."""


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """What the trial node needs of scenario and run."""

    run: RunSpec
    ready: Ready
    initial_pose: InitialPose
    goal: GoalInterface
    status: Status
    limits: Limits
    reached: Reached | None
    lockstep: bool
    answers: tuple[str, ...]
    """Topics of the rules of lockstep, on which the stack answers."""
    marker: str = ""
    """Value of the variable ``MARKER`` of the stack's processes; empty = they have none."""
    goal_from_ns: int = 0
    """Stamp before which neither initial pose nor goal are given, ns."""

    @classmethod
    def of(cls, scenario: Scenario, run: RunSpec, marker: str = "", *, kept: bool = False) -> TrialPlan:
        """Returns the plan of a run whose stack has a marker; one that was kept from an earlier run has been ready already."""
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
            answers,
            marker,
            KEPT_NS if kept else 0,
        )

    def to_json(self) -> str:
        """Returns the plan as text."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> TrialPlan:
        """Returns the plan that ``to_json`` returned."""
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
            tuple(values["answers"]),
            values["marker"],
            values["goal_from_ns"],
        )

    @property
    def goal_topic(self) -> str:
        """Topic of the goal; empty = it is an action or a service."""
        return {"topic": self.goal.name, "task": TASK_GOAL}.get(self.goal.kind, "")

    @property
    def stack_tells(self) -> bool:
        """Whether the stack tells how it fares; else the true pose alone decides."""
        return bool(self.status.topic) or self.goal.kind == "action"


@dataclass(slots=True)
class TrialReport:
    """What the trial node saw; times of CLOCK_MONOTONIC, seconds, which all processes share."""

    end: str = ""
    """How the run ended; empty = the node was ended."""
    detail: str = ""
    goal_ns: int = -1
    decided_ns: int = -1
    end_ns: int = -1
    status: str = ""
    began_s: float = 0.0
    """When the first tick arrived; 0 = none did."""
    ended_s: float = 0.0
    """When the last tick arrived."""

    def to_json(self) -> dict[str, Any]:
        """Returns it as values of JSON."""
        return asdict(self)
