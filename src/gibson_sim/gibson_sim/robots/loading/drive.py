"""Reads the ``drive`` section of a ``robot.yaml``: what the file does not give is measured in the URDF."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.errors import RobotError
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.quoting import quoted
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, DriveSpec, OmniSpec, OmniWheel
from gibson_sim.robots.loading.settings import Settings

_LIMITS = ("max_linear", "max_angular", "max_linear_acceleration", "max_wheel_torque", "command_delay", "slip")
_TURNS = ("max_angular_acceleration", "turn_slip")
_STRAIGHT = 0.99
"""Cosine of the largest angle between an axis and where it should point."""


def read_drive(robot: Settings, model: UrdfModel) -> DriveSpec | None:
    """Returns the drive; None = the file gives none."""
    settings = robot.section("drive")
    if settings is None:
        return None
    kind = settings.text("type")
    if kind not in _READERS:
        raise RobotError(f"{settings.where}: type is {quoted(kind)}, must be one of {', '.join(_READERS)}")
    return _READERS[kind](_Parts(settings, model))


class _Parts:
    """The section, and where the parts that it names are in the URDF."""

    def __init__(self, settings: Settings, model: UrdfModel) -> None:
        self.settings, self.model, self.where = settings, model, settings.where
        self._transforms = model.transforms()

    def frame(self, joint: UrdfJoint) -> Mat4:
        """Returns T_root_child with all joints at 0."""
        return self._transforms[joint.child]

    def axis(self, joint: UrdfJoint) -> Any:
        """Returns the unit vector of the joint's axis in the root's frame, (3,)."""
        return self.frame(joint)[:3, :3] @ np.array(joint.axis)

    def wheel(self, name: str) -> tuple[UrdfJoint, float]:
        """Returns a joint whose wheel rolls along x, and +1 if forward when it turns positively, else -1."""
        joint = self.model.joint(name)
        across = float(self.axis(joint)[1])
        if joint.kind != "continuous" or abs(across) < _STRAIGHT:
            raise RobotError(
                f"{self.model.path}: joint {quoted(name)} cannot drive: it must be continuous, with its axis along y of {self.model.root}"
            )
        return joint, 1.0 if across > 0 else -1.0

    def kingpin(self, name: str) -> tuple[UrdfJoint, float]:
        """Returns a joint that steers, and +1 if to the left when it turns positively, else -1."""
        joint = self.model.joint(name)
        up = float(self.axis(joint)[2])
        if joint.kind not in ("revolute", "continuous") or abs(up) < _STRAIGHT:
            raise RobotError(
                f"{self.model.path}: joint {quoted(name)} cannot steer: it must be revolute, with its axis along z of {self.model.root}"
            )
        return joint, 1.0 if up > 0 else -1.0

    def apart(self, left: UrdfJoint, right: UrdfJoint) -> float:
        """Returns how far ``left`` is to the left (+y) of ``right``, metres."""
        distance = float(self.frame(left)[1, 3] - self.frame(right)[1, 3])
        if distance <= 0:
            raise RobotError(
                f"{self.where}: {quoted(left.name)} is not to the left (+y) of {quoted(right.name)}; were they swapped?"
            )
        return distance

    def radius(self, wheels: Sequence[UrdfJoint]) -> float:
        """Returns ``wheel_radius``, from the file or from shapes that agree."""
        if "wheel_radius" in self.settings.values:
            return self.settings.number("wheel_radius")
        radii = [_wheel_radius(self.model, joint.child) for joint in wheels]
        if max(radii) - min(radii) > 1e-6:
            raise RobotError(
                f"{self.model.path}: the wheels have radii {min(radii):g} and {max(radii):g} m; give drive.wheel_radius"
            )
        return radii[0]

    def names(self, key: str) -> tuple[str, ...]:
        """Returns a list of joint names."""
        value = self.settings.values.get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) and item for item in value):
            raise RobotError(f"{self.where}: {key} is {quoted(value)}, must be a list of joint names")
        return tuple(value)


def _differential(parts: _Parts) -> DifferentialSpec:
    limits = (*_LIMITS, *_TURNS)
    parts.settings.check_keys(("type", "left_joint", "right_joint", "wheel_radius", "wheel_separation", *limits))
    left, right = (parts.wheel(parts.settings.text(key)) for key in ("left_joint", "right_joint"))
    given = parts.settings.numbers(("wheel_separation", *limits))
    separation = given.pop("wheel_separation", parts.apart(left[0], right[0]))
    return DifferentialSpec(
        kind="differential", left_joints=(left[0].name,), right_joints=(right[0].name,), left_signs=(left[1],), right_signs=(right[1],),
        wheel_radius=parts.radius((left[0], right[0])), wheel_separation=separation, **given,
    )  # fmt: skip


def _skid_steer(parts: _Parts) -> DifferentialSpec:
    limits = (*_LIMITS, *_TURNS, "traction")
    keys = ("type", "left_joints", "right_joints", "wheel_radius", "wheel_separation", "separation_factor", *limits)
    parts.settings.check_keys(keys)
    left, right = ([parts.wheel(name) for name in parts.names(key)] for key in ("left_joints", "right_joints"))
    separation = min(parts.apart(a, b) for a, _ in left for b, _ in right)
    given = parts.settings.numbers(("wheel_separation", "separation_factor", *limits))
    factor = given.pop("separation_factor", 1.0)
    if factor <= 0:
        raise RobotError(f"{parts.where}: separation_factor is {factor:g}, must be above 0")
    separation = given.pop("wheel_separation", separation) * factor
    return DifferentialSpec(
        kind="skid_steer", wheel_separation=separation, wheel_radius=parts.radius([joint for joint, _ in left + right]),
        left_joints=tuple(joint.name for joint, _ in left), right_joints=tuple(joint.name for joint, _ in right),
        left_signs=tuple(sign for _, sign in left), right_signs=tuple(sign for _, sign in right), **given,
    )  # fmt: skip


def _omni(parts: _Parts) -> OmniSpec:
    limits = (*_LIMITS, "max_lateral", "max_lateral_acceleration", *_TURNS, "traction")
    parts.settings.check_keys(("type", "wheels", "wheel_radius", *limits))
    items = parts.settings.values.get("wheels")
    if not isinstance(items, list) or not items:
        raise RobotError(f"{parts.where}: wheels is {quoted(items)}, must be a list of {{joint: .., roller_deg: ..}}")
    wheels = [_omni_wheel(parts, Settings(item, f"{parts.where}: wheels[{i}]")) for i, item in enumerate(items)]
    joints = [parts.model.joint(wheel.joint) for wheel in wheels]
    given = parts.settings.numbers(limits)
    for sideways, forward in (("max_lateral", "max_linear"), ("max_lateral_acceleration", "max_linear_acceleration")):
        if forward in given:
            given.setdefault(sideways, given[forward])
    return OmniSpec(wheels=tuple(wheels), wheel_radius=parts.radius(joints), **given)


def _omni_wheel(parts: _Parts, item: Settings) -> OmniWheel:
    item.check_keys(("joint", "roller_deg"))
    joint = parts.model.joint(item.text("joint"))
    axis, hub = parts.axis(joint), parts.frame(joint)[:3, 3]
    if joint.kind != "continuous" or math.hypot(axis[0], axis[1]) < _STRAIGHT:
        raise RobotError(
            f"{parts.model.path}: joint {quoted(joint.name)} cannot drive: it must be continuous, with a level axis in {parts.model.root}"
        )
    # A wheel that turns positively about its axis rolls along axis x up.
    heading = math.atan2(-axis[0], axis[1])
    roller = math.radians(item.numbers(("roller_deg",)).get("roller_deg", 0.0))
    return OmniWheel(joint.name, (float(hub[0]), float(hub[1])), heading, roller)


def _ackermann(parts: _Parts) -> AckermannSpec:
    numbers = ("max_steering_deg", "max_steering_rate", "max_steering_torque", "min_turning_radius")
    measured_keys = ("wheelbase", "wheel_separation", "steering_separation")
    keys = ("left_joint", "right_joint", "left_steering_joint", "right_steering_joint")
    parts.settings.check_keys(("type", *keys, "wheel_radius", *measured_keys, *numbers, *_LIMITS))
    left, right = (parts.wheel(parts.settings.text(key)) for key in keys[:2])
    left_pin, right_pin = (parts.kingpin(parts.settings.text(key)) for key in keys[2:])
    rear, front = (
        float(parts.frame(a[0])[0, 3] + parts.frame(b[0])[0, 3]) / 2 for a, b in ((left, right), (left_pin, right_pin))
    )
    if front <= rear:
        raise RobotError(
            f"{parts.where}: {quoted(left_pin[0].name)} is not in front (+x) of {quoted(left[0].name)}; were they swapped?"
        )
    given = parts.settings.numbers((*measured_keys, *numbers, *_LIMITS))
    given.setdefault("wheelbase", front - rear)
    given.setdefault("wheel_separation", parts.apart(left[0], right[0]))
    given.setdefault("steering_separation", parts.apart(left_pin[0], right_pin[0]))
    return AckermannSpec(
        left_joint=left[0].name, right_joint=right[0].name, left_sign=left[1], right_sign=right[1],
        left_steering_joint=left_pin[0].name, right_steering_joint=right_pin[0].name,
        left_steering_sign=left_pin[1], right_steering_sign=right_pin[1],
        max_steering=_max_steering(parts, given.pop("max_steering_deg", None), (left_pin[0], right_pin[0])),
        wheel_radius=parts.radius((left[0], right[0])), rear_axle_x=rear, **given,
    )  # fmt: skip


def _max_steering(parts: _Parts, given_deg: float | None, pins: Sequence[UrdfJoint]) -> float:
    """Returns the angle, radians, to which both wheels can be steered, both ways."""
    ends = [min(-joint.lower, joint.upper) for joint in pins if joint.lower <= joint.upper]
    if given_deg is None:
        if not ends:
            raise RobotError(f"{parts.model.path}: the steering joints have no limits; give drive.max_steering_deg")
        return min(ends)
    if ends and math.radians(given_deg) > min(ends) + 1e-6:
        raise RobotError(
            f"{parts.where}: max_steering_deg is {given_deg:g}, the limits of the joints allow {math.degrees(min(ends)):g}"
        )
    return math.radians(given_deg)


_READERS: dict[str, Callable[[_Parts], DriveSpec]] = {
    "differential": _differential, "skid_steer": _skid_steer, "omni": _omni, "ackermann": _ackermann,
}  # fmt: skip


def _wheel_radius(model: UrdfModel, link_name: str) -> float:
    """Returns the radius of the largest sphere or cylinder of the link: collision shapes first, else what is drawn."""
    link = model.link(link_name)
    for shapes in ([c.shape for c in link.collisions], [v.shape for v in link.visuals]):
        radii = [shape.size[0] for shape in shapes if shape.kind in ("sphere", "cylinder")]
        if radii:
            return max(radii)
    raise RobotError(
        f"{model.path}: link {quoted(link_name)} has no sphere or cylinder to read the wheel's radius from; give drive.wheel_radius"
    )
