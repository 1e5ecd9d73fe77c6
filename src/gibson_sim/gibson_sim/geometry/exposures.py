"""Plans the states at which an image with motion blur or a rolling shutter is rendered. Pure.

The stamp of an image is the end of its last row's exposure, since this is the newest known state. The exposure of row r ends
``readout_s (rows - 1 - r) / (rows - 1)`` earlier and lasts ``shutter_s``. Colours are averaged over the exposure; depth, labels and normals
are those at its end. Motion between two states is assumed uniform, and extrapolated before the earlier state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.interpolation import interpolate_states
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, matrix_from_quat
from gibson_sim.types import NS_PER_S, CameraSpec, SceneState

MAX_BANDS = 32
"""Maximum number of bands of rows of a rolling shutter."""
BAND_MOTION_PX = 0.5
"""Maximum motion from one band to the next, pixels, unless ``MAX_BANDS`` is reached."""
MAX_SAMPLES = 17
"""Maximum number of pictures averaged for motion blur; one picture is drawn per pixel of motion up to this number."""
MAX_PICTURES = 256
"""Maximum number of pictures for an image with both effects: with many bands each has fewer samples, but at least three."""
LEAST_MOTION_PX = 0.1
"""Motion below which an image is drawn without these effects, pixels."""
PROBE_DISTANCE = 1.0
"""Distance at which the image motion of the static world is estimated, metres. Nearer objects move by more pixels per band or sample."""
_LINK_RADIUS = 0.25
"""Distance from the origin of a rotating link at which its motion is estimated, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """One picture of some rows of an image."""

    state: SceneState
    rows: slice
    """Rows of the image."""
    weight: float
    """Weight of this picture in the colours of these rows, in linear light; the weights of a row sum to 1."""
    geometry: bool
    """Whether depth, labels and normals of these rows come from this picture; true for one picture of each row."""


def needs_previous(camera: CameraSpec) -> bool:
    """Returns whether the image of a camera depends on the previous state."""
    return "flow" in camera.outputs or camera.effects.shutter_s > 0.0 or camera.effects.readout_s > 0.0


