"""Depth registration: reprojects depth images of one camera to the image of another, as drivers of RGB-D cameras do. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.projections import project, unproject
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.types import CameraSpec

MAX_SPLIT = 8
"""Maximum number of subpixels per side."""
F32 = NDArray[np.float32]


def split_for(source: CameraSpec, target: CameraSpec) -> int:
    """Returns the number of subpixels per side into which a pixel of ``source`` is split for ``target``.

    Raises:
        ConfigError: the number exceeds ``MAX_SPLIT``.
    """
    finer = float((np.diag(target.intrinsics())[:2] / np.diag(source.intrinsics())[:2]).max())
    split = max(1, math.ceil(finer - 1e-6))
    if split > MAX_SPLIT:
        raise ConfigError(
            f"depth of camera {source.name!r} cannot be registered to {target.name!r}, whose pixels are {finer:.1f} times as fine; "
            f"at most {MAX_SPLIT} times: give {target.name!r} a smaller image or the depth camera a larger one"
        )
    return split


class DepthRegistration:
    """Registers depth images of ``source`` to the image of ``target``.

    Each pixel is a small square at its depth, split as finely as the target's pixels, so that a target of higher resolution has no gaps;
    the nearest square wins. Surfaces not visible to the source remain empty.

    Args:
        source: the depth camera.
        target: the camera that determines image size, K and frame of the result.
        T_target_source: (4, 4), optical frames.

    Raises:
        ConfigError: see ``split_for``.
    """

    def __init__(self, source: CameraSpec, target: CameraSpec, T_target_source: Mat4) -> None:
        self._split = split_for(source, target)
        n = self._split
        offsets = (np.arange(n) + 0.5) / n - 0.5
        v = (np.arange(source.height)[:, None] + offsets).ravel()
        u = (np.arange(source.width)[:, None] + offsets).ravel()
        rays = unproject(np.stack(np.meshgrid(u, v), axis=-1), source).reshape(-1, 3)
        T = np.asarray(T_target_source, dtype=np.float64)
        # (3, N): a point at depth d is d times its direction plus an offset, which avoids a matrix product for each image.
        self._directions = np.ascontiguousarray((rays @ T[:3, :3].T).T, dtype=np.float32)
        self._offset = T[:3, 3].astype(np.float32)
        self._source, self._target = source, target

    def image(self, depth: ArrayLike) -> F32:
        """Returns the depth in the target's image, (H, W) of the target, metres, +inf = unknown.

        Args:
            depth: (H, W) of the source, metres, in the convention of its projection; values that are not finite are ignored.

        Raises:
            ConfigError: the depth does not have the source's size.
        """
        d = np.asarray(depth, dtype=np.float32)
        if d.shape != (self._source.height, self._source.width):
            size = f"{self._source.height, self._source.width}"
            raise ConfigError(f"depth has shape {d.shape}, images of camera {self._source.name!r} have {size}")
        fine = np.repeat(np.repeat(d, self._split, axis=0), self._split, axis=1).ravel()
        fine = np.where(np.isfinite(fine), fine, np.float32(np.nan))
        x, y, z = (direction * fine + offset for direction, offset in zip(self._directions, self._offset, strict=True))
        u, v, target_depth = self._project(x, y, z)
        height, width = self._target.height, self._target.width
        # NaN, without depth or behind the camera, compares as false.
        inside = np.flatnonzero(
            (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
            & (target_depth >= self._target.near) & (target_depth <= self._target.far)
        )  # fmt: skip
        pixels = np.rint(v[inside]).astype(np.int64) * width + np.rint(u[inside]).astype(np.int64)
        out = np.full(height * width, np.inf, dtype=np.float32)
        np.minimum.at(out, pixels, target_depth[inside])
        return out.reshape(height, width)

    def _project(self, x: F32, y: F32, z: F32) -> tuple[F32, F32, F32]:
        """Returns column, row and depth of points in the target's frame, each (N,); NaN outside its field of view."""
        if self._target.projection != "pinhole" or any(self._target.distortion):
            pixels, depth = project(np.stack([x, y, z], axis=1), self._target)
            return pixels[:, 0].astype(np.float32), pixels[:, 1].astype(np.float32), depth.astype(np.float32)
        k = self._target.intrinsics().astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(z > 0.0, np.float32(1.0) / z, np.float32(np.nan))
        return (k[0, 0] * x + k[0, 1] * y) * inverse + k[0, 2], k[1, 1] * y * inverse + k[1, 2], z
