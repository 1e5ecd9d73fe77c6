"""Values that are exchanged between the parts of the simulator: frozen, and validated at construction.

Conventions: metres, radians, seconds (REP 103); time is a whole number of nanoseconds since the scene was loaded;
quaternions are ``(x, y, z, w)``; ``T_a_b`` maps coordinates in b to coordinates in a. Must import neither ROS, PyBullet nor OpenGL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.quoting import quoted

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Rgba = tuple[float, float, float, float]
Output = Literal["rgb", "depth", "semantic", "instance", "normal", "normal_world", "position", "flow", "hole"]
OUTPUTS: tuple[Output, ...] = ("rgb", "depth", "semantic", "instance", "normal", "normal_world", "position", "flow", "hole")
DEFAULT_OUTPUTS: tuple[Output, ...] = ("rgb", "depth")
Projection = Literal["pinhole", "fisheye", "equirectangular"]
DISTORTIONS: dict[Projection, dict[str, tuple[int, ...]]] = {
    "pinhole": {"plumb_bob": (4, 5), "rational_polynomial": (8,)},
    "fisheye": {"equidistant": (4,)},
    "equirectangular": {},
}
"""Projection -> ``distortion_model`` of camera_info -> allowed lengths of ``d``."""
FARTHEST_M = 1e4
"""Maximum absolute coordinate of objects, m: beyond it, single precision is insufficient for images and contacts."""
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform T_parent_child: a position in metres and a unit quaternion ``(x, y, z, w)``."""

    position: Vec3 = (0.0, 0.0, 0.0)
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.position, *self.quat_xyzw))):
            raise ConfigError(f"pose {self.position} {self.quat_xyzw} holds a NaN or an infinity; all seven must be finite")
        norm = math.sqrt(sum(c * c for c in self.quat_xyzw))
        if abs(norm - 1.0) > 1e-6:
            raise ConfigError(f"quaternion {self.quat_xyzw} (x, y, z, w) has length {norm:g}; it must be 1: normalise it")


def check_seed(what: str, seed: int) -> None:
    """Raises ConfigError, with ``what`` in its message, unless the seed is 0 to 2**63 - 1."""
    if not 0 <= seed < 2**63:
        raise ConfigError(f"{what}: seed is {seed}, must be 0 to {2**63 - 1}")


@dataclass(frozen=True, slots=True)
class ImageEffects:
    """Effects of a real camera on the colours. All are off by default; depth, labels and normals are not affected."""

    exposure_ev: float = 0.0
    """Exposure compensation, stops: each doubles the light."""
    white_balance_k: float = 6500.0
    """Colour temperature that is rendered white, kelvin; lower = bluer image of the same scene."""
    vignette: float = 0.0
    """Loss of light in the corners, 0 to 1; a cos^4 falloff, scaled to this value."""
    shutter_s: float = 0.0
    """Exposure time, seconds, for motion blur by the motion since the previous state."""
    readout_s: float = 0.0
    """Readout time from the first row to the last, seconds, for a rolling shutter."""
    shot_noise: float = 0.0
    """Standard deviation of shot noise at white, 0 to 1, linear; proportional to the square root of the light."""
    read_noise: float = 0.0
    """Standard deviation of read noise, 0 to 1, linear; independent of the light."""
    seed: int = 0
    """Seed of the noise, which depends on it, the stamp of the image and the name of the camera."""

    def __post_init__(self) -> None:
        if not abs(self.exposure_ev) <= 20.0:
            raise ConfigError(f"effects: exposure_ev is {self.exposure_ev:g} stops, must be -20 to 20")
        if not 1667.0 <= self.white_balance_k <= 25000.0:
            raise ConfigError(f"effects: white_balance_k is {self.white_balance_k:g} K, must be 1667 to 25000; daylight is 6500")
        for name in ("vignette", "shot_noise", "read_noise"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"effects: {name} is {getattr(self, name):g}, must be 0 to 1")
        for name in ("shutter_s", "readout_s"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"effects: {name} is {getattr(self, name):g} s, must be 0 to 1; was it given in milliseconds?")
        check_seed("effects", self.seed)