def exposures(camera: CameraSpec, previous: SceneState | None, current: SceneState) -> list[Exposure]:
    """Returns the pictures for one image, rows from top to bottom; the end of each row's exposure comes last.

    Without motion, without shutter and readout times, or without a previous state, this is one exposure of ``current``.

    Args:
        camera: the camera, with ``effects.shutter_s`` and ``effects.readout_s``.
        previous: an earlier state of the same scene, preferably recent; None = no motion.
        current: the state at the stamp of the image.

    Raises:
        SceneMismatchError: the states are not of the same scene.
    """
    whole = [Exposure(current, slice(0, camera.height), 1.0, True)]
    shutter = camera.effects.shutter_s if "rgb" in camera.outputs else 0.0
    readout = camera.effects.readout_s
    if previous is None or previous.stamp_ns >= current.stamp_ns or not (shutter or readout):
        return whole
    interval = (current.stamp_ns - previous.stamp_ns) / NS_PER_S
    speed = pixel_motion(camera, previous, current) / interval
    blur, skew = speed * shutter, speed * readout
    bands = min(MAX_BANDS, camera.height, math.ceil(skew / BAND_MOTION_PX)) if skew >= LEAST_MOTION_PX else 1
    samples = max(3, min(MAX_SAMPLES, MAX_PICTURES // bands, math.ceil(blur) + 1)) if blur >= LEAST_MOTION_PX else 1
    edges = [round(k * camera.height / bands) for k in range(bands + 1)]
    out: list[Exposure] = []
    for first, end in pairwise(edges):
        # A band is drawn at the time of its middle row; a single band moves by less than half a pixel and needs no correction.
        rows_after = camera.height - 1 - (first + end - 1) / 2
        end_before_stamp = readout * rows_after / (camera.height - 1) if bands > 1 else 0.0
        for k, weight in reversed(list(enumerate(_weights(samples)))):
            before_stamp = end_before_stamp + shutter * k / max(samples - 1, 1)
            state = interpolate_states(previous, current, 1.0 - before_stamp / interval)
            out.append(Exposure(state, slice(first, end), weight, k == 0))
    return out


def _weights(samples: int) -> list[float]:
    """Returns the weights of the trapezoidal rule, whose samples include the end of the exposure, from which geometry is taken."""
    if samples == 1:
        return [1.0]
    inner = 1.0 / (samples - 1)
    return [inner / 2, *[inner] * (samples - 2), inner / 2]


def pixel_motion(camera: CameraSpec, earlier: SceneState, later: SceneState) -> float:
    """Estimates the largest motion in the image from one state to another, pixels.

    Considers points of the static world at ``PROBE_DISTANCE``, at the centre, the edges and the corners of the image, and the links in the
    field of view.
    """
    T_before, T_after = _camera_matrix(camera, earlier), _camera_matrix(camera, later)
    rays, half_angle, focal = _lens(camera)
    static = T_after[:3, 3] + PROBE_DISTANCE * rays @ T_after[:3, :3].T
    before = _in_camera(T_before, np.concatenate([static, earlier.positions]))
    after = _in_camera(T_after, np.concatenate([static, later.positions]))
    distance = np.maximum(np.linalg.norm(after, axis=1), 1e-9)
    angles = np.linalg.norm(np.cross(before, after), axis=1) / np.maximum(np.linalg.norm(before, axis=1) * distance, 1e-12)
    angles[len(static) :] += _rotations(earlier, later) * _LINK_RADIUS / np.maximum(distance[len(static) :], _LINK_RADIUS)
    cosine = after[:, 2] / distance
    visible = cosine > math.cos(half_angle)
    visible[: len(static)] = True
    visible[len(static) :] &= np.asarray([link != camera.link for link in later.links], dtype=bool)
    # In a pinhole image, an angle spans more pixels towards the corners.
    stretch = np.clip(cosine, math.cos(half_angle), 1.0) ** -2 if camera.projection == "pinhole" else 1.0
    return float(np.max(angles * stretch, initial=0.0, where=visible)) * focal


def _rotations(earlier: SceneState, later: SceneState) -> NDArray[np.float64]:
    """Returns the rotation angle of each link, (N,), radians."""
    dots = np.abs(np.sum(earlier.quats_xyzw * later.quats_xyzw, axis=1))
    # Rounding to a dot product just below 1 must not count as a rotation.
    return np.where(dots > 1.0 - 1e-12, 0.0, 2.0 * np.arccos(np.minimum(dots, 1.0)))


def _camera_matrix(camera: CameraSpec, state: SceneState) -> Mat4:
    """Returns T_world_optical; a camera whose link is not in the state counts as static, and the renderer reports the error."""
    pose = matrix_from_pose(camera.pose)
    if camera.link not in state.links:
        return pose
    row = state.links.index(camera.link)
    T_world_link = np.eye(4)
    T_world_link[:3, :3] = matrix_from_quat(state.quats_xyzw[row])
    T_world_link[:3, 3] = state.positions[row]
    matrix: Mat4 = T_world_link @ pose
    return matrix


def _in_camera(T_world_camera: Mat4, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transforms world points (N, 3) to the optical frame, metres."""
    optical: NDArray[np.float64] = (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    return optical


def _lens(camera: CameraSpec) -> tuple[NDArray[np.float64], float, float]:
    """Returns unit rays, (N, 3), through centre, edges and corners, the largest angle from the axis, radians, and the focal length, pixels."""
    k = camera.intrinsics()
    focal = max(float(k[0, 0]), float(k[1, 1]))
    if camera.projection == "pinhole":
        u, v = np.meshgrid([0.0, k[0, 2], camera.width - 1.0], [0.0, k[1, 2], camera.height - 1.0])
        rays = np.stack([(u.ravel() - k[0, 2]) / k[0, 0], (v.ravel() - k[1, 2]) / k[1, 1], np.ones(9)], axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays, math.acos(float(rays[:, 2].min())), focal
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    if camera.projection == "fisheye":
        return axes[:5], min(camera.fov / 2, math.pi), focal
    return axes, math.pi, focal
