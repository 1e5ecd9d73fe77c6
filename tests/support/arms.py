"""A small robot with an arm of seven joints and a gripper, for tests."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec

_MOUNT = (0.1, 0.0, 0.6)
_JOINTS = (
    # name, origin in its parent, axis, lower, upper, effort
    ("turn", _MOUNT, (0, 0, 1), -2.0, 2.0, 80),
    ("lift", (0.1, 0.0, 0.05), (0, 1, 0), -1.6, 1.6, 120),
    ("roll", (0.2, 0.0, 0.0), (1, 0, 0), -3.0, 3.0, 70),
    ("elbow", (0.13, 0.0, 0.0), (0, 1, 0), -2.2, 2.2, 60),
    ("forearm", (0.2, 0.0, 0.0), (1, 0, 0), -3.0, 3.0, 30),
    ("wrist", (0.12, 0.0, 0.0), (0, 1, 0), -2.1, 2.1, 25),
    ("hand", (0.13, 0.0, 0.0), (1, 0, 0), -3.0, 3.0, 10),
)
ARM_JOINTS = tuple(name for name, *_ in _JOINTS)
FINGERS = ("left_finger", "right_finger")
HOME = {"lift": 0.5, "elbow": 1.0, "wrist": -1.5}
"""Tool pointing forward and level: 0.5 + 1.0 - 1.5 = 0."""
_YAML = """\
urdf: arm.urdf
radius: 0.4
height: 0.7
manipulators:
  - name: arm
    joints: [{joints}]
    tip_link: tool
    gripper: {{joints: [left_finger, right_finger], open: 0.05, closed: 0.0, max_effort: 30}}
named_poses:
  ready: {{lift: 0.5, elbow: 1.0, wrist: -1.5, left_finger: 0.05, right_finger: 0.05}}
home: ready
"""


def write_arm(folder: Path, *, base: str = "") -> Path:
    """Writes the robot and returns its folder. It stands on a box of 80 kg, unless ``base`` has other links and joints for ``base``."""
    links = [
        base
        or '<link name="base"><collision><origin xyz="0 0 0.3"/><geometry><box size="0.5 0.5 0.6"/></geometry></collision>'
        + _inertial(80.0, 3.0, "0 0 0.1")
        + "</link>"
    ]
    parent = "base"
    for name, origin, axis, lower, upper, effort in _JOINTS:
        xyz = " ".join(map(str, origin))
        links.append(f'<link name="{name}_link">{_inertial(1.0, 0.004, "0.05 0 0")}</link>')
        links.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="{xyz}"/>'
            f'<axis xyz="{" ".join(map(str, axis))}"/><limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="1.5"/></joint>'
        )
        parent = f"{name}_link"
    links.append(
        f'<link name="palm"><collision><geometry><box size="0.06 0.12 0.06"/></geometry></collision>{_inertial(0.5, 0.001)}</link>'
        f'<joint name="palm_joint" type="fixed"><parent link="{parent}"/><child link="palm"/><origin xyz="0.05 0 0"/></joint>'
        '<link name="tool"/><joint name="tool_joint" type="fixed"><parent link="palm"/><child link="tool"/>'
        '<origin xyz="0.1 0 0"/></joint>'
    )
    for name, side in zip(FINGERS, (1, -1), strict=True):
        links.append(
            f'<link name="{name}_link"><collision><origin xyz="0.05 0 0"/><geometry><box size="0.06 0.014 0.025"/></geometry></collision>'
            f'{_inertial(0.1, 0.0001, "0.05 0 0")}<contact><lateral_friction value="1.2"/></contact></link>'
            f'<joint name="{name}" type="prismatic"><parent link="palm"/><child link="{name}_link"/><origin xyz="0.05 {side * 0.008} 0"/>'
            f'<axis xyz="0 {side} 0"/><limit lower="0" upper="0.05" effort="60" velocity="0.2"/></joint>'
        )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(f'<robot name="arm">{"".join(links)}</robot>')
    (folder / "robot.yaml").write_text(_YAML.format(joints=", ".join(ARM_JOINTS)))
    return folder


def load_arm(folder: Path) -> RobotSpec:
    """Writes the robot and loads it."""
    return load_robot(write_arm(folder))


def _inertial(kilograms: float, inertia: float, xyz: str = "0 0 0") -> str:
    values = f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}"/>'
    return f'<inertial><origin xyz="{xyz}"/><mass value="{kilograms}"/>{values}</inertial>'
