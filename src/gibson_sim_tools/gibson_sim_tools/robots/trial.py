"""Test-drives a robot in one process, without ROS: rest on a flat floor, 1 m ahead, a full turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.extents import MeshPoints
from gibson_sim.description.urdf import read_urdf
from gibson_sim.geometry.transforms import matrices_from_poses, matrix_from_pose, wrap_angle
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.drive_spec import AckermannSpec, DriveSpec, OmniSpec, PlanarSpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, VelocityCommand
from gibson_sim_tools.robots.stability import Stability, base_links, footprint, stability, stands_on_line

STEP_HZ = 240
"""Physics rate, steps per second, the default of a simulation."""
_REST_S = 2.0
"""Time for a robot to come to rest, s."""
_STOP_S = 1.0
"""Time to stop after each motion, s."""
_STEER_S = 1.0
"""Time to steer the wheels of a car before it drives a circle, s."""
_DISTANCE = 1.0
"""Length of a straight motion, m."""
_SPEED, _TURN_RATE = 0.3, 1.0
"""Speeds of the test drive, m/s and rad/s, unless the robot's limits are lower."""
_RAMP = 0.25
"""Largest fraction of a motion spent accelerating."""
_CURVATURE = 0.9
"""Curvature of a car's circle, as a fraction of its maximum curvature."""
_FALLEN = math.radians(30.0)
"""Tilt above which a robot has fallen over, radians."""
_LEANING = math.radians(3.0)
"""Tilt at rest above which a robot on two wheels has no caster, radians; a caster slightly above the floor causes less tilt."""
_MIN_CORNERS = 3
"""Minimum number of corners of a support polygon."""
_SAMPLE_STEPS = 4
"""Physics steps between two readings of the pose; short enough to count turns."""
_NEVER_S = 1e6
"""Command timeout, s, longer than any trial: commands never become stale."""


class Planar(NamedTuple):
    """A pose on the floor."""

    x: float
    """Position, m."""
    y: float
    """Position, m."""
    yaw: float
    """Heading, radians, unwrapped: it counts full turns."""


@dataclass(frozen=True, slots=True)
class DriveTest:
    """Result of one motion of the test drive, in the base frame at its start."""

    name: str
    """Title, such as "1 m forward"."""
    commanded: Planar
    """Commanded change of the pose: m, m, radians."""
    driven: Planar
    """True change of the pose, measured after the stop."""
    odometry: Planar
    """Change of the pose according to wheel odometry."""
    tilt: float
    """Largest tilt of the base during the motion, radians."""

    @property
    def turns(self) -> bool:
        """Whether the motion is a turn, not a straight line."""
        return self.commanded.yaw != 0.0

    @property
    def slip(self) -> float:
        """Wheel slip: 1 - true motion / wheel odometry, of the angle for a turn, else of the distance."""
        if self.turns:
            return 1.0 - self.driven.yaw / self.odometry.yaw if self.odometry.yaw else 0.0
        rolled = math.hypot(self.odometry.x, self.odometry.y)
        return 1.0 - math.hypot(self.driven.x, self.driven.y) / rolled if rolled else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RobotTrial:
    """Measurements of a test drive."""

    robot: RobotSpec
    stability: Stability
    """Static stability at rest, joints in the start pose."""
    tilt: float
    """Angle between the base's z axis and the vertical at rest, radians."""
    pitch: float
    """Pitch of the base at rest, radians, positive = nose down."""
    roll: float
    """Roll of the base at rest, radians, positive = right side down."""
    drift: float
    """Horizontal distance moved without a command in the first two seconds, m."""
    footprint: NDArray[np.float64]
    """Corners of the convex footprint, (N, 2), m, base frame."""
    drives: tuple[DriveTest, ...] = ()
    """Motions of the test drive; empty = the robot has no drive, has fallen over, or cannot stand."""
    warnings: tuple[str, ...] = field(default=())
    """Masses, inertias and meshes missing in the description, one line each."""
    lacks_support: bool = False
    """Whether the wheels and casters are too few to stand upright: two wheels, for instance."""

    @property
    def has_fallen(self) -> bool:
        """Whether the robot fell over before the test drive."""
        return self.tilt > _FALLEN


