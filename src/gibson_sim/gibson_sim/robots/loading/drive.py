"""Reads the ``drive`` section of a ``robot.yaml``; missing dimensions are measured in the URDF."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gibson_sim.description.shapes import ROUND_KINDS
from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.errors import RobotError
from gibson_sim.formats.yaml_map import YamlMap
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.quoting import quoted
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, DriveSpec, OmniSpec, OmniWheel, PlanarSpec

_MOTION = ("max_linear", "max_angular", "max_linear_acceleration", "command_delay", "slip")
_LIMITS = (*_MOTION, "max_wheel_torque")
_SIDEWAYS = {"max_lateral": "max_linear", "max_lateral_acceleration": "max_linear_acceleration"}
"""Limit sideways -> the one forward, which is its default."""
_TURNS = ("max_angular_acceleration", "turn_slip")
ALIGNED = 0.99
"""Minimum cosine of the angle between the axis of a joint and its ideal direction."""


def read_drive(robot: YamlMap, model: UrdfModel) -> DriveSpec | None:
    """Returns the drive; None = the file has no ``drive`` section."""
    settings = robot.section("drive")
    if settings is None:
        return None
    kind = settings.text("type")
    if kind not in _READERS:
        raise RobotError(f"{settings.where}: type is {quoted(kind)}, must be one of {', '.join(_READERS)}")
    return _READERS[kind](_DriveSection(settings, model))


class _DriveSection:
    """The ``drive`` section, with access to the URDF joints that it names."""

    def __init__(self, settings: YamlMap, model: UrdfModel) -> None:
        self.settings, self.model, self.where = settings, model, settings.where
        self._transforms = model.transforms()

    def frame(self, joint: UrdfJoint) -> Mat4:
        """Returns T_root_child, (4, 4), with all joints at 0."""
        return self._transforms[joint.child]

    def axis(self, joint: UrdfJoint) -> Any:
        """Returns the unit vector of the joint's axis in the root frame, (3,)."""
        return self.frame(joint)[:3, :3] @ np.array(joint.axis)

    def wheel(self, name: str) -> tuple[UrdfJoint, float]:
        """Returns the joint of a wheel that rolls along x, and +1 if positive rotation rolls it forward, else -1."""
        joint = self.model.joint(name)
        across = float(self.axis(joint)[1])
        if joint.kind != "continuous" or abs(across) < ALIGNED:
            raise RobotError(
                f"{self.model.path}: joint {quoted(name)} cannot drive: it must be continuous, with its axis along y of {self.model.root}"
            )
        return joint, 1.0 if across > 0 else -1.0

    def steering_joint(self, name: str) -> tuple[UrdfJoint, float]:
        """Returns a steering joint, and +1 if positive rotation steers to the left, else -1."""
        joint = self.model.joint(name)
        up = float(self.axis(joint)[2])
        if joint.kind not in ("revolute", "continuous") or abs(up) < ALIGNED:
            raise RobotError(
                f"{self.model.path}: joint {quoted(name)} cannot steer: it must be revolute, with its axis along z of {self.model.root}"
            )
        return joint, 1.0 if up > 0 else -1.0

    def track(self, left: UrdfJoint, right: UrdfJoint) -> float:
        """Returns the lateral distance (+y) from ``right`` to ``left``, metres."""
        distance = float(self.frame(left)[1, 3] - self.frame(right)[1, 3])
        if distance <= 0:
            raise RobotError(
                f"{self.where}: {quoted(left.name)} is not to the left (+y) of {quoted(right.name)}; were they swapped?"
            )
        return distance

    def radius(self, wheels: Sequence[UrdfJoint]) -> float:
        """Returns ``wheel_radius`` of the file, else that of the shapes of the wheels, if it is unique."""
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


def _differential(section: _DriveSection) -> DifferentialSpec:
    limits = (*_LIMITS, *_TURNS)
    section.settings.check_keys(("type", "left_joint", "right_joint", "wheel_radius", "wheel_separation", *limits))
    left, right = (section.wheel(section.settings.text(key)) for key in ("left_joint", "right_joint"))
    values = section.settings.numbers(("wheel_separation", *limits))
    separation = values.pop("wheel_separation", section.track(left[0], right[0]))
    return DifferentialSpec(
        kind="differential", left_joints=(left[0].name,), right_joints=(right[0].name,), left_signs=(left[1],), right_signs=(right[1],),
        wheel_radius=section.radius((left[0], right[0])), wheel_separation=separation, **values,
    )  # fmt: skip


def _skid_steer(section: _DriveSection) -> DifferentialSpec:
    limits = (*_LIMITS, *_TURNS, "traction")
    keys = ("type", "left_joints", "right_joints", "wheel_radius", "wheel_separation", "separation_factor", *limits)
    section.settings.check_keys(keys)
    left, right = ([section.wheel(name) for name in section.names(key)] for key in ("left_joints", "right_joints"))
    separation = min(section.track(a, b) for a, _ in left for b, _ in right)
    values = section.settings.numbers(("wheel_separation", "separation_factor", *limits))
    factor = values.pop("separation_factor", 1.0)
    if factor <= 0:
        raise RobotError(f"{section.where}: separation_factor is {factor:g}, must be above 0")
    separation = values.pop("wheel_separation", separation) * factor
    return DifferentialSpec(
        kind="skid_steer", wheel_separation=separation, wheel_radius=section.radius([joint for joint, _ in left + right]),
        left_joints=tuple(joint.name for joint, _ in left), right_joints=tuple(joint.name for joint, _ in right),
        left_signs=tuple(sign for _, sign in left), right_signs=tuple(sign for _, sign in right), **values,
    )  # fmt: skip


