"""Views: cameras that are not mounted on a robot, but follow one, orbit it or look down on the floor. Pure values.

The pose of a view depends only on the state, so that a repeated run has the same images. ``Views`` adds each view as a link to
``SceneState.links``, with the name of its camera. The names of a body's links contain a slash, so the two never collide.
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
"""Target name of the first robot of the scene."""
_CLEAR_RADIUS = 0.7
"""Radius about the point at the centre of the image that the near plane never cuts, metres; objects nearer to the camera may be cut away."""
_MARGIN = 1.04
"""Ratio of the extent of a view of the whole floor to that of the floor."""
_BODY_SPAN = 6.0
"""Default span of a view from above on a body, metres."""


@dataclass(frozen=True, slots=True)
class FloorExtent:
    """The bounding rectangle of a floor, world frame."""

    low: tuple[float, float]
    """Lowest x and y, metres."""
    high: tuple[float, float]
    """Highest x and y, metres."""
    z: float
    """Height of the floor, metres."""


FloorLookup = Callable[[], FloorExtent]
"""Returns the extent of the floor; called only for a view that shows all of it."""


@dataclass(frozen=True, slots=True)
class View:
    """A camera and its motion."""

    camera: CameraSpec
    """Camera whose ``link`` is its own name and whose ``pose`` is the identity."""
    motion: Motion
    near_requested: bool = False
    """Whether ``camera.near`` was requested; else the motion determines it."""


class Views:
    """The views of one revision of a scene; views whose target is not in the scene are left out.

    Args:
        views: the requested views.
        scene: the scene without the views.
        robot: name of the first robot; empty = no robot.
        floor: returns the extent of the floor.

    Raises:
        GibsonSimError: a view cannot show its target, or the extent of the floor is unknown.
    """

    def __init__(self, views: Iterable[View], scene: DrawnScene, robot: str, floor: FloorLookup) -> None:
        self._scene = scene
        self._names = {camera.name for camera in scene.cameras}
        self._paths: list[CameraPath] = []
        self._rows: list[int] = []
        cameras: list[CameraSpec] = []
        self.absent: dict[str, str] = {}
        """Camera name -> reason why its view is left out, one line."""
        for view in views:
            try:
                row = self._row(view, robot)
            except ConfigError as error:
                self.absent[view.camera.name] = str(error)
                continue
            path, near = view.motion.resolve(view.camera, floor)
            camera = (
                view.camera if view.near_requested else replace(view.camera, near=near, far=max(view.camera.far, near + 20.0))
            )
            cameras.append(camera)
            self._names.add(camera.name)
            self._paths.append(path)
            self._rows.append(row)
        self.cameras = tuple(cameras)
        """Cameras of the views that are not left out."""

    @property
    def scene(self) -> DrawnScene:
        """The scene with the links and cameras of the views appended."""
        view_links = tuple(camera.link for camera in self.cameras)
        return replace(self._scene, links=(*self._scene.links, *view_links), cameras=(*self._scene.cameras, *self.cameras))

    def poses(self, state: SceneState) -> list[Pose]:
        """Returns T_world_optical of each camera at a state of the scene without the views."""
        poses = []
        for path, row in zip(self._paths, self._rows, strict=True):
            target = Pose()
            if row >= 0:
                x, y, z = state.positions[row].tolist()
                qx, qy, qz, qw = state.quats_xyzw[row].tolist()
                target = Pose((x, y, z), (qx, qy, qz, qw))
            poses.append(path.camera_pose(target, state.stamp_ns))
        return poses

    def extended(self, state: SceneState, poses: Sequence[Pose] | None = None) -> SceneState:
        """Returns the state with the views as links at rest; ``poses``: the result of ``self.poses``, None = compute it."""
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
        """Returns the row of a view's target in ``SceneState.links``; -1 = the view has no target.

        Raises:
            ConfigError: the target is not in the scene, or the scene has a camera of the view's name.
        """
        name, target, links = view.camera.name, view.motion.target, self._scene.links
        if name in self._names or view.camera.link in links:
            raise ConfigError(
                f"view {quoted(name)}: the scene already has a camera of this name; give the view another name, in a file"
            )
        if not target:
            return -1
        if target in links:
            return links.index(target)
        body = robot if target == ROBOT else target
        bodies = list(dict.fromkeys(link.partition("/")[0] for link in links if "/" in link))
        if body not in bodies:
            reason = "there is no robot" if target == ROBOT else f"there is no body {quoted(target)}"
            known = ", ".join(bodies[:20]) + (", ..." if len(bodies) > 20 else "")
            raise ConfigError(f"view {quoted(name)}: {reason}; it can follow: {known or 'nothing'}")
        # The links of a body are contiguous, the root first.
        return next(row for row, link in enumerate(links) if link.startswith(f"{body}/"))


class Motion(Protocol):
    """The requested motion of a view."""

    @property
    def target(self) -> str:
        """Body, ``<body>/<link>`` or ``robot`` that the view follows; empty = none."""

    def resolve(self, camera: CameraSpec, floor: FloorLookup) -> tuple[CameraPath, float]:
        """Returns the path of the camera in a scene, and its near distance, metres along the optical axis."""


class CameraPath(Protocol):
    """The pose of a view over time."""

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical; ``target``: T_world_target (the identity without a target), ``stamp_ns``: nanoseconds since load."""


