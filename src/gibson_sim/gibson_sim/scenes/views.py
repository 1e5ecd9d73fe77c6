"""Views: cameras on no robot, which follow one, go round it or look down on the floor. Pure values.

Where a view is follows from the state alone, so that a run that is repeated has the same pictures. ``Views`` makes each a link of its
own in ``SceneState.links``, named as its camera. Links of bodies have a slash in their names, so the two never meet.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import pose_from_matrix, yaw_from_quat
from gibson_sim.quoting import quoted
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import NS_PER_S, CameraSpec, Pose, SceneState, Vec3

ROBOT = "robot"
"""Stands for the first robot of the scene."""
_CLEAR = 0.7
"""Metres about what a view looks at that are always drawn: what is nearer to the camera, such as a wall between, is left out."""
_MARGIN = 1.04
"""A view of the whole floor shows so many times its size."""
_NEAR_A_BODY = 6.0
"""Metres that a view from above a body shows."""


@dataclass(frozen=True, slots=True)
class FloorExtent:
    """A rectangle about a floor, world frame, metres."""

    low: tuple[float, float]
    high: tuple[float, float]
    z: float
    """Height of the floor."""


FloorOf = Callable[[], FloorExtent]


class Path(Protocol):
    """Where a view is."""

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical, given T_world_target."""


class Motion(Protocol):
    """How a view moves, as it was asked for."""

    @property
    def target(self) -> str:
        """What it goes with: a body, ``<body>/<link>`` or ``robot``; empty = nothing."""

    def settled(self, camera: CameraSpec, floor: FloorOf) -> tuple[Path, float]:
        """Returns where it is in a scene, and the nearest distance to draw, metres along the axis."""


@dataclass(frozen=True, slots=True)
class View:
    """A camera and how it moves."""

    camera: CameraSpec
    """Its ``link`` is its own name, its ``pose`` nothing."""
    motion: Motion
    own_near: bool = False
    """``camera.near`` was asked for; else it is what the motion says."""


@dataclass(frozen=True, slots=True)
class Fixed:
    """Stays where it is."""

    pose: Pose
    """T_world_optical."""
    target: str = ""

    def settled(self, camera: CameraSpec, floor: FloorOf) -> tuple[Path, float]:
        """Returns itself: it draws what its camera does."""
        return self, camera.near

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        return self.pose


@dataclass(frozen=True, slots=True)
class Follow:
    """Stays behind a body and above it, turns with its heading and looks at it. It never tilts."""

    target: str = ROBOT
    distance: float = 1.8
    """Metres from the vertical through the target's origin."""
    height: float = 1.5
    """Metres above the target's origin."""
    look_at: float = 0.3
    """Height above the target's origin of the point in the middle of the picture, metres."""
    yaw: float = 0.0
    """Radians, counter-clockwise from above: 0 = from behind, pi / 2 = from the right, pi = from the front."""

    def __post_init__(self) -> None:
        _check_looks_at("follow", self.distance, self.height, self.look_at)
        if not self.target:
            raise ConfigError(f"follow: target is empty; give a robot, a body or a link, or {quoted(ROBOT)} for the first robot")

    def settled(self, camera: CameraSpec, floor: FloorOf) -> tuple[Path, float]:
        """Returns itself, and a distance that leaves out what hides the target."""
        return self, _nearest(camera, self.distance, self.height, self.look_at)

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        direction = yaw_from_quat(target.quat_xyzw) + self.yaw + math.pi
        return _looking_at(target.position, direction, self.distance, self.height, self.look_at)


@dataclass(frozen=True, slots=True)
class Orbit:
    """Goes round a body or a point and looks at it. It does not turn with the body."""

    target: str = ROBOT
    """Not heeded where there is a ``center``."""
    center: Vec3 | None = None
    """Point to go round, world frame, metres."""
    distance: float = 2.2
    """Metres from the vertical through the target's origin, or through the point."""
    height: float = 1.8
    """Metres above the same."""
    look_at: float = 0.3
    """Height above the same of the point in the middle of the picture, metres."""
    period: float = 20.0
    """Seconds of simulation time for a turn, counter-clockwise from above; negative = clockwise."""
    yaw: float = 0.0
    """Direction in which the camera stands at time 0, radians from the world's x axis."""

    def __post_init__(self) -> None:
        _check_looks_at("orbit", self.distance, self.height, self.look_at)
        if not 0.1 <= abs(self.period) <= 1e6:
            raise ConfigError(f"orbit: period is {self.period:g} s, must be 0.1 to 1,000,000, negative for clockwise")
        if bool(self.target) == (self.center is not None):
            raise ConfigError(f"orbit: target is {quoted(self.target)} and center is {self.center}; give one of the two")

    def settled(self, camera: CameraSpec, floor: FloorOf) -> tuple[Path, float]:
        """Returns itself, and a distance that leaves out what hides the target."""
        return self, _nearest(camera, self.distance, self.height, self.look_at)

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        period_ns = round(abs(self.period) * NS_PER_S)
        direction = self.yaw + math.copysign(2.0 * math.pi, self.period) * (stamp_ns % period_ns) / period_ns
        around = target.position if self.center is None else self.center
        return _looking_at(around, direction, self.distance, self.height, self.look_at)


