"""A lidar with many beams, simulated by rendering: each ray samples its distance in pinhole views in all directions.

A ray hardly ever passes through a pixel's centre, so the depth is extrapolated from the centre along the surface: on a plane ``1 / depth``
is linear in the pixels, with the slope given by neighbours on the same plane. Neighbours across an edge are not used. Rays of the physics
engine hit collision shapes; rays of this lidar hit visuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.colours import LUMINANCE, linear_from_srgb
from gibson_sim.geometry.transforms import Mat3, Mat4, matrix_from_quat, pose_from_matrix
from gibson_sim.types import CameraSpec, Frame, Output, SceneState

MAX_ELEVATION = math.radians(90.0)
_STEEP = math.radians(45.0)
"""Elevation above which rays are sampled in views straight up and down, radians."""
_NEAR = 0.01
"""Depth of the near plane, metres: nearer surfaces are transparent to the lidar."""
_MARGIN = 3
"""Margin around the outermost rays, pixels, for rounding and two neighbours."""
_MIN_FOCAL_PX, _MAX_FOCAL_PX = 48.0, 4000.0
_FAR_AWAY = 1e6
"""Distance by which the lidar's own body is moved down, out of the scene, while it measures, metres."""
_ROUNDING = 2e-5
"""Relative rounding error of a rendered depth."""

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class FrameRenderer(Protocol):
    """The part of ``Renderer`` required by lidars."""

    def render(self, state: SceneState, cameras: Sequence[CameraSpec]) -> list[Frame]:
        """Returns a frame for each camera."""


@dataclass(frozen=True, slots=True)
class LidarPattern:
    """The rays of a spinning lidar: every beam at every azimuth, all at the same instant."""

    elevations: tuple[float, ...]
    """Angle of each beam (ring) above the link's x-y plane, radians, in any order."""
    azimuth_steps: int = 720
    """Number of rays of a beam per revolution, evenly spaced: the first along the link's x axis, then counter-clockwise."""
    range_min: float = 0.3
    """Smallest range, metres; nearer returns are reported as -inf (REP 117)."""
    range_max: float = 100.0
    """Largest range, metres; farther returns are reported as +inf (REP 117)."""
    pixels_per_step: float = 2.0
    """Resolution of the views: pixels between successive rays of a beam at the centre of a view, more elsewhere. It determines the accuracy
    of edges."""

    def __post_init__(self) -> None:
        if not self.elevations or not all(abs(e) <= MAX_ELEVATION for e in self.elevations):
            raise ConfigError(
                f"lidar pattern: elevations are {self.elevations}, must be one or more angles from -pi/2 to pi/2 rad; "
                "were they given in degrees?"
            )
        if not 4 <= self.azimuth_steps <= 36_000:
            raise ConfigError(f"lidar pattern: azimuth_steps is {self.azimuth_steps}, must be 4 to 36000")
        if not 0.0 <= self.range_min < self.range_max < math.inf:
            raise ConfigError(
                f"lidar pattern: range_min is {self.range_min:g} and range_max {self.range_max:g} m, "
                "must be 0 <= range_min < range_max, both finite"
            )
        if not 0.25 <= self.pixels_per_step <= 16.0:
            raise ConfigError(f"lidar pattern: pixels_per_step is {self.pixels_per_step:g}, must be 0.25 to 16")


def even_elevations(beams: int, lowest: float, highest: float) -> tuple[float, ...]:
    """Returns evenly spaced elevations, both ends included, radians: 16 beams from -15 to 15 degrees are those of a VLP-16."""
    return tuple(float(e) for e in np.linspace(lowest, highest, beams))