def try_robot(robot: RobotSpec, points: MeshPoints | None = None) -> RobotTrial:
    """Measures how a robot stands and drives on a flat floor. Deterministic.

    Args:
        robot: The robot; it starts at the origin.
        points: Reads the vertices of meshes; None = meshes count neither in the footprint nor in the support polygon.

    Raises:
        RobotError: it cannot be simulated.
        PhysicsError: the physics engine rejects it.
    """
    scene = SceneSpec("trial", robot.urdf.parent, "", (), (), ground_z=0.0, robots=(replace(robot, start=Pose(), namespace=""),))
    model = read_urdf(robot.urdf)
    with PhysicsWorld(scene, step_hz=STEP_HZ, cmd_vel_timeout=_NEVER_S) as world:
        world.step(round(_REST_S * STEP_HZ))
        pose = matrix_from_pose(world.base_pose(robot.name))
        state = world.state()
        transforms = matrices_from_poses(state.positions, state.quats_xyzw)
        links = {name.partition("/")[2]: T for name, T in zip(state.links, transforms, strict=True)}
        T_base_links = base_links(pose, links)
        stability_at_rest, tilt = stability(model, T_base_links, points), _tilt(pose)
        lacks_support = robot.drive is not None and (
            len(stability_at_rest.support) < _MIN_CORNERS or (tilt > _LEANING and stands_on_line(model, points))
        )
        trial = RobotTrial(
            robot, stability_at_rest, tilt, pitch=-math.asin(max(-1.0, min(1.0, float(pose[2, 0])))),
            roll=math.atan2(float(pose[2, 1]), float(pose[2, 2])), drift=math.hypot(float(pose[0, 3]), float(pose[1, 3])),
            footprint=footprint(model, T_base_links, points), warnings=tuple(world.warnings),
            lacks_support=lacks_support and not robot.fixed_base,
        )  # fmt: skip
        if robot.drive is None or trial.has_fallen or trial.lacks_support:
            return trial
        drives = tuple(drive_test(world, robot.name, robot.drive) for drive_test in _drive_tests(robot.drive))
        return replace(trial, drives=drives)


_RunDriveTest = Callable[[PhysicsWorld, str, DriveSpec], DriveTest]


def _drive_tests(drive: DriveSpec) -> tuple[_RunDriveTest, ...]:
    """Returns the functions that run the motions of the test drive."""
    if isinstance(drive, AckermannSpec):
        return (_straight, _circle)
    return (_straight, _sideways, _spin) if isinstance(drive, (OmniSpec, PlanarSpec)) else (_straight, _spin)


