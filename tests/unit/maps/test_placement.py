"""Start poses of robots in a scene."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.placement import furnished_floor_map, populate, robot_floor_map, start_pose
from gibson_sim.maps.tour import plan_tour
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from support.scenes import write_room


@pytest.fixture
def room(tmp_path: Path) -> SceneSpec:
    """A room of 4 m x 4 m with the starts `middle` and `corner`, whose floor is 0.5 m up."""
    folder = write_room(tmp_path / "room")
    text = (folder / "scene.yaml").read_text()
    text = text.replace("ground_z: 0.0", "ground_z: 0.5").replace(
        "starts: [", "starts: [{name: corner, xy: [1, -1], yaw_deg: 90}, "
    )
    (folder / "scene.yaml").write_text(text)
    return load_scene(folder)


def _xyz_and_yaw(scene: SceneSpec, start: str) -> list[float]:
    matrix = matrix_from_pose(start_pose(scene, load_robot("gibson_bot"), start))
    return [*matrix[:3, 3].tolist(), math.degrees(math.atan2(matrix[1, 0], matrix[0, 0]))]


def test_named_start(room: SceneSpec) -> None:
    np.testing.assert_allclose(_xyz_and_yaw(room, "middle"), [0, 0, 0.5, 0], atol=1e-9)


def test_first_start_is_the_default(room: SceneSpec) -> None:
    np.testing.assert_allclose(_xyz_and_yaw(room, ""), [1, -1, 0.5, 90], atol=1e-9)


def test_three_numbers_are_metres_and_degrees_on_the_floor(room: SceneSpec) -> None:
    np.testing.assert_allclose(_xyz_and_yaw(room, "0.25,-1.5,-90"), [0.25, -1.5, 0.5, -90], atol=1e-9)


def test_without_starts_the_most_open_place_is_taken(room: SceneSpec) -> None:
    x, y, z, _ = _xyz_and_yaw(replace(room, starts=()), "")
    assert (x, y) == pytest.approx((0, 0), abs=0.1)
    assert z == pytest.approx(0.5)


@pytest.mark.parametrize("start", ["midle", "1,2", "1,2,3,4", "nan,0,0", "1,2,x"])
def test_other_start_is_refused_and_the_known_ones_are_named(room: SceneSpec, start: str) -> None:
    with pytest.raises(ConfigError, match=r"x,y,yaw_deg.*corner, middle"):
        _xyz_and_yaw(room, start)


def test_start_beyond_any_scene_is_refused(room: SceneSpec) -> None:
    with pytest.raises(ConfigError, match="start is '1e300,0,0', x and y must be -10000 to 10000 m"):
        _xyz_and_yaw(room, "1e300,0,0")


def test_start_that_is_nearly_a_known_one_is_answered_with_it(room: SceneSpec) -> None:
    with pytest.raises(ConfigError, match="did you mean 'middle'"):
        _xyz_and_yaw(room, "midle")


def test_populated_scene_holds_the_robot_at_its_start(tmp_path: Path) -> None:
    scene = populate(str(write_room(tmp_path)), "gibson_bot", "1,0.5,180")
    (robot,) = scene.robots
    assert robot.start.position == (1, 0.5, 0)
    np.testing.assert_allclose(matrix_from_pose(robot.start)[:3, 0], [-1, 0, 0], atol=1e-9)


def test_floor_map_of_a_robot_is_as_high_as_the_robot(tmp_path: Path) -> None:
    robot = load_robot("gibson_bot")
    bar = "  - {{name: bar, box: [0.2, 0.2, 0.02], pose: {{xyz: [0, 0, {:.3f}]}}}}\n"
    below = load_scene(write_room(tmp_path / "a", bar.format(robot.height - 0.05)))
    above = load_scene(write_room(tmp_path / "b", bar.format(robot.height + 0.05)))
    assert robot_floor_map(below, robot).clearance((0.0, 0.0)) == 0.0
    assert robot_floor_map(above, robot).clearance((0.0, 0.0)) > 1.0


@pytest.mark.parametrize("name", ["linden_flat", "mill_house", "corner_shop"])
def test_a_tour_keeps_clear_of_doors_and_chairs_where_they_stand(name: str) -> None:
    scene, robot = load_scene(name), load_robot("gibson_bot")
    bare, furnished = robot_floor_map(scene, robot), furnished_floor_map(scene, robot)
    assert (furnished.free & ~bare.free).sum() == 0
    assert bare.free.sum() > furnished.free.sum()
    x, y, _ = scene.starts[0].pose.position
    path = plan_tour(furnished, (x, y), robot.radius, 15.0)
    vertices, triangles = body_triangles(scene)
    low = vertices[triangles][(vertices[triangles][..., 2].min(axis=1) < scene.floor_z + robot.height)]
    corners = low[..., :2].reshape(-1, 2)
    nearest = min(float(np.linalg.norm(corners - point, axis=1).min()) for point in path)
    assert nearest > robot.radius - 0.05, f"a corner of something is {nearest:.2f} m from the middle of the way"
