"""Drive specifications: pure values, one class for each kind of drive.

All are in the frame of the base (x forward, y left). ``robots.drives`` implements the kinematics, ``robots.loading.drive`` reads the files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import Vec3

DriveKind = Literal["differential", "skid_steer", "omni", "ackermann", "planar"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Motion:
    """Common fields of all drives."""

    max_linear: float = 0.5
    """Maximum forward speed, m/s."""
    max_angular: float = 2.0
    """Maximum yaw rate, rad/s."""
    max_linear_acceleration: float = 1.0
    """Maximum forward acceleration and deceleration, m/s^2."""
    command_delay: float = 0.0
    """Delay from the arrival of a command to its effect on the motors, s, 0 to 10; rounded to whole physics steps."""
    slip: float = 0.0
    """Slip of translation: fraction of the rolled distance that the base does not move, -0.5 to 0.9; below 0 it moves farther."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Limits(_Motion):
    """Common fields of drives whose wheels roll in one direction."""

    wheel_radius: float
    """Radius of the driven wheels, metres."""
    max_wheel_torque: float = 10.0
    """Torque limit of each driven wheel, N m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialSpec(_Limits):
    """Velocity-controlled wheels on the left and on the right: one per side (differential) or more (skid steer)."""

    left_joints: tuple[str, ...]
    right_joints: tuple[str, ...]
    """Joints of the right wheels, as many as on the left."""
    wheel_separation: float
    """Distance between the contact points of left and right wheels, metres; skid steer: effective separation, with which wheels without
    slip would turn the same."""
    kind: DriveKind = "differential"
    max_angular_acceleration: float = 4.0
    """Maximum yaw acceleration, rad/s^2."""
    turn_slip: float = 0.0
    """Slip of rotation: fraction of the rolled rotation that the base does not make, -0.5 to 0.9."""
    traction: float = 0.8
    """Skid steer: maximum total force of the wheels along the floor, as a fraction of the load on them."""
    left_signs: tuple[float, ...] = ()
    """Sign of each left joint: +1 if positive rotation rolls the robot forward, -1 if the axis is reversed; empty = all +1."""
    right_signs: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _check_positive(
            self, "wheel_radius", "wheel_separation", "max_linear", "max_angular",
            "max_linear_acceleration", "max_angular_acceleration", "max_wheel_torque", "traction",
        )  # fmt: skip
        _check_response(self.command_delay, self.slip, self.turn_slip)
        _check_joints((*self.left_joints, *self.right_joints))
        left, right = len(self.left_joints), len(self.right_joints)
        if left != right or left < 1:
            raise ConfigError(
                f"drive: {left} left and {right} right wheels, must be one or more per side, and the same number on both"
            )


@dataclass(frozen=True, slots=True)
class OmniWheel:
    """A wheel with rollers: a mecanum or an omni wheel."""

    joint: str
    position: tuple[float, float]
    """Position x, y of its hub in the base frame, metres."""
    heading: float
    """Rolling direction for positive rotation of the joint, radians from x, counter-clockwise."""
    roller: float = 0.0
    """Angle from ``heading`` to the axis of the roller on the floor, radians, counter-clockwise seen from above; 0 = an omni wheel."""

    def speed_row(self, radius: float) -> Vec3:
        """Returns the coefficients of the base velocities (x, y, yaw) in the joint speed, rad/s.

        A roller cannot roll along its axis: floor and rim have the same velocity in that direction.
        """
        along_x, along_y = math.cos(self.heading + self.roller), math.sin(self.heading + self.roller)
        grip = radius * math.cos(self.roller)
        x, y = self.position
        return along_x / grip, along_y / grip, (x * along_y - y * along_x) / grip


@dataclass(frozen=True, slots=True, kw_only=True)
class _AllDirections(_Motion):
    """Common fields of drives that move the base in all directions."""

    max_lateral: float = 0.5
    """Maximum lateral speed, m/s."""
    max_lateral_acceleration: float = 1.0
    """Maximum lateral acceleration, m/s^2."""
    max_angular_acceleration: float = 4.0
    """Maximum yaw acceleration, rad/s^2."""
    turn_slip: float = 0.0
    """Slip of rotation: fraction of the rolled rotation that the base does not make, -0.5 to 0.9."""
    traction: float = 0.5
    """Maximum total force along the floor, as a fraction of the load on what drives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OmniSpec(_AllDirections):
    """Three or more wheels with rollers, which move the base in all directions."""

    wheels: tuple[OmniWheel, ...]
    wheel_radius: float
    """Radius of the driven wheels, metres."""
    max_wheel_torque: float = 10.0
    """Torque limit of each driven wheel, N m."""

    def __post_init__(self) -> None:
        _check_positive(
            self, "wheel_radius", "max_linear", "max_lateral", "max_angular", "max_linear_acceleration",
            "max_lateral_acceleration", "max_angular_acceleration", "max_wheel_torque", "traction",
        )  # fmt: skip
        _check_response(self.command_delay, self.slip, self.turn_slip)
        _check_joints(tuple(wheel.joint for wheel in self.wheels))
        for wheel in self.wheels:
            if abs(math.cos(wheel.roller)) < 0.1:
                raise ConfigError(
                    f"drive: rollers of {quoted(wheel.joint)} are at {math.degrees(wheel.roller):g} degrees, so that its motor only turns "
                    "them; 0 is an omni wheel, 45 or -45 mecanum"
                )
        if len(self.wheels) < 3 or np.linalg.matrix_rank(self.wheel_matrix(), tol=1e-3 / self.wheel_radius) < 3:
            raise ConfigError(
                f"drive: {len(self.wheels)} wheels in this arrangement cannot move the base in all directions; "
                "give three or more, with rollers or headings that differ"
            )

    @property
    def kind(self) -> DriveKind:
        """Value of ``drive.type`` in the file."""
        return "omni"

    def wheel_matrix(self) -> NDArray[np.float64]:
        """Returns the (N, 3) matrix that maps base velocities (x m/s, y m/s, yaw rad/s) to joint speeds, rad/s."""
        return np.array([wheel.speed_row(self.wheel_radius) for wheel in self.wheels]).reshape(-1, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarSpec(_AllDirections):
    """A base that moves in all directions by itself, as if on air cushions: its wheels are not simulated, or it has none."""

    free_wheels: tuple[str, ...] = ()
    """Joints of wheels that slide along without friction."""

    def __post_init__(self) -> None:
        _check_positive(
            self, "max_linear", "max_lateral", "max_angular", "max_linear_acceleration", "max_lateral_acceleration",
            "max_angular_acceleration", "traction",
        )  # fmt: skip
        _check_response(self.command_delay, self.slip, self.turn_slip)
        _check_joints(self.free_wheels)

    @property
    def kind(self) -> DriveKind:
        """Value of ``drive.type`` in the file."""
        return "planar"


@dataclass(frozen=True, slots=True, kw_only=True)
class AckermannSpec(_Limits):
    """A car: two driven rear wheels, two steered front wheels."""

    left_joint: str
    """Joint of the left driven wheel."""
    right_joint: str
    left_steering_joint: str
    right_steering_joint: str
    wheelbase: float
    """Distance from the rear axle to the steering joints, metres."""
    wheel_separation: float
    """Distance between the driven wheels, metres."""
    steering_separation: float
    """Distance between the steering joints, metres."""
    max_steering: float
    """Maximum steering angle of the inner wheel, radians."""
    max_steering_rate: float = 1.5
    """Maximum steering rate, rad/s."""
    max_steering_torque: float = 20.0
    """Torque limit of each steering joint, N m."""
    min_turning_radius: float = 0.0
    """Minimum turning radius, measured at the centre of the rear axle, metres; ``max_steering`` may make it larger."""
    rear_axle_x: float = 0.0
    """Position of the rear axle along x in the base frame, metres."""
    left_sign: float = 1.0
    """Sign of the left joint: +1 if positive rotation rolls the car forward, -1 if the axis is reversed."""
    right_sign: float = 1.0
    left_steering_sign: float = 1.0
    """Sign of the left steering joint: +1 if positive rotation steers to the left."""
    right_steering_sign: float = 1.0

    def __post_init__(self) -> None:
        _check_positive(
            self, "wheel_radius", "wheelbase", "wheel_separation", "steering_separation", "max_linear", "max_angular",
            "max_linear_acceleration", "max_wheel_torque", "max_steering", "max_steering_rate", "max_steering_torque",
        )  # fmt: skip
        _check_response(self.command_delay, self.slip)
        _check_joints((self.left_joint, self.right_joint, self.left_steering_joint, self.right_steering_joint))
        if self.max_steering > math.radians(80.0):
            raise ConfigError(f"drive: max_steering is {math.degrees(self.max_steering):g} degrees, must be at most 80")
        if not (math.isfinite(self.min_turning_radius) and self.min_turning_radius >= 0.0):
            raise ConfigError(
                f"drive: min_turning_radius is {quoted(self.min_turning_radius)} m, must be a finite number, 0 or more"
            )

    @property
    def kind(self) -> DriveKind:
        """Value of ``drive.type`` in the file."""
        return "ackermann"

    @property
    def max_curvature(self) -> float:
        """Maximum curvature of the path of the rear axle's centre, 1/m."""
        inner = math.tan(self.max_steering)
        tightest = inner / (self.wheelbase + inner * self.steering_separation / 2)
        return tightest if self.min_turning_radius == 0.0 else min(tightest, 1.0 / self.min_turning_radius)


DriveSpec = DifferentialSpec | OmniSpec | AckermannSpec | PlanarSpec


def _check_positive(spec: DriveSpec, *names: str) -> None:
    for name in names:
        value = getattr(spec, name)
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"drive: {name} is {quoted(value)}, must be a finite number above 0")


def _check_response(command_delay: float, slip: float, turn_slip: float = 0.0) -> None:
    if not 0.0 <= command_delay <= 10.0:
        raise ConfigError(f"drive: command_delay is {quoted(command_delay)} s, must be 0 to 10; was it given in milliseconds?")
    for name, value in (("slip", slip), ("turn_slip", turn_slip)):
        if not -0.5 <= value <= 0.9:
            raise ConfigError(
                f"drive: {name} is {quoted(value)}, must be -0.5 to 0.9; 0 = none, 0.1 = a tenth of the motion is lost"
            )


def _check_joints(names: tuple[str, ...]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"drive: joint {quoted(name)} is named twice; each joint must have one role")