@dataclass(frozen=True, slots=True)
class Top:
    """Looks straight down, on the whole floor or on a body. What rises above ``cut`` is not drawn: one sees into the rooms."""

    target: str = ""
    center: tuple[float, float] | None = None
    """Middle of the picture, world metres; None = that of the floor, or the target."""
    span: float = 0.0
    """Metres from the left edge of the picture to the right one, at the height of the cut; 0 = the whole floor, 6 m about a target."""
    cut: float = 2.1
    """Metres above the floor, or above the target's origin."""
    yaw: float = 0.0
    """Radians by which the camera is turned, counter-clockwise from above; at 0 the world's y axis points up in the picture."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.span <= 10_000.0:
            raise ConfigError(f"top: span is {self.span:g} m, must be 0 to 10,000; 0 = the whole floor, or 6 m about a target")
        if not 0.05 <= self.cut <= 1000.0:
            raise ConfigError(f"top: cut is {self.cut:g} m above the floor, must be 0.05 to 1,000")
        if self.target and self.center is not None:
            raise ConfigError(f"top: target is {quoted(self.target)} and center is {self.center}; give one of the two")

    def settled(self, camera: CameraSpec, floor: FloorOf) -> tuple[Path, float]:
        """Returns where it hangs, and the distance from there to the cut.

        Raises:
            ConfigError: its camera is no pinhole.
        """
        if camera.projection != "pinhole":
            raise ConfigError(
                f"camera {quoted(camera.name)}: a view from the top is pinhole, its projection is {camera.projection}"
            )
        k = camera.intrinsics()
        wide, high = camera.width / float(k[0, 0]), camera.height / float(k[1, 1])  # metres seen at a distance of 1 m
        if self.target:
            distance = (self.span or _NEAR_A_BODY) / wide
            return Above(None, distance + self.cut, self.yaw), distance
        whole = floor()
        sizes = [_MARGIN * (end - begin) for begin, end in zip(whole.low, whole.high, strict=True)]
        cos, sin = abs(math.cos(self.yaw)), abs(math.sin(self.yaw))
        across, along = sizes[0] * cos + sizes[1] * sin, sizes[0] * sin + sizes[1] * cos
        distance = self.span / wide if self.span else max(across / wide, along / high, 0.1)
        x, y = self.center or ((whole.low[0] + whole.high[0]) / 2.0, (whole.low[1] + whole.high[1]) / 2.0)
        return Above((x, y, whole.z), distance + self.cut, self.yaw), distance


@dataclass(frozen=True, slots=True)
class Above:
    """Hangs above a point of the world or the target, and looks down."""

    point: Vec3 | None
    """World frame, metres; None = the target's origin."""
    height: float
    """Metres above it."""
    yaw: float

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        x, y, z = target.position if self.point is None else self.point
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        T_world_optical = np.eye(4)
        T_world_optical[:3, :3] = [[cos, sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, -1.0]]
        T_world_optical[:3, 3] = x, y, z + self.height
        return pose_from_matrix(T_world_optical)


def _looking_at(origin: Vec3, direction: float, distance: float, height: float, look_at: float) -> Pose:
    """Returns T_world_optical of a level camera that stands in a direction from an origin and looks at a point above that."""
    cos, sin = math.cos(direction), math.sin(direction)
    slant = math.hypot(distance, height - look_at)
    level, down = distance / slant, (height - look_at) / slant
    T_world_optical = np.eye(4)
    T_world_optical[:3, 0] = -sin, cos, 0.0
    T_world_optical[:3, 1] = down * cos, down * sin, -level
    T_world_optical[:3, 2] = -level * cos, -level * sin, -down
    T_world_optical[:3, 3] = origin[0] + distance * cos, origin[1] + distance * sin, origin[2] + height
    return pose_from_matrix(T_world_optical)


