"""PSNR and SSIM: values by hand."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.sensors.image_similarity import psnr, ssim_map


def flat(level: int, width: int = 12) -> np.ndarray:
    return np.full((32, width, 3), level, np.uint8)


def test_psnr_by_hand() -> None:
    # An error of 8 everywhere: 10 log10(255^2 / 64) = 30.07 dB.
    assert psnr(64.0) == pytest.approx(30.07, abs=0.01)
    assert psnr(64.0 / 255.0**2, peak=1.0) == pytest.approx(30.07, abs=0.01)
    assert psnr(0.0) == psnr(0.0, peak=1.0) == 60.0


def test_ssim_of_flat_images_by_hand() -> None:
    # No structure: (2 100 200 + 6.5025) / (100^2 + 200^2 + 6.5025) = 0.80003.
    assert ssim_map(flat(100), flat(200)) == pytest.approx(0.80003, abs=1e-4)
    assert ssim_map(flat(100), flat(100)) == pytest.approx(1.0)
    assert ssim_map(flat(100) / 255.0, flat(200) / 255.0, peak=1.0) == pytest.approx(0.80003, abs=1e-4)


def test_ssim_of_equal_images_is_1_and_of_noise_less() -> None:
    image = np.random.default_rng(0).random((30, 30, 3)).astype(np.float32)
    np.testing.assert_allclose(ssim_map(image, image, peak=1.0), 1.0, atol=1e-5)
    assert ssim_map(image, image[::-1], peak=1.0).mean() < 0.3


def test_ssim_falls_where_pictures_differ_alone() -> None:
    other = flat(100, 32)
    other[:, 24:] = 0
    found = ssim_map(other, flat(100, 32))
    assert found[:, :16].min() > 0.999 and found[:, 28:].max() < 0.01
