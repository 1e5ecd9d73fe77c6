"""Other lights and other cameras, by hand-computed pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim_learn.path_following.photometry import Photometry, RoomLight, photographed, relit_linear, white_gains

GREY = np.full((4, 6, 3), 100, dtype=np.uint8)
TOWARDS_X = np.tile(np.array([-1.0, 0.0, 0.0], dtype=np.float32), (4, 6, 1))
"""Normals of a wall ahead of a camera that looks along +x."""
EYE = (0.0, 0.0, 0.0)
AT_2_M = np.tile(np.array([2.0, 0.0, 0.0], dtype=np.float32), (4, 6, 1))


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def linear(pixel: int) -> float:
    return float(linear_from_srgb(pixel / 255.0))


def test_neutral_light_and_camera_change_nothing() -> None:
    assert (photographed(relit_linear(GREY, TOWARDS_X, AT_2_M, EYE, RoomLight()), Photometry(), rng()) == GREY).all()
    assert (photographed(GREY, Photometry(), rng()) == GREY).all()
    assert white_gains(6500.0).tolist() == [1.0, 1.0, 1.0]


def test_one_stop_doubles_linear_light() -> None:
    brighter = photographed(GREY, Photometry(exposure_ev=1.0), rng())
    assert linear(int(brighter[0, 0, 0])) == pytest.approx(2.0 * linear(100), rel=0.01)


def test_bright_pixels_saturate() -> None:
    assert (photographed(GREY, Photometry(exposure_ev=8.0), rng()) == 255).all()


def test_automatic_exposure_brings_dark_and_bright_images_to_one_level() -> None:
    dark, bright = (photographed(np.full_like(GREY, v), Photometry(auto_exposure=True), rng()) for v in (20, 200))
    assert np.abs(dark.astype(int) - bright).max() <= 1


def test_warm_white_is_red_and_keeps_the_luminance() -> None:
    red, _, blue = white_gains(3000.0).tolist()
    assert red > 1.0 > blue
    assert white_gains(3000.0) @ np.array([0.2126, 0.7152, 0.0722]) == pytest.approx(1.0, rel=1e-5)


def test_the_vignette_darkens_corners_and_leaves_the_middle() -> None:
    grey = np.full((65, 97, 3), 100, dtype=np.uint8)
    out = photographed(grey, Photometry(vignette=0.5), rng())
    assert out[32, 48, 0] == 100
    assert linear(int(out[0, 0, 0])) == pytest.approx(0.5 * linear(100), rel=0.02)


def test_noise_has_its_deviation_and_comes_from_the_generator() -> None:
    grey = np.full((64, 96, 3), 128, dtype=np.uint8)
    one, same = (photographed(grey, Photometry(noise=4.0), rng()) for _ in range(2))
    assert (one == same).all()
    assert np.std(one.astype(float)) == pytest.approx(4.0, rel=0.05)


def test_blur_spreads_a_point_and_keeps_its_light() -> None:
    black = np.zeros((64, 96, 3), dtype=np.uint8)
    black[32, 48] = 255
    out = linear_from_srgb(photographed(black, Photometry(blur=1.0), rng()) / 255.0)
    # A Gaussian of standard deviation 1 has 1 / (2 pi) at its middle.
    assert out[32, 48, 0] == pytest.approx(1.0 / (2.0 * math.pi), rel=0.03)
    assert out[..., 0].sum() == pytest.approx(1.0, rel=0.05)


def test_a_lamp_falls_off_with_the_square_of_the_distance() -> None:
    night = RoomLight(ambient=0.0, lamp=1.0)
    out = relit_linear(GREY, TOWARDS_X, AT_2_M, EYE, night)
    assert out[0, 0, 0] == pytest.approx(linear(100) / 4.09, rel=1e-4)
    assert (relit_linear(GREY, -TOWARDS_X, AT_2_M, EYE, night) == 0).all()  # it faces away


def test_a_sun_lights_surfaces_that_face_it() -> None:
    sun = RoomLight(sun=1.0, sun_azimuth=math.pi, sun_elevation=0.0)
    lit = relit_linear(GREY, TOWARDS_X, AT_2_M, EYE, sun)
    assert lit[0, 0, 0] == pytest.approx(2.0 * linear(100), rel=1e-4)
    assert relit_linear(GREY, -TOWARDS_X, AT_2_M, EYE, sun)[0, 0, 0] == pytest.approx(linear(100), rel=1e-4)


def test_where_there_is_nothing_only_the_ambient_light_counts() -> None:
    nothing = np.full((4, 6, 3), np.nan, dtype=np.float32)
    out = relit_linear(GREY, nothing, nothing, EYE, RoomLight(ambient=2.0, sun=1.0, lamp=1.0, unevenness_ev=1.0))
    assert out[0, 0, 0] == pytest.approx(2.0 * linear(100), rel=1e-4)


def test_light_brighter_than_white_is_kept_for_the_exposure() -> None:
    bright = relit_linear(np.full_like(GREY, 255), TOWARDS_X, AT_2_M, EYE, RoomLight(ambient=4.0))
    assert (photographed(bright, Photometry(exposure_ev=-2.0), rng()) == 255).all()


def test_impossible_values_are_refused_with_their_limits() -> None:
    with pytest.raises(ConfigError, match=r"vignette is 1\.5, must be from 0 to 1"):
        Photometry(vignette=1.5)
    with pytest.raises(ConfigError, match="ambient is -1, must be 0 or more"):
        RoomLight(ambient=-1.0)