@dataclass(frozen=True, slots=True)
class DepthNoise:
    """Noise of a depth camera: standard deviation constant + linear z + quadratic z^2, metres; quantised disparity; holes."""

    constant: float = 0.0
    """Constant term, metres."""
    linear: float = 0.0
    """Linear coefficient."""
    quadratic: float = 0.0
    """Quadratic coefficient, 1/m, as of a stereo camera."""
    disparity_step_px: float = 0.0
    """Quantisation step of the disparity, pixels; 0 = no quantisation."""
    baseline: float = 0.05
    """Distance between the camera and its projector or second camera, metres: disparity = fx baseline / z."""
    hole_angle_deg: float = 90.0
    """Maximum angle of incidence at which a surface has a depth, degrees; 90 = no limit."""
    hole_fraction: float = 0.0
    """Share of random holes among the other pixels, 0 to 1."""
    range_min: float = 0.0
    """Minimum measurable depth, metres; smaller depths are -inf (REP 117)."""
    seed: int = 0
    """Seed of the noise, which depends on it, the stamp of the image and the name of the camera."""

    def __post_init__(self) -> None:
        for name in ("constant", "linear", "quadratic", "disparity_step_px", "range_min"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ConfigError(f"depth_noise: {name} is {getattr(self, name):g}, must be a finite number, 0 or more")
        if not (math.isfinite(self.baseline) and self.baseline > 0.0):
            raise ConfigError(f"depth_noise: baseline is {self.baseline:g} m, must be a finite number above 0")
        if not 0.0 < self.hole_angle_deg <= 90.0:
            raise ConfigError(f"depth_noise: hole_angle_deg is {self.hole_angle_deg:g}, must be in (0, 90]; 90 = no such holes")
        if not 0.0 <= self.hole_fraction <= 1.0:
            raise ConfigError(f"depth_noise: hole_fraction is {self.hole_fraction:g}, must be 0 to 1")
        check_seed("depth_noise", self.seed)


FILLS = ("push_pull", "learned")
"""Built-in methods to fill holes; other methods are networks in ONNX files."""


def check_fill(what: str, fill: str) -> None:
    """Raises ConfigError, with ``what`` in its message, unless ``fill`` is a method to fill holes, or empty."""
    if not isinstance(fill, str) or (fill and fill not in FILLS and not fill.endswith(".onnx")):
        raise ConfigError(
            f"{what}: fill is {quoted(fill)}, must be {', '.join(FILLS)} or the path of an ONNX file (.onnx), as text; '' = no filling"
            f"{'; fill_depth=True also fills depth' if str(fill).endswith(',depth') else ''}"
        )


WORLD_FRAME = "map"
"""Name of the world frame (REP 105); the link of cameras that are fixed to the world."""


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A camera fixed to a link. The camera frame is optical (REP 103): x right, y down, z forward."""

    name: str
    """Name of the camera, the prefix of its topics and of its frame ``<name>_optical_frame``."""
    link: str
    """Link that it is fixed to, as in ``SceneState.links``: ``<body>/<link>``; empty or "map", which is converted to empty = the world."""
    pose: Pose = field(default_factory=Pose)
    """T_link_optical."""
    width: int = 640
    """Image width, pixels."""
    height: int = 480
    """Image height, pixels."""
    fov_y: float = math.radians(60.0)
    """Vertical field of view of a pinhole camera without ``matrix``, radians, in (0, pi)."""
    near: float = 0.05
    """Distance of the near plane, metres along the axis (for a non-pinhole camera, along the axis of each of its pinhole views)."""
    far: float = 100.0
    """Maximum depth, metres; beyond it depth is +inf (REP 117)."""
    rate_hz: float = 30.0
    """Image rate, Hz, in simulation time."""
    outputs: tuple[Output, ...] = DEFAULT_OUTPUTS
    """Outputs, all rendered in one pass."""
    projection: Projection = "pinhole"
    """Projection: pinhole; fisheye (equidistant: the angle from the axis is proportional to the distance from the centre); equirectangular."""
    matrix: tuple[float, ...] | None = None
    """Intrinsic matrix K, nine numbers, row-major, pixels, as ``k`` in camera_info, with optional skew; None = derived from ``fov_y``, for a
    fisheye from ``fov``."""
    distortion: tuple[float, ...] = ()
    """Distortion coefficients, ``d`` of camera_info. pinhole: 4 or 5 of plumb_bob, or 8 of rational_polynomial; fisheye: 4 of equidistant."""
    fov: float = math.pi
    """Full field of view of a fisheye camera, radians, in (0, 2 pi]; pixels beyond it are empty."""
    samples: int = 1
    """Colour samples per pixel: 1 or 4 (antialiasing). Depth, labels and normals always have one sample."""
    stereo_baseline: float = 0.0
    """Distance of the right camera of a stereo pair from the left one, metres, for ``p`` of camera_info; 0 for other cameras."""
    effects: ImageEffects = field(default_factory=ImageEffects)
    depth_noise: DepthNoise = field(default_factory=DepthNoise)
    fill: str = ""
    """Method that fills holes of the colours (``hole`` 1 and 2): ``push_pull``, ``learned``, the path of an ONNX file; empty = none."""
    fill_depth: bool = False
    """Whether holes of depth and positions are filled too; ``hole`` marks the filled pixels."""
    frame_id: str = ""
    """tf frame of the images; empty = ``<name>_optical_frame``."""

    def __post_init__(self) -> None:
        what = f"camera {quoted(self.name)}"
        if self.link == WORLD_FRAME:
            object.__setattr__(self, "link", "")
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
        check_fill(what, self.fill)
        if not isinstance(self.fill_depth, bool):
            raise ConfigError(f"{what}: fill_depth is {quoted(self.fill_depth)}, must be True or False")
        if self.fill_depth and not self.fill:
            raise ConfigError(f"{what}: fill_depth is set without fill; give that too: {', '.join(FILLS)} or an ONNX file")
        self._check_optics(what)

    def _check_optics(self, what: str) -> None:
        if self.projection not in DISTORTIONS:
            raise ConfigError(f"{what}: projection is {quoted(self.projection)}, must be one of {', '.join(DISTORTIONS)}")
        if self.matrix is not None:
            self._check_matrix(what, self.matrix)
        models = DISTORTIONS[self.projection]
        if self.distortion and self.distortion_model is None:
            known = ", ".join(f"{' or '.join(map(str, counts))} ({model})" for model, counts in models.items()) or "none"
            raise ConfigError(
                f"{what}: distortion has {len(self.distortion)} numbers; projection {self.projection} allows: {known}"
            )
        if not all(map(math.isfinite, self.distortion)):
            raise ConfigError(f"{what}: distortion is {self.distortion}, its numbers must be finite")
        if not 0.0 < self.fov <= 2.0 * math.pi:
            raise ConfigError(f"{what}: fov is {self.fov:g} rad, must be in (0, 2 pi]; was it given in degrees?")
        if self.projection == "equirectangular" and self.effects.vignette:
            raise ConfigError(
                f"{what}: effects.vignette is {self.effects.vignette:g}, but a picture of the whole sphere has no corners"
            )
        if self.projection != "pinhole" and self.depth_noise.disparity_step_px:
            raise ConfigError(
                f"{what}: depth_noise.disparity_step_px is for pinhole cameras, its projection is {self.projection}"
            )
        if self.samples not in (1, 4):
            raise ConfigError(f"{what}: samples is {self.samples}, must be 1 or 4")
        if not (math.isfinite(self.stereo_baseline) and self.stereo_baseline >= 0.0):
            raise ConfigError(f"{what}: stereo_baseline is {self.stereo_baseline:g} m, must be a finite number, 0 or more")

    def _check_matrix(self, what: str, matrix: tuple[float, ...]) -> None:
        if self.projection == "equirectangular":
            raise ConfigError(
                f"{what}: matrix is given, but an equirectangular camera always shows the whole sphere; leave it out"
            )
        if len(matrix) != 9 or not all(map(math.isfinite, matrix)):
            raise ConfigError(f"{what}: matrix is {matrix}, must be nine finite numbers, K by rows")
        fx, _, _, zero, fy, _, *last = matrix
        if not (fx > 0.0 and fy > 0.0 and zero == 0.0 and last == [0.0, 0.0, 1.0]):
            raise ConfigError(f"{what}: matrix is {matrix}, must be fx skew cx 0 fy cy 0 0 1 with fx and fy above 0, pixels")

    @property
    def distortion_model(self) -> str | None:
        """Name of the distortion model in camera_info; None if no model has this number of coefficients."""
        models = DISTORTIONS[self.projection]
        return next((model for model, counts in models.items() if not self.distortion or len(self.distortion) in counts), None)

    @property
    def optical_frame(self) -> str:
        """Name of the tf frame of the images."""
        return self.frame_id or f"{self.name}_optical_frame"

    def intrinsics(self) -> NDArray[np.float64]:
        """Returns K, shape (3, 3), pixels; pixel centres are at whole numbers (OpenCV, ROS).

        Without ``matrix``, pixels are square and the principal point is the centre of the image; the circle of a fisheye's ``fov`` touches the
        edges of the image. K of an equirectangular camera maps (longitude, -latitude) to pixels.
        """
        if self.matrix is not None:
            return np.array(self.matrix, dtype=np.float64).reshape(3, 3)
        if self.projection == "pinhole":
            fx = fy = self.height / 2.0 / math.tan(self.fov_y / 2.0)
        elif self.projection == "fisheye":
            fx = fy = min(self.width, self.height) / self.fov
        else:
            fx, fy = self.width / (2.0 * math.pi), self.height / math.pi
        return np.array(
            [[fx, 0.0, (self.width - 1) / 2.0], [0.0, fy, (self.height - 1) / 2.0], [0.0, 0.0, 1.0]], dtype=np.float64
        )


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """Poses of all moving links at one tick, in the world frame (z up)."""

    stamp_ns: int
    """Simulation time of the tick, nanoseconds since load."""
    step: int
    """Physics steps since load."""
    revision: int
    """Revision of the scene with these links; a renderer rejects a state of another revision."""
    links: tuple[str, ...] = field(repr=False)
    """Names ``<body>/<link>`` of the rows."""
    positions: NDArray[np.float64] = field(repr=False)
    """Origins of the URDF link frames (not centres of mass), (N, 3), metres."""
    quats_xyzw: NDArray[np.float64] = field(repr=False)
    """Orientations of the link frames, (N, 4), unit quaternions."""
    twists: NDArray[np.float64] = field(repr=False)
    """Velocities, (N, 6), world frame: linear velocity of the link frame's origin (m/s), then angular velocity (rad/s)."""

    def __post_init__(self) -> None:
        n = len(self.links)
        shapes = (self.positions.shape, self.quats_xyzw.shape, self.twists.shape)
        if shapes != ((n, 3), (n, 4), (n, 6)):
            raise ConfigError(f"scene state with {n} links has arrays of shapes {shapes}; must be ({n}, 3), ({n}, 4), ({n}, 6)")

    @classmethod
    def still(cls, revision: int = 1, links: tuple[str, ...] = ()) -> SceneState:
        """Returns the state at time 0 with all links at rest at the origin.

        Args:
            revision: revision of the scene.
            links: its links; a scene of static shapes has none.
        """
        n = len(links)
        return cls(0, 0, revision, links, np.zeros((n, 3)), np.tile((0.0, 0.0, 0.0, 1.0), (n, 1)), np.zeros((n, 6)))


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """A velocity command for the robot's base, in the base frame (x forward, z up)."""

    linear: Vec3
    """Linear velocity, m/s."""
    angular: Vec3
    """Angular velocity, rad/s."""
    stamp_ns: int
    """Simulation time of its arrival, nanoseconds."""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.linear, *self.angular))):
            raise CommandError(
                f"velocity command linear={self.linear} angular={self.angular} holds a NaN or an infinity; "
                "it is ignored, send finite m/s and rad/s"
            )


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact point of two bodies."""

    body_a: str
    link_a: str
    body_b: str
    """Name of the other body, or of a static shape of the scene."""
    link_b: str
    """Link of the other body; empty for a static shape."""
    position: Vec3
    """Contact point on b, world frame, metres."""
    normal: Vec3
    """Contact normal from b to a, unit vector, world frame."""
    force: float
    """Normal force, N."""
    distance: float = 0.0
    """Distance between the two surfaces, metres; negative = penetration."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """The image of one camera at one tick. Row 0 is the top."""

    camera: CameraSpec
    stamp_ns: int
    """Stamp of the rendered state, nanoseconds of simulation time."""
    T_world_camera: NDArray[np.float64]
    """Pose of the optical frame, (4, 4)."""
    rgb: NDArray[np.uint8] | None = None
    """Colours, (height, width, 3) uint8, sRGB, or None if not requested."""
    depth: NDArray[np.float32] | None = None
    """Depth, (height, width) float32, metres along the optical axis (fisheye, equirectangular: from the camera's centre), +inf = nothing
    (REP 117/118), or None. With depth noise also -inf = too near, NaN = a hole."""
    semantic: NDArray[np.uint16] | None = None
    """Class IDs, (height, width) uint16, index into the scene's semantic classes, 0 = nothing or unlabelled, or None."""
    instance: NDArray[np.uint16] | None = None
    """Instance IDs, (height, width) uint16, index into the scene's instances, 0 = nothing, or None."""
    normal: NDArray[np.float32] | None = None
    """Normals, (height, width, 3) float32, unit vectors in the optical frame, facing the camera, 0 = nothing, or None."""
    normal_world: NDArray[np.float32] | None = None
    """``normal`` in the world frame."""
    position: NDArray[np.float32] | None = None
    """Positions, (height, width, 3) float32, world frame, metres, NaN = nothing, or None."""
    flow: NDArray[np.float32] | None = None
    """Optical flow, (height, width, 2) float32, motion of the visible point since the previous state, pixels right and down, NaN = nothing;
    or None."""
    hole: NDArray[np.uint8] | None = None
    """Hole classes, (height, width) uint8: 0 = the front of a surface, 1 = nothing is drawn, 2 = the back of an opaque surface of the
    static world, as seen through a wall that a scan lacks, 3 = outside the lens's view, or the sky; or None. See ``filling.holes``."""


@dataclass(frozen=True, slots=True, eq=False)
class JointStates:
    """Joint states of one body at one tick."""

    names: tuple[str, ...]
    positions: NDArray[np.float64]
    """Positions, (J,), radians or metres."""
    velocities: NDArray[np.float64]
    """Velocities, (J,), rad/s or m/s."""
    efforts: NDArray[np.float64]
    """Efforts, (J,), N m or N."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Wheel odometry: pose of the base in the odom frame, and its velocity in the base frame."""

    x: float
    """Position, metres, odom frame."""
    y: float
    """Position, metres, odom frame."""
    yaw: float
    """Heading, radians, in (-pi, pi], odom frame."""
    linear: float
    """Forward speed, m/s, base frame."""
    angular: float
    """Yaw rate, rad/s."""
    lateral: float = 0.0
    """Speed to the left, m/s, base frame."""
