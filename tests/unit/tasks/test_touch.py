"""Directions of contacts with a robot in observations."""

from __future__ import annotations

import math

import pytest

from gibson_sim.tasks.metrics import touch_direction
from gibson_sim.types import Contact, Vec3


def _contact(normal: Vec3, force: float, other: str = "wall") -> Contact:
    return Contact("robot", "base", other, "", (0.0, 0.0, 0.0), normal, force)


def test_a_wall_in_the_north_is_ahead_of_a_robot_that_looks_north() -> None:
    # Normals point from the wall to the robot: southwards.
    north = _contact((0.0, -1.0, 0.0), 5.0)
    assert touch_direction("robot", [north], math.pi / 2.0) == pytest.approx((1.0, 0.0))
    assert touch_direction("robot", [north], 0.0) == pytest.approx((0.0, 1.0))


def test_stronger_touches_count_for_more() -> None:
    ahead, left = _contact((-1.0, 0.0, 0.0), 4.0), _contact((0.0, -1.0, 0.0), 3.0)
    assert touch_direction("robot", [ahead, left], 0.0) == pytest.approx((0.8, 0.6))


@pytest.mark.parametrize(
    "contact",
    [
        _contact((0.0, 0.0, 1.0), 9.0, "floor"),
        _contact((-1.0, 0.0, 0.0), 0.0),
        _contact((-1.0, 0.0, 0.0), 9.0, "mug"),
        _contact((-1.0, 0.0, 0.0), 9.0, "robot"),
    ],
    ids=["floor", "no force", "held", "itself"],
)
def test_floor_and_grasped_object_are_no_touches(contact: Contact) -> None:
    assert touch_direction("robot", [contact], 0.0, ("mug",)) == (0.0, 0.0)
