"""Where a denoiser removed only noise."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.denoise import is_noise

GREY = np.full((40, 50, 3), 0.5, dtype=np.float32)


def test_a_change_below_the_noise_is_accepted() -> None:
    rng = np.random.default_rng(0)
    first, second = (GREY + rng.normal(0.0, 0.05, GREY.shape).astype(np.float32) for _ in range(2))
    assert is_noise((first + second) / 2, GREY, (first - second) / 2).mean() > 0.999


def test_texture_that_both_halves_have_is_kept() -> None:
    texture = GREY.copy()
    texture[:, ::4] = texture[:, 1::4] = 0.3
    noise = np.full_like(GREY, 0.01)
    accepted = is_noise(texture, GREY, noise)
    assert not accepted[:, 0::4].any()
    assert not accepted[:, 1::4].any()
    assert accepted[:, 2::4].all()


def test_a_bright_pixel_is_removed_even_if_both_halves_have_it() -> None:
    mean = GREY.copy()
    mean[20, 25] = 4.0
    assert is_noise(mean, GREY, np.full_like(GREY, 0.01))[20, 25]


def test_a_bright_pixel_of_one_half_is_removed() -> None:
    spread = np.zeros_like(GREY)
    mean, spread[20, 25] = GREY.copy(), 3.0
    mean[20, 25] += 3.0
    assert is_noise(mean, GREY, spread)[20, 25]
