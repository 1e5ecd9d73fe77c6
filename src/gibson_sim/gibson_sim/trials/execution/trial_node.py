"""What supervisor and trial node (``ros/trials/trial_node.py``) exchange through files in the job's folder: its input and its report."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from gibson_sim.trials.records import RunSpec
from gibson_sim.trials.scenario.spec import GoalInterface, InitialPose, Limits, Reached, Ready, Scenario, Status
from gibson_sim.types import NS_PER_S

INPUT, REPORT, PROGRESS, CLOCK, IMAGES = "trial_input.json", "trial.json", "progress", "clock", "images"
"""Files in the folder of the job: input of the trial node; its report; progress of the run as text; latest stamp, ns; empty file that exists
if images have subscribers."""
MARKER = "GIBSON_SIM_TRIAL"
"""Environment variable that identifies a stack and its child processes: a text unique to the run."""
KEPT_NS = NS_PER_S // 2
"""Simulation time for a stack kept from an earlier run to detect the jump back in time, ns."""
TASK_GOAL = "task/goal"
"""Topic of the goal for ``task``."""


@dataclass(frozen=True, slots=True)
class TrialInput:
    """Input of the trial node: the run, the interface of its stack, and its limits."""

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
    def of(cls, scenario: Scenario, run: RunSpec, marker: str = "", *, kept: bool = False) -> TrialInput:
        """Returns the input for a run; a stack ``kept`` from an earlier run has no conditions to become ready."""
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