@dataclass(frozen=True, slots=True, eq=False)
class RenderedScan:
    """One revolution of a lidar. ``points``, ``ring``, ``column`` and the fields after them have a row for each return, ring by ring."""

    stamp_ns: int
    """Stamp of the measured state."""
    link: str
    """``<body>/<link>``, the frame of the points."""
    ranges: F32
    """(beams, azimuth_steps) float32, metres; +inf = no return, -inf = nearer than range_min (REP 117)."""
    points: F32
    """(N, 3) float32, metres, frame of the link."""
    ring: NDArray[np.uint16]
    """(N,) uint16, index in the pattern's elevations."""
    column: NDArray[np.uint16]
    """(N,) uint16, azimuth step."""
    semantic: NDArray[np.uint16] | None = None
    """(N,) uint16, index in the scene's semantic classes; None = not requested."""
    instance: NDArray[np.uint16] | None = None
    """(N,) uint16, index in the scene's instances; None = not requested."""
    intensity: F32 | None = None
    """(N,) float32, 0 to 1; None = not requested."""


@dataclass(frozen=True, slots=True, eq=False)
class _LidarView:
    """A pinhole view and the rays sampled in it."""

    camera: CameraSpec
    """Camera whose pose is in the frame of the lidar's link; its link is empty."""
    T_link_view: Mat4
    rays: I64
    """(R,), indices of the rays, ring by ring."""
    pixel: I64
    """(R,), index of the pixel nearest to each ray, row by row."""
    right: F32
    """(R,), offset to the right from the pixel's centre to the ray, pixels."""
    down: F32
    """(R,), offset downwards from the pixel's centre to the ray, pixels."""
    length: F32
    """(R,), ratio of the distance along the ray to the depth."""


class RenderedLidar:
    """A lidar on a link.

    Args:
        link: ``<body>/<link>``; the rays start at its origin.
        pattern: directions of the rays.
        labels: also return the semantic class and the instance of each return.
        intensity: also return the intensity: the brightness of the picture times the cosine of the angle of incidence (exact for a
            Lambertian surface that is as bright under the lidar's light as under the lights of the scene).
        see_own_body: whether rays hit the body that carries the lidar; rays of the ray-cast lidar do not.
    """

    def __init__(
        self, link: str, pattern: LidarPattern, *, labels: bool = False, intensity: bool = False, see_own_body: bool = False
    ) -> None:
        self.link, self.pattern = link, pattern
        self._see_own_body = see_own_body
        outputs: list[Output] = ["depth"]
        outputs += ["semantic", "instance"] if labels else []
        outputs += ["rgb", "normal"] if intensity else []
        self._outputs = tuple(outputs)
        self.directions = _directions(pattern)
        """(beams * azimuth_steps, 3), unit vectors in the frame of the link, ring by ring."""
        self._views = _views(pattern, self.directions, self._outputs)

    @property
    def views(self) -> tuple[CameraSpec, ...]:
        """Cameras of the views, posed in the frame of the link."""
        return tuple(view.camera for view in self._views)

    def measure(self, state: SceneState, renderer: FrameRenderer) -> RenderedScan:
        """Returns the scan of the lidar in ``state``; all views are rendered in one call.

        Args:
            state: poses of all links.
            renderer: renderer of the state's scene.

        Raises:
            ConfigError: the link is not in the state.
        """
        if self.link not in state.links:
            raise ConfigError(f"lidar on {self.link!r}: the link is not in the scene; its links: {', '.join(state.links)}")
        row = state.links.index(self.link)
        T_world_link = np.eye(4)
        T_world_link[:3, :3] = matrix_from_quat(state.quats_xyzw[row])
        T_world_link[:3, 3] = state.positions[row]
        cameras = [replace(view.camera, pose=pose_from_matrix(T_world_link @ view.T_link_view)) for view in self._views]
        frames = renderer.render(state if self._see_own_body else self._without_own_body(state), cameras)
        distance = np.empty(len(self.directions), dtype=np.float32)
        for view, frame in zip(self._views, frames, strict=True):
            distance[view.rays] = _sample_distances(view, frame)
        return self._scan(state.stamp_ns, distance, frames)

    def _without_own_body(self, state: SceneState) -> SceneState:
        """Returns the state with the links of the lidar's body moved far below the scene."""
        body = self.link.partition("/")[0]
        is_own = np.array([link.partition("/")[0] == body for link in state.links])
        return replace(state, positions=state.positions - is_own[:, None] * (0.0, 0.0, _FAR_AWAY))

    def _scan(self, stamp_ns: int, distance: F32, frames: Sequence[Frame]) -> RenderedScan:
        pattern = self.pattern
        hit = (distance >= pattern.range_min) & (distance <= pattern.range_max)
        ranges = np.where(hit, distance, np.where(distance < pattern.range_min, -np.inf, np.inf)).astype(np.float32)
        ring, column = np.divmod(np.flatnonzero(hit), pattern.azimuth_steps)
        labels = [self._gather(frames, name)[hit] if name in self._outputs else None for name in ("semantic", "instance")]
        return RenderedScan(
            stamp_ns=stamp_ns,
            link=self.link,
            ranges=ranges.reshape(len(pattern.elevations), pattern.azimuth_steps),
            points=(self.directions[hit] * distance[hit, None]).astype(np.float32),
            ring=ring.astype(np.uint16),
            column=column.astype(np.uint16),
            semantic=labels[0],
            instance=labels[1],
            intensity=self._intensity(frames)[hit] if "rgb" in self._outputs else None,
        )

    def _gather(self, frames: Sequence[Frame], name: str) -> NDArray[np.uint16]:
        out = np.zeros(len(self.directions), dtype=np.uint16)
        for view, frame in zip(self._views, frames, strict=True):
            out[view.rays] = getattr(frame, name).ravel()[view.pixel]
        return out

    def _intensity(self, frames: Sequence[Frame]) -> F32:
        out = np.zeros(len(self.directions), dtype=np.float32)
        for view, frame in zip(self._views, frames, strict=True):
            assert frame.rgb is not None
            assert frame.normal is not None
            color = frame.rgb.reshape(-1, 3)[view.pixel] / np.float32(255.0)
            light = linear_from_srgb(color) @ LUMINANCE
            rays = self.directions[view.rays] @ view.T_link_view[:3, :3]
            cosine = np.abs(np.einsum("ij,ij->i", frame.normal.reshape(-1, 3)[view.pixel], rays))
            out[view.rays] = light * cosine
        return out


