"""Table of views: quality and mean colour of each triangle in each photograph that shows it. All later stages work on it.

The quality is the gradient magnitude of the photograph integrated over the projected triangle: the data term of Gal et al., "Seamless Montage for
Texturing Models", Eurographics 2010, which Waechter et al. use ("Let There Be Color!", ECCV 2014). It prefers close, orthogonal, sharp views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear
from gibson_sim_tools.scanning.posed_images import Intrinsics
from gibson_sim_tools.texturing.visibility import VisibleFaces

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]

SAMPLE_WEIGHTS: F64 = np.array(
    [[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [1, 3, 3], [3, 1, 3], [3, 3, 1]], dtype=np.float64
) / np.array([[3], [6], [6], [6], [7], [7], [7]])
"""(S, 3), barycentric coordinates of the points at which a triangle is sampled."""
_GRADIENT_OFFSET = 2.0
"""Offset of the gradient magnitude, 8-bit steps per pixel, so that the projected area decides on surfaces without texture."""
_BLUR_SIGMA_PX = 0.8
"""Standard deviation of the Gaussian blur before the gradient, pixels; it suppresses noise."""
LINEAR_FROM_SRGB8: F32 = linear_from_srgb(np.arange(256, dtype=np.float32) / np.float32(255.0))
"""(256,), linear light, 0 to 1, of each 8-bit sRGB value."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """N views: pairs of a triangle and a photograph that shows it, sorted by triangle, then by photograph."""

    face: I32
    """(N,), index of the triangle."""
    photograph: I32
    """(N,), number of the photograph."""
    quality: F32
    """(N,), gradient magnitude integrated over the projected triangle, 8-bit steps times pixels."""
    linear_rgb: F32
    """(N, 3), mean colour, linear light, 0 to 1."""
    radius: F32
    """(N,), normalised radius of the triangle's centre in the photograph; 1 = corner of the image."""

    def __len__(self) -> int:
        return len(self.face)

    def subset(self, rows: NDArray[np.bool_] | I64) -> Views:
        """Returns the views of a mask or of ascending rows."""
        return Views(self.face[rows], self.photograph[rows], self.quality[rows], self.linear_rgb[rows], self.radius[rows])

    @property
    def srgb(self) -> F32:
        """(N, 3), mean colour, sRGB, 0 to 1."""
        return np.asarray(srgb_from_linear(self.linear_rgb), dtype=np.float32)


def face_views(number: int, visible: VisibleFaces, rgb: U8) -> Views:
    """Returns the views of the visible triangles of one photograph.

    Args:
        number: number of the photograph.
        visible: its visible triangles.
        rgb: (H, W, 3) uint8, sRGB.
    """
    points = np.einsum("sk,fkc->fsc", SAMPLE_WEIGHTS, visible.corners).astype(np.float32)
    count = len(visible.faces)
    blurred = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), _BLUR_SIGMA_PX)
    gradient_image = cv2.magnitude(
        cv2.Sobel(blurred, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(blurred, cv2.CV_32F, 0, 1, scale=0.125)
    )
    if not count:
        empty = np.zeros(0, dtype=np.float32)
        return Views(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32), empty, np.zeros((0, 3), dtype=np.float32), empty)
    gradient = sample_bilinear(np.asarray(gradient_image, dtype=np.float32), points).mean(axis=1)
    linear_rgb = sample_bilinear(LINEAR_FROM_SRGB8[rgb], points).mean(axis=1)
    quality = triangle_areas_px(visible.corners) * (gradient + _GRADIENT_OFFSET)
    height, width = rgb.shape[:2]
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    radius = np.linalg.norm(visible.corners.mean(axis=1) - centre, axis=1) / np.linalg.norm(centre)
    return Views(
        visible.faces.astype(np.int32),
        np.full(count, number, dtype=np.int32),
        quality.astype(np.float32),
        linear_rgb,
        radius.astype(np.float32),
    )


def concatenate_views(parts: Sequence[Views]) -> Views:
    """Returns the views of several photographs in one sorted table."""
    face = np.concatenate([p.face for p in parts])
    photograph = np.concatenate([p.photograph for p in parts])
    order = np.lexsort((photograph, face))
    return Views(
        face[order], photograph[order], np.concatenate([p.quality for p in parts])[order],
        np.concatenate([p.linear_rgb for p in parts])[order], np.concatenate([p.radius for p in parts])[order],
    )  # fmt: skip


def triangle_areas_px(corners: F64) -> F64:
    """Returns the areas (F,), square pixels, of triangles (F, 3, 2), pixels."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0)


def sample_bilinear(image: F32, points: F32) -> F32:
    """Returns an image (H, W) or (H, W, C), sampled bilinearly at points (..., 2), columns and rows, with replicated border."""
    if not points.size:
        return np.zeros((*points.shape[:-1], *image.shape[2:]), dtype=np.float32)
    flat = np.ascontiguousarray(points.reshape(-1, 2), dtype=np.float32)
    # OpenCV's remap accepts maps with fewer than 32768 rows and columns.
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


def normalised_radius(intrinsics: Intrinsics) -> F32:
    """Returns (H, W) float32: distance of each pixel from the image centre; 1 = corner of the image."""
    y, x = np.mgrid[: intrinsics.height, : intrinsics.width].astype(np.float32)
    a, b = (intrinsics.width - 1) / 2, (intrinsics.height - 1) / 2
    return np.asarray(np.hypot(x - a, y - b) / np.hypot(a, b), dtype=np.float32)
