"""The voxel size follows from pixel spacing, depth noise and memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_tools.scanning.posed_images import (
    CameraModel,
    Intrinsics,
    Photograph,
    Photographs,
    PosedRgbd,
    RgbdFrame,
    ScanError,
)
from gibson_sim_tools.scanning.settings import FuseSettings
from gibson_sim_tools.scanning.voxel_size import BLOCK_BYTES, SIZES, select_voxel_size


class Wall(PosedRgbd):
    """Cameras that look straight at a wall, each 0.1 m beside the last."""

    def __init__(self, focal: float, depth: float, frames: int = 4, noise: float = 0.0) -> None:
        intrinsics = Intrinsics(96, 72, focal, focal, 47.5, 35.5)
        items = tuple(Photograph(Path("c"), CameraModel(intrinsics), np.eye(4), Path("d")) for _ in range(frames))
        super().__init__(Photographs(Path("scan"), "test", items), intrinsics)
        object.__setattr__(self, "_depth", depth)
        object.__setattr__(self, "_noise", noise)

    def __getitem__(self, number: int) -> RgbdFrame:
        pose = np.eye(4)
        pose[0, 3] = 0.1 * number
        depth = np.random.default_rng(number).normal(self._depth, self._noise, (72, 96))  # type: ignore[attr-defined]
        return RgbdFrame(number, np.zeros((72, 96, 3), np.uint8), depth.astype(np.float32), pose)


def test_voxels_are_as_fine_as_the_pixels_and_not_below_a_centimetre() -> None:
    settings = FuseSettings()
    for focal, depth, voxel in ((100.0, 2.0, 0.02), (100.0, 1.4, 0.015), (400.0, 2.0, 0.01), (50.0, 3.5, 0.08)):
        found = select_voxel_size(Wall(focal, depth), settings, range(4))
        assert (found.voxel, found.finer_gb) == (voxel, None)
        assert found.pixel == pytest.approx(depth / focal, rel=1e-5) and found.depth == pytest.approx(depth)
    assert SIZES[0] == 0.01


def test_the_truncation_band_holds_the_noise_of_the_depth() -> None:
    # Three quarters of the blocks of pixels measure the noise with at most some per cent more.
    found = select_voxel_size(Wall(400.0, 2.0, noise=0.018), FuseSettings(), range(4))
    assert found.noise == pytest.approx(0.018, rel=0.12) and found.voxel == 0.015  # 2.5 x 0.018 / 4 = 0.011
    assert select_voxel_size(Wall(400.0, 2.0, noise=0.008), FuseSettings(), range(4)).voxel == 0.01
    assert "noise 1" in found.text(4.0)


def test_the_blocks_of_a_wall_are_counted() -> None:
    # Voxels of 2 cm: blocks of 32 cm. Rays reach from -0.95 m to 0.89 m, and 0.3 m more by the last camera; up to 0.71 m to either side;
    # the band from 1.92 to 2.08 m lies in a single layer of blocks, the seventh.
    found = select_voxel_size(Wall(100.0, 2.0), FuseSettings(), range(4))
    assert found.blocks == pytest.approx(7 * 6, abs=8)
    assert found.memory_gb == pytest.approx(found.blocks * BLOCK_BYTES / 1e9)


def test_a_limit_of_memory_makes_voxels_larger_and_says_so() -> None:
    wall = Wall(400.0, 3.9, frames=400)
    free = select_voxel_size(wall, FuseSettings(), range(400))
    assert free.voxel == 0.01
    tight = FuseSettings(memory=0.1)
    found = select_voxel_size(wall, tight, range(400))
    assert found.voxel > 0.01 and found.memory_gb <= 0.1 and found.finer_gb is not None and found.finer_gb > 0.1
    assert "--memory 0.1" in found.text(0.1) and f"voxels of {100 * found.voxel:g} cm" in found.text(0.1)


def test_no_depth_in_range_or_no_memory_is_an_error() -> None:
    with pytest.raises(ScanError, match="--depth-max"):
        select_voxel_size(Wall(100.0, 9.0), FuseSettings(), range(4))
    with pytest.raises(ScanError, match="--memory"):
        select_voxel_size(Wall(20.0, 900.0, frames=4000), FuseSettings(memory=0.1, depth_max=1000.0), range(4000))
    with pytest.raises(ConfigError, match="must be 0"):
        FuseSettings(voxel=0.0005)
