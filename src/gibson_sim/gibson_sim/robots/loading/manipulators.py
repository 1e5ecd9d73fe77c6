"""Reads the sections of a ``robot.yaml`` about arms: ``manipulators``, ``named_poses`` and ``home``."""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise
from typing import Any

from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.errors import RobotError
from gibson_sim.formats.yaml_map import ROS_NAME, YamlMap
from gibson_sim.quoting import quoted
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.robots.drives import make_drive
from gibson_sim.robots.spec import GripperSpec, ManipulatorSpec, NamedPose

MANIPULATOR_KEYS = ("manipulators", "named_poses", "home")
_ROUNDING = 1e-6
"""Tolerated excess of a position over a limit, radians or metres."""


def read_manipulators(robot: YamlMap, model: UrdfModel, drive: DriveSpec | None) -> tuple[ManipulatorSpec, ...]:
    """Returns the arms, in the order of the file."""
    items = robot.values.get("manipulators") or []
    if not isinstance(items, list):
        raise RobotError(
            f"{robot.where}: manipulators is {quoted(items)}, must be a list of {{name: .., joints: [..], tip_link: ..}}"
        )
    joints = _Joints(model, drive)
    arms = [_manipulator(robot.within(item, f"manipulators[{i}]"), model, joints) for i, item in enumerate(items)]
    _check_distinct([arm.name for arm in arms], f"{robot.where}: manipulators", "are named")
    all_joints = [name for arm in arms for name in (*arm.joints, *(arm.gripper.joints if arm.gripper else ()))]
    _check_distinct(all_joints, f"{robot.where}: manipulators", "move joint")
    return tuple(arms)


def read_poses(
    robot: YamlMap, model: UrdfModel, drive: DriveSpec | None
) -> tuple[tuple[NamedPose, ...], tuple[tuple[str, float], ...]]:
    """Returns the named poses, and (joint, position) at load and after a reset: those of ``home``, else 0 or the nearest limit."""
    section = robot.section("named_poses")
    joints = _Joints(model, drive)
    poses = []
    for name, values in {} if section is None else section.values.items():
        if not isinstance(name, str) or not ROS_NAME.fullmatch(name):
            raise RobotError(f"{robot.where}: named_poses: name {quoted(name)} must be letters, digits and _, a letter first")
        poses.append(NamedPose(name, _positions(robot.within(values, f"named_poses: {name}"), joints)))
    at_home: dict[str, float] = {}
    if "home" in robot.values:
        home = robot.text("home")
        poses_by_name = {pose.name: pose for pose in poses}
        if home not in poses_by_name:
            raise RobotError(
                f"{robot.where}: home is {quoted(home)}, must be one of named_poses: {', '.join(poses_by_name) or 'none'}"
            )
        at_home = dict(poses_by_name[home].joints)
    at_rest = {joint.name: _at_rest(joint) for joint in joints.known.values()}
    positions = model.with_followers({**{name: at for name, at in at_rest.items() if at}, **at_home})
    return tuple(poses), tuple((name, at) for name, at in positions.items() if at or name in at_home)


class _Joints:
    """The joints of a robot that accept joint commands."""

    def __init__(self, model: UrdfModel, drive: DriveSpec | None) -> None:
        self.model = model
        self.driven: Collection[str] = ()
        if drive is not None:
            instance = make_drive(drive)
            self.driven = {joint.name for joint in (*instance.wheels, *instance.steering)}
        self.known = {joint.name: joint for joint in model.joints if self._refusal(joint) is None}

    def get(self, name: Any, where: str) -> UrdfJoint:
        """Returns the joint of this name; raises RobotError if it does not accept commands."""
        if not isinstance(name, str) or not name:
            raise RobotError(f"{where}: {quoted(name)} is not the name of a joint")
        reason = self._refusal(self.model.joint(name))
        if reason is not None:
            raise RobotError(
                f"{where}: joint {quoted(name)} {reason}; joints that accept commands: {', '.join(self.known) or 'none'}"
            )
        return self.known[name]

    def _refusal(self, joint: UrdfJoint) -> str | None:
        """Returns the reason why a joint does not accept commands; None = it does."""
        if joint.name in self.driven:
            return "belongs to the drive"
        if joint.mimic is not None:
            return f"mimics {quoted(joint.mimic.leader)}"
        return None if joint.has_motor else f"is {joint.kind} and has no motor"


