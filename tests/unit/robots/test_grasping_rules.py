"""When a gripper grasps, what, and when it releases; what a collision is."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gibson_sim.description.urdf import UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.errors import ConfigError
from gibson_sim.robots.collision_count import CollisionCount, CollisionCounter
from gibson_sim.robots.joints.commands import JointCommand, JointEfforts, JointPositions, JointTrajectory, JointVelocities
from gibson_sim.robots.joints.grasping import Candidate, GraspSettings, best_candidate, gripper_move, hinge_of, release_reason
from gibson_sim.robots.spec import GripperSpec
from gibson_sim.types import Pose

CLAW = GripperSpec(("claw",), open=0.0, closed=0.8, max_effort=10.0)
"""A gripper that closes towards larger positions."""
AT = {"lift": 0.1, "claw": 0.4}
S = 1_000_000_000


@pytest.mark.parametrize(
    ("command", "move"),
    [
        (JointPositions((0.8,), ("claw",)), "closes"),
        (JointPositions((0.0,), ("claw",)), "opens"),
        (JointPositions((0.41,), ("claw",)), "stays"),
        (JointPositions((0.3,), ("lift",)), "stays"),
        (JointPositions((0.3, 0.7)), "closes"),
        (JointVelocities((0.1,), ("claw",)), "closes"),
        (JointVelocities((0.0,), ("claw",)), "stays"),
        (JointEfforts((-1.0,), ("claw",)), "opens"),
        (JointTrajectory(("claw",), ()), "stays"),
    ],
)
def test_command_closes_opens_or_neither(command: JointCommand, move: str) -> None:
    assert gripper_move(CLAW, command, AT) == move


@pytest.mark.parametrize(("at", "wanted", "move"), [(0.83, 0.8, "stays"), (-0.03, 0.0, "stays"), (0.83, 0.7, "opens")])
def test_a_finger_that_is_pressed_beyond_its_end_does_not_open_the_hand(at: float, wanted: float, move: str) -> None:
    assert gripper_move(CLAW, JointPositions((wanted,), ("claw",)), {"claw": at}) == move


def test_handles_come_first_then_what_is_nearest_then_the_name() -> None:
    door, knob, cup, jar = (
        Candidate("d", "leaf", 0.01),
        Candidate("d", "Door_Knob", 0.15),
        Candidate("cup", "c", 0.1),
        Candidate("a", "j", 0.1),
    )
    assert best_candidate([door, knob, cup], 0.2) == knob
    assert best_candidate([door, knob, cup], 0.15) == door
    assert best_candidate([cup, jar], 0.2) == jar
    assert best_candidate([cup], 0.1) is None


def test_hinge_of_a_lever_on_a_door_is_that_of_the_door() -> None:
    def joint(name: str, kind: str, parent: str, child: str) -> UrdfJoint:
        return UrdfJoint(name, kind, parent, child, Pose(), (0.0, 0.0, 1.0))

    joints = (
        joint("hinge", "revolute", "frame", "leaf"),
        joint("latch", "revolute", "leaf", "lever"),
        joint("slide", "prismatic", "frame", "drawer"),
    )
    model = UrdfModel("d", Path("/d"), tuple(UrdfLink(name) for name in ("frame", "leaf", "lever", "drawer")), joints)
    assert [hinge_of(model, link) for link in ("lever", "leaf", "drawer", "frame")] == ["hinge", "hinge", None, None]


def test_reasons_to_release() -> None:
    rules = GraspSettings(release_force=100.0, release_angle=math.radians(60.0))
    assert release_reason(rules, 100.0, math.radians(-59.9)) == ""
    assert release_reason(rules, 100.1, None) == "let go: 100 N is more than the set force, 100 N"
    assert release_reason(rules, 0.0, math.radians(-61.0)).startswith("let go: the door is 61.0 degrees open")
    never = GraspSettings(release_force=0.0, release_angle=0.0)
    assert release_reason(never, 1e6, 3.0) == ""


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mode": "magnetic"}, "grasp mode is 'magnetic', must be one of physical, assisted, sticky"),
        ({"distance": 0.0}, "grasp distance is 0.0 m, must be a finite number above 0"),
        ({"max_force": math.nan}, "grasp max_force is nan N"),
        ({"release_angle": -1.0}, "grasp release_angle is -1.0 rad, must be a finite number, 0 or more"),
    ],
)
def test_impossible_rules_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        GraspSettings(**values)  # type: ignore[arg-type]


def test_touch_that_chatters_is_one_collision() -> None:
    counter, ms = CollisionCounter(), 1_000_000
    for now in (0, 10, 30, 130):
        counter.add_step(now * ms, {("arm", "wall"): float(now)})
        counter.add_step((now + 5) * ms, {})
    assert counter.total(100) == CollisionCount(1, 0, 0.04, 130.0, "arm", "wall")
    counter.add_step(300 * ms, {("arm", "wall"): 1.0, ("base", "chair"): 2.0})
    assert counter.total(100) == CollisionCount(3, 2, 0.05, 130.0, "base", "chair")
