"""Drives to goals on a costmap: plans, follows the path, recovers, and reports the result. Independent of ROS."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gibson_examples.costmap import Costmap
from gibson_examples.errors import PlanError
from gibson_examples.geometry import F64, Pose2D, wrap_angle
from gibson_examples.planner import RoutePlanner
from gibson_examples.pure_pursuit import STOP, PurePursuit, PursuitSettings, Velocity, arc

logger = logging.getLogger(__name__)

State = Literal["idle", "driving", "recovering", "reached", "failed"]

BACK_SPEED = 0.12
"""Speed of backing up, m/s."""
BRAKING_S = 0.8
"""Time ahead in which a command must be free of collisions, seconds."""
DEVIATION = 0.35
"""Distance of the robot from its path from which it replans, metres."""
PATH_MARGIN = 0.01
"""A path with less clearance than the robot's radius plus this is blocked, metres."""
MAX_STEP_S = 0.2
"""Upper bound of the time between steps, seconds: longer if the simulation was paused."""


@dataclass(frozen=True, slots=True)
class NavigatorSettings:
    """Tolerances of a goal, and the recovery of a stuck robot."""

    goal_distance: float = 0.10
    """Metres."""
    goal_angle: float = math.radians(10.0)
    """Radians."""
    settle_s: float = 0.4
    """Time within both tolerances from which a goal is reached, seconds."""
    replan_s: float = 2.0
    """Period of checking the path, seconds."""
    stuck_s: float = 4.0
    """Time without progress from which the robot is stuck, seconds."""
    recoveries: int = 6
    """Recovery attempts before a goal fails."""


