"""The values that flow between the parts of the simulator: frozen, checked where they are born.

Conventions: metres, radians, seconds (REP 103); time is a whole number of nanoseconds since the scene was loaded;
quaternions are ``(x, y, z, w)``; ``T_a_b`` takes coordinates in b to coordinates in a. Knows neither ROS, PyBullet nor OpenGL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import CommandError, ConfigError

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Rgba = tuple[float, float, float, float]
Output = Literal["rgb", "depth", "semantic", "instance", "normal"]
OUTPUTS: tuple[Output, ...] = ("rgb", "depth", "semantic", "instance", "normal")
DEFAULT_OUTPUTS: tuple[Output, ...] = ("rgb", "depth")
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform, parent from child: a position in metres and a unit quaternion ``(x, y, z, w)``."""

    position: Vec3 = (0.0, 0.0, 0.0)
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.position, *self.quat_xyzw))):
            raise ConfigError(f"pose {self.position} {self.quat_xyzw} holds a NaN or an infinity; all seven must be finite")
        norm = math.sqrt(sum(c * c for c in self.quat_xyzw))
        if abs(norm - 1.0) > 1e-6:
            raise ConfigError(f"quaternion {self.quat_xyzw} (x, y, z, w) has length {norm:g}; it must be 1: normalise it")


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A pinhole camera fixed to a robot link. The camera frame is optical (REP 103): x right, y down, z forward."""

    name: str
    """Name of the camera: its topics live under it, and its frame is ``<name>_optical_frame``."""
    link: str
    """Link that it is fixed to, as named in ``SceneState.links``: ``<body>/<link>``."""
    pose: Pose = field(default_factory=Pose)
    """T_link_optical."""
    width: int = 640
    """Image width, pixels."""
    height: int = 480
    """Image height, pixels."""
    fov_y: float = math.radians(60.0)
    """Vertical field of view, radians, in (0, pi)."""
    near: float = 0.05
    """Nearest distance drawn, metres along the axis."""
    far: float = 100.0
    """Farthest depth reported, metres along the axis; beyond it depth is +inf (REP 117)."""
    rate_hz: float = 30.0
    """Images a second of simulation time."""
    outputs: tuple[Output, ...] = DEFAULT_OUTPUTS
    """What to draw, all in one pass."""

    def __post_init__(self) -> None:
        what = f"camera {self.name!r}"
        if not (1 <= self.width <= 16384 and 1 <= self.height <= 16384):
            raise ConfigError(f"{what}: image size is {self.width}x{self.height}, each side must be 1 to 16384 pixels")
        if not 0.0 < self.fov_y < math.pi:
            raise ConfigError(f"{what}: fov_y is {self.fov_y:g} rad, must be in (0, pi); was it given in degrees?")
        if not 0.0 < self.near < self.far:
            raise ConfigError(f"{what}: near is {self.near:g} m and far is {self.far:g} m, must be 0 < near < far")
        if not 0.0 < self.rate_hz <= 1000.0:
            raise ConfigError(f"{what}: rate_hz is {self.rate_hz:g}, must be in (0, 1000]")
        unknown = [o for o in self.outputs if o not in OUTPUTS]
        if unknown or not self.outputs:
            raise ConfigError(f"{what}: outputs are {list(self.outputs)}, must be one or more of {', '.join(OUTPUTS)}")

    @property
    def optical_frame(self) -> str:
        """The tf frame of its images, ``<name>_optical_frame``."""
        return f"{self.name}_optical_frame"

    def intrinsics(self) -> NDArray[np.float64]:
        """Returns K, shape (3, 3), pixels, square pixels; pixel centres are at whole numbers (OpenCV, ROS)."""
        focal = self.height / 2.0 / math.tan(self.fov_y / 2.0)
        return np.array(
            [[focal, 0.0, (self.width - 1) / 2.0], [0.0, focal, (self.height - 1) / 2.0], [0.0, 0.0, 1.0]],
            dtype=np.float64,
        )


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """Poses of all moving links at one tick, in the world frame (z up)."""

    stamp_ns: int
    """Simulation time of the tick, nanoseconds since load."""
    step: int
    """Physics steps since load."""
    revision: int
    """Revision of the scene whose links these are; a state of another revision must not be drawn."""
    links: tuple[str, ...]
    """Names ``<body>/<link>``, one a row."""
    positions: NDArray[np.float64]
    """(N, 3), metres: origins of the URDF link frames (not centres of mass)."""
    quats_xyzw: NDArray[np.float64]
    """(N, 4), unit quaternions."""
    twists: NDArray[np.float64]
    """(N, 6), world frame: linear velocity of the link frame's origin (m/s), then angular velocity (rad/s)."""

    def __post_init__(self) -> None:
        n = len(self.links)
        shapes = (self.positions.shape, self.quats_xyzw.shape, self.twists.shape)
        if shapes != ((n, 3), (n, 4), (n, 6)):
            raise ConfigError(f"scene state with {n} links has arrays of shapes {shapes}; must be ({n}, 3), ({n}, 4), ({n}, 6)")


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """A wanted velocity of the robot's base, in its own frame (x forward, z up)."""

    linear: Vec3
    """m/s."""
    angular: Vec3
    """rad/s."""
    stamp_ns: int
    """Simulation time at which it arrived."""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.linear, *self.angular))):
            raise CommandError(
                f"velocity command linear={self.linear} angular={self.angular} holds a NaN or an infinity; "
                "it is ignored, send finite m/s and rad/s"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What one camera saw at one tick. Row 0 is the top of the image."""

    camera: CameraSpec
    stamp_ns: int
    """Stamp of the state that was drawn."""
    T_world_camera: NDArray[np.float64]
    """(4, 4), optical frame."""
    rgb: NDArray[np.uint8] | None = None
    """(height, width, 3) uint8, sRGB, or None if not asked for."""
    depth: NDArray[np.float32] | None = None
    """(height, width) float32, metres along the optical axis, +inf = nothing (REP 117/118), or None."""
    semantic: NDArray[np.uint16] | None = None
    """(height, width) uint16, index into the scene's semantic classes, 0 = nothing or unlabelled, or None."""
    instance: NDArray[np.uint16] | None = None
    """(height, width) uint16, index into the scene's instances, 0 = nothing, or None."""
    normal: NDArray[np.float32] | None = None
    """(height, width, 3) float32, unit normals in the optical frame, turned towards the camera, 0 = nothing, or None."""


@dataclass(frozen=True, slots=True, eq=False)
class JointStates:
    """Joints of one body at one tick: radians or metres, and per second."""

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    efforts: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Odometry:
    """What the wheels say: pose of the base in the odom frame, and its velocity in its own frame."""

    x: float
    """Metres, odom frame."""
    y: float
    yaw: float
    """Radians, in (-pi, pi]."""
    linear: float
    """Forward speed, m/s, base frame."""
    angular: float
    """Yaw rate, rad/s."""
