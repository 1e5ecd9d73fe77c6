"""Measures how a robot stands and drives: at rest on a flat floor, a metre ahead, a full turn. In one process, without ROS."""

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
from gibson_sim.robots.drive_spec import AckermannSpec, DriveSpec, OmniSpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, VelocityCommand
from gibson_sim_tools.robots.stability import Stability, base_links, footprint, stability, stands_on_line

STEP_HZ = 240
"""Physics steps per second, as a simulation has them by default."""
_REST_S = 2.0
"""Time in which a robot comes to rest, s."""
_STOP_S = 1.0
"""Time after each drive in which it stops, s."""
_STEER_S = 1.0
"""Time in which the wheels of a car are steered before it drives a circle, s."""
_DISTANCE = 1.0
"""Metres ahead."""
_SPEED, _TURN_RATE = 0.3, 1.0
"""Speeds of the drives, m/s and rad/s, unless the robot's limits are lower."""
_RAMP = 0.25
"""Greatest part of a drive in which it gains speed."""
_CURVATURE = 0.9
"""Curvature of a car's circle, as a fraction of that of its tightest one."""
_FALLEN = math.radians(30.0)
"""Tilt from which on a robot has fallen over, radians."""
_LEANS = math.radians(3.0)
"""Tilt at rest from which on a robot on two wheels has no caster, radians; one a little above the floor tilts it less."""
_LEAST_CORNERS = 3
"""Corners of a support polygon, at least."""
_SAMPLE_STEPS = 4
"""Physics steps between two readings of the pose, which count turns."""
_NEVER_S = 1e6
"""Command timeout, s: commands hold."""


class Planar(NamedTuple):
    """A pose on the floor."""

    x: float
    """Metres."""
    y: float
    """Metres."""
    yaw: float
    """Radians, counts full turns."""


@dataclass(frozen=True, slots=True)
class DriveTest:
    """One motion of the test drive, in the frame of the base at its start."""

    name: str
    """What it is, such as "1 m forward"."""
    commanded: Planar
    """Change of the pose that was commanded: metres, metres, radians."""
    driven: Planar
    """True change of the pose, after the stop."""
    odometry: Planar
    """The same by wheel odometry."""
    tilt: float
    """Greatest tilt of the base on the way, radians."""

    @property
    def turns(self) -> bool:
        """Whether it is a turn, and not a straight line."""
        return self.commanded.yaw != 0.0

    @property
    def slip(self) -> float:
        """Part of the wheels' rolling by which the base moved less: of the distance, or of the angle if it is a turn."""
        if self.turns:
            return 1.0 - self.driven.yaw / self.odometry.yaw if self.odometry.yaw else 0.0
        rolled = math.hypot(self.odometry.x, self.odometry.y)
        return 1.0 - math.hypot(self.driven.x, self.driven.y) / rolled if rolled else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RobotTrial:
    """What was measured."""

    robot: RobotSpec
    stability: Stability
    """At rest, with its joints in the start pose."""
    tilt: float
    """Of the base at rest, radians."""
    pitch: float
    """Of the base at rest, radians, positive = nose down."""
    roll: float
    """Radians, positive = right side down."""
    drift: float
    """Distance by which it moved by itself in the first two seconds, metres, seen from above."""
    footprint: NDArray[np.float64]
    """Corners of a convex polygon around it, (N, 2), metres, base frame."""
    drives: tuple[DriveTest, ...] = ()
    """Empty = it has no drive, has fallen over, or cannot stand."""
    warnings: tuple[str, ...] = field(default=())
    """What the description lacks, one line each: masses, inertias, meshes."""
    lacks_support: bool = False
    """Whether it has too few wheels and casters to stand upright: two wheels, for instance."""

    @property
    def has_fallen(self) -> bool:
        """Whether it fell over before it drove."""
        return self.tilt > _FALLEN


