"""Things to spawn, one unlike the other, and where they must be seen in an image: nothing of OpenGL is in this."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.load_mesh import load_shape
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.types import Pose

PLACES = tuple((x, y, 0.25) for x in (-0.4, 0.5) for y in (-0.75, 0.0, 0.75))
OURS = ("mug", "teapot", "bowl", "book_a", "vase", "basket", "ball", "box_cereal", "laptop", "stool", "plate", "keyboard")
FURNITURE = ("cabinet_drawers", "cabinet_doors", "oven_body")
TEXTURED = 48
"""Meshes with a texture: more than a renderer keeps of what nobody uses any more."""
ROBOT = "gibson_bot"
ROBOT_EVERY = 100


@dataclass
class Thing:
    """What was spawned."""

    name: str
    uri: str = ""
    text: str = ""
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    """Radians: edges along rows of the image would stand or fall as a whole."""
    is_robot: bool = False

    def triangles(self) -> NDArray[np.float64] | None:
        """Returns the triangles, (T, 3, 3), of what is drawn of it, frame of its root; None where it has joints."""
        body = None if self.is_robot else load_spawnable(self.uri, self.text, name=self.name, pose=Pose())
        if body is None or len(body.model.links) != 1:
            return None
        found = []
        for visual in body.model.links[0].visuals:
            vertices, triangles = load_shape(visual.shape, [Path(visual.shape.mesh).parent]).merged()
            T = matrix_from_pose(visual.pose)
            found.append((vertices @ T[:3, :3].T + T[:3, 3])[triangles])
        return np.concatenate(found)


def things(folder: Path, rng: np.random.Generator) -> Iterator[Thing]:
    """Yields what to spawn, for ever."""
    meshes = [_write_textured(folder / f"textured_{k}", rng) for k in range(TEXTURED)]
    number = 0
    while True:
        name, place = f"thing_{number}", PLACES[number % len(PLACES)]
        kind, yaw = number % 4, float(rng.uniform(0.0, 2 * math.pi))
        if number % ROBOT_EVERY == ROBOT_EVERY - 1:
            yield Thing(name, ROBOT, place=(-6.0, 4.0 * float(rng.uniform(-1.0, 1.0)), 0.0), is_robot=True)
        elif number % 25 == 13:
            yield Thing(name, FURNITURE[number % len(FURNITURE)], place=(3.0, float(rng.uniform(-1.0, 1.0)), 0.0))
        elif kind == 0:
            yield Thing(name, str(meshes[number // 4 % TEXTURED]), place=place, yaw=yaw)
        elif kind == 1:
            yield Thing(name, OURS[number // 4 % len(OURS)], place=place, yaw=yaw)
        else:
            yield Thing(name, text=_box(rng), place=place, yaw=yaw)
        number += 1


def _box(rng: np.random.Generator) -> str:
    """Returns the URDF of a box unlike any other."""
    size = " ".join(f"{edge:.5f}" for edge in rng.uniform(0.08, 0.25, 3))
    color = " ".join(f"{c:.4f}" for c in rng.uniform(0.2, 1.0, 3))
    shape = f'<geometry><box size="{size}"/></geometry>'
    return (
        f'<robot name="box"><link name="body"><visual>{shape}<material name="m"><color rgba="{color} 1"/></material></visual>'
        f'<collision>{shape}</collision><inertial><mass value="0.5"/><inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" '
        'izz="0.002"/></inertial></link></robot>'
    )


def _write_textured(folder: Path, rng: np.random.Generator) -> Path:
    """Writes a pyramid with a texture of noise, and returns its file."""
    folder.mkdir()
    cv2.imwrite(str(folder / "noise.png"), rng.integers(0, 255, (256, 256, 3), dtype=np.uint8))
    (folder / "m.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd noise.png\n")
    h, w = float(rng.uniform(0.1, 0.25)), float(rng.uniform(0.08, 0.14))
    (folder / "pyramid.obj").write_text(
        f"mtllib m.mtl\nv {-w} {-w} 0\nv {w} {-w} 0\nv {w} {w} 0\nv {-w} {w} 0\nv 0 0 {h}\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.5\nusemtl m\n"
        "f 4/4 3/3 2/2 1/1\nf 1/1 2/2 5/5\nf 2/2 3/3 5/5\nf 3/3 4/4 5/5\nf 4/4 1/1 5/5\n"
    )
    return folder / "pyramid.obj"


def silhouette(
    triangles: NDArray[np.float64], T_camera_body: Mat4, matrix: NDArray[np.float64], size: tuple[int, int]
) -> NDArray[np.bool_]:
    """Returns which pixels, (H, W), have their centre in a triangle.

    Args:
        triangles: (T, 3, 3), frame of the body, metres.
        T_camera_body: To the camera's optical frame.
        matrix: (3, 3), of the camera; pixel centres are at whole numbers.
        size: Height and width.
    """
    height, width = size
    points = triangles.reshape(-1, 3) @ T_camera_body[:3, :3].T + T_camera_body[:3, 3]
    mask = np.zeros((height, width), dtype=bool)
    if (points[:, 2] <= 0.0).any():
        return mask
    image = points @ matrix.T
    for corners in (image[:, :2] / image[:, 2:]).reshape(-1, 3, 2):
        low = np.maximum(np.ceil(corners.min(axis=0)).astype(int), 0)
        high = np.minimum(np.floor(corners.max(axis=0)).astype(int) + 1, (width, height))
        if (high > low).all():
            x, y = np.arange(low[0], high[0]), np.arange(low[1], high[1])[:, None]
            sides = [
                (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
                for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
            ]
            inside = np.all([side >= 0.0 for side in sides], axis=0) | np.all([side <= 0.0 for side in sides], axis=0)
            mask[low[1] : high[1], low[0] : high[0]] |= inside
    return mask
