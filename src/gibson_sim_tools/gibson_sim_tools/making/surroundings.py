"""Renders the environment map that lights movable bodies: the rooms, seen from the start poses."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.picture_files import write_picture
from gibson_sim.render.draw.environment import irradiance
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.pictures import EYE_HEIGHT, eye_camera, render_views
from gibson_sim_tools.making.pixels import F32

ASSETS, SURROUNDINGS = "assets", "rooms.hdr"
_ROWS = 64
"""Height of the environment map, pixels; its width is twice that."""


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