@dataclass(frozen=True, slots=True)
class Fixed:
    """A fixed camera."""

    pose: Pose
    """T_world_optical."""
    target: str = ""

    def resolve(self, camera: CameraSpec, floor: FloorLookup) -> tuple[CameraPath, float]:
        """Returns itself, and the near distance of the camera."""
        return self, camera.near

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        return self.pose


@dataclass(frozen=True, slots=True)
class Follow:
    """A camera behind and above a body that looks at it and turns with its heading; never rolls."""

    target: str = ROBOT
    distance: float = 1.8
    """Horizontal distance from the target's origin, metres."""
    height: float = 1.5
    """Height above the target's origin, metres."""
    look_at: float = 0.3
    """Height above the target's origin of the point at the centre of the image, metres."""
    yaw: float = 0.0
    """Direction to the camera, radians, counter-clockwise from above: 0 = behind, pi / 2 = to the right, pi = in front."""

    def __post_init__(self) -> None:
        _check_aim("follow", self.distance, self.height, self.look_at)
        if not self.target:
            raise ConfigError(f"follow: target is empty; give a robot, a body or a link, or {quoted(ROBOT)} for the first robot")

    def resolve(self, camera: CameraSpec, floor: FloorLookup) -> tuple[CameraPath, float]:
        """Returns itself, and a near distance that cuts away objects in front of the target."""
        return self, _near_distance(camera, self.distance, self.height, self.look_at)

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        direction = yaw_from_quat(target.quat_xyzw) + self.yaw + math.pi
        return _look_at_pose(target.position, direction, self.distance, self.height, self.look_at)


@dataclass(frozen=True, slots=True)
class Orbit:
    """A camera that orbits a body or a point and looks at it; does not turn with the body."""

    target: str = ROBOT
    """Body, ``<body>/<link>`` or ``robot``; empty if ``center`` is given."""
    center: Vec3 | None = None
    """Centre of the orbit, world frame, metres; None = the target's origin."""
    distance: float = 2.2
    """Radius of the orbit, metres."""
    height: float = 1.8
    """Height of the camera above the centre of the orbit, metres."""
    look_at: float = 0.3
    """Height above the centre of the orbit of the point at the centre of the image, metres."""
    period: float = 20.0
    """Period of the orbit, seconds of simulation time, counter-clockwise from above; negative = clockwise."""
    yaw: float = 0.0
    """Direction from the target to the camera at time 0, radians from the world's x axis."""

    def __post_init__(self) -> None:
        _check_aim("orbit", self.distance, self.height, self.look_at)
        if not 0.1 <= abs(self.period) <= 1e6:
            raise ConfigError(f"orbit: period is {self.period:g} s, must be 0.1 to 1,000,000, negative for clockwise")
        if bool(self.target) == (self.center is not None):
            raise ConfigError(f"orbit: target is {quoted(self.target)} and center is {self.center}; give one of the two")

    def resolve(self, camera: CameraSpec, floor: FloorLookup) -> tuple[CameraPath, float]:
        """Returns itself, and a near distance that cuts away objects in front of the target."""
        return self, _near_distance(camera, self.distance, self.height, self.look_at)

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        period_ns = round(abs(self.period) * NS_PER_S)
        direction = self.yaw + math.copysign(2.0 * math.pi, self.period) * (stamp_ns % period_ns) / period_ns
        center = target.position if self.center is None else self.center
        return _look_at_pose(center, direction, self.distance, self.height, self.look_at)


