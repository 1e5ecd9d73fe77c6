"""A scripted driver: plans a path, follows it, and backs up when it is stuck. Pure: maps observations to speeds."""

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
"""Time without progress after which a robot counts as stuck, seconds."""
STUCK_M, STUCK_RAD = 0.08, 0.3
"""Motion, metres, and rotation, radians, that count as progress."""
BACK_S, BACK_MOST_S = 1.5, 4.0
"""Durations of the first and of the longest backing up, seconds; it increases by half a second each time."""
PLAN_AGAIN_S = 5.0
"""Time between planning attempts while no path exists, seconds."""
_IN_FRONT_M = 0.35
"""Largest distance from the robot's outline to the centre of an item at which it is stuck, metres."""
_BACK_SPEED = -0.2
_LOOKAHEAD = 0.25


class Driver:
    """Drives to a goal: around items if a path exists, else pushing through them.

    Args:
        ground: the floor and the robot.
        goal: world x, y, metres.
        items: movable items that may be obstacles.
        around: avoid items if a path exists; False = ignore them.
        pushes: push items that leave no path; False = stop in front of them.
        obstacles: outlines (4, 2), world frame, metres, that are always avoided.
        near: distance to the goal within which it is reached, metres; 0 = at the end of the path.
        max_linear: largest speed, m/s.
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
        """Root links of the items that could not be pushed."""
        self._plan_from = -math.inf
        self.blocked = False
        """Whether no path exists."""

    def done(self, obs: Observation) -> bool:
        """Returns whether the goal is reached."""
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
        """Returns the root links of the items directly in front of the robot."""
        roots = set()
        for root in self._models:
            ahead, left = obs.in_base(obs.links[root].position)
            if 0.0 < ahead < self._ground.robot.radius + _IN_FRONT_M and abs(left) < self._ground.robot.radius + 0.1:
                roots.add(root)
        return roots

    def _plan(self, obs: Observation) -> None:
        """Plans a path: around all items, else around those that could not be pushed, else through all items."""
        all_items, jammed = set(self._models), set(self._jammed)
        attempts = [all_items] if self._around else []
        if self._pushes:
            attempts += [jammed, set()]
        for avoided in attempts:
            footprints = [footprint(model, obs.links[root]) for root, model in self._models.items() if root in avoided]
            try:
                path = self._ground.space.with_obstacles([*self._obstacles, *footprints]).planner.path(obs.xy, self._goal)
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
    """Returns x, y of a pose, metres."""
    return pose.position[0], pose.position[1]