def _nearest(camera: CameraSpec, distance: float, height: float, look_at: float) -> float:
    """Returns the nearest distance to draw: it leaves out what hides the target, but nothing of a level floor."""
    if camera.projection != "pinhole":
        return camera.near
    nearest = math.hypot(distance, height - look_at) - _CLEAR
    if height > 0.0:
        k = camera.intrinsics()
        below = (camera.height - 1 - float(k[1, 2])) / float(k[1, 1])  # of the lowest row, tangent of the angle from the axis
        steepest = math.atan2(height - look_at, distance) + math.atan(below)
        if steepest > 0.0:
            nearest = min(nearest, 0.95 * height / (math.sin(steepest) * math.hypot(1.0, below)))
    return max(camera.near, nearest)


def _check_looks_at(what: str, distance: float, height: float, look_at: float) -> None:
    if not 0.05 <= distance <= 1000.0:
        raise ConfigError(f"{what}: distance is {distance:g} m, must be 0.05 to 1,000")
    for name, value in (("height", height), ("look_at", look_at)):
        if not abs(value) <= 1000.0:
            raise ConfigError(f"{what}: {name} is {value:g} m, must be -1,000 to 1,000")


class Views:
    """The views of one revision of a scene. Those whose target is not there are left out.

    Args:
        views: what was asked for.
        scene: what there is, without the views.
        robot: name of the first robot; empty = there is none.
        floor: says how far the floor reaches; asked only where a view shows all of it.

    Raises:
        GibsonSimError: a view cannot show what it should, or the floor is not known.
    """

    def __init__(self, views: Iterable[View], scene: DrawnScene, robot: str, floor: FloorOf) -> None:
        self._scene = scene
        self._names = {camera.name for camera in scene.cameras}
        self._paths: list[Path] = []
        self._rows: list[int] = []
        cameras: list[CameraSpec] = []
        self.absent: dict[str, str] = {}
        """Why others are not there, by the names of their cameras, one line each."""
        for view in views:
            try:
                row = self._row(view, robot)
            except ConfigError as error:
                self.absent[view.camera.name] = str(error)
                continue
            path, near = view.motion.settled(view.camera, floor)
            camera = view.camera if view.own_near else replace(view.camera, near=near, far=max(view.camera.far, near + 20.0))
            cameras.append(camera)
            self._names.add(camera.name)
            self._paths.append(path)
            self._rows.append(row)
        self.cameras = tuple(cameras)
        """Of the views that are there."""

    @property
    def scene(self) -> DrawnScene:
        """The scene with the views: their links and cameras come last."""
        own = tuple(camera.link for camera in self.cameras)
        return replace(self._scene, links=(*self._scene.links, *own), cameras=(*self._scene.cameras, *self.cameras))

    def poses(self, state: SceneState) -> list[Pose]:
        """Returns T_world_optical of each camera at a state of the scene."""
        found = []
        for path, row in zip(self._paths, self._rows, strict=True):
            target = Pose()
            if row >= 0:
                x, y, z = state.positions[row].tolist()
                qx, qy, qz, qw = state.quats_xyzw[row].tolist()
                target = Pose((x, y, z), (qx, qy, qz, qw))
            found.append(path.camera_pose(target, state.stamp_ns))
        return found

    def extended(self, state: SceneState, poses: Sequence[Pose] | None = None) -> SceneState:
        """Returns the state of ``scene``; ``poses``: those at the state, where they are known. Views have no velocities."""
        if not self.cameras:
            return state
        if poses is None:
            poses = self.poses(state)
        return replace(
            state,
            links=(*state.links, *(camera.link for camera in self.cameras)),
            positions=np.concatenate([state.positions, [pose.position for pose in poses]]),
            quats_xyzw=np.concatenate([state.quats_xyzw, [pose.quat_xyzw for pose in poses]]),
            twists=np.concatenate([state.twists, np.zeros((len(poses), 6))]),
        )

    def _row(self, view: View, robot: str) -> int:
        """Returns the row of a view's target in a state; -1 = it has none."""
        name, target, links = view.camera.name, view.motion.target, self._scene.links
        if name in self._names or view.camera.link in links:
            raise ConfigError(
                f"view {quoted(name)}: the scene has a camera of this name already; give the view another one, in a file"
            )
        if not target:
            return -1
        if target in links:
            return links.index(target)
        body = robot if target == ROBOT else target
        bodies = list(dict.fromkeys(link.partition("/")[0] for link in links if "/" in link))
        if body not in bodies:
            what = "there is no robot" if target == ROBOT else f"nothing is called {quoted(target)}"
            known = ", ".join(bodies[:20]) + (", ..." if len(bodies) > 20 else "")
            raise ConfigError(f"view {quoted(name)}: {what}; it can go with: {known or 'nothing'}")
        # The links of a body stand together, the root first.
        return next(row for row, link in enumerate(links) if link.startswith(f"{body}/"))
