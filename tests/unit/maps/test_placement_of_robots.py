"""Several robots in one scene: names, namespaces, places."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.maps.placement import place_robots, populate
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from support.scenes import write_house


@pytest.fixture(scope="module")
def flat() -> SceneSpec:
    return load_scene("flat")


def test_one_robot_has_no_namespace_and_plain_frames(flat: SceneSpec) -> None:
    (robot,) = place_robots(flat, "gibson_bot").robots
    assert (robot.namespace, robot.frame_prefix, robot.own_tf) == ("", "", False)
    assert (robot.cameras[0].name, robot.cameras[0].optical_frame) == ("camera", "camera_optical_frame")


def test_two_robots_have_each_a_namespace_and_transforms_of_their_own(flat: SceneSpec) -> None:
    left, right = place_robots(flat, "left=gibson_bot, right=gibson_bot").robots
    assert (left.name, left.namespace, left.frame_prefix, left.own_tf) == ("left", "left", "", True)
    assert (right.cameras[0].name, right.cameras[0].optical_frame) == ("right/camera", "camera_optical_frame")
    assert right.cameras[0].link == "right/camera_optical_frame"


def test_prefixed_robots_share_tf_under_frames_of_their_own(flat: SceneSpec) -> None:
    left, _ = place_robots(flat, "left=gibson_bot,right=gibson_bot", robot_tf="prefixed").robots
    assert (left.frame_prefix, left.own_tf, left.cameras[0].optical_frame) == ("left/", False, "left/camera_optical_frame")


def test_robots_without_a_start_stand_apart(flat: SceneSpec) -> None:
    robots = place_robots(flat, "a=gibson_bot,b=gibson_bot,c=gibson_bot").robots
    for i, one in enumerate(robots):
        for other in robots[:i]:
            assert math.dist(one.start.position[:2], other.start.position[:2]) >= 0.5 + 4 * one.radius


@pytest.mark.parametrize(("robots", "start"), [("gibson_bot", "above"), ("a=gibson_bot,b=gibson_bot", "above;below")])
def test_the_floor_of_the_scene_is_that_on_which_the_first_robot_starts(tmp_path: Path, robots: str, start: str) -> None:
    house = load_scene(write_house(tmp_path))
    placed = place_robots(house, robots, start)
    assert (house.floor_z, placed.floor_z, placed.floors) == (0.0, 3.0, (0.0, 3.0))
    assert place_robots(house, "gibson_bot").floor_z == 0.0


def test_starts_are_given_in_the_order_of_the_robots() -> None:
    left, right = populate("flat", "left=gibson_bot,right=gibson_bot", "1.0,4.7,0; 2.5,4.7,90").robots
    assert left.start.position[:2] == (1.0, 4.7)
    assert right.start.position[:2] == (2.5, 4.7)
    assert right.start.quat_xyzw[2] == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize(
    ("robots", "start", "words"),
    [
        ("a=gibson_bot,a=gibson_bot", "", "two robots are named 'a'"),
        ("a=gibson_bot,gibson_bot", "", "must be name=robot"),
        ("a=gibson_bot,b=gibson_bot", "1,2,3;4,5,6;7,8,9", "3 places for 2 robots"),
    ],
)
def test_invalid_placement_is_refused_with_a_reason(flat: SceneSpec, robots: str, start: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        place_robots(flat, robots, start)
