"""Reading the arms, grippers and poses of a robot.yaml."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gibson_sim.errors import RobotError
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import GripperSpec, ManipulatorSpec, NamedPose, RobotSpec

Load = Callable[[str], RobotSpec]
LIMIT = '<limit lower="{}" upper="{}" effort="20" velocity="1"/>'


def joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'
    )


URDF = (
    '<robot name="r"><link name="base"><collision><geometry><box size="0.4 0.4 0.2"/></geometry></collision></link>'
    + joint("lift", "prismatic", "base", "torso", '<axis xyz="0 0 1"/>' + LIMIT.format(0.1, 0.5))
    + joint("shoulder", "revolute", "torso", "upper", LIMIT.format(-1, 2))
    + joint("roll", "continuous", "upper", "lower", '<limit effort="5" velocity="1"/>')
    + joint("wrist", "fixed", "lower", "tool")
    + joint("finger", "prismatic", "tool", "left", LIMIT.format(0, 0.05))
    + joint("other", "prismatic", "tool", "right", LIMIT.format(0, 0.05) + '<mimic joint="finger"/>')
    + joint("caster", "continuous", "base", "c")
    + "</robot>"
)
ARM = "manipulators: [{name: arm, joints: [shoulder, roll], tip_link: tool}]\n"
GRIPPER = "manipulators: [{{name: arm, joints: [shoulder, roll], tip_link: tool, gripper: {{{}}}}}]\n"


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def _load(text: str) -> RobotSpec:
        (tmp_path / "r.urdf").write_text(URDF)
        (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n" + text)
        return load_robot(tmp_path)

    return _load


def test_an_arm_with_its_gripper_is_read(load: Load) -> None:
    robot = load(GRIPPER.format("joints: [finger], open: 0.04, closed: 0, max_effort: 10"))
    expected = ManipulatorSpec("arm", ("shoulder", "roll"), "tool", "torso", GripperSpec(("finger",), 0.04, 0.0, 10.0))
    assert robot.manipulators == (expected,)
    assert robot.manipulator() == robot.manipulator("arm") == expected


def test_a_robot_starts_at_home_and_its_other_joints_where_they_rest(load: Load) -> None:
    robot = load("named_poses: {up: {shoulder: 1.5, roll: 0}, down: {shoulder: -1, finger: 0.02}}\nhome: up\n")
    assert robot.named_pose("down") == NamedPose("down", (("shoulder", -1.0), ("finger", 0.02)))
    # The lift cannot be at 0; the roll is named, so it is listed although it is at 0; the second finger mimics the first.
    assert dict(robot.joints) == {"lift": 0.1, "shoulder": 1.5, "roll": 0.0}
    assert dict(load("named_poses: {a: {finger: 0.02}}\nhome: a\n").joints) == {"lift": 0.1, "finger": 0.02, "other": 0.02}
    assert dict(load("").joints) == {"lift": 0.1}


def test_unknown_manipulators_and_named_poses_are_refused_with_the_known_ones(load: Load) -> None:
    robot = load(ARM)
    with pytest.raises(RobotError, match="no manipulator 'leg'; known: arm"):
        robot.manipulator("leg")
    with pytest.raises(RobotError, match="no pose 'up'; known: none"):
        robot.named_pose("up")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("manipulator: []\n", "did you mean 'manipulators'"),
        ("manipulators: {name: arm}\n", "must be a list of"),
        (ARM.replace("joints", "joint"), "did you mean 'joints'"),
        (ARM.replace("name: arm", "name: my arm"), "'my arm' is not usable in ROS"),
        (ARM.replace("[shoulder, roll]", "[]"), "must be a list of joint names"),
        (ARM.replace("shoulder,", "shulder,"), "no joint 'shulder'; known: lift, shoulder"),
        (ARM.replace("[shoulder, roll]", "[shoulder, shoulder]"), "two are 'shoulder'"),
        (
            ARM.replace("[shoulder, roll]", "[roll, shoulder]"),
            "'roll' is moved by 'shoulder'; name them from the base to the tool",
        ),
        (ARM.replace("roll", "finger"), "tip_link 'tool' is not moved by joint 'finger'; these do: lift, shoulder, roll"),
        (
            ARM.replace("roll", "caster"),
            "joint 'caster' is continuous and has no motor; joints that accept commands: lift, shoulder",
        ),
        (ARM.replace("roll", "wrist"), "joint 'wrist' is fixed"),
        (ARM.replace("tip_link: tool", "tip_link: hand"), "no link 'hand'; known: base"),
        (ARM.replace("}]", "}, {name: arm, joints: [lift], tip_link: torso}]"), "two are named 'arm'"),
        (ARM.replace("}]", "}, {name: b, joints: [shoulder], tip_link: tool}]"), "two move joint 'shoulder'"),
        (GRIPPER.format("joints: [finger], open: 0.04, closed: 0"), "gripper: max_effort is missing"),
        (GRIPPER.format("joints: [other], open: 0.04, closed: 0, max_effort: 5"), "joint 'other' mimics 'finger'"),
        (
            GRIPPER.format("joints: [finger], open: 0.06, closed: 0, max_effort: 5"),
            "open is 0.06, joint 'finger' goes from 0 to 0.05",
        ),
        (GRIPPER.format("joints: [finger], open: 0, closed: 0, max_effort: 5"), "open and closed are both 0"),
        (
            GRIPPER.format("joints: [finger], open: 0.04, closed: 0, max_effort: 50"),
            "max_effort is 50, joint 'finger' has at most 20",
        ),
        (GRIPPER.format("joints: [finger], open: 0.04, closed: 0, max_effort: 0"), "max_effort is 0, must be above 0"),
        ("home: up\n", "home is 'up', must be one of named_poses: none"),
        ("named_poses: {up: {shoulder: 3}}\n", "named_poses: up: shoulder is 3, joint 'shoulder' goes from -1 to 2"),
        ("named_poses: {up: {shoulder: .nan}}\n", "must be a finite number"),
        ("named_poses: {'go up': {shoulder: 1}}\n", "name 'go up' must be letters"),
        ("named_poses: {up: [1, 2]}\n", "must be a list of 'key: value' lines"),
    ],
)
def test_a_wrong_arm_is_refused_in_one_line(load: Load, text: str, words: str) -> None:
    with pytest.raises(RobotError) as error:
        load(text)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_joints_of_the_drive_are_of_no_arm(tmp_path: Path) -> None:
    wheel = '<axis xyz="0 1 0"/><limit effort="5" velocity="1"/><origin xyz="0 {} 0"/>'
    sides = joint("jl", "continuous", "base", "wl", wheel.format(0.2)) + joint(
        "jr", "continuous", "base", "wr", wheel.format(-0.2)
    )
    (tmp_path / "r.urdf").write_text(URDF.replace("</robot>", sides + "</robot>"))
    drive = "drive: {type: differential, left_joint: jl, right_joint: jr, wheel_radius: 0.1}\n"
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n" + drive + "manipulators: [{name: a, joints: [jl], tip_link: wl}]\n")
    with pytest.raises(RobotError, match="joint 'jl' belongs to the drive"):
        load_robot(tmp_path)
