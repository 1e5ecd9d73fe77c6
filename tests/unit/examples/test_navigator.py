"""From a goal to velocities, in closed loop with a robot that follows its commands exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from gibson_examples.costmap import Costmap, CostmapSettings
from gibson_examples.geometry import Pose2D
from gibson_examples.localisation import scan_points
from gibson_examples.navigator import Navigator
from gibson_examples.pure_pursuit import Velocity
from unit.examples.drawing import empty_room, grid_of, ranges_at

SETTINGS = CostmapSettings(robot_radius=0.18)
TWO_ROOMS = ["#" * 61, *["#" + "." * 29 + "#" + "." * 29 + "#"] * 28, *["#" + "." * 59 + "#"] * 10, "#" * 61]
"""6.1 m x 4 m, cells of 0.1 m: a wall at x = 3.0 to 3.1 with a doorway of 1 m at its lower end."""
DT = 0.05


@dataclass
class World:
    """A robot, what it is told and where it goes; ``frozen`` holds it."""

    navigator: Navigator
    pose: Pose2D
    frozen: bool = False
    now_s: float = 0.0
    commands: list[Velocity | None] = field(default_factory=list)
    poses: list[Pose2D] = field(default_factory=list)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.now_s += DT
            command = self.navigator.step(self.pose, self.now_s)
            self.commands.append(command)
            if command is not None and not self.frozen:
                self.pose = self.pose @ Pose2D(command.linear * DT, 0.0, command.angular * DT)
            self.poses.append(self.pose)


def in_room(pose: Pose2D, goal: Pose2D) -> World:
    world = World(Navigator(Costmap(empty_room(6.0, 6.0), SETTINGS)), pose)
    world.navigator.set_goal(goal)
    return world


def test_without_a_goal_it_commands_nothing() -> None:
    world = World(Navigator(Costmap(empty_room(6.0, 6.0), SETTINGS)), Pose2D(1.0, 1.0, 0.0))
    world.run(1.0)
    assert world.commands == [None] * 20
    assert world.navigator.state == "idle"


def test_robot_reaches_the_goal_and_its_heading_and_stops() -> None:
    world = in_room(Pose2D(1.0, 1.0, 2.0), Pose2D(4.5, 4.0, -math.pi / 2))
    world.run(30.0)
    assert world.navigator.state == "reached"
    assert math.hypot(world.pose.x - 4.5, world.pose.y - 4.0) < 0.12
    assert world.pose.yaw == pytest.approx(-math.pi / 2, abs=math.radians(10.0))
    sent = [c for c in world.commands if c is not None]
    assert sent[-1] == Velocity(0.0, 0.0)
    assert world.commands[-1] is None


def test_robot_goes_through_the_doorway_without_touching() -> None:
    costmap = Costmap(grid_of(*TWO_ROOMS), SETTINGS)
    world = World(Navigator(costmap), Pose2D(1.5, 3.0, 0.0))
    world.navigator.set_goal(Pose2D(4.5, 3.0, 0.0))
    world.run(40.0)
    assert world.navigator.state == "reached"
    assert costmap.clearance_at([(p.x, p.y) for p in world.poses]).min() > 0.18


def test_goal_in_a_wall_fails_with_the_reason() -> None:
    costmap = Costmap(grid_of(*TWO_ROOMS), SETTINGS)
    world = World(Navigator(costmap), Pose2D(1.5, 3.0, 0.0))
    world.navigator.set_goal(Pose2D(3.05, 3.0, 0.0))
    world.run(60.0)
    assert world.navigator.state == "failed"
    assert "too near to an obstacle" in world.navigator.reason
    assert world.commands[-1] is None


def test_robot_that_cannot_move_backs_up_and_looks_round() -> None:
    world = in_room(Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0))
    world.frozen = True
    world.run(4.5)
    assert world.navigator.state == "recovering"
    assert world.navigator.reason == "no progress for 4 s"
    backwards = world.commands[-1]
    assert backwards is not None
    assert backwards.linear < 0.0
    world.run(2.0)
    turning = world.commands[-1]
    assert turning is not None
    assert turning.linear == 0.0
    assert turning.angular != 0.0


def test_robot_that_is_freed_goes_on_to_the_goal() -> None:
    world = in_room(Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0))
    world.frozen = True
    world.run(5.0)
    world.frozen = False
    world.run(30.0)
    assert world.navigator.state == "reached"


def test_robot_that_stays_stuck_fails_in_the_end() -> None:
    world = in_room(Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0))
    world.frozen = True
    world.run(120.0)
    assert world.navigator.state == "failed"
    assert world.commands[-1] is None


def test_robot_does_not_back_into_what_is_behind_it() -> None:
    costmap = Costmap(empty_room(6.0, 6.0), SETTINGS)
    world = World(Navigator(costmap), Pose2D(0.27, 3.0, 0.0))
    world.navigator.set_goal(Pose2D(5.0, 3.0, 0.0))
    world.frozen = True
    world.run(4.5)
    world.frozen = False
    world.run(1.5)
    assert min(p.x for p in world.poses) > 0.18 + 0.05  # the radius, and the wall


def test_obstacle_that_appears_on_the_way_is_gone_round() -> None:
    grid = empty_room(6.0, 4.0)
    cells = grid.occupancy.copy()
    cells[36:44, 58:64] = 100  # a box about 3.05, 2.0
    real = type(grid)(grid.resolution, grid.origin, cells)
    costmap = Costmap(grid, SETTINGS)
    world = World(Navigator(costmap), Pose2D(1.0, 2.0, 0.0))
    world.navigator.set_goal(Pose2D(5.0, 2.0, 0.0))
    while world.navigator.active and world.now_s < 40.0:
        world.run(0.1)
        ranges = ranges_at(real, world.pose)
        ends, hits = scan_points(ranges.astype(np.float32), 0.0, 2 * math.pi / len(ranges), 0.1, 12.0)
        costmap.add_scan((world.pose.x, world.pose.y), world.pose.transform(ends), hits, world.now_s)
    assert world.navigator.state == "reached"
    assert Costmap(real, SETTINGS).clearance_at([(p.x, p.y) for p in world.poses]).min() > 0.18


def test_robot_that_turns_on_after_its_stop_has_not_arrived() -> None:
    world = in_room(Pose2D(3.0, 3.0, 0.0), Pose2D(3.0, 3.0, 0.0))
    world.run(0.2)
    assert world.commands[-1] == Velocity(0.0, 0.0)
    world.pose = Pose2D(3.0, 3.0, 0.6)
    world.run(0.3)
    assert world.navigator.state == "driving"
    world.run(3.0)
    assert world.navigator.state == "reached"
    assert world.pose.yaw == pytest.approx(0.0, abs=math.radians(10.0))


def test_new_goal_replaces_the_old_one() -> None:
    world = in_room(Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0))
    world.run(1.0)
    world.navigator.set_goal(Pose2D(1.0, 3.0, 0.0))
    world.run(30.0)
    assert world.navigator.state == "reached"
    assert world.pose.x == pytest.approx(1.0, abs=0.12)


def test_time_that_stands_still_does_not_make_the_robot_stuck() -> None:
    world = in_room(Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0))
    world.frozen = True
    for _ in range(1000):
        world.navigator.step(world.pose, 1.0)
    assert world.navigator.state == "driving"
