"""Robots with only a URDF: what is guessed, and the errors if nothing can be."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import pytest

from gibson_sim.cli.command_line import run
from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import RobotError
from gibson_sim.scenes.robot_files import load_robot

BODY = '<link name="{}"><collision><origin xyz="0 0 {}"/><geometry><box size="0.4 0.3 0.1"/></geometry></collision></link>'
ROUND = {
    "cylinder": '<collision><origin rpy="1.57 0 0"/><geometry><cylinder radius="0.08" length="0.04"/></geometry></collision>',
    "mesh": '<collision><geometry><mesh filename="wheel.obj"/></geometry></collision>',
    "drawn": '<visual><geometry><sphere radius="0.08"/></geometry></visual>',
    "leg": '<collision><origin xyz="0 0 -0.05"/><geometry><box size="0.02 0.02 0.1"/></geometry></collision>',
    "ball": '<collision><geometry><sphere radius="0.08"/></geometry></collision>',
}


def joint(name: str, parent: str, xyz: str, axis: str = "0 1 0", kind: str = "continuous", extra: str = "") -> str:
    return (
        f'<joint name="{name}_joint" type="{kind}"><parent link="{parent}"/><child link="{name}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/>{extra}</joint>'
    )


def wheel(name: str, xyz: str, parent: str = "base_link", shape: str = "cylinder", axis: str = "0 1 0") -> str:
    return f'<link name="{name}">{ROUND[shape]}</link>' + joint(name, parent, xyz, axis)


def pair(x: float, *, z: float = 0.0, shape: str = "cylinder", name: str = "wheel") -> str:
    where = "front" if x > 0 else "rear"
    return wheel(f"{where}_left_{name}", f"{x} 0.2 {z}", shape=shape) + wheel(
        f"{where}_right_{name}", f"{x} -0.2 {z}", shape=shape
    )


def steered(x: float) -> str:
    text = ""
    for side, y in (("left", 0.2), ("right", -0.2)):
        limit = '<limit lower="-0.5" upper="0.5" effort="5" velocity="2"/>'
        text += f'<link name="{side}_pin"/>' + joint(f"{side}_pin", "base_link", f"{x} {y} 0", "0 0 1", "revolute", limit)
        text += wheel(f"{side}_front", "0 0 0", f"{side}_pin")
    return text


def caster(name: str, xyz: str) -> str:
    return f'<link name="{name}_fork"/>' + joint(f"{name}_fork", "base_link", xyz, "0 0 1") + wheel(name, "0 0 0", f"{name}_fork")


def written(folder: Path, inner: str, root: str = BODY.format("base_link", 0.1)) -> Path:
    # A wheel of 24 corners about y.
    corners = [
        (0.08 * math.cos(i * math.pi / 12), y, 0.08 * math.sin(i * math.pi / 12)) for y in (-0.02, 0.02) for i in range(24)
    ]
    faces = [(i + 1, (i + 1) % 24 + 1, i + 25) for i in range(24)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (folder / "wheel.obj").write_text("\n".join(lines) + "\n")
    path = folder / "bot.urdf"
    path.write_text(f'<robot name="bot">{root}{inner}</robot>')
    return path


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize("shape", ["cylinder", "mesh"])
def test_one_pair_of_wheels_is_a_differential_drive(tmp_path: Path, shape: str) -> None:
    drive = load_robot(written(tmp_path, pair(0.1, shape=shape))).drive
    assert drive is not None
    assert (drive.kind, drive.left_joints, drive.right_joints) == (  # type: ignore[union-attr]
        "differential", ("front_left_wheel_joint",), ("front_right_wheel_joint",),
    )  # fmt: skip
    assert (drive.wheel_radius, drive.wheel_separation) == pytest.approx((0.08, 0.4))  # type: ignore[union-attr]


def test_more_pairs_are_a_skid_steer(tmp_path: Path) -> None:
    drive = load_robot(written(tmp_path, pair(0.1) + pair(-0.1))).drive
    assert drive is not None
    assert drive.kind == "skid_steer"
    assert drive.left_joints == ("rear_left_wheel_joint", "front_left_wheel_joint")  # type: ignore[union-attr]


def test_two_steered_wheels_are_a_car(tmp_path: Path) -> None:
    drive = load_robot(written(tmp_path, pair(-0.1) + steered(0.2))).drive
    assert drive is not None
    assert drive.kind == "ackermann"
    assert (drive.wheelbase, drive.max_steering) == pytest.approx((0.3, 0.5))  # type: ignore[union-attr]
    assert drive.left_steering_joint == "left_pin_joint"  # type: ignore[union-attr]


def test_four_wheels_called_mecanum_go_sideways(tmp_path: Path) -> None:
    drive = load_robot(written(tmp_path, pair(0.1, name="mecanum") + pair(-0.1, name="mecanum"))).drive
    assert drive is not None
    assert drive.kind == "omni"
    angles = {w.joint: round(math.degrees(w.roller)) for w in drive.wheels}  # type: ignore[union-attr]
    assert angles == {
        "front_left_mecanum_joint": -45, "front_right_mecanum_joint": 45,
        "rear_left_mecanum_joint": 45, "rear_right_mecanum_joint": -45,
    }  # fmt: skip


def test_casters_do_not_drive(tmp_path: Path) -> None:
    inner = pair(0.1) + caster("back", "-0.15 0.1 0") + caster("behind", "-0.15 -0.1 0") + wheel("tail", "-0.2 0 0")
    drive = load_robot(written(tmp_path, inner)).drive
    assert drive is not None
    assert drive.kind == "differential"


def test_a_root_above_the_floor_gets_a_footprint_on_it(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, pair(0.1, z=-0.02)))
    assert robot.base_link == "base_footprint"
    assert dict((child, pose.position[2]) for _, child, pose in robot.fixed_transforms)["base_link"] == pytest.approx(0.1)
    # Meshes are found from the folder of the cached file.
    assert load_robot(written(tmp_path, pair(0.1, shape="mesh"))).base_link == "base_footprint"


def test_a_footprint_below_the_root_becomes_the_root(tmp_path: Path) -> None:
    foot = '<link name="base_footprint"/>' + joint("base_footprint", "base_link", "0 0 -0.08", kind="fixed")
    robot = load_robot(written(tmp_path, pair(0.1) + foot))
    assert robot.base_link == robot.links[0] == "base_footprint"
    assert [(a, b, round(pose.position[2], 6)) for a, b, pose in robot.fixed_transforms] == [
        ("base_footprint", "base_link", 0.08)
    ]


def test_wheels_that_hang_above_the_casters_are_lowered(tmp_path: Path) -> None:
    ball = '<link name="ball"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
    inner = pair(0.1) + ball + joint("ball", "base_link", "-0.1 0 -0.074", kind="fixed")
    robot = load_robot(written(tmp_path, inner))
    model = read_urdf(robot.urdf)
    assert model.transforms()["front_left_wheel"][2, 3] == pytest.approx(0.08, abs=1e-6)
    assert model.joint("front_left_wheel_joint").pose.position[2] == pytest.approx(-0.005)


def test_what_is_guessed_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    scan = '<link name="base_scan"/>' + joint("base_scan", "base_link", "0 0 0.2", kind="fixed")
    eye = '<link name="camera_link"/>' + joint("camera_link", "base_link", "0.2 0 0.2", kind="fixed")
    robot = load_robot(written(tmp_path, pair(0.1) + scan + eye))
    assert [lidar.link for lidar in robot.sensors.lidars] == ["robot/base_scan"]
    assert [camera.link for camera in robot.cameras] == ["robot/camera_link"]
    for word in (
        "drive: differential",
        "wheel_radius: 0.08 m",
        "base_height: 0.08",
        "lidar: at base_scan",
        "camera: at camera_link",
    ):
        assert word in caplog.text


@pytest.mark.parametrize(
    ("inner", "reason"),
    [
        ("", "has no wheels"),
        (wheel("a", "0.1 0.2 0", shape="leg") + wheel("b", "0.1 -0.2 0", shape="leg"), "Robots with legs are not simulated"),
        (
            wheel("a", "0.2 0 0", axis="1 0 0", shape="ball") + wheel("b", "-0.2 0 0", axis="1 0 0", shape="ball"),
            "x must be forward",
        ),
        (wheel("a", "0.1 0.2 0"), "mirror each other"),
        (pair(0.1, shape="drawn"), "have no collision shape"),
        (steered(0.2), "no drive fits"),
        (pair(0.3) + steered(0.2), "steered in front"),
        (pair(0.1, z=0.3), "lower than the wheels"),
    ],
)
def test_what_cannot_drive_is_a_clear_error(tmp_path: Path, inner: str, reason: str) -> None:
    with pytest.raises(RobotError, match=reason) as caught:
        load_robot(written(tmp_path, inner))
    assert "YAML" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_with_one_description_is_a_robot(tmp_path: Path) -> None:
    path = written(tmp_path, pair(0.1))
    assert load_robot(tmp_path).drive is not None
    path.with_name("other.urdf").write_text(path.read_text())
    with pytest.raises(RobotError, match=r"2 descriptions, name one: bot\.urdf, other\.urdf"):
        load_robot(tmp_path)


def test_a_model_of_gazebo_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "bot.sdf").write_text("<sdf/>")
    with pytest.raises(RobotError, match="is an SDF model"):
        load_robot(str(tmp_path / "bot.sdf"))


def test_the_guess_is_written_and_read_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, pair(0.1, z=-0.02) + pair(-0.1, z=-0.02))
    output = tmp_path / "robot.yaml"
    assert run(["scene", "robot", str(path), "--write", str(output)]) == 0
    assert "# drive: skid_steer" in output.read_text()
    assert "guessed drive: skid_steer" in capsys.readouterr().out
    again, direct = load_robot(output), load_robot(path)
    assert (again.drive, again.base_link, again.radius, again.height) == (
        direct.drive,
        direct.base_link,
        direct.radius,
        direct.height,
    )
    assert run(["scene", "robot", str(path), "--write", str(output)]) != 0


def test_wheels_grip_and_casters_slide_where_the_file_does_not_say(tmp_path: Path) -> None:
    ball = '<link name="ball"><collision><geometry><sphere radius="0.01"/></geometry></collision>{}</link>'
    hang = joint("ball", "base_link", "-0.1 0 -0.07", kind="fixed")
    model = read_urdf(load_robot(written(tmp_path, pair(0.1) + ball.format("") + hang)).urdf)
    assert [model.link(name).friction for name in ("front_left_wheel", "ball", "base_link")] == [1.0, 0.0, None]
    told = ball.format('<contact><lateral_friction value="0.2"/></contact>')
    assert read_urdf(load_robot(written(tmp_path, pair(0.1) + told + hang)).urdf).link("ball").friction == 0.2


def test_friction_that_is_told_to_gazebo_counts(tmp_path: Path) -> None:
    told = '<gazebo reference="ball"><mu1>0.1</mu1><mu2>0.2</mu2></gazebo><gazebo reference="front_left_wheel"><mu1>1000</mu1></gazebo>'
    ball = '<link name="ball"/>' + joint("ball", "base_link", "0 0 0", kind="fixed")
    model = read_urdf(written(tmp_path, pair(0.1) + ball + told))
    assert (model.link("ball").friction, model.link("front_left_wheel").friction, model.link("base_link").friction) == (
        0.1,
        1.5,
        None,
    )
