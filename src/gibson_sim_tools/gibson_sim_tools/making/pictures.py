"""Renders views of a finished scene, its thumbnail, and the environment map that lights movable bodies: the rooms, seen from the start poses."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, matrix_from_pose, pose_from_xyz_rpy, quat_from_matrix
from gibson_sim.picture_files import write_picture
from gibson_sim.render.draw.environment import irradiance
from gibson_sim.simulation import Simulation
from gibson_sim.types import CameraSpec, Pose, Vec3
from gibson_sim_tools.making.building import Building, Room, Start
from gibson_sim_tools.making.pixels import F32

Rgb = NDArray[np.uint8]
WIDTH, HEIGHT = 640, 480
"""Size of a view, pixels."""
EYE_HEIGHT = 1.35
"""Height of the camera above the floor, m."""
_TILT = math.radians(8.0)
"""Downward pitch of the camera, radians."""
_FOV = math.radians(62.0)
ASSETS, SURROUNDINGS = "assets", "rooms.hdr"
_ROWS = 64
"""Height of the environment map, pixels; its width is twice that."""


def eye_camera(position: Vec3, yaw: float, pitch: float = _TILT) -> CameraSpec:
    """Returns a camera at a position, m, world frame. ``yaw``: heading, ``pitch``: downwards, radians."""
    T = matrix_from_pose(pose_from_xyz_rpy(position, (0.0, pitch, yaw)))
    return CameraSpec(
        "eye", "", Pose(position, quat_from_matrix(T[:3, :3] @ R_LINK_OPTICAL)), WIDTH, HEIGHT, _FOV, outputs=("rgb",), samples=4
    )


def render_views(folder: Path, cameras: Sequence[CameraSpec]) -> list[Rgb]:
    """Renders a scene with its bodies in their initial poses; returns (H, W, 3) uint8 sRGB images."""
    with Simulation(folder, None) as sim:
        return [frame.rgb for frame in sim.render_all(cameras) if frame.rgb is not None]


def write_thumbnail(folder: Path, building: Building) -> None:
    """Writes ``thumbnail.jpg``, the view from the start pose in the largest room."""
    start = best_start(building)
    x, y, z = start.position
    picture = render_views(folder, [eye_camera((x, y, z + EYE_HEIGHT), start.yaw)])[0]
    thumbnail = cv2.resize(picture, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA)
    write_picture(folder / "thumbnail.jpg", cv2.cvtColor(thumbnail, cv2.COLOR_RGB2BGR))


def best_start(building: Building) -> Start:
    """Returns the start pose in the largest room, or the first one."""
    rooms = sorted((room for storey in building.storeys for room in storey.rooms), key=_area, reverse=True)
    by_name = {start.name: start for start in building.starts}
    return next((by_name[room.name] for room in rooms if room.name in by_name), building.starts[0])


def _area(room: Room) -> float:
    """Returns the area of a room, m^2 (shoelace formula)."""
    x, y = np.asarray(room.corners, dtype=float).T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def write_uniform_surroundings(path: Path, white: float) -> None:
    """Writes a uniform environment map.

    Args:
        path: the file.
        white: brightness of a white surface lit by it, linear.
    """
    _write(path, np.full((_ROWS, 2 * _ROWS, 3), white, dtype=np.float32))


def write_surroundings(folder: Path, building: Building, white: float) -> None:
    """Writes the mean panorama from all start poses of a finished scene, scaled to the brightness of its baked light.

    Args:
        folder: folder of the scene, with a uniform environment map.
        building: plan of the scene.
        white: mean brightness of a white surface, linear.
    """
    cameras = [
        dataclasses.replace(
            eye_camera((x, y, z + EYE_HEIGHT), 0.0, 0.0),
            name=start.name,
            projection="equirectangular",
            width=2 * _ROWS,
            height=_ROWS,
        )
        for start in building.starts
        for x, y, z in (start.position,)
    ]
    panorama = np.mean([linear_from_srgb(rgb.astype(np.float32) / 255) for rgb in render_views(folder, cameras)], axis=0).astype(
        np.float32
    )
    # Mean irradiance over all normals: the constant terms, and a third of the z² term.
    coefficients = irradiance(panorama)
    mean = float((coefficients[0] + coefficients[6] / 3).mean())
    _write(folder / ASSETS / SURROUNDINGS, panorama * np.float32(white / max(mean, 1e-3)))


def _write(path: Path, linear: F32) -> None:
    write_picture(path, cv2.cvtColor(linear, cv2.COLOR_RGB2BGR))
