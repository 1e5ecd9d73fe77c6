"""When a run ends: decided by what the stack tells, the true pose and the limits. Pure; the trial node feeds it tick by tick.

What a stack tells has no stamp, and reaches the judge at one tick or the next. Therefore a run never ends at the tick of that message, but at
the next whole half second of the run at which the robot stands still, so that equal runs end at equal ticks.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gibson_sim.quoting import clipped
from gibson_sim.trials.execution.plan import TrialPlan
from gibson_sim.trials.records import End, PlanarPose
from gibson_sim.types import NS_PER_S

STILL_M_PER_S, STILL_RAD_PER_S = 0.01, 0.02
"""Speeds below which a robot stands still, m/s and rad/s."""
STILL_NS = NS_PER_S
"""Time for which it must, ns of simulation time."""
PATIENCE_NS = 5 * NS_PER_S
"""Time after the stack told the end of its work at which the run ends although the robot moves, ns of simulation time."""
_GRID_NS = NS_PER_S // 2
_TEXT = 200
"""Characters quoted of what a stack tells."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The end of a run."""

    end: End
    detail: str
    decided_ns: int
    """Stamp of the tick at which it was decided, although the run went on."""


class RunMonitor:
    """Watches a run after its goal was given."""

    def __init__(self, plan: TrialPlan) -> None:
        self._plan = plan
        self._reached, self._failed = re.compile(plan.status.reached), re.compile(plan.status.failed)
        self.goal_ns = self.now_ns = -1
        """Stamps of the goal and of the newest tick, ns; -1 = none."""
        self.status = ""
        """Last text of the stack."""
        self._told: Decision | None = None
        self._still_since_ns: int | None = None
        self._distance = math.inf

    def give_goal(self, stamp_ns: int) -> None:
        """Notes that the goal was given; what was told before does not count."""
        self.goal_ns, self._told = stamp_ns, None

    def receive_status(self, text: str) -> None:
        """Handles a text on the status topic: the last one that matches counts."""
        self.status = text
        quote = f"the stack tells {clipped(text, _TEXT)!r}"
        if self._failed.search(text):
            self._tell("gave up", quote)
        elif self._reached.search(text):
            self._tell("reached", quote)

    def receive_result(self, succeeded: bool, text: str) -> None:
        """Handles the end of the action."""
        self.status = text
        self._tell("reached" if succeeded else "gave up", f"the action {clipped(text, _TEXT)}")

    def tick(self, stamp_ns: int, pose: PlanarPose, speed: float, yaw_rate: float) -> Decision | None:
        """Returns whether and how the run ends at a tick.

        Args:
            stamp_ns: of the tick.
            pose: true pose of the robot in the map frame.
            speed: true speed, m/s.
            yaw_rate: true yaw rate, rad/s.
        """
        before_ns, self.now_ns = self.now_ns, stamp_ns
        stands = speed < STILL_M_PER_S and abs(yaw_rate) < STILL_RAD_PER_S
        if not stands:
            self._still_since_ns = None
        elif self._still_since_ns is None:
            self._still_since_ns = stamp_ns
        if self.goal_ns < 0:
            return None
        goal, run_ns = self._plan.run.goal, stamp_ns - self.goal_ns
        self._distance = math.hypot(pose[0] - goal[0], pose[1] - goal[1])
        is_still = self._still_since_ns is not None and stamp_ns - self._still_since_ns >= STILL_NS
        if self._told is not None:
            on_grid = before_ns >= 0 and run_ns // _GRID_NS > (before_ns - self.goal_ns) // _GRID_NS
            if (is_still and on_grid) or stamp_ns - self._told.decided_ns >= PATIENCE_NS:
                return self._told
        elif not self._plan.stack_tells and is_still and self._is_at_goal(pose):
            since_ns = max(self.goal_ns, self._still_since_ns or 0)
            return Decision("reached", f"the robot stands {self._distance:.3f} m from the goal", since_ns)
        if run_ns >= self._plan.limits.time * NS_PER_S:
            return self._told or Decision("time limit", self._late(run_ns), stamp_ns)
        return None

    def silence(self, waited_s: float) -> Decision | None:
        """Returns how the run ends if time has waited for the stack.

        Args:
            waited_s: how long, seconds of wall time.
        """
        if self._told is not None:
            return self._told  # a stack without a goal may well send no commands
        if waited_s < self._plan.limits.silence:
            return None
        limit, at = self._plan.limits.silence, max(self.now_ns, 0) / NS_PER_S
        topics = ", ".join(self._plan.answers)
        return Decision("stack silent", f"no message on {topics} within {limit:g} s of wall time, at {at:.3f} s", self.now_ns)

    @property
    def was_told(self) -> bool:
        """Whether the stack has told the end of its work."""
        return self._told is not None

    @property
    def progress(self) -> str:
        """How far the run is, for a line of text."""
        if self.goal_ns < 0:
            return "the goal is not given yet"
        away = f", {self._distance:.1f} m from the goal" if math.isfinite(self._distance) else ""
        return f"{(self.now_ns - self.goal_ns) / NS_PER_S:.1f} s{away}"

    def _tell(self, end: End, detail: str) -> None:
        if self.goal_ns < 0:
            return
        stamp_ns = self._told.decided_ns if self._told is not None and self._told.end == end else max(self.now_ns, self.goal_ns)
        self._told = Decision(end, detail, stamp_ns)

    def _is_at_goal(self, pose: PlanarPose) -> bool:
        reached = self._plan.reached
        if reached is None or self._distance > reached.within:
            return False
        turned = math.remainder(pose[2] - self._plan.run.goal[2], 2.0 * math.pi)
        return reached.yaw_within_deg is None or abs(turned) <= math.radians(reached.yaw_within_deg)

    def _late(self, run_ns: int) -> str:
        return f"{run_ns / NS_PER_S:g} s after the goal was given, {self._distance:.2f} m from it; the limit is {self._plan.limits.time:g} s"
