"""Drives in one process, without ROS: an oracle records a path, then a driver follows it under conditions. Equal seeds give equal bits.

``PathSite`` is a scene with its robot, loaded once for many drives. ``record`` and ``follow`` run one drive each.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.paths.evaluation import Outcome, TracePoint, evaluate
from gibson_path_following.paths.path_geometry import PathGeometry
from gibson_path_following.policies.follower import PathFollower
from gibson_path_following.types import STOP, PathNode, Place, RecordedPath, Velocity, View
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy, yaw_from_quat
from gibson_sim.simulation import Simulation
from gibson_sim.types import Output, VelocityCommand
from gibson_sim_learn.path_following.cameras import Rig
from gibson_sim_learn.path_following.cases import ROBOT, PathCase, path_ground
from gibson_sim_learn.path_following.domains import Conditions
from gibson_sim_learn.path_following.layout import ItemMaker, Layout, draw_layout
from gibson_sim_learn.path_following.oracle import OracleSettings, PurePursuit, avoid_obstacles
from gibson_sim_learn.path_following.photometry import Photometry, RoomLight, photographed, relit_linear

F64 = NDArray[np.float64]
Planar = tuple[float, float, float]
"""x, y, yaw: world frame, metres and radians."""
STEP_HZ, CONTROL_HZ = 120, 5
"""Physics steps, and images and commands, per second of simulation time."""
MAX_LINEAR, MAX_ANGULAR = 0.5, 1.0
"""Limits of commands, m/s and rad/s."""
SPACING = 0.2
"""Distance between the nodes of a path, metres."""
NODE_TURN = math.radians(20.0)
"""Turn after which a node is recorded at any distance, radians."""
_PARTS = 2
"""Parts of a control tick, after each of which a node may be recorded."""
_SETTLE_S = 0.3
"""Simulation time before the first image, in which bodies come to rest, seconds."""
_STANDSTILL_S = 6.0
"""Duration of a standstill that ends a drive, seconds of simulation time."""
_STANDSTILL_DISTANCE = 0.05
"""Largest motion of a robot in a standstill, metres."""
_STANDSTILL_TURN = 0.2
"""Largest turn of a robot in a standstill, radians: a robot that spins to find its path does not stand."""
_SETTLE_AT_END_S = 0.6
"""Time after a driver is finished in which the robot comes to rest, seconds."""
_TICK_S = 1.0 / CONTROL_HZ
"""Duration of a control tick, seconds."""
_DETOUR_CLEARANCE = 0.08
"""Clearance of an oracle's detours beyond the robot's radius, metres."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Input of a driver at one tick. Only oracles may use ``pose``."""

    stamp_ns: int
    view: View
    """Images; empty for drivers that need none."""
    pose: Planar
    """True pose of the robot."""


class Driver(Protocol):
    """Drives the robot along a path."""

    needs_view: bool
    """Whether it uses images."""

    @property
    def place(self) -> Place | None:
        """Estimated place on the path; None = it has no estimate."""

    @property
    def state(self) -> str:
        """State in a word; ``finished`` ends the drive."""

    def drive(self, observation: Observation) -> Velocity:
        """Returns the velocity until the next tick."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One control tick of a drive."""

    stamp_ns: int
    pose: Planar
    """True pose of the robot when the image was taken."""
    command: Velocity
    """Command of the driver."""
    in_collision: bool
    """Whether the robot collided with anything but the floor since the previous tick."""
    index: float
    """Estimated place on the path, node index with a fraction; NaN = none, or lost."""
    state: str
    """State of the driver."""