def _manipulator(item: YamlMap, model: UrdfModel, joints: _Joints) -> ManipulatorSpec:
    item.check_keys(("name", "joints", "tip_link", "gripper"))
    name = item.text("name")
    if not ROS_NAME.fullmatch(name):
        raise RobotError(f"{item.where}: name {quoted(name)} is not usable in ROS; use letters, digits and _, a letter first")
    names = _names(item, "joints")
    chain = [joints.get(joint, f"{item.where}: joints") for joint in names]
    tip = item.text("tip_link")
    above = _joints_above(model, model.link(tip).name)
    for before, joint in pairwise(names):
        if joint in above and before in above and above.index(before) > above.index(joint):
            raise RobotError(
                f"{item.where}: joints: {quoted(before)} is moved by {quoted(joint)}; name them from the base to the tool"
            )
    for joint in names:
        if joint not in above:
            raise RobotError(
                f"{item.where}: tip_link {quoted(tip)} is not moved by joint {quoted(joint)}; these do: {', '.join(above) or 'none'}"
            )
    section = item.section("gripper")
    gripper = None if section is None else _gripper(section, joints)
    return ManipulatorSpec(name, names, tip, chain[0].parent, gripper)


def _gripper(section: YamlMap, joints: _Joints) -> GripperSpec:
    section.check_keys(("joints", "open", "closed", "max_effort"))
    names = _names(section, "joints")
    fingers = [joints.get(name, f"{section.where}: joints") for name in names]
    opened, closed, effort = (section.number(key) for key in ("open", "closed", "max_effort"))
    for joint in fingers:
        for key, value in (("open", opened), ("closed", closed)):
            _check_position(joint, value, f"{section.where}: {key}")
        if joint.effort and effort > joint.effort:
            raise RobotError(
                f"{section.where}: max_effort is {effort:g}, joint {quoted(joint.name)} has at most {joint.effort:g} (its URDF's effort)"
            )
    if opened == closed:
        raise RobotError(f"{section.where}: open and closed are both {opened:g}; they must differ")
    if effort <= 0:
        raise RobotError(f"{section.where}: max_effort is {effort:g}, must be above 0")
    return GripperSpec(names, opened, closed, effort)


def _positions(values: YamlMap, joints: _Joints) -> tuple[tuple[str, float], ...]:
    out = []
    for name in values.values:
        joint = joints.get(name, values.where)
        position = values.number(name)
        _check_position(joint, position, f"{values.where}: {name}")
        out.append((joint.name, position))
    return tuple(out)


def _check_position(joint: UrdfJoint, value: float, where: str) -> None:
    if joint.is_bounded and not joint.lower - _ROUNDING <= value <= joint.upper + _ROUNDING:
        raise RobotError(f"{where} is {value:g}, joint {quoted(joint.name)} goes from {joint.lower:g} to {joint.upper:g}")


def _names(item: YamlMap, key: str) -> tuple[str, ...]:
    value = item.values.get(key)
    if not isinstance(value, list) or not value or not all(isinstance(name, str) and name for name in value):
        raise RobotError(f"{item.where}: {key} is {quoted(value)}, must be a list of joint names")
    _check_distinct(value, f"{item.where}: {key}", "are")
    return tuple(value)


def _check_distinct(names: list[str], where: str, verb: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise RobotError(f"{where}: two {verb} {quoted(name)}; each must be there once")


def _joints_above(model: UrdfModel, link: str) -> list[str]:
    """Returns the joints that move a link, from the root to the link."""
    by_child = {joint.child: joint for joint in model.joints}
    out: list[str] = []
    while link in by_child:
        if by_child[link].kind != "fixed":
            out.insert(0, by_child[link].name)
        link = by_child[link].parent
    return out


def _at_rest(joint: UrdfJoint) -> float:
    """Returns 0, or the limit nearest to it."""
    return min(max(0.0, joint.lower), joint.upper) if joint.is_bounded else 0.0
