"""Selects the voxel size of a fusion: as fine as the depth is sharp, no finer than 1 cm, and within a limit of memory. Knows no Open3D."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import transform_points
from gibson_sim_tools.scanning.posed_rgbd import PosedRgbd, ScanError
from gibson_sim_tools.scanning.settings import FuseSettings

F64 = NDArray[np.float64]

SIZES = (0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08)
"""Voxel sizes from which is selected, metres."""
BLOCK_VOXELS = 16
"""Voxels along the edge of a block, the unit in which Open3D allocates."""
BLOCK_BYTES = BLOCK_VOXELS**3 * (12 + 16)
"""Memory of a block: distance, weight and colour of each voxel, and the indices of the vertices when triangles are extracted."""
_FRAMES = 40
"""Number of frames that are looked at."""
_STEP = 6
"""Every so many pixels, in both directions, are looked at."""
_FARTHER = 0.75
"""Share of the depths that are at most as far as the one that decides."""
_BAND = 2.5
"""Least half width of the truncation band, standard deviations of the noise: where depths scatter beyond it, surfaces become double."""
_PATCH = 12
"""Edge of the blocks of pixels in which the noise is measured, pixels."""
_MEDIAN = 1.4826
"""Standard deviation of a normal distribution divided by the median absolute deviation."""
_ALONG = 5
"""Samples across the truncation band."""
_GB = 1e9


@dataclass(frozen=True, slots=True)
class VoxelSize:
    """A selected voxel size, and why."""

    voxel: float
    """Metres."""
    pixel: float
    """Distance of neighbouring pixels on a surface at ``depth``, metres."""
    depth: float
    """Depth that three quarters of the pixels do not exceed, metres."""
    noise: float
    """Noise of the depth, standard deviation, that three quarters of the pixels do not exceed, metres."""
    blocks: int
    """Estimated number of blocks."""
    finer_gb: float | None
    """Memory that the next finer size would need, GB, if memory decided; else None."""

    @property
    def memory_gb(self) -> float:
        """Estimated memory, GB."""
        return self.blocks * BLOCK_BYTES / _GB

    def text(self, limit_gb: float) -> str:
        """Returns the choice in words."""
        seen = f"pixels are {1000.0 * self.pixel:.1f} mm apart at {self.depth:.1f} m (75th percentile of depth)"
        out = f"voxels of {100.0 * self.voxel:g} cm: {seen}; noise {1000.0 * self.noise:.1f} mm; about {self.memory_gb:.1f} GB"
        if self.finer_gb is not None:
            out += f", finer ones would need {self.finer_gb:.1f} GB (--memory {limit_gb:g})"
        return out


def select_voxel_size(rgbd: PosedRgbd, settings: FuseSettings, frames: range) -> VoxelSize:
    """Returns the finest size of ``SIZES`` that the pixels resolve, whose truncation band holds their noise, and that fits into ``settings.memory``.

    Args:
        rgbd: the frames.
        settings: settings of the fusion.
        frames: numbers of the frames to fuse.

    Raises:
        ScanError: an image is broken, nothing is in range, or no size fits.
    """
    rows = sorted({frames[int(k)] for k in np.linspace(0, len(frames) - 1, min(len(frames), _FRAMES))})
    clouds = [_cloud(rgbd, number, settings.depth_max) for number in rows]
    depths = np.concatenate([cloud.depth for cloud in clouds])
    if not len(depths):
        raise ScanError(
            f"{rgbd.folder}: no depth is within {settings.depth_max:g} m; give a larger --depth-max, and check the depth scale"
        )
    depth = float(np.quantile(depths, _FARTHER))
    pixel = depth / max(rgbd.intrinsics.fx, rgbd.intrinsics.fy)
    noise = float(np.quantile(np.concatenate([cloud.noise for cloud in clouds]), _FARTHER))
    finer = None
    for size in SIZES:
        if size < max(pixel, _BAND * noise / settings.truncation) and size != SIZES[-1]:
            continue
        blocks = _blocks(clouds, size, settings.truncation * size, len(frames) / len(rows))
        if blocks * BLOCK_BYTES <= settings.memory * _GB:
            return VoxelSize(size, pixel, depth, noise, blocks, finer)
        finer = blocks * BLOCK_BYTES / _GB
    raise ScanError(
        f"{rgbd.folder}: voxels of {100.0 * SIZES[-1]:g} cm would need {finer:.1f} GB; give more --memory than {settings.memory:g} GB, "
        "a smaller --depth-max, or --voxel"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Cloud:
    """What is looked at of a frame."""

    rays: F64
    """(N, 3), camera frame with z = 1."""
    depth: F64
    """(N,), metres."""
    noise: F64
    """(B,), noise of the depth in each block of pixels, metres."""
    T_world_camera: F64
    """(4, 4)."""


def _cloud(rgbd: PosedRgbd, number: int, depth_max: float) -> _Cloud:
    frame = rgbd[number]
    depth = frame.depth[::_STEP, ::_STEP].astype(np.float64)
    v, u = np.nonzero(np.isfinite(depth) & (depth <= depth_max))
    camera = rgbd.intrinsics
    rays = np.stack(
        [(u * _STEP - camera.cx) / camera.fx, (v * _STEP - camera.cy) / camera.fy, np.ones(len(u))], axis=1
    )  # fmt: skip
    return _Cloud(rays, depth[v, u], _noise(frame.depth, depth_max), frame.T_world_camera)


def _noise(depth: NDArray[np.float32], depth_max: float) -> F64:
    """Returns the noise of a depth image (H, W), metres, in each block of pixels that shows enough of one surface."""
    near = np.where(depth <= depth_max, depth, np.nan).astype(np.float64)
    # What is left of a slanted plane by a second difference is noise, with six times the variance; edges are outliers of the median.
    bend = np.abs(near[:, :-2] - 2.0 * near[:, 1:-1] + near[:, 2:])
    rows, columns = (size // _PATCH for size in bend.shape)
    blocks = (
        bend[: rows * _PATCH, : columns * _PATCH].reshape(rows, _PATCH, columns, _PATCH).swapaxes(1, 2).reshape(-1, _PATCH**2)
    )
    blocks = blocks[np.isfinite(blocks).mean(axis=1) > 0.5]
    return np.asarray(_MEDIAN / math.sqrt(6.0) * np.nanmedian(blocks, axis=1)) if len(blocks) else np.zeros(1)


def _blocks(clouds: list[_Cloud], size: float, band: float, more: float) -> int:
    """Returns the estimated number of blocks that all frames touch, ``more`` times as many as these."""
    keys = []
    for cloud in clouds:
        at = (cloud.depth[:, None] + np.linspace(-band, band, _ALONG)).reshape(-1, 1)
        points = transform_points(cloud.T_world_camera, np.repeat(cloud.rays, _ALONG, axis=0) * at)
        keys.append(_distinct(np.floor(points / (BLOCK_VOXELS * size)).astype(np.int64)))
    every = len(_distinct(np.concatenate(keys)))
    half = len(_distinct(np.concatenate(keys[::2])))
    # The number grows with a power of the number of frames, ever more slowly.
    growth = math.log2(every / half) if len(keys) > 1 and half else 0.0
    return math.ceil(every * float(more**growth))


def _distinct(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(cells, axis=0)
