"""Selects the voxel size of a fusion: as fine as the cameras resolve, no finer than 1 cm, and within a limit of memory. Knows no Open3D."""

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
        seen = (
            f"pixels are {1000.0 * self.pixel:.1f} mm apart at {self.depth:.1f} m, where three quarters of the depths are nearer"
        )
        out = f"voxels of {100.0 * self.voxel:g} cm: {seen}; about {self.memory_gb:.1f} GB"
        if self.finer_gb is not None:
            out += f", finer ones would need {self.finer_gb:.1f} GB (--memory {limit_gb:g})"
        return out


def select_voxel_size(rgbd: PosedRgbd, settings: FuseSettings, frames: range) -> VoxelSize:
    """Returns the finest size of ``SIZES`` that the pixels resolve and that fits into ``settings.memory``.

    Args:
        rgbd: the frames.
        settings: settings of the fusion.
        frames: numbers of the frames to fuse.

    Raises:
        ScanError: an image is broken, nothing is in range, or no size fits.
    """
    rows = sorted({frames[int(k)] for k in np.linspace(0, len(frames) - 1, min(len(frames), _FRAMES))})
    clouds = [_points(rgbd, number, settings.depth_max) for number in rows]
    depths = np.concatenate([depth for _, depth, _ in clouds])
    if not len(depths):
        raise ScanError(
            f"{rgbd.folder}: no depth is within {settings.depth_max:g} m; give a larger --depth-max, and check the depth scale"
        )
    depth = float(np.quantile(depths, _FARTHER))
    pixel = depth / max(rgbd.intrinsics.fx, rgbd.intrinsics.fy)
    finer = None
    for size in SIZES:
        if size < pixel and size != SIZES[-1]:
            continue
        blocks = _blocks(clouds, size, settings.truncation * size, len(frames) / len(rows))
        if blocks * BLOCK_BYTES <= settings.memory * _GB:
            return VoxelSize(size, pixel, depth, blocks, finer)
        finer = blocks * BLOCK_BYTES / _GB
    raise ScanError(
        f"{rgbd.folder}: voxels of {100.0 * SIZES[-1]:g} cm would need {finer:.1f} GB; give more --memory than {settings.memory:g} GB, "
        "a smaller --depth-max, or --voxel"
    )


def _points(rgbd: PosedRgbd, number: int, depth_max: float) -> tuple[F64, F64, F64]:
    """Returns rays (N, 3), camera frame with z = 1, depths (N,), and T_world_camera (4, 4) of a frame."""
    frame = rgbd[number]
    depth = frame.depth[::_STEP, ::_STEP].astype(np.float64)
    v, u = np.nonzero(np.isfinite(depth) & (depth <= depth_max))
    camera = rgbd.intrinsics
    rays = np.stack(
        [(u * _STEP - camera.cx) / camera.fx, (v * _STEP - camera.cy) / camera.fy, np.ones(len(u))], axis=1
    )  # fmt: skip
    return rays, depth[v, u], frame.T_world_camera


def _blocks(clouds: list[tuple[F64, F64, F64]], size: float, band: float, more: float) -> int:
    """Returns the estimated number of blocks that all frames touch, ``more`` times as many as these."""
    keys = []
    for rays, depth, T in clouds:
        at = (depth[:, None] + np.linspace(-band, band, _ALONG)).reshape(-1, 1)
        points = transform_points(T, np.repeat(rays, _ALONG, axis=0) * at)
        keys.append(_distinct(np.floor(points / (BLOCK_VOXELS * size)).astype(np.int64)))
    every = len(_distinct(np.concatenate(keys)))
    half = len(_distinct(np.concatenate(keys[::2])))
    # The number grows with a power of the number of frames, ever more slowly.
    growth = math.log2(every / half) if len(keys) > 1 and half else 0.0
    return math.ceil(every * float(more**growth))


def _distinct(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(cells, axis=0)
