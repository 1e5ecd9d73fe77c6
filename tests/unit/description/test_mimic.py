"""Mimic joints."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.description.urdf import UrdfModel, parse_urdf
from gibson_sim.description.urdf_model import Mimic, scaled_model
from gibson_sim.errors import RobotError


def model(*mimics: str, kind: str = "revolute") -> UrdfModel:
    """Joints j0, j1, ... on one root, each with a ``<mimic>`` or nothing."""
    links = "".join(f'<link name="l{i}"/>' for i in range(len(mimics)))
    joints = "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="root"/><child link="l{i}"/><axis xyz="0 0 1"/>'
        f'<limit lower="-1" upper="1" effort="1" velocity="1"/>{mimic}</joint>'
        for i, mimic in enumerate(mimics)
    )
    return parse_urdf(f'<robot name="r"><link name="root"/>{links}{joints}</robot>', Path("r.urdf"))


def follow(name: str, multiplier: float | None = None, offset: float | None = None) -> str:
    more = "" if multiplier is None else f' multiplier="{multiplier}"'
    return f'<mimic joint="{name}"{more}{"" if offset is None else f""" offset="{offset}" """}/>'


def test_a_mimic_has_multiplier_1_and_offset_0_by_default() -> None:
    assert model("", follow("j0")).joint("j1").mimic == Mimic("j0", 1.0, 0.0)
    assert model("", follow("j0", -2.0, 0.5)).joint("j1").mimic == Mimic("j0", -2.0, 0.5)


def test_a_follower_of_a_follower_follows_the_leader() -> None:
    # j2 = 3 j1 + 0.1 = 3 (2 j0 + 0.5) + 0.1
    found = model("", follow("j0", 2.0, 0.5), follow("j1", 3.0, 0.1)).joint("j2").mimic
    assert found is not None
    assert (found.leader, found.multiplier, found.offset) == ("j0", 6.0, pytest.approx(1.6))


def test_followers_have_no_motor_and_their_positions_follow() -> None:
    two = model("", follow("j0", -1.0, 0.2))
    assert [joint.has_motor for joint in two.joints] == [True, False]
    assert two.with_followers({"j0": 0.5}) == {"j0": 0.5, "j1": pytest.approx(-0.3)}
    assert two.with_followers({}) == {"j1": pytest.approx(0.2)}


@pytest.mark.parametrize(
    ("mimics", "words"),
    [
        ((follow("j1"), follow("j0")), "in a cycle"),
        ((follow("j0"),), "in a cycle"),
        (("", follow("jx")), "'j1' mimics 'jx', which is not a movable joint; movable joints: j0, j1"),
        (("", "<mimic/>"), "<mimic> names no joint"),
        (("", follow("j0", float("nan"))), "must be a finite number"),
    ],
)
def test_a_mimic_that_cannot_be_followed_is_refused(mimics: tuple[str, ...], words: str) -> None:
    with pytest.raises(RobotError) as error:
        model(*mimics)
    assert words in str(error.value)


def test_a_scaled_model_keeps_the_ratio_of_its_joints() -> None:
    slides = scaled_model(model("", follow("j0", -1.0, 0.02), kind="prismatic"), 2.0).joint("j1").mimic
    assert slides == Mimic("j0", -1.0, 0.04)
    text = '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
    text += '<joint name="turn" type="continuous"><parent link="a"/><child link="b"/></joint>'
    text += (
        '<joint name="slide" type="prismatic"><parent link="a"/><child link="c"/><mimic joint="turn" multiplier="0.1"/></joint>'
    )
    mixed = scaled_model(parse_urdf(text + "</robot>", Path("r.urdf")), 2.0).joint("slide").mimic
    assert mixed == Mimic("turn", 0.2, 0.0)
