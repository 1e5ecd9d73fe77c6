"""When each row of an image sees the world: the states that a camera with an open shutter or a rolling one is drawn from. Pure.

The stamp of an image is the time at which its last row's exposure ends, since that is the newest state that is known when it is drawn.
Row r's exposure ends ``readout_s (rows - 1 - r) / (rows - 1)`` earlier and begins ``shutter_s`` before that. Colours are averaged over
the exposure; depth, labels and normals are those of the end of each row's exposure. In between two states everything moves evenly; what
lies before the earlier one goes on evenly.
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
"""Most bands of rows that a rolling shutter is drawn in."""
BAND_MOTION_PX = 0.5
"""Motion in pixels from one band to the next; more only where ``MAX_BANDS`` are not enough."""
MAX_SAMPLES = 17
"""Most pictures that are averaged for motion blur: one for each pixel of motion, up to this."""
MAX_PICTURES = 256
"""Most pictures for an image with both effects: with many bands fewer samples are averaged, but never less than three."""
LEAST_MOTION_PX = 0.1
"""Below this motion a picture is drawn at once, like one without these effects."""
PROBE_DISTANCE = 1.0
"""Metres: how near the standing world is taken to be. What is nearer may move farther from one band or sample to the next."""
_LINK_RADIUS = 0.25
"""Metres: how far from its origin a turning link is taken to reach."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """One picture to be drawn, of some rows."""

    state: SceneState
    rows: slice
    """Rows of the image."""
    weight: float
    """Part of the colours of these rows that comes from this picture, linear light; the weights of a row add up to 1."""
    geometry: bool
    """Whether depth, labels and normals of these rows are those of this picture: true once for each row."""


def needs_previous(camera: CameraSpec) -> bool:
    """Returns whether the image of a camera depends on the state before."""
    return "flow" in camera.outputs or camera.effects.shutter_s > 0.0 or camera.effects.readout_s > 0.0


def exposures(camera: CameraSpec, previous: SceneState | None, current: SceneState) -> list[Exposure]:
    """Returns what to draw for one image: rows from top to bottom, of each row the end of its exposure, whose geometry counts, last.

    Without motion, without shutter and readout times or without a previous state this is one exposure of ``current``.

    Args:
        camera: its ``effects.shutter_s`` and ``effects.readout_s`` count.
        previous: an earlier state of the same scene, the nearer in time the better; None = nothing has moved.
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
        # A band is drawn at the time of its middle row; a single one needs no correction, it moves by less than half a pixel.
        rows_after = camera.height - 1 - (first + end - 1) / 2
        before_stamp = readout * rows_after / (camera.height - 1) if bands > 1 else 0.0
        for k, weight in reversed(list(enumerate(_weights(samples)))):
            ago = before_stamp + shutter * k / max(samples - 1, 1)
            state = interpolate_states(previous, current, 1.0 - ago / interval)
            out.append(Exposure(state, slice(first, end), weight, k == 0))
    return out


def _weights(samples: int) -> list[float]:
    """Returns the weights of the trapezoid rule: its samples include the end of the exposure, whose geometry is wanted."""
    if samples == 1:
        return [1.0]
    inner = 1.0 / (samples - 1)
    return [inner / 2, *[inner] * (samples - 2), inner / 2]


def pixel_motion(camera: CameraSpec, earlier: SceneState, later: SceneState) -> float:
    """Returns an estimate of how far the fastest thing moves in the image from one state to another, pixels.

    It looks at points of the standing world ``PROBE_DISTANCE`` ahead, in the middle and the corners of the image, and at the links in
    the field of view.
    """
    T_before, T_after = _camera_matrix(camera, earlier), _camera_matrix(camera, later)
    rays, half_angle, focal = _lens(camera)
    still = T_after[:3, 3] + PROBE_DISTANCE * rays @ T_after[:3, :3].T
    before = _in_camera(T_before, np.concatenate([still, earlier.positions]))
    after = _in_camera(T_after, np.concatenate([still, later.positions]))
    distance = np.maximum(np.linalg.norm(after, axis=1), 1e-9)
    angles = np.linalg.norm(np.cross(before, after), axis=1) / np.maximum(np.linalg.norm(before, axis=1) * distance, 1e-12)
    angles[len(still) :] += _turns(earlier, later) * _LINK_RADIUS / np.maximum(distance[len(still) :], _LINK_RADIUS)
    cosine = after[:, 2] / distance
    seen = cosine > math.cos(half_angle)
    seen[: len(still)] = True
    seen[len(still) :] &= np.asarray([link != camera.link for link in later.links], dtype=bool)
    # The same angle is more pixels towards the corners of a pinhole's image.
    stretch = np.clip(cosine, math.cos(half_angle), 1.0) ** -2 if camera.projection == "pinhole" else 1.0
    return float(np.max(angles * stretch, initial=0.0, where=seen)) * focal


def _turns(earlier: SceneState, later: SceneState) -> NDArray[np.float64]:
    """Returns how far each link has turned, radians, (N,)."""
    dots = np.abs(np.sum(earlier.quats_xyzw * later.quats_xyzw, axis=1))
    # The rounding of a dot product just below 1 would count as a turn.
    return np.where(dots > 1.0 - 1e-12, 0.0, 2.0 * np.arccos(np.minimum(dots, 1.0)))


def _camera_matrix(camera: CameraSpec, state: SceneState) -> Mat4:
    """Returns T_world_camera; a camera on a link that the state lacks stands still, and drawing will refuse it."""
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
    moved: NDArray[np.float64] = (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    return moved


def _lens(camera: CameraSpec) -> tuple[NDArray[np.float64], float, float]:
    """Returns unit rays (N, 3) through the middle and towards the edges, the angle from the axis to the farthest, and pixels a radian."""
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
