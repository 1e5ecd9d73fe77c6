"""Renders a contact sheet: every object on a neutral floor, seen from the front and above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.geometry.transforms import pose_from_matrix
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import LightSpec, PointLight, SceneSpec
from gibson_sim.simulation import Simulation
from gibson_sim.types import CameraSpec, Pose
from gibson_sim_tools.making.objects.model import ObjectModel

Rgb = NDArray[np.uint8]
_FOV = math.radians(26.0)
_ELEVATION, _AZIMUTH = math.radians(24.0), math.radians(32.0)
_FLOOR = (0.74, 0.74, 0.73, 1.0)
_JOINT_FRACTION = 0.36
"""Position of joints, as a fraction of their upper limit."""
_LIGHT = LightSpec(
    sun_direction=(-0.55, 0.42, -1.0), sun=0.62, ambient=0.36, background=(0.80, 0.81, 0.82), shadows=True, sun_color=(1.0, 0.97, 0.92)
)  # fmt: skip


def sheet(folder: Path, models: Sequence[ObjectModel], tile: int = 160, columns: int = 7) -> Rgb:
    """Renders objects, their joints partly open, on one sheet, (H, W, 3) uint8 sRGB.

    Args:
        folder: folder of the objects (``scenes/objects``).
        models: objects to render.
        tile: edge of one picture, pixels.
        columns: number of pictures per row.
    """
    pictures = [picture(folder, model, tile) for model in models]
    while len(pictures) % columns:
        pictures.append(np.full_like(pictures[0], 255))
    rows = [np.hstack(pictures[k : k + columns]) for k in range(0, len(pictures), columns)]
    return np.asarray(np.vstack(rows))


def picture(folder: Path, model: ObjectModel, tile: int) -> Rgb:
    """Renders one object, (tile, tile, 3) uint8 sRGB."""
    body = load_spawnable(str(folder / model.name), "", name="thing", pose=Pose())
    assert isinstance(body, BodySpec)
    fractions = {joint.name: _JOINT_FRACTION * (1.0 if index % 2 == 0 else 0.5) for index, joint in enumerate(model.joints)}
    joints = tuple((joint.name, fractions[joint.name] * joint.upper) for joint in model.joints if joint.kind != "fixed")
    size = float(np.linalg.norm(model.size))
    # Small, since the resolution of shadows depends on the size of the scene.
    floor = VisualSpec("floor", "", Shape("cylinder", (7.0 * size, 0.1 * size, 0.0)), Pose((0.0, 0.0, -0.05 * size)), _FLOOR)
    lamp = PointLight((1.2 * size, -1.6 * size, 1.6 * size), (1.0, 1.0, 1.0), 0.10 * size * size)
    sun = (-0.5, -0.62, -1.0) if model.built_in else _LIGHT.sun_direction
    light = replace(_LIGHT, points=(lamp,), sun_direction=sun)
    scene = SceneSpec(model.name, folder, "", (floor,), (), bodies=(replace(body, static=True, joints=joints),), light=light)
    with Simulation(scene, None) as sim:
        low, high = sim.world.bounds("thing")
        eye = _eye((low + high) / 2, float(np.linalg.norm(high - low)), -1.0 if model.built_in else 1.0)
        frame = sim.render(CameraSpec("sheet", "", eye, 2 * tile, 2 * tile, _FOV, near=0.02, outputs=("rgb",), samples=4))
    assert frame.rgb is not None
    return np.asarray(cv2.resize(frame.rgb, (tile, tile), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _eye(middle: NDArray[np.float64], diameter: float, front: float) -> Pose:
    """Returns T_world_optical of a camera that frames a sphere of ``diameter`` (m). ``front``: 1 = from +x, -1 = from +y."""
    azimuth = _AZIMUTH if front > 0 else math.radians(88.0)
    backward = np.array(
        [math.cos(_ELEVATION) * math.cos(azimuth), math.cos(_ELEVATION) * math.sin(azimuth), math.sin(_ELEVATION)]
    )
    distance = 0.56 * diameter / math.tan(_FOV / 2)
    forward, right = -backward, np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = middle + backward * distance
    return pose_from_matrix(matrix)