class Navigator:
    """Drives to one goal at a time. The caller passes the time, in seconds of any monotonic clock."""

    def __init__(
        self, costmap: Costmap, settings: NavigatorSettings | None = None, pursuit: PursuitSettings | None = None
    ) -> None:
        self._costmap = costmap
        self._settings = settings or NavigatorSettings()
        self._pursuit = pursuit or PursuitSettings()
        self._goal: Pose2D | None = None
        self._routes: RoutePlanner | None = None
        self._follower: PurePursuit | None = None
        self.state: State = "idle"
        self.reason = ""
        """Cause of the failure or of the recovery."""
        self._last_s = self._planned_s = self._progress_s = -math.inf
        self._progress_pose = Pose2D(0.0, 0.0, 0.0)
        self._recoveries = 0
        self._recovery: list[tuple[float, Velocity]] = []
        self._aligning = False
        self._there_s = 0.0

    @property
    def active(self) -> bool:
        """Whether the robot is driving or recovering."""
        return self.state in ("driving", "recovering")

    @property
    def path(self) -> F64:
        """(N, 2), map frame, metres; no points without a goal."""
        return np.zeros((0, 2)) if self._follower is None else self._follower.path

    def set_goal(self, goal: Pose2D) -> None:
        """Replaces the goal, a pose in the map frame."""
        self._goal, self._routes, self._follower = goal, None, None
        self.state, self.reason = "driving", ""
        self._recoveries, self._recovery, self._aligning, self._there_s = 0, [], False, 0.0
        self._last_s = self._planned_s = self._progress_s = -math.inf

    def step(self, pose: Pose2D, now_s: float) -> Velocity | None:
        """Returns the command at a pose in the map frame; None without an active goal."""
        dt = min(max(now_s - self._last_s, 0.0), MAX_STEP_S)
        self._last_s = now_s
        if self._goal is None or not self.active:
            return None
        if self.state == "recovering":
            return self._recover(pose, dt, now_s)
        if self._stuck(pose, now_s):
            return self._begin_recovery(f"no progress for {self._settings.stuck_s:g} s", pose, now_s)
        try:
            follower = self._plan(pose, now_s)
        except PlanError as error:
            self._routes = self._follower = None
            return self._begin_recovery(str(error), pose, now_s)
        return self._follow(follower, self._goal, pose, dt)

    def _follow(self, follower: PurePursuit, goal: Pose2D, pose: Pose2D, dt: float) -> Velocity:
        end = follower.path[-1]
        distance = math.hypot(end[0] - pose.x, end[1] - pose.y)
        # Turning at the goal moves the robot a little: a larger tolerance keeps it from driving back.
        self._aligning = distance < self._settings.goal_distance * (2.0 if self._aligning else 1.0)
        if self._aligning:
            if abs(wrap_angle(goal.yaw - pose.yaw)) < self._settings.goal_angle:
                # Commands take effect late: the robot has arrived only if it stays there.
                self._there_s += dt
                if self._there_s >= self._settings.settle_s:
                    self.state = "reached"
                return STOP
            self._there_s = 0.0
            return follower.turn_to(goal.yaw, pose)
        clearance = float(self._costmap.clearance_at((pose.x, pose.y))) - self._costmap.settings.robot_radius
        command = self._without_collision(pose, follower.command(pose, clearance, dt))
        follower.limit(command.linear)
        return command

    def _plan(self, pose: Pose2D, now_s: float) -> PurePursuit:
        """Returns the follower of the path; checks the path periodically, and replans if it is blocked or far from the robot."""
        assert self._goal is not None
        follower = self._follower
        if follower is not None and now_s - self._planned_s < self._settings.replan_s and follower.deviation(pose) < DEVIATION:
            return follower
        if follower is None or self._routes is None or self._blocked(follower):
            self._routes, follower = RoutePlanner(self._costmap, (self._goal.x, self._goal.y)), None
        if follower is None or follower.deviation(pose) >= DEVIATION:
            speed = self._follower.speed if self._follower else 0.0
            follower = PurePursuit(self._routes.path((pose.x, pose.y)), self._pursuit, speed)
        self._follower, self._planned_s = follower, now_s
        return follower

    def _blocked(self, follower: PurePursuit) -> bool:
        """Returns whether obstacles block the path ahead of the robot."""
        ahead = follower.ahead[3:]
        return bool((self._costmap.clearance_at(ahead) < self._costmap.settings.robot_radius + PATH_MARGIN).any())

    def _without_collision(self, pose: Pose2D, requested: Velocity) -> Velocity:
        """Returns the requested velocity, slowed down, or without its linear part, to avoid a collision."""
        if requested.linear == 0.0:
            return requested
        here = float(self._costmap.clearance_at((pose.x, pose.y)))
        # A robot that is too near already may drive if this leads away.
        enough = min(self._costmap.settings.robot_radius, here - 0.01)
        for scale in (1.0, 0.6, 0.3):
            command = Velocity(scale * requested.linear, scale * requested.angular)
            if float(self._costmap.clearance_at(arc(pose, command, BRAKING_S, 8)).min()) >= enough:
                return command
        self._planned_s = min(self._planned_s, self._last_s - self._settings.replan_s + 0.5)
        return Velocity(0.0, requested.angular)

    def _stuck(self, pose: Pose2D, now_s: float) -> bool:
        """Returns whether the robot has made no progress for too long."""
        moved = pose.distance(self._progress_pose) > 0.1 or abs(wrap_angle(pose.yaw - self._progress_pose.yaw)) > 0.3
        if moved or self._progress_s == -math.inf or now_s < self._progress_s:
            self._progress_pose, self._progress_s = pose, now_s
        return now_s - self._progress_s > self._settings.stuck_s

    def _begin_recovery(self, reason: str, pose: Pose2D, now_s: float) -> Velocity:
        """Backs up, then turns, to alternating sides; fails after too many attempts."""
        self.reason = reason
        self._recoveries += 1
        if self._recoveries > self._settings.recoveries:
            self.state = "failed"
            return STOP
        logger.info("recovery %d of %d: %s", self._recoveries, self._settings.recoveries, reason)
        self.state = "recovering"
        side = 0.8 if self._recoveries % 2 else -0.8
        self._recovery = [(1.5, Velocity(-BACK_SPEED, 0.0)), (2.0, Velocity(0.0, side))]
        return self._recover(pose, 0.0, now_s)

    def _recover(self, pose: Pose2D, dt: float, now_s: float) -> Velocity:
        """Continues the recovery; replans at its end."""
        remaining, command = self._recovery[0]
        self._recovery[0] = (remaining - dt, command)
        if remaining - dt <= 0.0 or (command.linear < 0.0 and self._without_collision(pose, command).linear == 0.0):
            self._recovery.pop(0)
        if self._recovery:
            return self._recovery[0][1]
        self._costmap.forget_obstacles()
        self._routes = self._follower = None
        self.state, self._progress_s, self._planned_s = "driving", -math.inf, -math.inf
        return STOP