def _straight(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    speed = _speed(drive.max_linear, drive.max_linear_acceleration, _SPEED, _DISTANCE)
    return _run_drive_test(world, name, "1 m forward", (speed, 0.0, 0.0), _DISTANCE / speed)


def _sideways(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    assert isinstance(drive, (OmniSpec, PlanarSpec))
    speed = _speed(drive.max_lateral, drive.max_lateral_acceleration, _SPEED, _DISTANCE)
    return _run_drive_test(world, name, "1 m to the left", (0.0, speed, 0.0), _DISTANCE / speed)


def _spin(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    assert not isinstance(drive, AckermannSpec)
    rate = _speed(drive.max_angular, drive.max_angular_acceleration, _TURN_RATE, 2 * math.pi)
    return _run_drive_test(world, name, "turn of 360 degrees", (0.0, 0.0, rate), 2 * math.pi / rate)


def _circle(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    assert isinstance(drive, AckermannSpec)
    curvature = _CURVATURE * drive.max_curvature
    speed = _speed(
        drive.max_linear, drive.max_linear_acceleration, min(_SPEED, drive.max_angular / curvature), 2 * math.pi / curvature
    )
    title = f"circle of {1 / curvature:.2g} m radius"
    return _run_drive_test(world, name, title, (speed, 0.0, speed * curvature), 2 * math.pi / curvature / speed, steer=True)


def _speed(limit: float, acceleration: float, usual: float, distance: float) -> float:
    """Returns the speed of a motion, m/s or rad/s: reached within its first quarter. ``distance``: m or rad."""
    return min(limit, usual, math.sqrt(2 * _RAMP * distance * acceleration))


def _run_drive_test(
    world: PhysicsWorld, name: str, title: str, velocity: tuple[float, float, float], seconds: float, *, steer: bool = False
) -> DriveTest:
    """Commands a velocity (x and y in m/s, yaw in rad/s) for some seconds, then a stop, and returns the result."""
    if steer:
        _Track(world, name).hold((0.0, 0.0, velocity[2]), round(_STEER_S * STEP_HZ))
    track = _Track(world, name)
    steps = round(seconds * STEP_HZ)
    track.hold(velocity, steps)
    track.hold((0.0, 0.0, 0.0), round(_STOP_S * STEP_HZ))
    x, y, yaw = (value * steps / STEP_HZ for value in velocity)
    # A car's full circle ends at its start.
    commanded = Planar(0.0, 0.0, yaw) if steer else Planar(x, y, yaw)
    return DriveTest(title, commanded, track.driven, track.rolled, track.tilt)


class _Track:
    """Tracks the motion of a robot since construction, from its true pose and from wheel odometry."""

    def __init__(self, world: PhysicsWorld, name: str) -> None:
        self._world, self._name = world, name
        self._start, self._odometry_start = self._read()
        self._now, self._odometry = self._start, self._odometry_start
        self.tilt = 0.0
        """Largest tilt so far, radians."""

    def hold(self, velocity: tuple[float, float, float], steps: int) -> None:
        """Steps the world with a velocity command (x and y in m/s, yaw in rad/s)."""
        world, (x, y, yaw) = self._world, velocity
        world.command(self._name, VelocityCommand((x, y, 0.0), (0.0, 0.0, yaw), world.stamp_ns))
        while steps > 0:
            count = min(_SAMPLE_STEPS, steps)
            world.step(count)
            steps -= count
            pose, odometry = self._read()
            self._now, self._odometry = _unwrapped(self._now, pose), _unwrapped(self._odometry, odometry)
            self.tilt = max(self.tilt, _tilt(matrix_from_pose(world.base_pose(self._name))))

    @property
    def driven(self) -> Planar:
        """True motion, in the base frame at the start."""
        return _relative(self._start, self._now)

    @property
    def rolled(self) -> Planar:
        """Motion according to wheel odometry, in the base frame at the start."""
        return _relative(self._odometry_start, self._odometry)

    def _read(self) -> tuple[Planar, Planar]:
        pose, odometry = matrix_from_pose(self._world.base_pose(self._name)), self._world.odometry(self._name)
        yaw = math.atan2(float(pose[1, 0]), float(pose[0, 0]))
        return Planar(float(pose[0, 3]), float(pose[1, 3]), yaw), Planar(odometry.x, odometry.y, odometry.yaw)


def _unwrapped(last: Planar, pose: Planar) -> Planar:
    """Returns a pose with its yaw unwrapped: it continues that of ``last``."""
    return pose._replace(yaw=last.yaw + wrap_angle(pose.yaw - last.yaw))


def _relative(start: Planar, end: Planar) -> Planar:
    c, s = math.cos(start.yaw), math.sin(start.yaw)
    x, y = end.x - start.x, end.y - start.y
    return Planar(c * x + s * y, -s * x + c * y, end.yaw - start.yaw)


def _tilt(pose: NDArray[np.float64]) -> float:
    """Returns the angle between the z axis of a pose, (4, 4), and the vertical, radians."""
    return math.acos(max(-1.0, min(1.0, float(pose[2, 2]))))
