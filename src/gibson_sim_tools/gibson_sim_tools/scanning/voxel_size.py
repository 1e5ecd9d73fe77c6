"""Selects the voxel size of a TSDF fusion: the finest size that pixel spacing, depth noise and memory allow, at least 1 cm. No Open3D."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import transform_points
from gibson_sim_tools.scanning.posed_images import PosedRgbd, ScanError
from gibson_sim_tools.scanning.settings import FuseSettings

F64 = NDArray[np.float64]

SIZES = (0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08)
"""Candidate voxel sizes, metres."""
BLOCK_VOXELS = 16
"""Voxels along the edge of a block, the unit in which Open3D allocates."""
BLOCK_BYTES = BLOCK_VOXELS**3 * (12 + 16)
"""Memory of a block, bytes: distance, weight and colour of each voxel, and vertex indices during mesh extraction."""
_SAMPLED_FRAMES = 40
"""Number of sampled frames."""
_PIXEL_STRIDE = 6
"""Stride of the sampled pixels, rows and columns."""
_QUANTILE = 0.75
"""Quantile of depth and noise that decides."""
_MIN_BAND_DEVIATIONS = 2.5
"""Least half width of the truncation band, standard deviations of the noise; a narrower band yields double surfaces."""
_PATCH_PX = 12
"""Edge of the blocks of pixels in which the noise is measured, pixels."""
_DEVIATION_PER_MAD = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""
_SAMPLES_PER_RAY = 5
"""Samples across the truncation band."""
_GB = 1e9


@dataclass(frozen=True, slots=True)
class VoxelSize:
    """A selected voxel size, and the quantities that decided it."""

    voxel: float
    """Metres."""
    pixel: float
    """Spacing of neighbouring pixels on a surface at ``depth``, metres."""
    depth: float
    """75th percentile of the depth, metres."""
    noise: float
    """75th percentile of the depth noise (standard deviation), metres."""
    blocks: int
    """Estimated number of blocks."""
    finer_gb: float | None
    """Memory of the next finer size, GB, if memory decided; else None."""

    @property
    def memory_gb(self) -> float:
        """Estimated memory, GB."""
        return self.blocks * BLOCK_BYTES / _GB

    def text(self, limit_gb: float) -> str:
        """Returns the selection as text."""
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
    rows = sorted({frames[int(k)] for k in np.linspace(0, len(frames) - 1, min(len(frames), _SAMPLED_FRAMES))})
    clouds = [_back_project(rgbd, number, settings.depth_max) for number in rows]
    depths = np.concatenate([cloud.depth for cloud in clouds])
    if not len(depths):
        raise ScanError(
            f"{rgbd.folder}: no depth is within {settings.depth_max:g} m; give a larger --depth-max, and check the depth scale"
        )
    depth = float(np.quantile(depths, _QUANTILE))
    pixel = depth / max(rgbd.intrinsics.fx, rgbd.intrinsics.fy)
    noise = float(np.quantile(np.concatenate([cloud.noise for cloud in clouds]), _QUANTILE))
    finer_gb = None
    for size in SIZES:
        if size < max(pixel, _MIN_BAND_DEVIATIONS * noise / settings.truncation) and size != SIZES[-1]:
            continue
        blocks = _count_blocks(clouds, size, settings.truncation * size, len(frames) / len(rows))
        if blocks * BLOCK_BYTES <= settings.memory * _GB:
            return VoxelSize(size, pixel, depth, noise, blocks, finer_gb)
        finer_gb = blocks * BLOCK_BYTES / _GB
    raise ScanError(
        f"{rgbd.folder}: voxels of {100.0 * SIZES[-1]:g} cm would need {finer_gb:.1f} GB; give more --memory than {settings.memory:g} GB, "
        "a smaller --depth-max, or --voxel"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _PointCloud:
    """Sampled depth of a frame."""

    rays: F64
    """(N, 3), camera frame, scaled to z = 1."""
    depth: F64
    """(N,), metres."""
    noise: F64
    """(B,), noise of the depth in each block of pixels, metres."""
    T_world_camera: F64
    """(4, 4)."""


def _back_project(rgbd: PosedRgbd, number: int, depth_max: float) -> _PointCloud:
    frame = rgbd[number]
    depth = frame.depth[::_PIXEL_STRIDE, ::_PIXEL_STRIDE].astype(np.float64)
    v, u = np.nonzero(np.isfinite(depth) & (depth <= depth_max))
    camera = rgbd.intrinsics
    rays = np.stack(
        [(u * _PIXEL_STRIDE - camera.cx) / camera.fx, (v * _PIXEL_STRIDE - camera.cy) / camera.fy, np.ones(len(u))], axis=1
    )  # fmt: skip
    return _PointCloud(rays, depth[v, u], _depth_noise(frame.depth, depth_max), frame.T_world_camera)


def _depth_noise(depth: NDArray[np.float32], depth_max: float) -> F64:
    """Returns the standard deviation of the depth noise (B,), metres, in each block of pixels of a depth image (H, W) with enough depth."""
    near = np.where(depth <= depth_max, depth, np.nan).astype(np.float64)
    # The second difference of a slanted plane is noise of six times the variance; edges are outliers, which the median ignores.
    second_difference = np.abs(near[:, :-2] - 2.0 * near[:, 1:-1] + near[:, 2:])
    rows, columns = (size // _PATCH_PX for size in second_difference.shape)
    blocks = (
        second_difference[: rows * _PATCH_PX, : columns * _PATCH_PX]
        .reshape(rows, _PATCH_PX, columns, _PATCH_PX)
        .swapaxes(1, 2)
        .reshape(-1, _PATCH_PX**2)
    )
    blocks = blocks[np.isfinite(blocks).mean(axis=1) > 0.5]
    return np.asarray(_DEVIATION_PER_MAD / math.sqrt(6.0) * np.nanmedian(blocks, axis=1)) if len(blocks) else np.zeros(1)


def _count_blocks(clouds: list[_PointCloud], size: float, band: float, frame_ratio: float) -> int:
    """Returns the estimated number of blocks of all frames, which are ``frame_ratio`` times as many as the sampled ones."""
    keys = []
    for cloud in clouds:
        depths = (cloud.depth[:, None] + np.linspace(-band, band, _SAMPLES_PER_RAY)).reshape(-1, 1)
        points = transform_points(cloud.T_world_camera, np.repeat(cloud.rays, _SAMPLES_PER_RAY, axis=0) * depths)
        keys.append(_unique_blocks(np.floor(points / (BLOCK_VOXELS * size)).astype(np.int64)))
    total = len(_unique_blocks(np.concatenate(keys)))
    half_total = len(_unique_blocks(np.concatenate(keys[::2])))
    # The number of blocks grows with a power below 1 of the number of frames; the power is estimated from half the samples.
    growth = math.log2(total / half_total) if len(keys) > 1 and half_total else 0.0
    return math.ceil(total * float(frame_ratio**growth))


def _unique_blocks(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(cells, axis=0)
