"""A painted wall and photographs of it, with known poses and exposures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gibson_sim.geometry.colours import linear_from_srgb, srgb8_from_linear
from gibson_sim_tools.scanning.posed_images import CameraModel, Intrinsics, Photograph, Photographs
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.quality import sample_bilinear

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]

SIZE = (4.0, 3.0)
"""Metres along x and y; the wall is at z = 0, its middle at the origin, and faces -z."""
CAMERA = Intrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)


@dataclass(frozen=True)
class PaintedWall:
    """The wall."""

    surface: TriangleMesh
    paint: F32
    """(600, 800, 3), sRGB, 0 to 1; row 0 is at the least y."""

    def color_at(self, points: F64) -> F32:
        """Returns the paint (..., 3) at points (..., 3) of the wall."""
        x, y = (points[..., k] / SIZE[k] + 0.5 for k in range(2))
        return sample_bilinear(self.paint, np.stack([x * 799, y * 599], axis=-1).astype(np.float32))

    def depth(self, T_world_camera: F64, scale: float) -> NDArray[np.uint16]:
        """Returns its depth image, in units of which ``scale`` are a metre."""
        v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float64)
        rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
        return np.rint(-scale * T_world_camera[2, 3] / (rays @ T_world_camera[2, :3])).astype(np.uint16)

    def photograph(self, file: Path, T_world_camera: F64, gain: float = 1.0) -> Photograph:
        """Takes a photograph; ``gain`` multiplies the light."""
        v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float64)
        rays = (
            np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
            @ T_world_camera[:3, :3].T
        )
        hit = T_world_camera[:3, 3] - rays * (T_world_camera[2, 3] / rays[..., 2:])
        rgb = srgb8_from_linear(linear_from_srgb(self.color_at(hit)) * np.float32(gain))
        cv2.imwrite(str(file), rgb[:, :, ::-1])
        return Photograph(file, CameraModel(CAMERA), T_world_camera)


def painted_wall(columns: int = 40, rows: int = 30) -> PaintedWall:
    """Returns a wall of ``columns`` x ``rows`` x 2 triangles with soft blots of colour."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, columns + 1) * SIZE[0], np.linspace(-0.5, 0.5, rows + 1) * SIZE[1])
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    over = first + columns + 1
    triangles = np.concatenate([np.stack([first, over + 1, first + 1], 1), np.stack([first, over, over + 1], 1)])
    paint = cv2.GaussianBlur(np.random.default_rng(5).random((600, 800, 3)).astype(np.float32), (0, 0), 8)
    return PaintedWall(TriangleMesh(vertices, triangles), (0.2 + 0.5 * (paint - paint.min()) / np.ptp(paint)).astype(np.float32))


def row_of_cameras(count: int, rng: np.random.Generator) -> F64:
    """Returns T_world_camera (N, 4, 4) of cameras 2 m before the wall, from left to right, slightly turned."""
    out = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        out[k, :3, :3] = Rotation.from_euler("xyz", rng.normal(0.0, 0.08, 3)).as_matrix()
        out[k, :3, 3] = (-0.8 + 1.6 * k / max(count - 1, 1), 0.1 * (-1) ** k, -2.0)
    return out


def photographed(folder: Path, wall: PaintedWall, poses: F64, gains: list[float] | None = None) -> Photographs:
    """Returns photographs of a wall, written into a folder."""
    items = [wall.photograph(folder / f"{k}.png", T, 1.0 if gains is None else gains[k]) for k, T in enumerate(poses)]
    return Photographs(folder, "test", tuple(items))


def moved(photographs: Photographs, offsets: F64) -> Photographs:
    """Returns photographs whose poses are said to be others: T_world_camera @ offsets (N, 4, 4)."""
    items = tuple(
        replace(item, T_world_camera=item.T_world_camera @ D) for item, D in zip(photographs.items, offsets, strict=True)
    )
    return replace(photographs, items=items)
