"""Requests and messages of ROS, and changes of their fields within their types."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fuzz import seeds
from fuzz.grammar import HARSH_TEXTS, Mutator

_INTEGERS = {"int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "byte", "octet", "char"}


def fill_spawn(mutator: Mutator, files: Sequence[str], item: Any) -> None:
    """Lets a request spawn one of our things, or one of these files."""
    item.name, item.allow_renaming = f"thing_{mutator.rng.randrange(6)}", mutator.chance(0.7)
    resource = item.entity_resource if hasattr(item, "entity_resource") else item
    if mutator.chance(0.4):
        resource.resource_string = seeds.object_urdf("ball") if mutator.chance(0.5) else seeds.object_urdf("door_80_left")
    else:
        resource.uri = mutator.rng.choice(("mug", "ball", "vase", "gibson_bot", *files))
    pose = item.initial_pose.pose
    pose.position.x, pose.position.y, pose.position.z = mutator.rng.uniform(-1.5, 1.5), mutator.rng.uniform(-1.5, 1.5), 0.5
    pose.orientation.w = 1.0


def change(mutator: Mutator, files: Sequence[str], message: Any) -> None:
    """Changes one field, however deep, within its type."""
    places = list(_places(message))
    if not places:
        return
    holder, name, kind = mutator.rng.choice(places)
    value = getattr(holder, name)
    if isinstance(value, bool):
        new: Any = not value
    elif isinstance(value, str):
        texts = [t for t in HARSH_TEXTS if _encodable(t)]
        new = (
            mutator.rng.choice([*texts, *files, "thing_1", "robot", "map", "x" * 300_000])
            if mutator.harsh
            else value + mutator.rng.choice(("", "_1"))
        )
    elif isinstance(value, int | float):
        new = _fitting(mutator, value, kind)
    elif isinstance(value, list):
        if (value and isinstance(value[0], str)) or "string" in kind:
            # Repeated changes would make requests of gigabytes, which take rclpy minutes.
            new = ([*value, mutator.rng.choice(("a", "x" * 1000))] * mutator.rng.choice((0, 1, 2, 100)))[:20_000]
        else:
            new = value * mutator.rng.choice((0, 2, 5))
    else:
        new = value
        if len(value) and mutator.chance(0.6):
            new[mutator.rng.randrange(len(value))] = _fitting(mutator, float(value[0]), "double")
        elif "[" not in kind:
            new = type(value)(value.typecode, [*value, *[float(mutator.number(1.0))] * mutator.rng.choice((1, 1000))])
    try:
        setattr(holder, name, new)
    except (AssertionError, OverflowError, ValueError):
        return


def command(mutator: Mutator, joints: Sequence[str]) -> tuple[str, Any]:
    """Returns a topic of the robot and a command that makes sense."""
    names = list(mutator.rng.sample(joints, mutator.rng.choice((1, 2, len(joints)))))
    kind = mutator.rng.randrange(6)
    if kind == 0:
        twist = Twist()
        twist.linear.x, twist.angular.z = mutator.rng.uniform(-1, 1), mutator.rng.uniform(-1, 1)
        return "cmd_vel", twist
    if kind == 1:
        return "joint_command", JointState(name=names, position=[mutator.rng.uniform(-1, 1) for _ in names])
    if kind in (2, 3):
        points = [
            JointTrajectoryPoint(positions=[mutator.rng.uniform(-1, 1) for _ in names], velocities=[0.0 for _ in names])
            for _ in range(3)
        ]
        for k, point in enumerate(points):
            point.time_from_start.sec = k + 1
        topic = "joint_trajectory" if kind == 2 else "arm_controller/joint_trajectory"
        return topic, JointTrajectory(joint_names=names, points=points)
    if kind == 4:
        stamped = TwistStamped()
        stamped.header.frame_id = "base_link"
        stamped.twist.linear.x = mutator.rng.uniform(-0.2, 0.2)
        return "arm_servo/delta_twist_cmds", stamped
    return "grasp", Bool(data=mutator.chance(0.5))


def _places(message: Any) -> Iterator[tuple[Any, str, str]]:
    """Yields (message, field, type) of every value in a message."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from _places(value)
            continue
        yield message, name, kind
        if isinstance(value, list):
            for item in value[:5]:
                if hasattr(item, "get_fields_and_field_types"):
                    yield from _places(item)


def _fitting(mutator: Mutator, value: float | int, kind: str) -> Any:
    kind = kind.partition("[")[0].removeprefix("sequence<").rstrip(">")
    number = mutator.number(value)
    if kind in _INTEGERS:
        low, high = {"byte": (0, 255), "octet": (0, 255), "char": (0, 255)}.get(kind) or _range(kind)
        return high if math.isnan(number) else int(min(max(number, low), high))
    result = float(min(max(number, -(10**308)), 10**308)) if isinstance(number, int) else float(number)
    return float(np.float32(result)) if kind == "float" and abs(result) < 3e38 else result


def _range(kind: str) -> tuple[int, int]:
    info = np.iinfo(kind)
    return int(info.min), int(info.max)


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text
