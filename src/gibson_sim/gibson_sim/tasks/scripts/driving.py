"""A scripted driver: plans a path, follows it, and backs off where it is stuck. Pure: an observation goes in, speeds come out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.robots.path_tracking import PathFollower
from gibson_sim.tasks.episode import Action, Item, Observation, item_root
from gibson_sim.tasks.ground import Ground, footprint
from gibson_sim.types import Pose

STUCK_S = 2.5
"""Time after which a robot is stuck that moved less than ``STUCK_M`` and turned less than ``STUCK_RAD``, seconds."""
STUCK_M, STUCK_RAD = 0.08, 0.3
"""Metres and radians."""
BACK_S, BACK_MOST_S = 1.5, 4.0
"""Duration of the first and of the longest backing off, seconds: half a second more each time."""
PLAN_AGAIN_S = 5.0
"""Time between attempts to plan while there is no path, seconds."""
_IN_FRONT_M = 0.35
"""Greatest distance from the robot's rim to the centre of an item that it is stuck at, metres."""
_BACK_SPEED = -0.2
_LOOKAHEAD = 0.25


class Driver:
    """Drives to a place: around items where there is a path, else pushing through them.

    Args:
        ground: the floor and the robot.
        goal: world x, y, metres.
        items: movable items that may lie in the way.
        around: avoid items where there is a path; False = ignore them.
        pushes: push items that leave no path; False = stop there.
        obstacles: outlines (4, 2), world frame, metres, that are always avoided.
        near: distance to the goal within which it is reached, metres; 0 = at the end of the path.
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
        """Root links of the items that did not give way."""
        self._plan_from = -math.inf
        self.blocked = False
        """Whether there is no path."""

    def done(self, obs: Observation) -> bool:
        """Whether the goal is reached."""
        if self._near:
            return obs.distance_to(self._goal) <= self._near
        return self._follower is not None and self._follower.done

    def act(self, obs: Observation) -> Action:
        """Returns the next action."""
        if self.done(obs):
            return Action()
        if obs.time < self._back_until:
            return Action(linear=_BACK_SPEED, angular=0.4 * (-1.0) ** self._times_stuck)
        if self._follower is None and obs.time >= self._plan_from:
            self._plan(obs)
            self._mark = (obs.time, obs.xy, obs.yaw)
        if self._follower is None:
            return Action()
        if self._is_stuck(obs):
            self._times_stuck += 1
            self._jammed |= self._in_front(obs)
            self._back_until = obs.time + min(BACK_S + 0.5 * self._times_stuck, BACK_MOST_S)
            self._follower = None
            return Action(linear=_BACK_SPEED)
        linear, angular = self._follower.command(*obs.xy, obs.yaw)
        return Action(linear, angular)

    def _is_stuck(self, obs: Observation) -> bool:
        since, xy, yaw = self._mark
        turned = abs(math.remainder(obs.yaw - yaw, 2.0 * math.pi))
        if math.dist(obs.xy, xy) > STUCK_M or turned > STUCK_RAD:
            self._mark = (obs.time, obs.xy, obs.yaw)
            return False
        return obs.time - since > STUCK_S

    def _in_front(self, obs: Observation) -> set[str]:
        """Returns the root links of the items right in front of the robot."""
        found = set()
        for root in self._models:
            ahead, left = obs.in_base(obs.links[root].position)
            if 0.0 < ahead < self._ground.robot.radius + _IN_FRONT_M and abs(left) < self._ground.robot.radius + 0.1:
                found.add(root)
        return found

    def _plan(self, obs: Observation) -> None:
        """Plans a path: around all items, else around those that did not give way, else straight through."""
        every, jammed = set(self._models), set(self._jammed)
        attempts = [every] if self._around else []
        if self._pushes:
            attempts += [jammed, set()]
        for avoided in attempts:
            lying = [footprint(model, obs.links[root]) for root, model in self._models.items() if root in avoided]
            try:
                path = self._ground.planner_around([*self._obstacles, *lying]).path(obs.xy, self._goal)
            except SceneError:
                continue
            if not avoided:
                self._jammed.clear()
            if math.dist(obs.xy, path[-1]) > 1e-3:
                self._follower = PathFollower([obs.xy, *path[1:]], *self._speeds, _LOOKAHEAD)
                self.blocked = False
                return
        self.blocked, self._plan_from = True, obs.time + PLAN_AGAIN_S


def turn_towards(obs: Observation, yaw: float, fastest: float = 1.2) -> float:
    """Returns the yaw rate, rad/s, that turns the base to a heading ``yaw``, radians."""
    error = math.remainder(yaw - obs.yaw, 2.0 * math.pi)
    return max(-fastest, min(fastest, 2.5 * error))


def pose_xy(pose: Pose) -> tuple[float, float]:
    """Returns x, y of a pose."""
    return pose.position[0], pose.position[1]
