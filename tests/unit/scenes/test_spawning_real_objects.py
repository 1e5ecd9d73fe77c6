"""Third-party objects, furniture and robots can be spawned, with their masses and joints."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.scenes.spawning import SpawnError, SpawnFailure, find_spawnables, load_spawnable, spawn_name
from gibson_sim.scenes.worlds import WorldError, WorldFailure, find_worlds, load_world
from gibson_sim.types import Pose


def _body(uri: Path | str, text: str = "") -> BodySpec:
    body = load_spawnable(str(uri), text, name="thing", pose=Pose())
    assert isinstance(body, BodySpec)
    return body


def _code(uri: Path) -> SpawnFailure:
    with pytest.raises(SpawnError) as caught:
        _body(uri)
    return caught.value.code


@pytest.mark.parametrize(
    ("folder", "name", "mass"),
    [
        ("010_potted_meat_can", "potted_meat_can", 0.026),
        ("011_banana", "banana", 0.068),
        ("025_mug", "mug", 0.102),
        ("061_foam_brick", "foam_brick", 0.03),
    ],
)
def test_scanned_object_has_its_mass_and_size(data_dir: Path, folder: str, name: str, mass: float) -> None:
    path = data_dir / "isaacgym_ycb" / "assets" / "urdf" / "ycb" / folder
    body = _body(path)
    (link,) = body.model.links
    assert link.inertial is not None
    assert (spawn_name(str(path), ""), body.semantic_class, link.inertial.mass) == (name, name, mass)
    shape = link.visuals[0].shape
    size = load_mesh(Path(shape.mesh), (data_dir,)).bounds @ np.diag(shape.size)
    # Hand-sized: the files are in centimetres and the URDF scales them.
    assert 0.05 < float((size[1] - size[0]).max()) < 0.25


def test_cabinet_has_two_doors_and_two_drawers(data_dir: Path) -> None:
    body = _body(data_dir / "isaacgym_sektion_cabinet/assets/urdf/sektion_cabinet_model/urdf/sektion_cabinet_2.urdf")
    kinds = [joint.kind for joint in body.model.joints]
    assert (kinds.count("revolute"), kinds.count("prismatic"), kinds.count("fixed")) == (2, 2, 4)
    assert len(body.model.links) == 9
    assert body.model.root == "sektion"
    moved = {joint.child for joint in body.model.joints if joint.kind != "fixed"}
    assert moved == {"drawer_top", "drawer_bottom", "door_left_link", "door_right_link"}
    assert all(link.collisions for link in body.model.links)


@pytest.mark.parametrize(
    ("model", "mass", "static", "semantic_class"),
    [
        ("aws_robomaker_residential_Ball_01", 0.12, False, "ball"),
        ("aws_robomaker_residential_Bed_01", 22.6, True, "bed"),
        ("aws_robomaker_residential_ChairA_01", 7.5, False, "chair"),
        ("aws_robomaker_residential_Trash_01", 0.1, False, "trash"),
    ],
)
def test_furniture_of_a_house(data_dir: Path, model: str, mass: float, static: bool, semantic_class: str) -> None:
    body = _body(data_dir / "aws_small_house" / "models" / model)
    (link,) = body.model.links
    assert link.name == "link"
    assert link.inertial is not None
    assert (link.inertial.mass, body.static, body.semantic_class) == (mass, static, semantic_class)
    assert link.visuals
    assert link.collisions


def test_ball_has_the_inertia_and_friction_of_its_file(data_dir: Path) -> None:
    (link,) = _body(data_dir / "aws_small_house/models/aws_robomaker_residential_Ball_01").model.links
    assert link.inertial is not None
    assert link.inertial.inertia == (0.030752, 0.0, 0.0, 0.030752, 0.0, 0.030752)
    assert link.friction == 0.85
    assert (link.collisions[0].shape.kind, link.collisions[0].shape.size[0]) == ("sphere", 0.31)


def test_carpet_without_its_texture_names_it(data_dir: Path) -> None:
    with pytest.raises(SpawnError, match=r"aws_Carpet_01\.png") as caught:
        _body(data_dir / "aws_small_house/models/aws_robomaker_residential_Carpet_01")
    assert caught.value.code is SpawnFailure.MISSING_ASSETS


def test_furniture_without_collisions_collides_as_it_is_drawn(data_dir: Path) -> None:
    body = _body(data_dir / "drake_living_room" / "models" / "sofa.sdf")
    (link,) = body.model.links
    assert [c.shape for c in link.collisions] == [v.shape for v in link.visuals]


def test_bare_sofa_mesh_is_a_heavy_rigid_body(data_dir: Path) -> None:
    body = _body(data_dir / "drake_living_room" / "models" / "assets" / "sofa_03_1k.gltf")
    inertial = body.model.links[0].inertial
    assert inertial is not None
    assert inertial.mass == 100.0
    # It stands on its origin, z up.
    assert 0.2 < inertial.pose.position[2] < 0.7


def test_turtlebot_urdf_has_its_links(data_dir: Path) -> None:
    body = _body(data_dir / "nav2_minimal_tb3_tb4/nav2_minimal_tb3_sim/urdf/turtlebot3_waffle.urdf")
    assert body.model.root == "base_footprint"
    assert {"base_link", "wheel_left_link", "wheel_right_link", "base_scan", "imu_link"} <= set(body.links)
    assert [j.name for j in body.model.joints if j.kind != "fixed"] == ["wheel_left_joint", "wheel_right_joint"]


def test_turtlebot_sdf_has_its_mass_and_wheels(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = data_dir / "nav2_minimal_tb3_tb4"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(folder))
    text = (folder / "nav2_minimal_tb3_sim" / "urdf" / "gz_waffle.sdf.xacro").read_text()
    # The effect of xacro on this file: the argument is removed, and its value is empty.
    text = re.sub(r"<xacro:arg[^>]*/>", "", text).replace("$(arg namespace)", "")
    body = _body("", text)
    masses = [link.inertial.mass for link in body.model.links if link.inertial is not None]
    assert sum(masses) == pytest.approx(1.0 + 0.125 + 2 * 0.1 + 2 * 0.001 + 0.035)
    # A joint beside its link's origin gets a link of its own.
    at = body.model.transforms()["wheel_left_joint_axis"]
    np.testing.assert_allclose(at[:3, 3], [0.0, 0.144, 0.023], atol=1e-9)
    joint = body.model.joint("wheel_left_joint")
    assert joint.kind == "continuous"
    # Its axis, z rotated by -1.57 about x, is y of the robot.
    np.testing.assert_allclose(at[:3, :3] @ joint.axis, [0.0, 1.0, 0.0], atol=1e-3)
    assert any("'ball'" in warning for warning in body.model.warnings)


def test_xacro_of_a_robot_is_refused_with_advice(data_dir: Path) -> None:
    folder = data_dir / "locobot/interbotix_ros_xslocobots/interbotix_xslocobot_descriptions"
    assert _code(folder / "urdf" / "locobot.urdf.xacro") is SpawnFailure.UNSUPPORTED_FORMAT


def test_part_of_a_robot_is_a_rigid_body(data_dir: Path) -> None:
    folder = data_dir / "locobot/interbotix_ros_xslocobots/interbotix_xslocobot_descriptions/meshes/locobot_meshes"
    inertial = _body(folder / "locobot_lidar.stl").model.links[0].inertial
    assert inertial is not None
    assert 0.01 <= inertial.mass <= 100.0


def test_models_of_the_house_are_listed_once_each(data_dir: Path) -> None:
    folder = data_dir / "aws_small_house" / "models"
    found = [s.uri for s in find_spawnables([str(folder)]) if s.uri.startswith("file:")]
    assert found == sorted(path.as_uri() for path in folder.iterdir() if path.is_dir())


def test_third_party_worlds_are_listed(data_dir: Path) -> None:
    found = {w.name: w.tags for w in find_worlds([str(data_dir)]) if w.uri.startswith("file:")}
    assert {"small_house", "furnished_living_room", "vr-gallery"} <= set(found)
    assert not [name for name in found if name.startswith(("aws_", "locobot_"))]


def test_missing_assets_of_the_house_are_named_unless_ignored(data_dir: Path) -> None:
    uri = str(data_dir / "aws_small_house")
    with pytest.raises(WorldError) as caught:
        load_world(uri, "")
    assert caught.value.code is WorldFailure.MISSING_ASSETS
    for name in ("aws_Carpet_01.png", "PortraitA_01", "PortraitB_02"):
        assert name in str(caught.value)
    assert len(load_world(uri, "", ignore_missing=True).visuals) > 60