def try_robot(robot: RobotSpec, points: MeshPoints | None = None) -> RobotTrial:
    """Returns how a robot stands and drives on a flat floor; always the same for the same robot.

    Args:
        robot: The robot; it starts at the origin.
        points: Reads meshes; None = meshes count neither in the footprint nor in the support polygon.

    Raises:
        RobotError: it cannot be simulated.
        PhysicsError: the engine refuses it.
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
        stable, tilt = stability(model, T_base_links, points), _tilt(pose)
        lacks_support = robot.drive is not None and (
            len(stable.support) < _LEAST_CORNERS or (tilt > _LEANS and stands_on_line(model, points))
        )
        trial = RobotTrial(
            robot, stable, tilt, pitch=-math.asin(max(-1.0, min(1.0, float(pose[2, 0])))),
            roll=math.atan2(float(pose[2, 1]), float(pose[2, 2])), drift=math.hypot(float(pose[0, 3]), float(pose[1, 3])),
            footprint=footprint(model, T_base_links, points), warnings=tuple(world.warnings),
            lacks_support=lacks_support and not robot.fixed_base,
        )  # fmt: skip
        if robot.drive is None or trial.has_fallen or trial.lacks_support:
            return trial
        drives = tuple(make(world, robot.name, robot.drive) for make in _drives(robot.drive))
        return replace(trial, drives=drives)


_MakeDrive = Callable[[PhysicsWorld, str, DriveSpec], DriveTest]


def _drives(drive: DriveSpec) -> tuple[_MakeDrive, ...]:
    """Returns the motions of the test drive."""
    if isinstance(drive, AckermannSpec):
        return (_straight, _circle)
    return (_straight, _sideways, _spin) if isinstance(drive, OmniSpec) else (_straight, _spin)


def _straight(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    speed = _speed(drive.max_linear, drive.max_linear_acceleration, _SPEED, _DISTANCE)
    return _driven(world, name, "1 m forward", (speed, 0.0, 0.0), _DISTANCE / speed)


def _sideways(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    assert isinstance(drive, OmniSpec)
    speed = _speed(drive.max_lateral, drive.max_lateral_acceleration, _SPEED, _DISTANCE)
    return _driven(world, name, "1 m to the left", (0.0, speed, 0.0), _DISTANCE / speed)


def _spin(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    assert not isinstance(drive, AckermannSpec)
    rate = _speed(drive.max_angular, drive.max_angular_acceleration, _TURN_RATE, 2 * math.pi)
    return _driven(world, name, "turn of 360 degrees", (0.0, 0.0, rate), 2 * math.pi / rate)


def _circle(world: PhysicsWorld, name: str, drive: DriveSpec) -> DriveTest:
    assert isinstance(drive, AckermannSpec)
    curvature = _CURVATURE * drive.max_curvature
    speed = _speed(
        drive.max_linear, drive.max_linear_acceleration, min(_SPEED, drive.max_angular / curvature), 2 * math.pi / curvature
    )
    what = f"circle of {1 / curvature:.2g} m radius"
    return _driven(world, name, what, (speed, 0.0, speed * curvature), 2 * math.pi / curvature / speed, steer=True)


def _speed(limit: float, acceleration: float, usual: float, way: float) -> float:
    """Returns the speed of a drive, which it reaches in the first quarter of its way."""
    return min(limit, usual, math.sqrt(2 * _RAMP * way * acceleration))


def _driven(
    world: PhysicsWorld, name: str, what: str, velocity: tuple[float, float, float], seconds: float, *, steer: bool = False
) -> DriveTest:
    """Commands a velocity (x and y in m/s, yaw in rad/s) for a time, then a stop."""
    if steer:
        _Track(world, name).hold((0.0, 0.0, velocity[2]), round(_STEER_S * STEP_HZ))
    track = _Track(world, name)
    steps = round(seconds * STEP_HZ)
    track.hold(velocity, steps)
    track.hold((0.0, 0.0, 0.0), round(_STOP_S * STEP_HZ))
    x, y, yaw = (value * steps / STEP_HZ for value in velocity)
    # A full turn of a car ends where it began.
    commanded = Planar(0.0, 0.0, yaw) if steer else Planar(x, y, yaw)
    return DriveTest(what, commanded, track.driven, track.rolled, track.tilt)


class _Track:
    """The motion of a robot since some time, by its true pose and by wheel odometry."""

    def __init__(self, world: PhysicsWorld, name: str) -> None:
        self._world, self._name = world, name
        self._start, self._odometry_start = self._read()
        self._now, self._odometry = self._start, self._odometry_start
        self.tilt = 0.0
        """Greatest tilt so far, radians."""

    def hold(self, velocity: tuple[float, float, float], steps: int) -> None:
        """Makes steps with a velocity command."""
        world, (x, y, yaw) = self._world, velocity
        world.command(self._name, VelocityCommand((x, y, 0.0), (0.0, 0.0, yaw), world.stamp_ns))
        while steps > 0:
            count = min(_SAMPLE_STEPS, steps)
            world.step(count)
            steps -= count
            pose, odometry = self._read()
            self._now, self._odometry = _continued(self._now, pose), _continued(self._odometry, odometry)
            self.tilt = max(self.tilt, _tilt(matrix_from_pose(world.base_pose(self._name))))

    @property
    def driven(self) -> Planar:
        """The true motion, in the frame of its start."""
        return _relative(self._start, self._now)

    @property
    def rolled(self) -> Planar:
        """The motion by wheel odometry, in the frame of its start."""
        return _relative(self._odometry_start, self._odometry)

    def _read(self) -> tuple[Planar, Planar]:
        pose, odometry = matrix_from_pose(self._world.base_pose(self._name)), self._world.odometry(self._name)
        yaw = math.atan2(float(pose[1, 0]), float(pose[0, 0]))
        return Planar(float(pose[0, 3]), float(pose[1, 3]), yaw), Planar(odometry.x, odometry.y, odometry.yaw)


def _continued(last: Planar, pose: Planar) -> Planar:
    """Returns a pose whose yaw counts turns."""
    return pose._replace(yaw=last.yaw + wrap_angle(pose.yaw - last.yaw))


def _relative(start: Planar, end: Planar) -> Planar:
    c, s = math.cos(start.yaw), math.sin(start.yaw)
    x, y = end.x - start.x, end.y - start.y
    return Planar(c * x + s * y, -s * x + c * y, end.yaw - start.yaw)


def _tilt(pose: NDArray[np.float64]) -> float:
    """Returns the angle between the z axis of a pose, (4, 4), and the vertical, radians."""
    return math.acos(max(-1.0, min(1.0, float(pose[2, 2]))))