@dataclass(frozen=True, slots=True)
class Trace:
    """A drive, tick by tick."""

    ticks: tuple[Tick, ...]
    ended: str
    """finished, standing, or time."""
    touched: tuple[str, ...] = ()
    """Names of the bodies that the robot collided with, in the order of the first contact."""
    layout: Layout | None = None
    views: tuple[View, ...] = ()
    """Views of each tick; empty unless they were kept."""

    def outcome(self, recording: Recording) -> Outcome:
        """Returns the metrics of the drive."""
        points = [TracePoint(tick.stamp_ns, *tick.pose, tick.in_collision) for tick in self.ticks]
        return evaluate([(x, y) for x, y, _ in recording.poses], points)

    def place_errors(self, recording: Recording) -> F64:
        """Returns the errors of the estimated places, (K,), in nodes, of the ticks in which the driver followed the path by one.

        The true place is the nearest to the robot's true pose along the recorded path, from one tick to the next.
        """
        poses = np.array(recording.poses)
        poses[:, 2] = np.unwrap(poses[:, 2])
        geometry = PathGeometry(poses, np.array([node.distance for node in recording.path.nodes]))
        station, errors = 0.0, []
        for tick in self.ticks:
            station = geometry.project(np.array(tick.pose), station)
            if tick.state == "following" and not math.isnan(tick.index):
                errors.append(abs(tick.index - np.interp(station, geometry.stations, np.arange(len(poses)))))
        return np.array(errors)


@dataclass(frozen=True, slots=True)
class Recording:
    """A path as an oracle drove it."""

    case: PathCase
    path: RecordedPath
    poses: tuple[Planar, ...]
    """True poses of the nodes."""
    commands: tuple[Velocity, ...]
    """Command of each control tick."""
    line: tuple[tuple[float, float], ...]
    """True position of the robot at each control tick, world frame, metres."""

    @property
    def duration(self) -> float:
        """Duration of the recording, seconds."""
        return len(self.commands) / CONTROL_HZ


