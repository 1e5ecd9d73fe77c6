"""How far doors are open."""

from __future__ import annotations

import math

from gibson_sim.standard.openings import JointOpening, joint_openings


def values(position: float, lower: float, upper: float, velocity: float = 0.0) -> dict[str, float]:
    return {"position": position, "lower": lower, "upper": upper, "velocity": velocity}


def test_openings_are_fractions_of_the_range_from_the_closed_position() -> None:
    assert JointOpening(0.75, 0.0, 1.5, 0.0).opening == 0.5
    assert JointOpening(-0.5, -2.0, 0.0, 0.0).opening == 0.25, "it opens in the negative direction"
    assert JointOpening(0.3, 0.1, 0.5, 0.0).closed == 0.1
    assert JointOpening(0.0, -2.0, 0.0, 0.0).position_at(0.5) == -1.0


def test_a_joint_has_reached_an_opening_when_it_rests_there() -> None:
    assert JointOpening(1.49, 0.0, 1.5, 0.0).has_reached(1.0)
    assert not JointOpening(1.49, 0.0, 1.5, 0.5).has_reached(1.0)
    assert not JointOpening(1.4, 0.0, 1.5, 0.0).has_reached(1.0)


def test_handles_and_joints_without_limits_are_no_doors() -> None:
    joints = {
        "door/hinge": values(0.0, 0.0, 1.5),
        "door/handle": values(0.0, 0.0, 0.7),
        "fan/axle": {"position": 1.0, "velocity": 2.0},
        "fixed/joint": values(0.0, 0.0, 0.0),
        "lost/joint": values(math.nan, 0.0, 1.0),
    }
    assert list(joint_openings(joints.items())) == ["door/hinge"]