def _directions(pattern: LidarPattern) -> F64:
    elevation = np.array(pattern.elevations)[:, None]
    azimuth = np.arange(pattern.azimuth_steps)[None, :] * (2 * math.pi / pattern.azimuth_steps)
    parts = np.broadcast_arrays(np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    return np.stack(parts, axis=-1).reshape(-1, 3)


def _views(pattern: LidarPattern, directions: F64, outputs: tuple[Output, ...]) -> list[_LidarView]:
    """Returns the views required by the rays: up to four horizontal ones, and one up and one down for steep rays."""
    focal = pattern.pixels_per_step * pattern.azimuth_steps / (2 * math.pi)
    focal = min(max(focal, _MIN_FOCAL_PX), _MAX_FOCAL_PX)
    steep = np.abs(directions[:, 2]) > math.sin(_STEEP)
    quarter = np.round(np.arctan2(directions[:, 1], directions[:, 0]) / (math.pi / 2)).astype(np.int64) % 4
    side = np.where(steep, np.where(directions[:, 2] > 0.0, 4, 5), quarter)
    rotations = [*(_horizontal_view(k) for k in range(4)), _vertical_view(1.0), _vertical_view(-1.0)]
    views = []
    for number, R_link_view in enumerate(rotations):
        rays = np.flatnonzero(side == number)
        if len(rays):
            views.append(_view(f"lidar_view_{number}", R_link_view, rays, directions[rays], focal, pattern, outputs))
    return views


def _horizontal_view(quarter: int) -> Mat3:
    """Returns R_link_view of a horizontal view: optical x points right, y down."""
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]
    return np.array([[s, 0.0, c], [-c, 0.0, s], [0.0, -1.0, 0.0]])


