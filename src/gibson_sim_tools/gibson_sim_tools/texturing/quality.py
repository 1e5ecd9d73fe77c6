"""How well each photograph shows each triangle, and in which colour: the table that all later steps work on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics
from gibson_sim_tools.texturing.visibility import SeenFaces

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

SAMPLES: F64 = np.array(
    [[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [1, 3, 3], [3, 1, 3], [3, 3, 1]], dtype=np.float64
) / np.array([[3], [6], [6], [6], [7], [7], [7]])
"""Weights (S, 3) of the corners at the points of a triangle at which a photograph is read."""
_PLAIN = 2.0
"""Gradient that is added to that of the photograph, 8-bit steps a pixel: where there is none, the area decides."""
_BLUR_PX = 0.8
"""Standard deviation of the filter before the gradient, since noise is no detail."""
LINEAR: F32 = linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255.0))
"""Linear light by 8-bit sRGB."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Triangles in photographs, N of them, sorted by triangle, then by photograph."""

    face: I32
    """(N,)."""
    photograph: I32
    """(N,)."""
    quality: F32
    """(N,): the gradient of the photograph summed over the triangle, 8-bit steps times pixels."""
    light: F32
    """(N, 3): mean linear colour, 0 to 1."""
    radius: F32
    """(N,): distance from the middle of the photograph; 1 = its corner."""

    def __len__(self) -> int:
        return len(self.face)

    def subset(self, rows: NDArray[np.bool_] | I64) -> Views:
        """Returns some of the views, in the same order."""
        return Views(self.face[rows], self.photograph[rows], self.quality[rows], self.light[rows], self.radius[rows])

    @property
    def srgb(self) -> F32:
        """(N, 3): the mean colour in sRGB, 0 to 1."""
        return np.asarray(srgb_from_linear(self.light), dtype=np.float32)


def views_of(number: int, seen: SeenFaces, rgb: U8) -> Views:
    """Returns the views of one photograph, (H, W, 3) sRGB."""
    points = np.einsum("sk,fkc->fsc", SAMPLES, seen.corners).astype(np.float32)
    count = len(seen.faces)
    blurred = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), _BLUR_PX)
    slope = cv2.magnitude(cv2.Sobel(blurred, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(blurred, cv2.CV_32F, 0, 1, scale=0.125))
    if not count:
        empty = np.zeros(0, dtype=np.float32)
        return Views(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32), empty, np.zeros((0, 3), dtype=np.float32), empty)
    gradient = sampled(np.asarray(slope, dtype=np.float32), points).mean(axis=1)
    light = sampled(LINEAR[rgb], points).mean(axis=1)
    quality = areas_px(seen.corners) * (gradient + _PLAIN)
    height, width = rgb.shape[:2]
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    radius = np.linalg.norm(seen.corners.mean(axis=1) - middle, axis=1) / np.linalg.norm(middle)
    return Views(
        seen.faces.astype(np.int32),
        np.full(count, number, dtype=np.int32),
        quality.astype(np.float32),
        light,
        radius.astype(np.float32),
    )


def joined(parts: Sequence[Views]) -> Views:
    """Returns the views of several photographs."""
    face = np.concatenate([p.face for p in parts])
    photograph = np.concatenate([p.photograph for p in parts])
    order = np.lexsort((photograph, face))
    return Views(
        face[order], photograph[order], np.concatenate([p.quality for p in parts])[order],
        np.concatenate([p.light for p in parts])[order], np.concatenate([p.radius for p in parts])[order],
    )  # fmt: skip


def areas_px(corners: F64) -> F64:
    """Returns the areas (F,) of triangles (F, 3, 2), square pixels."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0)


def sampled(image: F32, points: F32) -> F32:
    """Returns the values of an image (H, W) or (H, W, C) at points (..., 2), pixels, between four pixels; those of the edge beyond it."""
    if not points.size:
        return np.zeros((*points.shape[:-1], *image.shape[2:]), dtype=np.float32)
    flat = np.ascontiguousarray(points.reshape(-1, 2), dtype=np.float32)
    # OpenCV's remap takes maps of fewer than 32768 rows and columns.
    width = 1024
    rows = -(-len(flat) // width)
    maps = np.zeros((rows * width, 2), dtype=np.float32)
    maps[: len(flat)] = flat
    out = [
        cv2.remap(
            image,
            np.ascontiguousarray(part[..., 0]),
            np.ascontiguousarray(part[..., 1]),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for part in np.array_split(maps.reshape(rows, width, 2), -(-rows // 16384) or 1)
    ]
    values = np.concatenate(out).reshape(rows * width, *image.shape[2:])[: len(flat)]
    return np.asarray(values.reshape(*points.shape[:-1], *image.shape[2:]), dtype=np.float32)


def intrinsics_radius(intrinsics: Intrinsics) -> F32:
    """Returns (H, W): the distance of each pixel from the middle of the image; 1 = its corner."""
    y, x = np.mgrid[: intrinsics.height, : intrinsics.width].astype(np.float32)
    a, b = (intrinsics.width - 1) / 2, (intrinsics.height - 1) / 2
    return np.asarray(np.hypot(x - a, y - b) / np.hypot(a, b), dtype=np.float32)
