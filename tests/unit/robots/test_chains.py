"""Chains with mimic joints, and the limits that mimic joints set."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.urdf import UrdfModel, parse_urdf
from gibson_sim.errors import CommandError
from gibson_sim.robots.joints.kinematics import Chain


def model(follower_limits: tuple[float, float] = (-9.0, 9.0), multiplier: float = 2.0, offset: float = 0.1) -> UrdfModel:
    """An arm in the plane z = 0: a hinge, 1 m further one that turns twice as far plus 0.1 rad, and 0.5 m further its tip."""
    low, high = follower_limits
    text = f"""<robot name="r"><link name="base"/><link name="upper"/><link name="fore"/><link name="tip"/>
    <joint name="lead" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/><limit lower="-1" upper="1.5"/></joint>
    <joint name="follow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
    <limit lower="{low}" upper="{high}"/><mimic joint="lead" multiplier="{multiplier}" offset="{offset}"/></joint>
    <joint name="end" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0.5 0 0"/></joint></robot>"""
    return parse_urdf(text, Path("r.urdf"))


def place(lead: float) -> tuple[float, float]:
    """Returns the position of the tip, by hand."""
    second = lead + 2.0 * lead + 0.1
    return math.cos(lead) + 0.5 * math.cos(second), math.sin(lead) + 0.5 * math.sin(second)


def test_a_follower_is_where_its_leader_puts_it_and_is_no_joint_of_its_own() -> None:
    chain = Chain(model(), "tip")
    assert chain.names == ("lead",)
    assert chain.pose({"lead": 0.4, "follow": 99.0})[:2, 3] == pytest.approx(place(0.4))
    with pytest.raises(CommandError, match="joint 'follow' does not move link 'tip'; these do: lead"):
        Chain(model(), "tip", ("follow",))


def test_the_motion_of_a_leader_holds_that_of_its_follower() -> None:
    step = 1e-6
    _, jacobian = Chain(model(), "tip").jacobian({"lead": 0.4})
    slope = (np.array(place(0.4 + step)) - np.array(place(0.4 - step))) / (2 * step)
    assert jacobian[:, 0] == pytest.approx([*slope, 0.0, 0.0, 0.0, 3.0], abs=1e-8)


def test_a_target_is_reached_by_leader_and_follower_together() -> None:
    chain = Chain(model(), "tip")
    solution = chain.solve(chain.pose({"lead": 0.7}), {"lead": 0.0})
    assert solution.within(1e-6, 1e-6)
    assert solution.positions == pytest.approx((0.7,), abs=1e-6)


@pytest.mark.parametrize(
    ("limits", "multiplier", "highest"),
    [((-9.0, 9.0), 2.0, 1.5), ((-9.0, 1.1), 2.0, 0.5), ((-1.1, 9.0), -2.0, 0.6), ((20.0, 21.0), 2.0, 1.5), ((-9.0, 1.1), 0.0, 1.5)],
)  # fmt: skip
def test_a_leader_stops_where_its_follower_would_leave_its_limits(
    limits: tuple[float, float], multiplier: float, highest: float
) -> None:
    chain = Chain(model(limits, multiplier), "tip")
    beyond = Chain(model(multiplier=multiplier), "tip").pose({"lead": 1.5})
    solution = chain.solve(beyond, {"lead": 0.0})
    assert solution.positions[0] <= highest + 1e-9
    if highest == 1.5:
        assert solution.within(1e-6, 1e-6)


def test_a_finger_that_slides_moves_by_its_factor() -> None:
    text = """<robot name="r"><link name="base"/><link name="a"/><link name="b"/>
    <joint name="left" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/><limit lower="0" upper="0.1"/></joint>
    <joint name="right" type="prismatic"><parent link="base"/><child link="b"/><axis xyz="0 1 0"/><limit lower="-0.1" upper="0"/>
    <mimic joint="left" multiplier="-1"/></joint></robot>"""
    chain = Chain(parse_urdf(text, Path("r.urdf")), "b")
    assert chain.names == ("left",)
    assert chain.pose({"left": 0.04})[1, 3] == pytest.approx(-0.04)
    assert chain.jacobian({"left": 0.04})[1][:, 0].tolist() == [0.0, -1.0, 0.0, 0.0, 0.0, 0.0]