def _vertical_view(up: float) -> Mat3:
    """Returns R_link_view of a view straight up, ``up`` = 1, or down, ``up`` = -1."""
    return np.array([[0.0, up, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, up]])


def _view(
    name: str, R_link_view: Mat3, rays: I64, directions: F64, focal: float, pattern: LidarPattern, outputs: tuple[Output, ...]
) -> _LidarView:
    in_view = directions @ R_link_view
    flat = in_view[:, :2] / in_view[:, 2:]
    low, high = flat.min(axis=0) * focal, flat.max(axis=0) * focal
    centre = np.ceil(-low) + _MARGIN
    width, height = (int(n) for n in np.ceil(high) + centre + _MARGIN + 1)
    uv = flat * focal + centre
    nearest = np.rint(uv)
    T_link_view = np.eye(4)
    T_link_view[:3, :3] = R_link_view
    camera = CameraSpec(
        name,
        "",
        pose_from_matrix(T_link_view),
        width,
        height,
        near=min(_NEAR, pattern.range_max / 2),
        far=pattern.range_max,
        outputs=outputs,
        matrix=(focal, 0.0, float(centre[0]), 0.0, focal, float(centre[1]), 0.0, 0.0, 1.0),
    )
    offset = (uv - nearest).astype(np.float32)
    pixel = (nearest[:, 1] * width + nearest[:, 0]).astype(np.int64)
    length = (1.0 / in_view[:, 2]).astype(np.float32)
    return _LidarView(camera, T_link_view, rays, pixel, offset[:, 0], offset[:, 1], length)


def _sample_distances(view: _LidarView, frame: Frame) -> F32:
    """Returns the distance along each ray of a view, (R,), metres, +inf = nothing."""
    assert frame.depth is not None
    inverse = np.reciprocal(frame.depth.ravel())  # +inf becomes 0
    centre = inverse[view.pixel]
    horizontal = _change(inverse, view.pixel, centre, 1, view.right)
    vertical = _change(inverse, view.pixel, centre, frame.camera.width, view.down)
    # Near the horizon of a plane the ray may leave the plane within the pixel, so the extrapolation is limited.
    extrapolated = np.clip(centre + horizontal + vertical, 0.5 * centre, 2.0 * centre)
    with np.errstate(divide="ignore"):
        return np.asarray(view.length / extrapolated, dtype=np.float32)


def _change(inverse: F32, pixel: I64, centre: F32, step: int, offset: F32) -> F32:
    """Returns the change of ``inverse`` from the centre of each pixel to ``offset`` pixels beside it, along rows or columns.

    The change is linear if the surface continues as a plane on one side, quadratic if it continues as one curve on both sides, and 0 if it
    continues on neither side.
    """
    rounding = np.float32(_ROUNDING) * centre
    slopes, curvatures = [], []
    for side in (step, -step):
        first, second = inverse[pixel + side], inverse[pixel + 2 * side]
        slope = first - centre
        curvature = np.abs(second - first - slope)
        curvatures.append(np.where(curvature <= 0.5 * np.abs(slope) + rounding, curvature, np.float32(np.inf)))
        slopes.append(slope if side > 0 else -slope)
    forward, backward = slopes
    flatter = np.where(curvatures[0] <= curvatures[1], forward, backward)
    plane = np.where(np.minimum(*curvatures) < np.inf, flatter, np.float32(0.0)) * offset
    curvature = forward - backward
    curve = (0.5 * (forward + backward) + 0.5 * curvature * offset) * offset
    # The second difference at a crease between two planes is far larger than those on the planes.
    largest = np.maximum(*curvatures)
    smooth = (np.abs(curvature) <= 2.0 * largest + rounding) & (largest < np.inf)
    return np.where(smooth, curve, plane)