@dataclass(frozen=True, slots=True)
class Top:
    """A camera that looks straight down on the whole floor or on a body. Everything above ``cut`` is cut away, which reveals the rooms."""

    target: str = ""
    center: tuple[float, float] | None = None
    """Centre of the image, world metres; None = the centre of the floor, or the target."""
    span: float = 0.0
    """Width of the image at the height of the cut, metres; 0 = the whole floor, or 6 m about a target."""
    cut: float = 2.1
    """Height of the near plane above the floor, or above the target's origin, metres."""
    yaw: float = 0.0
    """Rotation of the camera, radians, counter-clockwise from above; at 0 the world's y axis points up in the image."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.span <= 10_000.0:
            raise ConfigError(f"top: span is {self.span:g} m, must be 0 to 10,000; 0 = the whole floor, or 6 m about a target")
        if not 0.05 <= self.cut <= 1000.0:
            raise ConfigError(f"top: cut is {self.cut:g} m above the floor, must be 0.05 to 1,000")
        if self.target and self.center is not None:
            raise ConfigError(f"top: target is {quoted(self.target)} and center is {self.center}; give one of the two")

    def resolve(self, camera: CameraSpec, floor: FloorLookup) -> tuple[CameraPath, float]:
        """Returns the path of the camera, and the distance from the camera down to the cut as near distance.

        Raises:
            ConfigError: the camera is not a pinhole camera.
        """
        if camera.projection != "pinhole":
            raise ConfigError(
                f"camera {quoted(camera.name)}: a view from the top must be pinhole, its projection is {camera.projection}"
            )
        k = camera.intrinsics()
        wide, high = camera.width / float(k[0, 0]), camera.height / float(k[1, 1])  # visible extent at a distance of 1 m
        if self.target:
            distance = (self.span or _BODY_SPAN) / wide
            return _Above(None, distance + self.cut, self.yaw), distance
        extent = floor()
        sizes = [_MARGIN * (end - begin) for begin, end in zip(extent.low, extent.high, strict=True)]
        cos, sin = abs(math.cos(self.yaw)), abs(math.sin(self.yaw))
        across, along = sizes[0] * cos + sizes[1] * sin, sizes[0] * sin + sizes[1] * cos
        distance = self.span / wide if self.span else max(across / wide, along / high, 0.1)
        x, y = self.center or ((extent.low[0] + extent.high[0]) / 2.0, (extent.low[1] + extent.high[1]) / 2.0)
        return _Above((x, y, extent.z), distance + self.cut, self.yaw), distance


@dataclass(frozen=True, slots=True)
class _Above:
    """A camera above a point of the world or the target that looks down."""

    point: Vec3 | None
    """Point, world frame, metres; None = the target's origin."""
    height: float
    """Height of the camera above the point, metres."""
    yaw: float
    """Rotation of the camera, as ``Top.yaw``."""

    def camera_pose(self, target: Pose, stamp_ns: int) -> Pose:
        """Returns T_world_optical."""
        x, y, z = target.position if self.point is None else self.point
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        T_world_optical = np.eye(4)
        T_world_optical[:3, :3] = [[cos, sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, -1.0]]
        T_world_optical[:3, 3] = x, y, z + self.height
        return pose_from_matrix(T_world_optical)


def _look_at_pose(origin: Vec3, direction: float, distance: float, height: float, look_at: float) -> Pose:
    """Returns T_world_optical of a camera without roll that looks at a point above ``origin``; ``direction``: of the camera from it, radians."""
    cos, sin = math.cos(direction), math.sin(direction)
    slant = math.hypot(distance, height - look_at)
    level, down = distance / slant, (height - look_at) / slant
    T_world_optical = np.eye(4)
    T_world_optical[:3, 0] = -sin, cos, 0.0
    T_world_optical[:3, 1] = down * cos, down * sin, -level
    T_world_optical[:3, 2] = -level * cos, -level * sin, -down
    T_world_optical[:3, 3] = origin[0] + distance * cos, origin[1] + distance * sin, origin[2] + height
    return pose_from_matrix(T_world_optical)


def _near_distance(camera: CameraSpec, distance: float, height: float, look_at: float) -> float:
    """Returns a near distance, metres, that cuts away objects in front of the target, but nothing of a level floor."""
    if camera.projection != "pinhole":
        return camera.near
    near = math.hypot(distance, height - look_at) - _CLEAR_RADIUS
    if height > 0.0:
        k = camera.intrinsics()
        below = (camera.height - 1 - float(k[1, 2])) / float(k[1, 1])  # tangent of the angle between the axis and the lowest row
        steepest = math.atan2(height - look_at, distance) + math.atan(below)
        if steepest > 0.0:
            near = min(near, 0.95 * height / (math.sin(steepest) * math.hypot(1.0, below)))
    return max(camera.near, near)


def _check_aim(what: str, distance: float, height: float, look_at: float) -> None:
    if not 0.05 <= distance <= 1000.0:
        raise ConfigError(f"{what}: distance is {distance:g} m, must be 0.05 to 1,000")
    for name, value in (("height", height), ("look_at", look_at)):
        if not abs(value) <= 1000.0:
            raise ConfigError(f"{what}: {name} is {value:g} m, must be -1,000 to 1,000")
