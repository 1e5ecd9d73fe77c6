"""The list ``bodies`` of a scene.yaml: its movable objects."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gibson_sim.description.urdf import parse_urdf
from gibson_sim.description.urdf_model import scaled_model
from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from support.scenes import write_triangle_glb

CABINET = """
<robot name="cabinet">
  <link name="body">
    <inertial><mass value="8"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="cabinet.glb"/></geometry></visual>
    <collision><origin xyz="0 0 0.5"/><geometry><box size="0.4 0.4 1"/></geometry></collision>
  </link>
  <link name="door"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="drawer"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="door"/><origin xyz="0.2 0.2 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1.5707963" effort="1" velocity="1"/><dynamics damping="0.5" friction="1.5"/></joint>
  <joint name="slide" type="prismatic"><parent link="body"/><child link="drawer"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.3" effort="1" velocity="1"/><dynamics damping="2" friction="3"/></joint>
</robot>
"""


def _load(folder: Path, bodies: str) -> SceneSpec:
    (folder / "models").mkdir(exist_ok=True)
    (folder / "models/cabinet.urdf").write_text(CABINET)
    write_triangle_glb(folder / "models/cabinet.glb")
    (folder / "scene.yaml").write_text(f"ground_z: 0\nbodies:\n{bodies}")
    return load_scene(folder)


def _refused(folder: Path, bodies: str) -> str:
    with pytest.raises(SceneError) as caught:
        _load(folder, bodies)
    message = str(caught.value)
    assert "\n" not in message
    assert "scene.yaml" in message
    return message


def test_a_body_has_a_pose_and_joints_that_are_given_in_degrees_and_metres(tmp_path: Path) -> None:
    text = "  - {name: a, model: models/cabinet.urdf, pose: {xyz: [1, 2, 3], rpy_deg: [0, 0, 90]}, joints: {slide: 0.2, hinge: 45}}\n"
    (body,) = _load(tmp_path, text).bodies
    assert (body.name, body.static, body.semantic_class) == ("a", False, "cabinet")
    assert body.start == pose_from_xyz_rpy((1.0, 2.0, 3.0), (0.0, 0.0, math.pi / 2))
    assert dict(body.joints) == pytest.approx({"hinge": math.pi / 4, "slide": 0.2})


def test_bodies_are_drawn_as_moving_links_with_a_class_and_an_instance_each(tmp_path: Path) -> None:
    scene = _load(tmp_path, "  - {name: a, model: models/cabinet.urdf}\n  - {name: b, model: models/cabinet.urdf}\n")
    drawn = drawn_scene(scene, ("a/body", "b/body"))
    assert [(v.link, v.semantic_class) for v in drawn.visuals] == [("a/body", "cabinet"), ("b/body", "cabinet")]
    assert drawn.labels() == ((1, 1), (1, 2))


def test_a_body_without_a_name_is_called_like_its_model(tmp_path: Path) -> None:
    scene = _load(tmp_path, "  - {model: models/cabinet.urdf}\n  - {model: models/cabinet.urdf}\n")
    assert [body.name for body in scene.bodies] == ["cabinet", "cabinet_2"]


def test_a_mesh_becomes_a_rigid_body_and_static_holds_it(tmp_path: Path) -> None:
    (body,) = _load(tmp_path, "  - {model: models/cabinet.glb, static: true, semantic_class: sign}\n").bodies
    assert (len(body.model.links), body.static, body.semantic_class) == (1, True, "sign")


def test_the_limit_of_a_joint_can_be_given_in_round_degrees(tmp_path: Path) -> None:
    (body,) = _load(tmp_path, "  - {model: models/cabinet.urdf, joints: {hinge: 90}}\n").bodies
    assert body.joints == (("hinge", 1.5707963),)


def test_the_files_of_bodies_count_in_the_digest(tmp_path: Path) -> None:
    text = "  - {model: models/cabinet.urdf}\n"
    first = _load(tmp_path, text).content_hash
    assert _load(tmp_path, text).content_hash == first
    (tmp_path / "models/cabinet.urdf").write_text(CABINET.replace('mass value="8"', 'mass value="9"'))
    assert load_scene(tmp_path).content_hash != first
    _load(tmp_path, text)
    mesh = tmp_path / "models/cabinet.glb"
    mesh.write_bytes(mesh.read_bytes().replace(b'"version": "2.0"', b'"version":"2.0" '))
    assert load_scene(tmp_path).content_hash != first


def test_scale_makes_a_body_larger_at_the_same_density() -> None:
    model = scaled_model(parse_urdf(CABINET, Path("/nowhere/c.urdf"), lambda *_: Path("/nowhere/c.glb")), 2.0)
    body = model.link("body")
    assert body.inertial is not None
    assert (body.inertial.mass, body.inertial.inertia[0]) == (64.0, 32.0)
    assert body.collisions[0].shape.size == (0.8, 0.8, 2.0)
    assert body.collisions[0].pose.position == (0.0, 0.0, 1.0)
    assert body.visuals[0].shape.size == (2.0, 2.0, 2.0)
    assert model.joint("hinge").pose.position == (0.4, 0.4, 0.0)
    assert model.joint("hinge").upper == 1.5707963
    assert (model.joint("slide").upper, model.joint("slide").damping) == (0.6, 16.0)
    assert (model.joint("hinge").friction, model.joint("slide").friction) == (48.0, 48.0)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("{name: a}", ["bodies[0]", "no model"]),
        ("{model: models/cabinet.urdf, joint: {hinge: 1}}", ["'joint'", "did you mean 'joints'"]),
        ("{model: models/cabinet.urdf, joints: {hing: 1}}", ["'hing'", "did you mean 'hinge'"]),
        ("{model: models/cabinet.urdf, joints: {hinge: 91}}", ["body 'cabinet'", "hinge is 91", "0 to 90"]),
        ("{model: models/cabinet.urdf, joints: {slide: -0.1}}", ["slide is -0.1", "0 to 0.3"]),
        ("{model: models/cabinet.glb, joints: {slide: 1}}", ["no movable joints"]),
        ("{model: models/cabinet.urdf, scale: 0}", ["scale is 0", "0.01 to 100"]),
        ("{model: models/cabinet.urdf, name: a/b}", ["'a/b'", "letters"]),
        ("{model: models/none.urdf}", ["none.urdf"]),
        ("{model: ../outside.urdf}", ["outside"]),
        ("{model: /etc/passwd.urdf}", ["below the scene's folder"]),
        ("{model: file:///x.urdf}", ["below the scene's folder"]),
        ("{model: gibson_bot}", ["is a robot", "--robot"]),
        ("{model: no_such_thing}", ["no_such_thing", "neither a file nor a built-in model"]),
    ],
)
def test_a_mistake_is_one_line_that_says_what_is_allowed(tmp_path: Path, body: str, words: list[str]) -> None:
    (tmp_path.parent / "outside.urdf").write_text(CABINET)
    message = _refused(tmp_path, f"  - {body}\n")
    for word in words:
        assert word in message


def test_two_bodies_of_one_name_are_refused(tmp_path: Path) -> None:
    message = _refused(tmp_path, "  - {name: a, model: models/cabinet.urdf}\n  - {name: a, model: models/cabinet.glb}\n")
    assert "'a' is used twice" in message


def test_a_file_of_a_body_that_lies_outside_the_scene_is_refused(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    write_triangle_glb(tmp_path.parent / "outside.glb")
    scene = tmp_path / "inner"
    (scene / "models").mkdir(parents=True)
    (scene / "models/thief.urdf").write_text(CABINET.replace("cabinet.glb", "../../../outside.glb"))
    message = _refused(scene, "  - {model: models/thief.urdf}\n")
    assert "outside" in message
