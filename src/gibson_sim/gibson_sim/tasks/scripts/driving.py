"""A scripted driver: plans a way, follows it, and backs off where it is stuck. Pure: a view goes in, speeds come out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.robots.path_tracking import PathFollower
from gibson_sim.tasks.episode import Action, Item, View, item_root
from gibson_sim.tasks.ground import Ground, footprint
from gibson_sim.types import Pose

STUCK_S = 2.5
"""Who went less than ``STUCK_M`` and turned less than ``STUCK_RAD`` in so many seconds is stuck."""
STUCK_M, STUCK_RAD = 0.08, 0.3
BACK_S, BACK_MOST_S = 1.5, 4.0
"""Seconds that a robot backs off at first, and at most: half a second more each time."""
PLAN_AGAIN_S = 5.0
"""So long a robot without a way waits before it looks for one again."""
_IN_FRONT_M = 0.35
"""Metres from the robot's rim to the middle of what it is stuck at, at most."""
_BACK_SPEED = -0.2
_LOOKAHEAD = 0.25


class Driver:
    """Drives to a place, round things where that can be, and else through them.

    Args:
        ground: where.
        goal: world x, y, metres.
        items: what may lie in the way.
        around: go round items where there is a way; False = as if they were not there.
        pushes: push what leaves no way round; False = stop there.
        obstacles: outlines (4, 2), world metres, that no way leads through.
        near: metres to the goal at which it is reached.
        max_linear: greatest speed, m/s.
    """

    def __init__(
        self,
        ground: Ground,
        goal: tuple[float, float],
        items: Sequence[Item] = (),
        *,
        around: bool = True,
        pushes: bool = True,
        obstacles: Sequence[NDArray[np.float64]] = (),
        near: float = 0.0,
        max_linear: float = 0.5,
    ) -> None:
        drive = ground.robot.drive
        assert drive is not None
        self._ground, self._goal, self._near = ground, goal, near
        self._obstacles = list(obstacles)
        self._models = {item_root(item): item.model for item in items}
        self._around, self._pushes = around, pushes
        self._speeds = (min(max_linear, drive.max_linear), min(1.2, drive.max_angular))
        self._follower: PathFollower | None = None
        self._back_until = -math.inf
        self._mark = (0.0, (math.inf, math.inf), 0.0)
        self._times_stuck = 0
        self._jammed: set[str] = set()
        """Root links of what did not give way."""
        self._plan_from = -math.inf
        self.blocked = False
        """Whether there is no way, and nothing may be pushed."""

    def done(self, view: View) -> bool:
        """Whether the goal is reached."""
        if self._near:
            return view.distance_to(self._goal) <= self._near
        return self._follower is not None and self._follower.done

    def act(self, view: View) -> Action:
        """Returns what to do next."""
        if self.done(view):
            return Action()
        if view.time < self._back_until:
            return Action(linear=_BACK_SPEED, angular=0.4 * (-1.0) ** self._times_stuck)
        if self._follower is None and view.time >= self._plan_from:
            self._plan(view)
            self._mark = (view.time, view.xy, view.yaw)
        if self._follower is None:
            return Action()
        if self._is_stuck(view):
            self._times_stuck += 1
            self._jammed |= self._in_front(view)
            self._back_until = view.time + min(BACK_S + 0.5 * self._times_stuck, BACK_MOST_S)
            self._follower = None
            return Action(linear=_BACK_SPEED)
        linear, angular = self._follower.command(*view.xy, view.yaw)
        return Action(linear, angular)

    def _is_stuck(self, view: View) -> bool:
        since, xy, yaw = self._mark
        turned = abs(math.remainder(view.yaw - yaw, 2.0 * math.pi))
        if math.dist(view.xy, xy) > STUCK_M or turned > STUCK_RAD:
            self._mark = (view.time, view.xy, view.yaw)
            return False
        return view.time - since > STUCK_S

    def _in_front(self, view: View) -> set[str]:
        """Returns the root links of what lies right in front of the robot."""
        found = set()
        for root in self._models:
            ahead, left = view.in_base(view.links[root].position)
            if 0.0 < ahead < self._ground.robot.radius + _IN_FRONT_M and abs(left) < self._ground.robot.radius + 0.1:
                found.add(root)
        return found

    def _plan(self, view: View) -> None:
        """Plans a way: round everything, else round what did not give way, else straight through."""
        every, jammed = set(self._models), set(self._jammed)
        attempts = [every] if self._around else []
        if self._pushes:
            attempts += [jammed, set()]
        for avoided in attempts:
            lying = [footprint(model, view.links[root]) for root, model in self._models.items() if root in avoided]
            try:
                path = self._ground.planner_around([*self._obstacles, *lying]).path(view.xy, self._goal)
            except SceneError:
                continue
            if not avoided:
                self._jammed.clear()
            if math.dist(view.xy, path[-1]) > 1e-3:
                self._follower = PathFollower([view.xy, *path[1:]], *self._speeds, _LOOKAHEAD)
                self.blocked = False
                return
        self.blocked, self._plan_from = True, view.time + PLAN_AGAIN_S


def turn_towards(view: View, yaw: float, fastest: float = 1.2) -> float:
    """Returns the yaw rate, rad/s, that turns the base to a heading, radians."""
    error = math.remainder(yaw - view.yaw, 2.0 * math.pi)
    return max(-fastest, min(fastest, 2.5 * error))


def pose_xy(pose: Pose) -> tuple[float, float]:
    """Returns world x, y of a pose."""
    return pose.position[0], pose.position[1]
