"""Statistics of synthetic pictures."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.bags.comparison.pictures import STATISTICS, exposure_stops, histogram_distance, picture_statistics, thumbnail


def flat(value: int, size: int = 64) -> np.ndarray:
    return np.full((size, size, 3), value, dtype=np.uint8)


def statistic(rgb: np.ndarray, name: str) -> float:
    return float(picture_statistics(rgb)[0][STATISTICS.index(name)])


def test_grey_has_its_brightness_and_nothing_else() -> None:
    found = dict(zip(STATISTICS, picture_statistics(flat(51))[0].tolist(), strict=True))
    assert found == pytest.approx(
        {
            "brightness": 0.2,
            "contrast": 0.0,
            "sharpness": 0.0,
            "noise": 0.0,
            "red": 0.2,
            "green": 0.2,
            "blue": 0.2,
            "saturation": 0.0,
        }
    )


def test_contrast_of_two_halves_is_half_their_difference() -> None:
    rgb = flat(0)
    rgb[:, 32:] = 255
    assert statistic(rgb, "contrast") == pytest.approx(0.5)


def test_noise_is_recovered_on_any_gradient() -> None:
    slope = np.linspace(60, 180, 256)[None, :, None] * np.ones((256, 256, 1))
    noise = 6.0 * np.random.default_rng(1).standard_normal((256, 256, 1))
    rgb = np.clip(np.rint(slope + noise), 0, 255).astype(np.uint8).repeat(3, axis=2)
    assert statistic(rgb, "noise") == pytest.approx(6.0 / 255, rel=0.05)


def test_blurred_picture_is_less_sharp() -> None:
    import cv2

    rgb = np.random.default_rng(2).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    assert statistic(cv2.GaussianBlur(rgb, (5, 5), 2.0), "sharpness") < 0.1 * statistic(rgb, "sharpness")


def test_red_is_saturated() -> None:
    rgb = flat(0)
    rgb[:, :, 0] = 255
    assert (statistic(rgb, "red"), statistic(rgb, "blue"), statistic(rgb, "saturation")) == pytest.approx((1.0, 0.0, 1.0))


def test_distance_of_histograms_is_the_earth_movers_distance() -> None:
    black, white, middle = (picture_statistics(flat(value))[1] for value in (0, 255, 128))
    assert histogram_distance(black, black) == 0.0
    assert histogram_distance(black, white) == pytest.approx(1.0)
    assert histogram_distance(black, middle) == pytest.approx(0.5, abs=0.02)


def test_twice_the_light_is_one_stop() -> None:
    # sRGB 0.5 is 0.214 of the full light, 0.6858 twice that.
    assert exposure_stops(0.6858, 0.5) == pytest.approx(1.0, abs=0.01)


def test_thumbnail_keeps_the_shape() -> None:
    assert thumbnail(np.zeros((480, 640, 3), dtype=np.uint8)).shape == (180, 240, 3)
