"""Views become panoramas in which a turn is a shift, whatever the light is."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from gibson_path_following.errors import SettingError, ViewError
from gibson_path_following.images.preprocessing import PreprocessingSettings, Preprocessor, texture
from gibson_path_following.localisation.matching import Matcher, MatchingSettings
from support.path_views import HFOV, SIZE, fisheye_view, pinhole_view

DEG = math.pi / 180.0


def pinhole() -> Preprocessor:
    return Preprocessor("pinhole", HFOV, SIZE)


def test_a_line_in_an_image_is_at_its_azimuth_in_the_panorama() -> None:
    # 100 degrees at 45 columns per radian are 79 columns. The focal length is 48 / tan(50 deg) = 40.28 pixels, so that the middle of
    # pixel 80 is 32.5 pixels to the right of the axis: atan(32.5 / 40.28) = 38.9 degrees; that is 39.5 + 38.9 / (100 / 79) = 70.2.
    image = np.zeros((64, 96, 3), dtype=np.uint8)
    image[:, 80] = 255
    found = pinhole().panorama((image,))
    assert found.shape == (32, 79)
    assert int(found[16].argmax()) == 70


def test_the_middle_of_the_panorama_is_ahead_and_back_is_at_its_ends() -> None:
    ahead, back = np.zeros((2, 64, 64, 3), dtype=np.uint8)
    ahead[:], back[:] = 200, 50
    camera = Preprocessor("fisheye_pair", math.pi, (64, 64))
    found = camera.panorama((ahead, back))
    assert found.shape == (32, 283)  # 2 pi x 45
    assert np.allclose(found[:, 141], 200) and np.allclose(found[:, :68], 50) and np.allclose(found[:, -68:], 50)


def test_exposure_and_contrast_are_gone_after_normalisation() -> None:
    camera = pinhole()
    bright, dark = (camera.normalised(camera.panorama(pinhole_view(3, gain=gain))) for gain in (1.0, 0.4))
    correlation = float((bright * dark).sum() / np.sqrt((bright**2).sum() * (dark**2).sum()))
    assert correlation > 0.99
    assert float(dark.std()) > 0.85 * float(bright.std())


@pytest.mark.parametrize("turned_deg", [-12.0, 0.0, 5.0, 20.0])
def test_a_robot_turned_to_the_left_must_turn_back_to_the_right(turned_deg: float) -> None:
    camera = pinhole()
    descriptors = [camera.normalised(camera.panorama(pinhole_view(i))) for i in range(4)]
    view = camera.normalised(camera.panorama(pinhole_view(2, turned_deg * DEG, gain=0.6)))
    found = Matcher(camera, descriptors).match(view)
    assert int(found.scores.argmax()) == 2
    assert found.scores[2] > 0.9
    assert found.turns[2] == pytest.approx(-turned_deg * DEG, abs=0.5 * DEG)


def test_a_closed_panorama_is_matched_around_its_ends() -> None:
    camera = Preprocessor("fisheye_pair", math.pi, (64, 64))
    descriptors = [camera.normalised(camera.panorama(fisheye_view(i))) for i in range(3)]
    view = camera.normalised(camera.panorama(fisheye_view(1, 100.0 * DEG)))
    found = Matcher(camera, descriptors, MatchingSettings(max_shift=math.pi)).match(view)
    assert int(found.scores.argmax()) == 1
    assert found.turns[1] == pytest.approx(-100.0 * DEG, abs=1.5 * DEG)


def test_some_nodes_are_matched_alone() -> None:
    camera = pinhole()
    descriptors = [camera.normalised(camera.panorama(pinhole_view(i))) for i in range(5)]
    matcher = Matcher(camera, descriptors)
    every, some = matcher.match(descriptors[3]), matcher.match(descriptors[3], 2, 4)
    assert np.allclose(some.scores, every.scores[2:4])
    assert np.allclose(some.turns, every.turns[2:4])


def test_a_place_is_found_although_bright_and_dark_have_changed_places() -> None:
    camera = pinhole()
    matcher = Matcher(camera, [camera.descriptor(pinhole_view(i)) for i in range(4)])
    negative = (255 - pinhole_view(2, -8.0 * DEG)[0],)
    found = matcher.match(camera.descriptor(negative))
    assert int(found.scores.argmax()) == 2
    assert found.turns[2] == pytest.approx(8.0 * DEG, abs=0.6 * DEG)


def test_a_longer_lens_shows_the_same_with_its_zoom() -> None:
    # 110 % of the focal length of 100 degrees.
    view = (cv2.resize(pinhole_view(1)[0], None, fx=1.1, fy=1.1, interpolation=cv2.INTER_LINEAR),)
    top, left = (view[0].shape[0] - SIZE[1]) // 2, (view[0].shape[1] - SIZE[0]) // 2
    zoomed = (np.ascontiguousarray(view[0][top : top + SIZE[1], left : left + SIZE[0]]),)
    camera = pinhole()
    as_is, true = (camera.panorama(zoomed, zoom)[:, 8:-8] for zoom in (1.0, 1.1))
    target = camera.panorama(pinhole_view(1))[:, 8:-8]
    assert float(np.abs(true - target).mean()) < 0.3 * float(np.abs(as_is - target).mean())


def test_a_covered_lens_has_no_texture_though_its_sensor_has_noise() -> None:
    noise = np.random.default_rng(0).normal(12.0, 5.0, (64, 96, 3))
    assert texture((np.clip(noise, 0, 255).astype(np.uint8),)) < 1.5
    assert texture(pinhole_view(0, gain=0.2)) > 5.0


def test_views_that_are_not_the_cameras_are_refused() -> None:
    camera = pinhole()
    with pytest.raises(ViewError, match=r"a view of 2 images, but a pinhole camera has 1: front"):
        camera.panorama(pinhole_view(0) * 2)
    with pytest.raises(ViewError, match=r"image front has shape \(32, 32, 3\) and type uint8, the path has \(64, 96, 3\)"):
        camera.panorama((np.zeros((32, 32, 3), dtype=np.uint8),))
    with pytest.raises(SettingError, match=r"field of view is 200\.0 degrees, must be 5 to 179 \(pinhole\)"):
        Preprocessor("pinhole", 200.0 * DEG, SIZE)
    with pytest.raises(SettingError, match=r"window is 0, must be 1 to 200"):
        PreprocessingSettings(window=0.0)
    with pytest.raises(SettingError, match=r"max_shift is 30 rad, must be above 0, at most pi; was it given in degrees\?"):
        MatchingSettings(max_shift=30.0)
