"""Robots with only a URDF: what is guessed, and the errors if nothing can be."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import pytest

from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import RobotError
from gibson_sim.robots.load import derive_file, load_robot

BODY = '<link name="{}"><collision><origin xyz="0 0 {}"/><geometry><box size="0.4 0.3 0.1"/></geometry></collision></link>'
ROUND = {
    "cylinder": '<collision><origin rpy="1.57 0 0"/><geometry><cylinder radius="0.08" length="0.04"/></geometry></collision>',
    "mesh": '<collision><geometry><mesh filename="wheel.obj"/></geometry></collision>',
    "drawn": '<visual><geometry><sphere radius="0.08"/></geometry></visual>',
    "square": '<visual><geometry><sphere radius="0.08"/></geometry></visual><collision><geometry><box size="0.16 0.04 0.16"/></geometry></collision>',
    "gone": '<visual><geometry><mesh filename="gone.obj"/></geometry></visual>',
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


def gazebo(plugin: str, inner: str) -> str:
    return f'<gazebo><plugin filename="{plugin}" name="p">{inner}</plugin></gazebo>'


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


def test_joints_with_a_horizontal_axis_do_not_steer_and_other_floor_contacts_slide(
    tmp_path: Path,
) -> None:
    text = (pair(-0.1) + steered(0.2)).replace('"0 0 1"', '"0 1 0"')
    for side in ("left", "right"):
        text = text.replace(f'<link name="{side}_pin"/>', f'<link name="{side}_pin">{ROUND["cylinder"]}</link>')
    derived = derive_file(written(tmp_path, text))
    assert derived.values["drive"]["type"] == "skid_steer"
    assert [guess.text for guess in derived.guesses if guess.part == "steering"] == [
        "left_pin_joint: does not steer, since its axis is not vertical",
        "right_pin_joint: does not steer, since its axis is not vertical",
    ]
    assert derived.values["friction"] == {"left_pin": 0.0, "right_pin": 0.0}


def guess_of_drive(path: Path) -> str:
    """Returns the line about the kind of drive."""
    return str(next(guess for guess in derive_file(path).guesses if guess.key == "drive"))


MECANUM = {"rear_left": 45, "rear_right": -45, "front_left": -45, "front_right": 45}


def mecanum_angles(path: Path) -> dict[str, int]:
    drive = load_robot(path).drive
    assert drive is not None and drive.kind == "omni"
    return {w.joint.removesuffix("_wheel_joint"): round(math.degrees(w.roller)) for w in drive.wheels}  # type: ignore[union-attr]


FOUR_JOINTS = "".join(f"<{corner}_joint>{corner}_wheel_joint</{corner}_joint>" for corner in MECANUM)


@pytest.mark.parametrize(
    ("inner", "sign"),
    [
        (gazebo("libgazebo_ros_planar_move.so", ""), "Gazebo's plugin libgazebo_ros_planar_move.so"),
        (
            "<ros2_control><parameters>config/mecanum_drive.yaml</parameters></ros2_control>",
            "config/mecanum_drive.yaml in <parameters>",
        ),
        (
            '<link name="w"><visual><geometry><mesh filename="mecanum_a.stl"/></geometry></visual></link>'
            + joint("w", "base_link", "0 0 0", kind="fixed"),
            "the name of a missing mesh",
        ),
        (gazebo("gz-sim-mecanum-drive-system", FOUR_JOINTS), "Gazebo's plugin gz-sim-mecanum-drive-system"),
        (
            '<link name="mecanum_base"/>' + joint("mecanum_base", "base_link", "0 0 0", kind="fixed"),
            "the name of link 'mecanum_base'",
        ),
    ],
)
def test_four_wheels_are_mecanum_wheels_with_evidence_and_the_log_names_it(tmp_path: Path, inner: str, sign: str) -> None:
    path = written(tmp_path, pair(0.1) + pair(-0.1) + inner)
    assert mecanum_angles(path) == MECANUM
    assert guess_of_drive(path).endswith(f"(mecanum: {sign})")


def test_four_wheels_without_evidence_of_mecanum_are_a_skid_steer_and_the_log_says_why(tmp_path: Path) -> None:
    line = guess_of_drive(written(tmp_path, pair(0.1) + pair(-0.1)))
    assert line.endswith("(they do not steer, and nothing says that they are mecanum)")


def test_meshes_that_are_equal_across_the_corners_are_pointed_out(tmp_path: Path) -> None:
    """Mecanum wheels come in two hands, but tyres with treads do, too."""
    path = written(tmp_path, "")
    for name in ("a.obj", "b.obj"):
        (tmp_path / name).write_text((tmp_path / "wheel.obj").read_text())
    look = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
    corners = [("front_left", 0.1, 0.2), ("front_right", 0.1, -0.2), ("rear_left", -0.1, 0.2), ("rear_right", -0.1, -0.2)]
    for hands, crossed in (("abba", True), ("abab", False), ("aabb", False), ("aaaa", False)):
        inner = "".join(
            wheel(f"{corner}_wheel", f"{x} {y} 0").replace("</link>", look.format(f"{hand}.obj") + "</link>")
            for hand, (corner, x, y) in zip(hands, corners, strict=True)
        )
        path.write_text(f'<robot name="bot">{BODY.format("base_link", 0.1)}{inner}</robot>')
        derived = derive_file(path)
        assert derived.values["drive"]["type"] == "skid_steer"
        assert any("as of mecanum wheels" in guess.by_hand for guess in derived.guesses) == crossed, hands


def test_friction_along_a_diagonal_is_pointed_out(tmp_path: Path) -> None:
    friction = '<gazebo reference="front_left_wheel"><fdir1>1 -1 0</fdir1></gazebo>'
    derived = derive_file(written(tmp_path, pair(0.1) + pair(-0.1) + friction))
    assert derived.values["drive"]["type"] == "skid_steer"
    assert any(guess.by_hand.startswith("drive.type: their friction is along a diagonal") for guess in derived.guesses)


def test_wheels_with_limits_that_no_wheel_reaches_drive(tmp_path: Path) -> None:
    limit = '<limit lower="-1e16" upper="1e16" effort="10" velocity="9"/></joint>'
    text = pair(0.1).replace('"continuous"', '"revolute"').replace("</joint>", limit)
    assert derive_file(written(tmp_path, text)).values["drive"]["type"] == "differential"


def rollers(wheel_name: str, degrees: float, count: int = 8) -> str:
    """Returns rollers about a wheel at the origin of its link, which turns about y; that on the floor is ``degrees`` from x."""
    text, angle = "", math.radians(degrees)
    for i in range(count):
        around = 2 * math.pi * i / count
        name = f"{wheel_name}_roller_{i}"
        # The roller at the bottom, turned about y.
        xyz = f"{-0.07 * math.sin(around)} 0 {-0.07 * math.cos(around)}"
        axis = f"{math.cos(angle) * math.cos(around)} {math.sin(angle)} {-math.cos(angle) * math.sin(around)}"
        ball = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
        text += f'<link name="{name}">{ball}</link>' + joint(name, wheel_name, xyz, axis)
    return text


def test_rollers_with_joints_make_mecanum_wheels_of_their_angle(tmp_path: Path) -> None:
    bare = '<link name="{}"/>'
    inner = ""
    for corner, angle in MECANUM.items():
        x, y = (-0.2 if "rear" in corner else 0.2), (0.2 if "left" in corner else -0.2)
        name = f"{corner}_wheel"
        inner += bare.format(name) + joint(name, "base_link", f"{x} {y} 0") + rollers(name, angle * 2 / 3)
    path = written(tmp_path, inner)
    assert mecanum_angles(path) == {corner: angle * 2 // 3 for corner, angle in MECANUM.items()}
    assert guess_of_drive(path).endswith("(mecanum: their rollers have joints)")
    assert load_robot(path).drive.wheel_radius == pytest.approx(0.08)  # type: ignore[union-attr]


@pytest.mark.parametrize("start", [0, 60, 90])
def test_three_wheels_around_the_middle_move_in_all_directions(tmp_path: Path, start: int) -> None:
    inner = ""
    for i in range(3):
        a = math.radians(start + 120 * i)
        name, frame = f"w{i}", f'{0.2 * math.cos(a)} {0.2 * math.sin(a)} 0" rpy="0 0 {a - math.pi / 2}'
        inner += wheel(name, frame, axis="0 1 0")
    path = written(tmp_path, inner)
    drive = load_robot(path).drive
    assert drive is not None and drive.kind == "omni"
    assert [w.roller for w in drive.wheels] == [0.0, 0.0, 0.0]  # type: ignore[union-attr]
    assert guess_of_drive(path).endswith("(their axes point in different directions)")


def test_wheels_with_a_wrong_axis_are_no_omni_wheels(tmp_path: Path) -> None:
    """Axes of omni wheels go through the middle; two wheels that were given the axis x roll away from it."""
    inner = (
        wheel("left_wheel", "0 0.2 0", axis="1 0 0") + wheel("right_wheel", "0 -0.2 0", axis="1 0 0") + wheel("tail", "-0.2 0 0")
    )
    with pytest.raises(RobotError, match=r"no wheels|x axis|axis of"):
        derive_file(written(tmp_path, inner))


@pytest.mark.parametrize("plugin", ["libgazebo_ros_planar_move.so", "gz-sim-velocity-control-system"])
@pytest.mark.parametrize("needs_drive", [True, False])
def test_a_base_that_a_plugin_moves_is_no_arm(tmp_path: Path, plugin: str, needs_drive: bool) -> None:
    derived = derive_file(written(tmp_path, gazebo(plugin, "")), needs_drive=needs_drive)
    assert derived.values["drive"] == {"type": "planar"}
    assert "fixed_base" not in derived.values
    assert derived.values["base_height"] == -0.05, "the box is above the root, and slides on the floor"
    assert str(derived.guesses[0]).endswith(f"planar, the base moves in all directions by itself (Gazebo's plugin {plugin})")


def test_two_wheels_of_a_base_that_a_plugin_moves_slide_along(tmp_path: Path) -> None:
    derived = derive_file(written(tmp_path, pair(0.1) + gazebo("libgazebo_ros_planar_move.so", "")))
    assert derived.values["drive"] == {"type": "planar", "free_wheels": ["front_left_wheel_joint", "front_right_wheel_joint"]}


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


@pytest.mark.parametrize("shape", ["square", "mesh", "drawn"])
def test_wheels_that_cannot_roll_become_spheres(tmp_path: Path, shape: str) -> None:
    """Makers publish wheels that collide as boxes, as meshes, or not at all."""
    derived = derive_file(written(tmp_path, pair(0.1, shape=shape)))
    assert derived.values["round_wheels"] == {"front_left_wheel": 0.08, "front_right_wheel": 0.08}
    model = read_urdf(load_robot(tmp_path / "bot.urdf").urdf)
    assert [(c.shape.kind, c.shape.size[0]) for c in model.link("front_left_wheel").collisions] == [("sphere", 0.08)]
    assert "round_wheels" not in derive_file(written(tmp_path, pair(0.1))).values


def test_a_body_that_stands_without_its_wheels_is_lifted_onto_them(tmp_path: Path) -> None:
    """The convex hull of a body is flat below, and hides that it has casters."""
    inner = pair(0.05)
    flat = derive_file(written(tmp_path, inner, BODY.format("base_link", -0.03)))
    assert flat.values["wheel_drop"] == {"front_left_wheel_joint": 0.002, "front_right_wheel_joint": 0.002}
    hanging = derive_file(written(tmp_path, inner, BODY.format("base_link", -0.025)))
    assert hanging.values["wheel_drop"] == {"front_left_wheel_joint": -0.004, "front_right_wheel_joint": -0.004}
    assert "nothing beside the wheels touches the floor" in "".join(map(str, hanging.guesses))
    # A ball behind, or a body that is higher, is as it was meant.
    ball = '<link name="ball"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
    caster = ball + joint("ball", "base_link", "-0.15 0 -0.07", kind="fixed")
    assert "wheel_drop" not in derive_file(written(tmp_path, inner + caster, BODY.format("base_link", -0.025))).values
    assert "wheel_drop" not in derive_file(written(tmp_path, inner, BODY.format("base_link", 0.0))).values


def test_derived_settings_are_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
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
        (pair(0.1, shape="gone"), r"have no shape that can be read.*mesh gone\.obj does not exist"),
        (steered(0.2), "no drive fits"),
        (pair(0.3) + steered(0.2), "steered in front"),
        (pair(0.1, z=0.3), "lower than the wheels"),
    ],
)
def test_robot_without_a_usable_drive_is_refused_in_one_line(tmp_path: Path, inner: str, reason: str) -> None:
    with pytest.raises(RobotError, match=reason) as caught:
        load_robot(written(tmp_path, inner))
    assert "YAML" not in str(caught.value)
    assert "\n" not in str(caught.value)


def legs(count: int, *, low: float = -0.5) -> str:
    """Branches of a hip and a knee on the trunk, whose feet reach to ``low``."""
    limit = '<limit lower="-1" upper="1" effort="20" velocity="10"/>'
    text = ""
    for i in range(count):
        x, y = (0.2, -0.2)[i // 2], (0.1, -0.1)[i % 2]
        foot = f'<collision><origin xyz="0 0 {low + 0.02}"/><geometry><sphere radius="0.02"/></geometry></collision>'
        text += f'<link name="hip{i}"/>' + joint(f"hip{i}", "base_link", f"{x} {y} 0", "1 0 0", "revolute", limit)
        text += f'<link name="foot{i}">{foot}</link>' + joint(f"foot{i}", f"hip{i}", "0 0 0", "0 1 0", "revolute", limit)
    return text


@pytest.mark.parametrize("needs_drive", [True, False])
def test_a_legged_robot_is_refused_with_the_remedy(tmp_path: Path, needs_drive: bool) -> None:
    path = written(tmp_path, legs(4))
    with pytest.raises(
        RobotError, match=r"bot\.urdf: stands on 4 legs \(hip0_joint, .*\): walking robots are not simulated"
    ) as caught:
        derive_file(path, needs_drive=needs_drive)
    assert str(caught.value).endswith("fixed_base: true and base_height: 0.6")
    (tmp_path / "robot.yaml").write_text("urdf: bot.urdf\nfixed_base: true\nbase_height: 0.6\n")
    assert load_robot(tmp_path / "robot.yaml").fixed_base


def test_an_arm_is_no_leg_and_is_fixed(tmp_path: Path) -> None:
    """Two arms end at one height, above the base."""
    derived = derive_file(written(tmp_path, legs(2, low=0.3)), needs_drive=False)
    assert derived.values == {"fixed_base": True}
    assert [str(guess) for guess in derived.guesses][-1] == "fixed_base: true, an arm without a drive: base_link does not move"
    lowered = derive_file(written(tmp_path, legs(1, low=0.3), BODY.format("base_link", -0.2)), needs_drive=False)
    assert lowered.values == {"fixed_base": True, "base_height": 0.25}


def test_a_fixed_base_and_a_drive_exclude_each_other(tmp_path: Path) -> None:
    written(tmp_path, pair(0.1))
    drive = "{type: differential, left_joint: front_left_wheel_joint, right_joint: front_right_wheel_joint}"
    (tmp_path / "robot.yaml").write_text(f"urdf: bot.urdf\nfixed_base: true\ndrive: {drive}\n")
    with pytest.raises(RobotError, match="fixed_base is true and there is a drive"):
        load_robot(tmp_path / "robot.yaml")


def test_the_gazebo_plugin_distinguishes_drive_wheels_from_other_joints(tmp_path: Path) -> None:
    """The front pair has no motor, and nothing in its shape or name says so."""
    joints = "<left_joint>rear_left_wheel_joint</left_joint><right_joint>rear_right_wheel_joint</right_joint>"
    plugin = gazebo("libgazebo_ros_diff_drive.so", joints + "<wheel_diameter>0.16</wheel_diameter>")
    derived = derive_file(written(tmp_path, pair(0.1) + pair(-0.1) + plugin))
    assert derived.values["drive"]["type"] == "differential"
    assert derived.values["drive"]["left_joint"] == "rear_left_wheel_joint"
    assert any(str(guess).endswith("(Gazebo's plugin drives by them)") for guess in derived.guesses)
    assert derived.values["friction"]["front_left_wheel"] == 0.0, "they roll along"


def test_wheels_of_another_shape_are_wheels_if_gazebo_drives_by_them(tmp_path: Path) -> None:
    joints = "<left_joint>front_left_wheel_joint</left_joint><right_joint>front_right_wheel_joint</right_joint>"
    plugin = gazebo("gz-sim-diff-drive-system", joints + "<wheel_radius>0.1</wheel_radius>")
    derived = derive_file(written(tmp_path, pair(0.1, shape="leg") + plugin))
    assert derived.values["drive"]["wheel_radius"] == 0.1
    with pytest.raises(RobotError, match=r"radius of its wheels cannot be measured, since their shapes are not round"):
        derive_file(written(tmp_path, pair(0.1, shape="leg") + plugin.replace("wheel_radius", "radius")))


def test_wheels_that_follow_others_do_not_drive(tmp_path: Path) -> None:
    inner = pair(0.1) + pair(-0.1)
    for side in ("left", "right"):
        name = f'name="rear_{side}_wheel_joint" type="continuous">'
        inner = inner.replace(name, f'{name}<mimic joint="front_{side}_wheel_joint"/>')
    drive = load_robot(written(tmp_path, inner)).drive
    assert drive is not None and drive.kind == "differential"
    assert drive.left_joints == ("front_left_wheel_joint",)  # type: ignore[union-attr]


SENSOR = '<gazebo reference="{}"><sensor type="{}" name="s"><update_rate>20</update_rate>{}</sensor></gazebo>'
SCAN = "<ray><scan><horizontal><samples>{}</samples><min_angle>{}</min_angle><max_angle>{}</max_angle></horizontal>{}</scan>"
RANGE = "<range><min>0.1</min><max>{}</max></range></ray>"
IMAGE = "<camera><horizontal_fov>1.57</horizontal_fov><image><width>320</width><height>160</height></image></camera>"


def fixed(name: str, xyz: str, rpy: str = "0 0 0", parent: str = "base_link") -> str:
    return f'<link name="{name}"/>' + joint(name, parent, xyz, kind="fixed").replace("/><axis", f' rpy="{rpy}"/><axis', 1)


def test_sensors_are_those_of_gazebo(tmp_path: Path) -> None:
    cliff = SENSOR.format("cliff", "ray", SCAN.format(5, -0.04, 0.04, "") + RANGE.format(0.15))
    front = SENSOR.format("front", "ray", SCAN.format(667, -1.9, 1.9, "") + RANGE.format(25))
    back = SENSOR.format("back", "gpu_lidar", SCAN.format(640, 0, 6.28319, "") + RANGE.format(12))
    rings = "<vertical><samples>16</samples><min_angle>-0.2618</min_angle><max_angle>0.2618</max_angle></vertical>"
    top = SENSOR.format("top", "gpu_lidar", SCAN.format(900, -3.1416, 3.1416, rings) + RANGE.format(100))
    eye = SENSOR.format("eye_rgb_frame", "camera", IMAGE) + SENSOR.format("eye_rgb_frame", "depth", IMAGE)
    links = "".join(fixed(name, "0 0 0.2") for name in ("cliff", "front", "back", "top", "imu_link", "eye_rgb_frame"))
    links += fixed("eye_optical_frame", "0 0 0", "-1.5707963 0 -1.5707963", "eye_rgb_frame")
    tags = cliff + front + back + top + eye + SENSOR.format("imu_link", "imu", "")
    derived = derive_file(written(tmp_path, pair(0.1) + links + tags))
    common = {"range_min": 0.1, "rate_hz": 20.0}
    assert derived.values["lidar"] == [
        {"name": "front/scan", "link": "front", "beams": 667, "fov_deg": 217.724, "range_max": 25.0, **common},
        {"name": "back/scan", "link": "back", "beams": 640, "fov_deg": 360.0, "angle_min_deg": 0.0, "range_max": 12.0, **common},
    ]
    assert derived.values["lidar_3d"] == {
        "link": "top", "channels": 16, "samples": 900, "elevation_min_deg": -15.0, "elevation_max_deg": 15.0, "range_max": 100.0, **common,
    }  # fmt: skip
    camera = {"name": "camera", "link": "eye_optical_frame", "width": 320, "height": 160, "fov_y_deg": 53.094, "rate_hz": 20.0}
    assert derived.values["cameras"] == [camera]
    assert derived.values["imu"] == {"link": "imu_link", "rate_hz": 20.0}
    robot = load_robot(tmp_path / "bot.urdf")
    assert [lidar.name for lidar in robot.sensors.lidars] == ["front/scan", "back/scan"]
    assert robot.sensors.imus[0].rate_hz == 20.0 and robot.cameras[0].width == 320


def test_several_cameras_have_the_names_of_their_links(tmp_path: Path) -> None:
    names = (
        "head_camera_rgb_optical_frame",
        "head_camera_depth_optical_frame",
        "gripper_camera_color_optical_frame",
        "camera_imu_optical_frame",
    )
    links = "".join(fixed(name, "0 0 0.5", "-1.57 0 -1.57") for name in (*names, "velodyne", "base_imu", "camera_imu_frame"))
    derived = derive_file(written(tmp_path, pair(0.1) + links))
    assert [(c["name"], c["link"]) for c in derived.values["cameras"]] == [
        ("head_camera", names[0]),
        ("gripper_camera", names[2]),
    ]
    assert derived.values["imu"] == {"link": "base_imu"}
    # On its side, the lidar is none that scans a floor plan.
    assert "lidar_3d" not in derived.values
    upright = derive_file(written(tmp_path, pair(0.1) + fixed("velodyne", "0 0 0.5")))
    assert upright.values["lidar_3d"] == {"link": "velodyne"}


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


def test_wheels_grip_and_casters_slide_where_the_file_does_not_say(tmp_path: Path) -> None:
    ball = '<link name="ball"><collision><geometry><sphere radius="0.01"/></geometry></collision>{}</link>'
    hang = joint("ball", "base_link", "-0.1 0 -0.07", kind="fixed")
    model = read_urdf(load_robot(written(tmp_path, pair(0.1) + ball.format("") + hang)).urdf)
    assert [model.link(name).friction for name in ("front_left_wheel", "ball", "base_link")] == [1.0, 0.0, None]
    told = ball.format('<contact><lateral_friction value="0.2"/></contact>')
    assert read_urdf(load_robot(written(tmp_path, pair(0.1) + told + hang)).urdf).link("ball").friction == 0.2


def test_gazebo_friction_is_used(tmp_path: Path) -> None:
    told = '<gazebo reference="ball"><mu1>0.1</mu1><mu2>0.2</mu2></gazebo><gazebo reference="front_left_wheel"><mu1>1000</mu1></gazebo>'
    ball = '<link name="ball"/>' + joint("ball", "base_link", "0 0 0", kind="fixed")
    model = read_urdf(written(tmp_path, pair(0.1) + ball + told))
    assert (model.link("ball").friction, model.link("front_left_wheel").friction, model.link("base_link").friction) == (
        0.1,
        1.5,
        None,
    )