def _omni(section: _DriveSection) -> OmniSpec:
    limits = (*_LIMITS, *_SIDEWAYS, *_TURNS, "traction")
    section.settings.check_keys(("type", "wheels", "wheel_radius", *limits))
    items = section.settings.values.get("wheels")
    if not isinstance(items, list) or not items:
        raise RobotError(f"{section.where}: wheels is {quoted(items)}, must be a list of {{joint: .., roller_deg: ..}}")
    wheels = [_omni_wheel(section, section.settings.within(item, f"wheels[{i}]")) for i, item in enumerate(items)]
    joints = [section.model.joint(wheel.joint) for wheel in wheels]
    return OmniSpec(wheels=tuple(wheels), wheel_radius=section.radius(joints), **_in_all_directions(section, limits))


def _planar(section: _DriveSection) -> PlanarSpec:
    limits = (*_MOTION, *_SIDEWAYS, *_TURNS, "traction")
    section.settings.check_keys(("type", "free_wheels", *limits))
    free = section.names("free_wheels") if "free_wheels" in section.settings.values else ()
    for name in free:
        section.model.joint(name)
    return PlanarSpec(free_wheels=free, **_in_all_directions(section, limits))


def _in_all_directions(section: _DriveSection, keys: tuple[str, ...]) -> dict[str, float]:
    """Returns the numbers of the file; those sideways are those forward if missing."""
    values = section.settings.numbers(keys)
    for sideways, forward in _SIDEWAYS.items():
        if forward in values:
            values.setdefault(sideways, values[forward])
    return values


def _omni_wheel(section: _DriveSection, item: YamlMap) -> OmniWheel:
    item.check_keys(("joint", "roller_deg"))
    joint = section.model.joint(item.text("joint"))
    axis, hub = section.axis(joint), section.frame(joint)[:3, 3]
    if joint.kind != "continuous" or math.hypot(axis[0], axis[1]) < ALIGNED:
        raise RobotError(
            f"{section.model.path}: joint {quoted(joint.name)} cannot drive: it must be continuous, with a level axis in {section.model.root}"
        )
    # Positive rotation rolls the wheel along axis x up.
    heading = math.atan2(-axis[0], axis[1])
    roller = math.radians(item.numbers(("roller_deg",)).get("roller_deg", 0.0))
    return OmniWheel(joint.name, (float(hub[0]), float(hub[1])), heading, roller)


def _ackermann(section: _DriveSection) -> AckermannSpec:
    numbers = ("max_steering_deg", "max_steering_rate", "max_steering_torque", "min_turning_radius")
    measured_keys = ("wheelbase", "wheel_separation", "steering_separation")
    keys = ("left_joint", "right_joint", "left_steering_joint", "right_steering_joint")
    section.settings.check_keys(("type", *keys, "wheel_radius", *measured_keys, *numbers, *_LIMITS))
    left, right = (section.wheel(section.settings.text(key)) for key in keys[:2])
    left_pin, right_pin = (section.steering_joint(section.settings.text(key)) for key in keys[2:])
    rear, front = (
        float(section.frame(a[0])[0, 3] + section.frame(b[0])[0, 3]) / 2 for a, b in ((left, right), (left_pin, right_pin))
    )
    if front <= rear:
        raise RobotError(
            f"{section.where}: {quoted(left_pin[0].name)} is not in front (+x) of {quoted(left[0].name)}; were they swapped?"
        )
    values = section.settings.numbers((*measured_keys, *numbers, *_LIMITS))
    values.setdefault("wheelbase", front - rear)
    values.setdefault("wheel_separation", section.track(left[0], right[0]))
    values.setdefault("steering_separation", section.track(left_pin[0], right_pin[0]))
    return AckermannSpec(
        left_joint=left[0].name, right_joint=right[0].name, left_sign=left[1], right_sign=right[1],
        left_steering_joint=left_pin[0].name, right_steering_joint=right_pin[0].name,
        left_steering_sign=left_pin[1], right_steering_sign=right_pin[1],
        max_steering=_max_steering(section, values.pop("max_steering_deg", None), (left_pin[0], right_pin[0])),
        wheel_radius=section.radius((left[0], right[0])), rear_axle_x=rear, **values,
    )  # fmt: skip


def _max_steering(section: _DriveSection, given_deg: float | None, pins: Sequence[UrdfJoint]) -> float:
    """Returns the maximum angle, radians, to which both wheels can be steered in both directions."""
    ends = [min(-joint.lower, joint.upper) for joint in pins if joint.lower <= joint.upper]
    if given_deg is None:
        if not ends:
            raise RobotError(f"{section.model.path}: the steering joints have no limits; give drive.max_steering_deg")
        return min(ends)
    if ends and math.radians(given_deg) > min(ends) + 1e-6:
        raise RobotError(
            f"{section.where}: max_steering_deg is {given_deg:g}, the limits of the joints allow {math.degrees(min(ends)):g}"
        )
    return math.radians(given_deg)


_READERS: dict[str, Callable[[_DriveSection], DriveSpec]] = {
    "differential": _differential, "skid_steer": _skid_steer, "omni": _omni, "ackermann": _ackermann, "planar": _planar,
}  # fmt: skip


def _wheel_radius(model: UrdfModel, link_name: str) -> float:
    """Returns the radius of the largest sphere, cylinder or capsule of a link: of its collision shapes, else of its visuals."""
    link = model.link(link_name)
    for shapes in ([c.shape for c in link.collisions], [v.shape for v in link.visuals]):
        radii = [shape.size[0] for shape in shapes if shape.kind in ROUND_KINDS]
        if radii:
            return max(radii)
    raise RobotError(
        f"{model.path}: link {quoted(link_name)} has no sphere, cylinder or capsule for the radius of the wheel; give drive.wheel_radius"
    )