class PathSite:
    """A scene with its robot and cameras, for many drives. Close it, or use it in a ``with`` statement.

    Args:
        scene: name or path.
        rig: cameras; None = one pinhole camera.
        robot: name or path.
        device: EGL device that draws, as ``Simulation`` takes it.

    Raises:
        GibsonSimError: scene or robot cannot be used.
    """

    def __init__(self, scene: str, *, rig: Rig | None = None, robot: str = ROBOT, device: int | str | None = None) -> None:
        self.scene = scene
        self.rig = rig or Rig()
        self.ground = path_ground(scene, robot)
        self.simulation = Simulation(self.ground.scene, None, step_hz=STEP_HZ, device=device)
        """Physics and renderer. Use ``begin`` here, not ``simulation.reset``."""
        self.world = self.simulation.world
        self._name = self.ground.robot.name
        self._link = f"{self._name}/{self.ground.robot.base_link}"
        self._contact_s = 0.0
        """Total duration of contacts, seconds."""

    @property
    def pose(self) -> Planar:
        """True pose of the robot."""
        base = self.world.base_pose(self._name)
        return base.position[0], base.position[1], yaw_from_quat(base.quat_xyzw)

    @property
    def stamp_ns(self) -> int:
        """Simulation time since the drive began, ns."""
        return self.world.stamp_ns

    def begin(self, layout: Layout, start: Planar) -> None:
        """Places the robot and all bodies, and sets the time to 0.

        Args:
            layout: the bodies.
            start: pose of the robot.

        Raises:
            SceneError: the robot collides with something there.
        """
        x, y, yaw = start
        pose = pose_from_xyz_rpy((x, y, self.ground.floor.floor_z), (0.0, 0.0, yaw))
        self.world.repopulate([replace(self.ground.robot, start=pose)], layout.bodies)
        self.world.set_step_count(0)
        self.world.collisions(self._name)  # counting begins
        self.world.step(round(_SETTLE_S * STEP_HZ))
        self.world.set_step_count(0)
        count = self.world.collisions(self._name)
        self._contact_s = count.duration
        if count.ongoing:
            raise SceneError(
                f"scene {self.scene!r}: at {x:.2f}, {y:.2f} m the robot touches {count.last_body}; start it elsewhere"
            )

    def advance(self, velocity: Velocity, steps: int = STEP_HZ // CONTROL_HZ) -> str | None:
        """Drives at a velocity for some physics steps, by default a control tick; returns the body it collided with, except the floor."""
        self.world.command(
            self._name, VelocityCommand((velocity.linear, 0.0, 0.0), (0.0, 0.0, velocity.angular), self.world.stamp_ns)
        )
        self.world.step(steps)
        count = self.world.collisions(self._name)
        before, self._contact_s = self._contact_s, count.duration
        return count.last_body if count.duration > before else None

    def view(self, conditions: Conditions, rng: np.random.Generator) -> View:
        """Returns the images of the cameras now.

        Args:
            conditions: light and cameras.
            rng: of the image noise.
        """
        outputs: tuple[Output, ...] = ("rgb",) if conditions.light.is_unchanged else ("rgb", "normal_world", "position")
        cameras = self.rig.cameras(self._link, conditions, outputs)
        images = []
        for frame in self.simulation.renderer.render(self.world.state(), cameras):
            image = frame.rgb
            assert image is not None
            if frame.normal_world is None or frame.position is None:
                images.append(photographed(image, conditions.photometry, rng))
                continue
            x, y, z = frame.T_world_camera[:3, 3].tolist()
            linear = relit_linear(image, frame.normal_world, frame.position, (x, y, z), conditions.light)
            images.append(photographed(linear, conditions.photometry, rng))
        return tuple(images)

    def close(self) -> None:
        """Frees engine and renderer; a second call does nothing."""
        self.simulation.close()

    def __enter__(self) -> PathSite:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


# Drivers


class OracleDriver:
    """Pure pursuit along a line by the true pose.

    Args:
        line: corners (K, 2) of the line, world frame, metres.
        latency_ticks: ticks until its commands take effect, which it compensates.
        settings: None = the defaults.
    """

    needs_view = False

    def __init__(
        self, line: Sequence[tuple[float, float]] | F64, latency_ticks: int = 0, settings: OracleSettings | None = None
    ) -> None:
        self.pursuit = PurePursuit(line, settings)
        self.place: Place | None = None
        self.state = "following"
        self._pending: deque[Velocity] = deque([STOP] * latency_ticks)

    def drive(self, observation: Observation) -> Velocity:
        """Returns the velocity at a pose."""
        x, y, yaw = observation.pose
        for velocity in self._pending:
            yaw += 0.5 * velocity.angular * _TICK_S
            x += velocity.linear * _TICK_S * math.cos(yaw)
            y += velocity.linear * _TICK_S * math.sin(yaw)
            yaw += 0.5 * velocity.angular * _TICK_S
        found = self.pursuit.velocity(x, y, yaw)
        self._pending.append(found)
        self._pending.popleft()
        if self.pursuit.finished:
            self.state = "finished"
        return found


class BlindDriver:
    """Repeats the recorded commands."""

    needs_view = False

    def __init__(self, recording: Recording) -> None:
        self._commands = deque(recording.commands)
        self.place: Place | None = None
        self.state = "following"

    def drive(self, observation: Observation) -> Velocity:
        """Returns the next recorded velocity."""
        if not self._commands:
            self.state = "finished"
            return STOP
        return self._commands.popleft()


class RandomDriver:
    """Drives at random velocities, a new one every second, for the duration of the recording."""

    needs_view = False

    def __init__(self, recording: Recording, rng: np.random.Generator) -> None:
        self._left, self._rng = len(recording.commands), rng
        self._velocity = STOP
        self.place: Place | None = None
        self.state = "following"

    def drive(self, observation: Observation) -> Velocity:
        """Returns a random velocity."""
        if not self._left:
            self.state = "finished"
            return STOP
        if self._left % CONTROL_HZ == 0 or self._velocity == STOP:
            self._velocity = Velocity(
                float(self._rng.uniform(0.0, MAX_LINEAR)), float(self._rng.uniform(-MAX_ANGULAR, MAX_ANGULAR))
            )
        self._left -= 1
        return self._velocity


class FollowerDriver:
    """A follower as on a robot: it gets images alone."""

    needs_view = True

    def __init__(self, follower: PathFollower) -> None:
        self.follower = follower

    @property
    def place(self) -> Place | None:
        """Estimated place on the path."""
        return self.follower.place

    @property
    def state(self) -> str:
        """State of the follower."""
        return self.follower.state

    def drive(self, observation: Observation) -> Velocity:
        """Returns the velocity until the next view."""
        return self.follower.observe(observation.stamp_ns, observation.view)


# One drive


def record(
    site: PathSite, case: PathCase, *, light: RoomLight | None = None, settings: OracleSettings | None = None, seed: int = 0
) -> Recording:
    """Returns the recording of a path that an oracle drives in the unchanged scene.

    Args:
        site: the scene.
        case: the path.
        light: light; None = that of the scene.
        settings: of the oracle; None = the defaults.
        seed: of the image noise.

    Raises:
        SceneError: the robot collides, or does not arrive.
    """
    conditions = Conditions(light=light or RoomLight(), photometry=Photometry())
    rng = np.random.default_rng(seed)
    site.begin(Layout(site.ground.scene.bodies, site.ground.floor), case.start)
    driver = OracleDriver(case.line, settings=settings)
    commands: list[Velocity] = []
    line: list[tuple[float, float]] = []
    nodes: list[_Node] = []
    travelled, step, velocity = 0.0, 0.0, STOP
    last = site.pose
    for part in range(round((case.length / 0.1 + 20.0) * CONTROL_HZ * _PARTS)):
        pose, now_ns = site.pose, site.stamp_ns
        step = math.dist(last[:2], pose[:2])
        travelled, last = travelled + step, pose
        is_tick = part % _PARTS == 0
        if is_tick:
            line.append(pose[:2])
            velocity = driver.drive(Observation(now_ns, (), pose))
        is_over = driver.state == "finished"
        if not nodes or is_over or _is_due(nodes[-1], pose, travelled, step):
            if is_over and len(nodes) > 1 and travelled - nodes[-1].distance < SPACING / 4.0:
                nodes.pop()
            nodes.append(_Node(site.view(conditions, rng), now_ns, travelled, pose, [(0, velocity)]))
        elif is_tick:
            nodes[-1].velocities.append((now_ns - nodes[-1].stamp_ns, velocity))
        if is_over:
            break
        if is_tick:
            commands.append(velocity)
        touched = site.advance(velocity, STEP_HZ // CONTROL_HZ // _PARTS)
        if touched is not None:
            raise SceneError(f"scene {case.scene!r}: the recording of path {case.number} of {case.length:g} m touches {touched}")
    else:
        raise SceneError(f"scene {case.scene!r}: the recording of path {case.number} of {case.length:g} m does not arrive")
    path = RecordedPath(
        site.rig.kind,
        site.rig.field_of_view(),
        tuple(PathNode(node.view, node.stamp_ns, node.distance, tuple(node.velocities), node.pose) for node in nodes),
        SPACING,
    )
    return Recording(case, path, tuple(node.pose for node in nodes), tuple(commands), tuple(line))


@dataclass
class _Node:
    """A node while it is recorded."""

    view: View
    stamp_ns: int
    distance: float
    pose: Planar
    velocities: list[tuple[int, Velocity]]


def _is_due(last: _Node, pose: Planar, travelled: float, step: float) -> bool:
    """Returns whether a node is due: at the time nearest to ``SPACING`` after the last one, or after ``NODE_TURN``.

    Args:
        last: the last node.
        pose: true pose of the robot.
        travelled: distance driven, metres.
        step: distance driven since the previous call, metres.
    """
    turned = abs(math.remainder(pose[2] - last.pose[2], 2.0 * math.pi))
    return travelled - last.distance >= SPACING - step / 2.0 or turned >= NODE_TURN


def oracle_for(site: PathSite, recording: Recording, layout: Layout, conditions: Conditions) -> OracleDriver:
    """Returns an oracle that follows a recording, with detours around obstacles.

    Raises:
        SceneError: there is no detour.
    """
    line = (
        avoid_obstacles(layout.floor, recording.line, site.ground.robot.radius + _DETOUR_CLEARANCE)
        if layout.obstacles
        else recording.line
    )
    return OracleDriver(line, conditions.latency_ticks)


def follow(
    site: PathSite,
    recording: Recording,
    driver_of: Callable[[Layout], Driver],
    conditions: Conditions,
    seed: int,
    *,
    make_item: ItemMaker | None = None,
    keep_views: bool = False,
    on_tick: Callable[[Observation, Velocity], None] | None = None,
) -> Trace:
    """Returns the drive of a driver along a recording. Equal arguments give equal traces, bit for bit.

    Args:
        site: the scene.
        recording: the path.
        driver_of: returns the driver for a layout.
        conditions: differences from the recording.
        seed: of the layout and of the image noise.
        make_item: returns added objects and obstacles, see ``draw_layout``.
        keep_views: whether the trace keeps the images.
        on_tick: called at each tick with the observation, images included, and the command.

    Raises:
        SceneError: the robot cannot stand at the start.
    """
    layout_rng, noise = (np.random.default_rng([seed, k]) for k in range(2))
    layout = draw_layout(site.ground, recording.line, conditions.moved, conditions.obstacles, layout_rng, make_item)
    site.begin(layout, _start(recording.case.start, conditions))
    driver = driver_of(layout)
    pending: deque[Velocity] = deque([STOP] * conditions.latency_ticks)
    ticks: list[Tick] = []
    views: list[View] = []
    touched: list[str] = []
    last: str | None = None
    finished = 0
    limit = round((2.0 * recording.duration + 15.0) * CONTROL_HZ)
    ended = "time"
    while len(ticks) < limit:
        needs_view = driver.needs_view or keep_views or on_tick is not None
        observation = Observation(site.stamp_ns, site.view(conditions, noise) if needs_view else (), site.pose)
        command = _clamped(driver.drive(observation))
        if on_tick is not None:
            on_tick(observation, command)
        place = driver.place
        ticks.append(
            Tick(
                observation.stamp_ns,
                observation.pose,
                command,
                last is not None,
                math.nan if place is None or place.is_lost else place.index,
                driver.state,
            )
        )
        if keep_views:
            views.append(observation.view)
        finished = finished + 1 if driver.state == "finished" else 0
        if finished > _SETTLE_AT_END_S * CONTROL_HZ + conditions.latency_ticks:
            ended = "finished"
            break
        if _is_standstill(ticks):
            ended = "standing"
            break
        pending.append(command)
        last = site.advance(_with_slip(pending.popleft(), conditions))
        if last is not None and last not in touched:
            touched.append(last)
    return Trace(tuple(ticks), ended, tuple(touched), layout, tuple(views))


def _start(pose: Planar, conditions: Conditions) -> Planar:
    """Returns the start of a drive whose path begins at a pose."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    ahead, left = conditions.start_ahead, conditions.start_left
    return x + c * ahead - s * left, y + s * ahead + c * left, yaw + conditions.start_yaw


def _clamped(velocity: Velocity) -> Velocity:
    """Returns a velocity within ``MAX_LINEAR`` and ``MAX_ANGULAR``."""
    if not (math.isfinite(velocity.linear) and math.isfinite(velocity.angular)):
        raise ConfigError(f"a driver returned {velocity}, must be finite")
    return Velocity(min(max(velocity.linear, -MAX_LINEAR), MAX_LINEAR), min(max(velocity.angular, -MAX_ANGULAR), MAX_ANGULAR))


def _with_slip(command: Velocity, conditions: Conditions) -> Velocity:
    """Returns the true velocity of a command, after slip and yaw bias."""
    linear = conditions.slip * command.linear
    return Velocity(linear, conditions.slip * command.angular + conditions.yaw_bias * linear)


def _is_standstill(ticks: Sequence[Tick]) -> bool:
    """Returns whether the robot has stood for ``_STANDSTILL_S``."""
    count = round(_STANDSTILL_S * CONTROL_HZ)
    if len(ticks) <= count or math.dist(ticks[-1].pose[:2], ticks[-1 - count].pose[:2]) > _STANDSTILL_DISTANCE:
        return False
    x, y, yaw = (np.array([tick.pose[k] for tick in ticks[-1 - count :]]) for k in range(3))
    return float(max(np.ptp(x), np.ptp(y))) < _STANDSTILL_DISTANCE and float(np.ptp(np.unwrap(yaw))) < _STANDSTILL_TURN
