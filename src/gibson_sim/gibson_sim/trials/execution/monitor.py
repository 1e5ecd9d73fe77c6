"""Decides when a run ends, from the stack's reports, the true pose and the limits. The trial node calls it at each tick.

A report of the stack has no stamp and can arrive one tick earlier or later. A run therefore never ends at the tick of the report, but at the
next multiple of half a second at which the robot stands still, so that equal runs end at equal ticks.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gibson_sim.quoting import clipped
from gibson_sim.trials.execution.trial_node import TrialInput
from gibson_sim.trials.records import End, PlanarPose
from gibson_sim.types import NS_PER_S

STILL_M_PER_S, STILL_RAD_PER_S = 0.01, 0.02
"""Speeds below which a robot stands still, m/s and rad/s."""
STILL_NS = NS_PER_S
"""Time for which the robot must stand still, ns of simulation time."""
PATIENCE_NS = 5 * NS_PER_S
"""Time after the stack's report of its end at which the run ends even if the robot moves, ns of simulation time."""
_GRID_NS = NS_PER_S // 2
_TEXT = 200
"""Largest length of a quoted report, characters."""
MAX_STATUS = 2000
"""Largest kept length of a status text, characters: it is stored in the files of the run and of the trial."""


@dataclass(frozen=True, slots=True)
class Decision:
    """The end of a run."""

    end: End
    detail: str
    decided_ns: int
    """Stamp of the tick of the decision; the run may have continued."""


class RunMonitor:
    """Monitors a run after its goal was sent."""

    def __init__(self, given: TrialInput) -> None:
        self._input = given
        self._reached, self._failed = re.compile(given.status.reached), re.compile(given.status.failed)
        self.goal_ns = self.now_ns = -1
        """Stamps of the goal and of the latest tick, ns; -1 = none."""
        self.status = ""
        """Latest status text of the stack, at most ``MAX_STATUS`` characters of it, then a mark that says how many were cut."""
        self._reported: Decision | None = None
        self._still_since_ns: int | None = None
        self._distance = math.inf

    def give_goal(self, stamp_ns: int) -> None:
        """Records that the goal was sent; earlier reports are discarded."""
        self.goal_ns, self._reported = stamp_ns, None

    def receive_status(self, text: str) -> None:
        """Handles a text on the status topic; the latest text that matches counts."""
        self.status = _bounded(text)
        detail = f"the stack reports {clipped(text, _TEXT)!r}"
        if self._failed.search(text):
            self._report("gave up", detail)
        elif self._reached.search(text):
            self._report("reached", detail)

    def receive_result(self, succeeded: bool, text: str) -> None:
        """Handles the result of the action."""
        self.status = text
        self._report("reached" if succeeded else "gave up", f"the action {clipped(text, _TEXT)}")

    def tick(self, stamp_ns: int, pose: PlanarPose, speed: float, yaw_rate: float) -> Decision | None:
        """Returns the end of the run at a tick; None = the run continues.

        Args:
            stamp_ns: stamp of the tick.
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
        goal, run_ns = self._input.run.goal, stamp_ns - self.goal_ns
        self._distance = math.hypot(pose[0] - goal[0], pose[1] - goal[1])
        is_still = self._still_since_ns is not None and stamp_ns - self._still_since_ns >= STILL_NS
        if self._reported is not None:
            on_grid = before_ns >= 0 and run_ns // _GRID_NS > (before_ns - self.goal_ns) // _GRID_NS
            if (is_still and on_grid) or stamp_ns - self._reported.decided_ns >= PATIENCE_NS:
                return self._reported
        elif not self._input.stack_reports and is_still and self._is_at_goal(pose):
            since_ns = max(self.goal_ns, self._still_since_ns or 0)
            return Decision("reached", f"the robot stands {self._distance:.3f} m from the goal", since_ns)
        if run_ns >= self._input.limits.time * NS_PER_S:
            return self._reported or Decision("time limit", self._time_limit_text(run_ns), stamp_ns)
        return None

    def silence(self, waited_s: float) -> Decision | None:
        """Returns the end of the run if time has waited for the stack; None = the run continues.

        Args:
            waited_s: duration of the wait, seconds of wall time.
        """
        if self._reported is not None:
            return self._reported  # a stack without a goal need not send commands
        if waited_s < self._input.limits.silence:
            return None
        limit, at = self._input.limits.silence, max(self.now_ns, 0) / NS_PER_S
        topics = ", ".join(self._input.answers)
        return Decision("stack silent", f"no message on {topics} within {limit:g} s of wall time, at {at:.3f} s", self.now_ns)

    @property
    def end_was_reported(self) -> bool:
        """Whether the stack has reported its end."""
        return self._reported is not None

    @property
    def progress(self) -> str:
        """Progress of the run as text."""
        if self.goal_ns < 0:
            return "the goal has not been sent yet"
        away = f", {self._distance:.1f} m from the goal" if math.isfinite(self._distance) else ""
        return f"{(self.now_ns - self.goal_ns) / NS_PER_S:.1f} s{away}"

    def _report(self, end: End, detail: str) -> None:
        if self.goal_ns < 0:
            return
        stamp_ns = (
            self._reported.decided_ns
            if self._reported is not None and self._reported.end == end
            else max(self.now_ns, self.goal_ns)
        )
        self._reported = Decision(end, detail, stamp_ns)

    def _is_at_goal(self, pose: PlanarPose) -> bool:
        reached = self._input.reached
        if reached is None or self._distance > reached.within:
            return False
        yaw_error = math.remainder(pose[2] - self._input.run.goal[2], 2.0 * math.pi)
        return reached.yaw_within_deg is None or abs(yaw_error) <= math.radians(reached.yaw_within_deg)

    def _time_limit_text(self, run_ns: int) -> str:
        return f"{run_ns / NS_PER_S:g} s after the goal was sent, {self._distance:.2f} m from it; the limit is {self._input.limits.time:g} s"


def _bounded(text: str) -> str:
    """Returns a status text whose end is replaced by a mark if the text is too long."""
    cut = len(text) - MAX_STATUS
    return text if cut <= 0 else f"{text[:MAX_STATUS]} [... {cut} characters cut ...]"
